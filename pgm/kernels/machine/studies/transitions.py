"""Transitions of several CPDs on a card, as one conditional of a slice given the states before it.

A slice's new components y are those of CPDs one after another, y = F p + e of parents p among the
states before and the components so far. With M the rows of all of these as linear maps of the
states, and C their covariance given the states, a CPD adds

    M_y = F M_p,   C_yk = F C_pk,   C_yy = F C_pp Fᵀ + Q,

Q being the covariance of e.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import Any, NamedTuple

from pgm.kernels.machine.emitter.card import Card, printed, thread
from pgm.kernels.machine.emitter.kinds import ADDRESS, WHOLE
from pgm.kernels.machine.emitter.memory import Memory, Runs
from pgm.kernels.machine.emitter.module import Module
from pgm.kernels.machine.studies.sums import Given

# The name of the kernel, ``pgm_compose(table, first, last)``, and the kinds of its arguments.
COMPOSE, KINDS = "compose", (ADDRESS, WHOLE, WHOLE)


class Part(NamedTuple):
    """A CPD of a transition: where its parents and its child stand in a pair, and its components.

    matrix, noise: How runs lie in F (d, n) and in Q (d, d).
    """

    parents: tuple[int, ...]
    child: int
    height: int
    matrix: Runs
    noise: Runs


class Transition(NamedTuple):
    """A transition: how many components the states have, and its CPDs in order."""

    states: int
    parts: tuple[Part, ...]

    @property
    def size(self) -> int:
        """How many components a slice has."""
        return sum(part.height for part in self.parts)


@lru_cache(maxsize=32)
def composing(form: Transition, capability: tuple[int, int]) -> str:
    """The kernel that composes the transitions of all steps, a thread a run.

    Its table has the number of steps, of each CPD F and Q, and the matrix and the covariance that
    are found, all as `Cells`.
    """
    code = Module(target=Card(capability)).function(COMPOSE, KINDS)
    given = Given(code, code.arguments[0])
    steps = given.whole()
    laws = [(given.array(part.matrix), given.array(part.noise)) for part in form.parts]
    out, spread = given.array(Runs.BESIDE), given.array(Runs.BESIDE)
    _, first, last = code.arguments
    run, front, size = first + thread(code), form.states, form.size
    with code.when(run < last), code.loop(steps) as step:
        rows: list[list[Any]] = [[float(i == j) for j in range(front)] for i in range(front)]
        rows += [[0.0] * front for _ in range(size)]
        cov: list[list[Any]] = [[0.0] * (front + size) for _ in range(front + size)]
        for part, (matrix, noise) in zip(form.parts, laws, strict=True):
            law = _loaded(matrix(step, run), part.height, len(part.parents))
            own, parents = range(part.child, part.child + part.height), part.parents
            for i, factors in zip(own, law, strict=True):
                rows[i] = [_dot(factors, [rows[p][j] for p in parents]) for j in range(front)]
                for k in range(front + size):
                    if k not in own:
                        cov[i][k] = cov[k][i] = _dot(factors, [cov[p][k] for p in parents])
            added = _loaded(noise(step, run), part.height, part.height)
            for i, line in zip(own, added, strict=True):
                for j, factors in zip(own, law, strict=True):
                    cov[i][j] = _dot(factors, [cov[i][p] for p in parents]) + line[j - part.child]
        _keep(out(step, run), rows[front:])
        _keep(spread(step, run), [row[front:] for row in cov[front:]])
    return printed(code.module, [COMPOSE])


def _loaded(cells: Memory, height: int, width: int) -> list[list[Any]]:
    return [[cells.load(i * width + j) for j in range(width)] for i in range(height)]


def _dot(factors: Sequence[Any], values: Sequence[Any]) -> Any:
    """The sum of products, without those whose value is known to be zero."""
    found: Any = 0.0
    for factor, value in zip(factors, values, strict=True):
        if isinstance(value, float):
            if value == 0.0:
                continue
            product = factor if value == 1.0 else factor * value
        else:
            product = factor * value
        found = product if isinstance(found, float) else found + product
    return found


def _keep(cells: Memory, rows: Sequence[Sequence[Any]]) -> None:
    for k, number in enumerate(number for row in rows for number in row):
        cells.store(k, number)
