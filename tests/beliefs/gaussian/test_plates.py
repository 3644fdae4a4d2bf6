"""CPDs of one plate: the answers of each alone, in one call of their function."""

from functools import partial

import numpy as np
import pytest
from numpy.testing import assert_allclose

import pgm
from pgm.cpds.plates import plate

COUNT = 6
ANGLE = {"components": ("east", "north", "heading"), "angles": ("heading",)}
A, B, C = pgm.variables("a b c")


def turned(x, y):
    """Where y is, as seen from x."""
    cos, sin, off = np.cos(x[..., 2]), np.sin(x[..., 2]), y - x
    seen = (cos * off[..., 0] + sin * off[..., 1], cos * off[..., 1] - sin * off[..., 0])
    return np.stack([*seen, off[..., 2]], axis=-1)


def posed(function, *, runs=(), hidden=()):
    """Poses on a ring, each seen from the one before and the last from the first.

    `function` makes the function of the k-th sighting. Returns the network, evidence and poses.
    """
    rng = np.random.default_rng(len(runs))
    poses = [pgm.Variable(f"x{k}", **ANGLE) for k in range(COUNT)]
    seen = [pgm.Variable(f"z{k}", **ANGLE) for k in range(COUNT)]
    true = np.stack([np.array([np.cos(a), np.sin(a), a]) for a in np.arange(COUNT)])
    pairs = zip(poses, true, strict=True)
    cpds = [pgm.GaussianCPD(x, at, np.diag(rng.uniform(0.1, 1.0, 3))) for x, at in pairs]
    for k, z in enumerate(seen):
        cov = np.diag(rng.uniform(0.01, 0.1, 3))
        given = poses[k], poses[(k + 1) % COUNT]
        cpds.append(pgm.NonlinearGaussianCPD(z, given, function(k), cov))
    evidence = {
        z: turned(true[k], true[(k + 1) % COUNT]) + 0.1 * rng.normal(size=(*runs, 3))
        for k, z in enumerate(seen)
        if k not in hidden
    }
    evidence[seen[0]][..., 1] = np.nan  # a component that was not measured
    return pgm.BayesianNetwork(cpds), evidence, [*poses, *(seen[k] for k in hidden)]


@pytest.mark.parametrize("lineariser", [pgm.Taylor(), pgm.Unscented()], ids=repr)
@pytest.mark.parametrize("runs", [(), (3,)], ids=str)
@pytest.mark.parametrize("hidden", [(), (2, 3)], ids=str)
def test_a_plate_has_the_answers_of_each_alone(lineariser, runs, hidden):
    def found(function):
        network, evidence, variables = posed(function, runs=runs, hidden=hidden)
        graph, rounds = pgm.compile(network), pgm.Calibration(iterations=4, tolerance=0.0)
        posterior = pgm.infer(graph, evidence, schedule=rounds, lineariser=lineariser)
        return posterior, [posterior[x] for x in variables]

    one, beliefs = found(lambda _: turned)
    other, due = found(lambda _: partial(turned))  # no two of these are one function
    assert_allclose(one.log_evidence, other.log_evidence, rtol=1e-12)
    for belief, alone in zip(beliefs, due, strict=True):
        assert_allclose(belief.mean, alone.mean, atol=1e-12)
        assert_allclose(belief.cov, alone.cov, atol=1e-13)


def test_the_function_is_called_once_for_all():
    shapes = []

    def told(x, y):
        shapes.append(x.shape)
        return turned(x, y)

    network, evidence, _ = posed(lambda _: told)
    graph = pgm.compile(network)
    pgm.infer(graph, evidence, schedule=pgm.Calibration(iterations=1))
    shapes.clear()
    pgm.infer(graph, evidence, schedule=pgm.Calibration(iterations=5, tolerance=0.0))
    assert len(shapes) < 5 * COUNT


