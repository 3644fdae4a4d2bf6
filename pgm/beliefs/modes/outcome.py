"""Results of several modes of one posterior: mixtures of Gaussians, one of each mode."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import numpy as np

from pgm.clustergraph import Cluster, ClusterGraph
from pgm.compile import DynamicGraph
from pgm.display import Summary
from pgm.errors import GraphError, PgmError, Unanswered
from pgm.factors import Gaussian, GaussianMixture
from pgm.factors.scope import Scope
from pgm.kernels.arrays import Array, Integers
from pgm.kernels.stochastic import Dense
from pgm.posteriors.belief_kind import SMOOTHED
from pgm.posteriors.belief_kind import Kind as Knows
from pgm.posteriors.figures import Figures
from pgm.posteriors.outcome import MODES, QUESTIONS, Outcome
from pgm.posteriors.status import Status
from pgm.posteriors.summaries import of_network, over_time
from pgm.variables import Variable


class ModeFigures(Figures):
    """How the smoothers of several starts went.

    Attributes
    ----------
    starts : int
        How many there were, in each run.
    arrived : ndarray of int
        (*runs): how many of them settled.
    modes : ndarray of int
        (*runs): how many modes are kept, no more than were asked for: points more than half a
        deviation apart at which starts settled, or where none did, at which they ended.
    effective : ndarray or None
        (*runs): of draws that adapted the modes the effective number of the last round's; None if
        none were asked for.
    """

    starts: int
    arrived: Integers
    modes: Integers
    effective: Array | None

    def __init__(
        self, starts: int, arrived: Integers, modes: Integers, effective: Array | None = None
    ) -> None:
        for array in (arrived, modes, effective):
            if array is not None:
                array.flags.writeable = False
        self._set(starts=starts, arrived=arrived, modes=modes, effective=effective)

    @property
    def phrases(self) -> list[str]:
        """The figures in words."""
        modes = _range(self.modes)
        found = [
            f"{modes} mode{'s' * (modes != '1')}",
            f"{_range(self.arrived)} of {self.starts} starts settled",
        ]
        if self.effective is not None:
            found.append(f"{_range(self.effective.astype(np.intp))} effective draws")
        return found


def _range(values: Integers) -> str:
    low, high = (int(values.min()), int(values.max())) if values.size else (0, 0)
    return str(low) if low == high else f"{low} to {high}"


class Part(NamedTuple):
    """Some starts, and the beliefs that they led to, with an axis of starts before runs.

    Where `runs` is not None they are starts of some runs alone: `starts` and `runs`, (P,), are the
    numbers of start and run of each belief, in the order of the outcome's leading axes.
    """

    starts: Integers
    outcome: Any
    runs: Integers | None = None

    def within(self, runs: Integers) -> Part:
        """The part, of a search in some runs alone, as one of all runs."""
        if self.runs is not None:
            return self._replace(runs=runs[self.runs])
        return Part(
            np.repeat(self.starts, runs.size), self.outcome, np.tile(runs, self.starts.size)
        )

    def flat(self, values: Array, lead: Sequence[int]) -> Array:
        """Values of the outcome with one leading axis, of starts and then runs or of pairs."""
        axes = 1 + len(lead) if self.runs is None else np.ndim(self.outcome.log_evidence)
        return values.reshape(-1, *values.shape[axes:])


def rows_of(parts: Sequence[Part], runs: int) -> Integers:
    """The row of each start among the beliefs of all parts, one after another, (S, runs).

    Of a start in several parts the last counts; one that a run does not have is −1.
    """
    found = np.full((1 + max(int(part.starts.max()) for part in parts), runs), -1, dtype=np.intp)
    first = 0
    for part in parts:
        if part.runs is None:
            last = first + part.starts.size * runs
            found[part.starts] = np.arange(first, last).reshape(-1, runs)
        else:
            last = first + part.starts.size
            found[part.starts, part.runs] = np.arange(first, last)
        first = last
    return found


@dataclass(frozen=True, eq=False, repr=False)
class Found:
    """The modes of a posterior, whichever network it is of; leading axes are runs.

    Attributes
    ----------
    parts : sequence of Part
        The beliefs at which starts arrived.
    index : ndarray of int
        By mode the start that found it, (K, runs).
    weights : ndarray
        The modes' weights, (K, runs).
    hits : ndarray of int
        How many of the starts that settled arrived at each mode, (K, runs); 0 of a mode that a run
        does not have.
    """

    status: Status
    log_evidence: Array
    parts: Sequence[Part]
    index: Integers
    weights: Array
    hits: Integers

    def with_draws(
        self, weights: Array, log_evidence: Array, effective: Array, beliefs: Any
    ) -> Found:
        """The modes as draws adapted them, of weights (K, runs), with beliefs (K, *runs, ...)."""
        lead, (count, runs) = np.shape(self.log_evidence), weights.shape
        figures = self.status._figures
        assert isinstance(figures, ModeFigures)
        own = figures.starts, figures.arrived, figures.modes, effective.reshape(lead)
        every = np.arange(count)
        return Found(
            self.status._with(_figures=ModeFigures(*own)),
            np.asarray(log_evidence.reshape(lead)),
            [Part(every, beliefs)],
            np.tile(every[:, None], (1, runs)),
            weights,
            self.hits,
        )

    @property
    def drawn(self) -> bool:
        """Whether weighed draws adapted the modes."""
        return getattr(self.status._figures, "effective", None) is not None

    def mixture(self, each: Sequence[Gaussian]) -> GaussianMixture:
        """The mixtures of the Gaussians of all starts, one of each part, (starts, *runs, ...)."""
        lead = np.shape(self.log_evidence)
        count, runs = self.index.shape
        steps = each[0].mean.shape[1 + len(lead) : -1]
        rows = rows_of(self.parts, runs)[self.index, np.arange(runs)]

        def of_modes(name: str) -> Array:
            """Moments of all parts as those of the modes, (*lead, *steps, K, ...)."""
            moments = [getattr(own, name) for own in each]
            pairs = zip(self.parts, moments, strict=True)
            whole = np.concatenate([part.flat(own, lead) for part, own in pairs])
            chosen = np.moveaxis(whole[rows], 0, 1 + len(steps))
            return chosen.reshape(*lead, *chosen.shape[1:])

        weights = np.moveaxis(self.weights, 0, 1).reshape(*lead, *(1,) * len(steps), count)
        weights = np.broadcast_to(weights, (*lead, *steps, count)).copy()
        found = Gaussian._make(each[0].scope, of_modes("mean"), of_modes("cov"))
        return GaussianMixture._make(weights, found, each[0].steps)

    def sample(self, count: int, rng: np.random.Generator) -> dict[Variable, Array]:
        """So many draws for each run, (count, *runs, ...), each of a mode by its weight."""
        if self.drawn:
            raise Unanswered(
                "modes that draws adapted have no joint of all variables to be drawn from: leave "
                "draws= out of pgm.Gaussians(...), or sample an answer of pgm.smooth or pgm.infer "
                "in place of pgm.estimate"
            )
        each = [part.outcome.sample(count, rng) for part in self.parts]
        lead, runs = np.shape(self.log_evidence), np.arange(self.index.shape[1])
        mode = Dense(self.weights.T).draw(np.broadcast_to(runs, (count, runs.size)), rng)
        rows = rows_of(self.parts, runs.size)[self.index[mode, runs], runs]
        found: dict[Variable, Array] = {}
        for variable in each[0]:
            drawn = [np.moveaxis(own[variable], 0, 1 + len(lead)) for own in each]
            pairs = zip(self.parts, drawn, strict=True)
            whole = np.concatenate([part.flat(own, lead) for part, own in pairs])
            own = whole[rows, np.arange(count)[:, None]]
            found[variable] = own.reshape(count, *lead, *own.shape[2:])
        return found


@dataclass(frozen=True, eq=False, repr=False)
class ModesOutcome(Outcome[GaussianMixture]):
    """Mixtures of the modes of a posterior."""

    beliefs: ClassVar[str] = "mixtures of modes"
    silent: ClassVar[str] = "each mode has a linearisation of its own, and no messages are kept"

    graph: ClusterGraph
    _found: Found

    @property
    def status(self) -> Status:
        """How the starts went."""
        return self._found.status

    @property
    def log_evidence(self) -> Array:
        """Ln p(evidence), (*runs), in nats."""
        return self._found.log_evidence

    @property
    def log_evidence_kind(self) -> str:
        """``modes`` by Laplace's approximation of those that were found; ``draws`` by weighing."""
        return "draws" if self._found.drawn else "modes"

    def __getitem__(self, variable: Variable) -> GaussianMixture:
        """The marginal of a hidden variable; over time at all its steps or at one."""
        return self._found.mixture([part.outcome[variable] for part in self._found.parts])

    def joint(self, *variables: Variable) -> GaussianMixture:
        """The joint of hidden variables; over time at steps, ``x.at(3)``."""
        return self._found.mixture([part.outcome.joint(*variables) for part in self._found.parts])

    def sample(self, count: int, rng: np.random.Generator) -> dict[Variable, Array]:
        """So many draws for each run, each of a mode by its weight: as of the modes' outcomes."""
        return self._found.sample(count, rng)

    def refusal(self, question: str) -> PgmError:
        """The error for what modes cannot answer, and one linearisation can."""
        what, error = QUESTIONS[question]
        return error(
            f"{what}: {self.beliefs} have none; a posterior of one linearisation, of pgm.filter, "
            "pgm.smooth or pgm.infer, may have them"
        )


