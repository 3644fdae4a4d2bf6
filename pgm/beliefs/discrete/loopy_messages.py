"""Messages between the clusters of a discrete network whose graph has any shape.

A message goes from a cluster to a neighbour, over their sepset. Arrays end in the axis of runs. The
*entries* of all clusters' tables stand one after the other in one array. Another holds all
messages, in *columns*: one for each joint state of a message's sepset.

Messages have numbers: 2e goes along sepset e from the cluster of lower number to the other, 2e + 1
back. A *round* is a set of messages that are computed together, all from the messages before the
round. Its senders are divided into *groups* of clusters with equally many neighbours and entries.
Those messages of a group that have equally many columns are an *outlet*.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from pgm.beliefs.discrete.entered_evidence import enter_everywhere
from pgm.beliefs.discrete.impossible import contradicted
from pgm.beliefs.discrete.loopy_plan import Group, LoopyPlan, Outlet
from pgm.beliefs.discrete.storage import Storage
from pgm.clustergraph import ClusterGraph
from pgm.evidence.static import BoundStates
from pgm.factors.axes import sizes
from pgm.kernels.arrays import Array, Integers, Mask
from pgm.kernels.semirings import LOG_SUM_PRODUCT, Semiring, exp
from pgm.schedules import limits
from pgm.variables import Discrete

# The relative rounding of a message's logarithms.
ROUNDING = 1e-12


class TableMessages:
    """The messages of a graph as logarithms of tables, each of which sums to one.

    A message is the product of the sender's potential and all messages to it but the receiver's,
    summed over the variables outside the sepset. The product is made without dividing by the
    receiver's message, which may have zeros. In max-product every sum is a maximum, also the one
    that is one of each message. The class implements `pgm.schedules.loopy.Messages`.

    plan: The layout of all messages, and of rounds.
    storage: Where each cluster's table stands among the entries.
    directed: The source and the target cluster of each message.
    potentials: (entries, runs): logarithms of potentials times evidence.
    semiring: Of the sums: `LOG_SUM_PRODUCT` or `MAX_PRODUCT`.
    logs: (columns, runs): logarithms of the messages; `plan` says where each one stands.
    damping: The weight of the logarithm of the old message in the new one, in [0, 1); 0 for none.
    """

    def __init__(
        self,
        graph: ClusterGraph,
        evidence: BoundStates,
        damping: float,
        semiring: Semiring = LOG_SUM_PRODUCT,
    ) -> None:
        _require_room(graph, evidence)
        self.plan = graph.derived(LoopyPlan)
        self.storage = self.plan.storage
        self.directed = self.plan.directed
        self.evidence = evidence
        self.damping = damping
        self.semiring = semiring
        self.runs = evidence.runs
        self.potentials = enter_everywhere(self.storage, evidence)
        widths, which = np.unique(self.plan.widths, return_inverse=True)
        level = np.array([semiring.total(np.zeros(width), 0) for width in widths.tolist()])
        equal = np.repeat(-level[which], self.plan.widths)
        self.logs = np.repeat(equal[:, None], self.runs, axis=1)
        self._proposed = np.empty_like(self.logs)

    @property
    def bounded(self) -> bool:
        """Whether changes of messages are bounded: True, for a probability changes by one at most.

        Changes cannot grow without limit, so that their growth does not count as divergence.
        """
        return True

    def round(self, messages: Sequence[int]) -> Sequence[Group]:
        """Lay out the computation of the messages of these numbers, as one round.

        Returns the groups of clusters that send them.
        """
        if messages == range(len(self.directed)):
            return self.plan.everything(self.runs)
        return self.plan.lay_out(messages, self.runs)

    def propose(self, round: Sequence[Group]) -> Array:
        """Compute a round's new messages from the current ones, which only `accept` replaces.

        Returns the largest change of each message, (messages, runs), in the order in which the
        method `round` was given the messages. It is of a probability; in max-product of an entry
        relative to the larger of its two values, since an entry that is next to nothing may be the
        largest one that evidence elsewhere allows. A message that is zero throughout raises
        `EvidenceError`.
        """
        count = sum(outlet.order.size for group in round for outlet in group.outlets)
        change = np.empty((count, self.runs))
        for group in round:
            products = self._products(group)
            for outlet in group.outlets:
                sums: Array = self.semiring.total(products.take(outlet.index, 0), 0)
                new = self._normalised(sums.reshape(*outlet.columns.shape, self.runs), outlet)
                old = self.logs[outlet.columns]
                change[outlet.order] = self._change(new, old).max(axis=1)
                self._proposed[outlet.columns] = new
        return change

    def _change(self, new: Array, old: Array) -> Array:
        """How much each entry of messages changes, from 0 to 1; of their logarithms."""
        if self.semiring is LOG_SUM_PRODUCT:
            found: Array = np.abs(exp(new) - exp(old))
            return found
        same = new == old  # where both may be −∞
        apart = np.abs(np.subtract(new, old, where=~same, out=np.zeros_like(new)))
        relative: Array = -np.expm1(-apart)
        return relative

    def _products(self, group: Group) -> Array:
        """The products of each cluster's potential and all messages to it but one, as logarithms.

        The result is (neighbours · entries of the group, runs): first the products that leave out
        the message of each cluster's first neighbour, at all entries of the group's tables; then
        those that leave out the message of the second neighbour, and so on.
        """
        incoming = self.logs.take(group.incoming, 0)
        products = np.empty_like(incoming)
        products[0] = self.potentials.take(group.entries, 0)
        products[1:] = incoming[:-1]
        np.add.accumulate(products, 0, out=products)
        after = np.add.accumulate(incoming[:0:-1], 0)
        products[:-1] += after[::-1]
        return products.reshape(-1, self.runs)

    def _normalised(self, messages: Array, outlet: Outlet) -> Array:
        """Messages of an outlet, each divided by its sum, as logarithms.

        They are (messages, columns, runs).

        The argument `messages` has the logarithms before the division, in the same shape. A message
        of sum zero is refused with an `EvidenceError`, which names its sender.
        """
        total = self.semiring.total(messages, 1)
        self.require_possible(total, outlet.senders)
        normalised: Array = messages - total[:, None]
        return normalised

    def require_possible(self, totals: Array, clusters: Integers) -> None:
        """Raise `EvidenceError` if a sum is zero, which tells that the evidence is impossible.

        `totals`, (rows, runs), are logarithms of sums. Each row is for a message, for the belief of
        a cluster, or for the product of the two messages over a sepset. `clusters`, (rows,), has
        for each row the number of the cluster to be named: the message's sender, the belief's
        cluster, or the cluster of lower number at the sepset. The error names the first run in
        which a sum is zero, and the cluster of the first sum that is zero in this run.
        """
        empty = totals == -np.inf
        if empty.any():
            found = [self.storage.graph.clusters[k] for k in clusters.tolist()]
            raise contradicted(empty, found, self.evidence.lead)

    def accept(self, round: Sequence[Group], active: Mask, lost: Mask) -> None:
        """Replace messages by those of the last `propose`, in the runs that are active.

        `active`, (runs,), is the mask of these runs. With damping d, the message that is kept is
        the new one to the power of 1 − d times the old one to the power of d, normalised; if this
        product is zero throughout, an `EvidenceError` is raised. `lost`, (runs,), marks runs whose
        messages have diverged; it is not used, as such runs are not active.
        """
        for group in round:
            for outlet in group.outlets:
                new, old = self._proposed[outlet.columns], self.logs[outlet.columns]
                if self.damping:
                    new = self._normalised((1.0 - self.damping) * new + self.damping * old, outlet)
                self.logs[outlet.columns] = np.where(active, new, old)

    def relinearise(self, active: Mask) -> None:
        """Do nothing, and return None: no CPD of a discrete network is nonlinear."""
        return

    def belief_logs(self) -> Array:
        """The clusters' potentials times all messages to each, as logarithms, (entries, runs)."""
        logs = self.potentials.copy()
        for group in self.plan.everything(self.runs):
            logs[group.entries] += self.logs.take(group.incoming, 0).sum(axis=0)
        return logs

    def settled(self) -> Mask:
        """Whether each message equals what it would be if it were sent now, (runs,).

        Every entry is compared, up to rounding, and also those that are next to nothing beside the
        largest one of their message.
        """
        self.propose(self.round(range(len(self.directed))))
        new, old = self._proposed, self.logs
        with np.errstate(invalid="ignore"):
            near = np.abs(new - old) <= ROUNDING * np.maximum(1.0, np.abs(old))
        found: Mask = (near | (new == old)).all(axis=0)
        return found

    def beliefs(self) -> tuple[Array, Array]:
        """The clusters' beliefs as probabilities, (entries, runs), and ln Z_cluster of each.

        A belief is the cluster's potential times all messages to the cluster; Z_cluster is its sum,
        by which it is divided. The logarithms ln Z_cluster are (clusters, runs). A belief that is
        zero throughout raises `EvidenceError`.
        """
        logs = self.belief_logs()
        lengths = np.array(self.storage.graph.sizes)
        totals = _segments(logs, lengths)
        self.require_possible(totals, np.arange(lengths.size))
        return exp(logs - totals.repeat(lengths, 0)), totals

    def log_evidence(self, totals: Array) -> Array:
        """The Bethe approximation of ln p(evidence), Σ ln Z_cluster − Σ ln Z_sepset, (runs,).

        `totals` are the values ln Z_cluster, (clusters, runs), that `beliefs` returns. Z_sepset is
        the sum of the product of the two messages over a sepset; if it is zero `EvidenceError` is
        raised.
        """
        value: Array = totals.sum(axis=0)
        widths = self.plan.widths
        if widths.size:
            owner = np.repeat(np.arange(widths.size), widths)
            there, back = self.logs[owner % 2 == 0], self.logs[owner % 2 == 1]
            sepsets = _segments(there + back, widths[::2])
            self.require_possible(sepsets, self.directed.source[::2])
            value = value - sepsets.sum(axis=0)
        return value


