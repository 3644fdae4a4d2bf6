"""Backward simulation: trajectories drawn from the smoothing distribution.

A particle filter leaves a *cloud* at each step t: particles x_t^i with weights w_t^i, given the
measurements z_0..t up to that step. The last state of a trajectory is drawn from the last cloud.
Then, step by step backwards, the state before x_{t+1} is drawn from

    p(x_t | x_{t+1}, z_0..t) ≈ Σ_i w̃_i δ(x_t − x_t^i),    w̃_i ∝ w_t^i p(x_{t+1} | x_t^i).

Two ways are offered:

- *in full*, w̃_i is computed for every particle, which takes a density for each pair of a particle
  and a trajectory;
- *Metropolis moves* begin at the ancestor of x_{t+1}, the particle of step t that the filter moved
  to x_{t+1}; this ancestor is itself a draw from the distribution above. Each move proposes a
  particle i with the probability w_t^i, whatever the current particle x_t^now is, and accepts it
  with the probability min(1, p(x_{t+1} | x_t^i) / p(x_{t+1} | x_t^now)).

The *place* of a particle is its index along the last axis of its cloud's arrays. Such an array has
the particles of all runs, those of run 0 first. Arrays over trajectories, (..., trajectories), have
equally many of each run, those of run 0 first. d is the number of the components of a state.

Godsill, Doucet & West, Monte Carlo smoothing for nonlinear time series, 2004; Bunch & Godsill,
Improved particle approximations to the joint smoothing distribution using Markov chain Monte Carlo,
2013.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pgm.beliefs.particles.settings import FULL, ParticleSettings
from pgm.beliefs.points.cloud import Cloud, uniform
from pgm.beliefs.points.laws import GaussianLaw, Law, Root, Some, States
from pgm.beliefs.points.model import ParticleModel
from pgm.beliefs.points.streams import BACKWARD, stream
from pgm.kernels.arrays import Array, Integers, Mask
from pgm.kernels.resampling import RESAMPLERS, indices, systematic
from pgm.kernels.step import turns
from pgm.progress import counted

# Densities that are held at a time, where all pairs are asked for.
_PAIRS = 2**20


class Backward:
    """A smoother that draws trajectories backwards through the clouds of a particle filter.

    model: The network with its evidence.
    particles: The user's settings, which tell how many trajectories are drawn for each run, and in
        which of the two ways.
    clouds: The filter's weighted particles given the measurements up to each step, from 0 to T.
    restarted: The mask (T+1, runs) of steps at which a run's particles were drawn from the prior;
        these particles do not depend on the step before.

    unmoved: (T, runs): in row t, the share of a run's trajectories that, at step t, stayed at the
        ancestor of their particle at step t + 1; zeros until `smoothed` or `lagged` is called.
    """

    def __init__(
        self,
        model: ParticleModel,
        particles: ParticleSettings,
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
        """Draw whole trajectories given all measurements.

        Returns a cloud of equally weighted particles for each of the steps 0 to T; the i-th
        particles of all clouds make up the i-th trajectory.
        """
        last = len(self.clouds) - 1
        place = self._last(last, last)
        found = [self._cloud(last, place)]
        for step in counted(range(last - 1, -1, -1), "trajectories"):
            place = self._before(step, place, found[-1].states, step)
            found.append(self._cloud(step, place))
        return tuple(reversed(found))

    def lagged(self, lag: int) -> tuple[Cloud, ...]:
        """Draw the particles of each step t given the measurements up to step t + `lag`, at most T.

        Returns a cloud of equally weighted particles for each of the steps 0 to T. Each cloud is
        drawn with random numbers of its own, so that particles of two steps make no trajectory.
        """
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
        """The random generators of the draws at a step, one for each run.

        about: The step whose belief the trajectories are drawn for. `lagged` draws at a step for
            several beliefs, and `about` gives each of them a stream of its own; `smoothed` passes
            the step itself.
        """
        first, seed = self.model.bound.first_run, self.particles.seed
        purpose = BACKWARD + step - about  # each belief of `lagged` has streams of its own
        return [stream(seed, first + run, step, purpose) for run in range(len(self._counts))]

    def _cloud(self, step: int, place: Integers) -> Cloud:
        """The particles of a step at the places `place`, (trajectories,), equally weighted."""
        states = np.take(self.clouds[step].states, place, axis=1)
        return Cloud(states, uniform(self._counts), self._starts)

    def _last(self, step: int, about: int) -> Integers:
        """Draw the place at which each trajectory ends, by the weights of the filter's particles.

        Returns the places, (trajectories,).

        step: The last step of the trajectories.
        about: The step whose belief the trajectories are drawn for; see `_generators`.
        """
        cloud, generators = self.clouds[step], self._generators(step, about)
        draw, found = RESAMPLERS[self.particles.resampling], []
        for run, generator in enumerate(generators):
            part = cloud.of(run)
            counts = draw(cloud.weights[part], self.particles.trajectories, generator)
            found.append(part.start + indices(counts))
        return np.concatenate(found)

    def _before(self, step: int, place: Integers, after: States, about: int) -> Integers:
        """Draw for each trajectory its place at a step, given its state at the step after.

        Returns the places, (trajectories,).

        place: The trajectories' places at the step after, (trajectories,).
        after: The trajectories' states at the step after, (d, trajectories).
        about: The step whose belief the trajectories are drawn for; see `_generators`.

        A particle x_i of weight w_i is drawn with probability ∝ w_i p(after | x_i), in full or by
        Metropolis moves that begin at the ancestor of the trajectory's particle at the step after.
        Where a run was restarted from the prior at the step after, its states there do not depend
        on earlier ones, and particles are drawn with probability w_i.
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
        """Draw the places of trajectories at a step by independent Metropolis moves.

        Returns the places, (trajectories,), and the mask, (trajectories,), of the trajectories for
        which some proposal was accepted.

        cloud: The particles of the step, which are proposed by their weights.
        density: The log-density from a particle to a trajectory's state one step later.
        ancestor: The places at which the moves begin, (trajectories,).
        generators: The random generators, one for each run.
        """
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
        """The slice of one run in an array over the trajectories of all runs."""
        return slice(int(self._starts[run]), int(self._starts[run + 1]))

    def _drawn(self, cloud: Cloud, run: int, generator: np.random.Generator) -> Integers:
        """The places of particles drawn by their weights, one for each trajectory of a run.

        They are drawn systematically and shuffled: each place alone is a draw by the weights, and
        all together are spread over the weights more evenly than independent draws.
        """
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
        """Draw the places (trajectories,) from all particles of each run, ∝ w_i p(after | x_i).

        x_i is a particle of `cloud`, w_i its weight, and `after` the trajectory's state one step
        later. Each pair of a particle and a trajectory takes an evaluation of `density`,
        ln p(after | x_i).

        ancestor: The places of the trajectories' ancestors, (trajectories,). A trajectory takes its
            ancestor if rounding makes its densities from all particles zero.
        generators: The random generators, one for each run.
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
    """The log-density of a transition, from particles to trajectories' states one step later.

    It is the sum of the log-densities of the transition's CPDs. Where a CPD's child has a mean that
    depends on states of the step before alone, this mean is computed once for each particle, not
    once for each pair of a particle and a trajectory.

    step: The step of the trajectories' states.
    cloud: The particles of the step before.
    after: The trajectories' states, (d, trajectories).
    owner: The run of each trajectory, (trajectories,); None where there is one run.
    """

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
        """The means of a CPD's child at all particles, and the CPD's noise.

        The means are (c, particles), c being the number of the child's components. The noise is the
        lower triangular root of its covariance. None is returned if the means depend on states of
        the same step, or the noise is singular or not Gaussian.

        law: The CPD with the values of its observed parents.
        """
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
        """The log-densities (m,) of m pairs of a particle and a trajectory's state.

        place: The place of each pair's particle, (m,).
        which: The index of each pair's trajectory, (m,). None pairs the i-th place with the i-th
            trajectory; m is then the number of trajectories.
        """
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
                    residual[k] -= turns(residual[k])
                total += root.log_density(residual, some)
                continue
            if before is None:
                before = np.take(self.cloud.states, place, axis=1)
            total += law.log_density(self._row, some._replace(before=before), child)
        return total
