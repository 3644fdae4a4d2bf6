"""The backward sweep: Bayes' rule reverses every transition, then beliefs flow back."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from pgm.inference.chain.forward import Forward
from pgm.inference.chain.plan import ChainPlan
from pgm.kernels import moments, pseudoinverse, roots
from pgm.kernels.arrays import Array, Index, apply, block, sandwich, symmetric, transpose
from pgm.kernels.moments import Conditional


def transition(plan: ChainPlan) -> Conditional:
    """The slice given the states before it, as one affine conditional a step: (T, runs, ...)."""
    if plan.layout.single:
        family = plan.transition[0].family
        return Conditional(family.matrix, family.offset, family.noise)
    front, size = plan.layout.state_size, plan.layout.slice_size
    shape = (plan.steps, plan.runs)
    # Every component of the pair as a map of the states before, plus its share of all noises.
    matrix = np.zeros((*shape, front + size, front))
    matrix[..., :front, :] = np.eye(front)
    offset = np.zeros((*shape, front + size))
    shares = np.zeros((*shape, front + size, size))
    noise = np.zeros((*shape, size, size))
    for link in plan.transition:
        family, child = link.family, link.child
        own = slice(child.start - front, child.stop - front)
        matrix[..., child, :] = family.matrix @ matrix[..., link.parents, :]
        offset[..., child] = apply(family.matrix, offset[..., link.parents]) + family.offset
        shares[..., child, :] = family.matrix @ shares[..., link.parents, :]
        shares[..., child, own] += np.eye(own.stop - own.start)
        noise[..., own, own] = family.noise
    total = sandwich(shares[..., front:, :], noise)
    return Conditional(matrix[..., front:, :], offset[..., front:], total)


@dataclass(frozen=True, eq=False)
class Reverse:
    """The chain from its end: the model of the past given the future, for the same evidence.

    Attributes
    ----------
    states : Conditional
        The states of step t given the slice of step t + 1 and the readings up to t, at row t.
    slices : Conditional or None
        The slice given its states, at each step; None where there are no controls.
    """

    states: Conditional
    slices: Conditional | None

    @classmethod
    def make(cls, plan: ChainPlan, forward: Forward) -> Reverse:
        """Reverse every step at once: one batched call."""
        places = plan.layout.state_places
        matrix, _, noise = transition(plan)
        states = moments.reverse(
            forward.mean[:-1][..., places],
            block(forward.cov[:-1], places, places),
            matrix,
            noise,
            forward.predicted_mean[1:],
            forward.predicted_cov[1:],
        )
        return cls(
            states, _given_states(plan, forward) if plan.layout.control_places.size else None
        )

    def moved(self, mean: Array, states: Index) -> Reverse:
        """The same covariances with other smoothed means of the slices, (T+1, runs, n)."""
        matrix, _, cov = self.states
        offset = mean[:-1][..., states] - apply(matrix, mean[1:])
        slices = self.slices
        if slices is not None:
            shift = mean - apply(slices.matrix, mean[..., states])
            slices = slices._replace(offset=shift)
        return Reverse(Conditional(matrix, offset, cov), slices)

    def step_back(self, step: int, mean: Array, cov: Array) -> tuple[Array, Array]:
        """Moments of the slice at a step from those of the slice after it."""
        mean, cov = moments.push(mean, cov, Conditional(*(part[step] for part in self.states)))
        if self.slices is not None:
            mean, cov = moments.push(mean, cov, Conditional(*(part[step] for part in self.slices)))
        return mean, cov


def _given_states(plan: ChainPlan, forward: Forward) -> Conditional:
    """The slice given its states and the readings up to it; the states are given exactly."""
    layout = plan.layout
    states, controls = layout.state_places, layout.control_places
    known = block(forward.cov, states, states)
    lower = roots.root(known)
    size, front = layout.slice_size, layout.state_size
    gain = np.zeros((*forward.mean.shape[:-1], size, front))
    gain[..., states, :] = np.eye(front)
    gain[..., controls, :] = pseudoinverse.gain(block(forward.cov, controls, states), known, lower)
    rest = np.eye(size) - gain @ np.eye(size)[states]
    offset = forward.mean - apply(gain, forward.mean[..., states])
    return Conditional(gain, offset, symmetric(sandwich(rest, forward.cov)))


@dataclass(frozen=True, eq=False)
class Beliefs:
    """Moments of the slice at every step: (T+1, runs, n) and (T+1, runs, n, n)."""

    mean: Array
    cov: Array


def sweep(forward: Forward, reverse: Reverse) -> Beliefs:
    """Smoothed moments of every slice."""
    mean, cov = np.empty_like(forward.mean), np.empty_like(forward.cov)
    last = mean.shape[0] - 1
    mean[last], cov[last] = forward.mean[last], forward.cov[last]
    for step in range(last - 1, -1, -1):
        mean[step], cov[step] = reverse.step_back(step, mean[step + 1], cov[step + 1])
    return Beliefs(mean, cov)


def pairs(beliefs: Beliefs, reverse: Reverse, steps: slice | int) -> Beliefs:
    """Moments of the pairs at steps t ≥ 1, (states of t−1, slice of t), given the slices'."""
    conditional = Conditional(*(part[steps] for part in reverse.states))
    slice_mean, slice_cov = beliefs.mean[1:][steps], beliefs.cov[1:][steps]
    mean, cov = moments.push(slice_mean, slice_cov, conditional)
    cross = conditional.matrix @ slice_cov
    return Beliefs(
        np.concatenate([mean, slice_mean], axis=-1),
        np.concatenate(
            [
                np.concatenate([cov, cross], axis=-1),
                np.concatenate([transpose(cross), slice_cov], axis=-1),
            ],
            axis=-2,
        ),
    )


def backwards(
    reverse: Reverse, step: int, mean: Array, cov: Array
) -> Iterator[tuple[int, Array, Array, Array]]:
    """From a slice back to the start: step, mean, covariance, and a factor C.

    The covariance of the slice at a step with the one that was begun from is C times the covariance
    of the latter.
    """
    factor = np.broadcast_to(np.eye(mean.shape[-1]), cov.shape)
    yield step, mean, cov, factor
    for earlier in range(step - 1, -1, -1):
        mean, cov = reverse.step_back(earlier, mean, cov)
        factor = reverse.states.matrix[earlier] @ factor
        if reverse.slices is not None:
            factor = reverse.slices.matrix[earlier] @ factor
        yield earlier, mean, cov, factor
