"""Fixed points at which linearisations from several starts arrive, and the modes among them.

A *start* is a value of all hidden variables. From each, iterations that linearise anew go to a
*fixed point*; fixed points that are apart are the *modes* of the posterior, and the evidence of the
model as it is linearised there, Laplace's approximation of a mode's mass, weighs them. Arrays have
the S starts or K modes first, then the runs.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, TypeVar

import numpy as np

from pgm.beliefs.modes.outcome import Found, ModeFigures, Part, rows_of
from pgm.errors import ConvergenceWarning, ModelError, NumericalError, PgmError, levels_to_user
from pgm.factors.scope import Scope
from pgm.kernels.angles import difference
from pgm.kernels.arrays import Array, Integers, Mask
from pgm.kernels.semirings import log_sum
from pgm.linearisers import Cubature, GaussHermite, Lineariser
from pgm.posteriors.status import Status
from pgm.schedules.damping import LevenbergMarquardt
from pgm.schedules.options import Call
from pgm.schedules.schedule import Calibration, Smoothing

Kind = TypeVar("Kind", Smoothing, Calibration)

# Two fixed points are one mode if no component differs by more of its deviations.
APART = 0.5
# Linearisations from a start, unless a call asks for others.
ITERATIONS = 50


def patient(call: Call, kind: type[Kind]) -> Kind:
    """The schedule from each start: of many iterations, whose steps lower the cost."""
    asked = call.schedule
    damping = getattr(asked, "damping", None) or LevenbergMarquardt()
    if isinstance(asked, kind) and asked.iterations > 1:
        return kind(asked.iterations, asked.tolerance, damping)
    return kind(ITERATIONS, damping=damping)


def spread_rule(size: int) -> Lineariser:
    """The rule by which nonlinear functions of so many components are averaged over a belief.

    It is as exact as its number of points, a power of the components, allows.
    """
    if size <= 2:
        return GaussHermite(5)
    return GaussHermite(3) if size <= 4 else Cubature()


class Heights(NamedTuple):
    """By start the log-evidence where it stopped, and whether it settled there, (S, runs)."""

    log_evidence: Array
    settled: Mask


def heights(parts: Sequence[Part], lead: tuple[int, ...]) -> Heights:
    """The log-evidence of all starts, NaN of one that a run does not have, and which settled."""
    logs = by_start(parts, lead, [part.outcome.log_evidence for part in parts])
    settled = by_start(parts, lead, [part.outcome.status.converged for part in parts])
    return Heights(logs, np.isfinite(logs) & (settled == 1.0))


def by_start(parts: Sequence[Part], lead: tuple[int, ...], each: Sequence[Any]) -> Array:
    """Values of each part's beliefs as (S, runs, ...), NaN of a start that a run does not have."""
    pairs = zip(parts, each, strict=True)
    whole = np.concatenate([part.flat(np.asarray(own, float), lead) for part, own in pairs])
    rows = rows_of(parts, math.prod(lead))
    found: Array = whole[rows]
    found[rows < 0] = np.nan
    return found


class Arrived(NamedTuple):
    """The outcomes from starts, the starts that failed in some run, and the first error of these.

    The error is None if it was none of the package's own.
    """

    parts: list[Part]
    failed: Integers
    refused: PgmError | None

    @property
    def some(self) -> list[Part]:
        """The outcomes; the error is raised if there are none."""
        if not self.parts:
            raise self.refused or ModelError("nothing has arrived from any start")
        return self.parts

    def with_others(self, other: Arrived) -> Arrived:
        """These outcomes, and those of another attempt at the starts that failed."""
        made = [own for own, *_ in other.parts]
        left = np.setdiff1d(self.failed, np.concatenate([self.failed[:0], *made]))
        return Arrived([*self.parts, *other.parts], left, self.refused or other.refused)


