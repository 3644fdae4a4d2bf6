"""The beliefs of a mixed chain's measurements, without their own values: tables and mixtures.

A *member* is one of the M Gaussians of a step's belief, of a regime each where the sensor's CPD is
chosen by hidden variables. Members have moments (T+1, M, runs, n), of the n continuous components
of a slice, and log-weights (T+1, M, runs).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from pgm.beliefs.hypotheses.cases import Choices, Given, seen
from pgm.beliefs.hypotheses.chain import HypothesisChain
from pgm.beliefs.hypotheses.counts import leading
from pgm.beliefs.hypotheses.regimes import Regimes, is_regime_sensor
from pgm.beliefs.markov.measurements import at_rows
from pgm.beliefs.moments.outcomes.measurements import expected
from pgm.beliefs.moments.steps.diffuse import Diffuse
from pgm.beliefs.moments.steps.plan import ChainPlan
from pgm.compile import SliceGraph, SliceLayout
from pgm.cpds import CPD, ConditionalGaussian, SwitchingCPD
from pgm.errors import Unanswered
from pgm.evidence import BoundEvidence, Reading
from pgm.factors import Gaussian, GaussianMixture, Table
from pgm.kernels.arrays import Array, Integers, components_last
from pgm.kernels.semirings import log_sum
from pgm.posteriors.measurements import read_by, require_unread, rows_of
from pgm.variables import Variable


@dataclass(frozen=True, eq=False)
class Members:
    """The Gaussians of all steps, and the log-probabilities of the S regimes, (T+1, S, runs).

    `regime` (M,) is the regime of each member at all steps; None where a member may be of several.
    """

    logs: Array
    mean: Array
    cov: Array
    regimes: Array
    regime: Integers | None

    @classmethod
    def predicted(cls, chain: HypothesisChain) -> Members:
        """The pairs of a chain's steps before measurements, of a forward pass that was kept."""
        size, count, runs = chain.size, chain.regimes.size, chain.runs
        most = max(len(kept.pairs.logs) for kept in chain.kept)
        shape, steps = (most, count, runs), len(chain.kept)
        logs = np.full((steps, *shape), -np.inf)
        mean, cov = np.zeros((steps, *shape, size)), np.zeros((steps, *shape, size, size))
        cov[...] = np.eye(size)
        for step, kept in enumerate(chain.kept):
            own, *moments = kept.pairs.logs, kept.pairs.mean, kept.pairs.cov
            logs[step, : len(own)] = leading(own, kept.pairs.counts, (0, 1))
            mean[step, : len(own)] = components_last(moments[0], 1)
            cov[step, : len(own)] = components_last(moments[1], 2)
        regimes = log_sum(logs, 1)
        flat = most * count, runs
        return cls(
            logs.reshape(steps, *flat),
            mean.reshape(steps, *flat, size),
            cov.reshape(steps, *flat, size, size),
            regimes,
            np.tile(np.arange(count), most),
        )


def measurement(
    layout: SliceLayout,
    given: Given,
    regimes: Regimes,
    members: Members,
    variable: Variable,
) -> Table | GaussianMixture:
    """The belief of a sensor's measurement, ``z`` by row or ``z.at(3)``, given members of slices.

    Rows are as of `Posterior.predicted`. Each case of the CPD is linearised at each member.
    """
    bound = given.bound
    reading, rows = rows_of(bound, layout, variable)
    if is_regime_sensor(layout.model, reading.cpd):
        shares = np.exp(members.regimes - log_sum(members.regimes, 1)[:, None])
        shares = shares.reshape(len(shares), *regimes.shape, -1)
        beliefs = [shares[t] if bound.lead else shares[t][..., 0] for t in reading.step[rows]]
        return at_rows(regimes.plan, bound, reading, variable, rows, beliefs)
    mean, cov = _moments(given, regimes, members, reading)
    logs = members.logs[reading.step]
    weights = np.exp(logs - log_sum(logs, 1)[:, None])

    def out(part: Array) -> Array:
        """Values (rows, M, runs, ...) as (*lead, [rows], M, ...)."""
        whole = np.moveaxis(part[rows], 2, 0)
        whole = whole[:, 0] if variable.step is not None else whole
        return whole.reshape(*bound.lead, *whole.shape[1:])

    some = (weights[rows] > 0.0).any(axis=(0, 2))
    gaussian = Gaussian._make((variable,), out(mean[:, some]), out(cov[:, some]))
    steps = None if variable.step is not None else reading.step[rows]
    return GaussianMixture._make(out(weights[:, some]), gaussian, steps)


