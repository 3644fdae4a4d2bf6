"""The models that statsmodels' tests of its filters and smoothers are about, with fixed parameters.

Each is a function that makes a bound `Representation`; `MODELS` has them by name, `DIFFUSE` those
whose initial state is exactly diffuse.
"""

import numpy as np
from statsmodels import datasets
from statsmodels.tsa.statespace.dynamic_factor import DynamicFactor
from statsmodels.tsa.statespace.dynamic_factor_mq import DynamicFactorMQ
from statsmodels.tsa.statespace.exponential_smoothing import ExponentialSmoothing
from statsmodels.tsa.statespace.initialization import Initialization
from statsmodels.tsa.statespace.kalman_smoother import KalmanSmoother
from statsmodels.tsa.statespace.sarimax import SARIMAX
from statsmodels.tsa.statespace.structural import UnobservedComponents
from statsmodels.tsa.statespace.varmax import VARMAX

MODELS, DIFFUSE = {}, {}
# Where statsmodels' own smoothed covariances are off by more than 1e-6 and 300 digits decide:
# priors of 1e6, and diffuse for want of better.
LOST = {
    "AR(1), regressors in the state",
    "AR(1), drifting regressors",
    "ARIMA(0,2,2)",
    "ARIMA(1,2,0)",
    "deterministic trend",
    "local linear deterministic trend",
    "random walk with drift",
    "local linear trend",
    "smooth trend",
    "random trend",
    "cycle",
    "deterministic cycle",
    "seasonal",
    "fixed seasonal",
    "seasonal of frequencies",
    "trend and AR(1)",
    "level and regressors in the state",
    "trend, cycle, season, AR(1), regressors",
}
# Those whose readings leave directions unknown to the end, or know them by sin π = 1e-16: there its
# exact diffuse smoother says otherwise than the limit of wide priors does.
LEFT_OPEN = {
    "ARIMA(0,1,1)",
    "ARIMA(1,1,1)",
    "ARIMA(2,1,2)",
    "ARIMA(0,2,2)",
    "SARIMA(0,1,1)(0,1,1,4)",
    "SARIMA(0,1,1)(0,1,1,12)",
    "seasonal of frequencies",
}
MACRO = datasets.macrodata.load_pandas().data[["realgdp", "realcons", "realinv"]].to_numpy()
LOGS = 100 * np.log(MACRO[:50])
LEVEL = LOGS[:, 0] - LOGS[0, 0]
SHORT = LEVEL[:24]  # for large states, where 300 digits take their time
GROWTH = np.diff(LOGS, axis=0) - np.diff(LOGS, axis=0).mean(axis=0)
NOISE = np.random.default_rng(20).standard_normal(80)
EXOG = np.column_stack([np.sin(np.arange(80)), np.linspace(-1, 1, 80)])
SPARSE = GROWTH.copy()
SPARSE[5:9] = np.nan
SPARSE[20:30, 0] = SPARSE[28:40:2, 1] = SPARSE[0, 2] = SPARSE[-1, :2] = np.nan


def of(kind, endog, params, *args, **options):
    """The representation of one of statsmodels' model classes."""

    def make():
        model = kind(endog, *args, **options)
        model.update(np.asarray(params, dtype=float))
        return model.ssm

    return make


def put(name, make, among=MODELS):
    assert name not in among, name
    among[name] = make


def sarimax(name, endog, params, order, among=MODELS, **options):
    options = {"enforce_stationarity": False, "enforce_invertibility": False} | options
    put(name, of(SARIMAX, endog, params, order=order, **options), among)


def structural(name, params, endog=LEVEL, among=MODELS, **options):
    put(name, of(UnobservedComponents, endog, params, **options), among)


def switched(make, **options):
    """The same model with other options of the filter."""

    def made():
        ssm = make()
        for name, value in options.items():
            setattr(ssm, name, value)
        return ssm

    return made


