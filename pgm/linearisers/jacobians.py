"""Given Jacobians, compared with the derivatives of the function's trace."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from pgm.kernels.arrays import Array
from pgm.linearisers.function import BoundFunction, Source
from pgm.linearisers.template import FunctionTemplate
from pgm.tracing.trace import around

# Entries that are the same differ by less, of themselves and of the largest of their row.
_TRACED, _NUMERICAL = 1e-7, 1e-4


class Disagreement(NamedTuple):
    """An entry of a given Jacobian that is none of the function's derivative.

    `row` and `column` count components of the value and of the stacked hidden parents; `at` are
    those parents' values, (n,), and `traced` says whether `due` is exact.
    """

    row: int
    column: int
    given: float
    due: float
    at: Array
    traced: bool


def disagreement(
    template: FunctionTemplate, centres: Sequence[Array], source: Source
) -> Disagreement | None:
    """The entry of the given Jacobians that is most wrong, about some values of all parents.

    Derivatives by differences are trusted less: the entry has to be wrong at half of the points.

    Parameters
    ----------
    template : FunctionTemplate
    centres : sequence of ndarray
        Values of all parents, (dimension,) each.
    source : Source
        For messages.
    """
    if template.tracer is not None:
        template.tracer.confirm(centres)
    hidden = [place is not None for place in template.places]
    points = around(centres, least=1e-6)
    x = np.concatenate([p for p, free in zip(points, hidden, strict=True) if free], axis=-1)
    known = [None if free else p for p, free in zip(points, hidden, strict=True)]
    bare = replace(template, jacobians=(None,) * len(hidden))
    with np.errstate(all="ignore"):
        given, due = (
            BoundFunction(each, known, 2, source=source).jacobian(x) for each in (template, bare)
        )
        traced = bare.program is not None
        least = _TRACED if traced else _NUMERICAL
        scale = np.abs(due).max(axis=-1, keepdims=True)
        wrong = ~(np.abs(given - due) <= least * (np.abs(due) + 1e-3 * scale)) & np.isfinite(due)
    wrong[..., list(template.missing)] = False
    if not traced:
        wrong &= wrong.sum(axis=(0, 1)) * 2 >= np.isfinite(due).sum(axis=(0, 1))
    if not wrong.any():
        return None
    # The entry that is wrong at most points, and one of these that is not far away.
    row, column = np.unravel_index(int(wrong.sum(axis=(0, 1)).argmax()), wrong.shape[2:])
    found = wrong[..., row, column]
    point = (0, 2) if found[0, 2] else np.unravel_index(int(found.argmax()), found.shape)
    place = (*point, row, column)
    at: Array = x[point]
    return Disagreement(int(row), int(column), float(given[place]), float(due[place]), at, traced)
