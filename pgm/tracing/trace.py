"""A user's function, called once with traced arrays, and compared with its trace."""

from __future__ import annotations

import linecache
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from pgm.kernels.angles import difference
from pgm.kernels.arrays import Array, Mask, components_last
from pgm.tracing.program import Program
from pgm.tracing.reads import Reads, reads_of
from pgm.tracing.slopes import Slopes
from pgm.tracing.traced import STAND_INS, Node, Recorder, Traced, Untraceable, bare, traced_elements

LIMIT = 2000  # operations


def trace(
    function: Callable[..., Any], widths: Sequence[int], due: tuple[int, ...]
) -> Program | str:
    """The program traced from a function with a value of a given shape, or why there is none."""
    try:
        made = [_recorded(function, widths, due, 0)]
        if made[0][0].cast:
            made += [_recorded(function, widths, due, kind) for kind in range(1, len(STAND_INS))]
    except Untraceable as reason:
        return str(reason)
    if len({repr(each) for each in made}) > 1:
        return (
            "it computes with float(), math, or arrays of floats that values were written in "
            "(np.zeros, np.asarray(x, dtype=float)); np.stack and np.zeros_like are traced"
        )
    graph, outputs = made[0]
    return Program(graph.copy(), tuple(widths), outputs, cast=graph.cast)


def _recorded(
    function: Callable[..., Any], widths: Sequence[int], due: tuple[int, ...], kind: int
) -> tuple[Recorder, tuple[int, ...]]:
    graph = Recorder(LIMIT, kind)
    arguments = []
    for k, width in enumerate(widths):
        inputs = np.array([Node(graph, graph.input(k, i)) for i in range(width)], dtype=object)
        inputs.flags.writeable = False
        arguments.append(inputs.view(Traced))
    try:
        value = function(*arguments)
    except Exception as error:
        fails = f"it fails on traced numbers: {type(error).__name__}: {error}"
        found = error if isinstance(error, Untraceable) else fails
        raise Untraceable(f"{graph.refusal or found}{_line(error)}") from None
    if graph.refusal is not None:
        raise Untraceable(graph.refusal)
    try:
        array = bare(value)
        if array.shape != due:
            raise Untraceable(f"it returns shape {array.shape} of traced numbers, {due} was due")
        outputs = tuple(node.number for node in traced_elements(graph, array).flat)
    except (TypeError, ValueError) as error:
        raise Untraceable(f"it returns {type(value).__name__}: {error}") from None
    return graph, outputs


def _line(error: BaseException) -> str:
    """The line of the user's code that raised an error."""
    place, step = "", error.__traceback__
    while step is not None:
        code = step.tb_frame.f_code
        if not step.tb_frame.f_globals.get("__name__", "").startswith(("pgm.", "numpy.")):
            text = linecache.getline(code.co_filename, step.tb_lineno).strip()
            place = f" (in {code.co_name}: {text})" if text else f" (in {code.co_name})"
        step = step.tb_next
    return place


_DIFFERS = (
    "its values are not those of its trace, at drawn points: it has a memory, draws at random, or "
    "computes outside NumPy"
)
# What the points of a comparison are from its centre, as shares of 1 + |centre|.
_SPREAD = np.array([[0.0, 0.01, 1.0], [1.0, 10.0, 100.0]])
_EQUAL = 1e-12
# By how much of themselves points are moved to see how much the last digits count.
_BESIDE = 2.0**-46
# A trace that fails for the n-th time in a row is left out of 2^n − 1 calls, at most so.
_MOST_FAILURES = 6
# A trace has been right often after so many calls.
_OFTEN = 5


