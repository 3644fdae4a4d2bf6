"""The slices of one run on a grid, as the chain of finitely many states asks for them.

A belief is carried up to a share of 10⁻¹⁵ along each axis, and kernels up to 8.5 deviations. What
is beyond is lost, and no evidence brings it back, however much likelier it is there: `Cut` tells
how much of a belief that may have come to be.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from operator import itemgetter
from typing import Any, NamedTuple, NoReturn

import numpy as np

from pgm.cpds import ConditionalGaussian
from pgm.cpds.mixture import by_run
from pgm.errors import EvidenceError, ModelError, NumericalError
from pgm.evidence import BoundEvidence
from pgm.factors.scope import listed
from pgm.inference.argument_checks import require_density
from pgm.inference.grid import resolution
from pgm.inference.grid.densities import Uneven
from pgm.inference.grid.dependence import Dependence
from pgm.inference.grid.grouping import Kept, groups
from pgm.inference.grid.groups import Members
from pgm.inference.grid.lattice import Lattice, Window, spanned
from pgm.inference.grid.measured import MeasuredSensor, Shape, Sharpness
from pgm.inference.grid.motion import Motion
from pgm.inference.grid.sensors import DensitySensor, GridSensor, Weights, likelihood
from pgm.inference.grid.wide_prior import EVEN
from pgm.kernels.arrays import Array
from pgm.kernels.lattice import Span
from pgm.networks import DynamicBayesianNetwork
from pgm.variables import Variable

# The share of a belief, along an axis, that may stand outside the window of active cells.
TINY = 1e-15
# An edge with more than this was not cut: the belief ends there.
_TAIL = 1e-13
# So much likelier the last cells at a bound have to become to speak for what is beyond.
_REMARKABLE = 30.0
# Evidence that is less likely than its best by this is compared with that of all cells.
_DOUBT = 20.0


class Cut(NamedTuple):
    """The belief of which the most may have been cut off."""

    share: float
    step: int


class Narrowness(NamedTuple):
    """The narrowest belief along an axis.

    cells: Its standard deviation in cells.
    component: Empty if no belief has been looked at.
    """

    cells: float
    component: str
    step: int


class Worst(NamedTuple):
    """The sensor, beliefs and density that the cells serve the least; see `GridStatus`."""

    sharpest: Sharpness = Sharpness(0.0, None, 0)
    narrowest: Narrowness = Narrowness(math.inf, "", 0)
    cut: Cut = Cut(0.0, 0)
    uneven: Uneven = EVEN

    def of(self, other: Worst) -> Worst:
        """The worse of each, by its first figure; of equals its own."""
        first = itemgetter(0)
        return Worst(
            max(self.sharpest, other.sharpest, key=first),
            min(self.narrowest, other.narrowest, key=first),
            max(self.cut, other.cut, key=first),
            max(self.uneven, other.uneven, key=first),
        )


class Tails:
    """The share of a belief beyond either end of each axis' cells in use, as evidence goes on.

    The cut part is taken to become as much likelier as the last cells within. If the model is true
    these gains are a martingale: a share of ε becomes one of 10⁻³ with a probability of 10³ε at the
    most (Ville's inequality). So is what left the bounds at a step, where its measurements make the
    last cells much likelier.
    """

    def __init__(self, lattice: Lattice) -> None:
        self.lattice = lattice
        ends = len(lattice.axes), 2
        self._share = np.full(ends, TINY)
        self._cells = np.zeros(ends, dtype=np.intp)
        self._open = np.zeros(ends, dtype=bool)
        self._left = np.zeros(ends)
        self._before = self._taken = np.ones(ends)

    def predicted(self, marginals: list[Array], left: float) -> None:
        """Look at a predicted belief, by its marginals along the axes of the lattice.

        `left` is the share of it that is beyond the bounds.
        """
        for k, (axis, marginal) in enumerate(zip(self.lattice.axes, marginals, strict=True)):
            (used,) = np.nonzero(marginal > TINY / axis.cells * marginal.sum())
            gap = 0
            if axis.angle and used.size:  # the cells in use begin after the widest gap
                gap = (int(np.diff(used, append=used[0] + axis.cells).argmax()) + 1) % used.size
            if used.size:
                self._cells[k] = used[gap], used[gap - 1]
            if axis.angle:
                self._open[k] = 0 < used.size < axis.cells
            else:
                self._open[k] = self._cells[k, 0] > 0, self._cells[k, 1] + 1 < axis.cells
            self._left[k] = 0.0 if axis.angle else np.where(self._open[k], 0.0, left)
        self._before = self._at(marginals)
        # Motion leads away from an end that was not cut, as a wall is.
        fallen = np.minimum(self._before / np.maximum(self._taken, 1e-300), 1.0)
        kept = np.where(self._before > _TAIL, self._share * fallen, self._share)
        self._share = np.maximum(kept, TINY)

    def taken(self, marginals: list[Array]) -> float:
        """Look at the same belief given measurements: the largest share that was cut."""
        self._taken = self._at(marginals)
        gain = self._taken / np.maximum(self._before, 1e-300)
        self._share = np.minimum(self._share * gain, 1.0)
        beyond = np.where(gain > _REMARKABLE, np.minimum(self._left * gain, 1.0), 0.0)
        return max(float(self._share.max(initial=0.0, where=self._open)), float(beyond.max()))

    def _at(self, marginals: list[Array]) -> Array:
        return np.array(
            [
                each[cells] / max(float(each.sum()), 1e-300)
                for each, cells in zip(marginals, self._cells, strict=True)
            ]
        )


def doubtful(log_density: float, ceiling: float, components: int) -> bool:
    """Whether evidence is so unlikely that the part cut off might explain it better.

    log_density: ln p(measurements of a step | those before).
    ceiling: The logarithm of the density of residuals that are all zero.
    components: How many numbers were measured; true residuals have half their number as exponent.
    """
    usual = max(0.5 * components - math.sqrt(2.0 * components), 0.0)
    return log_density < ceiling - usual - _DOUBT


def bound(log_density: float, best: float) -> float:
    """The share of a belief that cells without a part in it may have, of the best log-density."""
    return math.exp(min(math.log(TINY) + best - log_density, 0.0))


# Probabilities below this are none: products of them would be slow, denormal numbers.
_NONE = 1e-150


class Tested(NamedTuple):
    """The shapes of a model's functions, as far as they have been tested on a lattice.

    With the weights of densities between its cells, where these are the same at all steps.
    """

    motion: dict[tuple[object, ...], Dependence]
    sensors: dict[Variable, Shape]
    kept: Kept

    @classmethod
    def nothing(cls) -> Tested:
        """Nothing yet."""
        return cls({}, {}, {})


class GridModel:
    """A model with its evidence on a lattice.

    tested: Of the same model and lattice, to go on from; it is added to.
    first: The step before the first of the evidence for the transition.
    """

    def __init__(
        self,
        lattice: Lattice,
        model: DynamicBayesianNetwork,
        bound: BoundEvidence,
        tested: Tested | None = None,
        first: int = 0,
    ) -> None:
        read = (reading.cpd for reading in bound.readings)
        require_density((*model.prior, *model.transition, *read), "grids")
        tested = tested or Tested.nothing()
        self.lattice, self.model, self.bound = lattice, model, bound
        prior, transition = (
            [by_run(cpd, bound.lead) for cpd in cpds] for cpds in (model.prior, model.transition)
        )
        self.first = groups(lattice, prior, [{}] * len(prior), tested.kept, prior=True)
        moved: list[Members] = []
        if bound.transition:
            known = bound.transition
            moved = groups(lattice, transition, known, tested.kept, prior=False, first=first)
        self.motion = Motion(lattice, moved, tested.motion, tested.kept)
        self.sensors = list[MeasuredSensor]()
        for reading in bound.readings:
            blank = Shape(Dependence(lattice))
            shape = tested.sensors.setdefault(reading.cpd.child, blank)
            cpd = by_run(reading.cpd, bound.lead)
            gaussian = isinstance(cpd, ConditionalGaussian) and cpd.noise is None
            kind = GridSensor if gaussian else DensitySensor
            self.sensors.append(kind(lattice, replace(reading, cpd=cpd), shape))
        for sensor in self.sensors:
            sensor.require_covered()


class GridSlices:
    """One run's slices: beliefs are (*cells), the chain having no axes of runs.

    keep: In which weights are kept for the way back; None where there is none.

    outside: By step, the probability that left the bounds, or that the window of active cells has
        cut off.
    added: (axes,): the variance that the lattice has added in all steps, in cells.
    worst: The sensor, beliefs and density that the cells have served the least so far.
    unresolved: The expected square of the error of the log-evidence, since centres stand where they
        do; see `resolution`.
    """

    lead: tuple[int, ...] = ()

    def __init__(self, model: GridModel, run: int, keep: Any = None) -> None:
        self.model, self.run, self._keep = model, run, keep
        self.lattice, self.steps = model.lattice, model.bound.steps
        self.outside: dict[int, float] = {}
        self.added = np.zeros(len(self.lattice.axes))
        self.split: frozenset[int] = frozenset()
        self.worst, self._tails = Worst(), Tails(self.lattice)
        self.unresolved = 0.0
        # By step, where something was measured: the density of no residuals, and how many numbers.
        self._ceilings: dict[int, tuple[float, int]] = {}
        # By step: the windows before and after its motion, and the weights of its measurements.
        self.windows: dict[int, tuple[Window, Window]] = {}
        self._weights: dict[int, tuple[Array | None, float]] = {}
        # The belief that waits for the measurements of its step, in its window.
        self._awaiting: tuple[int, Window, Array] | None = None

    def prior(self) -> Array:
        """See `Slices`."""
        found, added, uneven = start(self.lattice, self.model.first, self.run)
        self.added += added
        self._note(uneven=uneven)
        total = float(found.sum())
        self.outside[0] = max(1.0 - total, 0.0)
        if not total >= 0.5:
            raise ModelError(
                f"run {self.run}: the prior has {total:.2g} of its probability inside the grid, "
                f"{self._bounds()}; widen the bounds, or move them to where the states begin"
            )
        self.begin(0, found, self.outside[0])
        return found

    def begin(self, step: int, predicted: Array, left: float) -> None:
        """Go on from the predicted belief of a step, of which a share has left the bounds."""
        each = marginals(predicted)
        window = active(self.lattice, each)[0]
        self.windows[step] = (window,) * 2
        self._awaiting = step, window, self.lattice.cut(predicted, window)
        self._tails.predicted(each, left)

    def look(self, step: int, belief: Array) -> Window:
        """The window of a step's belief, whose deviations are looked at."""
        each = marginals(belief)
        window, deviations = active(self.lattice, each)
        if step in self._ceilings:
            self._note(cut=Cut(self._tails.taken(each), step))
        for axis, deviation in zip(self.lattice.axes, deviations, strict=True):
            self._note(narrowest=Narrowness(deviation, axis.label, step))
        return window

    def surprised(self, step: int, log_density: float) -> None:
        """Compare a step's evidence with what it is at the best of all cells, if it is doubtful."""
        if step in self._ceilings and doubtful(log_density, *self._ceilings[step]):
            best = likelihood(self.model.sensors, step, self.run, self.lattice.whole).log_scale
            self._note(cut=Cut(bound(log_density, best), step))

    def _note(self, **found: Any) -> None:
        self.worst = self.worst.of(Worst(**found))

    def forward(self, step: int, belief: Array) -> Array:
        """See `Slices`."""
        source = self.look(step - 1, belief)
        made = self.model.motion.at(step, self.run, source)
        part, added = made.forward(self.lattice.cut(belief, source))
        self.added += added
        self.split |= made.split
        self._note(uneven=made.uneven)
        part[part < _NONE] = 0.0
        left = float(part.sum())
        self.outside[step] = max(1.0 - left, 0.0)
        if not left > 0.0:
            raise NumericalError(
                f"all probability has left the grid at step {step}, run {self.run}: it covers "
                f"{self._bounds()}; widen its bounds",
                step=step,
                run=self.run,
            )
        self.windows[step] = source, made.target
        self._awaiting = step, made.target, part
        self._tails.predicted(
            [
                spread(each, span, axis.cells)
                for each, span, axis in zip(
                    marginals(part), made.target, self.lattice.axes, strict=True
                )
            ],
            self.outside[step],
        )
        return self.lattice.put(part, made.target)

    def backward(self, step: int, message: Array) -> Array:
        """See `Slices`."""
        source, _ = self.windows[step]
        made = self.model.motion.at(step, self.run, source)
        part = made.backward(self.lattice.cut(message, made.target))
        return self.lattice.put(part, source)

    def likelihood(self, step: int) -> tuple[Array | None, float]:
        """The weights of a step's measurements in the window of its belief, and their log-scale."""
        target = self.windows[step][1]
        if step in self._weights:
            weights, scale = self._weights[step]
        else:
            found = likelihood(self.model.sensors, step, self.run, target)
            weights, scale = found.values, found.log_scale
            if weights is not None:
                self._ceilings[step] = found.ceiling, found.components
            self._note(sharpest=found.sharpest)
            self._resolve(step, found, target)
            if self._keep is not None:
                kept: Array | None = None
                if weights is not None:
                    kept = weights.astype(self._keep, copy=False)
                self._weights[step] = kept, scale
        return None if weights is None else self.lattice.put(weights, target), scale

    def _resolve(self, step: int, found: Weights, window: Window) -> None:
        """Add the error of a step's evidence, once, on the way there."""
        waiting, self._awaiting = self._awaiting, None
        if waiting is None or self.unresolved >= resolution.ENOUGH**2:
            return
        awaited, own, predicted = waiting
        if (awaited, own) == (step, window):
            given = self.model.sensors, predicted, found, window, step, self.run
            self.unresolved += resolution.error(*given)

    def refuse(self, step: int, belief: Array, run: int) -> NoReturn:
        """See `Slices`."""
        read = [s.reading.cpd.child for s in self.model.sensors if len(s.rows(step))]
        raise EvidenceError(
            f"the measurements of {listed(read)} at step {step}, run {self.run}, are impossible: "
            "no cell that the belief has left explains them in float64; look for a mistaken "
            "measurement, a noise that is too small, or a state that has left the grid",
            variable=read[0] if read else None,
            step=step,
            run=self.run,
        )

    def _bounds(self) -> str:
        return ", ".join(
            f"{axis.label} {axis.low:.6g} to {axis.low + axis.cells * axis.width:.6g}"
            for axis in self.lattice.axes
            if not axis.angle
        )


def marginals(belief: Array) -> list[Array]:
    """The marginals (cells,) of a belief along each of its axes."""
    if belief.ndim == 1:
        return [belief]
    last = belief.sum(axis=tuple(range(belief.ndim - 1)))
    return [*marginals(belief.sum(axis=-1)), last]


def spread(marginal: Array, span: Span, cells: int) -> Array:
    """A marginal over the cells of a span as one over all cells of the axis."""
    found = np.zeros(cells)
    found[np.arange(span.first, span.first + span.length) % cells] = marginal
    return found


def active(lattice: Lattice, each: list[Array]) -> tuple[Window, list[float]]:
    """The smallest window that holds a belief, up to a share of 10⁻¹⁵ along each axis.

    With it the standard deviation along each axis, in cells, where that is not all of a circle.
    The belief is given by its marginals.
    """
    window, deviations = [], []
    for axis, marginal in zip(lattice.axes, each, strict=True):
        total = marginal.sum()
        span = spanned(marginal > TINY / axis.cells * total, axis.angle)
        window.append(span)
        inside = np.take(marginal, np.arange(span.first, span.first + span.length), mode="wrap")
        place = np.arange(span.length) - 0.5 * span.length
        mean = inside @ place / total
        variance = float(inside @ (place - mean) ** 2 / total)
        round_ = axis.angle and span.length == axis.cells
        deviations.append(np.inf if round_ else math.sqrt(max(variance, 0.0)))
    return tuple(window), deviations


def start(lattice: Lattice, groups: Sequence[Members], run: int) -> tuple[Array, Array, Uneven]:
    """The probabilities at step 0; what the bounds leave out is missing from their sum.

    With them the variance that the lattice has added along each axis, in cells, and the density
    whose sums over centres are the least those of it.
    """
    nowhere = (Span(0, 1),) * len(lattice.axes)
    made = Motion(lattice, list(groups)).at(0, run, nowhere)
    found, added = made.forward(np.ones((1,) * len(lattice.axes)))
    return lattice.put(found, made.target), added, made.uneven
