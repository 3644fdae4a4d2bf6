"""CPDs with their inputs, at many particles: draws of the child, and its density.

A law is a CPD with the values of its observed parents, which have a row for each step of the
transition, or for each measurement of a sensor. The particles at which it is evaluated are given as
`some`: their states at a step and at the step before, and their runs. `Drawing` holds the
generators of these particles' random numbers. Arrays over these m particles have components first,
(d, m); functions of users see (m, d). A root L of a noise covariance is lower triangular, cov =
L Lᵀ. A component has *noise of its own* where the diagonal of L, its pivot, is not zero; any other
component is a function of the parents and of the components with noise of their own.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from pgm.beliefs.points.cloud import Block
from pgm.cpds import CPD, AffineCPD, ConditionalGaussian, Noise
from pgm.cpds.base import Known
from pgm.cpds.conditional import evaluate
from pgm.errors import LinearisationError, ModelError, NumericalError
from pgm.factors.arrays import IMPROPER
from pgm.kernels import normal_density, roots
from pgm.kernels.arrays import LOG_2PI, Array, Integers, Mask
from pgm.kernels.step import turns
from pgm.linearisers.calls import Call
from pgm.linearisers.numbering import Numbering
from pgm.variables import Variable

# Components first, float64 or float32.
States = npt.NDArray[Any]


class Some(NamedTuple):
    """Particles at a step, the points at which CPDs are evaluated.

    now: The components of the step's slice, as far as they have been drawn, (d, m).
    before: The components of the slice one step before, (d, m).
    owner: The run of each particle, (m,); None where there is one run.
    """

    step: int
    now: States
    before: States
    owner: Integers | None

    @property
    def size(self) -> int:
        """The number of particles."""
        return int(self.now.shape[1])

    def chosen(self, which: Mask) -> Some:
        """The particles at which a mask (m,) is True."""
        owner = None if self.owner is None else self.owner[which]
        return Some(self.step, self.now[:, which], self.before[:, which], owner)


class Drawing:
    """The generators of random numbers for a block: adjacent particles, worked on together.

    pieces: Pairs of a slice of the block and a generator. The slices follow one another; each has
        the particles of one run, and the generator is that run's.
    """

    def __init__(self, pieces: Sequence[tuple[slice, np.random.Generator]]) -> None:
        self.pieces = pieces

    @classmethod
    def of(
        cls, block: Block, starts: Integers, generators: Sequence[np.random.Generator]
    ) -> Drawing:
        """The drawing of a block, from the generators of all runs.

        starts: The place among all particles at which each run begins, and the end, (runs + 1,).
        """
        found = []
        for run in block.runs:
            first = max(int(starts[run]), block.first) - block.first
            last = min(int(starts[run + 1]), block.last) - block.first
            found.append((slice(first, last), generators[run]))
        return cls(found)

    def chosen(self, which: Mask) -> Drawing:
        """The drawing for those particles of the block at which a mask (m,) is True."""
        found, first = [], 0
        for place, rng in self.pieces:
            count = int(which[place].sum())
            if count:
                found.append((slice(first, first + count), rng))
            first += count
        return Drawing(found)

    def white(self, components: int, count: int, dtype: Any) -> States:
        """Independent standard normal numbers, (components, count), for the block's particles.

        `count` is the number of particles, and `dtype` float64 or float32.
        """
        if len(self.pieces) == 1:
            return self.pieces[0][1].standard_normal((components, count), dtype=dtype)
        found = np.empty((components, count), dtype=dtype)
        for place, rng in self.pieces:
            shape = components, place.stop - place.start
            found[:, place] = rng.standard_normal(shape, dtype=dtype)
        return found


@dataclass(frozen=True, eq=False)
class Law:
    """The law of a CPD of any kind, by the CPD's own sampler and density; base of other laws.

    inputs: By observed parent, its values (rows, runs or 1, d).
    places: By hidden variable, where its components stand on the first axis of arrays of states.
    dtype: The type of the states, float64 or float32.
    first_run: The user's number of the first run here, from which texts of errors count.
    """

    cpd: CPD
    inputs: Mapping[Variable, States]
    places: Mapping[Variable, slice]
    dtype: Any
    first_run: int

    def given(self, row: int, some: Some) -> dict[Variable, States]:
        """The values (m, d) of each parent at the particles `some`, read-only.

        An observed parent has the values of its inputs at `row`. A hidden one has those of the
        particles, at their step, or at the step before if the parent has a lag.
        """
        found = {}
        for parent in self.cpd.parents:
            if parent in self.inputs:
                rows = self.inputs[parent][row]
                if len(rows) > 1 and some.owner is not None:
                    rows = rows[some.owner]
                value = np.broadcast_to(rows, (some.size, rows.shape[-1]))
            else:
                source = some.before if parent.lag else some.now
                value = source[self.places[parent.template]].T
                value.flags.writeable = False
            found[parent] = value
        return found

    def draw(self, row: int, some: Some, drawing: Drawing) -> States:
        """Draws of the child at particles, (d, m)."""
        values = self.given(row, some)
        found = np.empty((self.cpd.child.dimension, some.size), dtype=self.dtype)
        for place, rng in drawing.pieces:
            count = place.stop - place.start
            own = {v: a[place] for v, a in values.items()}
            known = Known(own, (count,), (count,), some.step)
            found[:, place] = self.cpd._draw(known, rng).T
        return found

    def log_density(self, row: int, some: Some, child: States, taken: Mask | None = None) -> Array:
        """The log-densities (m,) of a child (d, m), or (d, 1) for all particles.

        taken: The mask (d,) of the components that were measured; the CPD's density is given NaN
            for the others. None if all were measured.
        """
        values = self.given(row, some)
        if taken is not None and not taken.all():
            child = np.where(taken[:, None], child, np.nan)
        wide = np.broadcast_to(child, (len(child), some.size)).T
        known = Known(values, (some.size,), (some.size,), some.step)
        return self.cpd._log_density(wide, known)

    def open(self, row: int, step: int) -> Integers:
        """The number of components with noise of their own, at a row, (runs or 1,).

        `step` is that of the row, for texts of errors. Here all components are counted, since a
        CPD's own density does not say which of them have noise.
        """
        return np.array([self.cpd.child.dimension])

    def require_noise(self, steps: Integers) -> None:
        """Refuse, by a ModelError, a sensor that has singular noise at one of its rows.

        `steps` are those of all its rows, (rows,), for the text of the error. Here nothing is
        refused, since a CPD's own density does not say whether it is singular.
        """


class GaussianLaw(Law):
    """The law of a CPD of Gaussian noise: x = mean(parents) + L w, w being standard normal."""

    cpd: ConditionalGaussian

    def draw(self, row: int, some: Some, drawing: Drawing) -> States:
        """Draws of the child at particles, mean plus Gaussian noise, (d, m)."""
        white = drawing.white(self.cpd.child.dimension, some.size, self.dtype)
        root = self.root(row, some.step)
        if root.diagonal is not None:
            white *= root.diagonal if some.owner is None else root.diagonal[:, root.of(some)]
        elif len(root.lower) == 1:
            white = root.lower[0].astype(self.dtype) @ white
        else:
            white = np.einsum("mij,jm->im", root.lower[root.of(some)], white)
        white += self.mean(row, some)
        return white

    def log_density(self, row: int, some: Some, child: States, taken: Mask | None = None) -> Array:
        """The log-densities (m,) of a child (d, m), or (d, 1) for all particles.

        taken: The mask (d,) of the components that were measured, whose marginal density is taken;
            None if all were. It is ignored under singular noise, which no sensor may have.
        """
        root = self.root(row, some.step)
        if not root.regular:
            return self._within(root, row, some, child)
        mean, angles = self.mean(row, some), self.cpd.child.angle_mask
        if taken is not None and not taken.all():
            mean, child, angles = mean[taken], child[taken], angles[taken]
            root = root.marginal(taken)
        residual = np.subtract(child, mean)
        for k in np.flatnonzero(angles):
            residual[k] -= turns(residual[k])
        return root.log_density(residual, some)

    def _within(self, root: Root, row: int, some: Some, child: States) -> Array:
        """The log-densities (m,) of a child (d, m) or (d, 1) under singular noise L w, L = `root`.

        Under such noise the child lies in a subspace about its mean, where the components with
        noise of their own determine all others. Its density is that of those components. Where a
        child is off the subspace, by more than a rounding of the states' type, the log-density is
        −∞. Angles are compared with their means unwrapped first, and wrapped if the child is off
        the subspace then.
        """
        # That of the child alone: a particle is what the law made of another, and others are near.
        mean, error = self.mean(row, some), np.finfo(self.dtype).eps * np.abs(child)
        residual = np.subtract(child, mean, dtype=np.float64)
        found = root.within(residual, error, some)
        if self.cpd.child.angle_mask.any():
            wrapped = residual.copy()
            for k in np.flatnonzero(self.cpd.child.angle_mask):
                wrapped[k] -= turns(wrapped[k])
            found = np.where(np.isneginf(found), root.within(wrapped, error, some), found)
        return found

    def open(self, row: int, step: int) -> Integers:
        """The number of components with noise of their own, at a row, (runs or 1,).

        `step` is that of the row, for texts of errors.
        """
        return self.root(row, step).open

    def mean(self, row: int, some: Some) -> States:
        """The means of the child at particles, (d, m), or (d, 1) if they are the same for all.

        A function with values that are NaN or infinite is refused by a LinearisationError.
        """
        values = self.given(row, some)
        if isinstance(self.cpd, AffineCPD):
            total, matrices = self._affine(self.cpd, some)
            for parent, matrix in matrices.items():
                value = values[parent]
                total = total + matrix @ value.T
            return total
        lead = (some.size,)
        call = Call(self.cpd.child, "function", lead, some.step, None, self.cpd)
        with np.errstate(all="ignore"):  # non-finite values are refused below
            arguments = [values[v] for v in self.cpd.given]
            mean = self._called(arguments, (*lead, self.cpd.child.dimension), call)
        if not np.isfinite(mean.sum()) and not np.isfinite(mean).all():
            self._refuse(mean, values, some)
        return mean.T

    def _called(self, arguments: list[States], due: tuple[int, ...], call: Call) -> States:
        """The value of the user's function, (m, d), for the parents' values, `arguments`.

        A value of the states' type and of the shape `due`, (m, d), is returned as it is, so that
        float32 stays float32. Any other value is converted to a float64 array of that shape. Where
        it cannot be, or the function fails, a ModelError is raised.

        call: The CPD and the step that the function is called for, which makes the error's text.
        """
        function = getattr(self.cpd, "function", None)
        if function is None:
            known = dict(zip(self.cpd.given, arguments, strict=True))
            return self.cpd._mean(known, call.lead, call)
        try:
            value = function(*arguments)
        except Exception as error:
            raise call.error(f"failed: {call.reason(function, arguments, error, due)}") from error
        if isinstance(value, np.ndarray) and value.dtype == self.dtype and value.shape == due:
            return value
        return call.array(function, arguments, value, due)

    def _refuse(self, mean: States, values: Mapping[Variable, States], some: Some) -> None:
        """Raise the LinearisationError for means (m, d) that are not finite, naming a particle.

        values: The values (m, d) of each parent at the particles, for the text of the error.
        """
        index = int(np.flatnonzero(~np.isfinite(mean).all(axis=-1))[0])
        run = self.first_run + (0 if some.owner is None else int(some.owner[index]))
        at = {v: a[index].tolist() for v, a in values.items()}
        raise LinearisationError(
            f"{self.cpd!r}: at step {some.step}, run {run}, its function has values that are NaN "
            f"or infinite, at the particle {at}",
            variable=self.cpd.child,
            cpd=self.cpd,
            step=some.step,
            run=run,
        )

    def require_noise(self, steps: Integers) -> None:
        """Refuse, by a ModelError, a sensor that has singular noise at one of its rows.

        `steps` are those of all its rows, (rows,), for the text of the error.
        """
        for row, step in enumerate(steps.tolist()):
            if not self.root(row, step).regular:
                raise ModelError(
                    f"{self.cpd!r} has no noise in a component, or two that are one, at step "
                    f"{step}: no particle need agree with its measurement; give it some",
                    variable=self.cpd.child,
                    cpd=self.cpd,
                    step=step,
                )
            if not isinstance(self.cpd.cov, Noise):
                break

    def root(self, row: int, step: int) -> Root:
        """The `Root` of the noise covariance at a row, one root for all runs or one for each.

        If the CPD gives its covariance by a function, a value that is no covariance raises a
        ModelError. `step` is that of the row, for texts of errors.
        """
        if not isinstance(self.cpd.cov, Noise):
            return self._constant
        known = {v: np.asarray(self.inputs[v][row], dtype=np.float64) for v in self.cpd.cov.given}
        count = max((len(rows) for rows in known.values()), default=1)
        cov = evaluate(self.cpd, known, (count,), step, Numbering(self.first_run))
        return self._root(roots.root(cov), step)

    @cached_property
    def _constant(self) -> Root:
        """The `Root` of a noise covariance that is the same at all rows."""
        lower = self.cpd._lower
        return self._root(lower.reshape(-1, *lower.shape[-2:]), None)

    def _root(self, lower: Array, step: int | None) -> Root:
        """The `Root` made of the array `lower` (runs or 1, d, d) of lower triangular roots.

        NaN, which marks a covariance that is not finite and semidefinite, is refused by a
        NumericalError, which names the `step`; None if the covariance is the same at all steps.
        """
        if not roots.is_proper(lower):
            raise NumericalError(
                f"{self.cpd!r}: its noise cannot be used: {IMPROPER}",
                variable=self.cpd.child,
                cpd=self.cpd,
                step=step,
            )
        return Root(lower, self.dtype)

    def _affine(self, cpd: AffineCPD, some: Some) -> tuple[States, Mapping[Variable, States]]:
        """The offset (d, m) or (d, 1), and by parent the matrix, of an affine CPD at particles."""
        if cpd.steps is None:
            offset = self._offset if some.owner is None else self._offset[:, self._runs_of(some)]
            return offset, self._matrices
        matrices, shift = cpd._numbers(some.step)
        every = {v: matrix.astype(self.dtype) for v, matrix in matrices.items()}
        return shift[:, None].astype(self.dtype), every

    @cached_property
    def _offset(self) -> States:
        """The offset of an affine CPD, (d, runs or 1)."""
        assert isinstance(self.cpd, AffineCPD)
        return self.cpd.offset.reshape(-1, self.cpd.child.dimension).T.astype(self.dtype)

    def _runs_of(self, some: Some) -> Integers | slice:
        """The index of each particle's column in `_offset`; a full slice where all share one."""
        return slice(None) if self._offset.shape[1] == 1 or some.owner is None else some.owner

    @cached_property
    def _matrices(self) -> dict[Variable, States]:
        """By parent, the matrix of an affine CPD, (d, parent's d)."""
        assert isinstance(self.cpd, AffineCPD)
        return {v: matrix.astype(self.dtype) for v, matrix in self.cpd.matrices.items()}


