import matplotlib.pyplot as plt
import numpy as np
import pytest

import pgm
import pgm.plot
from pgm.examples import walk, z


def status(residuals, iterations=None):
    residuals = np.array(residuals, dtype=float)
    runs = residuals.shape[1:]
    return pgm.results.Status(iterations or len(residuals), residuals, np.ones(runs, dtype=bool))


def curves(ax):
    return [line for line in ax.lines if line.get_linestyle() == "-" and len(line.get_xdata())]


def texts(ax):
    return [text.get_text() for text in ax.get_legend().get_texts()]


def test_one_run_is_a_line_on_a_logarithmic_axis_with_its_tolerance():
    residuals = 10.0 ** -np.arange(12.0)
    ax = pgm.plot.convergence(status(residuals), tolerance=1e-10)
    assert ax.get_yscale() == "log"
    line, dashed = ax.lines
    np.testing.assert_array_equal(line.get_xdata(), np.arange(1, 13))
    np.testing.assert_array_equal(line.get_ydata(), residuals)
    assert set(dashed.get_ydata()) == {1e-10}
    assert texts(ax) == ["residual", "tolerance 1e-10"]
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("iteration", "residual")
    ax.figure.canvas.draw()
    assert all(tick == round(tick) for tick in ax.get_xticks())


def test_the_first_linearisation_of_a_tree_has_no_residual():
    ax = pgm.plot.convergence(status([1.0, 0.1], iterations=3))
    np.testing.assert_array_equal(ax.lines[0].get_xdata(), [2, 3])


def test_few_runs_are_lines_of_one_colour_and_one_label():
    residuals = np.random.default_rng(0).uniform(0.1, 1.0, (6, 2, 3))
    ax = pgm.plot.convergence(status(residuals), label="flooding", tolerance=0.2)
    drawn = np.array([line.get_ydata() for line in curves(ax)]).T
    np.testing.assert_array_equal(drawn, residuals.reshape(6, 6))
    assert len({line.get_color() for line in curves(ax)}) == 1
    assert texts(ax) == ["flooding", "tolerance 0.2"]


def test_many_runs_are_a_median_in_a_band():
    residuals = np.random.default_rng(0).uniform(0.1, 1.0, (6, 50))
    residuals[4, :20] = 0.0
    residuals[5, :30] = 0.0
    ax = pgm.plot.convergence(status(residuals))
    (band,) = ax.collections
    heights = band.get_paths()[0].vertices
    for k, row in enumerate(residuals):
        here = heights[heights[:, 0] == k + 1, 1]
        assert here.min() == row[row > 0].min()
        assert here.max() == row.max()
    middle = curves(ax)[0].get_ydata()
    np.testing.assert_array_equal(middle[:5], np.median(residuals[:5], axis=1))
    assert np.isnan(middle[5])  # most runs are at zero
    assert texts(ax) == ["residual, 50 runs", "residual, median", "zero"]


def test_zeros_are_triangles_at_the_bottom():
    ax = pgm.plot.convergence(status([1.0, 0.1, 0.0, 0.0]))
    (zeros,) = [line for line in ax.lines if line.get_marker() == "v"]
    np.testing.assert_array_equal(zeros.get_xdata(), [3, 4])
    ax.figure.canvas.draw()
    box, at = ax.get_window_extent(), zeros.get_window_extent()
    assert abs(0.5 * (at.y0 + at.y1) - box.y0) < 0.05 * box.height
    assert ax.get_ylim()[0] > 0.0


def test_runs_that_end_or_diverge_leave_gaps():
    residuals = [[1.0, 1.0], [0.1, np.inf], [np.nan, np.nan]]
    ax = pgm.plot.convergence(status(residuals))
    drawn = np.array([line.get_ydata() for line in curves(ax)]).T
    np.testing.assert_array_equal(np.isnan(drawn), [[0, 0], [0, 1], [1, 1]])
    ax.figure.canvas.draw()


@pytest.mark.parametrize("residuals", [np.zeros((0,)), np.zeros((0, 20)), [0.0], np.zeros((3, 9))])
def test_nothing_to_draw_is_drawn_all_the_same(residuals):
    ax = pgm.plot.convergence(status(residuals, iterations=1), tolerance=0.0)
    ax.figure.canvas.draw()
    assert ax.get_yscale() == "log"


def test_residuals_drawn_after_none_are_within_the_axis():
    ax = pgm.plot.convergence(status([0.0, 0.0]), label="exact")
    pgm.plot.convergence(status([0.0, 0.0]), label="exact too", ax=ax)
    ax.figure.canvas.draw()
    assert ax.get_ylim() == (1e-16, 1e-12)
    pgm.plot.convergence(status([1e-2, 1e-5]), label="iterated", ax=ax)
    low, high = ax.get_ylim()
    assert 1e-6 < low < 1e-5 < 1e-2 < high < 0.1


@pytest.mark.parametrize("residuals", [np.zeros((0,)), [0.0, 0.0]])
def test_a_tolerance_alone_has_room_about_it(residuals):
    ax = pgm.plot.convergence(status(residuals, iterations=3), tolerance=1e-6)
    ax.figure.canvas.draw()
    low, high = ax.get_ylim()
    assert low < 0.2e-6 < 5e-6 < high < 1e-3


def test_schedules_share_an_axes_in_different_colours():
    ax = pgm.plot.convergence(status([1.0, 0.5]), label="flooding")
    assert pgm.plot.convergence(status([1.0, 0.1]), label="residual", ax=ax) is ax
    assert len({line.get_color() for line in ax.lines}) == 2
    assert texts(ax) == ["flooding", "residual"]


def test_a_schedule_s_own_status_is_drawn():
    x, z = pgm.variables("x z")
    model = pgm.DynamicBayesianNetwork(
        prior=[pgm.GaussianCPD(x, 0.0, 1.0)],
        transition=[pgm.LinearGaussianCPD(x, given={x.previous: 1.0}, cov=0.1)],
        observation=[
            pgm.NonlinearGaussianCPD(z, given=(x,), function=lambda x: x + 0.1 * x**3, cov=0.1)
        ],
    )
    posterior = pgm.smooth(model, {z: np.ones((5, 1))}, iterations=20)
    ax = pgm.plot.convergence(posterior.status)
    assert len(ax.lines[0].get_xdata()) == posterior.status.iterations - 1 > 1


@pytest.mark.parametrize(
    ("wrong", "match"),
    [
        ({"status": [1.0, 2.0]}, "draws a Status, like posterior.status, not list"),
        ({"tolerance": -1.0}, "tolerance must be 0 or more"),
        ({"tolerance": np.nan}, "tolerance must be 0 or more"),
        ({"ax": plt}, "one matplotlib Axes, not module"),
    ],
)
def test_wrong_arguments_are_refused(wrong, match):
    with pytest.raises(pgm.ModelError, match=match):
        pgm.plot.convergence(**({"status": status([1.0])} | wrong))
    assert not plt.get_fignums()


@pytest.mark.parametrize(
    "belief",
    [pgm.Grid({"x": (-8.0, 12.0, 200)}), pgm.Particles(500, seed=0)],
    ids=["grid", "draws"],
)
def test_beliefs_that_are_not_iterated_have_no_residuals(belief):
    posterior = pgm.filter(walk, {z: [[4.0]]}, belief=belief)
    with pytest.raises(pgm.ModelError, match=r"Status\(.* not iterated, and has no residuals"):
        pgm.plot.convergence(posterior.status)
