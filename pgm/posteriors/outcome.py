"""The outcome of a schedule, as a family of beliefs keeps it: from it a `Posterior` answers."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, ClassVar, Generic, Protocol, Self

import numpy as np

from pgm.clustergraph import Cluster
from pgm.display import Shown
from pgm.errors import EvidenceError, GraphError, PgmError, Unanswered
from pgm.evidence import Reading
from pgm.factors.scope import Scope
from pgm.kernels.arrays import Array, Integers
from pgm.posteriors.belief_kind import Kind
from pgm.posteriors.shown_slices import Room, ShownMarginals, ShownSlices
from pgm.posteriors.status import Status
from pgm.variables import Variable

# The type of marginals. `Posterior` alone stands for that of any beliefs, and a call without a
# family returns such a one, as its marginals depend on the network.
if TYPE_CHECKING:
    from typing_extensions import TypeVar

    B = TypeVar("B", default=Any)
    B_co = TypeVar("B_co", covariant=True, default=Any)
else:
    from typing import TypeVar

    B = TypeVar("B")
    B_co = TypeVar("B_co", covariant=True)

# What a posterior can be asked for beside marginals and joints: in words, and the error of a family
# that has no answer.
QUESTIONS: dict[str, tuple[str, type[PgmError]]] = {
    "associations": ("associations of measurements", Unanswered),
    "belief": ("beliefs of clusters", GraphError),
    "filtered": ("the forward pass", Unanswered),
    "innovations": ("innovations", Unanswered),
    "joint": ("joints", EvidenceError),
    "left_out": ("beliefs of readings given all others", Unanswered),
    "lost": ("innovations, which tell where a belief was lost", Unanswered),
    "message": ("messages", GraphError),
    "nonlinearity": ("nonlinearities of CPDs that were linearised", Unanswered),
    "potential": ("potentials of clusters", GraphError),
    "predicted": ("marginals given the measurements before each step", Unanswered),
    "rejected": ("rejections by gates", Unanswered),
    "sample": ("draws of all variables together", Unanswered),
    "weights": ("weights of measurements", Unanswered),
}


# Forms in which beliefs are kept: moments or tables of a chain's slices, moments of the slices of a
# balanced tree, moments or tables of a network without time, mixtures of a mixed one, any of these
# for runs of each pattern of gaps; the modes of a network without time, whose clusters have beliefs
# and no messages; or the marginals of variables alone.
CHAIN, SLICES, BALANCED, NETWORK, TABLES = "chain", "slices", "balanced", "network", "tables"
MIXTURES, MODES, MARGINALS, SWITCHING = "mixtures", "modes", "marginals", "switching"
BY_PATTERN = "by pattern"


class OverTime(Protocol[B_co]):
    """Marginals at all steps, of one pass: what ``posterior.filtered`` and ``.predicted`` are.

    A `Posterior` where the family keeps so much of the pass, else marginals and their kind alone.
    """

    @property
    def kind(self) -> Kind:
        """Which measurements the marginals know."""

    def __getitem__(self, variable: Variable, /) -> B_co:
        """The marginal of a variable at its steps, ``x``, or at one of them, ``x.at(3)``."""

    if TYPE_CHECKING:  # of a pass that is a posterior, all that this has

        def __getattr__(self, name: str) -> Any:
            """A quantity that some families have of a pass, such as a grid's log-evidence."""


