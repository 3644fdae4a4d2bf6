"""Errors at each step, and their spread from run to run."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from pgm.arguments import public
from pgm.boundary import as_floats
from pgm.consistency.errors import size
from pgm.display import Shown, Summary, table
from pgm.display import count as counted
from pgm.errors import ModelError
from pgm.factors import Gaussian
from pgm.kernels.arrays import Array, Integers


@dataclass(frozen=True, eq=False, repr=False)
class OverTime(Shown):
    """A statistic of several runs at each step; NaN at steps where no run has it.

    Attributes
    ----------
    steps : ndarray of int
        (T+1,).
    rms : ndarray
        (T+1,): the root mean square over runs, which a few bad runs can rule.
    median, low, high : ndarray
        (T+1,): percentiles over runs, which they cannot.
    runs : int
    count : ndarray of int
        (T+1,): in how many of them the size is known.

    Examples
    --------
    >>> found = pgm.consistency.over_time([[3.0, 1.0], [4.0, 1.0]], np.array([0, 1]))
    >>> found
    OverTime(steps 0..1, 2 runs)
      step    rms   low  median  high  count
         0  3.536  3.05     3.5  3.95      2
         1  1.000  1.00     1.0  1.00      2
    """

    steps: Integers
    rms: Array
    median: Array
    low: Array
    high: Array
    runs: int
    count: Integers

    @property
    def _title(self) -> str:
        ends = f"steps {self.steps[0]}..{self.steps[-1]}, " if len(self.steps) else ""
        return f"OverTime({ends}{counted(self.runs, 'run')})"

    def _summary(self) -> Summary:
        names = ("rms", "low", "median", "high", "count")
        columns = [("step", self.steps), *((name, getattr(self, name)) for name in names)]
        return Summary(self._title, [table(columns)])


@public
def over_time(
    sizes: npt.ArrayLike, steps: Integers | None, percentiles: tuple[float, float] = (5.0, 95.0)
) -> OverTime:
    """Root mean square and percentiles over runs of sizes (*runs, T+1).

    Parameters
    ----------
    sizes : array_like
        Values of any statistic that has one a step, like `kl`.
    steps : ndarray of int
        (T+1,), as a belief over time carries them.
    percentiles : pair of float
        The lower and the upper one, in percent.

    Raises
    ------
    ModelError
        If the sizes are not over those steps or some are NaN, or the percentiles no such pair.

    Examples
    --------
    >>> found = pgm.consistency.over_time([[1.0, 2.0], [7.0, 2.0]], np.array([0, 1]))
    >>> found.rms
    array([5., 2.])
    >>> found.median
    array([4., 2.])
    """
    values = as_floats(sizes, "a size")
    steps = _steps_of(values, steps)
    if lost := int(np.isnan(values).sum()):
        raise ModelError(
            f"{lost} of the {values.size} sizes are NaN; leave out their runs or steps"
        )
    return _over_runs(values, steps, percentiles)


def _steps_of(values: Array, steps: Integers | None) -> Integers:
    if steps is None or values.shape[-1:] != steps.shape:
        raise ModelError(
            f"sizes of shape {values.shape} over the steps {steps}; a belief over time is needed, "
            "like posterior[x]"
        )
    return steps


def _over_runs(values: Array, steps: Integers, percentiles: tuple[float, float]) -> OverTime:
    """The mean and percentiles over runs of a statistic (*runs, T+1), NaN left out."""
    pair = as_floats(percentiles, "a percentile")
    if pair.shape != (2,) or not 0.0 <= pair[0] < pair[1] <= 100.0:
        raise ModelError(f"percentiles are a lower and an upper one in percent, not {percentiles}")
    flat = values.reshape(-1, values.shape[-1])
    count = (~np.isnan(flat)).sum(axis=0)
    known = count > 0
    # With gaps it takes many times as long.
    percentile = np.percentile if (count == len(flat)).all() else np.nanpercentile
    rms, found = np.full(count.shape, np.nan), np.full((3, *count.shape), np.nan)
    rms[known] = np.sqrt(np.nanmean(flat[:, known] ** 2, axis=0))
    found[:, known] = percentile(flat[:, known], (pair[0], 50.0, pair[1]), axis=0)
    below, median, above = found
    return OverTime(steps, rms, median, below, above, len(flat), count)


@public
def rmse_over_time(
    belief: Gaussian,
    truth: npt.ArrayLike,
    components: Sequence[str] = (),
    *,
    percentiles: tuple[float, float] = (5.0, 95.0),
) -> OverTime:
    """RMSE over runs at each step, and percentiles of the length of a run's error, in its units.

    The runs are, at each step, those of which the truth of all the components is known there.

    Parameters
    ----------
    belief : Gaussian
        Over steps, as ``posterior[x]``.
    truth : array_like
        (*runs, T+1, n), its leading axes as `error` asks for.
    components : sequence of str
        Over which the error's length is taken; all without.
    percentiles : pair of float
        See `over_time`.

    Raises
    ------
    ModelError
        If the belief is over no steps, or an argument does not fit it.

    Examples
    --------
    >>> x = pgm.Variable("x")
    >>> two_runs = pgm.Gaussian(x, mean=[[[1.0]], [[7.0]]], cov=1.0, steps=[0])
    >>> pgm.consistency.rmse_over_time(two_runs, truth=[[0.0]]).rms
    array([5.])
    """
    lengths = size(belief, truth, components)
    return _over_runs(lengths, _steps_of(lengths, belief.steps), percentiles)
