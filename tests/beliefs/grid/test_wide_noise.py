"""Noise that is wide for a grid: round a circle more than once, or beyond the bounds."""

import tracemalloc

import numpy as np
import pytest
from numpy.testing import assert_allclose

import pgm
from pgm.errors import ModelError

pose = pgm.Variable("pose", components=("place", "heading"), angles=("heading",))
turn = pgm.Variable("turn")
reading = pgm.Variable("reading")
GRID = pgm.Grid({"place": (-5.0, 5.0, 50), "heading": 72})


def walk(prior=(0.1, 0.1), noise=((0.1, 0.0), (0.0, 0.1))):
    return pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(pose, [0.0, 0.0], np.diag(prior))],
        [pgm.LinearGaussianCPD(pose, {pose.previous: np.eye(2)}, cov=noise)],
        [pgm.LinearGaussianCPD(reading, {pose: [[1.0, 0.0]]}, cov=0.3)],
    )


@pytest.mark.parametrize("deviation", [1.0, np.pi, 2.0 * np.pi, 6.5])
def test_a_hidden_turn_goes_round(deviation):
    """The resultant of a wrapped normal is e^(−σ²/2); a deviation of a full turn is not none."""
    heading = pgm.Variable("heading", components=("heading",), angles=("heading",))
    net = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(heading, [0.0], [[0.02]])],
        [
            pgm.GaussianCPD(turn, 0.0, deviation**2),
            pgm.LinearGaussianCPD(heading, {heading.previous: 1.0, turn: 1.0}, cov=0.01),
        ],
        [pgm.LinearGaussianCPD(reading, {heading: 1.0}, cov=0.3)],
    )
    found = pgm.filter(net, {}, steps=1, belief=pgm.Grid({"heading": 72}))[heading.at(1)]
    resultant = abs(found.values @ np.exp(1j * found.centres[0]))
    assert_allclose(resultant, np.exp(-0.5 * (0.03 + deviation**2)), atol=1e-9)


@pytest.mark.parametrize("variance", [1e6, 1e18, 1e30])
@pytest.mark.parametrize("when", ["prior", "noise"])
def test_a_wide_heading_is_flat(variance, when):
    net = walk(prior=(0.1, variance)) if when == "prior" else walk(noise=np.diag([0.1, variance]))
    found = pgm.filter(net, {}, steps=1, belief=GRID)[pose.at(1)]
    assert_allclose(found.marginal("heading").values, 1.0 / 72.0, rtol=1e-12)
    assert_allclose(found.marginal("place").cov, 0.2, rtol=1e-9)


@pytest.mark.parametrize("variance", [1e6, 1e18, 1e30])
@pytest.mark.parametrize(
    ("make", "step"),
    [
        (lambda v: walk(prior=(v, 0.1)), 0),
        (lambda v: walk(noise=np.diag([v, 0.1])), 1),
        (lambda v: walk(noise=[[v, 0.5 * v], [0.5 * v, v]]), 1),
    ],
    ids=["prior", "noise", "correlated"],
)
def test_noise_beyond_the_bounds_is_refused(make, step, variance):
    """In words, and before memory is taken for kernels of so many cells."""
    with pytest.raises(ModelError, match=f"noise of place at step {step}, run 0, deviates by"):
        pgm.filter(make(variance), {}, steps=1, belief=GRID)


def test_noise_of_a_control_that_is_too_wide_is_refused():
    net = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(pose, [0.0, 0.0], np.eye(2))],
        [
            pgm.GaussianCPD(turn, 0.0, 1e24),
            pgm.LinearGaussianCPD(
                pose, {pose.previous: np.eye(2), turn: [[1.0], [0.0]]}, cov=np.eye(2)
            ),
        ],
        [pgm.LinearGaussianCPD(reading, {pose: [[1.0, 0.0]]}, cov=0.3)],
    )
    with pytest.raises(ModelError, match="spreads over so many cells"):
        pgm.filter(net, {}, steps=1, belief=GRID)


def test_kernels_of_many_nodes_are_not_all_held():
    """A hidden control whose effect depends on the place: hundreds of nodes at every cell."""
    plane = pgm.Variable("plane", components=("east", "north"))
    push = pgm.Variable("push", components=("east", "north"))

    def pushed(plane, push):
        more = 0.1 * np.sin(plane[..., :1]) * np.cos(plane[..., 1:])
        return plane + push * (1.0 + more * [1.0, 0.0])

    net = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(plane, [0.0, 0.0], np.eye(2))],
        [
            pgm.GaussianCPD(push, [0.0, 0.0], 0.16 * np.eye(2)),
            pgm.NonlinearGaussianCPD(plane, (plane.previous, push), pushed, 0.07 * np.eye(2)),
        ],
    )
    on = pgm.Grid({"east": (-8.0, 8.0, 60), "north": (-8.0, 8.0, 60)})
    tracemalloc.start()
    found = pgm.filter(net, {}, steps=1, belief=on)
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert most < 2**28
    # E (1 + .1 sin x cos y)² of standard normal x, y is 1 + .0025 (1 − e⁻⁴).
    due = 1.07 + 0.16 * np.array([1.0 + 0.0025 * (1.0 - np.exp(-4.0)), 1.0])
    assert_allclose(found[plane.at(1)].cov, np.diag(due), atol=1e-6)
    assert found.status.split == ("east", "north")
