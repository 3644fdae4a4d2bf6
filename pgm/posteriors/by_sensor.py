"""Mappings from sensors that have measurements to results, such as innovations or rejections."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import ClassVar, TypeVar

from pgm.display import Shown
from pgm.errors import EvidenceError
from pgm.factors.scope import listed, namesake
from pgm.posteriors.posterior import require_variable
from pgm.variables import Variable

Value = TypeVar("Value")


class EachSensor(Shown, Mapping[Variable, Value]):
    """A mapping from sensors to results of one kind, such as innovations.

    Each kind of results has a subclass of its own. The keys are the sensors that have results. Any
    other key raises an `EvidenceError`, in whose text the results are called `_what`.
    """

    _what: ClassVar[str] = "results"

    def __init__(self, found: Mapping[Variable, Value]) -> None:
        self._found = dict(found)

    def __getitem__(self, variable: Variable) -> Value:
        if self._asked(variable) not in self._found:
            about = variable if isinstance(variable, Variable) else None
            raise EvidenceError(self._absent(variable), variable=about)
        return self._found[variable]

    def _asked(self, variable: Variable) -> Variable:
        """The key that is asked for; one of another kind is refused."""
        return require_variable(variable)

    def _absent(self, variable: Variable) -> str:
        """The text of the error for a variable without results, which a subclass may replace."""
        template = getattr(variable, "template", variable)
        if template != variable and template in self._found:
            return (
                f"{self._what} are of a sensor at all its steps, not at one, {variable!r}: ask for "
                f"{template!r}, and take the rows of the step"
            )
        return (
            f"there are no {self._what} of {variable!r}; measurements were given of {list(self)}"
            f"{namesake(variable, self)}"
        )

    def __contains__(self, variable: object) -> bool:
        return variable in self._found

    def __iter__(self) -> Iterator[Variable]:
        return iter(self._found)

    def __len__(self) -> int:
        return len(self._found)

    @property
    def _title(self) -> str:
        return f"{type(self).__name__}({listed(self._found)})"
