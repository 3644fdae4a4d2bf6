r"""Backward simulation: trajectories drawn from the smoothing distribution.

The last state is drawn from the filter's particles, and then, step by step, the one before from

    p(x_t | x_{t+1}, z_0..t) ≈ Σ_i w̃_i δ(x_t − x_t^i),    w̃_i ∝ w_t^i p(x_{t+1} | x_t^i),

in full, which takes a density for each particle and trajectory, or by a Metropolis chain: begun at
the particle's own ancestor, which is a draw of that distribution, moved by independent proposals
i ~ w_t, each taken with the probability min(1, p(x_{t+1} | x_t^i) / p(x_{t+1} | x_t^now)).

Godsill, Doucet & West, Monte Carlo smoothing for nonlinear time series, 2004; Bunch & Godsill,
Improved particle approximations to the joint smoothing distribution using Markov chain Monte Carlo,
2013.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pgm.inference.particles.cloud import BACKWARD, Cloud, stream, uniform
from pgm.inference.particles.laws import GaussianLaw, Law, Root, Some, States
from pgm.inference.particles.model import ParticleModel
from pgm.inference.particles.value import FULL, Particles
from pgm.kernels.angles import TURN
from pgm.kernels.arrays import Array, Integers, Mask
from pgm.kernels.resampling import RESAMPLERS, indices, systematic
from pgm.progress import counted

# Densities that are held at a time, where all pairs are asked for.
_PAIRS = 2**20


class Backward:
    """Trajectories by backward simulation through the clouds of a particle filter.

    restarted: (T+1, runs): where particles were drawn from the prior instead of the step before, of
        which they tell nothing then.

    unmoved: (T, runs): by step the share of trajectories that stayed at their ancestor.
    """

    def __init__(
        self,
        model: ParticleModel,
        particles: Particles,
        clouds: Sequence[Cloud],
        restarted: Mask,
    ) -> None:
        self.model, self.particles, self.clouds = model, particles, clouds
        self.restarted = restarted
        runs, count = model.bound.runs, particles.trajectories
        self.unmoved = np.zeros((max(len(clouds) - 1, 0), runs))
        self._counts = np.full(runs, count)
        self._starts = np.arange(runs + 1) * count
        self._owner = None if runs == 1 else np.repeat(np.arange(runs), count)

    def smoothed(self) -> tuple[Cloud, ...]:
        """The trajectories given all measurements, by step."""
        last = len(self.clouds) - 1
        place = self._last(last, last)
        found = [self._cloud(last, place)]
        for step in counted(range(last - 1, -1, -1), "trajectories"):
            place = self._before(step, place, found[-1].states, step)
            found.append(self._cloud(step, place))
        return tuple(reversed(found))

    def lagged(self, lag: int) -> tuple[Cloud, ...]:
        """The particles of each step given the measurements up to a lag later."""
        found = []
        for step in counted(range(len(self.clouds)), "trajectories"):
            last = min(step + lag, len(self.clouds) - 1)
            place = self._last(last, step)
            cloud = self._cloud(last, place)
            for before in range(last - 1, step - 1, -1):
                place = self._before(before, place, cloud.states, step)
                cloud = self._cloud(before, place)
            found.append(cloud)
        return tuple(found)

    def _generators(self, step: int, about: int) -> list[np.random.Generator]:
        """The random streams of draws at a step, for trajectories that end at the step `about`."""
        first, seed = self.model.bound.first_run, self.particles.seed
        purpose = BACKWARD + step - about  # a lag's trajectories are none of another's
        return [stream(seed, first + run, step, purpose) for run in range(len(self._counts))]

    def _cloud(self, step: int, place: Integers) -> Cloud:
        """The particles at these indices of a step, (trajectories,), with equal weights."""
        states = np.take(self.clouds[step].states, place, axis=1)
        return Cloud(states, uniform(self._counts), self._starts)

    def _last(self, step: int, about: int) -> Integers:
        """The places of the last particles of trajectories, drawn by their filtered weights."""
        cloud, generators = self.clouds[step], self._generators(step, about)
        draw, found = RESAMPLERS[self.particles.resampling], []
        for run, generator in enumerate(generators):
            part = cloud.of(run)
            counts = draw(cloud.weights[part], self.particles.trajectories, generator)
            found.append(part.start + indices(counts))
        return np.concatenate(found)

    def _before(self, step: int, place: Integers, after: States, about: int) -> Integers:
        """Indices of ancestors at a step, drawn by backward simulation given the states `after`.

        Each is drawn with probability ∝ w_i p(after | x_i), over all particles or by Metropolis
        moves from the ancestor. A run that was begun anew at the next step has no such link: it is
        drawn by w_i alone.
        """
        later, cloud = self.clouds[step + 1], self.clouds[step]
        generators = self._generators(step, about)
        ancestor = place if later.ancestors is None else later.ancestors[place]
        density = _Density(self.model, step + 1, cloud, after, self._owner)
        if self.particles.smoothing == FULL:
            chosen = self._in_full(cloud, density, ancestor, generators)
            moved = chosen != ancestor
        else:
            chosen, moved = self._by_moves(cloud, density, ancestor, generators)
        for run in np.flatnonzero(self.restarted[step + 1]).tolist():
            own = self._of(run)
            chosen[own], moved[own] = self._drawn(cloud, run, generators[run]), True
        self.unmoved[step] = 1.0 - moved.reshape(len(self._counts), -1).mean(axis=1)
        return chosen

    def _by_moves(
        self,
        cloud: Cloud,
        density: _Density,
        ancestor: Integers,
        generators: list[np.random.Generator],
    ) -> tuple[Integers, Array]:
        """Places after independent Metropolis moves, and which have moved at all."""
        now, moved = ancestor.copy(), np.zeros(len(ancestor), dtype=bool)
        log_now = density.at(now)
        proposed, level = np.empty_like(now), np.empty(len(now))
        for _ in range(self.particles.moves):
            for run, generator in enumerate(generators):
                own = self._of(run)
                proposed[own] = self._drawn(cloud, run, generator)
                level[own] = generator.random(own.stop - own.start)
            log_proposed = density.at(proposed)
            with np.errstate(invalid="ignore", over="ignore"):  # −∞ less −∞ moves nothing
                taken = level < np.exp(log_proposed - log_now)
            now[taken], log_now[taken] = proposed[taken], log_proposed[taken]
            moved |= taken
        return now, moved

    def _of(self, run: int) -> slice:
        """The slice of one run's trajectories in the array of all runs' trajectories."""
        return slice(int(self._starts[run]), int(self._starts[run + 1]))

    def _drawn(self, cloud: Cloud, run: int, generator: np.random.Generator) -> Integers:
        """The places of particles drawn by their weights, shuffled: each draw is independent."""
        weights = cloud.weights[cloud.of(run)]
        drawn = indices(systematic(weights, int(self._counts[run]), generator))
        found: Integers = cloud.starts[run] + generator.permutation(drawn)
        return found

    def _in_full(
        self,
        cloud: Cloud,
        density: _Density,
        ancestor: Integers,
        generators: list[np.random.Generator],
    ) -> Integers:
        """Places drawn from all n particles, with probability ∝ w_i p(after | x_i).

        That costs n densities a trajectory.
        """
        found = []
        for run, generator in enumerate(generators):
            part, trajectories = cloud.of(run), range(*self._starts[run : run + 2].tolist())
            every = np.arange(part.start, part.stop)
            rows = max(_PAIRS // len(every), 1)
            for first in range(trajectories.start, trajectories.stop, rows):
                some = np.arange(first, min(first + rows, trajectories.stop))
                pairs = density.at(np.tile(every, len(some)), np.repeat(some, len(every)))
                joint = pairs.reshape(len(some), -1) + cloud.log_weights[part]
                largest = joint.max(axis=1)
                # Rounding may hide what made a particle: its own ancestor has.
                lost = np.isneginf(largest)
                joint -= np.where(lost, 0.0, largest)[:, None]
                total = np.cumsum(np.exp(joint), axis=1)
                level = generator.random(len(some)) * total[:, -1]
                drawn = part.start + (total <= level[:, None]).sum(axis=1)
                found.append(np.where(lost, ancestor[some], drawn))
        return np.concatenate(found)


class _Density:
    def __init__(
        self,
        model: ParticleModel,
        step: int,
        cloud: Cloud,
        after: States,
        owner: Integers | None,
    ) -> None:
        self.model, self.step, self.cloud = model, step, cloud
        self.after, self.owner = after, owner
        self._row = model.row(step)
        self._means: list[tuple[States, Root] | None] = [
            self._mean(law) for law in model.transition
        ]

    def _mean(self, law: Law) -> tuple[States, Root] | None:
        """The means of all particles at once, where they do not depend on the step's own slice."""
        parents = [p for p in law.cpd.parents if p not in law.inputs]
        if not isinstance(law, GaussianLaw) or not all(p.lag for p in parents):
            return None
        root = law.root(self._row, self.step)
        if not root.regular:
            return None
        cloud, means = self.cloud, list[States]()
        for block in cloud.blocks():
            before = cloud.states[:, block.first : block.last]
            owner = None if cloud.runs == 1 else cloud.owner[block.first : block.last]
            some = Some(self.step, before, before, owner)
            mean = law.mean(self._row, some)
            means.append(np.broadcast_to(mean, (len(mean), len(block))))
        return np.concatenate(means, axis=1), root

    def at(self, place: Integers, which: Integers | None = None) -> Array:
        """The log-densities where particles at some places come before, of some trajectories."""
        after = self.after if which is None else self.after[:, which]
        owner = self.owner if which is None or self.owner is None else self.owner[which]
        some = Some(self.step, after, self.cloud.states[:, :0], owner)
        before: States | None = None
        total = np.zeros(len(place))
        for law, known in zip(self.model.transition, self._means, strict=True):
            child = after[self.model.places[law.cpd.child]]
            if known is not None:
                means, root = known
                residual = np.subtract(child, np.take(means, place, axis=1))
                for k in np.flatnonzero(law.cpd.child.angle_mask):
                    residual[k] -= TURN * np.rint(residual[k] / TURN)
                total += root.log_density(residual, some)
                continue
            if before is None:
                before = np.take(self.cloud.states, place, axis=1)
            total += law.log_density(self._row, some._replace(before=before), child)
        return total
