"""Expectations of a mixed chain's CPDs, for learning: hypotheses are runs, with weights.

A pair of a Gaussian and a regime, given all evidence, holds of the CPDs that its regime chooses.
The belief of such a CPD's family has all pairs of each step, one run of the user's after another,
and their weights: the probabilities of the pairs, zero where the regime chooses another case.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from pgm.beliefs.hypotheses.back import BackwardChain, Flow, TwoSlices
from pgm.beliefs.hypotheses.cases import seen, stand_in
from pgm.beliefs.hypotheses.records import Members
from pgm.beliefs.markov.counts import Tally
from pgm.beliefs.moments.steps.plan import ChainPlan, Link
from pgm.compile import DynamicGraph, SliceGraph
from pgm.cpds import SwitchingCPD
from pgm.evidence import Reading
from pgm.evidence.dynamic import Inputs
from pgm.kernels import merging
from pgm.kernels.arrays import Array, Integers, Mask, block
from pgm.networks import DynamicBayesianNetwork
from pgm.posteriors.expectations import (
    PRIOR,
    TRANSITION,
    Expectations,
    FamilyBelief,
    Learnable,
)
from pgm.variables import Discrete


def expectations(
    backward: BackwardChain, graph: DynamicGraph, parts: Sequence[Learnable]
) -> Expectations:
    """The expected counts and family beliefs of some CPDs, by a pass back."""
    return _Expected(backward, graph.model, parts).found()


class _Expected:
    """The pass back, and what is kept of it: pairs by step, and the members of each step."""

    def __init__(
        self, backward: BackwardChain, model: DynamicBayesianNetwork, parts: Sequence[Learnable]
    ) -> None:
        self.backward, self.model, self.parts = backward, model, parts
        self.chain = backward.chain
        self.regimes, self.bound = self.chain.regimes, self.chain.given.bound
        self.pairs: list[TwoSlices] = []
        self.members: list[Flow] = []

    def found(self) -> Expectations:
        """The expectations."""
        regimes, steps = self.regimes, self.bound.steps
        tally = Tally(self.model, self.bound, self.parts)
        now = {v: k for k, v in enumerate(regimes.variables) if v in regimes.hidden}
        remembered = regimes.remembered
        both = {v.previous: k for k, v in enumerate(remembered)}
        both |= {v: len(remembered) + k for v, k in now.items()}
        for step, _, opened, two in self.backward.walk(steps):
            self.members.append(opened)
            shares = _shares(self.backward.regimes(step, opened))
            belief = np.moveaxis(shares, -1, 0).reshape(-1, *regimes.shape)
            tally.add_readings(step, belief, now)
            if two is None:
                tally.add_prior(belief, now)
                continue
            self.pairs.append(two)
            if tally.moving:
                joint = np.moveaxis(np.exp(self.backward.by_memory(step, two)), -1, 0)
                sizes = [v.size for v in remembered]
                tally.add_motion(step, joint.reshape(-1, *sizes, *regimes.shape), both)
        self.members.reverse()
        self.pairs.reverse()
        parts = [part for part in self.parts if part not in tally.counts]
        return Expectations(
            tally.counts, {part: self._belief(part) for part in parts if self._has_rows(part)}
        )

    def _has_rows(self, part: Learnable) -> bool:
        """Whether there is a step or a measurement that tells of a CPD."""
        if part.role == TRANSITION:
            return self.bound.steps > 0
        return part.role == PRIOR or any(
            each.cpd is part.cpd and each.step.size for each in self.bound.readings
        )

    def _belief(self, part: Learnable) -> FamilyBelief:
        """The belief of a CPD's family, with its weights."""
        if part.role == PRIOR:
            return self._of_prior(part)
        if part.role == TRANSITION:
            return self._of_motion(part)
        return self._of_sensor(part)

    def _of_prior(self, part: Learnable) -> FamilyBelief:
        members, flow = self._members(0), self.members[0]
        copies = len(flow.logs)
        prior = [
            part.own if cpd is part.cpd else stand_in(cpd.child) for cpd in self.chain.roles.prior
        ]
        plan = self._plan(
            SliceGraph(self.chain.given.network(prior=prior), 0, False), copies, prior=True
        )
        link = next(each for each in plan.prior if each.family.cpd is part.own)
        states = plan.layout.state_places
        mean = flow.mean[None][..., states]
        cov = block(flow.cov[None], states, states)
        weights = self._weights(part, flow.logs, members.regime)[None]
        return _linked(link, *_living(mean, cov, weights, _shares(flow.logs)[None]))

    def _of_motion(self, part: Learnable) -> FamilyBelief:
        roles, given = self.chain.roles, self.chain.given
        cpds = [part.own if cpd is part.cpd else stand_in(cpd.child) for cpd in roles.transition]
        logs = np.stack([two.logs for two in self.pairs])
        mean = np.stack([two.mean for two in self.pairs])
        cov = np.stack([two.cov for two in self.pairs])
        steps, copies, count, runs = logs.shape
        graph = SliceGraph(given.network(transition=cpds), self.bound.steps, False)
        inputs = [
            seen(own, each) if own is part.own else {}
            for own, each in zip(cpds, roles.inputs, strict=True)
        ]
        plan = self._plan(graph, copies * count, inputs)
        link = next(each for each in plan.transition if each.family.cpd is part.own)
        weights = np.stack(
            [self._paired(part, step, two.logs) for step, two in enumerate(self.pairs, 1)]
        )
        size = self.chain.size
        first = np.arange(size)[plan.layout.state_places]
        places = np.concatenate([first, size + np.arange(size)])
        shape = steps, copies * count, runs
        shares = np.stack([_shares(each.logs.reshape(-1, runs)) for each in self.pairs])
        mean = mean[..., places].reshape(*shape, -1)
        cov = block(cov, places, places).reshape(*shape, len(places), len(places))
        return _linked(link, *_living(mean, cov, weights.reshape(shape), shares))

    def _of_sensor(self, part: Learnable) -> FamilyBelief:
        given = self.chain.given
        reading = next(each for each in self.bound.readings if each.cpd is part.cpd)
        own = replace(reading, cpd=part.own, inputs=seen(part.own, reading.inputs))
        copies = max(len(self.members[step].logs) for step in set(reading.step.tolist()))
        graph = SliceGraph(given.network(observation=[part.own]), self.bound.steps, False)
        plan = self._plan(graph, copies, readings=[own])
        (sensor,) = plan.sensors
        size, runs, rows = self.chain.size, self.chain.runs, reading.step.size
        mean = np.zeros((rows, copies, runs, size))
        cov = np.zeros((rows, copies, runs, size, size))
        weights, shares = np.zeros((rows, copies, runs)), np.zeros((rows, copies, runs))
        for row, step in enumerate(reading.step.tolist()):
            flow, regime = self.members[step], self._members(step).regime
            some = slice(len(flow.logs))
            mean[row, some], cov[row, some] = flow.mean, flow.cov
            shares[row, some] = _shares(flow.logs)
            weights[row, some] = self._weights(part, flow.logs, regime, reading, row)
        mean, cov, weights = _living(mean, cov, weights, shares)
        everywhere = np.arange(size)[sensor.parents]
        return FamilyBelief(
            sensor.family,
            mean[..., everywhere],
            block(cov, everywhere, everywhere),
            sensor.values,
            sensor.taken,
            weights,
        )

    def _plan(
        self,
        graph: DynamicGraph,
        copies: int,
        inputs: Sequence[Inputs] = (),
        readings: Sequence[Reading] = (),
        *,
        prior: bool = False,
    ) -> ChainPlan:
        """The plan of a network of one CPD and stand-ins, on so many hypotheses of each run."""
        steps = 0 if prior else self.bound.steps
        own = replace(
            self.bound, steps=steps, transition=tuple(inputs), readings=tuple(readings), form=None
        )
        return ChainPlan.make(graph, own.repeated(copies), self.chain.given.lineariser, prior=prior)

    def _members(self, step: int) -> Members:
        """The last members of a step."""
        return self.chain.kept[step].stages[-1].members

    def _chosen(self, part: Learnable, known: Sequence[Discrete] = ()) -> Mask:
        """The regimes that choose a part, by memory before them, (memories or 1, regimes).

        Variables whose states are `known` are left to others.
        """
        found: Mask = np.ones((1, self.regimes.size), dtype=bool)
        for variable, state in _states(part):
            if variable not in known:
                found = found & (self.regimes.states(variable) == state)
        return found

    def _weights(
        self,
        part: Learnable,
        logs: Array,
        regime: Integers,
        reading: Reading | None = None,
        row: int = 0,
    ) -> Array:
        """The probabilities that a part holds of the members of a step, (members, runs)."""
        known = () if reading is None else [v for v, _ in _states(part) if v in reading.inputs]
        (chosen,) = self._chosen(part, known)
        found = np.where(chosen[regime], _shares(logs), 0.0)
        for variable, state in _states(part):
            if reading is not None and variable in known:
                found = np.where(reading.inputs[variable][row, :, 0] == state, found, 0.0)
        return found

    def _paired(self, part: Learnable, step: int, logs: Array) -> Array:
        """The probabilities that a part holds of the pairs of a step, (K, S, runs)."""
        chosen = self._chosen(part)
        shares = _shares(logs.reshape(-1, logs.shape[-1])).reshape(logs.shape)
        if len(chosen) == 1:
            return np.where(chosen[0][:, None], shares, 0.0)
        memory = self.chain.kept[step - 1].known.memory
        return np.where(np.moveaxis(chosen[memory], -1, 1), shares, 0.0)


