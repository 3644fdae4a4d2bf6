"""The mixture's estimates against their formulas written out, and against repetition."""

import numpy as np
import pytest

import pgm
from pgm.inference.audit.draws import Draws
from pgm.inference.audit.mixture import Mixture, weigh

S = 400


def normal(x, mean, std):
    return -0.5 * ((x - mean) / std) ** 2 - np.log(std) - 0.5 * np.log(2 * np.pi)


def draws(seed, target, runs=1):
    """Of q = N(0, 1) and d = N(1, 3²), weighed with a target."""
    rng = np.random.default_rng(seed)
    parts = []
    for mean, std in ((0.0, 1.0), (1.0, 3.0)):
        x = rng.normal(mean, std, (runs, S))
        parts.append(Draws(target(x), normal(x, 0.0, 1.0), normal(x, 1.0, 3.0), [x[..., None]]))
    return parts


def estimated(parts, lost=0.0):
    weighed = [weigh(part) for part in parts]
    log_weights, control = (np.concatenate(each, axis=-1) for each in zip(*weighed, strict=True))
    log_ratio = np.concatenate([part.target - part.gaussian for part in parts], axis=-1)
    return Mixture.make(log_weights, control, log_ratio, np.full(len(log_weights), lost))


def bimodal(x):
    """e³ times a mixture of N(0.2, 0.9²) and N(4, 0.5²)."""
    return 3.0 + np.logaddexp(np.log(0.7) + normal(x, 0.2, 0.9), np.log(0.3) + normal(x, 4.0, 0.5))


def test_the_evidence_is_the_regression_written_out():
    parts = draws(1, bimodal)
    found = estimated(parts)
    y, v = [], []
    for part in parts:
        q, d = np.exp(part.gaussian[0]), np.exp(part.defensive[0])
        y.append(np.exp(part.target[0]) / (0.5 * q + 0.5 * d))
        v.append(q / (0.5 * q + 0.5 * d))
    cov = sum(np.cov(one, other, ddof=0)[0, 1] for one, other in zip(y, v, strict=True))
    beta = cov / sum(np.var(one) for one in v)
    due = np.mean(y) - beta * (np.mean(v) - 1.0)
    np.testing.assert_allclose(found.evidence.log, np.log(due))
    left = [one - beta * other for one, other in zip(y, v, strict=True)]
    error = np.sqrt(sum(np.var(each, ddof=1) / S for each in left)) / 2.0
    np.testing.assert_allclose(found.evidence.standard_error, error / due)
    np.testing.assert_allclose(found.effective_draws, np.sum(y) ** 2 / np.sum(np.square(y)))


def test_a_multiple_of_the_gaussian_is_found_without_error():
    found = estimated(draws(2, lambda x: 5.0 + normal(x, 0.0, 1.0)))
    np.testing.assert_allclose(found.evidence.log, 5.0, atol=1e-12)
    for value in (found.evidence.standard_error, found.divergence.value, found.inclusive.value):
        assert np.abs(value).max() < 1e-12
    assert (found.pareto_k == -np.inf).all()


def test_errors_are_those_of_many_estimates():
    x = np.linspace(-12.0, 12.0, 20_001)
    p, q = np.exp(bimodal(x) - 3.0), np.exp(normal(x, 0.0, 1.0))
    spacing = x[1] - x[0]
    due = {
        "log_evidence": 3.0,
        "divergence": (q * np.log(q / p)).sum() * spacing,
        "inclusive_divergence": (p * np.log(p / q)).sum() * spacing,
    }
    found = estimated(draws(3, bimodal, runs=3000))
    estimates = {
        "log_evidence": (found.evidence.log, found.evidence.standard_error),
        "divergence": found.divergence,
        "inclusive_divergence": found.inclusive,
    }
    for name, value in due.items():
        values, errors = estimates[name]
        spread = values.std()
        assert values.mean() == pytest.approx(value, abs=0.15 * spread + 4 * spread / 3000**0.5)
        assert np.sqrt((errors**2).mean()) == pytest.approx(spread, rel=0.1), name
        assert (np.abs(values - value) < 2 * errors).mean() > 0.93, name


def test_draws_that_are_lost_have_no_weight():
    parts = draws(4, bimodal)
    holes = parts[1].target.copy()
    holes[0, :3] = np.nan
    found = estimated([parts[0], parts[1]._replace(target=holes)], lost=3 / S)
    assert (found.weighed.weights[0, S : S + 3] == 0.0).all()
    assert np.isfinite(found.evidence.log).all()
    assert np.isfinite(found.inclusive.value).all()


def test_functions_that_are_not_defined_everywhere_tell_how_often():
    """√x where the Gaussian lies, NaN where a quarter of the prior does."""
    a, z = pgm.variables("a z")
    net = pgm.BayesianNetwork(
        [pgm.GaussianCPD(a, 1.0, 1.0), pgm.NonlinearGaussianCPD(z, a, np.sqrt, 0.0004)]
    )
    found = pgm.audit(pgm.infer(pgm.compile(net), {z: 1.2}, start={a: 1.4}), rng=0)
    x = np.linspace(1e-9, 8.0, 200_001)
    joint = np.exp(normal(x, 1.0, 1.0) + normal(1.2, np.sqrt(x), 0.02)).sum() * (x[1] - x[0])
    assert abs(found.log_evidence - np.log(joint)) < 4 * found.standard_error
    assert 0.05 < found.undefined < 0.3
    assert "NaN or infinite at 0." in repr(found)


@pytest.mark.parametrize("seed", range(5))
def test_a_control_that_hardly_varies_carries_no_estimate_away(seed):
    """Of q's values 0, 1, 2 one is rare, and d has drawn but a value that q hardly has.

    The control is 2 but for 1e-4 of q's draws, weights vary by as much as they are, and the mean of
    the control is off by what was not drawn: the regression's slope is some hundreds.
    """
    rng = np.random.default_rng(seed)
    q, d = np.array([0.5, 0.4999, 1e-4, 0.0]), np.array([1e-4, 2e-5, 1e-6, 1.0])
    p = np.array([0.2, 0.8, 0.0, 1e-5])
    found = []
    for law in (q / q.sum(), d / d.sum()):
        x = rng.choice(4, p=law, size=(1, S))
        with np.errstate(divide="ignore"):
            logs = (np.log(each)[x] for each in (p, q, d))
            found.append(Draws(*logs, [x[..., None]]))
    with np.errstate(invalid="ignore"):
        evidence = estimated(found).evidence
    assert abs(evidence.log - np.log(p.sum())) < 5.0 * evidence.standard_error
