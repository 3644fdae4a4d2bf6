"""The page of beliefs without messages: grids, particles, and marginals that alone were kept."""

from __future__ import annotations

from typing import Any

import numpy as np

from pgm.errors import EvidenceError, PgmError
from pgm.factors import Gaussian, Table
from pgm.inference import GridPosterior, KeptPosterior, ParticlePosterior
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
    """The structure of the page, its numbers added to those given."""
    graph = posterior.graph
    beliefs = {}
    for variable in graph.layout.slice:
        try:
            beliefs[variable] = posterior[variable]
        except EvidenceError:  # of a hidden control, or of a variable that was not kept
            continue
    found = head(graph, posterior.kind, span, beliefs)
    found["family"] = "moments"
    found["words"] = {
        "messages": next(why for kind, why in _WHY.items() if isinstance(posterior, kind))
    }
    found["steps"]["base"] = span[0]
    found["runs"] = []
    sensors = readings(_readings(posterior))
    for run in runs:
        arrays, size = {}, sum(v.dimension for v in beliefs)
        mean = np.full((graph.steps + 1, size), np.nan)
        cov = np.full((graph.steps + 1, size, size), np.nan)
        start = 0
        for variable, belief in beliefs.items():
            if isinstance(belief, Table):
                continue
            own = slice(start, start := start + variable.dimension)
            first = graph.steps + 1 - belief.mean.shape[-2]
            cov[first:] = np.where(np.isnan(cov[first:]), 0.0, cov[first:])
            mean[first:, own], cov[first:, own, own] = belief.mean[run], belief.cov[run]
        rows = np.array(span)
        arrays["mean"], arrays["cov"] = numbers.add(mean[rows]), numbers.add(lower(cov[rows]))
        draws = _drawn(beliefs, run, rows) if len(rows) * size * _DRAWS <= limits.numbers else None
        if draws is not None:
            arrays["draws"] = numbers.add(draws, SHOWN)
        lead = np.asarray(posterior.log_evidence).shape
        found["runs"].append(
            {
                "run": list(run),
                "log_evidence": number(float(np.asarray(posterior.log_evidence)[run])),
                "went": went(posterior.status, int(np.ravel_multi_index(run, lead)) if run else 0)
                if isinstance(posterior, KeptPosterior)
                else None,
                "arrays": arrays,
                "sensors": sighted(numbers, sensors, span, 0),
            }
        )
    return found


def _readings(posterior: Any) -> Any:
    if isinstance(posterior, GridPosterior):
        return posterior._bound.readings
    if isinstance(posterior, ParticlePosterior):
        return [sensor.reading for sensor in posterior._model.sensors]
    return ()


def _drawn(beliefs: dict[Any, Any], run: Run, rows: Any) -> Any:
    """Draws of the first state at each step, (steps, draws * components); None of Gaussians."""
    belief = next(iter(beliefs.values()), None)
    if belief is None or isinstance(belief, Gaussian | Table):
        return None
    try:
        draws = belief.sample(_DRAWS, rng=0)
    except PgmError:
        return None
    own = draws[(slice(None), *run)][:, rows]
    return np.moveaxis(own, 0, 1).reshape(len(rows), -1)
