"""Robust noise in filters and smoothers, against dense twins, SciPy's optimum and quadrature."""

from concurrent.futures import ThreadPoolExecutor
from functools import partial

import numpy as np
import pytest
from crossed import crossed
from scipy.optimize import least_squares

import pgm

X, Z = pgm.variables("x z")
T, Q, R = 12, 0.3, 0.5
VALUES = np.cumsum(np.random.default_rng(3).normal(0.0, 0.5, T))
VALUES[[3, 4, 8]] += [9.0, -7.0, 12.0]
T4, CAUCHY, HUBER = pgm.StudentT(4.0), pgm.Cauchy(1.5), pgm.Huber(1.345)
TLS = pgm.TruncatedLeastSquares(2.5)
EVERY = [T4, CAUCHY, HUBER, TLS]


def model(noise, *, function=None, cov=R, **options):
    if function is None:
        sensor = pgm.LinearGaussianCPD(Z, {X: 1.0}, cov=cov, noise=noise)
    else:
        sensor = pgm.NonlinearGaussianCPD(Z, X, function, cov, noise=noise, **options)
    return pgm.DynamicBayesianNetwork(
        prior=[pgm.GaussianCPD(X, 0.0, 1.0)],
        transition=[pgm.LinearGaussianCPD(X, {X.previous: 1.0}, cov=Q)],
        observation=[sensor],
    )


def bent(x):
    return x + 0.1 * x**2


EVIDENCE = {Z: VALUES[:, None]}
# The prior precision of x[0..T].
STEPS = np.diff(np.eye(T + 1), axis=0)
PRECISION = STEPS.T @ STEPS / Q + np.diag(np.eye(T + 1)[0])


def dense(noise, *, expected, precision=PRECISION, rounds=500):
    """Means and variances of x[0..T], weights and log-evidence, by reweighting dense matrices."""
    weight = np.ones(T)
    for _ in range(rounds):
        cov = np.linalg.inv(precision + np.diag([0.0, *(weight / R)]))
        mean = cov[:, 1:] @ (weight * VALUES / R)
        square = (VALUES - mean[1:]) ** 2 / R
        if expected:
            square = square + np.diag(cov)[1:] / R
        weight = noise.weight(square, 1)
    gaussian = -0.5 * (np.log(2 * np.pi * R) - np.log(weight) + weight * VALUES**2 / R)
    joint = mean @ np.linalg.solve(cov, mean) + np.linalg.slogdet(cov @ precision)[1]
    density = gaussian.sum() + 0.5 * joint + noise.surplus(square, 1, weight).sum()
    return mean, np.diag(cov), weight, density


@pytest.mark.parametrize("noise", [T4, CAUCHY, HUBER], ids=repr)
@pytest.mark.parametrize(
    ("lineariser", "expected"), [(pgm.Taylor(), False), (pgm.Unscented(), True)], ids=repr
)
def test_smoother_settles_where_dense_reweighting_does(noise, lineariser, expected):
    found = pgm.smooth(
        model(noise), EVIDENCE, iterations=500, tolerance=1e-9, lineariser=lineariser
    )
    mean, variance, weight, density = dense(noise, expected=expected)
    assert found.status.converged
    np.testing.assert_allclose(found[X].mean[:, 0], mean, atol=1e-7)
    np.testing.assert_allclose(found[X].cov[:, 0, 0], variance, rtol=1e-6)
    np.testing.assert_allclose(found.weights[Z], weight, atol=1e-7)
    assert found.log_evidence == pytest.approx(density, abs=1e-6)
    proper = noise.is_proper(1)
    assert found.log_evidence_kind == ("bound" if proper else "unnormalised")


