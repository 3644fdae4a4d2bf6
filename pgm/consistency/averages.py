"""Averages of normalised errors squared, in the χ² band that right ones keep to."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from pgm.arguments import public
from pgm.boundary import as_floats
from pgm.consistency.errors import check_count, check_innovations, nees_and_dof
from pgm.consistency.regions import chi_squared, tails
from pgm.display import Listing, Shown, Summary, column, count, number, places
from pgm.errors import ModelError
from pgm.factors import Gaussian
from pgm.inference import Innovations
from pgm.kernels.arrays import Array, Integers, Mask


@dataclass(frozen=True, eq=False, repr=False)
class Average(Shown):
    """The mean of normalised errors squared, beside the two-sided χ² band of a right belief.

    Attributes
    ----------
    value : ndarray
        (...): the mean; NaN where there is nothing to average.
    low, high : ndarray
        (...): the band, within which a right belief has it with the confidence asked for.
    dof : ndarray
        (...): degrees of freedom of the sum.
    count : ndarray of int
        (...): how many were averaged.

    Examples
    --------
    >>> found = pgm.consistency.average([1.0, 3.0], dof=2)
    >>> found
    Average(2, band 0.1035 to 7.43, expected 2, of 2 errors)
    >>> bool(found.inside)
    True
    """

    value: Array
    low: Array
    high: Array
    dof: Array
    count: Integers

    @property
    def expected(self) -> Array:
        """The mean under a consistent belief: its degrees of freedom, averaged."""
        return _quotient(self.dof, self.count)

    @property
    def inside(self) -> Mask:
        """Whether the mean lies in its band; a mean of nothing does not."""
        return np.asarray((self.low <= self.value) & (self.value <= self.high))

    @property
    def _title(self) -> str:
        if np.ndim(self.value):
            return f"Average({np.shape(self.value)} of them)"
        each = (self.value, self.low, self.high, self.expected)
        value, low, high, expected = (number(float(part)) for part in each)
        return (
            f"Average({value}, band {low} to {high}, expected {expected}, of "
            f"{count(int(self.count), 'error')})"
        )

    def _summary(self) -> Summary:
        shape = np.shape(self.value)
        if not shape:
            return Summary(self._title)
        known, inside = int((self.count > 0).sum()), int(self.inside.sum())
        heads = ["", "value", "low", "high", "expected", "of"]
        shown = places(shape)
        found = [place for place in shown if place is not None]
        each = [self.value, self.low, self.high, self.expected, self.count]
        cells = zip(*(column([part[at] for at in found]) for part in each), strict=True)
        rows = dict(zip(found, cells, strict=True))
        listing = Listing(
            heads, [None if at is None else [str(list(at)), *rows[at]] for at in shown]
        )
        return Summary(self._title, [f"{inside} of {known} inside their band", listing])

    def per_dof(self) -> Average:
        """The averages divided by their expected values, so that a consistent filter has 1."""
        value, low, high = (
            _quotient(part * self.count, self.dof) for part in (self.value, self.low, self.high)
        )
        return Average(value, low, high, self.dof, self.dof.astype(np.intp))

    def overall(self) -> Average:
        """One mean over all statistics, with the mean of their bands.

        The errors of a run at two steps depend on each other, so that a mean over steps varies more
        than one of as many runs. This band is wider than due where they depend less; take `average`
        for independent ones.
        """
        count = self.count.sum()
        value, low, high = (
            _quotient(np.sum(np.where(self.count > 0, part * self.count, 0.0)), count)
            for part in (self.value, self.low, self.high)
        )
        return Average(value, low, high, self.dof.sum(), count)


@public
def average(
    squares: npt.ArrayLike,
    dof: npt.ArrayLike,
    *,
    axis: int | tuple[int, ...] | None = None,
    confidence: float = 0.99,
) -> Average:
    r"""The average of independent normalised squared errors, with its band.

    .. math:: \bar\epsilon = \frac1N \sum_i \epsilon_i, \qquad
        N \bar\epsilon \sim \chi^2_{\sum_i d_i}

    Runs are independent; steps of one run are not, but for the innovations of an exact filter: a
    mean over them leaves this band too often, see `Average.overall`.

    Parameters
    ----------
    squares : array_like
        Normalised errors squared, NaN where there is none.
    dof : array_like
        Degrees of freedom of each, above 0 where there is an error; they broadcast.
    axis : int or tuple of int, optional
        The axes averaged over; all without.
    confidence : float
        Probability of the band.

    Raises
    ------
    ModelError
        If the degrees of freedom do not fit or are none, or the confidence is not between 0 and 1.

    Examples
    --------
    >>> found = pgm.consistency.average([[1.0, 3.0], [2.0, 6.0]], dof=2, axis=0)
    >>> found.value
    array([1.5, 4.5])
    >>> found.expected
    array([2., 2.])

    References
    ----------
    Bar-Shalom, Li & Kirubarajan, Estimation with Applications to Tracking and Navigation, 2001,
    section 5.4.2.
    """
    values = as_floats(squares, "normalised errors")
    each = as_floats(dof, "degrees of freedom")
    try:
        each = np.broadcast_to(each, values.shape)
    except ValueError:
        raise ModelError(
            f"degrees of freedom of shape {np.shape(dof)} for normalised errors of shape "
            f"{values.shape}; they must broadcast"
        ) from None
    there = ~np.isnan(values)
    if not (np.isfinite(each) & (each > 0.0))[there].all():
        raise ModelError(
            f"a normalised error has degrees of freedom above 0; {dof!r} are not all so"
        )
    count = np.sum(there, axis=axis)
    total = np.sum(np.where(there, each, 0.0), axis=axis)
    value = _quotient(np.sum(np.where(there, values, 0.0), axis=axis), count)
    low, high = (_quotient(chi_squared(p, total), count) for p in tails(confidence))
    return Average(value, low, high, total, count)


@public
def anees(
    belief: Gaussian,
    truth: npt.ArrayLike,
    components: Sequence[str] = (),
    *,
    confidence: float = 0.99,
) -> Average:
    """The NEES at each step, averaged over runs, (T+1,); over all of a belief without steps.

    The band is that of the sum of degrees of freedom, which differ with how much of the truth is
    known. Above it the belief claims too much, below it too little.

    Parameters
    ----------
    belief : Gaussian
        Over steps, as ``posterior[x]``; without steps, all its leading axes are runs.
    truth : array_like
        (..., n), its leading axes as `error` asks for.
    components : sequence of str
        Whose marginal is judged; all without.
    confidence : float
        Probability of the band, at each step.

    Returns
    -------
    Average
        (T+1,), or () of a belief without steps; NaN at steps where no truth is known.

    Raises
    ------
    ModelError
        If an argument does not fit the belief, or the confidence is not between 0 and 1.
    NumericalError
        If a covariance is singular.

    Examples
    --------
    >>> x = pgm.Variable("x")
    >>> two_runs = pgm.Gaussian(x, mean=[[[2.0]], [[4.0]]], cov=4.0, steps=[0])
    >>> pgm.consistency.anees(two_runs, truth=[[0.0]]).value
    array([2.5])
    """
    squares, dof = nees_and_dof(belief, truth, components)
    return average(squares, dof, axis=run_axes(squares, belief.steps), confidence=confidence)


@public
def anis(innovations: Innovations, *, confidence: float = 0.99) -> Average:
    """The NIS at each step, averaged over the runs that read the sensor there, (T+1,).

    The band is that of the sum of degrees of freedom, which differ with what was read. For all
    steps together give `average` ``innovations.nis`` and ``innovations.dof``; `nis` says what
    innovations are after iterating.

    Parameters
    ----------
    innovations : Innovations
        For instance ``posterior.innovations[z]``.
    confidence : float
        Probability of the band, at each step.

    Returns
    -------
    Average
        (T+1,); NaN at steps where the sensor was not read.

    Raises
    ------
    ModelError
        If they are no innovations, or the confidence is not between 0 and 1.

    Examples
    --------
    >>> from pgm.examples import walk, z
    >>> filtered = pgm.filter(walk, {z: [[2.0], [3.0]]})
    >>> pgm.consistency.anis(filtered.innovations[z]).value
    array([nan,  1.,  1.])
    """
    found = check_innovations(innovations)
    axes = tuple(range(found.nis.ndim - 1))
    return average(found.nis, found.dof, axis=axes, confidence=confidence)


@public
def mean_band(dof: int, count: int, confidence: float = 0.99) -> tuple[float, float]:
    """The two-sided χ² band, (low, high), of the mean of independent normalised errors squared.

    Parameters
    ----------
    dof : int
        Degrees of freedom of each.
    count : int
        How many are averaged.
    confidence : float
        Probability of the band.

    Raises
    ------
    ModelError
        If a number is no whole one from 1, or the confidence is not between 0 and 1.

    Examples
    --------
    >>> low, high = pgm.consistency.mean_band(dof=2, count=50, confidence=0.95)
    >>> round(low, 2), round(high, 2)
    (1.48, 2.59)
    """
    check_count("degrees of freedom of each", dof)
    check_count("how many are averaged", count)
    low, high = (float(chi_squared(p, dof * count)) / count for p in tails(confidence))
    return low, high


def run_axes(values: Array, steps: Integers | None) -> tuple[int, ...]:
    """The axes of runs of values of a belief: all, but the last where it is of steps."""
    return tuple(range(values.ndim - (steps is not None)))


def _quotient(a: Array, b: npt.NDArray[np.floating | np.integer]) -> Array:
    return np.asarray(np.divide(a, b, out=np.full(np.shape(a), np.nan), where=np.asarray(b) > 0))