class Outcome(Shown, ABC, Generic[B]):
    """Base of the outcomes of all families; B is what the marginal of a variable is.

    Beside the methods below, an outcome has methods and properties by the names of `QUESTIONS`, for
    what it can answer; `refusal` words the rest. Leading axes of all results are the user's axes of
    runs.
    """

    # Of which beliefs, in the text of a refusal: a plural.
    beliefs: ClassVar[str] = "these beliefs"
    # The form in which they are kept, by which a page shows slices or clusters, and an audit draws;
    # a page's name for their graph, and why it shows no messages; whether a path can be drawn
    # through their marginals.
    form: ClassVar[str] = MARGINALS
    called: ClassVar[str] = "chain"
    silent: ClassVar[str] = "these beliefs go from slice to slice, and no messages are kept"
    moving: ClassVar[bool] = False

    if TYPE_CHECKING:  # a property would be taken for the default of a field of the same name

        @property
        def graph(self) -> Any:
            """The cluster graph on which the schedule ran."""

        @property
        def status(self) -> Status:
            """How the schedule went."""

        @property
        def kind(self) -> Kind | None:
            """Which measurements the beliefs know; None without time."""

        @property
        def log_evidence(self) -> Array:
            """Ln p(evidence), (*runs), in nats."""

        @property
        def log_evidence_kind(self) -> str:
            """The kind of `log_evidence`, in a word, such as ``exact``."""

    @abstractmethod
    def __getitem__(self, variable: Variable) -> B:
        """The marginal of a variable without evidence."""

    def _moments(self, variable: Variable) -> Any:
        """The marginal of a variable, in a form that has moments, if it has such.

        Summaries, pages, data sets and comparisons ask for it. A family's own form without moments
        is an EvidenceError.
        """
        return self[variable]

    def _stacked(self, variables: Sequence[Variable]) -> tuple[Array, Array]:
        """Means (*lead, k, d) and covariances (*lead, k, d, d) of k variables of d components."""
        beliefs = [self._moments(variable) for variable in variables]
        means, covs = ([getattr(each, name) for each in beliefs] for name in ("mean", "cov"))
        return np.stack(means, axis=-2), np.stack(covs, axis=-3)

    def _readings_of(self, variable: Variable) -> tuple[Integers, Array]:
        """The readings of a sensor as a picture shows them: their steps, and values (*runs, M, d).

        NaN was not read. Of a sensor without evidence there are none.
        """
        raise self.refusal("predicted")

    @property
    def _squares(self) -> Mapping[Variable, tuple[Array, Integers]]:
        """The NIS of each sensor by step, and its degrees of freedom, (*runs, T+1) each.

        They are those of the innovations. Where the latter are zero, a NIS has no meaning.
        """
        found = getattr(self, "innovations", None)
        if found is None:
            raise self.refusal("innovations")
        return {sensor: (each.nis, each.dof) for sensor, each in found.items()}

    @property
    @abstractmethod
    def _hidden(self) -> Scope:
        """The variables that have marginals; of a dynamic network their templates."""

    @property
    def readings(self) -> Sequence[Reading]:
        """The measurements that a page shows beside marginals, sensor by sensor."""
        return ()

    def slices(self, span: range, room: Room) -> ShownSlices:
        """The slices of these steps of beliefs over time, as a page shows them.

        Unless a family has messages to show, that is the marginals of variables that have moments.
        """
        return ShownMarginals(self, span, room)

    def scope(self, cluster: Cluster) -> Scope:
        """The variables of a cluster without evidence, in the order of its scope."""
        hidden, over_time = frozenset(self._hidden), self.kind is not None
        return tuple(v for v in cluster.scope if (v.template if over_time else v) in hidden)

    def entered(self, run: int) -> Mapping[Variable, Any]:
        """The evidence of a run of a network without time, as a page shows it beside clusters.

        By variable an array (d,), NaN where nothing was observed, or the name of a state, None of
        one that was not observed in this run. `run` counts the runs, flattened.
        """
        return {}

    def _changed(self, **fields: Any) -> Self:
        """The outcome with other fields, whose parts are made as late as those of this one."""
        found = object.__new__(type(self))
        found.__dict__.update(self.__dict__, **fields)
        return found

    def refusal(self, question: str) -> PgmError:
        """The error for one of `QUESTIONS` that this outcome cannot answer."""
        what, error = QUESTIONS[question]
        return error(f"{what}: {self.beliefs} have none")

    def _why_unsettled(self) -> str:
        """Why messages round loops have not settled, as a sentence; empty if it is not known."""
        return ""

    def _doubt(self) -> str:
        """Why the beliefs are probably wrong, for a warning; empty if nothing says so at once."""
        return ""

    def _misfit(self) -> str:
        """Why no linearisation can be right, for a warning; empty if nothing says so at once."""
        return ""


def marginal(beliefs: Any, variable: Variable) -> Any:
    """The marginal of a variable in a form with moments, if a family's own form may have none.

    `beliefs` are a posterior, marginals over time, or an online belief.
    """
    return getattr(beliefs, "_moments", beliefs.__getitem__)(variable)
