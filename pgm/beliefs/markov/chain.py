r"""Hidden Markov chains of finitely many states: a belief is a probability for each state.

z_t are the measurements of step t, and their weights are l_t(x) = p(z_t | x). The last step is T.
The forward messages are

    α_0 = p(x_0) l_0,    α_t(x) = l_t(x) Σ_x' p(x | x') α_{t−1}(x'),

normalised at each step, and the backward ones, which `sweep.backward` carries from the last step,

    β_T = 1,    β_{t−1}(x') ∝ Σ_x p(x | x') l_t(x) β_t(x),

so that p(x_t | all measurements) ∝ α_t β_t. Nothing is divided by a predicted probability. The
*semiring* of a chain says what the entries of messages are, these numbers or their logarithms, and
how they are added up: by sums, or by maxima for the most probable path.

The *slice* of a step is its hidden variables, x a joint state of these. Arrays are (*states,
*runs): an axis for each hidden variable, or one for all states; then one of runs, the user's axes
flattened, or none where the user gave none.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from typing import Any, NoReturn, Protocol

import numpy as np

from pgm.kernels.arrays import Array
from pgm.kernels.semirings import SUM_PRODUCT, Semiring
from pgm.progress import counted
from pgm.schedules import sweep

# The product of a belief and of factors, both above this, is a number with all its digits: float64
# has them down to 2e-308.
TINY = 1e-150
# The smallest entry is looked for among so many at a time.
_CHUNK = 2**20


class Behind(Protocol):
    """A chain of slices of finitely many states, as far as backward messages need it.

    Beliefs and messages are (*states, *runs): the states of a slice have one axis or several, then
    the runs have one axis, flattened, or none where the user gave no axes of runs.

    steps: T, the last step.
    lead: The user's axes of runs.
    """

    steps: int
    lead: tuple[int, ...]

    def backward(self, step: int, message: Array) -> Array:
        """The sum Σ_x p(x | x') message(x), x being the slice of `step` and x' the one before."""
        ...

    def likelihood(self, step: int) -> tuple[Array | None, Array | float]:
        """The weights of a step's measurements, and their log-scale; None without measurements.

        p(z_t | x) is the weights, which broadcast with a belief, times the exponential of the
        scale, (*runs) or one number.
        """
        ...


class Slices(Behind, Protocol):
    """A chain of slices of finitely many states, as far as forward messages need it, too.

    It is a hidden Markov model, or a grid.
    """

    def prior(self) -> Array:
        """The probabilities of the states at step 0, (*states, *runs)."""
        ...

    def forward(self, step: int, belief: Array) -> Array:
        """The sum Σ_x' p(x | x') belief(x'), x being the slice of `step` ≥ 1, x' the one before."""
        ...

    def refuse(self, step: int, belief: Array, run: int) -> NoReturn:
        """Raise `EvidenceError` for a step's measurements, which are impossible in some run.

        belief: The predicted belief under which they have probability zero, (*states, *runs).
        run: A run in which they are impossible, by its place among the flattened runs.
        """
        ...


class BackwardChain:
    """The backward messages of a chain whose filtered beliefs are known.

    known: The filtered beliefs by step, (*states, *runs), each of sum one, in entries of the
        semiring; empty until the caller sets them.
    batch: The number of axes of runs, 1 or 0.
    """

    def __init__(self, slices: Behind, semiring: Semiring = SUM_PRODUCT) -> None:
        self.slices, self.semiring = slices, semiring
        self.batch = 1 if slices.lead else 0
        self.known: Array | list[Array] = []

    def total(self, values: Array) -> Array:
        """The sum of values (*states, *runs) over the states, (*runs), as the semiring adds."""
        return self.semiring.total(values, tuple(range(values.ndim - self.batch)))

    def unit(self) -> Array:
        """The backward message to the last slice, β_T: the semiring's one for each state."""
        return np.full(self.known[-1].shape, self.semiring.one)

    def message(self, step: int, message: Array) -> Array:
        """The backward message β to a step, of sum one, from `message`, β of the step after it."""
        found = self._passed(step, message)
        return self._scaled(found)

    def _scaled(self, message: Array) -> Array:
        """A message divided by its sum over the states, so that it stays within float64's range."""
        scaled: Array = self.semiring.over(message, self.total(message))
        return scaled

    def _passed(self, step: int, message: Array) -> Array:
        """The backward message to a step, not scaled, from `message`, that to the step after it.

        It takes in the measurements of the step after it.
        """
        weights, _ = self.slices.likelihood(step + 1)
        if weights is not None:
            message = self.semiring.times(message, weights)
        return self.slices.backward(step + 1, message)

    def back(self, step: int, message: Array) -> Array:
        """The backward message to a step, of sum one, but zero where the filtered belief is zero.

        `message` is the backward message to the step after it. The zeros change no posterior;
        without them the entries of possible states might underflow where later measurements favour
        impossible states.
        """
        found, zero = self._passed(step, message), self.semiring.zero
        return self._scaled(np.where(self.known[step] > zero, found, zero))

    def posterior(self, step: int, message: Array) -> Array:
        """The probabilities α β of the states at a step, normalised; `message` is β."""
        joint = self.semiring.times(self.known[step], message)
        return self.numbers(self.semiring.over(joint, self.total(joint)))

    def numbers(self, entries: Array) -> Array:
        """Semiring entries as probabilities: exp of logarithms, or the entries themselves."""
        if self.semiring.linear:
            return entries
        with np.errstate(under="ignore"):
            values: Array = np.exp(entries)
        return values


class StateChain(BackwardChain):
    """The messages of a hidden Markov chain, step by step, with a record of the forward ones.

    `sweep.forward` goes through the steps: it calls `start`, `predict` and `take` for the messages,
    and `keep` to record them.

    dtype: The type of the numbers in the beliefs that are kept, float64 or float32.
    log_density: ln p(z_t | z_0..t−1) by step, (T + 1, *runs), filled by `run`.
    """

    slices: Slices

    def __init__(
        self, slices: Slices, semiring: Semiring = SUM_PRODUCT, dtype: Any = np.float64
    ) -> None:
        super().__init__(slices, semiring)
        self.dtype = dtype
        self.log_density: Array = np.empty(
            (slices.steps + 1, *(math.prod(slices.lead),) * self.batch)
        )

    def run(self) -> StateChain:
        """Send the forward messages, and return the chain itself, which has kept them."""
        sweep.forward(self, self.slices.steps, self)
        return self

    def start(self) -> Array:
        """The prior over the slice at step 0."""
        return self.slices.prior()

    def predict(self, step: int, belief: Array) -> Array:
        """The belief over a step's slice, predicted from that over the slice before."""
        return self.slices.forward(step, belief)

    def take(self, step: int, belief: Array) -> tuple[Array, Array | float]:
        """The filtered belief of a step, and ln p(its measurements | those before), (*runs).

        `belief` is the predicted belief of the step. Measurements that it gives probability zero
        are refused with an `EvidenceError`.
        """
        weights, log_scale = self.slices.likelihood(step)
        joint = belief if weights is None else self.semiring.times(belief, weights)
        totals = self.total(joint)
        possible = totals > self.semiring.zero
        if not (possible.all() if self.batch else possible):
            joint, totals = self.contradicted(step, belief, joint, totals)
        known: Array = self.semiring.over(joint, totals)
        return known, self.semiring.logs(totals) + log_scale

    def contradicted(
        self, step: int, belief: Array, joint: Array, totals: Array
    ) -> tuple[Array, Array]:
        """The joint and the sums that `take` goes on with if measurements are impossible in a run.

        belief: The predicted belief of the step, (*states, *runs).
        joint: The product of `belief` and the weights of the measurements.
        totals: The sums of `joint` over the states, (*runs), some of them zero.

        Returns `joint` and `totals`, or, in a subclass, arrays in their place; this class raises an
        `EvidenceError`.
        """
        self.slices.refuse(step, belief, int(np.argmin(totals > self.semiring.zero)))

    def keep(self, step: int, predicted: Array, known: Array, log_density: Array | float) -> None:
        """Keep `known`, the filtered belief of a step, and the log-density of its measurements.

        The belief `predicted` is not kept. Where there are controls, which begin at step 1, the
        belief of step 0 has another shape, and the beliefs are kept as a list.
        """
        if not step:
            self.known = self.room(known)
        elif step == 1 and known.shape != self.known[0].shape:  # controls, which begin at step 1
            rows = np.empty((self.slices.steps, *known.shape), self.dtype)
            self.known = [self.known[0].copy(), *rows]
        self.known[step][...] = known
        self.log_density[step] = log_density

    def room(self, like: Array) -> Array:
        """A new array for a belief of the shape of `like` at each step, (T + 1, *states, *runs)."""
        return np.empty((self.slices.steps + 1, *like.shape), self.dtype)

    @property
    def smallest(self) -> float:
        """The smallest positive probability in the kept beliefs."""
        if isinstance(self.known, list):
            return min(map(smallest, self.known))
        flat = self.known.reshape(-1)
        return min(smallest(flat[at : at + _CHUNK]) for at in range(0, flat.size, _CHUNK))

    def smoothed(self) -> Iterator[tuple[int, Array]]:
        """The steps from T down to 0, each with its belief given all measurements."""
        for step, message in sweep.backward(self, self.slices.steps, self.unit()):
            yield step, self.posterior(step, message)

    def gathered(self, beliefs: Iterable[tuple[int, Array]]) -> Array | list[Array]:
        """Beliefs, given as pairs (step, belief) in any order, as one array by step.

        There is one of each step 0..T. Where there are controls, which begin at step 1, the result
        is a list, since the belief of step 0 has another shape.
        """
        if isinstance(self.known, list):
            found = dict(beliefs)
            return [found[step] for step in range(len(found))]
        rows = np.empty(self.known.shape)
        for step, belief in beliefs:
            rows[step] = belief
        return rows

    def smoothed_beliefs(self) -> Array | list[Array]:
        """The beliefs given all measurements, by step, as `gathered` returns them."""
        return self.gathered(self.smoothed())

    def lagged(self, lag: int) -> Iterator[tuple[int, Array]]:
        """The steps 0 to T, each with its belief given the measurements up to `lag` steps later."""
        for step in counted(range(self.slices.steps + 1), "back"):
            message = np.full(self.known[step].shape, self.semiring.one)
            last = min(step + lag, self.slices.steps)
            if last > step:
                message = np.full(self.known[last].shape, self.semiring.one)
                for before in range(last - 1, step - 1, -1):
                    message = self.back(before, message)
            yield step, self.posterior(step, message)


def smallest(entries: Array) -> float:
    """The smallest positive entry; infinity if there is none."""
    low = float(entries.min(initial=np.inf))
    if low == 0.0:
        low = float(entries.min(where=entries > 0.0, initial=np.inf))
    return low
