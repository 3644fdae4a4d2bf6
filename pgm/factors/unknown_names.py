"""Unknown variables: the known one that was probably meant, for messages."""

from __future__ import annotations

from collections.abc import Collection, Iterable

from pgm.factors.scope import described, kind, listed
from pgm.variables import Variable


def unknown_name(key: object, known: Collection[Variable], where: str = "the network") -> str:
    """A clause that says why a key is none of the known variables, and what to use instead."""
    named = key.name if isinstance(key, Variable) else key
    alike = _in_order(v for v in known if v.name == named)
    if not isinstance(key, Variable):
        advice = (
            f"use the variable itself, {listed(alike)}"
            if alike
            else f"{where} has the variables {listed(_in_order(known))}"
        )
        return f"which is no variable; {advice}"
    if not alike:
        return f"which {where} does not have; it has {listed(_in_order(known))}"
    if kind(key) != kind(alike[0]):
        return (
            f"which {where} does not have: its variable of that name is a different one, with "
            f"{described(alike[0])} where this one has {described(key)}; use that one"
        )
    template = key.step is None and not key.lag
    advice = f"name the step, {key.name}.at(k)" if template else "use what it has"
    return f"which {where} has only as {listed(alike)}; {advice}"


def _in_order(variables: Iterable[Variable]) -> list[Variable]:
    """By name, and copies by step."""
    return sorted(variables, key=lambda v: (v.name, -1 if v.step is None else v.step, v.lag))