def _require_room(graph: ClusterGraph, evidence: BoundStates) -> None:
    """Raise `GraphError` if the computation of messages would take too much memory.

    A cluster's *products* are as many tables as it sends messages, each of its own table's size.
    Two amounts may be a gibibyte at most: in one run, the products of all clusters; in all runs
    together, the tables of all clusters with the products of that cluster which has most.
    """
    # A cluster's table is multiplied by the messages of all neighbours but each in turn: where
    # these meet it is laid out for all clusters, the products are made for some at once.
    products = [size * max(1, len(graph.neighbours(k))) for k, size in enumerate(graph.sizes)]
    limits.require_size(graph, products, "tables, one for each message that a cluster sends,")
    entries = sum(graph.sizes) + max(products)
    limits.require_runs(entries, evidence.runs, "messages round the graph")


def _segments(logs: Array, lengths: Integers) -> Array:
    """The values ln Σ exp over segments of the rows of `logs`, (rows, runs): (segments, runs).

    The segments are consecutive, and `lengths`, (segments,), are their numbers of rows.
    """
    first = np.cumsum(lengths) - lengths
    top = np.maximum.reduceat(logs, first, 0)
    top = np.where(top == -np.inf, 0.0, top)
    with np.errstate(divide="ignore"):
        total: Array = np.log(np.add.reduceat(exp(logs - top.repeat(lengths, 0)), first, 0))
    return total + top


