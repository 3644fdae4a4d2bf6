"""How large errors are at each step, and how they differ from run to run."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from pgm.boundary import as_floats
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
    sizes: npt.ArrayLike, steps: Integers | None, percentiles: tuple[float, float] = (5.0, 95.0)
) -> OverTime:
    """Root mean square and percentiles over runs of sizes (*runs, T+1).

    Parameters
    ----------
    sizes : array_like
        Of any statistic that has one a step, like `kl`.
    steps : ndarray of int
        (T+1,), as a belief over time carries them.
    percentiles : pair of float
        The lower and the upper one, in percent.

    Raises
    ------
    ModelError
        If the sizes are not over those steps or some are NaN, or the percentiles no such pair.
    """
    values = as_floats(sizes, "a size")
    if steps is None or values.shape[-1:] != steps.shape:
        raise ModelError(
            f"sizes of shape {values.shape} over the steps {steps}; a belief over time is needed, "
            "like posterior[x]"
        )
    flat = values.reshape(-1, values.shape[-1])
    if lost := int(np.isnan(flat).sum()):
        raise ModelError(f"{lost} of the {flat.size} sizes are NaN; leave out their runs or steps")
    pair = as_floats(percentiles, "a percentile")
    if pair.shape != (2,) or not 0.0 <= pair[0] < pair[1] <= 100.0:
        raise ModelError(f"percentiles are a lower and an upper one in percent, not {percentiles}")
    below, median, above = np.percentile(flat, (pair[0], 50.0, pair[1]), axis=0)
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
        (*runs, T+1, n), its leading axes as `error` asks for.
    components : sequence of str
        Over which the error's length is taken; all without.
    percentiles : pair of float
        The lower and the upper one, in percent.

    Raises
    ------
    ModelError
        If the belief is over no steps, or an argument does not fit it.
    """
    return over_time(size(belief, truth, components), belief.steps, percentiles)
