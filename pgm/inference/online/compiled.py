"""Steps of one robot in machine code, where they are plain; all others go the general way."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from pgm.compile import SliceLayout
from pgm.evidence import Sightings
from pgm.inference.chain.compiled.table import Integers64, Uncompiled
from pgm.inference.chain.plan import ChainPlan
from pgm.inference.online.beliefs import OnlineBelief, is_plain, put_core
from pgm.inference.online.layout import Layout, Shapes
from pgm.inference.online.step_evidence import numbers
from pgm.inference.status import FILTERED, PREDICTED, Status
from pgm.kernels.arrays import Array
from pgm.variables import Variable

Values = Mapping[Variable, Any]
Make = Callable[[OnlineBelief, Any], ChainPlan]
General = Callable[[OnlineBelief, Any], OnlineBelief]

_ARRAY, _FLOAT = np.ndarray, np.dtype(np.float64)
_NO_ROWS = np.empty((0, 0))
# After the name of a sensor with sightings, before those of the parents given with them.
_SIGHTED = object()
# Kinds of input that are kept.
_MOST = 64
_new, _empty = object.__new__, np.empty


@dataclass(frozen=True, slots=True)
class Kind:
    """A kind of input, and the step laid out for it: none where it is not for a kernel.

    `first` and `second` are the variables whose arrays a kernel takes as they come: an input alone,
    or a sensor and the parent given with its sightings. `status` is that of a belief after it.
    """

    step: Integers64 | None
    status: Status
    first: Variable | None = None
    second: Variable | None = None
    kept: object = None


class CompiledSteps:
    """The steps of a filter without gates or windows, of one run, in machine code.

    All that is not plain goes the general way, by `moved` and `taken`: beliefs of many runs, in
    twice the digits, or of another filter; odd values; numbers that are not moderate. `ahead` and
    `seen` make plans of predictions and updates; `done` and `linearised` are the statuses after
    them.
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
        self._motion = self._sensors = Kind(None, done)
        self._known: dict[Any, Kind] = {}

    def predict(self, belief: OnlineBelief, inputs: Values | None = None) -> OnlineBelief:
        """As `OnlineFilter.predict`."""
        core = belief._core if type(belief) is OnlineBelief else None
        if core is not None and core[0] is self and type(inputs) is dict and len(inputs) == 1:
            kind = self._motion
            ((variable, row),) = inputs.items()
            if (
                variable is kind.first
                and type(row) is _ARRAY
                and row.dtype is _FLOAT
                and row.ndim == 1
            ):
                _, step, known, log_evidence, _, _ = core
                found = _empty(self._shape)
                if self._predict(kind.step, known, found, row) == 0.0:
                    after: OnlineBelief = _new(OnlineBelief)
                    put_core(after, (self, step + 1, found, log_evidence, PREDICTED, kind.status))
                    return after
        return self._step(belief, {} if inputs is None else inputs, moves=True)

    def update(self, belief: OnlineBelief, readings: Values) -> OnlineBelief:
        """As `OnlineFilter.update`."""
        core = belief._core if type(belief) is OnlineBelief else None
        if core is not None and core[0] is self and type(readings) is dict and len(readings) == 1:
            kind, (_, step, known, log_evidence, _, _) = self._sensors, core
            ((variable, seen),) = readings.items()
            if step and variable is kind.first and type(seen) is Sightings and seen.step is None:
                first, given = seen.values, seen.given
                if len(given) == 1:
                    ((parent, second),) = given.items()
                    if (
                        parent is kind.second
                        and type(first) is _ARRAY
                        and first.dtype is _FLOAT
                        and first.ndim == 2
                        and type(second) is _ARRAY
                        and second.dtype is _FLOAT
                        and second.ndim == 2
                    ):
                        found = _empty(self._shape)
                        density = self._update(kind.step, known, found, first, second)
                        if density == density:
                            after: OnlineBelief = _new(OnlineBelief)
                            total = log_evidence + density
                            put_core(after, (self, step, found, total, FILTERED, kind.status))
                            return after
        return self._step(belief, readings, moves=False)

    def adopted(self, belief: OnlineBelief) -> OnlineBelief:
        """A belief made the general way, from which steps may go on here."""
        if not belief.lead and is_plain(belief):
            both = np.vstack([belief.mean, belief.cov])
            told = belief.log_evidence.item(), belief.kind, belief.status
            put_core(belief, (self, belief.step, both, *told))
        return belief

    def _step(self, belief: OnlineBelief, values: Values, *, moves: bool) -> OnlineBelief:
        """A step of any kind of input."""
        core = belief._core if type(belief) is OnlineBelief else None
        make, general, kernel = self._ways[moves]
        laid = None
        if core is not None and core[0] is self and (moves or core[1]):
            laid = self._laid(belief, values, make)
        if core is not None and laid is not None:
            kind, rows = laid
            if moves:
                self._motion = kind
            else:
                self._sensors = kind
                rows = [row if row.ndim == 2 else row[None] for row in (*rows, _NO_ROWS)][:2]
            _, step, known, log_evidence, _, _ = core
            found = _empty(self._shape)
            density = kernel(kind.step, known, found, *rows)
            if density == density:
                after: OnlineBelief = _new(OnlineBelief)
                told = log_evidence + density, PREDICTED if moves else FILTERED, kind.status
                put_core(after, (self, step + moves, found, *told))
                return after
        return self.adopted(general(belief, values))

    def _laid(
        self, belief: OnlineBelief, values: Values, make: Make
    ) -> tuple[Kind, list[Array]] | None:
        """The kind of values, and their arrays, or one with all of them if there are more."""
        if type(values) is not dict:
            return None
        names: list[Any] = []
        rows: list[Array] = []
        for variable, value in values.items():
            names.append(variable)
            given: list[tuple[Any, int]] = [(value, 1)]
            if type(value) is Sightings:
                if value.step is not None:
                    return None
                names += [_SIGHTED, *value.given]
                given = [(each, 2) for each in (value.values, *value.given.values())]
            for each, axes in given:
                row = numbers(each, axes)
                if row is None:
                    return None
                rows.append(row)
        shapes = tuple(row.shape for row in rows)
        key = make, tuple(names), shapes
        kind = self._known.get(key)
        if kind is None:
            if len(self._known) >= _MOST:
                self._known.clear()
            kind = self._known[key] = self._made(make, belief, values, names, shapes)
        if kind.step is None:
            return None
        return kind, rows if kind.first else [np.concatenate([_NO_ROWS, *rows], axis=None)]

    @np.errstate(over="ignore", invalid="ignore", divide="ignore")
    def _made(
        self, make: Make, belief: OnlineBelief, values: Values, names: list[Any], shapes: Shapes
    ) -> Kind:
        plan = make(belief, values)
        as_given = len(names) == 1 if not plan.sensors else len(names) == 3 and names[1] is _SIGHTED
        status = self._statuses[plan.linear]
        try:
            layout = Layout(plan, values, shapes, packed=not as_given)
        except Uncompiled:
            return Kind(None, status, kept=names)
        first, second = (names[0], names[-1]) if as_given else (None, None)
        return Kind(layout.step, status, first, second, (names, layout))


def _entry(kernel: Any) -> Any:
    """The compiled function itself: without Numba's look at the types of arguments, so as given."""
    (made,) = kernel.overloads.values()
    return made.entry_point
