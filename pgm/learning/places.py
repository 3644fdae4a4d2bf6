"""The places of CPDs in a network, and the network with others in some of them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

from pgm.cpds import CPD, SwitchingCPD
from pgm.cpds.switching import Case
from pgm.display import titled
from pgm.errors import ModelError
from pgm.networks import BayesianNetwork, DynamicBayesianNetwork
from pgm.posteriors.expectations import OBSERVATION, PRIOR, TRANSITION, Learnable
from pgm.variables import Variable

# The role of all CPDs of a network without time.
NETWORK = "cpds"
Network = DynamicBayesianNetwork | BayesianNetwork


class Place(NamedTuple):
    """The place of a CPD: its role, its number there, and of a `SwitchingCPD` the case."""

    role: str
    number: int
    case: Case | None = None

    def of(self, model: Network) -> Learnable:
        """The CPD that stands here."""
        return Learnable(getattr(model, self.role)[self.number], self.role, self.case)


def replaced(model: Any, cpds: Iterable[tuple[Place, CPD]]) -> Any:
    """A network with other CPDs in some places."""
    parts: dict[str, list[Any]] = {}
    for place, cpd in cpds:
        own = parts.setdefault(place.role, list(getattr(model, place.role)))
        if place.case is not None:
            whole = own[place.number]
            cpd = SwitchingCPD(whole.child, whole.switches, {**whole.cases, place.case: cpd})
        own[place.number] = cpd
    if isinstance(model, BayesianNetwork):
        return model.replace(*parts[NETWORK])
    return model.replace(**parts)


def place_of(model: DynamicBayesianNetwork, variable: Any) -> Place:
    """The place of a variable's CPD: x.at(0) names a prior, x a transition or sensor."""
    if isinstance(variable, Variable):
        first = variable.step == 0 and not variable.lag
        roles: Mapping[str, Any] = (
            {PRIOR: model.prior}
            if first
            else {TRANSITION: model.transition, OBSERVATION: model.observation}
        )
        for role, cpds in roles.items():
            for number, cpd in enumerate(cpds):
                if cpd.child == (variable.template if first else variable):
                    return Place(role, number)
    raise ModelError(
        f"learn of {variable!r}: {titled(model)} has no CPD of it; name x.at(0) for the prior of a "
        "state, x for its transition, z for a sensor"
    )


def by_place(place: Place, cpd: CPD, learnt: Any) -> list[tuple[Place, Any]]:
    """The parts learnt of a CPD, or of each case of one that discrete variables choose.

    Of the latter `learnt` is of all cases, or maps states to what is learnt in these, each named
    once.
    """
    if not isinstance(cpd, SwitchingCPD):
        return [(place, learnt)]
    if not isinstance(learnt, Mapping):
        return [(place._replace(case=case), learnt) for case in cpd.cases]
    found = [(place._replace(case=cpd.case_of(states)), each) for states, each in learnt.items()]
    if not found or len({each for each, _ in found}) < len(found):
        raise ModelError(
            f"learn of {cpd!r}: maps one state or several, each once, to what is learnt in it; "
            f"found {list(learnt)!r}",
            variable=cpd.child,
            cpd=cpd,
        )
    return found
