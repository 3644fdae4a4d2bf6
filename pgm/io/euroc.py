"""Files of the EuRoC datasets: rows of comma-separated numbers, stamped in nanoseconds."""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Sequence

import numpy as np

from pgm.arguments import public
from pgm.io import sources
from pgm.io.poses import Poses, made
from pgm.io.sources import LIMIT, Content, Origin, Source, number
from pgm.kernels.arrays import Array

FIELDS = 8
# Neither poses nor inertial readings are taken more often than once in this time [s].
_CLOSEST = 1e-6
_DUE = "timestamp [ns], x, y, z, qw, qx, qy, qz"


@public
def read_euroc(path: Source, *, limit: int = LIMIT) -> Poses:
    r"""Read the ground truth of a EuRoC sequence, ``state_groundtruth_estimate0/data.csv``.

    Parameters
    ----------
    path : str, Path or open file
        Lines of nanoseconds since 1970, a place, and a quaternion, w first; what stands behind, as
        velocities and biases, is not read. Lines that begin with ``#`` are comments.
    limit : int, optional
        How many bytes the file may hold once unpacked, 64 MiB if not given.

    Returns
    -------
    Poses
        Stamps in seconds. Poses that go back in time are put in order, and of several at one time
        the first is taken; `dropped` tells of both.

    Raises
    ------
    FileError
        If the file is malformed, times are no nanoseconds, or a quaternion is no unit one; the
        message names the line, what was found, what to do.
    OSError
        If the file cannot be opened.

    References
    ----------
    Burri, Nikolic, Gohl, Schneider, Rehder, Omari, Achtelik and Siegwart, The EuRoC micro aerial
    vehicle datasets, 2016.

    Examples
    --------
    >>> import io
    >>> text = "#timestamp, p_RS_R_x [m], ...\n1403715524907143168,4.7,-1.8,0.9,1,0,0,0\n"
    >>> read_euroc(io.StringIO(text)).position
    array([[ 4.7, -1.8,  0.9]])
    """
    content = sources.read(path, limit)
    found, lines = table(content, FIELDS, _DUE, "poses", _require_w_first)
    rows = found[:, [0, 1, 2, 3, 5, 6, 7, 4]]
    return made(rows, lines, content.origin, "are they four numbers, w first?")


def table(
    content: Content,
    fields: int,
    due: str,
    what: str,
    told: Callable[[Sequence[str], int, Origin], None],
) -> tuple[Array, list[int]]:
    """The rows (n, fields) of a file, stamps in seconds first, and the line of each.

    `what` rows are, of columns `due`; `told` takes the cells of each comment, and its line.
    """
    origin, lines, rows = content.origin, [], []
    reader = csv.reader(io.StringIO(content.text(), newline=""))
    try:
        for cells in reader:
            if not cells or not any(map(str.strip, cells)):
                continue
            if cells[0].lstrip().startswith("#"):
                told(cells, reader.line_num, origin)
                continue
            if len(cells) < fields:
                raise origin.fault(
                    f"it has {len(cells)} numbers, where {due}, {fields} or more of them, were due",
                    reader.line_num,
                )
            stamp = _seconds(cells[0].strip(), reader.line_num, origin)
            others = (number(word.strip(), reader.line_num, origin) for word in cells[1:fields])
            rows.append([stamp, *others])
            lines.append(reader.line_num)
    except csv.Error as error:
        raise origin.fault(f"it is no table of values: {error}", reader.line_num) from None
    if not rows:
        raise origin.fault(f"it has no {what}, lines of {due}; is it another file?")
    found = np.array(rows)
    _require_apart(found[:, 0], lines, what, origin)
    return found, lines


def _require_w_first(cells: Sequence[str], line: int, origin: Origin) -> None:
    """Refuse a line of names in which the quaternion is in another order."""
    turns = [name.strip().partition("[")[0].strip() for name in cells if "q_" in name]
    if turns and not turns[0].endswith("w"):
        raise origin.fault(f"its quaternion is {', '.join(turns)}, where w was due first", line)


def _require_apart(stamps: Array, lines: list[int], what: str, origin: Origin) -> None:
    """Refuse stamps so close that they are whole seconds or milliseconds, not nanoseconds."""
    apart = np.abs(np.diff(stamps))
    apart = apart[apart > 0.0]
    if apart.size and np.median(apart) < _CLOSEST:
        raise origin.fault(
            f"its {what} are {np.median(apart) * 1e9:.0f} ns apart: are stamps in another unit, "
            "where nanoseconds were due? Files with other stamps are read by recordings.read_csv, "
            "poses by read_tum",
            lines[0],
        )


def _seconds(word: str, line: int, origin: Origin) -> float:
    """Seconds of nanoseconds, to the nearest double."""
    found = number(word, line, origin)
    if word.isascii() and word.isdigit():
        return int(word) / 1e9  # all digits, which a double has not
    if found != int(found):
        raise origin.fault(
            f"t = {word}, where whole nanoseconds were due; files with seconds are read by "
            "recordings.read_csv, poses by read_tum",
            line,
        )
    return found / 1e9
