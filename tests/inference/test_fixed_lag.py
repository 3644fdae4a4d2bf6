"""Fixed-lag smoothing of recorded readings: x[t] given those up to t + lag, in all its forms."""

import pickle
from concurrent.futures import ThreadPoolExecutor
from functools import partial

import naive
import numpy as np
import pytest
from dense import unrolled
from numpy.testing import assert_allclose, assert_array_equal
from robots import DRIVE, P0, SENSORS, Q, m, network, sighted, u, x
from textbooks import assert_belief, assert_covs, assert_log, assert_means, wrapped
from zoo import MODELS, RULES, TOLERANCE, assert_same, model_of, of, of_run, recording
from zoo import T as STEPS

import pgm
from pgm.evidence import Sightings
from pgm.inference.chain import parts

place, speed, push, fix, gauge = pgm.variables("place speed push fix gauge")
SIGHT = SENSORS["range_bearing"]
z = SIGHT.z


def lagged(model, evidence, lag, steps=None, rule=None, **options):
    """The posterior of a schedule, and of the keyword of `smooth`, which are the same."""
    rule = rule or pgm.Taylor()
    found = pgm.smooth(model, evidence, steps=steps, lineariser=rule, lag=lag, **options)
    graph = pgm.compile(model, found.graph.steps)
    schedule = pgm.FixedLag(lag, **options)
    other = pgm.infer(graph, evidence, schedule=schedule, lineariser=rule)
    hidden = (*model.states, *model.controls)
    for variable in hidden:
        assert_array_equal(found[variable].mean, other[variable].mean)
    assert (found.kind, repr(found)) == (other.kind, repr(other))
    return found


def until(evidence, last):
    """The evidence of the steps up to a last one."""
    return {
        variable: pgm.sightings(
            given.values[..., given.step <= last, :],
            given.step[given.step <= last],
            {v: rows[..., given.step <= last, :] for v, rows in given.given.items()},
        )
        if isinstance(given, Sightings)
        else given[..., :last, :]
        for variable, given in evidence.items()
    }


# ---- linear networks, against the dense joint


def two_states(rng, nonlinear=False):
    """A cart pushed by a hidden force, its place and its speed two variables, and its readings.

    As a nonlinear CPD a linear function is the same model, linearised wherever it is.
    """
    a, b, c, d = rng.uniform(0.5, 1.2, 4)

    def cpd(child, given, cov):
        if not nonlinear:
            return pgm.LinearGaussianCPD(child, given, cov=cov)
        return pgm.NonlinearGaussianCPD(
            child, tuple(given), lambda *values: sum(
                f * v for f, v in zip(given.values(), values, strict=True)
            ), cov=cov,
        )  # fmt: skip

    return pgm.DynamicBayesianNetwork(
        prior=[pgm.GaussianCPD(speed, 0.5, 0.3), pgm.GaussianCPD(place, 1.0, 2.0)],
        transition=[
            pgm.GaussianCPD(push, 0.1, 0.4),
            cpd(speed, {speed.previous: a, push: 1.0}, 0.05),
            cpd(place, {place.previous: b, speed: c}, 0.1),
        ],
        observation=[cpd(fix, {place: d}, 0.3), cpd(gauge, {push: 1.0, speed: -0.5}, 0.2)],
    )


