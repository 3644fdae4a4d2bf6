"""Draws of all variables, with their weights: trajectories of a chain, networks without time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pgm.errors import GraphError, NumericalError
from pgm.factors.scope import positions
from pgm.inference.audit.density import Term, has_exact
from pgm.inference.audit.draws import PREDICTED, Draws, Excursions, Proposal, Strand
from pgm.inference.audit.estimates import Sums
from pgm.inference.chain import backward
from pgm.inference.chain.backward import Beliefs, Reverse
from pgm.inference.chain.plan import ChainPlan, Link
from pgm.inference.chain.posterior import ChainPosterior
from pgm.inference.chain.sensor import Sensor
from pgm.inference.gaussian.model import Model
from pgm.inference.gaussian.posterior import GaussianPosterior
from pgm.inference.status import SMOOTHED
from pgm.kernels import moments
from pgm.kernels.arrays import Array, Mask, block, symmetric, transpose
from pgm.kernels.moments import Conditional

Links = list[tuple[Link, Term]]


@dataclass(frozen=True, eq=False)
class ChainDraws:
    """Trajectories from the smoothed Gaussian, drawn forward in time, with their log-weights.

    Proposals are of the states at step 0, `first`, and of each later slice given the states before.
    `reference` (runs,) is common to all log-weights: the linearised model's evidence, where they
    are `relative` to its densities. `judged` (T+1,) are the steps whose beliefs know all
    measurements; `onward` are the conditionals of slices, with their fixed components.
    """

    plan: ChainPlan
    first: Proposal
    later: Proposal
    prior: Links
    transition: Links
    sensors: list[tuple[Sensor, Term]]
    reference: Array
    relative: bool
    beliefs: Beliefs
    judged: Mask
    onward: Conditional

    @classmethod
    def make(cls, posterior: ChainPosterior) -> ChainDraws:
        """Prepare to draw from the smoothed joint of a posterior's linearisation."""
        plan = posterior._plan
        exact = has_exact(s.family for s in plan.sensors if s.family.step.size)
        reverse = posterior._reverse
        smoothed = posterior.kind == SMOOTHED
        beliefs = posterior._beliefs if smoothed else backward.sweep(posterior._forward, reverse)
        steps = range(plan.steps + 1)
        judged = np.array([posterior.kind.last(k, plan.steps) == plan.steps for k in steps])
        draws = cls._make(plan, beliefs, reverse, None, judged)
        if not exact and draws.first.regular and draws.later.regular:
            return draws
        # The draws' support is the linearised model's: weights are relative to its densities, with
        # its own means, which step control may have held back.
        _refuse_grouped(plan)
        forward = posterior._forward
        reverse = Reverse.make(plan, forward)
        beliefs = backward.sweep(forward, reverse)
        return cls._make(plan, beliefs, reverse, forward.log_density.sum(axis=0), judged)

    @classmethod
    def _make(
        cls,
        plan: ChainPlan,
        beliefs: Beliefs,
        reverse: Reverse,
        reference: Array | None,
        judged: Mask,
    ) -> ChainDraws:
        relative = reference is not None
        prior, transition = (
            [(link, Term.make(link.family, relative=relative)) for link in links]
            for links in (plan.prior, plan.transition)
        )
        states, front = plan.layout.state_places, plan.layout.state_size
        mean = beliefs.mean[..., states]
        cov = block(beliefs.cov, states, states)
        nothing = np.zeros((1, *cov.shape[1:-1], 0))
        later = moments.reverse(
            beliefs.mean[1:],
            beliefs.cov[1:],
            reverse.states.matrix,
            reverse.states.cov,
            mean[:-1],
            cov[:-1],
        )
        free = _free(transition, (plan.steps, *beliefs.mean.shape[1:]), front)
        return cls(
            plan,
            Proposal.make(Conditional(nothing, mean[:1], cov[:1]), _free(prior, mean[:1].shape, 0)),
            Proposal.make(later, free),
            prior,
            transition,
            [
                (sensor, Term.make(sensor.family, relative=relative, taken=sensor.taken))
                for sensor in plan.sensors
            ],
            np.zeros(plan.runs) if reference is None else reference,
            relative,
            beliefs,
            judged,
            later,
        )

    @property
    def width(self) -> int:
        """See `Drawing`."""
        size = self.plan.layout.state_size + 2 * self.plan.layout.slice_size
        seen = [
            np.diff(sensor.bounds).max() * sum(sensor.family.shape[2:])
            for sensor in self.plan.sensors
        ]
        return size + int(max(seen, default=0))

    @property
    def length(self) -> int:
        """See `Drawing`."""
        layout = self.plan.layout
        return (self.plan.steps + 1) * (layout.state_size + layout.slice_size)

    def sums(self) -> list[Sums]:
        """Empty sums of each hidden variable, of the states, and of clusters that are judged."""
        layout, judged = self.plan.layout, self.judged
        mean, cov = self.beliefs.mean, self.beliefs.cov
        front = layout.state_size
        alone = [(variable,) for variable in layout.slice]
        sums = []
        for scope in dict.fromkeys([*alone, layout.states]):
            first = 0 if set(scope) <= set(layout.states) else 1
            places = np.arange(layout.slice_size)[positions(layout.slice, scope)]
            sums.append(
                Sums(
                    scope,
                    front + places,
                    first,
                    mean[first:][..., places],
                    block(cov[first:], places, places),
                    judged[first:],
                    timed=True,
                )
            )
        known = judged[1:] & judged[:-1]
        if known.any():
            states, (matrix, _, rest) = layout.state_places, self.onward
            before = block(cov[:-1], states, states)
            cross = matrix @ before
            slices = symmetric(cross @ transpose(matrix) + rest)
            means = np.concatenate([mean[:-1][..., states], mean[1:]], axis=-1)
            pair = np.block([[before, transpose(cross)], [cross, slices]])
            sums.append(Sums(layout.pair, slice(None), 1, means, pair, known, timed=True))
        return sums

    def draw(self, count: int, rng: np.random.Generator, *, defensive: bool) -> Draws:
        """See `Drawing`."""
        plan, layout = self.plan, self.plan.layout
        shape, places, front = (plan.runs, count), layout.state_places, layout.state_size
        total = np.repeat(self.reference[:, None], count, axis=1)
        strand = Strand(self.excursions, shape, rng, defensive, self.relative)
        states, values = np.zeros((*shape, 0)), []
        for step in range(plan.steps + 1):
            links, proposal = (self.transition, self.later) if step else (self.prior, self.first)
            row = max(step - 1, 0)
            fresh, afresh = strand.propose(proposal, row, states)
            vector = np.concatenate([states, fresh], axis=-1)
            start = states.shape[-1]
            predicted = np.zeros(shape)
            for link, term in links:
                drawn = term.child(row, vector[..., link.parents], vector[..., link.child], afresh)
                vector[..., link.child] = drawn.values
                predicted += drawn.log_tails
                total += np.where(drawn.lost, np.nan, drawn.log_density)
            strand.weigh(proposal, row, states, vector[..., start:], predicted)
            if step:
                pair = vector
            else:
                pair = np.zeros((*shape, front + layout.slice_size))
                pair[..., front:][..., places] = vector
            slices = pair[..., front:]
            total += self._readings(step, slices, strict=not defensive)
            values.append(pair)
            states = slices[..., places]
        return strand.drawn(total, values)

    def _readings(self, step: int, slices: Array, *, strict: bool) -> Array:
        total = np.zeros(slices.shape[:2])
        for sensor, term in self.sensors:
            rows = sensor.rows(step)
            if rows.start == rows.stop:
                continue
            parents = slices[..., sensor.parents]
            total += term.readings(
                rows,
                np.broadcast_to(parents, (rows.stop - rows.start, *parents.shape)),
                sensor.values[rows],
                sensor.moved[rows],
                strict=strict,
            )
        return total

    @property
    def excursions(self) -> Excursions:
        """Where defensive draws leave the Gaussian; beside exact readings the model draws none."""
        return Excursions(self.plan.steps + 1, 0.0 if self.relative else PREDICTED)


