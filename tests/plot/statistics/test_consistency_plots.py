"""Plots of consistency: they show what `pgm.consistency` finds, and say what they show."""

import matplotlib.pyplot as plt
import numpy as np
import pytest
from matplotlib.colors import to_rgba
from matplotlib.container import StemContainer
from numpy.testing import assert_allclose

import pgm
import pgm.plot
from models import networks
from models.networks import fix, point, shift
from pgm import consistency
from pgm.plot.drawing.axes import right_band

STEPS = 25


@pytest.fixture(scope="module")
def right():
    model = networks.linear()
    sample = model.sample({shift: np.zeros((STEPS, 2))}, runs=30, rng=0)
    return pgm.smooth(model, sample.evidence), sample[point]


def labels(ax):
    return ax.get_legend_handles_labels()[1]


def ends(band):
    """The lower and upper end of a band, of one part or more, at each place along the axis."""
    vertices = np.concatenate([path.vertices for path in band.get_paths()])
    across = np.unique(vertices[:, 0])
    at = [vertices[vertices[:, 0] == place, 1] for place in across]
    return across, np.array([heights.min() for heights in at]), [h.max() for h in at]


def parts(ax):
    """The parts of the first band, which gaps divide."""
    return ax.collections[0].get_paths()


def test_nees_over_time_in_its_band(right):
    posterior, truth = right
    ax = pgm.plot.nees(posterior[point], truth, confidence=0.9, label=posterior.kind)
    found = posterior.filtered
    pgm.plot.nees(found[point], truth, confidence=0.9, label=found.kind, ax=ax)
    found = consistency.anees(posterior[point], truth, confidence=0.9)
    one, smoothed, filtered = ax.lines
    assert_allclose(smoothed.get_ydata(), found.value / 2)
    assert_allclose(smoothed.get_xdata(), np.arange(STEPS + 1))
    assert set(one.get_ydata()) == {1.0}
    assert smoothed.get_color() != filtered.get_color()
    (band,) = ax.collections
    _, low, high = ends(band)
    assert_allclose(low, found.low / 2)
    assert_allclose(high, found.high / 2)
    assert labels(ax) == ["90 % band", "smoothed", "filtered"]
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("step", "NEES / degrees of freedom")


def test_nis_leaves_out_steps_without_readings():
    model, x = networks.linear(), fix
    sample = model.sample({shift: np.zeros((STEPS, 2))}, runs=10, rng=1)
    readings = np.array(sample[fix])
    readings[:, 5:9] = np.nan
    readings[:5, 12] = np.nan
    posterior = pgm.filter(model, {shift: np.zeros((STEPS, 2)), x: readings})
    times = 0.5 * np.arange(STEPS + 1)
    ax = pgm.plot.nis(posterior.innovations[fix], times=times)
    line = ax.lines[1]
    drawn = np.isfinite(line.get_ydata())
    steps = [*range(1, 6), *range(10, STEPS + 1)]
    assert_allclose(line.get_xdata()[drawn], times[steps])
    nis = posterior.innovations[fix].nis
    assert_allclose(line.get_ydata()[drawn], np.nanmean(nis[:, steps], axis=0) / 2)
    assert list(np.flatnonzero(~drawn)) == [5]  # no line from step 5 to step 10
    assert [np.unique(path.vertices[:, 0])[[0, -1]].tolist() for path in parts(ax)] == [
        [0.5, 2.5],
        [5.0, 0.5 * STEPS],
    ]
    across, low, high = ends(ax.collections[0])
    widths = dict(zip(across, high - low, strict=True))
    assert widths[6.5] > 1.2 * widths[6.0]  # half as many runs
    assert line.get_marker() == "."
    assert ax.get_xlabel() == "time"


def test_nis_of_regular_readings_is_one_line():
    """A reading every fourth step: its gaps are the usual ones."""
    model, readings = networks.linear(), np.full((2, STEPS, 2), np.nan)
    readings[:, 3::4] = 0.0
    posterior = pgm.filter(model, {shift: np.zeros((STEPS, 2)), fix: readings})
    ax = pgm.plot.nis(posterior.innovations[fix])
    assert list(ax.lines[1].get_xdata()) == [4, 8, 12, 16, 20, 24]
    assert np.isfinite(ax.lines[1].get_ydata()).all()
    assert ax.lines[1].get_marker() == "."
    assert len(parts(ax)) == 1


