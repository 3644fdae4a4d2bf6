"""A CPD at its rows, with evidence bound.

A *row* is a step of a transition, or a sighting of a sensor: a measurement at some step, of which
there may be several. *Runs* are the simulations or robots that are worked on together; all of them
have the same rows. In the arrays of `At` component axes come first, then the *batch*: no axis for
one run, else that of runs, of length one where all runs are alike. An *input* is the value of a
parent with evidence. The CPD's child y has d components (in the shape of an input d is the number
of the input's own), and its hidden parents, stacked to one vector x, have n.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

import numpy as np

from pgm.cpds import AffineCPD, ConditionalGaussian, Noise, NonlinearGaussianCPD
from pgm.cpds.conditional import evaluate
from pgm.factors.scope import Scope
from pgm.kernels.arrays import Array, Integers, block_diagonal, components_first
from pgm.linearisers import BoundFunction, FunctionTemplate, Lineariser
from pgm.linearisers.function import Source
from pgm.linearisers.numbering import Numbering
from pgm.linearisers.repeated import Repeated
from pgm.tracing import Answers
from pgm.variables import Variable


class At(NamedTuple):
    """Some rows of a CPD, stacked to be linearised as one, with their evidence bound.

    The rows are `first` up to, not including, `last`. The children of these k rows are stacked to
    one vector y: here d is k times the number of a child's components. `function` is to be
    linearised. It is None of an affine CPD, and of one that was linearised before: then `matrix` is
    F (d, n, *batch) and `offset` b (d, *batch) of y = F x + b, which else are None. `noise` (d, d,
    *batch) is the CPD's own noise covariance, plus that of the linearisation's error where the CPD
    was linearised before.
    """

    function: BoundFunction | None
    matrix: Array | None
    offset: Array | None
    noise: Array
    first: int
    last: int

    def bound(self, step: int, inputs: Sequence[Array | None]) -> At:
        """The same rows with other inputs, at another step; there must be just one run.

        `inputs` has a value for each argument of the function, None for a hidden parent: (d,) if
        there is one row, else (rows, d). The function must not be None.
        """
        function = self.function
        assert function is not None
        template, _, lead, _, group, joint, source = function
        other = BoundFunction(template, inputs, lead, step, group, joint, source)
        return At(other, None, None, self.noise, self.first, self.last)


@dataclass(eq=False)
class Rows:
    """A CPD at its rows: steps for a transition, sightings for a sensor.

    `hidden` are the parents without evidence, stacked to n components; `step` (rows,) the steps,
    zeros where there is no time (not `timed`); `inputs` (rows, runs or 1, d) the values of the
    other parents. `template` has the function, None of an affine CPD, whose F (d, n) and b (rows or
    1, runs or 1, d) are `affine`. `own_noise` (rows or 1, runs or 1, d, d) is the CPD's own noise
    covariance. `batch` is (runs,), or () for one run; `numbering` is of the axis of runs, for the
    texts of errors. The rows may be of several CPDs, a `plate`, which differ in their variables,
    numbers and noise alone: then `cpd` and its parents are the first row's, and F is (rows, d, n).
    F of a CPD whose numbers differ by run is (1, runs, d, n), and by step (rows, 1, d, n).
    A *trace* is a function recorded as a graph of scalar operations (`pgm.tracing`). `answers`
    records the values and slopes that the function's trace gives in this call, for a comparison
    with the function afterwards; None without that.
    """

    cpd: ConditionalGaussian
    hidden: Scope
    step: Integers
    inputs: Mapping[Variable, Array]
    lineariser: Lineariser
    template: FunctionTemplate | None
    own_noise: Array
    timed: bool
    numbering: Numbering
    batch: tuple[int, ...]
    affine: tuple[Array, Array] = field(init=False, repr=False)
    answers: Answers | None = field(default=None, repr=False)
    plate: tuple[ConditionalGaussian, ...] = field(default=(), repr=False)

    def cpd_at(self, row: int) -> ConditionalGaussian:
        """The CPD of a row."""
        return self.plate[row] if self.plate else self.cpd

    def parents_at(self, row: int) -> dict[Variable, Variable]:
        """The parents of the first CPD, each with the one that has its place at a row."""
        pairs = zip(self.cpd.parents, self.cpd_at(row).parents, strict=True)
        return dict(pairs)

    @property
    def exact(self) -> bool:
        """Whether the CPD is affine, so that no linearisation is needed."""
        return self.template is None

    @cached_property
    def noisy(self) -> bool:
        """Whether the noise covariance depends on observed parents, or on the step."""
        return isinstance(self.cpd.cov, Noise)

    @cached_property
    def grouped(self) -> bool:
        """Whether the sightings of a step are linearised as one stacked vector, as the user asked.

        A sigma-point rule then keeps the cross terms of their approximation errors.
        """
        return isinstance(self.cpd, NonlinearGaussianCPD) and self.cpd.grouped

    @cached_property
    def bare(self) -> tuple[int, ...]:
        """The indices of the child's components whose own noise is zero at some row and run."""
        variances = np.diagonal(self.own_noise, axis1=-2, axis2=-1)
        return tuple(int(k) for k in np.flatnonzero((variances == 0.0).any(axis=(0, 1))))

    @cached_property
    def source(self) -> Source:
        """The origin of a function with evidence bound, mainly for the text of errors.

        It is the CPD, whether it has time, the numbering of its runs, and the record of its
        trace's answers.
        """
        return Source(self.cpd, self.timed, self.numbering, self.answers)

    def at(self, first: int, last: int) -> At:
        """The rows from `first` up to, not including, `last`, to be linearised as one.

        They have to be of one and the same step.
        """
        if self.template is None:
            return self._affine_at(first, last)
        count, lead = last - first, len(self.batch)
        inputs: Sequence[Array | None]
        if count == 1:
            inputs = self._by_row[first]
        else:
            inputs = [None if values is None else values[first:last] for values in self._known]
            if lead:
                inputs = [None if values is None else values.swapaxes(0, 1) for values in inputs]
        step, group = self._steps[first], None if count == 1 else count
        function = BoundFunction(
            self.template, inputs, lead, step, group, self.grouped, self.source
        )
        noise = self._constant_noise.get(count)
        if noise is None:
            noise = self._own(first, last)
        return At(function, None, None, noise, first, last)

    def repeated(self, more: tuple[int, ...]) -> Repeated:
        """The function at one row after another, at points whose axes are `more` behind the batch.

        The CPD must not be affine.
        """
        assert self.template is not None

        def bind(row: int) -> BoundFunction:
            function = self.at(row, row + 1).function
            assert function is not None
            return function

        return Repeated(self.template, self._known, self.batch, more, bind)

    def given(self, step: int, inputs: Sequence[Array], count: int) -> At:
        """The CPD at new rows with the inputs given here, in place of its own rows; for one run.

        There is one row of a transition, or `count` sightings, all of them at `step`. The `inputs`
        are in the order of `self.inputs`, (d,) each, or (count, d) of several sightings.
        """
        if self.noisy:
            wide = self._wide(inputs, count)
            noise = self._noise_of(evaluate(self.cpd, wide, (count, 1), step), 0, count)
        else:
            noise = self._own(0, count)
        if self.template is None:
            assert isinstance(self.cpd, AffineCPD)
            if not inputs and self.cpd.steps is None:
                return self._affine_at(0, count)._replace(noise=noise)
            matrix, shift = self.cpd._affine(self.hidden, self._wide(inputs, count), step)
            offset = np.broadcast_to(shift, (count, 1, shift.shape[-1])).reshape(-1)
            return At(None, np.tile(matrix, (count, 1)), offset, noise, 0, count)
        arguments = [None if place is None else inputs[place] for place in self.order]
        group = None if count == 1 else count
        function = BoundFunction(
            self.template, arguments, 0, step, group, self.grouped, self.source
        )
        return At(function, None, None, noise, 0, count)

    def _wide(self, inputs: Sequence[Array], count: int) -> dict[Variable, Array]:
        """Inputs by parent, (count, 1, d) each: a row for each of `count` sightings, one run.

        `inputs` are in the order of `self.inputs`.
        """
        every = zip(self.inputs, inputs, strict=True)
        return {parent: values.reshape(count, 1, -1) for parent, values in every}

    @cached_property
    def order(self) -> list[int | None]:
        """For each argument of the function its place among `inputs`; None for a hidden parent."""
        assert self.template is not None
        places = {parent: k for k, parent in enumerate(self.inputs)}
        return [places.get(parent) for parent in self.template.given]

    @cached_property
    def _known(self) -> list[Array | None]:
        """For each argument of the function its inputs by row, None if it is a hidden parent.

        They are (rows, d) of one run, (rows, runs or 1, d) of many; read-only, since users'
        functions see them.
        """
        assert self.template is not None
        found: list[Array | None] = []
        for parent in self.template.given:
            values = self.inputs.get(parent)
            if values is not None and self.batch:
                # A plain callable may ask for the function at the beliefs of some runs alone.
                if hasattr(self.lineariser, "prepare"):
                    values = np.broadcast_to(values, (len(values), *self.batch, values.shape[-1]))
            elif values is not None:
                values = np.ascontiguousarray(values[:, 0])
                values.flags.writeable = False
            found.append(values)
        return found

    @cached_property
    def _by_row(self) -> list[tuple[Array | None, ...]]:
        """For each row, and each argument of the function, its input, or None of a hidden parent.

        An input is (d,) of one run, (runs or 1, d) of many.
        """
        nothing = [None] * self.step.size
        every = (nothing if values is None else list(values) for values in self._known)
        return list(zip(*every, strict=True))

    @cached_property
    def _steps(self) -> list[int]:
        """The step of each row, as integers of Python."""
        found: list[int] = self.step.tolist()
        return found

    def _own(self, first: int, last: int) -> Array:
        """The CPD's own noise covariance of k rows, block diagonal, (k d, k d, *batch).

        They are the rows from `first` up to, not including, `last`. The result is kept for the next
        call if all rows of the CPD have the same noise.
        """
        if len(self.own_noise) > 1:
            return self._noise_of(self.own_noise, first, last)
        count = last - first
        found = self._constant_noise.get(count)
        if found is None:
            found = self._constant_noise[count] = self._noise_of(self.own_noise, 0, count)
        return found

    @cached_property
    def _constant_noise(self) -> dict[int, Array]:
        """A cache: by the number k of stacked rows, their own noise covariance, (k d, k d, *batch).

        It stays empty if the rows of the CPD differ in their noise.
        """
        return {}

    def _noise_of(self, noise: Array, first: int, last: int) -> Array:
        """The noise covariance of k rows, block diagonal, (k d, k d, *batch).

        They are the rows from `first` up to, not including, `last`, of `noise`, which is (rows or
        1, runs or 1, d, d).
        """
        blocks = noise[first:last] if len(noise) > 1 else noise
        blocks = blocks.transpose(0, 2, 3, 1) if self.batch else blocks[:, 0]
        if last - first == 1:
            return np.ascontiguousarray(blocks[0])
        return block_diagonal(np.broadcast_to(blocks, (last - first, *blocks.shape[1:])))

    def _affine_at(self, first: int, last: int) -> At:
        """The rows of an affine CPD from `first` up to, not including, `last`, stacked.

        Their arrays are kept for the next call if all rows have the same offset and noise.
        """
        constant, shift = self.affine
        count = last - first
        alike = len(shift) == 1 == len(self.own_noise) and (constant.ndim < 4 or len(constant) == 1)
        if alike:
            found = self._constant_at.get(count)
            if found is not None:
                return At(None, found.matrix, found.offset, found.noise, first, last)
        offset = np.broadcast_to(
            shift if len(shift) == 1 else shift[first:last], (count, *shift.shape[1:])
        )
        if constant.ndim == 4:  # of each run, or of each step
            each = components_first(constant[first if len(constant) > 1 else 0], 2)
            each = each if self.batch else each[..., 0]
            matrix = np.tile(each, (count, *(1,) * (each.ndim - 1)))
        elif self.batch:
            matrix = np.tile(constant, (count, 1))[..., None]
        else:
            matrix = np.tile(constant, (count, 1))
        if self.batch:
            offset = offset.transpose(0, 2, 1).reshape(-1, shift.shape[1])
        else:
            offset = offset.reshape(-1)
        made = At(None, matrix, offset, self._own(first, last), first, last)
        if alike:
            self._constant_at[count] = made
        return made

    @cached_property
    def _constant_at(self) -> dict[int, At]:
        """A cache of an affine CPD: by their number k, the stacked arrays of k rows.

        It stays empty if the rows of the CPD differ in their matrix, offset or noise.
        """
        return {}


def own_noise(
    cpd: ConditionalGaussian,
    step: Integers | None,
    rows: int,
    inputs: Mapping[Variable, Array],
    lead: tuple[int, ...],
    numbering: Numbering,
) -> Array:
    """The CPD's own noise covariance at its rows, (rows or 1, runs or 1, d, d).

    It has one row if it does not depend on `inputs` (rows, runs or 1, d). `step` (rows,) is None
    without time; `lead` is the shape of the user's axes of runs; `numbering` is of the axis of
    runs, for the texts of errors.
    """
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
    return evaluate(cpd, known, shape, steps, numbering)
