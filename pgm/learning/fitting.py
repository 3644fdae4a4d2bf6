"""Expectation-maximisation, accelerated, of a network's parameters."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from pgm.arguments import public
from pgm.beliefs.own.family import BeliefFamily, require_family
from pgm.boundary import is_number, is_whole
from pgm.cpds import CPD
from pgm.display import titled
from pgm.errors import (
    ConvergenceWarning,
    EvidenceError,
    ModelError,
    NumericalError,
    PgmError,
    levels_to_user,
)
from pgm.evidence import Evidence
from pgm.inference import Smoothing
from pgm.kernels.arrays import Array
from pgm.learning.model import Expected, Learner, Point
from pgm.learning.records import RecordLearner
from pgm.learning.values import Fit, FitStatus, Learn
from pgm.linearisers import TAYLOR, Lineariser, Taylor
from pgm.networks import BayesianNetwork, DynamicBayesianNetwork
from pgm.progress import Progress, counted, reporting
from pgm.schedules.argument_checks import require_lineariser
from pgm.schedules.schedule import Calibration

# The least cosine between a move and the change of the gradient that tells a curvature.
_TOLD = 1e-14


class QuasiNewton:
    """Quasi-Newton maximisation: EM's step first, then curvature learnt from gradients.

    With the gradient g of the log-evidence ℓ, which by Fisher's identity is that of the expected
    log-density at the same point, and the EM step e(θ) = M(θ) − θ, the step is

    .. math:: d = e + S g,

    with S symmetric, zero at first, and after each move Δθ changed by Broyden, Fletcher, Goldfarb
    and Shanno's rule, so that it would have told that move: Δθ = −(Δe + S Δg).

    As long as the log-evidence bends upwards along the moves, so that no curvature can be learnt,
    steps are those of EM, stretched twice as far each time (Jamshidian & Jennrich, 1997).
    """

    def __init__(self, size: int) -> None:
        self.correction = np.zeros((size, size))
        self.last: tuple[Array, Array, Array] | None = None
        self.stretch = 1.0

    def forget(self) -> None:
        """Begin again as EM."""
        self.correction[:] = 0.0
        self.last, self.stretch = None, 1.0

    def step(self, point: Array, gradient: Array, plain: Array) -> Array | None:
        """The step at the next point, given EM's; None where nothing is known beyond that."""
        if self.last is not None:
            move, turned, changed = (
                a - b for a, b in zip((point, gradient, plain), self.last, strict=True)
            )
            self._learn(move, turned, changed)
        self.last = point, gradient, plain
        if not self.correction.any():
            self.stretch *= 2.0
            return self.stretch * plain if self.stretch > 2.0 else None
        step: Array = plain + self.correction @ gradient
        if not np.isfinite(step).all() or step @ gradient <= 0.0:
            self.forget()
            self.last = point, gradient, plain
            return None
        return step

    def _learn(self, move: Array, turned: Array, changed: Array) -> None:
        """Update the correction S to tell the last move: Δθ = −(Δe + S Δg) holds of the new S.

        `move` is Δθ, `turned` the change Δg of the gradient, `changed` that of the EM step, Δe.
        With the residual l = Δθ + Δe + S Δg and the curvature b = −Δgᵀ Δθ the update is

            S ← S + (l Δθᵀ + Δθ lᵀ) / b + (lᵀ Δg / b²) Δθ Δθᵀ.

        Where b is not positive, the log-evidence bending upwards along the move, or b is lost in
        rounding, S stays.
        """
        bend = -float(turned @ move)
        if bend <= _TOLD * float(np.linalg.norm(turned) * np.linalg.norm(move)):
            return
        left = move + changed + self.correction @ turned
        both = np.outer(left, move)
        self.correction += (both + both.T) / bend
        self.correction += float(left @ turned) / bend**2 * np.outer(move, move)


