"""Checks of the arguments that schedules take: numbers, linearisers, CPDs and starts."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from pgm.boundary import is_number, is_whole
from pgm.cpds import CPD, ConditionalGaussian, MixtureCPD, SampledCPD
from pgm.errors import EvidenceError, ModelError
from pgm.factors.scope import listed
from pgm.kernels.arrays import Array
from pgm.variables import Variable


def require_count(owner: object, name: str, value: object) -> None:
    """Refuse what is no whole number, 1 or more."""
    if not is_whole(value) or value < 1:
        raise ModelError(f"{owner!r}: {name} must be a whole number, 1 or more, not {value!r}")


def require_tolerance(owner: object, tolerance: object) -> None:
    """Refuse what is no number, 0 or more."""
    if not is_number(tolerance) or not tolerance >= 0.0:
        raise ModelError(f"{owner!r}: a tolerance must be 0 or more, not {tolerance!r}")


def require_lineariser(lineariser: Any) -> None:
    """Refuse what cannot be called, and a rule that was not made."""
    if not callable(lineariser) or isinstance(lineariser, type):
        raise ModelError(f"{lineariser!r} is no lineariser; give one like pgm.Taylor()")


def require_gaussian(cpds: Iterable[CPD], beliefs: str) -> None:
    """Refuse a CPD that is not Gaussian, where beliefs of some kind need its moments."""
    for cpd in cpds:
        if not isinstance(cpd, ConditionalGaussian):
            raise ModelError(
                f"{cpd!r} is no Gaussian CPD, of which {beliefs} are made; of a dynamic network "
                "belief=pgm.Particles(...) takes any density, and pgm.Grid(...) any that is given",
                variable=cpd.child,
                cpd=cpd,
            )


def require_plain(cpds: Iterable[CPD]) -> None:
    """Refuse robust noise, where there are no residuals of sensors to weigh."""
    for cpd in cpds:
        if isinstance(cpd, ConditionalGaussian) and cpd.noise is not None:
            raise ModelError(
                f"{cpd!r} has robust noise, {cpd.noise!r}: Gaussian beliefs take it of sensors of "
                "a dynamic network alone, whose residuals they weigh; leave noise= out, declare a "
                "sensor, or take belief=pgm.Particles(...) or pgm.Grid(...) of a dynamic network",
                variable=cpd.child,
                cpd=cpd,
            )


def require_density(cpds: Iterable[CPD], beliefs: str) -> None:
    """Refuse a CPD that cannot be asked for its density, where beliefs of some kind need it."""
    for cpd in cpds:
        if isinstance(cpd, MixtureCPD):
            require_density(cpd.parts, beliefs)
        elif isinstance(cpd, ConditionalGaussian) and cpd.noise is not None:
            cpd.noise.require_proper(cpd.child.dimension, cpd)
        elif isinstance(cpd, SampledCPD) and cpd.density is None:
            raise ModelError(
                f"{cpd!r} has no density, by which {beliefs} move and weigh beliefs: give it "
                "log_density=, or take belief=pgm.Particles(...), which draws a transition",
                variable=cpd.child,
                cpd=cpd,
            )


# Means of hidden variables.
Start = Mapping[Variable, npt.ArrayLike]


def require_hidden(start: Start, hidden: Collection[Variable]) -> None:
    """Refuse a start that is no mapping, or names what is not hidden."""
    if not isinstance(start, Mapping):
        raise EvidenceError(f"start maps variables to means; found {type(start).__name__}")
    for variable in start:
        if variable not in hidden:
            raise EvidenceError(
                f"start has {variable!r}, which is not hidden; it takes {listed(hidden)}",
                variable=variable,
            )


def over_runs(variable: Variable, means: Array, lead: tuple[int, ...], axes: int) -> Array:
    """The means of a variable for all runs, whose axes become one: (runs, ...).

    `lead` are the evidence's axes of runs; the last `axes` of the means are none of runs.
    """
    own, rest = means.shape[: means.ndim - axes], means.shape[means.ndim - axes :]
    try:
        wide = np.broadcast_to(means, (*lead, *rest))
    except ValueError:
        raise EvidenceError(
            f"start for {variable!r} has the axes of runs {own}, which do not broadcast to those "
            f"of the evidence, {lead}",
            variable=variable,
        ) from None
    return wide.reshape(-1, *rest)
