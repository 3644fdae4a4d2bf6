"""Mixtures of CPDs in a chain: which component drew a value is a hypothesis, its *cause*.

The cause of a state is a hidden discrete variable that no step remembers, with the weights of the
mixture for a table. A sensor may have several sightings at a step, each drawn apart: a component is
then one of the alternatives of an open sighting (`sightings`), as a candidate is.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pgm.compile import DynamicGraph, compile
from pgm.cpds import CPD, TableCPD
from pgm.cpds.caused import cases_of, caused, flat, has_mixtures, is_farthest, is_mixture
from pgm.errors import EvidenceError
from pgm.evidence import BoundEvidence, Reading
from pgm.evidence.values import SUM, OneOf
from pgm.kernels.arrays import Array, Integers, Mask
from pgm.networks import DynamicBayesianNetwork


class Components(OneOf):
    """The components of a mixture, of which each sighting of its sensor is one.

    Where discrete variables choose among mixtures, they are those of all cases.

    Attributes
    ----------
    parts : tuple of CPD
        The components.
    cases : ndarray of int
        The number of the case that each is of, (components,).
    log_weights : ndarray
        The logarithms of their weights in their case, (components,).
    groups : ndarray of int
        The group of each, (components,): scales of one order of magnitude are alike.
    farthest : ndarray of bool
        Those that are the largest scale of a robust noise, (components,).
    """

    parts: tuple[CPD, ...]
    cases: Integers
    log_weights: Array
    groups: Integers
    farthest: Mask

    def __init__(self, cpd: CPD) -> None:
        mixtures = [flat(case) for case in cases_of(cpd).values()]
        every = [part for own in mixtures for part in own]
        weights = np.array([part.weight for part in every])
        super().__init__(len(every), weights, 0.0, 0.0, None, None, SUM)
        number = np.repeat(np.arange(len(mixtures)), [len(own) for own in mixtures])
        places = np.stack([number, [part.group for part in every]])
        self._set(
            parts=tuple(part.cpd for part in every),
            cases=number,
            log_weights=np.log(weights),
            groups=np.unique(places, axis=1, return_inverse=True)[1].reshape(-1),
            farthest=np.array([is_farthest(part.cpd) for part in every]),
            dimension=cpd.child.dimension,
        )


def opened(reading: Reading) -> Reading:
    """A sensor's sightings, which are open if it is a mixture."""
    cpd = reading.cpd
    if not is_mixture(cpd):
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
    # The inputs of a motion are those of its mixture; of a cause they are those that choose.
    known = {v: rows for inputs in bound.transition for v, rows in inputs.items()}
    transition = tuple(
        {v: known[v] for v in cpd.parents if v in known} for cpd in changed.transition
    )
    made = compile(changed, bound.steps, compiled=graph.layout.compiled)
    return made, replace(bound, transition=transition, form=None)


def network_with_causes(model: DynamicBayesianNetwork) -> DynamicBayesianNetwork:
    """A network whose states have causes in the place of mixtures; the same without any.

    It is kept with the network, so that a filter and its beliefs that are copied together have one.
    """
    if not has_mixtures([*model.prior, *model.transition]):
        return model
    known: DynamicBayesianNetwork | None = model.__dict__.get("_with_causes")
    if known is None:
        known = _made(model)
        model._set(_with_causes=known)
    return known


def _made(model: DynamicBayesianNetwork) -> DynamicBayesianNetwork:
    names = {v.name for v in model.variables}
    prior, transition = list[CPD](), list[CPD]()
    for cpd in model.prior:
        if not is_mixture(cpd):
            prior.append(cpd)
            continue
        table, chosen = caused(cpd, names)
        prior += [table, chosen]
        size = table.child.size  # what the cause is at later steps does not matter
        transition.append(TableCPD(table.child, table=np.eye(size)[0]))
    for cpd in model.transition:
        transition += caused(cpd, names) if is_mixture(cpd) else [cpd]
    return DynamicBayesianNetwork(prior, transition, model.observation)