def unread(
    layout: SliceLayout, given: Given, regimes: Regimes, members: Members, variable: Variable
) -> Table | GaussianMixture:
    """The belief of a measurement that was not taken, as of `measurement`."""
    reading = read_by(given.bound, variable)
    if reading is not None:
        require_unread(variable, reading.step, reading.taken)
    return measurement(layout, given, regimes, members, variable)


def _moments(
    given: Given, regimes: Regimes, members: Members, reading: Reading
) -> tuple[Array, Array]:
    """The moments of a measurement at its rows for each member, (rows, M, runs, ...)."""
    cpd, bound = reading.cpd, given.bound
    _require_cases(reading, regimes, members)
    choices, (count, runs) = Choices(regimes, [cpd]), members.logs.shape[1:]
    number = np.zeros(count, dtype=np.intp)
    if members.regime is not None:
        number = choices.of[members.regime]
    rows, size = reading.step.size, cpd.child.dimension
    mean, cov = np.empty((rows, count, runs, size)), np.empty((rows, count, runs, size, size))
    for group in choices.alike:
        own = np.flatnonzero(np.isin(number, group))
        if not own.size:
            continue
        (case,) = choices.at(number[own], 1, bound.lead)
        inputs = {
            v: each if each.shape[1] == 1 else np.concatenate([each] * own.size, axis=1)
            for v, each in seen(case, reading.inputs).items()
        }
        part = BoundEvidence(
            bound.steps,
            (own.size * runs,),
            (),
            (),
            bound.first_run,
            own_runs=runs,
            unread=(replace(reading, cpd=case, inputs=inputs),),
        )
        graph = SliceGraph(given.network(observation=[case]), bound.steps, False)
        plan = ChainPlan.make(graph, part, given.lineariser, prior=False)
        shape = len(members.mean), own.size * runs
        at = members.mean[:, own].reshape(*shape, -1)
        spread = Diffuse.known(members.cov[:, own].reshape(*shape, *members.cov.shape[-2:]))
        found = expected(plan, case.child, at, spread)
        mean[:, own] = found.mean.reshape(rows, own.size, runs, size)
        cov[:, own] = found.spread.cov.reshape(rows, own.size, runs, size, size)
    return mean, cov


def _require_cases(reading: Reading, regimes: Regimes, members: Members) -> None:
    """Refuse a sensor whose measurement has no mixture of Gaussians that is known here."""
    cpd: CPD = reading.cpd
    why = ""
    if reading.unknown is not None:
        why = "its sightings leave open what was seen"
    cases = list(cpd.cases.values()) if isinstance(cpd, SwitchingCPD) else [cpd]
    if not all(isinstance(case, ConditionalGaussian) for case in cases):
        why = "a case of its CPD is not Gaussian"
    if isinstance(cpd, SwitchingCPD):
        if any(v not in regimes.variables for v in cpd.switches):
            why = "observed variables choose its CPD"
        elif members.regime is None:
            why = (
                "hidden variables choose its CPD, with which these Gaussians are not kept; "
                f"posterior.predicted[{cpd.child.name}] has the belief before its step"
            )
    if why:
        raise Unanswered(f"{cpd.child!r} has no belief: {why}", variable=cpd.child)
