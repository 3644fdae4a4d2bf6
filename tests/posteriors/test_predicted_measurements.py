"""Beliefs of measurements: before their values are taken, and where nothing was read.

They are compared with the dense joint Gaussian of all states and measurements, made of the model's
matrices alone.
"""

import pickle
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import pgm

x, u, m = pgm.Variable("x", components=("p", "v")), pgm.Variable("u"), pgm.Variable("m")
z, y = pgm.Variable("z"), pgm.Variable("y", components=("a", "b"))
F, Q = np.array([[1.0, 1.0], [0.0, 0.9]]), np.array([[0.3, 0.1], [0.1, 0.2]])
H, G = np.array([[1.0, 0.0]]), np.array([[1.0, -1.0], [0.5, 2.0]])
R, S = np.array([[0.25]]), np.array([[0.4, 0.1], [0.1, 0.3]])
MEAN, COV = np.array([0.5, -0.2]), np.array([[2.0, 0.4], [0.4, 1.0]])
RNG = np.random.default_rng(3)


def model(prior=COV, z_given=(), **noise):
    linear = {x: H} | {parent: [[1.0]] for parent in z_given}
    return pgm.DynamicBayesianNetwork(
        prior=[pgm.GaussianCPD(x, MEAN, prior)],
        transition=[pgm.LinearGaussianCPD(x, {x.previous: F}, cov=Q)],
        observation=[
            pgm.LinearGaussianCPD(z, linear, cov=R, **noise),
            pgm.LinearGaussianCPD(y, {x: G}, offset=[1.0, 0.0], cov=S),
        ],
    )


class Dense:
    """The joint of states, z and y at the steps 0..T, and conditionals of it."""

    def __init__(self, steps, prior=COV):
        self.steps, size = steps, 2 * (steps + 1)
        slope, mean = np.zeros((size, size)), np.zeros(size)
        noise = np.kron(np.eye(steps + 1), Q)
        noise[:2, :2] = prior
        for t in range(steps + 1):
            for s in range(t + 1):
                slope[2 * t : 2 * t + 2, 2 * s : 2 * s + 2] = np.linalg.matrix_power(F, t - s)
            mean[2 * t : 2 * t + 2] = np.linalg.matrix_power(F, t) @ MEAN
        states = slope @ noise @ slope.T
        each = np.concatenate([H, G])
        own = np.zeros((3, 3))
        own[:1, :1], own[1:, 1:] = R, S
        reads = np.kron(np.eye(steps + 1), each)
        self.mean = reads @ mean + np.tile([0.0, 1.0, 0.0], steps + 1)
        self.cov = reads @ states @ reads.T + np.kron(np.eye(steps + 1), own)

    def rows(self, variable, step):
        return 3 * step + (np.array([0]) if variable == z else np.array([1, 2]))

    def of(self, variable, step, known):
        """The moments of a variable at a step, given {(variable, step): values}."""
        a = self.rows(variable, step)
        if not known:
            return self.mean[a], self.cov[np.ix_(a, a)]
        b = np.concatenate([self.rows(*key) for key in known])
        value = np.concatenate(list(known.values()))
        b, value = b[~np.isnan(value)], value[~np.isnan(value)]
        gain = np.linalg.solve(self.cov[np.ix_(b, b)], self.cov[np.ix_(b, a)]).T
        return (
            self.mean[a] + gain @ (value - self.mean[b]),
            self.cov[np.ix_(a, a)] - gain @ self.cov[np.ix_(b, a)],
        )


def matches(found, due, rtol=1e-11):
    assert_allclose(found.mean, due[0], rtol=rtol, atol=1e-12)
    assert_allclose(found.cov, due[1], rtol=rtol, atol=1e-12)


T, READ = 9, 6
ZS, YS = RNG.normal(size=(READ, 1)), RNG.normal(size=(T, 2))
ZS[2] = np.nan
YS[4] = YS[7:] = np.nan
YS[1, 0] = np.nan
KNOWN = {(z, k + 1): row for k, row in enumerate(ZS)} | {
    (y, k + 1): row for k, row in enumerate(YS)
}
EVIDENCE = {z: ZS, y: YS}


