"""Confidence ellipses of two components of a Gaussian."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pgm.boundary import as_tuple, is_number, is_unordered
from pgm.display import Listing, Summary, column, places
from pgm.errors import ModelError
from pgm.factors.scope import Scope, labels, names
from pgm.kernels import moments
from pgm.kernels.arrays import Array


class Ellipse(NamedTuple):
    """The smallest region of a confidence of a two-dimensional Gaussian.

    Attributes
    ----------
    centre : ndarray
        (..., 2).
    half_axes : ndarray
        (..., 2), the longer one first: √(χ²₂(c) λᵢ), with χ²₂(c) = −2 ln(1 − c).
    orientation : ndarray
        (...), of the longer axis, atan2(v₁₂, v₁₁), radians in (−π/2, π/2]: it has no direction.
    """

    centre: Array
    half_axes: Array
    orientation: Array

    def _summary(self) -> Summary:
        lead = self.orientation.shape
        found = [place for place in places(lead) if place is not None]
        parts = np.array(
            [[*self.centre[at], *self.half_axes[at], self.orientation[at]] for at in found]
        )
        cells = np.array([column(part) for part in parts.T]).reshape(5, -1)
        rows = {place: cells[:, k].tolist() for k, place in enumerate(found)}
        heads = ["centre", "", "half-axes", "", "orientation [rad]"]
        where = [""] if lead else []
        listed = [
            None if at is None else [*([str(list(at))] if lead else []), *rows[at]]
            for at in places(lead)
        ]
        return Summary(
            "Ellipse" + (f", {lead} of them" if lead else ""),
            [Listing([*where, *heads], listed, names=len(where))],
        )

    def __repr__(self) -> str:
        return self._summary().text()

    def _repr_html_(self) -> str:
        return self._summary().html()


def confidence_ellipse(
    scope: Scope, mean: Array, cov: Array, confidence: float, components: tuple[str, str] | None
) -> Ellipse:
    """The ellipse of two components of Gaussians, by name; of the first two without."""
    known = labels(scope)
    if not is_number(confidence) or not 0.0 < confidence < 1.0:
        raise ModelError(f"a confidence lies between 0 and 1; {confidence!r} does not")
    if len(known) < 2:
        raise ModelError(f"{names(scope)} has one component; an ellipse needs two")
    pair = known[:2] if components is None else as_tuple(components)
    if pair is None or len(pair) != 2 or is_unordered(components):
        raise ModelError(f"an ellipse is of two components, not of {components!r}")
    for label in pair:
        if known.count(label) != 1 or pair[0] == pair[1]:
            raise ModelError(f"{names(scope)} has no single component {label!r}; it has {known}")
    i, j = (known.index(label) for label in pair)
    variances, orientation = moments.principal_axes(cov[..., [[i], [j]], [i, j]])
    half_axes = np.sqrt(-2.0 * np.log1p(-confidence) * variances)
    return Ellipse(mean[..., [i, j]], half_axes, orientation)
