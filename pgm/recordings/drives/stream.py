"""Stamped rows of one sensor, odometer or reference, with named components."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt

from pgm.arguments import public
from pgm.boundary import as_floats, as_tuple, is_number, is_unordered
from pgm.display import NoArray, Shown, Summary, count, table
from pgm.errors import EvidenceError
from pgm.evidence import degrees
from pgm.factors.listing import with_units
from pgm.factors.scope import listed
from pgm.immutable import Immutable
from pgm.io.stamped import as_stamps, clock
from pgm.io.tum import JOINED
from pgm.kernels.arrays import Array, Integers, Mask, frozen
from pgm.recordings.drives import quantities, spreads
from pgm.resources import FRAMES, optional
from pgm.variables import Units

Subjects = npt.NDArray[Any]
# Bearings are within a turn; headings may go on, but not in jumps.
_ANGLES = {"heading": degrees.seem_degrees, "bearing": degrees.beyond_a_turn}
# Increments of a heading, which is hardly turned by more than a turn between two stamps.
_TURNS = dict.fromkeys(("turn", "rot1", "rot2"), degrees.beyond_a_turn)
_SUBJECTS = {int: np.dtype(int), str: np.dtype(np.str_), type(None): np.dtype(object)}


@public
class Stream(Shown, NoArray, Immutable):
    """Rows with their stamps; values are read by component, ``stream["range"]``.

    Parameters
    ----------
    stamps : array_like
        (n,), seconds.
    values : array_like
        (n, d), or (n,) where d = 1; NaN where nothing was measured.
    components : sequence of str
        The d names of the columns.
    subject : array_like, optional
        (n,): whole numbers or words, each row's landmark; None where unknown.
    cov : array_like, optional
        (n, d, d), the covariance of each row's noise; NaN where a variance is unknown.
    variances : array_like, optional
        (n, d), of noise whose components are not correlated, in place of `cov`.
    units : str, sequence or mapping of str to str, optional
        The units that values are given in, by component, ``{"heading": "deg"}``, and variances in
        their squares. Those that are known are converted to metres, seconds and radians; without,
        values are in these.
    begin : float, optional
        For increments: when the first of them begins, seconds. Without it, the first row only
        stamps the moment from which the second counts.

    Raises
    ------
    EvidenceError
        If shapes do not fit, stamps are not finite, variances are negative or a covariance is
        indefinite, a unit is none of a component, or angles seem to be degrees.

    Examples
    --------
    >>> from pgm.recordings import Stream
    >>> seen = Stream([0.1, 0.2], [[5.1, 0.3], [4.9, 0.2]], ("range", "bearing"), subject=[6, 9])
    >>> seen["bearing"]
    array([0.3, 0.2])
    >>> seen
    Stream(2 rows of range, bearing, 0.1 s to 0.2 s)
      stamp  range, bearing       subject
        0.1             5.1  0.3        6
        0.2             4.9  0.2        9
    """

    stamps: Array
    values: Array
    components: tuple[str, ...]
    subject: Subjects | None
    cov: Array | None
    units: tuple[str, ...]
    begin: float | None

    _arrays: ClassVar[str] = ".stamps and .values"

    def __init__(
        self,
        stamps: npt.ArrayLike,
        values: npt.ArrayLike,
        components: Sequence[str],
        *,
        subject: Any = None,
        cov: npt.ArrayLike | None = None,
        variances: npt.ArrayLike | None = None,
        units: Units | None = None,
        begin: float | None = None,
    ) -> None:
        names = _names(components)
        when = as_stamps("stamps", stamps)
        if begin is not None and not (is_number(begin) and np.isfinite(begin)):
            raise EvidenceError(f"begin= is a time in seconds, not {begin!r}")
        if begin is not None and when.size and begin > when.min():
            raise EvidenceError(
                f"begin={float(begin)!r} is after the first stamp, {clock(when.min())}; increments "
                "count up to their stamps"
            )
        if cov is not None and variances is not None:
            raise EvidenceError("cov= has the variances already; leave variances= out")
        spread = None if cov is None else spreads.of_covariances(cov, when.size, names)
        if variances is not None:
            spread = spreads.of_variances(_table("variances", variances, when.size, names))
        table = _table("values", values, when.size, names)
        kept, sizes = quantities.sizes(units, names)
        if any(size != 1.0 for size in sizes):
            table *= sizes
            spread = None if spread is None else spread * np.outer(sizes, sizes)
        _require_radians(when, table, names, told=units is not None)
        self._set(
            stamps=frozen(when),
            values=frozen(table),
            components=names,
            subject=None if subject is None else _subjects(subject, when.size),
            cov=None if spread is None else frozen(spread),
            units=kept,
            begin=None if begin is None else float(begin),
        )

    def __len__(self) -> int:
        return self.stamps.size

    def __getitem__(self, component: str) -> Array:
        """The values of a component, (n,)."""
        return self.values[:, self.place(component)]

    @property
    def variances(self) -> Array | None:
        """The variances of each row's noise, (n, d): the diagonals of `cov`."""
        return None if self.cov is None else np.diagonal(self.cov, axis1=1, axis2=2)

    def place(self, component: str) -> int:
        """The column of a component."""
        if component not in self.components:
            raise EvidenceError(
                f"{self._title} has no component {component!r}; it has {listed(self.components)}"
            )
        return self.components.index(component)

    def take(self, rows: Integers | Mask | slice) -> Stream:
        """The rows at some indices or in a mask."""
        return self.replace(
            stamps=self.stamps[rows],
            values=self.values[rows],
            subject=None if self.subject is None else self.subject[rows],
            cov=None if self.cov is None else self.cov[rows],
        )

    def select(self, **columns: str) -> Stream:
        """Some columns under new names, ``stream.select(v="v_forward")``."""
        places = [self.place(column) for column in columns.values()]
        return self.replace(
            values=self.values[:, places],
            components=tuple(columns),
            units=[self.units[place] for place in places],
            cov=None if self.cov is None else self.cov[:, places][:, :, places],
        )

    def replace(self, **changes: Any) -> Stream:
        """A copy of the stream with some attributes replaced."""
        given = {name: getattr(self, name) for name in type(self).__annotations__ if name[0] != "_"}
        if "components" in changes:
            del given["units"]
        if "variances" in changes:
            del given["cov"]
        return Stream(**given | changes)

    def to_frame(self) -> Any:
        """A `pandas.DataFrame` of the rows, by stamp; ``frame.attrs["units"]`` has the units."""
        pandas = optional("pandas", "to_frame", FRAMES)
        frame = pandas.DataFrame(
            self.values, columns=list(self.components), index=pandas.Index(self.stamps, name="t")
        )
        if self.subject is not None:
            frame["subject"] = self.subject
        if self.cov is not None:
            for k, name in enumerate(self.components):
                frame[f"variance of {name}"] = self.cov[:, k, k]
            for j, k in spreads.correlated(self.cov):
                pair = f"{self.components[j]}{JOINED}{self.components[k]}"
                frame[f"covariance of {pair}"] = self.cov[:, j, k]
        with_units(frame, dict(zip(self.components, self.units, strict=True)))
        return frame

    @property
    def _title(self) -> str:
        what = f"{count(len(self), 'row')} of {', '.join(self.components)}"
        span = f", {clock(self.stamps.min())} to {clock(self.stamps.max())}" if len(self) else ""
        return f"Stream({what}{span})"

    def _summary(self) -> Summary:
        if not len(self):
            return Summary(self._title)
        columns: list[tuple[str, Any]] = [("stamp", self.stamps)]
        columns.append((", ".join(self.components), self.values))
        if self.subject is not None:
            columns.append(("subject", self.subject))
        return Summary(self._title, [table(columns, digits=15)])