@pytest.mark.parametrize("loss", ["cauchy", "huber"])
@pytest.mark.parametrize("damping", [0.0, pgm.LevenbergMarquardt()], ids=["full", "controlled"])
def test_nonlinear_smoother_is_the_optimum_that_scipy_finds(loss, damping):
    noise = CAUCHY if loss == "cauchy" else HUBER
    scale = 1.5 if loss == "cauchy" else 1.345

    def whole(x):  # SciPy's loss would be of all residuals: it is written out for the measured
        s = (VALUES - bent(x[1:])) ** 2 / R / scale**2
        rho = np.log1p(s) if loss == "cauchy" else np.where(s <= 1, s, 2 * np.sqrt(s) - 1)
        return np.concatenate([scale * np.sqrt(rho), [x[0]], np.diff(x) / Q**0.5])

    found = pgm.smooth(model(noise, function=bent), EVIDENCE, iterations=500, damping=damping)
    tight = {"xtol": 1e-15, "ftol": 1e-15, "gtol": 1e-13}
    best = least_squares(whole, found[X].mean[:, 0] + 0.01, **tight).x
    assert found.status.converged
    np.testing.assert_allclose(found[X].mean[:, 0], best, atol=1e-6)
    assert found.log_evidence_kind == ("linearised bound" if noise.is_proper(1) else "unnormalised")


def test_scipys_own_robust_loss_has_the_same_optimum():
    """Without a motion to weigh the residuals are all robust: SciPy's loss is used as it is."""
    flat = pgm.DynamicBayesianNetwork(
        prior=[pgm.GaussianCPD(X, 0.0, 1e8)],
        transition=[pgm.LinearGaussianCPD(X, {X.previous: 1.0}, cov=0.0)],
        observation=[pgm.LinearGaussianCPD(Z, {X: 1.0}, cov=R, noise=HUBER)],
    )
    found = pgm.smooth(flat, EVIDENCE, iterations=300)
    tight = {"xtol": 1e-15, "ftol": 1e-15, "gtol": 1e-15}
    best = least_squares(
        lambda x: (VALUES - x) / R**0.5, [0.0], loss="huber", f_scale=1.345, **tight
    )
    assert found[X].mean[-1, 0] == pytest.approx(best.x[0], abs=1e-6)


@pytest.mark.parametrize("lineariser", [pgm.Taylor(), pgm.Unscented()], ids=repr)
@pytest.mark.parametrize("noise", [T4, HUBER], ids=repr)
def test_an_update_is_near_the_posterior_of_quadrature(noise, lineariser):
    z = pgm.sightings([[1.5], [0.2], [6.0]], step=[0, 0, 0])
    found = pgm.filter(model(noise), {Z: z}, steps=0, lineariser=lineariser)
    x = np.linspace(-12.0, 12.0, 48_001)
    sensor = model(noise).observation[0]
    log = -0.5 * x**2 - 0.5 * np.log(2 * np.pi)
    for value in (1.5, 0.2, 6.0):
        log = log + sensor.log_density([value], {X: x[:, None]})
    mass = np.exp(log) * (x[1] - x[0])
    mean = (mass @ x) / mass.sum()
    deviation = np.sqrt(mass @ (x - mean) ** 2 / mass.sum())
    assert abs(found[X].mean[0, 0] - mean) < 0.15 * deviation
    assert found[X].std[0, 0] == pytest.approx(deviation, rel=0.25)
    assert np.log(mass.sum()) - 0.25 < found.log_evidence < np.log(mass.sum())


def test_each_iteration_lowers_the_cost_and_expected_squares_raise_the_bound():
    def cost(x):
        return x @ PRECISION @ x + 2.0 * T4.loss((VALUES - x[1:]) ** 2 / R, 1).sum()

    counts, call = range(1, 12), partial(pgm.smooth, model(T4), EVIDENCE, tolerance=0)
    means = [call(iterations=k)[X].mean[:, 0] for k in counts]
    assert (np.diff([cost(mean) for mean in means]) < 1e-12).all()
    rule = pgm.Unscented()
    found = [call(iterations=k, lineariser=rule) for k in counts]
    assert (np.diff([float(each.log_evidence) for each in found]) > -1e-12).all()


