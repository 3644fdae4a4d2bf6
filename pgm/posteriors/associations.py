"""Data association: which candidate each sighting was taken for.

A *sighting* is one measurement of a sensor; there may be several at a step. An *open* sighting is
one whose sensor has a parent that the evidence leaves unknown (`pgm.unknown`). It is of one of k
candidates, which are values (k, d) of that parent, or of none of them: *spurious*, or of a *new*
thing. Probabilities (..., k + 2) are in that order. A `Reading` has all sightings of one sensor,
sorted by step, with the sensor's CPD.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType

import numpy as np

from pgm.cpds.mixture import UnidentifiedCPD
from pgm.display import Listing, Shown, Summary, number, places, whereabouts
from pgm.errors import EvidenceError
from pgm.evidence import BoundEvidence, Reading, Unknown
from pgm.evidence.values import JOINT, UnknownVariable, variables_left_open
from pgm.immutable import Immutable
from pgm.kernels import association
from pgm.kernels.arrays import Array, Integers, Mask
from pgm.variables import Variable

# Values of `candidate` for a sighting of none.
SPURIOUS, NEW = -1, -2


def as_candidate(probability: Array) -> Integers:
    """The index of the likeliest of probabilities (..., k + 2), as of `Associations`."""
    likeliest, count = association.likeliest(probability), probability.shape[-1] - 2
    found = np.where(likeliest < count, likeliest, count - 1 - likeliest)
    return np.where(np.isnan(probability).any(axis=-1), SPURIOUS, found)


class Associations(Shown, Immutable):
    """The associations of one sensor's sightings, in the order of the evidence.

    Attributes
    ----------
    step : ndarray of int
        (M,): the steps of the sightings.
    probability : ndarray
        (..., M, k + 2): the probability of each of k candidates, of a spurious sighting and of a
        new thing, given all measurements that the belief knows; with mixtures of Gaussians, given
        those up to the sighting's step; with other Gaussian beliefs, given only the sighting itself
        and the measurements taken in before it. Leading axes are runs. NaN
        where nothing was measured.
    candidate : ndarray of int
        (..., M): the index of the likeliest candidate, 0 to k − 1; −1 spurious, −2 new. −1 too
        where nothing was measured, and where all candidates were beyond the gate and nothing was
        declared spurious or new.
    outliers : float
        The prior probability, as `pgm.unknown` declares it, that a sighting is spurious or new.

    Examples
    --------
    >>> x, m, z = pgm.variables("x m z")
    >>> model = pgm.DynamicBayesianNetwork(
    ...     prior=[pgm.GaussianCPD(x, 0.0, 1.0)],
    ...     transition=[pgm.LinearGaussianCPD(x, given={x.previous: 1.0}, cov=1.0)],
    ...     observation=[pgm.LinearGaussianCPD(z, given={m: 1.0, x: -1.0}, cov=1.0)],
    ... )
    >>> seen = pgm.sightings([[2.0]], step=[1], given={m: pgm.unknown([[2.0], [20.0]])})
    >>> found = pgm.filter(model, {z: seen}, steps=1).associations[z]
    >>> found.candidate
    array([0])
    >>> found.probability.round(3)
    array([[1., 0., 0., 0.]])
    """

    step: Integers
    probability: Array
    candidate: Integers
    outliers: float

    def __init__(self, step: Integers, probability: Array, outliers: float = 0.0) -> None:
        candidate = as_candidate(probability)
        for array in (step, probability, candidate):
            array.flags.writeable = False
        self._set(step=step, probability=probability, candidate=candidate, outliers=outliers)

    @property
    def measured(self) -> Mask:
        """The mask (..., M) of sightings that have at least one measured component."""
        return np.asarray(~np.isnan(self.probability).any(axis=-1))

    def judged(self, *, gated: bool) -> tuple[Mask, Mask]:
        """The masks (M, runs) of strange and of judged sightings, for the test of a lost belief.

        A belief is lost if it is wrong by more than its covariance says. A measured sighting is
        *strange* if it was taken for no candidate. The test compares the number of strange
        sightings with that of *judged* ones. All measured sightings of a sensor without a gate are
        judged. Of a sensor with a gate (`gated`) only the strange ones are marked as judged, since
        the gate's own record counts all others.
        """
        shape = math.prod(self.measured.shape[:-1]), len(self.step)
        measured = self.measured.reshape(shape).T
        strange = measured & (self.candidate < 0).reshape(shape).T
        return strange, strange if gated else measured

    @property
    def _title(self) -> str:
        each, count = self.candidate, self.probability.shape[-1] - 2
        return (
            f"Associations({each.size:,} sightings: {int((each >= 0).sum()):,} of {count:,} "
            f"candidates, {int((each == SPURIOUS).sum()):,} spurious, "
            f"{int((each == NEW).sum()):,} new)"
        )

    def _summary(self) -> Summary:
        names = {SPURIOUS: "spurious", NEW: "new"}
        heads, where = whereabouts(self.candidate.shape, self.step)
        rows: list[Sequence[str] | None] = []
        for place in places(self.candidate.shape):
            if place is None:
                rows.append(None)
                continue
            likeliest, chances = int(self.candidate[place]), self.probability[place]
            if np.isnan(chances).any():
                rows.append([*where(place), "not measured", ""])
                continue
            chance = float(chances[likeliest if likeliest >= 0 else len(chances) - 1 + likeliest])
            rows.append([*where(place), names.get(likeliest, str(likeliest)), number(chance, 3)])
        heads = [*heads, "candidate", "probability"]
        return Summary(self._title, [Listing(heads, rows, names=len(heads) - 1)] if rows else [])


# By sensor, the associations that a call has found.
Found = Mapping[Variable, Associations]
NONE: Found = MappingProxyType({})


def is_open(bound: BoundEvidence) -> bool:
    """Whether some sightings are open: they leave a parent of their sensor unknown."""
    return any(reading.unknown is not None for reading in bound.readings)


def is_summed(bound: BoundEvidence) -> bool:
    """Whether sightings are open among hidden variables, or are to be summed over candidates."""
    every = [reading.unknown[1] for reading in bound.readings if reading.unknown is not None]
    return any(isinstance(own, UnknownVariable) or own.is_summed for own in every)


def by_density(bound: BoundEvidence) -> BoundEvidence:
    """The same evidence; each sensor with open sightings has a mixture over candidates as its CPD.

    It is for grids and particles, which evaluate densities. Sightings that are to be associated
    all together (``association="joint"``) raise an `EvidenceError`: only Gaussian beliefs do that.
    """

    def closed(reading: Reading) -> Reading:
        if reading.unknown is None:
            return reading
        if isinstance(reading.unknown[1], UnknownVariable):
            what = f"sightings of {reading.cpd.child!r}"
            raise variables_left_open(*reading.unknown, what, cpd=reading.cpd)
        if reading.unknown[1].association == JOINT:
            raise EvidenceError(
                f"sightings of {reading.cpd.child!r} leave {reading.unknown[0]!r} open, to be "
                'associated together: that is for Gaussian beliefs; give association="likelihood" '
                'or "sum"',
                variable=reading.unknown[0],
                cpd=reading.cpd,
            )
        return replace(reading, cpd=unidentified(reading, *reading.unknown), unknown=None)

    return replace(bound, readings=tuple(closed(reading) for reading in bound.readings))


def unidentified(reading: Reading, parent: Variable, unknown: Unknown) -> UnidentifiedCPD:
    """The CPD of a sensor's open sightings: a mixture over the candidates for a parent.

    `reading` has the sensor's own CPD, `parent` is the parent whose value the evidence leaves open,
    and `unknown` has the candidates with their prior probabilities.
    """
    return UnidentifiedCPD(
        reading.cpd,
        parent,
        unknown.candidates,
        unknown.log_shares[:-2],
        unknown.log_outliers,
        unknown.gate,
        unknown.is_summed,
    )


def collected(
    reading: Reading, rows: Iterable[Array], candidates: int, lead: tuple[int, ...]
) -> tuple[Variable, Associations]:
    """The sensor of a reading, and its `Associations` in the order of the user's evidence.

    `candidates` is the number k. `rows` yields the probabilities (runs, k + 2) of one sighting
    after another, in the order of `reading`. In the result the axis of runs has become the user's
    axes of runs, whose shape is `lead`.
    """
    ordered = np.empty((int(np.prod(lead)), len(reading.step), candidates + 2))
    for place, row in zip(reading.order.tolist(), rows, strict=True):
        ordered[:, place] = row
    step = np.empty_like(reading.step)
    step[reading.order] = reading.step
    if reading.unknown is not None:
        known = reading.unknown[1].log_shares[:-2]
    else:  # in its density
        assert isinstance(reading.cpd, UnidentifiedCPD)
        known = reading.cpd.log_shares
    outliers = max(1.0 - float(np.exp(known).sum()), 0.0)
    found = Associations(step, ordered.reshape(*lead, *ordered.shape[1:]), outliers)
    return reading.cpd.child, found