def drawn(seed, nonlinear=False, runs=2, steps=7):
    """A network, its readings, missing ones among them, and who says what is due of a run."""
    rng = np.random.default_rng(seed)
    model = two_states(rng, nonlinear)
    linear = two_states(np.random.default_rng(seed))
    when = np.sort(rng.integers(0, steps + 1, 9))
    later = np.sort(rng.integers(1, steps + 1, 4))
    values = rng.normal(size=(runs, when.size, 1))
    values[rng.random(values.shape) < 0.15] = np.nan
    others = rng.normal(size=(runs, later.size, 1))
    evidence = {fix: pgm.sightings(values, step=when), gauge: pgm.sightings(others, step=later)}
    sightings = [(fix, int(t), {}) for t in when] + [(gauge, int(t), {}) for t in later]
    joint = unrolled(linear, steps, sightings=sightings)

    def due(run, last, *variables):
        """Moments of variables given the readings of a run up to a step, and ln p of these."""
        rows = [*values[run], *others[run]]
        known = {
            (seen[0], k): row
            for k, (seen, row) in enumerate(zip(sightings, rows, strict=True))
            if seen[1] <= last
        }
        after, log_density = joint.given(known)
        return *(after.marginal(*variables) if variables else (None, None)), log_density

    return model, evidence, steps, due


@pytest.mark.parametrize("lag", [0, 1, 2, 3, 7, 12])
@pytest.mark.parametrize("seed", range(3))
def test_beliefs_are_those_of_the_joint_given_the_readings_up_to_the_lag(seed, lag):
    model, evidence, steps, due = drawn(seed)
    found = lagged(model, evidence, lag, steps)
    assert found.kind == pgm.Kind(lag)
    assert repr(found.status) == "Status(nothing to iterate)"
    assert found.log_evidence_kind == "exact"
    for run in range(2):
        for t in range(steps + 1):
            for v in (place, speed, push) if t else (place, speed):
                mean, cov, _ = due(run, min(t + lag, steps), v.at(t))
                belief = found[v.at(t)]
                assert_means(belief.mean[run], mean, cov, 1e-11)
                assert_covs(belief.cov[run], cov, 1e-11)
                assert_means(found.filtered[v.at(t)].mean[run], due(run, t, v.at(t))[0], cov, 1e-11)
        assert_log(found.log_evidence[run], due(run, steps)[2], 1e-11)


@pytest.mark.parametrize("lag", [7, 40])
def test_a_lag_that_covers_the_record_is_the_smoother(lag):
    model, evidence, steps, _ = drawn(5, runs=40)
    found, due = lagged(model, evidence, lag, steps), pgm.smooth(model, evidence, steps=steps)
    for v in (place, speed, push):
        assert_belief(found[v], due[v].mean, due[v].cov, 1e-12)
    assert_array_equal(found.log_evidence, due.log_evidence)


def test_without_a_lag_it_is_the_filter():
    evidence = recording("everything")
    for options in ({}, {"iterations": 3, "damping": 0.2}):
        found = lagged(MODELS["everything"], evidence, 0, **options)
        due = pgm.filter(MODELS["everything"], evidence, **options)
        assert (found.kind, str(found.kind)) == (due.kind, "filtered")
        assert_same(of(found), of(due), 0.0)
        assert repr(found.status) == repr(due.status)


def test_a_long_chain_of_one_run_and_of_many():
    """All steps go back at once, in chunks."""
    rng = np.random.default_rng(8)
    model = two_states(rng).replace(observation=[pgm.LinearGaussianCPD(fix, {place: 1.0}, cov=0.3)])
    values = rng.normal(size=(2, 3200, 1))
    for readings in (values[0], np.concatenate([values] * 20)[:, :90]):
        found = pgm.smooth(model, {fix: readings}, lag=9)
        steps = readings.shape[-2]
        for t in (1, 70, steps - 10, steps - 9, steps - 1):
            last = min(t + 9, steps)
            due = pgm.smooth(model, {fix: readings[..., :last, :]})[place.at(t)]
            assert_belief(found[place.at(t)], due.mean, due.cov, 1e-11)


