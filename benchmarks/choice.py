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
    networks: Sequence[memory.Large] = memory.LARGE
    curves: Sequence[Curve] = tuple(CURVES)

    @property
    def names(self) -> list[str]:
        """All their names."""
        return [each.name for part in (self.rows, self.networks, self.curves) for each in part]

    @property
    def others(self) -> list[str]:
        """All contenders but pgm."""
        every = [each.contenders for part in (self.rows, self.curves) for each in part]
        every += [each.libraries for each in self.networks]
        return sorted({other for contenders in every for other in _others(contenders)})

    def only(self, asked: str) -> Choice:
        """The rows of some names, with commas between them, or whose names begin with these words.

        Raises
        ------
        ValueError
            Where there is none of a name.
        """
        wanted = _listed(asked, self.names, _begins)
        chosen = {name for name in self.names if any(_begins(name, each) for each in wanted)}
        return Choice(
            [row for row in self.rows if row.name in chosen],
            [large for large in self.networks if large.name in chosen],
            [curve for curve in self.curves if curve.name in chosen],
        )

    def against(self, asked: str) -> Choice:
        """The rows of some contenders, with commas between them, beside pgm these alone.

        Raises
        ------
        ValueError
            Where there is none of a name.
        """
        wanted = _listed(asked, self.others)
        rows = [replace(row, contenders=_kept(row.contenders, wanted)) for row in self.rows]
        networks = [replace(n, libraries=_kept(n.libraries, wanted)) for n in self.networks]
        curves = [replace(each, contenders=_kept(each.contenders, wanted)) for each in self.curves]
        return Choice(
            [row for row in rows if _others(row.contenders)],
            [large for large in networks if _others(large.libraries)],
            [curve for curve in curves if _others(curve.contenders)],
        )


def short() -> Choice:
    """The choice of the quick run."""
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
