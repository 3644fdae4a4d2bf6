"""Residual factors that have values: plates of them, their weights, and messages that name them."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import pgm
from models import motion

A, B, C, D = pgm.variables("a b c d")
POSE = {"components": ("east", "north", "heading"), "angles": ("heading",)}
TURN = (False, False, True)


def infer(factors, evidence=(), **options):
    graph = pgm.compile(pgm.MarkovNetwork(factors))
    return pgm.infer(graph, dict(evidence), **options)


def ring(count=6, *, seed=2):
    """Motions round a ring of poses, values of which turn by nearly π, with their covariances."""
    rng = np.random.default_rng(seed)
    x = np.array(pgm.variables((f"x{k}" for k in range(count)), **POSE))
    true = np.stack([np.array([np.cos(a), np.sin(a), 3.0 * a]) for a in np.arange(count)])
    after = np.roll(np.arange(count), -1)
    values = motion.relative(true, true[after]) + 0.02 * rng.normal(size=(count, 3))
    values[:, 2] = (values[:, 2] + np.pi) % (2.0 * np.pi) - np.pi
    root = rng.normal(size=(count, 3, 3))
    return x, after, true, values, 1e-3 * (root @ root.swapaxes(1, 2) + np.eye(3))


@pytest.mark.parametrize("noise", [None, pgm.Cauchy(2.0)], ids=["Gaussian", "robust"])
@pytest.mark.parametrize("derivatives", [False, True])
def test_a_value_is_a_measurement_of_flat_priors(noise, derivatives):
    """Factors of a plate, one by one, and CPDs whose children have the values for evidence."""
    x, after, true, values, covs = ring()
    one, other = pgm.variables("one other", **POSE)
    given = {one: motion.relative_by_state, other: motion.relative_by_other}
    edge = pgm.NonlinearGaussianFactor(
        (one, other),
        motion.relative,
        np.eye(3),
        angles=TURN,
        jacobian=given if derivatives else None,
        noise=noise,
    )
    plates = pgm.plate(edge, {one: x, other: x[after]}, value=values, cov=covs)
    each = [
        pgm.NonlinearGaussianFactor(
            (a, b),
            motion.relative,
            cov,
            value=value,
            angles=TURN,
            jacobian=dict(zip((a, b), given.values(), strict=True)) if derivatives else None,
            noise=noise,
        )
        for a, b, value, cov in zip(x, x[after], values, covs, strict=True)
    ]
    z = np.array(pgm.variables((f"z{k}" for k in range(len(x))), **POSE))
    seen = pgm.NonlinearGaussianCPD(
        z[0], (one, other), motion.relative, np.eye(3), jacobian=edge._cpd.jacobian, noise=noise
    )
    flat = pgm.plate(pgm.GaussianCPD(one, np.zeros(3), np.inf), {one: x})
    sensors = pgm.plate(seen, {z[0]: z, one: x, other: x[after]}, cov=covs)
    assert [str(factor) for factor in plates] == [str(factor) for factor in each]
    start = dict(zip(x[1:], true[1:] + 0.02, strict=True))
    held, read = {x[0]: true[0]}, dict(zip(z, values, strict=True))
    schedule = pgm.Calibration(8, tolerance=0.0)
    found, alone, due = (
        pgm.infer(pgm.compile(network), evidence, schedule=schedule, start=start)
        for network, evidence in (
            (pgm.MarkovNetwork(plates), held),
            (pgm.MarkovNetwork(each), held),
            (pgm.BayesianNetwork([*flat, *sensors]), held | read),
        )
    )
    assert_array_equal(found.means(x[1:]), alone.means(x[1:]))
    assert_allclose(found.means(x[1:]), due.means(x[1:]), rtol=0.0, atol=1e-11)
    assert_allclose(found.covs(x[1:]), due.covs(x[1:]), rtol=1e-9, atol=1e-14)
    # A flat prior counts as the density 1, and its log-density has −½ ln 2π a component.
    level = 0.5 * np.log(2.0 * np.pi) * 3 * len(x)
    assert_allclose(found.log_evidence, due.log_evidence + level, rtol=1e-12)
    weights = [found.weights[factor] for factor in plates]
    assert_allclose(weights, [due.weights[v] for v in z], rtol=1e-9)
    assert (np.array(weights) < 1.0).all() == (noise is not None)


@pytest.mark.parametrize("kind", ["factors", "CPDs"])
def test_one_call_linearises_all_of_one_function(kind):
    """The function is called as often for three hundred of them as for three."""
    calls = []

    def squared(a):
        calls.append(a.shape)
        return a**2

    slope = {A: lambda a, *_: 2.0 * a[..., None]}
    counts = []
    for count in (3, 300):
        x = pgm.variables(f"x{k}" for k in range(count))
        if kind == "factors":
            each = pgm.NonlinearGaussianFactor(A, squared, 0.1, jacobian=slope)
            made = pgm.plate(each, {A: x}, value=np.linspace(1.0, 4.0, count))
        else:
            y = pgm.variables(f"y{k}" for k in range(count))
            priors = pgm.plate(pgm.GaussianCPD(A, 1.0, 1.0), {A: [*x, *y]})
            each = pgm.NonlinearGaussianCPD(B, A, squared, 0.1, jacobian=slope)
            made = [*priors, *pgm.plate(each, {B: y, A: x})]  # a second CPD of each y
        calls.clear()
        start = {v: [1.0] for v in x}
        if kind == "CPDs":
            start |= {v: [1.0] for v in y}
        infer(made, schedule=pgm.Calibration(10), start=start)
        counts.append(len(calls))
    assert counts[0] == counts[1] < 20


def test_values_that_are_shared_and_shown():
    x = pgm.variables("x0 x1 x2")
    edge = pgm.NonlinearGaussianFactor((A, B), lambda a, b: b - a, 0.5, value=2.0)
    assert edge.value.tolist() == [2.0]
    assert "value 2\n" in str(edge)
    made = pgm.plate(edge, {A: x[:2], B: x[1:]})
    assert [factor.value.tolist() for factor in made] == [[2.0], [2.0]]
    assert [factor.scope for factor in made] == [(x[0], x[1]), (x[1], x[2])]
    numbers = pgm.plate(edge, {B: x}, value=[1.0, 2.0, 3.0], cov=[0.1, 0.2, 0.3])
    assert [factor.scope[0] for factor in numbers] == [A, A, A]
    found = infer([*numbers, pgm.GaussianCPD(A, 0.0, 0.0)])
    assert_allclose(found.means(x)[:, 0], [1.0, 2.0, 3.0], atol=1e-12)
    assert_allclose(found.covs(x)[:, 0, 0], [0.1, 0.2, 0.3], rtol=1e-12)
    assert not edge.value.flags.writeable


def test_a_residual_is_called_like_none_of_a_plates_variables():
    names = ["residual", "residual ", "r"]
    each = pgm.NonlinearGaussianFactor(A, lambda a: a, 1.0)
    own = pgm.variables(names)
    found = infer(pgm.plate(each, {A: own}, value=[1.0, 2.0, 3.0]))
    assert_allclose(found.means(own)[:, 0], [1.0, 2.0, 3.0])


@pytest.mark.parametrize(
    ("over", "numbers", "words"),
    [
        ({C: [A, B]}, {}, r"NonlinearGaussianFactor\(a, b\): c is none of its variables \(a, b\)"),
        ({A: C}, {}, "no row has variables of its own"),
        ({}, {}, r"no row has variables of its own; give over=\{a: \["),
        (
            {A: [C, D]},
            {"value": [[1.0], [np.nan]]},
            r"\(d, b\): the value has entries that are NaN",
        ),
        ({A: [C, D]}, {"value": [1.0, 2.0, 3.0]}, "its first axes are those of the rows"),
        ({A: [C, D]}, {"value": np.zeros((2, 2))}, r"needs \(\) or \(1,\)"),
        ({A: [C, D]}, {"cov": [1.0, -1.0]}, r"\(d, b\) has the negative variance -1"),
        ({A: [C, D]}, {"mean": [1.0, 2.0]}, "mean is a number of a GaussianCPD"),
        ({A: [C, B]}, {}, "holds b twice"),
    ],
)
def test_plates_of_factors_that_do_not_fit(over, numbers, words):
    each = pgm.NonlinearGaussianFactor((A, B), lambda a, b: a - b, 1.0)
    with pytest.raises(pgm.ModelError, match=words) as caught:
        pgm.plate(each, over, **numbers)
    assert "residual" not in str(caught.value)
    cpd = caught.value.cpd
    assert cpd is None or isinstance(cpd, pgm.NonlinearGaussianFactor)


def test_values_are_of_factors():
    cpd = pgm.LinearGaussianCPD(B, {A: 1.0}, 1.0)
    with pytest.raises(pgm.ModelError, match="value is of a NonlinearGaussianFactor; the child"):
        pgm.plate(cpd, {B: [C, D]}, value=[1.0, 2.0])


def broken(*_):
    return 1 / 0


@pytest.mark.parametrize(
    ("factor", "words"),
    [
        (
            pgm.NonlinearGaussianCPD(B, A, broken, 0.1),
            r"^the function of NonlinearGaussianCPD\(b \|",
        ),
        (
            pgm.NonlinearGaussianFactor((A, B), broken, 0.1),
            r"^the function of NonlinearGaussianFac",
        ),
        (
            pgm.LinearGaussianCPD(B, {A: 1.0}, 0.1, noise=pgm.StudentT(4.0)),
            r"^LinearGaussianCPD\(b \| a\) has robust noise",
        ),
        (
            pgm.NonlinearGaussianFactor((A, B), lambda a, b: a * np.nan, 0.1),
            r"^NonlinearGaussianFactor\(a, b\): its linearisation",
        ),
        (
            pgm.NonlinearGaussianFactor(
                (A, B), lambda a, b: a, pgm.noise(np.abs, C, diagonal=True)
            ),
            r"no evidence for c in NonlinearGaussianFactor\(a, b, c\)",
        ),
    ],
)
def test_messages_name_the_factor(factor, words):
    first, second = pgm.GaussianCPD(A, 0.0, 1.0), pgm.GaussianCPD(B, 1.0, 1.0)
    with pytest.raises(pgm.PgmError, match=words) as caught:
        infer([first, second, factor])
    assert "residual" not in str(caught.value)
    assert caught.value.cpd is factor
    assert caught.value.variable in factor.scope


def test_contradictions_name_no_residual():
    exact = pgm.NonlinearGaussianFactor(A, lambda a: a, 0.0, value=3.0)
    with pytest.raises(pgm.NumericalError, match=r"at cluster 0, \(a\): CPDs without noise"):
        infer([pgm.GaussianCPD(A, 0.0, 0.0), exact])


def test_weights_are_asked_for_by_factor():
    near, far = (
        pgm.NonlinearGaussianFactor(A, lambda a: a, 0.1, value=v, noise=pgm.Cauchy(2.0))
        for v in (0.0, 50.0)
    )
    plain = pgm.NonlinearGaussianFactor(A, lambda a: a, 0.2, value=0.1)
    prior = pgm.GaussianCPD(A, 0.0, 1.0)
    found = infer([prior, near, far, plain], schedule=pgm.Calibration(100)).weights
    assert list(found) == [near, far, plain]
    assert found[plain] == 1.0
    assert found[far] < 0.01 < 0.9 < found[near]
    text = str(found).splitlines()
    assert text[0] == "FactorWeights(3 factors)"
    assert "1 of 3 below 0.1" in text[1]
    for key in (prior, A, "a", [near]):
        with pytest.raises(pgm.EvidenceError, match="those of a Markov network are by factor"):
            found[key]
    assert str(infer([prior]).weights)
