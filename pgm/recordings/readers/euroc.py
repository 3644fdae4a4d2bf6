"""Inertial readings of the EuRoC datasets, ``imu0/data.csv``."""

from __future__ import annotations

import re
from collections.abc import Sequence

from pgm.arguments import public
from pgm.io import euroc
from pgm.io.sources import Origin, Source
from pgm.recordings.drives.recording import Recording
from pgm.recordings.drives.stream import Stream
from pgm.recordings.readers import files
from pgm.units import SPELLINGS

# The components of a reading by the beginning and the end of their columns' names.
_NAMED = {
    (kind, axis): f"{name}_{axis}"
    for kind, name in (("w", "rate"), ("a", "acceleration"))
    for axis in "xyz"
}
_UNITS = (*("rad/s",) * 3, *("m/s^2",) * 3)
_DUE = "timestamp [ns], rates about x, y, z [rad s^-1], accelerations along x, y, z [m s^-2]"
_FIELDS = 7
# A column's name, w_RS_S_x, and its unit behind it.
_COLUMN = re.compile(r"\s*(?P<kind>[wa])_(?:\w*_)?(?P<axis>[xyz])\s*(?:\[(?P<unit>[^\]]*)\])?\s*")
_STAMP = re.compile(r"\s*#?\s*(?:timestamp|time|t)\s*\[(?P<unit>[^\]]*)\]\s*")


@public
def read_euroc_imu(path: Source) -> Recording:
    r"""Read the inertial readings of a EuRoC sequence, ``imu0/data.csv``.

    Parameters
    ----------
    path : str, Path or open file
        Lines of nanoseconds since 1970, three rates of turn and three accelerations. Lines that
        begin with ``#`` are comments; one with the columns' names, ``w_RS_S_x [rad s^-1]``, says
        their order and units. Without it rates are first, in rad/s, then accelerations in m/s².

    Returns
    -------
    Recording
        With `imu`, (rate_x, rate_y, rate_z, acceleration_x, acceleration_y, acceleration_z), in
        rad/s and m/s², in the axes of the unit itself; an accelerometer at rest reads the opposite
        of gravity. Stamps are seconds since 1970; `dropped` tells of those out of order.

    Raises
    ------
    FileError
        If the file is malformed, a column is missing or in an unknown unit, or times are no
        nanoseconds; the message names the line, the finding and the remedy.

    References
    ----------
    Burri, Nikolic, Gohl, Schneider, Rehder, Omari, Achtelik and Siegwart, The EuRoC micro aerial
    vehicle datasets, 2016.

    Examples
    --------
    >>> import io
    >>> text = (
    ...     "#timestamp [ns],w_RS_S_x [rad s^-1],w_RS_S_y [rad s^-1],w_RS_S_z [rad s^-1],"
    ...     "a_RS_S_x [m s^-2],a_RS_S_y [m s^-2],a_RS_S_z [m s^-2]\n"
    ...     "1403636579758555392,-0.099,0.147,0.029,8.1,-0.4,-2.4\n"
    ... )
    >>> drive = pgm.recordings.read_euroc_imu(io.StringIO(text))
    >>> drive.imu["acceleration_x"]
    array([8.1])
    """
    names, units = list(_NAMED.values()), list(_UNITS)

    def told(cells: Sequence[str], line: int, origin: Origin) -> None:
        if header := _header(cells, line, origin):
            names[:], units[:] = zip(*header, strict=True)

    content = files.content(path)
    rows, _ = euroc.table(content, _FIELDS, _DUE, "inertial readings", told)
    with files.told_of(content.origin):
        stream = Stream(rows[:, 0], rows[:, 1:], names, units=units)
        order = [names.index(name) for name in _NAMED.values()]
        stream = Stream(stream.stamps, stream.values[:, order], tuple(_NAMED.values()))
        return Recording(imu=stream, name=files.name(path))


def _header(cells: Sequence[str], line: int, origin: Origin) -> list[tuple[str, str]]:
    """Component and unit of each column of readings, by a comment of names; none of another."""
    first, *rest = cells
    found = [_COLUMN.fullmatch(cell) for cell in rest[: _FIELDS - 1]]
    if not any(found):
        return []
    stamp = _STAMP.fullmatch(first)
    if stamp is not None and stamp["unit"].strip() != "ns":
        raise origin.fault(
            f"its stamps are in [{stamp['unit']}], where [ns] was due; recordings.read_csv reads "
            "others",
            line,
        )
    named: dict[str, str] = {}
    for cell, column in zip(rest, found, strict=False):
        if column is None:
            raise origin.fault(f"a column is {cell.strip()!r}, where {_DUE} were due", line)
        name = _NAMED[column["kind"], column["axis"]]
        unit = (column["unit"] or "").strip()
        named[name] = SPELLINGS.get(unit, unit)
    if len(named) < len(_NAMED):
        raise origin.fault(
            f"its columns are {', '.join(map(str.strip, rest))}, where {_DUE} were due", line
        )
    return list(named.items())
