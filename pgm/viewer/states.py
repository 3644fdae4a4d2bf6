"""The pages of a chain of tables, and of beliefs without messages: grids, particles, kept ones."""

import math
from typing import Any

import numpy as np

from pgm.beliefs.markov.joints import potential
from pgm.beliefs.markov.outcome import StateOutcome
from pgm.errors import EvidenceError
from pgm.factors import Gaussian
from pgm.kernels.arrays import Array
from pgm.posteriors.belief_kind import FILTERED, SMOOTHED
from pgm.posteriors.outcome import marginal
from pgm.variables import Discrete, Variable
from pgm.viewer.chain import head, readings, sighted
from pgm.viewer.numbers import SHOWN, Limits, Numbers, Run, lower, number, went

# Entries of beliefs of all runs together, up to which messages back are made.
_MOST = 20_000_000


def page(
    posterior: StateOutcome, numbers: Numbers, runs: list[Run], span: range, limits: Limits
) -> dict[str, Any]:
    """The structure of the page, its numbers added."""
    found = head(posterior.graph, posterior.kind, span, posterior._plan.slice)
    words: dict[str, str] = {}
    if posterior.kind != SMOOTHED:
        words["back"] = f"not sent: the posterior is {posterior.kind}; smoothing sends it"
    # A cluster holds the states before its step.
    held = list(range(max(span[0] - 1, 0), span[-1] + 1))
    chain = _Chain(posterior, held)
    tables = chain.entries * len(held) <= limits.numbers and chain.entries <= limits.entries
    if posterior.kind == SMOOTHED and not chain.back:
        words["back"] = "left out: the batch is too large to make it for all runs"
        tables = False
    if not tables:
        words["large"] = f"left out: {chain.entries:,} entries at each step are too many"
    sensors = readings(posterior._slices.bound.readings)
    found["steps"]["base"] = held[0]
    rows = []
    for run in runs:
        place = int(np.ravel_multi_index(run, posterior._lead)) if run else 0
        arrays = chain.beliefs(place) | (chain.potentials(run, place) if tables else {})
        rows.append(
            {
                "run": list(run),
                "log_evidence": number(float(chain.weight[-1, place])),
                "went": went(posterior.status, place),
                "arrays": {name: numbers.add(array) for name, array in arrays.items()},
                "sensors": sighted(numbers, sensors, span, place),
            }
        )
    return found | {"family": "table", "words": words, "runs": rows}


