"""Mixtures of CPDs in a chain, as CPDs that a hidden *cause* chooses: which component drew a value.

A cause is a discrete variable that no step remembers, with the weights of the mixture for a table.
Sightings of one step are drawn apart, so that each has a sensor, and a cause, of its own.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np

from pgm.compile import DynamicGraph, compile
from pgm.cpds import CPD, MixtureCPD, TableCPD
from pgm.cpds.caused import caused, unused
from pgm.evidence import BoundEvidence, Reading
from pgm.networks import DynamicBayesianNetwork


def is_caused(model: DynamicBayesianNetwork) -> bool:
    """Whether a network has mixtures of CPDs."""
    return any(isinstance(cpd, MixtureCPD) for cpd in model.cpds)


def with_causes(graph: DynamicGraph, bound: BoundEvidence) -> tuple[DynamicGraph, BoundEvidence]:
    """A graph and its evidence, with causes in the place of mixtures; the same without any."""
    if not is_caused(graph.model):
        return graph, bound
    sightings: dict[CPD, int] = {
        each.cpd: _most(each) for each in bound.readings if isinstance(each.cpd, MixtureCPD)
    }
    made = _Caused(graph.model, sightings)
    known = dict(zip(graph.model.transition, bound.transition, strict=True))
    whole = replace(
        bound,
        transition=tuple(known.get(made.of.get(cpd, cpd), {}) for cpd in made.model.transition),
        readings=tuple(part for each in bound.readings for part in made.parted(each)),
        form=None,
    )
    compiled = graph.layout.compiled
    return compile(made.model, bound.steps, compiled=compiled), whole


def network_with_causes(model: DynamicBayesianNetwork) -> DynamicBayesianNetwork:
    """A network with causes in the place of mixtures, of one sighting a step."""
    return _Caused(model, {}).model if is_caused(model) else model


def _most(reading: Reading) -> int:
    """The most sightings of a sensor at a step."""
    return int(np.unique(reading.step, return_counts=True)[1].max(initial=1))


class _Caused:
    """A network with causes, whose sensors may have several sightings a step.

    Attributes
    ----------
    model : DynamicBayesianNetwork
    of : mapping of CPD to CPD
        By CPD of the network the mixture that it stands for.
    """

    def __init__(self, model: DynamicBayesianNetwork, sightings: Mapping[CPD, int]) -> None:
        self.of: dict[CPD, CPD] = {}
        self._sensors: dict[CPD, list[CPD]] = {}
        self._names = {v.name for v in model.variables}
        prior, transition = list[CPD](), list[CPD]()
        observation = list[CPD]()
        for cpd in model.prior:
            prior += self._of_state(cpd, transition, first=True)
        for cpd in model.transition:
            transition += self._of_state(cpd, transition)
        for cpd in model.observation:
            if not isinstance(cpd, MixtureCPD):
                observation.append(cpd)
                continue
            count = sightings.get(cpd, 1)
            for k in range(count):
                child = cpd.child
                if count > 1:
                    child = replace(child, name=unused(f"{child.name} {k + 1}", self._names))
                table, chosen = caused(cpd, self._names, child)
                prior.append(table)
                transition.append(table)
                observation.append(chosen)
                self._sensors.setdefault(cpd, []).append(chosen)
        self.model = DynamicBayesianNetwork(prior, transition, observation)

    def parted(self, reading: Reading) -> Iterator[Reading]:
        """The sightings of a sensor, those of one step by sensors of their own."""
        sensors = self._sensors.get(reading.cpd)
        if sensors is None or reading.unknown is not None:
            yield reading
            return
        rank = np.arange(reading.step.size) - np.searchsorted(reading.step, reading.step)
        for k, cpd in enumerate(sensors):
            some = rank == k
            yield replace(
                reading,
                cpd=cpd,
                step=reading.step[some],
                order=reading.order[some],
                values=reading.values[some],
                taken=reading.taken[some],
                inputs={v: values[some] for v, values in reading.inputs.items()},
            )

    def _of_state(self, cpd: CPD, transition: list[CPD], *, first: bool = False) -> list[CPD]:
        """The CPD of a state or control, and its cause's; a prior's cause stays as it was drawn."""
        if not isinstance(cpd, MixtureCPD):
            return [cpd]
        table, chosen = caused(cpd, self._names)
        if first:  # what it is later does not matter
            cause = chosen.switches[0]
            transition.append(TableCPD(cause, table=np.eye(cause.size)[0]))
        self.of[chosen] = cpd
        return [table, chosen]
