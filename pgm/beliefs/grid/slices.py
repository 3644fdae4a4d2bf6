"""The time slices of one run on a grid, in the form that `StateChain` works on.

A `StateChain` sends the forward and backward messages of a hidden Markov chain; it asks its slices
for the prior, for sums over the transition, and for the weights of measurements.

The joint states of a slice, the states of one step, are the cells of the lattice. A belief is an
array (*cells) of the probabilities of all cells. Computations are confined to a window, a span of
cells along each axis, outside of which a belief is negligible. Steps and runs are counted from 0.
"""

from __future__ import annotations

import math
from dataclasses import replace
from operator import itemgetter
from typing import Any, NamedTuple, NoReturn

import numpy as np

from pgm.beliefs.grid import resolution
from pgm.beliefs.grid.cut_off import TINY, Cut, Tails, bound, doubtful
from pgm.beliefs.grid.densities import EVEN, Uneven
from pgm.beliefs.grid.density_sensors import DensitySensor
from pgm.beliefs.grid.dependence import Dependence
from pgm.beliefs.grid.grouping import Kept, groups
from pgm.beliefs.grid.groups import Members
from pgm.beliefs.grid.lattice import Lattice, Window, spanned
from pgm.beliefs.grid.measured import MeasuredSensor, Shape, Sharpness
from pgm.beliefs.grid.motion import Motion
from pgm.beliefs.grid.prior import start
from pgm.beliefs.grid.sensors import GridSensor, Weights, likelihood
from pgm.cpds import ConditionalGaussian
from pgm.cpds.mixture import by_run
from pgm.errors import EvidenceError, ModelError, NumericalError
from pgm.evidence import BoundEvidence
from pgm.factors.scope import listed
from pgm.kernels.arrays import Array
from pgm.kernels.lattice import Span
from pgm.networks import DynamicBayesianNetwork
from pgm.schedules.argument_checks import require_density
from pgm.variables import Variable


class Narrowness(NamedTuple):
    """The marginal with the smallest standard deviation in cells, of one component at one step.

    cells: Its standard deviation in cells; infinite before the first belief.
    component: The label of its axis; empty before the first belief.
    step: The step of the belief.
    """

    cells: float
    component: str
    step: int


class Worst(NamedTuple):
    """Four figures of how well the cells serve the model, each the worst so far of steps and runs.

    They become attributes of the user's `GridFigures`.

    sharpest: The sensor that is sharpest for the cells.
    narrowest: The marginal of a belief that is narrowest for the cells.
    cut: The belief of which the largest share may have been cut off.
    uneven: The transition density whose sum over centres varies the most as the centres shift.
    """

    sharpest: Sharpness = Sharpness(0.0, None, 0)
    narrowest: Narrowness = Narrowness(math.inf, "", 0)
    cut: Cut = Cut(0.0, 0)
    uneven: Uneven = EVEN

    def of(self, other: Worst) -> Worst:
        """Of each of the four figures the worse one of this record and another, as a new record.

        For `narrowest` the smaller first field is worse, for the other three the larger; where the
        first fields are equal, this record's figure is taken.
        """
        first = itemgetter(0)
        return Worst(
            max(self.sharpest, other.sharpest, key=first),
            min(self.narrowest, other.narrowest, key=first),
            max(self.cut, other.cut, key=first),
            max(self.uneven, other.uneven, key=first),
        )


# Probabilities below this are none: products of them would be slow, denormal numbers.
_NONE = 1e-150


class Tested(NamedTuple):
    """Properties of a model's functions on a lattice, tested once and kept from call to call.

    A group is a set of states that move together, and is identified by its key, `Members.key`.

    motion: By a group's key, the axes on which its displacements depend.
    sensors: By sensor, a `Shape`: the axes on which its function depends, and whether the function
        is a sum of one of angles and one of the other axes.
    kept: By a group's key, the transition weights from every cell to every cell, of a group that is
        moved by densities which are the same at all steps.
    """

    motion: dict[tuple[object, ...], Dependence]
    sensors: dict[Variable, Shape]
    kept: Kept

    @classmethod
    def nothing(cls) -> Tested:
        """An empty record, of a model of which nothing has been tested yet."""
        return cls({}, {}, {})


