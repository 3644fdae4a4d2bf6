"""Mixtures of CPDs in a chain: which component drew a value is a hypothesis, its *cause*.

The cause of a state is a hidden discrete variable that no step remembers, with the weights of the
mixture for a table. A sensor may have several sightings at a step, each drawn apart: a component is
then one of the alternatives of an open sighting (`sightings`), as a candidate is.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pgm.compile import DynamicGraph, compile
from pgm.cpds import CPD, MixtureCPD, TableCPD
from pgm.cpds.caused import caused, flat, has_mixtures
from pgm.errors import EvidenceError
from pgm.evidence import BoundEvidence, Reading
from pgm.evidence.values import SUM, OneOf
from pgm.networks import DynamicBayesianNetwork


class Components(OneOf):
    """The components of a mixture, of which each sighting of its sensor is one."""

    parts: tuple[CPD, ...]

    def __init__(self, cpd: MixtureCPD) -> None:
        parts = list(flat(cpd))
        super().__init__(len(parts), [weight for _, weight in parts], 0.0, 0.0, None, None, SUM)
        self._set(parts=tuple(part for part, _ in parts), dimension=cpd.child.dimension)


def opened(reading: Reading) -> Reading:
    """A sensor's sightings, which are open if it is a mixture."""
    cpd = reading.cpd
    if not isinstance(cpd, MixtureCPD):
        return reading
    if reading.unknown is not None:
        raise EvidenceError(
            f"{cpd!r} is a mixture, and its sightings leave {reading.unknown[0]!r} open, too: give "
            "each component a sensor of its own, or belief=pgm.Particles(...)",
            variable=cpd.child,
            cpd=cpd,
        )
    return replace(reading, unknown=(cpd.child, Components(cpd)))


def with_causes(graph: DynamicGraph, bound: BoundEvidence) -> tuple[DynamicGraph, BoundEvidence]:
    """A graph and its evidence, whose states have causes in the place of mixtures."""
    model = graph.model
    changed = network_with_causes(model)
    if changed is model:
        return graph, bound
    # The inputs of a motion are those of its mixture; a cause has none.
    known = {
        cpd.child: inputs for cpd, inputs in zip(model.transition, bound.transition, strict=True)
    }
    transition = tuple(known.get(cpd.child, {}) for cpd in changed.transition)
    made = compile(changed, bound.steps, compiled=graph.layout.compiled)
    return made, replace(bound, transition=transition, form=None)


def network_with_causes(model: DynamicBayesianNetwork) -> DynamicBayesianNetwork:
    """A network whose states have causes in the place of mixtures; the same without any."""
    if not has_mixtures([*model.prior, *model.transition]):
        return model
    names = {v.name for v in model.variables}
    prior, transition = list[CPD](), list[CPD]()
    for cpd in model.prior:
        if not isinstance(cpd, MixtureCPD):
            prior.append(cpd)
            continue
        table, chosen = caused(cpd, names)
        prior += [table, chosen]
        cause = table.child  # what it is at later steps does not matter
        transition.append(TableCPD(cause, table=np.eye(len(chosen.cases))[0]))
    for cpd in model.transition:
        transition += caused(cpd, names) if isinstance(cpd, MixtureCPD) else [cpd]
    return DynamicBayesianNetwork(prior, transition, model.observation)
