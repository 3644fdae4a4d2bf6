"""Evidence far from what is believed: beliefs are carried up to 10⁻¹⁵, and what is lost is told."""

import warnings

import numpy as np
import pytest
from crossed import crossed
from numpy.testing import assert_allclose

import pgm
from pgm.beliefs.grid.cut_off import Tails
from pgm.beliefs.grid.lattice import resolve

place, reading = pgm.Variable("place"), pgm.Variable("reading")
GRID = pgm.Grid({"place": (-40.0, 40.0, 800)})


def line(cov=1.0, noise=0.04, sensor=0.2):
    return pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(place, 0.0, cov)],
        [pgm.LinearGaussianCPD(place, {place.previous: 1.0}, cov=noise)],
        [pgm.LinearGaussianCPD(reading, {place: 1.0}, cov=sensor)],
    )


def read(values, each=1):
    values = np.asarray(values, dtype=float)
    return {reading: pgm.sightings(values[:, None], step=np.arange(len(values)) // each)}


# Each is far from the Kalman filter's answer: 8.6 in place of 16.7, and so on.
LOST = {
    "one step": (line(), read([20.0]), 1, 0),
    "later": (line(), read([0.0, 0.0, 0.0, 0.0, 15.0]), 4, 4),
    "little by little": (line(noise=0.0, sensor=100.0), read(np.full(200, 20.0), 10), 19, None),
    "slow": (line(noise=1e-4, sensor=100.0), read(np.full(200, 20.0), 10), 19, None),
}


@pytest.mark.parametrize("case", LOST)
@pytest.mark.parametrize("infer", [pgm.filter, pgm.smooth])
def test_a_state_beyond_what_is_carried_is_told(case, infer):
    net, given, steps, step = LOST[case]
    with pytest.warns(pgm.GridWarning, match="cut off"):
        found = infer(net, given, steps=steps, belief=GRID)
    due = infer(net, given, steps=steps)
    assert np.abs(found[place].mean - due[place].mean).max() > 1.0
    assert found.status.cut.share > 0.5
    assert found.status.lost
    assert f"cut off at step {found.status.cut.step}" in repr(found.status)
    assert step is None or found.status.cut.step == step


@crossed(("case", "runs"), list(LOST), [(), (2,)])
def test_online_a_state_beyond_what_is_carried_is_told(case, runs):
    """One sighting after another; of two runs the second is as it should be."""
    net, given, steps, step = LOST[case]
    seen = given[reading]
    values, rows = np.asarray(seen.values), np.asarray(seen.step)
    if runs:
        values = np.stack([values, 0.0 * values])

    def filtered():
        robot = pgm.OnlineFilter(net, belief=GRID)
        belief = robot.initial()
        for t in range(steps + 1):
            belief = robot.predict(belief) if t else belief
            for k in np.flatnonzero(rows == t):
                belief = robot.update(belief, {reading: values[..., k, :]})
        return belief

    with pytest.warns(pgm.GridWarning, match="cut off"):
        belief = filtered()
    due = pgm.filter(net, given, steps=steps)[place].mean[-1, 0]
    assert abs(belief[place].mean.flat[0] - due) > 1.0
    assert belief.status.cut.share > 0.5
    assert step is None or belief.status.cut.step == step
    if runs:
        assert_allclose(belief[place].mean[1], 0.0, atol=1e-9)


def test_between_two_places_too():
    """Beliefs at −20 and 20 that a measurement of the square has left; the next one is of 0."""
    square = pgm.Variable("square")
    net = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(place, 0.0, 1e2)],
        [pgm.LinearGaussianCPD(place, {place.previous: 1.0}, cov=0.04)],
        [pgm.NonlinearGaussianCPD(square, (place,), lambda x: x**2, 100.0)],
    )
    given = {square: pgm.sightings([[400.0], [20.0]], step=[0, 1])}
    with pytest.warns(pgm.GridWarning, match="cut off"):
        found = pgm.filter(net, given, steps=1, belief=GRID)
    assert found.status.cut.step == 1


def test_online_tells_it_once():
    robot = pgm.OnlineFilter(line(), belief=GRID)
    belief = robot.predict(robot.initial())
    with pytest.warns(pgm.GridWarning, match="cut off"):
        belief = robot.update(belief, {reading: 20.0})
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        belief = robot.predict(belief)
    assert belief.status.cut == (1.0, 1)


def test_what_may_be_cut_bounds_the_error():
    """Of surprises of 4 to 8 deviations."""
    for value in (4.0, 5.0, 6.0, 7.0, 8.0):
        given = read([value * 1.2**0.5])
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", pgm.GridWarning)
            found = pgm.filter(line(), given, steps=0, belief=GRID)
        due = pgm.filter(line(), given, steps=0)
        error = abs(np.exp(found.log_evidence - due.log_evidence) - 1.0)
        assert error < 2.0 * found.status.cut.share + 1e-9
        assert value > 6.0 or found.status.cut.share < 1e-6


@crossed(("noise", "cov"), [0.0, 0.01, 0.04], [0.0, 1.0])
def test_evidence_of_the_model_is_not_doubted(cov, noise):
    net = line(cov=cov, noise=noise)
    drawn = net.sample({}, steps=200, rng=5)
    with warnings.catch_warnings():
        # Of a place that is known exactly, but stands between two centres, these cells know less.
        warnings.filterwarnings("ignore" if cov == noise == 0.0 else "error", "measurements are")
        found = pgm.filter(net, drawn.evidence, belief=GRID)
    assert found.status.cut.share < 1e-9


def test_a_wall_is_no_cut():
    def pushed(x):
        return np.minimum(x + 0.5, 8.0)

    net = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(place, 0.0, 1.0)],
        [pgm.NonlinearGaussianCPD(place, (place.previous,), pushed, 0.0)],
        [pgm.LinearGaussianCPD(reading, {place: 1.0}, cov=0.2)],
    )
    drawn = net.sample({}, steps=100, rng=1)
    found = pgm.filter(net, drawn.evidence, belief=GRID)
    assert_allclose(found[place].mean[-1], 8.0, atol=0.1)
    assert found.status.cut.share < 1e-9


def test_measurements_that_overflow_are_impossible():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises(pgm.EvidenceError, match="reading at step 0"):
            pgm.filter(line(), read([1e200]), steps=1, belief=GRID)


def test_a_fall_at_an_end_that_was_not_cut_is_counted_once():
    """Motion leads away from a wall at the first cell over steps without measurements."""
    lattice = resolve(GRID, (place,))
    cells = lattice.axes[0].cells

    def there(edge):
        """A marginal with the share `edge` in its first cell, the rest in the second."""
        found = np.zeros(cells)
        found[:2] = edge, 1.0 - edge
        return [found]

    tails = Tails.begun(lattice.axes).at(there(0.5), 0.0)._replace(share=np.full((1, 2), 1e-6))
    for edge in (0.05, 0.04, 0.03):
        tails = tails.predicted(there(edge), 0.0)
    assert_allclose(tails.share[0, 0], 1e-6 * 0.03 / 0.5)
