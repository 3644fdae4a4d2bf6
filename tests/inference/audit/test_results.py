"""The numbers and the errors of audits."""

import pickle

import numpy as np
import pytest
from textbooks import refusal

import pgm
from pgm import GraphError, LinearisationError, ModelError, NumericalError
from pgm.inference.audit import batches
from pgm.inference.audit.mixture import Mixture
from pgm.kernels.pareto import pareto_shape

a, b, z, fix = pgm.variables("a b z fix")
pair = pgm.Variable("pair", components=("p", "q"))
I2 = np.eye(2)


def chain(*sensors, transition=None, prior=None):
    return pgm.DynamicBayesianNetwork(
        prior=[prior or pgm.GaussianCPD(a, 1.0, 1.0)],
        transition=[transition or pgm.NonlinearGaussianCPD(a, a.previous, np.sin, 0.5)],
        observation=sensors or [pgm.NonlinearGaussianCPD(z, a, np.exp, 0.3)],
    )


def posterior(runs=(), **parts):
    values = np.linspace(0.5, 1.5, 3) + np.zeros((*runs, 3))
    return pgm.smooth(chain(**parts), {z: values[..., None]})


def test_the_numbers_of_the_gaussian_are_made_of_its_weights():
    found = pgm.audit(posterior((2, 3)), samples=400, rng=7)
    weights = np.exp(found.log_weights)
    assert weights.shape == (2, 3, 400)
    np.testing.assert_allclose(
        found.effective_sample_size, weights.sum(-1) ** 2 / (weights**2).sum(-1)
    )
    np.testing.assert_allclose(found.correction, found.log_evidence - found.gaussian_log_evidence)
    assert found.samples == 400
    assert found.pareto_k.shape == (2, 3)
    for belief in (found.corrected[a], posterior((2, 3))[a]):
        assert belief.mean.shape == (2, 3, 4, 1)
        assert belief.steps.tolist() == [0, 1, 2, 3]
    assert found.moment_divergence[a].shape == (2, 3, 4)
    for value in (found.suspect, found.trusted, found.undefined, found.inclusive_divergence):
        assert value.shape == (2, 3)


def test_an_audit_is_a_value():
    found = pgm.audit(posterior(), samples=100, rng=1)
    assert isinstance(found, pgm.results.Audit)
    assert repr(found).startswith("Audit(100 samples, effective ")
    assert list(pickle.loads(pickle.dumps(found)).innovations) == [z]
    with pytest.raises(AttributeError, match="immutable"):
        found.divergence = 0.0
    with pytest.raises(ValueError, match="read-only"):
        found.log_weights[...] = 0.0
    np.testing.assert_array_equal(pickle.loads(pickle.dumps(found)).log_weights, found.log_weights)


def test_a_seed_and_its_generator_draw_the_same():
    given = posterior()
    one, same, other = (
        pgm.audit(given, samples=50, rng=rng).log_weights
        for rng in (3, np.random.default_rng(3), 4)
    )
    np.testing.assert_array_equal(one, same)
    assert (one != other).all()


def test_batches_of_draws_are_of_one_law(monkeypatch):
    """Many small batches, whose estimate is within the error of one large one's."""
    given = posterior((2,))
    whole = pgm.audit(given, samples=4000, rng=1)
    monkeypatch.setattr(batches, "BATCH", 100)
    parts = pgm.audit(given, samples=4000, rng=2)
    gap = np.abs(whole.log_evidence - parts.log_evidence)
    assert (gap > 0).all()
    assert (gap < 4 * np.hypot(whole.standard_error, parts.standard_error)).all()


def bent(curvature):
    """A posterior of a linear motion and a sensor of some curvature."""
    model = chain(
        pgm.NonlinearGaussianCPD(z, a, lambda x: x + curvature * x**2, 0.3),
        transition=pgm.LinearGaussianCPD(a, {a.previous: 0.9}, cov=0.5),
    )
    return pgm.smooth(model, {z: np.full((3, 1), 1.5)})


