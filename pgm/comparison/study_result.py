"""The result of a study: statistics of methods over many drawn runs, and the runs themselves."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from os import PathLike
from pathlib import Path
from types import MappingProxyType
from typing import Any, ClassVar

import numpy as np

from pgm.beliefs.own.family import BeliefFamily
from pgm.boundary import is_whole
from pgm.comparison.drawn_runs import DrawnRuns
from pgm.comparison.table import shown
from pgm.display import Listing, NoArray, Shown, Summary, count, few, number
from pgm.display.notebook import Surveyed
from pgm.errors import ModelError
from pgm.factors.scope import labels, listed
from pgm.immutable import Immutable
from pgm.inference import Filtering, FixedLag, Kind, Smoothing
from pgm.kernels.arrays import Array, Integers
from pgm.linearisers import Lineariser
from pgm.networks import Sample
from pgm.resources import FRAMES, optional
from pgm.variables import Variable


@dataclass(frozen=True, eq=False, repr=False)
class Statistic(NoArray, Shown):
    """A statistic over runs, of all steps and of each, with standard errors over runs.

    A mean over steps weighs all values equally; its error allows for the steps of one run, which
    depend on each other. Errors are NaN of a single run. In the shapes ``...`` is d, the number of
    components, of errors and biases, and nothing of the other statistics.

    Attributes
    ----------
    value, error : ndarray
        (...): over all runs and steps, and its standard error.
    by_step, error_by_step : ndarray
        (T+1, ...): over runs; NaN at steps where no run has it.
    expected : float
        The value that a right belief has; NaN of a root mean square error.

    Examples
    --------
    >>> from pgm.examples import walk
    >>> found = pgm.study(walk, steps=5, runs=100, methods={"KF": pgm.Taylor()}, seed=1)
    >>> found["KF"].nees.by_step.shape
    (6,)
    """

    value: Array
    error: Array
    by_step: Array
    error_by_step: Array
    expected: float = np.nan

    _arrays: ClassVar[str] = ".value and .by_step"

    @property
    def _title(self) -> str:
        each = zip(np.ravel(self.value), np.ravel(self.error), strict=True)
        text = ", ".join(shown(value, error) for value, error in each)
        right = "" if np.isnan(self.expected) else f"; right: {number(self.expected)}"
        return f"Statistic({text}{right})"


@dataclass(frozen=True, eq=False, repr=False)
class StudyRow(Shown):
    """The beliefs of one state by one method, judged by the truths of the runs.

    Attributes
    ----------
    method : str
        Its name.
    lineariser : Lineariser
    schedule : schedule
    state : Variable
    kind : Kind
        Which measurements the beliefs know.
    runs : int
        The runs that count, all but those that failed.
    rmse, bias : Statistic
        Root mean square and mean of the error, belief less truth, by component and in its units;
        angles wrapped.
    nees : Statistic
        The normalised estimation error squared: a right belief has the number of components. Steps
        at which a covariance of some run is singular are left out.
    coverage : Statistic
        The share of truths in the belief's region of the study's confidence.
    nis : mapping of Variable to Statistic
        The normalised innovation squared of each sensor, of a smoother that of its forward pass; a
        right filter has the number of components that were read.
    diverged : ndarray of int
        The numbers of the runs whose last belief of any of the states leaves out the truth: their
        NEES at the last step is beyond the χ² quantile of 1 − 10⁻⁶. They count in the statistics.
    failed : ndarray of int
        The numbers of the runs in which the method ended in an error.
    unsettled : int
        The number of the runs whose iterations ended before they settled; they count.
    worst : int or None
        The number of the run with the largest NEES at any step; None where no run has any, as of a
        state whose covariances are all singular.
    belief : BeliefFamily or None
        The family of beliefs, of a method that has one in place of a lineariser.
    kl : Statistic or None
        KL divergence from the oracle's belief, in nats, where the study has an oracle; both are
        Gaussians of the same moments. Of draws its bias is subtracted.
    kl_error : float
        The part of ``kl.error`` that is the oracle's Monte Carlo error: zero of an oracle without
        draws, NaN where it tells none.
    kl_error_by_step : ndarray
        (T+1,): that of each step.
    doubtful : ndarray of int
        The numbers of the runs whose oracle is not to be trusted, as it has few effective draws, or
        failed; where it failed `kl` has no value.
    weak : str
        Why the oracle is too weak for `kl`, in words; empty where it is not.

    Examples
    --------
    >>> from pgm.examples import walk
    >>> found = pgm.study(walk, steps=5, runs=100, methods={"KF": pgm.Taylor()}, seed=1)
    >>> found["KF"].runs, found["KF"].nees.expected
    (100, 1.0)
    """

    method: str
    lineariser: Lineariser
    schedule: Filtering | FixedLag | Smoothing
    state: Variable
    kind: Kind
    runs: int
    rmse: Statistic
    bias: Statistic
    nees: Statistic
    coverage: Statistic
    nis: Mapping[Variable, Statistic]
    diverged: Integers
    failed: Integers
    unsettled: int
    worst: int | None
    belief: BeliefFamily[Any] | None = None
    kl: Statistic | None = None
    kl_error: float = np.nan
    kl_error_by_step: Array = field(default_factory=lambda: np.full(0, np.nan))
    doubtful: Integers = field(default_factory=lambda: np.zeros(0, dtype=np.intp))
    weak: str = ""

    def __post_init__(self) -> None:
        object.__setattr__(self, "nis", MappingProxyType(dict(self.nis)))

    @property
    def _title(self) -> str:
        return f"StudyRow({self.method}, {self.state!r}, {self.kind}, {count(self.runs, 'run')})"

    def _summary(self) -> Summary:
        cells = [
            [name, shown(value, error), "" if np.isnan(right) else number(right)]
            for name, value, error, right in self._figures()
        ]
        parts: list[str | Listing] = [Listing(("", "", "right"), cells)]
        parts += [
            f"{len(found)} {what}, runs {listed(found.tolist())}"
            for what, found in (("diverged", self.diverged), ("failed", self.failed))
            if len(found)
        ]
        if self.unsettled:
            parts.append(f"iterations had not settled in {count(self.unsettled, 'run')}")
        if self.kl is not None and not np.isnan(self.kl_error):
            parts.append(f"KL is known to ± {self.kl_error:.2g} by the oracle's draws")
        if self.weak:
            parts.append(f"the oracle is too weak: {self.weak}")
        return Summary(self._title, parts)

    def _statistics(self) -> dict[str, Statistic]:
        found = {"RMSE": self.rmse, "bias": self.bias, "NEES": self.nees}
        found |= {"coverage": self.coverage} | ({"KL": self.kl} if self.kl is not None else {})
        return found | {f"NIS {z.name}": statistic for z, statistic in self.nis.items()}

    def _figures(self, step: int | None = None) -> Iterable[tuple[str, float, float, float]]:
        """Name, value, error and right value of each statistic, of all steps or of one."""
        for name, each in self._statistics().items():
            value, error = (
                (each.value, each.error)
                if step is None
                else (each.by_step[step], each.error_by_step[step])
            )
            names = [f"{name} {label}" for label in labels((self.state,))]
            for label, one, its in zip(
                names if value.ndim else [name], np.ravel(value), np.ravel(error), strict=True
            ):
                yield label, float(one), float(its), each.expected

    def __getstate__(self) -> dict[str, Any]:
        return self.__dict__ | {"nis": dict(self.nis)}  # a read-only view cannot be pickled

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self.__post_init__()


class Study(Shown, Immutable, Surveyed):
    """Methods beside each other over many drawn runs; its text is a table.

    ``found["EKF"]`` is the row of a method, of the only state; ``found["EKF", x]`` that of one of
    several. `pgm.plot.study` draws it over time.

    Attributes
    ----------
    rows : tuple of StudyRow
        One row for each method and state.
    runs : int
    steps : int
        T.
    seed : int
    confidence : float
        Of the regions whose coverage is counted.
    compilation : str
        Where a card was asked for, the methods whose runs were drawn, swept and summed there, and
        why others were not; else empty.

    Examples
    --------
    >>> from pgm.examples import walk, x, z
    >>> methods = {"KF": pgm.Filtering(), "RTS": pgm.Smoothing()}
    >>> found = pgm.study(walk, steps=10, runs=200, methods=methods, seed=1)
    >>> bool(found["RTS"].rmse.value < found["KF"].rmse.value)
    True
    >>> again = pgm.filter(walk, found.run(17).evidence)
    """

    rows: tuple[StudyRow, ...]
    runs: int
    steps: int
    seed: int
    confidence: float
    compilation: str
    _drawn: DrawnRuns

    def __init__(
        self,
        rows: Iterable[StudyRow],
        drawn: DrawnRuns,
        confidence: float,
        compilation: str = "",
    ) -> None:
        self._set(rows=tuple(rows), runs=drawn.runs, steps=drawn.steps, seed=drawn.seed)
        self._set(confidence=confidence, compilation=compilation, _drawn=drawn)

    @property
    def states(self) -> tuple[Variable, ...]:
        """The states judged."""
        return tuple(dict.fromkeys(row.state for row in self.rows))

    def __getitem__(self, key: Any) -> StudyRow:
        """The row of a method by its name, and of a state where there are several.

        Raises
        ------
        ModelError
            If there is no such row, or several.
        """
        method, *rest = key if isinstance(key, tuple) else (key,)
        named = isinstance(method, str) and all(isinstance(each, Variable) for each in rest)
        rows = self.rows if named else ()
        found = [r for r in rows if r.method == method and rest in ([], [r.state])]
        if len(found) == 1:
            return found[0]
        if found:
            raise ModelError(
                f"{key!r} has rows of {listed(self.states)}; name the state, "
                f"[{method!r}, {found[0].state.name}]"
            )
        names = list(dict.fromkeys(row.method for row in self.rows))
        raise ModelError(
            f"no row {key!r}; a study is asked for a method of {names}, and a state of "
            f"{listed(self.states)}"
        )

    # Python would else iterate by asking for the rows 0, 1, ...
    __iter__ = None

    def run(self, number: int) -> Sample:
        """The truth and the evidence of one run, drawn anew: as the methods had them.

        Parameters
        ----------
        number : int
            From 0, as in `StudyRow.diverged`.

        Raises
        ------
        ModelError
            If the study has no such run.
        """
        if not is_whole(number) or not 0 <= number < self.runs:
            raise ModelError(f"the study has runs 0 to {self.runs - 1}, not {number!r}")
        return self._drawn.run(int(number))

    def to_frame(self, *, by_step: bool = False) -> Any:
        """The statistics as a data frame of pandas, a row for each method, state and statistic.

        Parameters
        ----------
        by_step : bool
            Whether each step has rows of its own.

        Returns
        -------
        pandas.DataFrame
            Columns method, state, step (with `by_step`), statistic, value, error, expected.

        Raises
        ------
        ImportError
            If pandas is not installed (``pip install 'sepset[frames]'``); `rows` has the same
            numbers.
        """
        pandas = optional("pandas", "Study.to_frame()", FRAMES)
        names = ("statistic", "value", "error", "expected")
        records = [
            {"method": row.method, "state": row.state.name}
            | ({} if step is None else {"step": step})
            | dict(zip(names, figures, strict=True))
            for row in self.rows
            for step in (range(self.steps + 1) if by_step else [None])
            for figures in row._figures(step)
        ]
        return pandas.DataFrame.from_records(records)

    def report(self, path: str | PathLike[str]) -> Path:
        """Write one page on the study, for a browser.

        On top it says in a line each, with a mark, what its sections find: runs that diverged,
        failed or did not settle, with their numbers; RMSE and bias of each state; whether its
        beliefs are right about their errors, by NEES and coverage; NIS of each sensor. Sections
        have a table of all methods, and charts over time in bands of 1.96 standard errors. A
        figure is marked where it differs from its right value by more than is due to chance in one
        study of a hundred. The page asks nothing of a network.

        Parameters
        ----------
        path : str or path-like
            The file's path, like ``"study.html"``; an old one is replaced.

        Returns
        -------
        Path
            The file's path.

        Raises
        ------
        OSError
            If the file cannot be written.

        Examples
        --------
        >>> import tempfile
        >>> from pgm.examples import walk
        >>> found = pgm.study(walk, steps=5, runs=100, methods={"KF": pgm.Taylor()}, seed=1)
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     found.report(f"{folder}/study.html").name
        'study.html'
        """
        return self._report(path)

    @property
    def _title(self) -> str:
        methods = count(len({row.method for row in self.rows}), "method")
        return f"Study of {methods}, steps 0..{self.steps}, {count(self.runs, 'run')}"

    def _summary(self) -> Summary:
        methods = list(dict.fromkeys(row.method for row in self.rows))
        cells = [line for state in self.states for line in self._lines(state)]
        for what, found in (
            ("diverged", [len(self[name, self.states[0]].diverged) for name in methods]),
            ("failed", [len(self[name, self.states[0]].failed) for name in methods]),
            ("unsettled", [self[name, self.states[0]].unsettled for name in methods]),
        ):
            if any(found):
                cells.append([what, "", *map(str, found)])
        kept = [None if k is None else cells[k] for k in few(len(cells))]
        told = [f"right: what a right belief has; regions of confidence {number(self.confidence)}"]
        told += [
            f"KL of {row.method}, {row.state.name}: the oracle is too weak: {row.weak}"
            for row in self.rows
            if row.weak
        ]
        told += [self.compilation] if self.compilation else []
        return Summary(self._title, [Listing(["", "right", *methods], kept), *told])

    def _lines(self, state: Variable) -> Iterable[list[str]]:
        """The statistics of a state, each with the values of all methods that have it."""
        of = f" of {state.name}" if len(self.states) > 1 else ""
        rows = [
            {name: figures for name, *figures in row._figures()}
            for row in self.rows
            if row.state == state
        ]
        names = dict.fromkeys(name for row in rows for name in row)
        for name in sorted(names, key=lambda name: name.startswith("NIS")):
            sensors = name.startswith("NIS")
            if sensors and state != self.states[0]:  # of a sensor, told once
                continue
            right = next(row[name][2] for row in rows if name in row)
            first = "" if np.isnan(right) else number(right)
            cells = (shown(*row.get(name, [np.nan])[:2]) for row in rows)
            yield [name if sensors else name + of, first, *cells]