@pytest.mark.parametrize(
    "how", [pgm.filter, pgm.smooth, lambda *a, **k: pgm.smooth(*a, lag=2, **k)]
)
def test_one_step_ahead_and_beyond_the_last_reading(how):
    found, dense = how(model(), EVIDENCE, steps=T), Dense(T)
    for v in (z, y):
        assert_array_equal(found.predicted[v].steps, np.arange(1, T + 1))
        for t in range(1, T + 1):
            due = dense.of(v, t, {key: row for key, row in KNOWN.items() if key[1] < t})
            matches(found.predicted[v][t - 1], due)
            matches(found.predicted[v.at(t)], due)
    residual = found.innovations[z].residual
    assert_allclose((ZS - found.predicted[z].mean[:READ]), residual, rtol=1e-13, atol=1e-14)


@pytest.mark.parametrize(("how", "later"), [(pgm.filter, 0), (pgm.smooth, T)])
def test_a_measurement_that_was_not_taken(how, later):
    found, dense = how(model(), EVIDENCE, steps=T), Dense(T)
    for v, t in ((z, 0), (z, 3), (z, 7), (z, 9), (y, 5), (y, 8)):
        if (v, t) == (z, 0):
            continue
        known = {key: row for key, row in KNOWN.items() if key[1] <= t + later and key != (v, t)}
        matches(found[v.at(t)], dense.of(v, t, known))
    with pytest.raises(pgm.EvidenceError, match=r"z\[2\] has evidence there.*predicted\[z\]"):
        found[z.at(2)]
    with pytest.raises(pgm.EvidenceError, match=r"y has evidence at steps 1\.\.7"):
        found[y]
    alone = how(model(), {z: ZS}, steps=T)[y]
    assert_array_equal(alone.steps, np.arange(T + 1))
    for t in (0, 4, T):
        known = {key: row for key, row in KNOWN.items() if key[0] == z and key[1] <= t + later}
        matches(alone[t], dense.of(y, t, known))


def test_sightings_at_any_steps():
    """A row for each step, from 0 on, whether it has a sighting, several, or none."""
    values, step = RNG.normal(size=(5, 1)), [7, 0, 3, 3, 4]
    found, dense = pgm.filter(model(), {z: pgm.sightings(values, step=step)}, steps=T), Dense(T)
    assert_array_equal(found.predicted[z].steps, np.arange(T + 1))
    matches(found.predicted[z][0], dense.of(z, 0, {}))
    first = dict(zip([(z, 7), (z, 0), (z, 3)], values, strict=False))
    del first[z, 7]
    matches(found.predicted[z][3], dense.of(z, 3, {(z, 0): values[1]}))
    residual = found.innovations[z].residual[[0, 4]]
    assert_allclose(values[[0, 4]] - found.predicted[z].mean[[7, 4]], residual, rtol=1e-12)


@pytest.mark.parametrize("compiled", [None, True])
def test_runs_executors_and_bound_calls(compiled):
    runs = RNG.normal(size=(3, 4, READ, 1))
    one, other = (
        pgm.filter(model(), {z: zs}, steps=T, compiled=compiled) for zs in (runs, runs + 1.0)
    )
    assert one.predicted[z].mean.shape == (3, 4, T, 1)
    alone = pgm.filter(model(), {z: runs[1, 2]}, steps=T)
    assert_allclose(one.predicted[z].mean[1, 2], alone.predicted[z].mean, rtol=1e-11)
    assert_allclose(one.predicted[z].cov[1, 2], alone.predicted[z].cov, rtol=1e-11)
    assert (other.predicted[z].mean != one.predicted[z].mean)[..., 1:, :].all()
    with ThreadPoolExecutor(2) as pool:
        shared = pgm.filter(model(), {z: runs}, steps=T, executor=pool).predicted[z]
    assert_allclose(shared.mean, one.predicted[z].mean, rtol=1e-11)
    sent = pickle.loads(pickle.dumps(one)).predicted[z]
    assert_array_equal(sent.mean, one.predicted[z].mean)


