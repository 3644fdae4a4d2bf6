"""One CPD at all its rows: its evidence, its noise, and what the lineariser made of it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from pgm.cpds import AffineCPD, ConditionalGaussian, Noise, NonlinearGaussianCPD
from pgm.cpds.noise import evaluate
from pgm.errors import LinearisationError, ModelError, PgmError
from pgm.factors import AffineGaussian, Gaussian
from pgm.factors.scope import Scope, dimension, names
from pgm.kernels.angles import nearest_branch
from pgm.kernels.arrays import Array, Integers, Mask, apply, cut, vacant
from pgm.kernels.scan import by_rows
from pgm.linearisers import (
    Affine,
    ArrayLineariser,
    BoundFunction,
    FunctionTemplate,
    Lineariser,
    Taylor,
)
from pgm.variables import Variable

Rows = int | slice


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
        made = cls(*known, first_run=first_run)
        if isinstance(cpd, AffineCPD):
            constant, shift = cpd._affine(hidden, inputs)
            if not cpd.given and shift.ndim > 1:
                shift = np.broadcast_to(shift, (*lead, height)).reshape(1, runs, height)
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
        part = replace(
            self,
            inputs={parent: cut(values, runs) for parent, values in self.inputs.items()},
            noise=cut(self.noise, runs),
            own_noise=cut(self.own_noise, runs),
            first_run=self.first_run + runs.start,
        )
        if self.exact:
            part.matrix, part.offset = cut(self.matrix, runs), cut(self.offset, runs)
        return part

    @property
    def exact(self) -> bool:
        """Whether the CPD is affine, so that no linearisation is needed."""
        return self.template is None

    @property
    def taylor(self) -> bool:
        """Whether the CPD is affine or expanded to first order at a point."""
        return self.exact or isinstance(self.lineariser, Taylor)

    def linearise(self, rows: Rows, mean: Array, cov: Array, active: Mask | None = None) -> None:
        """Linearise some rows at beliefs over the hidden parents, (runs, n) or (k, runs, n).

        `active` says which runs take the new linearisation; the others keep theirs.
        """
        if self.template is not None:
            function = self.bound(rows, mean.ndim - 1, mean.shape[:-1])
            affine = self.call(function, mean, cov)
            self.store(rows, affine.F, affine.b, affine.cov, active)

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

    def forget_errors(self) -> None:
        """Have no room for approximation errors any more."""
        if self.approximate:
            self.noise = np.broadcast_to(self.own_noise, self.noise.shape)
            self.approximate = False

    @property
    def erroneous(self) -> bool:
        """Whether there is any approximation error."""
        return self.approximate and bool((self.noise != self.own_noise).any())

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
        known = tuple(
            self.inputs[parent][rows] if place is None else None
            for parent, place in zip(self.template.given, self.template.places, strict=True)
        )
        return self.function(known, lead, step)

    def function(
        self,
        known: tuple[Array | None, ...],
        lead: int,
        step: int | Integers,
        group: int | None = None,
    ) -> BoundFunction:
        """The CPD's function with evidence bound."""
        assert self.template is not None
        return BoundFunction(
            self.template, known, lead, step, group, self.timed, self.first_run, self.cpd
        )

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

    def call(
        self, function: BoundFunction, mean: Array, cov: Array, *, finite: bool = True
    ) -> Affine:
        """What the lineariser makes of the function at a belief, checked."""
        found: Any
        try:
            with np.errstate(
                invalid="ignore", over="ignore", divide="ignore"
            ):  # non-finite values: see below
                if not self.hidden:
                    value = function(mean)
                    found = Affine(np.empty((*value.shape, 0)), value, None)
                elif isinstance(self.lineariser, ArrayLineariser):
                    found = self.lineariser.affine(function, mean, cov)
                else:
                    found = self.lineariser(function, Gaussian._make(self.hidden, mean, cov))
        except Exception as error:
            told = isinstance(self.lineariser, ArrayLineariser) or getattr(error, "cpd", None)
            if not isinstance(error, PgmError) or not told:
                said = f": {type(error).__name__}: {error}"
                raise self._fault(function, mean, "failed", said, ModelError) from error
            error.cpd = error.cpd or self.cpd
            error.variable = error.variable or self.cpd.child
            if self.timed and error.step is None and isinstance(function.step, int):
                error.step = function.step
            raise
        affine = found if isinstance(found, Affine) else self._arrays(found, function, mean)
        if finite and not np.isfinite(_total(affine)):
            self._refuse_non_finite(function, mean, affine)
        return affine

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
        last = first + (mean.shape[-2] if mean.ndim > 1 else 1) - 1
        at = "" if step is None else f" at step {step}"
        runs = f", run {first}" if first == last else f", in a call for runs {first} to {last}"
        return kind(
            f"the lineariser {self.lineariser!r} {fault} for {self.cpd!r}{at}{runs}{more}",
            variable=self.cpd.child,
            cpd=self.cpd,
            step=step,
            run=first if first == last else None,
        )

    def _arrays(self, affine: Any, function: BoundFunction, mean: Array) -> Affine:
        """What a lineariser that works on Gaussians has returned, its shapes checked."""
        if not isinstance(affine, AffineGaussian):
            more = "; it must return a pgm.AffineGaussian"
            raise self._fault(function, mean, f"returned {type(affine).__name__}", more)
        due = (function.angles.size, self.matrix.shape[-1])
        if affine.F.shape[-2:] != due:
            found, more = f"returned an F of shape {affine.F.shape}", f"; it must end in {due}"
            raise self._fault(function, mean, found, more)
        lead = np.broadcast_shapes(affine.F.shape[:-2], affine.b.shape[:-1], affine.cov.shape[:-2])
        if lead and lead != mean.shape[:-1]:
            more = f"; those of the belief are {mean.shape[:-1]}"
            raise self._fault(function, mean, f"returned the leading axes {lead}", more)
        return Affine(affine.F, affine.b, affine.cov)

    def _refuse_non_finite(self, function: BoundFunction, mean: Array, affine: Affine) -> None:
        shape = mean.shape[:-1]
        bad = np.broadcast_to(~np.isfinite(affine.b).all(axis=-1), shape)
        bad = bad | ~np.isfinite(affine.F).all(axis=(-2, -1))
        if affine.cov is not None:
            bad = bad | ~np.isfinite(affine.cov).all(axis=(-2, -1))
        where = tuple(int(axis[0]) for axis in np.nonzero(bad))
        step = None
        if self.timed and function.step is not None:
            step = int(np.broadcast_to(function.step, shape)[where])
        at = "" if step is None else f" at step {step}"
        run = self.first_run + where[-1]
        raise LinearisationError(
            f"{self.cpd!r}: its linearisation{at}, run {run}, has values that are NaN or "
            f"infinite, at {names(self.hidden)} = {mean[where]}; is the function defined there, "
            "and its Jacobian?",
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
        known = tuple(
            np.broadcast_to(self.inputs[parent][0, 0], (*axes, parent.dimension))
            if place is None
            else None
            for parent, place in zip(self.template.given, self.template.places, strict=True)
        )
        function = BoundFunction(self.template, known, 2, first_run=None, cpd=self.cpd)
        with np.errstate(all="ignore"):
            function(x)
            if len(self.template.numerical) < self.template.size:
                function.jacobian(x)


def _total(affine: Affine) -> float:
    """The sum of all entries, which is finite only if each of them is."""
    total = affine.F.sum() + affine.b.sum()
    return float(total if affine.cov is None else total + affine.cov.sum())


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
