"""A user's function, called once with traced arrays, and compared with its trace."""

from __future__ import annotations

import linecache
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from pgm.kernels.angles import difference
from pgm.kernels.arrays import Array, Mask, components_last
from pgm.tracing.program import Program
from pgm.tracing.surroundings import Surroundings
from pgm.tracing.traced import STAND_INS, Node, Recorder, Traced, Untraceable, bare, traced_elements

LIMIT = 2000  # operations


def trace(
    function: Callable[..., Any], widths: Sequence[int], due: tuple[int, ...]
) -> Program | str:
    """The program of a function with a value of a shape that is due, or a reason for none."""
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
    return Program(graph.copy(), tuple(widths), outputs)


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
    """Where in a user's code an error was raised."""
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


class Tracer:
    """A function and its trace, which is made when it is first asked for.

    It is used once it has been compared with the function, and as long as it equals it.

    Parameters
    ----------
    function : callable
    widths : sequence of int
        Components of each argument.
    angles : ndarray
        Which components of the value are angles, (d,).
    """

    def __init__(self, function: Callable[..., Any], widths: Sequence[int], angles: Mask) -> None:
        self.function, self.widths, self.angles = function, tuple(widths), angles
        self.reason: str | None = None
        self.trace: Program | None = None
        # Shapes of batches at which it has been compared since the last plan was made.
        self.compared: set[tuple[int, ...]] = set()
        self.surroundings: Surroundings | None = None
        # Values, and points about them.
        self._drawn: tuple[list[bytes], list[Array]] | None = None

    def confirm(self, centres: Sequence[Array]) -> bool:
        """Whether there is a trace that equals the function about some values (width,).

        A function that may have changed, with its closure, is traced again: no point shows all of
        a change, such as that of a limit between them.
        """
        if self.reason is not None:
            return False
        self.compared, settled, held = set(), self.settled(), self.surroundings
        if held is None or (held.known and not settled):
            held = Surroundings(self.function)
        places = [centre.tobytes() for centre in centres]
        if self._drawn is None or self._drawn[0] != places:
            self._drawn = places, around(centres)
            for point in self._drawn[1]:
                point[-1, -1] = np.nan  # by which a function shows what it does about such
        elif settled:
            return True
        found: Program | str | None = self.trace
        if found is None or not settled:
            found = trace(self.function, self.widths, (self.angles.size,))
            if repr(found) == repr(self.trace):
                found = self.trace  # what was made of it is still good
        if isinstance(found, Program) and self._equal(found, self._drawn[1]):
            # Last, since other threads trust a trace by it.
            self.trace, self.surroundings = found, held
            return True
        self.trace, self.reason = None, found if isinstance(found, str) else _DIFFERS
        return False

    def traced(self) -> Program | str:
        """The trace, confirmed about zero, or the reason for none."""
        self.confirm([np.zeros(width) for width in self.widths])
        return self.trace or str(self.reason)

    def settled(self) -> bool:
        """Whether nothing that the function refers to can have changed since `confirm`."""
        return self.surroundings is not None and self.surroundings.same()

    def __getstate__(self) -> dict[str, Any]:
        return self.__dict__ | {"surroundings": None, "_drawn": None}

    def _equal(self, found: Program, points: list[Array]) -> bool:
        with np.errstate(all="ignore"):
            try:
                due = np.asarray(self.function(*[point.copy() for point in points]), dtype=float)
            except Exception:
                return False
            value = components_last(found.batch(points, _SPREAD.shape)[0], 1)
            if due.shape != value.shape or (np.isfinite(due) != np.isfinite(value)).any():
                return False
            known = np.isfinite(due)
            error = np.abs(difference(due, value, self.angles))
            scale = np.where(known, np.abs(due), 0.0).max(axis=(0, 1))
            return bool((error <= _EQUAL * scale)[known].all())


def around(centres: Sequence[Array], least: float = 0.0) -> list[Array]:
    """Points (2, 3, width) about centres (width,), one of them there, or nearly."""
    rng = np.random.default_rng(5)
    spread = np.maximum(_SPREAD, least)[..., None]
    return [
        centre + spread * (1.0 + np.abs(centre)) * rng.normal(size=(2, 3, centre.size))
        for centre in centres
    ]