# ARMA, with and without a noise of the measurement, stationary.
for ar, ma in [
    ((0.5,), ()), ((0.99,), ()), ((0.5, 0.2), ()), ((0.5, 0.2, -0.1), ()), ((-0.9,), ()),
    ((), (0.2,)), ((), (0.9,)), ((), (1.0,)), ((), (-0.5, 0.3)), ((), (0.3, 0.0, 0.0, 0.1)),
    ((0.5,), (0.4,)), ((0.5,), (-0.5,)), ((0.9,), (-0.3, 0.4)), ((1.2, -0.4), (0.5,)),
    ((0.5, -0.2, 0.1), (0.3, 0.2)), ((0.0, 0.0, 0.0, 0.6), (0.4, 0.0, 0.2)),
]:  # fmt: skip
    spelt = f"ARMA{ar}{ma}".replace(" ", "")
    order = (len(ar), 0, len(ma))
    stationary = {"enforce_stationarity": True}
    sarimax(spelt, NOISE, (*ar, *ma, 1.0), order, **stationary)
    sarimax(
        f"{spelt}, measured with noise",
        NOISE, (*ar, *ma, 0.3, 1.0), order, measurement_error=True, **stationary,
    )  # fmt: skip
GAPS = np.where(np.arange(80) % 7 < 2, np.nan, NOISE)
sarimax("AR(3), gaps", GAPS, (0.5, 0.2, -0.1, 1.0), (3, 0, 0), enforce_stationarity=True)
sarimax("MA(2), gaps", GAPS, (0.4, 0.3, 1.0), (0, 0, 2))
sarimax("ARMA(1,1), Hamilton's form", NOISE, (0.5, 0.4, 1.0), (1, 0, 1),
        hamilton_representation=True, enforce_stationarity=True)  # fmt: skip
sarimax("ARMA(1,1), prior approximately diffuse", NOISE, (0.5, 0.4, 1.0), (1, 0, 1))
sarimax(
    "AR(1), a constant", LEVEL, (0.5, 0.9, 1.0), (1, 0, 0), trend="c", enforce_stationarity=True
)
sarimax("ARMA(1,1), trend", LEVEL, (0.5, 0.1, 0.7, 0.2, 1.0), (1, 0, 1), trend="ct",
        enforce_stationarity=True)  # fmt: skip
sarimax("ARMA(1,1), regressors", NOISE, (0.5, -0.3, 0.7, 0.2, 1.0), (1, 0, 1), exog=EXOG,
        enforce_stationarity=True)  # fmt: skip
sarimax("AR(1), regressors in the state", NOISE, (0.7, 1.0), (1, 0, 0), exog=EXOG,
        mle_regression=False)  # fmt: skip
sarimax("AR(1), drifting regressors", NOISE, (0.1, 0.2, 0.7, 1.0), (1, 0, 0), exog=EXOG,
        mle_regression=False, time_varying_regression=True)  # fmt: skip

# Differences in the state: statsmodels' prior of it is 1e6, "approximately diffuse".
for order, params in [
    ((0, 1, 1), (0.4, 1.0)), ((1, 1, 0), (0.6, 1.0)), ((1, 1, 1), (0.6, 0.3, 1.0)),
    ((2, 1, 2), (0.5, 0.2, 0.4, 0.1, 1.0)), ((0, 2, 2), (-0.5, 0.2, 1.0)), ((1, 2, 0), (0.3, 1.0)),
]:  # fmt: skip
    sarimax(f"ARIMA{order}".replace(" ", ""), LEVEL, params, order)
    sarimax(f"ARIMA{order}".replace(" ", ""), LEVEL, params, order, DIFFUSE, use_exact_diffuse=True)
sarimax("ARIMA(1,1,1), differences taken first", LEVEL, (0.6, 0.3, 1.0), (1, 1, 1),
        simple_differencing=True)  # fmt: skip
sarimax("ARIMA(1,1,1), measured with noise", LEVEL, (0.6, 0.3, 0.2, 1.0), (1, 1, 1),
        measurement_error=True)  # fmt: skip
