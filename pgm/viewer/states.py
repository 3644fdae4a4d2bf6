"""The page of a chain of tables, as of a hidden Markov model: transitions, weights, messages."""

from __future__ import annotations

from typing import Any

import numpy as np

from pgm.inference import StatePosterior
from pgm.inference.kind import FILTERED, SMOOTHED
from pgm.inference.markov.joints import potential
from pgm.kernels.arrays import Array
from pgm.viewer.limits import Limits, Run
from pgm.viewer.numbers import Numbers
from pgm.viewer.slices import head, readings, sighted
from pgm.viewer.words import number, went


def page(
    posterior: StatePosterior, numbers: Numbers, runs: list[Run], span: range, limits: Limits
) -> dict[str, Any]:
    """The structure of the page, its numbers added to those given."""
    graph, plan, chain = posterior.graph, posterior._plan, posterior._chain
    found = head(graph, posterior.kind, span, plan.slice)
    found["family"] = "table"
    found["words"] = {}
    found["steps"]["base"] = max(span[0] - 1, 0)
    if posterior.kind != SMOOTHED:
        found["words"]["back"] = f"not sent: the posterior is {posterior.kind}; smoothing sends it"
    sensors = readings(posterior._slices.bound.readings)
    steps, states = (
        list(range(max(span[0] - 1, 0), span[-1] + 1)),
        int(np.prod([v.size for v in plan.states])),
    )
    width = int(np.prod(plan.shape))
    room = len(steps) * states * width * (1 if posterior.kind in (FILTERED, SMOOTHED) else 2)
    pairs = room <= limits.numbers and states * width <= limits.entries
    if not pairs:
        found["words"]["large"] = f"left out: {states * width:,} entries at each step are too many"
    moved = [potential(chain, plan, step) for step in steps] if pairs else []
    back = list(posterior.messages_back())[::-1] if posterior.kind == SMOOTHED else []
    weight = np.cumsum(np.asarray(chain.log_density).reshape(graph.steps + 1, -1), axis=0)
    found["runs"] = []
    for run in runs:
        place = int(np.ravel_multi_index(run, posterior._lead)) if run else 0

        def one(values: Array, axes: int) -> Array:
            """The numbers of this run, flat."""
            own = values[..., place] if values.ndim > axes else values  # noqa: B023 - called here
            return np.asarray(own, dtype=np.float64).reshape(-1)

        axes = len(plan.shape)
        beliefs = [
            chain.numbers(b) if posterior._beliefs is chain.known else b for b in posterior._beliefs
        ]
        there = [posterior._states(b) for b in posterior._filtered]
        last = [posterior.kind.last(step, graph.steps) for step in steps]
        own: dict[str, Any] = {
            "belief": np.stack([_padded(one(beliefs[k], axes), width) for k in steps]),
            "weight": weight[last, place],
            "there": np.stack([one(there[k], len(plan.states)) for k in steps]),
            "there.weight": weight[steps, place],
        }
        if back:
            own["back"] = np.stack([one(back[k][0], len(plan.states)) for k in steps])
            own["back.scale"] = np.array([float(np.reshape(back[k][1], -1)[place]) for k in steps])
        if pairs:
            linear = [
                [chain.numbers(part) if part is not None else None for part in each[:2]]
                for each in moved
            ]
            later = [k for k, step in enumerate(steps) if step]
            ones = np.ones(width)
            own["own.weights"] = np.stack(
                [_padded(one(w, axes), width) if w is not None else ones for _, w in linear]
            )
            own["own.scale"] = np.array(
                [
                    float(np.broadcast_to(scale, max(weight.shape[1], 1))[place])
                    for *_, scale in moved
                ]
            )
            if later:
                both = len(plan.states) + axes
                own["own"] = np.stack([one(linear[k][0], both) for k in later])
            if not steps[0]:
                own["first"] = _padded(one(linear[0][0], axes), width)[None]
            if posterior.kind not in (FILTERED, SMOOTHED) and later:
                tables = [posterior.belief(steps[k]) for k in later]
                own["pairs"] = np.stack([t.values[run].reshape(-1) for t in tables])
        found["runs"].append(
            {
                "run": list(run),
                "log_evidence": number(float(weight[-1, place])),
                "went": went(posterior.status, place),
                "arrays": {name: numbers.add(array) for name, array in own.items()},
                "sensors": sighted(numbers, sensors, span, place),
            }
        )
    return found


def _padded(values: Array, width: int) -> Array:
    """A belief of step 0, where controls have one entry, at the length of the others."""
    found = np.full(width, np.nan)
    found[: values.size] = values
    return found
