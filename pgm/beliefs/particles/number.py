"""How many particles a run has: as many as their spread, or the measurements, ask for.

`KLDSampling` counts the bins that the particles occupy; `LikelihoodSampling` sums the particles'
likelihoods.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np

from pgm.arguments import public
from pgm.boundary import is_number, is_whole
from pgm.display import InCode
from pgm.errors import ModelError
from pgm.factors.scope import listed
from pgm.immutable import Immutable
from pgm.kernels.arrays import Array, Integers
from pgm.kernels.bins import keys, occupied
from pgm.kernels.kld_sampling import draws_needed

if TYPE_CHECKING:
    from pgm.beliefs.points.laws import States
    from pgm.beliefs.points.model import ParticleModel


@public
class KLDSampling(InCode, Immutable):
    r"""A number of particles that bounds the KL divergence from the belief they are drawn from.

    Particles are drawn anew, in batches that double their number n, until it is enough for the k
    bins that they occupy,

    .. math:: n \ge \frac{q_{1-δ}(k)}{2 ε}

    - ε: the largest divergence KL(drawn ‖ belief) over the bins, in nats;
    - δ: the probability that the divergence is larger all the same;
    - q_{1−δ}(k): a bound below which 2 n KL(drawn ‖ belief) stays with the probability 1 − δ,
      whatever the distribution over the k bins is.

    Parameters
    ----------
    widths : mapping of str to float
        The widths of bins, by component of the states, in its units; that of an angle is changed so
        that a whole number of bins makes a turn. Components that are not named are not divided into
        bins. A component is called by its name; where states share it, as ``"x.east"``.
    epsilon, delta : float
        ε, more than 0, and δ, between 0 and 1.
    least, most : int
        Bounds of the number of particles of a run; where the most is reached, the divergence may be
        larger than ε.

    Raises
    ------
    ModelError
        If an argument is out of its range; in a filter, if a name is that of no component.

    References
    ----------
    Fox, Adapting the sample size in particle filters through KLD-sampling, 2003.

    Examples
    --------
    >>> KLDSampling({"east": 0.5, "north": 0.5, "heading": 0.2})
    KLDSampling(east 0.5, north 0.5, heading 0.2; epsilon 0.05, delta 0.01, 100 to 100,000)
    """

    widths: Mapping[str, float]
    epsilon: float
    delta: float
    least: int
    most: int

    def __init__(
        self,
        widths: Mapping[str, float],
        *,
        epsilon: float = 0.05,
        delta: float = 0.01,
        least: int = 100,
        most: int = 100_000,
    ) -> None:
        if not isinstance(widths, Mapping) or not widths:
            raise ModelError(
                f'KLDSampling maps components to the widths of bins, {{"east": 0.5}}; found '
                f"{widths!r}"
            )
        for name, width in widths.items():
            if not isinstance(name, str) or not is_number(width) or not 0.0 < width < np.inf:
                raise ModelError(
                    f"KLDSampling: the width of bins of {name!r} is a positive number, by the name "
                    f"of a component, not {width!r}"
                )
        if not is_number(epsilon) or not 0.0 < epsilon < np.inf:
            raise ModelError(f"KLDSampling: epsilon is a positive number, not {epsilon!r}")
        if not is_number(delta) or not 0.0 < delta < 1.0:
            raise ModelError(f"KLDSampling: delta is a probability between 0 and 1, not {delta!r}")
        if not is_whole(least) or not is_whole(most) or not 1 <= least <= most < 2**63:
            raise ModelError(
                f"KLDSampling: least and most are whole numbers, 1 <= least <= most, not {least!r} "
                f"and {most!r}"
            )
        self._set(
            widths=MappingProxyType({name: float(width) for name, width in widths.items()}),
            epsilon=float(epsilon),
            delta=float(delta),
            least=int(least),
            most=int(most),
        )

    def drawn(
        self, states: States, model: ParticleModel, draw: Callable[[int], Integers]
    ) -> Integers:
        """The places of resampled particles, drawn until they are enough for the bins they occupy.

        `states` (d, n) are the n particles to draw from, with the d components of a state. The
        function `draw`, of a count, draws so many of the places 0 to n − 1 by the particles'
        weights, (count,). A particle so far from zero that its bin has no number is refused by a
        ModelError.
        """
        rows, widths = self._rows(model)
        bins = keys(np.asarray(states[rows], dtype=np.float64), widths, model.angles[rows])
        if bins is None:
            raise ModelError(
                f"{self!r}: a particle is so far from zero that its bin has no number; take wider "
                "bins, or count coordinates from a nearer origin"
            )
        found = draw(self.least)
        while True:
            needed = draws_needed(occupied(bins[:, found]), self.epsilon, self.delta)
            due = min(max(needed, self.least), self.most) - len(found)
            if due <= 0:
                return found
            found = np.concatenate([found, draw(min(due, len(found)))])

    def _rows(self, model: ParticleModel) -> tuple[list[int], Array]:
        """The rows of the components that are divided into bins, and the widths of their bins.

        The rows are those in the model's arrays of states, (d, particles). A name in `widths` that
        is no component's is refused by a ModelError.
        """
        parts = model.parts
        labels = [part.label for part in parts]
        for name in self.widths:
            if name not in labels:
                raise ModelError(
                    f"{self!r}: {name!r} is no component of the states; those are {listed(labels)}"
                )
        chosen = [part for part in parts if part.label in self.widths]
        widths = np.array([self.widths[part.label] for part in chosen])
        return [part.row for part in chosen], widths

    def __eq__(self, other: object) -> bool:
        return isinstance(other, KLDSampling) and self._key() == other._key()

    def __hash__(self) -> int:
        return hash(self._key())

    def _key(self) -> tuple[Any, ...]:
        """The values of all attributes, by which two objects are compared and hashed."""
        return (tuple(self.widths.items()), self.epsilon, self.delta, self.least, self.most)

    def __repr__(self) -> str:
        each = ", ".join(f"{name} {width:g}" for name, width in self.widths.items())
        return (
            f"KLDSampling({each}; epsilon {self.epsilon:g}, delta {self.delta:g}, "
            f"{self.least:,} to {self.most:,})"
        )


@public
class LikelihoodSampling(InCode, Immutable):
    r"""A number of particles whose likelihoods of a step's measurements sum to a threshold.

    Particles are drawn and moved, in batches that double their number, until

    .. math:: \sum_i \frac{p(z_t \mid x_t^i)}{\max_x p(z_t \mid x)} \ge L

    with particles x_t^i and measurements z_t of step t. Few are drawn if most of them explain the
    measurements well, and many if most explain them badly. The largest density is that of normal
    noise at zero residual, and that of a `LikelihoodField` where all beams end at obstacles; a
    filter refuses sensors of other densities by a ModelError. At steps without measurements the
    number stays.

    Parameters
    ----------
    total : float
        L, the number of particles that would be enough if each explained the measurements
        perfectly: some tens of them leave means that err by a tenth or two of a standard deviation.
    least, most : int
        Bounds of the number of particles of a run.

    Raises
    ------
    ModelError
        If an argument is out of its range.

    References
    ----------
    Koller & Fratkina, Using learning for approximation in stochastic processes, 1998; Fox, Adapting
    the sample size in particle filters through KLD-sampling, 2003, section 3.1.

    Examples
    --------
    >>> LikelihoodSampling(50)
    LikelihoodSampling(50; 100 to 100,000)
    """

    total: float
    least: int
    most: int

    def __init__(self, total: float, *, least: int = 100, most: int = 100_000) -> None:
        if not is_number(total) or not 0.0 < total < float("inf"):
            raise ModelError(f"LikelihoodSampling: total is a positive number, not {total!r}")
        if not is_whole(least) or not is_whole(most) or not 1 <= least <= most < 2**63:
            raise ModelError(
                f"LikelihoodSampling: least and most are whole numbers, 1 <= least <= most, not "
                f"{least!r} and {most!r}"
            )
        self._set(total=float(total), least=int(least), most=int(most))

    def more(self, count: int, found: float) -> int:
        """How many particles to draw next: 0 if `found` has reached the threshold L.

        Otherwise as many again as have been drawn, but no more than `most` in all.

        count: How many have been drawn.
        found: The sum of their likelihoods, as shares of the largest possible.
        """
        if found >= self.total:
            return 0
        return min(count, self.most - count)

    def __repr__(self) -> str:
        return f"LikelihoodSampling({self.total:g}; {self.least:,} to {self.most:,})"
