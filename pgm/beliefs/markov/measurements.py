r"""The beliefs of a hidden Markov model's measurements, without their own values.

.. math:: p(z) = \sum_x p(z \mid x) \, \alpha(x)

α is a belief over the slice x, the hidden variables of a step: predicted beliefs give forecasts,
filtered and smoothed ones measurements that were not taken. Beliefs are (*states, [runs]), as in
`marginals`; a *row* is a step, or a sighting.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from pgm.beliefs.markov.plan import RowTables, SlicePlan
from pgm.cpds import ConditionalGaussian, TableCPD
from pgm.cpds.caused import flat
from pgm.elimination import TableAlgebra, eliminate, next_smallest
from pgm.errors import Unanswered
from pgm.evidence import BoundEvidence, Reading
from pgm.factors import Gaussian, GaussianMixture, Table
from pgm.factors.axes import discrete
from pgm.kernels.arrays import Array, Integers, frozen
from pgm.kernels.semirings import SUM_PRODUCT
from pgm.linearisation.family import Family
from pgm.linearisers import Taylor
from pgm.posteriors.measurements import read_by, require_unread, rows_of
from pgm.variables import Variable


def expected(
    plan: SlicePlan, bound: BoundEvidence, variable: Variable, beliefs: Any
) -> Table | GaussianMixture:
    """The beliefs of a sensor's measurements, ``z`` by row or ``z.at(3)``, given those of slices.

    They are a table (*lead, rows, size), or of a continuous sensor whose cases are Gaussian a
    mixture. `beliefs` are those over the slices, by step.
    """
    reading, rows = rows_of(bound, plan.layout, variable)
    return at_rows(plan, bound, reading, variable, rows, [beliefs[t] for t in reading.step[rows]])


def at_rows(
    plan: SlicePlan,
    bound: BoundEvidence,
    reading: Reading,
    variable: Variable,
    rows: Integers,
    beliefs: Sequence[Array],
) -> Table | GaussianMixture:
    """The beliefs of a sensor's measurements at some rows, each with its belief over the slice.

    The result has an axis of rows, unless `variable` is that of one step.
    """
    kind = _table if isinstance(reading.cpd, TableCPD) else _mixture
    return kind(plan, bound, reading, variable, rows, beliefs)


def unread(
    plan: SlicePlan, bound: BoundEvidence, variable: Variable, beliefs: Any
) -> Table | GaussianMixture:
    """The belief of a measurement that was not taken, as of `expected`; an EvidenceError else."""
    reading = read_by(bound, variable)
    if reading is not None:
        require_unread(variable, reading.step, reading.taken)
    return expected(plan, bound, variable, beliefs)


def _table(
    plan: SlicePlan,
    bound: BoundEvidence,
    reading: Reading,
    variable: Variable,
    rows: Integers,
    beliefs: Sequence[Array],
) -> Table:
    """The table of a discrete sensor at some rows of its reading."""
    cpd: Any = reading.cpd
    tables = RowTables(plan, cpd, reading.inputs, reading.step)
    fixed: Any = None
    lead, child = bound.lead, len(plan.labels)
    sizes = {**plan.sizes, child: cpd.child.size}
    scopes = tuple(range(len(plan.slice))), (*tables.labels, child)
    summed = next_smallest(scopes, (child,), sizes)
    algebra = TableAlgebra(SUM_PRODUCT, sizes, watched=False)
    found = np.empty((len(rows), cpd.child.size, *((bound.runs,) if lead else ())))
    for place, row in enumerate(rows.tolist()):
        if fixed is None or reading.inputs:
            fixed = tables.factor(row, SUM_PRODUCT, as_map=False)
        found[place] = eliminate(summed, [beliefs[place], fixed], algebra)
    shown = discrete((variable,))
    found = np.moveaxis(found, -1, 0) if lead else found
    steps = () if variable.step is not None else (len(rows),)
    shape: Any = (*lead, *steps, cpd.child.size)
    return Table._plain(shown, frozen(found.reshape(shape)))


def _mixture(
    plan: SlicePlan,
    bound: BoundEvidence,
    reading: Reading,
    variable: Variable,
    rows: Integers,
    beliefs: Sequence[Array],
) -> GaussianMixture:
    """The mixture of a continuous sensor's cases at some rows of its reading."""
    cpd: Any = reading.cpd  # a SwitchingCPD
    switches = [v for v in cpd.switches if v in plan.labels]
    weights, means, covs = [], [], []
    every = [(case, own) for case, whole in cpd.cases.items() for own in flat(whole)]
    for case, (part, share, _) in every:
        if not isinstance(part, ConditionalGaussian):
            raise Unanswered(
                f"{variable!r}: {part!r}, a case of its CPD, is not Gaussian, and a measurement's "
                "belief is a mixture of Gaussians; the CPD's own sample() draws, given states of "
                "posterior.predicted"
            )
        inputs = {v: reading.inputs[v] for v in part.parents}
        lineariser = part.lineariser or Taylor() if hasattr(part, "lineariser") else Taylor()
        family = Family.make(
            part, (), reading.step, inputs, lineariser, bound.lead, numbering=bound.numbering
        )
        none = np.zeros((reading.step.size, bound.runs, 0))
        if not family.exact:
            family.linearise(slice(None), none, np.zeros((*none.shape, 0)))
        state: dict[Any, int] = dict(zip(cpd.switches, case, strict=True))
        place = tuple(state[v] if v in switches else slice(None) for v in plan.slice)
        weight = np.stack([_summed(belief[place], bool(bound.lead)) for belief in beliefs])
        for observed in set(cpd.switches) - set(switches):
            chosen = reading.inputs[observed][rows, :, 0] == state[observed]
            weight = weight * chosen
        weights.append(share * weight)
        means.append(family.value(slice(None), none)[rows])
        covs.append(np.broadcast_to(family.noise, (*none.shape[:2], *family.noise.shape[2:]))[rows])
    lead, one = bound.lead, variable.step is not None

    def out(parts: list[Array]) -> Array:
        """Values (rows, runs, ...) of each case as (*lead, [rows], cases, ...)."""
        whole = np.moveaxis(np.stack(parts), (0, 1, 2), (2, 1, 0))
        whole = whole[:, 0] if one else whole
        return whole.reshape(*lead, *whole.shape[1:])

    gaussian = Gaussian._make((variable,), out(means), out(covs))
    return GaussianMixture._make(out(weights), gaussian, None if one else reading.step[rows])


def _summed(belief: Array, batch: bool) -> Array:
    """The sum of a belief (*states, [runs]) over its states, (runs or 1,)."""
    axes = tuple(range(belief.ndim - batch))
    return np.atleast_1d(belief.sum(axis=axes))
