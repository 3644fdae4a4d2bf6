"""Neighbours must be what they are called, and find by machine code what NumPy finds."""

import numpy as np
import pytest

import pgm
from benchmarks import inside, timing
from benchmarks import neighbours as near
from benchmarks.work import neighbours, robots
from models import sensors
from models.networks import sighting

pytest.importorskip("llvmlite", reason="sweeps are compiled by llvmlite")

INFERRED = [each for each in near.NEIGHBOURS if each.asked is not None]
WORK = robots.draw(1, 60)  # a reading of which is beyond a gate


@pytest.mark.parametrize("each", INFERRED, ids=lambda each: f"{each.row}_{each.name}")
def test_neighbours_find_what_numpy_finds(each):
    found, due, plain = (
        make(WORK, compiled=compiled).call()
        for make, compiled in ((each.make, True), (each.make, False), (near.PLAINS[each.row], True))
    )
    for one, other in zip(found, due, strict=True):
        np.testing.assert_allclose(one, other, rtol=0, atol=1e-9)
    assert (np.abs(found[0] - plain[0]).max() < 1e-9) == each.same


@pytest.mark.parametrize("row", near.ROWS, ids=lambda row: row.name)
def test_neighbours_that_find_the_same_are_held_to_it(row):
    ready, missing = row.prepared(3)
    assert not missing
    assert next(iter(ready)) == near.PLAIN
    row.agree(ready, 3)
    assert {contender.units for contender in ready.values()} == {3}
    kind = row.name.split("_")[1]
    same = {each.name for each in INFERRED if each.same and each.row == kind}
    assert same == set(row.contenders) - row.unchecked - {near.PLAIN}


def test_time_in_machine_code_is_a_part_of_a_calls():
    swept, plain = (near.PLAINS["filter"](WORK, compiled=each) for each in (True, False))
    times = inside.least({"swept": swept, "plain": plain}, 3)
    assert set(times) == {"swept"}
    assert 0.0 < times["swept"] < timing.seconds(swept.call) / swept.units


def test_sightings_are_as_many_as_they_are_called():
    assert neighbours.grouped(WORK).landmarks.shape[1] == 3
    assert neighbours.grouped(WORK).network.observation[0].grouped
    assert neighbours.ten_landmarks(WORK).landmarks.shape[1] == 10
    assert len(neighbours.three_sensors(WORK).network.observation) == 3


@pytest.mark.parametrize(("steps", "count"), [(400, 20), (30, 15), (7, 7)])
def test_candidates_are_of_the_landmarks_that_are_seen(steps, count):
    work = neighbours.unknown_landmark(robots.draw(1, steps))
    graph = pgm.compile(work.network, steps)
    posterior = pgm.infer(graph, work.evidence(0), schedule=pgm.Filtering())
    taken = posterior.associations[sighting].probability
    assert taken.shape == (steps, count + 2)  # and what is spurious, or new


def test_functions_that_are_called_back_are_those_of_the_model_but_have_no_trace():
    x, u, m = WORK.truth[0, 1:], WORK.controls, WORK.landmarks[:, 0]
    np.testing.assert_allclose(neighbours.branching(x, u), robots.DRIVE(x, u), atol=1e-12)
    np.testing.assert_allclose(
        neighbours.branching(x[1:], u[1:]), robots.DRIVE(x[1:], u[1:]), atol=1e-12
    )
    seen = sensors.range_bearing(x, m)
    apart = np.angle(np.exp(1j * (neighbours.looked_up(x, m) - seen)))
    np.testing.assert_allclose(apart, 0.0, atol=1e-12)
    for change, place in ((neighbours.branch, "transition"), (neighbours.table, "observation")):
        network = change(WORK).network
        told = pgm.compile(network, 60, compiled=True).compilation
        (cpd,) = getattr(network, place)
        assert told[cpd].startswith("called back")


def test_limits_are_those_that_are_asked():
    limits = {(each.row, each.name): each.asked for each in INFERRED}
    six = ("gate", "grouped", "sensors", "iterations_2", "iterations_5", "unscented", "huber")
    assert limits == {
        **{("filter", name): 6.0 for name in six},
        ("filter", "student_t"): 10.0,
        ("filter", "ten"): 10.0,
        ("filter", "hermite"): 14.0,
        ("filter", "control"): 16.0,
        ("filter", "unknown"): 60.0,
        ("filter", "lag"): 40.0,
        ("filter", "branch"): 15.0,
        ("filter", "table"): 15.0,
        ("smoother", "gate"): 6.0,
        ("smoother", "unscented"): 6.0,
        ("smoother", "control"): 16.0,
        **{("online", name): 8.0 for name in ("gate", "lag", "watch")},
    }
