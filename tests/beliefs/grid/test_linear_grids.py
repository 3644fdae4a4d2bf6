"""Grids of linear Gaussian networks: the Kalman filter's and smoother's answers."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

import pgm

x = pgm.Variable("x", components=("place", "speed"))
z = pgm.Variable("z")
STEPS = 12
GRID = pgm.Grid({"place": (-9, 9, 150), "speed": (-2, 2, 70)})
WIDE = pgm.Grid({"place": (-8, 8, 100), "speed": (-5, 5, 80)})
TURN = 0.97 * np.array([[np.cos(0.3), -np.sin(0.3)], [np.sin(0.3), np.cos(0.3)]])


def model(
    matrix=((1.0, 0.4), (0.0, 1.0)),
    noise=((0.03, 0.0), (0.0, 0.01)),
    prior=((0.5, 0.0), (0.0, 0.04)),
):
    return pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(x, [0.03, 0.12], prior)],
        [pgm.LinearGaussianCPD(x, {x.previous: matrix}, offset=[0.033, 0.01], cov=noise)],
        [pgm.LinearGaussianCPD(z, {x: [[1.0, 0.0]]}, cov=0.2)],
    )


def divergence(p, q):
    """KL of a Gaussian p to a Gaussian q, of each step."""
    gap, inverse = q.mean - p.mean, np.linalg.inv(q.cov)
    ratio = np.linalg.slogdet(q.cov)[1] - np.linalg.slogdet(p.cov)[1]
    trace = np.einsum("...ij,...ji->...", inverse, p.cov)
    return 0.5 * (trace - 2 + ratio + np.einsum("...i,...ij,...j->...", gap, inverse, gap))


@pytest.mark.parametrize(
    ("net", "on", "step", "kl"),
    [
        (model(), GRID, 1e-9, 1e-9),
        (model(matrix=[[0.8, 0.4], [0.0, 0.9]]), GRID, 1e-9, 1e-9),
        (model(noise=[[0.03, 0.012], [0.012, 0.01]]), GRID, 1e-8, 1e-8),
        (model(prior=[[0.5, 0.12], [0.12, 0.04]]), GRID, 1e-8, 1e-8),
        (model(matrix=TURN, noise=[[0.1, 0], [0, 0.1]]), WIDE, 3e-6, 1e-5),
    ],
    ids=["plain", "matrix", "correlated noise", "correlated prior", "split"],
)
def test_a_linear_grid_is_the_kalman_filter(net, on, step, kl):
    drawn = net.sample({}, steps=STEPS, rng=3)
    exact, found = (
        pgm.smooth(net, drawn.evidence, steps=STEPS, **how) for how in ({}, {"belief": on})
    )
    assert abs(found.log_evidence - exact.log_evidence) / (STEPS + 1) <= step
    for gaussian, belief in [(exact[x], found[x]), (exact.filtered[x], found.filtered[x])]:
        assert divergence(gaussian, belief.gaussian()).max() <= kl
    lagged = [
        pgm.smooth(net, drawn.evidence, steps=STEPS, lag=3, **how)[x]
        for how in ({}, {"belief": on})
    ]
    assert divergence(lagged[0], lagged[1].gaussian()).max() <= kl
    assert found.kind.name == "smoothed"
    assert found.filtered.kind.name == "filtered"
    assert not any(value.any() for value in found.status.added.values())


@pytest.mark.parametrize(("motion", "sensor"), [(1.0, 2.0), (2.0, 1.0), (1.5, 1.5)])
def test_beliefs_of_a_cell_and_more(motion, sensor):
    """Deviations of one cell and more, of the beliefs' too, off the centres of cells."""
    place, width = pgm.Variable("place"), 0.1
    net = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(place, 0.013, 0.09)],
        [
            pgm.LinearGaussianCPD(
                place, {place.previous: 1.0}, offset=0.037, cov=(motion * width) ** 2
            )
        ],
        [pgm.LinearGaussianCPD(z, {place: 1.0}, cov=(sensor * width) ** 2)],
    )
    drawn = net.sample({}, steps=30, rng=1)
    on = pgm.Grid({"place": (-6.0, 8.0, 140)})
    exact, found = (pgm.smooth(net, drawn.evidence, **how) for how in ({}, {"belief": on}))
    assert abs(found.log_evidence - exact.log_evidence) / 31 <= 1e-6
    one, other = exact[place], found[place]
    ratio = one.cov[:, 0, 0] / other.cov[:, 0, 0]
    gap = (one.mean - other.mean)[:, 0] ** 2 / other.cov[:, 0, 0]
    assert (0.5 * (ratio - 1 - np.log(ratio) + gap)).max() <= 1e-5


