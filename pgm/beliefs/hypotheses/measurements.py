"""The beliefs of a mixed chain's measurements, without their own values: tables and mixtures.

A *member* is one of the M Gaussians of a step's belief, of a regime each where the sensor's CPD is
chosen by hidden variables. Members have moments (T+1, M, runs, n), of the n continuous components
of a slice, and log-weights (T+1, M, runs).
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from pgm.beliefs.hypotheses.back import BackwardChain, Flow
from pgm.beliefs.hypotheses.cases import Choices, Given, case_numbers, seen
from pgm.beliefs.hypotheses.chain import HypothesisChain
from pgm.beliefs.hypotheses.counts import leading
from pgm.beliefs.hypotheses.records import Members as StageMembers
from pgm.beliefs.hypotheses.records import Pairs
from pgm.beliefs.hypotheses.regimes import Regimes, is_regime_sensor
from pgm.beliefs.markov.measurements import at_rows
from pgm.beliefs.moments.outcomes.measurements import Expected, unweighed
from pgm.beliefs.moments.steps.diffuse import Diffuse
from pgm.beliefs.moments.steps.plan import ChainPlan
from pgm.compile import SliceGraph, SliceLayout
from pgm.cpds import CPD, ConditionalGaussian, SwitchingCPD
from pgm.cpds.caused import cases_of, components, flat
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
    def of(cls, chain: HypothesisChain, flows: Iterable[Flow]) -> Members:
        """Hypotheses of all steps, of which the regimes vary fastest, (K · S, runs)."""
        every, size, count = list(flows), chain.size, chain.regimes.size
        most = max(len(flow.logs) for flow in every)
        shape = len(every), most, chain.runs
        logs, mean = np.full(shape, -np.inf), np.zeros((*shape, size))
        cov = np.empty((*shape, size, size))
        cov[...] = np.eye(size)
        for step, flow in enumerate(every):
            own = slice(len(flow.logs))
            logs[step, own], mean[step, own], cov[step, own] = flow
        regimes = log_sum(logs.reshape(len(every), -1, count, chain.runs), 1)
        return cls(logs, mean, cov, regimes, np.tile(np.arange(count), most // count))

    @classmethod
    def predicted(cls, chain: HypothesisChain) -> Members:
        """The pairs of a chain's steps before measurements, of a forward pass that was kept."""
        return cls.of(chain, (flow_of(kept.pairs) for kept in chain.kept))

    @classmethod
    def filtered(cls, chain: HypothesisChain) -> Members:
        """The hypotheses of a chain's steps given their measurements, of a pass that was kept."""
        stages = [kept.stages[-1].members for kept in chain.kept]
        return cls.of(chain, (_by_regime(chain, each, flow_of(each)) for each in stages))

    @classmethod
    def smoothed(cls, backward: BackwardChain) -> Members:
        """The hypotheses of a chain's steps given all measurements."""
        chain, kept = backward.chain, backward.chain.kept
        flows = [
            _by_regime(chain, kept[each.step].stages[-1].members, each.opened)
            for each in backward.walk(len(kept) - 1)
        ]
        return cls.of(chain, flows[::-1])


def _by_regime(chain: HypothesisChain, members: StageMembers, flow: Flow) -> Flow:
    """Hypotheses of which regimes vary fastest, by the members of a stage.

    Members of an open sighting have any regime: they stand in each, with weight in their own alone.
    """
    if members.paired:
        return flow
    count = chain.regimes.size
    own = members.regime[:, None] == np.arange(count)[:, None]
    logs = np.where(own, flow.logs[:, None], -np.inf).reshape(-1, chain.runs)
    return Flow(logs, np.repeat(flow.mean, count, axis=0), np.repeat(flow.cov, count, axis=0))


def flow_of(some: Pairs | StageMembers) -> Flow:
    """Pairs, or members of a stage, with their probabilities and with hypotheses first."""
    size, *_, runs = some.mean.shape
    logs = leading(some.logs, some.counts, tuple(range(some.logs.ndim - 1)))
    mean, cov = some.mean.reshape(size, -1, runs), some.cov.reshape(size, size, -1, runs)
    return Flow(logs.reshape(-1, runs), components_last(mean, 1), components_last(cov, 2))


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
    reading, rows = rows_of(given.bound, layout, variable)
    return of_rows(layout, given, regimes, members, variable, reading, rows)


def of_rows(
    layout: SliceLayout,
    given: Given,
    regimes: Regimes,
    members: Members,
    variable: Variable,
    reading: Reading,
    rows: Integers,
) -> Table | GaussianMixture:
    """The belief of a sensor's measurements at some rows of its reading, as of `measurement`."""
    bound = given.bound
    if is_regime_sensor(layout.model, reading.cpd):
        shares = np.exp(members.regimes - log_sum(members.regimes, 1)[:, None])
        shares = shares.reshape(len(shares), *regimes.shape, -1)
        beliefs = [shares[t] if bound.lead else shares[t][..., 0] for t in reading.step[rows]]
        return at_rows(regimes.plan, bound, reading, variable, rows, beliefs)
    found = moments(given, regimes, members, reading)
    # The components of a mixture are members of their own.
    mean, cov = (np.concatenate(list(part), axis=1) for part in (found.mean, found.cov))
    logs = members.logs[reading.step] + found.logs[:, None, :, None]
    logs = np.concatenate(list(logs), axis=1)
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


