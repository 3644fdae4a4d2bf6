"""Page's tests whether a belief is lost: sums of log-likelihood ratios; see `pgm.posteriors.lost`.

They are written once, over numbers of any kind (`numbers`): arrays with a number for each run, and
numbers of machine code.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import log
from typing import NamedTuple

from pgm.kernels.numbers import Number, least, most, where

# κ; the shares q₀ and q₁ of rejections of a consistent belief, by outliers, and of a lost one.
INFLATION, OUTLIERS, LOST_SHARE = 2.0, 0.1, 0.5
# On average a test is wrong at most once in so many steps; the odds that a stretch is over.
STEPS, ODDS = 1e6, 100.0
HIGH, _BACK = log(STEPS), log(ODDS)
_MOST = HIGH / 3.0


class Sums(NamedTuple):
    """The state of both tests, of innovations and of rejections; see `lost.PageTest`.

    The last stretch of being lost has its `first` step, the step where it was `declared`, and in
    `why` the test that did so, 0 or 1.
    """

    level: Sequence[Number]
    onset: Sequence[Number]
    lost: Number
    first: Number
    declared: Number
    why: Number


def expected(nis: Number, dof: Number) -> Number:
    """The ratio a of innovations, whose NIS has `dof` degrees of freedom, cut to h/3."""
    return least(0.5 * ((1.0 - 1.0 / INFLATION) * nis - log(INFLATION) * dof), _MOST)


def weighed(rejected: Number, judged: Number, outliers: float = OUTLIERS) -> Number:
    """The ratio b of r = `rejected` sightings out of n = `judged`.

    q₀ is a tenth or, if larger, `outliers`, the prior share of sightings that was declared spurious
    or new; q₁ follows from q₀.
    """
    own = min(max(outliers, OUTLIERS), 1.0 - 1e-6)
    share = LOST_SHARE + (1.0 - LOST_SHARE) * (own - OUTLIERS) / (1.0 - OUTLIERS)
    return rejected * log(share / own) + (judged - rejected) * log((1.0 - share) / (1.0 - own))


def rejections(rejected: Number, judged: Number, odds: Number) -> Number:
    """The ratio b of a step, to which `odds` are added before, cut to h/3."""
    return least(weighed(rejected, judged) + odds, _MOST)


def summed(level: Number, ratio: Number) -> Number:
    """A sum after a step that adds a log-likelihood ratio."""
    return least(most(level + ratio, 0.0), HIGH)


def raised(level: Number, onset: Number, step: Number, ratio: Number) -> tuple[Number, Number]:
    """A sum and its onset after a step of that number, which adds a log-likelihood ratio."""
    return summed(level, ratio), where(level == 0.0, step, onset)


def ruled(sums: Sums, step: Number) -> Sums:
    """The verdict on sums that a step has raised."""
    level, onset, lost, first, declared, why = sums
    high, low = [x >= HIGH for x in level], [x <= HIGH - _BACK for x in level]
    cries = ~lost & (high[0] | high[1])
    over = lost & low[0] & low[1]
    return Sums(
        (where(over, 0.0, level[0]), where(over, 0.0, level[1])),
        onset,
        (lost | cries) & ~over,
        where(cries, where(high[0], onset[0], onset[1]), first),
        where(cries, step, declared),
        where(cries, where(high[0], 0, 1), why),
    )
