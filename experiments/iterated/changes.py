"""Changes of errors from one method to another, run by run."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import groupby

import numpy as np

from experiments.iterated.methods import TITLES, Grid, Outcome

# Standard errors from which on a difference is called one.
CLEAR = 2.0


@dataclass(frozen=True)
class Change:
    """From one method to another, on the same runs.

    Attributes
    ----------
    before, after : Outcome
    """

    before: Outcome
    after: Outcome

    @property
    def z(self) -> float:
        """The mean change of the squared error, in its standard errors over runs."""
        moved = self.after.squares.mean(axis=1) - self.before.squares.mean(axis=1)
        spread = moved.std() / np.sqrt(len(moved))
        return float(moved.mean() / spread) if spread > 0.0 else 0.0

    @property
    def verdict(self) -> str:
        """Lower, higher, or no clear change."""
        if abs(self.z) < CLEAR:
            return "no clear change"
        return "lower" if self.z < 0.0 else "higher"


def verdicts(grids: Mapping[str, Grid]) -> str:
    """The change of an RMSE by each number of linearisations, against one, by step control."""
    return " ".join(
        f"{name} {kind}: {_verdict(controls)}."
        for name, grid in grids.items()
        for kind, controls in grid.items()
    )


def _verdict(controls: Mapping[str, Mapping[int, Outcome]]) -> str:
    counts = [k for k in controls["plain"] if k > 1]
    return "; ".join(
        f"after {', '.join(str(k) for k in alike)} {said}"
        for said, alike in groupby(counts, lambda k: _said(controls, k))
    )


def _said(controls: Mapping[str, Mapping[int, Outcome]], count: int) -> str:
    found: dict[str, list[str]] = {}
    for control, each in controls.items():
        if count in each:
            found.setdefault(Change(each[1], each[count]).verdict, []).append(TITLES[control])
    if len(found) == 1:
        return f"{next(iter(found))} with each"
    return ", ".join(f"{verdict} with {' and '.join(who)}" for verdict, who in found.items())
