"""Numbers of a CPD that change from step to step: stacks with an entry for each step 1..T.

Entry k, counted from 0, is of step k + 1, as row k of a plain array of evidence is.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from pgm.boundary import as_floats
from pgm.cpds.base import CPD
from pgm.cpds.conditional import ConditionalGaussian, Noise
from pgm.errors import ModelError, PgmError
from pgm.factors.arrays import as_covariance
from pgm.kernels.arrays import Array, Integers, frozen
from pgm.linearisers.numbering import Numbering
from pgm.variables import Variable


@dataclass(frozen=True, eq=False, repr=False)
class NoiseByStep(Noise):
    """A noise covariance for each step, in place of a function of observed parents.

    Attributes
    ----------
    covs : ndarray
        (T, d, d): entry k is of step k + 1.
    """

    covs: Array = field(kw_only=True)

    @classmethod
    def of(cls, covs: Array) -> NoiseByStep:
        """The noise of some covariances (T, d, d), checked before."""
        return cls(_no_function, (), covs=frozen(covs))

    def __repr__(self) -> str:
        return f"NoiseByStep({len(self.covs)} steps)"

    def scaled(self, factor: float) -> NoiseByStep:
        """The noise whose covariances are a multiple of these."""
        return NoiseByStep.of(factor * self.covs)

    def _values(
        self,
        cpd: ConditionalGaussian,
        known: Mapping[Variable, Array],
        shape: tuple[int, ...],
        step: int | Integers | None,
        numbering: Numbering,
    ) -> Array:
        covs = self.covs[index(cpd, step)]
        return np.broadcast_to(covs, (*shape, *self.covs.shape[1:]))


def _no_function(*given: Array) -> Array:
    """The function that this noise does not have."""
    raise NotImplementedError("the noise of each step is an entry of covs")


def as_noise(child: Variable, cov: Any) -> Any:
    """Covariances (T, d, d) as a `NoiseByStep`, checked; a covariance of any other kind as it is.

    A ModelError refuses other stacks: the number of axes says that there is one, never a length.
    """
    if isinstance(cov, Noise | float | int) or getattr(cov, "ndim", 2) < 2:
        return cov
    what, size = f"the covariance of {child!r}", child.dimension
    given = as_floats(cov, what, variable=child)
    stacked = given.ndim == 3 and given.shape[1:] == (size, size)
    variances = given.ndim == 2 and given.shape[1] == size != given.shape[0]
    if given.ndim < 3 and not variances:
        return cov
    if not stacked:
        raise ModelError(
            f"{what} has shape {given.shape}; ({size}, {size}) was due or, for T steps that differ "
            f"in theirs, (T, {size}, {size}): variances of each step, (T, {size}), are matrices as "
            "cov[..., None] * np.eye(n)",
            variable=child,
        )
    _require_some(what, given, child)
    try:
        covs = as_covariance((child,), given, what, variable=child)
    except ModelError:
        for step, each in enumerate(given, 1):  # which names the step
            as_covariance((child,), each, f"{what} at step {step}", variable=child)
        raise
    return NoiseByStep.of(covs)


def as_stack(what: str, value: Array, due: tuple[int, ...], variable: Variable) -> Array:
    """An array of the shape that is due, or a stack of such, (T, *due); else a ModelError."""
    if value.shape == due or (value.ndim == len(due) + 1 and value.shape[1:] == due):
        if value.ndim > len(due):
            _require_some(what, value, variable)
        return value
    stacked = ", ".join(map(str, ("T", *due)))
    raise ModelError(
        f"{what} has shape {value.shape}; {due} was due or, for T steps that differ, ({stacked})",
        variable=variable,
    )


def _require_some(what: str, stack: Array, variable: Variable) -> None:
    if not len(stack):
        raise ModelError(
            f"{what} has shape {stack.shape}, an entry for each of no steps; give one step or more",
            variable=variable,
        )


def common(name: str, lengths: Mapping[str, int], variable: Variable) -> int | None:
    """The number of steps T that stacks have in common, by what they are; None without any."""
    found = dict.fromkeys(lengths.values())
    if len(found) > 1:
        told = ", ".join(f"{length} of the {what}" for what, length in lengths.items())
        raise ModelError(
            f"{name}: arrays by step have an entry for each of the same steps 1..T; found {told}",
            variable=variable,
        )
    return next(iter(found), None)


def among(cpds: Iterable[CPD]) -> CPD | None:
    """The first of some CPDs whose numbers change by step; all of these must have the same T."""
    found = [cpd for cpd in cpds if cpd.steps is not None]
    for cpd in found:
        if cpd.steps != found[0].steps:
            raise ModelError(
                f"{cpd!r} has arrays of {cpd.steps} steps, and {found[0]!r} of {found[0].steps}: "
                "arrays by step have an entry for each of the same steps 1..T",
                variable=cpd.child,
                cpd=cpd,
            )
    return found[0] if found else None


def index(cpd: CPD, step: int | Integers | None) -> Any:
    """The places of some steps in a CPD's stacks, step − 1; a ModelError refuses any other step."""
    steps = cpd.steps
    assert steps is not None
    if step is None:
        raise ModelError(
            f"{cpd!r} has numbers of its own at each of the steps 1..{steps}: it stands in the "
            "transition or the observation of a DynamicBayesianNetwork; cpd.at(step) has the "
            "numbers of one step",
            variable=cpd.child,
            cpd=cpd,
        )
    array = np.asarray(step)
    outside = (array < 1) | (array > steps)
    if outside.any():
        first = int(array[outside].flat[0])
        raise ModelError(
            f"{cpd!r} has numbers of its own at each of the steps 1..{steps}, and none of step "
            f"{first}; {_remedy(first)}",
            variable=cpd.child,
            cpd=cpd,
            step=first,
        )
    return array - 1


def require_last(cpd: CPD | None, steps: int, error: type[PgmError]) -> None:
    """Refuse another number of steps than that of a CPD's numbers by step, if there is one."""
    if cpd is not None and cpd.steps != steps:
        raise error(
            f"{cpd!r} has numbers of its own at each of the steps 1..{cpd.steps}, and "
            f"{steps} steps are asked for; give its arrays {steps} entries, or steps={cpd.steps}",
            variable=cpd.child,
            cpd=cpd,
        )


def _remedy(step: int) -> str:
    if step < 1:
        return (
            "entry 0 of its arrays is of step 1; a measurement at step 0 is of a sensor of its own"
        )
    return f"give its arrays {step} entries, one for each step up to it"


def require_step(cpd: CPD, step: int) -> None:
    """Refuse, by a ModelError, a step that a CPD of numbers by step has none for."""
    if cpd.steps is not None:
        index(cpd, step)