for order, seasons, params in [
    ((1, 0, 0), (1, 0, 0, 4), (0.5, 0.4, 1.0)), ((0, 0, 1), (0, 0, 1, 4), (0.5, 0.4, 1.0)),
    ((1, 0, 1), (1, 0, 1, 4), (0.5, 0.2, 0.4, 0.3, 1.0)),
]:  # fmt: skip
    spelt = f"SARIMA{order}{seasons}".replace(" ", "")
    sarimax(spelt, LEVEL, params, order, seasonal_order=seasons, enforce_stationarity=True)


def known(make, mean=0.5, deviation=2.0):
    def made():
        ssm = make()
        size = ssm.k_states
        ssm.initialize_known(np.full(size, mean), deviation**2 * (np.eye(size) + 0.2) / 1.2)
        return ssm

    return made


put("ARIMA(1,1,1), known start", known(MODELS["ARIMA(1,1,1)"]))
put("ARIMA(0,2,2), known start", known(MODELS["ARIMA(0,2,2)"]))
for order, seasons, params in [
    ((0, 1, 1), (0, 1, 1, 4), (-0.4, -0.5, 1.0)), ((1, 1, 1), (1, 1, 0, 4), (0.5, 0.2, 0.3, 1.0)),
    ((0, 1, 1), (0, 1, 1, 12), (-0.4, -0.5, 1.0)),
]:  # fmt: skip
    spelt = f"SARIMA{order}{seasons}".replace(" ", "")
    sarimax(spelt, LEVEL, params, order, DIFFUSE, seasonal_order=seasons, use_exact_diffuse=True)
    put(f"{spelt}, known start", known(DIFFUSE[spelt]))

# Structural models.
for name, params, options in [
    ("irregular", (2.0,), {"level": "ntrend"}),
    ("deterministic constant", (2.0,), {"level": "dconstant"}),
    ("local level", (1.0, 0.5), {"level": "llevel"}),
    ("random walk", (0.5,), {"level": "rwalk"}),
    ("deterministic trend", (2.0,), {"level": "dtrend"}),
    ("local linear deterministic trend", (1.0, 0.5), {"level": "lldtrend"}),
    ("random walk with drift", (0.5,), {"level": "rwdrift"}),
    ("local linear trend", (1.0, 0.5, 0.1), {"level": "lltrend"}),
    ("smooth trend", (1.0, 0.1), {"level": "strend"}),
    ("random trend", (0.1,), {"level": "rtrend"}),
    ("cycle", (1.0, 0.5, 0.3, 0.4, 0.9), {"level": "llevel", "cycle": True, "damped_cycle": True,
                                "stochastic_cycle": True}),
    ("deterministic cycle", (0.5, 0.3), {"level": "ntrend", "irregular": True, "cycle": True}),
    ("seasonal", (1.0, 0.5, 0.2), {"level": "llevel", "seasonal": 4}),
    ("fixed seasonal", (1.0, 0.5), {
        "level": "llevel", "seasonal": 4, "stochastic_seasonal": False}),
    ("seasonal of frequencies", (1.0, 0.5, 0.2, 0.1), {
        "level": "llevel", "freq_seasonal": [{"period": 6, "harmonics": 1}, {"period": 4}]}),
    ("level and AR(1)", (0.5, 0.3, 0.7), {"level": "rwalk", "autoregressive": 1}),
    ("level and AR(2)", (1.0, 0.5, 0.3, 0.7, -0.2), {"level": "llevel", "autoregressive": 2}),
    ("trend and AR(1)", (0.1, 0.3, 0.7), {"level": "rtrend", "autoregressive": 1}),
    ("level and regressors", (1.0, 0.5, 0.3, -0.2), {"level": "llevel", "exog": EXOG}),
    ("level and regressors in the state", (1.0, 0.5), {
        "level": "llevel", "exog": EXOG, "mle_regression": False}),
    ("trend, cycle, season, AR(1), regressors", (
        1.0, 0.5, 0.1, 0.2, 0.3, 0.4, 0.5, 0.9, 0.6, 0.3, -0.2), {
        "level": "lltrend", "cycle": True, "damped_cycle": True, "stochastic_cycle": True,
        "seasonal": 4, "autoregressive": 1, "exog": EXOG}),
]:  # fmt: skip
    rows = SHORT if len(params) > 4 or "freq_seasonal" in options else LEVEL
    if "exog" in options:
        options["exog"] = EXOG[: len(rows)]
    structural(name, params, rows, **options)
    structural(name, params, rows, among=DIFFUSE, use_exact_diffuse=True, **options)
