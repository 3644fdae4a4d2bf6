"""A user's function, called once with traced arrays."""

from __future__ import annotations

import linecache
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from pgm.tracing.graph import Graph
from pgm.tracing.traced import KINDS, Node, Recorder, Traced, Untraceable, bare, traced_elements

LIMIT = 2000  # operations


@dataclass(frozen=True, eq=False)
class Trace:
    """A function as scalar operations.

    Attributes
    ----------
    graph : Graph
    outputs : tuple of int
        The operations that are its value, row by row.
    widths : tuple of int
        Components of each argument.
    """

    graph: Graph
    outputs: tuple[int, ...]
    widths: tuple[int, ...]


def trace(
    function: Callable[..., Any], widths: Sequence[int], due: tuple[int, ...]
) -> Trace | str:
    """The trace of a function with a value of a shape that is due, or a reason for none."""
    try:
        made = [_recorded(function, widths, due, 0)]
        if made[0][0].cast:
            made += [_recorded(function, widths, due, kind) for kind in range(1, KINDS)]
    except Untraceable as reason:
        return str(reason)
    (graph, outputs), *others = made
    for again, found in others:
        if again.operations != graph.operations and repr(again.operations) != repr(graph.operations) or found != outputs:
            return (
                "it computes with float(), math, or arrays of floats that values were written in "
                "(np.zeros, np.asarray(x, dtype=float)); np.stack and np.zeros_like are traced"
            )
    return Trace(graph, outputs, tuple(widths))


def _recorded(
    function: Callable[..., Any], widths: Sequence[int], due: tuple[int, ...], kind: int
) -> tuple[Recorder, tuple[int, ...]]:
    graph = Recorder(LIMIT, kind)
    arguments = []
    for k, width in enumerate(widths):
        argument = np.empty(width, dtype=object)
        for i in range(width):
            argument[i] = Node(graph, graph.input(k, i))
        view = argument.view(Traced)
        view.flags.writeable = False
        arguments.append(view)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            value = function(*arguments)
    except Untraceable as reason:
        raise Untraceable(f"{graph.refusal or reason}{_line(reason)}") from None
    except Exception as error:
        reason = graph.refusal or f"it fails on traced numbers: {type(error).__name__}: {error}"
        raise Untraceable(f"{reason}{_line(error)}") from None
    if graph.refusal is not None:
        raise Untraceable(graph.refusal)
    try:
        found = bare(value)
        if found.shape != due:
            raise Untraceable(f"it returns shape {found.shape} of traced numbers, {due} was due")
        outputs = tuple(node.number for node in traced_elements(graph, found).flat)
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
