"""Innovations of a step in a robot's loop, as an online belief shows them."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import ClassVar

import numpy as np

from pgm.display import NoArray, Shown, Summary, number
from pgm.errors import Unanswered
from pgm.immutable import Immutable
from pgm.kernels.arrays import Array, Integers, Mask
from pgm.posteriors.by_sensor import EachSensor
from pgm.posteriors.innovations import Innovations
from pgm.variables import Variable


class NoGains(dict[Variable, Array]):
    """The gains of mixtures, of which each Gaussian has its own: asked for, they are refused."""

    def copy(self) -> NoGains:
        """A mapping that refuses them too, by which innovations travel in a pickle."""
        return NoGains(self)

    def __missing__(self, variable: Variable) -> Array:
        raise Unanswered(
            "a mixture of Gaussians has no gain: each of its Gaussians has its own, and their "
            "weights change with the reading, too"
        )


class StepInnovations(Shown, NoArray, Immutable):
    """The innovations of one sensor at one step of a loop, and what the update made of them.

    They are at the belief before the update, of which the sensor was linearised last; see
    `Innovations`. The shapes are those in which the readings were given. Of sightings they are as
    below, M being their number and ``...`` the axes of runs. One reading, given by itself, has no
    axis M; if it is of a scalar sensor, it has no component axis either, so that all are numbers.
    Of a lag with iterations they are always those of all sightings of the step.

    Of a mixture of Gaussians residual and covariance are of the mixture before the update: its mean
    and covariance, the spread of its Gaussians included. The NIS has then the right mean, but no χ²
    distribution.

    Attributes
    ----------
    residual : ndarray
        (..., M, d): measurement less prediction, r; NaN as of `Innovations`.
    cov : ndarray
        (..., M, d, d): the predictive covariance of `residual`, S = F P⁻ Fᵀ + R.
    nis : ndarray
        (...): the normalised innovation squared rᵀS⁻¹r of the residuals of all components that
        were measured, and not rejected, with their joint covariance; NaN if there are none.
    dof : ndarray of int
        (...): the number of these components, less the number of their combinations of which
        nothing was known, given a flat prior.
    gain : mapping of Variable to ndarray
        By hidden variable, of n components, its rows of the Kalman gain K, (..., M, n, d): the
        update moved its mean by the sum of K r over the sightings of all sensors. Zero for
        components that were not measured, and for rejected sightings; NaN while a flat prior left
        a direction unknown. Refused of mixtures of Gaussians, of which each has its own.
    rejected : ndarray of bool
        (..., M): marks sightings that a gate has rejected.

    Examples
    --------
    >>> import pgm
    >>> from pgm.examples import walk, x, z
    >>> robot = pgm.OnlineFilter(walk)
    >>> belief = robot.update(robot.predict(robot.initial()), {z: [4.0]})
    >>> found = belief.innovations[z]
    >>> found.residual.item(), found.cov.item(), found.nis.item(), found.gain[x]
    (4.0, 4.0, 4.0, array([0.5]))

    References
    ----------
    Bar-Shalom, Li & Kirubarajan, Estimation with Applications to Tracking and Navigation, 2001,
    sections 5.4 and 11.6.
    """

    residual: Array
    cov: Array
    nis: Array
    dof: Integers
    gain: Mapping[Variable, Array]
    rejected: Mask

    _arrays: ClassVar[str] = ".residual, .cov and .nis"

    def __init__(
        self, whole: Innovations, gain: Mapping[Variable, Array], *, alone: bool = False
    ) -> None:
        *lead, _, size = whole.residual.shape
        front, own = whole.rejected.shape, (size,)
        if alone:
            front, own = tuple(lead), own * (size > 1)
        found = {
            "residual": whole.residual.reshape(front + own),
            "cov": whole.cov.reshape(front + own + own),
            "rejected": whole.rejected.reshape(front),
            "nis": whole.nis[..., 0],
            "dof": whole.dof[..., 0],
        }
        gains = dict(gain) if not isinstance(gain, NoGains) else gain
        for x, rows in gains.items():
            gains[x] = rows.reshape((*front, rows.shape[-2], *own))
        for array in (*found.values(), *gains.values()):
            array.flags.writeable = False
        self._set(**found, gain=MappingProxyType(gains))

    @property
    def _title(self) -> str:
        runs = f", runs {self.nis.shape}" if self.nis.shape else ""
        return f"StepInnovations({self.dof.sum():,} components{runs})"

    def _summary(self) -> Summary:
        read = self.dof.sum()
        told = f"NIS {number(np.nansum(self.nis) / read)} a component (right: 1)"
        return Summary(self._title, [told if read else "nothing read"])


class StepInnovationsBySensor(EachSensor[StepInnovations]):
    """The innovations of a step (`StepInnovations`) by sensor, of each that was read."""

    _what = "innovations"

    def _summary(self) -> Summary:
        return Summary(self._title, [f"{v!r}: {found._title}" for v, found in self.items()])
