"""The options of schedules: starts, gates, the control of steps; and checks of arguments."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from pgm.arguments import public
from pgm.boundary import is_number, is_whole
from pgm.cpds import CPD, ConditionalGaussian, MixtureCPD, SampledCPD
from pgm.display import InCode
from pgm.errors import EvidenceError, ModelError
from pgm.factors.scope import listed, namesake
from pgm.immutable import Immutable
from pgm.kernels.arrays import Array, Mask
from pgm.variables import Variable


def require_count(owner: object, name: str, value: object) -> None:
    """Refuse what is no whole number, 1 or more."""
    if not is_whole(value) or value < 1:
        raise ModelError(f"{owner!r}: {name} must be a whole number, 1 or more, not {value!r}")


def require_tolerance(owner: object, tolerance: object) -> None:
    """Refuse what is no number, 0 or more."""
    if not is_number(tolerance) or not tolerance >= 0.0:
        raise ModelError(f"{owner!r}: a tolerance must be 0 or more, not {tolerance!r}")


def require_lineariser(lineariser: Any) -> None:
    """Refuse what cannot be called, and a rule that was not made."""
    if not callable(lineariser) or isinstance(lineariser, type):
        raise ModelError(f"{lineariser!r} is no lineariser; give one like pgm.Taylor()")


def require_gaussian(cpds: Iterable[CPD], beliefs: str) -> None:
    """Refuse a CPD that is not Gaussian, where beliefs of some kind need its moments."""
    for cpd in cpds:
        if not isinstance(cpd, ConditionalGaussian):
            raise ModelError(
                f"{cpd!r} is no Gaussian CPD, of which {beliefs} are made; of a dynamic network "
                "belief=pgm.Particles(...) takes any density, and pgm.Grid(...) any that is given",
                variable=cpd.child,
                cpd=cpd,
            )


def require_plain(cpds: Iterable[CPD]) -> None:
    """Refuse robust noise, where there are no residuals of sensors to weigh."""
    for cpd in cpds:
        if isinstance(cpd, ConditionalGaussian) and cpd.noise is not None:
            raise ModelError(
                f"{cpd!r} has robust noise, {cpd.noise!r}: Gaussian beliefs take it of sensors of "
                "a dynamic network alone, whose residuals they weigh; leave noise= out, declare a "
                "sensor, or take belief=pgm.Particles(...) or pgm.Grid(...) of a dynamic network",
                variable=cpd.child,
                cpd=cpd,
            )


def require_density(cpds: Iterable[CPD], beliefs: str) -> None:
    """Refuse a CPD that cannot be asked for its density, where beliefs of some kind need it."""
    for cpd in cpds:
        if isinstance(cpd, MixtureCPD):
            require_density(cpd.parts, beliefs)
        elif isinstance(cpd, ConditionalGaussian) and cpd.noise is not None:
            cpd.noise.require_proper(cpd.child.dimension, cpd)
        elif isinstance(cpd, SampledCPD) and cpd.density is None:
            raise ModelError(
                f"{cpd!r} has no density, by which {beliefs} move and weigh beliefs: give it "
                "log_density=, or take belief=pgm.Particles(...), which draws a transition",
                variable=cpd.child,
                cpd=cpd,
            )


def require_whole(cpd: CPD, taken: Mask, step: int) -> None:
    """Refuse a measurement with missing components, where a density cannot leave them out."""
    if not taken.all() and not cpd.partial:
        raise EvidenceError(
            f"{cpd!r}: a measurement at step {step} has components that are NaN, which the "
            "density of such a CPD cannot leave out; give all of them, or none",
            variable=cpd.child,
            cpd=cpd,
            step=step,
        )


# Means of hidden variables.
Start = Mapping[Variable, npt.ArrayLike]


def require_hidden(start: Start, hidden: Collection[Variable]) -> None:
    """Refuse a start that is no mapping, or names what is not hidden."""
    if not isinstance(start, Mapping):
        raise EvidenceError(f"start maps variables to means; found {type(start).__name__}")
    for variable in start:
        if variable not in hidden:
            raise EvidenceError(
                f"start has {variable!r}, which is not hidden; it takes {listed(hidden)}"
                f"{namesake(variable, hidden)}",
                variable=variable,
            )


def over_runs(variable: Variable, means: Array, lead: tuple[int, ...], axes: int) -> Array:
    """The means of a variable, (..., own axes), for all of the evidence's runs, (runs, ...)."""
    own, rest = means.shape[: means.ndim - axes], means.shape[means.ndim - axes :]
    try:
        wide = np.broadcast_to(means, (*lead, *rest))
    except ValueError:
        raise EvidenceError(
            f"start for {variable!r} has the axes of runs {own}, which do not broadcast to those "
            f"of the evidence, {lead}",
            variable=variable,
        ) from None
    return wide.reshape(-1, *rest)


