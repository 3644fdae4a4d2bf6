"""The particles that a user asks for: how many, drawn from what, and drawn anew when."""

from __future__ import annotations

from typing import Any

import numpy as np

from pgm.boundary import is_number, is_whole
from pgm.display import InCode
from pgm.errors import ModelError
from pgm.immutable import Immutable
from pgm.inference.options import require_lineariser
from pgm.inference.particles.cells import CellProposal
from pgm.inference.particles.injection import Injection
from pgm.inference.particles.number import KLDSampling, LikelihoodSampling
from pgm.kernels.resampling import RESAMPLERS
from pgm.linearisers import Lineariser

# The ways on from measurements that no particle explains.
RAISE, IGNORE, RESTART = "raise", "ignore", "restart"
# The ways of drawing trajectories backwards.
METROPOLIS, FULL = "metropolis", "full"


class Particles(InCode, Immutable):
    r"""Beliefs as weighted draws: the posterior as it is, of any shape.

    .. math:: p(x_t \mid z) \approx \sum_i w_t^i \, δ(x_t - x_t^i)

    - x_t^i: the particles, drawn from the transition, p(x_t | x_{t−1}^i);
    - w_t^i: their weights, w_{t−1}^i p(z_t | x_t^i), normalised.

    This is the bootstrap filter: the weights are the density of the measurements. With a `proposal`
    q particles are guided, drawn from q(x_t | x_{t−1}^i, z_t), and their weights are
    w_{t−1}^i p(x_t^i | x_{t−1}^i) p(z_t | x_t^i) / q. They are carried from step to step, as
    logarithms, until they are worth fewer particles than a share of their number,
    1 / Σ w² < threshold n; the particles are then drawn anew in proportion to them. Estimates err
    as 1/√n, whatever the number of components, by a factor that grows quickly with it.

    Parameters
    ----------
    n : int
        How many, of each run.
    seed : int
        Of the draws. Each run and step has a stream of its own: a run's particles are the same in
        any batch in which it has the same place, offline and online.
    proposal : Lineariser, optional
        Particles are moved to where the step's measurements are, by Gaussian beliefs that a
        lineariser makes of each, and weighed exactly for it: for measurements more precise than the
        motion. Without, they are drawn from the transition. Measurements at step 0, and those of
        sensors that are not Gaussian, weigh particles but guide none.
    resampling : str
        ``"systematic"``, ``"stratified"``, ``"residual"`` or ``"multinomial"``.
    number : KLDSampling or LikelihoodSampling, optional
        Chooses how many particles a run has, by how far they spread after each step's measurements,
        or by how well they explain them, n being their number at the start; they are then drawn
        anew at every step that it looks at.
    start : CellProposal, optional
        Draws of a state at step 0 from the likelihood of its measurements, weighed for its prior:
        for a robot that may be anywhere.
    injection : Injection, optional
        Puts particles elsewhere when measurements are no longer explained: for a robot that may
        have been carried away. Filters only.
    threshold : float
        The share of effective particles below which they are drawn anew: 1 at every step, 0 never.
    smoothing : str
        ``"metropolis"``: backward trajectories are moved by independent proposals from the filtered
        particles, begun at each particle's own ancestor; ``"full"``: drawn from all n of them,
        which takes n² densities a step.
    moves : int
        Of the Metropolis chain, at each step of a trajectory.
    trajectories : int, optional
        How many are drawn backwards; n, if not given.
    impossible : str
        Where no particle explains a step's measurements: ``"raise"`` an error, ``"ignore"`` them,
        or ``"restart"`` from the prior. `status` tells.
    dtype : numpy type
        Of the states, ``np.float64`` or ``np.float32``. Weights are float64.

    Raises
    ------
    ModelError
        If one of these is of a wrong kind.

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

    n: int
    seed: int
    proposal: Lineariser | None
    resampling: str
    number: KLDSampling | LikelihoodSampling | None
    start: CellProposal | None
    injection: Injection | None
    threshold: float
    smoothing: str
    moves: int
    trajectories: int
    impossible: str
    dtype: Any

    def __init__(
        self,
        n: int,
        *,
        seed: int = 0,
        proposal: Lineariser | None = None,
        resampling: str = "systematic",
        number: KLDSampling | LikelihoodSampling | None = None,
        start: CellProposal | None = None,
        injection: Injection | None = None,
        threshold: float = 0.5,
        smoothing: str = METROPOLIS,
        moves: int = 30,
        trajectories: int | None = None,
        impossible: str = RAISE,
        dtype: Any = np.float64,
    ) -> None:
        self._whole("n", n, 1)
        self._whole("seed", seed, 0)
        self._whole("moves", moves, 1)
        if trajectories is not None:
            self._whole("trajectories", trajectories, 1)
        self._one_of("resampling", resampling, tuple(RESAMPLERS))
        self._one_of("smoothing", smoothing, (METROPOLIS, FULL))
        self._one_of("impossible", impossible, (RAISE, IGNORE, RESTART))
        if not is_number(threshold) or not 0.0 <= threshold <= 1.0:
            raise ModelError(f"Particles: threshold is a share from 0 to 1, not {threshold!r}")
        if not isinstance(number, KLDSampling | LikelihoodSampling | None):
            raise ModelError(
                f"Particles: number is a pgm.KLDSampling(...) or pgm.LikelihoodSampling(...), not "
                f"{number!r}; how many there are at the start is n"
            )
        if not isinstance(start, CellProposal | None):
            raise ModelError(f"Particles: start is a pgm.CellProposal(...), not {start!r}")
        if not isinstance(injection, Injection | None):
            raise ModelError(f"Particles: injection is a pgm.Injection(...), not {injection!r}")
        if proposal is not None:
            require_lineariser(proposal)
            if isinstance(number, LikelihoodSampling):
                raise ModelError(
                    "Particles: a LikelihoodSampling counts particles drawn from the transition, "
                    "not from a proposal; give one of them"
                )
        if dtype not in (np.float64, np.float32):
            raise ModelError(f"Particles: dtype is np.float64 or np.float32, not {dtype!r}")
        self._set(
            n=int(n),
            seed=int(seed),
            proposal=proposal,
            resampling=resampling,
            number=number,
            start=start,
            injection=injection,
            threshold=float(threshold),
            smoothing=smoothing,
            moves=int(moves),
            trajectories=int(n if trajectories is None else trajectories),
            impossible=impossible,
            dtype=np.dtype(dtype).type,
        )

    @property
    def most(self) -> int:
        """The most particles of a run at a step."""
        return self.n if self.number is None else max(self.n, self.number.most)

    def _whole(self, name: str, value: Any, least: int) -> None:
        if not is_whole(value) or not least <= value < 2**63:
            raise ModelError(f"Particles: {name} is a whole number from {least} on, not {value!r}")

    def _one_of(self, name: str, value: Any, choices: tuple[str, ...]) -> None:
        if not isinstance(value, str) or value not in choices:
            raise ModelError(f"Particles: {name} is one of {', '.join(choices)}; found {value!r}")

    def __repr__(self) -> str:
        number = "" if self.number is None else f", then {self.number!r}"
        named = ["begun in cells"] * (self.start is not None)
        named += ["injected"] * (self.injection is not None)
        if self.proposal is not None:
            named.append(f"guided by {self.proposal!r}")
        named += [f"{self.resampling} below {self.threshold:g}", f"seed {self.seed}"]
        return f"Particles({self.n:,}{number}, {', '.join(named)})"
