"""The page of a chain, or of beliefs over time: the network, and the numbers of its slices."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from pgm.cpds import CPD
from pgm.kernels.arrays import Array
from pgm.posteriors.outcome import Outcome
from pgm.posteriors.shown_slices import Room, ShownSlices, Sighted
from pgm.variables import Variable
from pgm.viewer.numbers import (
    EXACT,
    SHOWN,
    Limits,
    Numbers,
    Ref,
    Run,
    cpd,
    lower,
    number,
    variable,
    went,
)
from pgm.viewer.truth import at_steps

# The arrays that a path is drawn of, or the probabilities of states over time.
_PATH = ("mean", "cov", "there.mean", "draws", "belief")


def page(
    outcome: Outcome[Any],
    numbers: Numbers,
    runs: list[Run],
    span: range,
    limits: Limits,
    truth: Mapping[Variable, Array],
    changes: Mapping[Variable, Array],
) -> dict[str, Any]:
    """The structure of the page, its numbers added.

    Of `truth` as `truths` makes it, and of changes by evidence as `moved_by_step` does.
    """
    graph, log_evidence = outcome.graph, np.asarray(outcome.log_evidence)
    model, states = graph.model, graph.layout.states
    shown = outcome.slices(span, Room(limits.numbers, limits.entries))
    rows = []
    held = range(shown.first, span[-1] + 1)
    for run in runs:
        place = int(np.ravel_multi_index(run, log_evidence.shape)) if run else 0
        arrays = {
            name: _added(numbers, shown, name, array)
            for name, array in shown.arrays(run).items()
            if limits.factors or name in _PATH
        }
        rows.append(
            {
                "run": list(run),
                "log_evidence": number(float(log_evidence[run])),
                "went": None if outcome.status._phrases else went(outcome.status, place),
                "arrays": arrays,
                "truth": {
                    v.name: numbers.add(at_steps(values[run], held, graph.steps), SHOWN)
                    for v, values in truth.items()
                },
                "moved": {
                    v.name: numbers.add(at_steps(each[run][:, None], held, graph.steps), SHOWN)
                    for v, each in changes.items()
                },
                "sensors": [
                    found
                    for sensor, sighted in shown.sensors.items()
                    if (found := _sighted(numbers, sensor, sighted, span, place))
                ],
            }
        )
    return {
        "kind": "chain",
        "about": str(outcome.kind),
        "steps": {"first": span[0], "last": span[-1], "end": graph.steps, "base": shown.first},
        "variables": [variable(v) | {"state": v in states} for v in shown.hidden],
        "discrete": [variable(v) for v in shown.discrete],
        "prior": [cpd(each) for each in model.prior],
        "transition": [cpd(each) for each in model.transition],
        "inputs": [v.name for v in model.inputs],
        "family": shown.reading,
        "words": shown.words,
        "runs": rows,
    }


def _added(numbers: Numbers, shown: ShownSlices, name: str, array: Array) -> Ref:
    """The place of an array among the page's numbers, of symmetric matrices the lower half."""
    symmetric = name.rpartition(".")[2] in ("cov", "K")
    return numbers.add(lower(array) if symmetric else array, EXACT if shown.exact(name) else SHOWN)


def _sighted(
    numbers: Numbers, sensor: CPD, sighted: Sighted, span: range, run: int
) -> dict[str, Any] | None:
    """The measurements of a sensor at the steps shown, in one run; None if there are none."""
    first, last = np.searchsorted(sighted.step, [span[0], span[-1] + 1])
    if first == last:
        return None

    def own(rows: Array) -> Array:
        """The rows of this run and these steps."""
        return rows[first:last, run if rows.shape[1] > 1 else 0].astype(np.float64)

    return {
        "cpd": cpd(sensor),
        "child": variable(sensor.child),
        "step": numbers.add(sighted.step[first:last, None].astype(np.float64)),
        "values": numbers.add(own(sighted.values)),
        "given": [
            {"components": list(v.components), "values": numbers.add(own(rows))}
            for v, rows in sighted.inputs.items()
            if v.dimension > 1
        ],
    }
