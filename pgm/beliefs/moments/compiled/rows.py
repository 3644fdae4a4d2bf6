"""CPDs at their rows, as machine code is told of them: any one, and those of transitions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from operator import attrgetter
from typing import Any

import numpy as np

from pgm.beliefs.moments.compiled.linearising import linearising_of
from pgm.beliefs.moments.compiled.table import Table
from pgm.beliefs.moments.compiled.uncompiled import Uncompiled
from pgm.beliefs.moments.steps.plan import ChainPlan, Link
from pgm.kernels.arrays import Index, Mask
from pgm.kernels.machine.sweeps import told
from pgm.linearisation.family import Family


def row_of(
    family: Family,
    parents: tuple[int, ...],
    table: Table,
    *,
    stored: bool,
    keep: bool,
    held: int = 1,
    known: tuple[int, ...] = (),
) -> dict[str, Any]:
    """The attributes of a CPD's `told.Row`, of whatever kind it is.

    Where its function is called, up to `held` rows of a step are linearised together. `known` are
    the parents' components that may have no variance.
    """

    def array(name: str) -> told.Array:
        return table.of(family, attrgetter(name))

    weighed = family.cpd.noise is not None and not stored
    found: dict[str, Any] = {"parents": parents, "height": family.shape[2]}
    if not stored:
        found["angles"] = tuple(np.flatnonzero(family.cpd.child.angle_mask).tolist())
    if stored or family.template is None:
        found["matrix"], found["offset"] = array("matrix"), array("offset")
        found["noise"] = array("own_noise" if weighed else "noise")
        if weighed and keep:
            family.keep_errors()
            found["kept"] = array("noise")
        return found
    found["noise"] = array("own_noise")
    curve = linearising_of(family, table, held)
    found |= with_known(curve, known)
    if keep:
        found["matrix"], found["offset"] = array("matrix"), array("offset")
        called, rule = curve.get("called"), curve.get("points")
        exact = rule is None if called is None else called.lines.error is None
        if not exact or weighed:
            family.keep_errors()
            found["kept"] = array("noise")
    return found


def motion_of(
    plan: ChainPlan, link: Link, table: Table, *, stored: bool, keep: bool
) -> told.Motion:
    """A CPD of the transition."""
    layout, family = plan.layout, link.family
    front = layout.state_size
    size = front + layout.slice_size
    turning: tuple[tuple[int, int, int], ...] = ()
    if link.turning and not stored:
        own = places(link.parents, size)
        if any(before not in own for before in link.before.tolist()):
            raise Uncompiled(f"{family.cpd!r} turns an angle of which its function does not know")
        turning = tuple((new, before, own.index(before)) for new, before in link.turning)
    parents = places(link.parents, size)
    start = np.append(known_at_start(plan)[layout.state_places], np.zeros(size - front, dtype=bool))
    known = tuple(np.flatnonzero(start[list(parents)]).tolist())
    row = row_of(family, parents, table, stored=stored, keep=keep, known=known)
    if not stored:
        row["angles"] = tuple(np.flatnonzero(family.turned).tolist())
    return told.Motion(
        **row,
        bare=family.bare,
        unsure=not family.semidefinite,
        turning=turning,
    )


def known_at_start(plan: ChainPlan) -> Mask:
    """The components of a slice that may have no variance in the belief to begin with, (n,).

    Those of states whose prior has no noise of their own, or that are known at the belief that
    takes the prior's place.
    """
    layout = plan.layout
    if plan.begin is not None:
        variances = np.einsum("ii...->i...", plan.begin[1]).reshape(layout.slice_size, -1)
        found: Mask = (variances == 0.0).any(axis=1)
        return found
    found, states = np.zeros(layout.slice_size, dtype=bool), np.arange(layout.slice_size)
    for link in plan.prior:
        own = states[layout.state_places][link.child]
        found[own[list(link.family.bare)]] = True
    return found


def with_known(curve: dict[str, Any], known: tuple[int, ...]) -> dict[str, Any]:
    """A linearisation's attributes, with the components that may have no variance."""
    if not known or curve.get("points") is None:
        return curve
    return curve | {"points": replace(curve["points"], known=known)}


def needed(
    motions: Sequence[told.Motion], sensors: Sequence[told.Sensor], front: int
) -> tuple[bool, bool]:
    """Whether a CPD is linearised by covariances of slices, and whether one is by those of pairs.

    `front` is how many components the states have.
    """
    pairs = any(
        motion.points is not None and max(motion.parents, default=0) >= front for motion in motions
    )
    expects = any(sensor.loss is not None and sensor.loss.expects for sensor in sensors)
    return pairs or expects or any(row.points is not None for row in (*motions, *sensors)), pairs


def places(index: Index, size: int) -> tuple[int, ...]:
    """The places that an index says."""
    return tuple(np.arange(size)[index].tolist())