class ChainModes(ModesOutcome):
    """Mixtures of the modes of a chain's posterior; leading axes are runs, then there are steps."""

    moving: ClassVar[bool] = True
    kind: ClassVar[Knows] = SMOOTHED

    graph: DynamicGraph

    @property
    def _hidden(self) -> Scope:
        return (*self.graph.model.states, *self.graph.model.controls)

    @property
    def _title(self) -> str:
        lead = np.shape(self.log_evidence)
        runs = f", runs {lead}" if lead else ""
        return f"Posterior({self.kind}, steps 0..{self.graph.steps}{runs})"

    def _summary(self) -> Summary:
        lead = np.shape(self.log_evidence)
        return over_time(self._title, self, self._hidden, lead, self.graph.steps)


@dataclass(frozen=True, eq=False, repr=False)
class NetworkModes(ModesOutcome):
    """Mixtures of the modes of the posterior of a network without time; leading axes are runs."""

    form: ClassVar[str] = MODES
    kind: ClassVar[None] = None

    graph: ClusterGraph
    _entered: Mapping[Variable, Array]

    @property
    def _hidden(self) -> Scope:
        hidden: Scope = self._found.parts[0].outcome._hidden
        return hidden

    def belief(self, cluster: int | Cluster) -> GaussianMixture:
        """The belief of a cluster over its variables without evidence, of mass one."""
        index = self.graph.index(cluster)
        if not (scope := self.scope(self.graph.clusters[index])):
            raise GraphError(f"all variables of cluster {index} are observed: it has no belief")
        return self.joint(*scope)

    def entered(self, run: int) -> dict[Variable, Array]:
        """The values that were given, by variable, (d,) each; NaN of what was not measured."""
        return {v: rows.reshape(-1, v.dimension)[run] for v, rows in self._entered.items()}

    @property
    def _title(self) -> str:
        lead = np.shape(self.log_evidence)
        runs = f", runs {lead}" if lead else ""
        return f"Posterior({self.graph._title}{runs})"

    def _summary(self) -> Summary:
        return of_network(self._title, self, self._hidden, np.shape(self.log_evidence))
