"""Marginals of a discrete chain's hidden variables, read from beliefs over its slices.

A *slice* is the hidden variables of a step: states and controls. A belief over it is (*states,
*runs): an axis for each of its variables, then one of runs, or none where the user gave no axes of
runs. It *knows* the measurements that it is given. The last step is T.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pgm.beliefs.markov.measurements import expected
from pgm.beliefs.markov.plan import SlicePlan
from pgm.display import NoArray, Shown, Summary
from pgm.evidence import BoundEvidence
from pgm.factors import GaussianMixture, Table
from pgm.factors.axes import discrete
from pgm.kernels.arrays import Array, frozen
from pgm.posteriors.belief_kind import Kind
from pgm.posteriors.hidden import located, measured
from pgm.posteriors.summaries import marginals_over_time
from pgm.variables import Variable

# Beliefs over the slice by step, (*states, *runs).
Beliefs = Sequence[Array] | Array


@dataclass(frozen=True, eq=False, repr=False)
class StateMarginals(Shown, NoArray):
    """The marginals of the hidden variables of a discrete chain over all steps, by variable.

    plan: The plan of the model, which has the axes of variables in a belief.
    beliefs: The beliefs over the slice by step, (*states, *runs) each.
    lead: The user's axes of runs.
    kind: Which measurements the beliefs know.
    """

    plan: SlicePlan
    beliefs: Beliefs
    lead: tuple[int, ...]
    kind: Kind

    def __getitem__(self, variable: Variable) -> Table:
        """The marginal of ``x`` at all its steps, (*lead, steps, size), or of ``x.at(3)`` at one.

        At one step it is (*lead, size). The steps of a state are 0..T, those of a control 1..T. Any
        variable but a hidden one, and a step that it lacks, raises `EvidenceError`.
        """
        template, first = located(self.plan.layout, variable, len(self.beliefs) - 1)
        if variable.step is not None:
            values = self._summed(self.beliefs[variable.step], template)
            shape = (*self.lead, *values.shape[:1])
            return Table._plain(discrete((variable,)), frozen(values.T.reshape(shape).copy()))
        if isinstance(self.beliefs, np.ndarray):
            rows = self._summed(self.beliefs[first:], template, 1)
        else:
            rows = np.stack([self._summed(belief, template) for belief in self.beliefs[first:]])
        rows = np.moveaxis(rows, -1, 0) if self.lead else rows  # (runs, steps, size)
        shape = (*self.lead, len(self.beliefs) - first, rows.shape[-1])
        return Table._plain(discrete((template,)), frozen(rows.reshape(shape)))

    def _summed(self, belief: Array, variable: Variable, steps: int = 0) -> Array:
        """The marginal of a variable, (size, *runs), from a belief over the slice.

        With `steps` = 1 the belief has a leading axis of steps, and so has the marginal.
        """
        if len(self.plan.slice) == 1:
            return belief
        own = self.plan.labels[variable]
        others = (k + steps for k in range(len(self.plan.slice)) if k != own)
        found: Array = belief.sum(axis=tuple(others))
        return found

    @property
    def _title(self) -> str:
        runs = f", runs {self.lead}" if self.lead else ""
        return f"Marginals({self.kind}, steps 0..{len(self.beliefs) - 1}{runs})"

    def _summary(self) -> Summary:
        last = len(self.beliefs) - 1
        return marginals_over_time(self._title, self, self.plan.layout, self.lead, last)


@dataclass(frozen=True, eq=False, repr=False)
class PredictedStates(StateMarginals):
    """The marginals before each step's measurements, and the beliefs of measurements to be taken.

    bound: The evidence, with the sensors at steps where nothing was read.
    """

    bound: BoundEvidence

    def __getitem__(self, variable: Variable) -> Table | GaussianMixture:  # type: ignore[override]
        """The marginal of a hidden variable, or the belief of a measurement, by row.

        A measurement that depends on observed parents that evidence does not tell raises
        `EvidenceError`.
        """
        if measured(self.plan.layout, variable) is None:
            return super().__getitem__(variable)
        return expected(self.plan, self.bound, variable, self.beliefs)
