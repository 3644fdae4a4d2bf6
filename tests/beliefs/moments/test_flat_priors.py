"""Priors of infinite variance: the limit of wide ones in 300 digits, and least squares."""

from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest
from crossed import crossed
from precise import Reference, floats
from scipy.optimize import least_squares
from textbooks import refusal

import pgm

INF = np.inf
x = pgm.Variable("x", components=("position", "velocity"))
y = pgm.Variable("y")
z, w = pgm.variables("z w")
MOVED = np.array([[1.0, 1.0], [0.0, 1.0]])
PUSH = np.outer([0.5, 1.0], [0.5, 1.0]) * 0.01  # of rank one
STEPS = 6


# ---- the limit


def limit(model, flat, readings):
    """Beliefs as priors grow: `model(κ)` has a variance κ in each of `flat` components.

    What exceeds any bound is infinite, and to the log-evidence ½ ln κ is added for each direction
    that the readings determine.
    """
    found, wider = (Reference(model(10.0**k), STEPS, {}, readings) for k in (60, 80))
    each = 0.5 * np.log(10.0)
    directions = round(float(found.log_evidence - wider.log_evidence) / (20 * each))
    assert 0 <= directions <= flat

    def part(beliefs):
        mean, cov = (floats([belief[k] for belief in beliefs]) for k in (0, 1))
        lost = np.diagonal(cov, 0, 1, 2) > 1e50
        cov[lost[:, :, None] | lost[:, None, :]] = 0.0
        cov[lost[:, :, None] & np.eye(lost.shape[1], dtype=bool)] = INF
        return mean, cov

    return SimpleNamespace(
        predicted=part(found.predicted),
        filtered=part(found.filtered),
        smoothed=part(found.smoothed),
        log_evidence=float(found.log_evidence) + directions * 60 * each,
        reference=found,
    )


def assert_close(belief, mean, cov, tolerance=1e-9):
    """Infinite where nothing is known, else right to a part of the deviations."""
    lost = np.isinf(np.diagonal(cov, axis1=-2, axis2=-1))
    np.testing.assert_array_equal(np.isinf(belief.cov), np.isinf(cov))
    std = np.where(lost, 1.0, np.sqrt(np.diagonal(np.where(np.isinf(cov), 1.0, cov), 0, -2, -1)))
    edge = np.where(std > 0.0, std, 1.0)
    assert (np.abs(belief.mean - mean)[~lost] <= tolerance * edge[~lost]).all()
    finite = np.isfinite(cov)
    limits = (tolerance * edge[..., None] * edge[..., None, :])[finite]
    assert (np.abs(belief.cov[finite] - cov[finite]) <= limits).all()


def constant_velocity(prior):
    return pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(x, [3.0, -2.0], prior)],
        [pgm.LinearGaussianCPD(x, {x.previous: MOVED}, cov=PUSH)],
        [pgm.LinearGaussianCPD(z, {x: [[1.0, 0.0]]}, cov=[[0.01]])],
    )


def with_a_bias(variance):
    """A flat position beside a velocity of which something is known, and an exact sensor."""
    return pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(x, [0.0, 1.0], np.diag([variance, 0.25])), pgm.GaussianCPD(y, 0.5, 1.0)],
        [
            pgm.LinearGaussianCPD(x, {x.previous: MOVED}, cov=PUSH),
            pgm.LinearGaussianCPD(y, {y.previous: 0.9}, cov=0.04),
        ],
        [
            pgm.LinearGaussianCPD(z, {x: [[1.0, 0.0]], y: 1.0}, cov=0.0),
            pgm.LinearGaussianCPD(w, {y: 2.0}, cov=0.01),
        ],
    )


def that_depends(variance):
    """A flat place, a second one given it, of which only the sum is ever read; and a third."""
    a, b, c = pgm.variables("a b c")
    return pgm.DynamicBayesianNetwork(
        [
            pgm.GaussianCPD(a, 1.0, variance),
            pgm.LinearGaussianCPD(b, {a: -1.0}, cov=0.5),
            pgm.GaussianCPD(c, 0.0, variance),
        ],
        [pgm.LinearGaussianCPD(v, {v.previous: 1.0}, cov=0.01) for v in (a, b, c)],
        [pgm.LinearGaussianCPD(z, {a: 1.0, b: 1.0}, cov=0.01)],
    )


MODELS = {
    "all": (lambda k: constant_velocity(k if np.isinf(k) else np.eye(2) * k), 2),
    "a velocity": (lambda k: constant_velocity(np.diag([4.0, k])), 1),
    "a position": (with_a_bias, 1),
    "never determined": (that_depends, 2),
}


def record(missing=False):
    values = np.cumsum(np.random.default_rng(8).normal(size=(STEPS, 1)), axis=0)
    if missing:
        values[[0, 2]] = np.nan
    return values


