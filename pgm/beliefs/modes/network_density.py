"""The log-density of a network without time at values of all its hidden variables.

A component is *free* if it has noise given its parents; any other component is a function of its
parents and the free ones. A *relative* density is that of the CPDs divided by that of the
linearised CPDs. S or C is the number of draws of a run, n that of the components of all hidden
variables.

Variables that have no prior of finite variance are *open*: nothing can be drawn of them by their
CPDs. A *base*, a Gaussian of all open variables, is drawn from instead, and the others by their
CPDs, given these. A Markov network is here as `pgm.beliefs.gaussian.undirected` has it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from pgm.beliefs.gaussian.model import Model
from pgm.beliefs.modes.turns import Turns
from pgm.beliefs.moments.trajectories.density import Afresh, Peak, Term
from pgm.beliefs.moments.trajectories.proposal import Proposal
from pgm.factors.scope import angle_mask
from pgm.kernels.arrays import Array, Integers, Mask
from pgm.kernels.moments import Conditional

# The part of itself by which rounding may change a log-density a whole turn away.
SAME = 1e-9


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
    level : float
        The logarithm of a constant factor of all densities but relative ones.
    base : Proposal or None
        The law that open variables are drawn from; None where it is not known yet, or none is open.
    turns : Turns or None
        The angles of which the density knows no turns, so that its integral is over one.
    """

    model: Model
    terms: list[Term]
    level: float = 0.0
    base: Proposal | None = None
    turns: Turns | None = None

    @classmethod
    def make(
        cls, model: Model, *, relative: bool, near: bool = True, level: float = 0.0
    ) -> NetworkDensity:
        """The density of a network; `relative` and `near` are as of its CPDs' `Term`."""
        every = zip(model.families, model.taken, strict=True)
        terms = [Term.make(f, relative=relative, near=near, taken=taken) for f, taken in every]
        return cls(model, terms, 0.0 if relative else level)

    def based(self, mean: Array, cov: Array) -> NetworkDensity:
        """The density with a base N(mean, cov), (runs, m) and (runs, m, m), of `open`."""
        given = np.zeros((1, *mean.shape, 0))
        every = np.ones((1, *mean.shape), dtype=bool)
        return replace(self, base=Proposal.make(Conditional(given, mean[None], cov[None]), every))

    @cached_property
    def _open(self) -> set[tuple[int, int]]:
        """The CPDs of open variables, pairs of a group's number and a row in it."""
        found = set()
        for g, (group, taken) in enumerate(
            zip(self.model.layout.groups, self.model.taken, strict=True)
        ):
            if taken is not None and not group.observed:
                lacking = np.broadcast_to(~taken.all(axis=(-2, -1)), len(group.cpds))
                found |= {(g, int(row)) for row in np.flatnonzero(lacking)}
        return found

    @cached_property
    def open(self) -> Integers:
        """The places (m,) of the components of open variables."""
        groups = self.model.layout.groups
        places = [groups[g].child[row] for g, row in self._open]
        return np.sort(np.concatenate([np.zeros(0, dtype=np.intp), *places]))

    def unturned(self, mean: Array) -> Mask:
        """The open angles of which the density knows no turns, (n,).

        It is compared at `mean` (runs, n), and a turn of each away from it.
        """
        found = np.zeros(mean.shape[1], dtype=bool)
        found[self.open] = angle_mask(self.model.layout.hidden)[self.open]
        places = np.flatnonzero(found)
        if places.size:
            away = np.zeros((1 + places.size, mean.shape[1]))
            away[1 + np.arange(places.size), places] = 2.0 * np.pi
            height = self.at(mean[:, None] + away, strict=False).log_density
            off = np.abs(height[:, 1:] - height[:, :1])
            found[places] = (off <= SAME * (1.0 + np.abs(height[:, :1]))).all(axis=0)
        return found

    def turning(self, places: Integers, centres: Array, widths: Array) -> NetworkDensity:
        """The density of one turn of angles at `places` (m,), as `Turns` has them."""
        return replace(self, turns=Turns(places, centres, widths) if places.size else None)

    @property
    def peak(self) -> Peak:
        """The peak of the density."""
        every = zip(self.model.layout.groups, self.terms, strict=True)
        found = Peak.of(
            self.model.runs, [term.peak(slice(0, len(group.cpds))) for group, term in every]
        )
        return found._replace(log_density=found.log_density + self.level)

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

        afresh: Marks draws for which the base and the CPDs make new values, with Student's t for
            their noise, parents before children; None marks none.
        strict: Whether a function that is NaN or infinite raises a LinearisationError.
        """
        model, values = self.model, values.copy()
        total, tails = np.full(values.shape[:2], self.level), np.zeros(values.shape[:2])
        if self.base is not None:
            tails += self._drawn_of_base(self.base, values, afresh)
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
                child, known = group.child[row], (g, row) not in self._open
                drawn = term.child(
                    row, parents, values[..., child], afresh if known else None, strict=strict
                )
                values[..., child] = drawn.values
                tails += drawn.log_tails if known else 0.0
                total += np.where(drawn.lost, np.nan, drawn.log_density)
        if self.turns is not None:
            total += self.turns.log_share(values)
        return Weighed(values, total, tails)

    def _drawn_of_base(self, base: Proposal, values: Array, afresh: Afresh | None) -> Array:
        """Put draws of the base into `values` (runs, S, n), where they are made afresh.

        Returns its log-density at the values, with Student's t for its noise, (runs, S).
        """
        places = self.open
        given = np.zeros((*values.shape[:2], 0))
        if afresh is not None:
            white = base.white(0, values.shape[1], afresh.rng, afresh.where)
            made = base.values(0, given, white)
            values[..., places] = np.where(afresh.where[..., None], made, values[..., places])
        white = base.whitened(0, given, values[..., places])
        squared = np.einsum("rsi,rsi->rs", white, white)
        return base.log_density(0, squared) + base.log_tails(0, squared)

    def drawn(self, white: Array) -> Array:
        """Draws (runs, C, n): base and CPDs turn white noise (C, n) into hidden variables."""
        layout = self.model.layout
        found = np.zeros((self.model.runs, *white.shape))
        if self.base is not None:
            given = np.zeros((*found.shape[:2], 0))
            found[..., self.open] = self.base.values(0, given, white[:, self.open])
        for g, row in layout.order:
            group = layout.groups[g]
            if not group.observed and (g, row) not in self._open:
                child, parents = group.child[row], found[..., group.parents[row]]
                found[..., child] = self.terms[g].sampled(row, parents, white[:, child])
        return found
