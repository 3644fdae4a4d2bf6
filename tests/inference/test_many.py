"""The sweep of many runs leaves what the general one leaves."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

import pgm
from models.networks import landmark, pose, range_bearing, sighting, velocity
from pgm.inference.chain import many

RULES = [
    pgm.Taylor(),
    pgm.Unscented(),
    pgm.Cubature(),
    pgm.GaussHermite(3),
    pgm.MonteCarlo(20),
]
GENERAL = [pgm.MonteCarlo(20, prior_moments=True), pgm.MonteCarlo(20, fresh_per_run=True)]
RUNS, STEPS = 40, 6


def drawn(sightings_a_step=1, network=None, runs=RUNS):
    network = network or range_bearing(0.5)
    rng = np.random.default_rng(3)
    controls = np.stack([np.ones(STEPS), 0.4 * np.ones(STEPS)], axis=-1)
    step = np.repeat(np.arange(1, STEPS + 1), sightings_a_step)
    landmarks = rng.uniform(-6.0, 9.0, (step.size, 2))
    at = pgm.sightings(step=step, given={landmark: landmarks})
    sample = network.sample({velocity: controls, sighting: at}, runs=runs, rng=rng)
    seen = pgm.sightings(sample[sighting], step, {landmark: landmarks})
    return network, {velocity: controls, sighting: seen}


@pytest.fixture
def ways(monkeypatch):
    """Filter both ways; whether the general sweep, too, was gone in the first."""

    def both(network, evidence, **options):
        swept = []
        original = many._run

        def seen(*arguments, **how):
            swept.append(original(*arguments, **how))
            return swept[-1]

        with monkeypatch.context() as patch:
            patch.setattr(many, "_run", seen)
            fast = pgm.filter(network, evidence, **options)
        with monkeypatch.context() as patch:
            patch.setattr(many, "suits", lambda plan: False)
            plain = pgm.filter(network, evidence, **options)
        return fast, plain, swept != [] and swept[-1] is not None

    return both


def assert_equal(fast, plain):
    for ours, theirs in (
        (fast[pose], plain[pose]),
        (fast.predicted[pose], plain.predicted[pose]),
    ):
        np.testing.assert_allclose(ours.mean, theirs.mean, rtol=0, atol=1e-10)
        np.testing.assert_allclose(ours.cov, theirs.cov, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(fast.log_evidence, plain.log_evidence, rtol=1e-9)
    ours, theirs = fast.innovations[sighting], plain.innovations[sighting]
    np.testing.assert_allclose(ours.residual, theirs.residual, rtol=0, atol=1e-9)
    np.testing.assert_allclose(ours.cov, theirs.cov, rtol=1e-9, atol=1e-12)
    assert (fast.status.converged == plain.status.converged).all()
    assert fast.log_evidence_kind == plain.log_evidence_kind


@pytest.mark.parametrize("rule", RULES + GENERAL, ids=repr)
@pytest.mark.parametrize("each", [1, 3])
def test_a_filter(ways, rule, each):
    fast, plain, swept = ways(*drawn(each), lineariser=rule)
    assert swept or rule in GENERAL
    assert_equal(fast, plain)


def changed(network, *, transition=None, observation=None):
    """The network with some of its CPDs' arguments changed."""
    parts = {}
    for name, changes in (("transition", transition), ("observation", observation)):
        (cpd,) = getattr(network, name)
        kept = {"function": cpd.function, "cov": cpd.cov, "jacobian": cpd.jacobian}
        kept |= changes or {}
        parts[name] = [pgm.NonlinearGaussianCPD(cpd.child, cpd.given, **kept)]
    return network.replace(**parts)


