r"""Guided proposals: particles drawn where the measurements of their step are.

A particle moves to its next slice x_t by white noise w, drawn from N(0, I). Each CPD of the
transition takes its own components of w; its child is the CPD's mean plus L times these components,
L being the lower triangular root of the CPD's noise covariance.

For each particle, a lineariser makes two Gaussian beliefs of x_t: N(μ⁻, P⁻) before the measurements
of step t, and N(μ⁺, P⁺) after them. With the lower triangular root A of P⁻ = A Aᵀ, the slice is
x_t ≈ μ⁻ + A w. The belief after the measurements is therefore a Gaussian belief of w, too:

.. math:: q(w) = N(w;\, A^{-1}(μ^+ - μ^-),\, A^{-1} P^+ A^{-T}).

A proposal draws w from q, passes it through the transition as it is, not linearised, and multiplies
the particle's weight by N(w; 0, I) / q(w). Weights are exact, however bad the linearisation. A
component without noise of its own, where the diagonal of A is zero, stays a function of the others.

m is the number of particles, n that of the components of a slice, and of w. The *inputs* of the
transition are the values of its observed parents, with a row for each step.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from pgm.beliefs.moments.steps.chain import MomentChain
from pgm.beliefs.moments.steps.plan import ChainPlan
from pgm.beliefs.moments.steps.readings import Moments
from pgm.beliefs.points.laws import Drawing, Some, States
from pgm.beliefs.points.model import ParticleModel
from pgm.compile import DynamicGraph
from pgm.cpds import CPD, ConditionalGaussian, GaussianCPD
from pgm.errors import LinearisationError, ModelError, NumericalError
from pgm.evidence import BoundEvidence, Reading
from pgm.kernels import roots, semidefinite, solving
from pgm.kernels.arrays import Array, quiet
from pgm.linearisers import Lineariser
from pgm.networks import DynamicBayesianNetwork
from pgm.schedules.argument_checks import require_gaussian, require_plain
from pgm.schedules.schedule import Filtering

_ONCE = Filtering()
# The share of its largest variance by which rounding may leave a covariance indefinite.
_ROUNDING = 1e-6


class Guide:
    """The guided proposals of a model: for each particle a Gaussian near p(x_t | x_{t−1}, z_t).

    z_t are the measurements of step t.

    graph: The compiled network.
    model: The network with its evidence, as it is evaluated at particles.
    lineariser: The user's choice, by which the Gaussians are made.
    """

    def __init__(self, graph: DynamicGraph, model: ParticleModel, lineariser: Lineariser) -> None:
        self.graph, self.model, self.lineariser = graph, model, lineariser

    def reads(self, step: int) -> bool:
        """Whether a step has measurements of Gaussian sensors, which can guide a proposal."""
        return any(len(sensor.rows(step)) for sensor in self._sensors)

    @property
    def _sensors(self) -> list[Any]:
        """The model's `Sensor`s that have evidence and whose CPDs are conditional Gaussians."""
        sensors = self.model.sensors
        return [s for s in sensors if isinstance(s.reading.cpd, ConditionalGaussian)]

    def steered(self, row: int, some: Some, drawing: Drawing) -> tuple[Steered, Array]:
        """Draw the white noise w by which particles move to a step, from each particle's q.

        row: The row of the step's inputs.
        some: The particles, with their states at the step before.
        drawing: The generators of the particles' random numbers.

        Returns a source of noise by which the transition's CPDs draw, which gives out w instead of
        random numbers; and ln N(w; 0, I) / q(w) of each particle, (m,). A NumericalError is raised
        if q is not finite, or singular: weights would be infinite.
        """
        before, after = self._moments(row, some)
        lower = roots.root(before.cov)
        free = ~roots.determined(lower)
        mean = solving.whiten(lower, after.mean - before.mean)
        cov = _whitened(lower, after.cov)
        # A direction that the measurements say nothing of is as it was.
        cov += ~free[..., None] * np.eye(cov.shape[-1])
        spread = roots.root(semidefinite.semidefinite(cov, _ROUNDING))
        pivots = np.diagonal(spread, axis1=-2, axis2=-1)
        if not (np.isfinite(mean).all() and (pivots > 0.0).all()):
            raise NumericalError(
                f"the proposals of {self.lineariser!r} at step {some.step} have no support in a "
                "direction in which the transition has: weights would be infinite; leave "
                "proposal= out, or give another lineariser",
                step=some.step,
            )
        drawn = drawing.white(mean.shape[-1], some.size, np.float64).T
        white = mean + np.einsum("mij,mj->mi", spread, drawn)
        square = np.einsum("mi,mi->m", drawn, drawn) - np.einsum("mi,mi->m", white, white)
        return Steered(white.T.astype(self.model.dtype)), 0.5 * square + np.log(pivots).sum(axis=-1)

    @quiet()
    def _moments(self, row: int, some: Some) -> tuple[Moments, Moments]:
        """The moments of each particle's slice, before and after the step's measurements.

        Means μ⁻ and μ⁺ are (m, n), covariances P⁻ and P⁺ (m, n, n). A LinearisationError or
        NumericalError is raised where the lineariser fails.

        row: The row of the step's inputs.
        some: The particles, with their states at the step before.
        """
        plan = self._plan(row, some)
        chain = MomentChain(plan, _ONCE, keep=False, check=True)
        layout, places = self.graph.layout, self.model.places
        mean = np.concatenate([some.before[places[v]] for v in layout.slice], dtype=np.float64)
        begin = Moments(mean.reshape(-1, *plan.batch), np.zeros((*mean.shape[:1] * 2, *plan.batch)))
        try:
            before = chain.predict(1, begin)
            after, _ = chain.take(1, before)
        except (LinearisationError, NumericalError) as error:
            raise type(error)(
                f"a proposal of {self.lineariser!r}, made of each particle, fails at step "
                f"{some.step} (its runs are particles here): {error}",
                variable=error.variable,
                cpd=error.cpd,
                step=some.step,
            ) from error
        return Moments(*before.by_run), Moments(*after.by_run)

    def _plan(self, row: int, some: Some) -> ChainPlan:
        """The plan by which a Gaussian filter makes a single step, each particle being a run.

        A plan is a chain of CPDs with their evidence and their lineariser. This one has the
        particles' step as its step 1. At step 0, the filter is to begin from the particles' states
        before.

        row: The row of the step's inputs.
        some: The particles, at the step.
        """

        def own(values: npt.NDArray[Any]) -> npt.NDArray[Any]:
            """Values (rows, runs or 1, d) as (rows, m or 1, d): a particle has those of its run."""
            return values if values.shape[1] == 1 or some.owner is None else values[:, some.owner]

        def reading(found: Reading, rows: range) -> Reading:
            """A sensor's measurements at the particles' step, as those of step 1 of the plan.

            Each particle has the measurements of its run.

            found: All measurements of the sensor, at all steps, one in each row.
            rows: The rows of those at the particles' step.
            """
            chosen = slice(rows.start, rows.stop)
            return replace(
                found,
                step=np.ones(len(rows), dtype=np.intp),
                order=found.order[chosen],
                values=own(found.values[chosen]),
                taken=own(found.taken[chosen]),
                inputs={v: own(a[chosen]) for v, a in found.inputs.items()},
            )

        bound = self.model.bound
        transition = tuple(
            {v: own(a[row : row + 1]) for v, a in inputs.items()} for inputs in bound.transition
        )
        readings = tuple(
            reading(sensor.reading, sensor.rows(some.step))
            for sensor in self._sensors
            if len(sensor.rows(some.step))
        )
        one = BoundEvidence(1, (some.size,), transition, readings)
        return ChainPlan.make(
            self.graph, one, self.lineariser, first=some.step - 1, prior=False, probe=False
        )


