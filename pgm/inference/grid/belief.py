"""Beliefs on a grid: probabilities of cells, and the means, marginals and draws read from them."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from functools import cached_property
from typing import Any, Self

import numpy as np
import numpy.typing as npt

from pgm.arguments import public
from pgm.boundary import as_generator, as_lengths, is_whole
from pgm.display import NoArray, Shown, Summary, axes
from pgm.errors import ModelError
from pgm.factors import Gaussian
from pgm.factors.listing import Framed
from pgm.factors.scope import Scope, places_of, whole_variables
from pgm.immutable import Immutable
from pgm.inference.grid.lattice import Axis
from pgm.inference.summaries import moments_of
from pgm.kernels.angles import wrap
from pgm.kernels.arrays import Array, Integers
from pgm.variables import Variable


class PointMassBelief(Framed, Shown, NoArray, Immutable):
    """Base of beliefs by point masses: grid cells or particles.

    components: The names of the n components that it is over.
    steps: The numbers of the steps that the last leading axis stands for; None where no axis is of
        steps.
    lead: The shape of the leading axes of independent beliefs, (...): runs, then steps.
    _parts: One object a component, with its name, `label`, and whether it is an angle, `angle`.
    """

    components: tuple[str, ...]
    steps: Integers | None
    lead: tuple[int, ...]
    _parts: Sequence[Any]

    @property
    def angles(self) -> tuple[str, ...]:
        """The names of the components that are angles."""
        return tuple(part.label for part in self._parts if part.angle)

    @cached_property
    def mean(self) -> Array:
        """The means, (..., n).

        The mean of an angle is its circular mean plus the mean of the differences from that, which
        are wrapped to [−π, π).
        """
        return closed(self._mean())

    @cached_property
    def cov(self) -> Array:
        """The covariances, (..., n, n); an angle's differences from its mean are wrapped."""
        return closed(self._cov())

    def _mean(self) -> Array:
        """Compute the means, (..., n), which `mean` keeps."""
        raise NotImplementedError

    def _cov(self) -> Array:
        """Compute the covariances, (..., n, n), which `cov` keeps."""
        raise NotImplementedError

    @cached_property
    def std(self) -> Array:
        """The standard deviations, (..., n)."""
        return closed(np.sqrt(np.einsum("...ii->...i", self.cov)))

    def gaussian(self) -> Gaussian:
        """The normal density with the belief's mean and covariance, over the components' variables.

        It has the leading axes and the steps of the belief.

        Raises
        ------
        ModelError
            If the components are not those of whole variables: all components of one variable in
            their order, then all of the next.
        """
        variables = whole_variables(self._parts)
        return Gaussian(variables, self.mean, self.cov, steps=self.steps)

    def marginal(self, *components: str) -> Self:
        """The belief over some components alone.

        Parameters
        ----------
        *components : str
            The names of the components, in the order wanted.

        Raises
        ------
        ModelError
            If a name is that of no component, or is given twice, or if no name is given.
        """
        return self._over(places_of(self._parts, components, "a marginal"))

    def _over(self, places: tuple[int, ...]) -> Self:
        """The belief over the components at these indices of `components`, in this order."""
        raise NotImplementedError

    @public
    def sample(self, size: int | tuple[int, ...] = (), *, rng: np.random.Generator | int) -> Array:
        """Draws of the point masses by their probabilities, (*size, ..., n).

        Parameters
        ----------
        size : int or tuple of int
            The number of draws of each belief, or the shape of an array of draws.
        rng : numpy.random.Generator or int
            The generator of draws, or its seed.

        Raises
        ------
        ModelError
            If `size` is no number of draws, or `rng` is neither a generator nor a seed.
        """
        extra, generator = as_lengths(size, "of each belief"), as_generator(rng)
        drawn = self._drawn(int(np.prod(extra)), generator)
        return drawn.reshape(*extra, *self.lead, drawn.shape[-1])

    def _drawn(self, count: int, rng: np.random.Generator) -> Array:
        """Draw `count` point masses of each belief, by their probabilities.

        The draws are (count, *lead, n); subclasses may flatten the leading axes to one, since
        `sample` reshapes them.
        """
        raise NotImplementedError

    def __getitem__(self, index: Any) -> Self:
        """The beliefs at an index of the leading axes: of some runs, or of some steps.

        Parameters
        ----------
        index : int, slice or tuple of them
            An index of an array with the shape of the leading axes.

        Raises
        ------
        ModelError
            If the leading axes have no such place.
        """
        numbers = np.arange(int(np.prod(self.lead))).reshape(self.lead)
        try:
            chosen = np.asarray(numbers[index])
        except IndexError as error:
            raise ModelError(f"a belief with the leading axes {self.lead}: {error}") from error
        return self._at(index, chosen)

    def _at(self, index: Any, chosen: Integers) -> Self:
        """The beliefs at the user's `index` of the leading axes, as `belief[index]` gives them.

        `chosen` has the places of these beliefs in the flattened leading axes, as an array with the
        shape of the result's leading axes.
        """
        raise NotImplementedError

    def __getstate__(self) -> dict[str, Any]:
        # What was computed is not part of the value.
        names = PointMassBelief.__annotations__ | type(self).__annotations__
        return {name: getattr(self, name) for name in names}


