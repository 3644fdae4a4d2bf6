"""Whether a belief is lost: a sequential test of innovations and of gate rejections.

A belief is *lost* when it is wrong by more than its covariance says, and *consistent* when it is
not. Two tests sum up log-likelihood ratios of a lost against a consistent belief, step by step.

The first test is of innovations. Let ν be the innovation of the d measured components of a step, S
its covariance, and NIS = νᵀS⁻¹ν, the normalised innovation squared. For a consistent belief NIS is
χ² with d degrees of freedom. Innovations of a lost belief are taken to have the covariance κ S with
κ = 2. A step therefore adds to the first sum, in nats,

    a = ½ (1 − 1/κ) NIS − ½ d ln κ.

The second test is of rejections. Let a gate have judged n *sightings* (single measurements of a
sensor) of a step and rejected r of them. Let q₁ = ½ be the share of rejections of a lost belief,
and q₀, a tenth, that of a consistent one. The step then adds to the second sum

    b = r ln(q₁/q₀) + (n − r) ln((1 − q₁)/(1 − q₀)).

A sighting of unknown identity is *strange* if it was taken for none of its candidates. Strange
sightings count as rejected, with a q₀ of their own: the prior share of sightings that was declared
spurious or new, but at least a tenth. Their q₁ then lies as far between ½ and 1 as q₀ does between
a tenth and 1.

Both are Page's tests: a sum is kept between zero and h = ln 10⁶. The belief is lost from where one
sum reaches h until both have fallen to h − ln 100 or less; both then begin again at zero.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from pgm.display import Listing, Shown, Summary, count, number, places
from pgm.immutable import Immutable
from pgm.kernels import cusum
from pgm.kernels.arrays import Array, Integers, Mask

_WHY = ("innovations", "rejections")


class Read(NamedTuple):
    """The numbers that both tests need of the measurements of steps, (..., runs) each.

    `nis` is the normalised innovation squared, `dof` its d. `judged` counts the sightings that
    gates have judged, `rejected` those that they rejected. `open` counts the sightings of unknown
    identity, `strange` those of them that were taken for no candidate, and `odds` is the
    log-likelihood ratio b of r = `strange` and n = `open`. For a sensor with a gate `open` counts
    its strange sightings alone, since the gate judges all others.
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
        """The numbers of `open_` sightings, of which `strange` were taken for no candidate.

        Both counts are (..., runs). `outliers` is the prior probability, as it was declared, that a
        sighting is of no candidate. The numbers of innovations and gates are zero.
        """
        nothing = np.zeros_like(open_)
        odds = cusum.weighed(strange, open_, outliers)
        return cls(np.zeros(open_.shape), nothing, nothing, nothing, strange, open_, odds)

    def and_(self, other: Read) -> Read:
        """The numbers of two updates of one step together: the sum of each."""
        return Read._make(mine + its for mine, its in zip(self, other, strict=True))

    @property
    def innovations(self) -> Array:
        """The log-likelihood ratios a, (..., runs), cut as of `weights`."""
        ratios: Array = cusum.expected(self.nis, self.dof)
        return ratios

    @property
    def rejections(self) -> Array:
        """The log-likelihood ratios b, (..., runs), which include `odds`, cut as of `weights`."""
        ratios: Array = cusum.rejections(self.rejected, self.judged, self.odds)
        return ratios

    @property
    def weights(self) -> Array:
        """The log-likelihood ratios a and b, (2, ..., runs).

        Each is cut to h/3 at the most, so that no single step makes a belief lost.
        """
        return np.stack([self.innovations, self.rejections])


class PageTest(NamedTuple):
    """The state of both tests after a step, for all runs.

    `level` (2, runs) is the sum of each test, within [0, h]; `onset` (2, runs) the step since which
    it has been above zero. `lost` (runs,) says whether the belief is lost. Of the latest stretch of
    being lost, (runs,) each: the step where it probably began (`first`), where it was noticed
    (`declared`), and the index of the test that did so, 0 of innovations and 1 of rejections
    (`why`); all are zero before there is one.
    """

    level: Array
    onset: Integers
    lost: Mask
    first: Integers
    declared: Integers
    why: Integers

    @classmethod
    def start(cls, runs: int) -> PageTest:
        """The state before the first step."""
        nothing = np.zeros(runs, dtype=np.intp)
        both = np.zeros((2, runs), dtype=np.intp)
        return cls(np.zeros((2, runs)), both, np.zeros(runs, dtype=bool), *[nothing] * 3)

    def over(self, runs: int) -> PageTest:
        """The same state for `runs` runs; a state of a single run is repeated for all of them."""
        wide: list[Any] = [np.broadcast_to(part, (*part.shape[:-1], runs)) for part in self]
        return PageTest(*wide)

    def of(self, run: int) -> PageTest:
        """The state of one run."""
        own: list[Any] = [part[..., run] for part in self]
        return PageTest(*own)

    def on(self, step: int, weights: Array) -> PageTest:
        """The state after a step that adds the log-likelihood ratios `weights`, (2, runs)."""
        level, onset = cusum.raised(self.level, self.onset, step, weights)
        raised = self._replace(level=level, onset=onset)
        if not ((level >= cusum.HIGH).any() or self.lost.any()):
            return raised
        level, *rest = cusum.ruled(cusum.Sums._make(raised), step)
        return PageTest(np.stack(level), onset, *rest[1:])