class Steered(Drawing):
    """A source of fixed white noise, in place of random generators.

    The noise is an array (n, m), with all components of a slice for each particle. The CPDs of a
    transition draw in turn; each is given as many of its rows as its child has components. CPDs
    whose noise is not Gaussian cannot draw by it.
    """

    def __init__(self, white: States) -> None:
        super().__init__(())
        self._left = white

    def white(self, components: int, count: int, dtype: Any) -> States:
        """The next `components` rows of the noise, (components, m).

        `count` and `dtype`, which a random source takes, are ignored.
        """
        del count, dtype
        found, self._left = self._left[:components].copy(), self._left[components:]
        return found


def require_guidable(model: DynamicBayesianNetwork) -> None:
    """Refuse, by a ModelError, a network for which a lineariser gives no proposal.

    Its transition has to be Gaussian, without robust noise, and no CPD may have parameters that
    differ between runs.
    """
    require_gaussian(model.transition, "proposals of a lineariser")
    require_plain(model.transition)
    every: Sequence[CPD] = (*model.transition, *model.observation)
    for cpd in every:
        if isinstance(cpd, GaussianCPD) and cpd._lead():
            raise ModelError(
                f"{cpd!r} has axes of runs of its own, which proposal= does not take; leave it "
                "out, or give each run a model",
                variable=cpd.child,
                cpd=cpd,
            )


def _whitened(lower: Array, cov: Array) -> Array:
    """The covariances A⁻¹ P A⁻ᵀ of roots A, `lower`, and covariances P, `cov`, all (m, n, n).

    A component with a zero on the diagonal of A is a function of those before it; its row and
    column in the result are zero.
    """
    free = ~roots.determined(lower)
    half = solving.solve_lower(lower, cov) * free[..., None]
    found: Array = solving.solve_lower(lower, half.swapaxes(-1, -2)) * free[..., None]
    return 0.5 * (found + found.swapaxes(-1, -2))
