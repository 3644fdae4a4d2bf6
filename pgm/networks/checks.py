"""Checks of the CPDs of networks, and of how a dynamic network is declared."""

from __future__ import annotations

import heapq
from collections import defaultdict
from collections.abc import Callable, Collection, Iterable, Sequence
from typing import TypeVar

import numpy as np

from pgm.boundary import as_tuple
from pgm.cpds import CPD, SwitchingCPD, TableCPD
from pgm.cpds.residual import NonlinearGaussianFactor
from pgm.display import titled
from pgm.errors import ModelError
from pgm.factors import CanonicalForm, Table
from pgm.factors.arrays import clash
from pgm.factors.scope import MOST, Scope
from pgm.variables import Variable

C = TypeVar("C", bound=CPD)


def as_cpds(cpds: CPD | Iterable[CPD], where: str) -> tuple[CPD, ...]:
    """CPDs as a tuple; refuses anything else."""
    result = (cpds,) if isinstance(cpds, CPD) else as_tuple(cpds)
    if result is None:
        raise ModelError(f"{where} is a sequence of CPDs, not {titled(cpds)}")
    for cpd in result:
        if not isinstance(cpd, CPD):
            bare = isinstance(cpd, Table | CanonicalForm | NonlinearGaussianFactor)
            way = (
                ": factors without a direction stand in a pgm.MarkovNetwork; elsewhere each is a "
                "CPD of a reading that was observed, NonlinearGaussianCPD(reading, given=..., ...)"
            ) * bare
            raise ModelError(f"{where} holds CPDs, not {titled(cpd)}{way}")
    return result


def one_cpd_each(cpds: Iterable[CPD]) -> None:
    """Refuse a second CPD for a child."""
    seen: dict[Variable, CPD] = {}
    for cpd in cpds:
        if cpd.child in seen:
            raise ModelError(
                f"{cpd.child!r} has two CPDs, {seen[cpd.child]!r} and {cpd!r}; keep one",
                variable=cpd.child,
                cpd=cpd,
            )
        seen[cpd.child] = cpd


def runs(cpds: Iterable[CPD]) -> tuple[int, ...]:
    """The axes of runs of the CPDs, broadcast; axes that do not broadcast are refused."""
    first: dict[tuple[int, ...], Variable] = {}
    for cpd in cpds:
        first.setdefault(cpd._lead(), cpd.child)
    try:
        return np.broadcast_shapes(*first)
    except ValueError:
        shapes = [(child, shape) for shape, child in first.items()]
        raise ModelError(
            f"the CPDs have axes of runs that do not broadcast: {clash(shapes)}; give each the same"
        ) from None


def no_step_before(cpds: Collection[CPD]) -> None:
    """Refuse parents of the step before, where there is no time."""
    for cpd in cpds:
        for parent in cpd.parents:
            if parent.lag:
                raise ModelError(
                    f"{cpd!r}: {parent!r} is of a step before, which a network without time does "
                    "not have; declare a DynamicBayesianNetwork, or name the steps, "
                    f"{parent.name}.at(0)",
                    variable=parent,
                    cpd=cpd,
                )
    no_steps(cpds, "a network without time has no steps")


def no_steps(cpds: Iterable[CPD], where: str) -> None:
    """Refuse CPDs of numbers that change from step to step, where there are no steps."""
    for cpd in cpds:
        if cpd.steps is not None:
            raise ModelError(
                f"{cpd!r} has numbers of its own at each of the steps 1..{cpd.steps}, and {where}; "
                "cpd.at(step) has those of one step, at that step",
                variable=cpd.child,
                cpd=cpd,
            )


def in_order(cpds: Sequence[C], parents: Callable[[C], Scope]) -> tuple[C, ...]:
    """CPDs with parents before children, otherwise in the given order."""
    place = {cpd.child: k for k, cpd in enumerate(cpds)}
    waiting = [[place[p] for p in parents(cpd) if p in place] for cpd in cpds]
    if all(k > parent for k, before in enumerate(waiting) for parent in before):
        return tuple(cpds)
    children: dict[int, list[int]] = defaultdict(list)
    for k, before in enumerate(waiting):
        for parent in before:
            children[parent].append(k)
    missing = [len(before) for before in waiting]
    ready = [k for k, count in enumerate(missing) if not count]  # sorted, which is a heap
    order = []
    while ready:
        first = heapq.heappop(ready)
        order.append(first)
        for k in children.get(first, ()):
            missing[k] -= 1
            if not missing[k]:
                heapq.heappush(ready, k)
    if len(order) < len(cpds):
        loop = _cycle(list(map(set, waiting)), set(range(len(cpds))).difference(order))
        path = " -> ".join(repr(cpds[k].child) for k in loop[:MOST])
        if len(loop) > MOST:
            path += f" -> ... ({len(loop) - 1} variables in all)"
        raise ModelError(
            f"the CPDs form a cycle, {path}; take a parent out of one of them or, in a dynamic "
            "network, give it the parent's step before (.previous)",
            variable=cpds[loop[0]].child,
            cpd=cpds[loop[0]],
        )
    return tuple(cpds[k] for k in order)


def _cycle(before: Sequence[set[int]], left: set[int]) -> list[int]:
    """A directed cycle among the CPDs that have no topological order."""
    path: dict[int, None] = {}
    at = min(left)
    while at not in path:
        path[at] = None
        at = min(before[at] & left)
    loop = list(path)[list(path).index(at) :]
    return [at, *reversed(loop)]


