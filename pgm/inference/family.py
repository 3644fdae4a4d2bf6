"""One CPD at all its rows: its evidence, its noise, and what the lineariser made of it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from pgm.cpds import AffineCPD, ConditionalGaussian, Noise, NonlinearGaussianCPD
from pgm.cpds.noise import evaluate
from pgm.errors import LinearisationError, ModelError, PgmError
from pgm.factors.scope import Scope, dimension, names
from pgm.kernels.angles import nearest_branch
from pgm.kernels.arrays import (
    Array,
    Integers,
    Mask,
    apply,
    block_diagonal,
    components_first,
    components_last,
    cut,
    quiet,
    times,
    vacant,
)
from pgm.kernels.scan import by_rows
from pgm.linearisers import (
    ArrayLineariser,
    BoundFunction,
    FunctionTemplate,
    Line,
    Lineariser,
    Taylor,
)
from pgm.linearisers.function import Source
from pgm.linearisers.lineariser import Misfit, Prepared, Wrapped, needs_cov, prepare
from pgm.variables import Variable

Rows = int | slice


class At(NamedTuple):
    """A CPD at one step, its evidence bound: components first, and a batch of one run or of many.

    Attributes
    ----------
    function : BoundFunction or None
        To be linearised; None where it is affine, or as it was linearised before.
    matrix, offset : ndarray or None
        F (d, n, *batch) and b (d, *batch) then; one for all runs may have a batch of one.
    noise : ndarray
        (d, d, *batch): the CPD's own covariance, with that of the error where it was linearised.
    first, last : int
        Its rows.
    """

    function: BoundFunction | None
    matrix: Array | None
    offset: Array | None
    noise: Array
    first: int
    last: int


@dataclass(eq=False)
class Family:
    """A CPD at its rows, steps for a transition, sightings for a sensor; the engine's own.

    Attributes
    ----------
    cpd : CPD
    hidden : tuple of Variable
        The parents without evidence, stacked.
    step : ndarray of int
        (rows,): the step of each row; zeros where there is no time.
    timed : bool
        Whether there is time.
    inputs : mapping of Variable to ndarray
        Values of the parents with evidence, (rows, runs or 1, d).
    lineariser : Lineariser
        The CPD's own, or the one given to `infer`.
    template : FunctionTemplate or None
        None where the CPD is affine, so that there is nothing to linearise.
    noise : ndarray
        (rows, runs, d, d): the CPD's own and the lineariser's error.
    first_run : int
        What the first run is called in messages.
    batch : tuple of int
        The axes of runs in `at` and `line`: none of one run.
    affine : (ndarray, ndarray)
        F (d, n) and b (rows or 1, runs or 1, d) of an affine CPD.
    """

    cpd: ConditionalGaussian
    hidden: Scope
    step: Integers
    inputs: Mapping[Variable, Array]
    lineariser: Lineariser
    template: FunctionTemplate | None
    noise: Array
    own_noise: Array
    timed: bool = True
    approximate: bool = False
    first_run: int = 0
    batch: tuple[int, ...] = ()
    affine: tuple[Array, Array] = field(init=False, repr=False)

    @classmethod
    def make(
        cls,
        cpd: ConditionalGaussian,
        hidden: Scope,
        step: Integers,
        inputs: Mapping[Variable, Array],
        lineariser: Lineariser,
        lead: tuple[int, ...],
        *,
        timed: bool = True,
        template: FunctionTemplate | None = None,
        first_run: int = 0,
    ) -> Family:
        """Lay out a CPD; an affine one is ready for use. A template at hand need not be made."""
        rows, runs = step.size, math.prod(lead)
        height, width = cpd.child.dimension, dimension(hidden)
        own_noise = _own_noise(cpd, step if timed else None, rows, inputs, lead, first_run)
        noise = np.broadcast_to(own_noise, (rows, runs, height, height))
        if isinstance(cpd, NonlinearGaussianCPD):
            template = template or cpd._template(hidden)
            lineariser = cpd.lineariser or lineariser
        elif not isinstance(cpd, AffineCPD):
            raise ModelError(f"{cpd!r} is of no kind that inference knows", cpd=cpd)
        known = (cpd, hidden, step, inputs, lineariser, template, noise, own_noise, timed)
        made = cls(*known, first_run=first_run, batch=() if runs == 1 else (runs,))
        if isinstance(cpd, AffineCPD):
            constant, shift = cpd._affine(hidden, inputs)
            if not cpd.given and shift.ndim > 1:
                shift = np.broadcast_to(shift, (*lead, height)).reshape(1, runs, height)
            made.affine = constant, shift if shift.ndim == 3 else shift[None, None]
            made.matrix = np.broadcast_to(constant, (rows, runs, height, width))
            made.offset = np.broadcast_to(shift, (rows, runs, height))
        return made

    @property
    def shape(self) -> tuple[int, ...]:
        """The shape of `matrix`: rows, runs, d, n."""
        return (*self.noise.shape[:3], dimension(self.hidden))

    @cached_property
    def matrix(self) -> Array:
        """F, (rows, runs, d, n); not initialised, where it is to be linearised."""
        return vacant(self.shape[:2], self.shape[2:])

    @cached_property
    def offset(self) -> Array:
        """The offset b, (rows, runs, d); not initialised, where F is not."""
        return vacant(self.shape[:2], self.shape[2:3])

    def of(self, runs: slice) -> Family:
        """Some of the runs, with views of these arrays; what is linearised is its own."""
        count = runs.stop - runs.start
        part = replace(
            self,
            inputs={parent: cut(values, runs) for parent, values in self.inputs.items()},
            noise=cut(self.noise, runs),
            own_noise=cut(self.own_noise, runs),
            first_run=self.first_run + runs.start,
            batch=() if count == 1 else (count,),
        )
        if self.exact:
            part.matrix, part.offset = cut(self.matrix, runs), cut(self.offset, runs)
            part.affine = self.affine[0], cut(self.affine[1], runs)
        return part

    def window(self, first: int, last: int) -> Family:
        """Some of the rows, with views of these arrays; what is linearised is its own."""
        rows, part = slice(first, last), copy(self)
        for name in ("_known", "_steps"):
            part.__dict__.pop(name, None)
        part.step = self.step[rows]
        part.inputs = {parent: values[rows] for parent, values in self.inputs.items()}
        part.matrix, part.offset = self.matrix[rows], self.offset[rows]
        part.noise = self.noise[rows]
        if len(self.own_noise) > 1:
            part.own_noise = self.own_noise[rows]
        if self.exact:
            matrix, shift = self.affine
            part.affine = matrix, shift[rows] if len(shift) > 1 else shift
        else:
            part.matrix, part.offset = part.matrix.copy("K"), part.offset.copy("K")
            part.noise = part.noise.copy("K") if self.approximate else part.noise
        return part

    def put(self, first: int, part: Family) -> None:
        """Keep what some of the rows, from the first of them on, were linearised to."""
        if self.exact:
            return
        rows = slice(first, first + part.step.size)
        self.matrix[rows], self.offset[rows] = part.matrix, part.offset
        if part.approximate:
            self.keep_errors()
        if self.approximate:
            self.noise[rows] = part.noise

    @property
    def exact(self) -> bool:
        """Whether the CPD is affine, so that no linearisation is needed."""
        return self.template is None

    @property
    def taylor(self) -> bool:
        """Whether the CPD is affine or expanded to first order at a point."""
        return self.exact or isinstance(self.lineariser, Taylor)

    @cached_property
    def semidefinite(self) -> bool:
        """Whether the approximation error cannot be indefinite."""
        if self.taylor or not self.hidden:
            return True
        rule = self.lineariser
        return isinstance(rule, ArrayLineariser) and rule.is_semidefinite(dimension(self.hidden))

    @property
    def needs_cov(self) -> bool:
        """Whether a linearisation depends on the covariance of the belief."""
        return self.template is not None and needs_cov(self.lineariser, self.template)

    @cached_property
    def noisy(self) -> bool:
        """Whether the noise depends on observed parents."""
        return isinstance(self.cpd.cov, Noise)

    @cached_property
    def grouped(self) -> bool:
        """Whether the sightings of a step are linearised as one vector."""
        return isinstance(self.cpd, NonlinearGaussianCPD) and self.cpd.grouped

    @cached_property
    def bare(self) -> tuple[int, ...]:
        """The components that the CPD's own noise leaves out at some row."""
        variances = np.diagonal(self.own_noise, axis1=-2, axis2=-1)
        return tuple(int(k) for k in np.flatnonzero((variances == 0.0).any(axis=(0, 1))))

    @cached_property
    def source(self) -> Source:
        """Whose function it is, for messages."""
        return Source(self.cpd, self.timed, self.first_run)

    @cached_property
    def prepared(self) -> Prepared:
        """The lineariser, ready for the CPD's function."""
        assert self.template is not None
        return prepare(self.lineariser, self.template) if self.hidden else _value

    # --- one step after another ---------------------------------------------------------------

    def at(self, first: int, last: int) -> At:
        """Some rows, a step's, to be linearised as one."""
        if self.template is None:
            return self._affine_at(first, last)
        count = last - first
        rows: Any = first if count == 1 else slice(first, last)
        inputs = [None if values is None else values[rows] for values in self._known]
        if count > 1 and self.batch:
            inputs = [None if values is None else values.swapaxes(0, 1) for values in inputs]
        function = BoundFunction(
            self.template,
            inputs,
            len(self.batch),
            self._steps[first],
            None if count == 1 else count,
            self.grouped,
            self.source,
        )
        return At(function, None, None, self._own(first, last), first, last)

    def stored_at(self, first: int, last: int) -> At:
        """Some rows as they were linearised."""
        if self.template is None:
            return self._affine_at(first, last)
        height, width = self.shape[2:]
        size = (last - first) * height
        matrix, offset = self.matrix[first:last], self.offset[first:last]
        if self.batch:
            matrix = matrix.transpose(0, 2, 3, 1).reshape(size, width, *self.batch)
            offset = offset.transpose(0, 2, 1).reshape(size, *self.batch)
        else:
            matrix, offset = matrix.reshape(size, width), offset.reshape(size)
        return At(None, matrix, offset, self._noise_of(self.noise, first, last), first, last)

    def given(self, step: int, inputs: Sequence[Array], count: int) -> At:
        """The CPD of one run with values of its observed parents, (d,), or (count, d) each."""
        if self.noisy:
            wide = self._wide(inputs, count)
            noise = self._noise_of(evaluate(self.cpd, wide, (count, 1), step), 0, count)
        else:
            noise = self._own(0, count)
        if self.template is None:
            assert isinstance(self.cpd, AffineCPD)
            if not inputs:
                return self._affine_at(0, count)._replace(noise=noise)
            matrix, shift = self.cpd._affine(self.hidden, self._wide(inputs, count))
            offset = np.broadcast_to(shift, (count, 1, shift.shape[-1])).reshape(-1)
            return At(None, np.tile(matrix, (count, 1)), offset, noise, 0, count)
        arguments = [None if place is None else inputs[place] for place in self._order]
        group = None if count == 1 else count
        function = BoundFunction(
            self.template, arguments, 0, step, group, self.grouped, self.source
        )
        return At(function, None, None, noise, 0, count)

    def _wide(self, inputs: Sequence[Array], count: int) -> dict[Variable, Array]:
        every = zip(self.inputs, inputs, strict=True)
        return {parent: values.reshape(count, 1, -1) for parent, values in every}

    @cached_property
    def _order(self) -> list[int | None]:
        """Which of the inputs each argument of the function is; None for a hidden parent."""
        assert self.template is not None
        places = {parent: k for k, parent in enumerate(self.inputs)}
        return [places.get(parent) for parent in self.template.given]

    def line(self, at: At, mean: Array, cov: Array) -> Line:
        """Linearise at a belief over the hidden parents, (n, *batch) and (n, n, *batch)."""
        function = at.function
        if function is None:
            assert at.matrix is not None
            assert at.offset is not None
            value = times(at.matrix, mean)
            value += at.offset
            return Line(at.matrix, value, None)
        try:
            return self.prepared(function, mean, cov)
        except Exception as error:
            failure = self._failure(function, mean, error)
            if failure is error:
                raise
            raise failure from (None if isinstance(error, Misfit) else error)

    def keep(self, at: At, matrix: Array, offset: Array, noise: Array | None) -> None:
        """Keep the linearisation of some rows, a step's; the noise where there is an error."""
        first, last = at.first, at.last
        count, (height, width) = last - first, self.shape[2:]
        if count == 1 and not self.batch:
            self.matrix[first, 0], self.offset[first, 0] = matrix, offset
            if noise is not None:
                self.keep_errors()
                self.noise[first, 0] = noise
            return
        shape = (count, height)
        if noise is not None:
            self.keep_errors()
            each = np.arange(count)
            blocks = noise.reshape(*shape, *shape, *noise.shape[2:])[each, :, each]
            self.noise[first:last] = blocks.transpose(0, 3, 1, 2) if self.batch else blocks[:, None]
        if self.batch:
            slope = matrix.reshape(*shape, width, *self.batch)
            self.matrix[first:last] = slope.transpose(0, 3, 1, 2)
            self.offset[first:last] = offset.reshape(*shape, *self.batch).transpose(0, 2, 1)
        else:
            self.matrix[first:last, 0] = matrix.reshape(*shape, width)
            self.offset[first:last, 0] = offset.reshape(shape)

    @cached_property
    def _known(self) -> list[Array | None]:
        """Values of each argument with evidence by row, read-only, since users' functions see them.

        Of one run they are (rows, d), of many (rows, runs, d), or (rows, 1, d) of all.
        """
        assert self.template is not None
        found: list[Array | None] = []
        for parent in self.template.given:
            values = self.inputs.get(parent)
            if values is not None and self.batch:
                # A plain callable may ask for the function at the beliefs of some runs alone.
                if not isinstance(self.prepared, Wrapped):
                    values = np.broadcast_to(values, (len(values), *self.batch, values.shape[-1]))
            elif values is not None:
                values = np.ascontiguousarray(values[:, 0])
                values.flags.writeable = False
            found.append(values)
        return found

    @cached_property
    def _steps(self) -> list[int]:
        found: list[int] = self.step.tolist()
        return found

    def _own(self, first: int, last: int) -> Array:
        """The CPD's own noise at some rows, as one."""
        if len(self.own_noise) > 1:
            return self._noise_of(self.own_noise, first, last)
        count = last - first
        found = self._constant_noise.get(count)
        if found is None:
            found = self._constant_noise[count] = self._noise_of(self.own_noise, 0, count)
        return found

    @cached_property
    def _constant_noise(self) -> dict[int, Array]:
        return {}

    def _noise_of(self, noise: Array, first: int, last: int) -> Array:
        """Covariances (rows or 1, runs or 1, d, d) of some rows along one diagonal."""
        blocks = noise[first:last] if len(noise) > 1 else noise
        blocks = blocks.transpose(0, 2, 3, 1) if self.batch else blocks[:, 0]
        if last - first == 1:
            return np.ascontiguousarray(blocks[0])
        return block_diagonal(np.broadcast_to(blocks, (last - first, *blocks.shape[1:])))

    def _affine_at(self, first: int, last: int) -> At:
        constant, shift = self.affine
        count = last - first
        if len(shift) == 1 == len(self.own_noise):
            found = self._constant_at.get(count)
            if found is not None:
                return found if found.first == first else found._replace(first=first, last=last)
        offset = np.broadcast_to(
            shift if len(shift) == 1 else shift[first:last], (count, *shift.shape[1:])
        )
        if self.batch:
            matrix = np.tile(constant, (count, 1))[..., None]
            offset = offset.transpose(0, 2, 1).reshape(-1, shift.shape[1])
        else:
            matrix, offset = np.tile(constant, (count, 1)), offset.reshape(-1)
        made = At(None, matrix, offset, self._own(first, last), first, last)
        if len(shift) == 1 == len(self.own_noise):
            self._constant_at[count] = made
        return made

    @cached_property
    def _constant_at(self) -> dict[int, At]:
        return {}

    # --- many rows at once ------------------------------------------------------------------------

    def linearise(self, rows: Rows, mean: Array, cov: Array, active: Mask | None = None) -> None:
        """Linearise some rows at beliefs over the hidden parents, (runs, n) or (k, runs, n).

        `active` says which runs take the new linearisation; the others keep theirs.
        """
        if self.template is not None:
            function = self.bound(rows, mean.ndim - 1, mean.shape[:-1])
            line = self.checked(function, mean, cov)
            at = components_first(mean, 1)
            offset = line.value - times(line.matrix, at)
            error = None if line.error is None else components_last(line.error, 2)
            self.store(
                rows, components_last(line.matrix, 2), components_last(offset, 1), error, active
            )

    def checked(
        self, function: BoundFunction, mean: Array, cov: Array, *, finite: bool = True
    ) -> Line:
        """A line at beliefs (*batch, n) and (*batch, n, n), which has to be finite."""
        with quiet():  # what is not finite is refused
            at = components_first(mean, 1)
            line = self.line(_unplaced(function), at, components_first(cov, 2))
            if finite:
                self.require_finite(function, at, line)
        return line

    def store(
        self,
        rows: Rows | Integers,
        matrix: Array,
        offset: Array,
        error: Array | None,
        active: Mask | None,
    ) -> None:
        """Keep what a lineariser made of some rows, for the runs that are active."""
        if error is not None and not self.approximate and error.any():
            self.keep_errors()
        if active is None and isinstance(rows, slice) and rows == slice(None):
            # What is linearised at all rows at once is used along rows of steps.
            self.matrix = by_rows(np.broadcast_to(matrix, self.matrix.shape), copy=True)
            self.offset = by_rows(np.broadcast_to(offset, self.offset.shape), copy=True)
        else:
            self._put(self.matrix, rows, matrix, active)
            self._put(self.offset, rows, offset, active)
        if self.approximate:
            own = self.own_noise
            own = own[rows] if own.shape[0] > 1 else own[0]
            total = own if error is None else error + own
            self._put(self.noise, rows, total, active)

    def keep_errors(self) -> None:
        """Make room for approximation errors, before any is known."""
        if not self.approximate:
            room = vacant(self.noise.shape[:2], self.noise.shape[2:])
            room[...] = self.noise
            self.noise, self.approximate = room, True

    def settle(self) -> None:
        """Give up the room for approximation errors where there are none."""
        if self.approximate and not (self.noise != self.own_noise).any():
            self.noise = np.broadcast_to(self.own_noise, self.noise.shape)
            self.approximate = False

    @staticmethod
    def _put(kept: Array, rows: Rows | Integers, new: Array, active: Mask | None) -> None:
        if active is not None:
            tail = (1,) * (kept.ndim - 2)
            new = np.where(active.reshape(-1, *tail), new, kept[rows])
        kept[rows] = new

    def bound(self, rows: Rows, lead: int, shape: tuple[int, ...]) -> BoundFunction:
        """The CPD's function with the evidence of some rows bound."""
        assert self.template is not None
        step: int | Integers
        if isinstance(rows, int):
            step = int(self.step[rows])
        else:
            steps = self.step[rows]
            if steps.size and steps[0] == steps[-1]:
                step = int(steps[0])
            else:
                step = np.broadcast_to(steps[:, None], shape)
        known = [
            self.inputs[parent][rows] if place is None else None
            for parent, place in zip(self.template.given, self.template.places, strict=True)
        ]
        return BoundFunction(self.template, known, lead, step, source=self.source)

    def value(self, rows: Rows, mean: Array) -> Array:
        """F mean + b of some rows."""
        return apply(self.matrix[rows], mean) + self.offset[rows]

    def to_chart(self, parents: Array, child: Array) -> None:
        """Move offsets of angles by whole turns, so that values lie near the child's mean.

        Beliefs live on one unwrapped chart; a function that wraps its angles must not leave it.
        """
        angles = self.cpd.child.angle_mask
        if self.template is not None and angles.any():
            value = self.value(slice(None), parents)
            self.offset += nearest_branch(value, child, angles) - value

    # --- refusals ---------------------------------------------------------------------------------

    def _failure(self, function: BoundFunction, mean: Array, error: Exception) -> Exception:
        """The error to raise of a lineariser that has failed."""
        if isinstance(error, Misfit):
            return self._fault(function, mean, *error.args)
        told = isinstance(self.lineariser, ArrayLineariser) or getattr(error, "cpd", None)
        if not isinstance(error, PgmError) or not told:
            said = f"{type(error).__name__}: {error}"
            return self._fault(function, mean, "failed", said, ModelError)
        error.cpd = error.cpd or self.cpd
        error.variable = error.variable or self.cpd.child
        if self.timed and error.step is None and isinstance(function.step, int):
            error.step = function.step
        return error

    def _fault(
        self,
        function: BoundFunction,
        mean: Array,
        fault: str,
        more: str,
        kind: type[PgmError] = LinearisationError,
    ) -> PgmError:
        """The error of a lineariser, whose one call may be for many runs."""
        step = function.step if self.timed and isinstance(function.step, int) else None
        first = self.first_run
        last = first + (mean.shape[-1] if mean.ndim > 1 else 1) - 1
        at = "" if step is None else f" at step {step}"
        runs = f", run {first}" if first == last else f", in a call for runs {first} to {last}"
        after = f": {more}" if kind is ModelError else f"; {more}"
        return kind(
            f"the lineariser {self.lineariser!r} {fault} for {self.cpd!r}{at}{runs}{after}",
            variable=self.cpd.child,
            cpd=self.cpd,
            step=step,
            run=first if first == last else None,
        )

    def require_finite(self, function: BoundFunction, mean: Array, line: Line) -> None:
        """Refuse a line at a mean (n, *batch) that has values of NaN or infinity."""
        total = line.matrix.sum() + line.value.sum()
        if line.error is not None:
            total = total + line.error.sum()
        if np.isfinite(total):
            return
        bad = np.zeros(mean.shape[1:], dtype=bool)
        for part in line:
            if part is not None:
                bad |= ~np.isfinite(part).all(axis=tuple(range(part.ndim - bad.ndim)))
        if not bad.any():
            return
        where = tuple(int(axis[0]) for axis in np.nonzero(bad)) if bad.ndim else ()
        step = None
        if self.timed and function.step is not None:
            step = int(np.broadcast_to(function.step, bad.shape)[where])
        at = "" if step is None else f" at step {step}"
        run = self.first_run + (where[-1] if where else 0)
        raise LinearisationError(
            f"{self.cpd!r}: its linearisation{at}, run {run}, has values that are NaN or "
            f"infinite, at {names(self.hidden)} = {mean.T[where[::-1]]}; is the function "
            "defined there, and its Jacobian?",
            variable=self.cpd.child,
            cpd=self.cpd,
            step=step,
            run=run,
        )

    def probe(self, means: Mapping[Variable, Array]) -> None:
        """Call the functions once with axes that give wrong indexing away, before inference."""
        if self.template is None or not self.step.size:
            return
        axes = (2, 3)
        parts = [means.get(v.template, np.zeros(v.dimension)) for v in self.hidden]
        x = np.broadcast_to(np.concatenate([np.zeros(0), *parts]), (*axes, dimension(self.hidden)))
        known = [
            np.broadcast_to(self.inputs[parent][0, 0], (*axes, parent.dimension))
            if place is None
            else None
            for parent, place in zip(self.template.given, self.template.places, strict=True)
        ]
        function = BoundFunction(self.template, known, 2, source=Source(self.cpd, True, None))
        with np.errstate(all="ignore"):
            function(x)
            if len(self.template.numerical) < self.template.size:
                function.jacobian(x)


