r"""Proposals: particles drawn where the measurements of their step are, guided or over cells.

For guided ones the noise of the transition is white noise w under its root, x_t = f(x_{t−1}) + L w,
CPD by CPD. A lineariser makes of each particle a chain of one step, begun at the particle, whose
Gaussian belief given the measurements is one of w,

.. math:: q(w) = N(w;\, A^{-1}(μ^+ - μ^-),\, A^{-1} P^+ A^{-T}), \qquad P^- = A A^T,

μ⁻, P⁻ and μ⁺, P⁺ being the moments of the slice before and after its measurements. w is drawn from
it, goes through the transition as it is, and counts N(w; 0, I) / q(w): weights are exact, however
bad the linearisation, and a component without noise stays a function of the others.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from pgm.arguments import public
from pgm.boundary import as_floats, is_number
from pgm.compile import DynamicGraph
from pgm.cpds import CPD, ConditionalGaussian, GaussianCPD
from pgm.display import InCode
from pgm.errors import EvidenceError, LinearisationError, ModelError, NumericalError
from pgm.evidence import BoundEvidence, Reading
from pgm.factors.scope import listed
from pgm.immutable import Immutable
from pgm.inference.chain.moments import MomentChain
from pgm.inference.chain.plan import ChainPlan
from pgm.inference.chain.readings import Moments
from pgm.inference.options import require_gaussian, require_plain
from pgm.inference.particles.cloud import BLOCK
from pgm.inference.particles.laws import Drawing, Some, States
from pgm.inference.particles.model import ParticleModel, Sensor
from pgm.inference.schedule import Filtering
from pgm.kernels import roots
from pgm.kernels.arrays import TURN, Array, quiet
from pgm.kernels.resampling import indices, systematic
from pgm.kernels.tables import log_sum
from pgm.linearisers import Lineariser
from pgm.networks import DynamicBayesianNetwork
from pgm.variables import Variable

_ONCE = Filtering()
# The share of its largest variance by which rounding may leave a covariance indefinite.
_ROUNDING = 1e-6


class Guide:
    """The proposals of one model."""

    def __init__(self, graph: DynamicGraph, model: ParticleModel, lineariser: Lineariser) -> None:
        self.graph, self.model, self.lineariser = graph, model, lineariser

    def reads(self, step: int) -> bool:
        """Whether a step has measurements that can guide: those of Gaussian sensors."""
        return any(len(sensor.rows(step)) for sensor in self._sensors)

    @property
    def _sensors(self) -> list[Any]:
        sensors = self.model.sensors
        return [s for s in sensors if isinstance(s.reading.cpd, ConditionalGaussian)]

    def steered(self, row: int, some: Some, drawing: Drawing) -> tuple[Steered, Array]:
        """White noise for particles to be moved to a step, and ln N(w; 0, I) / q(w) of each."""
        before, after = self._moments(row, some)
        lower = roots.root(before.cov)
        free = ~roots.determined(lower)
        mean = roots.whiten(lower, after.mean - before.mean)
        cov = _whitened(lower, after.cov)
        # A direction that the measurements say nothing of is as it was.
        cov += ~free[..., None] * np.eye(cov.shape[-1])
        spread = roots.root(roots.semidefinite(cov, _ROUNDING))
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
        """The moments (m, n), (m, n, n) of each particle's slice before and after measurements."""
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
        """The chain of one step whose runs are particles."""

        def own(values: npt.NDArray[Any]) -> npt.NDArray[Any]:
            return values if values.shape[1] == 1 or some.owner is None else values[:, some.owner]

        def reading(found: Reading, rows: range) -> Reading:
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
    """White noise that was drawn beforehand, (components, m), given out CPD by CPD."""

    def __init__(self, white: States) -> None:
        super().__init__(())
        self._left = white

    def white(self, components: int, count: int, dtype: Any) -> States:
        """The next components."""
        del count, dtype
        found, self._left = self._left[:components].copy(), self._left[components:]
        return found