def kinds(hidden: Sequence[CPD], observation: Sequence[CPD]) -> tuple[bool, bool]:
    """Whether the hidden variables of a dynamic network are discrete, and whether it is mixed.

    `hidden` are the CPDs of its prior and transition. A network is mixed if discrete variables are
    hidden beside continuous ones, or choose among CPDs of these. Of a network whose hidden
    variables are all discrete, sensors are tables, or SwitchingCPDs, which the variables choose.
    """
    every = (*hidden, *observation)
    tables = [cpd for cpd in hidden if cpd.discrete]
    discrete = len(tables) == len(hidden) and bool(every) and every[0].discrete
    mixed = not discrete and (bool(tables) or any(isinstance(cpd, SwitchingCPD) for cpd in every))
    for cpd in observation:
        if discrete and not cpd.discrete and not isinstance(cpd, SwitchingCPD):
            raise ModelError(
                f"{cpd!r} stands beside {every[0]!r}; sensors of hidden variables that are all "
                "discrete are tables, or SwitchingCPDs, which have a CPD of readings for each "
                "state",
                variable=cpd.child,
                cpd=cpd,
            )
        if not discrete and not mixed and cpd.discrete:
            raise ModelError(
                f"{cpd!r} is a sensor of discrete readings, and all hidden variables are "
                "continuous; give it a hidden discrete parent, with a TableCPD of its own",
                variable=cpd.child,
                cpd=cpd,
            )
    return discrete, mixed


def _carried(cpd: CPD) -> str:
    if cpd.discrete:
        return "TableCPD(older, given=x.previous, table=np.eye(x.size))"
    return "LinearGaussianCPD(older, given={x.previous: 1.0}, cov=0)"


def check_templates(cpds: Iterable[CPD]) -> None:
    """Refuse variables at single steps, and variables more than one step back."""
    for cpd in cpds:
        for variable in cpd.scope:
            if variable.step is not None:
                raise ModelError(
                    f"{cpd!r}: a dynamic network is declared for {variable.template!r} and "
                    f"{variable.template.previous!r}, not for the single step of {variable!r}",
                    variable=variable,
                    cpd=cpd,
                )
            if variable.lag > 1:
                raise ModelError(
                    f"{cpd!r}: {variable!r} is more than one step back; carry it along as a "
                    f"state of its own ({_carried(cpd)})",
                    variable=variable,
                    cpd=cpd,
                )


def check_states(
    prior: Iterable[CPD],
    transition: Iterable[CPD],
    observation: Iterable[CPD],
    states: set[Variable],
    hidden: set[Variable],
) -> None:
    """Refuse a state that lacks its prior or its transition."""
    moved = {cpd.child: cpd for cpd in observation}
    for cpd in prior:
        if cpd.child not in hidden:
            still = "an identity" if cpd.discrete else "cov=0"
            advice = f"add a CPD of it given {cpd.child.previous!r} ({still} for a static unknown)"
            if cpd.child in moved:
                advice = (
                    f"{moved[cpd.child]!r} stands in observation=, which is for sensors: a motion "
                    "belongs in transition="
                )
            elif cpd.parents:
                advice += "; if it is a sensor's measurement, its CPD belongs in observation= alone"
            raise ModelError(
                f"state {cpd.child!r} has a prior but no transition; {advice}",
                variable=cpd.child,
                cpd=cpd,
            )
    for cpd in transition:
        for parent in cpd.parents:
            if parent.lag and parent.template not in states:
                raise ModelError(
                    f"{cpd!r} needs {parent!r}, but {parent.template!r} has no prior; add a CPD "
                    "of it to the prior",
                    variable=parent.template,
                    cpd=cpd,
                )


def check_parents(
    prior: Iterable[CPD],
    transition: Iterable[CPD],
    observation: Iterable[CPD],
    states: set[Variable],
    hidden: set[Variable],
    sensors: set[Variable],
) -> None:
    """Refuse a parent that stands where it cannot."""

    def refuse(cpd: CPD, parent: Variable, why: str) -> None:
        raise ModelError(f"{cpd!r}: {parent!r} {why}", variable=parent, cpd=cpd)

    for cpd in prior:
        for parent in cpd.parents:
            if parent not in states:
                refuse(cpd, parent, "cannot be a parent in the prior; only other states can")
    for cpd in observation:
        for parent in cpd.parents:
            if parent.lag:
                refuse(
                    cpd,
                    parent,
                    "cannot be a sensor's parent; carry it along as a state of this step "
                    f"({_carried(cpd)})",
                )
    for cpd in (*prior, *transition, *observation):
        for parent in cpd.parents:
            if parent.template in sensors:
                refuse(
                    cpd,
                    parent,
                    "is a sensor's measurement, which cannot be a parent; add a "
                    "state that both depend on",
                )
        if isinstance(cpd, TableCPD):
            for parent in cpd.inputs:
                if parent.template in hidden:
                    refuse(
                        cpd,
                        parent,
                        "is hidden, so no table can be a function of it; give it an axis of the "
                        "table, in given=",
                    )
        for parent in cpd.noise_given:
            if parent.template in hidden:
                refuse(
                    cpd,
                    parent,
                    "is hidden, so the noise cannot depend on it; noise may depend on inputs alone",
                )