@dataclass(frozen=True, eq=False)
class LoopyBeliefs:
    """The beliefs of a graph with loops after messages were sent, for a posterior to read.

    messages: The messages that were sent last.
    storage: Where each cluster's table stands among the entries.
    evidence: The evidence of all runs.
    _tables: (entries, [runs]): the clusters' beliefs, of sum one; a single run has no axis.
    _totals: (clusters, runs): the logarithms of the beliefs' sums before normalisation.
    """

    messages: TableMessages
    storage: Storage
    evidence: BoundStates
    _tables: Array
    _totals: Array

    @classmethod
    def of(cls, messages: TableMessages) -> LoopyBeliefs:
        """The beliefs of all clusters: the potential of each times all current messages to it."""
        tables, totals = messages.beliefs()
        if messages.runs == 1:
            tables = tables[:, 0]
        return cls(messages, messages.storage, messages.evidence, tables, totals)

    @cached_property
    def _marginals(self) -> Array:
        """The marginals of all variables one after the other, (states of all variables, [runs]).

        ``storage.marginals.where[variable]`` is the slice of each one.
        """
        return self.storage.marginals.read(self._tables)

    def marginal(self, variable: Discrete) -> Array:
        """The marginal of a variable given the evidence, (states, [runs])."""
        return self._marginals[self.storage.marginals.where[variable]]

    def read(self, reader: Callable[[Array], Array]) -> Array:
        """The result of `reader`, called with the clusters' beliefs in one flat array.

        `reader` takes the array, (entries, [runs]), in the layout of `storage`, where a single run
        has no axis, and returns an array (..., [runs]).
        """
        return reader(self._tables)

    def log_evidence(self) -> Array:
        """The Bethe value, an approximation of ln p(evidence), (runs,)."""
        return self.messages.log_evidence(self._totals)

    def log_total(self, cluster: int) -> Array:
        """The logarithm of the sum of a cluster's unnormalised belief, (runs,)."""
        total: Array = self._totals[cluster]
        return total

    def message(self, source: int, target: int) -> tuple[Array, None]:
        """The message from one cluster to a neighbour, (sizes of the sepset..., runs), and None.

        The message sums to one in each run. None stands for a log-scale, which the message does
        not have.
        """
        plan, graph = self.messages.plan, self.storage.graph
        edge = min(source, target), max(source, target)
        number = 2 * list(graph.sepsets).index(edge) + (source > target)
        first = plan.first[number]
        logs = self.messages.logs[first : first + plan.widths[number]]
        return exp(logs).reshape((*sizes(plan.sepsets[number]), -1)), None
