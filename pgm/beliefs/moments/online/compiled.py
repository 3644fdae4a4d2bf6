"""Online steps of one robot in machine code.

A step that the machine code cannot make is made by NumPy, in the filter's *general way*. A *kind*
of step is told by the variables that are given and the shapes of their arrays; each kind has a
`Layout`, a table that machine code reads, which is made at the first step of that kind. The first
steps of a kind are made in both ways, and compared. *Sightings* are the measurements of one sensor,
of which a step may have several (`pgm.sightings`).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from typing import Any

import numpy as np

from pgm.beliefs.moments.compiled.judged import judge
from pgm.beliefs.moments.online.beliefs import MomentBelief, is_plain, put_core
from pgm.beliefs.moments.online.layout import Layout
from pgm.beliefs.moments.steps.plan import ChainPlan
from pgm.compile import SliceLayout
from pgm.evidence import Sightings
from pgm.kernels.arrays import Array
from pgm.posteriors.belief_kind import FILTERED, PREDICTED
from pgm.posteriors.status import Status
from pgm.schedules.step_evidence import ARRAY, FLOAT, MOST, Values, numbers

Make = Callable[[MomentBelief, Any], ChainPlan]
General = Callable[[MomentBelief, Any], MomentBelief]

_NO_ROWS = np.empty((0, 0))
# Beliefs of both ways are the same to so many standard deviations.
_CLOSE = 1e-6
# After the name of a sensor with sightings, before those of the parents given with them.
_SIGHTED = object()
_new, _empty = object.__new__, np.empty
# Why a step is made the general way.
_OTHER = "the belief is of many runs, in twice the digits, has lost digits, or is of another filter"
_START = "an update at step 0"
_ODD = "values came in another form than numbers or sightings without steps"
_JUDGED = "a function's trace, or machine code, answered otherwise than the function"
_FAR = "numbers are too far apart, or a reading is too sharp"


class CompiledSteps:
    """Machine code for the steps of an online filter of one run, without gates or windows.

    It is made from functions of the filter, each of a belief and the values given. `ahead` and
    `seen` make the plan of a prediction and of an update, which lays out the step's CPDs and
    evidence; `moved` and `taken` make these steps in the general way. `done` is the status after
    predictions and updates by linear sensors, `linearised` after others. `left` counts the steps
    made in the general way, by reason: the belief is of many runs or of another filter, or float64
    has too few digits for it; a value is neither an array of numbers nor sightings without steps;
    the update is at step 0; machine code cannot make steps of the kind, or its results, compared
    with NumPy's, were others; or numbers are too far apart.
    """

    def __init__(
        self,
        layout: SliceLayout,
        ahead: Make,
        seen: Make,
        moved: General,
        taken: General,
        done: Status,
        linearised: Status,
    ) -> None:
        from pgm.kernels.compiled import online  # here, since Numba is slow to import

        self.layout = layout
        self.only = layout.slice[0] if len(layout.slice) == 1 else None
        self._shape = layout.slice_size + 1, layout.slice_size
        self._predict, self._update = _entry(online.predict), _entry(online.update)
        self._ways = (seen, taken, self._update), (ahead, moved, self._predict)
        self._statuses = linearised, done
        # The layouts of the last update and the last prediction, which are looked at first; of all.
        self._last: list[Layout | None] = [None, None]
        self._known: dict[Any, Layout] = {}
        # Why steps were made the general way, and how many of them.
        self.left: Counter[str] = Counter()

    def predict(self, belief: MomentBelief, inputs: Values | None = None) -> MomentBelief:
        """Predict one step in machine code if that can be, else in the general way.

        The usual case of a single input, in a prediction of the same kind as the last one, takes a
        short way; all others go the long way, by `_any`.
        """
        core, kind = belief._core if type(belief) is MomentBelief else None, self._last[1]
        if core and core[0] is self and kind and type(inputs) is dict and len(inputs) == 1:
            ((variable, row),) = inputs.items()
            if (
                variable is kind.first
                and type(row) is ARRAY
                and row.dtype is FLOAT
                and row.ndim == 1
            ):
                _, step, known, log_evidence, _, _ = core
                found = _empty(self._shape)
                moved = self._predict(kind.step, known, found, row)
                if moved == 0.0:
                    after: MomentBelief = _new(MomentBelief)
                    put_core(after, (self, step + 1, found, log_evidence, PREDICTED, kind.status))
                    return after
        return self._any(belief, {} if inputs is None else inputs, moves=True)

    def update(self, belief: MomentBelief, readings: Values) -> MomentBelief:
        """Update in machine code if that can be, else in the general way.

        The usual case, sightings of one sensor with one parent given in an update of the same kind
        as the last one, takes a short way; all others go the long way, by `_any`.
        """
        core, kind = belief._core if type(belief) is MomentBelief else None, self._last[0]
        if core and core[0] is self and kind and type(readings) is dict and len(readings) == 1:
            _, step, known, log_evidence, _, _ = core
            ((variable, seen),) = readings.items()
            if step and variable is kind.first and type(seen) is Sightings and seen.step is None:
                first, given = seen.values, seen.given
                if len(given) == 1:
                    ((parent, second),) = given.items()
                    if (
                        parent is kind.second
                        and type(first) is ARRAY
                        and first.dtype is FLOAT
                        and first.ndim == 2
                        and type(second) is ARRAY
                        and second.dtype is FLOAT
                        and second.ndim == 2
                    ):
                        found = _empty(self._shape)
                        density = self._update(kind.step, known, found, first, second)
                        if density == density:
                            after: MomentBelief = _new(MomentBelief)
                            total = log_evidence + density
                            put_core(after, (self, step, found, total, FILTERED, kind.status))
                            return after
        return self._any(belief, readings, moves=False)

    def adopted(self, belief: MomentBelief) -> MomentBelief:
        """The same belief, with a core, from which compiled steps can go on.

        It gets none if it has axes of runs, or float64 has too few digits for it.
        """
        if not belief.lead and belief.status.digits is None and is_plain(belief):
            both = np.vstack([belief.mean, belief.cov])
            told = belief.log_evidence.item(), belief.kind, belief.status
            put_core(belief, (self, belief.step, both, *told))
        return belief

    def _any(self, belief: MomentBelief, values: Values, *, moves: bool) -> MomentBelief:
        """A step with values of any kind: a prediction if it `moves`, else an update.

        The layout of the step's kind is looked up, or made. The first few steps of a kind, its
        *trials*, are made in the general way, too; where the two beliefs differ, the one of the
        general way is returned.
        """
        core = belief._core if type(belief) is MomentBelief else None
        make, general, kernel = self._ways[moves]
        given, why = None, _OTHER
        if core and core[0] is self:
            why = _START
            if moves or core[1]:
                given, why = _given(values), _ODD
        if core and given:
            names, rows = given
            key = make, *names, *(row.shape for row in rows)
            kind = self._known.get(key)
            if kind is None:
                if len(self._known) >= MOST:
                    self._known.clear()
                kind = self._known[key] = self._laid(make, belief, values, rows)
            why = kind.why
            if kind.step is not None:
                if kind.first is None:
                    one = len(rows) == 1
                    row = rows[0].ravel() if one else np.concatenate([_NO_ROWS, *rows], axis=None)
                    rows = [row] if moves else [row[None], _NO_ROWS]
                _, step, known, log_evidence, _, _ = core
                found = _empty(self._shape)
                density, why = kernel(kind.step, known, found, *rows), _FAR
                if density == density:
                    after: MomentBelief = _new(MomentBelief)
                    told = log_evidence + density, PREDICTED if moves else FILTERED, kind.status
                    put_core(after, (self, step + moves, found, *told))
                    if not kind.trials:
                        self._last[moves] = kind
                        return after
                    due = general(belief, values)
                    if _tried(kind, found, due):
                        return after
                    self.left[_JUDGED] += 1
                    return self.adopted(due)
        self.left[why] += 1
        return self.adopted(general(belief, values))

    @np.errstate(over="ignore", invalid="ignore", divide="ignore")
    def _laid(self, make: Make, belief: MomentBelief, values: Values, rows: list[Array]) -> Layout:
        """The layout of a kind of step, without a table where machine code cannot make the step.

        `make` makes the plan of the step; `rows` are the arrays of the `values`. A *trace* is a
        function recorded as a graph of scalar operations. Traces are compared with their functions
        at the belief, and made anew, once, if one is wrong.
        """
        for _ in range(2):  # a trace that is wrong is made anew
            plan = make(belief, values)
            made = Layout(plan, values, [row.shape for row in rows], self._statuses[plan.linear])
            shape = plan.steps + 1, 1
            mean, cov = belief.mean, belief.cov
            here = (
                np.broadcast_to(mean, (*shape, *mean.shape)),
                np.broadcast_to(cov, (*shape, *cov.shape)),
            )
            if made.step is not None:
                judge(plan, here, here, np.ones(1, dtype=bool))
            if made.judge.passes():
                break
            made.step, made.why = None, _JUDGED
        return made


def _tried(kind: Layout, found: Array, due: MomentBelief) -> bool:
    """Whether machine code and NumPy give the same belief, to 10⁻⁶ standard deviations.

    `found` (n + 1, n) is the result of machine code, the mean in its first row and the covariance
    below; `due` is the belief by NumPy. The first few steps of a `kind` are such trials, of which
    one is used up. If the two differ, steps of the kind are made by NumPy from now on.
    """
    std = np.sqrt(np.maximum(due.cov.diagonal(), 0.0))
    close = np.abs(found[0] - due.mean) <= _CLOSE * std + 1e-12 * np.abs(due.mean)
    alike = np.abs(found[1:] - due.cov) <= _CLOSE * np.outer(std, std)
    kind.trials -= 1
    if not (close.all() and alike.all()):
        kind.step, kind.why = None, _JUDGED
        return False
    return True


def _given(values: Values) -> tuple[list[Any], list[Array]] | None:
    """The variables of the values given, and their arrays; None where a value has another form.

    A value has to be an array (d,), or sightings without steps. Sightings have several arrays
    (M, d), the sensor's first, then those of the parents given with them; among the variables the
    mark `_SIGHTED` stands after the sensor.
    """
    if type(values) is not dict:
        return None
    names: list[Any] = []
    rows: list[Array | None] = []
    for variable, value in values.items():
        names.append(variable)
        if type(value) is not Sightings:
            rows.append(numbers(value, 1))
        elif value.step is None:
            names += [_SIGHTED, *value.given]
            rows += [numbers(each, 2) for each in (value.values, *value.given.values())]
        else:
            return None
    found = [row for row in rows if row is not None]
    return (names, found) if len(found) == len(rows) else None


def _entry(kernel: Any) -> Any:
    """A compiled kernel as a function that skips Numba's checks of its arguments' types.

    Calls are quicker, and arguments of other types than it was compiled for are not noticed.
    """
    (made,) = kernel.overloads.values()
    return made.entry_point
