"""The figures of a study by setting: means, their standard errors, and quantiles.

Parts are read one after the other, in their order: memory is that of a part, and sums do not depend
on who worked out which part when.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from experiments.studies.errors import StudyError
from experiments.studies.folder import Folder
from experiments.studies.quantiles import PASSES, Quantiles
from experiments.studies.settings import Value
from experiments.studies.study import Part, Study

Array = npt.NDArray[np.float64]

PROBABILITIES = (0.0, 0.05, 0.25, 0.5, 0.75, 0.95, 1.0)


@dataclass(frozen=True)
class Row:
    """A figure of a setting, over its runs.

    Attributes
    ----------
    settings : mapping of str
        All of them.
    figure : str
    runs : int
        That have the figure.
    without : int
        That have none: theirs is NaN.
    mean, error, std : float
        The mean, its standard error, and the standard deviation of a run; NaN where too few runs
        have the figure.
    quantiles : mapping of float to float
        By probability, from 0, the least, to 1.
    """

    settings: Mapping[str, Value]
    figure: str
    runs: int
    without: int
    mean: float
    error: float
    std: float
    quantiles: Mapping[float, float]

    @property
    def numbers(self) -> dict[str, Any]:
        """For a summary."""
        return {
            **self.settings,
            "figure": self.figure,
            "runs": self.runs,
            "without": self.without,
            "mean": self.mean,
            "error": self.error,
            "std": self.std,
            "quantiles": {str(each): value for each, value in self.quantiles.items()},
        }


@dataclass(frozen=True, eq=False)
class Table:
    """The figures of a study, a row each.

    Attributes
    ----------
    study : Study
    rows : tuple of Row
    parts : int
        That were there, of ``study.parts``.
    """

    study: Study
    rows: tuple[Row, ...]
    parts: int

    def __getitem__(self, figure: str) -> tuple[Row, ...]:
        """The rows of a figure, one a setting."""
        found = tuple(row for row in self.rows if row.figure == figure)
        if not found:
            names = dict.fromkeys(row.figure for row in self.rows)
            raise KeyError(f"{self.study.name} has no figure {figure!r}; it has {', '.join(names)}")
        return found

    @property
    def figures(self) -> list[str]:
        """Their names."""
        return list(dict.fromkeys(row.figure for row in self.rows))

    def head(self) -> list[str]:
        """The heads of its columns."""
        return [*self.study.over, "figure", "runs", "mean", "± error", "5 %", "median", "95 %"]

    def cells(self) -> list[list[str]]:
        """Its rows in words, numbers to four digits."""
        return [
            [
                *(str(row.settings[name]) for name in self.study.over),
                row.figure,
                f"{row.runs:,}",
                *(f"{each:.4g}" for each in (row.mean, row.error)),
                *(f"{row.quantiles[each]:.4g}" for each in (0.05, 0.5, 0.95)),
            ]
            for row in self.rows
        ]

    def __str__(self) -> str:
        lines = [self.head(), *self.cells()]
        widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
        return "\n".join(
            "  ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)).rstrip()
            for line in lines
        )


def table(study: Study, folder: Folder) -> Table:
    """The table of the parts that a folder has.

    Raises
    ------
    StudyError
        If there is none yet, or one is damaged.
    """
    lacking = set(folder.missing())
    there = [part for part in study.each() if part not in lacking]
    if not there:
        raise StudyError(f"{folder.path} has no part yet; run the study")
    rows: list[Row] = []
    for k, setting in enumerate(study.settings):
        own = [part for part in there if part.setting == k]
        rows.extend(_rows(setting, folder, own))
    return Table(study, tuple(rows), len(there))


def _rows(setting: Mapping[str, Value], folder: Folder, parts: list[Part]) -> Iterator[Row]:
    names = list(folder.figures)
    moments = {name: _Moments() for name in names}
    quantiles = {name: Quantiles(PROBABILITIES) for name in names}
    for sweep in range(PASSES):
        for part in parts:
            for name, given in folder.read(part, names).items():
                values = np.asarray(given, np.float64)
                values = values[~np.isnan(values)]
                quantiles[name].add(values)
                if not sweep:
                    moments[name].add(values, len(given))
        for each in quantiles.values():
            each.end_pass()
    for name in names:
        found = moments[name]
        spread = found.squares / (found.count - 1) if found.count > 1 else np.nan
        yield Row(
            setting,
            name,
            found.count,
            found.asked - found.count,
            found.mean if found.count else np.nan,
            float(np.sqrt(spread / found.count)) if found.count else np.nan,
            float(np.sqrt(spread)),
            dict(zip(PROBABILITIES, quantiles[name].values().tolist(), strict=True)),
        )


@dataclass
class _Moments:
    """Count, mean and sum of squared deviations of numbers that come in pieces.

    Chan, Golub & LeVeque, Algorithms for computing the sample variance, 1983, equation 2.1.
    """

    count: int = 0
    asked: int = 0
    mean: float = 0.0
    squares: float = field(default=0.0)

    def add(self, values: Array, asked: int) -> None:
        self.asked += asked
        if not len(values):
            return
        own = float(values.mean())
        count = self.count + len(values)
        apart = own - self.mean
        self.squares += float(np.square(values - own).sum())
        self.squares += apart**2 * self.count * len(values) / count
        self.mean += apart * len(values) / count
        self.count = count