structural(
    "local level, gaps", (1.0, 0.5), np.where(np.isnan(GAPS[:50]), np.nan, LEVEL), level="llevel"
)
put("local linear trend, known start", known(MODELS["local linear trend"]))
put("seasonal, known start", known(MODELS["seasonal"]))
for name, options, params in [
    ("ETS", {}, (0.3, 1.0)), ("ETS, trend", {"trend": True}, (0.3, 0.1, 1.0)),
    ("ETS, damped trend", {"trend": True, "damped_trend": True}, (0.3, 0.1, 0.9, 1.0)),
    ("ETS, trend and season", {"trend": True, "seasonal": 4}, (0.3, 0.1, 0.2, 1.0)),
]:  # fmt: skip
    start = {"initial_level": 1.0} | ({"initial_trend": 0.9} if "trend" in options else {})
    start |= {"initial_seasonal": [0.1, -0.2, 0.3, -0.2]} if "seasonal" in options else {}
    put(name, of(ExponentialSmoothing, LEVEL + 10, params, initialization_method="known",
                 concentrate_scale=False, **options, **start))  # fmt: skip

# Several series.
LOADS = (0.8, 0.6, 1.2)
put(
    "dynamic factor",
    of(DynamicFactor, GROWTH, (*LOADS, 0.3, 0.4, 2.0, 0.6), k_factors=1, factor_order=1),
)
put(
    "dynamic factor, order 2, gaps",
    of(DynamicFactor, SPARSE, (*LOADS, 0.3, 0.4, 2.0, 0.6, 0.2), k_factors=1, factor_order=2),
)
put("dynamic factor, AR errors",
    of(DynamicFactor, GROWTH, (*LOADS, 0.3, 0.4, 2.0, 0.6, 0.3, 0.2, -0.4), k_factors=1,
       factor_order=1, error_order=1))  # fmt: skip
put("dynamic factor, AR errors, gaps",
    of(DynamicFactor, SPARSE, (*LOADS, 0.3, 0.4, 2.0, 0.6, 0.3, 0.2, -0.4), k_factors=1,
       factor_order=1, error_order=1))  # fmt: skip
put("dynamic factor, full errors",
    of(DynamicFactor, GROWTH, (*LOADS, 0.5, 0.1, 0.6, -0.2, 0.3, 1.2, 0.6), k_factors=1,
       factor_order=1, error_cov_type="unstructured"))  # fmt: skip
put("two dynamic factors",
    of(DynamicFactor, GROWTH, (0.8, 0.2, 0.6, -0.3, 1.2, 0.5, 0.3, 0.4, 2.0, 0.6, 0.1, -0.2, 0.4),
       k_factors=2, factor_order=1))  # fmt: skip
put("dynamic factor, regressors",
    of(DynamicFactor, GROWTH, (*LOADS, 0.1, -0.2, 0.3, 0.3, 0.4, 2.0, 0.6), k_factors=1,
       factor_order=1, exog=EXOG[1:50, :1]))  # fmt: skip
put("monthly dynamic factor, gaps",
    of(DynamicFactorMQ, SPARSE, (*LOADS, 0.6, 0.2, 1.0, 0.3, 0.1, 0.2, 0.3, 0.4, 2.0), factors=1,
       factor_orders=2, standardize=False))  # fmt: skip
