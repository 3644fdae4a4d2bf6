"""How large errors are at each step, and how they differ from run to run."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from pgm.consistency.errors import size
from pgm.errors import ModelError
from pgm.factors import Gaussian
from pgm.kernels.arrays import Array, Integers


@dataclass(frozen=True, eq=False)
class OverTime:
    """A size, at each step, of several runs.

    Attributes
    ----------
    steps : ndarray of int
        (T+1,).
    rms : ndarray
        (T+1,): the root mean square over runs, which a few bad runs can rule.
    median, low, high : ndarray
        (T+1,): percentiles over runs, which they cannot.
    runs : int
    """

    steps: Integers
    rms: Array
    median: Array
    low: Array
    high: Array
    runs: int


def over_time(
    sizes: Array, steps: Integers | None, percentiles: tuple[float, float] = (5.0, 95.0)
) -> OverTime:
    """Root mean square and percentiles over runs of sizes (*runs, T+1).

    Parameters
    ----------
    sizes : ndarray
        Of any statistic that has one a step, like `kl`.
    steps : ndarray of int
        (T+1,), as a belief over time carries them.
    percentiles : pair of float
        The lower and the upper one, in percent.

    Raises
    ------
    ModelError
        If the sizes are not over those steps, or the percentiles no such pair.
    """
    if steps is None or sizes.shape[-1:] != steps.shape:
        raise ModelError(
            f"sizes of shape {sizes.shape} over the steps {steps}; a belief over time is needed, "
            "like posterior[x]"
        )
    low, high = percentiles
    if not 0.0 <= low < high <= 100.0:
        raise ModelError(f"percentiles are a lower and an upper one in percent, not {percentiles}")
    flat = sizes.reshape(-1, sizes.shape[-1])
    below, median, above = np.percentile(flat, (low, 50.0, high), axis=0)
    return OverTime(steps, np.sqrt(np.mean(flat**2, axis=0)), median, below, above, flat.shape[0])


def rmse_over_time(
    belief: Gaussian,
    truth: npt.ArrayLike,
    components: Sequence[str] = (),
    *,
    percentiles: tuple[float, float] = (5.0, 95.0),
) -> OverTime:
    """RMSE over runs at each step, and percentiles of the length of a run's error.

    Parameters
    ----------
    belief : Gaussian
        Over steps, as ``posterior[x]``.
    truth : array_like
        (*runs, T+1, n).
    components : sequence of str
        Over which the error's length is taken; all without.
    percentiles : pair of float
        The lower and the upper one, in percent.
    """
    return over_time(size(belief, truth, components), belief.steps, percentiles)
