"""Iterated smoothing of a long chain: the later passes go in rounds, and nobody can tell."""

import mpmath as mp
import numpy as np
import pytest
from robots import LANDMARKS, SENSORS, controls, drive_along, m, network, u, x
from textbooks import assert_log, assert_same

import pgm
from pgm.beliefs.moments.digits import careful
from pgm.beliefs.moments.passes import forward
from pgm.beliefs.moments.smoothers import parallel, smoother

SIGHT = SENSORS["range_bearing"]
LM = pgm.LevenbergMarquardt()
STEPS = 64
z, s = pgm.Variable("z"), pgm.Variable("s")


def stepwise(monkeypatch):
    monkeypatch.setattr(smoother, "_MANY_STEPS", np.inf)


def calls(monkeypatch, module, name):
    """How often a function is called from now on, in a list that grows."""
    made, function = [], getattr(module, name)

    def counted(*args, **named):
        made.append(name)
        return function(*args, **named)

    monkeypatch.setattr(module, name, counted)
    return made


@pytest.fixture(scope="module")
def drive():
    rng = np.random.default_rng(11)
    commands = controls(rng, STEPS)
    states = drive_along(commands, rng)
    step = np.sort(rng.integers(0, STEPS + 1, 100))
    which = rng.integers(0, 3, step.size)
    values = SIGHT.draw(states[step], LANDMARKS[which], rng)
    many = values + rng.normal(0.0, 0.05, (3, *values.shape))
    many[1, ::4] = np.nan
    start = {x: states + rng.normal(0.0, 0.1, states.shape)}
    return {u: commands, SIGHT.z: pgm.sightings(many, step, {m: LANDMARKS[which]})}, start


@pytest.mark.parametrize(
    ("rule", "damping", "started"),
    [
        (pgm.Taylor(), 0.0, False),
        (pgm.Taylor(), LM, True),
        (pgm.Unscented(), 0.1, True),
        (pgm.GaussHermite(3), LM, False),
    ],
    ids=str,
)
def test_rounds_give_what_the_sweep_gives(drive, rule, damping, started, monkeypatch):
    seen, start = drive
    asked = {"lineariser": rule, "damping": damping, "start": start if started else None}
    asked |= {"iterations": 60, "tolerance": 1e-8}
    sweeps = calls(monkeypatch, forward, "stored")
    found = pgm.smooth(network(SIGHT.cpd()), seen, **asked)
    assert not sweeps
    stepwise(monkeypatch)
    due = pgm.smooth(network(SIGHT.cpd()), seen, **asked)
    assert sweeps
    assert due.status.converged.all()
    assert found.status.converged.all()
    assert_same(found[x], due[x], 2e-8)
    assert_log(found.log_evidence, due.log_evidence, 1e-7)
    assert_same(found.filtered[x], due.filtered[x], 2e-8)


def test_one_iteration_is_the_extended_smoother(drive, monkeypatch):
    (seen, _), twice = drive, {"iterations": 2, "tolerance": 0}
    rounds = calls(monkeypatch, parallel, "filtered")
    once = pgm.smooth(network(SIGHT.cpd()), seen)
    again = pgm.smooth(network(SIGHT.cpd()), seen, **twice)
    assert len(rounds) == 1
    stepwise(monkeypatch)
    np.testing.assert_array_equal(pgm.smooth(network(SIGHT.cpd()), seen)[x].mean, once[x].mean)
    assert_same(again[x], pgm.smooth(network(SIGHT.cpd()), seen, **twice)[x], 1e-9)


def follow(cov, exact=()):
    read = pgm.NonlinearGaussianCPD(
        z,
        (s,),
        lambda s: s + 0.01 * np.sin(s),
        cov=cov,
        jacobian={s: lambda s: 1.0 + 0.01 * np.cos(s)[..., None]},
    )
    return pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(s, 0.0, 1.0)],
        [pgm.LinearGaussianCPD(s, {s.previous: 1.0}, cov=1.0)],
        [read, *exact],
    )


