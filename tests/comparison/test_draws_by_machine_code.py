"""Draws in machine code: NumPy's words bit for bit, its numbers and paths to rounding."""

import mpmath
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import pgm
from pgm.comparison import drawn_runs
from pgm.errors import LinearisationError, ModelError
from pgm.kernels import philox
from pgm.kernels.arrays import address
from pgm.networks.counted import CountedDraws

pytest.importorskip("llvmlite")

from pgm.kernels.machine.emitter.kinds import ADDRESS
from pgm.kernels.machine.emitter.memory import Memory
from pgm.kernels.machine.emitter.module import Module
from pgm.kernels.machine.studies import draws
from pgm.kernels.machine.studies.normals import quantile
from pgm.networks import compiled_draws

ROWS = np.array([5, 0, 7, 2**40])


@pytest.mark.parametrize("count", [1, 3, 4, 5, 9])
@pytest.mark.parametrize("runs", [8, 13])
def test_uniform_numbers_are_numpys_bit_for_bit(count, runs):
    source, first, blocks = philox.Philox(2**70 + 1), 10**12, -(-count // 4)
    found = draws.numbers(source, first, runs, ROWS, 2, 1, count, normal=False)
    for k, row in enumerate(ROWS.tolist()):
        for run in range(runs):
            counter = np.array([(first + run) * blocks, row, 2, 1], dtype=np.uint64)
            words = np.random.Philox(key=source.key, counter=counter).random_raw(count)
            assert_array_equal(found[k, run], philox.uniforms(words))


def test_streams_give_the_same_request_by_request():
    plain, fast = (CountedDraws(7, 40, 11, compiled=c).at(3, ROWS) for c in (False, True))
    for size in ((4, 11, 2), (4, 11), (4, 11, 5)):
        assert_array_equal(fast.random(size), plain.random(size))
        assert_allclose(fast.standard_normal(size), plain.standard_normal(size), rtol=2e-15)
    assert_array_equal(fast.chisquare(3.0, (4, 11)), plain.chisquare(3.0, (4, 11)))
    for stream in (plain, fast):
        with pytest.raises(ModelError, match="draws one number, or one vector"):
            stream.standard_normal((11, 4))
    few = CountedDraws(7, 40, 5, compiled=True)
    assert_array_equal(
        few.at(0, 2).standard_normal((5, 2)),
        CountedDraws(7, 40, 5).at(0, 2).standard_normal((5, 2)),
    )


def test_quantiles_are_exact_to_rounding_far_into_the_tails():
    code = Module().function("quantiles", (ADDRESS, ADDRESS), lanes=8)
    given, out = code.arguments
    Memory(code, out).store(0, quantile(code, Memory(code, given).load(0)))
    function = code.module.compile().callable("quantiles")
    tails = [2.0**-53, 1e-12, 1.3e-11, 1.5e-11, 1e-5, 0.0749999, 0.0750001, 0.3]
    for uniform in (np.array(tails), np.array(tails)[::-1].copy(), 1.0 - np.array(tails)):
        found = np.empty(8)
        function(address(uniform), address(found))
        with mpmath.workdps(40):
            due = [mpmath.sqrt(2) * mpmath.erfinv(2 * mpmath.mpf(u) - 1) for u in uniform.tolist()]
        assert_allclose(found, [float(each) for each in due], rtol=2e-15)


x = pgm.Variable("x", components=("east", "heading"), angles=("heading",))
v = pgm.Variable("v")
w = pgm.Variable("w")
u = pgm.Variable("u")
m = pgm.Variable("m")
z = pgm.Variable("z", components=("range", "bearing"), angles=("bearing",))
y = pgm.Variable("y", components=("a", "b", "c"))
T = 12


def move(x, v, u):
    turned = x[..., 1] + u[..., 0]
    return np.stack([x[..., 0] + v[..., 0] * np.cos(turned), turned], axis=-1)


def sight(x, m):
    return np.stack([np.hypot(x[..., 0], m[..., 0]), np.arctan2(m[..., 0], x[..., 0])], axis=-1)


def model(noise=None, function=sight, moving=move):
    """A state by a function, a hidden control, a linear state, and three kinds of sensors."""
    return pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(x, [0.0, 3.0], [[0.1, 0.05], [0.05, 0.2]]), pgm.GaussianCPD(w, 1.0, 0.3)],
        [
            pgm.LinearGaussianCPD(v, {u: 2.0}, cov=0.1, offset=0.5),
            pgm.LinearGaussianCPD(w, {w.previous: 0.9, v: 0.1}, cov=0.2, noise=noise),
            pgm.NonlinearGaussianCPD(
                x, (x.previous, v, u), moving, cov=[[0.05, 0.02], [0.02, 0.03]]
            ),
        ],
        [
            pgm.NonlinearGaussianCPD(z, (x, m), function, cov=[0.1, 0.0], noise=None),
            pgm.LinearGaussianCPD(y, {w: [[1.0], [2.0], [0.0]], x: np.ones((3, 2))}, cov=np.eye(3)),
        ],
    )


