"""Networks of the Bayesian network repository: their files, and what is observed of leaves."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import numpy.typing as npt

import pgm
from benchmarks.work.tables import Task

NAMES = (
    "asia",
    "cancer",
    "earthquake",
    "survey",
    "sachs",
    "child",
    "alarm",
    "insurance",
    "hailfinder",
    "win95pts",
    "hepar2",
    "andes",
)
LARGE = (
    "pigs",
    "water",
    "munin1",
    "link",
    "pathfinder",
    "mildew",
    "barley",
    "munin",
    "munin2",
    "munin3",
    "munin4",
    "diabetes",
)
OBSERVED = 5


@dataclass(frozen=True, eq=False)
class Sets:
    """A network and many sets of evidence, for each of which all marginals are asked.

    Attributes
    ----------
    network : BayesianNetwork
    evidence : dict of Variable to ndarray of int
        The index of a state by set; −1 where it is not observed.
    """

    network: pgm.BayesianNetwork
    evidence: dict[pgm.Variable, npt.NDArray[np.intp]]

    @property
    def count(self) -> int:
        """Number of sets."""
        return len(next(iter(self.evidence.values())))

    @property
    def hidden(self) -> list[pgm.Discrete]:
        """The variables that are not observed in all sets."""
        seen = {v for v, states in self.evidence.items() if (states >= 0).all()}
        return [v for v in self.network.variables if v not in seen and isinstance(v, pgm.Discrete)]


def several(name: str, count: int) -> list[Task]:
    """Sets of five leaves each, drawn from the network one after the other."""
    network = read(name)
    return [_one(network, seed) for seed in range(count)]


def _one(network: pgm.BayesianNetwork, seed: int) -> Task:
    rng = np.random.default_rng(seed)
    drawn = network.sample(rng=rng)
    return Task(network, {leaf: int(drawn[leaf]) for leaf in _some(network, rng)})


def many(name: str, count: int, seed: int = 0) -> Sets:
    """Sets of five leaves each, other ones each time."""
    network = read(name)
    rng = np.random.default_rng(seed)
    drawn = network.sample(count, rng=rng)
    evidence = {leaf: np.full(count, -1) for leaf in _leaves(network)}
    for k in range(count):
        for leaf in _some(network, rng):
            evidence[leaf][k] = drawn[leaf][k]
    return Sets(network, evidence)


@cache
def read(name: str) -> pgm.BayesianNetwork:
    """The network of a file that comes with pgmpy; see `path`."""
    return pgm.read_bif(path(name), normalise=True)


def path(name: str) -> Path:
    """A gzipped file that comes with pgmpy.

    Raises
    ------
    ImportError
        If it is not here.
    """
    found = find_spec("pgmpy")
    if found is None or not found.submodule_search_locations:
        raise ImportError("the networks' files come with pgmpy, which is not here")
    folder = Path(found.submodule_search_locations[0]) / "utils" / "example_models"
    file = folder / f"{name}.bif.gz"
    if not file.is_file():
        raise ImportError(f"{name}.bif.gz does not come with the pgmpy that is here")
    return file


def _leaves(network: pgm.BayesianNetwork) -> list[pgm.Variable]:
    parents = {parent for cpd in network.cpds for parent in cpd.given}
    return [variable for variable in network.variables if variable not in parents]


def _some(network: pgm.BayesianNetwork, rng: np.random.Generator) -> list[pgm.Variable]:
    leaves = _leaves(network)
    chosen = rng.choice(len(leaves), min(OBSERVED, len(leaves)), replace=False)
    return [leaves[k] for k in chosen.tolist()]