class Secant:
    """Steps towards a fixed point M(θ) = θ: EM's step first, then by secants of earlier moves.

    With the move e(θ) = M(θ) − θ of a plain step, the step is d = B e, with B one at first, and
    after each move Δθ changed by Broyden's rule, so that it would have told it: Δθ = −B Δe
    (Jamshidian & Jennrich, 1997, method QN1). Where the move became longer, B is one again.
    """

    def __init__(self, size: int) -> None:
        self.inverse = np.eye(size)
        self.last: tuple[Array, Array] | None = None

    def step(self, point: Array, plain: Array) -> Array:
        """The step at the next point, given the plain one."""
        if self.last is not None:
            move, turned = point - self.last[0], plain - self.last[1]
            told = self.inverse @ -turned
            along = float(move @ told)
            longer = float(plain @ plain) > float(self.last[1] @ self.last[1])
            if longer or along <= _TOLD * float(move @ move):
                self.inverse = np.eye(len(point))
            else:
                self.inverse += np.outer(move - told, move @ self.inverse) / along
        self.last = point, plain
        return self.inverse @ plain


# How often a step is halved: a quasi-Newton one, by a quarter, before a plain one is taken.
_HALVINGS, _QUARTERS = 5, 1
# The part of an objective that may be rounding, and of a coordinate that is no move; at a fixed
# point that has no objective it is smaller.
_ROUNDING, _STILL, _FIXED = 1e-13, 1e-3, 1e-4
# The part of what the gradient promises that a quasi-Newton step has to gain.
_PROMISE = 1e-4
# Nats that a step gains although a noise has vanished, where there is no end to it.
_ENDLESS = 1.0
# M steps of a closed form, at most, from any float to any other. Where a coordinate fell below this
# part of what it was, it may be rounding of that, and where it rose it was; another step follows.
_PASSES, _ALIKE = 40, 0.1


