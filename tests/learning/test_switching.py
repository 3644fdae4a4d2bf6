"""Learning of models whose CPDs discrete variables choose."""

import numpy as np
import pytest

import pgm
from pgm.learning import Coefficients, Covariance, Offset, Parameter, Table
from pgm.learning.model import Learner
from tests.beliefs.hypotheses import enumerated

# All sequences of two modes at the steps 0 to 4.
ALL = pgm.Gaussians(32)
EVERY = (Coefficients(), Offset(), Covariance())


def learner_of(model, evidence, learn, belief=ALL, **more):
    settings = {"lineariser": pgm.Taylor(), "schedule": pgm.Smoothing(), **more}
    return Learner(model, [evidence], learn, *settings.values(), belief, [None], single=True)


def numbers_of(drawn, model):
    """The numbers of a drawn model as those of another network of its form."""
    moving, sensor = model.transition[1], model.observation[0]
    n = drawn.f.shape[-1]
    moves = [moving.cases[k,] for k in range(len(drawn.first))]
    sees = [sensor.cases[k,] for k in range(len(drawn.first))]
    return drawn._replace(
        first=model.prior[0].table,
        table=model.transition[0].table,
        f=np.array([cpd.matrices[drawn.x.previous] for cpd in moves]),
        b=np.array([cpd.offset for cpd in moves]),
        q=np.array([cpd.cov for cpd in moves]).reshape(-1, n, n),
        h=np.array([cpd.matrices[drawn.x] for cpd in sees]),
        c=np.array([cpd.offset for cpd in sees]),
        r=np.array([cpd.cov for cpd in sees]),
    )


@pytest.mark.parametrize("missing", [False, True])
def test_the_gradient_is_that_of_the_enumerated_log_evidence(missing):
    """Of everything at once, and the step of EM raises it."""
    rng = np.random.default_rng(5)
    drawn = enumerated.drawn(rng)
    values = drawn.drawn(rng, 4)
    if missing:
        values[2] = np.nan
    learn = {
        drawn.mode.at(0): Table(),
        drawn.mode: Table(),
        drawn.x: EVERY,
        drawn.z: {drawn.mode.states[0]: EVERY, drawn.mode.states[1]: (Offset(), Covariance())},
    }
    learner = learner_of(drawn.model, {drawn.z: values}, learn)
    here = learner.expected(learner.start)
    image, gradient = learner.improved(here)
    point = learner.vector(learner.start)

    def log_evidence(vector):
        return numbers_of(drawn, learner.at(learner.start, vector).model).enumerated(values)[0]

    assert here.log_evidence == pytest.approx(log_evidence(point), abs=1e-9)
    h = 1e-5
    slopes = [
        (log_evidence(point + h * unit) - log_evidence(point - h * unit)) / (2 * h)
        for unit in np.eye(point.size)
    ]
    np.testing.assert_allclose(gradient, slopes, rtol=1e-6, atol=1e-6)
    after = numbers_of(drawn, image.model).enumerated(values)[0]
    assert after > log_evidence(point)


M = pgm.Discrete("m", states=("a", "b"))
W = pgm.Discrete("w", states=("p", "q"))
S = pgm.Discrete("s", states=("u", "v"))
Y = pgm.Discrete("y", states=("n", "o"))
X, Z, U, K = pgm.variables("x z u k")
STAYS = pgm.TableCPD(M, given=M.previous, table=[[0.8, 0.2], [0.3, 0.7]])
FIRST = pgm.TableCPD(M, table=[0.6, 0.4])


def line(child, given, cov, offset=0.0):
    return pgm.LinearGaussianCPD(child, given, cov=cov, offset=offset)


def remembering():
    """Priors and motions by the mode, now and before; a sensor whose cases are one CPD; a table."""
    shared = line(Z, {X: 1.0}, 0.5)
    prior = {"a": pgm.GaussianCPD(X, 0.0, 1.0), "b": pgm.GaussianCPD(X, 2.0, 0.5)}
    motion = {
        "a": line(X, {X.previous: 0.9}, 0.1),
        "b": line(X, {X.previous: 0.5, U: 1.0}, 1.0, 1.0),
    }
    model = pgm.DynamicBayesianNetwork(
        prior=[FIRST, pgm.SwitchingCPD(X, M, prior)],
        transition=[STAYS, pgm.SwitchingCPD(X, M.previous, motion)],
        observation=[
            pgm.SwitchingCPD(Z, M, {"a": shared, "b": shared}),
            pgm.TableCPD(Y, M, table=[[0.9, 0.1], [0.4, 0.6]]),
        ],
    )
    learn = {M: Table(), M.at(0): Table(), X.at(0): (Offset(), Covariance())}
    return model, {**learn, X: EVERY, Z: EVERY, Y: Table()}


