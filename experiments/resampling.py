"""Particles drawn anew by their weights, for the particle filters of the experiments."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


def resampled(weight: Array, rng: np.random.Generator) -> npt.NDArray[np.intp]:
    """The particles that live on, by systematic resampling: a comb a run, its offset at random.

    Parameters
    ----------
    weight : ndarray
        (runs, count), that sum to 1 over the particles of a run.
    rng : numpy.random.Generator

    Returns
    -------
    ndarray
        (runs, count): numbers of particles in ascending order; one of weight w is there ⌊w count⌋
        or ⌈w count⌉ times.

    Notes
    -----
    The sampling is Madow's (On the theory of systematic sampling II, 1949).
    """
    runs, count = weight.shape
    ends = np.cumsum(weight, axis=1)
    teeth = np.ceil(ends * count - rng.random((runs, 1))).astype(np.intp)
    teeth[ends == ends[:, -1:]] = count  # whatever rounding says, a run has all its teeth
    copies = np.diff(np.minimum(teeth, count), axis=1, prepend=0)
    return np.repeat(np.tile(np.arange(count), runs), copies.ravel()).reshape(runs, count)
