"""Draws of all variables of a network without time, with their log-densities."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pgm.errors import GraphError
from pgm.inference.audit.corrected import Sums
from pgm.inference.audit.density import Term, has_exact
from pgm.inference.audit.draws import Draws, Strand
from pgm.inference.audit.excursions import PREDICTED, Excursions
from pgm.inference.audit.modes import Modes
from pgm.inference.audit.proposal import Path, Proposal
from pgm.inference.gaussian.model import Model
from pgm.inference.gaussian.posterior import GaussianPosterior
from pgm.kernels.arrays import Array, block
from pgm.kernels.moments import Conditional


@dataclass(frozen=True, eq=False)
class TreeDraws:
    """Draws from the joint Gaussian of a calibrated tree, all at once; see `ChainDraws`."""

    model: Model
    answer: Path
    modes: Modes
    terms: list[Term]
    reference: Array
    relative: bool
    mean: Array
    cov: Array

    @classmethod
    def make(cls, posterior: GaussianPosterior) -> TreeDraws:
        """Prepare to draw from the joint of a posterior."""
        if posterior.log_evidence_kind == "bethe":
            raise GraphError(
                f"{posterior._title}: an audit draws from the joint of all variables, which only a "
                "calibrated tree has; infer on pgm.compile(network)"
            )
        model = posterior._model
        every = zip(model.layout.groups, model.families, strict=True)
        exact = has_exact(family for group, family in every if group.observed)
        draws = cls._make(posterior, relative=False)
        if exact or not draws.answer.regular:
            return cls._make(posterior, relative=True)
        return draws

    @classmethod
    def _make(cls, posterior: GaussianPosterior, *, relative: bool) -> TreeDraws:
        model = posterior._model
        layout, runs = model.layout, model.runs
        mean, cov = np.zeros((runs, 0)), np.zeros((runs, 0, 0))
        if layout.size:
            joint = posterior.joint(*layout.hidden)
            mean, cov = joint.mean.reshape(runs, -1), joint.cov.reshape(runs, *joint.cov.shape[-2:])
        terms = [
            Term.make(family, relative=relative, taken=taken)
            for family, taken in zip(model.families, model.taken, strict=True)
        ]
        free = np.zeros((1, *mean.shape), dtype=bool)
        for group, term in zip(layout.groups, terms, strict=True):
            mask = term.free()
            for row, child in enumerate(() if group.observed else group.child):
                free[0][:, child] = mask[row if mask.shape[0] > 1 else 0]
        proposal = Proposal.make(
            Conditional(np.zeros((1, *mean.shape, 0)), mean[None], cov[None]), free
        )
        known = posterior.log_evidence.reshape(runs) if relative else np.zeros(runs)
        return cls(
            model, Path(proposal), Modes.none(runs), terms, known, relative, mean[None], cov[None]
        )

    @property
    def width(self) -> int:
        """See `Drawing`."""
        return 3 * self.model.layout.size

    @property
    def length(self) -> int:
        """See `Drawing`."""
        return self.model.layout.size

    def sums(self) -> list[Sums]:
        """See `Drawing`."""
        layout, every = self.model.layout, np.ones(1, dtype=bool)
        alone = [(variable,) for variable in layout.hidden]
        sums = []
        for scope in dict.fromkeys([*alone, *filter(None, layout.scopes)]):
            places = layout.components(scope)
            cov = block(self.cov, places, places)
            sums.append(Sums(scope, places, 0, self.mean[..., places], cov, every, timed=False))
        return sums

    def draw(self, count: int, rng: np.random.Generator, *, defensive: bool) -> Draws:
        """So many draws a run: defensive ones follow the prior, or have Student tails."""
        model = self.model
        total = np.repeat(self.reference[:, None], count, axis=1)
        excursions = Excursions(1, 0.0 if self.relative else PREDICTED)
        strand = Strand(
            self.answer, self.modes, excursions, total.shape, rng, defensive, self.relative
        )
        nothing = np.zeros((*total.shape, 0))
        values, afresh = strand.propose(nothing)
        predicted = np.zeros(total.shape)
        for g, row in model.layout.order:
            group, term = model.layout.groups[g], self.terms[g]
            parents = values[..., group.parents[row]]
            if group.observed:
                given, moved = model.readings[g], model.moved[g]
                assert given is not None
                assert moved is not None
                rows = slice(row, row + 1)
                total += term.readings(
                    rows, parents[None], given[rows], moved[rows], strict=not defensive
                )
            else:
                child = group.child[row]
                drawn = term.child(row, parents, values[..., child], afresh)
                values[..., child] = drawn.values
                predicted += drawn.log_tails
                total += np.where(drawn.lost, np.nan, drawn.log_density)
        strand.weigh(nothing, values, predicted)
        return strand.drawn(total, [values])
