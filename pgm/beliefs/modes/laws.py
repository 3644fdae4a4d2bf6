"""Laws of modes: Gaussians of all hidden variables, from which values are drawn and weighed.

The *law* of a mode is a Gaussian of all hidden variables: of the states at step 0, then of each
slice given the states before; a network without time is one slice. The *pair* of a step is the
vector of the m states of the step before, then of the slice's n components; T is the last step.
Arrays have the K modes first, then steps, then the runs.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple, Protocol

import numpy as np

from pgm.beliefs.moments.trajectories.density import Peak
from pgm.beliefs.moments.trajectories.model import ChainModel, Proposing, Weighed
from pgm.beliefs.moments.trajectories.proposal import Path
from pgm.errors import NumericalError
from pgm.kernels.arrays import Array, Index, Integers, Mask


class Laws(NamedTuple):
    """The laws of K modes by their moments.

    A network without time is a single slice of states, step 0.

    weights: (K, runs), of sum one; 0 of a mode that a run does not have.
    first, spread: The means (K, 1, runs, m) and covariances of the states at step 0.
    mean, cov: Those of the pairs at steps 1 to T, (K, T, runs, m + n).
    """

    weights: Array
    first: Array
    spread: Array
    mean: Array
    cov: Array

    def of(self, runs: Integers) -> Laws:
        """The laws of some runs."""
        return Laws(self.weights[:, runs], *(each[:, :, runs] for each in self[1:]))

    def put(self, runs: Integers, other: Laws) -> Laws:
        """The laws with those of some runs replaced by others, of no more modes than these."""
        wide = other.padded(len(self.weights))
        weights = self.weights.copy()
        weights[:, runs] = wide.weights
        found = [weights]
        for own, new in zip(self[1:], wide[1:], strict=True):
            copied = own.copy()
            copied[:, :, runs] = new
            found.append(copied)
        return Laws(*found)

    def padded(self, count: int) -> Laws:
        """The laws with so many modes, those beyond K of weight 0."""
        more = count - len(self.weights)
        if not more:
            return self
        none = np.zeros((more, self.weights.shape[1]))
        rest = (np.concatenate([each, np.repeat(each[:1], more, axis=0)]) for each in self[1:])
        return Laws(np.concatenate([self.weights, none]), *rest)


class Scoped(NamedTuple):
    """The places of a variable in pairs: `places` (d,), and the first step that has it.

    Step 0 has the states alone: `start` (d,) are places among these.
    """

    places: Integers
    start: Integers
    first: int


class Target(Protocol):
    """The posterior that draws are weighed by, of variables in slices.

    Attributes
    ----------
    before : int
        m, the number of components of the states before a slice.
    states : slice or ndarray of int
        The places of the states in a slice.
    turned : ndarray of bool
        (n,): the components of a slice that are angles of nonlinear motions.
    angles : ndarray of bool
        (m + n,): the angles of the states before and a slice.
    scopes : sequence of Scoped
        Where each hidden variable stands.
    """

    before: int
    states: Index
    turned: Mask
    angles: Mask

    @property
    def scopes(self) -> Sequence[Scoped]:
        """Where each hidden variable stands."""
        ...

    def path(self, laws: Laws, k: int) -> Path:
        """The law of a mode, as it is drawn from."""
        ...

    @property
    def chain(self) -> ChainModel | None:
        """The densities of a chain whose components all have noise; None of any other model."""
        ...

    @property
    def peak(self) -> Peak | None:
        """The peak of the density; None where it does not tell whether measurements fit."""
        ...

    def draw(self, source: Proposing, shape: tuple[int, int]) -> Weighed:
        """Draws that a source proposes, (runs, S), NaN where a function has no value."""
        ...


def without_density() -> NumericalError:
    """The error for a posterior that has no density."""
    return NumericalError(
        "draws are weighed by the density of all hidden variables, and these have none: a noise "
        "is zero, or as good as zero beside other variances, as of an exact sensor that was read; "
        "give it a size, or ask for no draws"
    )
