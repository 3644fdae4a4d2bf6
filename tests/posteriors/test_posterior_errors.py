"""Errors of graphs and schedules, and of questions to a posterior."""

import numpy as np
import pytest
from refusing import CALLS, EVIDENCE, T, U, a, b, c, model_row, robot, z
from robots import u, x
from textbooks import refusal

import pgm
from pgm import EvidenceError, GraphError, LinearisationError, ModelError
from pgm.clustergraph import check_families, check_running_intersection

GRAPH = pgm.compile(robot()[0], steps=T)
FILTERED = pgm.filter(robot()[0], EVIDENCE)
SMOOTHED = pgm.smooth(robot()[0], EVIDENCE)


def graph_row(name, call, *words, **attributes):
    return refusal(name, call, GraphError, *words, **attributes)


def asked(name, call, *words, **attributes):
    return refusal(name, call, EvidenceError, *words, **attributes)


GRAPHS = [
    graph_row(
        "a family that its cluster lacks",
        lambda: check_families([(a, b), (b, c)], [[(a, b)], [(c, a)]]),
        "family preservation",
        "cluster 1",
        "(a)",
        variable=a,
        cluster=1,
    ),
    graph_row(
        "a family in no cluster",
        lambda: check_families([(a, b)], [[(a, b)]], families=[(a, b), (b,)]),
        "family preservation",
        "b",
        "0 clusters",
        variable=b,
    ),
    graph_row(
        "a family in two clusters",
        lambda: check_families([(a, b), (a, b)], [[(a, b)], [(a, b)]]),
        "family preservation",
        "2 clusters",
        variable=a,
    ),
    graph_row(
        "a variable in two parts",
        lambda: check_running_intersection([(a, b), (b,), (a, b)], {(0, 1): (b,), (1, 2): (b,)}),
        "running intersection",
        "a",
        "[0]",
        "[2]",
        "add it to the sepsets",
        variable=a,
    ),
    graph_row(
        "a variable around a loop",
        lambda: check_running_intersection(
            [(a,), (a,), (a,)], {(0, 1): (a,), (1, 2): (a,), (0, 2): (a,)}
        ),
        "running intersection",
        "a",
        "loop",
        "take it out",
        variable=a,
    ),
    graph_row(
        "a sepset with a stranger",
        lambda: check_running_intersection([(a, b), (b, c)], {(0, 1): (a,)}),
        "sepset",
        "a",
        "cluster 1",
        variable=a,
        cluster=1,
    ),
    graph_row("no steps", lambda: pgm.compile(robot()[0]), "steps=T", "None"),
    graph_row("negative steps", lambda: pgm.compile(robot()[0], -1), "steps=T", "-1"),
    graph_row("half a step", lambda: pgm.compile(robot()[0], 2.5), "steps=T", "2.5"),
    refusal("no network", lambda: pgm.compile(GRAPH, 3), ModelError, "network"),
    graph_row("a model for a graph", lambda: pgm.infer(robot()[0], EVIDENCE), "pgm.compile"),
    refusal("a graph for a model", lambda: pgm.filter(GRAPH, EVIDENCE), ModelError, "network"),
    graph_row("no such cluster", lambda: SMOOTHED.belief(T + 1), "0..4", "5", cluster=T + 1),
    graph_row("cluster -1", lambda: SMOOTHED.belief(-1), "0..4", "-1", cluster=-1),
    graph_row("no neighbours", lambda: SMOOTHED.message(1, 3), "1", "3", "not joined", cluster=1),
    graph_row("a message to itself", lambda: SMOOTHED.message(2, 2), "not joined", cluster=2),
    graph_row(
        "what a filter does not send",
        lambda: FILTERED.message(3, 2),
        "not sent",
        "is filtered",
        "3",
        "2",
        "pgm.smooth",
        cluster=3,
    ),
]

STATES = np.zeros((T + 1, 3))


def smooth(**options):
    return lambda: pgm.smooth(robot()[0], EVIDENCE, **options)


