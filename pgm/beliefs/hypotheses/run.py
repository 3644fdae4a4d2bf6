"""Filtering and smoothing a chain of discrete and continuous variables."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from pgm.beliefs.hypotheses import compiled
from pgm.beliefs.hypotheses.back import BackwardChain, Flow
from pgm.beliefs.hypotheses.causes import Components
from pgm.beliefs.hypotheses.chain import HypothesisChain
from pgm.beliefs.hypotheses.forward import Record, chain_of
from pgm.beliefs.hypotheses.outcome import Beliefs, HypothesisOutcome
from pgm.beliefs.hypotheses.records import Asked
from pgm.beliefs.hypotheses.roles import Roles
from pgm.compile import DynamicGraph
from pgm.cpds import AffineCPD
from pgm.errors import ModelError
from pgm.evidence import BoundEvidence
from pgm.kernels.arrays import Array, frozen
from pgm.posteriors.associations import Found, collected
from pgm.posteriors.belief_kind import FILTERED, SMOOTHED, Kind
from pgm.posteriors.status import Status
from pgm.progress import counted
from pgm.schedules import sweep
from pgm.schedules.options import Call
from pgm.schedules.schedule import Filtering, kind_of


def run(graph: DynamicGraph, bound: BoundEvidence, call: Call, asked: Asked) -> HypothesisOutcome:
    """The beliefs of a mixed chain after a call's schedule."""
    return passes(graph, bound, call, asked)[0]


def passes(
    graph: DynamicGraph, bound: BoundEvidence, call: Call, asked: Asked
) -> tuple[HypothesisOutcome, BackwardChain | None]:
    """The beliefs after a call's schedule, and the pass back; None of a filter."""
    model = graph.model
    kind = kind_of(call.schedule, "mixtures of Gaussians")
    schedule = call.schedule
    first = schedule if isinstance(schedule, Filtering) else Filtering()
    chain = chain_of(model, bound, asked, call.lineariser, first, back=kind != FILTERED)
    roles, regimes, hidden = chain.roles, chain.regimes, chain.given.hidden
    if not (model.mixed or roles.open or asked.pieces > 1):
        raise ModelError(
            "mixtures of Gaussians are of hypotheses: discrete variables that choose among CPDs of "
            "continuous ones (pgm.SwitchingCPD), or sightings that leave open what was seen "
            "(pgm.unknown); here is neither: leave belief= out, or give it starts= for several "
            "modes of a nonlinear model"
        )
    _require_once(call, roles)
    done, account = compiled.forward(chain, graph.layout.compiled)
    if done is None:
        record = Record(chain)
        sweep.forward(chain, bound.steps, record)
        done = record.swept
    total = frozen(np.sum(done.density, axis=0).reshape(bound.lead))
    residuals, converged = chain.settled()
    status = Status.of(residuals, converged, bound.lead).with_compilation(account)
    beliefs = Beliefs.of(FILTERED, hidden, done.logs, done.mean, done.cov, done.regimes)
    found = associations_of(chain)
    again = bound, call, asked
    evidence = "merged"
    if roles.robust is not None:
        affine = all(isinstance(case, AffineCPD) for case in roles.cases)
        evidence = "bound" if affine else "linearised bound"
    filtered = HypothesisOutcome(graph, status, total, evidence, beliefs, regimes, found, again)
    if kind == FILTERED:
        return filtered, None
    backward = BackwardChain(chain)
    beliefs = _smoothed(chain, backward, kind, bound.steps)
    return replace(filtered, _beliefs=beliefs, _forward=filtered), backward


def _require_once(call: Call, roles: Roles) -> None:
    """Refuse a smoother that would linearise or weigh again, which is not what is done here."""
    schedule = call.schedule
    if getattr(schedule, "iterations", 1) == 1 or isinstance(schedule, Filtering):
        return
    robust = roles.robust
    if robust is not None:
        raise ModelError(
            f"{schedule!r} weighs the readings of robust noise again at smoothed beliefs, and "
            f"mixtures of Gaussians are smoothed as the filter weighed them ({robust!r}): leave "
            "iterations out",
            cpd=robust,
        )
    nonlinear = [case for case in roles.cases if not isinstance(case, AffineCPD)]
    if nonlinear:
        raise ModelError(
            f"{schedule!r} linearises again at smoothed beliefs, and mixtures of Gaussians are "
            f"smoothed as the filter linearised them ({nonlinear[0]!r}): leave iterations out, or "
            "give them to pgm.filter; or decide what sightings by pgm.unknown are of, "
            'association="likelihood"',
            cpd=nonlinear[0],
        )


def associations_of(chain: HypothesisChain) -> Found:
    """By sensor, what its open sightings were taken for."""
    lead = chain.given.bound.lead
    return dict(
        collected(sensor.reading, sensor.probabilities(rows), sensor.unknown.count, lead)
        for sensor, rows in chain.associations.items()
        if not isinstance(sensor.unknown, Components)
    )


def _told(chain: HypothesisChain, kind: Kind, flows: Sequence[tuple[Flow, Array]]) -> Beliefs:
    """The beliefs of all steps by what flows back to each, with the logs of its regimes."""
    return Beliefs.of(
        kind,
        chain.given.hidden,
        np.stack([flow.logs for flow, _ in flows]),
        np.stack([flow.mean for flow, _ in flows]),
        np.stack([flow.cov for flow, _ in flows]),
        np.stack([regimes for _, regimes in flows]),
    )


def _smoothed(chain: HypothesisChain, backward: BackwardChain, kind: Kind, steps: int) -> Beliefs:
    """The beliefs that know the measurements up to a lag later, or all."""
    found: list[tuple[Flow, Array]] = []
    if kind == SMOOTHED:
        for step, flow, opened, _ in counted(backward.walk(steps), "back", steps + 1):
            found.append((flow, backward.regimes(step, opened)))
        return _told(chain, kind, found[::-1])
    for step in counted(range(steps + 1), "back"):
        last = kind.last(step, steps)
        flow = backward.last(last)
        opened = backward.opened(last, flow)
        for before in range(last - 1, step - 1, -1):
            flow = backward.back(before, opened)
            opened = backward.opened(before, flow)
        found.append((flow, backward.regimes(step, opened)))
    return _told(chain, kind, found)
