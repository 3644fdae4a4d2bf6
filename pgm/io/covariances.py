"""Covariances over time in a table of comma-separated values, beside a file of poses.

The first line names the columns: ``t``, then the products ``east*east``, ``east*north``, ... whose
expectations stand below, the upper triangle row by row.
"""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Sequence
from itertools import combinations_with_replacement

import numpy as np

from pgm.factors.arrays import covariance_fault
from pgm.io import sources
from pgm.io.sources import Origin, Source
from pgm.io.words import number
from pgm.kernels.arrays import Array

JOINED = "*"


def write(target: Source, times: Array, names: Sequence[str], cov: Array) -> None:
    """Write covariances (n, k, k) of components by name, with all their digits."""
    text = io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    table.writerow(_header(names))
    upper = cov[:, *np.triu_indices(len(names))]
    table.writerows(np.column_stack([times, upper]).tolist())
    sources.write(target, text.getvalue())


def read(source: Source, times: Array, limit: int) -> tuple[tuple[str, ...], Array]:
    """The names of the components, and their covariances (n, k, k) at the times of the poses."""
    content = sources.read(source, limit)
    origin = content.origin
    reader = csv.reader(io.StringIO(content.text(), newline=""))
    try:
        header = next(reader, [])
        names = _names(header, origin)
        lines, rows = [], []
        for row in filter(None, reader):
            if len(row) != len(header):
                raise origin.fault(
                    f"it has {len(row)} numbers, where the first line names {len(header)} columns",
                    reader.line_num,
                )
            rows.append([number(word, reader.line_num, origin) for word in row])
            lines.append(reader.line_num)
    except csv.Error as error:
        raise origin.fault(f"it is no table of values: {error}", reader.line_num) from None
    table = np.array(rows).reshape(len(rows), len(header))
    _require_times(table[:, 0], times, lines, origin)
    cov = np.empty((len(rows), len(names), len(names)))
    i, j = np.triu_indices(len(names))
    cov[:, i, j] = cov[:, j, i] = table[:, 1:]
    if covariance_fault(cov):
        for line, matrix in zip(lines, cov, strict=True):
            if fault := covariance_fault(matrix):
                raise origin.fault(f"the covariance of {', '.join(names)} {fault}", line)
    return names, cov


def _header(names: Sequence[str]) -> list[str]:
    pairs = combinations_with_replacement(names, 2)
    return ["t", *(f"{one}{JOINED}{other}" for one, other in pairs)]


def _names(header: Sequence[str], origin: Origin) -> tuple[str, ...]:
    count = (math.isqrt(8 * len(header) - 7) - 1) // 2 if header else 0
    first = header[1][: (len(header[1]) - 1) // 2] if count else ""
    names = tuple(column[len(first) + 1 :] for column in header[1 : count + 1])
    if not count or list(header) != _header(names):
        raise origin.fault(
            "the first line is to name the columns, t and the upper triangle of the covariance, "
            f"as t,east*east,east*north,north*north; found {','.join(header)!r}",
            1,
        )
    return names


def _require_times(own: Array, times: Array, lines: Sequence[int], origin: Origin) -> None:
    if len(own) != len(times):
        raise origin.fault(
            f"it has {len(own)} covariances, where the poses are {len(times)}; are the files of "
            "one trajectory?"
        )
    if (other := own != times).any():
        row = int(other.argmax())
        raise origin.fault(
            f"t = {float(own[row])!r}, where the pose is of t = {float(times[row])!r}; are the "
            "files of one trajectory?",
            lines[row],
        )
