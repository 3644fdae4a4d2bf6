"""The backward sweep: Bayes' rule reverses every transition, then beliefs flow back.

The vector of a step, its *slice* (n components), holds states and hidden controls; only the states
act on the next slice. A *conditional* is affine, p(y | x) of y = F x + b + noise: a matrix F, an
offset b and a noise covariance. A transition, with the filtered belief before it, is reversed to a
conditional of the states at t given the slice at t + 1 and the measurements up to t. The filtered
belief at T is the smoothed one there, and is pushed back through these conditionals. So a backward
pass needs the forward pass (`Ahead`), which has the predicted and the filtered moments of all
steps, and the reversed chain (`Reverse`), which has the conditionals.

The reversed chain exists even where messages in information form (`messages.py`) do not, as for a
static state that is measured without noise. Arrays have the steps first and the runs second.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np

from pgm.beliefs.moments.compiled import sweep as compiled
from pgm.beliefs.moments.steps.plan import ChainPlan
from pgm.kernels import moments, roots
from pgm.kernels.arrays import Array, Index, apply, block, room, sandwich
from pgm.kernels.dense import Stack, StackRoot
from pgm.kernels.moments import Conditional
from pgm.kernels.prefixes import gather, in_chunks, levels, prefixes, take
from pgm.kernels.segment_maps import Moments, compose_conditionals, push_moments
from pgm.kernels.step import gain as gain_of
from pgm.schedules import sweep as loops

# From this many runs on, a sweep along rows of runs beats a scan along rows of steps, which does
# twice the work; and so it does with few steps, where a scan has nearly as many rounds.
_MANY_RUNS = 32
_FEW_STEPS = 64


def transition(plan: ChainPlan) -> Conditional:
    """The conditional p(slice at t | states at t − 1) that the transition's CPDs make together.

    Its arrays are (T, runs, ...), and row t − 1 is of step t. The matrix (T, runs, n, m) has a
    column for each of the m components of the states.
    """
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


def between_slices(plan: ChainPlan) -> Conditional:
    """The transition as conditionals of slices at t given whole slices at t − 1, t = 1..T.

    Their matrices are (T, runs, n, n); columns of the earlier controls are zero.
    """
    found = transition(plan)
    layout = plan.layout
    if layout.state_size == layout.slice_size:
        return found
    matrix = room((plan.steps, plan.runs), (layout.slice_size, layout.slice_size))
    matrix[...] = 0.0
    matrix[..., layout.state_places] = found.matrix
    return found._replace(matrix=matrix)


def about(conditional: Conditional, reference: Array) -> Conditional:
    """The same conditionals, over x[t] − reference[t] in place of the slices x[t].

    `conditional` has p(x[t] | x[t − 1]) for t = 1..T, of matrices (T, runs, n, n); `reference` is
    (T+1, runs, n).
    """
    matrix, offset, cov = conditional
    return Conditional(matrix, apply(matrix, reference[:-1]) + offset - reference[1:], cov)


class Ahead(Protocol):
    """A forward pass, as a backward pass reads it: moments before and after measurements."""

    @property
    def predicted_mean(self) -> Array:
        """The predicted means, before each step's measurements, (T+1, runs, n)."""
        ...

    @property
    def predicted_cov(self) -> Array:
        """The predicted covariances, (T+1, runs, n, n)."""
        ...

    @property
    def mean(self) -> Array:
        """The filtered means, (T+1, runs, n)."""
        ...

    @property
    def cov(self) -> Array:
        """The filtered covariances, (T+1, runs, n, n)."""
        ...


