"""Checks of the arguments that schedules take: numbers, linearisers, CPDs."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from pgm.boundary import is_number, is_whole
from pgm.cpds import CPD, ConditionalGaussian, MixtureCPD, SampledCPD
from pgm.errors import EvidenceError, ModelError
from pgm.kernels.arrays import Mask


def require_count(owner: object, name: str, value: object) -> None:
    """Check a whole number of 1 or more."""
    if not is_whole(value) or value < 1:
        raise ModelError(f"{owner!r}: {name} must be a whole number, 1 or more, not {value!r}")


def require_tolerance(owner: object, tolerance: object) -> None:
    """Check a number of 0 or more."""
    if not is_number(tolerance) or not tolerance >= 0.0:
        raise ModelError(f"{owner!r}: a tolerance must be 0 or more, not {tolerance!r}")


def require_lineariser(lineariser: Any) -> None:
    """Refuse what cannot be called, and a rule that was not made."""
    if not callable(lineariser) or isinstance(lineariser, type):
        raise ModelError(f"{lineariser!r} is no lineariser; give one like pgm.Taylor()")


def require_gaussian(cpds: Iterable[CPD], beliefs: str) -> None:
    """Refuse a CPD that is not Gaussian, for beliefs that need its mean and covariance."""
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


def require_whole(cpd: CPD, taken: Mask, step: int) -> None:
    """Refuse a measurement with missing components, for a density without marginals."""
    if not taken.all() and not cpd.partial:
        raise EvidenceError(
            f"{cpd!r}: a measurement at step {step} has components that are NaN, which the "
            "density of such a CPD cannot leave out; give all of them, or none",
            variable=cpd.child,
            cpd=cpd,
            step=step,
        )
