"""Marginals of the hidden variables of a chain over all steps, cut out of the beliefs over slices.

A slice is the vector of all hidden variables of a step; a chain has the steps 0..T. The template of
a variable ``x.at(3)`` is ``x``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pgm.beliefs.moments.outcomes.measurements import expected
from pgm.beliefs.moments.passes.backward import Beliefs
from pgm.beliefs.moments.steps.diffuse import Diffuse
from pgm.beliefs.moments.steps.plan import ChainPlan
from pgm.compile import SliceLayout
from pgm.display import NoArray, Shown, Summary
from pgm.factors import Gaussian
from pgm.kernels.arrays import block, quiet
from pgm.posteriors.belief_kind import Kind
from pgm.posteriors.hidden import located, measured
from pgm.posteriors.summaries import marginals_over_time
from pgm.variables import Variable


@dataclass(frozen=True, eq=False, repr=False)
class Marginals(Shown, NoArray):
    """The marginals of hidden variables over all steps, by variable.

    They are cut out of `beliefs`, the moments of all slices, in which the variables stand as
    `layout` says. `beliefs` has one axis of runs, for which a marginal has the user's axes, `lead`.

    Attributes
    ----------
    kind : Kind
        Which measurements the marginals know: predicted, filtered, fixed-lag or smoothed.
    """

    # The moments of the slices, whose runs are flattened from the axes `lead`.
    layout: SliceLayout
    beliefs: Beliefs
    lead: tuple[int, ...]
    kind: Kind

    def __getitem__(self, variable: Variable) -> Gaussian:
        """The marginal of a variable: ``x`` gives it at all its steps, ``x.at(3)`` at one step.

        The mean is (*runs, steps, d) for ``x``, stacked by step, and (*runs, d) for ``x.at(3)``;
        d counts the variable's components.

        Raises
        ------
        EvidenceError
            If the variable is not hidden, or has no such step.
        """
        layout, last = self.layout, self.beliefs.mean.shape[0] - 1
        template, first = located(layout, variable, last)
        places = layout.places[template]
        if variable.step is not None:
            mean = self.beliefs.mean[variable.step][:, places]
            cov = block(self.beliefs.cov[variable.step], places, places)
            shape = self.lead
            return Gaussian._make(
                (variable,),
                mean.reshape(*shape, mean.shape[-1]),
                cov.reshape(*shape, *cov.shape[-2:]),
            )
        steps = np.arange(first, last + 1)
        if self.lead == () and isinstance(places, slice):  # views, in a quarter of the time
            mean = self.beliefs.mean[first:, 0, places]
            cov = self.beliefs.cov[first:, 0, places, places]
            return Gaussian._make((variable,), mean, cov, steps)
        mean = self.beliefs.mean[first:][..., places].swapaxes(0, 1)
        cov = block(self.beliefs.cov[first:], places, places).swapaxes(0, 1)
        return Gaussian._make(
            (variable,),
            mean.reshape(*self.lead, *mean.shape[1:]),
            cov.reshape(*self.lead, *cov.shape[1:]),
            steps,
        )

    @property
    def _title(self) -> str:
        runs = f", runs {self.lead}" if self.lead else ""
        return f"Marginals({self.kind}, steps 0..{self.beliefs.mean.shape[0] - 1}{runs})"

    def _summary(self) -> Summary:
        last = self.beliefs.mean.shape[0] - 1
        return marginals_over_time(self._title, self, self.layout, self.lead, last)


@dataclass(frozen=True, eq=False, repr=False)
class Predicted(Marginals):
    """The marginals before each step's measurements, and the beliefs of measurements to be taken.

    `plan` has the sensors with their linearisations, and `spread` the covariances before
    measurements, along known and unknown directions.
    """

    plan: ChainPlan
    spread: Diffuse

    @quiet()
    def __getitem__(self, variable: Variable) -> Gaussian:
        """The marginal of a hidden variable, as of `Marginals`, or the belief of a measurement.

        Rows of a measurement ``z`` are steps, as `steps` says; see `Posterior.predicted`.

        Raises
        ------
        EvidenceError
            If the variable is neither hidden nor a measurement, has no such step, or depends on
            observed parents that evidence does not tell.
        """
        sensor = measured(self.layout, variable)
        if sensor is None:
            return super().__getitem__(variable)
        found = expected(self.plan, sensor, self.beliefs.mean, self.spread)
        return found.gaussian(variable, self.lead)
