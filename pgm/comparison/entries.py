"""The entries of a comparison: beliefs run here, run before, or imported."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np

from pgm.beliefs.own.family import BeliefFamily, require_family
from pgm.boundary import as_floats, as_tuple
from pgm.comparison.oracle import Compared, Held, Oracle, gaussian_of
from pgm.compile import DynamicGraph
from pgm.cpds.conditional import ConditionalGaussian
from pgm.cpds.robust import RobustNoise
from pgm.display import titled
from pgm.errors import ModelError
from pgm.factors import Gaussian
from pgm.factors.scope import labels, listed
from pgm.inference import Filtering, FixedLag, Kind, Smoothing
from pgm.inference.audit import Audit
from pgm.inference.engine import send
from pgm.io.poses import Poses
from pgm.kernels.arrays import Array
from pgm.linearisers import Lineariser
from pgm.networks import DynamicBayesianNetwork
from pgm.posteriors.belief_kind import SMOOTHED
from pgm.posteriors.outcome import marginal
from pgm.schedules.argument_checks import require_lineariser
from pgm.schedules.options import Call
from pgm.variables import Variable

OverTime = Filtering | FixedLag | Smoothing
Method = Lineariser | BeliefFamily[Any]

# The advice to a user who gives poses.
VALUES = (
    "a state's values at its steps are due: "
    "{x: poses.along(x, times=..., position=..., heading=...)}"
)
_WORDS = {Filtering: "filter", Smoothing: "smoother"}


class Entry(NamedTuple):
    """Beliefs to be judged: what a row of each state is made from.

    label, schedule: Its names in the table.
    kind: Which measurements the beliefs know.
    states: The states that it has beliefs, or values, of.
    run: Makes them: a posterior, or anything that has marginals by variable.
    iterated: Whether a schedule was run that iterates, so that the row tells of convergence.
    given: Whether the beliefs were made before, so that no time is told.
    lenient: Whether a family is run that may refuse a schedule, or have no moments.
    """

    label: str
    schedule: str
    kind: Kind
    states: tuple[Variable, ...]
    run: Callable[[], Any]
    iterated: bool = False
    given: bool = False
    lenient: bool = False


class Track(NamedTuple):
    """Values of a state at steps 0..T without covariances, (*runs, T+1, d), NaN where unknown."""

    state: Variable
    values: Array


def of_methods(
    methods: Mapping[str, Method], plans: Mapping[str, OverTime], compared: Compared
) -> list[Entry]:
    """Every lineariser or family of beliefs, under every schedule."""
    return [
        _planned(label, word, plan, compared, method=method)
        for label, method in methods.items()
        for word, plan in plans.items()
    ]


def of_rows(
    rows: Mapping[str, Any],
    plans: Mapping[str, OverTime],
    compared: Compared,
    bind: Callable[[DynamicBayesianNetwork], DynamicGraph],
) -> list[Entry]:
    """The user's rows by their labels, as `require_row` lets them pass.

    bind: Compiles another model, after the evidence is checked to fit it.
    """
    return [
        each for label, thing in rows.items() for each in _of(label, thing, plans, compared, bind)
    ]


def _of(
    label: str,
    thing: Any,
    plans: Mapping[str, OverTime],
    compared: Compared,
    bind: Callable[[DynamicBayesianNetwork], DynamicGraph],
) -> Iterator[Entry]:
    if isinstance(thing, OverTime):
        yield _planned(label, schedule_name(thing), thing, compared)
    elif isinstance(thing, DynamicBayesianNetwork | RobustNoise):
        model = compared.graph.model
        other = _noisy(model, thing) if isinstance(thing, RobustNoise) else thing
        graph = bind(other)
        for word, plan in plans.items():
            yield _planned(label, word, plan, compared, graph=graph)
    elif isinstance(thing, Gaussian | Mapping):
        yield _imported(label, thing, compared)
    elif isinstance(thing, Audit):
        found = Held(thing.corrected)
        for state in compared.states:
            gaussian_of(found, state, compared, f"{label!r} of rows=: its belief")
        yield Entry(label, "corrected", SMOOTHED, compared.states, lambda: found, given=True)
    elif isinstance(thing, Oracle) and not isinstance(thing, BeliefFamily):
        for state in compared.states:
            gaussian_of(thing, state, compared, f"{label!r} of rows=: its marginal")
        kind: Any = thing.kind
        yield Entry(label, str(kind), kind, compared.states, lambda: thing, given=True)
    else:
        for word, plan in plans.items():
            yield _planned(label, word, plan, compared, method=thing)


def require_row(label: Any, thing: Any, model: DynamicBayesianNetwork) -> None:
    """Refuse an object that cannot be a row of a comparison."""
    if isinstance(thing, BeliefFamily):
        require_family(thing, model)
        return
    if isinstance(thing, Poses):
        raise ModelError(f"rows= has {label!r}, which is Poses; {VALUES}")
    if isinstance(thing, OverTime | DynamicBayesianNetwork | RobustNoise | Audit):
        return
    if isinstance(thing, Gaussian | Mapping):
        return
    if isinstance(thing, Oracle) and isinstance(thing.kind, Kind):
        return
    if isinstance(thing, Oracle) or not callable(thing):
        raise ModelError(
            f"rows= has {label!r}, which is {titled(thing)}; a row is a posterior over time, a "
            "model, robust noise, a lineariser, a schedule, a family of beliefs like "
            "pgm.Particles(...), a pgm.audit(...), a pgm.Gaussian over steps, or a mapping of "
            "states to values (..., T+1, d)"
        )
    require_lineariser(thing)


def _planned(
    label: str,
    word: str,
    plan: OverTime,
    compared: Compared,
    *,
    method: Method | None = None,
    graph: DynamicGraph | None = None,
) -> Entry:
    """An entry that is run here, under a schedule; without a lineariser by the default one."""
    graph = graph or compared.graph
    family, call = None, Call(plan, keep=compared.states)
    if isinstance(method, BeliefFamily):
        family, call = method, Call(plan)
    else:
        call = call if method is None else call._replace(lineariser=method)
        if graph.model.mixed:  # whose mixtures are kept whole
            call = call._replace(keep=None)

    def run() -> Any:
        return send(graph, compared.evidence, call, family)  # of runs unsettled the rows tell

    iterated, lenient = plan.iterations > 1, family is not None
    return Entry(label, word, plan.kind, compared.states, run, iterated, lenient=lenient)


def _noisy(model: DynamicBayesianNetwork, noise: RobustNoise) -> DynamicBayesianNetwork:
    """The model with robust noise for all its sensors that are functions plus Gaussian noise."""
    sensors = [
        cpd._with_noise(noise) if isinstance(cpd, ConditionalGaussian) else cpd
        for cpd in model.observation
    ]
    if not any(isinstance(cpd, ConditionalGaussian) for cpd in sensors):
        raise ModelError(f"rows= has {noise!r}, and the model no sensor with Gaussian noise")
    return model.replace(observation=sensors)


def _imported(label: str, thing: Any, compared: Compared) -> Entry:
    """An entry of a trajectory from elsewhere: Gaussians, or values alone, which know all."""
    whose = f"{label!r} of rows="
    items = {thing.scope[0]: thing} if isinstance(thing, Gaussian) else dict(thing)
    marginals: dict[Variable, Any] = {}
    for state, values in items.items():
        if state not in compared.states:
            raise ModelError(
                f"{whose} has values of {state!r}; the states compared are "
                f"{listed(compared.states)}"
            )
        if isinstance(values, Gaussian):
            held = Held({state: values})
            marginals[state] = gaussian_of(held, state, compared, f"{whose}: the belief")
        else:
            marginals[state] = Track(state, _values(state, values, compared, whose))
    if not marginals:
        raise ModelError(f"{whose} is empty; map states to values (..., T+1, d)")
    found = Held(marginals)
    return Entry(label, "given", SMOOTHED, tuple(marginals), lambda: found, given=True)


def _values(state: Variable, values: Any, compared: Compared, whose: str) -> Array:
    array = as_floats(values, f"{whose}: values of {state!r}", labels=labels((state,)))
    due = (*compared.lead, compared.graph.steps + 1, state.dimension)
    if array.shape not in (due, due[-2:]):
        raise ModelError(
            f"{whose}: values of {state!r} have shape {array.shape}; {due} was due, NaN where "
            "none is known",
            variable=state,
        )
    if not (np.isfinite(array) | np.isnan(array)).all() or np.isnan(array).all():
        raise ModelError(f"{whose}: values of {state!r} are infinite, or NaN throughout")
    return np.broadcast_to(array, due)


def belief_of(found: Any, state: Variable) -> Gaussian | Track:
    """The belief of a state, as a Gaussian of its moments, or its values alone."""
    belief = marginal(found, state)
    if isinstance(belief, Gaussian | Track):
        return belief
    gaussian: Gaussian = belief.gaussian()
    return gaussian


def named(items: Any, what: str, example: str, word: Callable[[Any], str]) -> dict[str, Any]:
    """The user's items by name: of a mapping its own, of a sequence the class, or the words."""
    if isinstance(items, Mapping):
        for name in items:
            if not isinstance(name, str):
                raise ModelError(f"{what}= maps names to {what}; found the name {name!r}")
        found = dict(items)
    else:
        every = as_tuple(items)
        if every is None:
            raise ModelError(
                f"{what}= is a sequence of {what}, or a mapping of their names to them, as in "
                f"{example}; found {items!r}"
            )
        count = Counter(map(word, every))
        names = [word(item) if count[word(item)] == 1 else repr(item) for item in every]
        found = dict(zip(names, every, strict=True))
        if len(found) < len(names):
            twice = next(name for name in names if names.count(name) > 1)
            raise ModelError(f"{what}= has {twice} twice; name them by a mapping, or leave one out")
    if not found:
        raise ModelError(f"{what}= is empty; give one or more, as in {example}")
    return found


def class_name(item: Any) -> str:
    """The name of an item's class, or of a function."""
    return str(getattr(item, "__name__", type(item).__name__))


def schedule_name(schedule: Any) -> str:
    """A schedule in words, as a table shows it."""
    if isinstance(schedule, FixedLag):
        word = f"fixed lag {schedule.lag}"
    else:
        word = _WORDS.get(type(schedule), repr(schedule))
    iterations, gate = getattr(schedule, "iterations", 1), getattr(schedule, "gate", None)
    word = word if iterations == 1 else f"{word} × {iterations}"
    return word if gate is None else f"{word}, gate {gate}"


def require_schedule(schedule: Any) -> None:
    """Refuse an object that is no schedule of a dynamic network."""
    if not isinstance(schedule, OverTime):
        raise ModelError(
            f"{schedule!r} is no schedule of a dynamic network; give pgm.Filtering(), "
            "pgm.FixedLag(...) or pgm.Smoothing()"
        )
