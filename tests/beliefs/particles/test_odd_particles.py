"""Particles where little is left of them: few, impossible ones, restarted ones, runs that fork."""

import warnings

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import pgm

x, z, still = pgm.Variable("x"), pgm.Variable("z"), pgm.Variable("still")


def walk():
    """A walk whose place is read, and something that does not move."""
    return pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(x, 0.0, 1.0), pgm.GaussianCPD(still, 0.0, 1.0)],
        [
            pgm.LinearGaussianCPD(x, {x.previous: 1.0}, cov=0.1),
            pgm.LinearGaussianCPD(still, {still.previous: 1.0}, cov=0.0),
        ],
        [pgm.LinearGaussianCPD(z, {x: 1.0}, cov=0.2)],
    )


def boxed():
    """The same, read to within a half."""

    def within(z, x):
        return np.where(np.abs(z - x)[..., 0] < 0.5, 0.0, -np.inf)

    return walk().replace(observation=[pgm.SampledCPD(z, x, log_density=within)])


@pytest.mark.parametrize("count", range(1, 13))
def test_equal_particles_are_worth_their_number(count):
    """However few, and whatever rounding makes of 1 / Σ w²."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = pgm.filter(walk(), {z: np.full((3, 1), np.nan)}, belief=pgm.Particles(count))
    assert not found.status.few


def test_the_status_names_the_step_that_is_short_of_particles():
    """Not one with fewer particles in all, which are all worth something."""
    shares = np.array([[4.0, 5.0]])
    zero = np.zeros((1, 2))
    status = pgm.results.ParticleFigures(
        shares, np.array([[4, 900]]), zero > 0, zero.astype(int), zero > 0, zero > 0
    )
    assert "worth 5 at step 1, below 10 in 1 of 1 runs" in status.phrases
    with pytest.warns(pgm.ParticleWarning, match="worth fewer than 10 of them"):
        status.warn()


def test_python_shows_a_warning_once_a_place():
    """Of calls whose particles are worth other numbers, at other steps."""
    with warnings.catch_warnings(record=True) as shown:
        warnings.simplefilter("default")
        for reading in (2.0, 2.5, 3.0):
            found = pgm.filter(
                walk(), {z: [[0.0], [reading]]}, belief=pgm.Particles(11, seed=int(10 * reading))
            )
            assert found.status.few
    assert [each.category for each in shown] == [pgm.ParticleWarning]


@pytest.mark.parametrize("smoothing", ["full", "metropolis"])
def test_restarted_particles_tell_nothing_of_before(smoothing):
    """Smoothed beliefs before a restart are those of the measurements before it."""
    model = boxed()
    some = pgm.Particles(3000, impossible="restart", smoothing=smoothing, trajectories=600, moves=5)
    jump = np.array([[0.3], [0.2], [2.95], [2.9]])
    with pytest.warns(pgm.ParticleWarning, match="no particle explains"):
        found = pgm.smooth(model, {z: jump}, belief=some)
    before = pgm.smooth(model, {z: jump[:2]}, belief=some)
    assert found.status.restarted.tolist() == [False, False, False, True, False]
    for state in (x, still):
        assert_allclose(found[state].mean[:3], before[state].mean, atol=0.1)
        assert_allclose(found[state].std[:3], before[state].std, atol=0.1)
    # What does not move is one thing before the restart, and another from it on.
    assert_array_equal(found[still].states[0], found[still].states[2])
    assert_array_equal(found[still].states[3], found[still].states[4])


def cells(low, high):
    return pgm.CellProposal(x, np.arange(low, high, 0.5)[:, None], widths=[0.5])


def test_ignored_measurements_leave_the_prior_where_draws_from_cells_are_impossible():
    known = walk().replace(prior=[pgm.GaussianCPD(x, 0.1, 0.0), pgm.GaussianCPD(still, 0.0, 1.0)])
    seen = {z: pgm.sightings([[0.3]], step=[0])}
    some = pgm.Particles(200, start=cells(-2, 2), impossible="ignore")
    with pytest.warns(pgm.ParticleWarning, match="no particle explains"):
        found = pgm.filter(known, seen, steps=0, belief=some)
    assert found.log_evidence == -np.inf
    assert_array_equal(found[x].states, np.full((1, 200, 1), 0.1))
    assert_allclose(found[still].std, 1.0, rtol=0.3)
    with pytest.raises(pgm.EvidenceError, match="drawn from cells where the prior has no density"):
        pgm.filter(known, seen, steps=0, belief=pgm.Particles(200, start=cells(-2, 2)))


def test_runs_that_inputs_have_are_those_of_the_filter():
    """A prior without runs is drawn of each run, offline and online."""
    u = pgm.Variable("u")
    model = walk().replace(
        transition=[
            pgm.LinearGaussianCPD(x, {x.previous: 1.0, u: 1.0}, cov=0.1),
            *walk().transition[1:],
        ]
    )
    inputs = np.arange(6.0).reshape(3, 2, 1)
    offline = pgm.filter(model, {u: inputs}, belief=pgm.Particles(50))
    online = pgm.OnlineFilter(model, belief=pgm.Particles(50))
    belief = online.initial()
    for step in (1, 2):
        belief = online.predict(belief, {u: inputs[:, step - 1]})
        assert_array_equal(belief[x].states, offline[x].states[:, step])


def test_no_beliefs_are_no_belief():
    found = pgm.filter(walk(), {z: np.full((2, 3, 1), np.nan)}, belief=pgm.Particles(20))[x]
    for index in (np.s_[0:0], np.s_[:, 2:2]):
        with pytest.raises(pgm.ModelError, match="has none at"):
            found[index]


def test_a_sensor_without_noise_at_a_later_sighting_of_a_step():
    u = pgm.Variable("u")
    sharp = pgm.NonlinearGaussianCPD(
        z, (x, u), lambda x, u: x + 0 * u, cov=pgm.noise(lambda u: u[..., None], given=u)
    )
    seen = pgm.sightings([[0.1], [0.2]], step=[1, 1], given={u: [[1.0], [0.0]]})
    with pytest.raises(pgm.ModelError, match=r"has no noise in a component.* at step 1"):
        pgm.filter(walk().replace(observation=[sharp]), {z: seen}, steps=1, belief=pgm.Particles(9))


@pytest.mark.parametrize("smoothing", ["full", "metropolis"])
@pytest.mark.parametrize(
    ("away", "dtype"), [(0.0, np.float32), (5e6, np.float64), (1e9, np.float64)]
)
def test_what_does_not_move_stays_far_from_the_origin(smoothing, away, dtype):
    """Particles that are near to one another there, for their size, are not the same."""
    far = walk().replace(prior=[walk().prior[0], pgm.GaussianCPD(still, away, 1.0)])
    some = pgm.Particles(500, smoothing=smoothing, trajectories=100, moves=5, dtype=dtype)
    path = pgm.smooth(far, {z: np.full((4, 1), 0.3)}, belief=some)[still].states
    assert_array_equal(path, np.broadcast_to(path[0], path.shape))


@pytest.mark.parametrize("smoothing", ["full", "metropolis"])
@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_headings_of_many_turns_are_those_of_one_trajectory(smoothing, dtype):
    """A heading that turns exactly as told; runs whose noise differs, zero in one of them."""
    h, u, s = pgm.Variable("h", components=("e", "h"), angles=("h",)), x, pgm.Variable("s")
    turn = pgm.NonlinearGaussianCPD(
        h,
        (h.previous, u),
        lambda h, u: h + np.concatenate([np.sin(h[..., 1:]), u], axis=-1),
        cov=pgm.noise(lambda s: np.stack([s, 0.0 * s], -1) * np.eye(2), given=s),
    )
    read = pgm.LinearGaussianCPD(z, {h: [[1.0, 0.0]]}, cov=0.2)
    model = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(h, [0.0, 6.0e3 if dtype == np.float64 else 3.0], np.diag([1.0, 0.3]))],
        [turn],
        [read],
    )
    evidence = {z: np.full((2, 4, 1), 0.3), u: np.full((4, 1), 0.7), s: np.ones((2, 4, 1))}
    evidence[s][1] = 0.0
    some = pgm.Particles(400, smoothing=smoothing, trajectories=100, moves=5, dtype=dtype)
    path = pgm.smooth(model, evidence, belief=some)[h].states
    made = path[:, :-1, :, 1:] + dtype(0.7)
    assert_array_equal(path[:, 1:, :, 1:], made)
    rest = path[1, 1:, :, 0] - path[1, :-1, :, 0] - np.sin(path[1, :-1, :, 1])
    assert np.abs(rest).max() < (1e-12 if dtype == np.float64 else 1e-5)


@pytest.mark.parametrize("smoothing", ["full", "metropolis"])
def test_parts_of_a_mixture_have_a_density_in_common_or_none(smoothing):
    stay = pgm.LinearGaussianCPD(x, {x.previous: 1.0}, cov=0.0)
    either = pgm.MixtureCPD([stay, walk().transition[0]], [0.5, 0.5])
    model = walk().replace(transition=[either, walk().transition[1]])
    some = pgm.Particles(50, smoothing=smoothing)
    seen = {z: np.full((2, 1), np.nan)}
    assert np.isfinite(pgm.filter(model, seen, belief=some)[x].mean).all()
    with pytest.raises(pgm.ModelError, match="no density in common"):
        pgm.smooth(model, seen, belief=some)
    jump = pgm.LinearGaussianCPD(x, {x.previous: 1.0}, offset=3.0, cov=0.0)
    both = walk().replace(
        transition=[pgm.MixtureCPD([stay, jump], [0.5, 0.5]), walk().transition[1]]
    )
    path = pgm.smooth(both, seen, belief=some)[x].states[..., 0]
    steps = np.diff(path, axis=0)
    assert_allclose(steps, np.where(steps > 1.5, 3.0, 0.0), atol=1e-12)


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_measurements_that_no_cell_explains_are_ignored_as_was_asked(dtype):
    """By the injection too; one that cells explain puts particles there."""
    inject = pgm.Injection(cells(-9, 9), slow=0.1, fast=0.9)
    some = pgm.Particles(100, injection=inject, impossible="ignore", dtype=dtype)
    seen = np.array([[0.1], [1e200], [0.2]])
    with pytest.warns(pgm.ParticleWarning, match="no particle explains"):
        found = pgm.filter(walk(), {z: seen}, belief=some)
    assert found.status.ignored.tolist() == [False, False, True, False]
    assert not found.status.injected[2]
    assert np.abs(found[x].mean[2]) < 1.0
    seen[1] = 8.0
    with pytest.warns(pgm.ParticleWarning, match="no particle explains"):
        found = pgm.filter(boxed(), {z: seen[:2]}, belief=some)
    assert found.status.injected[2] > 50
    assert found[x].mean[2] > 4.0


@pytest.mark.parametrize("lead", [(2, 3), (3,), (2, 1)])
def test_hidden_controls_whose_runs_broadcast(lead):
    """As with a grid and with moments, whose means they have."""
    drift, place, read = pgm.variables("drift place read")
    mean = np.arange(np.prod(lead), dtype=float).reshape(*lead, 1)
    model = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(place, 0.0, 1.0)],
        [
            pgm.GaussianCPD(drift, mean, cov=0.01),
            pgm.LinearGaussianCPD(place, {place.previous: 1.0, drift: 1.0}, cov=0.1),
        ],
        [pgm.LinearGaussianCPD(read, {place: 1.0}, cov=1e4)],
    )
    evidence = {read: np.zeros((2, 3, 2, 1))}
    due = pgm.filter(model, evidence)[place].mean
    found = pgm.filter(model, evidence, belief=pgm.Particles(4000, seed=1))[place].mean
    np.testing.assert_allclose(found, due, atol=0.1)
