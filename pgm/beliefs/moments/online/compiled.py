"""Online steps of one robot in machine code.

A step that the machine code cannot make is made by NumPy, in the filter's *general way*. Each kind
of step, by the variables that are given, has machine code of its own (`Kind`), which is made at the
first step of that kind. The first steps of a kind are made in both ways, and compared. *Sightings*
are the measurements of one sensor, of which a step may have several (`pgm.sightings`).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping
from functools import cached_property
from typing import Any

import numpy as np

from pgm.beliefs.moments.compiled.judged import judge
from pgm.beliefs.moments.online.associating import leaves_open
from pgm.beliefs.moments.online.beliefs import MomentBelief, is_plain, opened, put_behind, put_core
from pgm.beliefs.moments.online.kind import Kind, Made, Questions, marginal_of
from pgm.beliefs.moments.online.window import Passed, Sliding, Trail
from pgm.beliefs.moments.steps.plan import ChainPlan
from pgm.beliefs.moments.steps.readings import Moments
from pgm.compile import SliceLayout
from pgm.evidence import Sightings
from pgm.factors import Gaussian
from pgm.kernels.arrays import Array
from pgm.kernels.machine.sweeps import lost
from pgm.posteriors.status import Status
from pgm.schedules.late import NOTHING, Copied, Log
from pgm.schedules.step_evidence import MOST, Values, numbers
from pgm.variables import Variable

Make = Callable[[MomentBelief, Any], ChainPlan]
General = Callable[[MomentBelief, Any], MomentBelief]
# Of a kind of step: by variable the form of what is given.
Key = tuple[Any, ...]

_NOTHING: Values = {}
# Beliefs of both ways are the same to so many standard deviations.
_CLOSE = 1e-6
# Why a step is made the general way.
_OTHER = "the belief is of many runs, in twice the digits, has lost digits, or is of another filter"
_START = "an update at step 0"
_ODD = "values came in another form than numbers or sightings without steps"
_OPEN = "sightings without identity are associated by NumPy"
_WAITED = "machine code is made for longer work, or by compiled=True"
_JUDGED = "a function's trace, or machine code, answered otherwise than the function"
_FAR = "numbers are too far apart, or a reading is too sharp"


class _Passed(Passed):
    """A past transition that machine code has made, from one belief to the next."""

    def __init__(self, before: MomentBelief, after: MomentBelief) -> None:
        steps, records = after._steps, after._records
        assert steps is not None
        assert records is not None
        self._ends = records, steps, before._numbers, after._numbers

    @cached_property
    def _made(self) -> tuple[ChainPlan, Moments, Moments]:  # type: ignore[override]
        records, steps, *ends = self._ends
        plan = records.transition(np.frombuffer(ends[1], offset=steps.record.itemsize))
        before, after = (opened(steps, numbers) for numbers in ends)
        known, predicted = (Moments(each["mean"], each["cov"]) for each in (before, after))
        return plan, known, predicted


class _Given:
    """The values given to a step in machine code, which stand behind its numbers."""

    __slots__ = ("_parts",)

    def __init__(self, after: MomentBelief) -> None:
        self._parts = after._records, after._numbers, after._steps

    @property
    def opened(self) -> dict[Variable, Any]:
        """The values, as they were given."""
        records, numbers, steps = self._parts
        assert records is not None
        assert steps is not None
        return records.given(np.frombuffer(numbers, offset=steps.record.itemsize))

    def __reduce__(self) -> Any:
        return Copied, (self.opened,)


class _Bare:
    """A belief of machine code without its log: the parts of its core, and its trail."""

    __slots__ = ("_core", "_trail")

    def __init__(self, belief: MomentBelief, trail: Trail) -> None:
        core = belief._steps, belief._number, belief._numbers, belief._kind, belief._records
        self._core: Any = core
        self._trail = trail[:3]

    def restored(self, log: Log) -> MomentBelief:
        """The belief with a log of the steps behind it, from which the filter can go on."""
        found = object.__new__(MomentBelief)
        steps, number, numbers, kind, records = self._core
        behind = Trail(*self._trail, log)
        put_core(found, steps, number, numbers, kind, records, behind)
        return found

    def __reduce__(self) -> Any:
        return _bare, (self.restored(NOTHING).bare(),)


def _bare(belief: MomentBelief) -> MomentBelief:
    """A bare belief that came out of a pickle."""
    return belief


def _trail(before: MomentBelief, after: MomentBelief) -> None:
    """Put a prediction by machine code on the trail behind the belief after it, and in its log."""
    trail = after._behind
    assert trail is not None
    kept: Any = before.bare() if before._records is None else _Bare(before, trail)
    log = trail.log.on(kept, _Given(after), trail.lag)
    put_behind(after, trail.on(_Passed(before, after)).logged(log))


def _log(after: MomentBelief) -> None:
    """Put the readings of an update by machine code in the log behind the belief after it."""
    trail = after._behind
    assert trail is not None
    put_behind(after, trail.logged(trail.log.read(_Given(after))))


def _none(*given: object) -> Any:
    """The machine code of a step, or of marginals, as long as there is none."""
    return None


class CompiledSteps:
    """Machine code for the steps of an online filter of one run, without sliding windows.

    It is made from functions of the filter, each of a belief and the values given. `ahead` and
    `seen` make the plan of a prediction and of an update, which lays out the step's CPDs and
    evidence; `moved` and `taken` make these steps in the general way. `asks` are the filter's
    steps, of which beliefs ask what they have no numbers of. `done` is the status after predictions
    and updates by linear sensors, `linearised` after others. `asked` are the questions that steps
    answer beside those of beliefs. `left` counts the steps made in the general way, by
    reason: the belief is of many runs or of another filter, or float64 has too few digits for it; a
    value is neither an array of numbers nor sightings without steps; sightings are to be
    associated, which NumPy does before they are read; the update is at step 0; machine code cannot
    make steps of the kind, or its results, compared with NumPy's, were others; or numbers are too
    far apart. So many steps of a kind as `wait` are made in the general way before there is machine
    code.
    """

    def __init__(
        self,
        layout: SliceLayout,
        ahead: Make,
        seen: Make,
        moved: General,
        taken: General,
        asks: Any,
        done: Status,
        linearised: Status,
        asked: Questions,
        *,
        wait: int = 0,
    ) -> None:
        self.layout, self.asks, model = layout, asks, layout.model
        # With the first machine code of a step the marginal of a single variable gets its own.
        self.only: Variable | None = None
        self.marginal: Callable[[bytes], Gaussian] = _none
        own = layout.slice_size
        record: list[Any] = [("mean", float, own), ("cov", float, (own, own)), ("total", float)]
        record += [("watch", float, lost.SIZE)] if asked.watched else []
        self.record = np.dtype(record)
        self._ways = (seen, taken), (ahead, moved)
        self._statuses, self._asked = (linearised, done), asked
        self._reverses = asked.reverses
        # Machine code tells variables by their identity: those of the model itself.
        self._own = {variable: variable for variable in (*model.inputs, *model.sensors)}
        self._grouped = {cpd.child for cpd in model.observation if getattr(cpd, "grouped", False)}
        # Of the kinds of the last update and the last prediction, tried first; all kinds.
        self._last: list[Made] = [_none, _none]
        # The same, for the filter to ask first, where they do all that is to be done.
        self.quick: list[Made] = [_none, _none]
        self._known: dict[Key, Kind] = {}
        self._wait, self._waited = wait, Counter[Key]()
        # Why steps were made the general way, and how many of them.
        self.left: Counter[str] = Counter()

    def predict(self, belief: MomentBelief, inputs: Values | None = None) -> MomentBelief:
        """Predict one step in machine code if that can be, else in the general way."""
        after: MomentBelief | None = self._last[1](belief, inputs)
        if after is None:
            return self._any(belief, _NOTHING if inputs is None else inputs, moves=True)
        if self._reverses:
            _trail(belief, after)
        return after

    def update(self, belief: MomentBelief, readings: Values) -> MomentBelief:
        """Update in machine code if that can be, else in the general way."""
        after: MomentBelief | None = self._last[0](belief, readings)
        if after is None:
            return self._any(belief, readings, moves=False)
        if self._reverses:
            _log(after)
        self._tell(after)
        return after

    def adopted(self, belief: MomentBelief) -> MomentBelief:
        """The same belief, with a core, from which compiled steps can go on.

        It gets none if it has axes of runs, or float64 has too few digits for it.
        """
        if not belief.lead and belief.status.digits is None and is_plain(belief):
            parts = [belief.mean, belief.cov, belief.log_evidence]
            if belief.watch is not None:
                parts.append(belief.watch.numbers(belief.step))
            numbers = b"".join(part.tobytes() for part in parts)
            assert not isinstance(belief.behind, Sliding)
            put_core(belief, self, belief.step, numbers, belief.kind, None, belief.behind)
        return belief

    def _any(self, belief: MomentBelief, values: Values, *, moves: bool) -> MomentBelief:
        """A step with values of any kind: a prediction if it `moves`, else an update.

        The step's kind is looked up, or made. Its first few steps, its *trials*, are made in the
        general way, too; where the two beliefs differ, the one of the general way is returned.
        """
        own = type(belief) is MomentBelief and belief._steps is self
        general, given, why = self._ways[moves][1], None, _OTHER
        if own:
            why = _START
            if moves or belief._number:
                given, why = self._given(values), _ODD
                if given is None and isinstance(values, Mapping) and leaves_open(values):
                    why = _OPEN
        if given:
            kind = self._kind(belief, *given, moves=moves)
            why = _WAITED if kind is None else kind.why
            if kind is not None and kind.step is not None:
                after: MomentBelief | None = kind.step(belief, given[1])
                why = _FAR
                if after is not None:
                    if self._reverses:
                        if moves:
                            _trail(belief, after)
                        else:
                            _log(after)
                    if not kind.trials:
                        self._last[moves] = kind.step
                        if not (self._reverses or (not moves and kind.records.warns)):
                            self.quick[moves] = kind.step
                        self._tell(after)
                        return after
                    due = general(belief, values)
                    if _tried(kind, opened(self, after._numbers), due):
                        return after
                    self.left[_JUDGED] += 1
                    return self.adopted(due)
        self.left[why] += 1
        return self.adopted(general(belief, values))

    def _kind(self, belief: MomentBelief, key: Key, values: Values, *, moves: bool) -> Kind | None:
        """The kind of a step, looked up or made; None as long as it waits."""
        key = moves, *key
        kind = self._known.get(key)
        if kind is None:
            if len(self._known) + len(self._waited) >= 2 * MOST:
                self._known.clear()
                self._waited.clear()
            if self._waited[key] < self._wait:
                self._waited[key] += 1
                return None
            kind = self._known[key] = self._made(self._ways[moves][0], belief, values)
        return kind

    @np.errstate(over="ignore", invalid="ignore", divide="ignore")
    def _made(self, make: Make, belief: MomentBelief, values: Values) -> Kind:
        """A kind of step, without machine code where that cannot make it.

        `make` makes the plan of the step. A *trace* is a function recorded as a graph of scalar
        operations. Traces are compared with their functions at the belief, and made anew, once, if
        one is wrong.
        """
        for _ in range(2):  # a trace that is wrong is made anew
            plan = make(belief, values)
            own = MomentBelief, self
            made = Kind(plan, values, self._statuses[plan.linear], self._asked, own)
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
        if made.step is not None and self.only is None and len(self.layout.slice) == 1:
            (variable,) = self.layout.slice
            self.marginal = marginal_of(variable)
            self.only = variable
        return made

    def _tell(self, after: MomentBelief) -> None:
        """Warn, if the step to a belief of machine code has not settled."""
        assert after._records is not None
        after._records.tell(after._numbers, self.record.itemsize)

    def _given(self, values: Values) -> tuple[Key, Values] | None:
        """The kind of the values given, and the values as its machine code takes them.

        A value has to be an array (d,), or sightings without steps: the sensor's array (M, d), and
        those of the parents given with them. None where one has another form.
        """
        if not isinstance(values, dict):
            return None
        key: list[Any] = []
        found: dict[Variable, Any] = {}
        for variable, value in self._named(values).items():
            if type(value) is not Sightings:
                row = _floats(value, 1)
                if row is None:
                    return None
                found[variable] = row
                key += variable, row.shape
                continue
            parts = {None: value.values, **self._named(value.given)}
            rows = {v: row for v, part in parts.items() if (row := _floats(part, 2)) is not None}
            if len(rows) < len(parts) or value.step is not None:
                return None
            first = rows.pop(None)
            found[variable] = Sightings(first, None, rows)
            key += variable, first.shape[1], len(first) == 1 and variable in self._grouped
            key += [(parent, each.shape[1]) for parent, each in rows.items()]
        return tuple(key), found

    def _named(self, values: Values) -> dict[Any, Any]:
        """The same values by the model's own variables."""
        return {self._own.get(variable, variable): value for variable, value in values.items()}


def _floats(value: Any, axes: int) -> Array | None:
    """A value as an array of floats that lie next to each other; None where it cannot be one."""
    found = numbers(value, axes)
    return None if found is None or not found.size else np.ascontiguousarray(found)


def _tried(kind: Kind, found: Any, due: MomentBelief) -> bool:
    """Whether machine code and NumPy give the same belief, to 10⁻⁶ standard deviations.

    `found` are the numbers of machine code, `due` is the belief by NumPy. The first few steps of a
    `kind` are such trials, of which one is used up. If the two differ, steps of the kind are made
    by NumPy from now on.
    """
    std = np.sqrt(np.maximum(due.cov.diagonal(), 0.0))
    close = np.abs(found["mean"] - due.mean) <= _CLOSE * std + 1e-12 * np.abs(due.mean)
    alike = np.abs(found["cov"] - due.cov) <= _CLOSE * np.outer(std, std)
    kind.trials -= 1
    if not (close.all() and alike.all()):
        kind.step, kind.why = None, _JUDGED
        return False
    return True