class Search:
    """The working place of `fit`."""

    def __init__(
        self, learner: Learner, iterations: int, tolerance: float, *, accelerate: bool
    ) -> None:
        self.learner, self.iterations, self.tolerance = learner, iterations, tolerance
        size = learner.vector(learner.start).size
        self.newton = QuasiNewton(size) if accelerate else None
        self.secant = Secant(size) if accelerate else None
        self.e_steps = self.accepted = self.refused = self.halved = 0
        self.stopped = f"after the {iterations} iterations that were asked for"
        # Whether the smoothers of the last E step have settled, as far as they were to iterate.
        self.smoothed = True
        # Whether all iterations were made.
        self.exhausted = False

    def run(self) -> Fit:
        """Go up until nothing is gained."""
        learner, converged = self.learner, False
        here: Expected | None = None
        trace: list[float] = []
        priors: list[float] = []
        for _ in counted(range(self.iterations + 1), "EM"):
            if here is None:
                here = self._expected(learner.start)
                trace.append(here.log_evidence)
                priors.append(here.log_prior)
                continue
            if learner.closed:
                here, converged, self.stopped = self._closed(here), True, _CLOSED
                trace.append(here.log_evidence)
                priors.append(here.log_prior)
                break
            before = here
            image, gradient = learner.improved(here)
            x, y = learner.vector(here.point), learner.vector(image)
            if learner.by_equations:
                step = y - x if self.secant is None else self.secant.step(x, y - x)
                here = self._by_equations(here, image, x, y, step)
                trace.append(here.log_evidence)
                priors.append(here.log_prior)
                far = np.maximum(np.abs(y - x), np.abs(step))
                if (far / (1.0 + np.abs(x))).max(initial=0.0) <= _FIXED:
                    converged, self.stopped = True, _EQUATIONS
                    break
                continue
            there = self._accelerated(here, x, gradient, y - x) or self._plain(here, image, x, y)
            if there is None:
                converged = self.stopped in (_ROUNDED, _WITHIN)
                if not converged and (cpd := learner.vanishing(here)) is not None:
                    self.stopped = _endless(cpd)
                break
            here = there
            trace.append(here.log_evidence)
            priors.append(here.log_prior)
            gained = here.objective - before.objective
            if gained > _ENDLESS and (cpd := learner.vanishing(here)) is not None:
                self.stopped = _endless(cpd)
                break
            moved = np.abs(learner.vector(here.point) - x) / (1.0 + np.abs(x))
            if gained <= self.tolerance and moved.max(initial=0.0) <= _STILL:
                converged = True
                self.stopped = _WITHIN
                break
        else:
            self.exhausted = True
        assert here is not None
        asked = learner.schedule
        self.smoothed = (
            asked is None
            or asked.iterations == 1
            or all(bool(each.status.converged.all()) for each in here.posteriors)
        )
        status = FitStatus(
            len(trace) - 1,
            self.e_steps,
            self.accepted,
            self.refused,
            self.halved,
            converged,
            self.stopped,
            learner.closed,
        )
        return learner.fit(here, trace, priors, status)

    def _closed(self, here: Expected) -> Expected:
        """The optimum where all that is learnt was observed.

        Further M steps make up for what sums lose in rounding at a start that is far away: each
        begins some sixteen digits nearer, until all are of the size that they had before.
        """
        cpd: Any = None
        try:
            for k in range(_PASSES):
                was = np.abs(self.learner.vector(here.point))
                image, _ = self.learner.improved(here)
                here = replace(here, point=image, expectations=self.learner.again(image))
                now = np.abs(self.learner.vector(image))
                if k and not (np.minimum(was, now) < _ALIKE * np.maximum(was, now)).any():
                    break
            if (cpd := self.learner.vanishing(here)) is None:
                return self._expected(image)
        except NumericalError:
            pass
        raise ModelError(
            f"the likeliest noise of {'a CPD' if cpd is None else repr(cpd)} vanishes: its records "
            "are explained exactly, or are too few; bound it, pgm.learning.Covariance(lower=)",
            cpd=cpd,
        )

    def _expected(self, point: Point) -> Expected:
        self.e_steps += 1
        return self.learner.expected(point)

    def _by_equations(
        self, here: Expected, image: Point, x: Array, y: Array, step: Array
    ) -> Expected:
        """The E step at the next point of a search for a fixed point.

        That is after a step by secants, or at the plain step's `image`, if the former is the same,
        moves a coordinate by more than half of its size, or leads to where there is no belief.
        """
        near = np.maximum(0.5 * np.abs(x), np.abs(y - x))
        if not np.array_equal(step, y - x) and (np.abs(step) <= near).all():
            try:
                found = self._expected(self.learner.at(here.point, x + step))
            except PgmError:
                self.refused += 1
            else:
                self.accepted += 1
                return found
        return self._expected(image)

    def _tried(self, here: Expected, vector: Array, least: float = 0.0) -> Expected | None:
        """A point of some coordinates, if its objective is higher, by more than the least."""
        try:
            with np.errstate(all="ignore"):  # what is not finite is refused
                found = self._expected(self.learner.at(here.point, vector))
        except PgmError:
            return None
        return found if found.objective - here.objective > least else None

    def _accelerated(
        self, here: Expected, x: Array, gradient: Array, plain: Array
    ) -> Expected | None:
        """The E step at a quasi-Newton step from `here`, or at a quarter of it; None if it fails.

        `x` are the coordinates of `here`, `gradient` that of the objective and `plain` the EM step.
        A step d must gain 10⁻⁴ of the gᵀd nats that the gradient promises. Where neither the whole
        step nor its quarter does, the curvature learnt is forgotten; None also where there is none.
        """
        step = None if self.newton is None else self.newton.step(x, gradient, plain)
        if step is None:
            return None
        for k in range(_QUARTERS + 1):
            part = 0.25**k
            least = _PROMISE * part * float(gradient @ step)
            found = self._tried(here, x + part * step, least)
            if found is not None:
                self.accepted += 1
                return found
            self.refused += 1
        assert self.newton is not None
        self.newton.forget()
        return None

    def _plain(self, here: Expected, image: Point, x: Array, y: Array) -> Expected | None:
        """The M step, or the longest of its halves that is higher."""
        rounding = _ROUNDING * max(abs(here.objective), 1.0)
        try:
            found = self._expected(image)
        except PgmError:
            found = None
        if found is not None and found.objective > here.objective:
            return found
        if found is not None and found.objective >= here.objective - rounding:
            self.stopped = _ROUNDED
            return None
        # Of a linearised model the log-evidence is not quite what a plain step raises: near its
        # optimum small steps lose a little.
        still = (np.abs(y - x) / (1.0 + np.abs(x))).max(initial=0.0) <= _STILL
        if still and found is not None and found.objective >= here.objective - self.tolerance:
            self.stopped = _WITHIN
            return None
        for k in range(1, _HALVINGS + 1):
            self.halved += 1
            half = self._tried(here, x + 0.5**k * (y - x))
            if half is not None:
                return half
        self.stopped = "no part of a plain step raises the log-evidence; it was refused"
        return None


