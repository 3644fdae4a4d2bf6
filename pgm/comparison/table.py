"""The table of a comparison."""

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from pgm.comparison.row import Row
from pgm.display import Listing, Shown, Summary, count, few
from pgm.errors import ModelError
from pgm.factors.scope import listed
from pgm.immutable import Immutable
from pgm.resources import FRAMES, optional
from pgm.variables import Variable

_NONE = "–"
# Why an oracle's own KL may be NaN.
UNKNOWN = "NaN of beliefs that tell none by non_gaussianity(), as draws, which have no density"
# Failures that are told.
FAILED = 3


class Comparison(Shown, Immutable):
    """Linearisers and schedules beside each other; its text is a table.

    ``found["Taylor", "filter"]`` is a row, of the only state; ``found["Taylor", "filter", x]`` that
    of one of several. `pgm.plot.comparison` draws it.

    Attributes
    ----------
    rows : tuple of Row
        One row for each lineariser, schedule and state, in the order given.
    oracle_rows : tuple of Row
        The oracle's own, of each kind and state: how far it is from a Gaussian, and that Gaussian
        against the truth.
    steps : int
        T.
    runs : tuple of int
        The axes of runs that were averaged.
    oracle : str
        The oracle in words; empty without one.
    oracle_status : str
        The status of an oracle whose family of beliefs has figures of its own, in words: what a
        grid's bounds and cells cost, how many of the particles count, or what yours has to say.

    Examples
    --------
    >>> from pgm.examples import walk, z
    >>> found = pgm.compare(walk, {z: [[2.0], [3.0]]}, linearisers=[pgm.Taylor(), pgm.Unscented()])
    >>> [row.lineariser for row in found.rows]
    ['Taylor', 'Taylor', 'Unscented', 'Unscented']
    """

    rows: tuple[Row, ...]
    oracle_rows: tuple[Row, ...]
    steps: int
    runs: tuple[int, ...]
    oracle: str
    oracle_status: str

    def __init__(
        self,
        rows: Iterable[Row],
        oracle_rows: Iterable[Row],
        steps: int,
        runs: tuple[int, ...],
        oracle: str,
        oracle_status: str = "",
    ) -> None:
        self._set(rows=tuple(rows), oracle_rows=tuple(oracle_rows), steps=steps, runs=runs)
        self._set(oracle=oracle, oracle_status=oracle_status)

    @property
    def states(self) -> tuple[Variable, ...]:
        """The states compared."""
        return tuple(dict.fromkeys(row.state for row in self.rows))

    def __getitem__(self, key: Any) -> Row:
        """The row of a lineariser and a schedule, by their names, and a state, if of several.

        Raises
        ------
        ModelError
            If there is no such row, or several.
        """
        parts = key if isinstance(key, tuple) else (key,)
        found = [
            row
            for row in self.rows
            if parts in ((row.lineariser, row.schedule), (row.lineariser, row.schedule, row.state))
        ]
        if len(found) == 1:
            return found[0]
        if found:
            raise ModelError(
                f"{key!r} has rows of {listed(self.states)}; name the state, "
                f"[{parts[0]!r}, {parts[1]!r}, {self.states[0].name}]"
            )
        names = [list(dict.fromkeys(getattr(r, n) for r in self.rows)) for n in _NAMES]
        raise ModelError(
            f"no row {key!r}; a comparison is asked for a lineariser of {names[0]} and a schedule "
            f"of {names[1]}, by their names"
        )

    # Python would else iterate by asking for the rows 0, 1, ...
    __iter__ = None

    def to_frame(self) -> Any:
        """The table as a data frame of pandas, the oracle's rows last.

        Returns
        -------
        pandas.DataFrame
            Columns lineariser, schedule, state, oracle (whether the row is its own), kl, kl_most,
            kl_step, rmse_<component>, nees, nees_expected, log_evidence, log_evidence_kind,
            seconds, converged, left_out, error; NaN where there is nothing.

        Raises
        ------
        ImportError
            If pandas is not installed (``pip install 'sepset[frames]'``); `rows` has the same
            numbers.
        """
        pandas = optional("pandas", "Comparison.to_frame()", FRAMES)
        records = [
            {"lineariser": row.lineariser, "schedule": row.schedule, "state": row.state.name}
            | {"oracle": row in self.oracle_rows}
            | {"kl": row.kl, "kl_most": row.kl_most}
            | {"kl_step": np.nan if row.kl_step is None else row.kl_step}
            | {f"rmse_{label}": row.rmse.get(label, np.nan) for label in self._components}
            | {name: getattr(row, name) for name in _FRAME}
            for row in (*self.rows, *self.oracle_rows)
        ]
        return pandas.DataFrame.from_records(records)

    @property
    def _components(self) -> list[str]:
        return list(dict.fromkeys(label for row in self.rows for label in row.rmse))

    @property
    def _title(self) -> str:
        linearisers, schedules = (len({getattr(r, n) for r in self.rows}) for n in _NAMES)
        runs = f", {count(int(np.prod(self.runs)), 'run')}" if self.runs else ""
        oracle = f"; oracle {self.oracle}" if self.oracle else ""
        return (
            f"Comparison of {count(linearisers, 'lineariser')} under "
            f"{count(schedules, 'schedule')}, steps 0..{self.steps}{runs}{oracle}"
        )

    def _summary(self) -> Summary:
        heads, *rows = zip(*self._columns(), strict=True)
        names = sum(head in (*_NAMES, "state") for head in heads)
        shown = [None if k is None else rows[k] for k in few(len(rows))]
        failed = [f"{_who(row)}: {row.error}" for row in self.rows if row.error]
        notes = failed[:FAILED] + [f"... {len(failed)} failed"] * (len(failed) > FAILED)
        left = [row for row in (*self.rows, *self.oracle_rows) if row.left_out]
        if left:
            most = max(row.left_out for row in left)
            notes.append(
                f"KL and NEES leave out up to {count(most, 'step')} of {self.steps + 1}, where a "
                "covariance is singular or infinite"
            )
        if self.oracle_rows:
            own = "KL of the oracle's rows: from its own Gaussian, KL(p ‖ N_p)"
            unknown = any(np.isnan(row.kl) for row in self.oracle_rows)
            notes.append(own + (f"; {UNKNOWN}" if unknown else ""))
        if self.oracle_status:
            notes.append(f"the oracle's status: {self.oracle_status}")
        return Summary(self._title, [Listing(heads, shown, names), *notes])

    def _columns(self) -> list[list[str]]:
        rows = [*self.rows, *self.oracle_rows]
        columns = [["lineariser", *(row.lineariser for row in rows)]]
        columns.append(["schedule", *(row.schedule for row in rows)])
        if len(self.states) > 1:
            columns.append(["state", *(row.state.name for row in rows)])
        numbers: list[tuple[str, Sequence[float]]] = [
            ("KL [nats]", [row.kl for row in rows]),
            ("most", [row.kl_most for row in rows]),
            ("at step", [np.nan if row.kl_step is None else row.kl_step for row in rows]),
        ]
        for label in self._components:
            numbers.append((f"RMSE {label}", [row.rmse.get(label, np.nan) for row in rows]))
        numbers += [
            ("NEES", [row.nees for row in rows]),
            ("of", [row.nees_expected for row in rows]),
            ("ln p(z)", [row.log_evidence for row in rows]),
            ("converged", [row.converged for row in rows]),
            ("seconds", [row.seconds for row in rows]),
        ]
        for head, values in numbers:
            if not np.isnan(values).all():
                columns.append([head, *map(_shown, values)])
        return columns


_NAMES = ("lineariser", "schedule")
_FRAME = (
    "nees",
    "nees_expected",
    "log_evidence",
    "log_evidence_kind",
    "seconds",
    "converged",
    "left_out",
    "error",
)


def _shown(value: float) -> str:
    return _NONE if np.isnan(value) else f"{value:.4g}"


def _who(row: Row) -> str:
    return f"{row.lineariser}, {row.schedule}, {row.state.name}"
