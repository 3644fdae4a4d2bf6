"""Beliefs on a grid: probabilities of cells, and the means, marginals and draws read from them."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from pgm.beliefs.grid.lattice import Axis
from pgm.beliefs.points.belief import PointMassBelief, closed
from pgm.boundary import is_whole
from pgm.display import Summary, axes
from pgm.factors.scope import Scope
from pgm.kernels.angles import wrap
from pgm.kernels.arrays import Array, Integers
from pgm.posteriors.summaries import moments_of


class GridBelief(PointMassBelief):
    r"""A belief as probabilities of the cells of a grid.

    .. math:: p(x) = \sum_k p_k \, δ(x - c_k)

    - c_k: the centres of cells, `centres` along each axis;
    - p_k: their probabilities, `values`.

    Leading axes are independent beliefs: runs, and, where `steps` says so, steps in time. Means and
    covariances are those of the point masses. Those of an angle come from its differences, wrapped
    to [−π, π), from the circular mean μ°, the direction of Σ p_k (cos c_k, sin c_k): the mean is μ°
    plus the mean difference, wrapped to [−π, π).

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
        """The means (..., n); an angle's is its circular mean plus the mean offset, wrapped."""
        each = []
        for axis, (about, _, offset) in zip(self._parts, self._moments, strict=True):
            mean = axis.reference + about + offset
            # Near the cut the offset may lead out of [−π, π).
            each.append(wrap(mean) if axis.angle else mean)
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

    def non_gaussianity(self) -> Array:
        r"""KL from the belief's density to the Gaussian of its mean and covariance, (...), in nats.

        .. math:: KL(p \| N_p) = \tfrac12 \ln |2πe P| + \sum_k p_k \ln (p_k / V)

        - p_k / V: the density in a cell of volume V;
        - P: the covariance.

        NaN where the covariance is singular. It is right where the density is smooth over a cell;
        one that is negative tells that cells are too wide for the belief. Angles count as if their
        line had no ends.
        """
        rows = self.values.reshape(-1, int(np.prod(self.values.shape[len(self.lead) :])))
        entropy = np.empty(len(rows))
        for k, row in enumerate(rows):  # one at a time: all of them may not fit twice
            some = row[row > 0.0].astype(np.float64)
            some /= some.sum()
            entropy[k] = -(some @ np.log(some))
        volume = np.prod([centres[1] - centres[0] for centres in self.centres])
        sign, log_det = np.linalg.slogdet(self.cov)
        normal = 0.5 * (log_det + self.cov.shape[-1] * np.log(2.0 * np.pi * np.e))
        density = entropy.reshape(self.lead) + np.log(volume)
        found: Array = np.where((sign > 0.0) & np.isfinite(log_det), normal - density, np.nan)
        return found

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
