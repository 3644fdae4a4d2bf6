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
from pgm.cpds import CPD, MixtureCPD, SwitchingCPD
from pgm.cpds.caused import flat
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
            if isinstance(cpd, MixtureCPD):
                yield from (part for part, _ in flat(cpd))
            else:
                yield from cpd.cases.values() if isinstance(cpd, SwitchingCPD) else (cpd,)

    @property
    def robust(self) -> CPD | None:
        """A CPD of robust noise, if there is any; hypotheses are not weighed then."""
        return next((case for case in self.cases if not is_plain(case)), None)


def roles_of(model: DynamicBayesianNetwork, bound: BoundEvidence) -> Roles:
    """The CPDs of continuous variables; one that has no Gaussian beliefs is a ModelError."""
    # An online update has no inputs of the motion, which it does not ask for.
    known = bound.transition or ({},) * len(model.transition)
    pairs = zip(model.transition, known, strict=True)
    moved = [(cpd, inputs) for cpd, inputs in pairs if not cpd.discrete]
    every = [opened(each) for each in bound.readings]
    readings = [
        part
        for each in every
        if each.unknown is None and not is_regime_sensor(model, each.cpd)
        for part in _by_observed(each)
    ]
    unknown = [each for each in every if each.unknown is not None]
    for each in unknown:
        if isinstance(each.cpd, SwitchingCPD):
            raise EvidenceError(
                f"sightings of {each.cpd.child!r} leave a parent open, and discrete variables "
                "choose its CPD: give each case a sensor of its own",
                variable=each.cpd.child,
                cpd=each.cpd,
            )
    found = Roles(
        [cpd for cpd in model.prior if not cpd.discrete],
        [cpd for cpd, _ in moved],
        [inputs for _, inputs in moved],
        [reading.cpd for reading in readings],
        readings,
        unknown,
    )
    for case in found.cases:
        require_gaussian([case], "the Gaussian beliefs of a mixed network")
        case.require_proper(
            "hypotheses are weighed by densities, and a belief of infinite variance has none"
        )
    return found


def require_densities(roles: Roles, hidden: Sequence[Discrete]) -> None:
    """Refuse robust noise, whose bound of a density does not weigh hypotheses."""
    case = roles.robust
    if case is not None:
        of = f" of ({listed(hidden)})" if hidden else ""
        raise ModelError(
            f"{case!r} has robust noise, and what hypotheses{of} are weighed by are densities, of "
            "which robust noise gives but a bound: make outliers a state of a discrete "
            "variable, with a case of larger noise; or, of sightings by pgm.unknown, give "
            'association="likelihood"',
            variable=case.child,
            cpd=case,
        )


def _by_observed(reading: Reading) -> list[Reading]:
    """The readings of a sensor by the states of the observed variables that choose its CPD."""
    cpd = reading.cpd
    if not isinstance(cpd, SwitchingCPD):
        return [reading]
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
