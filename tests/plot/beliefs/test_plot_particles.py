"""Clouds of particles, and their Gaussians, as pictures."""

import numpy as np
import pytest
from matplotlib.collections import EllipseCollection, PathCollection
from matplotlib.quiver import Quiver
from numpy.testing import assert_allclose

import pgm
import pgm.plot
from pgm.errors import ModelError

x = pgm.Variable("x", components=("east", "north", "heading"), angles=("heading",))
z = pgm.Variable("z", components=("east", "north"))


@pytest.fixture(scope="module")
def posterior():
    """A robot of a heading hardly known that has gone three ahead, and then been seen."""

    def ahead(x):
        heading = x[..., 2]
        return x + np.stack([3 * np.cos(heading), 3 * np.sin(heading), 0 * heading], axis=-1)

    model = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(x, [2.0, 1.0, 1.0], np.diag([0.01, 0.01, 0.3]))],
        [pgm.NonlinearGaussianCPD(x, x.previous, ahead, np.diag([0.01, 0.01, 0.001]))],
        [pgm.LinearGaussianCPD(z, given={x: np.eye(2, 3)}, cov=np.eye(2))],
    )
    return pgm.filter(model, {z: [[4.5, 3.0]]}, belief=pgm.Particles(800, seed=1))


def drawn(ax):
    (points,) = (c for c in ax.collections if isinstance(c, PathCollection))
    ticks = [c for c in ax.collections if isinstance(c, Quiver)]
    return points, ticks


def test_points_are_the_particles_by_weight_and_ticks_their_headings(posterior):
    belief = posterior[x.at(1)]
    ax = pgm.plot.particles(belief, truth=[4.0, 3.0, 0.0], landmarks=[[0.0, 0.0]])
    points, (ticks,) = drawn(ax)
    assert_allclose(points.get_offsets(), belief.states[:, :2])
    shares = 800 * belief.weights
    assert shares.max() > 2.0
    assert_allclose(points.get_sizes(), points.get_sizes()[0] / shares[0] * shares)
    assert_allclose(np.arctan2(ticks.V, ticks.U), np.angle(np.exp(1j * belief.states[:, 2])))
    assert_allclose(np.hypot(ticks.U, ticks.V), 1.0)
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("east", "north")
    assert {line.get_label() for line in ax.lines} == {"landmarks", "truth"}


def test_no_more_are_drawn_than_asked_for_and_in_proportion(posterior):
    belief = posterior[x.at(1)]
    points, _ = drawn(pgm.plot.particles(belief, most=100))
    offsets, sizes = np.asarray(points.get_offsets()), points.get_sizes()
    assert len(offsets) <= 100
    known = {tuple(place): w for place, w in zip(belief.states[:, :2], belief.weights, strict=True)}
    weights = np.array([known[tuple(place)] for place in offsets])
    times = sizes / sizes.min()
    assert_allclose(times, np.round(times), atol=1e-9)  # whole teeth of the comb
    assert (np.abs(times - 100 * weights) < 1.0).all()
    mean = times @ offsets / times.sum()
    assert_allclose(mean, belief.mean[:2], atol=0.1)


def test_one_particle_with_all_the_weight_stays_in_the_picture():
    model = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(z, [0.0, 0.0], np.eye(2))],
        [pgm.LinearGaussianCPD(z, given={z.previous: 1.0}, cov=np.eye(2))],
        [pgm.LinearGaussianCPD(y := pgm.Variable("y"), given={z: [[1.0, 0.0]]}, cov=1e-8)],
    )
    with pytest.warns(pgm.ParticleWarning, match="worth"):
        found = pgm.filter(model, {y: [[0.5]]}, belief=pgm.Particles(300, seed=2))
    points, ticks = drawn(pgm.plot.particles(found[z.at(1)]))
    assert not ticks
    assert points.get_sizes().max() == pytest.approx(25 * 7.0)


def test_ticks_turn_with_the_plane_and_may_be_left_out(posterior):
    belief = posterior[x.at(1)]
    points, (ticks,) = drawn(pgm.plot.particles(belief, components=("north", "east")))
    assert_allclose(points.get_offsets(), belief.states[:, [1, 0]])
    assert_allclose(np.arctan2(ticks.U, ticks.V), np.angle(np.exp(1j * belief.states[:, 2])))
    assert not drawn(pgm.plot.particles(belief, ticks=False))[1]
    assert not drawn(pgm.plot.particles(belief, components=("heading", "east")))[1]


def test_style_wins(posterior):
    points, _ = drawn(pgm.plot.particles(posterior[x.at(1)], c="red", s=4.0, alpha=1.0))
    assert points.get_facecolor().tolist() == [[1.0, 0.0, 0.0, 1.0]]
    assert points.get_sizes().tolist() == [4.0]


def test_a_second_cloud_has_the_next_colour(posterior):
    ax = pgm.plot.particles(posterior[x.at(0)], ticks=False)
    pgm.plot.particles(posterior[x.at(1)], ticks=False, ax=ax)
    one, other = (points.get_facecolor()[0, :3] for points in ax.collections)
    assert np.abs(one - other).max() > 0.1


def test_what_cannot_be_drawn(posterior):
    belief = posterior[x.at(0)]
    faults = [
        (posterior[x], {}, "pick one"),
        (belief.gaussian(), {}, "not a Gaussian"),
        (belief.marginal("east", "heading"), {}, "two components"),
        (belief, {"components": ("east", "up")}, "no component"),
        (belief, {"heading": "up"}, "no angle"),
        (belief, {"most": 0}, "most is a whole number, 1 or more"),
        (belief, {"most": 2.5}, "most is a whole number, 1 or more"),
        (belief, {"truth": [1.0, 2.0]}, "truth has shape"),
        (belief, {"landmarks": [1.0, 2.0]}, "landmarks have shape"),
    ]
    for what, how, match in faults:
        with pytest.raises(ModelError, match=match):
            pgm.plot.particles(what, **how)


def test_ellipses_and_paths_of_particles_are_those_of_their_gaussians(posterior):
    for draw in (pgm.plot.ellipses, pgm.plot.trajectory):
        of_particles, of_gaussian = draw(posterior[x]), draw(posterior[x].gaussian())
        pairs = zip(of_particles.collections, of_gaussian.collections, strict=True)
        for one, other in pairs:
            assert isinstance(one, EllipseCollection)
            assert_allclose(one.get_offsets(), other.get_offsets())
            assert_allclose(one.get_widths(), other.get_widths())
        for one, other in zip(of_particles.lines, of_gaussian.lines, strict=True):
            assert_allclose(one.get_xydata(), other.get_xydata())


def test_statistics_ask_for_the_gaussian(posterior):
    with pytest.raises(ModelError, match=r"belief\.gaussian\(\) has its mean"):
        pgm.consistency.nees(posterior[x], np.zeros((2, 3)))