def _free(links: Links, shape: tuple[int, ...], start: int) -> Mask:
    free = np.zeros(shape, dtype=bool)
    for link, term in links:
        free[..., link.child.start - start : link.child.stop - start] = term.free()
    return free


def _refuse_grouped(plan: ChainPlan) -> None:
    for sensor in plan.sensors:
        if sensor.cross:
            raise NumericalError(
                f"{sensor.family.cpd!r} is grouped: the approximation errors of a step's sightings "
                "are correlated, which is not audited beside a sensor without noise or a "
                "covariance too near to singular; leave grouped=True out, or give the exact sensor "
                "some noise",
                variable=sensor.variable,
                cpd=sensor.family.cpd,
            )


@dataclass(frozen=True, eq=False)
class TreeDraws:
    """Draws from the joint Gaussian of a calibrated tree, all at once; see `ChainDraws`."""

    model: Model
    proposal: Proposal
    terms: list[Term]
    reference: Array
    relative: bool
    mean: Array
    cov: Array

    @classmethod
    def make(cls, posterior: GaussianPosterior) -> TreeDraws:
        """Prepare to draw from the joint of a posterior."""
        if posterior.log_evidence_kind == "bethe":
            raise GraphError(
                f"{posterior._title}: an audit draws from the joint of all variables, which only a "
                "calibrated tree has; infer on pgm.compile(network)"
            )
        model = posterior._model
        every = zip(model.layout.groups, model.families, strict=True)
        exact = has_exact(family for group, family in every if group.observed)
        draws = cls._make(posterior, relative=False)
        if exact or not draws.proposal.regular:
            return cls._make(posterior, relative=True)
        return draws

    @classmethod
    def _make(cls, posterior: GaussianPosterior, *, relative: bool) -> TreeDraws:
        model = posterior._model
        layout, runs = model.layout, model.runs
        mean, cov = np.zeros((runs, 0)), np.zeros((runs, 0, 0))
        if layout.size:
            joint = posterior.joint(*layout.hidden)
            mean, cov = joint.mean.reshape(runs, -1), joint.cov.reshape(runs, *joint.cov.shape[-2:])
        terms = [
            Term.make(family, relative=relative, taken=taken)
            for family, taken in zip(model.families, model.taken, strict=True)
        ]
        free = np.zeros((1, *mean.shape), dtype=bool)
        for group, term in zip(layout.groups, terms, strict=True):
            mask = term.free()
            for row, child in enumerate(() if group.observed else group.child):
                free[0][:, child] = mask[row if mask.shape[0] > 1 else 0]
        proposal = Proposal.make(
            Conditional(np.zeros((1, *mean.shape, 0)), mean[None], cov[None]), free
        )
        known = posterior.log_evidence.reshape(runs) if relative else np.zeros(runs)
        return cls(model, proposal, terms, known, relative, mean[None], cov[None])

    @property
    def width(self) -> int:
        """See `Drawing`."""
        return 3 * self.model.layout.size

    @property
    def length(self) -> int:
        """See `Drawing`."""
        return self.model.layout.size

    def sums(self) -> list[Sums]:
        """See `Drawing`."""
        layout, every = self.model.layout, np.ones(1, dtype=bool)
        alone = [(variable,) for variable in layout.hidden]
        sums = []
        for scope in dict.fromkeys([*alone, *filter(None, layout.scopes)]):
            places = layout.components(scope)
            cov = block(self.cov, places, places)
            sums.append(Sums(scope, places, 0, self.mean[..., places], cov, every, timed=False))
        return sums

    def draw(self, count: int, rng: np.random.Generator, *, defensive: bool) -> Draws:
        """So many draws a run: defensive ones follow the prior, or have Student tails."""
        model = self.model
        total = np.repeat(self.reference[:, None], count, axis=1)
        excursions = Excursions(1, 0.0 if self.relative else PREDICTED)
        strand = Strand(excursions, total.shape, rng, defensive, self.relative)
        nothing = np.zeros((*total.shape, 0))
        values, afresh = strand.propose(self.proposal, 0, nothing)
        predicted = np.zeros(total.shape)
        for g, row in model.layout.order:
            group, term = model.layout.groups[g], self.terms[g]
            parents = values[..., group.parents[row]]
            if group.observed:
                given, moved = model.readings[g], model.moved[g]
                assert given is not None
                assert moved is not None
                rows = slice(row, row + 1)
                total += term.readings(
                    rows, parents[None], given[rows], moved[rows], strict=not defensive
                )
            else:
                child = group.child[row]
                drawn = term.child(row, parents, values[..., child], afresh)
                values[..., child] = drawn.values
                predicted += drawn.log_tails
                total += np.where(drawn.lost, np.nan, drawn.log_density)
        strand.weigh(self.proposal, 0, nothing, values, predicted)
        return strand.drawn(total, [values])
