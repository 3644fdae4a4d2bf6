"""Marks of rows for which an oracle is too weak: its errors, or other oracles, say so."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from pgm import consistency
from pgm.comparison.judgement import BAND, Judgement, Parts
from pgm.comparison.reference import Reference
from pgm.display import count, number
from pgm.factors import Gaussian
from pgm.kernels.arrays import Mask

# A difference of KLs in nats below which rows are the same, so that none is to be shown.
SAME = 1e-9


class Judged(NamedTuple):
    """One oracle's judgement of a row that has one, with the parts of groups in its error.

    label: The row, in words.
    """

    label: str
    judgement: Judgement
    parts: Parts | None


def marked(
    reference: Reference, every: Sequence[Judged], apart: Mapping[str, Judgement]
) -> list[Judgement]:
    """The judgements of one oracle on the rows of one state and kind, marked where it is too weak.

    It is too weak for a row if

    - nothing vouches for its errors: `Reference.doubt`;
    - nothing tells its errors, which are NaN;
    - the row's KL, in some run, is no more than the bound on the oracle's own error: `hidden`;
    - 1.96 errors of the row's KL are no less than all differences between this and other rows, or
      than the KL itself of a single row;
    - the difference from another row is within 1.96 of its own errors, which are less than those of
      both rows, as both were judged by the same draws;
    - another oracle is as far from it as the row is, by 1.96 errors, and not by chance: one of both
      is wrong.

    apart: By name of the other oracles, the KL of their beliefs from this one's.
    """
    return [replace(each.judgement, weak=_why(reference, each, every, apart)) for each in every]


def hidden(reference: Reference, belief: Gaussian, kept: Mask) -> str:
    """Why a row's KL may be the oracle's own error, by the bound of an estimate's verdict.

    The KL of each run, the mean over the steps `kept`, is to be above the bound of that run. Exact
    estimates, whose bound is 0, hide none.
    """
    if reference.within is None or not kept.any():
        return ""
    each = consistency.kl(reference.gaussian[..., kept], belief[..., kept]).mean(axis=-1)
    bound = np.broadcast_to(reference.within, each.shape)
    below = (each <= bound) & (bound > 0.0)
    if not below.any():
        return ""
    runs = f" in {below.sum()} of {count(below.size, 'run')}" if below.ndim else ""
    most = number(float(bound[below].max()), 2)
    return f"the row's KL{runs} is no more than {most} nats, within which the estimate is known"


def _why(
    reference: Reference, row: Judged, every: Sequence[Judged], apart: Mapping[str, Judgement]
) -> str:
    own = row.judgement
    if np.isnan(own.kl):
        return ""
    if reference.doubt:
        return reference.doubt
    if own.weak:
        return own.weak
    if np.isnan(own.error) and reference.within is None:
        return "nothing tells the oracle's own error, as its beliefs are made once, of draws"
    if row.parts is not None:
        others = [each for each in every if each is not row and each.parts is not None]
        gaps = [abs(own.kl - each.judgement.kl) for each in others]
        due = max(gaps, default=abs(own.kl))
        band = BAND * own.error
        if band >= max(due, SAME):
            what = "differences between rows are" if gaps else "KL itself is"
            return f"the row's KL is known to ± {band:.2g} nats, and the {what} {due:.2g}"
        for each, gap in zip(others, gaps, strict=True):
            assert each.parts is not None
            band = BAND * row.parts.less(each.parts).error(reference.factor)
            if band >= gap > SAME:
                return (
                    f"the row's KL differs from that of {each.label} by {gap:.2g} ± {band:.2g} nats"
                )
    for name, other in apart.items():
        error = 0.0 if np.isnan(other.error) else other.error
        if other.kl + BAND * error >= own.kl and other.kl - BAND * error > SAME:
            return f"the oracle {name} is {other.kl:.2g} nats from this oracle"
    return ""