@pytest.mark.slow
def test_the_standard_error_is_that_of_many_audits():
    given = bent(0.1)
    found = [pgm.audit(given, samples=200, rng=seed) for seed in range(300)]
    spread = np.std([each.log_evidence for each in found])
    told = np.sqrt(np.mean([each.standard_error**2 for each in found]))
    np.testing.assert_allclose(told, spread, rtol=0.15)


def test_divergences_grow_with_curvature():
    none, some, more = (pgm.audit(bent(c), rng=0).divergence for c in (0.0, 0.05, 0.15))
    assert none < 1e-12 < 1e-4 < some < more


@pytest.mark.parametrize("shape", [0.2, 0.5, 0.9, 2.0])
def test_the_shape_of_pareto_tails(shape):
    """Weights U^−k have a tail of shape k exactly; scale does not matter."""
    uniform = np.random.default_rng(0).uniform(size=(5, 100_000))
    found = pareto_shape(700.0 - shape * np.log(uniform))
    np.testing.assert_allclose(found.mean(), shape, atol=0.05)


def test_shapes_of_tails_that_are_none():
    rng = np.random.default_rng(0)
    bounded = np.log(rng.uniform(size=1000))
    one = np.where(np.arange(1000) == 3, 0.0, -900.0 - rng.uniform(size=1000))
    found = pareto_shape(np.array([np.zeros(1000), bounded, one]))
    assert found[0] == -np.inf
    assert found[1] < 0.0
    assert found[2] == np.inf
    assert np.isnan(pareto_shape(np.zeros((2, 24)))).all()


# ---- errors


def rooted(x):
    return np.sqrt(x)


def exact_nonlinear():
    model = chain(pgm.NonlinearGaussianCPD(z, a, np.exp, 0.0))
    return pgm.audit(pgm.smooth(model, {z: np.ones((2, 1))}), rng=0)


def exact_beside_a_deterministic_motion():
    model = chain(
        pgm.LinearGaussianCPD(fix, {a: 1.0}, cov=0.0),
        transition=pgm.NonlinearGaussianCPD(a, a.previous, np.sin, 0.0),
    )
    return pgm.audit(pgm.smooth(model, {fix: pgm.sightings([[0.9]], step=[0])}, steps=1), rng=0)


def exact_beside_a_grouped_sensor():
    model = pgm.DynamicBayesianNetwork(
        prior=[pgm.GaussianCPD(pair, [0, 1], I2)],
        transition=[pgm.LinearGaussianCPD(pair, {pair.previous: 1.0}, cov=I2)],
        observation=[
            pgm.LinearGaussianCPD(fix, {pair: [[1.0, 0.0]]}, cov=0.0),
            pgm.NonlinearGaussianCPD(z, pair, lambda x: x[..., 1:] ** 2, 0.4, grouped=True),
        ],
    )
    evidence = {
        fix: pgm.sightings([[0.9]], step=[1]),
        z: pgm.sightings([[1.0], [1.2]], step=[1, 1]),
    }
    return pgm.audit(pgm.smooth(model, evidence, steps=1, lineariser=pgm.Cubature()), rng=0)


def undefined():
    model = chain(pgm.NonlinearGaussianCPD(z, a, rooted, 0.3))
    return pgm.audit(pgm.smooth(model, {z: np.ones((2, 1))}), rng=0)


def impossible():
    """A sensor that is a line where it is linearised, and out of all bounds elsewhere."""
    sensor = pgm.NonlinearGaussianCPD(
        z,
        a,
        lambda x: np.where(x == 1.0, x, 1e200),
        0.3,
        jacobian={a: lambda x: np.ones((*x.shape, 1))},
    )
    given = pgm.smooth(chain(sensor), {z: pgm.sightings([[1.5]], step=[0])}, steps=0)
    return pgm.audit(given, samples=20, rng=0)


