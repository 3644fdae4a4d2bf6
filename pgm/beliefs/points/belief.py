"""Beliefs by point masses, cells or particles: their means, marginals and draws."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import Any, Self

import numpy as np

from pgm.arguments import public
from pgm.boundary import as_generator, as_lengths
from pgm.display import NoArray, Shown
from pgm.errors import ModelError
from pgm.factors import Gaussian
from pgm.factors.listing import Framed
from pgm.factors.scope import places_of, whole_variables
from pgm.immutable import Immutable
from pgm.kernels.arrays import Array, Integers


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

    @property
    def units(self) -> tuple[str, ...]:
        """The units of the components, as their variables say; empty where none is known."""
        parts = ((part.variable, part.component) for part in self._parts)
        return tuple(variable.unit_of(variable.components[k]) for variable, k in parts)

    @cached_property
    def mean(self) -> Array:
        """The means, (..., n).

        The mean of an angle is its circular mean plus the mean of the differences from that; both
        they and the mean are wrapped to [−π, π).
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


def closed(array: Array) -> Array:
    """The array itself, made read-only."""
    array.flags.writeable = False
    return array