def require_guidable(model: DynamicBayesianNetwork) -> None:
    """Refuse a network whose transition no Gaussian proposal can be made of."""
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
    """A⁻¹ P A⁻ᵀ, zero in determined components."""
    free = ~roots.determined(lower)
    half = roots.solve_lower(lower, cov) * free[..., None]
    found: Array = roots.solve_lower(lower, half.swapaxes(-1, -2)) * free[..., None]
    return 0.5 * (found + found.swapaxes(-1, -2))


# Neighbours that overlap by a rounding error do not overlap.
_TOUCHING = 1.0 - 1e-6


@public
class CellProposal(InCode, Immutable):
    r"""Draws of a state from the likelihood of a step's measurements, over cells.

    .. math:: q(x) = \frac{p(z \mid c_k)^{τ}}{V \sum_j p(z \mid c_j)^{τ}}

    - c_k: the centre of the cell in which x lies, V the volume of a cell;
    - τ: `temper`, 1 for the likelihood, 0 for equal cells, between for cells that are so wide that
      the likelihood at their centres says too much of them.

    Measurements that take part are those of sensors that depend on this state, and on no other.
    Cells stand along the axes of the state, and cover wherever it may be: where none is, nothing is
    drawn, and as the start of a filter what the prior has there is missing. Of a map that is turned
    in the world, cells of its poses would overlap.

    Parameters
    ----------
    variable : Variable
        The state, d components.
    centres : array_like
        (k, d), in its units; ``map.poses(...)`` has those of a map.
    widths : array_like
        (d,): of all cells, which must not overlap.
    temper : float
        From 0 to 1.

    Raises
    ------
    ModelError
        If one of these is of a wrong kind or shape, or cells overlap.

    References
    ----------
    Lenser & Veloso, Sensor resetting localization for poorly modelled mobile robots, 2000; Thrun,
    Fox, Burgard & Dellaert, Robust Monte Carlo localization for mobile robots, 2001.

    Examples
    --------
    >>> pose = Variable("pose", components=("east", "north"))
    >>> CellProposal(pose, [[0.5, 0.5], [1.5, 0.5], [2.5, 0.5]], widths=[1, 1])
    CellProposal(pose, 3 cells of east 1, north 1)
    """

    variable: Variable
    centres: Array
    widths: Array
    temper: float

    def __init__(
        self, variable: Variable, centres: Any, widths: Any, *, temper: float = 1.0
    ) -> None:
        if not isinstance(variable, Variable):
            raise ModelError(f"a CellProposal is of a Variable, not {variable!r}")
        what = f"CellProposal of {variable!r}"
        points = np.array(as_floats(centres, f"{what}: centres", variable=variable))
        sizes = np.array(as_floats(widths, f"{what}: widths", variable=variable))
        if points.ndim != 2 or not len(points) or points.shape[1] != variable.dimension:
            raise ModelError(
                f"{what}: centres are one or more rows of {variable.dimension} components, (k, "
                f"{variable.dimension}), not of shape {points.shape}",
                variable=variable,
            )
        if sizes.shape != (variable.dimension,) or not ((sizes > 0) & np.isfinite(sizes)).all():
            raise ModelError(
                f"{what}: widths are a positive number for each of the {variable.dimension} "
                f"components, not {widths!r}",
                variable=variable,
            )
        if not np.isfinite(points).all():
            raise ModelError(f"{what}: a centre is NaN or infinite", variable=variable)
        if not is_number(temper) or not 0.0 <= temper <= 1.0:
            raise ModelError(f"{what}: temper is a number from 0 to 1, not {temper!r}")
        _require_apart(what, points / sizes, np.where(variable.angle_mask, TURN / sizes, 0.0))
        for array in (points, sizes):
            array.flags.writeable = False
        self._set(variable=variable, centres=points, widths=sizes, temper=float(temper))

    @property
    def _log_volume(self) -> float:
        return float(np.log(self.widths).sum())

    def sensors(self, model: ParticleModel, step: int) -> list[Sensor]:
        """The sensors with measurements at a step that depend on this state alone."""
        found = []
        for sensor in model.sensors:
            hidden = [v for v in sensor.law.cpd.parents if v in model.places]
            if hidden == [self.variable] and len(sensor.rows(step)):
                found.append(sensor)
        return found

    def drawn(
        self, model: ParticleModel, step: int, run: int, count: int, rng: np.random.Generator
    ) -> tuple[States, Array]:
        """Draws (d, count) for a run from the measurements of a step, and their log-densities.

        Places are drawn systematically; they come in the order of the cells.
        """
        levels = np.zeros(len(self.centres))
        if self.temper > 0.0:
            levels = self.temper * self._log_likelihood(model, step, run)
        total = log_sum(levels, 0)
        if not np.isfinite(total):
            raise EvidenceError(
                f"{self!r}: the measurements of step {step}, run {run + model.bound.first_run}, "
                "are impossible at every centre; take more cells, or a sensor that allows for "
                "outliers",
                variable=self.variable,
                step=step,
                run=run + model.bound.first_run,
            )
        chosen = indices(systematic(np.exp(levels - total), count, rng))
        within = rng.random((count, self.variable.dimension)) - 0.5
        points = self.centres[chosen] + within * self.widths
        return points.T.astype(model.dtype), levels[chosen] - total - self._log_volume

    def _log_likelihood(self, model: ParticleModel, step: int, run: int) -> Array:
        from pgm.inference.particles.laws import Some

        sensors = self.sensors(model, step)
        if not sensors:
            raise EvidenceError(
                f"{self!r}: step {step} has no measurements of a sensor that depends on "
                f"{self.variable!r} alone; those read are of {listed(model.read(step)) or 'none'}",
                variable=self.variable,
                step=step,
            )
        found = np.zeros(len(self.centres))
        for first in range(0, len(found), BLOCK):
            points = self.centres[first : first + BLOCK]
            now = np.zeros((model.size, len(points)), dtype=model.dtype)
            now[model.places[self.variable]] = points.T
            owner = np.full(len(points), run) if model.bound.runs > 1 else None
            some = Some(step, now, now, owner)
            for sensor in sensors:
                for row in sensor.rows(step):
                    sensor.add(row, some, found[first : first + BLOCK])
        return found

    def require(self, model: DynamicBayesianNetwork) -> None:
        """Refuse a network of which this is no state."""
        if self.variable not in model.states:
            raise ModelError(
                f"{self!r}: {self.variable!r} is no state of the network; those are "
                f"{listed(model.states)}",
                variable=self.variable,
            )

    def __repr__(self) -> str:
        pairs = zip(self.variable.components, self.widths, strict=True)
        each = ", ".join(f"{name} {width:.3g}" for name, width in pairs)
        temper = "" if self.temper == 1.0 else f", temper {self.temper:g}"
        count = f"{len(self.centres):,} cell" + "s" * (len(self.centres) > 1)
        return f"CellProposal({self.variable!r}, {count} of {each}{temper})"


def _require_apart(what: str, places: Array, around: Array) -> None:
    from scipy.spatial import KDTree  # here, since it is slow to import

    if len(places) < 2:
        return
    turning = around > 0.0
    if (around[turning] < _TOUCHING).any():
        raise ModelError(f"{what}: the width of an angle is more than a turn")
    places = np.where(turning, np.mod(places, np.where(turning, around, 1.0)), places)
    # Rounding may leave the remainder at the length itself, which a circle has no place for.
    places = np.where(turning & (places >= around), 0.0, places)
    away, which = KDTree(places, boxsize=around).query(places, k=[2], p=np.inf)
    nearest, others = np.ravel(away), np.ravel(which)
    if nearest.min() < _TOUCHING:
        first = int(nearest.argmin())
        raise ModelError(
            f"{what}: cells {first} and {int(others[first])} overlap: their centres are "
            f"{nearest[first]:.3g} widths apart; take narrower cells, or fewer"
        )