def listed(evidence):
    return [
        (sensor, k + 1, row, {})
        for sensor, rows in evidence.items()
        for k, row in enumerate(rows)
        if not np.isnan(row).any()
    ]


def evidence_for(model, missing=False):
    found = {z: record(missing)}
    if w in model.sensors:
        found[w] = record()[::-1] * 0.1
    return found


def balanced(model, evidence, schedule):
    tree = pgm.compile(model, steps=STEPS, method=pgm.Balanced())
    return pgm.infer(tree, evidence, schedule=schedule)


@crossed(("name", "missing"), list(MODELS), {"whole": False, "gaps": True})
def test_the_limit_of_wide_priors(name, missing):
    """Predictions, the filter, the smoother, log-evidence; chain and balanced tree."""
    make, flat = MODELS[name]
    model = make(INF)
    evidence = evidence_for(model, missing)
    due = limit(make, flat, listed(evidence))
    places = due.reference.places
    runs = [
        pgm.filter(model, evidence),
        pgm.smooth(model, evidence),
        balanced(model, evidence, pgm.Filtering()),
        balanced(model, evidence, pgm.Smoothing()),
    ]
    for k, posterior in enumerate(runs):
        last = due.smoothed if k % 2 else due.filtered
        for v, own in places.items():
            for belief, (mean, cov) in (
                (posterior.predicted[v], due.predicted),
                (posterior.filtered[v], due.filtered),
                (posterior[v], last),
            ):
                assert_close(belief, mean[:, own], cov[:, own][:, :, own])
        assert posterior.log_evidence == pytest.approx(due.log_evidence, abs=1e-9)
        assert posterior.status.digits > 10.0


def test_joints():
    """Of steps near and far, also where the filter knew nothing yet."""
    make, flat = MODELS["all"]
    evidence = {z: record()}
    due = limit(make, flat, listed(evidence)).reference
    for posterior in (
        pgm.smooth(make(INF), evidence),
        balanced(make(INF), evidence, pgm.Smoothing()),
    ):
        for steps in ([0, 1], [0, STEPS], [5, 2, 3]):
            scope = [x.at(step) for step in steps]
            assert_close(posterior.joint(*scope), *due.joint(*scope))


def test_an_unknown_component_has_no_covariance_with_others():
    """One place alone is read: where it was before, and how fast it moves, stays unknown."""
    belief = pgm.smooth(MODEL, {z: pgm.sightings([[1.0]], [1])}, steps=3).joint(x.at(0), x.at(3))
    unknown = np.isinf(np.diag(belief.cov))
    assert unknown.all()
    assert (belief.cov[~np.eye(4, dtype=bool)] == 0.0).all()


def test_innovations():
    """None while a prediction is improper, then those of the predictions."""
    values = record()
    posterior = pgm.filter(constant_velocity(INF), {z: values})
    found, ahead = posterior.innovations[z], posterior.predicted[x]
    assert np.isnan(found.residual[:2]).all()
    assert np.isnan(found.cov[:2]).all()
    np.testing.assert_array_equal(found.dof, [0, 0, 0, *[1] * (STEPS - 2)])
    residual = values[2:, 0] - ahead.mean[3:, 0]
    variance = ahead.cov[3:, 0, 0] + 0.01
    np.testing.assert_allclose(found.residual[2:, 0], residual, rtol=1e-9)
    np.testing.assert_allclose(found.cov[2:, 0, 0], variance, rtol=1e-9)
    assert np.isnan(found.nis[:3]).all()
    np.testing.assert_allclose(found.nis[3:], residual**2 / variance, rtol=1e-9)


def test_runs_that_know_at_different_steps():
    """Each run by itself."""
    model, rng = constant_velocity(INF), np.random.default_rng(9)
    values = np.cumsum(rng.normal(size=(40, STEPS, 1)), axis=1)
    values[rng.random(values.shape) < 0.5] = np.nan
    for run in (pgm.filter, pgm.smooth):
        together = run(model, {z: values})
        kept = run(model, {z: values}, keep=x)
        for k in (0, 13, 39):
            alone = run(model, {z: values[k]})
            for found in (together, kept):
                belief = SimpleNamespace(mean=found[x].mean[k], cov=found[x].cov[k])
                assert_close(belief, alone[x].mean, alone[x].cov)
                assert found.log_evidence[k] == pytest.approx(float(alone.log_evidence), abs=1e-9)


# ---- least squares


