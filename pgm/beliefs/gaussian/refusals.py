"""Errors of Gaussian networks that more than one way of solving them raises."""

from __future__ import annotations

from pgm.beliefs.gaussian.layout import Layout
from pgm.beliefs.gaussian.model import Model
from pgm.cpds import CPD
from pgm.errors import NumericalError
from pgm.factors.scope import names


def contradiction(model: Model, cluster: int, run: int) -> NumericalError:
    """The error that measurements contradict CPDs without noise, naming the cluster and the run.

    `cluster` and `run` are their numbers; without axes of runs the run is not named.
    """
    scope = model.layout.graph.clusters[cluster].scope
    which = f", run {run}" if model.lead else ""
    return NumericalError(
        f"evidence contradicts an exact model at cluster {cluster}, {names(scope)}{which}: "
        "CPDs without noise determine a value in two ways that differ; give one of them, or "
        "the prior, some noise",
        cluster=cluster,
    )


def improper(layout: Layout, cluster: int) -> NumericalError:
    """The error that a cluster, by its number, has no proper belief, or the evidence no density."""
    scope = layout.scopes[cluster]
    if not scope:
        return NumericalError(
            f"the density of the evidence in cluster {cluster} is beyond the range of float64: "
            "a measurement is more than 1e150 deviations from what the model expects",
            cluster=cluster,
        )
    return NumericalError(
        f"cluster {cluster} has no proper belief over {names(scope)}: its information is "
        "singular in these numbers. Some noise is more than 1e11 times sharper than what else "
        "is known of its variables, or, on a graph with loops, messages diverged or CPDs "
        "without noise form a loop; scale the noise, or compile a junction tree",
        cluster=cluster,
    )


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