SINGULAR = np.diag([0.01, 0.0, 0.0])
INDEFINITE = pgm.Unscented(alpha=0.8, beta=2.0, kappa=0.0)  # its weights may be negative
ODD = {
    "numerical jacobians": {"transition": {"jacobian": None}, "observation": {"jacobian": None}},
    "noise by control": {
        "transition": {"cov": pgm.noise(lambda u: u[..., :1, None] ** 2 * np.eye(3), velocity)}
    },
    "grouped": {"observation": {"grouped": True}},
    "an exact range": {"observation": {"cov": np.diag([0.0, 0.01])}},
    "sharp readings": {"observation": {"cov": 1e-8 * np.eye(2)}},
    "a motion without noise": {"transition": {"cov": SINGULAR}},
    "own lineariser": {"observation": {"lineariser": pgm.Cubature()}},
    "negative weights": {"transition": {"lineariser": INDEFINITE}},
}


@pytest.mark.parametrize("rule", [pgm.Taylor(), pgm.Unscented()], ids=repr)
@pytest.mark.parametrize("each", [1, 2])
@pytest.mark.parametrize("name", ODD)
def test_models_of_all_kinds(ways, name, each, rule):
    """Whichever way they go."""
    network, evidence = drawn(each)
    controls = evidence[velocity] * np.linspace(0.5, 1.5, STEPS)[:, None]
    controls = controls * np.linspace(0.8, 1.2, RUNS)[:, None, None]
    model = changed(network, **ODD[name])
    seen = evidence[sighting]
    if name == "sharp readings":  # what was drawn with more noise would contradict them
        drawn_again = model.sample(
            {velocity: controls, sighting: pgm.sightings(step=seen.step, given=seen.given)}, rng=5
        )
        seen = drawn_again.evidence[sighting]
    fast, plain, swept = ways(model, {velocity: controls, sighting: seen}, lineariser=rule)
    assert_equal(fast, plain)
    ordinary = {"numerical jacobians", "noise by control", "own lineariser"}
    if name in ordinary:
        assert swept


def test_a_noise_that_varies_is_judged_anew_at_each_step(ways):
    """A blunt reading first, then sharp ones, of which a difference would lose eight digits."""
    x, z, scale = pgm.Variable("x"), pgm.Variable("z"), pgm.Variable("scale")
    noise = pgm.noise(lambda scale: scale[..., None] ** 2, given=scale)
    model = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(x, 0.0, 1.0)],
        [pgm.LinearGaussianCPD(x, {x.previous: 1.0}, cov=1.0)],
        [pgm.LinearGaussianCPD(z, {x: 1.0}, cov=noise)],
    )
    scales = np.array([1e4, 1e-4, 1e-4])[:, None]
    values = 1e-4 * np.random.default_rng(1).normal(size=(RUNS, 3, 1))
    fast, plain, swept = ways(
        model, {z: pgm.sightings(values, [1, 2, 3], {scale: scales})}, steps=3
    )
    assert swept
    np.testing.assert_allclose(fast[x].cov, plain[x].cov, rtol=1e-12)
    np.testing.assert_allclose(fast[x].cov[:, -1], 1e-8, rtol=1e-6)


@pytest.mark.parametrize("rule", [pgm.Taylor(), pgm.Unscented()], ids=repr)
@pytest.mark.parametrize("most", [7, RUNS - 1])
def test_parts_that_fit_a_cache(ways, monkeypatch, rule, most):
    """Runs differ in their start, controls and landmarks, so that each has to keep its own."""
    network, evidence = drawn()
    rng = np.random.default_rng(4)
    start = rng.normal(size=(RUNS, 3))
    prior = pgm.GaussianCPD(pose, mean=start, cov=network.prior[0].cov)
    network = pgm.DynamicBayesianNetwork([prior], network.transition, network.observation)
    controls = evidence[velocity] + 0.1 * rng.normal(size=(RUNS, STEPS, 2))
    seen = evidence[sighting]
    landmarks = seen.given[landmark] + 0.1 * rng.normal(size=(RUNS, STEPS, 2))
    seen = pgm.sightings(seen.values, seen.step, {landmark: landmarks})
    monkeypatch.setattr(many, "MOST", most)
    fast, plain, swept = ways(network, {velocity: controls, sighting: seen}, lineariser=rule)
    assert swept
    assert_equal(fast, plain)


