"""Maps of beliefs on grids."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

import pgm
import pgm.plot
from pgm.errors import ModelError

x = pgm.Variable("x", components=("east", "north", "heading"), angles=("heading",))


@pytest.fixture(scope="module")
def posterior():
    """A robot of an unknown heading about a place: it has gone one ahead."""

    def ahead(x):
        heading = x[..., 2]
        return x + np.stack([np.cos(heading), np.sin(heading), 0 * heading], axis=-1)

    model = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(x, [2.0, 1.0, 0.0], np.diag([0.05, 0.05, np.inf]))],
        [pgm.NonlinearGaussianCPD(x, x.previous, ahead, np.diag([0.04, 0.04, 0.02]))],
    )
    on = pgm.Grid({"east": (-1.0, 5.0, 40), "north": (-2.0, 4.0, 30), "heading": 24})
    return pgm.filter(model, {}, steps=1, belief=on)


def test_cells_are_the_marginal_and_arrows_point_outwards(posterior):
    belief = posterior[x.at(1)]
    ax = pgm.plot.grid_map(belief, truth=[3.0, 1.0, 0.0], landmarks=[[0.0, 0.0], [4.0, 3.0]])
    mesh, quiver = ax.collections
    assert_allclose(mesh.get_array().reshape(30, 40), belief.values.sum(axis=2).T)
    corners = mesh.get_coordinates()
    assert_allclose(corners[[0, -1], [0, -1]], [[-1.0, -2.0], [5.0, 4.0]])
    outwards = quiver.get_offsets() - [2.0, 1.0]
    far = np.hypot(*outwards.T) > 0.8
    along = (quiver.U * outwards[:, 0] + quiver.V * outwards[:, 1])[far]
    assert far.sum() > 10
    assert (along > 0.5 * np.hypot(quiver.U, quiver.V)[far] * np.hypot(*outwards[far].T)).all()
    block = 3 * 6.0 / 40  # 40 cells, no more than 16 arrows
    assert np.hypot(quiver.U, quiver.V).max() <= 0.9 * block + 1e-12
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("east", "north")
    assert {line.get_label() for line in ax.lines} == {"landmarks", "truth"}


def test_a_map_of_other_components_has_no_arrows(posterior):
    ax = pgm.plot.grid_map(posterior[x.at(0)], components=("heading", "east"))
    assert len(ax.collections) == 1
    assert ax.get_xlabel() == "heading"
    assert len(pgm.plot.grid_map(posterior[x.at(0)], arrows=0).collections) == 1


def test_arrows_turn_with_the_plane(posterior):
    """A heading is counted from east to north, on a map whose axes are north and east too."""
    belief = posterior[x.at(1)]
    ax = pgm.plot.grid_map(belief, components=("north", "east"))
    quiver = ax.collections[1]
    outwards = quiver.get_offsets() - [1.0, 2.0]
    far = np.hypot(*outwards.T) > 0.8
    along = (quiver.U * outwards[:, 0] + quiver.V * outwards[:, 1])[far]
    assert (along > 0.5 * np.hypot(quiver.U, quiver.V)[far] * np.hypot(*outwards[far].T)).all()


def test_arrows_of_flat_cells_do_not_cross(posterior):
    on = pgm.Grid({"east": (-1.0, 5.0, 12), "north": (-2.0, 4.0, 90), "heading": 24})
    belief = pgm.filter(posterior.graph.model, {}, steps=1, belief=on)[x.at(1)]
    quiver = pgm.plot.grid_map(belief).collections[1]
    north = np.unique(np.round(quiver.get_offsets()[:, 1], 9))
    assert np.hypot(quiver.U, quiver.V).max() <= 0.9 * np.diff(north).min() + 1e-9


def test_what_cannot_be_drawn(posterior):
    belief = posterior[x.at(0)]
    faults = [
        (posterior[x], {}, "pick one"),
        (belief.gaussian(), {}, "not a Gaussian"),
        (belief.marginal("east", "heading"), {}, "two components"),
        (belief, {"components": ("east", "up")}, "no component"),
        (belief, {"components": 3}, "two components"),
        (belief, {"components": ("east", ["north"])}, "by name"),
        (belief, {"heading": "up"}, "no angle"),
        (belief, {"heading": "north", "components": ("east", "heading")}, "no angle"),
        (belief, {"arrows": -1}, "0 or more"),
        (belief, {"arrows": True}, "0 or more"),
        (belief, {"truth": ["here", 1.0, 2.0]}, "truth must be numbers"),
        (belief, {"landmarks": "there"}, "landmarks must be numbers"),
        (belief, {"truth": [1.0, 2.0]}, "truth has shape"),
        (belief, {"landmarks": [1.0, 2.0]}, "landmarks have shape"),
    ]
    for what, how, match in faults:
        with pytest.raises(ModelError, match=match):
            pgm.plot.grid_map(what, **how)
