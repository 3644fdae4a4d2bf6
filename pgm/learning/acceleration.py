"""Anderson acceleration of a fixed-point iteration."""

from __future__ import annotations

import numpy as np

from pgm.kernels.arrays import Array


class Anderson:
    """Extrapolation from the last steps of x ← M(x), to where their residual would be least.

    With f = M(x) − x, and differences Δx, Δf of the last points that were visited, γ minimises
    |f − Δf γ|² and the next point is x + f − (Δx + Δf) γ.

    Parameters
    ----------
    memory : int
        How many differences are kept.

    References
    ----------
    Walker & Ni, Anderson acceleration for fixed-point iterations, 2011. Henderson & Varadhan, Damped
    Anderson acceleration with restarts and monotonicity control, 2019.
    """

    def __init__(self, memory: int) -> None:
        self.memory = memory
        self.points: list[Array] = []
        self.residuals: list[Array] = []

    def forget(self) -> None:
        """Begin again from the next point."""
        self.points, self.residuals = [], []

    def proposed(self, point: Array, image: Array) -> Array | None:
        """The next point; None where only one is known."""
        self.points.append(point)
        self.residuals.append(image - point)
        self.points = self.points[-self.memory - 1 :]
        self.residuals = self.residuals[-self.memory - 1 :]
        if len(self.points) < 2:
            return None
        moves, changes = np.diff(self.points, axis=0).T, np.diff(self.residuals, axis=0).T
        weights = np.linalg.lstsq(changes, self.residuals[-1], rcond=1e-10)[0]
        found: Array = image - (moves + changes) @ weights
        return found if np.isfinite(found).all() else None