def test_a_step_without_measurements_has_exact_moments():
    """A mean to 1e-12 and a variance, from point masses far inside the bounds."""
    net = model(matrix=np.eye(2), noise=[[0.03, 0.0], [0.0, 0.01]], prior=np.diag([0.05, 0.02]))
    found = pgm.filter(net, {}, steps=1, belief=GRID)[x]
    assert_allclose(found.mean[0], [0.03, 0.12], atol=1e-12)
    assert_allclose(found.mean[1], [0.063, 0.13], atol=1e-12)
    assert_allclose(found.cov[0], np.diag([0.05, 0.02]), atol=1e-12)
    assert_allclose(found.cov[1], np.diag([0.08, 0.03]), atol=1e-12)


def test_several_states_one_static_one_after_the_other():
    """A bias that does not move, and a state that depends on another one of its own step."""
    place, speed, bias = (pgm.Variable(name) for name in ("place", "speed", "bias"))
    net = pgm.DynamicBayesianNetwork(
        [
            pgm.GaussianCPD(speed, 0.1, 0.04),
            pgm.LinearGaussianCPD(place, {speed: 0.5}, cov=0.3),
            pgm.GaussianCPD(bias, 0.2, 0.05),
        ],
        [
            pgm.LinearGaussianCPD(speed, {speed.previous: 0.9}, cov=0.02),
            pgm.LinearGaussianCPD(place, {place.previous: 1.0, speed: 1.0}, cov=0.04),
            pgm.LinearGaussianCPD(bias, {bias.previous: 1.0}, cov=0.0),
        ],
        [pgm.LinearGaussianCPD(z, {place: 1.0, bias: 1.0}, cov=0.1)],
    )
    drawn = net.sample({}, steps=6, rng=1)
    on = pgm.Grid({"place": (-6, 6, 70), speed: (-1.5, 1.5, 30), "bias.bias": (-1.2, 1.6, 40)})
    exact, found = (pgm.smooth(net, drawn.evidence, steps=6, **how) for how in ({}, {"belief": on}))
    assert_allclose(found.log_evidence, exact.log_evidence, atol=1e-6)
    for v in (place, speed, bias):
        assert_allclose(found[v].mean, exact[v].mean, atol=1e-6)
        assert_allclose(found[v].cov, exact[v].cov, atol=1e-6)
    due = exact.joint(bias.at(4), place.at(4))
    assert_allclose(found.joint(bias.at(4), place.at(4)).mean, due.mean, atol=1e-6)
    assert_allclose(found.joint(bias.at(4), place.at(4)).cov, due.cov, atol=1e-6)


def test_noise_through_a_hidden_control():
    """A control whose noise moves two components together."""
    u, command = pgm.Variable("u"), pgm.Variable("command")
    net = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(x, [0.0, 0.0], np.diag([0.3, 0.05]))],
        [
            pgm.LinearGaussianCPD(u, {command: 1.0}, cov=0.09),
            pgm.LinearGaussianCPD(
                x, {x.previous: 1.0, u: [[1.0], [0.4]]}, cov=np.diag([0.02, 0.005])
            ),
        ],
        [pgm.LinearGaussianCPD(z, {x: [[1.0, 0.5]]}, cov=0.2)],
    )
    drawn = net.sample({command: np.full((8, 1), 0.1)}, rng=2)
    exact, found = (pgm.smooth(net, drawn.evidence, **how) for how in ({}, {"belief": GRID}))
    assert abs(found.log_evidence - exact.log_evidence) / 9 <= 1e-6
    assert divergence(exact[x], found[x].gaussian()).max() <= 1e-5