def loopy():
    net = pgm.BayesianNetwork(
        [
            pgm.GaussianCPD(a, 0.0, 1.0),
            pgm.LinearGaussianCPD(b, {a: 1.0}, cov=1.0),
            pgm.LinearGaussianCPD(fix, {a: 1.0}, cov=1.0),
            pgm.LinearGaussianCPD(z, {b: 1.0, fix: 1.0}, cov=1.0),
        ]
    )
    graph = pgm.compile(net, method=pgm.Bethe())
    return pgm.audit(pgm.infer(graph, {z: 1.0}, schedule=pgm.Flooding()), rng=0)


def discrete():
    rain = pgm.Discrete("rain", states=("no", "yes"))
    net = pgm.BayesianNetwork([pgm.TableCPD(rain, table=[0.8, 0.2])])
    return pgm.audit(pgm.infer(pgm.compile(net), {}), rng=0)


ERRORS = [
    refusal(
        "an exact nonlinear sensor",
        exact_nonlinear,
        NumericalError,
        "NonlinearGaussianCPD(z | a)",
        "singular",
        "give it noise",
        variable=z,
    ),
    refusal(
        "an exact sensor beside a motion without noise",
        exact_beside_a_deterministic_motion,
        NumericalError,
        "NonlinearGaussianCPD(a | a[t-1])",
        "singular",
        "the exact sensor",
        variable=a,
    ),
    refusal(
        "an exact sensor beside a grouped one",
        exact_beside_a_grouped_sensor,
        NumericalError,
        "NonlinearGaussianCPD(z | pair)",
        "grouped=True",
        variable=z,
    ),
    refusal(
        "a function that is not defined everywhere",
        undefined,
        LinearisationError,
        "NonlinearGaussianCPD(z | a)",
        "at step 1",
        "NaN or infinite at a draw",
        variable=z,
        step=1,
    ),
    refusal("a model that no draw fits", impossible, NumericalError, "run 0", "no draw", "units"),
    refusal("loops", loopy, GraphError, "calibrated tree", "pgm.compile(network)"),
    refusal("tables", discrete, ModelError, "discrete", "exact"),
    refusal("no posterior", lambda: pgm.audit(chain(), rng=0), ModelError, "pgm.smooth"),
    refusal(
        "one sample", lambda: pgm.audit(posterior(), samples=1, rng=0), ModelError, "2 or more"
    ),
    refusal(
        "half a sample",
        lambda: pgm.audit(posterior(), samples=2.5, rng=0),
        ModelError,
        "samples",
        "2.5",
    ),
    refusal("no seed", lambda: pgm.audit(posterior(), rng=None), ModelError, "rng", "None"),
    refusal(
        "more weights than fit",
        lambda: pgm.audit(posterior(), samples=2**30, rng=0),
        GraphError,
        "the weights of an audit",
        "GiB",
    ),
]


@pytest.mark.parametrize("row", ERRORS, ids=lambda row: row.name)
def test_errors(row):
    row.check()


def test_a_reading_not_taken_needs_no_value_of_its_function():
    model = chain(
        pgm.NonlinearGaussianCPD(z, a, rooted, 0.3),
        transition=pgm.LinearGaussianCPD(a, {a.previous: 1.0}, cov=0.5),
    )
    found = pgm.audit(pgm.smooth(model, {z: [[np.nan], [np.nan]]}), rng=0)
    np.testing.assert_allclose(found.log_weights, 0.0, atol=1e-12)


def tracked(rng, outliers=0.0, drift=0.0):
    """A random walk read with noise, of which a share is 15 times too large, or which drifts."""
    states = np.cumsum(rng.normal(drift, 0.5, 300))
    noise = rng.normal(0.0, 0.3, 300) * np.where(rng.uniform(size=300) < outliers, 15.0, 1.0)
    model = pgm.DynamicBayesianNetwork(
        prior=[pgm.GaussianCPD(a, 0.0, 0.5)],
        transition=[pgm.LinearGaussianCPD(a, {a.previous: 1.0}, cov=0.25)],
        observation=[pgm.LinearGaussianCPD(z, {a: 1.0}, cov=0.09)],
    )
    values = states + noise
    return pgm.audit(pgm.smooth(model, {z: values[:, None]}), rng=0), values


