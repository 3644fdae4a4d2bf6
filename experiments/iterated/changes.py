"""What one method does to the errors of another, run by run."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from experiments.iterated.methods import Outcome

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
        """Lowers, raises, or does not clearly change."""
        if abs(self.z) < CLEAR:
            return "does not clearly change"
        return "lowers" if self.z < 0.0 else "raises"

    def __str__(self) -> str:
        before, after = self.before.score, self.after.score
        return (
            f"{self.verdict} the RMSE ({before.rmse:.3f} to {after.rmse:.3f}, "
            f"{self.z:+.1f} standard errors of the paired difference; without the worst 5 % of "
            f"runs {before.trimmed:.3f} to {after.trimmed:.3f}; median run {before.median:.3f} "
            f"to {after.median:.3f})"
        )