def test_rmse_over_time_over_its_percentiles(right):
    posterior, truth = right
    ax = pgm.plot.rmse(posterior[point], truth, components=("east",), percentiles=(10, 90))
    found = consistency.rmse_over_time(posterior[point], truth, ("east",), percentiles=(10, 90))
    assert_allclose(ax.lines[0].get_ydata(), found.rms)
    _, low, high = ends(ax.collections[0])
    assert_allclose(low, found.low)
    assert_allclose(high, found.high)
    assert labels(ax) == ["RMSE, 10 to 90 % of runs", "RMSE"]
    assert ax.get_ylim()[0] == 0.0
    one = pgm.plot.rmse(posterior[point].run(0), truth[0])
    assert not one.collections


def test_kl_is_the_median_over_runs_on_a_logarithmic_axis(right):
    posterior, _ = right
    p, q = posterior[point], posterior.filtered[point]
    ax = pgm.plot.kl(p, q, label="filter")
    due = np.median(p.kl(q), axis=0)
    drawn = ax.lines[0].get_ydata()
    assert ax.get_yscale() == "log"
    assert_allclose(drawn[:-1], due[:-1])
    # At the last step the filter is the smoother: no line, not a drop to nowhere.
    assert np.isnan(drawn[-1]) or drawn[-1] < 1e-12
    assert labels(ax) == ["filter, 5 to 95 % of runs", "filter, median"]


def test_coverage_against_the_diagonal(right):
    posterior, truth = right
    ax = pgm.plot.coverage(posterior[point], truth, label="smoother")
    pgm.plot.coverage(posterior.filtered[point], truth, label="filter", ax=ax)
    diagonal, smoothed, _ = ax.lines
    assert_allclose(diagonal.get_xdata(), diagonal.get_ydata())
    levels = smoothed.get_xdata()
    found = consistency.coverage(posterior[point], truth, levels, band=0.95)
    assert_allclose(smoothed.get_ydata(), found.actual)
    _, low, high = ends(ax.collections[0])
    assert_allclose(low, found.low)
    assert_allclose(high, found.high)
    assert ax.get_aspect() == 1.0
    assert labels(ax) == ["smoother", "filter"]


def test_whiteness_as_stems_in_their_band(right):
    posterior, _ = right
    ax = pgm.plot.whiteness(posterior.innovations[fix], lags=8)
    found = consistency.whiteness(posterior.innovations[fix], 8)
    (stems,) = ax.containers
    assert_allclose(stems.markerline.get_xdata(), np.arange(1, 9))
    assert_allclose(stems.markerline.get_ydata(), found.autocorrelation)
    _, low, high = ends(ax.collections[0])
    assert_allclose(high, found.band)
    assert_allclose(low, -found.band)
    assert labels(ax) == ["95 % band", f"innovations, p = {found.probability:.2g}"]
    pgm.plot.whiteness(posterior.innovations[fix], lags=8, label="again", ax=ax)
    again = ax.containers[1].markerline
    assert 1.0 < again.get_xdata()[0] < 1.5
    assert again.get_color() != stems.markerline.get_color()


def test_whiteness_with_other_lags_has_a_band_of_its_own(right):
    innovations = right[0].innovations[fix]
    ax = pgm.plot.whiteness(innovations, lags=4, label="few")
    pgm.plot.whiteness(innovations, lags=4, label="again", ax=ax)
    assert len(ax.collections) == 3  # a band, and two of stems
    pgm.plot.whiteness(innovations, lags=8, label="many", ax=ax)
    own = next(c for c in ax.collections if c.get_label() == "many, 95 % band")
    across, low, high = ends(own)
    found = consistency.whiteness(innovations, 8)
    assert_allclose(across, found.lags)
    assert_allclose(high, found.band)
    assert_allclose(low, -found.band)
    tint = to_rgba(ax.containers[2].markerline.get_color())
    assert_allclose(own.get_edgecolor()[:, :3], [tint[:3]])
    assert own.get_facecolor()[0, 3] == 0.0
    pgm.plot.whiteness(innovations, lags=8, confidence=0.5, label="narrow", ax=ax)
    assert "narrow, 50 % band" in labels(ax)


def test_bands_that_differ_by_chance_are_drawn_once():
    evidence = networks.linear().sample({shift: np.zeros((STEPS, 2))}, runs=30, rng=0).evidence
    ax = None
    for label, std in (("right", 0.5), ("wrong", 0.25)):
        found = pgm.filter(networks.linear(sensor_std=std), evidence).innovations[fix]
        ax = pgm.plot.whiteness(found, lags=4, label=label, ax=ax)
    assert [label.split(",")[0] for label in labels(ax)] == ["95 % band", "right", "wrong"]


