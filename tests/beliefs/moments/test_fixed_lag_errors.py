"""Fixed lags that are refused, and errors on the way."""

from functools import partial

import numpy as np
import pytest
from robots import DRIVE, SENSORS, drive_cpd, network, sighted, x
from textbooks import refusal

import pgm

SIGHT = SENSORS["range_bearing"]
ROBOT = network(SIGHT.cpd())


def infer(schedule, **options):
    return pgm.infer(pgm.compile(ROBOT, 12), sighted(), schedule=schedule, **options)


def static(method=None):
    a, b, c = pgm.variables("a b c")
    net = pgm.BayesianNetwork(
        [
            pgm.GaussianCPD(a, 0.0, 1.0),
            pgm.LinearGaussianCPD(b, {a: 1.0}, cov=1.0),
            pgm.LinearGaussianCPD(c, {a: 1.0, b: 0.5}, cov=1.0),
        ]
    )
    return pgm.compile(net, method=method)


NO_TIME = "only a dynamic network is filtered, or smoothed by a lag", "which FixedLag(lag=2,"
REFUSALS = [
    *(
        refusal(
            f"a lag of {odd!r}",
            lambda odd=odd: pgm.FixedLag(odd),
            pgm.ModelError,
            f"FixedLag(lag={odd!r}, iterations=1",
            f"a lag is a whole number of steps, 0 or more, not {odd!r}",
            "pgm.Smoothing()",
        )
        for odd in (-1, 1.5, np.inf, True, "5", None)
    ),
    refusal(
        "no iteration",
        lambda: pgm.FixedLag(2, iterations=0),
        pgm.ModelError,
        "iterations, which count linearisations, must be a whole number, 1 or more, not 0",
    ),
    refusal(
        "no tolerance",
        lambda: pgm.FixedLag(2, tolerance=-1.0),
        pgm.ModelError,
        "a tolerance must be 0 or more, not -1.0",
    ),
    refusal(
        "too much damping",
        lambda: pgm.smooth(ROBOT, sighted(), lag=2, damping=1.0),
        pgm.ModelError,
        "damping is the share of the old point",
        "not 1.0",
    ),
    refusal(
        "a tree without time",
        lambda: pgm.infer(static(), {}, schedule=pgm.FixedLag(2)),
        pgm.GraphError,
        *NO_TIME,
    ),
    refusal(
        "a graph with loops",
        lambda: pgm.infer(static(pgm.Bethe()), {}, schedule=pgm.FixedLag(2)),
        pgm.GraphError,
        *NO_TIME,
        "on a graph with loops give pgm.Flooding()",
    ),
    refusal(
        "a balanced tree",
        lambda: pgm.smooth(ROBOT, sighted(), lag=2, method=pgm.Balanced()),
        pgm.GraphError,
        "FixedLag(lag=2, iterations=1",
        "goes along a chain of slices",
        "compile without pgm.Balanced()",
    ),
    refusal(
        "a start",
        lambda: infer(pgm.FixedLag(2), start={x: np.zeros((13, 3))}),
        pgm.EvidenceError,
        "a start is for smoothing all at once, not FixedLag(lag=2",
    ),
    refusal(
        "costs that do not exist",
        lambda: pgm.smooth(
            network(SIGHT.cpd(cov=np.diag([0.0, 0.01]))),
            sighted(),
            lag=2,
            iterations=3,
            damping=pgm.LevenbergMarquardt(),
        ),
        pgm.ModelError,
        "its noise is singular",
        "use damping=0.5",
    ),
    refusal(
        "a schedule of loops",
        lambda: infer(pgm.Flooding()),
        pgm.ModelError,
        "a chain of slices takes pgm.Filtering(), pgm.FixedLag(...) or pgm.Smoothing(), not Flood",
    ),
    refusal(
        "the filter of what was kept",
        lambda: pgm.smooth(ROBOT, sighted(), lag=2, keep=x).filtered,
        pgm.errors.Unanswered,
        "keep= keeps fixed-lag (2) marginals",
    ),
]


@pytest.mark.parametrize("row", REFUSALS, ids=lambda row: row.name)
def test_refusals(row):
    row.check()


@pytest.mark.parametrize("iterations", [1, 3])
def test_errors_of_a_step_name_it(iterations):
    """In the first window that has it; functions that fail, values that are not finite."""
    evidence = sighted()

    def lost(state, control):
        return np.where(state[..., :1] > 1.0, np.nan, DRIVE(state, control))

    def broken(state, mark):
        if np.any(state[..., 0] > 1.0):
            raise OverflowError("too far")
        return SIGHT.function(state, mark)

    move = drive_cpd(function=lost)
    see = SIGHT.cpd(function=broken)
    due = []
    for model, kind in (
        (network(SIGHT.cpd(), transition=move), pgm.LinearisationError),
        (network(see), pgm.ModelError),
    ):
        for call in (
            partial(pgm.filter, model, evidence),
            partial(pgm.smooth, model, evidence, lag=3, iterations=iterations),
        ):
            with pytest.raises(kind) as caught:
                call()
            due.append((caught.value.step, caught.value.cpd))
    assert due[0] == due[1]
    assert due[2] == due[3]
