"""Beliefs by particles, as a family of beliefs."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

from pgm.arguments import public
from pgm.beliefs.own.family import BeliefFamily
from pgm.beliefs.particles.online import ParticleSteps
from pgm.beliefs.particles.outcome import ParticleOutcome
from pgm.beliefs.particles.run import run
from pgm.beliefs.particles.settings import ParticleSettings
from pgm.beliefs.points.particle_belief import ParticleBelief
from pgm.compile import DynamicGraph
from pgm.errors import ModelError
from pgm.evidence import BoundEvidence
from pgm.networks import DynamicBayesianNetwork
from pgm.posteriors.associations import by_density
from pgm.schedules.options import Call


@public
class Particles(ParticleSettings, BeliefFamily[ParticleBelief]):
    r"""Beliefs as weighted draws, for posteriors of any shape.

    .. math:: p(x_t \mid z) \approx \sum_i w_t^i \, δ(x_t - x_t^i)

    - x_t^i: the n particles, drawn from the transition, p(x_t | x_{t−1}^i);
    - w_t^i: their weights, w_{t−1}^i p(z_t | x_t^i), normalised;
    - z: the measurements, z_t those of step t.

    This is the bootstrap filter: the weights are the density of the measurements. If there is a
    `proposal`, q, particles are drawn from q(x_t | x_{t−1}^i, z_t) instead, and their weights are
    w_{t−1}^i p(x_t^i | x_{t−1}^i) p(z_t | x_t^i) / q. Weights are carried from step to step, as
    logarithms, until the effective number of particles falls below a share of their number,
    1 / Σ w² < threshold n; the particles are then drawn anew in proportion to the weights. Errors
    of estimates fall as 1/√n, whatever the number of components of x, but by a factor that grows
    quickly with this number.

    With ``compiled=True`` or ``compiled=pgm.Compiled(threads=2)``, given to `filter`, `smooth` or
    `compile`, machine code moves, weighs and resamples particles, which threads share. The
    transition has to be Gaussian with a fixed covariance, and linear, or of functions that can be
    traced; sensors likewise, or with `StudentT` noise, and others are weighed by NumPy. The draws
    are then counted (Philox): the same for any number of threads, and other ones than NumPy's where
    `compiled` is left out. NumPy alone has a `proposal`, `number`, `start` or `injection`, float32,
    and what a smoother draws backwards; ``posterior.status.compilation`` tells what was compiled,
    and why something was not.

    Parameters
    ----------
    n : int
        The number of particles of each run; with `number`, at the start.
    seed : int
        The seed of the draws. Each run and step has a stream of its own: a run's particles are the
        same in any batch in which it has the same place, offline and online.
    proposal : Lineariser, optional
        Makes, from each particle, a Gaussian belief of its next state given the step's
        measurements. The next state is drawn from this belief, and its weight corrected exactly for
        that: for measurements more precise than the motion. Without it, particles are drawn from
        the transition. Measurements at step 0, and those of sensors that are not Gaussian, weigh
        particles but guide none.
    resampling : str
        ``"systematic"``, ``"stratified"``, ``"residual"`` or ``"multinomial"``.
    number : KLDSampling or LikelihoodSampling, optional
        Chooses how many particles a run has: `KLDSampling` by how far they spread, at every step,
        `LikelihoodSampling` by how well they explain the measurements, at steps that have some.
        Particles are drawn anew at each of these steps.
    start : CellProposal, optional
        Draws a state at step 0 from the likelihood of that step's measurements, and weighs each
        particle by the state's prior: for a robot that may be anywhere.
    injection : Injection, optional
        Puts particles elsewhere when measurements are no longer explained: for a robot that may
        have been carried away. Filters only.
    threshold : float
        The effective number of particles, as a share of their number, below which they are drawn
        anew: 1 at every step, 0 never.
    smoothing : str
        ``"metropolis"``: backward trajectories are moved by independent proposals from the filtered
        particles, begun at each particle's own ancestor; ``"full"``: drawn from all n of them,
        which takes n² densities a step.
    moves : int
        Moves of the Metropolis chain, at each step of a trajectory.
    trajectories : int, optional
        The number of trajectories that a smoother draws backwards; n, if not given.
    impossible : str
        What to do where no particle explains a step's measurements: ``"raise"`` an error,
        ``"ignore"`` the measurements, or ``"restart"`` from the prior. The posterior's `status`
        says where that happened.
    dtype : numpy type
        Type of the states, ``np.float64`` or ``np.float32``. Weights are float64.

    Raises
    ------
    ModelError
        If an argument is not of the kind or in the range described here, or a proposal comes with a
        `LikelihoodSampling`.

    References
    ----------
    Gordon, Salmond & Smith, Novel approach to nonlinear/non-Gaussian Bayesian state estimation,
    1993; Doucet, Godsill & Andrieu, On sequential Monte Carlo sampling methods, 2000; Bunch &
    Godsill, Improved particle approximations to the joint smoothing distribution, 2013.

    Examples
    --------
    >>> Particles(1000, seed=3)
    Particles(1,000, systematic below 0.5, seed 3)
    """

    beliefs: ClassVar[str] = "particles"
    takes: ClassVar[frozenset[str]] = frozenset({"compiled"})
    spare: ClassVar[str] = (
        "is for beliefs that are Gaussian; particles linearise nothing, are of all runs at once, "
        "and have no lag online"
    )
    more: ClassVar[Mapping[str, str]] = {
        "impossible": '; particles have their own, pgm.Particles(..., impossible="restart"): '
        "leave it out"
    }

    def infer(self, graph: DynamicGraph, bound: BoundEvidence, call: Call) -> ParticleOutcome:
        """The posterior's particles; measurements of unknown things are mixtures."""
        return run(graph, by_density(bound), call.schedule, self, call.compiled)

    def online(self, model: DynamicBayesianNetwork, options: dict[str, Any]) -> ParticleSteps:
        """The filter of one step at a time."""
        if options.get("compiled"):
            raise ModelError(
                f"{self!r}: online, particles are moved by NumPy: leave out compiled=, which "
                "pgm.filter, smooth and infer take"
            )
        return ParticleSteps(model, self)
