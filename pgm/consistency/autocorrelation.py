"""Whiteness of innovations: a filter with correlated innovations leaves information unused."""

from dataclasses import dataclass

import numpy as np
from scipy.special import gammaincc

from pgm.arguments import public
from pgm.consistency.errors import check_count, check_innovations
from pgm.consistency.regions import chi_squared, normal
from pgm.display import Shown, Summary, count, number, table
from pgm.errors import ModelError
from pgm.inference import Innovations
from pgm.kernels.arrays import Array, Integers
from pgm.posteriors.innovations import autocorrelation, whitened


@dataclass(frozen=True, eq=False, repr=False)
class Whiteness(Shown):
    """The autocorrelation of whitened innovations, and its band under whiteness.

    Attributes
    ----------
    lags : ndarray of int
        (L,): 1 and up, counted in steps at which the sensor was read.
    autocorrelation : ndarray
        (L,), in [−1, 1]; NaN where no two measurements are that far apart.
    band : ndarray
        (L,): its size stays below with the confidence asked for, at each lag by itself.
    statistic : float
        The sum of squared autocorrelations, each by its own variance: χ² for white innovations.
    dof : int
        Its degrees of freedom, the number of lags that are known.
    limit : float
        The statistic stays below it with the confidence asked for.

    Examples
    --------
    >>> from pgm.examples import walk, z
    >>> filtered = pgm.filter(walk, {z: [[2.0], [3.0], [1.0], [0.0], [2.0]]})
    >>> found = pgm.consistency.whiteness(filtered.innovations[z], lags=2)
    >>> found.inside, found.dof
    (True, 2)
    """

    lags: Integers
    autocorrelation: Array
    band: Array
    statistic: float
    dof: int
    limit: float

    @property
    def inside(self) -> bool:
        """Whether the statistic stays below its limit: nothing speaks against white."""
        return self.statistic <= self.limit

    @property
    def _title(self) -> str:
        verdict = "white" if self.inside else "not white"
        return (
            f"Whiteness({verdict}: statistic {number(self.statistic)}, limit "
            f"{number(self.limit)}, {count(self.dof, 'degree')} of freedom)"
        )

    def _summary(self) -> Summary:
        columns = [("lag", self.lags), ("autocorrelation", self.autocorrelation)]
        return Summary(self._title, [table([*columns, ("band ±", self.band)])])

    @property
    def probability(self) -> float:
        """The probability that white innovations have a larger statistic."""
        return float(gammaincc(0.5 * self.dof, 0.5 * self.statistic))


@public
def whiteness(innovations: Innovations, lags: int = 20, *, confidence: float = 0.95) -> Whiteness:
    r"""The autocorrelation of innovations, whitened by their own covariances.

    .. math:: w = S^{-1/2} r, \qquad p_l(t) = w_t^\top w_{t+l}, \qquad
        \rho_l = \frac{\sum p_l}{\sqrt{\sum |w_t|^2 \sum |w_{t+l}|^2}}

    Sums are over steps and runs. Innovations of an exact filter are independent from step to
    step; its ρ_l has the variance Σ p_l² / (Σ |w_t|² Σ |w_{t+l}|²), which for one measurement a
    step tends to 1/N, N the number of products of components summed, and which allows for
    several measurements of one step sharing its prediction. The k-th measurement of a step meets
    that of a later one: sightings of several landmarks are best given in one order. `nis` says
    what innovations are after iterating.

    Parameters
    ----------
    innovations : Innovations
        As ``posterior.innovations[z]``; components that were not taken are left out.
    lags : int
        From 1 to this, in steps with measurements.
    confidence : float
        Probability of the band and below the limit.

    Raises
    ------
    ModelError
        If there are no more steps with measurements than lags, or no run was read at two of them;
        or if an argument is not what it should be.

    Examples
    --------
    >>> from pgm.examples import walk, z
    >>> filtered = pgm.filter(walk, {z: [[2.0], [3.0], [1.0], [0.0], [2.0]]})
    >>> pgm.consistency.whiteness(filtered.innovations[z], lags=2).lags
    array([1, 2])

    References
    ----------
    Bar-Shalom, Li & Kirubarajan, Estimation with Applications to Tracking and Navigation, 2001,
    section 5.4.2; Box & Pierce, Distribution of residual autocorrelations, 1970.
    """
    white = whitened(check_innovations(innovations))
    check_count("lags", lags)
    if lags >= len(white):
        raise ModelError(
            f"lags = {lags} for measurements at {len(white)} steps; ask for fewer than there are "
            "steps with measurements"
        )
    z = normal(confidence)
    correlation, deviation = np.array(
        [autocorrelation(white[:-lag], white[lag:]) for lag in range(1, lags + 1)]
    ).T
    known = deviation > 0.0
    statistic = float(np.sum((correlation[known] / deviation[known]) ** 2))
    dof = int(known.sum())
    if not dof:
        raise ModelError(f"no run was read at two steps {lags} or fewer measurements apart")
    limit = float(chi_squared(confidence, dof))
    return Whiteness(np.arange(1, lags + 1), correlation, z * deviation, statistic, dof, limit)