PAIR, HOLED = GROWTH[:, :2], SPARSE[:, :2]
ROTATE, MOVE = (0.4, 0.1, -0.2, 0.5), (0.2, 0.1, -0.1, 0.3)
CHOLESKY = (0.8, 0.3, 0.6)
put("VAR(1)", of(VARMAX, PAIR, (*ROTATE, *CHOLESKY), order=(1, 0), trend="n"))
put("VAR(1), constants", of(VARMAX, PAIR, (0.1, 0.2, *ROTATE, *CHOLESKY), order=(1, 0), trend="c"))
put(
    "VAR(1), trend",
    of(VARMAX, PAIR, (0.1, 0.2, 0.01, 0.02, *ROTATE, *CHOLESKY), order=(1, 0), trend="ct"),
)
put("VAR(1), gaps", of(VARMAX, HOLED, (*ROTATE, *CHOLESKY), order=(1, 0), trend="n"))
put(
    "VAR(1), measured with noise",
    of(
        VARMAX,
        HOLED,
        (*ROTATE, *CHOLESKY, 0.2, 0.3),
        order=(1, 0),
        trend="n",
        measurement_error=True,
    ),
)
put("VMA(1)", of(VARMAX, PAIR, (*MOVE, *CHOLESKY), order=(0, 1), trend="n"))
put("VMA(1), gaps", of(VARMAX, HOLED, (*MOVE, *CHOLESKY), order=(0, 1), trend="n"))
put("VARMA(1,1)", of(VARMAX, PAIR, (*ROTATE, *MOVE, *CHOLESKY), order=(1, 1), trend="n"))
put("VARMA(1,1), measured with noise",
    of(VARMAX, PAIR, (*ROTATE, *MOVE, *CHOLESKY, 0.2, 0.3), order=(1, 1), trend="n",
       measurement_error=True))  # fmt: skip
put("VAR(2), regressors",
    of(VARMAX, PAIR, (*ROTATE, 0.1, 0.0, 0.05, -0.1, 0.3, -0.2, *CHOLESKY), order=(2, 0), trend="n",
       exog=EXOG[1:50, :1]))  # fmt: skip

# Other ways of computing, which are other code on their side.
put("dynamic factor, collapsed", switched(MODELS["dynamic factor"], filter_collapsed=True))
put(
    "dynamic factor, order 2, gaps, univariate",
    switched(MODELS["dynamic factor, order 2, gaps"], filter_univariate=True),
)
put("VARMA(1,1), univariate", switched(MODELS["VARMA(1,1)"], filter_univariate=True))
put("VAR(1), gaps, classical", switched(MODELS["VAR(1), gaps"], smooth_classical=True))
put("VAR(1), gaps, alternative", switched(MODELS["VAR(1), gaps"], smooth_alternative=True))
for name in ("AR(3), gaps", "VAR(1), measured with noise", "local linear trend, known start"):
    put(f"{name}, the state before first", switched(MODELS[name], timing_init_filtered=True))


# Matrices by hand.
def system(endog, start=None, **matrices):
    """A representation of given matrices, stationary unless its start is given."""

    def make():
        size, noises = np.shape(matrices["selection"])[:2]
        ssm = KalmanSmoother(endog.shape[1], size, noises)
        ssm.bind(np.ascontiguousarray(endog))
        for name, value in matrices.items():
            ssm[name] = value
        if start is None:
            ssm.initialize_stationary()
        elif isinstance(start, Initialization):
            ssm.initialization = start
        else:
            ssm.initialize_known(*(np.asarray(part, dtype=float) for part in start))
        return ssm

    return make