def test_parts_that_threads_have_filtered_are_one_filter():
    """Of beliefs alone, until something else is asked for."""
    network, evidence = drawn(2, runs=2 * RUNS)
    with ThreadPoolExecutor(2) as threads:
        shared = pgm.filter(network, evidence, executor=threads)
    assert isinstance(shared._swept, many.Filtered)
    whole = pgm.filter(network, evidence)
    np.testing.assert_allclose(shared[pose].cov, whole[pose].cov, rtol=1e-12)
    np.testing.assert_allclose(shared.log_evidence, whole.log_evidence, rtol=1e-12)
    assert "whole" not in vars(shared._swept)
    assert_equal(shared, whole)


@pytest.mark.parametrize("rule", [pgm.Taylor(), pgm.Unscented()], ids=repr)
def test_a_smoother_goes_on_from_it(ways, monkeypatch, rule):
    network, evidence = drawn(2)
    fast = pgm.smooth(network, evidence, lineariser=rule)
    monkeypatch.setattr(many, "suits", lambda plan: False)
    plain = pgm.smooth(network, evidence, lineariser=rule)
    np.testing.assert_allclose(fast[pose].mean, plain[pose].mean, rtol=0, atol=1e-9)
    np.testing.assert_allclose(fast[pose].cov, plain[pose].cov, rtol=1e-8, atol=1e-12)


def test_controls_and_landmarks_of_each_run(ways):
    network, evidence = drawn()
    own = (
        np.repeat(evidence[velocity][None], RUNS, axis=0)
        * np.linspace(0.5, 1.5, RUNS)[:, None, None]
    )
    fast, plain, swept = ways(network, evidence | {velocity: own})
    assert swept
    assert_equal(fast, plain)


def test_headings_that_a_function_wraps_stay_on_their_chart(ways):
    """Six half turns: a function that wraps its heading, and sights that wrap their bearings."""
    x, u, z = (
        pgm.Variable("x", ("a", "b"), angles=("b",)),
        pgm.Variable("u"),
        pgm.Variable("z", ("a", "b"), angles=("b",)),
    )

    def turn(x, u):
        out = x + np.concatenate([u, np.ones_like(u)], axis=-1)
        out[..., 1] = np.arctan2(np.sin(out[..., 1]), np.cos(out[..., 1]))
        return out

    def by_state(x, u):
        return np.broadcast_to(np.eye(2), (*x.shape[:-1], 2, 2))

    model = pgm.DynamicBayesianNetwork(
        prior=[pgm.GaussianCPD(x, [0.0, 0.0], np.eye(2))],
        transition=[
            pgm.NonlinearGaussianCPD(
                x, (x.previous, u), turn, cov=0.1 * np.eye(2), jacobian={x.previous: by_state}
            )
        ],
        observation=[pgm.LinearGaussianCPD(z, {x: np.eye(2)}, cov=0.2 * np.eye(2))],
    )
    truth = np.stack([np.zeros(12), np.arange(1.0, 13.0)], axis=-1)
    readings = truth + 0.1 * np.random.default_rng(0).normal(size=(RUNS, 12, 2))
    evidence = {u: np.zeros((12, 1)), z: np.arctan2(np.sin(readings), np.cos(readings))}
    fast, plain, swept = ways(model, evidence)
    assert swept
    np.testing.assert_allclose(fast[x].mean, plain[x].mean, rtol=0, atol=1e-10)
    assert fast[x].mean[:, -1, 1].min() > 10.0


def test_what_is_out_of_the_ordinary_goes_the_general_way():
    network, evidence = drawn()
    plan_runs = {}
    original = many.suits

    def seen(plan):
        plan_runs[plan.runs] = original(plan)
        return plan_runs[plan.runs]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(many, "suits", seen)
        pgm.filter(network, evidence)
        missing = evidence[sighting].values.copy()
        missing[0, 0] = np.nan
        gone = pgm.sightings(missing, evidence[sighting].step, evidence[sighting].given)
        assert plan_runs.pop(RUNS)
        pgm.filter(network, evidence | {sighting: gone})
        assert not plan_runs.pop(RUNS)
    assert many.suits is original