def seen_cases():
    """Motions and sensors that observed variables choose, too."""
    moves = {
        (a, b): line(X, {X.previous: 0.9 - 0.2 * i}, 0.1 + i + j, float(j))
        for i, a in enumerate("ab")
        for j, b in enumerate("pq")
    }
    sees = {
        (a, b): line(Z, {X: 1.0}, 0.3 + i, 0.5 * j)
        for i, a in enumerate("uv")
        for j, b in enumerate("ab")
    }
    model = pgm.DynamicBayesianNetwork(
        prior=[FIRST, pgm.GaussianCPD(X, 0.0, 1.0)],
        transition=[STAYS, pgm.SwitchingCPD(X, (M, W), moves)],
        observation=[pgm.SwitchingCPD(Z, (S, M), sees)],
    )
    return model, {X: EVERY, Z: EVERY, M: Table()}


def with_parameter():
    """A parameter of a function and of a linear sensor, in one case each."""
    added = pgm.NonlinearGaussianCPD(X, given=(X.previous, K), function=lambda a, b: a + b, cov=0.4)
    sees = {"a": line(Z, {X: 1.0, K: 1.0}, 0.4), "b": line(Z, {X: 2.0}, 1.0)}
    model = pgm.DynamicBayesianNetwork(
        prior=[FIRST, pgm.GaussianCPD(X, 0.0, 1.0)],
        transition=[
            STAYS,
            pgm.SwitchingCPD(X, M, {"a": line(X, {X.previous: 0.9}, 0.1), "b": added}),
        ],
        observation=[pgm.SwitchingCPD(Z, M, sees)],
    )
    return model, {K: Parameter(0.3), Z: EVERY, X: {"a": EVERY, "b": Covariance()}}


def readings(rng, runs=()):
    found = 2.0 * rng.standard_normal((*runs, 4, 1))
    found[..., 1, :] = np.nan
    return found


@pytest.mark.parametrize("runs", [(), (2,)], ids=["one", "two"])
@pytest.mark.parametrize("made", [remembering, seen_cases, with_parameter])
def test_gradients_are_differences_of_the_log_evidence(made, runs):
    """The latter equals that of enumeration, as tests of the filter say."""
    rng = np.random.default_rng(3)
    model, learn = made()
    evidence = {Z: readings(rng, runs)}
    if made is remembering:
        evidence |= {U: rng.standard_normal((4, 1)), Y: rng.integers(2, size=(*runs, 4))}
    elif made is seen_cases:
        evidence |= {W: ["p", "q", "q", "p"], S: ["u", "v", "u", "u"]}
    learner = learner_of(model, evidence, learn)
    here = learner.expected(learner.start)
    image, gradient = learner.improved(here)
    point, h = learner.vector(learner.start), 1e-5

    def log_evidence(vector):
        return learner.expected(learner.at(learner.start, vector)).log_evidence

    slopes = [
        (log_evidence(point + h * unit) - log_evidence(point - h * unit)) / (2 * h)
        for unit in np.eye(point.size)
    ]
    np.testing.assert_allclose(gradient, slopes, rtol=1e-5, atol=1e-6)
    assert learner.expected(image).log_evidence > here.log_evidence


def hidden_markov(first, table, means, covs):
    state = pgm.Discrete("state", states=("a", "b", "c"))
    read = pgm.Variable("read", components=("u", "v"))
    cases = {k: pgm.GaussianCPD(read, means[k], covs[k]) for k in range(3)}
    model = pgm.DynamicBayesianNetwork(
        prior=[pgm.TableCPD(state, table=first)],
        transition=[pgm.TableCPD(state, state.previous, table=table)],
        observation=[pgm.SwitchingCPD(read, state, cases)],
    )
    return model, state, read


def test_a_step_of_a_hidden_markov_model_is_that_of_hmmlearn():
    hmm = pytest.importorskip("hmmlearn.hmm")
    rng = np.random.default_rng(0)
    means, covs = (
        2.0 * rng.standard_normal((3, 2)),
        np.array([0.5, 1.0, 2.0])[:, None, None] * np.eye(2),
    )
    first, table = np.array([0.2, 0.3, 0.5]), rng.dirichlet(2.0 * np.ones(3), 3)
    model, _, read = hidden_markov(first, table, means, covs)
    values = model.sample(steps=200, rng=1)[read]
    other = hmm.GaussianHMM(
        *(3, "full"),
        n_iter=1,
        params="mc",
        init_params="",
        **dict.fromkeys(["covars_prior", "means_weight", "covars_weight", "min_covar"], 0.0),
    )
    other.startprob_, other.transmat_ = first @ table, table
    other.means_, other.covars_ = means, covs
    other.fit(values)
    with pytest.warns(pgm.ConvergenceWarning):
        found = pgm.fit(
            model,
            {read: values},
            learn={read: (Offset(), Covariance())},
            iterations=1,
            accelerate=False,
        )
    cases = found.model.observation[0].cases
    for k in range(3):
        np.testing.assert_allclose(cases[k,].offset, other.means_[k], atol=1e-10)
        np.testing.assert_allclose(cases[k,].cov, other.covars_[k], atol=1e-10)


