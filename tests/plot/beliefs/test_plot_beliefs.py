import matplotlib.pyplot as plt
import numpy as np
import pytest
from matplotlib.collections import EllipseCollection
from matplotlib.colors import to_hex, to_rgb
from scipy.stats import chi2

import pgm
import pgm.plot

X = pgm.Variable("x", components=("east", "north", "heading"), angles=("heading",))


def belief(steps=101, seed=0):
    rng = np.random.default_rng(seed)
    root = 0.3 * rng.standard_normal((steps, 3, 3))
    mean = np.cumsum(rng.standard_normal((steps, 3)), axis=0)
    return pgm.Gaussian(X, mean, root @ root.swapaxes(-1, -2), steps=np.arange(steps))


def collections(ax):
    return [c for c in ax.collections if isinstance(c, EllipseCollection)]


def line(ax, label):
    (found,) = [line for line in ax.lines if line.get_label() == label]
    return found


# --- ellipses


@pytest.mark.parametrize("components", [None, ("north", "east"), ("heading", "north")])
def test_ellipses_are_the_regions_of_their_confidence(components):
    gaussian = belief(7)
    ax = pgm.plot.ellipses(gaussian, confidence=0.8, components=components)
    (drawn,) = collections(ax)
    places = [X.components.index(name) for name in components or ("east", "north")]
    angle = np.radians(drawn.get_angles())
    axes = 0.5 * np.stack([drawn.get_widths(), drawn.get_heights()], axis=-1)
    np.testing.assert_allclose(axes, gaussian.ellipse(0.8, components).half_axes)
    np.testing.assert_allclose(drawn.get_offsets(), gaussian.mean[:, places])
    turn = np.linspace(0, 2 * np.pi, 9)[:, None]
    u, v = axes[:, 0] * np.cos(turn), axes[:, 1] * np.sin(turn)
    border = np.stack(
        [u * np.cos(angle) - v * np.sin(angle), u * np.sin(angle) + v * np.cos(angle)], axis=-1
    )
    cov = gaussian.cov[:, places][:, :, places]
    square = np.einsum("kni,nij,knj->kn", border, np.linalg.inv(cov), border)
    np.testing.assert_allclose(square, chi2.ppf(0.8, 2))


def test_ellipses_are_painted_in_data_units():
    cov = [[4.0, 1.5], [1.5, 1.0]]
    gaussian = pgm.Gaussian(pgm.Variable("p", components=("a", "b")), [1.0, 2.0], cov)
    fig = plt.figure(figsize=(4, 4), dpi=100)
    ax = fig.add_axes((0, 0, 1, 1), xlim=(-7, 9), ylim=(-1, 5))
    pgm.plot.ellipses(gaussian, ax=ax, facecolor="black", edgecolor="none")
    ax.axis("off")
    fig.canvas.draw()
    dark = np.asarray(fig.canvas.buffer_rgba())[..., :3].max(axis=-1) < 128
    rows, columns = np.nonzero(dark)
    reach = np.sqrt(chi2.ppf(0.95, 2) * np.diag(cov))
    assert np.ptp(columns) + 1 == pytest.approx(2 * reach[0] * 400 / 16, abs=2.5)
    assert np.ptp(rows) + 1 == pytest.approx(2 * reach[1] * 400 / 6, abs=2.5)


def test_all_leading_axes_are_drawn_in_one_collection_inside_the_limits():
    wide = pgm.Gaussian(X, np.zeros((4, 5, 3)), np.eye(3))
    ax = pgm.plot.ellipses(wide)
    (drawn,) = collections(ax)
    assert len(drawn.get_offsets()) == 20
    reach = np.sqrt(chi2.ppf(0.95, 2))
    assert ax.get_xlim()[0] < -reach
    assert ax.get_xlim()[1] > reach
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("east", "north")


def test_singular_covariances_are_lines_and_zero_ones_points():
    cov = np.zeros((3, 3, 3))
    cov[1, 0, 0] = 1.0
    cov[2, :2, :2] = 1.0
    gaussian = pgm.Gaussian(X, np.zeros((3, 3)), cov)
    ax = pgm.plot.ellipses(gaussian)
    (drawn,) = collections(ax)
    np.testing.assert_allclose(drawn.get_heights(), 0.0, atol=1e-7)
    assert (drawn.get_widths() > 0).tolist() == [False, True, True]
    (dots,) = [c for c in ax.collections if c is not drawn]
    np.testing.assert_array_equal(dots.get_offsets(), [[0.0, 0.0]])
    ax.figure.canvas.draw()