def test_a_function_that_is_not_finite_is_refused_with_its_step_and_run():
    network, evidence = drawn()
    drive = network.transition[0]

    def broken(x, u):
        out = np.array(drive.function(x, u))
        if x.ndim == 2 and x.shape[0] == RUNS and np.abs(x[..., 2]).max() > 0.7:
            out[7] = np.nan
        return out

    moved = pgm.NonlinearGaussianCPD(
        drive.child, drive.given, broken, cov=drive.cov, jacobian=drive.jacobian
    )
    with pytest.raises(pgm.LinearisationError, match="run 7"):
        pgm.filter(network.replace(transition=[moved]), evidence)


def test_what_else_there_is_is_found_when_it_is_asked_for(monkeypatch):
    """A filter of many runs keeps beliefs alone at first: one sweep more gives all the rest."""
    network, evidence = drawn(2)
    stored = []
    original = many._run

    def seen(*arguments, store):
        stored.append(store)
        return original(*arguments, store=store)

    monkeypatch.setattr(many, "_run", seen)
    posterior = pgm.filter(network, evidence)
    assert np.isfinite(posterior[pose].mean.sum() + posterior.log_evidence.sum())
    assert stored == [False]
    joint = posterior.joint(pose.at(2), pose.at(3))
    monkeypatch.setattr(many, "suits", lambda plan: False)
    plain = pgm.filter(network, evidence)
    expected = plain.joint(pose.at(2), pose.at(3))
    np.testing.assert_allclose(joint.cov, expected.cov, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(
        posterior.innovations[sighting].nis, plain.innovations[sighting].nis, rtol=1e-9
    )
    np.testing.assert_allclose(
        posterior.predicted[pose].cov, plain.predicted[pose].cov, rtol=1e-9, atol=1e-12
    )
    assert stored == [False, True]


def test_a_mean_that_is_lost_at_a_step_without_readings_is_refused():
    """Though the next function would map it back to a number."""
    network, evidence = drawn()
    drive = network.transition[0]

    def broken(x, u):
        out = np.array(drive.function(np.nan_to_num(x), u))
        if x.ndim == 2 and x.shape[0] == RUNS and 0.35 < np.abs(x[..., 2]).mean() < 0.5:
            out[7] = np.nan
        return out

    def slope(x, u):
        return drive.jacobian[pose.previous](np.nan_to_num(x), u)

    moved = pgm.NonlinearGaussianCPD(
        drive.child, drive.given, broken, cov=drive.cov, jacobian={pose.previous: slope}
    )
    model = network.replace(transition=[moved], observation=[])
    with pytest.raises(pgm.LinearisationError, match="run 7"):
        pgm.filter(model, {velocity: np.tile(evidence[velocity], (RUNS, 1, 1))})


@pytest.mark.parametrize("runs", [(), (RUNS,)])
def test_a_prediction_that_a_rule_makes_indefinite_is_refused(runs):
    """A belief of negative variance is none, even if no later step would notice."""
    x, u = pgm.Variable("x"), pgm.Variable("u")
    rule = pgm.Unscented(alpha=0.5, beta=-3.0, kappa=0.0)
    model = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(x, 0.0, 1.0)],
        [pgm.NonlinearGaussianCPD(x, (x.previous, u), lambda x, u: u * x**2, cov=0.01)],
        [],
    )
    evidence = {u: np.broadcast_to([[0.001], [3.0]], (*runs, 2, 1))}
    with pytest.raises(pgm.NumericalError, match="predicted covariance at step 1 is indefinite"):
        pgm.filter(model, {u: evidence[u][..., 1:, :]}, lineariser=rule)
    assert (pgm.filter(model, {u: evidence[u][..., :1, :]}, lineariser=rule)[x].std > 0.0).all()
    robot = pgm.OnlineFilter(model, rule)
    belief = robot.predict(robot.initial(), {u: evidence[u][..., 0, :]})  # a step that is laid out
    assert (belief[x].std > 0.0).all()
    with pytest.raises(pgm.NumericalError, match="predicted covariance at step 1 is indefinite"):
        robot.predict(robot.initial(), {u: evidence[u][..., 1, :]})
