"""Beliefs on a grid: probabilities of cells, and what is asked of them."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

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


class GridBelief(Framed, Shown, NoArray, Immutable):
    r"""A belief as probabilities of the cells of a grid.

    .. math:: p(x) = \sum_k p_k \, δ(x - c_k)

    - c_k: the centres of cells, `centres` along each axis;
    - p_k: their probabilities, `values`.

    Leading axes are independent beliefs: runs, and, where `steps` says so, steps in time. Means and
    covariances are those of the point masses; those of angles are taken about the circular mean μ°,
    the direction of Σ p_k (cos c_k, sin c_k), of differences wrapped to [−π, π).

    Attributes
    ----------
    components : tuple of str
        In the order of the axes of cells.
    centres : tuple of ndarray
        (cells,) of each axis; those of an angle go round the circle from −π on.
    values : ndarray
        (..., *cells), of sum one, or float32 where the grid has that `dtype`.
    steps : ndarray of int or None
        The steps that the last leading axis stands for.

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

    components: tuple[str, ...]
    centres: tuple[Array, ...]
    values: npt.NDArray[Any]
    steps: Integers | None
    _axes: tuple[Axis, ...]

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
            _axes=tuple(axes),
        )

    @property
    def angles(self) -> tuple[str, ...]:
        """The components that are angles."""
        return tuple(axis.label for axis in self._axes if axis.angle)

    @property
    def lead(self) -> tuple[int, ...]:
        """The leading axes: runs and steps."""
        return self.values.shape[: self.values.ndim - len(self._axes)]

    @cached_property
    def mean(self) -> Array:
        """The means, (..., n); those of angles within half a turn of their circular mean."""
        each = [
            axis.reference + about + offset
            for axis, (about, _, offset) in zip(self._axes, self._moments, strict=True)
        ]
        return _frozen(np.stack(each, axis=-1))

    @cached_property
    def cov(self) -> Array:
        """The covariances, (..., n, n)."""
        count = len(self._axes)
        found = np.empty((*self.lead, count, count))
        for i, j in itertools.combinations_with_replacement(range(count), 2):
            first, second = self._centred(i), self._centred(j)
            if i == j:
                entry = np.einsum("...a,...a->...", self._marginal((i,)), first * first)
            else:
                both = self._marginal((i, j))
                entry = np.einsum("...ab,...a,...b->...", both, first, second, optimize=True)
            found[..., i, j] = found[..., j, i] = entry
        return _frozen(found)

    @cached_property
    def std(self) -> Array:
        """The standard deviations, (..., n)."""
        return _frozen(np.sqrt(np.einsum("...ii->...i", self.cov)))

    @cached_property
    def mode(self) -> Array:
        """The centre of the likeliest cell, (..., n)."""
        flat = self.values.reshape(*self.lead, -1).argmax(axis=-1)
        places = np.unravel_index(flat, self.values.shape[len(self.lead) :])
        return _frozen(self._at(places))

    def _at(self, places: Sequence[Integers]) -> Array:
        each = [centres[place] for centres, place in zip(self.centres, places, strict=True)]
        return np.stack(each, axis=-1)

    def marginal(self, *components: str) -> GridBelief:
        """The belief over some components alone.

        Parameters
        ----------
        *components : str
            By name, in the order wanted.

        Raises
        ------
        ModelError
            If one is no component, or named twice, or none is named.
        """
        return self._over(places_of(self._axes, components, "a marginal"))

    def _over(self, places: tuple[int, ...]) -> GridBelief:
        axes = [self._axes[k] for k in places]
        return GridBelief(axes, self._marginal(places), self.steps)

    def sample(self, size: int | tuple[int, ...] = (), *, rng: np.random.Generator | int) -> Array:
        """Draws of the centres of cells.

        Parameters
        ----------
        size : int or tuple of int
            How many of each belief.
        rng : numpy.random.Generator or int
            The generator of draws, or its seed.

        Returns
        -------
        ndarray
            (*size, ..., n).

        Raises
        ------
        ModelError
            If `size` is no number of draws, or `rng` is neither a generator nor a seed.
        """
        extra, generator = as_lengths(size, "of each belief"), as_generator(rng)
        cells = self.values.shape[len(self.lead) :]
        rows = self.values.reshape(-1, int(np.prod(cells)))
        count = int(np.prod(extra))
        drawn = np.empty((count, len(rows)), dtype=np.intp)
        for k, row in enumerate(rows):
            total = np.cumsum(row, dtype=np.float64)
            # Below one, so that no cell of probability zero is drawn.
            level = generator.random(count) * total[-1]
            drawn[:, k] = np.minimum(np.searchsorted(total, level, side="right"), len(total) - 1)
        return self._at(np.unravel_index(drawn.reshape(*extra, *self.lead), cells))

    def gaussian(self) -> Gaussian:
        """The normal density of the same mean and covariance, over the variables of the components.

        Raises
        ------
        ModelError
            If the components are not all those of some variables, in their order.
        """
        variables = whole_variables(self._axes)
        return Gaussian(variables, self.mean, self.cov, steps=self.steps)

    def __getitem__(self, index: Any) -> GridBelief:
        """The beliefs at some places of the leading axes: of a run, or of a step.

        Parameters
        ----------
        index : int, slice or tuple of them
            As of an array of the shape of the leading axes.

        Raises
        ------
        ModelError
            If the leading axes have no such place.
        """
        try:
            kept = np.empty(self.lead, dtype=bool)[index]
            places = (*(index if isinstance(index, tuple) else (index,)), ...)
            values = self.values[(*places, *(slice(None),) * len(self._axes))]
        except IndexError as error:
            raise ModelError(f"a belief with the leading axes {self.lead}: {error}") from error
        steps = self.steps
        if steps is not None:
            wide = np.broadcast_to(steps, self.lead)[index]
            steps = wide.reshape(-1, wide.shape[-1])[0].copy() if kept.ndim else None
            if steps is not None and not (wide == steps).all():
                steps = None
        return GridBelief(self._axes, values, steps)

    @property
    def _title(self) -> str:
        shape = " × ".join(f"{axis.label} {axis.cells}" for axis in self._axes)
        return f"GridBelief({shape}{axes(self.lead, self.steps)})"

    def _summary(self) -> Summary:
        return Summary(self._title, [moments_of(self)])

    def _marginal(self, places: tuple[int, ...]) -> Array:
        """The probabilities (..., cells of the axes), in the order given."""
        if places not in self._marginals:
            count = len(self.lead)
            others = tuple(count + k for k in range(len(self._axes)) if k not in places)
            found = self.values.sum(axis=others, dtype=np.float64) if others else self.values
            order = [int(k) for k in np.argsort(np.argsort(places))]
            self._marginals[places] = found.transpose(*range(count), *(count + k for k in order))
        return self._marginals[places]

    @cached_property
    def _marginals(self) -> dict[tuple[int, ...], Array]:
        return {}

    @cached_property
    def _moments(self) -> list[tuple[Array, Array, Array]]:
        """Of each axis: a place about which offsets count, the offsets, and their mean."""
        found = []
        for k, axis in enumerate(self._axes):
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
        """The differences (..., cells) of centres from the mean along one axis."""
        _, offsets, mean = self._moments[k]
        return offsets - mean[..., None]

    def __getstate__(self) -> dict[str, Any]:
        # What was computed is not part of the value.
        return {name: getattr(self, name) for name in GridBelief.__annotations__}


def scope_axes(axes: Sequence[Axis], variables: Scope) -> tuple[int, ...]:
    """The places of the axes of some variables, in the order of their components."""
    places = {(axis.variable, axis.component): k for k, axis in enumerate(axes)}
    return tuple(places[v, k] for v in variables for k in range(v.dimension))


def require_step(variable: Variable, steps: int) -> int | None:
    """The step of a variable, if it has one that the chain has."""
    if variable.step is None:
        return None
    if not is_whole(variable.step) or variable.step > steps:
        raise ModelError(
            f"{variable!r} is after the last step, {steps}", variable=variable, step=variable.step
        )
    return int(variable.step)


def _frozen(array: Array) -> Array:
    array.flags.writeable = False
    return array
