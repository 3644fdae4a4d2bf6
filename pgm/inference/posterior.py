"""The interface of posteriors of any network, as data sets too, and of results by sensor."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
from importlib import import_module
from typing import Any, ClassVar, TypeVar, overload

import numpy as np

from pgm.clustergraph import Cluster, ClusterGraph
from pgm.compile import DynamicGraph
from pgm.display import NoArray, Shown
from pgm.errors import EvidenceError
from pgm.factors import CanonicalForm, Gaussian, Table
from pgm.factors.listing import run_names
from pgm.factors.scope import Scope, dimension, distinct_labels, listed
from pgm.inference.status import Status
from pgm.kernels.arrays import Array
from pgm.resources import FRAMES, optional, require_memory
from pgm.variables import Discrete, Variable


class Labelled:
    """A posterior whose marginals make a data set."""

    def to_xarray(self: Any) -> Any:
        """The marginals of all hidden variables as a data set of xarray.

        Of continuous variables it has ``mean`` and ``std``, with the dimensions of runs (``run``,
        or ``run_0``, ``run_1``, ...), ``step``, where there is time, and ``component``, and
        ``cov``, with ``other_component`` last. Components are called by their names, with that of
        the variable where variables share one, and ``variable`` says whose they are. The covariance
        of two variables is NaN: `joint` has it. So is a hidden control at step 0, where it has no
        value.

        Of discrete variables it has the probabilities of each, under its name, with its states
        along a last dimension ``<name>_state``.

        ``log_evidence`` has the dimensions of runs. Attributes are ``kind``, where there is time,
        and ``log_evidence_kind``. An `ImportError` says how to install xarray where it is missing.

        Examples
        --------
        >>> from pgm.examples import drive
        >>> found = pgm.filter(drive, {}, steps=4).to_xarray()
        >>> float(found.cov.sel(step=4, component="north", other_component="north"))
        5.0
        """
        xarray = optional("xarray", f"{type(self).__name__}.to_xarray()", FRAMES)
        runs = run_names(np.ndim(self.log_evidence))
        marginals = {variable: self[variable] for variable in self._hidden}
        steps = self.graph.steps if isinstance(self.graph, DynamicGraph) else None
        coords = {} if steps is None else {"step": np.arange(steps + 1)}
        dims = [*runs, *coords]
        tables = any(isinstance(belief, Table) for belief in marginals.values())
        data, more = (_tables if tables else _moments)(marginals, dims, steps)
        data["log_evidence"] = (runs, np.asarray(self.log_evidence))
        attributes = {"log_evidence_kind": self.log_evidence_kind}
        if steps is not None:
            attributes = {"kind": str(self.kind), **attributes}
        return xarray.Dataset(data, {**coords, **more}, attributes)


# Arrays of a data set by name, each with its dimensions.
Arrays = dict[str, tuple[list[str], Any]]


def _tables(
    marginals: Mapping[Variable, Any], dims: list[str], steps: int | None
) -> tuple[Arrays, dict[str, Any]]:
    data: Arrays = {}
    states: dict[str, Any] = {}
    for variable, table in marginals.items():
        own = f"{variable!r}_state"
        data[repr(variable)] = ([*dims, own], _at_all_steps(table.values, -2, steps))
        states[own] = list(table.scope[0].states)
    return data, states


def _moments(
    marginals: Mapping[Variable, Any], dims: list[str], steps: int | None
) -> tuple[Arrays, dict[str, Any]]:
    each = [_at_all_steps(belief.mean, -2, steps) for belief in marginals.values()]
    lead = each[0].shape[:-1] if each else (0,) * len(dims)
    size = dimension(marginals)
    require_memory(
        math.prod(lead) * size * size,
        f"the covariances of {size} components as one array",
        "take posterior[x] of the variables that are wanted",
    )
    mean = np.concatenate([np.empty((*lead, 0)), *each], axis=-1)
    cov, first = np.full((*lead, size, size), np.nan), 0
    for variable, belief in marginals.items():
        own = slice(first, first := first + variable.dimension)
        cov[..., own, own] = _at_all_steps(belief.cov, -3, steps)
    labels = list(distinct_labels(marginals))
    owners = [repr(variable) for variable in marginals for _ in variable.components]
    data: Arrays = {
        "mean": ([*dims, "component"], mean),
        "std": ([*dims, "component"], np.sqrt(np.einsum("...ii->...i", cov))),
        "cov": ([*dims, "component", "other_component"], cov),
    }
    named = {"component": labels, "other_component": labels, "variable": ("component", owners)}
    return data, named


def _at_all_steps(values: Any, axis: int, steps: int | None) -> Array:
    if steps is None or values.shape[axis] == steps + 1:
        return np.asarray(values)
    before = [(0, 0)] * values.ndim
    before[axis] = (1, 0)
    return np.pad(values, before, constant_values=np.nan)


class Viewed:
    """Base of results that a notebook shows as a page of their graph, beliefs and messages."""

    __slots__ = ()

    def _repr_html_(self) -> str:
        # The viewer stands above this layer, which must not import it: found by its name.
        shown: str = import_module("pgm.viewer").html(self)
        return shown


class Posterior(Labelled, Viewed, Shown, NoArray, ABC):
    """The beliefs of a cluster graph after a schedule of messages; leading axes are runs.

    Marginals and joints are a `Gaussian` for continuous variables, a `Table` for discrete ones;
    messages and cluster beliefs are a `CanonicalForm` or a `Table`, unnormalised.

    Attributes
    ----------
    graph : ClusterGraph
    status : Status
        Iterations, residuals, and whether they converged.

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

        Of a variable over time, the last of the leading axes is of steps.

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
            If no cluster of a graph with loops holds them all, or the result would not fit.
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
        last. Times all messages to the cluster it is the belief, where these were sent. Errors are
        those of `belief`.
        """

    @property
    @abstractmethod
    def _hidden(self) -> Scope:
        """The variables that have marginals; of a dynamic network their templates."""

    @property
    @abstractmethod
    def log_evidence(self) -> Array:
        """The value ln p(evidence), (...)."""

    @property
    @abstractmethod
    def log_evidence_kind(self) -> str:
        """The kind of `log_evidence`: exact, linearised, laplace or bethe."""

    def _why_unsettled(self) -> str:
        """The cause, where one is known, that messages round loops did not settle: a sentence."""
        return ""


def require_variable(variable: Variable) -> Variable:
    """Refuse what is no variable, such as a name."""
    if isinstance(variable, tuple | list | set):
        raise EvidenceError(
            f"{variable!r} is asked for where one variable was due: of several, ask for "
            "posterior.joint(a, b)"
        )
    if not isinstance(variable, Variable):
        raise EvidenceError(f"results are asked for by variable, not by {variable!r}: posterior[x]")
    return variable


Value = TypeVar("Value")


class EachSensor(Shown, Mapping[Variable, Value]):
    """The results of each sensor that was read."""

    _what: ClassVar[str] = "results"

    def __init__(self, found: Mapping[Variable, Value]) -> None:
        self._found = dict(found)

    def __getitem__(self, variable: Variable) -> Value:
        if require_variable(variable) not in self._found:
            raise EvidenceError(self._absent(variable), variable=variable)
        return self._found[variable]

    def _absent(self, variable: Variable) -> str:
        return f"there are no {self._what} of {variable!r}; measurements were given of {list(self)}"

    def __contains__(self, variable: object) -> bool:
        return variable in self._found

    def __iter__(self) -> Iterator[Variable]:
        return iter(self._found)

    def __len__(self) -> int:
        return len(self._found)

    @property
    def _title(self) -> str:
        return f"{type(self).__name__}({listed(self._found)})"