@pytest.mark.parametrize("name", MODELS)
@pytest.mark.parametrize("rule", ["taylor", "unscented"])
def test_linearised_once_it_is_the_textbook_s_smoother_of_the_readings_so_far(name, rule):
    run, lag = 1, 2
    model, evidence = model_of(name, run), of_run(recording(name), run)
    found = lagged(model, evidence, lag, rule=RULES[rule])
    batch = lagged(MODELS[name], recording(name), lag, rule=RULES[rule])
    assert_same(of(batch, run), of(found), TOLERANCE.get(name, 1e-9))
    for t in (0, 3, STEPS - lag + 1, STEPS):
        last = min(t + lag, STEPS)
        due = naive.run(model, until(evidence, last), last, rule)
        mean, cov = due.smoothed[t]
        for variable in model.states:
            own, belief = due.slices[t][variable.at(t)], found[variable.at(t)]
            bound = TOLERANCE.get(name, 1e-9)
            assert_means(belief.mean, mean[own], cov[np.ix_(own, own)], bound)
            assert_covs(belief.cov, cov[np.ix_(own, own)], bound)


# ---- windows that are linearised again


@pytest.mark.parametrize("lag", [1, 2, 5, 12])
@pytest.mark.parametrize("rule", [pgm.Taylor(), pgm.Cubature()], ids=str)
def test_no_reading_counts_twice(rule, lag):
    """However often CPDs are linearised: linear functions have one linearisation alone."""
    model, evidence, steps, due = drawn(11, nonlinear=True)
    found = lagged(model, evidence, lag, steps, rule, iterations=6, tolerance=0.0)
    assert found.status.iterations == 6
    assert (found.status.residuals < 1e-6).all()
    assert found.log_evidence_kind == "linearised"
    for run in range(2):
        for t in range(steps + 1):
            mean, cov, _ = due(run, min(t + lag, steps), place.at(t), speed.at(t))
            belief = found.joint(place.at(t), speed.at(t))
            assert_means(belief.mean[run], mean, cov, 1e-8)
            assert_covs(belief.cov[run], cov, 1e-8)
            mean, cov, _ = due(run, t, place.at(t))
            assert_means(found.filtered[place.at(t)].mean[run], mean, cov, 1e-8)
        assert_log(found.log_evidence[run], due(run, steps)[2], 1e-8)


@pytest.mark.parametrize("iterations", [1, 6])
def test_joints_and_clusters_know_what_their_latest_step_knows(iterations):
    lag = 2
    model, evidence, steps, due = drawn(12, nonlinear=True)
    found = lagged(model, evidence, lag, steps, iterations=iterations)
    for scope in (
        (place.at(2), speed.at(2)),
        (speed.at(5), push.at(3), place.at(1)),
        (place.at(0), place.at(steps)),
        (push.at(6), place.at(7)),
    ):
        last = min(max(v.step for v in scope) + lag, steps)
        mean, cov, _ = due(1, last, *scope)
        joint = found.joint(*scope)
        assert_means(joint.mean[1], mean, cov, 1e-7)
        assert_covs(joint.cov[1], cov, 1e-7)
    for cluster in (0, 3, steps):
        belief = found.belief(cluster)
        last = min(cluster + lag, steps)
        assert_allclose(belief.log_integral[1], due(1, last)[2], rtol=1e-7)
        mean, cov, _ = due(1, last, *belief.scope)
        assert_means(belief.gaussian().mean[1], mean, cov, 1e-6)
    assert found.message(3, 4).scope == (speed.at(3), place.at(3))
    with pytest.raises(pgm.GraphError, match=r"was not sent, since the posterior is fixed-lag \(2"):
        found.message(4, 3)
    ours = found.innovations[fix]
    theirs = pgm.filter(model, evidence, steps=steps).innovations[fix]
    assert_allclose(ours.residual, theirs.residual, atol=1e-8)
    assert_allclose(ours.nis, theirs.nis, rtol=1e-7)


ROBOT = network(SIGHT.cpd())


