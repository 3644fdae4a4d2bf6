"""The page of a Gaussian chain, in batched calls, and the parts that the page of any chain has."""

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from pgm.beliefs.moments.outcomes.outcome import ChainOutcome
from pgm.beliefs.moments.passes.backward import Beliefs, Reverse, pairs
from pgm.beliefs.moments.passes.forward import Filtered, Forward
from pgm.beliefs.moments.passes.messages import first_potential
from pgm.compile import DynamicGraph
from pgm.errors import NumericalError
from pgm.evidence import Reading
from pgm.kernels.arrays import Array, Integers, block, cut, quiet
from pgm.kernels.canonical import Canonical
from pgm.kernels.moments import Conditional
from pgm.posteriors.belief_kind import FILTERED, SMOOTHED, Kind
from pgm.variables import Variable
from pgm.viewer.numbers import (
    EXACT,
    SHOWN,
    Limits,
    Numbers,
    Run,
    cpd,
    lower,
    number,
    variable,
    went,
)


def head(
    graph: DynamicGraph, kind: Kind, span: range, hidden: Iterable[Variable]
) -> dict[str, Any]:
    """The chain itself for the page: steps, variables and CPDs, without a belief."""
    model, states = graph.model, graph.layout.states
    return {
        "kind": "chain",
        "about": str(kind),
        "steps": {"first": span[0], "last": span[-1], "end": graph.steps},
        "variables": [variable(v) | {"state": v in states} for v in hidden],
        "prior": [cpd(each) for each in model.prior],
        "transition": [cpd(each) for each in model.transition],
        "inputs": [v.name for v in model.inputs],
    }


def sighted(
    numbers: Numbers,
    sensors: Mapping[Any, tuple[Integers, Array, Mapping[Variable, Array]]],
    span: range,
    run: int,
) -> list[dict[str, Any]]:
    """The measurements of the steps shown in one run, by sensor.

    sensors: The step of each measurement, (M,) ascending, its values, (M, runs or 1, d), and those
        of its observed parents.
    """
    found = []
    for sensor, (step, values, inputs) in sensors.items():
        first, last = np.searchsorted(step, [span[0], span[-1] + 1])
        if first == last:
            continue

        def own(rows: Array) -> Array:
            """The rows of this run and these steps."""
            return rows[first:last, run if rows.shape[1] > 1 else 0].astype(np.float64)  # noqa: B023 - called at once

        found.append(
            {
                "cpd": cpd(sensor),
                "child": variable(sensor.child),
                "step": numbers.add(step[first:last, None].astype(np.float64)),
                "values": numbers.add(own(values)),
                "given": [
                    {"components": list(v.components), "values": numbers.add(own(rows))}
                    for v, rows in inputs.items()
                    if v.dimension > 1
                ],
            }
        )
    return found


def readings(
    given: Iterable[Reading],
) -> dict[Any, tuple[Integers, Array, Mapping[Variable, Array]]]:
    """The measurements of sensors as evidence holds them; missing components are NaN."""
    found = {}
    for each in given:
        values = each.values.astype(np.float64)
        if each.taken.shape[-1] == values.shape[-1]:
            values = np.where(each.taken, values, np.nan)
        found[each.cpd] = each.step, values, each.inputs
    return found


# Entries of matrices of all runs together, up to which messages back and potentials are made.
_MOST = 20_000_000


@quiet()
def page(
    posterior: ChainOutcome, numbers: Numbers, runs: list[Run], span: range, limits: Limits
) -> dict[str, Any]:
    """The structure of the page, its numbers added."""
    layout, plan = posterior.graph.layout, posterior._planned
    found = head(posterior.graph, posterior.kind, span, layout.slice)
    words = {"singular": "no canonical form: singular"}
    if posterior.kind != SMOOTHED:
        words["back"] = f"not sent: the posterior is {posterior.kind}; smoothing sends it"
    size = layout.state_size + layout.slice_size
    fits = plan.runs * (posterior.graph.steps + 1) * size * size <= _MOST
    if not fits:
        words["large"] = "left out: the batch is too large; keep fewer runs to see it"
    # A cluster holds the states before its step.
    held = np.arange(max(span[0] - 1, 0), span[-1] + 1)
    found["steps"]["base"] = int(held[0])
    sensors = {
        s.family.cpd: (
            s.family.step,
            s.values if s.taken is None else np.where(s.taken, s.values, np.nan),
            s.family.inputs,
        )
        for s in plan.sensors
    }
    rows = []
    for run in runs:
        place = int(np.ravel_multi_index(run, plan.lead)) if run else 0
        arrays = _moments(posterior, posterior._forward if fits else posterior._swept, held, place)
        if fits:
            arrays |= _pairs(posterior, held, place)
        refs = {name: numbers.add(array) for name, array in arrays.items()}
        if fits:
            refs |= _information(posterior, numbers, held, place)
        rows.append(
            {
                "run": list(run),
                "log_evidence": number(float(posterior._swept.log_density[:, place].sum())),
                "went": went(posterior.status, place),
                "arrays": refs,
                "sensors": sighted(numbers, sensors, span, place),
            }
        )
    return found | {"family": "gaussian", "words": words, "runs": rows}


