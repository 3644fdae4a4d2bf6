"""Pictures of occupancy grids."""

import numpy as np
import pytest
from matplotlib.colors import to_rgb
from numpy.testing import assert_allclose

import pgm
from pgm.errors import ModelError
from pgm.maps import OccupancyMap

# Free below, an obstacle, something not known, and something likelier than not above.
CELLS = [[0.0, 0.0, 0.0], [1.0, np.nan, 0.6]]


def colour(ax, point):
    """The colour that a picture has at a point."""
    ax.figure.canvas.draw()
    picture = np.asarray(ax.figure.canvas.buffer_rgba())
    column, row = ax.transData.transform(point)
    return picture[len(picture) - 1 - int(row), int(column), :3] / 255.0


@pytest.mark.parametrize("yaw", [0.0, 0.7, -2.0])
def test_each_cell_is_where_it_is(yaw):
    drawn = OccupancyMap(CELLS, 0.5, (3.0, -1.0, yaw))
    ax = pgm.plot.occupancy_map(drawn)
    rows, columns = np.mgrid[:2, :3]
    found = {
        (i, j): colour(ax, point)
        for i, j, point in zip(
            rows.flat, columns.flat, drawn.centres(rows, columns).reshape(-1, 2), strict=True
        )
    }
    for j in range(3):
        assert_allclose(found[0, j], 1.0)
    assert_allclose(found[1, 0], 0.0)
    assert_allclose(found[1, 1], to_rgb("#D5E3EE"), atol=0.01)
    assert np.ptp(found[1, 2]) < 0.02
    assert 0.2 < found[1, 2].mean() < 0.8
    assert ax.get_aspect() == 1.0
    corners = drawn.centres([-0.5, -0.5, 1.5, 1.5], [-0.5, 2.5, -0.5, 2.5])
    low, high = np.transpose([ax.get_xlim(), ax.get_ylim()])
    assert (corners >= low - 1e-9).all()
    assert (corners <= high + 1e-9).all()


def test_it_lies_below_and_takes_a_style():
    ax = pgm.plot.occupancy_map(OccupancyMap(CELLS, 0.5), alpha=0.5)
    assert pgm.plot.occupancy_map(OccupancyMap(CELLS, 0.5, (1, 1, 1)), ax=ax, zorder=3) is ax
    (image,), (mesh,) = ax.images, ax.collections
    assert (image.get_alpha(), image.get_zorder(), mesh.get_zorder()) == (0.5, -1.0, 3)
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("x [m]", "y [m]")


def test_what_is_no_map_is_refused():
    with pytest.raises(ModelError, match="draws an OccupancyMap, not a list"):
        pgm.plot.occupancy_map(CELLS)
    with pytest.raises(ModelError, match="ax must be one matplotlib Axes"):
        pgm.plot.occupancy_map(OccupancyMap(CELLS, 0.5), ax=[1, 2])
