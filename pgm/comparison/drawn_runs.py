"""The runs of a study: truths and measurements, drawn in blocks by counters."""

from __future__ import annotations

from importlib.util import find_spec
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from pgm.cpds.conditional import ConditionalGaussian
from pgm.cpds.losses import Cauchy, Huber, StudentT, TruncatedLeastSquares
from pgm.display import titled
from pgm.errors import EvidenceError, ModelError
from pgm.evidence import Evidence, Sightings, bind, sightings
from pgm.factors.scope import listed
from pgm.networks import DynamicBayesianNetwork, Sample
from pgm.networks.compiled_draws import drawn_compiled
from pgm.networks.counted import CountedDraws
from pgm.networks.sampling import draw_steps
from pgm.variables import Variable

# The most runs of a block. Neither it nor `ROOM` is for users: the last digits of a study's
# figures depend on how its runs are divided, and so it is divided in the same way everywhere.
MOST = 1024
# The numbers that the means and covariances of a block may take.
ROOM = 2**24
# Noises that ask for no more of a generator than `pgm.networks.counted.Stream` has.
_NOISES = Cauchy | Huber | StudentT | TruncatedLeastSquares | None


class DrawnRuns(NamedTuple):
    """The runs 0, 1, ... of a study; a block of them is drawn when it is asked for."""

    model: DynamicBayesianNetwork
    inputs: Evidence
    steps: int
    runs: int
    seed: int
    block: int
    compiled: bool = False

    @property
    def blocks(self) -> range:
        """The numbers of the first runs of the blocks."""
        return range(0, self.runs, self.block)

    def sample(self, first: int) -> Sample:
        """The block that begins with a run."""
        count = min(self.block, self.runs - first)
        compiled = self.compiled and find_spec("llvmlite") is not None
        draws = CountedDraws(self.seed, first, count, compiled=compiled)
        by = drawn_compiled if draws.compiled else None
        return draw_steps(self.model, self.inputs, self.steps, count, draws.at, by)

    def run(self, number: int) -> Sample:
        """One run, without an axis of runs.

        Its whole block is drawn, so that the functions of the model are called as they were in the
        study, and round as they did.
        """
        place = number % self.block
        return of_runs(self.sample(number - place), place)


def of_runs(sample: Sample, which: int | slice) -> Sample:
    """Some runs of a sample whose first axis is of runs."""
    values = {variable: each[which] for variable, each in sample.values.items()}
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
    """The runs of a model, after a check that they can be drawn by counters.

    Raises
    ------
    ModelError
        If a CPD is of a kind that asks a generator for more than counters give, or has runs.
    EvidenceError
        If the inputs do not fit the model, or have axes of runs.
    """
    for cpd in model.cpds:
        noise = getattr(cpd, "noise", None)
        if not isinstance(cpd, ConditionalGaussian) or not isinstance(noise, _NOISES):
            thing = f"has {titled(noise)}" if isinstance(cpd, ConditionalGaussian) else "is none"
            raise ModelError(
                f"a study draws CPDs with Gaussian, Student-t, Cauchy or Huber noise by counters, "
                f"and {cpd!r} {thing}; draw with model.sample(..., runs=, rng=), and compare with "
                "pgm.compare(...)",
                variable=cpd.child,
                cpd=cpd,
            )
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
    size = sum(variable.dimension for variable in hidden)
    # Means and covariances, of filter, smoother and what is between them.
    each = 4 * (bound.steps + 1) * size * (size + 1)
    block = MOST
    while block > 1 and block * each > ROOM:
        block //= 2
    return DrawnRuns(model, inputs, bound.steps, runs, seed, block)
