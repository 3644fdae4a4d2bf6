"""Draws of all variables of a network without time, with their log-densities.

Draws are from the Gaussian answer q, the joint of the calibrated tree, or *defensive*, from a
density with wider tails. A defensive draw is from the prior or from q, with Student's t for the
noise in either case, or from a Gaussian at another mode.

A component is *free* if it has noise given its parents; any other component is a function of its
parents and the free ones. Where an observed CPD has no noise, or the posterior no density,
densities are *relative*: each CPD's density is divided by that of the linearised CPD. n is the
number of components of all hidden variables, S the number of draws of a run.

Variables may be *open*, without a prior of finite variance, as in Markov networks. The linear part
of the network takes the place of their prior, where it is proper. Else draws are from the answer,
WIDER times as wide, and whether there are other modes is not known.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pgm.beliefs.gaussian.outcome import GaussianOutcome
from pgm.beliefs.modes.linear_part import linear_part
from pgm.beliefs.modes.network_density import NetworkDensity
from pgm.beliefs.moments.trajectories.density import has_exact
from pgm.beliefs.moments.trajectories.proposal import Path, Proposal
from pgm.errors import GraphError
from pgm.factors.scope import Scope, listed
from pgm.inference.audit import tree_modes
from pgm.inference.audit.corrected import Sums
from pgm.inference.audit.draws import Draws, Strand
from pgm.inference.audit.excursions import PREDICTED, Excursions
from pgm.inference.audit.modes import MOST, Modes
from pgm.kernels.arrays import Array, Mask, block
from pgm.kernels.moments import Conditional

# How many times the answer's deviations are drawn from where the linear part is not proper.
WIDER = 4.0


@dataclass(frozen=True, eq=False)
class TreeDraws:
    """Draws from the joint Gaussian q of a calibrated tree, or defensive ones.

    answer : Path
        The law q of all variables, which stand in a single slice.
    modes : Modes
        Gaussians at other modes, for defensive draws.
    density : NetworkDensity
        The density of the model.
    reference : ndarray
        (runs,): added to all log-densities: ln p(z) of the linearised network where they are
        `relative`, else zero.
    relative : bool
        Whether densities are relative.
    mean, cov : ndarray
        (1, runs, n) and (1, runs, n, n): the moments of `answer`.
    """

    answer: Path
    modes: Modes
    density: NetworkDensity
    reference: Array
    relative: bool
    mean: Array
    cov: Array

    @classmethod
    def make(cls, posterior: GaussianOutcome) -> TreeDraws:
        """Prepare to draw from the joint of a posterior; a GraphError if its graph has loops.

        A NumericalError is raised for a nonlinear sensor that was read and has singular noise, for
        indefinite covariances, and, where densities are relative, for robust noise and nonlinear
        CPDs with singular noise.
        """
        if posterior.log_evidence_kind == "bethe":
            raise GraphError(
                f"{posterior._title}: an audit draws from the joint of all variables, which only a "
                "calibrated tree has; infer on pgm.compile(network)"
            )
        model = posterior._model
        every = zip(model.layout.groups, model.families, strict=True)
        exact = has_exact(family for group, family in every if group.observed)
        if not exact:
            draws = cls._make(posterior, relative=False)
            if draws.answer.regular:
                return draws
        return cls._make(posterior, relative=True)

    @classmethod
    def _make(cls, posterior: GaussianOutcome, *, relative: bool) -> TreeDraws:
        """Prepare to draw, with densities that are `relative` or not, and look for other modes."""
        model = posterior._model
        layout, runs = model.layout, model.runs
        mean, cov = np.zeros((runs, 0)), np.zeros((runs, 0, 0))
        if layout.size:
            joint = posterior.joint(*layout.hidden)
            mean, cov = joint.mean.reshape(runs, -1), joint.cov.reshape(runs, *joint.cov.shape[-2:])
        density = NetworkDensity.make(model, relative=relative, level=posterior._level)
        unturned = np.zeros(layout.size, dtype=bool) if relative else density.unturned(mean)
        density, left = _based(density, unturned, mean, cov)
        free = density.free(mean.shape)

        def path(mean: Array, cov: Array) -> Path:
            """The Gaussian law of all variables, of mean (runs, n) and covariance (runs, n, n)."""
            given = np.zeros((1, *mean.shape, 0))
            return Path(Proposal.make(Conditional(given, mean[None], cov[None]), free))

        answer = path(mean, cov)
        known = posterior.log_evidence.reshape(runs) if relative else np.zeros(runs)
        modes = Modes.none(runs)
        if relative or answer.regular:
            most = 0 if relative else MOST
            modes = tree_modes.find(posterior._plan, density, (mean, cov), path, most)
        if left and not model.settled:
            modes = modes.unsearched(
                "there was nowhere to look from, as no prior or affine factor bounds "
                f"{listed(left)}"
            )
        if unturned.any():
            laws = [path.first for path in (answer, *modes.paths)]
            places = np.flatnonzero(unturned)
            centres = np.stack([law.offset[0][:, places] for law in laws])
            roots = np.stack([law.lower[0][:, places] for law in laws])
            widths = np.sqrt((roots * roots).sum(axis=-1))
            density = density.turning(places, centres, widths)
        return cls(answer, modes, density, known, relative, mean[None], cov[None])

    @property
    def width(self) -> int:
        """The number of floats that a draw of one run occupies while it is made."""
        return 3 * self.density.model.layout.size

    @property
    def length(self) -> int:
        """The number of floats of a draw of one run, which is that of its components."""
        return self.density.model.layout.size

    def sums(self) -> list[Sums]:
        """Sums over draws, still empty, by which the moments of beliefs are estimated.

        There is one `Sums` for each hidden variable, and one for each cluster.
        """
        layout, every = self.density.model.layout, np.ones(1, dtype=bool)
        alone = [(variable,) for variable in layout.hidden]
        sums = []
        for scope in dict.fromkeys([*alone, *filter(None, layout.scopes)]):
            places = layout.components(scope)
            cov = block(self.cov, places, places)
            sums.append(Sums(scope, places, 0, self.mean[..., places], cov, every, timed=False))
        return sums

    def draw(self, count: int, rng: np.random.Generator, *, defensive: bool) -> Draws:
        """Make S = `count` draws for each run, from q or, if `defensive`, defensive ones.

        Returns their values, and their log-densities by the model, by q and by the defensive
        density. Where a function of the model is NaN or infinite at a defensive draw, the model's
        log-density is NaN; at a draw from q, a LinearisationError is raised.
        """
        shape = len(self.reference), count
        excursions = Excursions(1, 0.0 if self.relative else PREDICTED)
        strand = Strand(self.answer, self.modes, excursions, shape, rng, defensive, self.relative)
        nothing = np.zeros((*shape, 0))
        proposed, afresh = strand.propose(nothing)
        found = self.density.at(proposed, afresh, strict=not defensive)
        strand.weigh(nothing[None], found.values[None], found.log_tails[None])
        return strand.drawn(self.reference[:, None] + found.log_density, found.values[None])


def _based(
    density: NetworkDensity, unturned: Mask, mean: Array, cov: Array
) -> tuple[NetworkDensity, Scope]:
    """The density with a base of its open variables, and those that its linear part leaves open.

    `unturned` (n,) marks angles of which the density knows no turns; `mean` (runs, n) and `cov`
    (runs, n, n) are the answer's.
    """
    places = density.open
    if not places.size:
        return density, ()
    part = linear_part(density.model, places, unturned, mean)
    if part.open:
        wide = WIDER**2 * block(cov, places, places)
        return density.based(mean[:, places], wide), part.open
    return density.based(part.mean, part.cov), ()