def is_chosen(layout: SliceLayout, variable: Variable) -> bool:
    """Whether hidden variables choose the CPD of a sensor's measurement."""
    cpd = next(cpd for cpd in layout.model.observation if cpd.child == variable.template)
    return isinstance(cpd, SwitchingCPD) and any(v in layout.slice for v in cpd.switches)


class Moments(NamedTuple):
    """The moments of a measurement at its rows for each member, (K, rows, M, runs, ...).

    There are K of each member, the components of the sensor's mixture, of log-weights `logs`
    (K, M); K is one of a sensor that is none. `matrix` is that of the linearisation, over the
    slice, (K, rows, M, runs, d, n). `correlated` says that errors of the linearisations of a step's
    rows may be correlated.
    """

    logs: Array
    mean: Array
    cov: Array
    matrix: Array
    correlated: bool


def moments(given: Given, regimes: Regimes, members: Members, reading: Reading) -> Moments:
    """The moments of a sensor's measurements for each member, its CPD linearised at each."""
    _require_cases(reading, regimes, members)
    count, cpd = members.logs.shape[1], reading.cpd
    cases = {case: flat(own) for case, own in cases_of(cpd).items()}
    logs, each = [], []
    for k in range(max(map(len, cases.values()))):
        own = {case: parts[min(k, len(parts) - 1)].cpd for case, parts in cases.items()}
        weights = [parts[k].weight if k < len(parts) else 0.0 for parts in cases.values()]
        with np.errstate(divide="ignore"):
            levels = np.log(weights)
        part, number = own[next(iter(own))], np.zeros(count, dtype=np.intp)
        if isinstance(cpd, SwitchingCPD):
            part = SwitchingCPD(cpd.child, cpd.switches, own)
            number = case_numbers(regimes, part)[members.regime]
        logs.append(levels[number])
        each.append(_of_part(given, regimes, members, replace(reading, cpd=part)))
    mean, cov, matrix = (np.stack(parts) for parts in zip(*(own[:3] for own in each), strict=True))
    return Moments(np.stack(logs), mean, cov, matrix, any(own[3] for own in each))


def _of_part(
    given: Given, regimes: Regimes, members: Members, reading: Reading
) -> tuple[Array, Array, Array, bool]:
    """The moments of a sensor that is no mixture, (rows, M, runs, ...), as of `Moments`."""
    cpd, bound = reading.cpd, given.bound
    choices, (count, runs) = Choices(regimes, [cpd]), members.logs.shape[1:]
    number = np.zeros(count, dtype=np.intp)
    if members.regime is not None:
        number = choices.of[members.regime]
    rows, size, wide = reading.step.size, cpd.child.dimension, members.mean.shape[-1]
    mean, cov = np.empty((rows, count, runs, size)), np.empty((rows, count, runs, size, size))
    matrix = np.zeros((rows, count, runs, size, wide))
    correlated, places = False, np.arange(wide)
    values, taken = (np.broadcast_to(each, (rows, 1, size)) for each in (0.0, False))
    for group in choices.alike:
        own = np.flatnonzero(np.isin(number, group))
        if not own.size:
            continue
        (case,) = choices.at(number[own], 1, bound.lead)
        inputs = {
            v: each if each.shape[1] == 1 else np.concatenate([each] * own.size, axis=1)
            for v, each in seen(case, reading.inputs).items()
        }
        unread = replace(reading, cpd=case, inputs=inputs, values=values, taken=taken)
        lead = (own.size * runs,)
        part = BoundEvidence(bound.steps, lead, (), (unread,), bound.first_run, own_runs=runs)
        graph = SliceGraph(given.network(observation=[case]), bound.steps, False)
        plan = ChainPlan.make(graph, part, given.lineariser, first=given.first, prior=False)
        (sensor,), shape = plan.sensors, (len(members.mean), *lead)
        at = members.mean[:, own].reshape(*shape, wide)
        spread = Diffuse.known(members.cov[:, own].reshape(*shape, wide, wide))
        family = unweighed(sensor, at, spread, first=given.first)
        found = Expected.of(family, sensor.parents, at, spread, first=given.first)
        mean[:, own] = found.mean.reshape(rows, own.size, runs, size)
        cov[:, own] = found.spread.cov.reshape(rows, own.size, runs, size, size)
        over = np.zeros((rows, *lead, size, wide))
        over[..., places[sensor.parents]] = family.matrix
        matrix[:, own] = over.reshape(rows, own.size, runs, size, wide)
        correlated |= sensor.is_correlated
    return mean, cov, matrix, correlated


def _require_cases(reading: Reading, regimes: Regimes, members: Members) -> None:
    """Refuse a sensor whose measurement has no mixture of Gaussians that is known here."""
    cpd: CPD = reading.cpd
    why = ""
    if reading.unknown is not None:
        why = "its sightings leave open what was seen"
    others = [part for part in components(cpd) if not isinstance(part, ConditionalGaussian)]
    if others:
        why = f"{others[0]!r} is no Gaussian, nor a mixture of such; its own sample() draws"
    if isinstance(cpd, SwitchingCPD):
        if any(v not in regimes.variables for v in cpd.switches):
            why = "observed variables choose its CPD"
        elif members.regime is None:
            why = (
                "hidden variables choose its CPD, with which the Gaussians of a fixed lag are not "
                f"kept; posterior.predicted[{cpd.child.name}] has the belief before its step"
            )
    if why:
        raise Unanswered(f"{cpd.child!r} has no belief: {why}", variable=cpd.child)