@pytest.mark.parametrize("noise", EVERY, ids=repr)
def test_one_filter_however_it_is_run(noise):
    rule = pgm.Cubature()
    network = model(noise, function=bent)
    values = np.stack([VALUES, -0.3 * VALUES, VALUES[::-1]])[..., None]
    values[1, 2] = np.nan
    batch = pgm.filter(network, {Z: values}, lineariser=rule)
    many = pgm.filter(network, {Z: np.tile(values, (4, 1, 1, 1))}, lineariser=rule)
    np.testing.assert_allclose(many[X].mean[2], batch[X].mean, atol=1e-9)
    np.testing.assert_allclose(many.weights[Z][2], batch.weights[Z], atol=1e-8)
    graph = pgm.compile(network, T)
    kept = pgm.infer(graph, {Z: values}, schedule=pgm.Filtering(), lineariser=rule, keep=[X])
    np.testing.assert_allclose(kept[X].mean, batch[X].mean, atol=1e-9)
    robot = pgm.OnlineFilter(network, rule)
    for run in range(3):
        one = pgm.filter(network, {Z: values[run]}, lineariser=rule)
        belief = robot.initial()
        for k in range(T):
            belief = robot.update(robot.predict(belief), {Z: values[run, k]})
        for log_evidence in (one.log_evidence, belief.log_evidence):
            assert log_evidence == pytest.approx(batch.log_evidence[run], abs=1e-7)
        np.testing.assert_allclose(belief[X].mean, batch[X].mean[run, -1], atol=1e-7)
        np.testing.assert_allclose(one[X].mean, batch[X].mean[run], atol=1e-7)
        np.testing.assert_allclose(one.weights[Z], batch.weights[Z][run], atol=1e-7)
    assert np.isnan(batch.weights[Z][1, 2])
    assert np.isnan(batch.weights[Z]).sum() == 1


@pytest.mark.parametrize("noise", EVERY, ids=repr)
def test_one_smoother_however_it_is_solved(noise):
    network = model(noise, function=bent)
    found = pgm.smooth(network, EVIDENCE, iterations=400)
    assert found.status.converged
    lagged = pgm.smooth(network, EVIDENCE, lag=T + 1, iterations=400)
    start = {X: found[X].mean + 0.01}
    others = [lagged, pgm.smooth(network, EVIDENCE, iterations=400, start=start)]
    balanced = pgm.compile(network, T, method=pgm.Balanced())
    schedule = pgm.Smoothing(400)
    others.append(pgm.infer(balanced, EVIDENCE, schedule=schedule, start=start))
    for other in others:
        assert other.status.converged
        np.testing.assert_allclose(other[X].mean, found[X].mean, atol=1e-6)
        np.testing.assert_allclose(other.weights[Z], found.weights[Z], atol=1e-6)
        assert other.log_evidence == pytest.approx(found.log_evidence, abs=1e-6)


@pytest.mark.parametrize("noise", [T4, HUBER], ids=repr)
def test_beside_a_flat_prior_the_passes_go_on_in_twice_the_digits(noise):
    flat = model(noise).replace(prior=[pgm.GaussianCPD(X, 0.0, np.inf)])
    found = pgm.smooth(flat, EVIDENCE, iterations=500)
    mean, variance, weight, _ = dense(noise, expected=False, precision=STEPS.T @ STEPS / Q)
    assert found.status.digits is not None
    np.testing.assert_allclose(found[X].mean[:, 0], mean, atol=1e-6)
    np.testing.assert_allclose(found[X].cov[:, 0, 0], variance, rtol=1e-5)
    np.testing.assert_allclose(found.weights[Z], weight, atol=1e-6)


