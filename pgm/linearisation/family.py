"""One CPD at all its rows: its evidence, its noise, and its linearisation.

A *row* is a step of a transition or one measurement of a sensor; *runs* are the simulations or
robots that are worked on together. A linearised CPD of a child y, given its hidden parents stacked
to one vector x, is

    y = F x + b + e,   e ~ N(0, Q),   Q = R + Ω,

R being the CPD's own noise covariance and Ω the covariance of the linearisation's error. An affine
CPD is such from the start, with Ω = 0. y has d components, and x has n. Arrays over rows and runs
are (rows, runs, ...). An `At` (module `rows`) has a few consecutive rows, stacked to one vector; in
its arrays components come first and the *batch* last: no axis for one run, else that of runs. A
`Line` is a linearisation at a mean: F, the value at the mean, and Ω, or None for zero.

A nonlinear CPD has a function of its parents. Its `template` (`FunctionTemplate`) is that function
with the derivatives that the user gave, and its parents, hidden and observed. A *trace* is a user's
function recorded as a graph of scalar operations (`pgm.tracing`), which gives values and slopes,
the trace's *answers*. A *call* is one of the user's, as of `smooth`. The *judge* of a call compares
the answers with the function once the call is done; a judge that is not *trusting* allows no
traces.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import count, islice

import numpy as np

from pgm.cpds import AffineCPD, ConditionalGaussian, NonlinearGaussianCPD
from pgm.errors import ModelError
from pgm.factors.scope import Scope, dimension
from pgm.kernels.angles import nearest_branch
from pgm.kernels.arrays import (
    Array,
    Index,
    Integers,
    Mask,
    apply,
    components_first,
    components_last,
    cut,
    length,
    quiet,
    tiled,
    times,
    vacant,
)
from pgm.kernels.prefixes import by_rows
from pgm.linearisation.affine import affine_rows, plate_noise
from pgm.linearisation.failures import failure, require_finite
from pgm.linearisation.rows import At, Rows, own_noise
from pgm.linearisers import (
    ArrayLineariser,
    BoundFunction,
    FunctionTemplate,
    Line,
    Lineariser,
    StatisticalRegression,
    Taylor,
)
from pgm.linearisers.function import Source
from pgm.linearisers.lineariser import Misfit, Prepared, by_values, needs_cov, prepare
from pgm.linearisers.numbering import COUNTED, Numbering
from pgm.tracing import Answers, Judge, Tracer
from pgm.variables import Variable

Some = int | slice
# Rules whose rounding grows no more than this lose nothing that a mean in float64 has.
_FEW_TIMES = 10.0


@dataclass(eq=False)
class Family(Rows):
    """A CPD at its rows, and its linearisation F, b and Q there.

    `noise` is Q, (rows, runs, d, d): a read-only view of `own_noise`, R, until some row has an
    error Ω, then (`approximate`) an array of its own. `judge` is the call's judge of traces;
    without one (None) each answer of a trace is compared at once. `compiled` records the answers of
    the trace that machine code uses, which is of the function together with the derivatives that
    the user gave; None without machine code.
    """

    noise: Array = field(init=False, repr=False)
    approximate: bool = False
    judge: Judge | None = field(default=None, repr=False)
    compiled: Answers | None = field(default=None, repr=False)
    # Why there is no such trace in this call; it is asked once, as another time there might be one.
    _untraced: str | None = field(default=None, repr=False)

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
        numbering: Numbering = COUNTED,
        plate: Sequence[ConditionalGaussian] = (),
    ) -> Family:
        """Lay out a CPD with its evidence bound; an affine one has F, b and Q at once.

        `hidden` are the parents without evidence; `step` (rows,) is the step of each row, `inputs`
        are the other parents' values (rows, runs or 1, d) and `lead` the shape of the user's axes
        of runs, whose `numbering` the texts of errors have. `timed` is False of a network without
        time. For a nonlinear CPD a `template` is made if none is given, and the CPD's own
        lineariser, if it has one, takes the place of `lineariser`. A CPD that is neither affine nor
        nonlinear Gaussian is a `ModelError`.

        The rows are of the CPDs of a `plate` (`pgm.cpds.plates`), whose first is `cpd`, if they are
        not all copies of this one.
        """
        rows, runs = step.size, math.prod(lead)
        height, width = cpd.child.dimension, dimension(hidden)
        copies = cpd.origin.steps is None and all(each.origin is cpd.origin for each in plate)
        plate = () if copies else tuple(plate)
        noise = own_noise(cpd, step if timed else None, rows, inputs, lead, numbering)
        if plate:
            noise = plate_noise(plate, lead)
        if isinstance(cpd, NonlinearGaussianCPD):
            template = template or cpd._template(hidden)
            if plate:
                variances = np.diagonal(noise, axis1=-2, axis2=-1).min(axis=(0, 1))
                template = replace(template, variances=tuple(variances.tolist()))
            lineariser = cpd.lineariser or lineariser
        elif not isinstance(cpd, AffineCPD):
            raise ModelError(f"{cpd!r} is of no kind that inference knows", cpd=cpd)
        batch = () if runs == 1 else (runs,)
        known = cpd, hidden, step, inputs, lineariser, template, noise, timed, numbering, batch
        made = cls(*known)
        made.plate, made.noise = plate, np.broadcast_to(noise, (rows, runs, height, height))
        if isinstance(cpd, AffineCPD):
            constant, shift = made.affine = affine_rows(cpd, plate, hidden, inputs, lead, step)
            slope = constant if constant.ndim == 4 else constant[..., None, :, :]
            made.matrix = np.broadcast_to(slope, (rows, runs, height, width))
            made.offset = np.broadcast_to(shift, (rows, runs, height))
        return made

    @cached_property
    def shape(self) -> tuple[int, ...]:
        """The shape of `matrix`, (rows, runs, d, n)."""
        return (*self.noise.shape[:3], dimension(self.hidden))

    @cached_property
    def matrix(self) -> Array:
        """The slope F of each row and run, (rows, runs, d, n).

        Of an affine CPD it is known from the start, and read-only. Of any other it is uninitialised
        memory until a linearisation of the row is stored in it.
        """
        return vacant(self.shape[:2], self.shape[2:])

    @cached_property
    def offset(self) -> Array:
        """The offset b, (rows, runs, d).

        Of an affine CPD it is known from the start. Of any other it is uninitialised memory until a
        linearisation of the row is stored in it.
        """
        return vacant(self.shape[:2], self.shape[2:3])

    def emptied(self) -> Family:
        """The family with evidence of the same shape that takes no memory, to be `renewed`."""
        part, inputs = copy(self), self.inputs.items()
        part.inputs = {parent: np.broadcast_to(0.0, values.shape) for parent, values in inputs}
        assert part.shape is not None  # which all that are made of it have in common
        assert part.bare is not None
        return part

    def renewed(self, inputs: Mapping[Variable, Array], lead: tuple[int, ...]) -> Family:
        """The family, as it was `emptied`, with other evidence of the same shape.

        What depends on evidence is made anew. An affine CPD of Gaussian noise that has none, and is
        never linearised, stays the same object. `lead` is as of `make`.
        """
        if self.noisy or (self.exact and inputs):
            timed, numbering = self.timed, self.numbering
            parts = self.cpd, self.hidden, self.step, inputs, self.lineariser, lead
            return Family.make(*parts, timed=timed, template=self.template, numbering=numbering)
        if self.settled:
            return self
        part = object.__new__(Family)
        part.__dict__.update(self.__dict__, inputs=inputs)
        return part

    def of(self, runs: Index) -> Family:
        """The family of some runs alone, with views of the evidence if `runs` is a slice.

        A slice has a start and a stop. An affine CPD keeps F and b; a nonlinear one has
        none until it is linearised anew. Where Q has errors Ω it is copied, so that this family
        stays as it is.
        """
        count = length(runs)
        part = replace(
            self,
            inputs={parent: cut(values, runs) for parent, values in self.inputs.items()},
            own_noise=cut(self.own_noise, runs),
            numbering=self.numbering.of(runs),
            batch=() if count == 1 else (count,),
        )
        part.noise = cut(self.noise, runs)
        if self.approximate:
            part.noise = part.noise.copy("K")
        if self.exact:
            part.matrix, part.offset = cut(self.matrix, runs), cut(self.offset, runs)
            matrix, shift = self.affine
            part.affine = cut(matrix, runs) if matrix.ndim == 4 else matrix, cut(shift, runs)
        return part

    def copies(self, count: int) -> Family:
        """The family with all its runs so many times, copy after copy, linearised as it is."""
        runs, part = self.shape[1], copy(self)
        for name in ("shape", "_known", "_by_row", "_steps", "_constant_at", "_constant_noise"):
            part.__dict__.pop(name, None)

        def wide(array: Array) -> Array:
            return tiled(array, count, alone=runs == 1)

        part.inputs = {parent: wide(values) for parent, values in self.inputs.items()}
        part.own_noise, part.numbering = wide(self.own_noise), self.numbering._replace(runs=runs)
        part.batch = () if count * runs == 1 else (count * runs,)
        part.matrix, part.offset, part.noise = map(wide, (self.matrix, self.offset, self.noise))
        if self.exact:
            matrix, shift = self.affine
            part.affine = wide(matrix) if matrix.ndim == 4 else matrix, wide(shift)
        return part

    def window(self, first: int, last: int) -> Family:
        """The family of the rows from `first` up to, not including, `last`.

        Its evidence is a view. Linearisations are copied, so that the part can be linearised again
        while the whole stays as it is.
        """
        rows, part = slice(first, last), copy(self)
        for name in ("shape", "_known", "_by_row", "_steps"):
            part.__dict__.pop(name, None)
        part.step = self.step[rows]
        part.inputs = {parent: values[rows] for parent, values in self.inputs.items()}
        part.matrix, part.offset = self.matrix[rows], self.offset[rows]
        part.noise = self.noise[rows]
        if len(self.own_noise) > 1:
            part.own_noise = self.own_noise[rows]
        if self.exact:
            matrix, shift = self.affine
            own = matrix[rows] if matrix.ndim == 4 and len(matrix) > 1 else matrix
            part.affine = own, shift[rows] if len(shift) > 1 else shift
        else:
            part.matrix, part.offset = part.matrix.copy("K"), part.offset.copy("K")
        if self.approximate:
            part.noise = part.noise.copy("K")
        return part

    def unweighed(self) -> Family:
        """The family with its own noise R, without weights and errors of linearisations.

        An affine CPD keeps F and b; any other is to be linearised.
        """
        part = self.window(0, self.step.size)
        part.noise = np.broadcast_to(part.own_noise, part.noise.shape)
        part.approximate = False
        return part

    def put(self, rows: slice | tuple[slice, Index], part: Family) -> None:
        """Copy the linearisations F, b and Q of another family of this CPD into some rows.

        `rows` is a slice of rows, or that and an index of runs; the family `part` has these rows
        and runs alone.
        """
        if not self.exact:
            self.matrix[rows], self.offset[rows] = part.matrix, part.offset
        if part.approximate:
            self.keep_errors()
        if self.approximate:
            self.noise[rows] = part.noise

    @property
    def uniform(self) -> bool:
        """Whether the CPD is affine, with the same offsets and noise in all runs."""
        return self.exact and self.own_noise.shape[1] == 1 == self.affine[1].shape[1]

    @property
    def taylor(self) -> bool:
        """Whether the CPD is affine, or linearised to first order at a point, by `Taylor`."""
        return self.exact or isinstance(self.lineariser, Taylor)

    @property
    def expects(self) -> bool:
        """Whether robust noise finds a measurement's weight from E[rᵀ R⁻¹ r] of its residual r.

        The expectation is under the belief. The result is False with `Taylor()`: the weight is then
        found from rᵀ R⁻¹ r of the residual at the belief's mean.
        """
        return not isinstance(self.lineariser, Taylor) or self.lineariser.expected

    @property
    def settled(self) -> bool:
        """Whether the CPD is affine and its noise Gaussian, so that it depends on no belief."""
        return self.exact and self.cpd.noise is None

    @cached_property
    def semidefinite(self) -> bool:
        """Whether Ω is positive semidefinite for certain, whatever the function and the belief."""
        if self.taylor or not self.hidden:
            return True
        rule = self.lineariser
        return isinstance(rule, ArrayLineariser) and rule.is_semidefinite(dimension(self.hidden))

    @property
    def needs_cov(self) -> bool:
        """Whether the linearisation depends on the belief's covariance, not on its mean alone."""
        return self.template is not None and needs_cov(self.lineariser, self.template)

    @cached_property
    def prepared(self) -> Prepared:
        """The lineariser as a function ``prepared(function, mean, cov)`` that returns a `Line`.

        What depends on the CPD alone is done once, not in every call. A call takes the CPD's
        function with evidence bound, and the mean (n, *batch) and covariance (n, n, *batch) of the
        hidden parents. Where no parent is hidden, it only evaluates the function.
        """
        assert self.template is not None
        return prepare(self.lineariser, self.template) if self.hidden else _value

    def line(self, at: At, mean: Array, cov: Array) -> Line:
        """Linearise the rows of `at` at a belief over their hidden parents.

        The belief has the `mean` (n, *batch) and the covariance `cov` (n, n, *batch). Rows that
        are affine, or linearised already, keep F; the line then has the value F mean + b, and no
        error. An exception of the lineariser becomes an error that names the CPD, step and run.
        """
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
            refusal = failure(self, function, mean, error)
            if refusal is error:
                raise
            raise refusal from (None if isinstance(error, Misfit) else error)

    def keep(self, at: At, matrix: Array, offset: Array, noise: Array | None) -> None:
        """Store the linearisation of the rows of `at`, which were linearised as one.

        For k rows `matrix` F is (k d, n, *batch), `offset` b (k d, *batch), and `noise` Q (k d,
        k d, *batch), of which the diagonal blocks are kept; None leaves Q as it is.
        """
        first, last = at.first, at.last
        if noise is not None:
            self.keep_noise(at, noise)
        if last - first == 1 and not self.batch:
            self.matrix[first, 0], self.offset[first, 0] = matrix, offset
            return
        count, (height, width) = last - first, self.shape[2:]
        shape = (count, height)
        if self.batch:
            slope = matrix.reshape(*shape, width, *self.batch)
            self.matrix[first:last] = slope.transpose(0, 3, 1, 2)
            self.offset[first:last] = offset.reshape(*shape, *self.batch).transpose(0, 2, 1)
        else:
            self.matrix[first:last, 0] = matrix.reshape(*shape, width)
            self.offset[first:last, 0] = offset.reshape(shape)

    def keep_noise(self, at: At, noise: Array) -> None:
        """Store Q of the rows of `at`: of k rows the diagonal blocks of (k d, k d, *batch)."""
        self.keep_errors()
        first, last, height = at.first, at.last, self.shape[2]
        if last - first == 1 and not self.batch:
            self.noise[first, 0] = noise
            return
        shape, each = (last - first, height), np.arange(last - first)
        blocks = noise.reshape(*shape, *shape, *noise.shape[2:])[each, :, each]
        self.noise[first:last] = blocks.transpose(0, 3, 1, 2) if self.batch else blocks[:, None]

    def stored_at(self, first: int, last: int) -> At:
        """The rows from `first` up to, not including, `last`, with the stored F, b and Q, stacked.

        Each of these rows has to be affine, or linearised already.
        """
        if self.template is None:
            at = self._affine_at(first, last)
            if self.approximate:  # of robust noise
                at = at._replace(noise=self._noise_of(self.noise, first, last))
            return at
        height, width = self.shape[2:]
        size = (last - first) * height
        matrix, offset = self.matrix[first:last], self.offset[first:last]
        if self.batch:
            matrix = matrix.transpose(0, 2, 3, 1).reshape(size, width, *self.batch)
            offset = offset.transpose(0, 2, 1).reshape(size, *self.batch)
        else:
            matrix, offset = matrix.reshape(size, width), offset.reshape(size)
        return At(None, matrix, offset, self._noise_of(self.noise, first, last), first, last)

    def linearise(self, rows: Some, mean: Array, cov: Array, active: Mask | None = None) -> None:
        """Linearise some rows at beliefs over the hidden parents, and store the result.

        `rows` is the number of a row, then the mean is (runs, n) and the covariance (runs, n, n);
        or a slice of k rows, then they are (k, runs, n) and (k, runs, n, n). `active` (runs,) marks
        the runs that take the new linearisation, None all; the others keep theirs. An affine CPD is
        left as it is.
        """
        if self.template is not None:
            line = self._line_at(rows, mean, cov)
            at = components_first(mean, 1)
            offset = line.value - times(line.matrix, at)
            error = None if line.error is None else components_last(line.error, 2)
            self.store(
                rows, components_last(line.matrix, 2), components_last(offset, 1), error, active
            )

    def _line_at(self, rows: Some, mean: Array, cov: Array) -> Line:
        """The `Line` of some rows; of a plate an error is that of the first row which has one."""
        if self.plate and not by_values(self.lineariser):
            return self._line_of_each(rows, mean, cov)
        function = self.bound(rows, mean.ndim - 1, mean.shape[:-1])
        try:
            return self.checked(function, mean, cov)
        except Exception as error:
            if not self.plate:
                raise
            fault = error
        self._line_of_each(rows, mean, cov)
        raise fault

    def _line_of_each(self, rows: Some, mean: Array, cov: Array) -> Line:
        """The `Line` of some rows of a plate, each of which is linearised alone."""
        if isinstance(rows, int):
            return self.alone(rows)._line_at(0, mean, cov)
        every = zip(range(self.step.size)[rows], mean, cov, strict=True)
        lines = [self.alone(row)._line_at(0, *at) for row, *at in every]
        none = np.zeros((*self.shape[2:3] * 2, self.shape[1]))
        return Line(
            np.stack([line.matrix for line in lines], axis=2),
            np.stack([line.value for line in lines], axis=1),
            None
            if all(line.error is None for line in lines)
            else np.stack([none if e is None else e for _, _, e in lines], axis=2),
        )

    def alone(self, row: int) -> Family:
        """One row of a plate, as a family of its own CPD."""
        part, own = self.window(row, row + 1), self.parents_at(row)
        for name in ("bare", "source", "order", "prepared", "_constant_noise", "_constant_at"):
            part.__dict__.pop(name, None)
        part.cpd, part.plate = self.cpd_at(row), ()
        part.hidden = tuple(own[parent] for parent in self.hidden)
        part.inputs = {own[parent]: values for parent, values in part.inputs.items()}
        if isinstance(part.cpd, NonlinearGaussianCPD):
            assert self.template is not None
            template = part.cpd._template(part.hidden)
            # The trace is the one that this call's judge looks at, or none.
            part.template = replace(template, tracer=self.template.tracer)
        return part

    def checked(
        self, function: BoundFunction, mean: Array, cov: Array, *, finite: bool = True
    ) -> Line:
        """The `Line` of a function at means (..., n) and covariances (..., n, n) of its parents.

        Leading axes are (runs,) or (rows, runs). In the arrays of the `Line` components come first
        and these axes last: F is (d, n, runs) or (d, n, rows, runs). With `finite` a NaN or an
        infinity in these arrays raises a `LinearisationError`.
        """
        with quiet():  # what is not finite is refused
            at = components_first(mean, 1)
            line = self.line(_unplaced(function), at, components_first(cov, 2))
            if finite:
                require_finite(self, function, at, line)
        return line

    def store(
        self,
        rows: Some | Integers,
        matrix: Array,
        offset: Array,
        error: Array | None,
        active: Mask | None,
    ) -> None:
        """Store F, b and Q = R + `error` of some rows, for the runs that are `active`.

        `rows` is the number of a row, a slice, or an array of numbers. F (`matrix`) is (rows, runs,
        d, n), b (`offset`) (rows, runs, d), the error's covariance Ω (rows, runs, d, d) or None for
        zero; of a single row they are without the first axis. `active` is (runs,), None for all.
        """
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
        """Make Q an array of its own, no view of R, so that errors Ω can be added to it."""
        if not self.approximate:
            room = vacant(self.noise.shape[:2], self.noise.shape[2:])
            room[...] = self.noise
            self.noise, self.approximate = room, True

    def settle(self) -> None:
        """Make Q a view of R again, if the errors Ω of all rows are zero."""
        if self.approximate and not (self.noise != self.own_noise).any():
            self.noise = np.broadcast_to(self.own_noise, self.noise.shape)
            self.approximate = False

    @staticmethod
    def _put(kept: Array, rows: Some | Integers, new: Array, active: Mask | None) -> None:
        """Write new values into some rows of the array `kept`, in active runs only.

        `kept` is (rows, runs, ...), and so is `new` for the rows given, or (runs, ...) for a single
        one; `active` is (runs,), None for all.
        """
        if active is not None:
            tail = (1,) * (kept.ndim - 2)
            new = np.where(active.reshape(-1, *tail), new, kept[rows])
        kept[rows] = new

    def bound(self, rows: Some | Integers, lead: int, shape: tuple[int, ...]) -> BoundFunction:
        """The CPD's function with the evidence of some rows bound.

        It will be called with beliefs whose leading axes are `shape`, (runs,) for one row or
        (k, runs) for k rows; `lead` is the number of these axes, 1 or 2.
        """
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

    def value(self, rows: Some, mean: Array) -> Array:
        """The predicted value F mean + b of some rows at means of the hidden parents.

        `rows` is the number of a row, then the means are (runs, n) and the values (runs, d); or a
        slice of rows, then they are (rows, runs, n) and (rows, runs, d).
        """
        return apply(self.matrix[rows], mean) + self.offset[rows]

    @property
    def turned(self) -> Mask:
        """The components of a hidden child that are angles known but for whole turns, (d,).

        Those of a function may be wrapped; an affine CPD predicts them on the chart of its parents.
        """
        return self.cpd.child.angle_mask & (self.template is not None)

    def to_chart(self, parents: Array, child: Array) -> None:
        """Add multiples of 2π to b, in place, so that predicted angles are within π of the child's.

        `parents` (rows, runs, n) are the means of the hidden parents, `child` (rows, runs, d) those
        of the child. The angles in them are not wrapped to one turn: they may be any numbers. The b
        of an affine CPD stays.
        """
        angles = self.turned
        if angles.any():
            value = self.value(slice(None), parents)
            self.offset += nearest_branch(value, child, angles) - value

    def probe(self, means: Mapping[Variable, Array]) -> None:
        """Call the function and its Jacobian on trial, to refuse wrong shapes before inference.

        A hidden parent gets its mean (d,) from `means`, which has variables without a step as
        keys, or zeros where it has none there; any other parent gets its first evidence. These
        values are repeated along two leading axes. The axes' lengths differ from the numbers of
        components of the child and of all parents, so that a function that takes such an axis for
        components returns a wrong shape, which raises a `ModelError`.
        """
        if self.template is None or not self.step.size:
            return
        # No axis is as long as a vector of components: function(x) that takes x[0] for a component
        # of a row, or x[:, 0] for one of a table, would return the shape that is due.
        taken = {self.cpd.child.dimension, *(v.dimension for v in self.template.given)}
        axes = tuple(islice((k for k in count(2) if k not in taken), 2))
        known = [
            None if value is None else np.broadcast_to(value, (*axes, value.size))
            for value in self._observed
        ]
        parts = [means.get(v.template, np.zeros(v.dimension)) for v in self.hidden]
        x = np.broadcast_to(np.concatenate([np.zeros(0), *parts]), (*axes, dimension(self.hidden)))
        function = BoundFunction(self.template, known, 2, source=Source(self.cpd, True, None))
        with np.errstate(all="ignore"):
            function(x)
            if len(self.template.missing) < self.template.size:
                function.jacobian(x)

    def trace(self, means: Mapping[Variable, Array], judge: Judge | None) -> None:
        """Set whether and how a trace gives the derivatives that the user has not given.

        With a trusting judge the trace's answers are recorded, and compared with the function after
        the call; without a judge each answer is compared at once; with a judge that is not trusting
        no trace is used. A trace that is made here is compared with the function at values near the
        first evidence and the hidden parents' `means`, (d,) by variable without a step (zeros where
        one is lacking).
        """
        template = self.template
        if template is None:
            return
        self.judge, self._untraced = judge, None
        if judge is not None and not judge.trusting:
            self.template = replace(template, tracer=None)
        elif template.tracer is not None and template.missing:
            centres = [
                means.get(parent.template, np.zeros(parent.dimension)) if value is None else value
                for parent, value in zip(template.given, self._observed, strict=True)
            ]
            if judge is None:
                template.tracer.confirm(centres)
            else:
                self.answers = self._asked(judge, template.tracer, centres)

    def trace_whole(self) -> Answers | str:
        """Trace the function together with the derivatives that the user gave, for machine code.

        The result is a record of the answers that the trace will give in this call, which the judge
        compares with the function; it is kept as `compiled`. Where no trace can be used, the result
        is a text that says why.
        """
        assert self.template is not None
        if self.judge is None or self.template.tracer is None:
            return "its trace has been given up for this call"
        if self._untraced is not None:
            return self._untraced
        tracer = self.template.whole
        if tracer is self.template.tracer and self.answers is not None:
            self.compiled = self.answers
            return self.answers
        self.compiled = self._asked(self.judge, tracer, list(map(np.zeros, tracer.widths)))
        if self.compiled is None:
            self._untraced = str(tracer.reason)
        return self.compiled or str(tracer.reason)

    def _asked(self, judge: Judge, tracer: Tracer, centres: list[Array]) -> Answers | None:
        """An empty record of a trace's answers in this call, which the judge will look through.

        `tracer` has the trace or makes it. One that it makes is compared with the function at
        values near `centres`, which has a value (d,) for each argument. The result is None if the
        judge is not trusting or there is no right trace.
        """
        template, count = self.template, math.prod(self.noise.shape[:2])
        assert template is not None
        columns, places = template.missing_columns, template.missing
        alone = None if tracer is template.tracer else template.tracer
        return judge.asked(tracer, centres, columns, places, template.variances, count, alone)

    @property
    def _observed(self) -> list[Array | None]:
        """For each argument of the function its value at the first row and run, (d,).

        It is zeros if there are no rows, and None of a hidden parent.
        """
        assert self.template is not None
        return [
            (self.inputs[parent][0, 0] if self.step.size else np.zeros(parent.dimension))
            if place is None
            else None
            for parent, place in zip(self.template.given, self.template.places, strict=True)
        ]


def _unplaced(function: BoundFunction) -> At:
    """A function to be linearised alone, as an `At` without rows and noise."""
    return At(function, None, None, np.zeros(0), 0, 0)


def _value(function: BoundFunction, mean: Array, cov: Array) -> Line:
    """The value of a function without hidden parents, as a `Line` whose slope F has no columns.

    `mean` (0, *batch) is empty, and `cov` is not read.
    """
    value = components_first(function(components_last(mean, 1)), 1)
    return Line(np.zeros((len(value), 0, *mean.shape[1:])), value, None)


def cancellation(family: Family) -> float:
    """The factor by which a sigma-point rule magnifies the rounding of the function's values.

    A factor of ten or less counts as 0. The result is also 0 of an affine CPD, of one without
    hidden parents, and of a lineariser that is no sigma-point rule.
    """
    rule = family.lineariser
    if family.template is None or not family.hidden or not isinstance(rule, StatisticalRegression):
        return 0.0
    found = rule.cancellation(family.template.size)
    return found if found > _FEW_TIMES else 0.0