@dataclass(frozen=True, eq=False)
class Reverse:
    """The reversed chain: affine conditionals of each slice given the next, for the same evidence.

    `states` (T, runs, ...) has in row t p(states at t | slice at t + 1, measurements up to t).
    `slices` (T+1, runs, ...) has in row t p(slice at t | its states, measurements up to t); None if
    there are no controls, so that the states are the slice.
    """

    states: Conditional
    slices: Conditional | None

    @classmethod
    def make(cls, plan: ChainPlan, forward: Ahead) -> Reverse:
        """Reverse the transitions of a plan by Bayes' rule, many steps at once."""
        moved, slices = transition(plan), _given_states(plan, forward)
        found = compiled.backward(plan, forward, moved, slices, reverse=True, smooth=False)
        states = None if found is None else found[0]
        return cls(_reversed(plan, forward, moved) if states is None else states, slices)

    @property
    def whole(self) -> Conditional:
        """The conditionals p(slice at t | slice at t + 1, measurements up to t), row t of T."""
        if self.slices is None:
            return self.states
        return compose_conditionals(self.states, Conditional(*(part[:-1] for part in self.slices)))

    def moved(self, mean: Array, states: Index) -> Reverse:
        """The same chain with its offsets changed, such that its smoothed means are `mean`.

        `mean` is (T+1, runs, n); `states` are the places of the states in a slice.
        """
        matrix, _, cov = self.states
        offset = mean[:-1][..., states] - apply(matrix, mean[1:])
        slices = self.slices
        if slices is not None:
            shift = mean - apply(slices.matrix, mean[..., states])
            slices = slices._replace(offset=shift)
        return Reverse(Conditional(matrix, offset, cov), slices)

    def back(self, step: int, belief: tuple[Array, Array]) -> tuple[Array, Array]:
        """Smoothed mean (runs, n) and covariance (runs, n, n) of the slice at a step.

        `belief` are the smoothed mean and covariance one step later.
        """
        mean, cov = moments.push(*belief, Conditional(*(part[step] for part in self.states)))
        if self.slices is not None:
            mean, cov = moments.push(mean, cov, Conditional(*(part[step] for part in self.slices)))
        return mean, cov


def _reversed(plan: ChainPlan, forward: Ahead, moved: Conditional) -> Conditional:
    """The states of a `Reverse` by the general kernels; `moved` is the plan's transition."""
    places = plan.layout.state_places
    matrix, _, noise = moved
    parts = _Step(
        forward.mean[:-1][..., places],
        block(forward.cov[:-1], places, places),
        matrix,
        noise,
        forward.predicted_mean[1:],
        forward.predicted_cov[1:],
    )
    found: Conditional = in_chunks(_reverse, parts)
    return found


class _Step(NamedTuple):
    """The quantities of Bayes' rule that reverse transitions from t to t + 1, t = 0..T − 1.

    `mean` (T, runs, m) and `cov` (T, runs, m, m) are the filtered moments of the states at t, of m
    components. `matrix` (T, runs, n, m) and the covariance `noise` (T, runs, n, n) are those of the
    transition. `forward_mean` (T, runs, n) and `forward_cov` (T, runs, n, n) are the predicted
    moments of the slice at t + 1.
    """

    mean: Array
    cov: Array
    matrix: Array
    noise: Array
    forward_mean: Array
    forward_cov: Array


def _reverse(step: _Step) -> Conditional:
    """p(states at t | slice at t + 1, measurements up to t) by Bayes' rule, for many t at once.

    `step` has the filtered moments of the states at these t, the transitions from there, and the
    predicted moments of the slices at t + 1. The result has the same rows.
    """
    return moments.reverse(*step)


def _given_states(plan: ChainPlan, forward: Ahead) -> Conditional | None:
    """p(slice | its states, measurements up to its step) as affine conditionals, (T+1, runs, ...).

    The states follow from themselves, without noise; the controls by their regression on the
    states, with the gain Cov(controls, states) Cov(states)⁺ of the filtered belief. None without
    controls, as the states are the slice then.
    """
    layout = plan.layout
    states, controls = layout.state_places, layout.control_places
    if not controls.size:
        return None
    known = block(forward.cov, states, states)
    lower = roots.root(known)
    size, front = layout.slice_size, layout.state_size
    gain = np.zeros((*forward.mean.shape[:-1], size, front))
    gain[..., states, :] = np.eye(front)
    cross = Stack(block(forward.cov, states, controls))
    gain[..., controls, :] = gain_of(StackRoot(lower, known), cross).array
    offset = forward.mean - apply(gain, forward.mean[..., states])
    nothing = np.zeros((front, front))
    left = moments.squares(forward.cov, gain, np.eye(size)[states], nothing)
    return Conditional(gain, offset, left)


def stepwise_is_faster(steps: int, runs: int) -> bool:
    """Whether a smoother that goes one step after another is faster than a parallel scan.

    It is taken to be so with 32 `runs` or more, since a scan does twice the work, and with fewer
    than 64 `steps`, for which a scan needs nearly as many rounds.
    """
    return runs >= _MANY_RUNS or steps < _FEW_STEPS


@dataclass(frozen=True, eq=False)
class Beliefs:
    """Moments of the slice at every step: (T+1, runs, n) and (T+1, runs, n, n).

    `kept` says of smoothed ones that all their numbers, and those of the forward pass, are finite,
    and that the way back surely left them the digits that are promised.
    """

    mean: Array
    cov: Array
    kept: bool = False


