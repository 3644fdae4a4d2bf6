"""Filters of mixtures in machine code: what they leave is what the passes by NumPy leave."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

import pgm
from tests.beliefs.hypotheses import enumerated

M = pgm.Discrete("m", states=("a", "b", "c"))
W = pgm.Discrete("w", states=("p", "q"))
F = pgm.Discrete("f", states=("no", "yes"))
Y = pgm.Discrete("y", states=("n", "o"))
X = pgm.Variable("x", components=("p", "v"))
Z, U, H = pgm.variables("z u h")
MOVES = [[1.0, 0.5], [0.0, 0.9]]
STAYS = pgm.TableCPD(M, given=M.previous, table=[[0.8, 0.2, 0.0], [0.3, 0.6, 0.1], [0.0, 0.5, 0.5]])


def line(child, given, cov, offset=0.0):
    return pgm.LinearGaussianCPD(child, given, cov=cov, offset=offset)


def driven():
    """A motion with inputs and a hidden control, faults of readings, and a table of the mode."""
    motion = {
        k: line(X, {X.previous: MOVES, U: [[0.5], [1.0]], H: [[0.1], [0.2]]}, 0.1 * (k + 1) ** 2)
        for k in range(3)
    }
    sensor = {
        "no": line(Z, {X: [[1.0, 0.0]]}, 0.3),
        "yes": pgm.GaussianCPD(Z, 0.0, 50.0),
    }
    return pgm.DynamicBayesianNetwork(
        prior=[
            pgm.TableCPD(M, table=[0.5, 0.5, 0.0]),
            pgm.SwitchingCPD(X, M, {k: pgm.GaussianCPD(X, [k, 0.0], 1.0) for k in range(3)}),
        ],
        transition=[
            STAYS,
            pgm.TableCPD(F, table=[0.9, 0.1]),
            pgm.GaussianCPD(H, 0.0, 0.5),
            pgm.SwitchingCPD(X, M, motion),
        ],
        observation=[
            pgm.SwitchingCPD(Z, F, sensor),
            pgm.TableCPD(Y, M, table=[[0.9, 0.1], [0.5, 0.5], [0.2, 0.8]]),
        ],
    )


def evidence(rng, runs=(), steps=12):
    found = {
        U: rng.standard_normal((*runs, steps, 1)),
        Z: 3.0 * rng.standard_normal((*runs, steps, 1)),
        Y: rng.integers(2, size=(*runs, steps)),
    }
    found[Z][..., 3, :] = np.nan
    return found


def both(model, given, belief=None, **more):
    found = [
        pgm.filter(model, given, belief=belief, compiled=compiled, **more)
        for compiled in (True, False)
    ]
    assert found[0].status.compilation == "compiled"
    assert found[1].status.compilation == ""
    return found


def assert_equal(one, other, variables):
    assert_allclose(one.log_evidence, other.log_evidence, rtol=1e-12, atol=1e-11)
    for variable in variables:
        a, b = one[variable], other[variable]
        if isinstance(variable, pgm.Discrete):
            assert_allclose(a.probabilities, b.probabilities, atol=1e-11)
            continue
        assert_allclose(a.weights, b.weights, atol=1e-11)
        alive = b.weights > 1e-300
        assert_allclose(a.components.mean[alive], b.components.mean[alive], atol=1e-10)
        assert_allclose(a.components.cov[alive], b.components.cov[alive], atol=1e-10)


@pytest.mark.parametrize("mix", [False, True])
@pytest.mark.parametrize("runs", [(), (3,), (2, 2)], ids=["one", "three", "two by two"])
def test_inputs_controls_faults_tables_and_runs(runs, mix):
    given = evidence(np.random.default_rng(1), runs)
    belief = pgm.Gaussians(mix=mix)
    assert_equal(*both(driven(), given, belief), [M, F, X, H])


@pytest.mark.parametrize("mix", [False, True])
@pytest.mark.parametrize("modes", [2, 5])
def test_drawn_models(modes, mix):
    rng = np.random.default_rng(modes)
    for seed in range(4):
        drawn = enumerated.drawn(rng, modes=modes, n=3, d=2, zeros=bool(seed % 2))
        values = drawn.drawn(rng, 30)
        values[4:6] = np.nan
        found = both(drawn.model, {drawn.z: values}, pgm.Gaussians(mix=mix))
        assert_equal(*found, [drawn.mode, drawn.x])


def test_sightings_and_observed_modes():
    """Several readings of a step, and cases that evidence chooses; nothing is remembered."""
    moves = {k: line(X, {X.previous: MOVES}, 0.1 + k) for k in range(2)}
    sees = {"no": line(Z, {X: [[1.0, 0.0]], U: 1.0}, 0.5), "yes": line(Z, {X: [[0.0, 1.0]]}, 2.0)}
    model = pgm.DynamicBayesianNetwork(
        prior=[pgm.GaussianCPD(X, [0.0, 0.0], 1.0)],
        transition=[pgm.TableCPD(F, table=[0.7, 0.3]), pgm.SwitchingCPD(X, W, moves)],
        observation=[pgm.SwitchingCPD(Z, F, sees)],
    )
    steps = [1, 1, 1, 2, 4, 4]
    rng = np.random.default_rng(2)
    given = {
        W: ["p", "q", "q", "p", "p"],
        Z: pgm.sightings(
            rng.standard_normal((6, 1)), step=steps, given={U: rng.standard_normal((6, 1))}
        ),
    }
    assert_equal(*both(model, given), [F, X])


def test_many_components_are_swept_in_loops():
    rng = np.random.default_rng(3)
    drawn = enumerated.drawn(rng, modes=2, n=14, d=6)
    values = drawn.drawn(rng, 6)
    assert_equal(*both(drawn.model, {drawn.z: values}), [drawn.mode, drawn.x])


def test_nothing_read_and_no_steps():
    model = driven()
    for steps in (0, 3):
        given = {U: np.zeros((steps, 1))}
        assert_equal(*both(model, given, steps=steps), [M, X])


def test_a_long_record_is_compiled_unasked():
    rng = np.random.default_rng(4)
    drawn = enumerated.drawn(rng)
    values = drawn.drawn(rng, 600)
    assert pgm.filter(drawn.model, {drawn.z: values}).status.compilation == "compiled"
    short = pgm.filter(drawn.model, {drawn.z: values[:20]}).status.compilation
    assert short.startswith("by NumPy: machine code is made for longer work")


def test_what_is_left_to_numpy_is_told():
    rng = np.random.default_rng(5)
    drawn = enumerated.drawn(rng)
    values = drawn.drawn(rng, 5)

    def compilation(run, evidence=None, model=drawn.model, **more):
        given = {drawn.z: values} if evidence is None else evidence
        return run(model, given, compiled=True, **more).status.compilation

    assert "and these are smoothed" in compilation(pgm.smooth)
    assert "others were asked for" in compilation(pgm.filter, belief=pgm.Gaussians(5))
    scale = pgm.Variable("scale")
    own = pgm.noise(lambda s: s[..., None] ** 2, given=scale)
    noisy = {k: line(drawn.z, {drawn.x: drawn.h[k]}, own) for k in range(2)}
    model = drawn.model.replace(observation=[pgm.SwitchingCPD(drawn.z, drawn.mode, noisy)])
    given = {drawn.z: values, scale: np.ones((5, 1))}
    assert "functions of noise" in compilation(pgm.filter, given, model)
    sharp = enumerated.drawn(rng)
    cases = {k: line(sharp.z, {sharp.x: sharp.h[k]}, 1e-14, sharp.c[k]) for k in range(2)}
    exact = sharp.model.replace(observation=[pgm.SwitchingCPD(sharp.z, sharp.mode, cases)])
    assert "readings are too sharp" in compilation(pgm.filter, {sharp.z: values}, exact)
    certain = {k: line(sharp.z, {sharp.x: sharp.h[k]}, 0.0, sharp.c[k]) for k in range(2)}
    exact = sharp.model.replace(observation=[pgm.SwitchingCPD(sharp.z, sharp.mode, certain)])
    assert "singular noise" in compilation(pgm.filter, {sharp.z: values}, exact)
    with pytest.raises(pgm.ModelError, match="an online filter of mixtures is made by NumPy"):
        pgm.OnlineFilter(drawn.model, compiled=True)


def test_impossible_evidence_is_refused_in_the_same_words():
    model = driven().replace(
        observation=[
            driven().observation[0],
            pgm.TableCPD(Y, M, table=[[1.0, 0.0], [1.0, 0.0], [0.0, 1.0]]),
        ]
    )
    model = model.replace(prior=[pgm.TableCPD(M, table=[1.0, 0.0, 0.0]), model.prior[1]])
    given = evidence(np.random.default_rng(1))
    given[Y] = np.array([1, *[0] * 11])  # the mode c at the first step, where it cannot be
    told = []
    for compiled in (True, False):
        with pytest.raises(pgm.NumericalError, match="have probability zero") as caught:
            pgm.filter(model, given, compiled=compiled)
        told.append(str(caught.value))
    assert told[0] == told[1]
