"""Discrete chains and grids of the benchmark: their work is what it is called."""

import numpy as np
import pytest

import pgm
from benchmarks.libraries import pgm_chains, pgm_rooms
from benchmarks.rows import ROWS
from benchmarks.work import chains, robots, rooms

BY_NAME = {row.name: row for row in ROWS}


def textbook(first, motion, sensor, symbols):
    """The smoothed beliefs of a hidden Markov model, step by step there and back."""
    known, message = [first * sensor[:, symbols[0]]], np.ones(len(first))
    for symbol in symbols[1:]:
        known.append(sensor[:, symbol] * (known[-1] @ motion))
        known[-1] /= known[-1].sum()
    found = []
    for belief, symbol in zip(known[::-1], symbols[::-1], strict=True):
        found.append(belief * message / (belief @ message))
        message = motion @ (sensor[:, symbol] * message)
        message /= message.sum()
    return np.array(found[::-1])


@pytest.mark.parametrize(("states", "steps", "runs"), [(10, 200, 1), (40, 30, 1), (40, 30, 3)])
def test_chains_are_smoothed_as_in_a_textbook(states, steps, runs):
    work = chains.draw(states, steps, runs)
    found = pgm_chains.together(work).call()
    assert found.shape == (runs, steps, states)
    for run in range(runs):
        due = textbook(*work.tables, work.readings[run])
        np.testing.assert_allclose(found[run], due, rtol=0, atol=1e-13)
    np.testing.assert_allclose(pgm_chains.alone(work).call()[0], found[0], rtol=0, atol=1e-13)


def test_shifts_on_a_map_are_smoothed_as_their_matrix():
    work = chains.shifting((6, 5), 25)
    prior, motion, sensor = (np.array(cpd.table) for cpd in work.network.cpds)
    assert motion.shape == (30, 30)
    np.testing.assert_allclose(motion.sum(axis=1), 1.0, rtol=0, atol=1e-12)
    due = textbook(prior @ motion, motion, sensor, work.readings[0])
    found = pgm_chains.smoothing(work).call()
    np.testing.assert_allclose(found, due, rtol=0, atol=1e-12)


def test_rows_of_chains_have_the_sizes_that_were_asked_for():
    sizes = {name: BY_NAME[name].size for name in BY_NAME if name.startswith("markov")}
    assert sizes["markov_100"] == 2_000
    assert sizes["markov_10"] == 10_000
    work = BY_NAME["markov_runs"].work(1)
    assert (work.runs, work.state.size) == (64, 1_000)
    assert BY_NAME["markov_shifts"].work(1).state.size == 100_000


@pytest.mark.parametrize("kind", rooms.KINDS)
def test_a_robot_stays_in_its_room_and_the_grid_finds_it(kind):
    work = rooms.draw(12, kind)
    assert work.readings.shape == (1, 12, 2, 2)
    assert (np.abs(work.truth[0, :, :2]) < rooms.ROOM / 2.0).all()
    contender = pgm_rooms.on_grid("smoother", work)
    values = contender.call()
    assert values.shape == (13, *rooms.CELLS)
    assert contender.units == 12 * np.prod(rooms.CELLS)
    np.testing.assert_allclose(values.sum(axis=(1, 2, 3)), 1.0, rtol=0, atol=1e-9)
    if not kind:
        gaussian = pgm.smooth(work.network, work.evidence(0), iterations=10)[robots.pose]
        east = np.linspace(-5.0, 5.0, 100, endpoint=False) + 0.05
        means = values.sum(axis=(2, 3)) @ east
        assert np.abs((means - gaussian.mean[:, 0]) / gaussian.std[:, 0]).max() < 0.5


@pytest.mark.filterwarnings("ignore:::stonesoup")
def test_stone_soup_filters_a_robot_that_stands_still():
    pytest.importorskip("stonesoup", reason="stonesoup comes with the extra bench")
    from benchmarks.libraries import stonesoup_rooms

    work = rooms.draw(1)
    contender = stonesoup_rooms.filtering(work)
    (weights,) = contender.call()
    assert contender.units == len(weights) == np.prod([cells | 1 for cells in rooms.CELLS])
    assert np.isfinite(weights).all()
    assert (weights >= 0.0).all()
