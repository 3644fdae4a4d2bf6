"""Solving a tree as its CPDs are linearised now, by stacks of fronts or in machine code.

Rows are made triangular by Householder's reflections. Where a solution only leads to the next
linearisation, normal equations are factorised instead, which takes a third of the time or less;
what squares lose shows when the last solution is made by rows.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from importlib.util import find_spec
from typing import TYPE_CHECKING

import numpy as np

from pgm.beliefs.gaussian.beliefs import Beliefs, Calibrated, Sizes
from pgm.beliefs.gaussian.front_stacks import FrontStacks
from pgm.beliefs.gaussian.hidden_noise import Candidates
from pgm.beliefs.gaussian.model import Model
from pgm.beliefs.gaussian.potentials import Potentials, make_potentials
from pgm.beliefs.gaussian.refusals import improper
from pgm.beliefs.gaussian.row_buffer import Buffer
from pgm.beliefs.gaussian.tree import (
    TreeBeliefs,
    TreePlan,
    calibrate,
    calibrate_by_squares,
    not_kept,
    read_back,
)
from pgm.compile.machine import COMPILED
from pgm.errors import NumericalError
from pgm.kernels.arrays import LOG_2PI, Array, frozen
from pgm.kernels.rows import NEGLIGIBLE
from pgm.schedules.iteration import Anchor

if TYPE_CHECKING:
    from pgm.kernels.machine.fronts.solving import Solver

# Fronts, counted once for each run with matrices of its own, from which on machine code pays.
MANY = 150
# A pivot below this part of its square is left by rounding: rows have it to twice as many digits.
CANCELLED = 1e-13


@dataclass(eq=False)
class TreeSolver:
    """A tree whose linearised CPDs are solved again and again.

    Attributes
    ----------
    plan : TreePlan
    model : Model
    squares : bool
        Whether normal equations may be factorised; `solve` sets it to False where that fails.
    compilation : str
        How the last solution was made, as `Status.compilation` tells it.
    """

    plan: TreePlan
    model: Model
    squares: bool = True
    compilation: str = ""
    _largest: float = field(default=0.0, init=False)
    _coarse: float = field(default=0.0, init=False)

    @classmethod
    def of(cls, plan: TreePlan, model: Model) -> TreeSolver:
        """The solver of a model, which integrates hidden noise out before if the tree is large."""
        if plan.layout.graph.compiled or _is_large(plan, model):
            candidates = Candidates.of(model)
            plan = plan if candidates is None else plan.without_noise(candidates)
        solver = cls(plan, model)
        if solver._pays or solver._stacked > 1:
            return solver
        return cls(plan.for_numpy(), model)

    @property
    def _stacked(self) -> int:
        return 1 if self.model.shared else self.model.runs

    def solve(self, anchor: Anchor | None = None, *, to_move: bool = False) -> Calibrated:
        """The beliefs, and ln p(evidence); of one `to_move` by, ln p is not asked for.

        An anchor's measurement is added, if there is one: the layout has to be anchored then, and
        the sizes of its numbers are not those of the network.
        """
        if anchor is None:
            return self._with_noise(make_potentials(self.model), to_move)
        buffer: Buffer[FrontStacks] | None = self.__dict__.get("_buffer")
        own = self._largest, self._coarse
        its = (0.0, 0.0) if buffer is None else (buffer.largest, buffer.coarse)
        done = self._with_noise(make_potentials(self.model, anchor), to_move)
        self._largest, self._coarse = own
        if buffer is not None:
            buffer.largest, buffer.coarse = its
        return done

    def _with_noise(self, potentials: Potentials, to_move: bool) -> Calibrated:
        noise = self.plan.noise
        if noise is None:
            if self.model.frame.by_noise:
                self._require_proper(potentials)
            done = self._solved(potentials, to_move)
        else:
            potentials, given = noise.integrated(self.model, potentials)
            exact = potentials.exact is not None
            self._require_proper(potentials)
            done = self._solved(potentials, to_move)
            done = read_back(self.plan, noise, done, given, exact=exact)
        sizes = done.sizes
        if to_move or sizes is None or potentials.exact is not None:
            return done
        residual = potentials.largest_residual(done.beliefs.in_frame()[0])
        information = potentials.column_squares()
        return replace(done, sizes=sizes._replace(information=information, residual=residual))

    def _require_proper(self, potentials: Potentials) -> None:
        """Refuse relations that are left without noise, which ask for all noise in the tree."""
        if potentials.exact is not None:
            raise NumericalError("relations without noise are left beside hidden noise")

    def _solved(self, potentials: Potentials, to_move: bool) -> Calibrated:
        if self._pays:
            if potentials.exact is None:
                self.compilation = COMPILED
                return self._in_machine_code(potentials, to_move)
            self.compilation = "not compiled: CPDs without noise are left to NumPy"
        if to_move and self.squares and potentials.exact is None:
            found = calibrate_by_squares(self.plan, self.model.frame, potentials, CANCELLED)
            if found is not None:
                return found
            self.squares = False
        return calibrate(self.plan, self._buffer, potentials)

    @property
    def _pays(self) -> bool:
        choice = self.plan.layout.graph.compiled
        if choice is not None:
            return bool(choice)
        return _is_large(self.plan, self.model) and find_spec("llvmlite") is not None

    @cached_property
    def _buffer(self) -> Buffer[FrontStacks]:
        return Buffer.make(self.plan.stacks, self.model)

    @cached_property
    def _solver(self) -> Solver:
        from pgm.kernels.machine.fronts.solving import Solver

        return Solver(self.plan.machine, self.model.runs if self.model.shared else 1)

    def _in_machine_code(self, potentials: Potentials, to_move: bool) -> Calibrated:
        plan, frame, solver = self.plan, self.model.frame, self._solver
        matrix, right = (np.ascontiguousarray(part) for part in potentials.proper)
        self._coarse = float(np.maximum(self._coarse, potentials.coarse))
        self._largest = float(np.maximum(self._largest, np.abs(matrix).max(initial=0.0)))
        stacked, _, sides = right.shape
        found = Beliefs.empty(plan.of_fronts, frame, stacked, sides)
        total: Array = potentials.log_scale.sum(axis=1)
        units = frame.scale[plan.fronts.order]
        unit = float(np.log(units).sum()) + 0.5 * LOG_2PI * units.size
        kept, magnified = list[Array](), 1.0
        for v in range(stacked):
            room, residual, fault = solver.room(), np.zeros(sides), 0
            if to_move and self.squares:
                fault = solver.squares(matrix[v], right[v], room, CANCELLED)
                self.squares = fault < 0
            if not (to_move and self.squares):
                residual, fault = solver.rows(matrix[v], right[v], room, NEGLIGIBLE)
            if fault >= 0:
                raise improper(
                    self.model, potentials.assembly, int(plan.fronts.tops[fault]), matrix
                )
            magnified = max(magnified, solver.back(room, found.mean[v], found.cov[v]))
            total[v] += unit - solver.log_pivots(room) - 0.5 * residual
            kept.append(room)
        gain = not_kept if to_move else _Gains(plan, sides, kept)
        beliefs = TreeBeliefs(found.places, found.frame, found.mean, found.cov, gain)
        sizes = Sizes(self._largest, self._coarse, magnified=magnified)
        return Calibrated(beliefs, frozen(total), sizes)


def _is_large(plan: TreePlan, model: Model) -> bool:
    return len(plan.fronts) * (1 if model.shared else model.runs) >= MANY


def may_be_large(plan: TreePlan) -> bool:
    """Whether hidden noise is integrated out of a tree in any case, if there is some."""
    return bool(plan.layout.graph.compiled) or len(plan.fronts) >= MANY


@dataclass(frozen=True, eq=False)
class _Gains:
    """The regressions of fronts' pivots on their separators, from the triangles that were kept."""

    plan: TreePlan
    sides: int
    kept: list[Array]

    def __call__(self, front: int) -> Array:
        plan = self.plan.machine
        own, size = int(plan.pivots[front]), int(plan.sizes[front])
        begin = int(plan.keeps(self.sides)[front])
        there = slice(begin, begin + own * (size + self.sides))
        rows = np.stack([each[there].reshape(own, size + self.sides) for each in self.kept])
        triangle = np.triu(rows[..., :own])
        return -np.asarray(np.linalg.solve(triangle, rows[..., own:size]))