def textbook(evidence, lag, iterations, steps):
    """The windows of one run, their normal equations written down: newest and lagged beliefs.

    A window is solved for all its states at once, about the points where its CPDs are linearised.
    """
    prior, newest, oldest, at = (np.zeros(3), P0), [(np.zeros(3), P0)], {}, {}
    commands, seen = evidence[u], evidence[z]

    def linearised(k):
        """Move k's slope and offset at x[k−1], and the readings of step k at x[k]."""
        before, here = at[k]
        slope = DRIVE.by_state(before, commands[k - 1])
        parts = [(slope, DRIVE(before, commands[k - 1]) - slope @ before)]
        for row in np.flatnonzero(seen.step == k):
            mark = seen.given[m][row]
            slope = SIGHT.by_state(here, mark)
            off = wrapped(seen.values[row] - SIGHT.function(here, mark), z.angle_mask)
            parts.append((slope, off + slope @ here))
        return parts

    def solve(first, last, prior):
        size = 3 * (last - first + 1)
        K, h = np.zeros((size, size)), np.zeros(size)
        inverse = np.linalg.inv(prior[1])
        K[:3, :3], h[:3] = inverse, inverse @ prior[0]
        for k in range(first + 1, last + 1):
            (slope, offset), *readings = linearised(k)
            two = slice(3 * (k - first - 1), 3 * (k - first + 1))
            row, weight = np.hstack([-slope, np.eye(3)]), np.linalg.inv(Q)
            K[two, two] += row.T @ weight @ row
            h[two] += row.T @ weight @ offset
            one = slice(3 * (k - first), 3 * (k - first + 1))
            for slope, value in readings:
                weight = np.linalg.inv(SIGHT.cov)
                K[one, one] += slope.T @ weight @ slope
                h[one] += slope.T @ weight @ value
        cov = np.linalg.inv(K)
        return (cov @ h).reshape(-1, 3), cov

    first = 0
    for s in range(1, steps + 1):
        if s - lag > first:
            # The step after the first is left behind, as it was linearised last.
            mean, cov = solve(first, first + 1, prior)
            prior, first = (mean[1], cov[3:, 3:]), first + 1
        before = newest[-1][0]
        at[s] = before, DRIVE(before, commands[s - 1])
        for _ in range(iterations):
            mean, cov = solve(first, s, prior)
            found = {k: (mean[k - first - 1], mean[k - first]) for k in range(first + 1, s + 1)}
            previous, at = at, at | found
        at = previous  # where the last solution was linearised
        newest.append((mean[-1], cov[-3:, -3:]))
        for k in range(first, s + 1):
            own = slice(3 * (k - first), 3 * (k - first + 1))
            oldest[k] = mean[k - first], cov[own, own]
    return newest, [oldest[k] for k in range(steps + 1)]


@pytest.mark.parametrize("iterations", [2, 5])
@pytest.mark.parametrize("lag", [1, 3, 12])
def test_windows_are_the_textbook_s(lag, iterations):
    """With a lag of one, the dynamically iterated extended Kalman filter."""
    evidence = sighted()
    found = lagged(ROBOT, evidence, lag, iterations=iterations, tolerance=0.0)
    newest, oldest = textbook(evidence, lag, iterations, 12)
    for belief, due in ((found.filtered[x], newest), (found[x], oldest)):
        mean, cov = (np.array([each[k] for each in due]) for k in (0, 1))
        assert_belief(belief, mean, cov, 1e-8)