def smoothed(
    plan: ChainPlan, forward: Ahead, *, reverse: bool = False
) -> tuple[Beliefs, Reverse | None]:
    """Smoothed moments of every slice, and the reversed chain, if it was made on the way.

    Machine code makes it with `reverse` alone. The general kernels do always, and then go back by
    a parallel scan, or step by step where that is faster.
    """
    moved, slices = transition(plan), _given_states(plan, forward)
    found = compiled.backward(plan, forward, moved, slices, reverse=reverse, smooth=True)
    if found is not None:
        states, beliefs, kept = found
        assert beliefs is not None
        return Beliefs(*beliefs, kept), None if states is None else Reverse(states, slices)
    made = Reverse(_reversed(plan, forward, moved), slices)
    stepwise = stepwise_is_faster(*forward.mean.shape[:2])
    return sweep(forward, made) if stepwise else scan(forward, made), made


def scan(forward: Ahead, reverse: Reverse) -> Beliefs:
    """Smoothed moments of every slice by a parallel scan, in 2 log₂ T rounds.

    A round composes conditionals of `reverse`, or pushes beliefs through such products, at many
    steps at once. The scan begins with the filtered belief at T, from `forward`.
    """
    start = Moments(forward.mean[-1:], forward.cov[-1:])
    back = Conditional(*(part[::-1] for part in reverse.whole))
    found = prefixes(start, levels(back, compose_conditionals), push_moments)
    mean = room(forward.mean.shape[:2], forward.mean.shape[2:])
    cov = room(forward.cov.shape[:2], forward.cov.shape[2:])
    mean[:-1], mean[-1:] = found.mean[::-1], start.mean
    cov[:-1], cov[-1:] = found.cov[::-1], start.cov
    return Beliefs(mean, cov)


def sweep(forward: Ahead, reverse: Reverse) -> Beliefs:
    """Smoothed moments of every slice, one step after another.

    The filtered belief at T, from `forward`, is pushed back through the conditionals of `reverse`.
    """
    mean, cov = np.empty_like(forward.mean), np.empty_like(forward.cov)
    last = forward.mean[-1], forward.cov[-1]
    for step, belief in loops.backward(reverse, len(mean) - 1, last):
        mean[step], cov[step] = belief
    return Beliefs(mean, cov)


def lagged(forward: Ahead, reverse: Reverse, lag: int) -> Beliefs:
    """Moments of every slice given the measurements up to `lag` steps later, all steps at once.

    Let B_k[t] be the belief over slice t given the measurements up to t + k, and C_m[t] the
    conditional of slice t given slice t + m and the measurements up to t + m − 1. Steps after T are
    replaced by T. Then

        B_{k+m}[t] = C_m[t] B_k[t + m],    C_{2m}[t] = C_m[t] C_m[t + m].

    The first rule pushes beliefs through conditionals, from the filtered B_0 on, for each power m
    of two that `lag` is a sum of; the second composes conditionals to those of the next power.
    """
    shape, own = forward.mean.shape[:2], forward.mean.shape[2:]
    mean, cov = room(shape, own), room(shape, own * 2)
    mean[...], cov[...] = forward.mean, forward.cov
    last = shape[0] - 1
    back, reach, left = reverse.whole, 1, min(lag, last)
    while left:
        if left % 2:
            ends = np.minimum(np.arange(reach, last + reach), last)
            found = in_chunks(push_moments, Moments(gather(mean, ends), gather(cov, ends)), back)
            mean[:-1], cov[:-1] = found
        left //= 2
        if left:
            later, sooner, end = map(slice, (reach, None, -reach), (None, -reach, None))
            both = in_chunks(compose_conditionals, take(back, later), take(back, sooner))
            parts = zip(both, take(back, end), strict=True)
            back = Conditional(*map(np.concatenate, parts))
            reach *= 2
    return Beliefs(mean, cov)


def pairs(beliefs: Beliefs, reverse: Reverse, steps: slice | int) -> Beliefs:
    """Joint smoothed moments of the pairs (states at t − 1, slice at t).

    `beliefs` are the smoothed moments of the slices. `steps` picks values of t − 1, which is from 0
    to T − 1, by a Python slice or an int. The result is (picked steps, runs, ...), or (runs, ...)
    for an int; components are those of the states, then those of the slice.
    """
    conditional = Conditional(*(part[steps] for part in reverse.states))
    return Beliefs(
        *moments.pushed_with(beliefs.mean[1:][steps], beliefs.cov[1:][steps], conditional)
    )
