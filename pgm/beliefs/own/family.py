"""A family of beliefs: the value that a user gives as ``belief=``, and that inference asks.

Moments, tables, grids and particles are families; one's own is made by a start, a prediction and an
update.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, ClassVar, Generic

from pgm.arguments import public
from pgm.beliefs.own.marginals import Asked
from pgm.beliefs.own.online import OwnSteps
from pgm.beliefs.own.run import run
from pgm.beliefs.own.slices import Slice
from pgm.clustergraph import ClusterGraph
from pgm.compile import DynamicGraph
from pgm.display import ByAttributes, titled
from pgm.errors import ModelError, PgmError
from pgm.evidence import BoundEvidence, Evidence
from pgm.factors.scope import listed
from pgm.kernels.arrays import Array
from pgm.networks import DynamicBayesianNetwork
from pgm.posteriors.expectations import Expectations, Learnable
from pgm.posteriors.figures import Threshold
from pgm.posteriors.outcome import B, Outcome
from pgm.schedules.options import Call, refused


@public
class BeliefFamily(ByAttributes, Generic[B]):
    """A family of beliefs of a dynamic network's slices, such as ensembles.

    A family of your own is a subclass. It says how a belief begins, is predicted and takes the
    measurements of a step, for all runs at once; and what it shows: `moments`, or `points`. That is
    all that `filter`, `infer` and `OnlineFilter` ask; with `back` it is smoothed, too. A belief may
    be any value. Values of a family should not change, and hold a seed where they draw.

    Attributes
    ----------
    beliefs : str
        What its beliefs are called in the text of an error, in the plural.
    warns : mapping of str to Threshold
        Of its own `numbers`, by name, those of which the user is warned, and from where on.

    Examples
    --------
    The Kalman filter of a random walk, x ← x + N(0, 1), which is seen with noise N(0, 2):

    >>> class Kalman(pgm.BeliefFamily):
    ...     beliefs = "Kalman beliefs"
    ...
    ...     def begin(self, at):
    ...         return np.zeros((at.runs, 1)), np.ones((at.runs, 1, 1))
    ...
    ...     def predict(self, at, belief):
    ...         return belief[0], belief[1] + 1.0
    ...
    ...     def take(self, at, belief):
    ...         mean, cov = belief
    ...         (seen,) = at.measurements
    ...         total = cov + 2.0
    ...         residual = seen.value - mean
    ...         gain = cov / total
    ...         known = mean + gain[..., 0] * residual, (1 - gain) * cov
    ...         spread = total[..., 0]
    ...         log_density = -0.5 * (residual**2 / spread + np.log(2 * np.pi * spread))
    ...         return known, log_density[:, 0]
    ...
    ...     def moments(self, belief):
    ...         return belief
    >>> from pgm.examples import walk, x, z
    >>> posterior = pgm.filter(walk, {z: [[4.0]]}, belief=Kalman())
    >>> posterior[x].mean.ravel(), posterior[x].cov.ravel()
    (array([0., 2.]), array([1., 1.]))
    """

    beliefs: ClassVar[str] = "beliefs of your own"
    warns: ClassVar[Mapping[str, Threshold]] = {}
    # The options of a call, and of an online filter, that it has a use for; for what it has no use
    # of the others, and more to say of some of these.
    takes: ClassVar[frozenset[str]] = frozenset()
    spare: ClassVar[str] = "is for beliefs that are Gaussian, and not for a family of your own"
    more: ClassVar[Mapping[str, str]] = {}
    # Whether networks without time are solved by pattern of gaps where runs differ in these.
    by_pattern: ClassVar[bool] = False
    # Whether an estimate looks for several modes, and weighs draws of them.
    by_modes: ClassVar[bool] = False

    def __init_subclass__(cls, **settings: Any) -> None:
        super().__init_subclass__(**settings)
        carrier = next(each for each in cls.__mro__ if "infer" in vars(each))
        below = cls.__mro__[: cls.__mro__.index(carrier)]
        idle = [name for name in _ASKED if any(name in vars(each) for each in below)]
        if idle and carrier is not BeliefFamily:
            raise ModelError(
                f"{cls.__name__} has {', '.join(idle)}, which {carrier.__name__} never asks, as it "
                "carries schedules out in its own way (infer, online); derive a family of your own "
                "from pgm.BeliefFamily"
            )

    @property
    def _by_block(self) -> bool:
        """Whether a study has many runs together, for less than one by one take."""
        return False

    def require(self, model: DynamicBayesianNetwork) -> None:
        """Refuse, by a `ModelError`, a network that it cannot carry.

        Unless a family says otherwise, that is one of discrete variables.

        Parameters
        ----------
        model : DynamicBayesianNetwork
        """
        if model.discrete:
            raise ModelError(
                "a network of tables has the probabilities of its states, exactly: leave belief= "
                "out"
            )
        if model.mixed:
            raise ModelError(
                f"{self!r} is for networks of continuous variables; one with discrete ones beside "
                "these has mixtures of Gaussians: leave belief= out, or give pgm.Gaussians(...)"
            )

    def begin(self, at: Slice) -> Any:
        """The belief over the slice at step 0, before its measurements.

        Parameters
        ----------
        at : Slice

        Returns
        -------
        object
            Of any kind; it is handed to the other methods.
        """
        raise ModelError(f"{self!r} has no begin(at), with which a family of beliefs begins")

    def predict(self, at: Slice, belief: Any) -> Any:
        """The belief over a step's slice, from that of the step before given its measurements.

        Parameters
        ----------
        at : Slice
            The step to predict.
        belief : object

        Returns
        -------
        object
        """
        raise ModelError(f"{self!r} has no predict(at, belief)")

    def take(self, at: Slice, belief: Any) -> tuple[Any, Array | float]:
        """The belief given the measurements of its step, and their log-density.

        It is asked at steps with measurements alone, ``at.measurements``.

        Parameters
        ----------
        at : Slice
        belief : object
            Before the measurements.

        Returns
        -------
        object, ndarray
            The belief, and ln p(measurements of the step | those before), (runs,) or a number.
        """
        raise ModelError(f"{self!r} has no take(at, belief)")

    def back(self, at: Slice, known: Any, predicted: Any, later: Any) -> Any:
        """The belief over a step's slice that knows the measurements that `later` knows.

        A family without it is filtered alone.

        Parameters
        ----------
        at : Slice
            The step; the transition from it to the next one is that of ``at.next``.
        known : object
            The step's belief given the measurements up to it.
        predicted : object
            The belief of the next step, before that step's measurements.
        later : object
            The belief of the next step that knows more.

        Returns
        -------
        object
        """
        raise ModelError(f"{self!r} has no back(at, known, predicted, later)")

    @property
    def flows_back(self) -> bool:
        """Whether it says how a belief flows back."""
        back = self.back
        return callable(back) and getattr(back, "__func__", back) is not BeliefFamily.back

    @property
    def without_time(self) -> bool:
        """Whether it has beliefs of networks without time."""
        return type(self).infer_static is not BeliefFamily.infer_static

    def moments(self, belief: Any) -> tuple[Array, Array]:
        """The mean (runs, d) and covariance (runs, d, d) of a belief over a slice.

        ``posterior[x]`` is then a `Gaussian`. The components are in the order of ``at.places``.

        Parameters
        ----------
        belief : object

        Returns
        -------
        ndarray, ndarray
        """
        raise ModelError(
            f"{self!r} shows nothing of its beliefs: define moments(belief), points(belief) or "
            "marginal(beliefs, asked)"
        )

    def points(self, belief: Any) -> tuple[Array, Array | None] | None:
        """The points of a belief over a slice, (runs, n, d), and their log-weights, (runs, n).

        ``posterior[x]`` is then a `ParticleBelief`, and `moments` is not asked.

        Parameters
        ----------
        belief : object

        Returns
        -------
        ndarray, ndarray or None; or None
            The log-weights need not be normalised; None where the weights are equal. None in place
            of both, as here, of a family that has no points.
        """
        return None

    def marginal(self, beliefs: Sequence[Any], asked: Asked) -> Any:
        """The marginal of some variables in a form of its own; None, as here, for the usual ones.

        Parameters
        ----------
        beliefs : sequence of object
            One a step, of all runs; at least one.
        asked : Asked
            The ``scope`` of the marginal, and the ``columns`` of its components among the d of a
            slice; the user's axes of runs, ``lead``; and the numbers of the ``steps``, None where
            one step is asked for.

        Returns
        -------
        object or None
            What ``posterior[x]`` is to be, as it is. If it has a ``mean`` (*runs, steps, k) and a
            ``cov`` (*runs, steps, k, k), without the axis of steps where one is asked for,
            summaries, pages, data sets, comparisons and animations show these; they leave it out,
            or refuse it, if it has none.
        """
        return None

    def numbers(self, belief: Any) -> Mapping[str, Array | float]:
        """Figures by which to judge a belief, by name, (runs,) each, for ``posterior.status``.

        Parameters
        ----------
        belief : object

        Returns
        -------
        mapping of str to ndarray
        """
        return {}

    def refusal(self, option: str, of: object) -> PgmError:
        """The error for an option that it does not take, with the remedy.

        Parameters
        ----------
        option : str
        of : ClusterGraph or DynamicBayesianNetwork
            For the text.

        Returns
        -------
        PgmError
        """
        return refused(
            option, of, self.beliefs, self.spare, self.more.get(option, ": leave it out")
        )

    def infer(self, graph: DynamicGraph, bound: BoundEvidence, call: Call) -> Outcome[B]:
        """The outcome of a call's schedule on a dynamic network's graph, given its evidence."""
        return run(self, graph, bound, call)

    def infer_to_learn(
        self, graph: DynamicGraph, bound: BoundEvidence, call: Call, *, by_score: bool = False
    ) -> tuple[Outcome[B], Callable[[Sequence[Learnable]], Expectations]]:
        """The outcome of a smoother, and expectations of CPDs given all evidence, as of `fit`.

        Gaussian covariances beside Student-t noise may be `by_score`: see `Weights.information`.
        """
        raise ModelError(
            f"{self!r} has no expectations to learn by: fit with Gaussian beliefs, tables, or "
            "mixtures of Gaussians, and leave belief= out"
        )

    def infer_static(self, graph: ClusterGraph, evidence: Evidence, call: Call) -> Outcome[B]:
        """The outcome of a call's schedule on the graph of a network without time."""
        raise ModelError(f"{self!r} is for dynamic networks, not for {titled(graph)}")

    def online(self, model: DynamicBayesianNetwork, options: dict[str, Any]) -> Any:
        """The steps of an online filter: `initial`, `predict` and `update` of its beliefs.

        And ``options``, by name, with which the same steps are made, and which the filter shows.

        Parameters
        ----------
        model : DynamicBayesianNetwork
        options : dict
            Those of `OnlineFilter` that it takes, by name.

        Returns
        -------
        object
        """
        return OwnSteps(model, self)


