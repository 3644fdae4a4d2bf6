"""Modes of a network without time besides the one that the Gaussian answer fits.

They are found by calibrations that start from C points for each run: by iterations that linearise
the network's CPDs at a point, and calibrate its cluster tree. n is the number of components of all
hidden variables.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from pgm.beliefs.gaussian.beliefs import Calibrated, TreePoint
from pgm.beliefs.gaussian.joints import joint_moments
from pgm.beliefs.gaussian.model import LinearisedAt, Model, weights_of
from pgm.beliefs.gaussian.prior import prior_predictive
from pgm.beliefs.gaussian.reweighting import reweigh
from pgm.beliefs.gaussian.solving import TreeSolver
from pgm.beliefs.gaussian.tree import TreePlan
from pgm.beliefs.modes.network_density import NetworkDensity
from pgm.beliefs.moments.trajectories.proposal import Path
from pgm.errors import PgmError
from pgm.factors.scope import angle_mask
from pgm.inference.audit.modes import MOST, FixedPoints, Modes, choose
from pgm.inference.audit.repeated import of_family, tiled
from pgm.inference.audit.starts import images, white_points
from pgm.kernels.arrays import Array, deviation, quiet

# Points of the prior; linearisations at the most, the parts of a step that are tried in each, and
# the standard deviations within which it has arrived.
POINTS, ITERATIONS, PARTS, TOLERANCE = 12, 12, (1.0, 0.5, 0.2, 0.05), 0.02

# From the moments of all variables, (runs, n) and (runs, n, n), to their law.
MakePath = Callable[[Array, Array], Path]


@quiet()
def find(
    plan: TreePlan,
    density: NetworkDensity,
    answer: tuple[Array, Array],
    make: MakePath,
    most: int = MOST,
) -> Modes:
    """The modes other than the answer's at which calibrations from other starts arrive.

    If the calibrations fail, the modes are unknown (`Modes.unknown`).

    Parameters
    ----------
    plan : TreePlan
        The rounds of messages by which the tree is calibrated.
    density : NetworkDensity
        The density of the network, of all runs.
    answer : tuple of ndarray
        The answer's mean (runs, n) and covariance (runs, n, n) of all variables.
    make : callable
        Makes the `Path` of all variables of a mean and covariance, of the shapes of `answer`.
    most : int
        The largest number of modes that are to be drawn from.
    """
    mean, cov = answer
    runs, size = mean.shape
    if density.model.exact or not size:
        return Modes.none(runs)
    at = starts(density, mean)
    search = Search(plan, density, at.shape[1])
    try:
        at = search.climb(at)
        done = search.solve(at)
        _, spread = joint_moments(plan, done.beliefs, np.arange(size))
    except (PgmError, np.linalg.LinAlgError):
        return Modes.unknown(runs)
    count = at.shape[1]
    spread = np.broadcast_to(spread, (count * runs, size, size)).reshape(count, runs, size, size)
    evidence = np.broadcast_to(done.log_evidence.reshape(-1), count * runs).reshape(count, runs)
    evidence = np.where(np.isfinite(evidence), evidence, -np.inf)
    where = at.swapaxes(0, 1)
    points = FixedPoints(where, deviation(spread), evidence, angle_mask(plan.layout.hidden))
    chosen = choose(points, mean, deviation(cov), most)
    laws = []
    for index, share in zip(chosen.index, chosen.shares, strict=True):
        there, place = index >= 0, (np.maximum(index, 0), np.arange(runs))
        centre = np.where(there[:, None], where[place], mean)
        spread_there = np.where(there[:, None, None], spread[place], cov)
        laws.append((partial(make, centre, spread_there), share))
    return Modes.made(laws, chosen.missed)


def starts(density: NetworkDensity, answer: Array) -> Array:
    """Points (runs, C, n) from which calibrations start, the answer's means μ (runs, n) first.

    Let ρ be the values that the CPDs make of zero noise, parents before children. The means are
    followed by mirror images 2ρ − μ, by ρ, and by the values that the CPDs make of white noise, at
    points that fill N(0, I). A point at which the model has no density is replaced by μ.
    """
    size = answer.shape[-1]
    white = np.concatenate([np.zeros((1, size)), white_points(POINTS, size)])
    drawn = density.drawn(white)
    mirrored = images(answer, drawn[:, 0])
    found = np.concatenate([np.stack([answer, *mirrored], axis=1), drawn], axis=1)
    known = np.isfinite(density.at(found, strict=False).log_density)
    return np.where(known[..., None], found, answer[:, None])


@dataclass(frozen=True, eq=False)
class Search:
    """Gauss–Newton on a tree from C = `count` points for each run, all in one linearised network.

    This network has every run C times: its run c · runs + r is the copy c of run r. `plan` has the
    rounds of messages by which the tree is calibrated, `density` the log-density that is climbed.
    """

    plan: TreePlan
    density: NetworkDensity
    count: int

    def solve(self, at: Array) -> Calibrated:
        """Calibrate the network linearised at points (runs, C, n).

        Returns the clusters' beliefs, of C · runs runs, and their log-evidence. A NumericalError is
        raised if the beliefs are not proper.
        """
        flat = at.swapaxes(0, 1).reshape(-1, at.shape[-1])
        model = self._linearised(flat)
        solver = TreeSolver(self.plan, model)
        return solver.solve()

    def climb(self, at: Array) -> Array:
        """Climb from points (runs, C, n) by steps of Gauss–Newton that raise the log-density.

        Returns the points reached, (runs, C, n). A step goes the part t of the way from a point x
        to the mean x̂ of the network linearised at x,

            x ← x + t (x̂ − x).

        Of 1, 0.5, 0.2 and 0.05, that t is taken for which the log-density is largest; if none
        raises it, the point stays. There are 12 steps, or fewer if in one of them no component of
        any point moves by more than 0.02 standard deviations of the linearised network.
        """
        runs, count, size = at.shape
        parts = np.array((0.0, *PARTS))[:, None]
        for _ in range(ITERATIONS):
            point = self.solve(at).point
            found = point.mean.reshape(count, runs, size).swapaxes(0, 1)
            std = np.broadcast_to(point.std, point.mean.shape).reshape(count, runs, size)
            tried = at[:, :, None] + parts * (found - at)[:, :, None]
            flat = tried.reshape(runs, -1, size)
            height = self.density.at(flat, strict=False).log_density.reshape(runs, count, -1)
            height = np.where(np.isfinite(height), height, -np.inf)
            best = height.argmax(axis=-1)[..., None, None]
            moved = np.take_along_axis(tried, best, axis=2)[:, :, 0]
            off = np.abs(moved - at)
            at = moved
            if (off <= TOLERANCE * std.swapaxes(0, 1)).all():
                break
        return at

    def _linearised(self, at: Array) -> Model:
        """The network with each run C times, expanded to first order at points (C · runs, n)."""
        model = self.density.model
        layout = model.layout
        families = [of_family(family, self.count, model.runs) for family in model.families]
        for group, family in zip(layout.groups, families, strict=True):
            there = at[:, group.parents].swapaxes(0, 1)
            family.linearise(slice(None), there, np.zeros((*there.shape, there.shape[-1])))
        frame = prior_predictive(layout, families, len(at), shared=False, start=at)
        readings = [None if r is None else tiled(r, self.count) for r in model.readings]
        moved = [
            None if r is None else np.broadcast_to(r, (len(r), len(at), r.shape[2]))
            for r in readings
        ]
        taken = [None if t is None else tiled(t, self.count) for t in model.taken]
        made = Model(
            layout,
            (len(at),),
            families,
            readings,
            moved,
            taken,
            False,
            frame,
            [LinearisedAt.prior(frame, group) for group in layout.groups],
            weights_of(families, taken, len(at)),
        )
        every = np.ones(len(at), dtype=bool)
        made._follow(frame.mean, every)
        reweigh(made, TreePoint(at[None], np.zeros((1, *at.shape)), None), every, sharp=True)
        return made
