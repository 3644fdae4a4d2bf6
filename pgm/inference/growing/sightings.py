r"""Open sightings of a growing map: each is one of some candidates, by the belief of the map.

The slice is (p, m_1, ..., m_k): the variables p of the map that the sensors are given beside the
open parent, poses as a rule, and the candidates for that parent. Innovations, gates and decisions
are as of `pgm.kernels.association`, a sensor being linearised at the means of p and of each
candidate. With candidate j a sensor depends on (p, m_j) alone, so that S_j takes the joint
covariance of these; a joint decision takes that of p and all candidates that are in question.
"""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from pgm.errors import EvidenceError, NumericalError
from pgm.evidence import UnknownVariable
from pgm.evidence.values import JOINT
from pgm.factors.scope import Scope, listed
from pgm.inference.growing.association import Association
from pgm.inference.growing.covariances import Covariances
from pgm.inference.growing.factors import Given, Known, Plates, innovations, measured, noises
from pgm.inference.growing.means import Means
from pgm.kernels import association, joint_compatibility, moments
from pgm.kernels.arrays import Array, Mask, independent
from pgm.linearisers import Lineariser
from pgm.variables import Variable


@dataclass(frozen=True)
class OpenSightings:
    """The sightings, CPDs with readings, of an addition that leave one parent open.

    Attributes
    ----------
    parent, unknown
        The open parent, and its candidates.
    given : sequence of Given
        The sightings, each with the parent among its hidden ones.
    taken : mapping of Variable to mask
        By sighting the components that were measured, where it is not all, (d,).
    numbers : mapping of Variable to int
        The numbers of the map's variables.
    means, covariances
        Those of the map.
    """

    parent: Variable
    unknown: UnknownVariable
    given: Sequence[Given]
    taken: Mapping[Variable, Mask | None]
    numbers: Mapping[Variable, int]
    means: Means
    covariances: Covariances

    def associated(
        self, known: Known, plates: Plates, lineariser: Lineariser
    ) -> dict[Variable, Association]:
        """By sighting, the candidate that it is taken for.

        A NumericalError refuses an S that is not positive definite, an EvidenceError a joint choice
        among too many hypotheses.
        """
        unknown = self.unknown
        pairs, seen = self._pairs(known, plates, lineariser)
        terms = association.terms(
            pairs, unknown.log_shares[:-2], unknown.log_outliers, unknown.gate
        )
        if unknown.association == JOINT:
            terms = self._jointly(pairs, terms)
        some = np.asarray(seen.any(axis=-1))
        probability = association.probabilities(terms, some[:, None])[:, 0]
        return {
            each.cpd.child: Association(unknown.candidates, own)
            for each, own in zip(self.given, probability, strict=True)
        }

    @cached_property
    def beside(self) -> Scope:
        """The variables p that the sensors are given beside the open parent."""
        every = dict.fromkeys(v for each in self.given for v in each.parents)
        return tuple(v for v in every if v != self.parent)

    @cached_property
    def _places(self) -> dict[Variable, range]:
        """The columns of p, and then of the open parent."""
        found, column = {}, 0
        for variable in (*self.beside, self.parent):
            found[variable] = range(column, column + variable.dimension)
            column += variable.dimension
        return found

    def _numbers(self, variables: Sequence[Variable]) -> list[int]:
        return [self.numbers[variable] for variable in variables]

    def _pairs(
        self, known: Known, plates: Plates, lineariser: Lineariser
    ) -> tuple[association.Pairs, Mask]:
        """Each sighting with each candidate, over (p, m_j), and the components measured.

        Sightings of fewer components than others have some more that were not measured.
        """
        count, every = len(self.unknown.candidates), len(self.given)
        height, width = max(each.cpd.child.dimension for each in self.given), self._width
        matrix = np.zeros((every, 1, count, height, width))
        residual = np.zeros((every, 1, count, height))
        noise = np.zeros((every, height, height))
        seen = np.zeros((every, height), dtype=bool)
        alike: dict[Hashable, list[int]] = {}
        for k, each in enumerate(self.given):
            alike.setdefault((each.key, each.parents.index(self.parent)), []).append(k)
        for rows in alike.values():
            own = [self.given[k] for k in rows]
            size = own[0].cpd.child.dimension
            left, slope = self._innovations(own, known, plates, lineariser)
            residual[rows, 0, :, :size] = left
            for k, each, steep in zip(rows, own, slope, strict=True):
                columns = [c for v in each.parents for c in self._places[v]]
                matrix[k, 0, :, :size, columns] = steep.transpose(2, 0, 1)
            noise[rows, :size, :size] = noises(own, known)
            masks = [self.taken.get(each.cpd.child) for each in own]
            seen[rows, :size] = measured(own, masks)
        matrix *= seen[:, None, None, :, None]
        residual *= seen[:, None, None]
        alone = independent(noise, seen)[:, None, None]
        wide = np.broadcast_to(alone, (every, 1, count, height, height))
        spread = moments.predict(self._spreads[None, None], matrix, wide)
        size_of = np.broadcast_to(seen.sum(axis=-1)[:, None, None], (every, 1, count))
        with np.errstate(all="ignore"):  # squares that overflow are refused
            pairs = association.paired(matrix, residual, wide, spread, size_of)
        self._require(
            np.asarray((pairs.share > 0.0).all(axis=(1, 2))),
            "an innovation has no variance in a component, or two that are one, so that candidates "
            "cannot be compared; give the sensor some noise",
        )
        unknown = self.unknown
        if unknown.gate is None and np.isneginf(unknown.log_outliers).all():
            self._require(
                np.asarray(np.isfinite(pairs.square).any(axis=(1, 2))),
                "its reading is more than 1e150 deviations from all candidates, whose densities "
                "float64 cannot hold; check the reading, or give pgm.unknown a gate",
            )
        return pairs, seen

    def _require(self, fits: Mask, why: str) -> None:
        """Refuse the first sighting that does not fit, (sightings,), by a NumericalError."""
        if not fits.all():
            cpd = self.given[int(np.argmin(fits))].cpd
            raise NumericalError(f"{cpd!r}: {why}", variable=cpd.child, cpd=cpd)

    @property
    def _width(self) -> int:
        """The number of components of p and of the open parent."""
        return self._places[self.parent].stop

    @cached_property
    def _candidates(self) -> list[int]:
        return self._numbers(self.unknown.candidates)

    @cached_property
    def _spreads(self) -> Array:
        """The covariances of (p, m_j), (k, n, n)."""
        start, width = self._places[self.parent].start, self._width
        beside = self._numbers(self.beside)
        found = np.empty((len(self._candidates), width, width))
        across = self.covariances.across([*beside, *self._candidates], beside)
        own = across[:start]
        found[:, :start, :start] = 0.5 * (own + own.T)
        cross = across[start:].reshape(len(found), width - start, start)
        found[:, start:, :start], found[:, :start, start:] = cross, cross.transpose(0, 2, 1)
        found[:, start:, start:] = [self.covariances.of(j) for j in self._candidates]
        return found

    def _innovations(
        self, given: Sequence[Given], known: Known, plates: Plates, lineariser: Lineariser
    ) -> tuple[Array, Array]:
        """The ν (rows, k, d) of sightings of one key, and slopes by all parents (rows, k, d, n)."""
        count = len(self._candidates)
        means = np.array(self.means.some(self._candidates))
        parts: list[Array] = []
        for column in zip(*(each.parents for each in given), strict=True):
            if column[0] == self.parent:
                parts.append(np.tile(means, (len(given), 1)))
            else:
                here = np.array(self.means.some(self._numbers(column)))
                parts.append(np.repeat(here, count, axis=0))
        rows = [each for each in given for _ in range(count)]
        at = np.concatenate(parts, axis=1)
        left, slope = innovations(rows, at, known, plates, lineariser)
        shape = len(given), count
        return left.reshape(*shape, -1), slope.reshape(*shape, *slope.shape[1:])

    def _jointly(self, pairs: association.Pairs, terms: Array) -> Array:
        """Decide about all sightings together, by the candidates that are in question for any."""
        unknown, start = self.unknown, self._places[self.parent].start
        assert unknown.gate is not None
        some = np.flatnonzero(np.isfinite(terms[..., :-2]).any(axis=(0, 1)))
        some = some if some.size else np.zeros(1, dtype=np.intp)
        asked = np.concatenate([some, len(self._candidates) + np.arange(2)])
        few = pairs.of(some)
        few = few._replace(matrix=_spread_out(few.matrix, start))
        numbers = self._numbers([*self.beside, *(unknown.candidates[j] for j in some)])
        cov = self.covariances.joint(numbers)[None]
        weight = unknown.log_shares[some]
        decided = np.full(terms.shape, -np.inf)
        try:
            decided[..., asked] = association.jointly(
                few, terms[..., asked], cov, weight, unknown.gate
            )
        except joint_compatibility.TooManyError:
            raise EvidenceError(
                f"{len(self.given)} sightings ({listed(each.cpd.child for each in self.given)}) "
                f"that leave {self.parent!r} open fit {unknown!r} in more than "
                f"{joint_compatibility.NODES:,} ways: give a narrower gate, a surer belief, or "
                'fewer candidates; association="likelihood" decides about each by itself',
                variable=self.parent,
            ) from None
        return decided


def _spread_out(matrix: Array, start: int) -> Array:
    """Slopes (..., k, d, n) over p, of `start` components, and m_j, over p and all k candidates."""
    *lead, count, height, width = matrix.shape
    size = width - start
    found = np.zeros((*lead, count, height, start + count * size))
    found[..., :start] = matrix[..., :start]
    for j in range(count):
        place = start + j * size
        found[..., j, :, place : place + size] = matrix[..., j, :, start:]
    return found
