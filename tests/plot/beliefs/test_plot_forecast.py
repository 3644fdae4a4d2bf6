"""The fan of a sensor's readings and forecasts."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.stats import norm

import pgm

x = pgm.Variable("x", components=("east", "north"))
z = pgm.Variable("z", components=("east", "north"), units=("m", ""))
MODEL = pgm.DynamicBayesianNetwork(
    [pgm.GaussianCPD(x, [0.0, 1.0], np.inf)],
    [pgm.LinearGaussianCPD(x, {x.previous: 1.0}, [0.5, 0.1])],
    [pgm.LinearGaussianCPD(z, {x: 1.0}, 0.5)],
)
ZS = np.random.default_rng(2).normal(size=(3, 8, 2))
ZS[:, 3] = np.nan
FOUND = pgm.filter(MODEL, {z: ZS}, steps=12)


def bands(ax):
    """By label the lower and upper ends of each band at its last place."""
    found = {}
    for drawn in ax.collections:
        ends = np.concatenate([path.vertices for path in drawn.get_paths()])
        last = ends[ends[:, 0] == ends[:, 0].max(), 1]
        found[drawn.get_label()] = last.min(), last.max()
    return found


def test_bands_line_and_readings():
    axes = pgm.plot.forecast(FOUND, z, run=1, confidence=(0.9, 0.5))
    assert [ax.get_ylabel() for ax in axes] == ["z east [m]", "z north"]
    ahead = FOUND.predicted[z].run(1)
    for k, ax in enumerate(axes):
        found = bands(ax)
        assert list(found) == ["90 %", "50 %"]
        for label, probability in (("90 %", 0.9), ("50 %", 0.5)):
            low, high = norm.interval(probability, ahead.mean[-1, k], ahead.std[-1, k])
            assert_allclose(found[label], (low, high))
        lines = {line.get_label(): line for line in ax.lines}
        assert np.isnan(lines["expected"].get_ydata()[0])  # of which nothing is known yet
        assert_allclose(lines["expected"].get_ydata()[1:], ahead.mean[1:, k])
        steps = [1, 2, 3, 5, 6, 7, 8]
        assert_allclose(lines["reading"].get_xdata(), steps)
        assert_allclose(lines["reading"].get_ydata(), ZS[1, np.array(steps) - 1, k])
        assert_allclose(lines["last reading"].get_xdata(), 8)


def test_a_component_on_given_axes_over_times():
    (first, _) = pgm.plot.forecast(FOUND, z, run=0)
    times = 10.0 * np.arange(1, 13)
    (ax,) = pgm.plot.forecast(
        FOUND, z, components=["north"], run=2, times=times, unit={"north": "km"}, axes=first
    )
    assert ax is first
    assert ax.lines[-1].get_xdata()[0] == 80.0


def test_sightings_in_any_order_and_a_sensor_never_read():
    seen = pgm.sightings(ZS[0, [4, 0, 1]], step=[7, 0, 4])
    (ax, _) = pgm.plot.forecast(pgm.smooth(MODEL, {z: seen}, steps=9), z)
    lines = {line.get_label(): line for line in ax.lines}
    assert_allclose(lines["reading"].get_xdata(), [7, 0, 4])
    (ax, _) = pgm.plot.forecast(
        pgm.filter(MODEL.replace(prior=[pgm.GaussianCPD(x, [0.0, 1.0], 1.0)]), {}, steps=9), z
    )
    assert "last reading" not in [line.get_label() for line in ax.lines]


def test_angles_go_on_beyond_half_a_turn():
    """The line has no jump of a turn; readings are moved by whole turns, to the line."""
    heading = pgm.Variable("heading")
    read = pgm.Variable("read", components=("heading",), angles=("heading",))
    turning = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(heading, 3.0, np.inf)],
        [pgm.LinearGaussianCPD(heading, {heading.previous: 1.0}, 0.05, offset=0.1)],
        [pgm.LinearGaussianCPD(read, {heading: 1.0}, 0.01)],
    )
    truth = 3.0 + 0.1 * np.arange(1, 9)
    truth[4:6] = truth[5:3:-1]  # across half a turn and back
    wrapped = (truth + np.pi) % (2.0 * np.pi) - np.pi
    (ax,) = pgm.plot.forecast(pgm.filter(turning, {read: wrapped[:, None]}, steps=12), read)
    lines = {line.get_label(): line.get_ydata() for line in ax.lines}
    assert np.abs(np.diff(lines["expected"][1:])).max() < 1.0
    assert_allclose(lines["reading"] - truth, -2.0 * np.pi)  # as of the first that had a forecast


def test_what_cannot_be_drawn_is_refused():
    m = pgm.Variable("m", components=("east", "north"))
    given = MODEL.replace(observation=[pgm.LinearGaussianCPD(z, {x: -1.0, m: 1.0}, 0.5)])
    seen = pgm.sightings(ZS[0, :2], step=[2, 2], given={m: np.eye(2)})
    twice = pgm.filter(given, {z: seen}, steps=3)
    for call, words in (
        (lambda: pgm.plot.forecast(FOUND, z), r"\(3,\), of runs; choose one, as with run=0"),
        (lambda: pgm.plot.forecast(FOUND, z.at(3), run=0), "of one step"),
        (lambda: pgm.plot.forecast(FOUND, z, run=0, confidence=95), "between 0 and 1"),
        (lambda: pgm.plot.forecast(FOUND, z, run=0, components=[]), "no components"),
        (lambda: pgm.plot.forecast(twice, z), "several sightings at a step"),
    ):
        with pytest.raises(pgm.ModelError, match=words):
            call()
    with pytest.raises(pgm.EvidenceError, match="by variable, not by 'z'"):
        pgm.plot.forecast(FOUND, "z", run=0)


place, heard = pgm.Discrete("place", 2), pgm.Discrete("heard", ("no", "a", "b"))
HOUSE = pgm.DynamicBayesianNetwork(
    [pgm.TableCPD(place, table=[0.9, 0.1])],
    [pgm.TableCPD(place, place.previous, table=[[0.8, 0.2], [0.3, 0.7]])],
    [pgm.TableCPD(heard, place, table=[[0.7, 0.2, 0.1], [0.1, 0.3, 0.6]])],
)


def test_a_discrete_sensor_is_a_strip():
    runs = [["no", -1, "b", "a"], ["a", "a", -1, "no"]]
    found = pgm.filter(
        HOUSE,
        {heard: [[-1 if r == -1 else heard.states.index(r) for r in row] for row in runs]},
        steps=6,
    )
    times = 10.0 * np.arange(1, 7)
    (ax,) = pgm.plot.forecast(found, heard, run=0, times=times)
    (mesh,) = ax.collections
    assert_allclose(mesh.get_array(), found.predicted[heard].probabilities[0].T)
    assert_allclose(mesh.get_coordinates()[0, :, 0], np.arange(5.0, 66.0, 10.0))
    lines = {line.get_label(): line for line in ax.lines}
    assert_allclose(lines["reading"].get_xdata(), [10, 30, 40])
    assert_allclose(lines["reading"].get_ydata(), [0, 2, 1])
    assert_allclose(lines["last reading"].get_xdata(), 45.0)
    assert [text.get_text() for text in ax.get_yticklabels()] == list(heard.states)
    soft = pgm.soft([[0.2, 0.5, 0.3], [0.1, 0.1, 0.8]])
    (ax,) = pgm.plot.forecast(pgm.smooth(HOUSE, {heard: soft}), heard)
    (line,) = ax.lines
    assert line.get_label() == "soft reading"
    assert_allclose(line.get_ydata(), [1, 2])
    seen = pgm.sightings([2, 0], step=[3, 0])
    (ax,) = pgm.plot.forecast(pgm.filter(HOUSE, {heard: seen}, steps=4), heard)
    assert_allclose(ax.lines[0].get_xdata(), [3, 0])
    assert_allclose(ax.lines[0].get_ydata(), [2, 0])


def test_strips_that_cannot_be_drawn():
    found = pgm.filter(HOUSE, {heard: [[0, 1], [1, 1]]})
    choose = pgm.Discrete("choose", 2)
    table = np.stack([HOUSE.observation[0].table, HOUSE.observation[0].table])
    chosen = HOUSE.replace(observation=[pgm.TableCPD(heard, (choose, place), table=table)])
    seen = pgm.sightings([0, 1], step=[1, 1], given={choose: [0, 1]})
    twice = pgm.filter(chosen, {heard: seen}, steps=2)
    for call, words in (
        (lambda: pgm.plot.forecast(found, heard), r"\(2,\), of runs; choose one, as with run=0"),
        (lambda: pgm.plot.forecast(found, heard, run=0, unit="m"), "neither components nor units"),
        (lambda: pgm.plot.forecast(twice, heard), "several sightings at a step"),
        (lambda: pgm.plot.forecast(found, heard.at(1), run=0), "of one step"),
    ):
        with pytest.raises(pgm.ModelError, match=words):
            call()