def test_observed_parents_are_told_by_evidence():
    """At the top level at all steps; in given= at the sightings, of NaN where nothing was read."""
    shift, dense = RNG.normal(size=(T, 1)), Dense(T)
    seen = {z: pgm.sightings(ZS[:2], step=[2, 5]), u: shift}
    found = pgm.filter(model(z_given=[u]), seen).predicted[z]
    assert_array_equal(found.steps, np.arange(1, T + 1))
    mean, cov = dense.of(z, 6, {(z, 2): ZS[0] - shift[1], (z, 5): ZS[1] - shift[4]})
    matches(found[5], (mean + shift[5], cov))

    fixed = {z: pgm.sightings(ZS[:2], step=[0, 5]), m: pgm.constant([3.0])}
    found = pgm.smooth(model(z_given=[m]), fixed, steps=T)
    mean, cov = dense.of(z, 6, {(z, 0): ZS[0] - 3.0, (z, 5): ZS[1] - 3.0})
    matches(found.predicted[z][6], (mean + 3.0, cov))

    rows = pgm.sightings(
        [[1.0], [np.nan], [np.nan]], step=[2, 6, 6], given={m: [[1.0], [2.0], [4.0]]}
    )
    found = pgm.filter(model(z_given=[m]), {z: rows}, steps=T)
    assert_array_equal(found.predicted[z].steps, [2, 6, 6])
    mean, cov = dense.of(z, 6, {(z, 2): [0.0]})
    matches(found.predicted[z][2], (mean + 4.0, cov))
    with pytest.raises(pgm.EvidenceError, match=r"at step 6 there are 2 sightings"):
        found[z.at(6)]
    with pytest.raises(pgm.EvidenceError, match=r"at step 5 there is no row.*a sighting of NaN"):
        found.predicted[z.at(5)]
    with pytest.raises(pgm.EvidenceError, match=r"does not tell its observed parents \[m\]"):
        pgm.filter(model(z_given=[m]), {}, steps=T).predicted[z]


def test_a_sensor_of_a_hidden_control_begins_at_step_1():
    dynamic = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(x, MEAN, COV)],
        [
            pgm.GaussianCPD(u, [1.0], 0.5),
            pgm.LinearGaussianCPD(x, {x.previous: F, u: [[0.0], [1.0]]}, Q),
        ],
        [pgm.LinearGaussianCPD(z, {u: 2.0}, 0.1)],
    )
    found = pgm.filter(dynamic, {z: pgm.sightings([[1.0]], step=[2])}, steps=4)
    assert_array_equal(found.predicted[z].steps, [1, 2, 3, 4])
    assert_allclose(found.predicted[z].mean, 2.0)
    assert_allclose(found.predicted[z].cov, 2.1)


def test_a_nonlinear_sensor_is_linearised_where_nothing_was_read():
    """As a step of an unscented filter has it, by ten lines; iterated ones as they were last."""

    def square(at):
        return at[..., :1] ** 2 / 4.0 + at[..., 1:]

    dynamic = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(x, MEAN, COV)],
        [pgm.LinearGaussianCPD(x, {x.previous: F}, Q)],
        [pgm.NonlinearGaussianCPD(z, given=(x,), function=square, cov=R)],
    )
    rule, zs = (
        pgm.Unscented(alpha=1.0, beta=0.0, kappa=1.0),
        pgm.sightings([[2.0], [1.5]], step=[1, 3]),
    )
    found = pgm.filter(dynamic, {z: zs}, steps=5, lineariser=rule)
    for t in (0, 1, 2, 3, 5):
        at = found.predicted[x.at(t)]
        root = np.linalg.cholesky(3.0 * at.cov)
        points = at.mean + np.concatenate([np.zeros((1, 2)), root.T, -root.T])
        weights = np.array([1 / 3, *[1 / 6] * 4])
        mean = weights @ square(points)
        off = square(points) - mean
        matches(found.predicted[z.at(t)], (mean, off.T @ (weights[:, None] * off) + R), 1e-10)
    for each in (
        pgm.filter(dynamic, {z: zs}, steps=5, lineariser=rule, iterations=4, tolerance=0.0),
        pgm.smooth(dynamic, {z: zs}, steps=5, lineariser=rule, iterations=3, tolerance=0.0),
    ):
        residual, ahead = each.innovations[z], each.predicted[z][[1, 3]]
        assert_allclose([[2.0], [1.5]] - ahead.mean, residual.residual, rtol=1e-12)
        assert_allclose(ahead.cov, residual.cov, rtol=1e-12)