def test_sightings_of_several_sensors_missing_parts_and_noise_that_depends_on_evidence():
    """One update, against reweighting in information form of each sighting as a whole."""
    x = pgm.Variable("x", components=("a", "b"))
    z, plain, size = pgm.Variable("z", components=("u", "v")), *pgm.variables("plain size")
    h = np.array([[1.0, 0.4], [-0.3, 2.0]])
    shape = np.array([[0.4, 0.1], [0.1, 0.3]])
    network = pgm.DynamicBayesianNetwork(
        prior=[pgm.GaussianCPD(x, [0.0, 0.0], [2.0, 1.0])],
        transition=[pgm.LinearGaussianCPD(x, {x.previous: np.eye(2)}, cov=[0.1, 0.1])],
        observation=[
            pgm.LinearGaussianCPD(
                z, {x: h}, cov=pgm.noise(lambda s: s[..., None] * shape, size), noise=T4
            ),
            pgm.LinearGaussianCPD(plain, {x: [[1.0, 1.0]]}, cov=0.2),
        ],
    )
    values = np.array([[0.3, 0.2], [np.nan, 6.0], [8.0, np.nan], [0.1, -5.0], [0.4, 0.6]])
    sizes = np.array([[1.0], [2.0], [0.5], [1.0], [3.0]])
    seen = pgm.sightings(values, step=[0] * 5, given={size: sizes})
    evidence = {z: seen, plain: pgm.sightings([[0.5]], step=[0])}
    found = pgm.filter(network, evidence, steps=0)

    there = ~np.isnan(values)
    parts = [
        (h[k], value[k], np.linalg.inv(scale * shape[np.ix_(k, k)]))
        for k, value, scale in zip(there, values, sizes, strict=True)
    ]
    weight = np.ones(5)
    for _ in range(300):
        K, right = np.diag([0.5, 1.0]) + np.ones((2, 2)) / 0.2, 0.5 * np.ones(2) / 0.2
        for w, (matrix, value, inverse) in zip(weight, parts, strict=True):
            K = K + w * matrix.T @ inverse @ matrix
            right = right + w * matrix.T @ inverse @ value
        mean = np.linalg.solve(K, right)
        left = [(value - matrix @ mean, inverse) for matrix, value, inverse in parts]
        weight = np.array([(4 + len(r)) / (4 + r @ inverse @ r) for r, inverse in left])
    np.testing.assert_allclose(found[x].mean[0], mean, atol=1e-8)
    np.testing.assert_allclose(found[x].cov[0], np.linalg.inv(K), atol=1e-8)
    np.testing.assert_allclose(found.weights[z], weight, atol=1e-8)
    np.testing.assert_array_equal(found.weights[plain], [1.0])
    assert "z: " in str(found.weights)
    with pytest.raises(pgm.EvidenceError, match="no weights of x"):
        found.weights[x]


def test_weights_are_in_the_order_of_the_evidence_and_grouping_changes_nothing_linear():
    z = pgm.sightings([[9.0], [0.4], [0.2], [-8.0]], step=[3, 1, 3, 1])
    separate, grouped = (
        pgm.smooth(
            model(T4, function=lambda x: 1.0 * x, grouped=flag),
            {Z: z},
            steps=4,
            lineariser=pgm.Unscented(),
            iterations=50,
        )
        for flag in (False, True)
    )
    assert (separate.weights[Z][[0, 3]] < 0.3).all()
    assert (separate.weights[Z][[1, 2]] > 0.5).all()
    np.testing.assert_allclose(grouped[X].mean, separate[X].mean, atol=1e-9)
    np.testing.assert_allclose(grouped.weights[Z], separate.weights[Z], atol=1e-9)


def test_graduated_losses_leave_out_most_of_the_measurements_where_they_are_wrong():
    rng = np.random.default_rng(5)
    truth = np.cumsum(rng.normal(0.0, 0.1, 60))
    values, wrong = truth + rng.normal(0.0, 0.2, 60), rng.random(60) < 0.4
    values[wrong] += rng.uniform(3.0, 12.0, wrong.sum())
    network = pgm.DynamicBayesianNetwork(
        prior=[pgm.GaussianCPD(X, 0.0, 1.0)],
        transition=[pgm.LinearGaussianCPD(X, {X.previous: 1.0}, cov=0.01)],
        observation=[pgm.LinearGaussianCPD(Z, {X: 1.0}, cov=0.04, noise=TLS)],
    )
    found = pgm.smooth(network, {Z: values[:, None]}, iterations=100)
    assert found.status.converged
    np.testing.assert_array_equal(found.weights[Z] < 0.5, wrong)
    assert np.abs(found[X].mean[1:, 0] - truth).max() < 0.4
    with pytest.warns(pgm.ConvergenceWarning, match="had not settled"):
        few = pgm.smooth(network, {Z: values[:, None]}, iterations=3)
    assert not few.status.converged


