r"""Guided proposals: particles drawn where the measurements of their step are.

The transition of a particle is a function of white noise w, drawn from N(0, I): x_t = f(x_{t−1}) +
L w, CPD by CPD, L being the root of the CPD's noise covariance. For each particle, a lineariser
makes Gaussian beliefs of its next slice x_t, before and after the measurements of step t. As
x_t ≈ μ⁻ + A w, the belief after them is a Gaussian belief of w, too:

.. math:: q(w) = N(w;\, A^{-1}(μ^+ - μ^-),\, A^{-1} P^+ A^{-T}), \qquad P^- = A A^T,

μ⁻, P⁻ and μ⁺, P⁺ being the mean and covariance of the slice before and after its measurements, and
A, like L, lower triangular. A proposal draws w from q, passes it through the transition as it
is, and multiplies the particle's weight by N(w; 0, I) / q(w). Weights are exact, however bad the
linearisation, and a component without noise stays a function of the others. m is the number of
particles, n that of the slice's components. The *inputs* of the transition are the values of its
observed parents, with a row for each step.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from pgm.compile import DynamicGraph
from pgm.cpds import CPD, ConditionalGaussian, GaussianCPD
from pgm.errors import LinearisationError, ModelError, NumericalError
from pgm.evidence import BoundEvidence, Reading
from pgm.inference.argument_checks import require_gaussian, require_plain
from pgm.inference.chain.moments import MomentChain
from pgm.inference.chain.plan import ChainPlan
from pgm.inference.chain.readings import Moments
from pgm.inference.particles.laws import Drawing, Some, States
from pgm.inference.particles.model import ParticleModel
from pgm.inference.schedule import Filtering
from pgm.kernels import roots, semidefinite, solving
from pgm.kernels.arrays import Array, quiet
from pgm.linearisers import Lineariser
from pgm.networks import DynamicBayesianNetwork

_ONCE = Filtering()
# The share of its largest variance by which rounding may leave a covariance indefinite.
_ROUNDING = 1e-6


class Guide:
    """The guided proposals of a model: for each particle a Gaussian near p(x_t | x_{t−1}, z_t)."""

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
        drawing: The particles' generators.

        Returns a `Drawing` that gives out w where `drawing` would give out random noise, and
        ln N(w; 0, I) / q(w) of each particle, (m,). A NumericalError is raised if q is not finite,
        or singular: weights would be infinite.
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

        Means are (m, n), covariances (m, n, n). The text of a LinearisationError or NumericalError
        tells the proposal and the step.

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
        """The plan of a chain that has the step alone, and each particle as a run of its own.

        A filter of this plan gives the lineariser's belief of each particle's slice.

        row: The row of the step's inputs.
        some: The particles, at the step.
        """

        def own(values: npt.NDArray[Any]) -> npt.NDArray[Any]:
            """Values (rows, runs or 1, d) of the runs as values (rows, m or 1, d) of particles."""
            return values if values.shape[1] == 1 or some.owner is None else values[:, some.owner]

        def reading(found: Reading, rows: range) -> Reading:
            """A sensor's measurements at the step, as those of step 1 of the chain.

            found: All measurements of the sensor, one in each row.
            rows: The rows that are of the step.

            A particle has the measurements of its run.
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
    """A source of fixed white noise, (components, m), in place of random generators.

    Each CPD that draws is given the next components of it. CPDs whose noise is not Gaussian cannot
    draw by it.
    """

    def __init__(self, white: States) -> None:
        super().__init__(())
        self._left = white

    def white(self, components: int, count: int, dtype: Any) -> States:
        """The next components of the noise, (components, m), whatever `count` and `dtype` are."""
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
