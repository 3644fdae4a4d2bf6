"""What cannot be learnt is refused before anything is run."""

import numpy as np
import pytest

import pgm
from pgm.learning import Coefficients, Covariance, Offset, Parameter, Table

X, Z, K, Q = pgm.variables("x z k q")
READINGS = {Z: np.ones((3, 1))}


def model(x0=1.0, move=1.0, sight=1.0):
    return pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(X, 0.0, x0)],
        [pgm.LinearGaussianCPD(X, {X.previous: 1.0}, cov=move)],
        [
            pgm.LinearGaussianCPD(Z, {X: 1.0}, cov=sight),
            pgm.NonlinearGaussianCPD(Q, (X, K), lambda x, k: x * k, cov=1.0),
        ],
    )


@pytest.mark.parametrize(
    ("learn", "told"),
    [
        ({}, "learn= maps variables"),
        ({Z: "cov"}, "takes a part of pgm.learning"),
        ({Z: ()}, "one part or several"),
        ({Z: (Covariance(), Covariance())}, "each kind once"),
        ({pgm.Variable("y"): Covariance()}, "has no CPD of it"),
        ({X.at(3): Covariance()}, "has no CPD of it"),
        ({Z: Table()}, "has no Table to learn"),
        ({X.at(0): Coefficients()}, "has no coefficients to learn"),
        ({Q: Offset()}, "has no offset"),
        ({Z: Coefficients({K: True})}, "none of its parents"),
        ({Z: Coefficients({X: [True, False]})}, "an array of these"),
        ({Z: Offset(1.0)}, "an array of these"),
        ({X: Parameter(1.0)}, "is an input of Gaussian CPDs"),
        ({K: (Parameter(1.0), Covariance())}, "has no other parts"),
        ({K: Parameter([1.0, 2.0])}, "start"),
    ],
)
def test_what_is_not_there(learn, told):
    with pytest.raises(pgm.ModelError, match=told):
        pgm.fit(model(), READINGS, learn=learn)


@pytest.mark.parametrize(
    ("given", "told"),
    [
        ({"move": 0.0}, "is zero, and would stay so"),
        ({"move": pgm.noise(lambda k: k[..., None], given=K)}, "a factor alone"),
    ],
)
def test_noise_that_cannot_be_learnt(given, told):
    with pytest.raises(pgm.ModelError, match=told):
        pgm.fit(model(**given), READINGS | {K: np.ones((3, 1))}, learn={X: Covariance()})


def test_a_regressor_that_is_zero_is_no_want_of_noise():
    """Of a noise by an input: nothing is learnt of its coefficient, which stays."""
    u = pgm.Variable("u")
    noise = pgm.noise(lambda k: k[..., None], given=K)
    sensor = pgm.LinearGaussianCPD(Z, {X: 1.0, u: 2.0}, cov=noise)
    still = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(X, 0.0, 1.0)],
        [pgm.LinearGaussianCPD(X, {X.previous: 1.0}, cov=1.0)],
        [sensor],
    )
    given = READINGS | {K: np.ones((3, 1)), u: np.zeros((3, 1))}
    found = pgm.fit(still, given, learn={Z: Coefficients({u: True})})
    assert found.model.observation[0].matrices[u] == 2.0


def _pushed(pair, cov):
    """A place and its speed, moved with a noise."""
    return pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(pair, [0.0, 1.0], 1.0)],
        [pgm.LinearGaussianCPD(pair, {pair.previous: [[1, 1], [0, 0.9]]}, cov=cov)],
        [pgm.LinearGaussianCPD(Z, {pair: [[1.0, 0.0]]}, cov=0.1)],
    )


@pytest.mark.parametrize("learn", [Offset(), Coefficients()])
def test_means_of_components_without_noise(learn):
    """An EM step would leave them where they are, and call that an optimum."""
    with pytest.raises(pgm.ModelError, match="x has no noise"):
        pgm.fit(model(move=0.0), READINGS, learn={X: learn})
    pair = pgm.Variable("pair", ("place", "speed"))
    moved = _pushed(pair, np.diag([0.0, 0.1]))
    with pytest.raises(pgm.ModelError, match="place has no noise"):
        pgm.fit(moved, READINGS, learn={pair: learn})
    pushed = np.outer([0.5, 1.0], [0.5, 1.0])  # by one acceleration: no component is free of it
    with pytest.raises(pgm.ModelError, match="place, speed has no noise of its own"):
        pgm.fit(_pushed(pair, pushed), READINGS, learn={pair: learn})
    none = pgm.noise(lambda k: 0.0 * k[..., None], given=K)
    with pytest.raises(pgm.ModelError, match="noise is zero wherever"):
        pgm.fit(model(move=none), READINGS | {K: np.ones((3, 1))}, learn={X: learn})
    other = Coefficients({pair.previous: [[False, False], [False, True]]})
    found = pgm.fit(moved, READINGS, learn={pair: other})
    assert found.log_evidence[-1] > pgm.smooth(moved, READINGS).log_evidence