class Root:
    """The lower triangular root L of a noise covariance L Lᵀ, one for all runs or one for each.

    lower: The roots, (runs or 1, d, d).
    diagonal: The standard deviations, (d, runs or 1), if the noise of components is independent;
        otherwise None.
    regular: Whether all components have noise of their own, in all runs.
    open: How many components have noise of their own, (runs or 1,).
    """

    def __init__(self, lower: Array, dtype: Any) -> None:
        self.lower, self.dtype = lower, dtype
        deviations = np.diagonal(lower, axis1=-2, axis2=-1)
        independent = np.array_equal(lower, deviations[..., None] * np.eye(lower.shape[-1]))
        self.diagonal = deviations.T.astype(dtype) if independent else None
        self.regular = bool((deviations > 0.0).all())
        self.open: Integers = (deviations > 0.0).sum(axis=-1)
        self._pivots = deviations

    def of(self, some: Some) -> Integers:
        """The index in `lower` of each particle's root, (m,)."""
        if len(self.lower) == 1 or some.owner is None:
            return np.zeros(some.size, dtype=np.intp)
        return some.owner

    def marginal(self, taken: Mask) -> Root:
        """The `Root` of the covariance of the components at which a mask (d,) is True."""
        part = self.lower[:, taken]
        return Root(roots.root(part @ part.swapaxes(-1, -2)), self.dtype)

    @cached_property
    def constant(self) -> Array:
        """The log-density of regular noise at a residual of zero, (runs or 1,)."""
        count = self.lower.shape[-1]
        found: Array = -np.log(self._pivots).sum(axis=-1) - 0.5 * count * LOG_2PI
        return found

    def log_density(self, residual: States, some: Some) -> Array:
        """The log-densities (m,) of residuals (d, m) under regular noise.

        residual: The children of the m particles `some`, less their means; may be overwritten.
        """
        which = slice(None) if len(self.lower) == 1 else self.of(some)
        if self.diagonal is not None:
            residual /= self.diagonal[:, which]
        elif len(self.lower) == 1:
            residual = np.linalg.solve(self.lower[0], residual)
        else:
            residual = np.linalg.solve(self.lower[which], residual.T[..., None])[..., 0].T
        square = np.einsum("im,im->m", residual, residual)
        found: Array = self.constant[which] - 0.5 * square
        return found

    def within(self, residual: Array, error: Array, some: Some) -> Array:
        """The log-densities (m,) of residuals (d, m) under singular noise.

        The log-density is that of the components with noise of their own; −∞ where a residual is
        off the subspace of the noise by more than rounding explains.

        residual: The children of the m particles `some`, less their means.
        error: By how much rounding may have changed the residuals, (d, m) or (d, 1).
        """
        lower = self.lower[0] if len(self.lower) == 1 else self.lower[self.of(some)]
        points = (-1, 1, len(residual)) if lower.ndim > 2 else (-1, len(residual))
        wide = np.broadcast_to(residual, (len(residual), some.size)).T.reshape(points)
        white, left = normal_density.whitened(lower, wide)
        found = normal_density.log_density(lower, white)
        if left is not None:
            errors = np.broadcast_to(error, (len(error), some.size)).T.reshape(points)
            found = np.where(normal_density.off(lower, left, errors), -np.inf, found)
        return found.reshape(-1)


def by_pattern(taken: Mask, owner: Integers | None) -> Iterator[tuple[Mask, Mask | None]]:
    """Each pattern of measured components, with the particles in whose runs they were measured.

    Yields pairs of a pattern, a mask (d,) of components, and a mask (m,) of particles, which is
    None for all particles. A pattern without measured components is left out.

    taken: For each run, or for all, the mask of the components measured, (runs or 1, d).
    owner: The run of each particle, (m,); None where there is one run.
    """
    if len(taken) == 1 or owner is None or (taken == taken[0]).all():
        if taken[0].any():
            yield taken[0], None
        return
    for pattern in np.unique(taken, axis=0):
        if pattern.any():
            yield pattern, (taken == pattern).all(axis=1)[owner]