def test_the_band_of_a_curve_that_differs_is_drawn_in_its_tint():
    ax = plt.subplots()[1]
    across = np.arange(4)
    for runs, tint, label in ((7, "C0", "a"), (7, "C1", "b"), (1, "C2", "c"), (1, "C3", "d")):
        low, high = (np.full(4, end) for end in consistency.mean_band(2, runs, 0.95))
        first = right_band(ax, across, low, high, tint, confidence=0.95, label=label)
        assert first == (label == "a")
    seven, one = ax.collections
    assert labels(ax) == ["95 % band", "c, 95 % band"]
    assert_allclose(one.get_edgecolor()[:, :3], [to_rgba("C2")[:3]])
    assert one.get_facecolor()[0, 3] == 0.0 < seven.get_facecolor()[0, 3]
    for band, runs in ((seven, 7), (one, 1)):
        _, low, high = ends(band)
        assert_allclose([low[0], high[0]], consistency.mean_band(2, runs, 0.95))


def test_a_belief_over_fewer_runs_has_a_band_of_its_own(right):
    posterior, truth = right
    ax = pgm.plot.nees(posterior[point], truth, label="thirty")
    pgm.plot.nees(posterior[point].run(0), truth[0], label="one", ax=ax)
    assert labels(ax) == ["95 % band", "thirty", "one, 95 % band", "one"]
    for band, runs in zip(ax.collections, (30, 1), strict=True):
        _, low, high = ends(band)
        assert_allclose([low[0], high[0]], np.divide(consistency.mean_band(2, runs, 0.95), 2))


def test_stems_stand_nearer_to_their_own_lag_than_to_the_next(right):
    ax = plt.subplots()[1]
    ax.plot([0, 1], [0, 0.1])
    ax.bar([0], [0.1])
    for _ in range(9):
        pgm.plot.whiteness(right[0].innovations[fix], lags=3, ax=ax)
    stems = [c for c in ax.containers if isinstance(c, StemContainer)]
    first = [each.markerline.get_xdata()[0] for each in stems]
    assert first[0] == 1.0
    assert np.min(np.diff(np.sort(first))) > 0.03
    assert max(first) < 1.6


def test_the_diagonal_is_drawn_once_whatever_else_is_on_the_axes(right):
    posterior, truth = right
    ax = plt.subplots()[1]
    ax.plot([0.0, 1.0], [0.5, 0.5])
    for _ in range(2):
        pgm.plot.coverage(posterior[point], truth, ax=ax)
    diagonals = [line for line in ax.lines if np.array_equal(line.get_xydata(), [[0, 0], [1, 1]])]
    assert len(diagonals) == 1
    assert len(ax.lines) == 4


def test_all_of_them_draw_on_the_axes_given_and_return_it(right):
    posterior, truth = right
    belief, innovations = posterior[point], posterior.innovations[fix]
    figure, axes = plt.subplots(2, 3)
    for draw, ax in zip(
        (
            lambda ax: pgm.plot.nees(belief, truth, ax=ax),
            lambda ax: pgm.plot.nis(innovations, ax=ax),
            lambda ax: pgm.plot.rmse(belief, truth, ax=ax),
            lambda ax: pgm.plot.kl(belief, posterior.filtered[point], ax=ax),
            lambda ax: pgm.plot.coverage(belief, truth, ax=ax),
            lambda ax: pgm.plot.whiteness(innovations, ax=ax),
        ),
        axes.flat,
        strict=True,
    ):
        assert draw(ax) is ax
        assert ax.get_xlabel()
        assert ax.get_ylabel()
    figure.canvas.draw()


def test_refusals(right):
    posterior, truth = right
    with pytest.raises(pgm.ModelError, match="a belief is a Gaussian"):
        pgm.plot.nees(posterior, truth)
    with pytest.raises(pgm.ModelError, match="over no steps"):
        pgm.plot.nees(posterior[point.at(3)], truth[:, 3])
    with pytest.raises(pgm.ModelError, match="over time"):
        pgm.plot.kl(posterior[point.at(3)], posterior[point.at(3)])
    with pytest.raises(pgm.ModelError, match=r"times has shape \(3,\)"):
        pgm.plot.rmse(posterior[point], truth, times=[0, 1, 2])
    with pytest.raises(pgm.ModelError, match=r"posterior.innovations\[z\]"):
        pgm.plot.nis(posterior[point])
    with pytest.raises(pgm.ModelError, match="one matplotlib Axes"):
        pgm.plot.coverage(posterior[point], truth, ax=plt.subplots(2)[1])
