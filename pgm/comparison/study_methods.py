"""The methods of a study: a lineariser or a family of beliefs, under a schedule."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

from pgm.beliefs.own.family import BeliefFamily, require_family
from pgm.comparison.entries import OverTime, class_name, named
from pgm.display import titled
from pgm.errors import ModelError
from pgm.inference import Filtering
from pgm.linearisers import TAYLOR, Lineariser
from pgm.networks import DynamicBayesianNetwork
from pgm.schedules.argument_checks import require_lineariser
from pgm.schedules.options import Call

_EXAMPLE = 'methods={"EKF": pgm.Taylor(), "RTS": (pgm.Taylor(), pgm.Smoothing())}'
# Seeds from which an oracle's are counted, so that it has none in common with a method's.
ORACLES = 2**40


class Method(NamedTuple):
    """A lineariser under a schedule; or a family of beliefs under one."""

    lineariser: Lineariser
    schedule: OverTime
    belief: BeliefFamily[Any] | None = None

    @property
    def call(self) -> Call:
        """The options of its inference."""
        return Call(self.schedule, self.lineariser)

    @property
    def alone(self) -> bool:
        """Whether a family of beliefs has each run by itself, and not all runs of a block."""
        return self.belief is not None and not self.belief._by_block

    @property
    def iterates(self) -> bool:
        """Whether its iterations may end before they settle."""
        schedule = self.schedule
        return self.belief is None and schedule.iterations > 1 and schedule.tolerance > 0.0


def methods_of(given: Any, model: DynamicBayesianNetwork) -> dict[str, Method]:
    """The methods by name, checked.

    Raises
    ------
    ModelError
        If one is no method, or would repeat its draws in other runs.
    """
    if not isinstance(given, Mapping):
        raise ModelError(f"methods= maps names to methods, as in {_EXAMPLE}; found {given!r}")
    found = {
        name: _method(name, each, model)
        for name, each in named(given, "methods", _EXAMPLE, class_name).items()
    }
    _require_shared_points(model, found)
    return found


def seeded(family: BeliefFamily[Any], number: int) -> BeliefFamily[Any]:
    """A family with draws of its own for each number; itself where it has no seed."""
    with_seed = getattr(family, "with_seed", None)
    return with_seed(family.seed + number) if with_seed else family  # type: ignore[attr-defined]


def require_seeds(family: BeliefFamily[Any]) -> None:
    """Refuse a family that would draw the same in each run."""
    if hasattr(family, "seed") and not hasattr(family, "with_seed"):
        raise ModelError(
            f"{titled(family)} has a seed, and would draw the same in each run of a study; give "
            "it with_seed(seed), which returns the family with another seed"
        )


def _method(name: str, given: Any, model: DynamicBayesianNetwork) -> Method:
    """A method from a lineariser, a family of beliefs, a schedule, or a pair with a schedule."""
    parts = given if isinstance(given, tuple) else (given,)
    schedules = [part for part in parts if isinstance(part, OverTime)]
    families = [part for part in parts if isinstance(part, BeliefFamily)]
    rules = [part for part in parts if not isinstance(part, OverTime | BeliefFamily)]
    several = len(schedules) > 1 or len(rules) + len(families) > 1
    if not parts or several or not all(map(callable, rules)):
        raise ModelError(
            f"methods= has {name!r}, which is {titled(given)}; a method is a lineariser, a family "
            "of beliefs like pgm.Particles(...), a schedule over time, or a pair of one of the "
            f"former and a schedule, as in {_EXAMPLE}"
        )
    for rule in rules:
        require_lineariser(rule)
    for family in families:
        require_family(family, model)
        require_seeds(family)
    schedule = schedules[0] if schedules else Filtering()
    rule = rules[0] if rules else TAYLOR
    return Method(rule, schedule, families[0] if families else None)


def _require_shared_points(model: DynamicBayesianNetwork, methods: Mapping[str, Method]) -> None:
    """Refuse rules that draw points of their own for each run of a call, as blocks are calls."""
    rules: list[Any] = [method.lineariser for method in methods.values()]
    rules += [getattr(cpd, "lineariser", None) for cpd in model.cpds]
    for rule in rules:
        if getattr(rule, "fresh_per_run", False):
            raise ModelError(
                f"{titled(rule)} draws anew for each run of a call, and would repeat its draws in "
                "each block of a study; leave fresh_per_run out"
            )
