"""Damping of iterated schedules: by a fixed share of the old point, or Levenberg–Marquardt."""

from __future__ import annotations

from dataclasses import dataclass

from pgm.arguments import public
from pgm.boundary import is_number
from pgm.display import InCode
from pgm.errors import ModelError
from pgm.schedules.argument_checks import require_count


@public
@dataclass(frozen=True)
class LevenbergMarquardt(InCode):
    """Steps that never raise the cost: full ones where they lower it, else held back.

    A point of linearisation is a mean of every hidden variable, and a step leads from one point to
    the next. A CPD says that its child is f(parents) + e, with noise e ~ N(0, R). A point gives the
    means x of the parents and y of the child; of a sensor y is the measured value. The belief's
    covariance of the parents is P, and Q is R plus the covariance of the linearisation's error. The
    cost of a point is

        sum of rᵀ Q⁻¹ r over all CPDs,  r = y − E[f(X)],  X ~ N(x, P).

    In a filter the CPDs are the sensors of the step, and the predicted belief is one more. P and Q
    are held fixed where costs are compared. A CPD with robust noise adds twice its loss in place of
    rᵀ Q⁻¹ r. Under `Taylor` the cost is twice the negative log-density of the point and the
    measurements, but for a constant.

    The full step takes the means of the solution of the linearised model. If they raise the cost,
    the model is solved again with an added measurement of each component of each mean: its value is
    the old point's, its noise variance the belief's variance divided by λ. The larger λ, the nearer
    the solution is to the old point. λ grows from try to try. If no try lowers the cost, the means
    stay. A posterior's means are those of the last point accepted. Its covariances are those of the
    last linearisation, without the added measurement.

    This damping suits `Taylor`, and rules as exact as `GaussHermite`. With few sigma points the
    slope of the linearisation is only nearly the derivative of E[f(X)]. Close to a fixed point it
    may then be that no step lowers the cost: the means stay some hundredths of a standard deviation
    short of the fixed point, and `status` says that they have not converged. A damping that is a
    number reaches it.

    A smoother's step from the filter's linearisation to its first solution is not controlled. The
    first step from a user's start, or from dead reckoning on a `Balanced` tree, is controlled: the
    cost of the start is never exceeded. A start that does not obey the exact CPDs (linear, with
    singular noise) has no finite cost: its projection onto them takes its place. In a filter the
    predicted mean has no finite cost if it contradicts an exact measurement: the mean of the
    predicted belief given the exact measurements alone takes its place.

    On a tree without time the first step is controlled from a user's start, and, by `Taylor`, from
    the prior's means. There nonlinear CPDs of singular noise are taken, too, of variables without
    evidence and by `Taylor`: each solution is moved to obey them. Where y is without noise a
    function of a parent u that can be solved for u, as of a motion x ⊕ u, and u has noise and no
    other child, u is; else y is set to the function's value.

    Parameters
    ----------
    start : float
        λ of the first try, and the least; positive.
    factor : float
        The number, above 1, by which λ is multiplied at each failure and divided after each
        success.
    tries : int
        The most tries with an added measurement in one iteration.

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
    """Refuse a damping that is neither a number in [0, 1) nor a `LevenbergMarquardt`.

    The error is a `ModelError`, whose text begins with the repr of `schedule`.
    """
    if isinstance(damping, LevenbergMarquardt):
        return
    if not is_number(damping) or not 0.0 <= damping < 1.0:
        raise ModelError(
            f"{schedule!r}: damping is the share of the old point that is kept, in [0, 1), or "
            f"pgm.LevenbergMarquardt(), not {damping!r}"
        )
