"""The particle filter of all runs, step by step: its beliefs are clouds of weighted particles.

At each step the particles are resampled, if their weights have grown unequal: they are drawn anew
in proportion to the weights, which are equal then. Every particle is moved and weighed,

    x_t^i ~ q(x_t | x_{t−1}^a),
    w_t^i ∝ w_{t−1}^a p(x_t^i | x_{t−1}^a) p(z_t | x_t^i) / q(x_t^i | x_{t−1}^a).

Here a is the index of its *ancestor*, the particle of step t − 1 that it is moved from, z_t are the
measurements of step t, and q is the transition or a proposal. The weights of a step, before they
are normalised, sum to an estimate of p(z_t | z_0..t−1); the product of these estimates over the
steps estimates p(z_0..t) without bias (Del Moral, Feynman–Kac formulae, 2004, section 7.4).

A *cloud* has the particles of all runs at one step, with their weights; d is the number of the
components of a state. The *place* of a particle is its index along the last axis of a cloud's
arrays, which have the particles of run 0 first. `Some` holds the particles at which CPDs are
evaluated: their states at the step and at the step before, and their runs. `Drawing` holds the
generators of these particles' random numbers.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple, NoReturn

import numpy as np

from pgm.beliefs.particles.guided_proposal import Guide
from pgm.beliefs.particles.number import KLDSampling, LikelihoodSampling
from pgm.beliefs.particles.record import Record
from pgm.beliefs.particles.settings import IGNORE, RAISE, RESTART, Injection, ParticleSettings
from pgm.beliefs.points.cloud import Cloud, uniform
from pgm.beliefs.points.laws import Drawing, Some, States
from pgm.beliefs.points.model import ParticleModel
from pgm.beliefs.points.streams import FORWARD, INJECTED, RESTARTED, STARTED, stream
from pgm.compile import DynamicGraph
from pgm.errors import EvidenceError
from pgm.factors.scope import listed
from pgm.kernels.arrays import Array, Integers, Mask
from pgm.kernels.resampling import RESAMPLERS, indices
from pgm.variables import Variable

Generators = Sequence[np.random.Generator]


class Placed(NamedTuple):
    """Draws of one state variable at step 0, from a proposal over cells instead of its prior.

    variable: The state variable, of d components.
    states: Its draws, one for each particle, (d, particles).
    log_density: The proposal's log-density at each draw, (particles,).
    """

    variable: Variable
    states: States
    log_density: Array


class ParticleChain:
    """A particle filter of all runs at once.

    A forward sweep calls `start` once, `predict` at each later step, and `take` at every step.

    model: The network with its evidence.
    particles: The user's choice of particles: their number, proposal, resampling and so on. Its
        `start`, if there is one, is a proposal over cells: one state variable is drawn at step 0
        from the cells at which that step's measurements are likely, instead of from its prior.
    record: The record of the sweep, in which resampling, injection and impossible steps are noted.
    guide: Steers draws towards their step's measurements; None if the user gave no proposal.
    """

    def __init__(
        self,
        graph: DynamicGraph,
        model: ParticleModel,
        particles: ParticleSettings,
        record: Record,
    ) -> None:
        self.model, self.particles, self.record = model, particles, record
        proposal = particles.proposal
        self.guide = None if proposal is None else Guide(graph, model, proposal)

    def generators(self, step: int, purpose: int = FORWARD) -> Generators:
        """The random generators of a step's draws, one for each run.

        purpose: What is drawn: the filter's particles (FORWARD), those of a run that begins anew
            from the prior (RESTARTED), or states from cells, at step 0 (STARTED) or for an
            injection (INJECTED). Each purpose has random numbers of its own.
        """
        first = self.model.bound.first_run
        runs = range(first, first + self.model.bound.runs)
        return [stream(self.particles.seed, run, step, purpose) for run in runs]

    def start(self) -> Cloud:
        """The particles of step 0, before they are weighed by its measurements.

        They are drawn from the prior, except for the state of the user's `start`, if there is one.
        """
        counts = np.full(self.model.bound.runs, self.particles.n)
        return self._prior(counts, self.generators(0), self._placed(self.particles.n))

    def _placed(self, count: int) -> Placed | None:
        """Draw the state of the user's `start` from its cells, `count` times in each run.

        None is returned if there is no `start`, or if no sensor with measurements at step 0 depends
        on this state alone.
        """
        cells = self.particles.start
        if cells is None or not cells.sensors(self.model, 0):
            return None
        generators = self.generators(0, STARTED)
        each = [cells.drawn(self.model, 0, k, count, rng) for k, rng in enumerate(generators)]
        states, log_densities = zip(*each, strict=True)
        found = np.concatenate(states, axis=1), np.concatenate(log_densities)
        return Placed(cells.variable, *found)

    def _prior(
        self, counts: Integers, generators: Generators, placed: Placed | None = None
    ) -> Cloud:
        """Draw the particles of step 0 from the prior, `counts` (runs,) of them in each run.

        placed: Draws of one variable from a proposal over cells, which are taken for its values.
            A particle's weight is then proportional to the ratio of the prior's density at its
            value to the proposal's. None draws all variables from the prior, with equal weights.
        """
        starts = np.concatenate([[0], np.cumsum(counts)])
        states = np.zeros((self.model.size, int(starts[-1])), dtype=self.particles.dtype)
        cloud = Cloud(states, uniform(counts), starts)
        for block in cloud.blocks():
            place = slice(block.first, block.last)
            some = self._some(cloud, 0, block.first, block.last, states[:, place])
            drawing = Drawing.of(block, starts, generators)
            for law in self.model.prior:
                child = law.cpd.child
                if placed is None or child is not placed.variable:
                    some.now[self.model.places[child]] = law.draw(0, some, drawing)
                    continue
                some.now[self.model.places[child]] = placed.states[:, place]
                density = law.log_density(0, some, placed.states[:, place])
                cloud.log_weights[place] += density - placed.log_density[place]
        return cloud

    def predict(self, step: int, cloud: Cloud) -> Cloud:
        """The particles of a step, drawn from the transition or a proposal, given the step before.

        `cloud` is that of the step before, given its measurements. Runs whose weights have grown
        unequal are resampled first. If the user's `LikelihoodSampling` chooses the number of
        particles, all runs are resampled at a step with measurements: particles are drawn and moved
        until their likelihoods sum to the user's threshold.
        """
        generators = self.generators(step)
        number = self.particles.number
        if isinstance(number, LikelihoodSampling) and self.model.measured(step).any():
            return self._until_likely(step, cloud, number, generators)
        source, starts, log_weights = self._drawn_anew(step, cloud, generators)
        states = np.zeros((self.model.size, int(starts[-1])), dtype=self.particles.dtype)
        guide = self.guide if self.guide is not None and self.guide.reads(step) else None
        if guide is not None:
            log_weights = log_weights.copy()  # to which the proposals' are added
        found = Cloud(states, log_weights, starts, source, cloud.averages)
        row = self.model.row(step)
        for block in found.blocks():
            place = slice(block.first, block.last)
            before = cloud.states[:, place]
            if source is not None:
                before = np.take(cloud.states, source[place], axis=1)
            some = self._some(found, step, block.first, block.last, before)
            drawing = Drawing.of(block, starts, generators)
            if guide is not None:
                drawing, log_ratio = guide.steered(row, some, drawing)
                log_weights[place] += log_ratio
            self._move(row, some, drawing)
        return found

    def _drawn_anew(
        self, step: int, cloud: Cloud, generators: Generators
    ) -> tuple[Integers | None, Integers, Array]:
        """Choose the particles that are moved to a step, resampling some runs.

        A run is resampled if its effective number of particles is below the threshold; all runs
        are, with a threshold of 1 or KLD-sampling. Returns

        - the place in `cloud` of each chosen particle, (particles,); None if no run is resampled,
          so that all particles are chosen as they are;
        - the place at which each run begins among the chosen particles, and the end, (runs + 1,);
        - the log-weights of the chosen particles, (particles,), equal in a resampled run.
        """
        due = cloud.effective < self.particles.threshold * cloud.counts
        number = self.particles.number
        if self.particles.threshold == 1.0 or isinstance(number, KLDSampling):
            due = np.ones(cloud.runs, dtype=bool)
        if not due.any():
            return None, cloud.starts, cloud.log_weights
        self.record.resampled[step] = due
        return self._resampled(cloud, due, generators)

    def _resampled(
        self, cloud: Cloud, due: Mask, generators: Generators
    ) -> tuple[Integers, Integers, Array]:
        """Resample the runs that are due, by a mask (runs,); returns as `_drawn_anew` does."""
        source, log_weights = list[Integers](), list[Array]()
        for run in range(cloud.runs):
            place = cloud.of(run)
            if not due[run]:
                source.append(np.arange(place.start, place.stop))
                log_weights.append(cloud.log_weights[place])
                continue
            chosen = self._chosen(cloud.states[:, place], cloud.weights[place], generators[run])
            chosen += place.start
            source.append(chosen)
            log_weights.append(np.full(len(chosen), -np.log(len(chosen))))
        starts = np.concatenate([[0], np.cumsum([len(each) for each in source])])
        if cloud.runs == 1:
            return source[0], starts, log_weights[0]
        return np.concatenate(source), starts, np.concatenate(log_weights)

    def _until_likely(
        self, step: int, cloud: Cloud, number: LikelihoodSampling, generators: Generators
    ) -> Cloud:
        """The particles of a step, drawn until their likelihoods sum to the user's threshold.

        cloud: The particles of the step before, given its measurements.
        number: The user's threshold, and the bounds of a run's number of particles.

        A particle's likelihood is counted as a share of the largest that the measurements could
        have at any state. A run without measurements has as many particles as before.
        """
        self.record.resampled[step] = True
        draw, peak = RESAMPLERS[self.particles.resampling], self.model.log_peak(step)
        states, source = list[States](), list[Integers]()
        row, measured = self.model.row(step), self.model.measured(step) > 0
        counts = np.zeros(cloud.runs, dtype=np.intp)
        for run, rng in enumerate(generators):
            place, explained = cloud.of(run), 0.0
            # A run without measurements needs as many particles as it had.
            due = number.least if measured[run] else int(cloud.counts[run])
            while due:
                chosen = place.start + indices(draw(cloud.weights[place], due, rng))
                owner = None if cloud.runs == 1 else np.full(due, run)
                now = np.zeros((self.model.size, due), dtype=self.particles.dtype)
                some = Some(step, now, np.take(cloud.states, chosen, axis=1), owner)
                self._move(row, some, Drawing([(slice(0, due), rng)]))
                explained += float(np.exp(self.model.log_likelihood(some) - peak[run]).sum())
                states.append(now)
                source.append(chosen)
                counts[run] += due
                due = number.more(int(counts[run]), explained) if measured[run] else 0
        starts = np.concatenate([[0], np.cumsum(counts)])
        moved = np.concatenate(states, axis=1), uniform(counts), starts, np.concatenate(source)
        return Cloud(*moved, cloud.averages)

    def _move(self, row: int, some: Some, drawing: Drawing) -> None:
        """Draw the states of particles at a step, by one CPD of the transition after another.

        row: The row of the step in the values of the transition's observed parents.
        some: The m particles; their array `some.now`, (d, m), takes the states drawn.
        drawing: The source of the particles' noise.
        """
        for law in self.model.transition:
            some.now[self.model.places[law.cpd.child]] = law.draw(row, some, drawing)

    def _chosen(self, states: States, weights: Array, rng: np.random.Generator) -> Integers:
        """Resample one run's particles, of states (d, m) and weights (m,).

        Returns the indices, from 0 to m − 1, of the particles drawn: m of them, or as many as
        KLD-sampling asks for.
        """
        draw = RESAMPLERS[self.particles.resampling]
        number = self.particles.number
        if not isinstance(number, KLDSampling):
            return indices(draw(weights, len(weights), rng))
        return number.drawn(states, self.model, lambda count: indices(draw(weights, count, rng)))

    def take(self, step: int, cloud: Cloud) -> tuple[Cloud, Array]:
        """Weigh a cloud by its step's measurements, and estimate their log-density.

        Returns the cloud given the measurements, and ln p(z_t | z_0..t−1), (runs,), which is zero
        at a step without measurements. With an `Injection`, some particles of runs whose
        measurements have become less likely are then replaced by draws elsewhere.
        """
        if not self.model.read(step):
            return cloud, np.zeros(cloud.runs)
        known, log_density = self._weighed(step, cloud)
        if self.particles.injection is not None:
            known = self._injected(step, known, log_density, self.particles.injection)
        return known, log_density

    def _weighed(self, step: int, cloud: Cloud) -> tuple[Cloud, Array]:
        """Weigh a cloud by a step's measurements, and estimate their log-density.

        Returns the weighed cloud, and the estimates of ln p(z_t | z_0..t−1), (runs,). If no
        particle of a run explains the measurements, the user's settings decide: an EvidenceError is
        raised, or the measurements are ignored, or the run is restarted from the prior; in the last
        two cases the run's estimate is −∞. An EvidenceError is raised, too, if after a restart no
        particle from the prior explains the measurements.
        """
        log_weights = cloud.log_weights + self._log_likelihood(step, cloud)
        impossible = np.isneginf(np.maximum.reduceat(log_weights, cloud.starts[:-1]))
        if not impossible.any():
            return cloud.normalised(log_weights)
        cloud = self._after_impossible(step, cloud, impossible)
        if self.particles.impossible == RESTART:
            log_weights = cloud.log_weights + self._log_likelihood(step, cloud)
            still = np.isneginf(np.maximum.reduceat(log_weights, cloud.starts[:-1]))
            if still.any():
                self._refuse(step, int(still.argmax()), ", nor of those of the prior,")
        hopeless = cloud.spread(impossible)
        if self.particles.impossible == IGNORE:
            log_weights = np.where(hopeless, cloud.log_weights, log_weights)
        known, log_density = cloud.normalised(log_weights)
        log_density[impossible] = -np.inf
        return known, log_density

    def _injected(self, step: int, cloud: Cloud, log_density: Array, injection: Injection) -> Cloud:
        """Replace particles in runs whose measurements fit worse than they used to.

        cloud: The particles, weighed by the step's measurements.
        log_density: ln p(z_t | z_0..t−1), (runs,).
        injection: The user's choice: how a run's long-term and short-term averages of the
            measurements' likelihood are formed, and the cells from which a state is drawn.

        The averages are updated with `log_density`, and then give the share of a run's particles
        that is to be replaced. A run with such a share is resampled, its weights become equal, and
        in this share of its particles the state variable of the cells is drawn from the cells;
        other variables keep their values. The cloud returned has the new particles and averages.
        """
        measured, cells = self.model.measured(step), injection.cells
        averages = injection.averaged(cloud.averages, log_density, measured)
        cloud = replace(cloud, averages=averages)
        shares = injection.shares(averages)
        if not shares.any() or (cells.temper > 0.0 and not cells.sensors(self.model, step)):
            return cloud
        draw, generators = RESAMPLERS[self.particles.resampling], self.generators(step, INJECTED)
        rows = self.model.places[cells.variable]
        states, log_weights = cloud.states.copy(), cloud.log_weights.copy()
        for run in np.flatnonzero(shares).tolist():
            rng, place, count = generators[run], cloud.of(run), int(cloud.counts[run])
            fresh = int(shares[run] * count + rng.random())
            if not fresh:
                continue
            own = cloud.states[:, place][:, indices(draw(cloud.weights[place], count, rng))]
            which = rng.permutation(count)[:fresh]
            try:
                own[rows, which] = cells.drawn(self.model, step, run, fresh, rng)[0]
            except EvidenceError:
                if self.record.ignored[step, run]:  # nor does a cell explain what was left out
                    continue
                raise
            states[:, place], log_weights[place] = own, -np.log(count)
            self.record.injected[step, run] += fresh
        return replace(cloud, states=states, log_weights=log_weights, ancestors=None)

    def _log_likelihood(self, step: int, cloud: Cloud) -> Array:
        """The log-density of a step's measurements at each particle of a cloud, (particles,)."""
        found = np.empty(len(cloud.log_weights))
        for block in cloud.blocks():
            place = slice(block.first, block.last)
            some = self._some(cloud, step, block.first, block.last, cloud.states[:, place])
            found[place] = self.model.log_likelihood(some)
        return found

    def _after_impossible(self, step: int, cloud: Cloud, impossible: Mask) -> Cloud:
        """The cloud to go on with, where no particle of some runs explains a step's measurements.

        cloud: The particles, not weighed by the measurements yet.
        impossible: The mask of these runs, (runs,).

        The particles of a run are drawn from the prior if it is to restart, or if all of them had
        weight zero already, before the measurements; otherwise they stay. An EvidenceError is
        raised if the user chose ``impossible="raise"``.
        """
        if self.particles.impossible == RAISE:
            run = int(impossible.argmax())
            nowhere = np.isneginf(cloud.log_weights[cloud.of(run)]).all()
            besides = ", all drawn from cells where the prior has no density," if nowhere else ""
            self._refuse(step, run, besides)
        if self.particles.impossible == IGNORE:
            self.record.ignored[step] |= impossible
            # Draws from cells may be impossible under the prior, which alone is left then.
            largest = np.maximum.reduceat(cloud.log_weights, cloud.starts[:-1])
            impossible = np.isneginf(largest)
            if not impossible.any():
                return cloud
        else:
            self.record.restarted[step] |= impossible
        fresh = self._prior(cloud.counts, self.generators(step, RESTARTED))
        hopeless = cloud.spread(impossible)
        states = np.where(hopeless, fresh.states, cloud.states)
        log_weights = np.where(hopeless, fresh.log_weights, cloud.log_weights)
        return replace(cloud, states=states, log_weights=log_weights)

    def _refuse(self, step: int, run: int, besides: str = "") -> NoReturn:
        """Raise the EvidenceError for measurements that none of a run's particles explains.

        besides: Words to be put after "none of the particles" in the error's text, beginning and
            ending with a comma; "" if there are none.
        """
        run += self.model.bound.first_run
        read = self.model.read(step)
        raise EvidenceError(
            f"the measurements of {listed(read)} at step {step}, run {run}, are impossible: none "
            f"of the particles{besides} explains them; look for a mistaken measurement or a noise "
            'that is too small, give more particles, or a way on, impossible="ignore" or "restart"',
            variable=read[0] if read else None,
            step=step,
            run=run,
        )

    def _some(self, cloud: Cloud, step: int, first: int, last: int, before: Array) -> Some:
        """The particles of `cloud` in the places `first` to `last` − 1, to evaluate CPDs at.

        before: The states of these particles at the step before, (d, last − first), for parents of
            that step; where no CPD has such a parent, any array of this shape.
        """
        owner = None if cloud.runs == 1 else cloud.owner[first:last]
        return Some(step, cloud.states[:, first:last], before, owner)