def _states(part: Learnable) -> list[tuple[Discrete, int]]:
    """The discrete variables that choose a part, each with its state; none of a plain CPD."""
    if not isinstance(part.cpd, SwitchingCPD):
        return []
    assert part.case is not None
    return list(zip(part.cpd.switches, part.case, strict=True))


def _shares(logs: Array) -> Array:
    """The probabilities of log-weights (hypotheses, runs)."""
    found: Array = np.exp(merging.normalised(logs)[0])
    return found


def _linked(link: Link, mean: Array, cov: Array, weights: Array) -> FamilyBelief:
    """The belief of a link's family, by the moments of the vector in which it has its places."""
    everywhere = np.arange(mean.shape[-1])
    chosen = np.concatenate([everywhere[link.parents], everywhere[link.child]])
    return FamilyBelief(
        link.family, mean[..., chosen], block(cov, chosen, chosen), None, None, weights
    )


def _living(mean: Array, cov: Array, weights: Array, shares: Array) -> tuple[Array, Array, Array]:
    """Hypotheses (rows, hypotheses, runs) as runs, (rows, hypotheses · runs).

    Those of weight zero, at whose moments a function may have no value, get the moments of the
    likeliest of their row and run, by its share.
    """
    best = shares.argmax(axis=1)[:, None]
    dead = weights == 0.0
    mean = np.where(dead[..., None], np.take_along_axis(mean, best[..., None], axis=1), mean)
    likeliest = np.take_along_axis(cov, best[..., None, None], axis=1)
    cov = np.where(dead[..., None, None], likeliest, cov)
    rows, runs = len(mean), mean.shape[1] * mean.shape[2]
    size = mean.shape[-1]
    return (
        mean.reshape(rows, runs, size),
        cov.reshape(rows, runs, size, size),
        weights.reshape(rows, runs),
    )