def test_least_squares_of_the_whole_record():
    """Of the states at all steps: no prior is a row less."""
    values = record()
    root = np.array([[0.05], [0.1]])  # of the noise
    states = [np.hstack([np.eye(2), np.zeros((2, STEPS))])]
    for k in range(STEPS):
        states.append(MOVED @ states[-1])
        states[-1][:, 2 + k] = root[:, 0]
    noises = np.eye(2 + STEPS)[2:]
    rows = np.vstack([*(state[:1] / 0.1 for state in states[1:]), noises])
    right = np.concatenate([values[:, 0] / 0.1, np.zeros(STEPS)])
    solution, cost = np.linalg.lstsq(rows, right, rcond=None)[:2]
    spread = np.linalg.inv(rows.T @ rows)
    posterior = pgm.smooth(constant_velocity(INF), {z: values})
    for step, state in enumerate(states):
        belief = posterior[x.at(step)]
        assert_close(belief, state @ solution, state @ spread @ state.T, 1e-8)
    # ∫ p(readings, noises | δ) dδ (2π)^(−q/2), for q components δ.
    log_det = np.linalg.slogdet(rows.T @ rows)[1] + 2 * STEPS * np.log(0.1)
    due = -0.5 * (cost[0] + log_det + STEPS * np.log(2 * np.pi))
    assert posterior.log_evidence == pytest.approx(due, abs=1e-9)


beacon = pgm.Variable("beacon", components=("east", "north"))
place = pgm.Variable("place", components=("east", "north"))
ranged = pgm.Variable("ranged")
BEACONS = np.array([[0.0, 0.0], [10.0, 0.0], [0.0, 8.0]])
WALK = 0.04


def ranging(cov=INF):
    """A walk in the plane, of which nothing is known, and ranges to beacons."""
    return pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(place, [4.0, 3.0], cov)],
        [pgm.LinearGaussianCPD(place, {place.previous: 1.0}, cov=np.eye(2) * WALK)],
        [
            pgm.NonlinearGaussianCPD(
                ranged,
                (place, beacon),
                lambda s, b: np.linalg.norm(s - b, axis=-1, keepdims=True),
                [[0.01]],
            )
        ],
    )


def ranges():
    rng = np.random.default_rng(10)
    truth = np.cumsum(np.vstack([[6.0, 5.0], rng.normal(size=(4, 2)) * 0.2]), axis=0)
    step = np.repeat(np.arange(1, 5), 3)
    seen = np.tile(BEACONS, (4, 1))
    values = np.linalg.norm(truth[step] - seen, axis=-1) + 0.1 * rng.normal(size=12)
    return step, seen, values


OPTIONS = {
    "iterations": {"iterations": 30},
    "damped": {"iterations": 30, "damping": pgm.LevenbergMarquardt()},
    "balanced": {"iterations": 30, "method": pgm.Balanced()},
}


@pytest.mark.parametrize("name", OPTIONS)
def test_nonlinear_least_squares(name):
    """The optimum of SciPy, and the covariance of Gauss and Newton there."""
    step, seen, values = ranges()

    def residuals(flat):
        states = flat.reshape(5, 2)
        moves = np.diff(states, axis=0) / np.sqrt(WALK)
        read = (values - np.linalg.norm(states[step] - seen, axis=-1)) / 0.1
        return np.concatenate([moves.ravel(), read])

    best = least_squares(residuals, np.tile([4.0, 3.0], 5), method="lm", xtol=1e-14, ftol=1e-14)
    spread = np.linalg.inv(best.jac.T @ best.jac)
    evidence = {ranged: pgm.sightings(values[:, None], step=step, given={beacon: seen})}
    posterior = pgm.smooth(ranging(), evidence, steps=4, **OPTIONS[name])
    assert posterior.status.converged
    for k in range(5):
        own = slice(2 * k, 2 * k + 2)
        belief = posterior[place.at(k)]
        assert_close(belief, best.x[own], spread[own, own], 1e-5)


def test_a_start_of_an_angle():
    """Linear CPDs are the same wherever one starts."""
    heading = pgm.Variable("heading", components=("heading",), angles=("heading",))
    model = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(heading, [3.0], INF)],
        [pgm.LinearGaussianCPD(heading, {heading.previous: 1.0}, cov=0.01)],
        [pgm.LinearGaussianCPD(z, {heading: 1.0}, cov=0.01)],
    )
    evidence = {z: np.array([[3.1], [3.2], [3.3]])}
    due = pgm.smooth(model, evidence)[heading]
    found = pgm.smooth(model, evidence, start={heading: np.zeros((4, 1))})[heading]
    assert_close(found, due.mean, due.cov)


# ---- what needs moments