INPUTS = {
    u: np.linspace(-0.3, 0.3, T)[:, None],
    z: pgm.sightings(step=[4, 1, 1, 12, 0], given={m: [[1.0], [2.0], [3.0], [4.0], [5.0]]}),
}


def samples(network, runs=29, inputs=INPUTS, first=0):
    """Draws with machine code, and without."""
    drawn = drawn_runs.drawn_runs(network, inputs, None, 100, 3)._replace(block=runs)
    return drawn._replace(compiled=True).sample(first), drawn.sample(first)


def assert_same(found, other, exactly=False):
    assert found.values.keys() == other.values.keys()
    for variable, values in found.values.items():
        assert values.shape == other[variable].shape
        if exactly:
            assert_array_equal(values, other[variable])
        else:
            assert_allclose(values, other[variable], rtol=1e-12, atol=1e-12)
    assert found.evidence.keys() == other.evidence.keys()
    assert_array_equal(found.evidence[z].values, found[z])


@pytest.fixture
def by_machine_code(monkeypatch):
    """How often machine code has drawn, and how often arrays have instead."""
    count = {"arrays": 0}

    def arrays(*given):
        count["arrays"] += 1
        return plain(*given)

    plain = compiled_draws.drawn_by_arrays
    monkeypatch.setattr(compiled_draws, "drawn_by_arrays", arrays)
    return count


@pytest.mark.parametrize("noise", [None, pgm.StudentT(4.0), pgm.Huber(1.2)], ids=str)
def test_paths_and_readings_are_those_of_arrays(noise, by_machine_code):
    assert_same(*samples(model(noise), first=29))
    assert by_machine_code["arrays"] == 0


def test_a_model_without_steps_ahead_is_drawn(by_machine_code):
    still = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(m, 1.0, 0.5)],
        [pgm.LinearGaussianCPD(m, {m.previous: 1.0}, cov=0.0)],
        [pgm.NonlinearGaussianCPD(z, (m,), lambda m: np.repeat(m**2, 2, axis=-1), cov=0.1)],
    )
    drawn = drawn_runs.drawn_runs(still, {z: pgm.sightings(step=[0, 0])}, 0, 9, 1)
    assert_same(drawn._replace(compiled=True).sample(0), drawn.sample(0))
    assert by_machine_code["arrays"] == 0


def untraced(x, m):
    return np.array([sight(np.asarray(a, dtype=float), b) for a, b in zip(x, m, strict=True)])


def decides(x, m):
    """A function that decides by numbers which no trace can follow."""
    near = bool((np.asarray(x, dtype=float)[..., 0] > 2.0).any())
    return sight(x, m) * (2.0 if near else 1.0)


@pytest.mark.parametrize("function", [untraced, decides])
def test_functions_without_a_right_trace_are_called(function, by_machine_code):
    assert_same(*samples(model(function=function)))
    assert by_machine_code["arrays"] == 1


def test_few_runs_and_a_noise_of_inputs_are_drawn_by_arrays(by_machine_code):
    assert_same(*samples(model(), runs=5), exactly=True)
    assert by_machine_code["arrays"] == 0  # since nobody asks for machine code
    noise = pgm.noise(lambda u: 1.0 + u**2, given=(u,), diagonal=True)
    first = pgm.LinearGaussianCPD(v, {u: 2.0}, cov=noise)
    noisy = model().replace(transition=[first, *model().transition[1:]])
    assert_same(*samples(noisy))
    assert by_machine_code["arrays"] == 1


def test_draws_that_are_not_finite_are_refused_as_without_machine_code():
    def leaves(x, v, u):
        return move(x, v, u) + np.log(x[..., :1] + 1.0)

    texts = []
    for compiled in (True, False):
        drawn = drawn_runs.drawn_runs(model(moving=leaves), INPUTS, None, 64, 3)
        with pytest.raises(LinearisationError) as found:
            drawn._replace(compiled=compiled).sample(0)
        texts.append(str(found.value))
    assert texts[0] == texts[1]