def kalman(values):
    """Normalised innovations of the same walk, from the textbook."""
    mean, cov, out = 0.0, 0.5, []
    for value in values:
        cov += 0.25
        out.append((value - mean) / np.sqrt(cov + 0.09))
        gain = cov / (cov + 0.09)
        mean, cov = mean + gain * (value - mean), (1 - gain) * cov
    return np.array(out)


@pytest.mark.parametrize(
    ("wrong", "fits"), [({}, True), ({"outliers": 0.1}, False), ({"drift": 0.6}, False)], ids=str
)
def test_a_wrong_model_is_seen_by_its_innovations(wrong, fits):
    """Of a linear model the Gaussian answer is exact, be the model right or wrong."""
    found, values = tracked(np.random.default_rng(5), **wrong)
    assert found.effective_sample_size == pytest.approx(1000.0)
    assert found.divergence < 1e-9
    white, seen = kalman(values), found.innovations[z]
    assert seen.nis == pytest.approx((white**2).mean())
    assert seen.overall == pytest.approx((white**2).mean())
    lagged = white[:-1] @ white[1:] / np.sqrt((white[:-1] ** 2).sum() * (white[1:] ** 2).sum())
    assert seen.autocorrelation == pytest.approx(lagged)
    assert seen.band == pytest.approx(2.576 * np.sqrt(2 / 300), rel=1e-3)
    assert seen.fits == fits
    told = " ".join(repr(found).split())
    assert ("speaks against the model" in told) != fits
    assert f"z NIS {seen.overall:.3g} a component (right: 1 ± {seen.band:.2g})" in told
    if "drift" in wrong:
        assert abs(seen.autocorrelation) > seen.autocorrelation_band


def test_the_summary_bounds_nothing_and_says_against_what():
    found = pgm.audit(posterior((2, 3)), samples=50, rng=7)
    told = " ".join(repr(found).split())
    assert "or less" not in told
    assert "or more" not in told
    assert f"effective {found.effective_sample_size.min():.4g} in the worst run" in told
    assert f"Pareto shape {found.pareto_k.max():.2g} (to be below 0.7)" in told
    assert f"divergence [nats], most of all runs {found.divergence.max():.3g}" in told
    assert "The answer against the exact posterior of the same model:" in told


def summed_up(log_weights):
    """An audit of weights of the Gaussian, and of as many that say nothing."""
    both = np.concatenate([log_weights, np.full_like(log_weights, -np.inf)])[None]
    control = np.where(np.isfinite(both), 2.0, 0.0)
    return pgm.results.Audit(Mixture.make(both, control, both, np.zeros(1)), np.array(0.0))


def test_estimates_of_a_heavy_tail_are_not_to_be_trusted():
    uniform = np.random.default_rng(0).uniform(size=1000)
    heavy, light = (summed_up(-shape * np.log(uniform)) for shape in (2.0, 0.2))
    assert not heavy.trusted
    assert "these estimates are not to be trusted" in repr(heavy)
    assert light.trusted
    assert "not to be trusted" not in repr(light)
    assert repr(light).endswith("The model against its data: not seen by this audit")


def test_runs_that_are_not_read_have_no_nis():
    values = np.array([[0.3, 0.4], [np.nan, np.nan]])[..., None]
    found = pgm.audit(pgm.smooth(chain(), {z: values}), samples=50, rng=0)
    assert np.isnan(found.innovations[z].nis).tolist() == [False, True]
    blank = pgm.audit(pgm.smooth(chain(), {z: values[1]}), samples=50, rng=0)
    assert not blank.innovations