_CLOSED = "all that is learnt was observed: a closed form, no search was needed"
_EQUATIONS = "parameters and weights are at a fixed point, of which there is no likelihood"
_ROUNDED, _WITHIN = "rounding alone was left", "a step was within the tolerance"


def _endless(cpd: CPD) -> str:
    """Why a search stops where a noise vanishes."""
    return (
        f"the noise of {cpd!r} vanishes, and the log-evidence rises with it without end: something "
        "is explained exactly; bound it, pgm.learning.Covariance(lower=)"
    )


# Smoothers of each E step, or posteriors of records: weights of robust noise are found by
# iterations.
_ONCE, _WEIGHED = Smoothing(), Smoothing(iterations=100)
_RECORDS_WEIGHED = Calibration(iterations=100)
# Its weights raise the bound of the evidence, as parameters do.
_EXPECTED = Taylor(expected=True)


@public
def fit(
    model: DynamicBayesianNetwork | BayesianNetwork,
    evidence: Evidence | Sequence[Evidence],
    *,
    learn: Learn,
    weights: npt.ArrayLike | Sequence[npt.ArrayLike] | None = None,
    lineariser: Lineariser = TAYLOR,
    schedule: Calibration | None = None,
    belief: BeliefFamily[Any] | None = None,
    steps: int | Sequence[int | None] | None = None,
    iterations: int = 200,
    tolerance: float = 1e-6,
    accelerate: bool = True,
    progress: Progress = False,
) -> Fit:
    r"""Learn parameters of a network from recordings or records, by expectation-maximisation.

    Each step smooths the recordings (E) and takes the parameters that maximise the expected
    log-density (M),

    .. math:: \theta_{k+1} = \arg\max_\theta E[\ln p(x, z \mid \theta) \mid z, \theta_k],

    which never lowers the log-evidence ln p(z | θ): it is closed for affine CPDs and tables, with
    expectations by the lineariser for others. Quasi-Newton steps, by the gradient that the same
    beliefs give, are taken where they raise the log-evidence; else the plain one. A plain step
    that does not, as of nonlinear models it may, is halved five times, and then refused. Where a
    noise vanishes and the log-evidence rises without end the search stops, and its status says so.

    Measurements of robust noise count with their weights in both steps, at which log-evidence is a
    lower bound that neither lowers. The weights are those of expected squares: without a
    lineariser, `Taylor(expected=True)`. So Student-t noise is learnt, a distribution; the
    covariance of a loss (Huber, Cauchy, truncated least squares) is that of the readings without
    outliers. Its likelihood would be that of its tails, and with a gate there is none: steps go on
    until parameters stay, what is spared being made up for as of Gaussian residuals. They do so
    too where Gaussian noise, as of a motion, is learnt beside Student-t noise on a chain: that
    which maximises the bound is too small, so that covariances are of readings that count with the
    information that they have on average.

    A network without time is learnt from records, the rows of its evidence. Where the child and the
    parents of all that is learnt were observed, there is a closed form, and no search, unless its
    noise is robust. States told by `soft` weights count by these times their probabilities.

    Where discrete variables choose among CPDs (`SwitchingCPD`), each row enters the expectations of
    a case by the probability that this holds there. Where mixtures of Gaussians are merged, the
    log-evidence and its gradient are approximate, as of nonlinear models.

    Parameters
    ----------
    model : DynamicBayesianNetwork or BayesianNetwork
        With the values to begin with.
    evidence : mapping of Variable, or sequence of them
        Evidence of one or several recordings, as for `smooth`; runs on leading axes share the
        parameters. Without time as for `infer`: leading axes are records, as `records` makes them.
    learn : mapping of Variable
        The parts that are learnt, all else being fixed: by ``x.at(0)`` of the prior of a state, by
        ``x`` of its transition, by ``z`` of a sensor, a part of `pgm.learning` or a tuple of them,
        ``{x: (Coefficients(), Covariance("diagonal")), z: Covariance()}``, of Student-t noise also
        its `DegreesOfFreedom`; by an input its `Parameter`. Of a `SwitchingCPD` that is learnt of
        every case; or, by state, of some: ``{z: {"working": Covariance()}}``.
    weights : array_like, or sequence of array_like, optional
        Of the records of a network without time, of the evidence's leading axes; one for each of
        several mappings.
    lineariser, schedule : optional
        Settings of the smoother, or of the posterior of records (`Calibration`). Without a schedule
        it linearises once, ``Smoothing(iterations=...)`` again; where noise is robust up to 100
        times, weighing measurements each time. With a gate each E step decides anew which
        measurements are taken in.
    belief : BeliefFamily, optional
        How many Gaussians mixtures of a model with discrete and continuous variables have:
        ``pgm.Gaussians(8)``.
    steps : int or sequence of int, optional
        T, or that of each recording, where no plain array tells.
    iterations : int
        The largest number of EM iterations.
    tolerance : float
        The search has converged after a step that raised the log-evidence by no more (in nats) and
        moved no coordinate by more than a thousandth. With 0 all iterations are made, and none is
        missed (no `ConvergenceWarning`).
    accelerate : bool
        Whether quasi-Newton steps are tried.
    progress : bool or callable
        As for `infer`.

    Warns
    -----
    ConvergenceWarning
        If the search ends before it converges, ``status.stopped`` saying why, or the smoothers of
        its last step do.

    Raises
    ------
    ModelError
        If something is to be learnt that is not there, or cannot be from its start, or a noise of
        which all was observed vanishes.
    EvidenceError
        If evidence is no mapping, or nothing in it tells of a CPD that is to be learnt.
    PgmError
        For the same reasons as `smooth`, at the start.

    References
    ----------
    Shumway & Stoffer, An approach to time series smoothing and forecasting using the EM algorithm,
    1982. Jamshidian & Jennrich, Acceleration of the EM algorithm by using quasi-Newton methods,
    1997, method QN2. Lange, Little & Taylor, Robust statistical modeling using the t distribution,
    1989. Liu & Rubin, ML estimation of the t distribution using EM and its extensions, ECM and
    ECME, 1995. Huber, Robust estimation of a location parameter, 1964 (proposal 2); The behavior of
    maximum likelihood estimates under nonstandard conditions, 1967. Windham,
    Robustifying model fitting, 1995. Kokkala, Solin & Särkkä, Sigma-point filtering and smoothing
    based parameter estimation in nonlinear dynamic systems, 2015.

    Examples
    --------
    >>> from pgm.examples import walk, x, z
    >>> from pgm.learning import Coefficients, Covariance
    >>> recording = walk.sample(steps=500, rng=1).evidence
    >>> found = pgm.fit(walk, recording, learn={x: (Coefficients(), Covariance())})
    >>> found.model.transition[0].matrices[x.previous].round(1)
    array([[1.]])
    """
    if not isinstance(model, DynamicBayesianNetwork | BayesianNetwork):
        raise ModelError(f"a dynamic network or a BayesianNetwork was due, not {titled(model)}")
    single = isinstance(evidence, Mapping)
    recordings = _recordings(evidence)
    every = _lengths(steps, len(recordings))
    if not isinstance(learn, Mapping) or not learn:
        raise ModelError(
            "learn= maps variables to what is learnt of their CPDs, "
            f"{{z: pgm.learning.Covariance()}}; found {learn!r}"
        )
    if not is_whole(iterations) or iterations < 1:
        raise ModelError(f"iterations= is a whole number from 1 on, not {iterations!r}")
    if not is_number(tolerance) or not tolerance >= 0.0:
        raise ModelError(f"tolerance= is a number, 0 or more, not {tolerance!r}")
    if not isinstance(accelerate, bool):
        raise ModelError(f"accelerate= is True or False, not {accelerate!r}")
    require_lineariser(lineariser)
    learner: Learner
    weighed = _is_weighed(model)
    if lineariser == TAYLOR and weighed:
        lineariser = _EXPECTED
    if isinstance(model, BayesianNetwork):
        _require_records(schedule, belief, steps)
        rows = [weights] if single or weights is None else list(weights)  # type: ignore[arg-type]
        rows = rows * len(recordings) if weights is None else rows
        if len(rows) != len(recordings):
            raise ModelError(f"weights= has {len(rows)} entries for {len(recordings)} of evidence")
        if schedule is None and weighed:
            schedule = _RECORDS_WEIGHED
        learner = RecordLearner(
            model, recordings, rows, learn, lineariser, schedule, None, every, single=single
        )
    else:
        if weights is not None:
            raise ModelError("weights= are of records of networks without time; leave them out")
        if schedule is None:
            schedule = _WEIGHED if weighed else _ONCE
        if not isinstance(schedule, Smoothing):
            raise ModelError(f"schedule= is pgm.Smoothing(...), not {titled(schedule)}")
        if belief is not None:
            require_family(belief, model)
        learner = Learner(
            model, recordings, learn, lineariser, schedule, belief, every, single=single
        )
    with reporting(progress):
        search = Search(learner, int(iterations), float(tolerance), accelerate=accelerate)
        found = search.run()
    # A tolerance of 0 asks for a number of iterations, of which none is missed.
    _tell(
        found,
        searched=found.status.converged or (tolerance == 0.0 and search.exhausted),
        smoothed=search.smoothed or (schedule is not None and schedule.tolerance == 0.0),
    )
    return found


