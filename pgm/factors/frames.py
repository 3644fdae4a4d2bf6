"""Beliefs as data frames of pandas."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np

from pgm.errors import ModelError, NumericalError
from pgm.factors.axes import States
from pgm.factors.scope import names
from pgm.kernels import tables as kernel
from pgm.kernels.arrays import Array, Integers
from pgm.optional import FRAMES, optional


class Moments(Protocol):
    """A belief with means and standard deviations, of the components of its last axis."""

    @property
    def components(self) -> tuple[str, ...]:
        """Their names."""

    @property
    def mean(self) -> Array:
        """(..., n)."""

    @property
    def std(self) -> Array:
        """(..., n)."""

    @property
    def steps(self) -> Integers | None:
        """The steps that the last leading axis stands for."""


class Framed:
    """A belief whose moments make a data frame."""

    __slots__ = ()

    def to_frame(self: Moments) -> Any:
        """The means and standard deviations as a data frame of pandas.

        A row for each run and step, in the index: the level ``run``, or ``run_0``, ``run_1``, ...
        where runs have several axes, and the level ``step``, where there are any. Covariances are
        in `cov` alone, and `to_xarray` of a posterior.

        Columns are ``mean_<component>``, then ``std_<component>``, in units of the components. An
        `ImportError` says how to install pandas where it is missing.

        Examples
        --------
        >>> x = pgm.Variable("x", components=("east", "north"))
        >>> walk = pgm.Gaussian(x, mean=[[0, 5], [1, 6], [2, 7]], cov=0.25, steps=[0, 1, 2])
        >>> frame = walk.to_frame()
        >>> list(frame.columns), frame.index.name
        (['mean_east', 'mean_north', 'std_east', 'std_north'], 'step')
        >>> frame["mean_north"].tolist()
        [5.0, 6.0, 7.0]
        """
        pandas = optional("pandas", f"{type(self).__name__}.to_frame()", FRAMES)
        lead = self.mean.shape[:-1]
        levels: list[Any] = list(map(range, lead))
        titles = run_names(len(lead) - (self.steps is not None))
        if self.steps is not None:
            levels[-1], titles = self.steps, [*titles, "step"]
        columns = {
            f"{what}_{label}": moment[..., k].reshape(-1)
            for what, moment in (("mean", self.mean), ("std", self.std))
            for k, label in enumerate(self.components)
        }
        return pandas.DataFrame(columns, index=_index(pandas, levels, titles))


def run_names(axes: int) -> list[str]:
    """The names of axes of runs."""
    return ["run"] if axes == 1 else [f"run_{k}" for k in range(axes)]


class Entries(Protocol):
    """A table."""

    scope: States
    values: Array
    log_scale: Array

    @property
    def _title(self) -> str: ...


class FramedTable:
    """A table whose entries make a data frame."""

    __slots__ = ()

    def to_frame(self: Entries, *, axes: str | Sequence[str] | None = None) -> Any:
        """The entries as a data frame of pandas, with the states of the last variable as columns.

        A row for each of the leading axes' places and each combination of the other variables'
        states, levels of the index that are named like these. A table without variables has the
        one column ``value``. An entry that is too large for a number is a `NumericalError`.

        Parameters
        ----------
        axes : str or sequence of str, optional
            The names of the leading axes, ``"step"`` of ``posterior[x]``, since a table does not
            know what they are of; ``axis`` or ``axis_0``, ``axis_1``, ... without.

        Examples
        --------
        >>> rain, wet = (pgm.Discrete(name, states=("no", "yes")) for name in ("rain", "wet"))
        >>> frame = pgm.Table((rain, wet), [[0.9, 0.1], [0.3, 0.7]]).to_frame()
        >>> frame.index.tolist(), frame.columns.tolist(), float(frame.loc["yes", "no"])
        (['no', 'yes'], ['no', 'yes'], 0.3)
        """
        pandas = optional("pandas", "Table.to_frame()", FRAMES)
        lead, scope = self.log_scale.shape, self.scope
        log_scale = self.log_scale.reshape(lead + (1,) * len(scope))
        values = np.asarray(kernel.entries(self.values, log_scale))
        if np.isinf(values).any():
            raise NumericalError(
                f"an entry of the table over {names(scope)} is too large for a number; take "
                "log_values"
            )
        if axes is None:
            axes = ["axis"] if len(lead) == 1 else [f"axis_{k}" for k in range(len(lead))]
        titles = [axes] if isinstance(axes, str) else list(axes)
        if len(titles) != len(lead):
            raise ModelError(f"axes= has {len(titles)} names; {self._title} has axes {lead}")
        levels = [*map(range, lead), *(variable.states for variable in scope[:-1])]
        columns = pandas.Index(["value"])
        if scope:
            columns = pandas.Index(scope[-1].states, name=repr(scope[-1]))
        index = _index(pandas, levels, [*titles, *map(repr, scope[:-1])])
        return pandas.DataFrame(values.reshape(len(index), -1), index=index, columns=columns)


def _index(pandas: Any, levels: Sequence[Any], titles: Sequence[str]) -> Any:
    if len(levels) > 1:
        return pandas.MultiIndex.from_product(levels, names=titles)
    return pandas.Index(levels[0], name=titles[0]) if levels else pandas.RangeIndex(1)