# What is asked of a family whose beliefs are carried from slice to slice by the package.
_ASKED = ("begin", "predict", "take", "back", "moments", "points", "marginal", "numbers")


def require_family(belief: Any, model: Any) -> None:
    """Refuse, by a ModelError, a `belief` that is no family, or a model that cannot have it."""
    if isinstance(belief, type) and issubclass(belief, BeliefFamily):
        raise ModelError(
            "belief= is a pgm.Grid(...) or pgm.Particles(...), or a family of your own: make one, "
            f"{belief.__name__}(...)"
        )
    if not isinstance(belief, BeliefFamily):
        raise ModelError(
            "belief= is a pgm.Grid(...) or pgm.Particles(...), or a family of your own "
            f"(pgm.BeliefFamily), not {titled(belief)}"
        )
    if not isinstance(model, DynamicBayesianNetwork):
        raise ModelError(f"a dynamic network was due, not {titled(model)}")
    if not isinstance(belief.warns, Mapping):
        raise ModelError(
            f"{belief!r}: warns maps names of numbers(belief) to pgm.Threshold(...); found "
            f"{belief.warns!r}"
        )
    if belief.takes and type(belief).infer is BeliefFamily.infer:
        raise ModelError(
            f"{belief!r}: takes names options, {listed(belief.takes)}, and is for a family that "
            "carries schedules out itself (infer, online); none of them comes to begin, predict, "
            "take or back: leave takes out"
        )
    belief.require(model)
