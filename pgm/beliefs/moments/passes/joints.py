"""The joint moments of hidden variables at several steps, by the gains of the reversed transitions.

A *slice* is the vector of all hidden variables of a step. Bayes' rule reverses each transition to
an affine conditional of a slice given the next one, whose slope is the gain (`backward`).
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from pgm.beliefs.moments.passes.backward import Beliefs, Reverse
from pgm.compile import SliceLayout
from pgm.kernels.arrays import Array, Integers, transpose
from pgm.variables import Variable

# Rows that are mirrored at once: a block and its mirror image stay in the processor's cache.
_ROWS = 256


def joint_moments(
    reverse: Reverse, beliefs: Beliefs, layout: SliceLayout, variables: Sequence[Variable]
) -> tuple[Array, Array]:
    r"""Mean (runs, n) and covariance (runs, n, n) of variables at steps, in the order given.

    `variables` are hidden ones, each with a step, no two the same; n counts their components, and
    `layout` tells where they stand in a slice. `reverse` has the reversed transitions. `beliefs`
    are the slices' moments given all measurements, or after a filter those up to their step.

    Only the belief at the latest step wanted is read. A pass back from there carries its mean and
    covariance through the reversed transitions, which gives those of each earlier slice. It also
    finds the covariance of the slice x_s at step s with each wanted variable x_t of a later step t,
    by one product a step:

        cov(x_s, x_t) = A_s cov(x_{s+1}, x_t),    t > s,

    where A_s is the gain of x_s given x_{s+1}.
    """
    steps = [variable.step for variable in variables if variable.step is not None]
    order = sorted(range(len(variables)), key=steps.__getitem__)
    latest, first = steps[order[-1]], steps[order[0]]
    starts = np.cumsum([0, *(variables[k].dimension for k in order)])
    due: dict[int, list[tuple[slice, Integers]]] = {}
    everywhere = np.arange(beliefs.mean.shape[-1])
    for k, (begin, end) in zip(order, pairwise(starts.tolist()), strict=True):
        places = everywhere[layout.places[variables[k].template]]
        due.setdefault(steps[k], []).append((slice(begin, end), places))
    runs, size = beliefs.mean.shape[1], int(starts[-1])
    mean, cov = np.empty((runs, size)), np.empty((runs, size, size))
    at, spread = beliefs.mean[latest], beliefs.cov[latest]
    # The covariance of the whole slice at a step with the components wanted from that step on,
    # which stand from `start` on.
    cross, start = np.empty((runs, everywhere.size, size)), size
    for step in range(latest, first - 1, -1):
        if step < latest:
            at, spread = reverse.back(step, (at, spread))
            cross[..., start:] = _gain(reverse, step) @ cross[..., start:]
        for rows, places in due.get(step, []):
            cross[..., rows] = spread[..., places]
            mean[:, rows] = at[:, places]
            start = min(start, rows.start)
        for rows, places in due.get(step, []):
            cov[:, rows, start:] = cross[:, places, start:]
    _mirror(cov)
    if order == sorted(order):
        return mean, cov
    # Where each component of the result stands among those sorted by step.
    place = np.concatenate(
        [np.arange(*starts[[k, k + 1]]) for k in np.argsort(order, kind="stable")]
    )
    return mean[:, place], cov[:, place[:, None], place]


def _gain(reverse: Reverse, step: int) -> Array:
    """The gain A_t, (runs, n, n): the regression of the slice at step t on the slice at t + 1.

    Its rows are of the slice at t, its columns of that at t + 1.
    """
    gain: Array = reverse.states.matrix[step]
    return gain if reverse.slices is None else reverse.slices.matrix[step] @ gain


def _mirror(cov: Array) -> None:
    """Copy upper triangles of matrices (runs, n, n) onto the lower ones, in place, by blocks."""
    size = cov.shape[-1]
    for start in range(0, size, _ROWS):
        rows = slice(start, start + _ROWS)
        block = cov[:, rows, rows]
        above = np.triu(block)
        block[...] = above + transpose(np.triu(block, 1))
        for other in range(start + _ROWS, size, _ROWS):
            later = slice(other, other + _ROWS)
            cov[:, later, rows] = transpose(cov[:, rows, later])
