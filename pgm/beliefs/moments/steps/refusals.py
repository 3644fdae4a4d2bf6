"""Errors that refuse beliefs and measurements, and name the CPD and the step to blame.

Components stand first and runs last, (n, *batch), `batch` being () for one run and (runs,) for
several. `step` is the number of the step to name, and `parts` are the linearised measurements of
that step, one part a sensor. In *twice the digits* numbers are pairs of float64, `Twofold`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NoReturn

import numpy as np

from pgm.beliefs.moments.steps.plan import ChainPlan, Link
from pgm.beliefs.moments.steps.vector import Measured
from pgm.errors import NumericalError
from pgm.kernels import roots
from pgm.kernels.arrays import Array, Mask, components_last, times
from pgm.kernels.extended import Twofold
from pgm.linearisation.family import cancellation

# A measurement this far from what an exact model says, as a part of the numbers' size, contradicts
# it.
CONTRADICTION = 1e-8
# Or this many times the rounding of a linearisation, where that is more.
_OF_ROUNDING = 10.0 * float(np.finfo(np.float64).eps)
# Rounding is magnified by this much at the most where rows of exact readings are nearly parallel:
# what is no further off may be a contradiction, or not.
_MAGNIFIED = 1e3


def indefinite(parts: Sequence[Measured], step: int, where: Mask) -> NoReturn:
    """Raise the NumericalError for a predictive covariance of `parts`, indefinite or not finite.

    `where`, () or (runs,), marks the runs in which it is, of which the first is named. The error
    blames the first sensor that is not linearised by Taylor's rule; if there is none, the first.
    """
    names = ", ".join(seen.sensor.variable.name for seen in parts)
    blamed = [seen.sensor for seen in parts if not seen.sensor.family.taylor]
    sensor = blamed[0] if blamed else parts[0].sensor
    advice = (
        f"with {sensor.family.lineariser!r} it may be: use positive weights or more samples"
        if blamed
        else "are the belief before it and the measurement of a size that float64 can hold?"
    )
    run = sensor.family.numbering.run(int(np.argmax(where)))
    of = f", run {run}," if np.size(where) > 1 else ""
    raise NumericalError(
        f"the predictive covariance of {names} at step {step}{of} is indefinite or not "
        f"finite; {advice}",
        variable=sensor.variable,
        cpd=sensor.family.cpd,
        step=step,
    )


def contradicted(parts: Sequence[Measured], mean: Array, left: Array) -> Mask:
    """Which measured components contradict a value that an exact model determines, (D, *batch).

    `left` (D, *batch) is how far each component of `parts`, D in all, is from its determined value,
    zero where none is determined; `mean` (n, *batch) is that of the predicted slice, the vector of
    the step's hidden variables. Rounding of the numbers summed up, and of a linearisation, is
    allowed.
    """
    sizes, roundings = _sizes(parts, mean)
    far: Mask = left > np.maximum(CONTRADICTION * sizes, roundings)
    return far


def _sizes(parts: Sequence[Measured], mean: Array) -> tuple[Array, Array]:
    """The size of the numbers that each component is summed up from, and their rounding.

    They are (D, *batch) each; of a sensor that is linearised the largest of its components, which a
    function may have summed up together.
    """
    sizes, roundings = [], []
    for seen in parts:
        # Numbers of this size are summed up to the expected value.
        expected = times(np.abs(seen.matrix), np.abs(mean[seen.sensor.parents]))
        size = np.abs(seen.reading) + expected + np.abs(seen.constant)
        if not seen.sensor.family.exact:
            size = np.broadcast_to(size.max(axis=0), size.shape)
        sizes.append(size)
        roundings.append(_OF_ROUNDING * cancellation(seen.sensor.family) * size)
    return np.concatenate(sizes), np.concatenate(roundings)


def contradiction(parts: Sequence[Measured], step: int, mean: Array, left: Array) -> None:
    """Raise NumericalError if a measurement contradicts a value that an exact model determines.

    `parts`, `mean` and `left` are as of `contradicted`.
    """
    far = contradicted(parts, mean, left)
    if not far.any():
        return
    _, roundings = _sizes(parts, mean)
    where = tuple(int(axis[0]) for axis in np.nonzero(far.T))
    run, place = where if far.ndim > 1 else (0, *where)
    heights = [len(seen.value) for seen in parts]
    sensor = parts[int(np.searchsorted(np.cumsum(heights), place, side="right"))].sensor
    run, off = sensor.family.numbering.run(run), float(left.T[where])
    fault = "contradicts an exact model"
    if not sensor.family.exact:
        fault += f", as {sensor.family.lineariser!r} linearises it"
    advice = "give the sensor, the motion or the prior some noise"
    if off <= _MAGNIFIED * roundings.T[where]:
        fault = f"may contradict an exact model, or {sensor.family.lineariser!r} rounds by as much"
        advice = f"use a larger alpha, so that sigma points lie further apart, or {advice}"
    raise NumericalError(
        f"a measurement of {sensor.variable!r} at step {step}, run {run}, {fault}: it is {off:.3g} "
        f"from a value that is certain; {advice}",
        variable=sensor.variable,
        cpd=sensor.family.cpd,
        step=step,
        run=run,
    )


def prediction(link: Link, step: int, cov: Array, *, finite: bool) -> None:
    """Raise NumericalError if the covariance `cov` (d, d, *batch) predicted by a CPD is indefinite.

    `link` has the CPD of the d components. The test is left out if its linearisation's error cannot
    have an indefinite covariance. With `finite` a covariance that is not finite is refused, too.
    """
    family, whole = link.family, bool(np.isfinite(cov).all())
    proper = family.semidefinite or roots.is_proper(roots.root(components_last(cov, 2)))
    if proper and (whole or not finite):
        return
    fault = "not finite; are the belief before it, its inputs and its noise of a size that float64"
    fault += " can hold?"
    if whole:
        fault = f"indefinite with {family.lineariser!r}; use a rule with positive weights or more"
        fault += " samples"
    raise NumericalError(
        f"{family.cpd!r}: the predicted covariance at step {step} is {fault}",
        variable=family.cpd.child,
        cpd=family.cpd,
        step=step,
    )


def belief(plan: ChainPlan, step: int, *beliefs: tuple[Twofold, Twofold]) -> None:
    """Raise NumericalError if beliefs in twice the digits are not finite or indefinite.

    Each of the `beliefs` is over the n components of the step's hidden variables. It is a pair: the
    columns [m D] (runs, n, 1 + q) of its mean m + D δ, where δ are the q components that a flat
    prior leaves unknown, and its covariance (runs, n, n). An indefinite covariance is blamed on a
    CPD of the plan whose approximation error may have one; without such a CPD only finiteness is
    tested.
    """
    for belief in beliefs:
        if not all(np.isfinite(part.hi + part.lo).all() for part in belief):
            infinite("the belief", step)
    rough = [family for family in plan.families if not family.semidefinite]
    if not rough or all(roots.is_proper(roots.root(cov.hi)) for _, cov in beliefs):
        return
    blamed = next((family for family in rough if step in family.step), rough[0])
    raise NumericalError(
        f"the belief at step {step} has an indefinite covariance, by the error of "
        f"{blamed.lineariser!r} for {blamed.cpd!r}; use a rule with positive weights or more "
        "samples",
        variable=blamed.cpd.child,
        cpd=blamed.cpd,
        step=step,
    )


def infinite(what: str, step: int) -> NoReturn:
    """Raise the NumericalError for `what`, such as "the belief", that is not finite at a step."""
    raise NumericalError(
        f"{what} at step {step} is not finite; are its inputs, measurements and noises of a size "
        "that float64 can hold?",
        step=step,
    )
