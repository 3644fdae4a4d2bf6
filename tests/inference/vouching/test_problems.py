"""Estimates of problems drawn at random: those that are vouched for are right."""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
import pytest

import pgm
from pgm.inference.estimating import EFFORT
from tests.inference.vouching.problems import Block, Group, Tail, basins, group, judged, normal

# Groups of few components, a second or two each.
FAST = 0, 3, 4, 7, 8, 16, 17, 31


class Tally(NamedTuple):
    """Shares of problems of at most four modes.

    off, less: Of the vouched, those further from the truth than twice their bound, and from the
    truth less 1 % of its mass. few, several: Of the unimodal in up to 3 and in up to 6 components,
    those vouched for.
    """

    vouched: int
    off: float
    less: float
    few: float
    several: float


def tally(drawn: Iterable[Group], effort: int) -> Tally:
    found = []
    for k, each in enumerate(drawn):
        answer = pgm.estimate(each.model, each.evidence, effort=effort, steps=each.steps, rng=k)
        for run in range(each.runs):
            own = judged(each, answer, run)
            if own.resolved and own.modes <= 4:
                within = 2.0 * answer.verdict.within[run]
                vouched = answer.verdict.vouched[run]
                found.append((each.size, own.modes, vouched, own.off > within, own.less > within))
    size, modes, vouched, off, less = np.transpose(found)
    sure, one = vouched > 0, modes == 1
    return Tally(
        int(sure.sum()),
        float(off[sure].mean()),
        float(less[sure].mean()),
        float(vouched[one & (size <= 3)].mean()),
        float(vouched[one & (size <= 6)].mean()),
    )


@pytest.mark.filterwarnings("ignore")
def test_some_problems():
    found = tally((group(0, k, 8) for k in FAST), EFFORT)
    assert found.vouched >= 40
    assert found.off <= 0.05
    assert found.less <= 0.03
    assert found.few >= 0.85
    assert found.several >= 0.8


@pytest.mark.slow
@pytest.mark.parametrize(("effort", "wrong"), [(4000, 0.01), (EFFORT, 0.02)])
@pytest.mark.filterwarnings("ignore")
def test_two_thousand_problems(effort, wrong):
    found = tally((group(0, k, 20) for k in range(100)), effort)
    assert found.less <= wrong
    assert found.off <= 0.03
    assert found.few >= 0.9
    assert found.several >= 0.8


def test_quadrature_is_that_of_a_gaussian():
    """Of a block that is linear: against the joint Gaussian of all its variables."""
    x, y, w, z = pgm.Variable("x", components=("a", "b")), *pgm.variables("y w z")
    row = np.array([1.0, -0.5])
    mean, std = np.array([1.0, 2.0]), np.array([0.5, 2.0])
    tail = Tail(y, row, 0.4, w, 0.7)
    block = Block([x], mean, std, z, lambda x: x.sum(-1, keepdims=True), 0.3, [tail])
    seen = {z: np.array([3.5]), w: np.array([-1.0])}
    truth = block.truth(seen)
    assert truth.resolved
    assert truth.modes == pytest.approx([1.0])
    prior = np.diag(std**2)
    maps = np.concatenate([np.eye(2), row[None]])
    cross = maps @ prior @ maps.T + np.diag([0.0, 0.0, 0.4**2])
    reads = np.array([[1.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
    gain = np.linalg.solve(reads @ cross @ reads.T + np.diag([0.3**2, 0.7**2]), reads @ cross).T
    whole = cross - gain @ reads @ cross
    centre = np.append(mean, row @ mean)
    centre = centre + gain @ (np.array([3.5, -1.0]) - reads @ centre)
    for variable, place in ((x, slice(0, 2)), (y, slice(2, 3))):
        belief = truth.less(())[variable]
        own_mean, own_cov = belief.moments
        np.testing.assert_allclose(own_mean, centre[place], atol=1e-4)
        np.testing.assert_allclose(own_cov, whole[place, place], rtol=1e-3, atol=1e-5)
        same = np.ones(1), centre[None, place], whole[None, place, place]
        for of in ("density", "moments"):
            assert belief.divergence(of, *same) == pytest.approx(0.0, abs=1e-4)
        wide = np.ones(1), centre[None, place], 4.0 * whole[None, place, place]
        size = len(centre[place])
        expected = 0.5 * size * (0.25 - 1.0 + np.log(4.0))
        for of in ("density", "moments"):
            assert belief.divergence(of, *wide) == pytest.approx(expected, abs=1e-3)


def test_basins_are_the_modes_of_a_density():
    grid = np.linspace(-6.0, 6.0, 301)
    points = np.stack(np.meshgrid(grid, grid, indexing="ij"), -1).reshape(-1, 2)
    parts = [
        np.log(weight) + normal(points, np.array(mean), np.eye(2) * 0.5)
        for weight, mean in ((0.7, [2.0, 2.0]), (0.3, [-2.0, -1.0]))
    ]
    logs = np.logaddexp(*parts)
    labels = basins(logs.reshape(301, 301))
    mass = np.bincount(labels.ravel(), np.exp(logs))
    assert sorted(mass / mass.sum())[-2:] == pytest.approx([0.3, 0.7], abs=1e-3)
