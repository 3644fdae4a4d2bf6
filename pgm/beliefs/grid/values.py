"""Means, noise covariances and densities of CPDs at many points of a lattice, with evidence bound.

In all functions `points` are the values (n, d) of hidden parents at n points, `known` the values
(d,) of parents with evidence, both by variable, and `step` and `run` the numbers of the step and of
the run, which choose the noise and stand in errors. The root L of a covariance is lower triangular,
cov = L Lᵀ.
"""

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
from pgm.linearisers.numbering import Numbering
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
    """A CPD's mean at n points, (n, d), by one call of the user's function.

    points: Values of hidden parents, (n, d); n is 1 if there are none.
    known: Values of the parents with evidence, (d,).
    less: A hidden variable of `points` whose value is subtracted, which leaves the displacement
        from it; of an affine CPD its matrix less the identity is used, so that no digits are lost.
        None for the mean itself.

    A function with values that are NaN or infinite is refused by a LinearisationError.
    """
    count = next((len(values) for values in points.values()), 1)
    values = {}
    for parent in cpd.given:
        found = points[parent] if parent in points else known[parent]
        found = np.broadcast_to(found, (count, parent.dimension))
        found.flags.writeable = False
        values[parent] = found
    if isinstance(cpd, AffineCPD):
        cpd = cpd._held(step)
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
    """The noise covariance (d, d) of a CPD in a run.

    A covariance that is a function of observed parents is evaluated at `known`; a value that is no
    covariance is refused by a ModelError.
    """
    if isinstance(cpd.cov, Noise):
        given = {parent: known[parent][None] for parent in cpd.cov.given}
        cov: Array = evaluate(cpd, given, (1,), step, Numbering(run))[0]
        return cov
    size = cpd.child.dimension
    every = cpd.cov.reshape(-1, size, size)
    found: Array = every[run if len(every) > 1 else 0]
    return found


def root_of(cpd: ConditionalGaussian, cov: Array, step: int) -> Array:
    """The lower triangular root L (d, d) of a CPD's noise covariance, cov = L Lᵀ.

    The column of a component whose noise is determined by the noise of those before it is zero. A
    covariance that is not finite and positive semidefinite is refused by a NumericalError.
    """
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
    """Refuse a CPD whose noise covariance is singular, by a ModelError: `lower` is its root (d, d).

    The density of such noise is zero at nearly every centre.
    """
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
    """A CPD with its noise evaluated for a step and a run, ready to be asked for many densities.

    A covariance that is a function of observed parents is replaced by its value at `known`. A
    `GaussianCPD` with axes of runs is replaced by that of the run, and numbers that change from
    step to step by those of the step. The parts of a mixture are treated likewise. Other CPDs are
    returned as they are.
    """
    cpd = cpd._held(step)
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
    """The CPD itself if it is Gaussian, or all Gaussian parts of a mixture; none of other CPDs."""
    if isinstance(cpd, MixtureCPD):
        for part in cpd.parts:
            yield from gaussian_parts(part)
    elif isinstance(cpd, ConditionalGaussian):
        yield cpd


def deviations(
    cpd: ConditionalGaussian, gaps: Array, taken: Mask, known: Known, step: int, run: int
) -> float:
    """The largest of n differences of measurements, in standard deviations of a CPD's noise.

    It is max ‖L⁻¹ g‖ over the rows g of `gaps` (n, d), of the components in the mask `taken` (d,),
    angles the shorter way round; L Lᵀ is the noise covariance of these components. Infinite where
    that is singular.
    """
    gaps = np.where(cpd.child.angle_mask, wrap(gaps), gaps)[:, taken]
    cov = covariance_of(cpd, known, step, run)[np.ix_(taken, taken)]
    lower = root_of(cpd, cov, step)
    if roots.determined(lower).any():
        return float("inf")
    white = np.linalg.solve(lower, gaps.T)
    return float(np.sqrt((white * white).sum(axis=0)).max())


def at_a_time(cpd: CPD) -> int:
    """The most points at which a CPD is asked for densities in one call, to bound the memory."""
    return max(min(_NUMBERS // sum(v.dimension for v in cpd.scope), _POINTS), 1)


def known_at(
    cpd: CPD, child: Array, points: Known, known: Known, step: int
) -> tuple[Array, cpd_values.Known]:
    """A CPD's arguments at n points: values of its child, (n, d), and of all its parents, (n, d).

    The parents' are a `Known` record, which has them by variable; all are broadcast to n rows. n is
    the number of the points, or, where no parent is hidden, of the rows of `child`, (n, d) or (d,).
    """
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

    cpd: A CPD of this step and run, as `settled` returns it.
    child: Values of the child, (n, d), or (d,) for all points.
    points: Values of hidden parents, (n, d).
    known: Values of the parents with evidence, (d,).

    Log-densities that are NaN or plus infinity are refused by a LinearisationError.
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
