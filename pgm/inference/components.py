"""The components of beliefs that are point masses: asked for by name, and as whole variables."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

from pgm.errors import ModelError
from pgm.factors.scope import Scope, listed
from pgm.variables import Variable


class Component(Protocol):
    """One component of a variable, with the name that it has in a belief."""

    @property
    def variable(self) -> Variable:
        """The variable."""

    @property
    def component(self) -> int:
        """Its place in the variable."""

    @property
    def label(self) -> str:
        """Its name, with that of the variable where variables share it."""


def places_of(each: Sequence[Component], asked: Sequence[str], what: str) -> tuple[int, ...]:
    """The places of components by name, each named once, for a result called `what`."""
    labels = [component.label for component in each]
    named = all(isinstance(name, str) for name in asked)
    if not asked or not named or len(set(asked)) < len(asked):
        raise ModelError(
            f"{what} is of one or more of {listed(labels)}, by name, each once; found "
            f"{tuple(asked)}"
        )
    unknown = [name for name in asked if name not in labels]
    if unknown:
        raise ModelError(
            f"{unknown[0]!r} is no component of this belief; those are {listed(labels)}"
        )
    return tuple(labels.index(name) for name in asked)


def whole_variables(each: Sequence[Component]) -> Scope:
    """The variables whose components these are, refused if some are missing or out of order."""
    variables = tuple(dict.fromkeys(component.variable for component in each))
    due = [(v, k) for v in variables for k in range(v.dimension)]
    if [(component.variable, component.component) for component in each] != due:
        labels = [component.label for component in each]
        raise ModelError(
            f"a Gaussian is over whole variables: {listed(labels)} are not all components of "
            f"{listed(variables)} in their order; take .mean and .cov"
        )
    return variables
