"""Curves of statistics that are hard to draw, each as a function that draws it."""

from __future__ import annotations

import numpy as np

import pgm
import pgm.plot
from models import networks
from models.networks import fix, point, shift
from tests.plot.beliefs.zoo import loop

STEPS = 25


def over(draw, count):
    """Curves of some beliefs on one axes."""
    ax = None
    for k in range(count):
        model = networks.linear()
        sample = model.sample({shift: np.zeros((STEPS, 2))}, runs=20, rng=k)
        ax = draw(pgm.filter(model, sample.evidence), sample[point], f"belief {k}", ax)
    return ax


def errors(count, components=None, steps=101):
    axes = None
    for k in range(count):
        belief, truth = loop(steps, seed=k)
        axes = pgm.plot.errors(
            belief, truth, label=f"belief {k}", axes=axes, unit="m", components=components
        )
    return axes


def convergence(count, runs=1, zero=False):
    ax = None
    for k in range(count):
        rng = np.random.default_rng(k)
        residuals = 10.0 ** (-np.arange(30)[:, None] * (0.2 + 0.1 * rng.random(runs)))
        if zero:
            residuals[-5:] = 0.0
        status = pgm.results.Status(30, residuals, np.ones(runs, bool))
        ax = pgm.plot.convergence(status, tolerance=1e-6, label=f"schedule {k}", ax=ax)
    return ax


_a, _z = pgm.Variable("a"), pgm.Variable("z")


def compared(linearisers, schedules=None):
    model = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(_a, [0.5], 1.0)],
        [pgm.LinearGaussianCPD(_a, {_a.previous: 1.0}, cov=0.2)],
        [pgm.NonlinearGaussianCPD(_z, _a, lambda a: np.sqrt(4.0 + np.abs(a)), cov=0.5)],
    )
    evidence = {_z: pgm.sightings(np.full((31, 1), 2.2), step=np.arange(31))}
    found = pgm.compare(
        model,
        evidence,
        linearisers={f"rule {k}": pgm.Unscented(alpha=1.0 + 0.3 * k) for k in range(linearisers)},
        oracle=pgm.Grid({"a": (-6.0, 8.0, 120)}),
        truth={_a: np.full((31, 1), 0.8)},
        steps=30,
    )
    return pgm.plot.comparison(found)


def studied(count):
    methods = {f"rule {k}": pgm.Unscented(alpha=1.0 + 0.3 * k) for k in range(count)}
    found = pgm.study(
        networks.linear(), {shift: np.zeros((STEPS, 2))}, runs=50, methods=methods, seed=1
    )
    return pgm.plot.study(found)


def _rmse(posterior, truth, label, ax):
    return pgm.plot.rmse(posterior[point], truth, label=label, ax=ax, unit="m")


def _nees(posterior, truth, label, ax):
    return pgm.plot.nees(posterior[point], truth, label=label, ax=ax)


def _nis(posterior, truth, label, ax):
    return pgm.plot.nis(posterior.innovations[fix], label=label, ax=ax)


def _coverage(posterior, truth, label, ax):
    return pgm.plot.coverage(posterior[point], truth, label=label, ax=ax)


def _whiteness(posterior, truth, label, ax):
    return pgm.plot.whiteness(posterior.innovations[fix], label=label, ax=ax)


def _kl(posterior, truth, label, ax):
    return pgm.plot.kl(posterior[point], posterior.predicted[point], label=label, ax=ax)


STATISTICS = {
    "errors": lambda: errors(1),
    "errors two": lambda: errors(2),
    "errors nine": lambda: errors(9),
    "errors one step": lambda: errors(1, steps=1, components=("east",)),
    **{
        f"{draw.__name__[1:]} {count}": lambda d=draw, n=count: over(d, n)
        for draw in (_rmse, _nees, _nis, _coverage, _whiteness, _kl)
        for count in (1, 2, 9)
    },
    "convergence": lambda: convergence(1),
    "convergence nine": lambda: convergence(9, runs=3, zero=True),
    "convergence runs": lambda: convergence(2, runs=30, zero=True),
    "comparison 2": lambda: compared(2),
    "comparison 9": lambda: compared(9),
    "study 2": lambda: studied(2),
    "study 9": lambda: studied(9),
}