def _moments(
    posterior: ChainOutcome, forward: Forward | Filtered, rows: Integers, place: int
) -> dict[str, Array]:
    """Beliefs and forward messages of a run at some steps, a row a step.

    From the moments the page makes canonical forms, with the log-evidence that each knows.
    """
    beliefs, windows = posterior._beliefs, posterior._windows
    states, steps = posterior.graph.layout.state_places, posterior.graph.steps
    passed = np.cumsum(forward.log_density[:, place])
    known = passed if windows is None else windows.log_evidence[:, place]
    found = {
        "mean": beliefs.mean[rows, place],
        "cov": lower(beliefs.cov[rows, place]),
        "weight": known[[posterior.kind.last(int(step), steps) for step in rows]],
        "there.weight": passed[rows],
    }
    if posterior.kind != FILTERED:
        found["there.mean"] = forward.mean[rows, place][:, states]
        found["there.cov"] = lower(block(forward.cov[rows, place], states, states))
    return found


def _pairs(posterior: ChainOutcome, rows: Integers, place: int) -> dict[str, Array]:
    """The states before each step within its cluster's belief: moments, covariances with the slice.

    Their moments are left out after smoothing, when they are those of the slice before. NaN at
    step 0, and where joints were not kept.
    """
    layout = posterior.graph.layout
    front, size = layout.state_size, layout.slice_size
    mean = np.full((len(rows), front + size), np.nan)
    cov = np.full((len(rows), front + size, front + size), np.nan)
    later = rows > 0
    windows = posterior._windows
    if posterior._careful is None and (windows is None or windows.plain):
        if later.any():
            run = slice(place, place + 1)
            beliefs = Beliefs(posterior._beliefs.mean[:, run], posterior._beliefs.cov[:, run])
            states = Conditional(*(cut(part, run) for part in posterior._reverse.states))
            own = slice(int(rows[later][0]) - 1, int(rows[-1]))
            both = pairs(beliefs, Reverse(states, None), own)
            mean[later], cov[later] = both.mean[:, 0], both.cov[:, 0]
    else:
        for row in np.flatnonzero(later).tolist():
            try:
                joint = posterior.joint(*(v.at(int(rows[row])) for v in layout.pair))
            except NumericalError:
                continue
            mean[row] = joint.mean.reshape(-1, front + size)[place]
            cov[row] = joint.cov.reshape(-1, front + size, front + size)[place]
    found: dict[str, Array] = {"cross": cov[:, :front, front:]}
    if posterior.kind != SMOOTHED:
        found |= {"before.mean": mean[:, :front], "before.cov": lower(cov[:, :front, :front])}
    return found


def _information(
    posterior: ChainOutcome, numbers: Numbers, rows: Integers, place: int
) -> dict[str, Any]:
    """The messages back to some steps, and the potentials: K, h and g of a run, a row a step."""

    def added(name: str, form: Canonical, which: Any, bits: int) -> dict[str, Any]:
        K, h, g = (part[which, place] for part in form)
        parts = {"K": lower(K), "h": h, "g": g}
        return {f"{name}.{part}": numbers.add(array, bits) for part, array in parts.items()}

    found = added("own", posterior._potentials, rows[rows > 0] - 1, SHOWN)
    if not rows[0]:
        first = first_potential(posterior._plan, posterior._forward)
        K, h, g = (part[None] for part in first)
        found |= added("first", (K, h, g), slice(None), SHOWN)
    if posterior.kind == SMOOTHED:
        found |= added("back", posterior._backward_messages, rows, EXACT)
    return found