class Gates(Immutable, Mapping[Variable, float]):
    """A gate for each of some sensors; the others have none."""

    _gates: dict[Variable, float]

    def __init__(self, gates: Mapping[Variable, float]) -> None:
        self._set(_gates=dict(gates))

    def __getitem__(self, sensor: Variable) -> float:
        return self._gates[sensor]

    def __iter__(self) -> Iterator[Variable]:
        return iter(self._gates)

    def __len__(self) -> int:
        return len(self._gates)

    def __hash__(self) -> int:
        return hash(frozenset(self._gates.items()))

    def __repr__(self) -> str:
        return repr(dict(self._gates))


Gate = float | Mapping[Variable, float] | None


def as_gate(owner: str, gate: object) -> float | Gates | None:
    """A gate as a schedule keeps it; what is none is refused."""
    if gate is None:
        return None
    if not isinstance(gate, Mapping):
        return _probability(owner, gate, "")
    for sensor in gate:
        if not isinstance(sensor, Variable):
            raise ModelError(
                f"{owner}: gate= maps sensors' variables to probabilities, not {sensor!r}"
            )
    return Gates({sensor: _probability(owner, p, f" of {sensor!r}") for sensor, p in gate.items()})


def _probability(owner: str, value: object, of: str) -> float:
    if not is_number(value) or not 0.0 < value < 1.0:
        none = "left out for no gate" if of else "or None for no gate"
        raise ModelError(
            f"{owner}: a gate{of} is a probability between 0 and 1, such as 0.99, {none}; found "
            f"{value!r}"
        )
    return float(value)


def gate_of(gate: Gate, sensor: Variable) -> float | None:
    """The gate of one sensor, None where it has none."""
    return gate.get(sensor) if isinstance(gate, Mapping) else gate


@public
@dataclass(frozen=True)
class LevenbergMarquardt(InCode):
    """Steps that never raise the cost: full ones where they lower it, else held back.

    The cost of a point x is that of the expected functions, with the covariances P and the noise
    of the linearisation held fixed,

        Σ rᵀ Σ⁻¹ r over all CPDs,  r = y − E[f(X)],  X ~ N(x, P):

    under `Taylor` twice the negative log-density of x and the measurements, but for a constant. A
    full step that raises it is taken back, and tried again with a measurement x = (the point) + n
    added, n ~ N(0, diag(P)/λ), λ growing from try to try; if no try lowers the cost the means stay.
    A posterior's means are those of the last point accepted, its covariances those of the last
    linearisation, without the added measurement.

    It suits `Taylor`, and rules as exact as `GaussHermite`. With few points F is only nearly the
    derivative of E[f(X)], so that close to a fixed point no step may lower the cost: the means
    stay some hundredths of a deviation short of it, and `status` says not converged; a number as
    damping gets there.

    The first solution of a smoother, the filter's linearisation, is not controlled. From a start,
    or dead reckoning on a `Balanced` tree, the first step is: the cost of the start is never
    exceeded. A start that does not obey the exact CPDs (linear, with singular noise) has no cost,
    and is represented by its projection onto them; so is a filter's predicted belief beside an
    exact measurement, by the belief given that alone.

    Parameters
    ----------
    start : float
        λ of the first try, and the least; positive.
    factor : float
        What λ is multiplied with at each failure, and divided by after each success; above 1.
    tries : int
        Tries at the most in one iteration.

    References
    ----------
    Lindqvist, Särkkä, García-Fernández, Raitoharju & Svensson, Posterior linearisation smoothing
    with robust iterations, 2021.

    Examples
    --------
    >>> from pgm.examples import squares, x, z
    >>> control = pgm.LevenbergMarquardt()
    >>> posterior = pgm.smooth(squares, {z: [[9.0]]}, iterations=20, damping=control)
    >>> posterior[x].mean.ravel().round(2), bool(posterior.status.converged)
    (array([2., 3.]), True)
    """

    start: float = 0.01
    factor: float = 10.0
    tries: int = 10

    def __post_init__(self) -> None:
        require_count(self, "tries", self.tries)
        if not is_number(self.start) or not 0.0 < self.start < float("inf"):
            raise ModelError(f"{self!r}: start is a positive number, not {self.start!r}")
        if not is_number(self.factor) or not 1.0 < self.factor < float("inf"):
            raise ModelError(f"{self!r}: factor is a number above 1, not {self.factor!r}")


# The share of the old point that is kept, in [0, 1), or a control of each step by its cost.
Damping = float | LevenbergMarquardt


def require_damping(schedule: object, damping: object) -> None:
    """Refuse what is no damping."""
    if isinstance(damping, LevenbergMarquardt):
        return
    if not is_number(damping) or not 0.0 <= damping < 1.0:
        raise ModelError(
            f"{schedule!r}: damping is the share of the old point that is kept, in [0, 1), or "
            f"pgm.LevenbergMarquardt(), not {damping!r}"
        )
