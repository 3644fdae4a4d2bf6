"""Linearisations that fail or are not finite, refused with the CPD, the step and the run.

Arguments `rows` are the CPD with its evidence, at all its steps or measurements; `function` is its
function with the evidence of some of these bound, and `mean` (n, *batch) the mean of its hidden
parents, of n components, where it was linearised. The batch is () for one run, (runs,), or (rows,
runs) where several steps or measurements are linearised in one call.
"""

from __future__ import annotations

import numpy as np

from pgm.errors import LinearisationError, ModelError, PgmError
from pgm.factors.scope import names
from pgm.kernels.arrays import Array
from pgm.linearisation.rows import Rows
from pgm.linearisers import ArrayLineariser, BoundFunction, Line
from pgm.linearisers.lineariser import Misfit


def failure(rows: Rows, function: BoundFunction, mean: Array, error: Exception) -> Exception:
    """The error to raise in place of one that a lineariser has raised, with CPD, step and run.

    A `Misfit`, which reports a result of a wrong shape or type, becomes a `LinearisationError`. A
    `PgmError` is returned itself if it has the attribute `cpd` set, or if the lineariser is an
    `ArrayLineariser`, as those of this package are; those of its attributes `cpd`, `variable` and
    `step` that are not set are filled in. Any other error becomes a `ModelError`.
    """
    if isinstance(error, Misfit):
        return _fault(rows, function, mean, *error.args)
    told = isinstance(rows.lineariser, ArrayLineariser) or getattr(error, "cpd", None)
    if not isinstance(error, PgmError) or not told:
        said = f"{type(error).__name__}: {error}"
        return _fault(rows, function, mean, "failed", said, ModelError)
    error.cpd = error.cpd or rows.cpd
    error.variable = error.variable or rows.cpd.child
    if rows.timed and error.step is None and isinstance(function.step, int):
        error.step = function.step
    return error


def _fault(
    rows: Rows,
    function: BoundFunction,
    mean: Array,
    fault: str,
    more: str,
    kind: type[PgmError] = LinearisationError,
) -> PgmError:
    """The error, of the class `kind`, for a fault of the lineariser.

    `fault` is the verb phrase after the lineariser's name in the text ("failed", "returned an F of
    shape (2, 3)"). `more` ends the text: it is what was due, or the lineariser's own error. The
    text names the CPD, the step where there is one, and the runs of `mean` (n, *batch).
    """
    step = function.step if rows.timed and isinstance(function.step, int) else None
    places, numbering = mean.shape[-1] if mean.ndim > 1 else 1, rows.numbering
    at = "" if step is None else f" at step {step}"
    where = f"{at}, {numbering.several(places)}"
    after = f": {more}" if kind is ModelError else f"; {more}"
    return kind(
        f"the lineariser {rows.lineariser!r} {fault} for {rows.cpd!r}{where}{after}",
        variable=rows.cpd.child,
        cpd=rows.cpd,
        step=step,
        run=numbering.only(places),
    )


def require_finite(rows: Rows, function: BoundFunction, mean: Array, line: Line) -> None:
    """Refuse a linearisation at a mean if it has a NaN or an infinity, by a `LinearisationError`.

    `line` has its slope, its value at the `mean`, and the covariance of its error or None. The
    error names the first step and run where a number is not finite.
    """
    total = line.matrix.sum() + line.value.sum()
    if line.error is not None:
        total = total + line.error.sum()
    if np.isfinite(total):
        return
    bad = np.zeros(mean.shape[1:], dtype=bool)
    for part in line:
        if part is not None:
            bad |= ~np.isfinite(part).all(axis=tuple(range(part.ndim - bad.ndim)))
    if not bad.any():
        return
    where = tuple(int(axis[0]) for axis in np.nonzero(bad)) if bad.ndim else ()
    step = None
    if rows.timed and function.step is not None:
        step = int(np.broadcast_to(function.step, bad.shape)[where])
    place = where[-1] if where else 0
    at = "" if step is None else f" at step {step}"
    which = rows.numbering.words(place)
    raise LinearisationError(
        f"{rows.cpd!r}: its linearisation{at}, {which}, has values that are NaN or "
        f"infinite, at {names(rows.hidden)} = {mean.T[where[::-1]]}; is the function "
        "defined there, and its Jacobian?",
        variable=rows.cpd.child,
        cpd=rows.cpd,
        step=step,
        run=rows.numbering.run(place),
    )