def test_missing_measurements_runs_and_float32():
    net = model()
    runs = net.sample({}, steps=5, runs=(2, 3), rng=0)
    values = runs[z].copy()
    values[0, 1, 2:4] = np.nan
    on = pgm.Grid({"place": (-9, 9, 100), "speed": (-2, 2, 40)}, dtype=np.float32)
    given = {z: values}
    exact, found = (pgm.smooth(net, given, **how) for how in ({}, {"belief": on}))
    assert found[x].values.dtype == np.float32
    assert found[x].values.shape == (2, 3, 6, 100, 40)
    assert found.log_evidence.shape == (2, 3) == found.status.outside.shape
    assert_allclose(found.log_evidence, exact.log_evidence, atol=1e-5)
    assert_allclose(found[x].mean, exact[x].mean, atol=1e-5)
    assert_allclose(found[x].cov, exact[x].cov, atol=1e-5)
    alone = pgm.smooth(net, {z: values[1, 2]}, belief=on)
    np.testing.assert_array_equal(alone[x].values, found[x].values[1, 2])


def test_noise_by_inputs_and_components_missing():
    """Noise that evidence sets, correlated measurements, some of whose components are missing."""
    place, both = pgm.Variable("place"), pgm.Variable("both", components=("one", "other"))
    quality = pgm.Variable("quality")

    def spread(quality):
        return quality[..., None] ** 2

    def shared(quality):
        return quality[..., None] * np.array([[0.3, 0.1], [0.1, 0.2]])

    net = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(place, 0.2, 0.5)],
        [
            pgm.LinearGaussianCPD(
                place, {place.previous: 0.9, quality: 0.3}, cov=pgm.noise(spread, quality)
            )
        ],
        [
            pgm.LinearGaussianCPD(
                both, {place: [[1.0], [0.5]]}, offset=[0.0, 0.2], cov=pgm.noise(shared, quality)
            )
        ],
    )
    quality_ = np.array([[0.3], [0.5], [0.4], [0.35]])
    drawn = net.sample({quality: quality_}, rng=0)
    values = drawn[both].copy()
    values[1, 0] = values[2, 1] = np.nan
    values[3] = np.nan
    given = {quality: quality_, both: values}
    on = pgm.Grid({"place": (-7.0, 7.0, 150)})
    exact, found = (pgm.infer(pgm.compile(net, 4), given, **how) for how in ({}, {"belief": on}))
    assert_allclose(found.log_evidence, exact.log_evidence, atol=1e-8)
    assert_allclose(found[place].mean, exact[place].mean, atol=1e-7)
    assert_allclose(found[place].cov, exact[place].cov, atol=1e-7)
    for schedule, kind in [(pgm.Filtering(), "filtered"), (pgm.FixedLag(0), "filtered")]:
        few = pgm.infer(pgm.compile(net, 4), given, schedule=schedule, belief=on)
        assert few.kind.name == kind
        np.testing.assert_array_equal(few[place].values, found.filtered[place].values)


def test_no_step_and_no_measurement():
    found = pgm.smooth(model(), {}, steps=0, belief=GRID)
    assert found[x].values.shape == (1, 150, 70)
    assert_allclose(found.log_evidence, 0.0, atol=1e-9)
    none = pgm.sightings(np.zeros((0, 1)), step=[])
    assert_allclose(
        pgm.filter(model(), {z: none}, steps=2, belief=GRID).log_evidence, 0.0, atol=1e-6
    )