def test_linear_plates_have_numbers_of_their_own():
    rng = np.random.default_rng(0)
    levels = [pgm.Variable(f"y{k}") for k in range(COUNT)]
    cpds = [pgm.GaussianCPD(levels[0], 1.0, 2.0)]
    slope, shift, noise = (
        rng.normal(size=(3, COUNT)),
        rng.normal(size=COUNT),
        1.0 + np.arange(COUNT),
    )
    slope = slope[0]
    for k in range(1, COUNT):
        given = {levels[k - 1]: slope[k]}
        cpds.append(pgm.LinearGaussianCPD(levels[k], given, offset=shift[k], cov=noise[k]))
    posterior = pgm.infer(pgm.compile(pgm.BayesianNetwork(cpds)), {levels[2]: 0.7})
    mean, cov = np.zeros(COUNT), np.zeros((COUNT, COUNT))
    mean[0], cov[0, 0] = 1.0, 2.0
    for k in range(1, COUNT):
        mean[k] = slope[k] * mean[k - 1] + shift[k]
        cov[k, :k] = cov[:k, k] = slope[k] * cov[k - 1, :k]
        cov[k, k] = slope[k] ** 2 * cov[k - 1, k - 1] + noise[k]
    gain = cov[:, 2] / cov[2, 2]
    for k, x in enumerate(levels):
        if k != 2:
            assert_allclose(posterior[x].mean, [mean[k] + gain[k] * (0.7 - mean[2])])
            assert_allclose(posterior[x].cov, [[cov[k, k] - gain[k] * cov[2, k]]])


@pytest.mark.parametrize("start", [False, True])
def test_an_error_names_the_cpd_of_its_row(start):
    def strict(x, y):
        if (x[..., 0] < -0.9).any():
            raise ValueError("too far west")
        return turned(x, y)

    network, evidence, poses = posed(lambda _: strict)
    own = {x: np.array([np.cos(k), np.sin(k), k]) for k, x in enumerate(poses)}
    with pytest.raises(
        pgm.ModelError, match="CPD of z3, run 0, failed: ValueError: too far west"
    ) as told:
        pgm.infer(pgm.compile(network), evidence, start=own if start else None)
    assert told.value.cpd in network.cpds
    assert repr(told.value.variable) == "z3"


@pytest.mark.parametrize("start", [False, True])
def test_what_is_not_finite_is_named_too(start):
    def rooted(x, y):
        return turned(x, y) + np.sqrt(x[..., :1] + 0.9)

    network, evidence, poses = posed(lambda _: rooted)
    own = {x: np.array([np.cos(k), np.sin(k), k]) for k, x in enumerate(poses)}
    with pytest.raises(pgm.LinearisationError, match=r"z3 \| x3, x4.*NaN"):
        pgm.infer(pgm.compile(network), evidence, start=own if start else None)


def squared(a):
    return a**2


def slope(a):
    return 2.0 * a[..., None]


def other_slope(a):
    return 2.0 * a[..., None]


KNOWN = pgm.NonlinearGaussianCPD(B, A, squared, 1.0, jacobian={A: slope})


@pytest.mark.parametrize(
    ("cpd", "same"),
    [
        (pgm.NonlinearGaussianCPD(C, B, squared, 3.0, jacobian={B: slope}), True),
        (pgm.NonlinearGaussianCPD(C, B, squared, 1.0), False),
        (pgm.NonlinearGaussianCPD(C, B, squared, 1.0, jacobian={B: other_slope}), False),
        (pgm.NonlinearGaussianCPD(C, B, np.sin, 1.0, jacobian={B: slope}), False),
        (
            pgm.NonlinearGaussianCPD(
                C, B, squared, 1.0, jacobian={B: slope}, lineariser=pgm.Unscented()
            ),
            False,
        ),
        (
            pgm.NonlinearGaussianCPD(
                C, B, squared, pgm.noise(lambda a: a**2, given=A), jacobian={B: slope}
            ),
            False,
        ),
        (pgm.LinearGaussianCPD(C, {B: 1.0}, cov=1.0), False),
    ],
)
def test_cpds_of_a_plate_differ_in_variables_numbers_and_noise_alone(cpd, same):
    assert (plate(cpd) == plate(KNOWN)) is same


def test_angles_are_of_another_plate():
    turn = pgm.Variable("t", components=("h",), angles=("h",))
    linear = pgm.LinearGaussianCPD(B, {A: 1.0}, cov=1.0)
    assert plate(pgm.LinearGaussianCPD(C, {A: 2.0}, cov=3.0, offset=1.0)) == plate(linear)
    assert plate(pgm.LinearGaussianCPD(turn, {A: 1.0}, cov=1.0)) != plate(linear)
    assert plate(pgm.LinearGaussianCPD(C, {turn: 1.0}, cov=1.0)) != plate(linear)