def test_angles_are_on_the_branch_of_the_readings():
    turn = pgm.Variable("turn", components=("heading",), angles=("heading",))
    compass = pgm.Variable("compass", components=("heading",), angles=("heading",))
    dynamic = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(turn, [6.0 * np.pi + 3.0], 0.01)],
        [pgm.LinearGaussianCPD(turn, {turn.previous: 1.0}, 0.01, offset=[0.1])],
        [pgm.NonlinearGaussianCPD(compass, given=(turn,), function=lambda at: at, cov=0.01)],
    )
    zs = np.array([[3.1], [-3.05], [np.nan], [-2.9]])
    found = pgm.filter(dynamic, {compass: zs}, steps=6)
    ahead, residual = found.predicted[compass].mean, found.innovations[compass].residual
    assert_allclose((zs - ahead[:4])[[0, 1, 3]], residual[[0, 1, 3]], atol=1e-13)
    assert np.abs(residual[[0, 1, 3]]).max() < 0.2
    assert_allclose(ahead[[2, 4, 5], 0], [-2.95, -2.8, -2.7], atol=0.1)
    assert_allclose(np.mod(found.predicted[turn].mean[1:] - ahead + 1.0, 2 * np.pi), 1.0)


def test_robust_noise_counts_with_the_covariance_of_its_cpd():
    zs = np.array([[0.1], [50.0], [0.3]])
    found = pgm.filter(model(noise=pgm.Huber(1.5)), {z: zs}, steps=4)
    at = found.predicted[x]
    assert found.weights[z][1] < 0.1
    assert_allclose(found.predicted[z].cov, (H @ at.cov @ H.T + R)[1:], rtol=1e-12)


def test_what_is_kept_alone_has_no_forecasts():
    kept = pgm.filter(model(), {z: ZS}, steps=T, keep=x)
    with pytest.raises(pgm.PgmError, match="not kept"):
        kept.predicted[z]
    with pytest.raises(pgm.EvidenceError, match="z"):
        kept[z.at(T)]


def without(evidence, sensor, row):
    """The evidence without one reading."""
    values = np.array(evidence[sensor])
    values[row] = np.nan
    return evidence | {sensor: values}


def test_readings_left_out_are_those_of_a_run_without_them():
    found = pgm.smooth(model(), EVIDENCE, steps=T).left_out
    for v in (z, y):
        assert_array_equal(found[v].steps, np.arange(1, len(EVIDENCE[v]) + 1))
        for row in range(len(EVIDENCE[v])):
            again = pgm.smooth(model(), without(EVIDENCE, v, row), steps=T)[v.at(row + 1)]
            matches(found[v][row], (again.mean, again.cov), 1e-11)
    due = Dense(T).of(z, 4, {key: row for key, row in KNOWN.items() if key != (z, 4)})
    matches(found[z][3], due)
    assert repr(pgm.smooth(model(), EVIDENCE, steps=T).left_out) == "LeftOut(z, y)"
    assert_array_equal(pickle.loads(pickle.dumps(found))[z].mean, found[z].mean)


@pytest.mark.parametrize("prior", [np.inf, 1e4])
def test_sightings_left_out_of_many_runs(prior):
    """Several at a step, in any order, with a flat prior or a wide one."""
    values, step = RNG.normal(size=(3, 6, 1)), np.array([7, 0, 3, 3, 4, 0])
    rest = {y: RNG.normal(size=(T, 2))}

    def smoothed(chosen):
        seen = {z: pgm.sightings(values[:, chosen], step=step[chosen])}
        return pgm.smooth(model(prior), rest | seen)

    found = smoothed(np.arange(6)).left_out[z]
    for row in range(6):
        again = smoothed(np.delete(np.arange(6), row))
        at = again[x.at(int(step[row]))]
        assert_allclose(found.mean[:, row], at.mean @ H.T, rtol=1e-10, atol=1e-10)
        assert_allclose(found.cov[:, row], H @ at.cov @ H.T + R, rtol=1e-10)


