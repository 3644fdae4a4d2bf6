"""Tables of means and deviations by component, for one belief or over runs and steps."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from pgm.display.brief import beside, column, count, number
from pgm.display.summary import ALL, LEFT_OUT, Listing, Place, few, places

Array = npt.NDArray[np.float64]
# The most components beside each other, and of how many correlations are shown.
WIDE, CORRELATED = 12, 6


def by_component(names: Sequence[str], mean: Array, cov: Array) -> Listing:
    """One belief: its mean and deviation, a row a component, and where few their correlations."""
    std = deviations(cov)
    shown = few(len(names))
    kept = [k for k in shown if k is not None]
    # Each component has units of its own, and so its own decimals.
    cells = dict(
        zip(kept, beside(mean[kept].tolist(), std[kept].tolist(), alike=False), strict=True)
    )
    heads, rest = ["", "mean ± deviation"], correlations(cov, std) if len(names) > 1 else None
    if rest is not None:
        heads += ["correlations", *[""] * (len(names) - 2)]
    rows: list[Sequence[str] | None] = []
    for k in shown:
        if k is None:
            rows.append(None)
        elif rest is None:
            rows.append([names[k], cells[k]])
        else:
            below = [_correlation(rest[k, j]) for j in range(k)]
            rows.append([names[k], cells[k], *below, *[""] * (len(names) - 1 - k)])
    return Listing(heads, rows)


def stacked(
    names: Sequence[str],
    lead: tuple[int, ...],
    steps: Sequence[int] | npt.NDArray[Any] | None,
    moments: Callable[[Place], tuple[Array, Array]],
    most: int = ALL,
) -> Listing:
    """Many beliefs: a row each of the first and the last, with means and deviations.

    `lead` are runs and `steps`; the moments at a place of these are asked for of those shown alone.
    """
    shown = places(lead, most)
    found = {place: moments(place) for place in shown if place is not None}
    columns = []
    for k in range(min(len(names), WIDE)):
        means = [mean[k] for mean, _ in found.values()]
        spreads = [float(deviations(cov[k : k + 1, k : k + 1])[0]) for _, cov in found.values()]
        columns.append(dict(zip(found, beside(means, spreads), strict=True)))
    heads, where = whereabouts(lead, steps)
    more = [f"{LEFT_OUT} {len(names)} in all"] * (len(names) > WIDE)
    rows: list[Sequence[str] | None] = []
    for place in shown:
        if place is None:
            rows.append(None)
        else:
            rows.append([*where(place), *(column[place] for column in columns), *[""] * len(more)])
    return Listing([*heads, *names[:WIDE], *more], rows, names=len(heads))


def whereabouts(
    lead: tuple[int, ...], steps: Sequence[int] | npt.NDArray[Any] | None
) -> tuple[list[str], Callable[[Place], list[str]]]:
    """The heads of the columns that tell run and step, and their cells at a place."""
    runs = len(lead) - (steps is not None)
    heads = ["run"] * (runs > 0) + ["step"] * (steps is not None)

    def cells(place: Place) -> list[str]:
        found = [", ".join(map(str, place[:runs]))] if runs else []
        return found if steps is None else [*found, str(int(steps[place[-1]]))]

    return heads, cells


def axes(lead: tuple[int, ...], steps: Sequence[int] | npt.NDArray[Any] | None) -> str:
    """Leading axes in words, behind a comma: ``, runs (100,), steps 0..60``."""
    runs = lead if steps is None else lead[:-1]
    text = f", runs {runs}" if runs else ""
    if steps is None:
        return text
    found = np.asarray(steps)
    if not found.size or (np.diff(found) != 1).any():
        return f"{text}, {count(found.size, 'step')}"
    return f"{text}, steps {found[0]}..{found[-1]}"


def deviations(cov: Array) -> Array:
    """Standard deviations; NaN for negative variances."""
    with np.errstate(invalid="ignore"):
        return np.asarray(np.sqrt(np.diagonal(cov, axis1=-2, axis2=-1)))


def correlations(cov: Array, std: Array) -> Array | None:
    """The correlations of a few components; None where they are many, or none is correlated."""
    if len(std) > CORRELATED or not np.isfinite(cov).all() or not (std > 0.0).any():
        return None
    with np.errstate(invalid="ignore", divide="ignore"):
        found = cov / np.outer(std, std)
    apart = found[~np.eye(len(std), dtype=bool)]
    return found if (np.abs(np.nan_to_num(apart)) >= 0.005).any() else None


def _correlation(value: float) -> str:
    return "" if np.isnan(value) else f"{round(value, 2) + 0.0:.2f}"


# The most rows and columns of which all are shown.
ROWS, COLUMNS = 7, 7


def named_matrix(
    rows: Sequence[str],
    columns: Sequence[str],
    values: npt.NDArray[Any],
    symbol: str,
    before: Sequence[tuple[str, npt.NDArray[Any]]] = (),
) -> Listing:
    """A matrix with the names of its rows and columns and its symbol, behind other columns."""
    shown = few(len(rows), ROWS)
    kept = [k for k in shown if k is not None]
    heads, cells = [""], [[rows[k] for k in kept]]
    for name, vector in before:
        heads.append(name)
        cells.append([number(value) for value in vector[kept]])
    for k, name in enumerate(columns[:COLUMNS]):
        heads.append(name if k else f"{symbol}: {name}")
        cells.append(column(values[kept, k]))
    if len(columns) > COLUMNS:
        heads.append(LEFT_OUT)
        cells.append([LEFT_OUT] * len(kept))
    found = dict(zip(kept, zip(*cells, strict=True), strict=True))
    return Listing(heads, [None if k is None else found[k] for k in shown])
