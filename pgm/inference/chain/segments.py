"""The steps of a chain as elements: each transition with the readings at its end."""

from __future__ import annotations

import numpy as np

from pgm.errors import NumericalError
from pgm.inference.chain.backward import transition
from pgm.inference.chain.information import absorb_readings
from pgm.inference.chain.plan import ChainPlan
from pgm.inference.chain.stacks import Stack
from pgm.kernels.arrays import Array, apply, room
from pgm.kernels.elements import Element, Likelihood
from pgm.kernels.moments import Conditional


def steps(plan: ChainPlan) -> Conditional:
    """The slice given that before it, (T, runs, n, n), of which controls play no part."""
    found = transition(plan)
    layout = plan.layout
    if layout.state_size == layout.slice_size:
        return found
    matrix = room((plan.steps, plan.runs), (layout.slice_size, layout.slice_size))
    matrix[...] = 0.0
    matrix[..., layout.state_places] = found.matrix
    return found._replace(matrix=matrix)


def about(conditional: Conditional, reference: Array) -> Conditional:
    """The same for deviations from a reference, (T+1, runs, n)."""
    matrix, offset, cov = conditional
    return Conditional(matrix, apply(matrix, reference[:-1]) + offset - reference[1:], cov)


def leaves(moves: Conditional, likelihood: Likelihood, stacks: list[Stack]) -> Element:
    """The element of every step, in deviations from a reference: (T, runs, ...).

    It begins with the readings at the step before, and ends before those of its own step; but for
    those of a singular noise, which it has with it, since they can only be absorbed by the
    transition that leads to them. Step 0 is left to the belief from which all begins.

    Parameters
    ----------
    moves : Conditional
        As `about` makes them.
    likelihood : Likelihood
        Of the readings with a regular noise, (T+1, runs, ...).
    stacks : list of Stack
        Those of a singular one.
    """
    precision = room(moves.matrix.shape[:2], moves.matrix.shape[2:])
    h = room(moves.offset.shape[:2], moves.offset.shape[2:])
    precision[:1], h[:1] = 0.0, 0.0
    precision[1:], h[1:] = likelihood.K[1:-1], likelihood.h[1:-1]
    if not stacks:
        return Element(*moves, precision, h)
    matrix, offset, cov = (np.array(part) for part in moves)
    whole = Element(matrix, offset, cov, precision, h)
    for stack in stacks:
        _absorb_exact(whole, stack)
    return whole


def _absorb_exact(moves: Element, stack: Stack) -> None:
    """Bring readings into the transitions to their steps, in place."""
    later = np.flatnonzero(stack.steps)
    if not later.size:
        return
    rows = stack.steps[later] - 1
    matrix, noise = stack.matrix[later], stack.noise[later]
    left = stack.residual[later] - apply(matrix, moves.b[rows])
    moves.F[rows], shift, moves.cov[rows], (precision, h, g) = absorb_readings(
        moves.F[rows], moves.cov[rows], matrix, left, noise, stack.missing[later]
    )
    bad = np.isnan(g).any(axis=-1)
    if bad.any():
        step = int(rows[np.flatnonzero(bad)[0]]) + 1
        raise NumericalError(
            f"the readings at step {step} are exact, and so is what the transition leads to: "
            "their covariance given the states before is singular, and the step has no element; "
            "compile without pgm.Balanced(), for a chain of slices",
            step=step,
        )
    moves.b[rows] += shift
    moves.K[rows] += precision
    moves.h[rows] += h