@pytest.mark.parametrize("runs", [(), (3,)])
@pytest.mark.parametrize("prior", [COV, np.inf])
def test_exact_readings_are_left_out_by_smoothing_again(prior, runs):
    """Without noise in a component, in two that are one, or in all; some components not read."""
    steps, rng = 4, np.random.default_rng(8)
    for noise in (np.zeros((2, 2)), [[0.3, 0.3], [0.3, 0.3]], np.diag([0.0, 0.2])):
        exact = model(prior).replace(
            observation=[
                pgm.LinearGaussianCPD(z, {x: H}, cov=R),
                pgm.LinearGaussianCPD(y, {x: np.eye(2)}, cov=noise),
            ]
        )
        evidence = {z: rng.normal(size=(*runs, steps, 1)), y: rng.normal(size=(*runs, steps, 2))}
        evidence[y][..., 1, 0] = evidence[y][..., 2, :] = np.nan
        found = pgm.smooth(exact, evidence).left_out[y]
        for row in (0, 1):
            values = evidence[y].copy()
            values[..., row, :] = np.nan
            again = pgm.smooth(exact, evidence | {y: values})[y.at(row + 1)]
            assert_allclose(found.mean[..., row, :], again.mean, rtol=1e-10, atol=1e-12)
            assert_allclose(found.cov[..., row, :, :], again.cov, rtol=1e-10, atol=1e-12)


def test_a_reading_that_alone_tells_is_left_out():
    """Nothing tells of it then, and its variance is infinite; a bearing stays on its branch."""
    found = pgm.smooth(model(np.inf), {z: [[1.0], [2.0]]}).left_out[z]
    assert_array_equal(found.cov.ravel(), [np.inf, np.inf])
    turned = pgm.Variable("turned", angles=("turned",))
    exact = model().replace(
        observation=[
            pgm.NonlinearGaussianCPD(turned, x, lambda x: x[..., :1] + 0.1 * x[..., 1:] ** 2, 0.0)
        ]
    )
    values = np.array([[0.4], [0.2 + 2.0 * np.pi], [0.1]])
    smoothed = pgm.smooth(exact, {turned: values}, iterations=20)
    at = smoothed.left_out[turned]
    assert (np.abs(values - at.mean) < 3.0).all()
    # The linearisation is that with the reading: a linear model of it, by running again.
    slope = np.array([[1.0, 0.2 * smoothed[x.at(t)].mean[1]] for t in (1, 2, 3)])
    bend = [0.1 * smoothed[x.at(t)].mean[1] ** 2 for t in (1, 2, 3)]
    for row in range(3):
        at_steps = [
            pgm.LinearGaussianCPD(v, {x: [slope[k]]}, 0.0, offset=-bend[k])
            for k, v in enumerate(pgm.variables("a b c"))
        ]
        read = {
            cpd.child: pgm.sightings([[w]], step=[k + 1])
            for k, (cpd, w) in enumerate(zip(at_steps, np.unwrap([0.4, 0.2, 0.1]), strict=True))
            if k != row
        }
        linear = model().replace(observation=at_steps)
        states = pgm.smooth(linear, read, steps=3)[x.at(row + 1)]
        due = slope[row] @ states.cov @ slope[row]
        assert_allclose(at.cov[row, 0, 0], due, rtol=1e-5)


def test_what_cannot_be_left_out_is_refused(monkeypatch):
    with pytest.raises(pgm.EvidenceError, match=r"knows all readings but one.*is filtered"):
        pgm.filter(model(), EVIDENCE, steps=T).left_out[z]
    monkeypatch.setattr("pgm.beliefs.moments.outcomes.left_out._WORST", -1.0)
    one = pgm.smooth(model(np.inf), {z: [[1.0], [2.0]]})
    with pytest.raises(pgm.NumericalError, match=r"left_out\[z\]: .* step 1 .*fewer than six"):
        one.left_out[z]
    with pytest.raises(pgm.EvidenceError, match="y"):
        pgm.smooth(model(), {z: ZS}).left_out[y]
