"""Expectation-maximisation, accelerated, of a dynamic network's parameters."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from pgm.boundary import is_number, is_whole
from pgm.display import titled
from pgm.errors import EvidenceError, ModelError
from pgm.evidence import Evidence
from pgm.inference import Smoothing
from pgm.inference.options import require_lineariser
from pgm.learning.model import Learner
from pgm.learning.search import Search
from pgm.learning.values import Fit, Learn
from pgm.linearisers import TAYLOR, Lineariser
from pgm.networks import DynamicBayesianNetwork
from pgm.progress import Progress, reporting

_ONCE = Smoothing()


def fit(
    model: DynamicBayesianNetwork,
    evidence: Evidence | Sequence[Evidence],
    *,
    learn: Learn,
    lineariser: Lineariser = TAYLOR,
    schedule: Smoothing = _ONCE,
    steps: int | Sequence[int | None] | None = None,
    iterations: int = 200,
    tolerance: float = 1e-6,
    accelerate: bool = True,
    progress: Progress = False,
) -> Fit:
    r"""Learn parameters of a dynamic network from recordings, by expectation-maximisation.

    Each step smooths the recordings (E) and takes the parameters that maximise the expected
    log-density (M),

    .. math:: \theta_{k+1} = \arg\max_\theta E[\ln p(x, z \mid \theta) \mid z, \theta_k],

    which never lowers the log-evidence ln p(z | θ): it is closed for affine CPDs and tables, with
    expectations by the lineariser for others. Quasi-Newton steps, by the gradient that the same
    beliefs give, are taken where they raise the log-evidence; else the plain one. A plain step
    that does not, as of nonlinear models it may, is halved five times, and then refused. Where a
    noise vanishes and the log-evidence rises without end the search stops, and its status says so.

    Parameters
    ----------
    model : DynamicBayesianNetwork
        With the values to begin with.
    evidence : mapping of Variable, or sequence of them
        Of one or several recordings, as for `smooth`; runs on leading axes share the parameters.
    learn : mapping of Variable
        The parts that are learnt, all else being fixed: by ``x.at(0)`` of the prior of a state, by
        ``x`` of its transition, by ``z`` of a sensor, a part of `pgm.learning` or a tuple of them,
        ``{x: (Coefficients(), Covariance("diagonal")), z: Covariance()}``; by an input its
        `Parameter`.
    lineariser, schedule : optional
        Of the smoother, without a gate; ``Smoothing(iterations=...)`` linearises again.
    steps : int or sequence of int, optional
        T, or that of each recording, where no plain array tells.
    iterations : int
        Of EM, at the most.
    tolerance : float
        The search has converged after a step that raised the log-evidence by no more (in nats) and
        moved no coordinate by more than a thousandth.
    accelerate : bool
        Whether quasi-Newton steps are tried.
    progress : bool or callable
        As for `infer`.

    Raises
    ------
    ModelError
        If something is to be learnt that is not there, or cannot be from its start.
    EvidenceError
        If evidence is no mapping, or nothing in it tells of a CPD that is to be learnt.
    PgmError
        As `smooth`, at the start.

    References
    ----------
    Shumway & Stoffer, An approach to time series smoothing and forecasting using the EM algorithm,
    1982. Jamshidian & Jennrich, Acceleration of the EM algorithm by using quasi-Newton methods,
    1997, method QN2. Kokkala, Solin & Särkkä, Sigma-point filtering and smoothing based parameter
    estimation in nonlinear dynamic systems, 2015.

    Examples
    --------
    >>> from pgm.examples import walk, x, z
    >>> from pgm.learning import Coefficients, Covariance
    >>> recording = walk.sample(steps=500, rng=1).evidence
    >>> found = pgm.fit(walk, recording, learn={x: (Coefficients(), Covariance())})
    >>> found.model.transition[0].matrices[x.previous].round(1)
    array([[1.]])
    """
    if not isinstance(model, DynamicBayesianNetwork):
        raise ModelError(f"a dynamic network was due, not {titled(model)}")
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
    if not isinstance(schedule, Smoothing):
        raise ModelError(f"schedule= is pgm.Smoothing(...), not {titled(schedule)}")
    if schedule.gate is not None:
        raise ModelError(
            f"schedule= is {schedule!r}: what a gate rejects would change with the parameters, and "
            "with it what the log-evidence is of; smooth with the gate, and fit evidence that is "
            "NaN where posterior.innovations[z].rejected"
        )
    require_lineariser(lineariser)
    learner = Learner(model, recordings, learn, lineariser, schedule, every, single=single)
    with reporting(progress):
        return Search(learner, int(iterations), float(tolerance), accelerate=accelerate).run()


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
