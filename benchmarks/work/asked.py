"""Questions to static Gaussian networks: means and covariances of some of their variables."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
import numpy.typing as npt

import pgm

Array = npt.NDArray[np.float64]
Integers = npt.NDArray[np.intp]
Beliefs = tuple[Array, Array | None]  # means and covariances of variables of one kind


@dataclass(frozen=True, eq=False)
class Asked:
    """A declared network, what is known of it, and whose marginals are asked for.

    Attributes
    ----------
    network : MarkovNetwork
    evidence : mapping of Variable
    kinds : tuple
        Variables of as many components each.
    start : mapping of Variable
        Where CPDs are linearised first; none of a linear network.
    """

    network: pgm.MarkovNetwork
    evidence: Mapping[pgm.Variable, Array | float]
    kinds: tuple[tuple[pgm.Variable, ...], ...]
    start: Mapping[pgm.Variable, Array] = field(default_factory=dict)


class Work(Protocol):
    """Numbers of which a network can be declared."""

    @property
    def units(self) -> int:
        """How many poses, or variables of a field, it is of."""
        ...

    def asked(self) -> Asked:
        """Declare the network."""
        ...
