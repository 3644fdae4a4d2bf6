"""Beliefs over finitely many states: maps of cells, and rows through time."""

import matplotlib.pyplot as plt
import numpy as np
import pytest
from matplotlib.colors import to_hex
from matplotlib.patches import Rectangle

import pgm
import pgm.plot

ROW = pgm.Discrete("row", ("top", "bottom"))
COLUMN = pgm.Discrete("column", ("left", "middle", "right"))
CELL = pgm.Discrete("cell", tuple("abcdef"))
PLACES = np.array([[0, 0], [0, 2], [1, 0], [1, 1], [2, 1], [3, 2]])


def entries(*shape, seed=0):
    return np.random.default_rng(seed).random(shape)


def mesh(ax):
    """The probabilities drawn, and where: (rows, columns), corners in x and y."""
    (drawn,) = ax.collections
    return drawn.get_array(), drawn.get_coordinates()


# --- maps


def test_a_map_of_rows_and_columns_is_the_table():
    values = entries(2, 3)
    ax = pgm.plot.belief_map(pgm.Table((ROW, COLUMN), 7.0 * values))
    drawn, corners = mesh(ax)
    np.testing.assert_allclose(drawn, values / values.sum())
    np.testing.assert_array_equal(corners[0, :, 0], [-0.5, 0.5, 1.5, 2.5])
    np.testing.assert_array_equal(corners[:, 0, 1], [-0.5, 0.5, 1.5])
    assert ax.get_ylim() == (1.5, -0.5)  # the first row is on top
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("column", "row")
    assert [label.get_text() for label in ax.get_yticklabels()] == ["top", "bottom"]
    written = {text.get_position(): text.get_text() for text in ax.texts}
    assert written[1, 0] == f"{values[0, 1] / values.sum():.3g}"
    assert len(written) == 6
    ax.figure.canvas.draw()


def test_a_map_of_cells_has_them_at_their_places():
    values = entries(6)
    ax = pgm.plot.belief_map(pgm.Table(CELL, values), places=PLACES, outside="#123456")
    drawn, _ = mesh(ax)
    assert drawn.shape == (4, 3)
    np.testing.assert_allclose(drawn[tuple(PLACES.T)], values / values.sum())
    assert (~np.ma.getmaskarray(drawn)).sum() == 6
    assert to_hex(ax.get_facecolor()) == "#123456"
    assert not ax.get_xticks().size
    ax.figure.canvas.draw()


def test_places_may_begin_anywhere():
    ax = pgm.plot.belief_map(pgm.Table(CELL, entries(6)), places=PLACES + np.array([10, -4]))
    assert ax.get_xlim() == (-4.5, -1.5)
    assert ax.get_ylim() == (13.5, 9.5)


def test_darkest_is_the_most_probable_or_what_is_said():
    table = pgm.Table(CELL, [1, 2, 3, 4, 5, 5])
    alone = pgm.plot.belief_map(table, places=PLACES).collections[0]
    assert alone.get_clim() == (0.0, 0.25)
    shared = pgm.plot.belief_map(table, places=PLACES, most=0.8).collections[0]
    assert shared.get_clim() == (0.0, 0.8)


@pytest.mark.parametrize("truth", ["d", 3, np.int64(3)])
def test_the_right_cell_is_framed(truth):
    ax = pgm.plot.belief_map(pgm.Table(CELL, entries(6)), places=PLACES, truth=truth)
    (frame,) = [p for p in ax.patches if isinstance(p, Rectangle)]
    assert frame.get_center() == pytest.approx((1.0, 1.0))


@pytest.mark.parametrize("truth", [("bottom", "right"), (1, 2)])
def test_the_right_row_and_column_are_framed(truth):
    ax = pgm.plot.belief_map(pgm.Table((ROW, COLUMN), entries(2, 3)), truth=truth)
    (frame,) = ax.patches
    assert frame.get_center() == pytest.approx((2.0, 1.0))


def test_numbers_are_written_where_they_can_be_read():
    many = pgm.Discrete("many", tuple(map(str, range(49))))
    places = np.moveaxis(np.indices((7, 7)), 0, -1).reshape(-1, 2)
    table = pgm.Table(many, entries(49))
    assert not pgm.plot.belief_map(table, places=places).texts
    assert len(pgm.plot.belief_map(table, places=places, numbers=True).texts) == 49
    small = pgm.Table(CELL, [0, 1e-9, 1, 1, 1, 1])
    written = {text.get_text() for text in pgm.plot.belief_map(small, places=PLACES).texts}
    assert written == {"0", "2e-10", "0.25"}
    assert not pgm.plot.belief_map(small, places=PLACES, numbers=False).texts


def test_two_maps_in_given_axes():
    fig, axes = plt.subplots(1, 2)
    for ax in axes:
        assert pgm.plot.belief_map(pgm.Table(CELL, entries(6)), places=PLACES, ax=ax) is ax
    fig.colorbar(axes[0].collections[0], ax=axes)
    fig.canvas.draw()


