"""Filtering and smoothing: a dynamic network is compiled, and a schedule run on its graph."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

from pgm.arguments import public
from pgm.beliefs.own.family import BeliefFamily
from pgm.compile import Balanced, DynamicGraph, compile
from pgm.compile.machine import Choice
from pgm.evidence import BoundEvidence, Evidence
from pgm.inference.families import answered, family_of
from pgm.inference.on_card import solved_there
from pgm.kernels.settling import TOLERANCE
from pgm.linearisers import TAYLOR, Lineariser
from pgm.networks import DynamicBayesianNetwork
from pgm.posteriors.outcome import B
from pgm.posteriors.posterior import Posterior
from pgm.progress import Progress, reporting
from pgm.schedules.argument_checks import require_lineariser
from pgm.schedules.binding import bind_chain
from pgm.schedules.convergence import told
from pgm.schedules.damping import Damping
from pgm.schedules.gates import Gate
from pgm.schedules.impossible import RAISE
from pgm.schedules.options import Call, require_over_time
from pgm.schedules.schedule import Filtering, FixedLag, Smoothing
from pgm.schedules.starting_points import Start
from pgm.variables import Variable

if TYPE_CHECKING:
    from concurrent.futures import Executor


@public
def filter(
    model: DynamicBayesianNetwork,
    evidence: Evidence,
    *,
    lineariser: Lineariser = TAYLOR,
    steps: int | None = None,
    iterations: int = 1,
    tolerance: float = TOLERANCE,
    damping: Damping = 0.0,
    gate: Gate = None,
    keep: Variable | Iterable[Variable] | None = None,
    executor: Executor | None = None,
    belief: BeliefFamily[B] | None = None,
    compiled: Choice = None,
    progress: Progress = False,
    impossible: str = RAISE,
) -> Posterior[B]:
    r"""Kalman filters: the belief of the states at each step, given the measurements up to it.

    .. math:: p(x_t \mid \text{measurements up to } t), \quad t = 0, \ldots, T

    Of a linear model with Gaussian noise that is the Kalman filter, which is exact. Nonlinear CPDs
    are linearised at each incoming belief: with `Taylor` it is the extended Kalman filter, with
    `Unscented` the unscented, with `Cubature` the cubature Kalman filter. Two or more iterations
    make iterated filters of these, which linearise the sensors of a step again where they lead. Of
    discrete states it is the forward algorithm of hidden Markov models. The schedule, for `infer`,
    is `Filtering`.

    Parameters
    ----------
    model : DynamicBayesianNetwork
        The prior of the states, their motion and the sensors, as CPDs.
    evidence : mapping of Variable
        Values of sensors and inputs, by variable: arrays (..., T, d) of the steps 1 to T,
        `constant` or `sightings`. Leading axes are runs; NaN was not measured. Arrays may lie on a
        card that ``compiled`` asks for: beliefs then stay there (`Posterior.on_card`).
    lineariser : Lineariser, optional
        The rule for nonlinear CPDs that have none of their own, such as ``pgm.Unscented()``; by
        default `Taylor`, which takes Jacobians.
    steps : int, optional
        T, the last step: needed where no array in the evidence tells it. Arrays of sensors may be
        shorter; the steps after them are a forecast.
    iterations : int
        How often the sensors of a step are linearised, at the most: 1 is the plain filter. More
        start again from the predicted belief, so that no measurement counts twice.
    tolerance : float
        Iterations of a step end once no mean is further from where it was linearised than so many
        standard deviations; with 0 all are made.
    damping : float or LevenbergMarquardt
        The share of the old point of linearisation that is kept in the next, in [0, 1); or
        ``pgm.LevenbergMarquardt()``, which takes no step that raises the cost.
    gate : float or mapping of Variable to float, optional
        A probability, of all sensors or by sensor. A measurement is left out if its innovation ν,
        of covariance S, has a νᵀS⁻¹ν beyond the χ² quantile of it; see ``posterior.rejected``.
    keep : collection of Variable, optional
        The variables whose marginals are kept, ``keep=[x]``, so that a study of 100,000 runs fits
        in memory, and sensors whose ``predicted`` and ``innovations`` are; all, if not given.
    executor : concurrent.futures.Executor, optional
        A pool of processes or threads, which works on parts of the runs; the results are the same.
    belief : BeliefFamily, optional
        What beliefs are in place of Gaussians: a `Grid` of cells, `Particles`, ``pgm.Gaussians(8)``
        (mixtures, of switching models and ambiguous sightings), or a family of your own.
    compiled : bool or Compiled, optional
        Whether sweeps run in machine code, by LLVM; if not given, where they are long enough for
        that to be quicker. ``posterior.status.compilation`` says what was compiled.
    progress : bool or callable
        Whether bars show how far the work is, on a terminal or in a notebook; or a function,
        ``progress(done, total)``, that is told.
    impossible : str
        Of a model of tables, what is done with a run whose evidence has probability zero:
        ``"raise"`` an error, or ``"allow"`` it: its log-evidence is then −∞, and its beliefs are
        NaN from that step on.

    Returns
    -------
    Posterior
        ``posterior[x]`` is a `Gaussian` with means (..., T+1, d) of a state, (..., T, d) of a
        hidden control; with ``keep``, of what was kept. Of a network of tables it is a `Table` of
        probabilities (..., T+1, size), and so it is of a discrete state beside continuous ones,
        which have `GaussianMixture`; with ``belief`` a `GridBelief`, a `ParticleBelief`, or what a
        family of your own shows.

    Warns
    -----
    ConvergenceWarning
        If ``iterations`` of two or more end before they settle, in any run.
    LinearisationWarning
        If no line fits a function over its belief, in more than one of 20 runs;
        `Posterior.nonlinearity` says where. Only the first call of a model by each lineariser
        looks, and not one of eight or more runs, of more than 20,000 steps of all runs together, or
        one that gives a `LostWarning`.
    LostWarning
        If a belief is probably wrong at some step of a run; `Posterior.lost` says where.
    PrecisionWarning
        If rounding leaves fewer than six digits of a mean.

    Raises
    ------
    PgmError
        For the same reasons as `infer`.

    Examples
    --------
    >>> from pgm.examples import walk, x, z
    >>> posterior = pgm.filter(walk, {z: [[4.0]]})
    >>> posterior[x].mean.ravel(), posterior[x].cov.ravel()
    (array([0., 2.]), array([1., 1.]))
    """
    schedule = Filtering(iterations, tolerance, damping, gate)
    call = Call(schedule, lineariser, None, keep, executor, None, impossible, compiled)
    there = solved_there(model, evidence, steps, call, belief)
    if there is not None:
        return there
    family, asked = over_time(model, evidence, call, steps, None, belief, compiled)
    with reporting(progress):
        posterior = answered(family, family.infer(*asked))
    return told(posterior, schedule)


@public
def smooth(
    model: DynamicBayesianNetwork,
    evidence: Evidence,
    *,
    lineariser: Lineariser = TAYLOR,
    steps: int | None = None,
    start: Start | None = None,
    lag: int | None = None,
    iterations: int = 1,
    tolerance: float = TOLERANCE,
    damping: Damping = 0.0,
    gate: Gate = None,
    method: Balanced | None = None,
    keep: Variable | Iterable[Variable] | None = None,
    executor: Executor | None = None,
    belief: BeliefFamily[B] | None = None,
    compiled: Choice = None,
    progress: Progress = False,
    impossible: str = RAISE,
) -> Posterior[B]:
    r"""Rauch–Tung–Striebel smoothers: the belief at each step, given all measurements.

    .. math:: p(x_t \mid \text{all measurements}), \quad t = 0, \ldots, T

    A Kalman filter goes forward, and a pass back takes in what comes later. Of a linear model that
    is exact. Nonlinear CPDs are linearised as the filter does it: with `Taylor` it is the extended,
    with `Unscented` the unscented, with `Cubature` the cubature RTS smoother. Two or more
    iterations linearise everything again at the smoothed beliefs: with `Taylor` that is
    Gauss–Newton (the iterated extended Kalman smoother), with sigma points the iterated posterior
    linearisation smoother. Of discrete states it is the forward–backward algorithm. The schedule,
    for `infer`, is `Smoothing`, with a lag `FixedLag`.

    Parameters
    ----------
    model : DynamicBayesianNetwork
        The prior of the states, their motion and the sensors, as CPDs.
    evidence : mapping of Variable
        Values of sensors and inputs, by variable: arrays (..., T, d) of the steps 1 to T,
        `constant` or `sightings`. Leading axes are runs; NaN was not measured. Arrays may lie on a
        card that ``compiled`` asks for: beliefs then stay there (`Posterior.on_card`).
    lineariser : Lineariser, optional
        The rule for nonlinear CPDs that have none of their own, such as ``pgm.Unscented()``; by
        default `Taylor`, which takes Jacobians.
    steps : int, optional
        T, the last step: needed where no array in the evidence tells it. Arrays of sensors may be
        shorter; the steps after them are a forecast.
    start : mapping of Variable to array_like, optional
        Means (..., T+1, d) of states, (..., T, d) of hidden controls, at which everything is
        linearised first, in place of the filter's beliefs; not with a lag.
    lag : int, optional
        A fixed lag: each belief knows the measurements up to so many steps later. All, if not
        given.
    iterations : int
        How often CPDs are linearised, at the most: 1 is the plain smoother. It pays where the
        filter's beliefs are wide, as from an unknown start.
    tolerance : float
        Iterations of a run end once no smoothed mean is further from where it was linearised than
        so many standard deviations; with 0 all are made.
    damping : float or LevenbergMarquardt
        The share of the old point of linearisation that is kept in the next, in [0, 1); or
        ``pgm.LevenbergMarquardt()``, which takes no step that raises the cost.
    gate : float or mapping of Variable to float, optional
        A probability, of all sensors or by sensor. The filter leaves a measurement out if its
        innovation ν, of covariance S, has a νᵀS⁻¹ν beyond the χ² quantile of it, and so it stays.
    method : Balanced, optional
        ``pgm.Balanced()`` solves on a balanced tree of steps, and linearises first where motion
        alone leads. If not given, the graph is a chain, the first linearisation is the filter's,
        and later ones are solved in 2 log₂ T rounds or step by step, whichever is faster.
    keep : collection of Variable, optional
        The variables whose marginals are kept, ``keep=[x]``, so that a study of 100,000 runs fits
        in memory, and sensors whose ``predicted`` and ``innovations`` are; all, if not given.
    executor : concurrent.futures.Executor, optional
        A pool of processes or threads, which works on parts of the runs; the results are the same.
    belief : BeliefFamily, optional
        What beliefs are in place of Gaussians: a `Grid` of cells, `Particles`, ``pgm.Gaussians(8)``
        (mixtures, of switching models and ambiguous sightings), or a family of your own.
    compiled : bool or Compiled, optional
        Whether sweeps run in machine code, by LLVM; if not given, where they are long enough for
        that to be quicker. ``posterior.status.compilation`` says what was compiled.
    progress : bool or callable
        Whether bars show how far the work is, on a terminal or in a notebook; or a function,
        ``progress(done, total)``, that is told.
    impossible : str
        Of a model of tables, what is done with a run whose evidence has probability zero:
        ``"raise"`` an error, or ``"allow"`` it: its log-evidence is then −∞, and its beliefs are
        NaN at all steps.

    Returns
    -------
    Posterior
        ``posterior[x]`` has the smoothed means (..., T+1, d) of a state, (..., T, d) of a hidden
        control. For tables, and with ``belief``, it is another marginal; see `filter`.

    Warns
    -----
    ConvergenceWarning
        If ``iterations`` of two or more end before they settle, in any run.
    LinearisationWarning
        If no line fits a function over its belief, in more than one of 20 runs;
        `Posterior.nonlinearity` says where. Only the first call of a model by each lineariser
        looks, and not one of more than 20,000 steps of all runs together, or one that gives a
        `LostWarning`.
    LostWarning
        If a belief is probably wrong at some step of a run; `Posterior.lost` says where.
    PrecisionWarning
        If rounding leaves fewer than six digits of a mean.

    Raises
    ------
    PgmError
        For the same reasons as `infer`.

    Notes
    -----
    On a chain each linearisation after the first is of all steps at once, and the linearised model
    is solved in one of two ways: in about 2 log₂ T rounds, as on a balanced tree, or step by step.
    The rounds are taken where they are faster and cost no digits. They are faster from 64 steps on,
    if the components of a slice times the runs are 200 at the most. They would cost digits with
    measurements that are noise-free, that are linearised jointly with others of their step, or that
    shrink a variance more than 4·10⁶ times. In machine code it is always step by step.

    Examples
    --------
    >>> from pgm.examples import walk, x, z
    >>> posterior = pgm.smooth(walk, {z: [[4.0]]})
    >>> posterior[x].mean.ravel(), posterior[x].cov.ravel()
    (array([1., 2.]), array([0.75, 1.  ]))
    """
    rest = iterations, tolerance, damping, gate
    schedule = Smoothing(*rest) if lag is None else FixedLag(lag, *rest)
    call = Call(schedule, lineariser, start, keep, executor, None, impossible, compiled)
    there = solved_there(model, evidence, steps, call, belief)
    if there is not None:
        return there
    family, asked = over_time(model, evidence, call, steps, method, belief, compiled)
    with reporting(progress):
        posterior = answered(family, family.infer(*asked))
    return told(posterior, schedule)


def over_time(
    model: DynamicBayesianNetwork,
    evidence: Evidence,
    call: Call,
    steps: int | None = None,
    method: Balanced | None = None,
    belief: BeliefFamily[B] | None = None,
    compiled: Choice = None,
) -> tuple[BeliefFamily[B], tuple[DynamicGraph, BoundEvidence, Call]]:
    """A network compiled and its evidence bound: the family of beliefs, and what its `infer` takes.

    `call` has the schedule, and with it the other options; the rest are arguments of `smooth`.
    """
    require_lineariser(call.lineariser)
    bound = bind_chain(model, evidence, steps, identities=True, among=True, compiled=compiled)
    graph = compile(model, bound.steps, method=method, compiled=compiled)
    family = family_of(graph.model, belief, bound)
    call = call._replace(compiled=graph.layout.compiled or None)
    require_over_time(call, graph, family)
    return family, (graph, bound, call)
