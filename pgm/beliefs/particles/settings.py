"""A user's choice of particles: how many there are, and how they are drawn and replaced."""

from typing import Any, Self

import numpy as np

from pgm.arguments import public
from pgm.beliefs.particles.cell_proposal import CellProposal
from pgm.beliefs.particles.number import KLDSampling, LikelihoodSampling
from pgm.boundary import is_number, is_whole
from pgm.display import InCode
from pgm.errors import ModelError
from pgm.immutable import Immutable
from pgm.kernels.arrays import Array
from pgm.kernels.resampling import RESAMPLERS
from pgm.linearisers import Lineariser
from pgm.schedules.argument_checks import require_lineariser


@public
class Injection(InCode, Immutable):
    r"""A share of particles drawn afresh, when measurements are explained worse than they used to.

    .. math:: \ell_t = \Big( \sum_i w_{t-1}^i \, p(z_t \mid x_t^i) \Big)^{1/b}, \qquad
        s_t = s_{t-1} + α_s (\ell_t - s_{t-1}), \qquad f_t = f_{t-1} + α_f (\ell_t - f_{t-1})

    - w_{t−1}^i, x_t^i: the weights before the measurements z_t of step t, and the particles;
    - ℓ_t: the likelihood of z_t, as its geometric mean over the b components that were measured; of
      a scan b is the beams in use times their weight;
    - s, f: the long-term and short-term averages of ℓ, begun at the first measurements.

    A share of the particles,

    .. math:: \max(0, 1 - f_t / s_t),

    is replaced by draws of a `CellProposal` once the measurements have been taken: the particles of
    the run are drawn anew in proportion to their weights, and in this share of them the state of
    the proposal is replaced, and no other. Weights are equal then. This is for a robot that was
    carried elsewhere, which the model does not know of: the log-evidence is computed before the
    replacement, and nothing can be smoothed.

    Parameters
    ----------
    cells : CellProposal
        The proposal from which the state is drawn; with ``temper=0`` draws are uniform.
    slow, fast : float
        α_s and α_f, 0 < slow < fast <= 1: with a large `fast` one bad scan injects particles at
        once, with a small one it takes several in a row.
    most : float
        The largest share that is replaced at a step, 0 < most <= 1.

    Raises
    ------
    ModelError
        If a number is out of its range, or `cells` is no `CellProposal`.

    References
    ----------
    Gutmann & Fox, An experimental comparison of localization methods continued, 2002; Thrun,
    Burgard & Fox, Probabilistic Robotics, 2005, section 8.3.5.

    Examples
    --------
    >>> from pgm.variables import Variable
    >>> cells = CellProposal(Variable("x"), [[0.0], [1.0]], widths=[1.0])
    >>> Injection(cells, slow=0.05, fast=0.5)
    Injection(CellProposal(x, 2 cells of x 1), slow 0.05, fast 0.5)
    """

    cells: CellProposal
    slow: float
    fast: float
    most: float

    def __init__(
        self, cells: CellProposal, *, slow: float = 0.01, fast: float = 0.3, most: float = 1.0
    ) -> None:
        if not isinstance(cells, CellProposal):
            raise ModelError(f"an Injection draws from a pgm.CellProposal(...), not {cells!r}")
        numbers: tuple[Any, ...] = slow, fast, most
        if not all(is_number(each) for each in numbers) or not 0.0 < slow < fast <= 1.0:
            raise ModelError(
                f"Injection: slow and fast are numbers, 0 < slow < fast <= 1, not {slow!r} and "
                f"{fast!r}"
            )
        if not 0.0 < most <= 1.0:
            raise ModelError(f"Injection: most is a share, 0 < most <= 1, not {most!r}")
        self._set(cells=cells, slow=float(slow), fast=float(fast), most=float(most))

    def averaged(self, before: Array | None, log_density: Array, measured: Array) -> Array:
        """The logarithms of the long-term and short-term averages, (2, runs), after one more step.

        Parameters
        ----------
        before : ndarray or None
            Those of the step before, (2, runs), NaN in runs without any measurement so far; None
            before the first measurements of all runs.
        log_density : ndarray
            ln p of the step's measurements given those before, (runs,).
        measured : ndarray
            The number b of components measured, (runs,); where it is 0 the averages stay.
        """
        runs = len(log_density)
        if before is None:
            before = np.full((2, runs), np.nan)
        level = np.where(measured > 0, log_density / np.where(measured > 0, measured, 1.0), np.nan)
        share = np.log([[self.slow], [self.fast]])
        with np.errstate(invalid="ignore", divide="ignore"):
            later = np.logaddexp(np.log1p(-np.exp(share)) + before, share + level)
        later = np.where(np.isnan(before), level, later)
        return np.where(measured > 0, later, before)

    def shares(self, averages: Array) -> Array:
        """The share of particles to be replaced in each run, (runs,), from 0 to `most`.

        It is max(0, 1 − f_t / s_t), or `most` if that is less.

        Parameters
        ----------
        averages : ndarray
            The logarithms of the long-term average s_t and the short-term average f_t, (2, runs).
        """
        with np.errstate(invalid="ignore"):
            found = -np.expm1(averages[1] - averages[0])
        return np.clip(np.where(np.isnan(found), 0.0, found), 0.0, self.most)

    def __repr__(self) -> str:
        most = "" if self.most == 1.0 else f", at most {self.most:g}"
        return f"Injection({self.cells!r}, slow {self.slow:g}, fast {self.fast:g}{most})"


# The ways on from measurements that no particle explains.
RAISE, IGNORE, RESTART = "raise", "ignore", "restart"
# The ways of drawing trajectories backwards.
METROPOLIS, FULL = "metropolis", "full"


@public
class ParticleSettings(InCode, Immutable):
    """How many particles there are, and how they are drawn, resampled and smoothed; `Particles`."""

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

    def with_seed(self, seed: int) -> Self:
        """The same settings with another seed, whose draws are independent of these ones'."""
        return type(self)(**(self.__dict__ | {"seed": seed}))

    @property
    def most(self) -> int:
        """The largest number of particles that a run may have at a step."""
        return self.n if self.number is None else max(self.n, self.number.most)

    def _whole(self, name: str, value: Any, least: int) -> None:
        """Refuse, by a ModelError, the argument `name` if it is no whole number from `least` on."""
        if not is_whole(value) or not least <= value < 2**63:
            raise ModelError(f"Particles: {name} is a whole number from {least} on, not {value!r}")

    def _one_of(self, name: str, value: Any, choices: tuple[str, ...]) -> None:
        """Refuse, by a ModelError, the argument `name` if it is none of the words `choices`."""
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