def test_style_wins_over_the_defaults():
    ax = pgm.plot.ellipses(belief(3), ec="red", fc="none", lw=3, label="here")
    (drawn,) = collections(ax)
    assert to_hex(drawn.get_edgecolor()[0]) == "#ff0000"
    assert drawn.get_linewidth() == [3]
    assert len(drawn.get_facecolor()) == 0
    (handle,), labels = ax.get_legend_handles_labels()
    assert labels == ["here"]
    assert (handle.get_edgecolor(), handle.get_facecolor()[3]) == ((1.0, 0.0, 0.0, 1.0), 0.0)
    assert (handle.get_linewidth(), ax.get_legend()) == (3.0, None)
    pgm.plot.ellipses(belief(3), color="black", ax=ax)
    assert to_rgb(collections(ax)[1].get_facecolor()[0]) == (0, 0, 0)


def test_ellipses_are_named_in_a_legend():
    ax = pgm.plot.ellipses(belief(3), label="filtered")
    limits = ax.dataLim.get_points()
    pgm.plot.ellipses(belief(3), label=pgm.Kind(np.inf), colour="black", linestyle="--", ax=ax)
    assert [text.get_text() for text in ax.get_legend().get_texts()] == ["filtered", "smoothed"]
    first, second = ax.get_legend_handles_labels()[0]
    assert to_hex(first.get_edgecolor()) == to_hex(collections(ax)[0].get_edgecolor()[0])
    assert (to_hex(second.get_edgecolor()), second.get_linestyle()) == ("#000000", "--")
    np.testing.assert_array_equal(ax.dataLim.get_points(), limits)


def test_ellipses_refuse_what_has_none():
    scalar = pgm.Gaussian(pgm.Variable("s"), 0.0, 1.0)
    with pytest.raises(pgm.ModelError, match="an ellipse needs two"):
        pgm.plot.ellipses(scalar)
    with pytest.raises(pgm.ModelError, match="confidence lies between 0 and 1"):
        pgm.plot.ellipses(belief(3), confidence=95)
    with pytest.raises(pgm.ModelError, match="like posterior"):
        pgm.plot.ellipses(np.zeros(3))
    assert not plt.get_fignums()


# --- trajectory


