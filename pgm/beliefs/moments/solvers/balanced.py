"""Messages and cluster beliefs of the balanced cluster tree of a dynamic network.

The tree's leaves are the clusters 0 to T of the chain of slices. Every other cluster stands for a
*segment*, the steps after a up to b, and holds the states at a, at b and at a step between
(`BalancedGraph`). The leaf of a step t > 0 is a segment of one step, from t − 1 to t.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from pgm.beliefs.moments.outcomes.outcome import ChainOutcome
from pgm.beliefs.moments.passes.backward import transition
from pgm.beliefs.moments.passes.messages import absorbed
from pgm.clustergraph import Cluster
from pgm.compile import BalancedGraph
from pgm.factors import CanonicalForm
from pgm.kernels import canonical
from pgm.kernels.arrays import block
from pgm.kernels.canonical import Canonical
from pgm.kernels.elements import Element, compose
from pgm.kernels.prefixes import take
from pgm.posteriors.belief_kind import FILTERED, SMOOTHED
from pgm.posteriors.outcome import BALANCED


@dataclass(frozen=True, eq=False, repr=False)
class BalancedOutcome(ChainOutcome):
    """The beliefs of a balanced cluster tree after a schedule of messages.

    Beliefs over variables and slices are found as on the chain of slices; messages and beliefs of
    clusters are those of the balanced tree `graph`. After smoothing they are those of a calibrated
    tree. After filtering a message down to a segment knows only the measurements up to the
    segment's left end, and cluster 0 is sent none. Methods take a cluster of `graph` or its index.
    """

    graph: BalancedGraph

    form: ClassVar[str] = BALANCED

    def message(self, source: int | Cluster, target: int | Cluster) -> CanonicalForm:
        """The message from one cluster to a neighbour, over their sepset, unnormalised.

        For a segment from a to b, with states x at a and y at b:

            up     p(y, measurements after a up to b | x),
            down   p(x, measurements up to a) p(measurements after b | y),

        the latter without its second factor after filtering. Cluster 0 sends up p(x[0],
        measurements at 0) and is sent down p(measurements after 0 | x[0]).

        Raises
        ------
        GraphError
            If the clusters are not joined, or the message was not sent.
        NumericalError
            If the message has no canonical form.
        """
        graph = self.graph
        source, target = graph.index(source), graph.index(target)
        scope = graph.sepsets[source, target]
        up = graph.parent(source) == target
        first, last = graph.segment(source if up else target)
        if up:
            parts = self._segment(first, last) if last else self._past(0)
        elif self.kind != SMOOTHED and (self.kind != FILTERED or not last):
            raise self._unsent(source, target)
        else:
            future = self._future(last)
            parts = _side_by_side(self._past(first), future) if last else future
        return self._form(scope, parts, f"the message from cluster {source} to {target}", source)

    def belief(self, cluster: int | Cluster) -> CanonicalForm:
        """The belief of a cluster over its hidden variables, unnormalised.

        Its integral is the density of the measurements that it knows. After smoothing these are all
        measurements; after filtering they are those up to the last step of the cluster's segment.

        Raises
        ------
        NumericalError
            If the belief has no canonical form, since its covariance is singular.
        """
        index = self.graph.index(cluster)
        if index <= self.graph.steps:
            return super().belief(index)
        scope = self.graph.cluster(index).scope
        _, last = self.graph.segment(index)
        joint = self.joint(*scope)
        runs, size = self._plan.runs, joint.mean.shape[-1]
        parts = canonical.from_moments(
            joint.mean.reshape(runs, size), joint.cov.reshape(runs, size, size), self._weight(last)
        )
        return self._form(scope, parts, f"the belief of cluster {index}", index)

    def potential(self, cluster: int | Cluster) -> CanonicalForm:
        """The potential of a cluster, which is one everywhere in clusters that have no CPD.

        Raises
        ------
        NumericalError
            If it has no canonical form, since a noise is singular.
        """
        index = self.graph.index(cluster)
        if index <= self.graph.steps:
            return super().potential(index)
        form = CanonicalForm.vacuous(self.graph.cluster(index).scope)
        lead = self._planned.lead
        K, h = np.broadcast_to(form.K, (*lead, *form.K.shape)), form.h
        return CanonicalForm._make(form.scope, K, h, form.g)

    def _future(self, step: int) -> Canonical:
        """The likelihood of the measurements after a step, a canonical form over the states there.

        Parts K, h and g are (runs, m, m), (runs, m) and (runs,) for m components. The likelihood is
        one (all zeros) unless the posterior is smoothed.
        """
        if self.kind == SMOOTHED:
            K, h, g = self._backward_messages
            return K[step], h[step], g[step]
        size = self.graph.layout.state_size
        runs = self._plan.runs
        return np.zeros((runs, size, size)), np.zeros((runs, size)), np.zeros(runs)

    def _segment(self, first: int, last: int) -> Canonical:
        """The message up from a segment, p(y, measurements after a up to b | x), in canonical form.

        x and y are the states at a = `first` and b = `last`; the form is over x, then y. It is
        computed over the deviations of x and y from their filtered means, so that numbers are
        small, and then moved to the origin.
        """
        whole = _composed(self._leaves(first, last))
        precision, h, g = (part[0] for part in canonical.from_affine(*whole[:3]))
        # The right end comes first in the form of a conditional.
        size = self.graph.layout.state_size
        order = np.roll(np.arange(2 * size), size)
        precision, h = block(precision, order, order), h[..., order]
        precision[..., :size, :size] += whole.K[0]
        h[..., :size] += whole.h[0]
        assert whole.g is not None
        places = self.graph.layout.state_places
        ends = [self._forward.mean[step][..., places] for step in (first, last)]
        return canonical.shift(precision, h, g + whole.g[0], np.concatenate(ends, axis=-1))

    def _leaves(self, first: int, last: int) -> Element:
        """The single steps `first` + 1 to `last` as segments, a row for each.

        The row of step t is p(x[t], measurements at t | x[t − 1]), x being the states less their
        filtered means: an affine conditional of x[t] and a likelihood over x[t − 1].
        """
        conditionals = transition(self._plan)
        size, runs = self.graph.layout.state_size, self._plan.runs
        nothing = np.zeros((runs, size, size)), np.zeros((runs, size)), np.zeros(runs)
        rows = []
        for later in range(first + 1, last + 1):
            conditional, likelihood = absorbed(self._plan, self._forward, conditionals, later)
            rows.append((*conditional, *(likelihood or nothing)))
        return Element(*(np.stack(parts) for parts in zip(*rows, strict=True)))


def _composed(segments: Element) -> Element:
    """The S successive segments (S, ...) composed to one, (1, ...), in log₂ S rounds.

    Segments are given by the affine conditional of the states at their end given those at their
    beginning, and a likelihood over the latter.
    """
    while (count := segments.F.shape[0]) > 1:
        even = count - count % 2
        pairs = compose(take(segments, slice(0, even, 2)), take(segments, slice(1, even, 2)))
        rest = take(segments, slice(even, None))
        both = zip(pairs, rest, strict=True)
        segments = Element(*(np.concatenate([a, b]) for a, b in both if a is not None))
    return segments


def _side_by_side(left: Canonical, right: Canonical) -> Canonical:
    """The product of two canonical forms, over the variables of the first and then the second.

    Each form is K (..., m, m), h (..., m) and g (...), over variables of its own; the product has
    2m components.
    """
    size = left[1].shape[-1]
    precision = np.zeros((*left[1].shape[:-1], 2 * size, 2 * size))
    precision[..., :size, :size], precision[..., size:, size:] = left[0], right[0]
    return precision, np.concatenate([left[1], right[1]], axis=-1), left[2] + right[2]
