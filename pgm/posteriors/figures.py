"""A belief family's own figures: what a status tells beside iterations, digits and convergence."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, ClassVar

import numpy as np

from pgm.arguments import public
from pgm.display import InCode, Shown, number
from pgm.errors import BeliefWarning, levels_to_user
from pgm.immutable import Immutable
from pgm.kernels.arrays import Array, Mask


@public
@dataclass(frozen=True)
class Threshold(InCode):
    """The limit of a belief family's own figure, beyond which the user is warned.

    Attributes
    ----------
    limit : float
    below : bool
        Whether figures below the limit are bad; else those above it.
    remedy : str
        What to do, for the warning.

    Examples
    --------
    >>> print(pgm.Threshold(10.0, below=True, remedy="take more members"))
    less than 10
    """

    limit: float
    below: bool = False
    remedy: str = "look at the beliefs"

    def passed(self, values: Array) -> Mask:
        """Where figures are beyond the limit, or NaN."""
        return ~(values >= self.limit) if self.below else ~(values <= self.limit)

    def worst(self, values: Array) -> float:
        """The figure furthest beyond the limit."""
        return float(values.min() if self.below else values.max())

    def __str__(self) -> str:
        return f"{'less' if self.below else 'more'} than {self.limit:g}"


class Figures(Shown, Immutable):
    """Base of a family's own figures, which are its attributes; a `Status` shows them."""

    # More phrases than this stand on lines of their own.
    on_a_line: ClassVar[int] = 3

    @property
    def phrases(self) -> list[str]:
        """The figures in words, for a status that is shown, such as "outside 0.01"."""
        raise NotImplementedError

    @property
    def _title(self) -> str:
        return f"{type(self).__name__}({'; '.join(self.phrases)})"

    @property
    def numbers(self) -> Mapping[str, Any]:
        """The figures by name."""
        return MappingProxyType({k: v for k, v in vars(self).items() if not k.startswith("_")})


class OwnFigures(Figures):
    """The figures of a user's own family, (*runs, steps) each, and the thresholds of some."""

    _numbers: Mapping[str, Array]
    _warns: Mapping[str, Threshold]

    def __init__(self, numbers: Mapping[str, Array], warns: Mapping[str, Threshold]) -> None:
        for array in numbers.values():
            array.flags.writeable = False
        self._set(_numbers=MappingProxyType(dict(numbers)), _warns=MappingProxyType(dict(warns)))

    def __getattr__(self, name: str) -> Array:
        found = self.__dict__.get("_numbers", {})
        if name not in found:
            raise AttributeError(name)
        array: Array = found[name]
        return array

    def __reduce__(self) -> tuple[Any, ...]:
        return OwnFigures, (dict(self._numbers), dict(self._warns))

    @property
    def numbers(self) -> Mapping[str, Array]:
        """The figures by name."""
        return self._numbers

    @property
    def phrases(self) -> list[str]:
        """Each figure, from its least to its largest."""
        return [f"{name} {_spread(each)}" for name, each in self._numbers.items()]

    def passed(self) -> list[str]:
        """The names of the figures that are beyond their thresholds."""
        return [
            name
            for name, threshold in self._warns.items()
            if name in self._numbers and threshold.passed(self._numbers[name]).any()
        ]

    def warn(self, whose: str, before: Any = None) -> None:
        """Give a `BeliefWarning` for each figure beyond its threshold; `whose` begins its text.

        Not of those of which the figures `before` have given one: of a smoother's forward pass.
        """
        told = () if before is None else before.passed()
        for name in self.passed():
            if name not in told:
                threshold = self._warns[name]
                worst = threshold.worst(self._numbers[name])
                message = f"{whose}: {name} is {worst:.3g} at its worst (status.{name}), "
                message += f"{threshold}: {threshold.remedy}"
                warnings.warn(message, BeliefWarning, stacklevel=levels_to_user())


def _spread(values: Array) -> str:
    """Figures as text: the least to the largest, or one where they are equal."""
    low, high = float(values.min(initial=np.inf)), float(values.max(initial=-np.inf))
    return number(low, 4) if low == high else f"{number(low, 4)} to {number(high, 4)}"
