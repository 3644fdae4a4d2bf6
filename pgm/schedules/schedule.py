"""Schedules: which messages are sent in which order, and how often CPDs are linearised."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from typing import Any, ClassVar

from pgm.arguments import public
from pgm.boundary import is_number, is_whole
from pgm.display import InCode
from pgm.errors import ModelError
from pgm.kernels.settling import TOLERANCE
from pgm.posteriors.belief_kind import FILTERED, SMOOTHED, Kind
from pgm.schedules.argument_checks import require_count, require_tolerance
from pgm.schedules.damping import Damping, require_damping
from pgm.schedules.gates import Gate, as_gate
from pgm.schedules.rounds import Directed, Messages, Step, in_turn, largest_first

# The options of a call, with those of the schedule, that every schedule has a use for. Each class
# lists its own in `takes`, which `pgm.schedules.options` compares with a call; a schedule of a
# user's own takes those of its base, unless it says otherwise.
_EVERY = frozenset(
    {
        *("lineariser", "keep", "executor", "compiled"),
        *("iterations", "damping", "gate"),
    }
)


class OnChains(InCode):
    """Base of the schedules for chains of slices.

    solver: Of a schedule of one's own for Gaussian beliefs, the `Solver` that carries it out; None
        of one that is run as its base.
    """

    solver: ClassVar[Any] = None


@public
@dataclass(frozen=True)
class Filtering(OnChains):
    """Forward messages alone: each belief knows the measurements up to its step.

    A transition is linearised at the incoming message, a sensor at the predicted belief. With
    `Taylor` it is the extended Kalman filter, with `Unscented` the unscented one. Further
    iterations linearise the sensors of a step together at the step's posterior, and each starts
    again from the predicted belief, so that no measurement counts twice: the iterated extended
    Kalman filter, the iterated posterior linearisation filter.

    Parameters
    ----------
    iterations : int
        Linearisations of a step's sensors at the most.
    tolerance : float
        A step of a run is done when no mean is more than this many standard deviations from where
        it was linearised. With 0 all iterations are made, and there is no
        `ConvergenceWarning`.
    damping : float or LevenbergMarquardt
        The share of the old point of linearisation that is kept, in [0, 1), or a control of each
        step by its cost, which `LevenbergMarquardt` defines.
    gate : float or mapping of Variable to float, optional
        The probability within which measurements are taken in. A measurement is left out, in its
        run alone, if νᵀS⁻¹ν, with its innovation ν at the predicted belief and the covariance S of
        ν, exceeds the χ² quantile of this probability, with as many degrees of freedom as
        components were measured. A mapping gives the gates of some sensors; the others have none.
        ``posterior.rejected[z]`` has the record.

    References
    ----------
    García-Fernández, Svensson, Morelande & Särkkä, Posterior linearization filter, 2015.

    Examples
    --------
    >>> from pgm.examples import walk, x, z
    >>> graph = pgm.compile(walk, steps=1)
    >>> posterior = pgm.infer(graph, {z: [[4.0]]}, schedule=pgm.Filtering())
    >>> posterior[x].mean.ravel(), posterior[x].cov.ravel()
    (array([0., 2.]), array([1., 1.]))
    """

    iterations: int = 1
    tolerance: float = TOLERANCE
    damping: Damping = 0.0
    gate: Gate = None
    takes: ClassVar[frozenset[str]] = _EVERY | {"method", "impossible"}

    def __post_init__(self) -> None:
        object.__setattr__(self, "gate", as_gate(type(self).__name__, self.gate))
        require_count(self, _LINEARISATIONS, self.iterations)
        require_tolerance(self, self.tolerance)
        require_damping(self, self.damping)

    @property
    def kind(self) -> Kind:
        """The kind of its beliefs: filtered."""
        return FILTERED


_LINEARISATIONS = "iterations, which count linearisations,"
ONCE = Filtering()


@public
@dataclass(frozen=True)
class Calibration(OnChains):
    """Both passes over a tree: towards the root and back, so that each belief knows all evidence.

    Without nonlinear CPDs one iteration is exact. The first linearisation of nonlinear ones is at
    their parents' prior predictive moments, or at a given start; each further one is of every CPD
    at the belief of its cluster, after which all messages are sent again: no evidence is counted
    twice. With `Taylor` that is Gauss–Newton. Measurements of robust noise are weighed anew at each
    solution, for which it takes dozens of iterations.

    Parameters
    ----------
    iterations : int
        Linearisations at the most.
    tolerance : float
        A run stops when no mean moves by more than this many standard deviations. With 0 all
        iterations are made, and there is no `ConvergenceWarning`.
    damping : float or LevenbergMarquardt
        The share of the old point of linearisation that is kept, in [0, 1), or a control of each
        step by its cost, which `LevenbergMarquardt` defines.

    Examples
    --------
    >>> from pgm.examples import a, b, pair
    >>> graph = pgm.compile(pair, method=pgm.JunctionTree())
    >>> posterior = pgm.infer(graph, {b: [2.0]}, schedule=pgm.Calibration())
    >>> posterior[a]
    Gaussian(a)
         mean ± deviation
      a     1.000 ± 0.707
    >>> posterior.status.iterations
    1
    """

    iterations: int = 1
    tolerance: float = TOLERANCE
    damping: Damping = 0.0
    takes: ClassVar[frozenset[str]] = _EVERY | {"method", "start", "memory", "impossible"}

    def __post_init__(self) -> None:
        require_count(self, _LINEARISATIONS, self.iterations)
        require_tolerance(self, self.tolerance)
        require_damping(self, self.damping)


@public
@dataclass(frozen=True)
class Smoothing(Calibration):
    """Forward and backward messages, the calibration of a chain: all measurements are known.

    The first linearisation is that of the filter, so that one iteration is the (extended,
    unscented) RTS smoother; the later ones are of every CPD at the smoothed belief over its hidden
    parents, all steps in one call.

    Parameters
    ----------
    iterations : int
        Linearisations of all CPDs at the most.
    tolerance : float
        A run stops when no smoothed mean is more than this many standard deviations from where it
        was linearised. With 0 all iterations are made, and there is no `ConvergenceWarning`.
    damping : float or LevenbergMarquardt
        The share of the old point of linearisation that is kept, in [0, 1), or a control of each
        step by its cost, which `LevenbergMarquardt` defines.
    gate : float or mapping of Variable to float, optional
        The probability within which measurements are taken in, of all sensors or of some, as
        `Filtering` defines it. The gate decides in the first forward pass, and its decisions are
        kept, so that all iterations are of the same measurements. If the user gives a start, CPDs
        are linearised there in that pass.

    References
    ----------
    García-Fernández, Svensson & Särkkä, Iterated posterior linearization smoother, 2017.

    Examples
    --------
    >>> from pgm.examples import walk, x, z
    >>> graph = pgm.compile(walk, steps=1)
    >>> posterior = pgm.infer(graph, {z: [[4.0]]}, schedule=pgm.Smoothing())
    >>> posterior[x].mean.ravel(), posterior[x].cov.ravel()
    (array([1., 2.]), array([0.75, 1.  ]))
    """

    gate: Gate = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "gate", as_gate(type(self).__name__, self.gate))
        super().__post_init__()

    @property
    def kind(self) -> Kind:
        """The kind of its beliefs: smoothed."""
        return SMOOTHED

    @property
    def first(self) -> Filtering:
        """The filter that makes the first linearisation, and in which the gate decides."""
        return Filtering(gate=self.gate)


@public
@dataclass(frozen=True)
class FixedLag(OnChains):
    r"""Messages forward, and back over a lag: a belief knows the measurements up to a lag later.

    .. math:: p(x_t \mid z_0, \dots, z_{\min(t + L,\, T)})

    is the belief over the state x at step t, given measurements z, with the lag L and the last step
    T. A lag of zero is the filter. A lag that covers the record is the smoother: for linear models
    up to rounding, for others the smoother iterated until it settled.

    With one iteration every CPD is linearised as in the filter. With more, each new step s has a
    window: the transitions into the steps s − L + 1 to s and their measurements. All of its CPDs
    are linearised again at the window's smoothed beliefs, the motion included, and the window is
    smoothed again from its prior p(x[s−L] | measurements up to s − L), until that settles or the
    iterations are used up. A step that the next window leaves behind keeps its last linearisations,
    and its information goes into the next window's prior: each measurement counts once. While the
    first step is in the window, so are the network's prior and the measurements there. A lag of one
    with iterations is the dynamically iterated filter.

    The log-evidence is that of the model as each CPD was linearised last. ``posterior.filtered``
    has the belief of each window at its newest step.

    Parameters
    ----------
    lag : int
        L, in steps: 0 or more.
    iterations : int
        Linearisations of a window at the most.
    tolerance : float
        A window is done when no smoothed mean is more than this many standard deviations from
        where it was linearised. With 0 all iterations are made, and there is no
        `ConvergenceWarning`.
    damping : float or LevenbergMarquardt
        The share of the old point of linearisation that is kept, in [0, 1), or a control of each
        step by the cost of the window's trajectory, the window's prior included.
    gate : float or mapping of Variable to float, optional
        The probability within which measurements are taken in, of all sensors or of some, as
        `Filtering` defines it. The gate decides when a step is new, and its decisions are kept.

    Examples
    --------
    >>> FixedLag(5)
    FixedLag(lag=5, iterations=1, tolerance=1e-06, damping=0.0, gate=None)

    References
    ----------
    Moore, Discrete-time fixed-lag smoothing algorithms, 1973.
    Kullberg, Skog & Hendeby, Iterated filters for nonlinear transition models, 2023; Dynamically
    iterated filters: a unified framework for improved iterated filtering, 2024.
    """

    lag: int
    iterations: int = 1
    tolerance: float = TOLERANCE
    damping: Damping = 0.0
    gate: Gate = None
    takes: ClassVar[frozenset[str]] = _EVERY | {"impossible"}

    def __post_init__(self) -> None:
        object.__setattr__(self, "gate", as_gate(type(self).__name__, self.gate))
        if not is_whole(self.lag) or self.lag < 0:
            raise ModelError(
                f"{self!r}: a lag is a whole number of steps, 0 or more, not {self.lag!r}; of all "
                "later measurements, use pgm.Smoothing()"
            )
        require_count(self, _LINEARISATIONS, self.iterations)
        require_tolerance(self, self.tolerance)
        require_damping(self, self.damping)

    @property
    def kind(self) -> Kind:
        """The kind of its beliefs: fixed-lag, or filtered with a lag of zero."""
        return Kind(self.lag)

    @property
    def filtering(self) -> Filtering:
        """The filter that this schedule equals if its lag is zero."""
        return Filtering(self.iterations, self.tolerance, self.damping, self.gate)

    @property
    def first(self) -> Filtering:
        """The filter that first linearises a new step, and in which the gate decides."""
        return Filtering(gate=self.gate)

    @property
    def smoothing(self) -> Smoothing:
        """The schedule by which a window is smoothed, with the same iterations."""
        return Smoothing(self.iterations, self.tolerance, self.damping)


@public
@dataclass(frozen=True)
class Loopy(InCode):
    """Base of the schedules for any graph, a tree or not; one of your own gives `turns`.

    Messages are sent round after round, until none changes. A run has converged when no message
    changes by more than `tolerance`, in standard deviations of the belief that it makes, or in
    probability. The first messages of tables are uniform; those of Gaussians say as much as one
    observation with the deviation of the prior prediction, at its mean.

    Parameters
    ----------
    iterations : int
        Rounds of messages at the most.
    tolerance : float
        A run has converged when no message changes by more than this: in standard deviations of
        the belief it makes, or in probability. With 0 all rounds are sent.
    damping : float
        The share of the old message that is kept, in [0, 1).

    Examples
    --------
    An order that is drawn, one message after another:

    >>> from dataclasses import dataclass
    >>> @dataclass(frozen=True)
    ... class Drawn(pgm.Loopy):
    ...     seed: int = 0
    ...
    ...     def turns(self, messages):
    ...         order = np.random.default_rng(self.seed).permutation(len(messages))
    ...         return [[message] for message in order]
    >>> from pgm.examples import a, b, pair
    >>> graph = pgm.compile(pair, method=pgm.Bethe())
    >>> pgm.infer(graph, {b: [2.0]}, schedule=Drawn(seed=1))[a].mean
    array([1.])
    """

    iterations: int = 1000
    tolerance: float = 1e-10
    damping: float = 0.0
    # Those over time too, as a chain refuses the schedule itself.
    takes: ClassVar[frozenset[str]] = _EVERY | {"method", "start"}

    def __post_init__(self) -> None:
        require_count(self, "iterations", self.iterations)
        require_tolerance(self, self.tolerance)
        if not is_number(self.damping) or not 0.0 <= self.damping < 1.0:
            raise ModelError(
                f"{self!r}: damping is the share of the old message, in [0, 1), not "
                f"{self.damping!r}"
            )

    def turns(self, messages: Directed) -> Sequence[Sequence[int]]:
        """The order of a round: groups of messages, which are sent one group after the other.

        The messages of a group are all computed from the latest ones before it. Each message is in
        one group or more.

        Parameters
        ----------
        messages : Directed
            ``len(messages)`` of them, told by number: ``messages.source[k]`` is the number of the
            cluster that sends message k, ``messages.target[k]`` of the one that gets it.
            Messages 2e and 2e + 1 go along the e-th of ``graph.sepsets``, there and back.

        Returns
        -------
        sequence of sequence of int
        """
        raise ModelError(f"{self!r} has no turns(messages), which gives the order of its messages")

    def _step(self, messages: Messages[Any]) -> Step:
        """The `Step` that sends a round of these messages."""
        return in_turn(messages, self.turns(messages.directed), self)


@public
@dataclass(frozen=True)
class Flooding(Loopy):
    """All messages at once, each from those of the iteration before, until none changes.

    The beliefs of neighbours then agree. On a tree they are exact. On a graph with loops messages
    need not converge; where they do, Gaussian means are exact, variances and log-evidence
    approximate, and so are all beliefs of discrete variables.

    Parameters
    ----------
    iterations : int
        Rounds of messages at the most; a round sends as many messages as the graph has.
    tolerance : float
        A run has converged when no message changes by more than this: in standard deviations of
        the belief it makes, or in probability. With 0 all rounds are sent, and there is no
        `ConvergenceWarning` unless messages diverge.
    damping : float
        The share of the old message that is kept, in [0, 1): what is sent is the geometric mean of
        the old message and the new one, with weights `damping` and 1 − `damping`.

    Examples
    --------
    >>> from pgm.examples import a, b, pair
    >>> graph = pgm.compile(pair, method=pgm.Bethe())
    >>> posterior = pgm.infer(graph, {b: [2.0]}, schedule=pgm.Flooding(tolerance=1e-6))
    >>> posterior[a]
    Gaussian(a)
         mean ± deviation
      a     1.000 ± 0.707
    >>> bool(posterior.status.converged)
    True
    """

    def turns(self, messages: Directed) -> Sequence[Sequence[int]]:
        """All messages in one group."""
        return [range(len(messages))]


@public
@dataclass(frozen=True)
class Sequential(Loopy):
    """Cluster after cluster, forth and back, each message computed from the latest ones.

    On a tree the beliefs are exact. On a graph with loops messages need not converge; see
    `Flooding`.

    Parameters
    ----------
    iterations : int
        Rounds of messages at the most; a round sends as many messages as the graph has.
    tolerance : float
        A run has converged when no message changes by more than this: in standard deviations of
        the belief it makes, or in probability.
    damping : float
        The share of the old message that is kept, in [0, 1).

    Examples
    --------
    >>> from pgm.examples import a, b, pair
    >>> graph = pgm.compile(pair, method=pgm.Bethe())
    >>> pgm.infer(graph, {b: [2.0]}, schedule=pgm.Sequential())[a].mean
    array([1.])
    """

    def turns(self, messages: Directed) -> Sequence[Sequence[int]]:
        """Clusters in order, each with its messages to later ones; in reverse, those to earlier."""
        target = messages.target
        there, back = [], []
        for cluster, outgoing in enumerate(messages.outgoing):
            later = [m for m in outgoing if target[m] > cluster]
            earlier = [m for m in outgoing if target[m] < cluster]
            there += [later] if later else []
            back += [earlier] if earlier else []
        return [*there, *reversed(back)]


@public
@dataclass(frozen=True)
class Residual(Loopy):
    """One message at a time, always the one that would change most.

    After each message, all messages that depend on it are computed anew. So an iteration computes
    about n² messages around a hub of n neighbours, where `Flooding` and `Sequential` compute n.
    On a tree the beliefs are exact. On a graph with loops messages need not converge; see
    `Flooding`.

    Parameters
    ----------
    iterations : int
        Rounds of messages at the most; a round sends as many messages as the graph has.
    tolerance : float
        A run has converged when no message would change by more than this: in standard deviations
        of the belief it makes, or in probability.
    damping : float
        The share of the old message that is kept, in [0, 1).

    References
    ----------
    Elidan, McGraw & Koller, Residual belief propagation, 2006.

    Examples
    --------
    >>> from pgm.examples import a, b, pair
    >>> graph = pgm.compile(pair, method=pgm.Bethe())
    >>> pgm.infer(graph, {b: [2.0]}, schedule=pgm.Residual())[a].mean
    array([1.])
    """

    def _step(self, messages: Messages[Any]) -> Step:
        """The `Step` that sends messages in an order that depends on their changes."""
        if type(self).turns is not Loopy.turns:
            raise ModelError(
                f"{self!r} has turns(messages), and the order of a Residual follows from the "
                "changes of messages: derive from pgm.Loopy"
            )
        return largest_first(messages)


Schedule = Filtering | FixedLag | Calibration | Loopy


def require_known(schedule: Schedule, who: str) -> None:
    """Refuse, by a ModelError, a schedule of one's own: with options, or a solver, of its own.

    `who` would run it as its base, for the text. A subclass that only changes defaults passes.
    """
    if isinstance(schedule, Loopy):
        return
    kind = type(schedule)
    base: Any = next(each for each in kind.__mro__ if each.__module__ == __name__)
    # Of a dataclass or not; what it keeps for itself, by `cached_property`, is no option.
    named = {field.name for field in fields(schedule)} | vars(schedule).keys()
    own = sorted(
        name
        for name in named - {field.name for field in fields(base)}
        if not isinstance(getattr(kind, name, None), cached_property)
    )
    if schedule.solver is not None:
        own.append("a solver")
    if own:
        raise ModelError(
            f"{schedule!r} has {', '.join(own)}, of which {who} would know nothing: give a "
            f"schedule of pgm's own, like {base.__name__}; one of yours is carried out by a solver "
            "for chains of Gaussian beliefs, which it names: solver = ..."
        )


def kind_of(schedule: Schedule | None, beliefs: str) -> Kind:
    """The kind of a chain's beliefs that a schedule leaves; smoothed without a schedule.

    `Filtering`, `FixedLag` and `Smoothing` are taken, and `Calibration` counts as `Smoothing`. Any
    other schedule raises a `ModelError`, whose text names the `beliefs`, by a plural such as
    "tables".
    """
    if schedule is None or type(schedule) is Calibration:
        schedule = Smoothing()
    if not isinstance(schedule, OnChains):
        raise ModelError(
            f"{beliefs} take pgm.Filtering(), pgm.FixedLag(...) or pgm.Smoothing(), not "
            f"{schedule!r}"
        )
    require_known(schedule, beliefs)
    if not isinstance(schedule, Filtering | FixedLag | Smoothing):
        return SMOOTHED  # a calibration with other defaults
    kind: Any = schedule.kind
    if not isinstance(kind, Kind):
        raise ModelError(f"{schedule!r}: its kind is {kind!r}; a pgm.Kind was due")
    return kind
