"""Errors of Gaussian networks that more than one way of solving them raises."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pgm.beliefs.gaussian.assembly import Assembly
from pgm.beliefs.gaussian.model import Model
from pgm.cpds import CPD
from pgm.errors import NumericalError
from pgm.factors.scope import components, names
from pgm.kernels.arrays import Array, Integers, Mask
from pgm.kernels.rows import NEGLIGIBLE

# Components up to which an open direction is looked for, and the most that are shown of one.
MOST, SHOWN = 1500, 6


class Contradiction(NumericalError):
    """Measurements that contradict CPDs without noise.

    `lost`, (runs,), marks the runs where that was found; others may contradict them elsewhere.
    """

    lost: Mask


def contradiction(model: Model, cluster: int, runs: Sequence[Integers]) -> Contradiction:
    """The error that measurements contradict CPDs without noise, naming the cluster and the run.

    `cluster` is its number; `runs` are the numbers of the runs that were found, once by the axis of
    runs that differ in their matrices and once by that of those that share them, zero in the other.
    Without axes of runs none is named.
    """
    numbers = np.unique(np.maximum(*runs))
    found = _contradiction(model, cluster, int(numbers[0]))
    found.lost = np.isin(np.arange(model.runs), numbers)
    return found


def _contradiction(model: Model, cluster: int, run: int) -> Contradiction:
    graph = model.layout.graph
    residuals = {cpd.child for cpd in graph.network.cpds if cpd._of is not None}
    scope = tuple(v for v in graph.clusters[cluster].scope if v not in residuals)
    which = f", run {run}" if model.lead else ""
    return Contradiction(
        f"evidence contradicts an exact model at cluster {cluster}, {names(scope)}{which}: "
        "CPDs without noise determine a value in two ways that differ; give one of them, or "
        "the prior, some noise",
        cluster=cluster,
        run=run if model.lead else None,
    )


def improper(model: Model, assembly: Assembly, cluster: int, rows: Array) -> NumericalError:
    """The error that a cluster, by its number, has no proper belief, or the evidence no density.

    `rows` (V, entries) are those of all CPDs, group by group, as linearised now.
    """
    scope = model.layout.scopes[cluster]
    if not scope:
        return NumericalError(
            f"the density of the evidence in cluster {cluster} is beyond the range of float64: "
            "a measurement is more than 1e150 deviations from what the model expects",
            cluster=cluster,
        )
    what = f"cluster {cluster} has no proper belief over {names(scope)}"
    if model.flat and (told := _open(model, assembly, rows)):
        return NumericalError(
            f"{what}: priors are flat, and measurements leave the direction {told} open, but for "
            "rounding; give one of its variables a prior of finite variance, a measurement or "
            "evidence",
            cluster=cluster,
        )
    return NumericalError(
        f"{what}: its information is "
        "singular in these numbers. Some noise is more than 1e11 times sharper than what else "
        "is known of its variables, or, on a graph with loops, messages diverged or CPDs "
        "without noise form a loop; scale the noise, or compile a junction tree",
        cluster=cluster,
    )


def _open(model: Model, assembly: Assembly, rows: Array) -> str:
    """A direction that no row has a share in, in words; empty if none is found.

    It is looked for in the first run where there is one, and not in networks of very many
    components.
    """
    layout = model.layout
    if layout.size > MOST:
        return ""
    for own in rows:
        matrix = np.zeros((int(assembly.row_starts[-1]), layout.size))
        for k, group in enumerate(assembly.factors):
            first = np.arange(len(group.clusters))[:, None] * group.height + np.arange(group.height)
            at = (assembly.row_starts[k] + first)[..., None], group.places[:, None]
            matrix[at] = assembly.matrices(k, own[None])[0]
        length = np.sqrt((matrix**2).sum(axis=0))
        unit = np.where(length > 0.0, length, 1.0)
        if not np.isfinite(matrix).all():
            continue
        _, values, vt = np.linalg.svd(matrix / unit, full_matrices=True)
        least = values[-1] if len(values) == layout.size else 0.0
        if least > NEGLIGIBLE * values.max(initial=1.0):
            continue
        direction = vt[-1] / unit * model.frame.scale
        direction = direction / np.sqrt((direction**2).sum())
        direction = direction * np.sign(direction[np.abs(direction).argmax()])
        largest = np.argsort(-np.abs(direction), kind="stable")[:SHOWN]
        named = components(layout.hidden)
        parts = [f"{direction[k]:.3g} {named[k]}" for k in largest if abs(direction[k]) > 1e-6]
        return " + ".join(parts).replace("+ -", "- ") + (", ..." if layout.size > SHOWN else "")
    return ""


def indefinite_noise(cpd: CPD) -> NumericalError:
    """The error that the noise covariance of a linearised CPD is indefinite.

    That covariance is the CPD's own, plus that of the linearisation's error.
    """
    return NumericalError(
        f"the noise of {cpd!r} plus the lineariser's approximation error is indefinite; use a "
        "rule with positive weights, or more samples",
        variable=cpd.child,
        cpd=cpd,
    )
