"""Random variables: a name, named components, which of them are angles, and a step in time."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from pgm.errors import ModelError


@dataclass(frozen=True, slots=True)
class Variable:
    """A continuous random variable, scalar or vector.

    Parameters
    ----------
    name : str
        Two different variables of one network may not share it.
    components : tuple of str, optional
        Names of the components, in order; a scalar's single component is named like the variable.
    angles : tuple of str, optional
        The components that are angles, in radians.
    step : int, optional
        The step of a concrete copy (see `at`); None in a template, which holds for every step.
    lag : int, optional
        How many steps before the current one a template stands (see `previous`).

    Raises
    ------
    ModelError
        If names repeat, an angle is no component, or a step is negative.

    Examples
    --------
    >>> x = Variable("x", components=("east", "north", "heading"), angles=("heading",))
    >>> x.previous, x.at(3), x.at(3).previous
    (x[t-1], x[3], x[2])
    >>> x.at(3).previous == x.at(2) == x.previous.at(3)
    True
    """

    name: str
    components: tuple[str, ...] = ()
    angles: tuple[str, ...] = ()
    step: int | None = None
    lag: int = 0

    def __post_init__(self) -> None:
        if not isinstance(self.name, str) or not self.name:
            raise ModelError(f"a variable's name must be a non-empty string, not {self.name!r}")
        for field in ("components", "angles"):
            value = getattr(self, field)
            if (
                isinstance(value, str)
                or not isinstance(value, Iterable)
                or not all(isinstance(name, str) for name in value)
            ):
                raise ModelError(
                    f"variable {self.name}: {field} must be a tuple of names, not {value!r}",
                    variable=self,
                )
            object.__setattr__(self, field, tuple(value))
        if not self.components:
            object.__setattr__(self, "components", (self.name,))
        if len(set(self.components)) < len(self.components):
            raise ModelError(
                f"variable {self.name}: components {self.components} repeat a name; "
                "give each component a name of its own",
                variable=self,
            )
        strangers = [name for name in self.angles if name not in self.components]
        if strangers:
            raise ModelError(
                f"variable {self.name}: angles {strangers} are not among its components "
                f"{self.components}",
                variable=self,
            )
        for field, value in (("step", self.step), ("lag", self.lag)):
            if value is None:
                continue
            if not isinstance(value, int | np.integer):
                raise ModelError(
                    f"variable {self.name}: {field} must be a whole number, not {value!r}",
                    variable=self,
                )
            if value < 0:
                raise ModelError(
                    f"variable {self.name}: {field} {value} is before the first, 0", variable=self
                )

    @property
    def dimension(self) -> int:
        """Number of components."""
        return len(self.components)

    @property
    def angle_mask(self) -> npt.NDArray[np.bool_]:
        """Which components are angles, shape (dimension,)."""
        return np.array([name in self.angles for name in self.components], dtype=bool)

    @property
    def previous(self) -> Variable:
        """The same variable one step before."""
        if self.step is not None:
            return self.at(self.step - 1)
        return replace(self, lag=self.lag + 1)

    @property
    def template(self) -> Variable:
        """The variable without a step or lag, which stands for all its copies."""
        return replace(self, step=None, lag=0)

    def at(self, step: int) -> Variable:
        """The copy at a step; for a template with a lag, that many steps before it."""
        if not isinstance(step, int | np.integer):
            raise ModelError(f"{self!r}.at({step!r}): a step is a whole number", variable=self)
        return replace(self, step=int(step) - self.lag, lag=0)

    def __repr__(self) -> str:
        if self.step is not None:
            return f"{self.name}[{self.step}]"
        return f"{self.name}[t-{self.lag}]" if self.lag else self.name


def variables(names: str | Iterable[str]) -> tuple[Variable, ...]:
    """Scalar variables, one a name.

    Parameters
    ----------
    names : str or iterable of str
        Names, in one string separated by white space or commas, or one by one.

    Examples
    --------
    >>> a, b, c = variables("a b c")
    >>> b.dimension
    1
    """
    if isinstance(names, str):
        names = names.replace(",", " ").split()
    names = tuple(names)
    if len(set(names)) < len(names):
        raise ModelError(f"the names {names} repeat; each variable needs one of its own")
    return tuple(Variable(name) for name in names)
