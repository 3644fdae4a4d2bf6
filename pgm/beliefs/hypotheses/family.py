"""Mixtures of a few Gaussians, as a family of beliefs: the value that says how many are kept."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, ClassVar

from pgm.arguments import public
from pgm.beliefs.hypotheses.causes import network_with_causes, with_causes
from pgm.beliefs.hypotheses.expectations import expectations
from pgm.beliefs.hypotheses.online import HypothesisSteps
from pgm.beliefs.hypotheses.records import Asked
from pgm.beliefs.hypotheses.run import passes, run
from pgm.beliefs.mixed.family import MIXED
from pgm.beliefs.modes import chain, network
from pgm.beliefs.own.family import BeliefFamily
from pgm.boundary import is_whole
from pgm.clustergraph import ClusterGraph
from pgm.compile import DynamicGraph
from pgm.cpds.caused import has_mixtures
from pgm.errors import ModelError
from pgm.evidence import BoundEvidence, Evidence
from pgm.networks import DynamicBayesianNetwork
from pgm.posteriors.expectations import Expectations, Learnable
from pgm.posteriors.outcome import Outcome
from pgm.schedules.options import Call
from pgm.schedules.schedule import Filtering


@public
class Gaussians(BeliefFamily[Any]):
    r"""Mixtures of `count` Gaussians: of chains with discrete variables, or sightings left open.

    Open are sightings whose candidates are summed over (`unknown`), and those of a `MixtureCPD`.
    With `starts` they are the several modes of a nonlinear posterior, over time or not.

    .. math:: p(x_t, s_t \mid z) \approx \sum_k w_k \, N(x_t; \mu_k, P_k) \, p_k(s_t)

    Each Gaussian is predicted and updated under each state of the discrete variables, and the
    results are merged into `count` again. *Remembered* variables are those that the next step
    depends on; Gaussians of unlike states of these are never merged.

    - None, the default: one for each joint state of the remembered variables, which is the
      generalised pseudo-Bayesian filter of second order. Where nothing is remembered it is a single
      Gaussian, and for readings of unknown source probabilistic data association.
    - With ``mix=True`` Gaussians are mixed for each state before they are predicted: the
      interacting multiple model, which predicts as many as there are states, not that many for each
      Gaussian, and is less exact.
    - A larger `count`: the likeliest ones that are unlike others are kept, and others merged into
      the one from which they are the least different. As many as there are sequences of states is
      exact.

    Backwards each merged Gaussian's message, smoothed over filtered, is multiplied into each of
    the Gaussians that it was merged of.

    Parameters
    ----------
    count : int, optional
        How many Gaussians in all are kept at each step; with `starts`, of a smoother or a network
        without time, how many modes at the most.
    mix : bool
        Whether they are mixed before they are predicted.
    starts : int
        Of a smoother of a nonlinear network without discrete variables the number of starts of
        iterated smoothers, points of the prior that are sent through the motion; 0 is none. The
        fixed points that are more than half a deviation apart, whole turns of angles aside, are the
        modes of the posterior, weighed by their evidence: one call of as many runs. So it is of a
        network without time, by `infer`, where starts are points that its CPDs make of white noise,
        and iterations those of a `Calibration`. Where variables have no prior of finite variance,
        as in a `MarkovNetwork`, points are of the Gaussian that its affine factors make together,
        and a `ModelError` names what these leave open. Of a filter the number of narrower Gaussians
        that its prior is cut into, which are merged into `count` from the first step on.
    draws : int
        With `starts`, the number of draws of all hidden variables in each run and each of three
        rounds, by which the modes' weights and moments are adapted; 0 is none. Draws are of the
        modes' mixture, some of the model alone, and are weighed with the model as it was declared.
        Some 4,000 are a good number; ``status.effective`` tells how many all of them are worth.

    References
    ----------
    Blom & Bar-Shalom, The interacting multiple model algorithm for systems with Markovian switching
    coefficients, 1988. Salmond, Mixture reduction algorithms for target tracking in clutter, 1990.
    Kim, Dynamic linear models with Markov-switching, 1994. Barber, Expectation correction for
    smoothed inference in switching linear dynamical systems, 2006.

    Examples
    --------
    A target that drifts, calmly or wildly:

    >>> x, z = pgm.Variable("x"), pgm.Variable("z")
    >>> mode = pgm.Discrete("mode", states=("calm", "wild"))
    >>> calm = pgm.LinearGaussianCPD(x, {x.previous: 1.0}, cov=0.01)
    >>> wild = pgm.LinearGaussianCPD(x, {x.previous: 1.0}, cov=4.0)
    >>> model = pgm.DynamicBayesianNetwork(
    ...     prior=[pgm.TableCPD(mode, table=[0.5, 0.5]), pgm.GaussianCPD(x, 0.0, 1.0)],
    ...     transition=[
    ...         pgm.TableCPD(mode, given=mode.previous, table=[[0.9, 0.1], [0.2, 0.8]]),
    ...         pgm.SwitchingCPD(x, given=mode, cases={"calm": calm, "wild": wild}),
    ...     ],
    ...     observation=[pgm.LinearGaussianCPD(z, {x: 1.0}, cov=0.25)],
    ... )
    >>> posterior = pgm.filter(model, {z: [[0.0], [3.0]]}, belief=pgm.Gaussians(8))
    >>> posterior[mode.at(2)]
    Table(mode[2]: calm 0.00122, wild 0.999)
    >>> posterior[x.at(2)].mean.round(3)
    array([2.831])
    """

    count: int | None
    mix: bool
    starts: int
    draws: int

    takes: ClassVar[frozenset[str]] = frozenset(
        {"lineariser", "iterations", "damping", "schedule", "compiled"}
    )
    beliefs: ClassVar[str] = "mixtures of Gaussians"
    spare: ClassVar[str] = "is not for mixtures of Gaussians"
    more: ClassVar[Mapping[str, str]] = dict.fromkeys(
        ("keep", "executor", "start", "gate", "lag", "watch"),
        ": leave it out; or, where sightings by pgm.unknown are summed over, decide what each is "
        'of, by unknown(..., association="likelihood")',
    )

    def __init__(
        self, count: int | None = None, mix: bool = False, starts: int = 0, draws: int = 0
    ) -> None:
        if count is not None and (not is_whole(count) or count < 1):
            raise ModelError(f"a count of Gaussians is a whole number, 1 or more, not {count!r}")
        if not isinstance(mix, bool):
            raise ModelError(f"mix says whether Gaussians are mixed, True or False, not {mix!r}")
        if not is_whole(starts) or starts < 0:
            raise ModelError(
                "starts is a number of smoothers, or of pieces of a filter's prior, 0 or more, not "
                f"{starts!r}"
            )
        if starts and count is None:
            raise ModelError(
                f"starts={starts} looks for modes of one posterior, of which a count is kept: give "
                "pgm.Gaussians(count, starts=...)"
            )
        if starts and mix:
            raise ModelError(
                f"mix=True mixes the Gaussians of discrete states, and starts={starts} are of one "
                "posterior's modes: leave one of them out"
            )
        if not is_whole(draws) or draws < 0:
            raise ModelError(f"draws is a number of trajectories, 0 or more, not {draws!r}")
        if draws and not starts:
            raise ModelError(f"draws={draws} adapts the modes that starts= finds: give both")
        self.count, self.mix = None if count is None else int(count), mix
        self.starts, self.draws = int(starts), int(draws)

    def __repr__(self) -> str:
        given = [] if self.count is None else [f"{self.count}"]
        settings = {"mix": self.mix, "starts": self.starts, "draws": self.draws}
        given += [f"{name}={value}" for name, value in settings.items() if value]
        return f"{type(self).__name__}({', '.join(given)})"

    @property
    def _by_block(self) -> bool:
        return not self.starts  # which are themselves so many runs

    def require(self, model: DynamicBayesianNetwork) -> None:
        """Refuse a network of discrete variables alone, whose tables are exact."""
        if model.discrete:
            super().require(model)

    def infer(self, graph: DynamicGraph, bound: BoundEvidence, call: Call) -> Outcome[Any]:
        """The outcome of a call's schedule on a dynamic network's graph, given its evidence."""
        if self.starts and not isinstance(call.schedule, Filtering):
            assert self.count is not None
            return chain.run(graph, bound, call, self.count, self.starts, self.draws)
        graph, bound = with_causes(graph, bound)
        self._require_no_draws()
        return run(graph, bound, call, Asked(self.count, self.mix, max(self.starts, 1)))

    def infer_static(self, graph: ClusterGraph, evidence: Evidence, call: Call) -> Outcome[Any]:
        """The modes of a network without time; of one with discrete variables all its mixtures."""
        if graph.network.discrete:
            raise ModelError("a network of tables is exact: leave belief= out")
        several = graph.network.mixed or has_mixtures(graph.network.cpds)
        if self.starts and not several:
            assert self.count is not None
            return network.run(graph, evidence, call, self.count, self.starts, self.draws)
        if not several or self.starts:
            raise ModelError(
                f"{self!r}: a network without time has Gaussian beliefs, several of them where "
                "starts= looks for modes of nonlinear CPDs, or where discrete variables choose, of "
                "which it has as many as there are configurations: leave belief= out, or, without "
                "discrete variables, give pgm.Gaussians(count, starts=...)"
            )
        return MIXED.infer_static(graph, evidence, call)

    def infer_to_learn(
        self, graph: DynamicGraph, bound: BoundEvidence, call: Call, *, by_score: bool = False
    ) -> tuple[Outcome[Any], Callable[[Sequence[Learnable]], Expectations]]:
        """The mixtures of a smoother, and expectations by its pass back."""
        if self.starts:
            raise ModelError(
                f"{self!r}: fit learns by one smoother, and starts= asks for several: leave it out"
            )
        graph, bound = with_causes(graph, bound)
        outcome, backward = passes(graph, bound, call, Asked(self.count, self.mix))
        assert backward is not None
        return outcome, lambda parts: expectations(backward, graph, parts)

    def online(self, model: DynamicBayesianNetwork, options: dict[str, Any]) -> HypothesisSteps:
        """The steps of an online filter."""
        self._require_no_draws()
        if options.pop("compiled", None):
            raise ModelError(
                "compiled=True: an online filter of mixtures is made by NumPy alone; leave it out"
            )
        asked = Asked(self.count, self.mix, max(self.starts, 1))
        return HypothesisSteps(network_with_causes(model), asked, **options)

    def _require_no_draws(self) -> None:
        """Refuse draws of a filter."""
        if self.draws:
            raise ModelError(
                f"{self!r}: draws adapt the modes that a smoother finds; a filter has none, leave "
                "them out"
            )


GAUSSIANS = Gaussians()
