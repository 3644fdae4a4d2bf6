"""Checks of arguments: numbers, linearisers, and the CPDs that a kind of belief can take.

A check returns nothing where the argument is right. Where it is wrong, the check raises a
`ModelError`, or an `EvidenceError` about a measurement. The error's text begins with the repr of
`owner`, if there is such an argument. An argument `beliefs` is the name, for the error's text, of
the beliefs that take only CPDs of some kind, in the plural: "Gaussian beliefs".
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from pgm.boundary import is_number, is_whole
from pgm.cpds import CPD, ConditionalGaussian, MixtureCPD, SampledCPD
from pgm.errors import EvidenceError, ModelError
from pgm.kernels.arrays import Mask


def require_count(owner: object, name: str, value: object) -> None:
    """Refuse a value that is no whole number of 1 or more; errors call it `name`."""
    if not is_whole(value) or value < 1:
        raise ModelError(f"{owner!r}: {name} must be a whole number, 1 or more, not {value!r}")


def require_tolerance(owner: object, tolerance: object) -> None:
    """Refuse a tolerance that is no number, or is NaN or negative."""
    if not is_number(tolerance) or not tolerance >= 0.0:
        raise ModelError(f"{owner!r}: a tolerance must be 0 or more, not {tolerance!r}")


def require_lineariser(lineariser: Any) -> None:
    """Refuse a lineariser that cannot be called, or that is a class.

    `Taylor` is a class, `Taylor()` a lineariser.
    """
    if not callable(lineariser) or isinstance(lineariser, type):
        raise ModelError(f"{lineariser!r} is no lineariser; give one like pgm.Taylor()")


def require_gaussian(cpds: Iterable[CPD], beliefs: str) -> None:
    """Refuse CPDs that are not Gaussian, for beliefs that are a mean and a covariance."""
    for cpd in cpds:
        if not isinstance(cpd, ConditionalGaussian):
            raise ModelError(
                f"{cpd!r} is no Gaussian CPD, of which {beliefs} are made; of a dynamic network "
                "belief=pgm.Particles(...) takes any density, and pgm.Grid(...) any that is given",
                variable=cpd.child,
                cpd=cpd,
            )


def require_plain(cpds: Iterable[CPD]) -> None:
    """Refuse CPDs with robust noise; `cpds` are those of a dynamic network that are no sensors.

    Gaussian beliefs handle robust noise by weighting the residuals of measurements. Only sensors
    may therefore have it, and the caller leaves them out of `cpds`.
    """
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
    """Refuse CPDs whose density cannot be evaluated, for beliefs that are weighted by densities.

    Refused are a `SampledCPD` without `log_density`, and robust noise whose density has an infinite
    integral. A mixture is refused if any of its component CPDs is.
    """
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
    """Refuse a partly missing measurement, if the density of its CPD needs all components.

    `taken` (d,) marks the components that were measured at `step`. A CPD whose `partial` is true
    has a density of the measured components alone, and is never refused. The error is an
    `EvidenceError`.
    """
    if not taken.all() and not cpd.partial:
        raise EvidenceError(
            f"{cpd!r}: a measurement at step {step} has components that are NaN, which the "
            "density of such a CPD cannot leave out; give all of them, or none",
            variable=cpd.child,
            cpd=cpd,
            step=step,
        )
