"""Quantiles of statistics, and whether confidence regions hold the truth as often as they say."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.special import betaincinv, gammaincinv, ndtri

from pgm.arguments import public
from pgm.consistency.errors import check_confidence, nees_and_dof, nothing_known
from pgm.display import Shown, Summary, table
from pgm.display import count as counted
from pgm.errors import ModelError
from pgm.factors import Gaussian
from pgm.kernels.arrays import Array, Mask


@dataclass(frozen=True, eq=False, repr=False)
class Coverage(Shown):
    """The share of truths inside regions of a confidence.

    Attributes
    ----------
    nominal : ndarray
        (...): the confidence of the region.
    actual : ndarray
        (...): the share of truths inside it.
    low, high : ndarray
        (...): the binomial interval of the region's probability, from the runs alone.
    runs : int
        How many of them, independent of each other; those of which some truth is known.
    count : int
        How many truths, of all runs and steps.

    Examples
    --------
    >>> x = pgm.Variable("x")
    >>> four_runs = pgm.Gaussian(x, mean=[[0.0], [1.0], [-1.0], [3.0]], cov=1.0)
    >>> pgm.consistency.coverage(four_runs, truth=[0.0])
    Coverage(4 runs, 4 truths)
      1 of 1 confidences inside the interval
      nominal  actual     low    high
         0.95    0.75  0.1109  0.9987
    """

    nominal: Array
    actual: Array
    low: Array
    high: Array
    runs: int
    count: int

    @property
    def _title(self) -> str:
        return f"Coverage({counted(self.runs, 'run')}, {counted(self.count, 'truth')})"

    def _summary(self) -> Summary:
        nominal = np.ravel(self.nominal)
        names = ("actual", "low", "high")
        columns = [("nominal", nominal), *((name, np.ravel(getattr(self, name))) for name in names)]
        inside = f"{int(np.sum(self.inside))} of {nominal.size} confidences inside the interval"
        return Summary(self._title, [inside, table(columns)])

    @property
    def inside(self) -> Mask:
        """Whether the confidence lies in the interval."""
        return np.asarray((self.low <= self.nominal) & (self.nominal <= self.high))


@public
def coverage(
    belief: Gaussian,
    truth: npt.ArrayLike,
    confidence: npt.ArrayLike = 0.95,
    components: Sequence[str] = (),
    *,
    band: float = 0.99,
) -> Coverage:
    r"""The share of confidence regions that hold the truth.

    .. math:: \{x : (x - \mu)^\top P^{-1} (x - \mu) \le \chi^2_n(c)\}

    The interval of the probability is that of Clopper and Pearson. Steps of one run depend on
    each other: they sharpen the share, but only runs count as trials, so that the interval is
    rather too wide than too narrow. Where the truth of some components is not known, the region is
    that of the others.

    Parameters
    ----------
    belief : Gaussian
        Over runs and steps, as ``posterior[x]``; without steps, all its leading axes are runs.
    truth : array_like
        (..., n), its leading axes as `error` asks for.
    confidence : array_like
        (...): the probability c of the region, or several, of which the result has the shape.
    components : sequence of str
        Whose region, two for an ellipse in the plane; all without.
    band : float
        Probability of the interval.

    Raises
    ------
    ModelError
        If a confidence or the band is not between 0 and 1, the truth or a component does not fit
        the belief, or no truth is known.
    NumericalError
        If a covariance is singular.

    Examples
    --------
    >>> x = pgm.Variable("x")
    >>> four_runs = pgm.Gaussian(x, mean=[[0.0], [1.0], [-1.0], [3.0]], cov=1.0)
    >>> found = pgm.consistency.coverage(four_runs, truth=[0.0], confidence=[0.5, 0.95])
    >>> found.actual
    array([0.25, 0.75])
    >>> found.inside
    array([ True,  True])

    References
    ----------
    Clopper & Pearson, The use of confidence or fiducial limits illustrated in the case of the
    binomial, 1934.
    """
    nominal = check_confidence(confidence)
    squares, dof = nees_and_dof(belief, truth, components)
    known = dof > 0
    count = int(known.sum())
    if not count:
        raise nothing_known(belief, components)
    held = np.zeros(nominal.shape, dtype=np.intp)
    for degrees in np.unique(dof[known]):
        ordered = np.sort(squares[dof == degrees])
        held += np.searchsorted(ordered, chi_squared(nominal, degrees), side="right")
    actual = held / count
    runs = int((known if belief.steps is None else known.any(axis=-1)).sum())
    return Coverage(nominal, actual, *clopper_pearson(actual, runs, band), runs, count)


def tails(confidence: float) -> tuple[float, float]:
    """The probabilities below the lower and below the upper end of a two-sided band."""
    value = check_confidence(confidence)
    if value.ndim:
        raise ModelError(f"a band has one confidence, not {value.size} of them; ask for each")
    return 0.5 * float(1.0 - value), 0.5 * float(1.0 + value)


def chi_squared(probability: npt.ArrayLike, dof: npt.ArrayLike) -> Array:
    """The quantile of χ² with `dof` degrees of freedom."""
    half = 0.5 * np.asarray(dof, dtype=float)
    return np.asarray(2.0 * gammaincinv(half, np.asarray(probability, dtype=float)))


def normal(confidence: float) -> float:
    """The z with P(|n| ≤ z) = confidence for a standard normal n."""
    return float(ndtri(tails(confidence)[1]))


def clopper_pearson(share: Array, count: int, confidence: float) -> tuple[Array, Array]:
    """The exact two-sided interval of a probability, from the share of `count` trials it won."""
    low, high = tails(confidence)
    won = share * count
    lost = count - won
    # The incomplete beta function has no inverse at zero trials won or lost.
    below = np.where(won > 0.0, betaincinv(np.maximum(won, 1e-9), lost + 1.0, low), 0.0)
    above = np.where(lost > 0.0, betaincinv(won + 1.0, np.maximum(lost, 1e-9), high), 1.0)
    return below, above
