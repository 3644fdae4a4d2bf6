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
