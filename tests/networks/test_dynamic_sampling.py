"""Ancestral samples: their moments against the dense joint, and their evidence in the filter."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import pgm
from tests.dense import unrolled

X = pgm.Variable("x", components=("position", "speed"))
Y, U, COMMAND, Z, W, PLACE = pgm.variables("y u command z w place")
M = pgm.Variable("m", components=("east", "north"))
STEPS = 3
COMMANDS = np.array([[0.5], [-1.0], [2.0]])
Z_STEPS = np.array([3, 2, 0, 2, 2])  # in no order, several a step
PLACES = np.array([[1.0], [2.0], [-1.0], [0.5], [0.0]])


def model_of():
    """Two states, a static unknown, a hidden control, and two sensors."""
    drive = np.array([[1.0, 0.4], [0.0, 0.9]])
    return pgm.DynamicBayesianNetwork(
        prior=[
            pgm.GaussianCPD(X, [1.0, -1.0], [[1.0, 0.3], [0.3, 0.5]]),
            pgm.LinearGaussianCPD(Y, {X: [[0.5, 1.0]]}, offset=2.0, cov=0.4),
            pgm.GaussianCPD(M, [3.0, 0.0], [[1.0, 0.8], [0.8, 1.0]]),
        ],
        transition=[
            pgm.LinearGaussianCPD(
                X,
                {X.previous: drive, U: [[0.1], [1.0]]},
                offset=[0.1, 0.0],
                cov=[[0.2, 0.1], [0.1, 0.05]],  # singular
            ),
            pgm.LinearGaussianCPD(Y, {Y.previous: 0.7, X: [[0.0, 1.0]]}, cov=0.3),
            pgm.LinearGaussianCPD(M, {M.previous: 1.0}, cov=np.zeros((2, 2))),
            pgm.LinearGaussianCPD(U, {COMMAND: 2.0}, cov=0.6),
        ],
        observation=[
            pgm.LinearGaussianCPD(
                Z, {X: [[1.0, 0.0]], M: [[-1.0, 0.5]], PLACE: 1.0}, offset=0.5, cov=0.1
            ),
            pgm.LinearGaussianCPD(W, {Y: 1.0, U: 1.0}, cov=0.2),
        ],
    )


def drawn(runs, rng=0):
    inputs = {COMMAND: COMMANDS, Z: pgm.sightings(step=Z_STEPS, given={PLACE: PLACES})}
    return model_of().sample(inputs, runs=runs, rng=rng)


def dense():
    sightings = [(Z, int(t), {PLACE: p}) for t, p in zip(Z_STEPS, PLACES, strict=True)]
    sightings += [(W, t, {}) for t in range(1, STEPS + 1)]
    return unrolled(model_of(), STEPS, {COMMAND: COMMANDS}, sightings)


def stacked(sample, joint):
    """Lay the sample out like the joint, (runs, n)."""
    columns = []
    for label in joint.places:
        if isinstance(label, tuple):
            sensor, k = label
            columns.append(sample[sensor][:, k if sensor == Z else k - len(Z_STEPS)])
        else:
            first = 1 if label.template == U else 0
            columns.append(sample[label.template][:, label.step - first])
    return np.concatenate(columns, axis=-1)


def test_moments_are_those_of_the_joint():
    joint, runs = dense(), 20_000
    x = stacked(drawn(runs), joint)
    spread = np.sqrt(np.diag(joint.cov) / runs)
    assert (np.abs(x.mean(axis=0) - joint.mean) <= 5 * spread + 1e-12).all()
    variance = np.diag(joint.cov)
    error = np.sqrt((np.outer(variance, variance) + joint.cov**2) / runs)
    assert (np.abs(np.cov(x.T) - joint.cov) <= 5 * error + 1e-12).all()


@pytest.mark.parametrize(("runs", "lead"), [((), ()), (4, (4,)), ((2, 3), (2, 3))])
def test_shapes(runs, lead):
    sample = drawn(runs)
    assert sample[X].shape == (*lead, STEPS + 1, 2)
    assert sample[Y].shape == (*lead, STEPS + 1, 1)
    assert sample[U].shape == (*lead, STEPS, 1)
    assert sample[Z].shape == (*lead, 5, 1)
    assert sample[W].shape == (*lead, STEPS, 1)
    assert_array_equal(sample[M], np.broadcast_to(sample[M][..., :1, :], sample[M].shape))
    with pytest.raises(pgm.ModelError, match="no values of command") as caught:
        sample[COMMAND]
    assert caught.value.variable == COMMAND


def test_a_seed_draws_the_same_again():
    first, again, other = drawn(3, rng=5), drawn(3, rng=5), drawn(3, rng=6)
    rng = np.random.default_rng(5)
    generated, further = drawn(3, rng=rng), drawn(3, rng=rng)
    for variable in (X, Y, M, U, Z, W):
        assert_array_equal(first[variable], again[variable])
        assert_array_equal(first[variable], generated[variable])
        assert (first[variable] != other[variable]).all()
        assert (first[variable] != further[variable]).all()


def test_what_draws_is_asked_for():
    with pytest.raises(pgm.ModelError, match=r"rng is a numpy\.random\.Generator or a seed"):
        model_of().sample(steps=3, rng=None)


def test_a_sample_is_read_by_variable():
    sample = model_of().sample({COMMAND: COMMANDS}, rng=0)
    with pytest.raises(pgm.ModelError, match=f"no variable.* itself, {U!r}$"):
        sample[U.name]
    with pytest.raises(pgm.ModelError, match="stranger, which the sample does not have"):
        sample[pgm.Variable("stranger")]


def test_there_is_no_global_random_state():
    np.random.seed(0)  # noqa: NPY002
    before = np.random.get_state()[1].copy()  # noqa: NPY002
    drawn(3)
    assert_array_equal(np.random.get_state()[1], before)  # noqa: NPY002


def test_the_evidence_is_ready_for_inference():
    sample, joint = drawn((2, 3), rng=1), dense()
    assert set(sample.evidence) == {COMMAND, Z, W}
    posterior = pgm.filter(model_of(), sample.evidence)
    for k in np.ndindex(2, 3):
        readings = {(Z, row): sample[Z][(*k, row)] for row in range(5)}
        readings |= {(W, 5 + row): sample[W][(*k, row)] for row in range(STEPS)}
        rest, log_evidence = joint.given(readings)
        assert_allclose(posterior.log_evidence[k], log_evidence, atol=1e-8)
        mean, cov = rest.marginal(X.at(STEPS))
        assert_allclose(posterior[X.at(STEPS)].mean[k], mean, atol=1e-8)
        assert_allclose(posterior[X.at(STEPS)].cov[k], cov, atol=1e-8)


def test_priors_and_inputs_of_runs():
    model = model_of()
    here_and_there = pgm.GaussianCPD(X, [[0.0, 0.0], [50.0, 0.0]], np.zeros((2, 2)))
    model = model.replace(prior=[here_and_there, *model.prior[1:]])
    commands = np.array([0.0, 1e3]).reshape(2, 1, 1) + COMMANDS
    sample = model.sample({COMMAND: commands}, rng=0)
    assert_array_equal(sample[X][:, 0], [[0.0, 0.0], [50.0, 0.0]])
    assert abs(sample[U][0]).max() < 100 < abs(sample[U][1]).min()
    assert Z not in sample.values  # its places are not known
    assert sample[W].shape == (2, STEPS, 1)


def test_nonlinear_functions_and_noise():
    x, u, z = pgm.Variable("x", angles=("x",)), pgm.Variable("u"), pgm.Variable("z")
    model = pgm.DynamicBayesianNetwork(
        prior=[pgm.GaussianCPD(x, 3.0, 0.0)],
        transition=[
            pgm.NonlinearGaussianCPD(
                x, (u, x.previous), lambda u, x: x + 2 * u, pgm.noise(lambda u: 0 * u[..., None], u)
            )
        ],
        observation=[
            pgm.NonlinearGaussianCPD(
                z, x, lambda x: np.sin(x), pgm.noise(lambda u: u[..., None] ** 2, u)
            )
        ],
    )
    steps = np.arange(3.0)[:, None]
    sample = model.sample({u: steps}, runs=20_000, rng=0)
    assert_allclose(sample[x][0], [[3.0], [3.0], [5.0], [9.0]])  # the chart is not wrapped
    left = sample[z] - np.sin(sample[x][:, 1:])
    assert_allclose(left.std(axis=0), steps, rtol=5 / np.sqrt(2 * 20_000))
    assert_allclose(left[:, 0], 0.0, atol=1e-15)


def test_no_step_and_no_sighting():
    sample = model_of().sample(
        {
            COMMAND: np.zeros((0, 1)),
            Z: pgm.sightings(step=[], given={PLACE: np.zeros((0, 1))}),
        },
        runs=4,
        rng=0,
    )
    assert sample[X].shape == (4, 1, 2)
    assert sample[U].shape == (4, 0, 1)
    assert sample[Z].shape == (4, 0, 1)


def test_inputs_are_asked_for():
    with pytest.raises(pgm.EvidenceError, match="command") as caught:
        model_of().sample(steps=3, rng=0)
    assert caught.value.variable == COMMAND
    with pytest.raises(pgm.EvidenceError, match="steps="):
        model_of().sample({COMMAND: pgm.constant(1.0)}, rng=0)
    with pytest.raises(pgm.EvidenceError, match="place") as caught:
        model_of().sample({COMMAND: COMMANDS, Z: pgm.sightings(step=[1])}, rng=0)
    assert caught.value.variable == PLACE


def moving(function, cov=1.0):
    given = (Y.previous, COMMAND)
    return pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(Y, 0, 1)], [pgm.NonlinearGaussianCPD(Y, given, function, cov)]
    )


@pytest.mark.parametrize("runs", [(), 3])
@pytest.mark.parametrize("function", [lambda y, u: y[..., 0], lambda y, u: np.array(3.0)])
def test_functions_of_wrong_shape_are_refused(function, runs):
    with pytest.raises(pgm.ModelError, match="shape") as caught:
        moving(function).sample({COMMAND: COMMANDS}, runs=runs, rng=0)
    assert caught.value.variable == Y


@pytest.mark.parametrize("noise", [lambda u: -(u[..., None] ** 2), lambda u: u])
def test_malformed_noise_is_refused(noise):
    cov = pgm.noise(noise, given=COMMAND)
    with pytest.raises(pgm.ModelError, match="noise"):
        moving(lambda y, u: y, cov).sample({COMMAND: COMMANDS}, rng=0)


def test_values_that_are_not_finite_are_refused():
    with pytest.raises(pgm.PgmError) as caught:
        moving(lambda y, u: y + np.where(u < 0, np.nan, u)).sample({COMMAND: COMMANDS}, rng=0)
    assert caught.value.step == 2


def test_means_of_runs_of_a_hidden_control():
    model = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(Y, 0, 0)],
        [
            pgm.GaussianCPD(U, np.array([[1.0], [2.0]]), 0),
            pgm.LinearGaussianCPD(Y, {Y.previous: 1.0, U: 1.0}, cov=0),
        ],
    )
    sample = model.sample(steps=2, rng=0)
    assert_allclose(sample[Y], [[[0.0], [1.0], [2.0]], [[0.0], [2.0], [4.0]]])


@pytest.mark.parametrize("runs", [0, -1, 2.5, "3", True, (2, 0)])
def test_the_number_of_draws_is_checked(runs):
    with pytest.raises(pgm.ModelError, match="runs is the number of draws"):
        drawn(runs)


def test_draws_and_the_runs_of_the_model_broadcast():
    level = pgm.Variable("level")
    model = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(level, [[0.0], [9.0]], 1.0)],
        [pgm.LinearGaussianCPD(level, {level.previous: 1.0}, cov=1.0)],
    )
    assert model.sample(steps=3, runs=np.int64(2), rng=0)[level].shape == (2, 4, 1)
    with pytest.raises(pgm.ModelError, match=r"axes of runs \(2,\); runs=\(1000, 1\) draws"):
        model.sample(steps=3, runs=3, rng=0)
