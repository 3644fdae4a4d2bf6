"""Options given as what they are if they are left out, whatever their type; and all others."""

import numpy as np
import pytest

import pgm
from pgm.examples import a, b, pair, walk, z
from pgm.schedules.options import is_left
from tests.beliefs.own.kalman import Kalman

DOOR, SEEN = (pgm.Discrete(name, states=("open", "shut")) for name in ("door", "seen"))
TABLE = [[0.9, 0.1], [0.2, 0.8]]
HMM = pgm.DynamicBayesianNetwork(
    [pgm.TableCPD(DOOR, table=[0.5, 0.5])],
    [pgm.TableCPD(DOOR, DOOR.previous, table=TABLE)],
    [pgm.TableCPD(SEEN, DOOR, table=TABLE)],
)
STATES = pgm.BayesianNetwork(
    [pgm.TableCPD(DOOR, table=[0.5, 0.5]), pgm.TableCPD(SEEN, DOOR, table=TABLE)]
)
READINGS = {z: [[4.0], [3.0]]}
FAMILIES = {
    "moments": (walk, READINGS, None),
    "tables": (HMM, {SEEN: [0, 1]}, None),
    "grid": (walk, READINGS, pgm.Grid({"x": (-8.0, 12.0, 50)})),
    "particles": (walk, READINGS, pgm.Particles(500, seed=0)),
    "own": (walk, READINGS, Kalman()),
}
NOT_MOMENTS = [name for name in FAMILIES if name != "moments"]
NO_WATCH_OR_LAG = [name for name in NOT_MOMENTS if name != "tables"]


@pytest.mark.parametrize("name", FAMILIES)
@pytest.mark.parametrize("call", [pgm.filter, pgm.smooth])
@pytest.mark.parametrize(
    "left",
    [
        {"damping": 0},
        {"damping": np.float64(0.0)},
        {"iterations": np.int64(1)},
        {"gate": None, "keep": None},
        {"lineariser": pgm.Taylor()},
    ],
    ids=str,
)
def test_an_option_given_as_its_default_is_left_out(name, call, left):
    model, evidence, belief = FAMILIES[name]
    due = call(model, evidence, belief=belief).log_evidence
    assert call(model, evidence, belief=belief, **left).log_evidence == due


@pytest.mark.parametrize("name", NOT_MOMENTS)
@pytest.mark.parametrize(
    "given", [{"damping": 0.5}, {"iterations": np.int64(2)}, {"gate": 0.9}], ids=str
)
def test_any_other_value_is_refused(name, given):
    model, evidence, belief = FAMILIES[name]
    with pytest.raises(pgm.ModelError, match="leave"):
        pgm.smooth(model, evidence, belief=belief, **given)


@pytest.mark.parametrize("schedule", [pgm.Calibration(), pgm.Calibration(np.int64(1))], ids=str)
@pytest.mark.parametrize("method", [pgm.JunctionTree(), pgm.Bethe()], ids=str)
def test_without_time_what_linearises_is_idle(schedule, method):
    graph = pgm.compile(STATES, method=method)
    due = pgm.infer(graph, {SEEN: 0}).log_evidence
    for each in (schedule, pgm.Calibration(3), pgm.Smoothing(3), pgm.Smoothing(damping=0)):
        assert pgm.infer(graph, {SEEN: 0}, schedule=each).log_evidence == due
    assert pgm.infer(graph, {SEEN: 0}, lineariser=pgm.Unscented()).log_evidence == due
    graph = pgm.compile(pair, method=method)
    due = pgm.infer(graph, {b: [2.0]})[a].mean
    for damping in (0, 0.5, pgm.LevenbergMarquardt()):
        for kind in (pgm.Calibration, pgm.Smoothing):
            found = pgm.infer(graph, {b: [2.0]}, schedule=kind(damping=damping))
            assert found[a].mean == due


@pytest.mark.parametrize("name", FAMILIES)
@pytest.mark.parametrize(
    "left",
    [
        {"lag": None, "gate": None, "schedule": None, "watch": False, "compiled": None},
        {"schedule": pgm.Filtering(), "lineariser": pgm.Taylor(), "compiled": False},
        {"watch": np.False_},
    ],
    ids=str,
)
def test_online_options_may_be_given_as_left_out(name, left):
    model, _, belief = FAMILIES[name]
    assert pgm.OnlineFilter(model, belief=belief, **left).initial().step == 0


REFUSED = [
    *({"gate": value} for value in (0, 0.0, False, 0.9, np.array([0.9, 0.8]))),
    *({"lineariser": value} for value in (None, False, pgm.Unscented(), np.array([1.0, 2.0]))),
    *({"schedule": value} for value in (False, np.array([1, 2]), pgm.Filtering(gate=0.9))),
    *({"watch": value} for value in (True, np.True_, np.array([True, False]))),
]
LAGS = [{"lag": value} for value in (0, False, 1, np.array([1, 2]))]


@pytest.mark.parametrize("name", NO_WATCH_OR_LAG)
@pytest.mark.parametrize("given", [*REFUSED, *LAGS, {"schedule": pgm.FixedLag(1)}], ids=str)
def test_online_all_else_is_refused(name, given):
    """A 0 that is a lag or a gate is none of those left out, nor is an array."""
    model, _, belief = FAMILIES[name]
    with pytest.raises(pgm.ModelError, match="leave it out"):
        pgm.OnlineFilter(model, belief=belief, **given)


@pytest.mark.parametrize("given", REFUSED, ids=str)
def test_online_tables_refuse_it_too(given):
    with pytest.raises(pgm.ModelError):
        pgm.OnlineFilter(HMM, **given)
    assert pgm.OnlineFilter(HMM, lag=0).lag == 0


@pytest.mark.parametrize("watch", [1, "yes", np.array([True, False])])
def test_a_watch_that_is_neither_yes_nor_no_is_refused(watch):
    with pytest.raises(pgm.ModelError, match="watch is True or False"):
        pgm.OnlineFilter(walk, watch=watch)
    assert pgm.OnlineFilter(walk, watch=np.True_).watch is True


@pytest.mark.parametrize(
    ("value", "default", "due"),
    [
        (0, 0.0, True),
        (np.float32(0.0), 0.0, True),
        (False, 0.0, False),
        (0, False, False),
        (np.False_, False, True),
        (None, None, True),
        (0, None, False),
        (np.zeros(2), 0.0, False),
        (np.nan, 0.0, False),
        ("raise", "raise", True),
    ],
)
def test_what_is_left(value, default, due):
    assert is_left(value, default) is due
