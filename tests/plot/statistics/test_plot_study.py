"""`pgm.plot.study`: curves of the methods, bands of their errors, and the value that is right."""

import matplotlib.pyplot as plt
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import pgm
import pgm.plot
from pgm import ModelError
from pgm.examples import drive, p, q, x

METHODS = {"KF": pgm.Filtering(), "RTS": pgm.Smoothing()}


@pytest.fixture(scope="module")
def found():
    return pgm.study(drive, steps=4, runs=30, methods=METHODS, seed=1)


@pytest.mark.parametrize(
    ("statistic", "given", "place", "label"),
    [
        ("nees", {}, ..., "NEES"),
        ("coverage", {}, ..., "coverage"),
        ("rmse", {"component": "north"}, (..., 1), "RMSE of north"),
        ("bias", {"component": "east", "state": p}, (..., 0), "bias of east"),
    ],
)
def test_each_method_is_a_curve_in_its_band(found, statistic, given, place, label):
    times = np.linspace(0.0, 2.0, 5)
    ax = pgm.plot.study(found, statistic=statistic, times=times, **given)
    assert ax.get_ylabel() == label
    for name, curve, band in zip(METHODS, ax.lines, ax.collections, strict=False):
        each = getattr(found[name], statistic)
        value, error = (each.by_step[place], each.error_by_step[place])
        assert curve.get_label() == name
        assert_array_equal(curve.get_xdata(), times)
        assert_array_equal(curve.get_ydata(), value.ravel())
        low, high = (value - 1.96 * error).min(), (value + 1.96 * error).max()
        points = band.get_paths()[0].vertices
        assert_allclose([points[:, 1].min(), points[:, 1].max()], [low, high])
    right = [line.get_ydata()[0] for line in ax.lines[2:]]
    assert right == ([] if statistic == "rmse" else [each.expected])
    plt.close(ax.figure)


def test_steps_without_readings_are_left_out(found):
    _, ax = plt.subplots()
    assert pgm.plot.study(found, statistic="nis", sensor=q, ax=ax) is ax
    assert_array_equal(ax.lines[0].get_xdata(), np.arange(1, 5))
    assert_array_equal(ax.lines[0].get_ydata(), found["KF"].nis[q].by_step[1:])
    plt.close(ax.figure)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"statistic": "anees"}, "statistic= is one of"),
        ({"state": x}, r"has states p; name one, state=..., not x"),
        ({"statistic": "rmse"}, r"has components 'east', 'north'; name one"),
        ({"statistic": "nis", "sensor": x}, "has sensors q"),
    ],
)
def test_wrong_arguments(found, given, message):
    with pytest.raises(ModelError, match=message):
        pgm.plot.study(found, **given)


def test_something_else():
    with pytest.raises(ModelError, match=r"what pgm\.study returns, not 3"):
        pgm.plot.study(3)


@pytest.mark.parametrize(
    ("statistic", "given"), [("nees", {"sensor": q}), ("nees", {"component": "east"})]
)
def test_what_a_statistic_is_not_of_is_refused(found, statistic, given):
    with pytest.raises(ModelError, match="leave it out"):
        pgm.plot.study(found, statistic=statistic, **given)