SCHEDULES = [
    model_row("no iterations", lambda: pgm.Smoothing(iterations=0), "iterations", "0", "1 or more"),
    model_row("no iterations of smooth", smooth(iterations=0), "iterations", "0", "1 or more"),
    model_row("half an iteration", lambda: pgm.Smoothing(iterations=1.5), "iterations", "1.5"),
    model_row("true iterations", lambda: pgm.Smoothing(iterations=True), "iterations", "True"),
    model_row("a negative tolerance", lambda: pgm.Smoothing(tolerance=-1.0), "tolerance", "-1"),
    model_row("no tolerance", lambda: pgm.Smoothing(tolerance=np.nan), "tolerance", "nan"),
    model_row(
        "a schedule in words",
        lambda: pgm.infer(GRAPH, EVIDENCE, schedule="smooth"),
        "smooth",
        "pgm.Smoothing()",
    ),
    model_row("a lineariser in words", smooth(lineariser="Taylor"), "Taylor", "pgm.Taylor()"),
    model_row(
        "a lineariser in words online",
        lambda: pgm.OnlineFilter(robot()[0], "Taylor"),
        "Taylor",
        "pgm.Taylor()",
    ),
    asked(
        "a start for a filter",
        lambda: pgm.infer(GRAPH, EVIDENCE, schedule=pgm.Filtering(), start={x: STATES}),
        "start",
        "smoothing",
    ),
    asked("a start without its variable", smooth(start=STATES), "start", "ndarray"),
    asked("an empty start", smooth(start={}), "start lacks x", variable=x),
    asked("a start of an input", smooth(start={x: STATES, u: U}), "u", "not hidden", variable=u),
    asked("a start of T rows", smooth(start={x: STATES[1:]}), "x", "4", "0..4", variable=x),
    asked("a start of 2 components", smooth(start={x: STATES[:, :2]}), "x", "(5, 2)", variable=x),
    asked("a start of NaN", smooth(start={x: STATES * np.nan}), "x", "NaN", variable=x),
    asked("a start of runs", smooth(start={x: np.zeros((3, T + 1, 3))}), "x", "(3", variable=x),
    refusal(
        "points without weight",
        smooth(lineariser=pgm.Unscented(alpha=1.0, kappa=-3.0)),
        LinearisationError,
        "kappa=-3.0",
        "positive",
    ),
    refusal("no samples", lambda: pgm.MonteCarlo(0), LinearisationError, "samples=0", "from 1"),
]

ASKED = [
    asked("an observed variable", lambda: SMOOTHED[z], "z", ".innovations[z]", variable=z),
    asked("one reading", lambda: SMOOTHED[z.at(2)], ".innovations", variable=z.at(2)),
    asked("an input", lambda: SMOOTHED[u], "u", "an input", "evidence", variable=u),
    asked("a stranger", lambda: SMOOTHED[a], "a", "hidden", "x", variable=a),
    asked("the step before", lambda: SMOOTHED[x.previous], "x[t-1]", variable=x.previous),
    asked(
        "a step past the end",
        lambda: SMOOTHED[x.at(T + 1)],
        "x[5]",
        "0..4",
        variable=x.at(5),
        step=5,
    ),
    asked(
        "a prediction past the end",
        lambda: FILTERED.predicted[x.at(T + 1)],
        "x[5]",
        "0..4",
        variable=x.at(5),
        step=5,
    ),
    asked("a joint without steps", lambda: SMOOTHED.joint(x), "x.at(3)", variable=x),
    asked(
        "a joint with a reading", lambda: SMOOTHED.joint(x.at(1), z.at(1)), "z", variable=z.at(1)
    ),
    asked("a joint past the end", lambda: SMOOTHED.joint(x.at(1), x.at(9)), "x[9]", step=9),
]

TABLE = GRAPHS + SCHEDULES + ASKED


@pytest.mark.parametrize("refused", TABLE, ids=lambda r: r.name)
def test_every_refusal(refused):
    refused.check()


# A rule is asked for its points when it meets a function: those rows are no part of this.
EARLY = [row for row in SCHEDULES if row.error is not LinearisationError]


@pytest.mark.parametrize("refused", EARLY, ids=lambda r: r.name)
def test_schedules_and_starts_are_refused_before_any_call(refused):
    CALLS.clear()
    refused.check()
    assert not CALLS


def test_the_robot_of_these_tests_runs():
    """Else the rows would say nothing."""
    assert pgm.smooth(robot()[0], EVIDENCE, iterations=2, tolerance=0)[x].mean.shape == (T + 1, 3)
    GRAPH.check()


def test_whole_numbers_of_numpy_are_whole_numbers():
    """As in steps=step.max()."""
    steps = np.int64(T)
    assert pgm.smooth(robot()[0], EVIDENCE, steps=steps)[x].mean.shape == (T + 1, 3)
    assert pgm.compile(robot()[0], steps=steps).steps == T
    assert SMOOTHED.message(np.int64(1), np.int64(2)).scope == (x.at(1),)
    assert pgm.Smoothing(iterations=np.int64(2)).iterations == 2
