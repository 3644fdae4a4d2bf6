"""The runs of a study: truths and measurements, drawn in blocks by counters, or one by one."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from importlib.util import find_spec
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from pgm.cpds import CPD, MixtureCPD, SwitchingCPD, TableCPD
from pgm.cpds.conditional import ConditionalGaussian
from pgm.cpds.losses import Cauchy, Huber, StudentT, TruncatedLeastSquares
from pgm.errors import EvidenceError, ModelError
from pgm.evidence import Evidence, Sightings, bind, sightings
from pgm.factors.scope import listed
from pgm.networks import DynamicBayesianNetwork, Sample
from pgm.networks.compiled_draws import drawn_compiled
from pgm.networks.counted import CASES, CountedDraws
from pgm.networks.sampling import draw_steps
from pgm.variables import Discrete, Variable

# The most runs of a block. Neither it nor `ROOM` is for users: the last digits of a study's
# figures depend on how its runs are divided, and so it is divided in the same way everywhere.
MOST = 1024
# The numbers that the means and covariances of a block may take.
ROOM = 2**24
# Noises that ask for no more of a generator than `pgm.networks.counted.Stream` has.
_NOISES = Cauchy | Huber | StudentT | TruncatedLeastSquares | None


class DrawnRuns(NamedTuple):
    """The runs 0, 1, ... of a study; a block of them is drawn when it is asked for.

    counted: Whether all runs of a block are drawn together, by counters; else each is drawn by a
        generator of its own.
    """

    model: DynamicBayesianNetwork
    inputs: Evidence
    steps: int
    runs: int
    seed: int
    block: int
    counted: bool = True
    compiled: bool = False

    @property
    def blocks(self) -> range:
        """The numbers of the first runs of the blocks."""
        return range(0, self.runs, self.block)

    def sample(self, first: int) -> Sample:
        """The block that begins with a run."""
        count = min(self.block, self.runs - first)
        if not self.counted:
            return _stacked([self._alone(k) for k in range(first, first + count)])
        compiled = self.compiled and find_spec("llvmlite") is not None
        draws = CountedDraws(self.seed, first, count, compiled=compiled)
        by = drawn_compiled if draws.compiled else None
        return draw_steps(self.model, self.inputs, self.steps, count, draws.at, by)

    def _alone(self, number: int) -> Sample:
        """One run, by a generator whose seeds are the study's and the run's number."""
        seeds = np.random.SeedSequence(self.seed, spawn_key=(number,))
        rng = np.random.Generator(np.random.Philox(seeds))
        return self.model.sample(self.inputs, steps=self.steps, rng=rng)

    def run(self, number: int) -> Sample:
        """One run, without an axis of runs.

        Of runs that are drawn together the whole block is drawn, so that the functions of the model
        are called as they were in the study, and round as they did.
        """
        if not self.counted:
            return self._alone(number)
        place = number % self.block
        return of_runs(self.sample(number - place), place)


def of_runs(sample: Sample, which: int | slice) -> Sample:
    """Some runs of a sample whose first axis is of runs."""
    return _with_values(sample, {variable: each[which] for variable, each in sample.values.items()})


def _stacked(samples: Sequence[Sample]) -> Sample:
    """Samples of one run each, along a first axis of runs."""
    first = samples[0]
    values = {variable: np.stack([each[variable] for each in samples]) for variable in first.values}
    return _with_values(first, values)


def _with_values(sample: Sample, values: Mapping[Variable, Any]) -> Sample:
    """A sample with other values, of its evidence too."""
    evidence: dict[Variable, Any] = dict(sample.evidence)
    for variable in evidence.keys() & values.keys():
        asked, drawn = evidence[variable], values[variable]
        evidence[variable] = (
            sightings(drawn, asked.step, asked.given) if isinstance(asked, Sightings) else drawn
        )
    return Sample(MappingProxyType(values), MappingProxyType(evidence))


def drawn_runs(
    model: DynamicBayesianNetwork,
    inputs: Evidence,
    steps: int | None,
    runs: int,
    seed: int,
) -> DrawnRuns:
    """The runs of a model, after a check that they can be drawn.

    Raises
    ------
    ModelError
        If the model has no sensors, or a CPD has runs.
    EvidenceError
        If the inputs do not fit the model, or have axes of runs.
    """
    if not model.observation:
        raise ModelError(
            "the model has no sensors, so that there is nothing to filter: give it an observation"
        )
    if model.lead:
        raise ModelError(
            f"the model has CPDs with axes of runs {model.lead}, where the runs of a study are "
            "draws of one model; make a study of each"
        )
    # Runs are drawn again later, whatever becomes of the caller's arrays.
    inputs = {
        v: each.copy() if isinstance(each, np.ndarray) else each for v, each in inputs.items()
    }
    for cpd in model.observation:
        given = inputs.get(cpd.child)
        if isinstance(given, np.ndarray) and given.ndim > 2:
            raise EvidenceError(
                f"{cpd.child!r} is given as an array of shape {given.shape}, which "
                "has axes of runs; a study draws what sensors read: give (steps, components), or "
                "pgm.sightings(step=...)",
                variable=cpd.child,
            )
    bound = bind(model.transition, model.observation, inputs, steps, (1,), drawing=True)
    if bound.lead != (1,):
        raise EvidenceError(
            f"the inputs {listed(inputs)} have axes of runs {bound.lead}, where the runs of a "
            "study are draws with one course of inputs; make a study of each"
        )
    hidden = (*model.states, *model.controls)
    size = sum(variable.dimension or 1 for variable in hidden)
    # Means and covariances, of filter, smoother and what is between them; of mixtures one for each
    # pair of joint states.
    pairs = math.prod(v.size for v in hidden if isinstance(v, Discrete)) ** 2
    each = 4 * (bound.steps + 1) * size * (size + 1) * pairs
    block = MOST
    while block > 1 and block * each > ROOM:
        block //= 2
    return DrawnRuns(
        model, inputs, bound.steps, runs, seed, block, all(map(_is_counted, model.cpds))
    )


def _is_counted(cpd: CPD) -> bool:
    """Whether a CPD asks a generator for no more than counters give."""
    if isinstance(cpd, SwitchingCPD) or type(cpd) is MixtureCPD:
        parts = cpd.cases.values() if isinstance(cpd, SwitchingCPD) else cpd.parts
        return len(parts) < CASES and all(map(_is_counted, parts))
    if isinstance(cpd, TableCPD):
        return True
    return isinstance(cpd, ConditionalGaussian) and isinstance(cpd.noise, _NOISES)