def _names(components: Any) -> tuple[str, ...]:
    names = as_tuple(components)
    if (
        not names
        or is_unordered(components)
        or not all(isinstance(name, str) and name for name in names)
        or len(set(names)) < len(names)
    ):
        raise EvidenceError(
            f"components= names the columns, each once, like ('range', 'bearing'); not "
            f"{components!r}"
        )
    return names


def _table(what: str, value: Any, rows: int, names: tuple[str, ...]) -> Array:
    array = as_floats(value, what, EvidenceError, labels=names, missing=True).copy()
    if array.ndim == 1 and len(names) == 1:
        array = array[:, None]
    if array.size == 0 and rows == 0:
        array = array.reshape(0, len(names))
    if array.shape != (rows, len(names)):
        raise EvidenceError(
            f"{what} have shape {array.shape}; {(rows, len(names))} was due, a row for each stamp "
            f"and a column for each of {listed(names)}"
        )
    return array


def _require_radians(stamps: Array, values: Array, names: tuple[str, ...], *, told: bool) -> None:
    """Refuse angles in degrees, as far as numbers tell; turns only where no unit is told."""
    order = np.argsort(stamps, kind="stable")
    kinds = _ANGLES if told else _ANGLES | _TURNS
    for name, seem in kinds.items():
        if name in names and seem(angles := values[order, names.index(name)]):
            remedy = (
                f"units={{{name!r}: 'deg'}} says so, and 'rad' that it is not"
                if name in _TURNS
                else "np.radians(degrees) makes radians; radians of many turns are to be wrapped, "
                "(a + np.pi) % (2 * np.pi) - np.pi"
            )
            raise EvidenceError(
                f"{name!r} goes to {np.nanmax(np.abs(angles)):.4g} rad; it seems to be in degrees: "
                f"{remedy}"
            )


def _subjects(value: Any, rows: int) -> Subjects:
    """Identities as an array of whole numbers or words; of objects, where some are unknown."""
    array = np.asarray(value)
    if array.shape != (rows,):
        raise EvidenceError(
            f"subject= has the shape {array.shape}, where ({rows},) was due, one for each stamp"
        )
    each = array.tolist()
    odd = [one for one in each if type(one) not in _SUBJECTS]
    if odd:
        raise EvidenceError(
            f"subject= has whole numbers or words, and None where unknown; not {odd[0]!r}"
        )
    kinds = {type(one) for one in each}
    plain = _SUBJECTS[kinds.pop()] if len(kinds) == 1 else np.dtype(object)
    found: Subjects = np.empty(rows, dtype=object)
    found[:] = each
    if plain.kind == "U" or (plain.kind == "i" and max(map(abs, each)) < 2**62):
        found = found.astype(plain)
    found.flags.writeable = False
    return found
