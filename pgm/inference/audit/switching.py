"""Draws of the paths of a switching model's regimes, and of trajectories given these.

The answer is a mixture of Gaussians at each step. Its draws are of a Markov chain of regimes that
has the answer's smoothed probabilities of each two successive steps; defensive draws are of laws
that are wider than the model's own. Given a path, and all CPDs being linear, the posterior of the
trajectory is a Gaussian that is drawn from exactly, so that weights are those of paths. With
nonlinear CPDs the trajectory is drawn from the smoother of the path, linearised as its filter goes,
and weighed by the exact density.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pgm.beliefs.hypotheses.forward import chain_of
from pgm.beliefs.hypotheses.outcome import HypothesisOutcome
from pgm.beliefs.hypotheses.paths import PathLaw, follow
from pgm.beliefs.hypotheses.records import Asked
from pgm.beliefs.hypotheses.roles import roles_of
from pgm.beliefs.hypotheses.run import passes
from pgm.cpds import AffineCPD
from pgm.cpds.caused import is_mixture
from pgm.errors import ModelError, NumericalError
from pgm.evidence import BoundEvidence
from pgm.factors.scope import positions
from pgm.inference.audit.corrected import Sums
from pgm.inference.audit.draws import Draws
from pgm.inference.audit.modes import Modes
from pgm.inference.audit.path_density import TrajectoryDensity
from pgm.inference.audit.states import StateSums
from pgm.kernels.arrays import Array, Integers
from pgm.schedules.schedule import Filtering, Smoothing


@dataclass(frozen=True, eq=False)
class SwitchingDraws:
    """Paths and trajectories from the answer's law, or from the defensive one.

    outcome : HypothesisOutcome
        The answer.
    bound : BoundEvidence
    law : PathLaw
        Of paths.
    modes : Modes
        None: paths are all that there is to be missed.
    """

    outcome: HypothesisOutcome
    bound: BoundEvidence
    law: PathLaw
    modes: Modes

    @classmethod
    def make(cls, outcome: HypothesisOutcome) -> SwitchingDraws:
        """Prepare to draw; open sightings, and robust noise, are a ModelError."""
        bound, call, asked = outcome._asked
        roles = roles_of(outcome.graph.model, bound, None)
        if roles.open:
            cpd = roles.open[0].cpd
            if is_mixture(cpd):
                raise ModelError(
                    f"{cpd!r} is a sensor of several components, which no audit draws; a "
                    "pgm.SwitchingCPD of a discrete variable is audited, and says the same"
                )
            raise ModelError(
                f"{cpd!r} has sightings of which each may be of several candidates, which no audit "
                'draws; it can be decided beforehand, pgm.unknown(..., association="likelihood")'
            )
        if roles.robust is not None:
            raise ModelError(
                f"{roles.robust!r} has robust noise: an audit of a switching model takes the "
                "answer as exact where its discrete variables are known, and this is a bound, or "
                "a mixture of several scales"
            )
        smoothing = call._replace(schedule=Smoothing())
        whole = Asked(asked.count, asked.mix)  # of which the prior is not cut into pieces
        _, backward = passes(outcome.graph, bound, smoothing, whole)
        assert backward is not None
        return cls(outcome, bound, PathLaw(backward), Modes.none(bound.runs))

    @property
    def _hidden(self) -> int:
        return sum(v.dimension for v in self.outcome._beliefs.hidden)

    @property
    def width(self) -> int:
        """The number of floats that a step of a draw of one run occupies while it is made."""
        return 8 * self.outcome._regimes.size * (self._hidden + 1) ** 2

    @property
    def length(self) -> int:
        """The number of floats of a whole draw of one run, of all steps."""
        return (self.bound.steps + 1) * (2 * self._hidden + 1) ** 2

    def sums(self) -> list[Sums | StateSums]:
        """Sums over draws, still empty, of each hidden variable."""
        outcome, beliefs, runs = self.outcome, self.outcome._beliefs, self.bound.runs
        layout, steps = outcome.graph.layout, self.bound.steps
        judged = np.array([outcome.kind.last(k, steps) == steps for k in range(steps + 1)])
        found: list[Sums | StateSums] = []
        for variable in beliefs.hidden:
            first = 0 if variable in layout.states else 1
            belief = outcome[variable]
            shape = runs, steps + 1 - first, variable.dimension
            mean = np.asarray(belief.mean).reshape(shape).swapaxes(0, 1)  # type: ignore[union-attr]
            cov = np.asarray(belief.cov).reshape(*shape, shape[-1]).swapaxes(0, 1)  # type: ignore[union-attr]
            places = np.arange(self._hidden)[positions(beliefs.hidden, (variable,))]
            rest = mean, cov, judged[first:]
            found.append(Sums((variable,), places, first, *rest, timed=True, plain=True))
        for k, state in enumerate(outcome._regimes.hidden):
            first = 0 if state in layout.states else 1
            table = np.asarray(outcome[state].probabilities)  # type: ignore[union-attr]
            shape = runs, steps + 1 - first, state.size
            own = table.reshape(shape).swapaxes(0, 1)
            found.append(StateSums(state, self._hidden + k, first, own, judged[first:]))
        return found

    def draw(self, count: int, rng: np.random.Generator, *, defensive: bool) -> Draws:
        """Make S = `count` draws for each run, from the answer's law or, if `defensive`, not."""
        paths = self.law.drawn(count, rng, defensive=defensive)
        asked = Asked(count, mix=False, prune=True)
        model, lineariser = self.outcome.graph.model, self.outcome._asked[1].lineariser
        chain = chain_of(model, self.bound, asked, lineariser, Filtering(), back=True)
        followed = follow(chain, paths)
        if followed.certain:
            raise NumericalError(
                "sensors without noise were read, by which hypotheses are certain, and no audit "
                "weighs these: give the exact CPDs some noise"
            )
        values, density = followed.drawn(rng)
        own = np.concatenate([values, self._states(paths)], axis=-1).swapaxes(1, 2)
        answer, alone = (self.law.log_probability(paths, defensive=d).T for d in (False, True))
        if all(isinstance(case, AffineCPD) for case in chain.roles.cases):
            return Draws(followed.log_density.T, answer, alone, own)
        law = TrajectoryDensity(chain)
        if not np.isfinite(density).all():
            raise NumericalError(
                "some state has no noise of its own, and beside nonlinear CPDs no audit of a "
                "switching model draws these: give the exact CPDs some noise"
            )
        exact = law.log_density(values, paths) + self.law.of_model(paths)
        return Draws(exact.T, answer + density.T, alone + density.T, own)

    def _states(self, paths: Integers) -> Array:
        """The states of hidden discrete variables along paths, (T+1, draws, runs, variables)."""
        regimes = self.outcome._regimes
        each = [regimes.states(v)[paths][..., None] for v in regimes.hidden]
        return np.concatenate([np.zeros((*paths.shape, 0)), *each], axis=-1)
