"""Inference in the runs of each pattern of gaps, and in those of them that are possible."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from pgm.beliefs.gaussian.refusals import Contradiction
from pgm.beliefs.own.family import BeliefFamily
from pgm.clustergraph import ClusterGraph
from pgm.cpds import CPD, ConditionalGaussian, GaussianCPD
from pgm.cpds.by_run import repeated
from pgm.cpds.caused import components
from pgm.errors import EvidenceError, PgmError
from pgm.evidence.cells import Cells, Pattern
from pgm.evidence.values import soft
from pgm.factors.scope import listed
from pgm.inference.gaps.outcome import Group, OutcomeByPattern
from pgm.inference.gaps.readings import with_readings
from pgm.kernels.arrays import Integers
from pgm.networks import BayesianNetwork, MarkovNetwork
from pgm.posteriors.outcome import Outcome
from pgm.progress import counted
from pgm.schedules.impossible import ImpossibleEvidence, allows
from pgm.schedules.options import Call
from pgm.schedules.starting_points import Start
from pgm.variables import Discrete, Variable


def by_pattern(
    family: BeliefFamily[Any], graph: ClusterGraph, cells: Cells, call: Call
) -> Outcome[Any]:
    """The beliefs of a network without time, solved for each pattern of gaps by itself.

    With ``impossible="allow"`` runs whose evidence is impossible are left out, and told to be so.
    """
    patterns = list(cells.patterns())
    solver = _Solver(family, graph, cells, call, alone=len(patterns) == 1)
    groups: list[Group] = []
    for pattern in counted(patterns, "patterns of gaps"):
        groups += solver.solved(pattern)
    only = groups[0]
    if len(groups) == 1 and only.outcome is not None and only.is_plain(cells.lead):
        found = only.outcome
    else:
        found = OutcomeByPattern(graph, cells, tuple(groups))
    if call.tells:
        found.status._warn()
    return found


class _Solver:
    """The runs of some evidence, solved by pattern.

    `alone` says that they have one pattern.
    """

    def __init__(
        self,
        family: BeliefFamily[Any],
        graph: ClusterGraph,
        cells: Cells,
        call: Call,
        *,
        alone: bool,
    ) -> None:
        self.family, self.graph, self.cells, self.call = family, graph, cells, call
        self.alone, self.allow = alone, allows(call.impossible)

    def solved(self, pattern: Pattern) -> Iterator[Group]:
        """The beliefs of the runs of a pattern, and those that are impossible, if allowed."""
        parts = [pattern.runs]
        if self.call.start is not None and not self._differ(pattern):
            parts = list(pattern.runs[:, None])  # which differ in their start alone
        for runs in parts:
            yield from self._solved(pattern, runs)

    def _differ(self, pattern: Pattern) -> bool:
        """Whether the runs of a pattern may differ in what they observe."""
        hidden = self.cells.values.keys() - pattern.whole - pattern.parts.keys()
        seen = (v for v in self.cells.variables if v not in hidden)
        return any(len(self.cells.rows(v)) > 1 for v in seen)

    def _solved(self, pattern: Pattern, runs: Integers) -> Iterator[Group]:
        lost = [runs[:0]]
        while runs.size:
            try:
                outcome, readings = self._outcome(pattern, runs)
            except (Contradiction, ImpossibleEvidence) as error:
                gone = _lost(error, runs.size)
                if not self.allow or not gone.size:
                    raise self._placed(error, pattern, runs) from None
                lost.append(runs[gone])
                runs = np.delete(runs, gone)
            except PgmError as error:
                raise self._placed(error, pattern, runs) from None
            else:
                yield Group(runs, pattern, outcome, readings)
                break
        if (impossible := np.concatenate(lost)).size:
            yield Group(np.sort(impossible), pattern, None, {})

    def _outcome(
        self, pattern: Pattern, runs: Integers
    ) -> tuple[Outcome[Any], Mapping[Variable, Variable]]:
        """The beliefs of some runs of a pattern, and the readings of variables seen in part."""
        cells, graph = self.cells, self.graph
        if graph.network.lead and runs.size < cells.runs:
            graph = _of_runs(graph, cells.lead, runs)
        weighed = {v for v in pattern.parts if _is_weighed(graph.network, v)}
        parts = {v: mask for v, mask in pattern.parts.items() if v not in weighed}
        readings: Mapping[Variable, Variable] = {}
        if parts:
            graph, readings = with_readings(graph, parts)
        evidence: dict[Variable, Any] = {}
        for variable in cells.variables:
            rows = self._rows(cells, variable, runs)
            if variable in cells.weights:
                evidence[variable] = soft(rows, log=True)
            elif variable in readings:
                evidence[readings[variable]] = rows[..., parts[variable]]
            elif isinstance(variable, Discrete) or variable in pattern.whole | weighed:
                evidence[variable] = rows
        start = None if self.call.start is None else self._start(self.call.start, pattern, runs)
        call = self.call._replace(start=start, tells=False)
        return self.family.infer_static(graph, evidence, call), readings

    def _rows(self, cells: Cells, variable: Variable, runs: Integers) -> Any:
        """A variable's evidence in some runs, with their axis where they may differ.

        All runs together have the user's axes.
        """
        rows = cells.rows(variable, runs)
        if len(cells.rows(variable)) == 1:
            return rows[0]
        return rows.reshape((*cells.lead, *rows.shape[1:])) if runs.size == cells.runs else rows

    def _start(self, start: Start, pattern: Pattern, runs: Integers) -> dict[Variable, Any]:
        """The means at which some runs begin, of the variables that they leave hidden."""
        own = {v: value for v, value in start.items() if not self._is_seen(v, pattern)}
        laid = Cells.of(own, self.cells.lead)
        if laid.lead != self.cells.lead:
            return own  # which is refused
        rows = {v: self._rows(laid, v, runs) for v in own}
        # One run's start has no axis of runs, which its evidence may lack.
        return {v: each.reshape(-1) if runs.size == 1 else each for v, each in rows.items()}

    def _is_seen(self, variable: Variable, pattern: Pattern) -> bool:
        """Whether a variable is observed in the runs of a pattern, and hidden in others."""
        return variable in pattern.whole and self.cells.gaps(variable)

    def _placed(self, error: PgmError, pattern: Pattern, runs: Integers) -> PgmError:
        """The error of some runs, with their numbers among all of them."""
        if self.alone or not self.cells.lead:
            return error
        lacking = [v for v in self.cells.values if v not in pattern.whole]
        of = f"lack something of ({listed(lacking)})" if lacking else "lack nothing"
        own = error.run or 0
        error.args = (
            f"{error.args[0]} (runs with the same gaps are counted by themselves: of those here, "
            f"which {of}, run {own} is run {runs[own]} of all)",
        )
        error.run = None if error.run is None else int(runs[own])
        return error


def _lost(error: Contradiction | ImpossibleEvidence, runs: int) -> Integers:
    """The places of the runs, of so many, that an error found impossible.

    All are, if one is and they share their evidence.
    """
    return np.flatnonzero(np.broadcast_to(error.lost, (runs,)))


def _is_weighed(network: MarkovNetwork, variable: Variable) -> bool:
    """Whether a variable is a measurement of robust noise, whose residual is weighed.

    It has no belief, and the components that were not measured are left out of its residual.
    """
    if not isinstance(network, BayesianNetwork):
        return False
    cpd = next((cpd for cpd in network.cpds if cpd.child == variable), None)
    return cpd is not None and any(
        isinstance(case, ConditionalGaussian) and case.noise is not None for case in components(cpd)
    )


def _of_runs(graph: ClusterGraph, lead: tuple[int, ...], runs: Integers) -> ClusterGraph:
    """The graph of a network whose CPDs differ by run, for some of the runs."""
    cpds: list[CPD] = []
    for cpd in graph.network.cpds:
        if not cpd._lead():
            cpds.append(cpd)
        elif isinstance(cpd, GaussianCPD):
            cpds.append(repeated(cpd, 1, lead, runs))
        else:
            raise EvidenceError(
                f"{cpd!r} differs by run, and so do the gaps of the evidence: give runs of one "
                "pattern of gaps to a call",
                variable=cpd.child,
                cpd=cpd,
            )
    network = BayesianNetwork._made(cpds)
    return graph._with(network, graph._members, graph._shared, graph._assigned)
