"""Innovations ν = z − h(x̂) of measurements z at predicted means x̂, as a posterior shows them.

The NIS is the normalised innovation squared νᵀS⁻¹ν, S being the innovation's covariance. A sighting
is one measurement of a sensor, of d components; a step may have several.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from pgm.display import NoArray, Shown, Summary, number, stacked
from pgm.kernels import roots, solving
from pgm.kernels.arrays import Array, Integers, Mask, independent, inner
from pgm.posteriors.by_sensor import EachSensor


@dataclass(frozen=True, eq=False, repr=False)
class Innovations(Shown, NoArray):
    """The innovations of one sensor, one row a sighting, in the order of the evidence.

    Where measurements z were linearised several times, the innovations are those of the last
    linearisation F x + b, z − (F x⁻ + b), at the predicted mean x⁻; not z − h(x⁻). In the shapes
    ``...`` stands for the user's axes of runs, none for one run; M is the number of sightings, and
    T the last step.

    Attributes
    ----------
    residual : ndarray
        (..., M, d): measurement less prediction; NaN in components that were not measured, and in
        those that depend on a direction of which nothing is known yet, given a flat prior.
    cov : ndarray
        (..., M, d, d): the predictive covariance of `residual`, S = F P⁻ Fᵀ + R, with the predicted
        covariance P⁻ and that of the noise, R; NaN in rows and columns of the components in which
        `residual` is NaN.
    step : ndarray of int
        (M,): the step of each sighting.
    nis : ndarray
        (..., T+1): the normalised innovation squared of each step, rᵀS⁻¹r of the residuals r of all
        components measured at the step, with their joint covariance S; NaN if none was measured.
        While a flat prior leaves a direction unknown, it is the limit of the NIS of wide priors.
    dof : ndarray of int
        (..., T+1): the number of components measured at each step, less the number of their
        combinations of which nothing was known, given a flat prior.
    rejected : ndarray of bool
        (..., M): marks sightings that a gate has rejected: they have a residual and a covariance,
        but do not count in `nis` and `dof`.

    Examples
    --------
    >>> from pgm.examples import walk, z
    >>> found = pgm.filter(walk, {z: [[4.0]]}).innovations[z]
    >>> found.residual, found.cov, found.nis
    (array([[4.]]), array([[[4.]]]), array([nan,  4.]))
    """

    residual: Array
    cov: Array
    step: Integers
    nis: Array
    dof: Integers
    rejected: Mask = field(default_factory=lambda: np.zeros((), dtype=bool))

    _arrays: ClassVar[str] = ".residual, .cov and .nis"

    @property
    def _title(self) -> str:
        *lead, count, size = self.residual.shape
        runs = f", runs {tuple(lead)}" if lead else ""
        steps = f" at steps {self.step.min()}..{self.step.max()}" if count else ""
        return f"Innovations({count} of {size} components{steps}{runs})"

    def _summary(self) -> Summary:
        size = self.residual.shape[-1]
        squares, read = np.nansum(self.nis), self.dof.sum()
        said = f"NIS {number(squares / read)} a component (right: 1)" if read else "nothing read"

        def moments(at: tuple[int, ...]) -> tuple[Array, Array]:
            return self.residual[at], self.cov[at]

        shape = self.residual.shape[:-1]
        return Summary(
            self._title,
            [said, stacked(["residual"] + [""] * (size - 1), shape, self.step, moments)],
        )


class BySensor(EachSensor[Innovations]):
    """A mapping of the variables of sensors to their innovations."""

    _what = "innovations"

    def _summary(self) -> Summary:
        return Summary(self._title, [f"{v!r}: {found._title}" for v, found in self.items()])


def whitened(innovations: Innovations) -> Array:
    """The innovations of a sensor by step, each whitened by its own S = L Lᵀ: L⁻¹ν.

    L is lower triangular. The result is (steps, runs, k, d), k being the largest number of
    sightings of a step, with zeros for what is missing or rejected. Steps at which all is zero are
    left out.
    """
    shape = innovations.residual.shape
    runs = math.prod(shape[:-2])
    residual = innovations.residual.reshape(runs, *shape[-2:])
    cov = innovations.cov.reshape(*residual.shape, shape[-1])
    rejected = np.broadcast_to(innovations.rejected, shape[:-1]).reshape(residual.shape[:2])
    taken = ~np.isnan(residual) & ~rejected[..., None]
    white = solving.whiten(roots.root(independent(cov, taken)), np.where(taken, residual, 0.0))

    order = np.argsort(innovations.step, kind="stable")
    _, first, step, counts = np.unique(
        innovations.step[order], return_index=True, return_inverse=True, return_counts=True
    )
    result = np.zeros((counts.size, runs, max(counts, default=0), shape[-1]))
    result[step, :, np.arange(order.size) - first[step]] = white[:, order].swapaxes(0, 1)
    return result[np.any(result, axis=(1, 2, 3))]


def autocorrelation(now: Array, later: Array) -> tuple[float, float]:
    """The correlation of whitened innovations with later ones, and its standard deviation if white.

    `now` and `later` are (steps, runs, k, d): whitened innovations of k sightings a step, zeros for
    what is missing. The sighting at each place of `now` is paired with that at the same place of
    `later`. The correlation is one number for all pairs, runs and components. Both results are NaN
    if there is no pair of sightings that were both measured and not rejected.
    """
    met = inner(now, now) * inner(later, later) > 0.0
    now, later = now[met], later[met]
    scale = np.sqrt(np.sum(now**2) * np.sum(later**2))
    if scale == 0.0:
        return np.nan, np.nan
    product = np.zeros(met.shape)
    product[met] = inner(now, later)
    # The measurements of one step are not independent of each other: their products are one term.
    terms = product.sum(axis=-1)
    return float(terms.sum() / scale), float(np.sqrt(np.sum(terms**2)) / scale)