@pytest.mark.parametrize(
    ("belief", "settings", "told"),
    [
        (np.ones(6), {}, "a Table, not array"),
        (pgm.Table(CELL, entries(6)), {}, "places are the cells of a table over one"),
        (pgm.Table((ROW, COLUMN), entries(2, 3)), {"places": PLACES}, "a table over two has"),
        (pgm.Table(CELL, entries(4, 6), lead=4), {"places": PLACES}, r"leading axes \(4,\)"),
        (pgm.Table(CELL, entries(6)), {"places": PLACES[:5]}, r"\(5, 2\) of int64; .* \(6, 2\)"),
        (pgm.Table(CELL, entries(6)), {"places": 1.0 * PLACES}, "of float64; whole numbers"),
        (pgm.Table(CELL, entries(6)), {"places": 0 * PLACES}, "two states have the same place"),
        (pgm.Table(CELL, entries(6)), {"places": PLACES, "most": 0.0}, "most must be a prob"),
        (pgm.Table(CELL, entries(6)), {"places": PLACES, "truth": "g"}, "no state 'g'"),
        (pgm.Table(CELL, entries(6)), {"places": PLACES, "truth": (1, 2)}, "has 2 parts; one"),
        (pgm.Table((ROW, COLUMN), entries(2, 3)), {"truth": "top"}, "has 1 parts; one"),
    ],
)
def test_a_map_refuses_what_it_cannot_draw(belief, settings, told):
    with pytest.raises(pgm.ModelError, match=told):
        pgm.plot.belief_map(belief, **settings)
    assert not plt.get_fignums()


def test_a_belief_of_nothing_is_no_map():
    with pytest.raises(pgm.NumericalError, match="all zero"):
        pgm.plot.belief_map(pgm.Table(CELL, np.zeros(6)), places=PLACES)


# --- rows through time


def beliefs(count, seed=0, states=6):
    cell = pgm.Discrete("cell", tuple(f"c{k}" for k in range(states)))
    return pgm.Table(cell, entries(count, states, seed=seed), lead=count)


def outlines(ax, colour=None):
    """The steps of each row's outline: probabilities in units of a full row."""
    lines = [line for line in ax.lines if len(line.get_xdata()) > 3]
    return [
        line.get_ydata()[0] - line.get_ydata()[2:-1]
        for line in lines
        if colour is None or to_hex(line.get_color()) == colour
    ]


def test_rows_are_the_beliefs_on_one_scale():
    belief = beliefs(5)
    ax = pgm.plot.beliefs_over_time(belief)
    rows = np.array(outlines(ax))
    assert rows.shape == (5, 6)
    np.testing.assert_allclose(rows / rows.max(), belief.probabilities / belief.probabilities.max())
    assert rows.max() < 1.0  # a row does not reach the one above
    assert ax.get_ylim()[0] > ax.get_ylim()[1]  # time goes down
    assert [label.get_text() for label in ax.get_yticklabels()] == list("01234")
    assert [label.get_text() for label in ax.get_xticklabels()] == list(belief.scope[0].states)
    high = belief.probabilities.max()
    assert ax.get_ylabel() == f"step (full height: probability {high:.2g})"
    assert ax.get_legend() is None
    ax.figure.canvas.draw()


def test_the_smoother_is_drawn_over_the_filter_on_its_scale():
    first, second = beliefs(5), beliefs(5, seed=1)
    ax = pgm.plot.beliefs_over_time(first, label="filtered", truth=[0, 1, 2, 3, 4])
    assert pgm.plot.beliefs_over_time(second, label="smoothed", ax=ax) is ax
    blue, orange = (np.array(outlines(ax, colour)) for colour in ("#0072b2", "#d55e00"))
    np.testing.assert_allclose(
        blue / first.probabilities, np.full((5, 6), (blue / first.probabilities)[0, 0])
    )
    np.testing.assert_allclose(orange / second.probabilities, (blue / first.probabilities)[0, 0])
    shown = [text.get_text() for text in ax.get_legend().get_texts()]
    assert sorted(shown) == ["filtered", "smoothed", "truth"]
    filled = [c for c in ax.collections if len(c.get_facecolor())]
    assert len(filled) == 5


def test_what_is_filled_and_how_high_may_be_said():
    ax = pgm.plot.beliefs_over_time(beliefs(3), full=0.5, filled=False, colour="#112233")
    assert not ax.collections
    rows = np.array(outlines(ax, "#112233"))
    np.testing.assert_allclose(beliefs(3).probabilities / rows, 0.5 / 0.86)
    pgm.plot.beliefs_over_time(beliefs(3), full=0.5, ax=ax)
    with pytest.raises(pgm.ModelError, match=r"full is 0\.7, but rows of these axes are 0\.5 high"):
        pgm.plot.beliefs_over_time(beliefs(3), full=0.7, ax=ax)


def test_the_truth_stands_at_its_states():
    names = ["c5", "c0", "c2"]
    ax = pgm.plot.beliefs_over_time(beliefs(3), truth=names)
    (marks,) = [c for c in ax.collections if c.get_label() == "truth"]
    found = [segment[:, 0] for segment in marks.get_segments()]
    np.testing.assert_array_equal(found, [[5, 5], [0, 0], [2, 2]])