FULL = np.array([[2.0, 0.5, -0.3], [0.5, 1.0, 0.2], [-0.3, 0.2, 1.5]])
TURN = np.array([[0.5, 0.2], [-0.3, 0.6]])
SEEN = np.array([[1.0, 0.3], [0.2, 1.0], [0.5, -0.5]])
PLAIN = {
    "design": SEEN,
    "transition": TURN,
    "selection": np.eye(2),
    "state_cov": [[1, 0.3], [0.3, 0.5]],
}
for kind, rows in (("", GROWTH), (", gaps", SPARSE)):
    put(f"full noise{kind}", system(rows, obs_cov=FULL, **PLAIN))
    put(f"one exact sensor{kind}", system(rows, obs_cov=np.diag([0.0, 1.0, 2.0]), **PLAIN))
    put(
        f"noise of rank one{kind}",
        system(rows, obs_cov=np.outer([1, 2, 0.5], [1, 2, 0.5]), **PLAIN),
    )
put(
    "two exact sensors",
    system(GROWTH[:, :2], obs_cov=np.zeros((2, 2)), **PLAIN | {"design": SEEN[:2]}),
)
put("known exactly", system(GROWTH, (np.ones(2), np.zeros((2, 2))), obs_cov=FULL, **PLAIN))
put("known along a line", system(GROWTH, (np.ones(2), np.ones((2, 2))), obs_cov=FULL, **PLAIN))
put("no motion noise", system(GROWTH, (np.ones(2), FULL[:2, :2]), obs_cov=FULL,
                              **PLAIN | {"state_cov": np.zeros((2, 2))}))  # fmt: skip


def changing(rows, *names):
    """All or some of the matrices another at every step."""
    rng = np.random.default_rng(3)
    count = len(rows)
    roots = rng.standard_normal((3, 3, count)), rng.standard_normal((2, 2, count))
    drawn = {
        "design": rng.standard_normal((3, 2, count)),
        "obs_intercept": rng.standard_normal((3, count)),
        "obs_cov": np.einsum("ikt,jkt->ijt", roots[0], roots[0]) + 0.1 * np.eye(3)[..., None],
        "transition": 0.5 * rng.standard_normal((2, 2, count)),
        "state_intercept": rng.standard_normal((2, count)),
        "selection": rng.standard_normal((2, 2, count)),
        "state_cov": np.einsum("ikt,jkt->ijt", roots[1], roots[1]),
    }
    matrices = {"obs_cov": FULL, **PLAIN} | {name: drawn[name] for name in names or drawn}
    return system(rows, (np.zeros(2), np.eye(2)), **matrices)


for name in ("design", "obs_intercept", "obs_cov", "transition", "state_intercept", "state_cov"):
    put(f"changing {name}", changing(GROWTH, name))
put("changing, all", changing(GROWTH))
put("changing, all, gaps", changing(SPARSE))
put(
    "changing noises, the state before first",
    switched(changing(GROWTH, "obs_cov", "state_cov"), timing_init_filtered=True),
)

# Exactly diffuse, or in part.
put("VAR(1), diffuse", system(GROWTH[:, :2], Initialization(2, "diffuse"), obs_cov=np.zeros((2, 2)),
                              **PLAIN | {"design": np.eye(2)}), DIFFUSE)  # fmt: skip
put("VAR(1), diffuse, gaps", system(HOLED[1:], Initialization(2, "diffuse"),
                                    obs_cov=np.zeros((2, 2)), **PLAIN | {"design": np.eye(2)}),
    DIFFUSE)  # fmt: skip
put(
    "three sensors, diffuse",
    system(GROWTH, Initialization(2, "diffuse"), obs_cov=FULL, **PLAIN),
    DIFFUSE,
)


def mixed():
    start = Initialization(2)
    start.set(0, "diffuse")
    start.set(1, "known", constant=[0.3], stationary_cov=[[2.0]])
    return start


put("diffuse in part", system(GROWTH, mixed(), obs_cov=FULL, **PLAIN), DIFFUSE)
put("diffuse in part, gaps", system(SPARSE, mixed(), obs_cov=FULL, **PLAIN), DIFFUSE)
put("common level", system(GROWTH[:, :2], Initialization(2, "diffuse"), design=[[1, 0], [0.7, 1]],
                           obs_cov=np.eye(2), transition=np.eye(2), selection=[[1.0], [0.0]],
                           state_cov=[[0.5]]), DIFFUSE)  # fmt: skip
