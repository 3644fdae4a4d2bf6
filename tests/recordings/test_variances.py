"""Variances of a stream's rows reach the sensors, and angles in degrees do not."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import pgm
from pgm.errors import EvidenceError
from pgm.recordings import Recording, Stream

PLACE = ("east", "north")
x, g, r = (pgm.Variable(name, components=PLACE) for name in "xgr")
VALUES, SPREAD = np.array([[0.0, 0.0], [10.0, 4.0]]), np.array([[0.01, 0.02], [100.0, 50.0]])


def model():
    return pgm.DynamicBayesianNetwork(
        prior=[pgm.GaussianCPD(x, [0, 0], 100.0)],
        transition=[pgm.LinearGaussianCPD(x, {x.previous: 1.0}, cov=0)],
        observation=[
            pgm.LinearGaussianCPD(
                g, {x: 1.0}, cov=pgm.noise(lambda r: r, given=r, diagonal=True)
            )
        ],
    )  # fmt: skip


def drive(**changes):
    stream = Stream([1.0, 2.0], VALUES, PLACE, variances=SPREAD)
    return Recording(fixes=stream.replace(**changes))


def test_each_reading_is_as_sure_as_its_row():
    log = drive().timeline([0.0, 1.0, 2.0], sensors={g: "fixes"}, variances={g: r})
    found = pgm.filter(model(), log.evidence, steps=2)[x]
    # Of a place that does not move, precisions add.
    precision = 1 / 100 + (1 / SPREAD).sum(axis=0)
    assert_allclose(found.mean[-1], (VALUES / SPREAD).sum(axis=0) / precision, rtol=1e-12)
    assert_allclose(np.diagonal(found.cov[-1]), 1 / precision, rtol=1e-12)


def test_variances_go_by_name_beside_landmarks():
    z, s = pgm.Variable("range"), pgm.Variable("s", components=("range",))
    m = pgm.Variable("m", components=PLACE)
    heard = Stream(
        [0.0, 1.0], [[3.0, 0.1], [4.0, 0.2]], ("range", "bearing"), subject=[7, 7],
        variances=[[1.0, 2.0], [3.0, 4.0]],
    )  # fmt: skip
    found = Recording(sightings={"radio": heard}, landmarks={7: (1.0, 2.0)}).timeline(
        [0.0, 1.0], sensors={z: "radio"}, landmark=m, variances={z: s}
    )
    given = found.evidence[z].given
    assert_array_equal(given[s], [[1.0], [3.0]])
    assert_array_equal(given[m], [[1.0, 2.0]] * 2)


def test_variances_of_rows_that_are_not_taken():
    values, spread = VALUES.copy(), SPREAD.copy()
    values[0] = spread[0] = np.nan
    log = drive(values=values, variances=spread).timeline(
        [1.0, 2.0], sensors={g: "fixes"}, variances={g: r}
    )
    assert_array_equal(log.evidence[g].given[r], SPREAD[1:])


@pytest.mark.parametrize(
    ("changes", "variances", "told"),
    [
        ({"variances": None}, {g: r}, "'fixes' has no variances that r could be"),
        ({"variances": [[1, 2], [np.nan, 1]]}, {g: r}, r"no variances in 1 row \(row 1\)"),
        ({}, r, "variances= says whose they are, like {g: r}"),
        ({}, {x: r}, r"variances= has x, which is not in sensors=: \(g\)"),
        ({}, {g: "r"}, "variances= names a variable, not 'r'"),
        ({}, {g: pgm.Variable("r", components=("a", "b"))}, "they go by name"),
    ],
)
def test_variances_that_cannot_be(changes, variances, told):
    with pytest.raises(EvidenceError, match=told):
        drive(**changes).timeline([0.0, 1.0, 2.0], sensors={g: "fixes"}, variances=variances)


def test_streams_in_degrees():
    wrapped = [100.0, 179.0, -178.0, -90.0]
    for component, values in (("heading", wrapped), ("bearing", [10.0, -30.0, 5.0, 1.0])):
        with pytest.raises(EvidenceError, match=rf"'{component}' goes to .* np.radians"):
            Stream(np.arange(4.0), values, (component,))
    # A heading of many turns that goes on steadily is in radians, in whatever order its rows are.
    turned = np.linspace(0.0, 300.0, 40)
    order = np.random.default_rng(0).permutation(40)
    assert len(Stream(order.astype(float), turned[order], ("heading",))) == 40


def test_a_timeline_of_degrees():
    z = pgm.Variable("z", components=("heading",), angles=("heading",))
    values, times = np.array([100.0, 179.0, -178.0]), [0.0, 1.0, 2.0]
    with pytest.raises(EvidenceError, match="the angle 'heading' goes to 179 rad and jumps"):
        pgm.timeline(times, sensors={z: pgm.stamped(times, values)})
    assert pgm.timeline(times, sensors={z: pgm.stamped(times, np.radians(values))}).steps == 2
