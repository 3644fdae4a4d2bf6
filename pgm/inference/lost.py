"""Whether a belief is lost: a sequential test of innovations and of gate rejections.

Against innovations of κ times the variance, a step of NIS ~ χ²(d) weighs, in logarithms of odds,

    a = ½ (1 − 1/κ) NIS − ½ d ln κ,

and r rejected sightings of n that a gate judged weigh, for a share q₁ of rejections against q₀,

    b = r ln(q₁/q₀) + (n − r) ln((1 − q₁)/(1 − q₀)).

A sighting of unknown identity that is taken for none of its candidates counts as rejected; q₀ is
then at least the share that was declared to be such, and q₁ as far between ½ and 1 as q₀ between
a tenth and 1.

Each is summed up by Page's test; see `Lost`. From recovery on both begin again at zero.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import log
from typing import Any, NamedTuple

import numpy as np

from pgm.display import Listing, Shown, Summary, number, places
from pgm.immutable import Immutable
from pgm.kernels.arrays import Array, Integers, Mask

# κ; the shares of rejections of a right belief, outliers among them, and of a lost one.
INFLATION, OUTLIERS, LOST_SHARE = 2.0, 0.1, 0.5
# Steps in which each test cries wrongly once at the most, on average; the odds that it is over.
STEPS, ODDS = 1e6, 100.0
_HIGH, _BACK = log(STEPS), log(ODDS)
_MOST = _HIGH / 3.0
_WHY = ("innovations", "rejections")


def weighed(rejected: Integers, judged: Integers, outliers: float) -> Array:
    """The value b of rejections, of which a right belief has at least the tenth that it may."""
    own = min(max(outliers, OUTLIERS), 1.0 - 1e-6)
    share = LOST_SHARE + (1.0 - LOST_SHARE) * (own - OUTLIERS) / (1.0 - OUTLIERS)
    found: Array = rejected * log(share / own) + (judged - rejected) * log(
        (1.0 - share) / (1.0 - own)
    )
    return found


class Read(NamedTuple):
    """The readings of steps in numbers, (..., runs): NIS, its components, and what gates did.

    Sightings were `rejected` of those `judged`, or `strange`, taken for no candidate, of the `open`
    ones; of a sensor with a gate strange ones alone count. `odds` is the weight of these.
    """

    nis: Array
    dof: Integers
    rejected: Integers
    judged: Integers
    strange: Integers | int = 0
    open: Integers | int = 0
    odds: Array | float = 0.0

    @classmethod
    def of_open(cls, strange: Integers, open_: Integers, outliers: float) -> Read:
        """Sightings with candidates, of which so large a share was declared to be of none."""
        nothing = np.zeros_like(open_)
        odds = weighed(strange, open_, outliers)
        return cls(np.zeros(open_.shape), nothing, nothing, nothing, strange, open_, odds)

    def and_(self, other: Read) -> Read:
        """The readings of two updates of a step."""
        return Read._make(mine + its for mine, its in zip(self, other, strict=True))

    @property
    def weights(self) -> Array:
        """The values a and b, (2, ..., runs)."""
        a = 0.5 * ((1.0 - 1.0 / INFLATION) * self.nis - log(INFLATION) * self.dof)
        b = weighed(self.rejected, self.judged, OUTLIERS) + self.odds
        found: Array = np.minimum(np.stack([a, b]), _MOST)
        return found


class PageTest(NamedTuple):
    """The state of the tests of runs after a step.

    `level` (2, runs) is C of each test, `onset` since when it has been above zero. Of the latest
    stretch, (runs,): since when (`first`), when it was said (`declared`), and by which test.
    """

    level: Array
    onset: Integers
    lost: Mask
    first: Integers
    declared: Integers
    why: Integers

    @classmethod
    def start(cls, runs: int) -> PageTest:
        """Before the first step."""
        nothing = np.zeros(runs, dtype=np.intp)
        both = np.zeros((2, runs), dtype=np.intp)
        return cls(np.zeros((2, runs)), both, np.zeros(runs, dtype=bool), *[nothing] * 3)

    def over(self, runs: int) -> PageTest:
        """The test for several runs, copied where it has one."""
        wide: list[Any] = [np.broadcast_to(part, (*part.shape[:-1], runs)) for part in self]
        return PageTest(*wide)

    def on(self, step: int, weights: Array) -> PageTest:
        """The test after a step with log-likelihood ratios `weights`, (2, runs)."""
        onset = np.where(self.level == 0.0, step, self.onset)
        level = np.clip(self.level + weights, 0.0, _HIGH)
        high = level >= _HIGH
        if not (high.any() or self.lost.any()):
            return self._replace(level=level, onset=onset)
        cries = ~self.lost & high.any(axis=0)
        why = np.where(cries, np.argmax(high, axis=0), self.why)
        first = np.where(cries, np.take_along_axis(onset, why[None], axis=0)[0], self.first)
        over = self.lost & (level <= _HIGH - _BACK).all(axis=0)
        level = np.where(over, 0.0, level)
        declared = np.where(cries, step, self.declared)
        return PageTest(level, onset, (self.lost | cries) & ~over, first, declared, why)


@dataclass(frozen=True)
class Stretch:
    """Steps at which a belief was lost.

    `run` is empty for one run; it probably began at `first`, was known by the measurements up to
    `declared`, and ended after `last`. The reason `why` is ``"innovations"`` too large, of which
    `value` is the NIS of what was taken in, a component (right: 1), or ``"rejections"`` too many,
    of which it is the share of the sightings judged by a gate or an association.
    """

    run: tuple[int, ...]
    first: int
    declared: int
    last: int
    why: str
    value: float

    def __str__(self) -> str:
        what = "NIS {} a component" if self.why == _WHY[0] else "{} of the sightings rejected"
        where = f"run {', '.join(map(str, self.run))}: " if self.run else ""
        return (
            f"{where}steps {self.first}..{self.last} (said at {self.declared}): {self.why}, "
            + what.format(number(self.value, 3))
        )


class Lost(Shown, Immutable):
    r"""The steps at which a belief was probably wrong, by its innovations and a gate's rejections.

    Attributes
    ----------
    at : ndarray of bool
        (..., T+1): whether it was lost at a step by the measurements up to it; leading axes are
        runs.
    stretches : tuple of Stretch
        In the order of runs and steps, each with its `run`, `first`, `declared` and `last` step,
        `why`, and the NIS or the share of rejections as `value`.

    Notes
    -----
    Page's test, for each step's NIS with d components and each gate's r rejections of n sightings,

    .. math:: C \leftarrow \min(h, \max(0, C + x)), \quad
        x = \tfrac14 \mathrm{NIS} - \tfrac d2 \ln 2
        \ \text{ and } \ x = r \ln 5 - (n - r) \ln 1.8:

    innovations of twice their variance; half of all sightings rejected, where a tenth may be
    outliers. Lost is where a C reaches h = ln 10⁶, in a consistent filter once in 10⁶ steps on
    average at the most often; recovered where both have fallen by ln 100. One step counts for h/3
    at the most. A sighting that is taken for none of its candidates, `pgm.unknown`, or that
    truncated least squares leave out, is rejected too; more of the former are expected where more
    are declared spurious or new.

    Page, Continuous inspection schemes, 1954; Lorden, Procedures for reacting to a change in
    distribution, 1971.

    Examples
    --------
    >>> from pgm.examples import walk, z
    >>> readings = [[0.0]] * 20 + [[30.0]] * 20
    >>> print(pgm.filter(walk, {z: readings}, gate=0.99).lost)
    Lost(1 stretch, at 12 of 41 steps)
      steps 21..40 (said at 29): rejections, 1 of the sightings rejected
    """

    at: Mask
    stretches: tuple[Stretch, ...]

    def __init__(self, at: Mask, stretches: Sequence[Stretch]) -> None:
        at.flags.writeable = False
        self._set(at=at, stretches=tuple(stretches))

    @classmethod
    def of(cls, read: Read, lead: tuple[int, ...]) -> Lost:
        """The stretches of a record of readings, (T+1, runs) each."""
        steps, runs = read.nis.shape
        weights, test = read.weights, PageTest.start(runs)
        at = np.zeros((steps, runs), dtype=bool)
        found: list[tuple[int, int, int, int, int]] = []
        for step in range(steps):
            before, test = test, test.on(step, weights[:, step])
            at[step] = test.lost
            for run in np.flatnonzero(before.lost & ~test.lost).tolist():
                found.append(_row(run, before, step - 1))
        found += [_row(run, test, steps - 1) for run in np.flatnonzero(test.lost).tolist()]
        stretches = []
        for run, first, declared, last, why in sorted(found):
            part, whole = (
                (np.asarray(read.rejected + read.strange), np.asarray(read.judged + read.open))
                if why
                else (read.nis, read.dof)
            )
            own = slice(first, last + 1), run
            value = float(part[own].sum()) / max(float(whole[own].sum()), 1.0)
            place = tuple(int(k) for k in np.unravel_index(run, lead)) if lead else ()
            stretches.append(Stretch(place, first, declared, last, _WHY[why], value))
        return cls(at.T.reshape(*lead, steps), stretches)

    def __bool__(self) -> bool:
        return bool(self.stretches)

    @property
    def _title(self) -> str:
        count, steps = len(self.stretches), int(self.at.sum())
        if not count:
            return f"Lost(never, {self.at.size:,} steps)"
        few = "1 stretch" if count == 1 else f"{count:,} stretches"
        return f"Lost({few}, at {steps:,} of {self.at.size:,} steps)"

    def _summary(self) -> Summary:
        lines: list[str | Listing] = []
        for place in places((len(self.stretches),)):
            lines.append("..." if place is None else str(self.stretches[place[0]]))
        return Summary(self._title, lines)


def _row(run: int, test: PageTest, last: int) -> tuple[int, int, int, int, int]:
    return run, int(test.first[run]), int(test.declared[run]), last, int(test.why[run])