@pytest.mark.parametrize(("steps", "ellipses"), [(1, 1), (20, 20), (25, 25), (101, 21), (1000, 25)])
def test_a_path_has_up_to_25_ellipses(steps, ellipses):
    gaussian = belief(steps)
    ax = pgm.plot.trajectory(gaussian, confidence=0.5)
    (drawn,) = collections(ax)
    every = -(-steps // 25)
    np.testing.assert_array_equal(drawn.get_offsets(), gaussian.mean[::every, :2])
    assert len(drawn.get_offsets()) == ellipses
    np.testing.assert_allclose(
        0.5 * drawn.get_widths(), gaussian.ellipse(0.5).half_axes[::every, 0]
    )
    np.testing.assert_array_equal(line(ax, "estimate of x").get_xydata(), gaussian.mean[:, :2])
    assert ax.get_aspect() == 1.0
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("east", "north")


def test_every_and_components_are_obeyed():
    gaussian = belief(10)
    ax = pgm.plot.trajectory(gaussian, every=4, components=("heading", "east"))
    (drawn,) = collections(ax)
    np.testing.assert_array_equal(drawn.get_offsets(), gaussian.mean[::4, [2, 0]])
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("heading [rad]", "east")


def test_filter_and_smoother_share_an_axes():
    truth, landmarks = belief(30).mean, np.array([[1.0, 2.0], [3.0, 4.0]])
    ax = pgm.plot.trajectory(belief(30), label="filtered", truth=truth, landmarks=landmarks)
    assert pgm.plot.trajectory(belief(30, seed=1), label="smoothed", ax=ax) is ax
    assert len(ax.lines) == 4
    np.testing.assert_array_equal(line(ax, "truth").get_xydata(), truth[:, :2])
    np.testing.assert_array_equal(line(ax, "landmarks").get_xydata(), landmarks)
    colours = [to_rgb(line(ax, label).get_color()) for label in ("filtered", "smoothed")]
    assert colours[0] != colours[1]
    assert [to_rgb(c.get_edgecolor()[0]) for c in collections(ax)] == colours
    shown = {text.get_text() for text in ax.get_legend().get_texts()}
    assert shown == {"filtered", "smoothed", "truth", "landmarks"}


def test_a_lone_path_has_no_legend_and_takes_the_colour_given():
    ax = pgm.plot.trajectory(belief(5), colour="#123456")
    assert ax.get_legend() is None
    assert line(ax, "estimate of x").get_color() == "#123456"
    assert to_hex(collections(ax)[0].get_edgecolor()[0]) == "#123456"


def test_one_step_is_a_point_with_its_ellipse():
    gaussian = pgm.Gaussian(X.at(3), [1.0, 2.0, 0.1], np.eye(3))
    ax = pgm.plot.trajectory(gaussian, truth=[1.5, 2.5, 0.0])
    assert len(collections(ax)[0].get_offsets()) == 1
    assert line(ax, "estimate of x[3]").get_marker() == "o"
    ax.figure.canvas.draw()


def test_truth_may_have_its_own_steps_runs_and_gaps():
    truth = np.zeros((2, 50, 3))
    truth[1, 10] = np.nan
    ax = pgm.plot.trajectory(belief(5), truth=truth)
    assert sum(len(line.get_xdata()) == 50 for line in ax.lines) == 2
    ax.figure.canvas.draw()


def test_axes_with_shared_limits_can_be_drawn_on():
    fig, axes = plt.subplots(1, 2, sharex=True, sharey=True)
    for ax in axes:
        pgm.plot.trajectory(belief(5), ax=ax)
    fig.canvas.draw()


def test_labels_of_the_axes_are_kept():
    _, ax = plt.subplots()
    ax.set_xlabel("east [m]")
    pgm.plot.trajectory(belief(5), ax=ax)
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("east [m]", "north")


def test_several_runs_are_refused_with_the_way_to_pick_one():
    runs = pgm.Gaussian(X, np.zeros((4, 9, 3)), np.eye(3), steps=range(9))
    for draw in (pgm.plot.trajectory, lambda g: pgm.plot.errors(g, np.zeros((9, 3)))):
        with pytest.raises(pgm.ModelError, match=r"which are 4 runs; pick one") as caught:
            draw(runs)
        assert caught.value.variable == X
    with pytest.raises(pgm.ModelError, match=r"9 runs \(or give steps= if they are steps\)"):
        pgm.plot.trajectory(pgm.Gaussian(X, np.zeros((9, 3)), np.eye(3)))
    one = pgm.Gaussian(X, runs.mean[0], runs.cov[0], steps=runs.steps)  # as the message says
    pgm.plot.trajectory(one)
    pgm.plot.trajectory(pgm.Gaussian(X, runs.mean[:1], runs.cov[:1], steps=runs.steps))


@pytest.mark.parametrize(
    ("wrong", "match"),
    [
        ({"every": 0}, "every must be a number of steps"),
        ({"every": 2.5}, "every must be a number of steps"),
        ({"landmarks": [1.0, 2.0]}, r"landmarks have shape \(2,\); \(L, 2\) was due"),
        ({"truth": np.zeros((5, 1))}, r"truth has shape \(5, 1\)"),
        ({"components": ("east", "up")}, "no single component 'up'"),
        ({"confidence": 1.0}, "confidence lies between 0 and 1"),
        ({"ax": plt}, "one matplotlib Axes, not module"),
    ],
)
def test_wrong_arguments_are_refused_before_anything_is_drawn(wrong, match):
    with pytest.raises(pgm.ModelError, match=match):
        pgm.plot.trajectory(belief(5), **wrong)
    assert not plt.get_fignums()


def test_no_steps_draw_nothing():
    empty = pgm.Gaussian(X, np.zeros((0, 3)), np.zeros((0, 3, 3)), steps=[])
    ax = pgm.plot.trajectory(empty)
    assert len(collections(ax)[0].get_offsets()) == 0
    ax.figure.canvas.draw()


# --- errors


def test_errors_are_the_means_less_the_truth_with_angles_wrapped():
    gaussian = belief(20)
    truth = gaussian.mean - [1.0, -2.0, 2 * np.pi - 0.1]
    axes = pgm.plot.errors(gaussian, truth, sigma=2.0)
    assert [ax.get_ylabel() for ax in axes] == [
        "east error",
        "north error",
        "heading error [rad]",
    ]
    for k, (ax, due) in enumerate(zip(axes, [1.0, -2.0, -0.1], strict=True)):
        drawn = line(ax, "error")
        np.testing.assert_allclose(drawn.get_ydata(), due)
        np.testing.assert_array_equal(drawn.get_xdata(), gaussian.steps)
        (band,) = ax.collections
        heights = band.get_paths()[0].vertices[:, 1]
        np.testing.assert_allclose(
            np.unique(np.abs(heights[1:-1])), np.unique(2.0 * gaussian.std[:, k])
        )
        assert heights.min() < 0 < heights.max()
    assert axes[-1].get_xlabel() == "step"
    assert {t.get_text() for t in axes[0].get_legend().get_texts()} == {"error", "±2σ"}


def test_two_beliefs_share_axes_in_different_colours():
    gaussian = belief(20)
    axes = pgm.plot.errors(gaussian, gaussian.mean, label="filtered")
    again = pgm.plot.errors(gaussian, gaussian.mean + 1.0, label="smoothed", axes=axes)
    assert again == axes
    for ax in axes:
        assert len(ax.lines) == 3  # the zero line once
        assert line(ax, "filtered").get_color() != line(ax, "smoothed").get_color()


def test_components_times_and_one_axes():
    _, ax = plt.subplots()
    gaussian, times = belief(20), np.linspace(0.0, 2.0, 20)
    found = pgm.plot.errors(
        gaussian, np.zeros((20, 3)), components=["heading"], times=times, axes=ax
    )
    assert found == (ax,)
    np.testing.assert_array_equal(line(ax, "error").get_xdata(), times)
    wrapped = (gaussian.mean[:, 2] + np.pi) % (2 * np.pi) - np.pi
    np.testing.assert_allclose(line(ax, "error").get_ydata(), wrapped)
    assert ax.get_xlabel() == "time"


def test_an_array_of_axes_from_subplots_will_do():
    fig, axes = plt.subplots(1, 3)
    assert pgm.plot.errors(belief(9), np.zeros((9, 3)), axes=axes) == tuple(axes)
    assert len(plt.get_fignums()) == 1
    fig.canvas.draw()


def test_one_step_and_zero_covariances_can_be_drawn():
    gaussian = pgm.Gaussian(X.at(7), np.zeros(3), np.zeros((3, 3)))
    axes = pgm.plot.errors(gaussian, np.ones(3))
    assert line(axes[0], "error").get_xdata().tolist() == [7]
    axes[0].figure.canvas.draw()


@pytest.mark.parametrize(
    ("truth", "wrong", "match"),
    [
        (np.zeros((8, 3)), {}, r"truth has \(8,\) steps where the belief has 9"),
        (np.zeros((2, 9, 3)), {}, r"truth has \(2, 9\) steps"),
        (np.zeros((9, 2)), {}, "at least 3 of them"),
        (np.zeros((9, 3)), {"sigma": 0.0}, "above 0, not 0.0"),
        (np.zeros((9, 3)), {"times": np.zeros(8)}, r"times has shape \(8,\); \(9,\) was due"),
        (np.zeros((9, 3)), {"components": ["up"]}, "no single component 'up'"),
        (np.zeros((9, 3)), {"components": "east"}, "sequence of names"),
        (np.zeros((9, 3)), {"components": []}, "no components to draw"),
        (np.zeros((9, 3)), {"axes": [1, 2, 3]}, "one matplotlib Axes, not int"),
    ],
)
def test_wrong_arguments_of_errors_are_refused(truth, wrong, match):
    with pytest.raises(pgm.ModelError, match=match):
        pgm.plot.errors(belief(9), truth, **wrong)
    assert not plt.get_fignums()


def test_the_number_of_axes_must_be_that_of_components():
    with pytest.raises(pgm.ModelError, match="2 axes for 3 components"):
        pgm.plot.errors(belief(9), np.zeros((9, 3)), axes=plt.subplots(2)[1])


# --- the package


# --- what several beliefs on one axes share


def test_paths_that_coincide_can_be_told_apart_and_the_truth_is_drawn_once():
    gaussian, truth = belief(30), belief(30).mean
    ax = None
    for k in range(14):
        ax = pgm.plot.trajectory(gaussian, truth=truth, label=f"{k}", ax=ax)
    paths = [line for line in ax.lines if line.get_label().isdigit()]
    looks = {(to_hex(line.get_color()), line.get_linestyle()) for line in paths}
    assert len(looks) == len(paths) == 14
    assert paths[0].get_linewidth() > 1.5 * paths[1].get_linewidth()
    assert paths[1].get_linestyle() == "--"
    right = [line for line in ax.lines if line.get_label() == "truth"]
    assert len(right) == 1
    assert paths[0].get_zorder() < right[0].get_zorder() < paths[1].get_zorder()
    texts = [text.get_text() for text in ax.get_legend().get_texts()]
    assert texts == ["truth", *(f"{k}" for k in range(14))]
    ax = pgm.plot.trajectory(gaussian, dash=":")
    assert ax.lines[-1].get_linestyle() == ":"


def test_landmarks_are_marked_once():
    places = np.array([[1.0, 2.0], [3.0, 4.0]])
    ax = pgm.plot.trajectory(belief(9), landmarks=np.tile(places, (50, 1)))
    pgm.plot.trajectory(belief(9), landmarks=places, ax=ax)
    (marks,) = [line for line in ax.lines if line.get_label() == "landmarks"]
    np.testing.assert_array_equal(marks.get_xydata(), places)


@pytest.mark.parametrize(
    ("unit", "due"),
    [
        (None, ["east error", "north error", "heading error [rad]"]),
        ("m", ["east error [m]", "north error [m]", "heading error [rad]"]),
        (
            {"east": "km", "heading": "turns"},
            ["east error [km]", "north error", "heading error [turns]"],
        ),
    ],
)
def test_errors_have_units(unit, due):
    axes = pgm.plot.errors(belief(9), belief(9).mean, unit=unit)
    assert [ax.get_ylabel() for ax in axes] == due
    ax = pgm.plot.trajectory(belief(9), unit="m")
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("east [m]", "north [m]")


def test_units_that_are_no_texts_are_refused():
    with pytest.raises(pgm.ModelError, match=r"unit= is a text.*found 3"):
        pgm.plot.trajectory(belief(9), unit=3)


@pytest.mark.parametrize("draw", [pgm.plot.errors, pgm.plot.rmse, pgm.plot.trajectory])
def test_units_of_components_that_are_none_are_refused(draw):
    truth = {} if draw is pgm.plot.trajectory else {"truth": belief(9).mean}
    told = r"unit= is given of 'est'; the components are \['east', 'north', 'heading'\]"
    with pytest.raises(pgm.ModelError, match=told):
        draw(belief(9), **truth, unit={"est": "m"})


def test_the_rmse_of_a_later_belief_is_not_cut():
    small, large = belief(9), belief(9, seed=1)
    ax = pgm.plot.rmse(small, small.mean + 0.1, unit="m")
    pgm.plot.rmse(large, large.mean + 5.0, ax=ax)
    low, high = ax.get_ylim()
    assert low == 0.0
    assert high > max(line.get_ydata().max() for line in ax.lines)


def test_ellipses_of_a_mixture_are_as_dark_as_they_weigh():
    x = pgm.Variable("x", components=("a", "b"))
    each = pgm.Gaussian(x, [[0.0, 0.0], [5.0, 0.0], [9.0, 9.0]], np.eye(2))
    ax = pgm.plot.ellipses(pgm.GaussianMixture([0.64, 0.355, 0.005], each))
    (drawn,) = ax.collections
    edges = drawn.get_edgecolor()
    assert len(edges) == 2  # the third is too unlikely to be seen
    np.testing.assert_allclose(edges[:, 3], 0.75 * np.sqrt([0.64, 0.355]))
    assert ax.get_xlim()[1] < 9.0
    plt.close(ax.figure)


def test_the_path_of_a_mixture_is_that_of_its_mean():
    x = pgm.Variable("x", components=("a", "b"))
    means = np.array([[[0.0, 0.0], [2.0, 0.0]], [[1.0, 1.0], [3.0, 1.0]]])
    mixture = pgm.GaussianMixture(
        [[0.5, 0.5], [0.25, 0.75]], pgm.Gaussian(x, means, np.eye(2)), steps=[0, 1]
    )
    ax = pgm.plot.trajectory(mixture)
    (line,) = ax.lines
    np.testing.assert_allclose(line.get_xydata(), [[1.0, 0.0], [2.5, 1.0]])
    assert len(ax.collections[0].get_offsets()) == 4
    assert mixture[1:].steps.tolist() == [1]
    assert mixture[1].steps is None
    assert "steps 0..1" in repr(mixture)
    plt.close(ax.figure)
