r"""The chain family of particles: a belief is a cloud of weighted draws.

At a step particles are drawn anew, if their weights have grown unequal, moved, and weighed,

    x_t^i ~ q(x_t | x_{t−1}^a),    w_t^i ∝ w_{t−1}^a p(x_t^i | x_{t−1}^a) p(z_t | x_t^i) / q,

a being the ancestor of each. The sum of what the weights are multiplied by estimates
p(z_t | z_0..t−1) without bias (Del Moral, Feynman–Kac formulae, 2004, section 7.4).
"""

from __future__ import annotations

from dataclasses import replace
from typing import NoReturn

import numpy as np

from pgm.errors import EvidenceError
from pgm.factors.scope import listed
from pgm.inference.particles.cloud import Cloud, uniform
from pgm.inference.particles.laws import Drawing, Some, States
from pgm.inference.particles.model import ParticleModel
from pgm.inference.particles.record import Record
from pgm.inference.particles.streams import FORWARD, RESTARTED, stream
from pgm.inference.particles.value import IGNORE, RAISE, RESTART, Particles
from pgm.kernels.arrays import Array, Integers, Mask
from pgm.kernels.resampling import RESAMPLERS, indices

Generators = list[np.random.Generator]


class ParticleChain:
    """The family of one chain of all runs.

    Parameters
    ----------
    model : ParticleModel
    particles : Particles
    record : Record
        Of what happens on the way.
    """

    def __init__(self, model: ParticleModel, particles: Particles, record: Record) -> None:
        self.model, self.particles, self.record = model, particles, record

    def generators(self, step: int, purpose: int = FORWARD) -> Generators:
        """The streams of a step's draws, one a run."""
        first = self.model.bound.first_run
        runs = range(first, first + self.model.bound.runs)
        return [stream(self.particles.seed, run, step, purpose) for run in runs]

    def start(self) -> Cloud:
        """The particles of the prior."""
        return self._prior(np.full(self.model.bound.runs, self.particles.n), self.generators(0))

    def _prior(self, counts: Integers, generators: Generators) -> Cloud:
        starts = np.concatenate([[0], np.cumsum(counts)])
        states = np.zeros((self.model.size, int(starts[-1])), dtype=self.particles.dtype)
        cloud = Cloud(states, uniform(counts), starts)
        for block in cloud.blocks():
            place = slice(block.first, block.last)
            some = self._some(cloud, 0, block.first, block.last, states[:, place])
            drawing = Drawing.of(block, starts, generators)
            for law in self.model.prior:
                some.now[self.model.places[law.cpd.child]] = law.draw(0, some, drawing)
        return cloud

    def predict(self, step: int, cloud: Cloud) -> Cloud:
        """The particles of a step, moved from those of the step before."""
        generators = self.generators(step)
        source, starts, log_weights = self._drawn_anew(step, cloud, generators)
        states = np.zeros((self.model.size, int(starts[-1])), dtype=self.particles.dtype)
        found = Cloud(states, log_weights, starts, source)
        row = self.model.row(step)
        for block in found.blocks():
            place = slice(block.first, block.last)
            before = cloud.states[:, place]
            if source is not None:
                before = np.take(cloud.states, source[place], axis=1)
            some = self._some(found, step, block.first, block.last, before)
            drawing = Drawing.of(block, starts, generators)
            for law in self.model.transition:
                some.now[self.model.places[law.cpd.child]] = law.draw(row, some, drawing)
        return found

    def _drawn_anew(
        self, step: int, cloud: Cloud, generators: Generators
    ) -> tuple[Integers | None, Integers, Array]:
        """The particles to be moved to a step: which, where runs begin, and their log-weights.

        None stands for all of them as they are.
        """
        due = cloud.effective < self.particles.threshold * cloud.counts
        if self.particles.threshold == 1.0 or self.particles.number is not None:
            due = np.ones(cloud.runs, dtype=bool)
        if not due.any():
            return None, cloud.starts, cloud.log_weights
        self.record.resampled[step] = due
        source, log_weights = list[Integers](), list[Array]()
        for run in range(cloud.runs):
            place = cloud.of(run)
            if not due[run]:
                source.append(np.arange(place.start, place.stop))
                log_weights.append(cloud.log_weights[place])
                continue
            chosen = self._chosen(cloud.states[:, place], cloud.weights[place], generators[run])
            source.append(place.start + chosen)
            log_weights.append(np.full(len(chosen), -np.log(len(chosen))))
        starts = np.concatenate([[0], np.cumsum([len(each) for each in source])])
        return np.concatenate(source), starts, np.concatenate(log_weights)

    def _chosen(self, states: States, weights: Array, rng: np.random.Generator) -> Integers:
        """The places of the particles of a run that are drawn anew."""
        draw = RESAMPLERS[self.particles.resampling]
        number = self.particles.number
        if number is None:
            return indices(draw(weights, self.particles.n, rng))
        return number.drawn(states, self.model, lambda count: indices(draw(weights, count, rng)))

    def take(self, step: int, cloud: Cloud) -> tuple[Cloud, Array]:
        """The particles weighed by the measurements of their step, and the log-density of these."""
        if not self.model.read(step):
            return cloud, np.zeros(cloud.runs)
        log_weights = cloud.log_weights + self._log_likelihood(step, cloud)
        impossible = np.isneginf(np.maximum.reduceat(log_weights, cloud.starts[:-1]))
        if not impossible.any():
            return _normalised(cloud, log_weights)
        cloud = self._after_impossible(step, cloud, impossible)
        if self.particles.impossible == RESTART:
            log_weights = cloud.log_weights + self._log_likelihood(step, cloud)
            still = np.isneginf(np.maximum.reduceat(log_weights, cloud.starts[:-1]))
            if still.any():
                self._refuse(step, int(still.argmax()), ", nor of those of the prior,")
        hopeless = np.repeat(impossible, cloud.counts)
        if self.particles.impossible == IGNORE:
            log_weights[hopeless] = cloud.log_weights[hopeless]
        known, log_density = _normalised(cloud, log_weights)
        log_density[impossible] = -np.inf
        return known, log_density

    def _log_likelihood(self, step: int, cloud: Cloud) -> Array:
        """The log-density of a step's measurements at all particles."""
        found = np.empty(len(cloud.log_weights))
        for block in cloud.blocks():
            place = slice(block.first, block.last)
            some = self._some(cloud, step, block.first, block.last, cloud.states[:, place])
            found[place] = self.model.log_likelihood(some)
        return found

    def _after_impossible(self, step: int, cloud: Cloud, impossible: Mask) -> Cloud:
        """The cloud with which to go on where no particle explains the measurements."""
        if self.particles.impossible == RAISE:
            self._refuse(step, int(impossible.argmax()))
        if self.particles.impossible == IGNORE:
            self.record.ignored[step] |= impossible
            return cloud
        self.record.restarted[step] |= impossible
        fresh = self._prior(cloud.counts, self.generators(step, RESTARTED))
        hopeless = np.repeat(impossible, cloud.counts)
        states = np.where(hopeless, fresh.states, cloud.states)
        log_weights = np.where(hopeless, fresh.log_weights, cloud.log_weights)
        return replace(cloud, states=states, log_weights=log_weights)

    def _refuse(self, step: int, run: int, besides: str = "") -> NoReturn:
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
        owner = None if cloud.runs == 1 else cloud.owner[first:last]
        return Some(step, cloud.states[:, first:last], before, owner)


def _normalised(cloud: Cloud, log_weights: Array) -> tuple[Cloud, Array]:
    """The cloud with weights of sum one in each run, and the logarithm of what they were."""
    largest = np.maximum.reduceat(log_weights, cloud.starts[:-1])
    shift = np.repeat(largest, cloud.counts)
    log_sum = largest + np.log(cloud.summed(np.exp(log_weights - shift)))
    return cloud.weighed(log_weights - np.repeat(log_sum, cloud.counts)), log_sum