@pytest.mark.parametrize(("count", "due"), [(16, range(16)), (17, range(0, 17, 2)), (101, 15)])
def test_as_many_rows_as_can_be_read(count, due):
    ax = pgm.plot.beliefs_over_time(beliefs(count))
    steps = [int(label.get_text()) for label in ax.get_yticklabels()]
    assert steps == list(due) if isinstance(due, range) else len(steps) == due


def test_steps_are_drawn_in_the_order_given():
    belief = beliefs(9)
    ax = pgm.plot.beliefs_over_time(belief, steps=[8, 0, 4], truth=np.arange(9) % 6)
    assert [label.get_text() for label in ax.get_yticklabels()] == ["8", "0", "4"]
    rows = np.array(outlines(ax))
    shown = belief.probabilities[[8, 0, 4]]
    np.testing.assert_allclose(rows / rows.max(), shown / shown.max())
    (marks,) = [c for c in ax.collections if c.get_label() == "truth"]
    assert [segment[0, 0] for segment in marks.get_segments()] == [2, 0, 4]


X = pgm.Variable("x")
GRID = pgm.filter(
    pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(X, 2.0, 0.2)], [pgm.LinearGaussianCPD(X, {X.previous: 1.0}, cov=0.2)], []
    ),
    {},
    steps=1,
    belief=pgm.Grid({"x": (-6.0, 10.0, 4)}),
)


def test_of_many_states_some_are_named():
    ax = pgm.plot.beliefs_over_time(beliefs(2, states=200))
    ax.figure.canvas.draw()
    shown = [label.get_text() for label in ax.get_xticklabels() if label.get_text()]
    assert 3 < len(shown) <= 16
    assert set(shown) <= {f"c{k}" for k in range(200)}


@pytest.mark.parametrize(
    ("belief", "settings", "told"),
    [
        ([0.5, 0.5], {}, r"a Table, not \[0\.5, 0\.5\]"),
        (GRID[X], {}, r"GridBelief\(x 4, .* is drawn by grid_map, or over time by animate"),
        (
            pgm.Table(CELL, entries(6)),
            {},
            r"leading axes \(\); give beliefs over one variable with one",
        ),
        (pgm.Table(CELL, entries(2, 3, 6), lead=(2, 3)), {}, r"leading axes \(2, 3\)"),
        (pgm.Table((ROW, COLUMN), entries(4, 2, 3), lead=4), {}, "beliefs over one variable"),
        (beliefs(0), {}, "beliefs over no steps"),
        (beliefs(3), {"steps": [0, 3]}, r"steps are 0 to 2; found \[0, 3\]"),
        (beliefs(3), {"steps": []}, "steps must be a sequence of whole numbers"),
        (beliefs(3), {"steps": [0.5]}, "steps must be a sequence of whole numbers"),
        (beliefs(3), {"truth": [0, 1]}, r"the truth has shape \(2,\); \(3,\) was due"),
        (beliefs(3), {"truth": ["c0", "c1", "c9"]}, "no state 'c9'"),
        (beliefs(3), {"full": -1.0}, "full must be a probability above 0"),
    ],
)
def test_rows_refuse_what_they_cannot_draw(belief, settings, told):
    with pytest.raises(pgm.ModelError, match=told):
        pgm.plot.beliefs_over_time(belief, **settings)
    assert not plt.get_fignums()


# --- bands


def test_bands_stand_one_upon_the_other_and_a_strip_tells_the_right_states():
    values = np.array([[0.5, 0.3, 0.2], [0.1, 0.6, 0.3], [0.0, 0.0, 1.0]])
    ax = pgm.plot.bands(pgm.Table(COLUMN, values, lead=3), truth=["left", "middle", "right"])
    tops = [band.get_paths()[0].get_extents().y1 for band in ax.collections[:3]]
    np.testing.assert_allclose(tops, [0.5, 0.8, 1.0])
    assert [text.get_text() for text in ax.get_legend().get_texts()] == list(COLUMN.states)
    right = [band.get_paths()[0].get_extents() for band in ax.collections[3:]]
    assert [(strip.x0, strip.x1) for strip in right] == [(-0.5, 0.5), (0.5, 1.5), (1.5, 2.5)]
    assert [text.get_text() for text in ax.texts] == ["truth"]
    plt.close(ax.figure)


@pytest.mark.parametrize(
    ("belief", "options", "words"),
    [
        (pgm.Table(COLUMN, np.ones(3)), {}, "with one leading axis, of steps"),
        (pgm.Table(COLUMN, np.ones((2, 3)), lead=2), {"truth": [0]}, "a state at each step"),
        (pgm.Table(COLUMN, np.ones((2, 3)), lead=2), {"colours": ["red"]}, "one for each of 3"),
        (pgm.Table(pgm.Discrete("many", 13), np.ones((2, 13)), lead=2), {}, "beliefs_over_time"),
    ],
)
def test_bands_refuse_what_they_cannot_draw(belief, options, words):
    with pytest.raises(pgm.PgmError, match=words):
        pgm.plot.bands(belief, **options)
