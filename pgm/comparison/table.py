"""The table of a comparison."""

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from pgm.comparison.judgement import Judgement
from pgm.comparison.row import Row
from pgm.display import Listing, Shown, Summary, count, few
from pgm.errors import ModelError
from pgm.factors.scope import listed
from pgm.immutable import Immutable
from pgm.resources import FRAMES, optional
from pgm.variables import Variable

_NONE = "–"
# Failures that are told.
FAILED = 3


class Comparison(Shown, Immutable):
    """Linearisers under schedules, and other rows, beside each other; its text is a table.

    ``found["Taylor", "filter"]`` is a row, of the only state; ``found["Taylor", "filter", x]`` that
    of one of several; ``found["mine"]`` suffices where only one row has this label.
    `pgm.plot.comparison` draws it. In its text "±" is a standard error, and a "?" marks a KL for
    which the oracle is too weak, as the lines below say.

    Attributes
    ----------
    rows : tuple of Row
        One row for each lineariser, schedule and state, in the order given, then those of
        ``rows=``.
    oracle_rows : tuple of Row
        The oracles' own, of each kind and state: how far each is from a Gaussian, and that Gaussian
        against other oracles and the truth.
    steps : int
        T.
    runs : tuple of int
        The axes of runs that were averaged.
    oracle : str
        The oracle in words, or several, a truth among them; empty without one.
    oracles : tuple of str
        Their names, by which a row has them in ``by_oracle``.
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
    oracles: tuple[str, ...]

    def __init__(
        self,
        rows: Iterable[Row],
        oracle_rows: Iterable[Row],
        steps: int,
        runs: tuple[int, ...],
        oracle: str,
        oracle_status: str = "",
        oracles: tuple[str, ...] = (),
    ) -> None:
        self._set(rows=tuple(rows), oracle_rows=tuple(oracle_rows), steps=steps, runs=runs)
        self._set(oracle=oracle, oracle_status=oracle_status, oracles=oracles)

    @property
    def states(self) -> tuple[Variable, ...]:
        """The states compared."""
        return tuple(dict.fromkeys(row.state for row in self.rows))

    def __getitem__(self, key: Any) -> Row:
        """The row of a label and a schedule, by their names, and a state, as far as is needed.

        Raises
        ------
        ModelError
            If there is no such row, or several.
        """
        parts = key if isinstance(key, tuple) else (key,)
        found = [row for row in self.rows if _is(row, parts)]
        if len(found) == 1:
            return found[0]
        names = [list(dict.fromkeys(getattr(r, n) for r in found or self.rows)) for n in _NAMES]
        if len(names[1]) > 1 and found:
            raise ModelError(
                f"{key!r} has rows of {names[1]}; name the schedule, [{parts[0]!r}, "
                f"{names[1][0]!r}]"
            )
        if found:
            state = next(iter(dict.fromkeys(row.state for row in found)))
            raise ModelError(
                f"{key!r} has rows of {listed(self.states)}; name the state, "
                f"[{parts[0]!r}, {names[1][0]!r}, {state.name}]"
            )
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
            Columns lineariser, schedule, state, oracle (whether the row is its own), kl, kl_error,
            kl_most, kl_step, weak, rmse_<component>, rmse_error_<component>, nees, nees_error,
            nees_expected, log_score, log_score_error, log_evidence, log_evidence_kind, seconds,
            converged, left_out, error; NaN where there is nothing. Of several oracles the columns
            from kl to weak are there for each, as kl_<name>.

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
            | self._judged(row)
            | {f"rmse_{label}": row.rmse.get(label, np.nan) for label in self._components}
            | {
                f"rmse_error_{label}": row.rmse_error.get(label, np.nan)
                for label in self._components
            }
            | {name: getattr(row, name) for name in _FRAME}
            for row in (*self.rows, *self.oracle_rows)
        ]
        return pandas.DataFrame.from_records(records)

    def _judged(self, row: Row) -> dict[str, Any]:
        """The judgements of a row by each oracle, by the names of a data frame's columns."""
        found: dict[str, Any] = {}
        for oracle in self.oracles or ("",):
            each = _judgement(row, oracle)
            step = np.nan if each.kl_step is None else each.kl_step
            told: dict[str, Any] = {"kl": each.kl, "kl_error": each.error, "kl_most": each.kl_most}
            told |= {"kl_step": step, "weak": each.weak}
            ending = f"_{oracle}" if len(self.oracles) > 1 else ""
            found |= {f"{name}{ending}": value for name, value in told.items()}
        return found

    @property
    def _components(self) -> list[str]:
        return list(dict.fromkeys(label for row in self.rows for label in row.rmse))

    @property
    def _title(self) -> str:
        number = len({(row.lineariser, row.schedule) for row in self.rows})
        runs = f", {count(int(np.prod(self.runs)), 'run')}" if self.runs else ""
        oracle = f"; oracle {self.oracle}" if self.oracle else ""
        return f"Comparison of {count(number, 'row')}, steps 0..{self.steps}{runs}{oracle}"

    def _summary(self) -> Summary:
        heads, *rows = zip(*self._columns(), strict=True)
        names = sum(head in (*_NAMES, "state") for head in heads)
        kept = [None if k is None else rows[k] for k in few(len(rows))]
        failed = [f"{_who(row)}: {row.error}" for row in self.rows if row.error]
        notes = failed[:FAILED] + [f"... {len(failed)} failed"] * (len(failed) > FAILED)
        left = [row for row in (*self.rows, *self.oracle_rows) if row.left_out]
        if left:
            most = max(row.left_out for row in left)
            notes.append(
                f"KL and NEES leave out up to {count(most, 'step')} of {self.steps + 1}, where a "
                "covariance is singular or infinite"
            )
        notes += self._weak()
        if self.oracle_rows:
            notes.append(self._of_oracles())
        if self.oracle_status:
            notes.append(f"the oracle's status: {self.oracle_status}")
        return Summary(self._title, [Listing(heads, kept, names), *notes])

    def _of_oracles(self) -> str:
        """A line on the KL of the oracles' own rows, and on those of which it is not known."""
        own = (_oracle(row) for row in self.oracle_rows if np.isnan(row.by_oracle[_oracle(row)].kl))
        unknown = ", ".join(dict.fromkeys(own))
        line = "in the row of an oracle p its KL is that from its own Gaussian, KL(p ‖ N_p)"
        if not unknown:
            return line
        return (
            f"{line}; it is not known of {unknown}: beliefs made of draws, and others without "
            "non_gaussianity(), have no density to integrate"
        )

    def _columns(self) -> list[list[str]]:
        rows = [*self.rows, *self.oracle_rows]
        columns = [["lineariser", *(row.lineariser for row in rows)]]
        columns.append(["schedule", *(row.schedule for row in rows)])
        if len(self.states) > 1:
            columns.append(["state", *(row.state.name for row in rows)])
        for oracle in self.oracles:
            columns += self._columns_of(oracle, rows)
        columns += _known(
            (f"RMSE {name}", [shown(row.rmse.get(name, np.nan)) for row in rows])
            for name in self._components
        )
        columns += _known([("NEES", _shown_each(rows, "nees"))])
        columns += _known([("of", [shown(row.nees_expected) for row in rows])])
        columns += _known([("log-score", _shown_each(rows, "log_score"))])
        plain = {"ln p(z)": "log_evidence", "converged": "converged", "seconds": "seconds"}
        return columns + _known(
            (head, [shown(getattr(row, name)) for row in rows]) for head, name in plain.items()
        )

    def _columns_of(self, oracle: str, rows: Sequence[Row]) -> list[list[str]]:
        """The columns of one oracle; of several without the step where the KL is largest."""
        each = [_judgement(row, oracle) for row in rows]
        marks = [" ?" if j.weak and not np.isnan(j.kl) else "" for j in each]
        cells = [shown(j.kl, j.error) + m for j, m in zip(each, marks, strict=True)]
        if len(self.oracles) > 1:
            return _known([(f"KL {oracle}", cells)])
        steps = [np.nan if j.kl_step is None else j.kl_step for j in each]
        most = [shown(j.kl_most) for j in each]
        return _known([("KL [nats]", cells), ("most", most), ("at step", map(shown, steps))])

    def _weak(self) -> list[str]:
        """Lines that say why oracles are too weak for rows, a line for each reason."""
        found: dict[tuple[str, str], list[Row]] = {}
        for row in self.rows:
            for oracle, judgement in row.by_oracle.items():
                if judgement.weak:
                    found.setdefault((oracle, judgement.weak), []).append(row)
        lines = [
            f"? {oracle} is too weak for {_few([_who(row) for row in rows])}: {why}"
            for (oracle, why), rows in found.items()
        ]
        return lines[:FAILED] + [f"... {len(lines)} such reasons"] * (len(lines) > FAILED)


