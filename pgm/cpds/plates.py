"""Plates: CPDs that differ in their variables, numbers and noise alone.

A network of many thousand variables is made of few kinds of CPDs: all edges of a pose graph have
one function, all pixels of a field the same neighbours. CPDs of one plate stand as rows of the
same arrays, and are linearised in one call of their function if their lineariser does not ask whose
it is.
"""

from __future__ import annotations

from collections.abc import Hashable
from functools import lru_cache
from types import MethodType
from typing import Any

from pgm.cpds.by_run import ByRunCPD
from pgm.cpds.conditional import ConditionalGaussian, Noise
from pgm.cpds.gaussian import AffineCPD, NonlinearGaussianCPD
from pgm.cpds.losses import LOSSES
from pgm.cpds.robust import RobustNoise
from pgm.linearisers.lineariser import by_values
from pgm.variables import Variable


def plate(cpd: ConditionalGaussian) -> Hashable:
    """A key that CPDs have in common which are of one plate.

    Nonlinear ones have the same function, Jacobians and lineariser, and the same objects, as equal
    ones of a user's may compute different values. Affine ones have any numbers. All have parents
    and children of the same numbers of components, with angles at the same places. Those at
    steps of time are apart from others. A CPD whose noise depends on parents is of a plate with its
    own copies.
    """
    if isinstance(cpd.cov, Noise):
        return cpd.origin
    timed = cpd.child.step is not None
    shape = (
        timed,
        _form(cpd.child),
        tuple(map(_form, cpd.given)),
        cpd.cov.shape,
        _loss(cpd.noise),
    )
    if isinstance(cpd, NonlinearGaussianCPD):
        jacobians = tuple(_identity(cpd.jacobian.get(parent)) for parent in cpd.given)
        rule = cpd.lineariser
        own = rule if by_values(rule) else _identity(rule)
        return shape, _identity(cpd.function), jacobians, own
    if isinstance(cpd, AffineCPD) and not isinstance(cpd, ByRunCPD):
        return shape, cpd.offset.shape
    return cpd.origin


def _form(variable: Variable) -> Hashable:
    return _angles(variable.components, variable.angles)


@lru_cache(maxsize=1024)
def _angles(components: tuple[str, ...], angles: tuple[str, ...]) -> tuple[bool, ...]:
    return tuple(name in angles for name in components)


def _loss(noise: RobustNoise | None) -> Hashable:
    """A key of robust noise: its numbers, or of a user's own class its identity."""
    return noise if type(noise) in LOSSES else _identity(noise)


def _identity(part: Any) -> Hashable:
    """An identity that no other living part has, even if it says that they are equal.

    All parts live as long as their network. A bound method is made anew each time it is asked for.
    """
    if isinstance(part, MethodType):
        return id(part.__self__), id(part.__func__)
    return id(part)
