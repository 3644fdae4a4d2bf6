"""The page of beliefs without messages: grids, particles, and marginals that alone were kept."""

from __future__ import annotations

from typing import Any

import numpy as np

from pgm.errors import EvidenceError
from pgm.factors import Gaussian
from pgm.inference import GridPosterior, KeptPosterior, ParticlePosterior
from pgm.kernels.arrays import Array
from pgm.variables import Discrete, Variable
from pgm.viewer.limits import Limits, Run
from pgm.viewer.numbers import SHOWN, Numbers, lower
from pgm.viewer.slices import head, readings, sighted
from pgm.viewer.words import number, went

_DRAWS = 60
_WHY = {
    GridPosterior: "a grid sends probabilities of cells from slice to slice, and keeps no messages",
    ParticlePosterior: "particles are drawn from slice to slice: there are no messages to show",
    KeptPosterior: "keep= kept marginals alone: no messages; leave it out to have them",
}


def page(
    posterior: Any, numbers: Numbers, runs: list[Run], span: range, limits: Limits
) -> dict[str, Any]:
    """The structure of the page, its numbers added."""
    graph, beliefs = posterior.graph, {}
    for variable in graph.layout.slice:
        try:
            belief = posterior[variable]
        except EvidenceError:  # of a hidden control, or of a variable that was not kept
            continue
        if not isinstance(variable, Discrete):
            beliefs[variable] = belief
    found = head(graph, posterior.kind, span, beliefs)
    found["steps"]["base"] = span[0]
    sensors = readings(_readings(posterior))
    log_evidence = np.asarray(posterior.log_evidence)
    rows = []
    for run in runs:
        place = int(np.ravel_multi_index(run, log_evidence.shape)) if run else 0
        own = {v: _of_run(belief, v, posterior, run, span) for v, belief in beliefs.items()}
        arrays = _moments(own, span)
        draws = _drawn(own, span, limits)
        if draws is not None:
            arrays["draws"] = draws
        kept = isinstance(posterior, KeptPosterior)
        rows.append(
            {
                "run": list(run),
                "log_evidence": number(float(log_evidence[run])),
                "went": went(posterior.status, place) if kept else None,
                "arrays": {name: numbers.add(array, SHOWN) for name, array in arrays.items()},
                "sensors": sighted(numbers, sensors, span, place),
            }
        )
    why = next(why for kind, why in _WHY.items() if isinstance(posterior, kind))
    return found | {"family": "moments", "words": {"messages": why}, "runs": rows}


def _of_run(belief: Any, variable: Variable, posterior: Any, run: Run, span: range) -> Any:
    first = 0 if variable in posterior.graph.layout.states else 1
    return belief[(*run, slice(max(span[0] - first, 0), span[-1] + 1 - first))]


def _moments(beliefs: dict[Variable, Any], span: range) -> dict[str, Array]:
    """The moments of all variables together, a row a step; NaN where one has none."""
    size = sum(v.dimension for v in beliefs)
    mean, cov = np.full((len(span), size), np.nan), np.zeros((len(span), size, size))
    start = 0
    for variable, belief in beliefs.items():
        own = slice(start, start := start + variable.dimension)
        late = len(span) - len(belief.mean)
        cov[:late, own, own] = np.nan
        mean[late:, own], cov[late:, own, own] = belief.mean, belief.cov
    return {"mean": mean, "cov": lower(cov)}


def _readings(posterior: Any) -> Any:
    if isinstance(posterior, GridPosterior):
        return posterior._bound.readings
    if isinstance(posterior, ParticlePosterior):
        return [sensor.reading for sensor in posterior._model.sensors]
    return ()


def _drawn(beliefs: dict[Variable, Any], span: range, limits: Limits) -> Array | None:
    """Draws of the first variable at each step, (steps, draws * components); None of Gaussians."""
    belief = next(iter(beliefs.values()), None)
    if belief is None or isinstance(belief, Gaussian) or len(belief.mean) < len(span):
        return None
    if belief.mean.size * _DRAWS > limits.numbers:
        return None
    draws: Array = belief.sample(_DRAWS, rng=0)
    return np.moveaxis(draws, 0, 1).reshape(len(span), -1)