def test_a_prior_that_differs_by_run_or_is_flat():
    for cov in (np.ones((2, 1, 1)), np.inf):
        with pytest.raises(pgm.ModelError, match="differs by run or is infinite"):
            pgm.fit(model(x0=cov), READINGS, learn={X.at(0): Covariance()})


def test_correlations_where_a_diagonal_is_due():
    x = pgm.Variable("x", ("a", "b"))
    other = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(x, [0, 0], 1.0)],
        [pgm.LinearGaussianCPD(x, {x.previous: 1.0}, cov=[[2, 1], [1, 2]])],
    )
    with pytest.raises(pgm.ModelError, match="has correlations"):
        pgm.fit(other, {}, steps=3, learn={x: Covariance("diagonal")})


def test_evidence_that_tells_nothing():
    with pytest.raises(pgm.EvidenceError, match="nothing in the evidence tells of"):
        pgm.fit(model(), READINGS, learn={Q: Covariance()})
    with pytest.raises(pgm.ModelError, match="is to be learnt and has evidence"):
        pgm.fit(model(), READINGS | {K: pgm.constant(1.0)}, learn={K: Parameter(1.0)})
    with pytest.raises(pgm.ModelError, match="holds no recording"):
        pgm.fit(model(), [], learn={Z: Covariance()})
    with pytest.raises(pgm.ModelError, match="2 entries for 1 recordings"):
        pgm.fit(model(), READINGS, steps=[3, 3], learn={Z: Covariance()})


@pytest.mark.parametrize("kind", ["full", "diagonal", "scaled"])
def test_a_start_beyond_the_bounds(kind):
    with pytest.raises(pgm.ModelError, match="are not within 2 to 3"):
        pgm.fit(model(), READINGS, learn={Z: Covariance(kind, 2.0, 3.0)})


@pytest.mark.parametrize(
    ("name", "value"),
    [("iterations", 0), ("tolerance", -1.0), ("accelerate", 1), ("schedule", pgm.Filtering())],
)
def test_settings(name, value):
    with pytest.raises(pgm.ModelError, match=f"{name}="):
        pgm.fit(model(), READINGS, learn={Z: Covariance()}, **{name: value})


@pytest.mark.parametrize(
    "made",
    [
        lambda: Covariance("round"),
        lambda: Covariance(lower=2.0, upper=1.0),
        lambda: Coefficients([True]),
        lambda: Parameter(2.0, upper=1.0),
        lambda: Table(prior_counts=-1.0),
    ],
)
def test_parts(made):
    with pytest.raises(pgm.ModelError):
        made()


def test_beliefs_without_expectations():
    with pytest.raises(pgm.ModelError, match="no expectations to learn by"):
        pgm.fit(model(), READINGS, learn={Z: Covariance()}, belief=pgm.Particles(10))


@pytest.mark.parametrize("kind", ["full", "scaled"])
def test_variances_too_far_apart(kind):
    pair = pgm.Variable("pair", components=("a", "b"))
    sight = pgm.LinearGaussianCPD(pair, {X: [[1.0], [1.0]]}, cov=[1.0, 1e-16])
    far = model().replace(observation=[sight])
    with pytest.raises(pgm.ModelError, match="too far apart to be learnt together"):
        pgm.fit(far, {pair: [[1.0, 2.0]]}, learn={pair: Covariance(kind)})


@pytest.mark.parametrize("many", [False, True])
def test_evidence_that_is_no_mapping(many):
    log = pgm.timeline(sensors={Z: pgm.stamped([0.0, 1.0], [1.0, 2.0])})
    with pytest.raises(
        pgm.EvidenceError, match=r"found Timeline, which is none; its \.evidence is"
    ):
        pgm.fit(model(), [READINGS, log] if many else log, learn={Z: Covariance()})
