"""A quasi-Newton correction of steps of expectation-maximisation."""

from __future__ import annotations

import numpy as np

from pgm.kernels.arrays import Array

# The least cosine between a move and the change of the gradient that tells a curvature.
_TOLD = 1e-14


class QuasiNewton:
    r"""Steps that begin as those of EM, and learn the log-evidence's curvature as they go.

    With the gradient g of the log-evidence ℓ, which by Fisher's identity is that of the expected
    log-density at the same point, and the EM step e(θ) = M(θ) − θ, the step is

    .. math:: d = e + S g,

    with S symmetric, zero at first, and after each move Δθ changed by Broyden, Fletcher, Goldfarb
    and Shanno's rule, so that it would have told that move: Δθ = −(Δe + S Δg).

    As long as the log-evidence bends upwards along the moves, so that no curvature can be learnt,
    steps are those of EM, stretched twice as far each time.

    References
    ----------
    Jamshidian & Jennrich, Acceleration of the EM algorithm by using quasi-Newton methods, 1997,
    method QN2.

    Parameters
    ----------
    size : int
        Number of coordinates.
    """

    def __init__(self, size: int) -> None:
        self.correction = np.zeros((size, size))
        self.last: tuple[Array, Array, Array] | None = None
        self.stretch = 1.0

    def forget(self) -> None:
        """Begin again as EM."""
        self.correction[:] = 0.0
        self.last, self.stretch = None, 1.0

    def step(self, point: Array, gradient: Array, plain: Array) -> Array | None:
        """The step at the next point, given EM's; None where nothing is known beyond that."""
        if self.last is not None:
            move, turned, changed = (
                a - b for a, b in zip((point, gradient, plain), self.last, strict=True)
            )
            self._learn(move, turned, changed)
        self.last = point, gradient, plain
        if not self.correction.any():
            self.stretch *= 2.0
            return self.stretch * plain if self.stretch > 2.0 else None
        step: Array = plain + self.correction @ gradient
        if not np.isfinite(step).all() or step @ gradient <= 0.0:
            self.forget()
            self.last = point, gradient, plain
            return None
        return step

    def _learn(self, move: Array, turned: Array, changed: Array) -> None:
        bend = -float(turned @ move)
        if bend <= _TOLD * float(np.linalg.norm(turned) * np.linalg.norm(move)):
            return
        left = move + changed + self.correction @ turned
        both = np.outer(left, move)
        self.correction += (both + both.T) / bend
        self.correction += float(left @ turned) / bend**2 * np.outer(move, move)
