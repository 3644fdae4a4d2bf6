"""A CPD of one robot online: laid out once, with other values of its inputs at each step.

A law keeps nothing of a step, so threads may share it.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from pgm.cpds import AffineCPD, Noise
from pgm.cpds.noise import evaluate
from pgm.inference.chain.single_motion import Affinity
from pgm.inference.family import Family
from pgm.kernels.arrays import Array
from pgm.linearisers.single import Line
from pgm.linearisers.single_rules import prepare
from pgm.variables import Variable

# A step, and the rows that are given for it.
Now = tuple[int, list[Array]]


class Law:
    """A CPD; of a sensor, all its sightings of a step as one value.

    Parameters
    ----------
    family : Family
        The CPD as it is laid out for one step of one run.
    places : mapping of Variable to int
        Which of the rows that are given are those of a parent.
    count : int
        Sightings.
    grouped : bool
        Whether these are linearised as one.

    Attributes
    ----------
    full : bool
        Whether the noise is known to leave no component out.
    """

    def __init__(
        self,
        family: Family,
        places: Mapping[Variable, int],
        count: int = 1,
        *,
        grouped: bool = False,
    ) -> None:
        cpd, template = family.cpd, family.template
        self.family, self.cpd, self.count = family, cpd, count
        self.template, self.height = template, cpd.child.dimension
        self.places = {parent: places[parent] for parent in family.inputs}
        self.grouped = grouped
        self.lineariser = None
        if template is not None:
            self.given = [self.places.get(parent) for parent in template.given]
            self.lineariser = prepare(template, family.lineariser, self.given, joint=grouped)
        # The errors of sightings that are linearised each by itself are taken to be independent.
        self.within = None
        if count > 1 and not grouped:
            self.within = np.kron(np.eye(count), np.ones((self.height, self.height)))
        self.noise, self.full = None, False
        if not isinstance(cpd.cov, Noise):
            own = family.own_noise[0, 0]
            self.noise, self.full = np.kron(np.eye(count), own), bool((own.diagonal() > 0.0).all())
        self.constant = None
        if template is None and not any(parent in family.inputs for parent in cpd.given):
            self.constant = self._affine([])

    def conditional(self, at: Now, mean: Array, cov: Array) -> Affinity:
        """F, F μ + b and the noise at a belief over the hidden parents."""
        step, rows = at
        if self.lineariser is not None:
            try:
                matrix, value, error = self.lineariser.linearise(rows, self.count, step, mean, cov)
            except Exception:  # the general way tells what is wrong, if anything is
                matrix, value, error = self._generally(step, rows, mean, cov)
        elif self.template is not None:
            matrix, value, error = self._generally(step, rows, mean, cov)
        else:
            matrix, offset = self.constant or self._affine(rows)
            value, error = matrix.dot(mean) + offset, None
        noise = self._noise(step, rows) if self.noise is None else self.noise
        if error is not None:
            noise = noise + (error if self.within is None else error * self.within)
        return matrix, value, noise

    def _inputs(self, rows: list[Array]) -> dict[Variable, Array]:
        """Values of the parents with evidence, (count, 1, d)."""
        return {parent: rows[k].reshape(self.count, 1, -1) for parent, k in self.places.items()}

    def _affine(self, rows: list[Array]) -> tuple[Array, Array]:
        """F and b of an affine CPD."""
        assert isinstance(self.cpd, AffineCPD)
        matrix, offset = self.cpd._affine(self.family.hidden, self._inputs(rows) if rows else {})
        offset = np.broadcast_to(offset, (self.count, 1, self.height))
        return np.tile(matrix, (self.count, 1)), offset.reshape(-1)

    def _noise(self, step: int, rows: list[Array]) -> Array:
        """The CPD's own noise where it depends on inputs."""
        blocks = evaluate(self.cpd, self._inputs(rows), (self.count, 1), step)
        return _diagonal(blocks)

    def _generally(self, step: int, rows: list[Array], mean: Array, cov: Array) -> Line:
        """As any lineariser does it: with an axis of runs and, of several sightings, of rows."""
        template, count = self.template, self.count
        assert template is not None
        lead: tuple[int, ...] = (1,) if count == 1 else (count, 1)
        own: tuple[int, ...] = ()
        if self.grouped:
            lead, own = (1, 1), (count,)
        known = tuple(None if k is None else rows[k].reshape(*lead, *own, -1) for k in self.given)
        function = self.family.function(known, len(lead), step, own[0] if own else None)
        at, spread = (np.broadcast_to(each, (*lead, *each.shape)) for each in (mean, cov))
        found = self.family.call(function, at, spread)
        height, width = self.height * (count if self.grouped else 1), mean.size
        matrix = np.broadcast_to(found.F, (*lead, height, width)).reshape(
            count * self.height, width
        )
        offset = np.broadcast_to(found.b, (*lead, height)).reshape(-1)
        value = matrix.dot(mean) + offset
        if found.cov is None:
            return matrix, value, None
        return matrix, value, _diagonal(np.broadcast_to(found.cov, (*lead, height, height)))


def _diagonal(blocks: Array) -> Array:
    """The blocks (..., d, d) along the diagonal of one matrix."""
    size = blocks.shape[-1]
    blocks = blocks.reshape(-1, size, size)
    count = len(blocks)
    each = np.arange(count)
    joint = np.zeros((count, size, count, size))
    joint[each, :, each] = blocks
    return joint.reshape(count * size, count * size)