_NAMES = ("lineariser", "schedule")
_FRAME = (
    "nees",
    "nees_error",
    "nees_expected",
    "log_score",
    "log_score_error",
    "log_evidence",
    "log_evidence_kind",
    "seconds",
    "converged",
    "left_out",
    "error",
)


def _known(columns: Iterable[tuple[str, Iterable[str]]]) -> list[list[str]]:
    """The columns of cells in which something is known, each with its head."""
    found = [[head, *cells] for head, cells in columns]
    return [column for column in found if set(column[1:]) - {_NONE}]


def _shown_each(rows: Sequence[Row], name: str) -> list[str]:
    """A score of each row with its standard error, where there is one."""
    return [shown(getattr(row, name), getattr(row, f"{name}_error")) for row in rows]


def _judgement(row: Row, oracle: str) -> Judgement:
    found = row.by_oracle.get(oracle)
    return Judgement.none(len(row.nees_by_step)) if found is None else found


def _oracle(row: Row) -> str:
    """The name of the oracle that a row is of."""
    return row.lineariser.removeprefix("oracle: ")


def _is(row: Row, parts: tuple[Any, ...]) -> bool:
    """Whether a row has the label, and the schedule or state, that were asked for."""
    label, rest = (parts[0] if parts else None), parts[1:]
    known = (row.schedule, row.state), (row.schedule,), (row.state,), ()
    return row.lineariser == label and rest in known


def _few(names: Sequence[str]) -> str:
    """The first names of several, and how many there are more."""
    more = len(names) - 2
    return "; ".join(names[:2]) + (f" and {more} more" if more > 0 else "")


def shown(value: float, error: float = np.nan) -> str:
    """A number, and its standard error where there is one."""
    if np.isnan(value):
        return _NONE
    return f"{value:.4g} ± {error:.2g}" if error > 0.0 else f"{value:.4g}"


def _who(row: Row) -> str:
    return f"{row.lineariser}, {row.schedule}, {row.state.name}"