def test_the_dynamically_iterated_filter_linearises_the_motion_where_the_reading_says():
    """Kullberg, Skog & Hendeby, 2023, algorithm 1, written down for a cube that is hardly known."""
    position, reading = pgm.variables("position reading")
    model = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(position, 1.0, 0.5)],
        [pgm.NonlinearGaussianCPD(position, (position.previous,), lambda x: 0.3 * x**3, cov=0.01)],
        [pgm.LinearGaussianCPD(reading, {position: 1.0}, cov=0.02)],
    )
    values = np.array([[0.7], [0.2], [0.05], [0.3]])
    found = pgm.smooth(model, {reading: values}, lag=1, iterations=8, tolerance=0.0)
    mean, cov, due = 1.0, 0.5, []
    for value in values[:, 0]:
        before = mean
        for _ in range(8):
            slope = 0.9 * before**2
            ahead, spread = 0.3 * before**3 + slope * (mean - before), slope**2 * cov + 0.01
            gain = spread / (spread + 0.02)
            new, new_cov = ahead + gain * (value - ahead), (1 - gain) * spread
            back = cov * slope / spread
            before = mean + back * (new - ahead)
        mean, cov = new, new_cov
        due.append((mean, cov))
    assert_allclose(found.filtered[position].mean[1:, 0], [mean for mean, _ in due], rtol=1e-9)
    assert_allclose(found.filtered[position].cov[1:, 0, 0], [cov for _, cov in due], rtol=1e-9)
    filtered = pgm.filter(model, {reading: values}, iterations=8)
    assert abs(filtered[position.at(1)].mean - due[0][0]) > 0.01


@pytest.mark.parametrize("name", ["plain", "grouped", "everything", "wrapping drive"])
@pytest.mark.parametrize("rule", ["taylor", "cubature"])
def test_windows_that_cover_the_record_end_where_the_iterated_smoother_does(name, rule):
    evidence = recording(name)
    options = {"iterations": 60, "tolerance": 1e-11}
    found = lagged(MODELS[name], evidence, STEPS + 1, rule=RULES[rule], **options)
    due = pgm.smooth(MODELS[name], evidence, lineariser=RULES[rule], **options)
    assert found.status.converged.all()
    assert due.status.converged.all()
    kinds = "smoothed", "predicted"
    assert_same(of(found, kinds=kinds), of(due, kinds=kinds), 1e-8)


@pytest.mark.parametrize("damping", [0.0, 0.4, pgm.LevenbergMarquardt()], ids=repr)
def test_each_run_of_a_batch_is_that_run_alone(damping):
    """Runs settle after iterations of their own, and those that have do not move."""
    evidence = sighted(runs=3)
    options = {"lag": 2, "iterations": 6, "tolerance": 1e-3, "damping": damping}
    batch = pgm.smooth(ROBOT, evidence, **options)
    for run in range(3):
        seen = evidence[z]
        own = {u: evidence[u], z: pgm.sightings(seen.values[run], seen.step, seen.given)}
        alone = pgm.smooth(ROBOT, own, **options)
        for ours, theirs in ((batch[x], alone[x]), (batch.filtered[x], alone.filtered[x])):
            assert_means(ours.mean[run], theirs.mean, theirs.cov, 1e-9)
            assert_covs(ours.cov[run], theirs.cov, 1e-9)
        assert_log(batch.log_evidence[run], alone.log_evidence, 1e-9)
        assert batch.status.converged[run] == alone.status.converged
    assert batch.status.iterations == len(batch.status.residuals) + 1 <= 6


def test_dampings_end_at_the_same_points():
    evidence, options = sighted(seed=4), {"lag": 3, "iterations": 80, "tolerance": 1e-10}
    due = pgm.smooth(ROBOT, evidence, **options)
    for damping in (0.4, pgm.LevenbergMarquardt()):
        found = pgm.smooth(ROBOT, evidence, damping=damping, **options)
        assert found.status.converged
        assert_belief(found[x], due[x].mean, due[x].cov, 1e-7)
        assert_belief(found.filtered[x], due.filtered[x].mean, due.filtered[x].cov, 1e-7)


