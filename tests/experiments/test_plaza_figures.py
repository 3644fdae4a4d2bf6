"""Plaza's paths: the part enlarged is where the smoother gains most, and both are in it."""

from types import SimpleNamespace

import matplotlib.pyplot as plt
import numpy as np
import pytest
from matplotlib.collections import EllipseCollection
from numpy.testing import assert_allclose

import pgm
from experiments.plaza import figures
from experiments.plaza.figures import LENGTH, RINGS, parting
from models.networks import pose

STEPS = 200  # of half a metre


class Posterior(dict):
    """The beliefs that the figures ask a posterior for."""

    def __init__(self, filtered, smoothed):
        super().__init__({pose: smoothed})
        self.filtered = {pose: filtered}


@pytest.fixture
def drive():
    """A straight drive on which the filter strays about step 120, and the smoother by a third."""
    truth = np.zeros((STEPS, 3))
    truth[:, 0] = 0.5 * np.arange(STEPS)
    aside = np.exp(-0.5 * ((np.arange(STEPS) - 120) / 8.0) ** 2)
    cov = np.broadcast_to(0.04 * np.eye(3), (STEPS, 3, 3))

    def belief(share):
        mean = truth.copy()
        mean[:, 1] += share * aside
        return pgm.Gaussian(pose, mean, cov, steps=range(STEPS))

    log = SimpleNamespace(
        truth=truth,
        beacons=np.array([[0.0, 20.0], [90.0, 20.0]]),
        timeline=SimpleNamespace(times=100.0 + np.arange(STEPS)),
    )
    return log, Posterior(filtered=belief(3.0), smoothed=belief(1.0))


def test_the_part_is_where_the_smoother_gains_most():
    truth = np.zeros((STEPS, 2))
    truth[:, 0] = 0.5 * np.arange(STEPS)
    gain = np.zeros(STEPS)
    gain[100:110] = 1.0
    part = parting(truth, 1.0 + gain, np.ones(STEPS))
    assert part.start <= 100
    assert part.stop >= 110
    assert 0.5 * (part.stop - part.start) == pytest.approx(LENGTH, rel=0.05)


def test_a_short_drive_is_its_own_part():
    truth = np.zeros((3, 2))
    assert parting(truth, np.ones(3), np.zeros(3)) == slice(0, 3)


def test_filter_and_smoother_are_told_apart(drive):
    log, posterior = drive
    figure = figures.path(log, posterior)
    whole, part, below = figure.axes
    rings = [c for c in part.collections if isinstance(c, EllipseCollection)]
    assert [len(ring.get_offsets()) for ring in rings] == [RINGS, RINGS]
    assert len({ring.get_edgecolor()[0].tobytes() for ring in rings}) == 2
    filtered, smoothed, truth = (line.get_ydata() for line in part.lines)
    middle = len(truth) // 2
    height = np.ptp(part.get_ylim())
    # Far enough apart on paper to be seen.
    assert abs(filtered[middle] - smoothed[middle]) > 0.05 * height
    distances = [line.get_ydata() for line in below.lines]
    assert_allclose(distances[0], 3.0 * distances[1])
    (frame,) = whole.patches
    assert frame.get_x() <= 60.0 <= frame.get_x() + frame.get_width()
    plt.close(figure)


def test_names_stand_once_and_outside_of_the_paths(drive):
    figure = figures.path(*drive)
    (legend,) = figure.legends
    names = [text.get_text() for text in legend.get_texts()]
    assert names == ["beacons", "filter", "smoother", "truth", "enlarged"]
    assert not any(ax.get_legend() for ax in figure.axes)
    figure.draw_without_rendering()
    box = legend.get_window_extent()
    assert not any(box.overlaps(ax.get_window_extent()) for ax in figure.axes)


def test_errors_have_their_unit(drive):
    figure = figures.errors(*drive)
    labels = [ax.get_ylabel() for ax in figure.axes]
    assert labels == ["error east [m]", "", "error north [m]", ""]