@pytest.mark.parametrize("belief", ["grid", "particles"])
def test_point_masses_weigh_by_the_same_densities(belief):
    made = pgm.Grid({"x": (-6.0, 18.0, 480)})
    if belief == "particles":
        made = pgm.Particles(20_000, seed=1)
    network = model(T4)
    found = pgm.filter(network, EVIDENCE, belief=made)
    exact = pgm.filter(network, EVIDENCE, belief=pgm.Grid({"x": (-8.0, 20.0, 1400)}))
    near = pgm.filter(network, EVIDENCE, lineariser=pgm.Unscented())
    deviation = exact[X].std[:, 0]
    np.testing.assert_array_less(abs(found[X].mean - exact[X].mean)[:, 0], 0.08 * deviation)
    assert np.sqrt(np.mean((near[X].mean - exact[X].mean)[:, 0] ** 2 / deviation**2)) < 0.3
    assert found.log_evidence == pytest.approx(exact.log_evidence, abs=0.1)
    assert near.log_evidence < exact.log_evidence


def test_a_motion_of_heavy_tails_is_for_point_masses_alone():
    slipping = model(None).replace(
        transition=[pgm.LinearGaussianCPD(X, {X.previous: 1.0}, cov=Q, noise=T4)]
    )
    calm = {Z: np.array([[0.2], [0.5], [3.0], [3.1]])}
    found = pgm.filter(slipping, calm, belief=pgm.Grid({"x": (-20.0, 20.0, 400)}))
    drawn = pgm.filter(slipping, calm, belief=pgm.Particles(20_000, seed=2))
    np.testing.assert_allclose(drawn[X].mean, found[X].mean, atol=0.05)
    for run in (pgm.filter, pgm.smooth):
        with pytest.raises(pgm.ModelError, match=r"StudentT.*sensors of a dynamic network"):
            run(slipping, EVIDENCE)
    with pytest.raises(pgm.ModelError, match="StudentT"):
        pgm.OnlineFilter(slipping)
    with pytest.raises(pgm.ModelError, match="StudentT"):
        pgm.filter(slipping, EVIDENCE, belief=pgm.Particles(50, proposal=pgm.Taylor()))


def test_what_takes_no_robust_noise_refuses_it():
    static = pgm.BayesianNetwork(
        [pgm.GaussianCPD(X, 0.0, 1.0), pgm.LinearGaussianCPD(Z, {X: 1.0}, cov=R, noise=T4)]
    )
    with pytest.raises(pgm.ModelError, match=r"z \| x.*weights are found by iterations"):
        pgm.infer(pgm.compile(static), {Z: 1.0})
    balanced = pgm.compile(model(T4), T, method=pgm.Balanced())
    with pytest.raises(pgm.GraphError, match=r"robust noise.*smooth"):
        pgm.infer(balanced, EVIDENCE, schedule=pgm.Filtering())
    for belief in (pgm.Grid({"x": (-8.0, 20.0, 300)}), pgm.Particles(50)):
        with pytest.raises(pgm.ModelError, match="improper"):
            pgm.filter(model(TLS), EVIDENCE, belief=belief)


def test_an_audit_finds_the_evidence_that_the_bound_is_below():
    smoothed = pgm.smooth(model(T4), EVIDENCE, iterations=100)
    audit = pgm.audit(smoothed, samples=4000, rng=0)
    exact = pgm.smooth(model(T4), EVIDENCE, belief=pgm.Grid({"x": (-8.0, 20.0, 700)}))
    assert audit.log_evidence == pytest.approx(exact.log_evidence, abs=0.05)
    assert smoothed.log_evidence < audit.log_evidence


def test_messages_and_beliefs_carry_the_same_evidence():
    found = pgm.smooth(model(T4), EVIDENCE, iterations=30)
    for cluster in (0, 4, T):
        assert found.belief(cluster).log_integral == pytest.approx(found.log_evidence, abs=1e-8)
    whole = found.message(3, 4) * found.message(4, 3)
    assert whole.log_integral == pytest.approx(found.log_evidence, abs=1e-8)


