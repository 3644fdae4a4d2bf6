"""CPDs at many points of a lattice, with a step's evidence bound: means, noise, densities."""

import copy
from collections.abc import Iterator, Mapping

import numpy as np

from pgm.cpds import CPD, AffineCPD, ConditionalGaussian, GaussianCPD, MixtureCPD, Noise
from pgm.cpds import base as cpd_values
from pgm.cpds.conditional import evaluate
from pgm.errors import LinearisationError, ModelError, NumericalError
from pgm.factors.arrays import IMPROPER
from pgm.kernels import roots
from pgm.kernels.angles import wrap
from pgm.kernels.arrays import Array, Mask
from pgm.linearisers.calls import Call
from pgm.variables import Variable

Known = Mapping[Variable, Array]
# Numbers of a block of points that a density is asked for, and points at the most.
_NUMBERS = 1 << 20
_POINTS = 1 << 16


def mean_at(
    cpd: ConditionalGaussian,
    points: Known,
    known: Known,
    step: int,
    run: int,
    less: Variable | None = None,
) -> Array:
    """The mean of a CPD at n points, (n, d); user's functions are called once, with all of them.

    points: Values of hidden parents, (n, d).
    known: Values of the parents with evidence, (d,).
    less: The parent of which the mean is a displacement: its value is taken off, of an affine CPD
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


def require_noise(cpd: ConditionalGaussian, lower: Array, step: int) -> None:
    """Refuse noise of a root that is singular, whose density no centre need meet."""
    if not (np.diagonal(lower) > 0.0).all():
        raise ModelError(
            f"{cpd!r} has no noise in a component, or two that are one, at step {step}: "
            "no centre of a grid need be where its density is; give it the noise of half a cell, "
            "or more",
            variable=cpd.child,
            cpd=cpd,
            step=step,
        )


def settled(cpd: CPD, known: Known, step: int, run: int) -> CPD:
    """A CPD with the noise of a step, and of a run, for its density at many points."""
    if isinstance(cpd, MixtureCPD):
        return cpd._with(tuple(settled(part, known, step, run) for part in cpd.parts))
    if isinstance(cpd, GaussianCPD) and cpd._lead():
        mean = cpd.mean.reshape(-1, cpd.child.dimension)
        return GaussianCPD(
            cpd.child, mean[run if len(mean) > 1 else 0], covariance_of(cpd, {}, step, run)
        )
    if isinstance(cpd, ConditionalGaussian) and isinstance(cpd.cov, Noise):
        found = copy.copy(cpd)
        found._set(cov=covariance_of(cpd, known, step, run))
        return found
    return cpd


def gaussian_parts(cpd: CPD) -> Iterator[ConditionalGaussian]:
    """The Gaussian CPDs that a CPD is, or is a mixture of."""
    if isinstance(cpd, MixtureCPD):
        for part in cpd.parts:
            yield from gaussian_parts(part)
    elif isinstance(cpd, ConditionalGaussian):
        yield cpd


def deviations(
    cpd: ConditionalGaussian, gaps: Array, taken: Mask, known: Known, step: int, run: int
) -> float:
    """The most deviations of its noise, in components taken, that differences (n, d) come to."""
    gaps = np.where(cpd.child.angle_mask, wrap(gaps), gaps)[:, taken]
    cov = covariance_of(cpd, known, step, run)[np.ix_(taken, taken)]
    lower = root_of(cpd, cov, step)
    if roots.determined(lower).any():
        return float("inf")
    white = np.linalg.solve(lower, gaps.T)
    return float(np.sqrt((white * white).sum(axis=0)).max())


def at_a_time(cpd: CPD) -> int:
    """The number of points for which a CPD is asked for densities at a time."""
    return max(min(_NUMBERS // sum(v.dimension for v in cpd.scope), _POINTS), 1)


def known_at(
    cpd: CPD, child: Array, points: Known, known: Known, step: int
) -> tuple[Array, cpd_values.Known]:
    """The child (n, d) and the parents of a CPD at n points, as of `log_density_at`."""
    hidden = (len(points[parent]) for parent in cpd.parents if parent in points)
    count = next(hidden, len(child) if child.ndim > 1 else 1)
    values = {}
    for parent in cpd.parents:
        found = points[parent] if parent in points else known[parent]
        values[parent] = np.broadcast_to(found, (count, parent.dimension))
    wide = np.broadcast_to(child, (count, cpd.child.dimension))
    return wide, cpd_values.Known(values, (count,), (count,), step)


def log_density_at(
    cpd: CPD, child: Array, points: Known, known: Known, step: int, run: int
) -> Array:
    """The log-densities of a CPD at n points, (n,); users' functions are called once with all.

    cpd: As `settled` gives it.
    child: (n, d), or (d,) for all.
    points: Values of hidden parents, (n, d).
    known: Values of the parents with evidence, (d,).
    """
    wide, given = known_at(cpd, child, points, known, step)
    level, values, count = cpd._log_density(wide, given), given.values, len(wide)
    (bad,) = np.nonzero(np.isnan(level) | (level == np.inf))
    if bad.size:
        at = {v: a[bad[0]].tolist() for v, a in {cpd.child: wide, **values}.items()}
        raise LinearisationError(
            f"{cpd!r}: at step {step}, run {run}, its log-density is {level[bad[0]]} at {bad.size} "
            f"of {count} centres of cells, like {at}; it must be a number, or minus infinity where "
            "it is impossible",
            variable=cpd.child,
            cpd=cpd,
            step=step,
            run=run,
        )
    return level