class GridModel:
    """A model with its evidence on a lattice: the groups of its prior and motion, and its sensors.

    A group is a set of states that move together.

    tested: The record of earlier tests of the same model and lattice, to which new ones are added;
        None begins an empty one.
    first: As an argument, the step before the first one that `bound` has inputs of the transition
        for; as an attribute, the groups of the prior.
    motion: The transition, as groups that are moved one after another.
    sensors: The sensors that have measurements.

    A CPD without a density, or a parent that the grid does not cover, is refused by a ModelError.
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
    """The `Slices` of a `StateChain`, of one run on a grid; a belief is an array (*cells).

    Some of its arguments are:

    keep: The type, float64 or float32, in which the weights of measurements are kept for the
        backward sweep; None for a filter, which has no such sweep.
    tails, unresolved: What these attributes were for the belief that an online filter goes on from;
        None and 0 at the beginning.

    Its attributes are:

    lead: The shape of the user's axes of runs; (), since these are the slices of one run.
    outside: By step, the probability that left the bounds, or that the window of active cells has
        cut off.
    added: The variance that the lattice has added in all steps, in squared cells, (axes,).
    split: The indices of the axes that were moved cell by cell.
    worst: The sharpest sensor for the cells, the narrowest belief, the most cut off, and the most
        uneven density, of all steps so far.
    tails: What may be cut off from the belief at hand.
    unresolved: The expected square of the error of the log-evidence, in nats, that comes of taking
        sums over centres for integrals; see `resolution`.
    """

    lead: tuple[int, ...] = ()

    def __init__(
        self,
        model: GridModel,
        run: int,
        keep: Any = None,
        tails: Tails | None = None,
        unresolved: float = 0.0,
    ) -> None:
        self.model, self.run, self._keep = model, run, keep
        self.lattice, self.steps = model.lattice, model.bound.steps
        self.outside: dict[int, float] = {}
        self.added = np.zeros(len(self.lattice.axes))
        self.split: frozenset[int] = frozenset()
        self.worst = Worst()
        self.tails = Tails.begun(self.lattice.axes) if tails is None else tails
        self.unresolved = unresolved
        # By step, where something was measured: the log-density of zero residuals, and how many
        # numbers were measured.
        self._ceilings: dict[int, tuple[float, int]] = {}
        # By step: the windows before and after its motion, and the weights of its measurements.
        self.windows: dict[int, tuple[Window, Window]] = {}
        self._weights: dict[int, tuple[Array | None, float]] = {}
        # The belief that waits for the measurements of its step, in its window.
        self._awaiting: tuple[int, Window, Array] | None = None

    def prior(self) -> Array:
        """The prior's probabilities of the cells at step 0, (*cells).

        Their sum lacks the probability outside the bounds. A ModelError is raised if less than half
        of the prior is inside.
        """
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
        """Go on from a `predicted` belief (*cells), of which the share `left` has left the bounds.

        The window that holds this belief becomes that of the step, and the belief is held until the
        measurements of the step are taken in by `likelihood`.
        """
        each = marginals(predicted)
        window = active(self.lattice, each)[0]
        self.windows[step] = (window,) * 2
        self._awaiting = step, window, self.lattice.cut(predicted, window)
        self.tails = self.tails.at(each, left)

    def look(self, step: int, belief: Array) -> Window:
        """The smallest window that holds a step's belief (*cells) given its measurements.

        The belief's standard deviations, and the share of it that may have been cut off, are noted
        for the status.
        """
        each = marginals(belief)
        window, deviations = active(self.lattice, each)
        if step in self._ceilings:
            self.tails, missing = self.tails.measured(each)
            self._note(cut=Cut(missing, step))
        for axis, deviation in zip(self.lattice.axes, deviations, strict=True):
            self._note(narrowest=Narrowness(deviation, axis.label, step))
        return window

    def surprised(self, step: int, log_density: float) -> None:
        """Note for the status how much of a belief may be cut off, if its evidence is doubtful.

        The evidence is doubtful where the log-density of the step's measurements is more than 20
        below that of residuals of usual size. The share is bounded by means of the largest density
        that the measurements have at any cell.

        log_density: ln p(measurements of the step | those before).
        """
        if step in self._ceilings and doubtful(log_density, *self._ceilings[step]):
            best = likelihood(self.model.sensors, step, self.run, self.lattice.whole).log_scale
            self._note(cut=Cut(bound(log_density, best), step))

    def _note(self, **found: Any) -> None:
        """Replace figures in `worst` by those of `found` that are worse.

        The names in `found` are the fields of `Worst`.
        """
        self.worst = self.worst.of(Worst(**found))

    def forward(self, step: int, belief: Array) -> Array:
        """The predicted belief (*cells) at a step, from the belief, of sum one, at the step before.

        It is not normalised: the probability that has left the bounds is missing. A NumericalError
        is raised if all probability has left.
        """
        source = self.look(step - 1, belief)
        made = self.model.motion.at(step, self.run, source)
        part, added = made.forward(self.lattice.cut(belief, source))
        self.added += added
        self.split |= made.split
        self._note(uneven=made.uneven)
        part = np.where(part < _NONE, 0.0, part)  # it may be a view of the belief
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
        spans = zip(marginals(part), made.target, self.lattice.axes, strict=True)
        each = [spread(marginal, span, axis.cells) for marginal, span, axis in spans]
        self.tails = self.tails.predicted(each, self.outside[step])
        return self.lattice.put(part, made.target)

    def backward(self, step: int, message: Array) -> Array:
        """The sum Σ_x p(x | x') message(x) over the cells x of a step, (*cells), one for each x'.

        x' are the cells of the step before; `message` (*cells) is the product of the backward
        message to the step and of its measurements' weights. `forward` must have been called for
        this step already.
        """
        source, _ = self.windows[step]
        made = self.model.motion.at(step, self.run, source)
        part = made.backward(self.lattice.cut(message, made.target))
        return self.lattice.put(part, source)

    def likelihood(self, step: int) -> tuple[Array | None, float]:
        """The weights (*cells) of a step's measurements, and the logarithm s of their scale.

        The density of the measurements at a cell is its weight times e^s. Weights are 1 at the
        most, and zero outside of the belief's window; if nothing was measured, None stands for
        them. The belief of the step must already have been predicted by `forward`, or given to
        `begin`.
        """
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
        """Add to `unresolved` the expected square of the error of a step's log-evidence.

        It is added once for each step, when the forward sweep takes in the measurements. `found`
        are their weights in the window.
        """
        waiting, self._awaiting = self._awaiting, None
        if waiting is None or self.unresolved >= resolution.ENOUGH**2:
            return
        awaited, own, predicted = waiting
        if (awaited, own) == (step, window):
            given = self.model.sensors, predicted, found, window, step, self.run
            self.unresolved += resolution.error(*given)

    def refuse(self, step: int, belief: Array, run: int) -> NoReturn:
        """Raise an EvidenceError for measurements of probability zero under a predicted belief.

        The error names the run of this object; the arguments `belief` and `run` are not used, since
        only chains of several runs need them.
        """
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
        """The bounds of the axes that are no angles, as words for the text of an error."""
        return ", ".join(
            f"{axis.label} {axis.low:.6g} to {axis.low + axis.cells * axis.width:.6g}"
            for axis in self.lattice.axes
            if not axis.angle
        )


def marginals(belief: Array) -> list[Array]:
    """The marginals of a belief along each of its axes, a list of arrays (cells,)."""
    if belief.ndim == 1:
        return [belief]
    last = belief.sum(axis=tuple(range(belief.ndim - 1)))
    return [*marginals(belief.sum(axis=-1)), last]


def spread(marginal: Array, span: Span, cells: int) -> Array:
    """The marginal (cells,) of a whole axis: `marginal` (length,) in a span, zero elsewhere."""
    found = np.zeros(cells)
    found[np.arange(span.first, span.first + span.length) % cells] = marginal
    return found


def active(lattice: Lattice, each: list[Array]) -> tuple[Window, list[float]]:
    """The smallest window that holds a belief, but for a share of 10⁻¹⁵ along each axis.

    each: The belief's marginals (cells,) along the axes.

    Returned are the window, and a list of the belief's standard deviations along the axes, in
    cells; infinite where the window has all cells of a circle.
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
