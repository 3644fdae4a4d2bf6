"""The continuous parts of a mixed network, where evidence has cut it."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Sequence
from typing import NamedTuple

from pgm.cpds import CPD, SwitchingCPD
from pgm.factors.axes import States
from pgm.factors.scope import Scope
from pgm.variables import Discrete, Variable


class Part(NamedTuple):
    """CPDs that hidden continuous variables join, and the discrete variables that choose them.

    Attributes
    ----------
    cpds : tuple of CPD
        Of continuous children, parents first.
    hidden : tuple of Variable
        The continuous variables without evidence.
    boundary : tuple of Discrete
        The discrete parents of the CPDs.
    """

    cpds: tuple[CPD, ...]
    hidden: Scope
    boundary: States


def parts_of(cpds: Sequence[CPD], observed: Iterable[Variable]) -> list[Part]:
    """The parts of a network's CPDs of continuous children, given the variables with evidence.

    A CPD without hidden variables is a part of its own: a likelihood of its discrete parents.
    """
    known = frozenset(observed)
    top = list(range(len(cpds)))

    def find(k: int) -> int:
        while top[k] != k:
            top[k] = top[top[k]]
            k = top[k]
        return k

    first: dict[Variable, int] = {}
    scopes = [
        tuple(v for v in cpd.scope if not isinstance(v, Discrete) and v not in known)
        for cpd in cpds
    ]
    for k, scope in enumerate(scopes):
        for variable in scope:
            top[find(first.setdefault(variable, k))] = find(k)
    members: dict[int, list[int]] = {}
    for k in range(len(cpds)):
        members.setdefault(find(k), []).append(k)
    found = []
    for places in members.values():
        own = tuple(cpds[k] for k in places)
        hidden = tuple(dict.fromkeys(v for k in places for v in scopes[k]))
        switches = (v for cpd in own if isinstance(cpd, SwitchingCPD) for v in cpd.switches)
        found.append(Part(own, hidden, tuple(dict.fromkeys(switches))))
    return found


def fitting(
    cpds: Sequence[CPD],
    observed: Collection[Variable],
    told: Collection[Variable],
    fits: Callable[[Part], bool],
) -> list[Part]:
    """The parts, without variables that nothing known depends on where a part does not fit.

    Such a variable, one that only joins its parents, is left out, then the next ones. `told` are
    those of the observed variables of which something was measured.
    """
    found: list[Part] = []
    waiting = parts_of(cpds, observed)
    while waiting:
        part = waiting.pop()
        needed = {v for cpd in part.cpds for v in cpd.parents}.union(told)
        kept = [cpd for cpd in part.cpds if cpd.child in needed]
        if fits(part) or len(kept) == len(part.cpds):
            found.append(part)
        else:
            waiting += parts_of(kept, observed)
    return found
