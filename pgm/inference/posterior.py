"""The base class of what inference on a network returns: marginals, joints, messages, log-evidence.

Its subclasses are for tables or Gaussians, on chains, trees or graphs with loops.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import ClassVar, overload

from pgm.clustergraph import Cluster, ClusterGraph
from pgm.display import NoArray, Shown, Viewed
from pgm.errors import EvidenceError
from pgm.factors import CanonicalForm, Gaussian, Table
from pgm.factors.scope import Scope
from pgm.inference.labelled import Labelled
from pgm.inference.status import Status
from pgm.kernels.arrays import Array
from pgm.variables import Discrete, Variable


class Posterior(Labelled, Viewed, Shown, NoArray, ABC):
    """The beliefs of a cluster graph after a schedule of messages; leading axes are runs.

    Marginals and joints are a `Gaussian` for continuous variables, a `Table` for discrete ones;
    messages and cluster beliefs are a `CanonicalForm` or a `Table`, unnormalised.

    Attributes
    ----------
    graph : ClusterGraph
    status : Status
        Iterations, residuals, and whether each run converged.

    Examples
    --------
    >>> a, b, c = pgm.variables("a b c")
    >>> net = pgm.BayesianNetwork([
    ...     pgm.GaussianCPD(a, 0.0, 1.0),
    ...     pgm.LinearGaussianCPD(b, given={a: 1.0}, cov=1.0),
    ...     pgm.LinearGaussianCPD(c, given={b: 1.0}, cov=2.0),
    ... ])
    >>> graph = pgm.compile(net, method=pgm.JunctionTree())
    >>> posterior = pgm.infer(graph, {c: [4.0]})
    >>> posterior[a].mean, posterior[b].mean
    (array([1.]), array([2.]))
    >>> posterior.joint(a, b).cov
    array([[0.75, 0.5 ],
           [0.5 , 1.  ]])
    >>> posterior.belief(0)
    CanonicalForm(a, b)
      g = -7.10339
         h  K: a     b
      a  0     2  -1.0
      b  2    -1   1.5
    >>> posterior.message(0, 1)
    CanonicalForm(b)
      g = -1.26551
         h  K: b
      b  0   0.5
    """

    graph: ClusterGraph
    status: Status

    _arrays: ClassVar[str] = ".mean and .cov by variable, posterior[x].mean"

    # Python would else iterate by asking for the variables 0, 1, ...
    __iter__: ClassVar[None] = None

    @overload
    def __getitem__(self, variable: Discrete) -> Table: ...  # type: ignore[overload-overlap]

    @overload
    def __getitem__(self, variable: Variable) -> Gaussian: ...

    @abstractmethod
    def __getitem__(self, variable: Variable) -> Gaussian | Table:
        """The marginal of a variable without evidence.

        For a variable over time, the last of the leading axes is of steps.

        Raises
        ------
        EvidenceError
            If the variable has evidence, or is not of the network.
        """

    @overload
    def joint(self, *variables: Discrete) -> Table: ...  # type: ignore[overload-overlap]

    @overload
    def joint(self, *variables: Variable) -> Gaussian: ...

    @abstractmethod
    def joint(self, *variables: Variable) -> Gaussian | Table:
        """The joint of some variables without evidence, in the order given.

        Raises
        ------
        EvidenceError, ModelError
            If a variable has evidence, is not of the network or is named twice, or none is given.
        GraphError
            If no cluster of a graph with loops holds them all, or the result would take too much
            memory.
        """

    @abstractmethod
    def message(self, source: int | Cluster, target: int | Cluster) -> CanonicalForm | Table:
        """The message from one cluster to a neighbour, over their sepset.

        Raises
        ------
        GraphError
            If the clusters are not joined.
        NumericalError
            If it has no canonical form, since a covariance is singular.
        """

    @abstractmethod
    def belief(self, cluster: int | Cluster) -> CanonicalForm | Table:
        """The belief of a cluster over its variables without evidence.

        Raises
        ------
        GraphError
            If the graph has no such cluster.
        NumericalError
            If it has no canonical form, since a covariance is singular.
        """

    @abstractmethod
    def potential(self, cluster: int | Cluster) -> CanonicalForm | Table:
        """The potential of a cluster: the product of its CPDs, with their evidence put in.

        It is over the cluster's variables without evidence, nonlinear CPDs as they were linearised
        last. Its product with all messages to the cluster, if the schedule has sent these, is the
        cluster's belief.

        Raises
        ------
        GraphError
            If the graph has no such cluster, or the potential would take too much memory.
        NumericalError
            If it has no canonical form, since a covariance is singular.
        """

    @property
    @abstractmethod
    def _hidden(self) -> Scope:
        """The variables that have marginals; over time each is one variable, without a step."""

    @property
    @abstractmethod
    def log_evidence(self) -> Array:
        """The log-evidence ln p(evidence), (...), in nats; see `log_evidence_kind`."""

    @property
    @abstractmethod
    def log_evidence_kind(self) -> str:
        """What `log_evidence` is, in a word.

        It is ``exact``; that of the ``linearised`` network; Laplace's approximation (``laplace``);
        Bethe's, of a graph with loops (``bethe``); or, with robust noise, a lower ``bound``, a
        ``linearised bound``, or ``unnormalised``, if a density has no finite integral.
        """

    def _why_unsettled(self) -> str:
        """Why messages round loops have not settled, as a sentence; empty if it is not known."""
        return ""


def require_variable(variable: Variable) -> Variable:
    """The same variable; any other key, as a name or several variables, is an `EvidenceError`."""
    if isinstance(variable, tuple | list | set):
        raise EvidenceError(
            f"{variable!r} is asked for where one variable was due: of several, ask for "
            "posterior.joint(a, b)"
        )
    if not isinstance(variable, Variable):
        raise EvidenceError(f"results are asked for by variable, not by {variable!r}: posterior[x]")
    return variable
