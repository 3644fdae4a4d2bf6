"""The chain family of finitely many states: beliefs are probabilities, one for each state.

With weights l_t(x) = p(z_t | x), of the measurements of step t, the forward messages are

    α_0 = p(x_0) l_0,    α_t(x) = l_t(x) Σ_x' p(x | x') α_{t−1}(x'),

normalised at each step, and the backward ones, which `sweep.backward` carries from the last step,

    β_T = 1,    β_{t−1}(x') ∝ Σ_x p(x | x') l_t(x) β_t(x),

so that p(x_t | all measurements) ∝ α_t β_t. Nothing is divided by a predicted probability.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NoReturn, Protocol

import numpy as np

from pgm.inference import sweep
from pgm.kernels.arrays import Array

# Sums of products of numbers above this are found by plain arithmetic: 1e-300 times them is none.
TINY = 1e-150


class Slices(Protocol):
    """A chain of slices of finitely many states: a hidden Markov model, or a grid.

    Beliefs and messages are (*states, *runs), the states of a slice on one axis or on several, the
    runs flattened to one axis, or none of one run.

    Attributes
    ----------
    steps : int
        T.
    lead : tuple of int
        The user's axes of runs.
    """

    steps: int
    lead: tuple[int, ...]

    def prior(self) -> Array:
        """The probabilities at step 0."""
        ...

    def forward(self, step: int, belief: Array) -> Array:
        """The belief over the slice of a step, 1 or later, from that of the step before."""
        ...

    def backward(self, step: int, message: Array) -> Array:
        """The transpose of `forward`: a message to the slice before a step, from one to its own."""
        ...

    def likelihood(self, step: int) -> tuple[Array | None, Array | float]:
        """The weights of a step's measurements and their log-scale; no weights, if there are none.

        The density of the measurements is the weights times the exponential of the scale.
        """
        ...

    def refuse(self, step: int, belief: Array, run: int) -> NoReturn:
        """Raise the error of measurements that are impossible given a predicted belief."""
        ...


class StateChain:
    """The family of one chain, and its record.

    Parameters
    ----------
    slices : Slices
    dtype : numpy type
        Of the beliefs that are kept, float64 or float32.

    Attributes
    ----------
    known : list of ndarray
        The filtered beliefs by step, (*states, *runs), each of sum one.
    log_density : list of ndarray or float
        ln p(z_t | z_0..t−1) by step, (runs,) or a number.
    """

    def __init__(self, slices: Slices, dtype: Any = np.float64) -> None:
        self.slices, self.dtype = slices, dtype
        self.batch = 1 if slices.lead else 0
        self.known: list[Array] = []
        self.log_density: list[Array | float] = []

    def run(self) -> StateChain:
        """The same, its forward sweep done."""
        sweep.forward(self, self.slices.steps, self)
        return self

    def start(self) -> Array:
        """The prior."""
        return self.slices.prior()

    def predict(self, step: int, belief: Array) -> Array:
        """The belief over the slice of a step, from that of the step before."""
        return self.slices.forward(step, belief)

    def take(self, step: int, belief: Array) -> tuple[Array, Array | float]:
        """The belief given the measurements of its step, and the logarithm of their density."""
        weights, log_scale = self.slices.likelihood(step)
        joint = belief if weights is None else belief * weights
        if not self.batch:
            total = float(np.add.reduce(joint, None))
            if not total > 0.0:
                self.slices.refuse(step, belief, 0)
            return joint / total, np.log(total) + log_scale
        totals = joint.reshape(-1, joint.shape[-1]).sum(axis=0)
        if not (totals > 0.0).all():
            self.slices.refuse(step, belief, int((totals > 0.0).argmin()))
        return joint / totals, np.log(totals) + log_scale

    def keep(
        self, step: int, predicted: Array, known: Array, log_density: Array | float
    ) -> None:
        """Keep the belief of a step."""
        self.known.append(known if known.dtype == self.dtype else known.astype(self.dtype))
        self.log_density.append(log_density)

    def back(self, step: int, message: Array) -> Array:
        """The message to the slice of a step from all later measurements, of sum one."""
        weights, _ = self.slices.likelihood(step + 1)
        if weights is not None:
            message = message * weights
        found = self.slices.backward(step + 1, message)
        return found / found.reshape(-1, *found.shape[found.ndim - self.batch :]).sum(axis=0)

    def smoothed(self) -> Iterator[tuple[int, Array]]:
        """The steps from T to 0, and the belief of each given all measurements."""
        last = np.ones_like(self.known[-1], dtype=np.float64)
        for step, message in sweep.backward(self, self.slices.steps, last):
            joint = self.known[step] * message
            totals = joint.reshape(-1, *joint.shape[joint.ndim - self.batch :]).sum(axis=0)
            yield step, joint / totals
