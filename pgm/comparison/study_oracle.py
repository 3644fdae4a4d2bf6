"""The oracle of a study: how far beliefs of each run are from those of a grid or of many draws."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from pgm.beliefs.own.family import BeliefFamily, require_family
from pgm.boundary import is_whole
from pgm.comparison.drawn_runs import of_runs
from pgm.comparison.judgement import judge
from pgm.comparison.oracle import Compared, references
from pgm.comparison.reference import Reference
from pgm.comparison.row import FAILURES, proper
from pgm.comparison.study_methods import ORACLES, require_seeds, seeded
from pgm.comparison.tally import Tally
from pgm.compile import DynamicGraph
from pgm.display import titled
from pgm.errors import ModelError
from pgm.factors import Gaussian
from pgm.kernels.arrays import Array, Integers
from pgm.networks import DynamicBayesianNetwork, Sample
from pgm.posteriors.belief_kind import Kind
from pgm.variables import Variable

# Of one run, by kind and state; none where the oracle's own inference ended in an error.
References = Mapping[tuple[Kind, Variable], Reference]


class StudyOracle(NamedTuple):
    """A family of beliefs that is run on each run, with seeds of its own.

    graph: Not in machine code, which families have no use for.
    repeats: How often it is run on each run, where its draws have a seed.
    """

    family: BeliefFamily[Any]
    graph: DynamicGraph
    states: tuple[Variable, ...]
    kinds: tuple[Kind, ...]
    repeats: int

    def references(self, sample: Sample, first: int) -> list[References]:
        """Its beliefs of each run of a block that begins with run `first`."""
        found: list[References] = []
        for place in range(len(sample[self.states[0]])):
            evidence = of_runs(sample, place).evidence
            compared = Compared(self.graph, evidence, (), self.states, self.kinds)
            family = seeded(self.family, ORACLES + self.repeats * (first + place))
            try:
                found.append(references(family, compared, self.repeats))
            except FAILURES:
                found.append({})
        return found


def oracle_of(
    family: Any,
    repeats: Any,
    graph: DynamicGraph,
    states: tuple[Variable, ...],
    kinds: tuple[Kind, ...],
) -> StudyOracle:
    """The oracle that a study is given, checked.

    Raises
    ------
    ModelError
        If it is no family of beliefs, cannot carry the model, or would draw the same in each run.
    """
    model: DynamicBayesianNetwork = graph.model
    if not isinstance(family, BeliefFamily):
        raise ModelError(
            f"oracle={titled(family)}: each run of a study has evidence of its own, on which its "
            "oracle is run: pgm.Grid(...), pgm.Particles(...) or another family of beliefs; a "
            "posterior or an audit judges one run, pgm.compare(model, found.run(k).evidence, ...)"
        )
    if not is_whole(repeats) or repeats < 4:
        raise ModelError(f"repeats is a whole number of runs, 4 or more, not {repeats!r}")
    require_family(family, model)
    require_seeds(family)
    return StudyOracle(family, graph, states, kinds, int(repeats))


def judged(
    belief: Gaussian, each: Sequence[References], kind: Kind, state: Variable
) -> tuple[dict[str, Tally], Integers]:
    """Tallies of the KL of runs' beliefs, and the places of runs whose oracle is not to be trusted.

    ``"kl"`` is by run and step, in nats; ``"oracle"`` is the square of its Monte Carlo error, and
    ``"oracle sum"`` that of the error of its sum over the steps of a run, (runs, 1).

    belief: (runs, T+1, d), of this kind and state.
    """
    count = belief.mean.shape[-2]
    kl, square = (np.full((len(each), count), np.nan) for _ in range(2))
    total, doubtful = np.full((len(each), 1), np.nan), []
    for place, found in enumerate(each):
        if not found:
            doubtful.append(place)
            continue
        reference, own = found[kind, state], belief[place]
        kept = proper(own) & proper(reference.gaussian)
        judgement, _ = judge(reference, own, kept)
        kl[place], square[place] = judgement.kl_by_step, judgement.error_by_step**2
        total[place] = (judgement.error * kept.sum()) ** 2
        if reference.doubt or np.isnan(judgement.error):
            doubtful.append(place)
    tallies = {"kl": Tally.of(kl), "oracle": Tally.of(square), "oracle sum": Tally.of(total)}
    return tallies, np.array(doubtful, dtype=np.intp)


def errors_of(tallies: Mapping[str, Tally]) -> tuple[float, Array]:
    """The oracle's Monte Carlo error of the mean KL, over all runs and steps and by step.

    Runs have draws of their own, so that the squares of their errors add up.
    """
    kl, oracle, total = (tallies[name] for name in ("kl", "oracle", "oracle sum"))
    known = kl.centre[1] * kl.runs
    with np.errstate(divide="ignore", invalid="ignore"):
        by_step = np.sqrt(oracle.mean / oracle.known)
        whole = np.sqrt(total.mean * total.known)[0] / known
    return float(whole), np.where(oracle.known > 0.0, by_step, np.nan)
