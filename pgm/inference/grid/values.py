"""Means and noise of CPDs at many points of a lattice, with a step's evidence bound."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from pgm.cpds import AffineCPD, ConditionalGaussian, Noise
from pgm.cpds.noise import evaluate
from pgm.errors import LinearisationError, NumericalError
from pgm.kernels import roots
from pgm.kernels.arrays import Array
from pgm.kernels.checks import IMPROPER
from pgm.linearisers.calls import Call
from pgm.variables import Variable

Known = Mapping[Variable, Array]


def mean_at(
    cpd: ConditionalGaussian,
    points: Known,
    known: Known,
    step: int,
    run: int,
    less: Variable | None = None,
) -> Array:
    """The mean of a CPD at n points, (n, d); user's functions are called once, with all of them.

    Parameters
    ----------
    cpd : CPD
    points : mapping of Variable to ndarray
        Values of hidden parents, (n, d).
    known : mapping of Variable to ndarray
        Values of the parents with evidence, (d,).
    step, run : int
        For messages.
    less : Variable, optional
        The parent of which the mean is a displacement: its value is taken off, of an affine CPD
        without a loss of digits.
    """
    count = next((len(values) for values in points.values()), 1)
    values = {}
    for parent in cpd.given:
        found = points[parent] if parent in points else known[parent]
        found = np.broadcast_to(found, (count, parent.dimension))
        found.flags.writeable = False
        values[parent] = found
    if isinstance(cpd, AffineCPD):
        offset = cpd.offset.reshape(-1, cpd.child.dimension)
        mean = np.broadcast_to(offset[run if len(offset) > 1 else 0], (count, offset.shape[1]))
        for parent, value in values.items():
            matrix = cpd.matrices[parent]
            mean = mean + value @ (matrix - np.eye(len(matrix)) if parent == less else matrix).T
        return mean - points[less] if less is not None and less not in values else mean
    call = Call(cpd.child, "function", (count,), step, None, cpd)
    with np.errstate(all="ignore"):  # non-finite values are refused below
        mean = cpd._mean(values, (count,), call)
    if not np.isfinite(mean.sum()):
        (bad,) = np.nonzero(~np.isfinite(mean).all(axis=-1))
        if bad.size:
            at = {parent: value[bad[0]] for parent, value in values.items()}
            raise LinearisationError(
                f"{cpd!r}: at step {step}, run {run}, its function has values that are NaN or "
                f"infinite at {bad.size} of {count} centres of cells, like {at}; it must have a "
                "value at every centre of the grid",
                variable=cpd.child,
                cpd=cpd,
                step=step,
                run=run,
            )
    moved: Array = mean if less is None else mean - points[less]
    return moved


def covariance_of(cpd: ConditionalGaussian, known: Known, step: int, run: int) -> Array:
    """The noise covariance of a CPD, (d, d)."""
    if isinstance(cpd.cov, Noise):
        given = {parent: known[parent][None] for parent in cpd.cov.given}
        cov: Array = evaluate(cpd, given, (1,), step, run)[0]
        return cov
    size = cpd.child.dimension
    every = cpd.cov.reshape(-1, size, size)
    found: Array = every[run if len(every) > 1 else 0]
    return found


def root_of(cpd: ConditionalGaussian, cov: Array, step: int) -> Array:
    """The lower root of a covariance (d, d), zero columns where it is singular."""
    lower = roots.root(cov)
    if not roots.is_proper(lower):
        raise NumericalError(
            f"the noise of {cpd!r} at step {step} cannot be used: {IMPROPER}",
            variable=cpd.child,
            cpd=cpd,
            step=step,
        )
    return lower