def unscented(first):
    """A filter of ranges, at a step before which a linear sensor has read, or not."""
    fix = pgm.Variable("fix", components=("east", "north"))
    sensor = pgm.LinearGaussianCPD(fix, {place: 1.0}, cov=np.eye(2))
    model = ranging()
    model = model.replace(observation=[sensor, *model.observation])
    evidence = {
        fix: pgm.sightings([[6.0, 5.0]], step=[first]),
        ranged: pgm.sightings([[6.4]], step=[2], given={beacon: BEACONS[1:2]}),
    }
    return pgm.filter(model, evidence, steps=3, lineariser=pgm.Unscented())


def test_sigma_points_of_what_a_linear_sensor_has_told():
    """A belief that is a reading's alone, N(reading, 1), as if it were the prior."""
    belief = unscented(1)[place.at(2)]
    model = ranging().replace(prior=[pgm.GaussianCPD(place, [6.0, 5.0], np.eye(2))])
    evidence = {ranged: pgm.sightings([[6.4]], step=[1], given={beacon: BEACONS[1:2]})}
    due = pgm.filter(model, evidence, steps=1, lineariser=pgm.Unscented())[place.at(1)]
    assert_close(belief, due.mean, due.cov)


def bent():
    """A prior with a CPD that is not linear in what is flat."""
    return pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(y, 0.0, INF), pgm.NonlinearGaussianCPD(w, y, np.sin, 1.0)],
        [pgm.LinearGaussianCPD(v, {v.previous: 1.0}, cov=1.0) for v in (y, w)],
        [pgm.LinearGaussianCPD(z, {y: 1.0}, cov=1.0)],
    )


MODEL = constant_velocity(INF)
smoothed = partial(pgm.smooth, MODEL, {z: record()})
PROPER = "has an infinite variance", "give it a finite one"
ERRORS = [
    refusal("sampling", lambda: MODEL.sample({}, steps=3, rng=1), pgm.ModelError, *PROPER),
    refusal("audit", lambda: pgm.audit(smoothed(), rng=1), pgm.ModelError, *PROPER),
    refusal(
        "sigma points",
        lambda: unscented(3),
        pgm.LinearisationError,
        "still has an infinite variance",
        "pgm.Taylor()",
        "read a linear sensor before",
        step=2,
    ),
    refusal(
        "bent",
        lambda: pgm.filter(bent(), {z: record()}),
        pgm.LinearisationError,
        "(w | y)",
        "make it linear, or give the prior a finite variance",
        step=0,
    ),
    refusal(
        "correlated",
        lambda: pgm.GaussianCPD(x, [0.0, 0.0], [[INF, 1.0], [1.0, 1.0]]),
        pgm.ModelError,
        "has a covariance with another one",
    ),
    refusal(
        "negative",
        lambda: pgm.GaussianCPD(x, [0.0, 0.0], [[-INF, 0.0], [0.0, 1.0]]),
        pgm.ModelError,
        "NaN or infinite",
    ),
    refusal(
        "flat motion",
        lambda: MODEL.replace(transition=[pgm.GaussianCPD(x, [0.0, 0.0], INF)]),
        pgm.ModelError,
        "only the prior of a dynamic network takes flat priors",
    ),
    refusal(
        "flat sensor",
        lambda: MODEL.replace(observation=[pgm.GaussianCPD(z, 0.0, INF)]),
        pgm.ModelError,
        "only the prior of a dynamic network takes flat priors",
    ),
    refusal(
        "draws",
        lambda: pgm.filter(MODEL, {z: record()})[x].sample(2, rng=1),
        pgm.NumericalError,
        "no draws, since a variance is infinite",
    ),
    refusal(
        "motion",
        lambda: pgm.LinearGaussianCPD(x, {x.previous: MOVED}, cov=np.diag([INF, 1.0])),
        pgm.ModelError,
        "NaN or infinite",
    ),
]


@pytest.mark.parametrize("case", ERRORS, ids=lambda case: case.name)
def test_refusals(case):
    case.check()


@pytest.mark.parametrize("first", [True, False])
@pytest.mark.parametrize("flat", [True, False])
def test_a_rule_of_points_is_refused_whichever_cpd_comes_first(first, flat):
    """Beside a CPD expanded by Taylor, which can be linearised at any variance."""
    a, b, z = pgm.variables("a b z")
    by_slope = pgm.NonlinearGaussianCPD(a, a.previous, np.sin, cov=0.1)
    by_points = pgm.NonlinearGaussianCPD(b, b.previous, np.sin, 0.1, lineariser=pgm.Unscented())
    model = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(a, 0.0, np.inf if flat else 1.0), pgm.GaussianCPD(b, 0.0, np.inf)],
        [by_slope, by_points] if first else [by_points, by_slope],
        [pgm.LinearGaussianCPD(z, {a: 1.0, b: 1.0}, cov=0.1)],
    )
    with pytest.raises(pgm.LinearisationError, match="its parents still has an infinite"):
        pgm.filter(model, {z: [[1.0], [2.0]]})