def _require_records(schedule: object, belief: object, steps: object) -> None:
    """Refuse options of chains, for networks without time."""
    if schedule is not None and (
        isinstance(schedule, Smoothing) or not isinstance(schedule, Calibration)
    ):
        raise ModelError(
            f"schedule= is pgm.Calibration(...) of a network without time, not {titled(schedule)}"
        )
    for name, value in (("belief", belief), ("steps", steps)):
        if value is not None:
            raise ModelError(
                f"records of a network without time are learnt without {name}=; leave it out"
            )


def _is_weighed(model: DynamicBayesianNetwork | BayesianNetwork) -> bool:
    """Whether measurements are weighed by robust noise, as they are where beliefs are Gaussian."""
    gaussian = not (model.discrete or model.mixed)
    return gaussian and any(getattr(cpd, "noise", None) is not None for cpd in model.cpds)


def _tell(found: Fit, *, searched: bool, smoothed: bool) -> None:
    """Warn, once, of a search that did not end as it should, or of its last smoothers."""
    status = found.status
    if not searched:
        gained = float(np.diff(found.log_evidence[-2:]).sum())
        message = (
            f"the search for parameters ended unconverged, {status.stopped}; its last step gained "
            f"{gained:.3g} nats (status; log_evidence has its course). Give more iterations=, a "
            "tolerance= that is enough for the purpose, or another start"
        )
    elif not smoothed:
        message = (
            "the search for parameters converged, but the smoothers of its last step had not "
            "settled, and so the log-evidence is of other beliefs than theirs: give schedule= "
            "more iterations, or damping"
        )
    else:
        return
    warnings.warn(message, ConvergenceWarning, stacklevel=levels_to_user())


def _recordings(evidence: Any) -> list[Any]:
    """Evidence of several recordings."""
    every = list(evidence) if isinstance(evidence, list | tuple) else [evidence]
    for each in every:
        if not isinstance(each, Mapping):
            own = "; its .evidence is" if hasattr(each, "evidence") else ""
            raise EvidenceError(
                "evidence maps variables to values, or is a list of such mappings, one a "
                f"recording; found {type(each).__name__}, which is none{own}"
            )
    return every


def _lengths(steps: Any, count: int) -> list[int | None]:
    if not count:
        raise ModelError("evidence= holds no recording; give one, or a list of them")
    if not isinstance(steps, list | tuple):
        return [steps] * count
    if len(steps) != count:
        raise ModelError(f"steps= has {len(steps)} entries for {count} recordings")
    return list(steps)