class GridBelief(PointMassBelief):
    r"""A belief as probabilities of the cells of a grid.

    .. math:: p(x) = \sum_k p_k \, δ(x - c_k)

    - c_k: the centres of cells, `centres` along each axis;
    - p_k: their probabilities, `values`.

    Leading axes are independent beliefs: runs, and, where `steps` says so, steps in time. Means and
    covariances are those of the point masses. Those of an angle come from its differences, wrapped
    to [−π, π), from the circular mean μ°, the direction of Σ p_k (cos c_k, sin c_k): the mean is μ°
    plus the mean difference.

    Attributes
    ----------
    components : tuple of str
        The names of the n components, in the order of the axes of cells.
    centres : tuple of ndarray
        (cells,) of each axis; those of an angle go round the circle from −π on.
    values : ndarray
        (..., *cells): the probabilities, of sum one; float32 where the grid has that `dtype`.
    steps : ndarray of int or None
        The steps that the last leading axis stands for; None where no axis is of steps.

    Examples
    --------
    >>> from pgm.examples import walk, x, z
    >>> belief = pgm.filter(walk, {z: [[4.0]]}, belief=pgm.Grid({"x": (-8.0, 8.0, 160)}))[x][1]
    >>> belief.mean.round(2), belief.std.round(2)
    (array([2.]), array([1.]))
    >>> belief.marginal("x").values.shape
    (160,)
    >>> belief.sample(5, rng=0).shape
    (5, 1)
    """

    centres: tuple[Array, ...]
    values: npt.NDArray[Any]
    _parts: tuple[Axis, ...]

    def __init__(
        self, axes: Sequence[Axis], values: npt.NDArray[Any], steps: Integers | None = None
    ) -> None:
        view = values.view()
        view.flags.writeable = False
        if steps is not None:
            steps.flags.writeable = False
        self._set(
            components=tuple(axis.label for axis in axes),
            centres=tuple(axis.centres for axis in axes),
            values=view,
            steps=steps,
            lead=values.shape[: values.ndim - len(axes)],
            _parts=tuple(axes),
        )

    def _mean(self) -> Array:
        """The means (..., n); an angle's mean is its circular mean plus the mean offset from it."""
        each = [
            axis.reference + about + offset
            for axis, (about, _, offset) in zip(self._parts, self._moments, strict=True)
        ]
        return np.stack(each, axis=-1)

    def _cov(self) -> Array:
        """The covariances (..., n, n), from the marginals of single axes and of pairs of axes.

        Differences of an angle's centres from its mean are taken the shorter way round.
        """
        count = len(self._parts)
        found = np.empty((*self.lead, count, count))
        for i, j in itertools.combinations_with_replacement(range(count), 2):
            first, second = self._centred(i), self._centred(j)
            if i == j:
                entry = np.einsum("...a,...a->...", self._marginal((i,)), first * first)
            else:
                both = self._marginal((i, j))
                entry = np.einsum("...ab,...a,...b->...", both, first, second, optimize=True)
            found[..., i, j] = found[..., j, i] = entry
        return found

    @cached_property
    def mode(self) -> Array:
        """The centre of the likeliest cell, (..., n)."""
        flat = self.values.reshape(*self.lead, -1).argmax(axis=-1)
        return closed(self._centres(np.asarray(flat)))

    def _centres(self, flat: Integers) -> Array:
        """The centres (..., n) of cells, given by their indices (...) in the flattened grid."""
        # One axis: NumPy 2.4 gives others than these of (n, 1) places, n above 8192.
        places = np.unravel_index(flat.reshape(-1), self.values.shape[len(self.lead) :])
        each = [centres[place] for centres, place in zip(self.centres, places, strict=True)]
        return np.stack(each, axis=-1).reshape(*flat.shape, -1)

    def _over(self, places: tuple[int, ...]) -> GridBelief:
        """The belief over the axes that have the indices `places`, in this order."""
        axes = [self._parts[k] for k in places]
        return GridBelief(axes, self._marginal(places), self.steps)

    def _drawn(self, count: int, rng: np.random.Generator) -> Array:
        """Draw `count` centres of each belief's cells by their probabilities, (count, beliefs, n).

        The leading axes are flattened to one, of all beliefs.
        """
        rows = self.values.reshape(int(np.prod(self.lead)), -1)
        drawn = np.empty((count, len(rows)), dtype=np.intp)
        for k, row in enumerate(rows):
            total = np.cumsum(row, dtype=np.float64)
            # Below one, so that no cell of probability zero is drawn.
            level = rng.random(count) * total[-1]
            drawn[:, k] = np.minimum(np.searchsorted(total, level, side="right"), len(total) - 1)
        return self._centres(drawn)

    def _at(self, index: Any, chosen: Integers) -> GridBelief:
        """The beliefs at the user's `index` of the leading axes, as `belief[index]` gives them.

        `chosen` has the places of these beliefs in the flattened leading axes. The result's `steps`
        are those that the index takes of the last leading axis; None where it takes one step, or
        takes other steps in one run than in another.
        """
        each = index if isinstance(index, tuple) else (index,)
        values = self.values.reshape(-1, *self.values.shape[len(self.lead) :])[chosen]
        steps = self.steps
        if steps is not None:
            whole = len(each) == len(self.lead) or any(part is ... for part in each)
            of_runs = whole and is_whole(each[-1])
            wide = np.broadcast_to(steps, self.lead)[index]
            steps = None if of_runs else wide.reshape(-1, wide.shape[-1])[0].copy()
            if steps is not None and not (wide == steps).all():
                steps = None
        return GridBelief(self._parts, values, steps)

    @property
    def _title(self) -> str:
        shape = " × ".join(f"{axis.label} {axis.cells}" for axis in self._parts)
        return f"GridBelief({shape}{axes(self.lead, self.steps)})"

    def _summary(self) -> Summary:
        return Summary(self._title, [moments_of(self)])

    def _marginal(self, places: tuple[int, ...]) -> Array:
        """The marginals over the axes with these indices, in this order: (..., *cells of these)."""
        if places not in self._marginals:
            count = len(self.lead)
            others = tuple(count + k for k in range(len(self._parts)) if k not in places)
            found = self.values.sum(axis=others, dtype=np.float64) if others else self.values
            order = [int(k) for k in np.argsort(np.argsort(places))]
            self._marginals[places] = found.transpose(*range(count), *(count + k for k in order))
        return self._marginals[places]

    @cached_property
    def _marginals(self) -> dict[tuple[int, ...], Array]:
        """The marginals found so far, (..., *cells of their axes), by the indices of these axes."""
        return {}

    @cached_property
    def _moments(self) -> list[tuple[Array, Array, Array]]:
        """For each axis a triple (about, offsets, mean), from which moments are computed.

        `about` (...) is the mean of the marginal, or of an angle the circular mean, counted from
        the middle of the axis (`Axis.reference`). `offsets` (..., cells) are the differences of the
        centres from it, which are wrapped to [−π, π) along an angle. `mean` (...) is the mean of
        these offsets: zero up to rounding, but not along an angle whose probabilities are not
        symmetric.
        """
        found = []
        for k, axis in enumerate(self._parts):
            marginal = self._marginal((k,))
            marginal = marginal / marginal.sum(axis=-1, keepdims=True)
            if axis.angle:
                about = np.arctan2(marginal @ np.sin(axis.offsets), marginal @ np.cos(axis.offsets))
                offsets = wrap(axis.offsets - about[..., None])
            else:
                about = marginal @ axis.offsets
                offsets = axis.offsets - about[..., None]
            found.append((about, offsets, np.einsum("...a,...a->...", marginal, offsets)))
        return found

    def _centred(self, k: int) -> Array:
        """The centres' differences (..., cells) from the mean along axis k, an angle's wrapped."""
        _, offsets, mean = self._moments[k]
        return offsets - mean[..., None]


def scope_axes(axes: Sequence[Axis], variables: Scope) -> tuple[int, ...]:
    """The indices, in `axes`, of all components of some variables, one variable after another."""
    places = {(axis.variable, axis.component): k for k, axis in enumerate(axes)}
    return tuple(places[v, k] for v in variables for k in range(v.dimension))


def require_step(variable: Variable, steps: int) -> int | None:
    """The step that a variable stands at: 3 of ``x.at(3)``; None of ``x``, which is of all steps.

    A step that is no whole number, or after the last step, `steps`, is refused by a ModelError.
    """
    if variable.step is None:
        return None
    if not is_whole(variable.step) or variable.step > steps:
        raise ModelError(
            f"{variable!r} is after the last step, {steps}", variable=variable, step=variable.step
        )
    return int(variable.step)


def closed(array: Array) -> Array:
    """The array itself, made read-only."""
    array.flags.writeable = False
    return array
