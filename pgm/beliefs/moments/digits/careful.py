"""The forward pass in twice the digits, where standard deviations lie too far apart for float64.

Numbers are pairs of float64 (`Twofold`). The measurements of a step are decorrelated to scalars
z = h x + e, e ~ N(0, r), of the slice x (n components), h being a row. The belief N(m, P) over the
slice is conditioned on them one by one. Each has an innovation v, of variance S, and a gain G:

    S = h P hᵀ + r,   G = P hᵀ/S,   v = z − h m,
    m ← m + G v,   P ← (1 − G h) P (1 − G h)ᵀ + G r Gᵀ.

A scalar whose S is no more than rounding was determined before, and is left out.

A *flat* prior has infinite variances. A component of infinite prior variance is taken for the sum
of an unknown number and a variable of unit variance. These unknown numbers are a vector δ of q
components. Covariances P given δ are then those of an ordinary model, and means are functions
m + D δ, where the matrix [m D] goes through the pass as one mean does. Each scalar has an
innovation v + V δ, kept as the row [v V], and so δ is estimated from Σ VᵀV / S and Σ Vᵀv / S, sums
over the scalars (de Jong, 1991; Durbin & Koopman, 2012, 5.7 and 6.4).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from pgm.beliefs.moments.digits import compiled
from pgm.beliefs.moments.digits.careful_belief import (
    Move,
    predicted,
    rounded_belief,
    solved,
)
from pgm.beliefs.moments.digits.careful_chain import moving, start, transition
from pgm.beliefs.moments.digits.careful_pass import Begin, Careful, Step
from pgm.beliefs.moments.digits.careful_update import CarefulReading, CarefulUpdate
from pgm.beliefs.moments.passes.forward import Forward
from pgm.beliefs.moments.steps import gate, refusals
from pgm.beliefs.moments.steps.chain import largest
from pgm.beliefs.moments.steps.diffuse import Diffuse
from pgm.beliefs.moments.steps.iterated_update import IteratedUpdate, iterated
from pgm.beliefs.moments.steps.plan import ChainPlan
from pgm.beliefs.moments.steps.readings import Reading
from pgm.kernels.arrays import Array, variances
from pgm.kernels.extended import Twofold
from pgm.posteriors.status import Status
from pgm.progress import counted
from pgm.schedules.iteration import Anchor
from pgm.schedules.schedule import Filtering


def sweep(
    plan: ChainPlan,
    schedule: Filtering | None = None,
    anchor: Anchor | None = None,
    begin: Begin | None = None,
    gated: gate.Asked | None = None,
) -> tuple[Careful, Status]:
    """The forward pass over all steps of a plan, and whether its linearisations settled.

    With a schedule each CPD is linearised at its incoming belief, the plan stores the
    linearisation, and the schedule's gates reject sightings; `anchor` and `gated` are then not
    used. Without a schedule the plan's linearisations are used, the gates `gated` reject sightings,
    and `anchor` holds all slices near a point, for a step control (Levenberg–Marquardt); None for
    no gates and no anchor. `begin` takes the prior's place in the plan of a window. Beliefs that
    are indefinite or not finite, and measurements that contradict a certain belief, are refused
    with a NumericalError.
    """
    made = compiled.sweep(plan, schedule, anchor, begin, gated)
    if made is not None:
        once = np.full(plan.runs, schedule is None or plan.linear)
        return made, Status.of([], once, plan.lead)
    out = Forward.empty(plan)
    steps: list[Step] = []
    ahead: list[Diffuse] = []
    record: list[Array] = []
    converged = np.ones(plan.runs, dtype=bool)
    if begin is None:
        belief = start(plan, linearise=schedule is not None)
        information = Twofold.zeros((plan.runs, *(belief.columns.shape[-1:] * 2)))
    else:
        belief, information = begin
        belief = belief._replace(largest=variances(belief.cov.hi))  # as far back as the window goes
    unknown = solved(information)
    move: Move | None = None
    settled = schedule is None or all(link.family.exact for link in plan.transition)
    every = transition(plan, slice(None)) if settled else None
    for step in counted(range(plan.steps + 1), "forward, in twice the digits"):
        if step:
            if every is None:
                move = moving(plan, step, out.mean[step - 1], out.cov[step - 1])
            else:
                move = every.at(step - 1 if len(every.matrix.hi) > 1 else 0)
            belief = predicted(belief, move)
        before = belief
        mean, spread = rounded_belief(belief, unknown)
        out.predicted_mean[step], out.predicted_cov[step] = mean, spread.shown
        if spread.open.shape[-1]:
            ahead.append(spread)
        reading = CarefulReading.of(
            plan, step, mean, spread, belief, information, schedule, gated=gated
        )
        if schedule is None:
            found = reading.solve(None if anchor is None else anchor.at(step))
        else:
            taken = iterated(reading, schedule)
            reading.keep()
            found = taken.solution.at(taken.mean)
            record = largest(record, taken.residuals)
            converged &= taken.converged
        belief, information, unknown = found.belief, found.information, found.unknown
        out.mean[step], out.cov[step] = found.mean, found.cov
        out.log_density[step] = found.log_density
        steps.append(Step(move, before, found))
        refusals.belief(plan, plan.first + step, before[:2], belief[:2])
    if any(spread.open.any() for spread in ahead):
        out = replace(out, diffuse=Diffuse(*map(np.stack, zip(*ahead, strict=True))))
    error = np.max([step.taken.belief.error() for step in steps], axis=0)
    return Careful(out, steps, error), Status.of(record, converged, plan.lead)


def predict(plan: ChainPlan, step: int, known: Begin) -> Begin:
    """The belief of an online filter predicted to `step`, by the only transition of the plan.

    `known` is the belief after the measurements of the step before, and what these have told of δ;
    `step` is the number in the chain, for the texts of errors. A belief that is indefinite or not
    finite is refused with a NumericalError.
    """
    mean, spread = known.rounded
    found = predicted(known.belief, moving(plan, 1, mean, spread.shown))
    refusals.belief(plan, step, found[:2])
    return known._replace(belief=found)


def update(
    plan: ChainPlan, step: int, known: Begin, schedule: Filtering
) -> tuple[Begin, IteratedUpdate[CarefulUpdate], Sequence[Reading]]:
    """The belief of an online filter given the measurements of its step, the only ones of the plan.

    `step` is the step's number in the chain, and `known` the belief predicted to that step. Returns
    the belief, the iterated update that led to it, and the readings as linearised last, which the
    plan keeps. A NumericalError refuses beliefs that are indefinite or not finite, and measurements
    that contradict a certain belief.
    """
    reading = CarefulReading.of(plan, 0, *known.rounded, *known, schedule)
    taken = iterated(reading, schedule)
    reading.keep()
    found = taken.solution.at(taken.mean)
    refusals.belief(plan, step, found.belief[:2])
    return Begin(found.belief, found.information), taken, reading.parts