def _unplaced(function: BoundFunction) -> At:
    """A function to be linearised, of which nothing else is asked."""
    return At(function, None, None, np.zeros(0), 0, 0)


def _value(function: BoundFunction, mean: Array, cov: Array) -> Line:
    """The value of a function without hidden parents."""
    value = components_first(function(components_last(mean, 1)), 1)
    return Line(np.zeros((len(value), 0, *mean.shape[1:])), value, None)


def _own_noise(
    cpd: ConditionalGaussian,
    step: Integers | None,
    rows: int,
    inputs: Mapping[Variable, Array],
    lead: tuple[int, ...],
    first_run: int,
) -> Array:
    """The CPD's own noise covariance, (rows or 1, runs or 1, d, d)."""
    size = cpd.child.dimension
    if not isinstance(cpd.cov, Noise):
        if cpd.cov.ndim == 2:
            return cpd.cov[None, None]
        return np.broadcast_to(cpd.cov, (*lead, size, size)).reshape(1, math.prod(lead), size, size)
    if not rows:
        return np.zeros((1, 1, size, size))
    known = {parent: inputs[parent] for parent in cpd.cov.given}
    shape = np.broadcast_shapes((rows, 1), *(array.shape[:2] for array in known.values()))
    steps = None if step is None else step[:, None]
    return evaluate(cpd, known, shape, steps, first_run)