class _Chain:
    def __init__(self, posterior: StateOutcome, steps: list[int]) -> None:
        self.posterior, self.steps = posterior, steps
        self.plan, self.chain = posterior._plan, posterior._chain
        self.width = math.prod(self.plan.shape)
        # Of the states before a step with its slice.
        self.entries = math.prod(v.size for v in self.plan.states) * self.width
        last = posterior.graph.steps
        density = np.asarray(self.chain.log_density).reshape(last + 1, -1)
        self.weight: Array = np.cumsum(density, axis=0)
        fits = self.width * self.weight.size <= _MOST
        back = posterior.messages_back() if posterior.kind == SMOOTHED and fits else ()
        self.back = list(back)[::-1]

    def _of(self, values: Array, axes: int, place: int, width: int = 0) -> Array:
        """The numbers of a run, flat; at step 0, without controls, at the length of the others."""
        own = values[..., place] if values.ndim > axes else values
        found = np.full(max(own.size, width), np.nan)
        found[: own.size] = own.reshape(-1)
        return found

    def beliefs(self, place: int) -> dict[str, Array]:
        posterior, steps = self.posterior, self.steps
        axes, states = len(self.plan.shape), len(self.plan.states)
        beliefs, filtered = posterior._beliefs, posterior._filtered
        last = [posterior.kind.last(step, posterior.graph.steps) for step in steps]
        found = {
            "belief": np.stack([self._of(beliefs[k], axes, place, self.width) for k in steps]),
            "weight": self.weight[last, place],
            "there": np.stack(
                [self._of(posterior._states(filtered[k]), states, place) for k in steps]
            ),
            "there.weight": self.weight[steps, place],
        }
        if self.back:
            found["back"] = np.stack([self._of(self.back[k][0], states, place) for k in steps])
            found["back.scale"] = np.array([np.reshape(self.back[k][1], -1)[place] for k in steps])
        return found

    def potentials(self, run: Run, place: int) -> dict[str, Array]:
        """The transitions and likelihood weights of a run.

        Transitions are the same at all steps, mostly, and then take no room.
        """
        chain, steps, kind = self.chain, self.steps, self.posterior.kind
        axes, states = len(self.plan.shape), len(self.plan.states)
        later = [step for step in steps if step]
        moved, weights, scales = [], [], []
        found = {}
        for step in steps:
            transition, own, scale = potential(chain, self.plan, step)
            if step:
                moved.append(self._of(chain.numbers(transition), states + axes, place))
            else:
                found["first"] = self._of(chain.numbers(transition), axes, place, self.width)[None]
            # Weights have one entry for variables that the measurements do not depend on.
            shape = self.plan.shape if step else self.plan.first_shape
            likely = np.ones(shape) if own is None else chain.numbers(own)
            likely = np.broadcast_to(likely, (*shape, *likely.shape[axes:]))
            weights.append(self._of(likely, axes, place, self.width))
            scales.append(np.broadcast_to(scale, self.weight.shape[1])[place])
        found |= {"own.weights": np.stack(weights), "own.scale": np.array(scales)}
        if later:
            found["own"] = np.stack(moved)
            if kind not in (FILTERED, SMOOTHED):
                tables = (self.posterior.belief(step).values[run] for step in later)
                found["pairs"] = np.stack([table.reshape(-1) for table in tables])
        return found


_DRAWS = 60


def marginal_page(
    posterior: Any, numbers: Numbers, runs: list[Run], span: range, limits: Limits
) -> dict[str, Any]:
    """The structure of the page, its numbers added."""
    graph, beliefs = posterior.graph, {}
    for variable in graph.layout.slice:
        try:
            belief = marginal(posterior, variable)
        except EvidenceError:  # of a hidden control, of one not kept, or of a form without moments
            continue
        if not isinstance(variable, Discrete):
            beliefs[variable] = belief
    found = head(graph, posterior.kind, span, beliefs)
    found["steps"]["base"] = span[0]
    sensors = readings(posterior.readings)
    log_evidence = np.asarray(posterior.log_evidence)
    rows = []
    for run in runs:
        place = int(np.ravel_multi_index(run, log_evidence.shape)) if run else 0
        own = {v: _of_run(belief, v, posterior, run, span) for v, belief in beliefs.items()}
        arrays = _moments(own, span)
        draws = _drawn(own, span, limits)
        if draws is not None:
            arrays["draws"] = draws
        kept = posterior.status._figures is None
        rows.append(
            {
                "run": list(run),
                "log_evidence": number(float(log_evidence[run])),
                "went": went(posterior.status, place) if kept else None,
                "arrays": {name: numbers.add(array, SHOWN) for name, array in arrays.items()},
                "sensors": sighted(numbers, sensors, span, place),
            }
        )
    return found | {"family": "moments", "words": {"messages": posterior.silent}, "runs": rows}


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


def _drawn(beliefs: dict[Variable, Any], span: range, limits: Limits) -> Array | None:
    """Draws of the first variable at each step, (steps, draws * components); None of Gaussians."""
    belief = next(iter(beliefs.values()), None)
    if belief is None or isinstance(belief, Gaussian) or len(belief.mean) < len(span):
        return None
    if belief.mean.size * _DRAWS > limits.numbers:
        return None
    draws: Array = belief.sample(_DRAWS, rng=0)
    return np.moveaxis(draws, 0, 1).reshape(len(span), -1)