@dataclass(frozen=True)
class Stretch:
    """A stretch of steps, of one run, at which the belief was lost.

    `run` is the run's index, empty without axes of runs. The stretch reaches from the step `first`,
    where it probably began, to the step `last`; the test noticed it at the step `declared`. The
    reason `why` is ``"innovations"`` if innovations were too large, and `value` is then the mean
    NIS per component of the measurements taken in (1 for a consistent belief); or it is
    ``"rejections"`` if these were too many, and `value` is then their share of the sightings that a
    gate or an association has judged.
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
        (..., T+1): whether the belief was lost at a step, by the measurements up to it; leading
        axes are runs.
    stretches : tuple of Stretch
        In the order of runs and steps, each with its `run`, `first`, `declared` and `last` step,
        `why`, and the NIS or the share of rejections as `value`.

    Notes
    -----
    There are two of Page's tests. Each keeps a sum C, to which a step adds a figure x, at most h/3:

    .. math:: C \leftarrow \min(h, \max(0, C + x)), \quad
        x = \tfrac14 \mathrm{NIS} - \tfrac d2 \ln 2
        \ \text{ or } \ x = r \ln 5 - (n - r) \ln 1.8

    The x of the first test is of NIS, the normalised innovation squared of the step's d measured
    components: it asks whether innovations have twice their variance. The x of the second is of the
    r sightings that gates have rejected out of n: it asks whether half of all are rejected, where a
    tenth may be outliers. The belief is lost from where one C reaches h = ln 10⁶. In a consistent
    filter that happens at most once in 10⁶ steps on average. It has recovered where both have
    fallen to h − ln 100.

    A sighting counts as rejected, too, if it is taken for none of its candidates (`pgm.unknown`),
    or if truncated least squares leave it out. Where sightings are declared spurious or new more
    often than one in ten, more that are taken for no candidate are expected.

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
        """Run both tests on the numbers of all steps, (T+1, runs) each, and record the stretches.

        `lead` is the shape of the user's leading axes of runs.
        """
        steps, runs = read.nis.shape
        at, heard = np.zeros((steps, runs), dtype=bool), _reach(read.innovations)
        if np.any(read.judged) or np.any(read.open):
            heard |= _reach(read.rejections)
        some = np.flatnonzero(heard)
        if not some.size:
            return cls(at.T.reshape(*lead, steps), [])
        weights, test = read.weights[..., some], PageTest.start(some.size)
        found: list[tuple[int, int, int, int, int]] = []
        for step in range(steps):
            before, test = test, test.on(step, weights[:, step])
            at[step, some] = test.lost
            for k in np.flatnonzero(before.lost & ~test.lost).tolist():
                found.append(_row(int(some[k]), before.of(k), step - 1))
        found += [
            _row(int(some[k]), test.of(k), steps - 1) for k in np.flatnonzero(test.lost).tolist()
        ]
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
    def brief(self) -> str:
        """Where and why in a line, of the first stretch; empty if the belief was never lost."""
        if not self:
            return ""
        more = len(self.stretches) - 1
        rest = f"; {count(more, 'more stretch', 'more stretches')}" if more else ""
        return f"{int(self.at.sum()):,} of {self.at.size:,} steps; {self.stretches[0]}{rest}"

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


def _reach(ratios: Array) -> Mask:
    """The runs (runs,) in which a test's sum of ratios (steps, runs) may reach h.

    A sum that is kept above zero is, before it reaches h, the sum S of all ratios so far less its
    least value, min(0, S).
    """
    total = np.ascontiguousarray(ratios.T).cumsum(axis=1)  # several times as fast as across rows
    least = np.minimum.accumulate(total, axis=1)
    total -= np.minimum(least, 0.0, out=least)
    high = cusum.HIGH * (1.0 - 1e-9)  # since the sums are rounded differently
    return np.asarray(total.max(axis=1, initial=0.0) >= high)


def _row(run: int, test: PageTest, last: int) -> tuple[int, int, int, int, int]:
    """The latest stretch of a run as numbers, from its state `test` after the step `last`.

    They are the run, the steps where it probably began, was noticed and ended, and the number of
    the test that noticed it.
    """
    return run, int(test.first), int(test.declared), last, int(test.why)
