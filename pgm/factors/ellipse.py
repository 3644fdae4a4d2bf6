"""Ellipses of confidence."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pgm.display import Listing, Summary, column, places
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
        (...), of the longer axis, in radians, atan2(v₁₂, v₁₁).
    """

    centre: Array
    half_axes: Array
    orientation: Array

    @classmethod
    def make(cls, mean: Array, cov: Array, confidence: float) -> Ellipse:
        """The ellipse of means (..., 2) and covariances (..., 2, 2)."""
        variances, orientation = moments.principal_axes(cov)
        return cls(mean, np.sqrt(-2.0 * np.log1p(-confidence) * variances), orientation)

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