def test_priors_of_their_own_runs():
    """Axes of runs of a prior's mean alone, and of its covariance alone, beside the evidence's."""
    place = pgm.Variable("place")
    cov = np.array([0.2, 0.5]).reshape(2, 1, 1, 1)
    net = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(place, [[0.1], [0.4], [-0.9]], cov)],
        [pgm.LinearGaussianCPD(place, {place.previous: 1.0}, cov=0.1)],
        [pgm.LinearGaussianCPD(z, {place: 1.0}, cov=0.3)],
    )
    given = {z: np.array([[0.2], [0.5]])}
    exact = pgm.filter(net, given)
    found = pgm.filter(net, given, belief=pgm.Grid({"place": (-9.0, 9.0, 150)}))
    assert found.log_evidence.shape == (2, 3)
    assert_allclose(found.log_evidence, exact.log_evidence, atol=1e-7)
    assert_allclose(found[place].mean, exact[place].mean, atol=1e-7)


def test_a_flat_prior_is_uniform_within_the_bounds():
    place = pgm.Variable("place")
    flat, wide = (
        pgm.DynamicBayesianNetwork(
            [pgm.GaussianCPD(place, 0.0, cov)],
            [pgm.LinearGaussianCPD(place, {place.previous: 1.0}, cov=0.1)],
            [pgm.LinearGaussianCPD(z, {place: 1.0}, cov=0.2)],
        )
        for cov in (np.inf, 1e6)
    )
    on = pgm.Grid({"place": (-10.0, 10.0, 200)})
    readings = {z: pgm.sightings([[0.3], [0.1], [0.4]], step=[0, 1, 2])}
    found = pgm.smooth(flat, readings, steps=2, belief=on)
    exact = pgm.smooth(wide, readings, steps=2)
    assert_allclose(found[place].mean, exact[place].mean, atol=1e-6)
    assert_allclose(found[place].cov, exact[place].cov, atol=1e-6)
    # The density of the uniform prior in place of the wide normal one's at its middle.
    due = exact.log_evidence - np.log(20.0) + 0.5 * np.log(2 * np.pi * 1e6)
    assert_allclose(found.log_evidence, due, atol=1e-5)


def test_what_is_added_to_a_prior_is_told():
    """A point between centres, and a correlated prior of half a cell and of one."""
    on = pgm.Grid({"place": (-3, 3, 60), "speed": (-3, 3, 60)})
    for deviation in (0.0, 0.05, 0.1, 0.3):
        cov = deviation**2 * np.array([[1.0, 0.8], [0.8, 1.0]])
        net = model(prior=cov)
        found = pgm.filter(net, {}, steps=0, belief=on)
        told = [float(found.status.added[name]) for name in x.components]
        assert_allclose(np.diag(found[x].cov[0]) - np.diag(cov), told, rtol=1e-9, atol=1e-13)
        assert (max(told) > 1e-4) == (deviation < 0.2)
        begun = pgm.OnlineFilter(net, belief=on).initial()
        assert_allclose([float(begun.status.added[name]) for name in x.components], told)


def test_motion_cell_by_cell_is_told():
    """Where components depend on each other; its error falls as the cells do."""
    net = model(matrix=TURN, noise=[[0.1, 0.05], [0.05, 0.1]])
    drawn = net.sample({}, steps=4, rng=3)
    due = pgm.filter(net, drawn.evidence)[x]
    off = []
    for cells in (60, 120):
        on = pgm.Grid({"place": (-7, 7, cells), "speed": (-7, 7, cells)})
        found = pgm.filter(net, drawn.evidence, belief=on)
        assert found.status.split == ("place", "speed")
        assert "place and speed moved cell by cell" in repr(found.status)
        off.append(float(divergence(found[x], due).max()))
    assert off[1] < off[0] / 16.0
    assert pgm.filter(model(), {}, steps=1, belief=WIDE).status.split == ()
