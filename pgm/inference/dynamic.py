"""Filtering and smoothing: a dynamic network is compiled, and a schedule run on its graph.

The options of all functions are these, in a few words; `filter` and `infer` tell more:

- `lineariser` is for the nonlinear CPDs that have none of their own.
- `steps` is T, the last step, where no plain array in the evidence tells it, or goes on beyond it.
- `iterations` is the most linearisations that are made. They end early once no mean moves by more
  than `tolerance` standard deviations.
- `damping` is the share of the old point of linearisation that is kept in the next one, or a
  `LevenbergMarquardt`, which takes no step that raises the weighted sum of squared residuals.
- `gate` is a probability: a measurement is left out if its innovation ν, of covariance S, has a
  νᵀS⁻¹ν beyond the χ² quantile of that probability. It is one number for all sensors, or a mapping
  from sensors to theirs; None leaves nothing out.
- `start` has means, by variable, at which everything is linearised first; None for the beliefs of a
  filter, or on a balanced tree for dead reckoning.
- `lag` is the number of later steps whose measurements each belief knows; None for all.
- `method` is `Balanced()` for a balanced tree; None for a chain.
- `keep` names the variables whose marginals are kept; None for all.
- `executor` is a pool of processes or threads that works on parts of the runs; None for none.
- `belief` is a family of beliefs, `Grid`, `Particles` or one of the user's own; None for Gaussians,
  or for tables of discrete variables.
- `compiled` says whether sweeps run in machine code; with None they do where they are long.
- `progress` says whether bars show how far the work is.
- `impossible` says what is done with runs whose evidence has probability zero, if the network is
  of tables: ``"raise"`` refuses the evidence; ``"allow"`` gives such runs NaN.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

from pgm.arguments import public
from pgm.beliefs.own.family import BeliefFamily
from pgm.compile import Balanced, DynamicGraph, compile
from pgm.compile.machine import Choice
from pgm.evidence import BoundEvidence, Evidence
from pgm.inference.families import answered, family_of
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
    r"""Compile a network and filter: `infer` with `Filtering(iterations, tolerance, damping)`.

    .. math:: p(x_t \mid \text{measurements up to } t), \quad t = 0, \ldots, T

    Parameters
    ----------
    model : DynamicBayesianNetwork
    evidence : mapping of Variable
        Values of sensors and inputs, by variable: arrays (..., T, d) of the steps 1 to T,
        `constant` or `sightings`. Leading axes are runs; see `infer`.
    lineariser : Lineariser, optional
        For every nonlinear CPD that has none of its own; `Taylor()` if not given.
    steps : int, optional
        T, the last step: needed if the evidence has no plain array, whose length would tell it.
        Arrays of sensors may be shorter: nothing was read at the steps after them, which are a
        forecast; see `Posterior.predicted`.
    iterations, tolerance, damping
        The most linearisations of a step's sensors; they end early once no mean moves by more than
        ``tolerance`` standard deviations. ``damping`` is the share of the old point of
        linearisation that is kept in the next, or a `LevenbergMarquardt`. See `Filtering`.
    gate : float or mapping of Variable to float, optional
        A probability, of all sensors or by sensor. A measurement is left out if its innovation ν,
        of covariance S, has a νᵀS⁻¹ν beyond the χ² quantile of this probability; see `Filtering`.
    compiled : bool or Compiled, optional
        Whether the sweep along the chain runs in machine code, by LLVM. If not given, it does
        where the chain is long enough for that to be quicker; see `compile`.
    keep : collection of Variable, optional
        The variables whose marginals are kept, so that many runs fit in memory, and sensors, whose
        ``predicted`` and ``innovations`` are; see `infer`.
    executor : concurrent.futures.Executor, optional
        A pool of processes or threads that works on parts of the runs; see `infer`.
    belief : BeliefFamily, optional
        Beliefs on a `Grid`, by `Particles`, or of a family of your own, in place of Gaussians; or
        how many Gaussians a mixture has, ``pgm.Gaussians(8)``, which is what switching models,
        mixtures of CPDs and sightings that leave open what was seen have.
    progress : bool or callable
        Whether bars show how far the work is, or a function that is told; see `infer`.
    impossible : str
        For a network of tables, what is done with a run of which a measurement has probability
        zero given those before: ``"raise"`` an error, or ``"allow"`` it. The run then has a
        log-evidence of −∞, and NaN for its filtered beliefs from that step on, and for the
        smoothed ones at all steps.

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
    call = Call(schedule, lineariser, None, keep, executor, None, impossible)
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
    r"""Compile a network and smooth: `infer` with `Smoothing(iterations, tolerance, damping)`.

    .. math:: p(x_t \mid \text{all measurements}), \quad t = 0, \ldots, T

    With a lag the schedule is `FixedLag(lag, iterations, tolerance, damping)`: each belief knows
    the measurements up to `lag` steps later.

    Parameters
    ----------
    model : DynamicBayesianNetwork
    evidence : mapping of Variable
        Values of sensors and inputs, by variable: arrays (..., T, d) of the steps 1 to T,
        `constant` or `sightings`. Leading axes are runs; see `infer`.
    lineariser : Lineariser, optional
        For every nonlinear CPD that has none of its own; `Taylor()` if not given.
    steps : int, optional
        T, the last step: needed if the evidence has no plain array, whose length would tell it.
        Arrays of sensors may be shorter: nothing was read at the steps after them, which are a
        forecast; see `Posterior.predicted`.
    start : mapping of Variable to array_like, optional
        Means (..., T+1, d) of states, (..., T, d) of hidden controls, at which everything is
        linearised first; not with a lag.
    lag : int, optional
        The number of later steps whose measurements each belief knows; see `FixedLag`.
    iterations, tolerance, damping
        The most linearisations; they end early once no smoothed mean moves by more than
        ``tolerance`` standard deviations. ``damping`` is the share of the old point of
        linearisation that is kept in the next, or a `LevenbergMarquardt`. See `Smoothing` and
        `FixedLag`.
    gate : float or mapping of Variable to float, optional
        A probability, of all sensors or by sensor. A measurement is left out if its innovation ν,
        of covariance S, has a νᵀS⁻¹ν beyond the χ² quantile of this probability; see `Smoothing`.
    method : Balanced, optional
        `Balanced()` solves on a balanced tree, and starts from dead reckoning, which saves the
        filter's sweep. If not given, the graph is a chain of slices, and the first linearisation
        is the filter's. Each later one is of all steps at once, and the linearised model is solved
        in one of two ways. One takes about 2 log₂ T rounds, as on a balanced tree; the other goes
        step by step along the chain. The rounds are taken where they are faster and cost no
        digits. They are faster from 64 steps on, if the components of a slice times the runs are
        200 at the most. They would cost digits with measurements that are noise-free, that are
        linearised jointly with others of their step, or that shrink a variance more than 4·10⁶
        times. In machine code the model is always solved step by step.
    keep, executor, belief, compiled, progress, impossible
        The variables whose marginals are kept; a pool that works on parts of the runs; a `Grid` or
        `Particles` in place of Gaussians; whether sweeps run in machine code; whether bars show how
        far the work is; and what is done with evidence of probability zero. See `filter`.

    Returns
    -------
    Posterior
        ``posterior[x]`` has the smoothed means (..., T+1, d) of a state, (..., T, d) of a hidden
        control. For tables, and with ``belief``, it is another marginal; see `filter`.

    Warns
    -----
    ConvergenceWarning
        If ``iterations`` of two or more end before they settle, in any run.

    Raises
    ------
    PgmError
        For the same reasons as `infer`.

    Examples
    --------
    >>> from pgm.examples import walk, x, z
    >>> posterior = pgm.smooth(walk, {z: [[4.0]]})
    >>> posterior[x].mean.ravel(), posterior[x].cov.ravel()
    (array([1., 2.]), array([0.75, 1.  ]))
    """
    rest = iterations, tolerance, damping, gate
    schedule = Smoothing(*rest) if lag is None else FixedLag(lag, *rest)
    call = Call(schedule, lineariser, start, keep, executor, None, impossible)
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
