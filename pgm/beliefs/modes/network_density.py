"""The log-density of a network without time at values of all its hidden variables.

A component is *free* if it has noise given its parents; any other component is a function of its
parents and the free ones. A *relative* density is that of the CPDs divided by that of the
linearised CPDs. S or C is the number of draws of a run, n that of the components of all hidden
variables.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from pgm.beliefs.gaussian.model import Model
from pgm.beliefs.moments.trajectories.density import Afresh, Term
from pgm.kernels.arrays import Array, Mask


class Weighed(NamedTuple):
    """Values of the hidden variables at draws, and their log-densities.

    values: The values x, (runs, S, n).
    log_density: ln p(x, z) with the evidence z, (runs, S); NaN where a function of the model is NaN
        or infinite.
    log_tails: The log-density of the hidden variables alone, without the evidence, and with
        Student's t for the noise of their CPDs, (runs, S).
    """

    values: Array
    log_density: Array
    log_tails: Array


@dataclass(frozen=True, eq=False)
class NetworkDensity:
    """The product of all CPDs of a network with its evidence, over the hidden variables.

    model : Model
        The linearised network with its evidence.
    terms : list of Term
        The densities of the CPDs. Copies of one CPD share a term if the same of their parents are
        hidden.
    """

    model: Model
    terms: list[Term]

    @classmethod
    def make(cls, model: Model, *, relative: bool, near: bool = True) -> NetworkDensity:
        """The density of a network; `relative` and `near` are as of its CPDs' `Term`."""
        every = zip(model.families, model.taken, strict=True)
        terms = [Term.make(f, relative=relative, near=near, taken=taken) for f, taken in every]
        return cls(model, terms)

    def free(self, shape: tuple[int, int]) -> Mask:
        """The mask of free components, (1, runs, n); `shape` is (runs, n)."""
        free = np.zeros((1, *shape), dtype=bool)
        for group, term in zip(self.model.layout.groups, self.terms, strict=True):
            mask = term.free()
            for row, child in enumerate(() if group.observed else group.child):
                free[0][:, child] = mask[row if mask.shape[0] > 1 else 0]
        return free

    def at(self, values: Array, afresh: Afresh | None = None, *, strict: bool) -> Weighed:
        """The log-densities at `values` (runs, S, n) of the hidden variables, and the values used.

        Components that are not free are computed from the others. The array `values` is not
        changed.

        afresh: Marks draws for which the CPDs make new values, with Student's t for their noise,
            parents before children; None marks none.
        strict: Whether a function that is NaN or infinite raises a LinearisationError.
        """
        model, values = self.model, values.copy()
        total, tails = np.zeros(values.shape[:2]), np.zeros(values.shape[:2])
        for g, row in model.layout.order:
            group, term = model.layout.groups[g], self.terms[g]
            parents = values[..., group.parents[row]]
            if group.observed:
                given, moved = model.readings[g], model.moved[g]
                assert given is not None
                assert moved is not None
                rows = slice(row, row + 1)
                total += term.readings(rows, parents[None], given[rows], moved[rows], strict=strict)
            else:
                child = group.child[row]
                drawn = term.child(row, parents, values[..., child], afresh, strict=strict)
                values[..., child] = drawn.values
                tails += drawn.log_tails
                total += np.where(drawn.lost, np.nan, drawn.log_density)
        return Weighed(values, total, tails)

    def drawn(self, white: Array) -> Array:
        """Ancestral draws (runs, C, n): the CPDs turn white noise (C, n) into hidden variables."""
        layout = self.model.layout
        found = np.zeros((self.model.runs, *white.shape))
        for g, row in layout.order:
            group = layout.groups[g]
            if not group.observed:
                child, parents = group.child[row], found[..., group.parents[row]]
                found[..., child] = self.terms[g].sampled(row, parents, white[:, child])
        return found
