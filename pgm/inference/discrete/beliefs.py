"""The beliefs of a discrete graph: its tables after a schedule of messages."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable

import numpy as np

from pgm.evidence.discrete import BoundStates
from pgm.factors import Table
from pgm.factors.axes import States, sizes
from pgm.inference.discrete.storage import Storage
from pgm.kernels.arrays import Array, frozen
from pgm.variables import Discrete


class Beliefs(ABC):
    """The beliefs of all clusters as probabilities.

    Attributes
    ----------
    storage : Storage
    evidence : BoundStates
    """

    storage: Storage
    evidence: BoundStates

    @abstractmethod
    def marginal(self, variable: Discrete) -> Array:
        """The probabilities of a variable, (states, [runs])."""

    @abstractmethod
    def read(self, reader: Callable[[Array], Array]) -> Array:
        """The result of a function of the tables, whose last axis, if any, is of runs."""

    @abstractmethod
    def joint(self, scope: States) -> Array:
        """The probabilities of variables that no one cluster holds, (sizes..., [runs])."""

    @abstractmethod
    def log_evidence(self) -> Array:
        """The value ln p(evidence), ([runs])."""

    @abstractmethod
    def log_total(self, cluster: int) -> Array:
        """The logarithm of the sum of a cluster's unnormalised belief, ([runs])."""

    @abstractmethod
    def message(self, source: int, target: int) -> Table:
        """The message from one cluster to a neighbour."""

    def table(self, scope: States, values: Array, log_scale: Array | None = None) -> Table:
        """Values (sizes..., [runs]) as a table whose leading axes are those of the runs."""
        lead = self.evidence.lead
        if values.ndim > len(scope):
            values = np.moveaxis(values, -1, 0)
        if lead or values.ndim > len(scope):
            values = values.reshape((*lead, *sizes(scope)))
        if log_scale is None:
            return Table._plain(scope, frozen(values) if values.flags.writeable else values)
        return Table._make(scope, values, log_scale.reshape(lead))