def test_step_control_finds_the_least_cost_of_a_window_where_plain_iterations_swing():
    """The second window begins at a belief, whose share of the cost counts."""
    a, b = pgm.variables("a b")
    model = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(a, 2.0, 2.0)],
        [pgm.LinearGaussianCPD(a, {a.previous: 1.0}, cov=0.3)],
        [pgm.NonlinearGaussianCPD(b, (a,), lambda a: np.arctan(a), cov=0.001)],
    )
    evidence = {b: np.array([[-0.2], [-0.4]])}
    options = {"lag": 1, "iterations": 60, "tolerance": 1e-10}
    assert not pgm.smooth(model, evidence, **options).status.converged
    found = pgm.smooth(model, evidence, damping=pgm.LevenbergMarquardt(), **options)
    assert found.status.converged
    prior, due = (2.0, 2.3), []
    for value in (-0.2, -0.4):
        grid = np.linspace(-3.0, 3.0, 600_001)
        cost = (grid - prior[0]) ** 2 / prior[1] + (value - np.arctan(grid)) ** 2 / 0.001
        mean = grid[np.argmin(cost)]
        cov = 1.0 / (1.0 / prior[1] + (1.0 / (1.0 + mean**2)) ** 2 / 0.001)
        due.append((mean, cov))
        prior = mean, cov + 0.3
    assert_allclose(found.filtered[a].mean[1:, 0], [mean for mean, _ in due], atol=2e-5)
    assert_allclose(found.filtered[a].cov[1:, 0, 0], [cov for _, cov in due], rtol=1e-3)


def test_a_status_tells_of_all_windows():
    found = pgm.smooth(ROBOT, sighted(), lag=3, iterations=2, tolerance=1e-12)
    assert not found.status.converged
    assert found.status.residuals.shape == (1,)
    assert repr(found.status).startswith("Status(2 iterations, 0 of 1 runs converged, last resid")
    settled = pgm.smooth(ROBOT, sighted(), lag=3, iterations=60, tolerance=1e-6)
    assert settled.status.converged
    assert settled.status.residuals[-1] <= 1e-6
    once = pgm.smooth(ROBOT, sighted(), lag=3)
    assert repr(once.status) == "Status(linearised once, not iterated)"


# ---- results


@pytest.mark.parametrize("iterations", [1, 3])
def test_what_is_kept_and_what_executors_find_is_the_same(iterations, monkeypatch):
    monkeypatch.setattr(parts, "MOST", 3)
    evidence = sighted(runs=7)
    call = partial(pgm.smooth, ROBOT, evidence, lag=2, iterations=iterations)
    whole, kept = call(), call(keep=[x])
    assert repr(kept) == "Posterior(fixed-lag (2), kept [x], steps 0..12, runs (7,))"
    with ThreadPoolExecutor(2) as pool:
        for found in (kept, call(executor=pool), call(executor=pool, keep=x)):
            assert_belief(found[x], whole[x].mean, whole[x].cov, 1e-12)
            assert_log(found.log_evidence, whole.log_evidence, 1e-12)
            assert found.kind == whole.kind
        joined = call(executor=pool)
    for result in (joined, pickle.loads(pickle.dumps(whole))):
        assert_belief(result.filtered[x], whole.filtered[x].mean, whole.filtered[x].cov, 1e-12)
        two = [posterior.joint(x.at(3), x.at(5)) for posterior in (result, whole)]
        assert_belief(two[0], two[1].mean, two[1].cov, 1e-10)
        weights = [posterior.belief(4).log_integral for posterior in (result, whole)]
        assert_log(*weights, 1e-10)


def test_no_steps_and_no_readings():
    model = drawn(1, nonlinear=True)[0]
    for options in ({}, {"iterations": 3}):
        found = pgm.smooth(
            model, {fix: pgm.sightings([[0.5]], step=[0])}, steps=0, lag=2, **options
        )
        due = pgm.filter(model, {fix: pgm.sightings([[0.5]], step=[0])}, steps=0)
        assert_belief(found[place], due[place].mean, due[place].cov, 1e-9)
        found = pgm.smooth(model, {}, steps=3, lag=2, **options)
        due = pgm.filter(model, {}, steps=3)
        assert_belief(found[place], due[place].mean, due[place].cov, 1e-9)
        assert found.log_evidence == 0.0