def test_a_hidden_markov_model_is_learnt_with_functions_and_noise_of_inputs():
    """Its sensors are of inputs alone; the step is that of weighted rows."""
    rng = np.random.default_rng(4)
    scale = pgm.Variable("scale")
    cases = {
        "a": pgm.NonlinearGaussianCPD(Z, given=(U, K), function=lambda u, k: k * u, cov=0.3),
        "b": line(Z, {U: -1.0}, pgm.noise(lambda s: s[..., None] ** 2, given=scale)),
    }
    model = pgm.DynamicBayesianNetwork(
        prior=[FIRST], transition=[STAYS], observation=[pgm.SwitchingCPD(Z, M, cases)]
    )
    evidence = {U: rng.standard_normal((30, 1)), scale: 1.0 + rng.random((30, 1))}
    evidence[Z] = rng.standard_normal((30, 1))
    learn = {K: Parameter(0.5), Z: {"a": Covariance(), "b": (Coefficients(), Covariance("scaled"))}}
    learner = learner_of(model, evidence, learn, None)
    here = learner.expected(learner.start)
    image, gradient = learner.improved(here)
    point, h = learner.vector(learner.start), 1e-5
    slopes = [
        (
            learner.expected(learner.at(learner.start, point + h * unit)).log_evidence
            - learner.expected(learner.at(learner.start, point - h * unit)).log_evidence
        )
        / (2 * h)
        for unit in np.eye(point.size)
    ]
    np.testing.assert_allclose(gradient, slopes, rtol=1e-6, atol=1e-6)
    assert learner.expected(image).log_evidence > here.log_evidence


@pytest.mark.slow
def test_a_target_of_two_modes_is_learnt():
    """From a start that is far away, by few Gaussians, to near the numbers that it was drawn by."""

    def model(calm, wild, sight):
        cases = {"a": line(X, {X.previous: 1.0}, calm), "b": line(X, {X.previous: 1.0}, wild)}
        return pgm.DynamicBayesianNetwork(
            prior=[FIRST, pgm.GaussianCPD(X, 0.0, 1.0)],
            transition=[STAYS, pgm.SwitchingCPD(X, M, cases)],
            observation=[line(Z, {X: 1.0}, sight)],
        )

    true = model(0.01, 9.0, 0.2)
    recording = true.sample(steps=400, rng=2).evidence
    found = pgm.fit(
        *(model(0.1, 1.0, 1.0), recording),
        learn={M: Table(), X: Covariance(), Z: Covariance()},
        iterations=12,
        tolerance=0.0,
    )
    assert (np.diff(found.log_evidence) > 0.0).all()
    assert found.log_evidence[-1] > pgm.filter(true, recording).log_evidence - 0.5
    np.testing.assert_allclose(found.model.transition[0].table, STAYS.table, atol=0.15)
    assert found.parameters[X].cases[1,].cov == pytest.approx(9.0, rel=0.3)
    assert "b: LinearGaussianCPD(x | x[t-1])" in found._summary().parts
    assert found.posterior[X].mean.shape == (401, 1)


def test_what_cannot_be_learnt_of_cases():
    model, learn = remembering()
    evidence = {U: np.zeros((2, 1)), Z: np.zeros((2, 1)), Y: [0, 0]}

    def refused(told, learn, model=model, error=pgm.ModelError, **more):
        with pytest.raises(error, match=told):
            pgm.fit(model, evidence, learn=learn, **more)

    refused("the case 'c' is of no states|no state 'c'", {X: {"c": Covariance()}})
    refused("of a SwitchingCPD also a mapping", {M: {"a": Table()}})
    refused("has no Table to learn", {X: Table()})
    refused("fit learns by one smoother", learn, belief=pgm.Gaussians(4, starts=4))
    parts = [pgm.GaussianCPD(Z, 0.0, 1.0), pgm.GaussianCPD(Z, 1.0, 1.0)]
    mixed = pgm.SwitchingCPD(Z, M, {"a": pgm.MixtureCPD(parts, [0.5, 0.5]), "b": parts[0]})
    other = pgm.DynamicBayesianNetwork(prior=[FIRST], transition=[STAYS], observation=[mixed])
    with pytest.raises(pgm.ModelError, match="make its components states"):
        pgm.fit(other, {Z: [[0.0]]}, learn={Z: Covariance()})


def test_a_constant_input_beside_a_free_offset_changes_nothing():
    """Its coefficient stays, and the offset is as if the input were not there."""
    values = np.random.default_rng(1).standard_normal((50, 1))
    model = pgm.DynamicBayesianNetwork(
        prior=[pgm.GaussianCPD(X, 0.0, 1.0)],
        transition=[line(X, {X.previous: 1.0}, 0.1)],
        observation=[line(Z, {X: 1.0, U: 2.0}, 1.0)],
    )
    free = {Z: (Coefficients({U: True}), Offset(), Covariance())}
    alone = {Z: (Offset(), Covariance())}
    evidence = {Z: values, U: pgm.constant(0.1)}
    found, other = (
        pgm.fit(model, evidence, learn=learn, iterations=5, tolerance=0.0)
        for learn in (free, alone)
    )
    assert found.parameters[Z].matrices[U] == 2.0
    np.testing.assert_allclose(found.log_evidence, other.log_evidence, rtol=1e-12)