class Tracer:
    """A function and its trace, which is made when a call first asks for it.

    It is compared with the function at some drawn points, and then used as long as no call that
    used it finds it wrong (`pgm.tracing.judging`). One that is wrong though it was just made is
    given up for some calls, twice as many each time: the function may have been disturbed once, by
    another thread or a reading of the clock, or may draw at random.

    Parameters
    ----------
    function : callable
    widths : sequence of int
        Components of each argument.
    angles : ndarray
        Which components of the value are angles, (d,).

    Attributes
    ----------
    trace : Program or None
    reason : str or None
        The reason why there is no trace, or the last call did without.
    """

    def __init__(self, function: Callable[..., Any], widths: Sequence[int], angles: Mask) -> None:
        self.function, self.widths, self.angles = function, tuple(widths), angles
        self.trace: Program | None = None
        self.reason: str | None = None
        # Whether a call has found it right; how often it failed since, and calls to leave out.
        self._proven, self._failures, self._waits = False, 0, 0
        self._stale, self._calls = False, 0
        # By what they are derivatives of: draws are judged by values alone, inference by slopes.
        self._slopes: dict[tuple[Any, ...], Slopes] = {}
        # What the function read when it was traced, if a call has asked for that.
        self._reads: Reads | None = None

    def confirm(self, centres: Sequence[Array], *, anew: bool = False) -> bool:
        """Whether there is a trace. A new one must equal its function about some values (width,).

        Where the trace is judged at a few points alone, it is to be as if it were made `anew`: it
        is, unless all that the function reads is surely as it was.
        """
        if self._waits:
            self._waits -= 1
            return False
        if self.trace is not None and not self._stale and (not anew or self._is_fresh):
            return True
        self._stale, self._reads = False, reads_of(self.function) if anew else None
        found = trace(self.function, self.widths, (self.angles.size,))
        if not isinstance(found, Program):
            self._fail(found)
            return False
        if not self._equal(found, centres):
            self._fail(_DIFFERS)
            return False
        if repr(found) != repr(self.trace):  # else what was made of it is still good
            self.trace, self._proven, self._calls = found, False, 0
        return True

    @property
    def _is_fresh(self) -> bool:
        """Whether the function would give the same trace again, so far as is known."""
        return self._reads is not None and self._reads.stand()

    def stands(self, trace: Program) -> bool:
        """Whether a call would use this trace, and calls have often found it right."""
        return self.trace is trace and self.often and not (self._stale or self._waits)

    def renew(self) -> None:
        """Have the function traced anew at its next use."""
        self._stale, self._waits = True, 0

    def prove(self, proven: Program) -> None:
        """Take a trace for right, since a call has found it so."""
        if self.trace is proven:
            self._proven, self._failures, self.reason = True, 0, None
            self._calls += 1

    def doubt(self, doubted: Program, reason: str, *, moved: bool) -> None:
        """Give up a wrong trace; if the function's values have changed, trace it once more.

        It was right before then, so that its function may have changed.
        """
        if self.trace is doubted:
            if self._proven and moved:
                self.trace = None
            else:
                self._fail(reason)

    @property
    def state(self) -> dict[str, Any]:
        """The trace and the record of how it fared, for `put_back`."""
        return dict(vars(self))

    def put_back(self, state: dict[str, Any]) -> None:
        """Restore a trace and the record of how it fared."""
        vars(self).update(state)

    @property
    def often(self) -> bool:
        """Whether calls have found the trace right so often that there may be many more."""
        return self._calls >= _OFTEN

    def slopes(self, program: Program, variances: tuple[float, ...]) -> Slopes:
        """The derivatives of a program of the trace, with the least variances of noise, (d,)."""
        key = program.columns, variances
        found = self._slopes.get(key)
        if found is None or found.program is not program:
            noise = np.sqrt(variances)
            found = Slopes(self.function, program, self.angles[: len(noise)], noise)
            self._slopes[key] = found
        return found

    def traced(self) -> Program | str:
        """The trace as the function is now, or the reason for none."""
        if self.reason is None:
            self.confirm([np.zeros(width) for width in self.widths], anew=True)
        return str(self.reason) if self.trace is None else self.trace

    def __getstate__(self) -> dict[str, Any]:
        return self.__dict__ | {"_proven": False, "_calls": 0, "_slopes": {}, "_reads": None}

    def _fail(self, reason: str) -> None:
        self.trace, self.reason, self._proven, self._reads = None, reason, False, None
        self._failures = min(self._failures + 1, _MOST_FAILURES)
        self._waits = 2**self._failures - 1

    def _equal(self, found: Program, centres: Sequence[Array]) -> bool:
        points = around(centres)
        for point in points:
            point[-1, -1] = np.nan  # by which a function shows what it does about such
        with np.errstate(all="ignore"):
            try:
                due = np.asarray(self.function(*[point.copy() for point in points]), dtype=float)
            except Exception:
                return False
            value, beside = (
                components_last(found.batch(each, _SPREAD.shape)[0], 1)
                for each in (points, [point * (1.0 + _BESIDE) for point in points])
            )
            if due.shape != value.shape or (np.isfinite(due) != np.isfinite(value)).any():
                return False
            known = np.isfinite(due)
            error = np.abs(difference(due, value, self.angles))
            scale = np.where(known, np.abs(due), 0.0).max(axis=(0, 1))
            # Far from the centre the last digits of what a sine is taken of may be its first.
            loose = np.nan_to_num(np.abs(difference(beside, value, self.angles)), posinf=0.0)
            return bool((error <= _EQUAL * scale + loose)[known].all())


def around(centres: Sequence[Array], least: float = 0.0) -> list[Array]:
    """Points (2, 3, width) around centres (width,); one of them stands at the centre, or nearly."""
    rng = np.random.default_rng(5)
    spread = np.maximum(_SPREAD, least)[..., None]
    return [
        centre + spread * (1.0 + np.abs(centre)) * rng.normal(size=(2, 3, centre.size))
        for centre in centres
    ]