def arrived(infer: Callable[[Integers], Any], starts: Integers) -> Arrived:
    """The outcomes from all starts, of which `infer` takes some by number.

    Where it fails the halves are tried by themselves.
    """
    left = [starts] if starts.size else []
    found: list[Part] = []
    failed: list[int] = []
    refused: PgmError | None = None
    while left:
        some = left.pop()
        try:
            outcome = infer(some)
        except (PgmError, np.linalg.LinAlgError) as error:
            if isinstance(error, PgmError):
                refused = refused or error
            if some.size > 1:
                left += [some[: some.size // 2], some[some.size // 2 :]]
            else:
                failed.append(int(some[0]))
            continue
        found.append(Part(some, outcome))
    return Arrived(found, np.array(failed, dtype=np.intp), refused)


def chosen(
    parts: Sequence[Part], hidden: Scope, lead: tuple[int, ...], first_run: int, count: int
) -> Found:
    """The modes at which starts have arrived, `count` at the most, the likeliest first.

    `hidden` are the variables by which points are told apart. Errors count runs from `first_run`.
    """
    runs, (logs, settled) = math.prod(lead), heights(parts, lead)
    none = ~settled.any(axis=0)
    ranked = np.where(settled | (none & np.isfinite(logs)), logs, -np.inf)
    mean, std, angles = _points(parts, hidden, lead)
    order = np.argsort(-ranked, axis=0, kind="stable")
    each, filled = np.arange(runs), np.zeros(runs, dtype=np.intp)
    index, weights = np.tile(order[0], (count, 1)), np.full((count, runs), -np.inf)
    hits = np.zeros((count, runs), dtype=np.intp)
    for place in order:
        some = ranked[place, each] > -np.inf
        new = some & (filled < count)
        for k, other in enumerate(index):
            off = np.abs(difference(mean[place, each], mean[other, each], angles))
            wide = std[other, each]
            apart = np.where(wide > 0.0, off / np.where(wide > 0.0, wide, 1.0), off > 0.0)
            same = some & (k < filled) & (apart.max(axis=-1, initial=0.0) <= APART)
            hits[k] += same
            new &= ~same
        at = filled[new], each[new]
        index[at], weights[at], hits[at] = place[new], ranked[place, each][new], 1
        filled = filled + new
    found = max(int(filled.max(initial=1)), 1)
    index, weights, hits = index[:found], weights[:found], hits[:found]
    total = log_sum(weights, 0)
    if not (total > -np.inf).all():
        run = first_run + int((total == -np.inf).argmax())
        raise NumericalError(
            f"run {run}: from no start there is a log-evidence that float64 can hold; are the "
            "evidence and the noises of a size that fits?",
            run=run,
        )
    starts = int((~np.isnan(logs)).sum(axis=0).max())
    figures = ModeFigures(starts, settled.sum(axis=0).reshape(lead), filled.reshape(lead))
    record = _record(parts, runs).reshape(-1, *lead)
    converged = np.asarray(~none.reshape(lead))
    status = Status(len(record) + 1, record, converged, _figures=figures)
    evidence = np.asarray(total.reshape(lead))
    return Found(status, evidence, parts, index, np.exp(weights - total), hits)


def _record(parts: Sequence[Part], runs: int) -> Array:
    """The least of all starts' residuals at each linearisation after the first, (L − 1, runs)."""
    whole_runs = [part for part in parts if part.runs is None]
    each = [
        part.outcome.status.residuals.reshape(-1, len(part.starts), runs) for part in whole_runs
    ]
    longest = max(map(len, each), default=0)
    whole = [
        np.pad(own, ((0, longest - len(own)), (0, 0), (0, 0)), "edge") for own in each if len(own)
    ]
    if not whole:
        return np.zeros((0, runs))
    found: Array = np.concatenate(whole, axis=1).min(axis=1)
    return found


def warn_of_unsettled(found: Found, iterations: int) -> None:
    """Warn of runs in which nothing has settled, from any start."""
    if not found.status.converged.all():
        figures = found.status._figures
        assert isinstance(figures, ModeFigures)
        warnings.warn(
            f"starts={figures.starts}: in some run nothing had settled from any start after "
            f"{iterations} linearisations (status.converged, status.arrived); give more "
            "iterations, or more starts",
            ConvergenceWarning,
            stacklevel=levels_to_user(),
        )


def _points(
    parts: Sequence[Part], hidden: Scope, lead: tuple[int, ...]
) -> tuple[Array, Array, Mask]:
    """The means and deviations of all variables at each fixed point, (S, runs, all), and angles."""
    means: list[Array] = []
    stds: list[Array] = []
    angles = []
    for variable in hidden:
        each = [part.outcome[variable] for part in parts]
        for found, name in ((means, "mean"), (stds, "std")):
            whole = by_start(parts, lead, [getattr(own, name) for own in each])
            found.append(whole.reshape(*whole.shape[:2], -1))
        angles.append(np.tile(variable.angle_mask, means[-1].shape[-1] // variable.dimension))
    return np.concatenate(means, -1), np.concatenate(stds, -1), np.concatenate(angles)
