"""The chain against statsmodels' filters and smoothers, on the models of its own tests."""

import importlib
import warnings

import numpy as np
import pytest

with warnings.catch_warnings():
    warnings.simplefilter("ignore")  # statsmodels' own
    pytest.importorskip("statsmodels", reason="statsmodels comes with the extra bench")
    models = importlib.import_module("peers.statsmodels_models")
from peers.judged import by_limit, by_reference, by_statsmodels, faults, made
from peers.statsmodels_chain import statsmodels_chain

import pgm


@pytest.mark.parametrize("name", models.MODELS)
def test_models_equal_statsmodels(name):
    ssm, result = made(models.MODELS[name])
    chain = statsmodels_chain(ssm)
    due = by_reference(chain, ssm.nobs) if name in models.LOST else by_statsmodels(result)
    assert not faults(chain, due, ssm.nobs)


@pytest.mark.parametrize("name", sorted(models.DIFFUSE.keys() - models.LEFT_OPEN))
def test_diffuse_models_equal_statsmodels(name):
    ssm, result = made(models.DIFFUSE[name])
    chain = statsmodels_chain(ssm)
    assert not faults(chain, by_statsmodels(result), ssm.nobs, result.nobs_diffuse)


LONG = "SARIMA(0,1,1)(0,1,1,12)"  # 27 states


@pytest.mark.parametrize(
    "name",
    [
        *sorted(models.LEFT_OPEN - {LONG}),
        pytest.param(LONG, marks=pytest.mark.slow),
        "local linear trend",
        "diffuse in part, gaps",
    ],
)
def test_diffuse_models_equal_the_limit_of_wide_priors(name):
    ssm, result = made(models.DIFFUSE[name])
    chain = statsmodels_chain(ssm)
    settled = result.nobs_diffuse if name == "seasonal of frequencies" else 0
    assert not faults(chain, by_limit(chain, ssm.nobs), ssm.nobs, settled)


@pytest.mark.parametrize(
    "name", ["ARMA(0.5,)(0.4,)", "local linear trend, known start", "VARMA(1,1)"]
)
def test_forecasts_equal_statsmodels(name):
    """Of readings 12 steps ahead: rows of NaN are steps without a reading."""
    ssm, result = made(models.MODELS[name])
    ahead = result.predict(ssm.nobs, ssm.nobs + 12)
    rows = np.vstack([ssm.endog.T, np.full((12, ssm.k_endog), np.nan)])
    ssm.bind(rows)
    chain = statsmodels_chain(ssm)
    belief = chain.filter()[chain.x]
    design, later = ssm["design"], slice(ssm.nobs - 12, ssm.nobs)
    mean = belief.mean[later] @ design.T + ssm["obs_intercept"].reshape(-1)
    cov = design @ belief.cov[later] @ design.T + ssm["obs_cov"]
    np.testing.assert_allclose(mean, ahead.forecasts.T, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(cov, np.moveaxis(ahead.forecasts_error_cov, -1, 0), rtol=1e-9)


GAPPED = np.where(np.arange(50) % 7 < 2, np.nan, models.LEVEL)
REGRESSORS = {"level": "llevel", "exog": models.EXOG[:50], "mle_regression": False}


@pytest.mark.parametrize(
    ("params", "options"),
    [
        ((1.0, 0.5), {"level": "llevel"}),
        ((1.0, 0.5, 0.1), {"level": "lltrend"}),
        ((1.0, 0.5, 0.2), {"level": "llevel", "seasonal": 4}),
        ((1.0, 0.5), REGRESSORS),
    ],
    ids=["local level", "trend", "seasonal", "regression"],
)
@pytest.mark.parametrize("start", [0, 2], ids=["gaps", "gaps at first"])
def test_predicted_measurements_equal_statsmodels(params, options, start):
    """One step ahead through gaps, from flat priors on, and 12 steps beyond the last reading."""
    endog = np.concatenate([GAPPED[2 - start :], np.full(12, np.nan)])
    if "exog" in options:
        options = options | {"exog": models.EXOG[: len(endog)]}
    kind = models.UnobservedComponents
    ssm, result = made(models.of(kind, endog, params, use_exact_diffuse=True, **options))
    chain = statsmodels_chain(ssm)
    x, z = chain.x, pgm.Variable("z")
    whole = ssm["design"] if ssm["design"].ndim == 3 else ssm["design"][..., None]
    rows = np.broadcast_to(whole, (1, ssm.k_states, ssm.nobs))[0].T
    wide = np.moveaxis(result.predicted_diffuse_state_cov, -1, 0)[: ssm.nobs]
    unknown = np.einsum("ti,tij,tj->t", rows, wide, rows) > 1e-9
    design = pgm.Variable("design", components=[f"d{k}" for k in range(ssm.k_states)])

    def slope(x, design):
        return design[..., None, :]

    def value(x, design):
        return (x * design).sum(axis=-1, keepdims=True)

    cpd = pgm.NonlinearGaussianCPD(z, (x, design), value, ssm["obs_cov"], jacobian={x: slope})
    given = {design: rows}
    if whole.shape[-1] == 1:
        cpd, given = pgm.LinearGaussianCPD(z, {x: rows[:1]}, ssm["obs_cov"]), {}
    model = chain.model.replace(observation=[cpd])
    seen = pgm.sightings(ssm.endog.T.reshape(-1, 1), step=np.arange(ssm.nobs), given=given)
    kept = {v: each for v, each in chain.evidence.items() if not v.name.startswith("z")}
    found = pgm.filter(model, kept | {z: seen}, steps=ssm.nobs - 1)
    ahead, innovation = found.predicted[z][: ssm.nobs], found.innovations[z]
    assert unknown.any()
    # Of the regression statsmodels' numbers are off by some 1e-9, as a filter of 120 digits tells.
    rtol = 1e-8 if "exog" in options else 1e-9
    np.testing.assert_array_equal(np.isinf(ahead.cov[:, 0, 0]), unknown)
    np.testing.assert_allclose(
        ahead.mean[~unknown, 0], result.forecasts[0, ~unknown], rtol=rtol, atol=rtol
    )
    due = result.forecasts_error_cov[0, 0, ~unknown]
    np.testing.assert_allclose(ahead.cov[~unknown, 0, 0], due, rtol=rtol)
    read = ~unknown & ~np.isnan(ssm.endog[0])
    errors = result.forecasts_error[0, read]
    np.testing.assert_allclose(innovation.residual[read, 0], errors, rtol=rtol, atol=rtol)
    assert np.isnan(innovation.residual[unknown]).all()
