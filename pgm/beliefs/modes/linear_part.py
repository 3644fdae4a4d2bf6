r"""The linear part of a network: the Gaussian law that its affine factors alone make.

It takes the place of a prior where variables have none of finite variance: of a Markov network
those that no CPD explains, of a Bayesian one those of flat priors. Where these are x and all other
hidden variables y, with rows A (x, y) = b + e of white noise e of all affine factors, it is the
marginal of x of

.. math:: N\big((A^T A)^{-1} A^T b, (A^T A)^{-1}\big).

Factors of robust noise, or without noise, are left out. A nonlinear function counts as affine if it
is so, but for rounding, at points from a hundredth to 10,000 units away. Nothing hangs on that but
where modes are looked for: draws are weighed by the factors as they are.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from pgm.beliefs.gaussian.layout import Group
from pgm.beliefs.gaussian.model import Model
from pgm.beliefs.gaussian.potentials import make_potentials
from pgm.beliefs.modes.points import white_points
from pgm.errors import PgmError
from pgm.factors.scope import Scope
from pgm.kernels import canonical
from pgm.kernels.angles import difference
from pgm.kernels.arrays import Array, Integers, Mask, block, quiet, transpose
from pgm.linearisation.family import Family
from pgm.schedules.limits import require_runs

# How far from where a function is linearised it is compared with its line, in units.
AWAY = (1e-2, 1.0, 1e2, 1e4)
# The part of the line's terms by which the function of an affine factor may differ from it.
ROUNDING = 1e-6


class LinearPart(NamedTuple):
    """The law of the variables without a proper prior, by affine factors.

    mean, cov: Its moments, (runs, m) and (runs, m, m), of no use where something is open.
    open: The variables without a proper prior that affine factors leave open, in some run.
    """

    mean: Array
    cov: Array
    open: Scope


@quiet()
def linear_part(model: Model, places: Integers, turned: Mask, centre: Array) -> LinearPart:
    """The law of the components at `places` (m,) that a model's affine factors make.

    `turned` (n,) marks angles of which the density knows no turns, so that they cannot be further
    away than π: they are told by as much as N(centre, π²) tells, `centre` being (runs, n).
    """
    frame, size, runs = model.frame, model.layout.size, model.runs
    parts = _rows(model)
    reached = np.zeros(size, dtype=bool)
    reached[turned] = True
    for rows, _, at in parts:
        np.logical_or.at(reached, at.ravel(), (rows != 0.0).any(axis=(0, 2)).ravel())
    if not reached[places].all():  # which is found before anything as large as a joint is made
        lacking = np.zeros(size, dtype=bool)
        lacking[places] = ~reached[places]
        return LinearPart(np.zeros((runs, 0)), np.zeros((runs, 0, 0)), _holding(model, lacking))
    require_runs(3 * size * size, runs, "the joint law of all variables by affine factors")
    precision, along = _form(model, parts, np.where(turned, frame.scale / math.pi, 0.0), centre)
    mean, cov, loose = canonical.determined_moments(precision, along)
    lacking = np.zeros(size, dtype=bool)
    lacking[places] = loose[:, places].any(axis=0)
    mean = transpose(mean).reshape(runs, size) * frame.scale + frame.mean
    scale = frame.scale[places]
    cov = block(cov, places, places) * scale[:, None] * scale
    cov = np.broadcast_to(cov, (runs, *cov.shape[1:]))
    return LinearPart(mean[:, places], cov, _holding(model, lacking))


def _holding(model: Model, marked: Mask) -> Scope:
    """The variables that hold some of the components which are marked, (n,)."""
    return tuple(v for v, own in model.layout.places.items() if marked[own].any())


# The rows of some CPDs of a group, (V, k, d, w), their right sides (V, k, d, N), and the places of
# the columns, (k, w): of white noise, over coordinates ξ of the model's frame.
_Part = tuple[Array, Array, Integers]


def _rows(model: Model) -> list[_Part]:
    """The rows of affine CPDs with Gaussian noise."""
    potentials, found = make_potentials(model), []
    assembly, proper = potentials.assembly, potentials.proper
    for k, (group, family) in enumerate(zip(model.layout.groups, model.families, strict=True)):
        if family.cpd.noise is None and group.width:
            good = _are_affine(model, family, group)
            rows, right = assembly.matrices(k, proper.matrix), assembly.sides(k, proper.right)
            found.append((rows[:, good], right[:, good], group.places[good]))
    return found


def _form(model: Model, parts: list[_Part], told: Array, centre: Array) -> tuple[Array, Array]:
    """The information AᵀA of all rows, (V, n, n), and Aᵀb, (V, n, N), over coordinates ξ.

    `told` (n,) are the reciprocal deviations by which angles are about the `centre`, (runs, n).
    """
    size = model.layout.size
    away = (centre - model.frame.mean) / model.frame.scale * told**2
    along = transpose(away)[None].copy() if model.shared else away[..., None].copy()
    precision = np.zeros((size * size, len(along)))
    precision[:: size + 1] = (told**2)[:, None]
    for rows, right, at in parts:
        pairs = (at[:, :, None] * size + at[:, None, :]).ravel()
        squares = transpose(rows) @ rows
        np.add.at(precision, pairs, squares.reshape(len(along), -1).T)
        own = (transpose(rows) @ right).reshape(len(along), -1, along.shape[-1])
        np.add.at(along.swapaxes(0, 1), at.ravel(), own.swapaxes(0, 1))
    return precision.T.reshape(-1, size, size), along


def _are_affine(model: Model, family: Family, group: Group) -> Mask:
    """Which CPDs of a group have an affine function, in all runs, (k,)."""
    count, runs = len(group.cpds), model.runs
    if family.exact or not group.parents.shape[1]:
        return np.ones(count, dtype=bool)
    white = white_points(2, group.parents.shape[1])
    away = np.concatenate([far * white for far in AWAY])
    off = model.frame.scale[group.parents][:, None, None] * away
    parents = model.frame.mean[:, group.parents].swapaxes(0, 1)[:, :, None] + off
    slope = transpose(family.matrix)
    line = parents @ slope + family.offset[:, :, None]
    with np.errstate(all="ignore"):
        try:
            value = family.bound(slice(None), 2, (count, runs))(parents)
        except PgmError:
            return np.zeros(count, dtype=bool)
    gap = np.abs(difference(value, line, family.cpd.child.angle_mask))
    terms = np.abs(off) @ np.abs(slope)
    digits = np.abs(parents) @ np.abs(slope) + np.abs(family.offset[:, :, None]) + np.abs(value)
    return np.asarray((gap <= ROUNDING * terms + 1e-3 * ROUNDING * digits).all(axis=(1, 2, 3)))