def test_an_online_window_settles_as_a_fixed_lag_does():
    network, schedule = model(HUBER, function=bent), pgm.FixedLag(3, iterations=60)
    offline = pgm.infer(pgm.compile(network, T), EVIDENCE, schedule=schedule)
    robot = pgm.OnlineFilter(network, schedule=schedule)
    belief = robot.initial()
    for value in VALUES:
        belief = robot.update(robot.predict(belief), {Z: [value]})
    np.testing.assert_allclose(belief[X].mean, offline[X].mean[-1], atol=1e-9)
    assert belief.log_evidence == pytest.approx(float(offline.log_evidence), abs=1e-8)
    assert offline.weights[Z][3] < 0.3


def test_sightings_of_nobody_knows_what_are_associated_and_weighed():
    m = pgm.Variable("m")
    network = model(None).replace(
        observation=[pgm.LinearGaussianCPD(Z, {X: 1.0, m: -1.0}, cov=R, noise=T4)]
    )
    marks = [[0.0], [50.0]]
    at = np.arange(1, T + 1)
    of = np.array([[0.0], [50.0]] * (T // 2))
    values = VALUES[:, None] - of
    known = {Z: pgm.sightings(values, step=at, given={m: of})}
    told = pgm.smooth(network, known, steps=T, iterations=20)
    guessed = pgm.smooth(
        network,
        {
            Z: pgm.sightings(
                values, step=at, given={m: pgm.unknown(marks, association="likelihood")}
            )
        },
        steps=T,
        iterations=20,
    )
    np.testing.assert_allclose(guessed[X].mean, told[X].mean, atol=1e-9)
    np.testing.assert_allclose(guessed.weights[Z], told.weights[Z], atol=1e-9)
    assert guessed.weights[Z].min() < 0.2


@crossed(("wrong", "noise"), [1e9, -3.4e38], EVERY)
def test_a_reading_however_far_out_says_no_more_than_one_less_far(noise, wrong):
    """As files write what they do not know."""
    far, outer = VALUES[:, None].copy(), VALUES[:, None].copy()
    far[5], outer[5] = 1e6 * np.sign(wrong), wrong
    for run in (pgm.filter, pgm.smooth):
        options = {} if run is pgm.filter else {"iterations": 700}
        one, other = (run(model(noise), {Z: value}, **options) for value in (far, outer))
        np.testing.assert_allclose(other[X].mean, one[X].mean, atol=1e-4)
        if noise is TLS:  # of the limit of both
            assert other.log_evidence == pytest.approx(one.log_evidence, abs=1e-6)


def test_runs_worked_through_in_parts_keep_their_weights():
    values = np.stack([VALUES, -VALUES, VALUES[::-1], 0.5 * VALUES])[..., None]
    call = partial(pgm.smooth, model(HUBER, function=bent), {Z: values}, iterations=5, tolerance=0)
    whole = call()
    with ThreadPoolExecutor(2) as workers:
        parts = call(executor=workers)
    np.testing.assert_allclose(parts.weights[Z], whole.weights[Z], atol=1e-12)
    np.testing.assert_allclose(parts.log_evidence, whole.log_evidence, atol=1e-9)
    np.testing.assert_allclose(parts.innovations[Z].cov, whole.innovations[Z].cov, rtol=1e-9)


@pytest.mark.parametrize("noise", [T4, HUBER], ids=repr)
def test_a_gate_rejects_before_anything_is_weighed(noise):
    network, values = model(noise, function=bent), np.stack([VALUES, 0.2 * VALUES])[..., None]
    schedule = pgm.Filtering(gate=0.999)
    gated = pgm.infer(pgm.compile(network, T), {Z: values}, schedule=schedule)
    left = np.where(np.isnan(gated.weights[Z])[..., None], np.nan, values)
    assert np.isnan(left).any()
    plain = pgm.filter(network, {Z: left})
    np.testing.assert_allclose(gated[X].mean, plain[X].mean, atol=1e-9)
    np.testing.assert_allclose(gated.log_evidence, plain.log_evidence, atol=1e-9)
    np.testing.assert_allclose(gated.weights[Z], plain.weights[Z], atol=1e-9)
