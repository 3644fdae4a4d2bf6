"""Which rows and curves a run is of, and which contenders they have beside pgm."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from operator import eq

from benchmarks import memory
from benchmarks.curves import CURVES, Curve
from benchmarks.row import Prepare, Row
from benchmarks.rows import ROWS


@dataclass(frozen=True, eq=False)
class Choice:
    """Rows, networks whose memory is measured, and curves."""

    rows: Sequence[Row] = tuple(ROWS)
    networks: Sequence[str] = memory.NAMES
    curves: Sequence[Curve] = tuple(CURVES)

    @property
    def names(self) -> list[str]:
        """All their names."""
        rows, curves = ([each.name for each in part] for part in (self.rows, self.curves))
        return [*rows, *self.networks, *curves]

    @property
    def others(self) -> list[str]:
        """All contenders but pgm."""
        rows, curves = ([each.contenders for each in part] for part in (self.rows, self.curves))
        found = {other for contenders in (*rows, *curves) for other in _others(contenders)}
        return sorted(found | (set(memory.LIBRARIES) - {"pgm"} if self.networks else set()))

    def only(self, asked: str) -> Choice:
        """Those of some names, with commas between them, or whose names begin with these words.

        Raises
        ------
        ValueError
            Where there is none of a name.
        """
        wanted = _listed(asked, self.names, _begins)
        chosen = {name for name in self.names if any(_begins(name, each) for each in wanted)}
        return Choice(
            [row for row in self.rows if row.name in chosen],
            [name for name in self.networks if name in chosen],
            [curve for curve in self.curves if curve.name in chosen],
        )

    def against(self, asked: str) -> Choice:
        """Those that have some contenders, with commas between them, beside pgm these alone.

        Raises
        ------
        ValueError
            Where there is none of a name.
        """
        wanted = _listed(asked, self.others)
        rows = [replace(row, contenders=_kept(row.contenders, wanted)) for row in self.rows]
        curves = [replace(each, contenders=_kept(each.contenders, wanted)) for each in self.curves]
        return Choice(
            [row for row in rows if _others(row.contenders)],
            self.networks if set(memory.LIBRARIES) & set(wanted) else (),
            [curve for curve in curves if _others(curve.contenders)],
        )


def short() -> Choice:
    """What the quick run is of."""
    return Choice(rows=[row for row in ROWS if row.quick], networks=())


def _listed(asked: str, known: Sequence[str], fits: Callable[[str, str], bool] = eq) -> list[str]:
    names = [name.strip() for name in asked.split(",")]
    strangers = [name for name in names if not any(fits(each, name) for each in known)]
    if strangers:
        raise ValueError(
            f"there is no {', '.join(map(repr, strangers))}, but {', '.join(known) or 'none'}"
        )
    return names


def _begins(name: str, asked: str) -> bool:
    """Whether a name is some words, or begins with them."""
    return bool(asked) and f"{name}_".startswith(f"{asked}_")


def _others(contenders: Mapping[str, Prepare]) -> list[str]:
    return list(contenders)[1:]


def _kept(contenders: Mapping[str, Prepare], wanted: Sequence[str]) -> dict[str, Prepare]:
    ours, *others = contenders.items()
    return dict([ours, *(other for other in others if other[0] in wanted)])