def solved(values, cov, at):
    """Means and variances of `follow`, linearised at s₁ ... s_T: a tridiagonal system."""
    slopes = [1 + mp.cos(place) / 100 for place in at]
    seen = [
        z - place - mp.sin(place) / 100 + slope * place
        for z, place, slope in zip(values, at, slopes, strict=True)
    ]
    own = [mp.mpf(2), *(slope**2 / cov + 2 for slope in slopes)]
    own[-1] -= 1  # no motion leads on from the last step
    right = [mp.mpf(0), *(slope * z / cov for slope, z in zip(slopes, seen, strict=True))]
    ahead, behind = list(zip(own, right, strict=True)), list(zip(own, right, strict=True))
    for k in range(1, len(own)):
        before, said = ahead[k - 1]
        ahead[k] = own[k] - 1 / before, right[k] + said / before
        later, told = behind[-k]
        behind[-k - 1] = own[-k - 1] - 1 / later, right[-k - 1] + told / later
    parts = zip(ahead, behind, own, right, strict=True)
    precise = [(a + b - o, p + q - r) for (a, p), (b, q), o, r in parts]
    return [said / precision for precision, said in precise], [1 / each for each, _ in precise]


def twice(values, cov):
    """The extended smoother, which a filter linearises, and what one more linearisation makes."""
    mean, variance, at = mp.mpf(0), mp.mpf(1), []
    for z in values:
        at.append(mean)
        variance, slope = variance + 1, 1 + mp.cos(mean) / 100
        gain = variance * slope / (slope**2 * variance + cov)
        mean += gain * (z - mean - mp.sin(mean) / 100)
        variance *= 1 - gain * slope
    return solved(values, cov, solved(values, cov, at)[0][1:])


def test_sharp_and_exact_readings_go_step_by_step(monkeypatch):
    """Rounds would cost these digits, or do not exist."""
    rounds, sweeps = calls(monkeypatch, parallel, "filtered"), calls(monkeypatch, forward, "stored")
    fine = calls(monkeypatch, careful, "sweep")
    y = pgm.Variable("y")
    told = pgm.LinearGaussianCPD(y, {s: 1.0}, cov=0.0)
    values = np.cumsum(np.random.default_rng(4).normal(size=(STEPS, 1)), axis=0)
    exact = {z: values, y: pgm.sightings(values[[9]], [10])}
    pgm.smooth(follow(0.1, exact=[told]), exact, iterations=2, tolerance=0)
    assert (len(rounds), len(sweeps), len(fine)) == (0, 1, 0)
    for cov, made in ((1e-14, (1, 2, 2)), (1e-2, (2, 2, 2))):
        found = pgm.smooth(follow(cov), {z: values}, iterations=2, tolerance=0)[s]
        assert (len(rounds), len(sweeps), len(fine)) == made
        with mp.workdps(50):
            means, variances = twice([mp.mpf(value) for value in values[:, 0]], mp.mpf(cov))
            left = [mp.mpf(m) - due for m, due in zip(found.mean[:, 0], means, strict=True)]
            missed = [abs(m) / mp.sqrt(v) for m, v in zip(left, variances, strict=True)]
        # What the function returns, and the mean, is rounded to float64.
        assert max(missed) < 4 * np.spacing(np.abs(values).max()) / np.sqrt(cov)
        np.testing.assert_allclose(found.cov[:, 0, 0], np.array(variances, dtype=float), rtol=1e-9)


def test_what_has_no_elements_goes_step_by_step(monkeypatch):
    def refuse(*args, **named):
        raise pgm.NumericalError("indefinite")

    seen = {z: np.ones((STEPS, 1))}
    monkeypatch.setattr(parallel, "filtered", refuse)
    found = pgm.smooth(follow(0.1), seen, iterations=3, tolerance=0)
    stepwise(monkeypatch)
    due = pgm.smooth(follow(0.1), seen, iterations=3, tolerance=0)
    np.testing.assert_array_equal(found[s].mean, due[s].mean)


@pytest.mark.parametrize("damping", [0.0, LM], ids=["plain", "LM"])
def test_smooth_takes_a_balanced_tree(drive, damping):
    seen, start = drive
    asked = {"iterations": 20, "tolerance": 1e-8, "damping": damping, "start": start}
    tree = pgm.smooth(network(SIGHT.cpd()), seen, method=pgm.Balanced(), **asked)
    chain = pgm.smooth(network(SIGHT.cpd()), seen, **asked)
    assert tree.graph.depth == 6
    assert_same(tree[x], chain[x], 1e-7)
    kept = pgm.smooth(network(SIGHT.cpd()), seen, method=pgm.Balanced(), keep=[x], **asked)
    assert_same(kept[x], tree[x], 1e-9)
    with pytest.raises(pgm.GraphError, match=r"compiled to a chain.*not by JunctionTree"):
        pgm.smooth(network(SIGHT.cpd()), seen, method=pgm.JunctionTree())
