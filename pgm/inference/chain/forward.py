"""The forward sweep: messages in moment form, from cluster 0 to cluster T."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pgm.errors import NumericalError
from pgm.inference.chain.plan import ChainPlan, Link
from pgm.inference.chain.update import update
from pgm.kernels import moments, roots
from pgm.kernels.angles import TURN
from pgm.kernels.arrays import Array, Index, block


@dataclass(frozen=True, eq=False)
class Forward:
    """What a forward sweep leaves, time first: over the slices, before and after their readings.

    Attributes
    ----------
    predicted_mean, mean : ndarray
        (T+1, runs, slice size); controls at step 0 are zero.
    predicted_cov, cov : ndarray
        (T+1, runs, slice size, slice size).
    log_density : ndarray
        (T+1, runs): of each step's readings given those before.
    """

    predicted_mean: Array
    predicted_cov: Array
    mean: Array
    cov: Array
    log_density: Array

    @classmethod
    def empty(cls, plan: ChainPlan) -> Forward:
        """Room for a sweep."""
        size, shape = plan.layout.slice_size, (plan.steps + 1, plan.runs)
        means, covs = (*shape, size), (*shape, size, size)
        return cls(
            np.zeros(means), np.zeros(covs), np.zeros(means), np.zeros(covs), np.zeros(shape)
        )


def sweep(plan: ChainPlan, *, linearise: bool) -> Forward:
    """Run the forward sweep, linearising each CPD at its incoming belief, or as it is laid out."""
    out = Forward.empty(plan)
    states, last = plan.layout.state_places, plan.steps
    mean, cov = start(plan, linearise=linearise)
    out.predicted_mean[0][:, states] = mean
    put(out.predicted_cov[0], states, cov)
    for step in range(last + 1):
        if step:
            mean = out.mean[step - 1][:, states]
            cov = block(out.cov[step - 1], states, states)
            out.predicted_mean[step], out.predicted_cov[step] = predict(
                plan, step - 1, mean, cov, linearise=linearise
            )
        out.mean[step], out.cov[step], out.log_density[step] = update(
            plan.sensors,
            step,
            out.predicted_mean[step],
            out.predicted_cov[step],
            linearise=linearise,
        )
    return out


def put(cov: Array, places: Index, value: Array) -> None:
    """Write the block of some components."""
    if isinstance(places, slice):
        cov[:, places, places] = value
    else:
        cov[:, places[:, None], places] = value


def start(plan: ChainPlan, *, linearise: bool) -> tuple[Array, Array]:
    """Moments of the states at step 0."""
    size = plan.layout.state_size
    mean, cov = np.zeros((plan.runs, size)), np.zeros((plan.runs, size, size))
    for link in plan.prior:
        _extend(link, 0, 0, mean, cov, linearise)
    return mean, cov


def predict(
    plan: ChainPlan, row: int, mean: Array, cov: Array, *, linearise: bool
) -> tuple[Array, Array]:
    """Moments of the slice from those of the states before it."""
    if plan.layout.single:
        link = plan.transition[0]
        family = link.family
        if linearise and not family.exact:
            family.linearise(row, mean, cov)
        conditional = moments.Conditional(family.matrix[row], family.offset[row], family.noise[row])
        slice_mean, slice_cov = moments.predict(mean, cov, conditional)
        _keep_chart(link, row, mean, slice_mean)
        _check_predicted(link, row, slice_cov)
        return slice_mean, slice_cov
    front = plan.layout.state_size
    size = front + plan.layout.slice_size
    pair_mean, pair_cov = np.zeros((plan.runs, size)), np.zeros((plan.runs, size, size))
    pair_mean[:, :front] = mean
    pair_cov[:, :front, :front] = cov
    for link in plan.transition:
        _extend(link, row, row + 1, pair_mean, pair_cov, linearise)
    return pair_mean[:, front:], pair_cov[:, front:, front:]


def _extend(link: Link, row: int, step: int, mean: Array, cov: Array, linearise: bool) -> None:
    family, parents = link.family, link.parents
    if linearise and not family.exact:
        family.linearise(row, mean[:, parents], block(cov, parents, parents))
    moments.extend(
        mean,
        cov,
        link.child,
        parents,
        family.matrix[row],
        family.offset[row],
        family.noise[row],
    )
    _keep_chart(link, row, mean, mean[:, link.child])
    _check_predicted(link, row, block(cov, link.child, link.child))


def _keep_chart(link: Link, row: int, before: Array, child: Array) -> None:
    """Undo, in place, whole turns that a function which wraps its angles has made in a step.

    Beliefs live on one unwrapped chart.
    """
    if not link.before.size:
        return
    turned = child[:, link.angles] - before[:, link.before]
    if np.abs(turned).max() > np.pi:
        # A function that wraps gives the same for an angle a whole turn on; another turns too.
        further = before.copy()
        further[:, link.before] += TURN
        function = link.family.bound(row, 1, before.shape[:1])
        gained = function(further[:, link.parents]) - function(before[:, link.parents])
        wraps = np.abs(gained[:, link.angles]) < 0.5 * TURN
        turns = np.where(wraps, TURN * np.round(turned / TURN), 0.0)
        child[:, link.angles] -= turns
        link.family.offset[row][:, link.angles] -= turns


def _check_predicted(link: Link, row: int, cov: Array) -> None:
    """Only a lineariser's error can make a prediction indefinite."""
    family = link.family
    if family.approximate and not roots.is_proper(roots.root(cov)):
        step = int(family.step[row])
        raise NumericalError(
            f"{family.cpd!r}: the predicted covariance at step {step} is indefinite with "
            f"{family.lineariser!r}; use a rule with positive weights or more samples",
            variable=family.cpd.child,
            cpd=family.cpd,
            step=step,
        )
