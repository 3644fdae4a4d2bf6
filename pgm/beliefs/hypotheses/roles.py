"""The CPDs of a mixed chain's continuous variables, with their evidence, by role.

A sensor that observed variables choose is as many sensors as these have states that were observed,
each of which has the readings that were taken in its state: what is observed is no hypothesis.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from pgm.beliefs.hypotheses.causes import opened
from pgm.beliefs.hypotheses.regimes import is_plain, is_regime_sensor
from pgm.cpds import CPD, SwitchingCPD
from pgm.cpds.caused import components, in_scales, is_mixture
from pgm.errors import EvidenceError, ModelError
from pgm.evidence import BoundEvidence, Reading
from pgm.evidence.dynamic import Inputs
from pgm.factors.scope import listed
from pgm.kernels.arrays import Integers
from pgm.networks import DynamicBayesianNetwork
from pgm.schedules.argument_checks import require_gaussian
from pgm.variables import Discrete, Variable


class Roles(NamedTuple):
    """The CPDs of continuous variables by role, with their evidence, in the network's order.

    `open` are the readings that leave open what was seen, whose sensors are not among the others.
    """

    prior: Sequence[CPD]
    transition: Sequence[CPD]
    inputs: Sequence[Inputs]
    observation: Sequence[CPD]
    readings: Sequence[Reading]
    open: Sequence[Reading]

    @property
    def cases(self) -> Iterator[CPD]:
        """The CPDs that nothing chooses, and all cases, or components, of the others."""
        unknown = (reading.cpd for reading in self.open)
        for cpd in (*self.prior, *self.transition, *self.observation, *unknown):
            yield from components(cpd)

    @property
    def robust(self) -> CPD | None:
        """A CPD of robust noise, if there is any; hypotheses are not weighed then."""
        return next((case for case in self.cases if not is_plain(case)), None)


def roles_of(
    model: DynamicBayesianNetwork, bound: BoundEvidence, hypotheses: Sequence[Discrete] | None
) -> Roles:
    """The CPDs of continuous variables; one that has no Gaussian beliefs is a ModelError.

    `hypotheses` are hidden variables that choose; None where there are none. They are weighed by
    densities, and sensors of robust noise are then mixtures of Gaussians of several scales.
    """
    # An online update has no inputs of the motion, which it does not ask for.
    known = bound.transition or ({},) * len(model.transition)
    pairs = zip(model.transition, known, strict=True)
    moved = [(cpd, inputs) for cpd, inputs in pairs if not cpd.discrete]
    every = [
        part
        for each in bound.readings
        if not is_regime_sensor(model, each.cpd)
        for part in _by_observed(each)
    ]
    if hypotheses is None and any(each.unknown or is_mixture(each.cpd) for each in every):
        hypotheses = ()
    if hypotheses is not None:
        every = [_weighed(each, hypotheses) for each in every]
    every = [opened(each) for each in every]
    readings = [each for each in every if each.unknown is None]
    found = Roles(
        [cpd for cpd in model.prior if not cpd.discrete],
        [cpd for cpd, _ in moved],
        [inputs for _, inputs in moved],
        [reading.cpd for reading in readings],
        readings,
        [each for each in every if each.unknown is not None],
    )
    for case in found.cases:
        require_gaussian([case], "the Gaussian beliefs of a mixed network")
        case.require_proper(
            "hypotheses are weighed by densities, and a belief of infinite variance has none"
        )
    return found


def _weighed(reading: Reading, hypotheses: Sequence[Discrete]) -> Reading:
    """A sensor's readings, each of a scale that is a hypothesis where its noise is robust."""
    cpd = reading.cpd
    robust = next((part for part in components(cpd) if not is_plain(part)), None)
    if robust is None:
        return reading
    if reading.unknown is not None:
        raise ModelError(
            f"{cpd!r} has robust noise, and its sightings leave {reading.unknown[0]!r} open, "
            "whose candidates are weighed by densities, of which robust noise gives but a bound: "
            "declare outliers by pgm.unknown(..., spurious=, volume=), or, where no discrete "
            'variables are hidden, decide by association="likelihood"',
            variable=cpd.child,
            cpd=cpd,
        )
    of = f"hypotheses of ({listed(hypotheses)})" if hypotheses else "hypotheses"
    return replace(reading, cpd=in_scales(cpd, f"by whose densities {of} are weighed"))


def _by_observed(reading: Reading) -> list[Reading]:
    """The readings of a sensor by the states of the observed variables that choose its CPD."""
    cpd = reading.cpd
    if not isinstance(cpd, SwitchingCPD):
        return [reading]
    if reading.unknown is not None:
        raise EvidenceError(
            f"sightings of {cpd.child!r} leave a parent open, and discrete variables choose its "
            "CPD: give each case a sensor of its own",
            variable=cpd.child,
            cpd=cpd,
        )
    seen = [v for v in cpd.switches if v in reading.inputs]
    if not seen:
        return [reading]
    rows = np.broadcast_arrays(*(reading.inputs[v][..., 0] for v in seen))
    each = np.stack(rows, axis=-1)
    found = []
    for states in np.unique(each.reshape(-1, len(seen)), axis=0):
        own = (each == states).all(axis=-1)
        some = own.any(axis=1)
        found.append(
            replace(
                reading,
                cpd=_in_states(cpd, seen, states),
                step=reading.step[some],
                order=reading.order[some],
                values=reading.values[some],
                taken=reading.taken[some] & own[some][..., None],
                inputs={v: values[some] for v, values in reading.inputs.items()},
            )
        )
    return found


def _in_states(cpd: SwitchingCPD, seen: Sequence[Discrete], states: Integers) -> CPD:
    """The CPD where some of the variables that choose it are in known states.

    Its child is a variable of its own, as a network has one CPD for each.
    """
    known = dict(zip(seen, states.tolist(), strict=True))
    named = ", ".join(v.states[k] for v, k in known.items())
    child = replace(cpd.child, name=f"{cpd.child.name} ({named})")

    def moved(variable: Variable) -> Variable:
        return child if variable == cpd.child else variable

    left = [v for v in cpd.switches if v not in known]
    cases = {
        tuple(k for v, k in zip(cpd.switches, case, strict=True) if v not in known): own._copy(
            moved
        )
        for case, own in cpd.cases.items()
        if all(known.get(v, k) == k for v, k in zip(cpd.switches, case, strict=True))
    }
    if not left:
        return next(iter(cases.values()))
    return SwitchingCPD(child, left, cases)
