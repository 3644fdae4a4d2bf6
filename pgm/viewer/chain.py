"""The page of a Gaussian chain: moments, messages and potentials of all steps in batched calls."""

from __future__ import annotations

from typing import Any

import numpy as np

from pgm.errors import NumericalError
from pgm.inference import ChainPosterior
from pgm.inference.chain.backward import pairs
from pgm.inference.chain.potentials import first_potential
from pgm.inference.kind import FILTERED, SMOOTHED
from pgm.kernels.arrays import Array, Integers, block, quiet
from pgm.kernels.canonical import Canonical
from pgm.viewer.limits import Limits, Run
from pgm.viewer.numbers import SHOWN, Numbers, lower
from pgm.viewer.slices import head, sighted
from pgm.viewer.words import number, went

# Numbers of all runs together, up to which messages back and potentials are made for the page.
_MOST = 20_000_000
_SINGULAR = "no canonical form: singular"


@quiet()
def page(
    posterior: ChainPosterior, numbers: Numbers, runs: list[Run], span: range, limits: Limits
) -> dict[str, Any]:
    """The structure of the page, its numbers added to those given."""
    graph, layout = posterior.graph, posterior.graph.layout
    size = layout.state_size + layout.slice_size
    found = head(graph, posterior.kind, span, layout.slice)
    flat = [int(np.ravel_multi_index(run, posterior._planned.lead)) for run in runs]
    forward, beliefs = posterior._forward, posterior._beliefs
    fits = posterior._planned.runs * (graph.steps + 1) * size * size <= _MOST
    whole = posterior._windows is None and posterior._careful is None
    rest: Canonical | None = posterior._potentials if fits else None
    first = first_potential(posterior._plan, forward) if fits else None
    back = posterior._backward_messages if fits and posterior.kind == SMOOTHED else None
    found["family"] = "gaussian"
    found["words"] = _words(posterior, fits)
    sensors = {
        s.family.cpd: (
            s.family.step,
            s.values if s.taken is None else np.where(s.taken, s.values, np.nan),
            s.family.inputs,
        )
        for s in posterior._planned.sensors
    }
    weight = np.cumsum(forward.log_density, axis=0)
    found["runs"] = []
    held = range(max(span[0] - 1, 0), span[-1] + 1)  # a cluster holds the states before its step
    rows = np.array(held)
    found["steps"]["base"] = held[0]
    for run, place in zip(runs, flat, strict=True):
        own = {
            "mean": beliefs.mean[rows, place],
            "cov": lower(beliefs.cov[rows, place]),
            "weight": _known(posterior, rows, place),
        }
        own |= _pairs(posterior, rows, place)
        states = layout.state_places
        if posterior.kind != FILTERED or not whole:
            own["there.mean"] = forward.mean[rows, place][:, states]
            own["there.cov"] = lower(block(forward.cov[rows, place], states, states))
        own["there.weight"] = weight[rows, place]
        if back is not None:
            own |= {
                "back.K": lower(back[0][rows, place]),
                "back.h": back[1][rows, place],
                "back.g": back[2][rows, place],
            }
        refs = {name: numbers.add(array) for name, array in own.items()}
        if rest is not None and first is not None:
            at = rows[rows > 0] - 1
            for name, part in zip("Khg", rest, strict=True):
                values = part[at, place]
                refs[f"own.{name}"] = numbers.add(lower(values) if name == "K" else values, SHOWN)
            if not held[0]:
                for name, part in zip("Khg", first, strict=True):
                    values = part[None, place]
                    refs[f"first.{name}"] = numbers.add(lower(values) if name == "K" else values, SHOWN)
        found["runs"].append(
            {
                "run": list(run),
                "log_evidence": number(float(posterior._swept.log_density[:, place].sum())),
                "went": went(posterior.status, place),
                "arrays": refs,
                "sensors": sighted(numbers, sensors, span, place),
            }
        )
    return found


def _words(posterior: ChainPosterior, fits: bool) -> dict[str, str]:
    """Why something is not there, by what it is."""
    words = {"singular": _SINGULAR}
    if not fits:
        words["large"] = "left out: the batch is too large to make it for all runs"
    if posterior.kind != SMOOTHED:
        words["back"] = f"not sent: the posterior is {posterior.kind}; smoothing sends it"
    return words


def _known(posterior: ChainPosterior, rows: Array, place: int) -> Array:
    """The log-evidence that the belief of each step knows."""
    total = np.cumsum(posterior._forward.log_density[:, place])
    if posterior._windows is not None:
        total = posterior._windows.log_evidence[:, place]
    steps = posterior.graph.steps
    found: Array = total[[posterior.kind.last(int(step), steps) for step in rows]]
    return found


def _pairs(posterior: ChainPosterior, rows: Integers, place: int) -> dict[str, Array]:
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
            own = slice(int(rows[later][0]) - 1, int(rows[-1]))
            found = pairs(posterior._beliefs, posterior._reverse, own)
            mean[later], cov[later] = found.mean[:, place], found.cov[:, place]
    else:
        for row in np.flatnonzero(later).tolist():
            try:
                joint = posterior.joint(*(v.at(int(rows[row])) for v in layout.pair))
            except NumericalError:
                continue
            mean[row] = joint.mean.reshape(-1, front + size)[place]
            cov[row] = joint.cov.reshape(-1, front + size, front + size)[place]
    found = {"cross": cov[:, :front, front:]}
    if posterior.kind != SMOOTHED:
        found |= {"before.mean": mean[:, :front], "before.cov": lower(cov[:, :front, :front])}
    return found

