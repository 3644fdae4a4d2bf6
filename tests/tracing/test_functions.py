"""Functions as users write them: each printer computes what they do, or they have no trace."""

import math
import pickle

import numpy as np
import pytest
from scipy import special

from pgm.tracing import Program, Tracer, trace

F = np.array([[1.0, 2.0, 0.0], [0.5, -1.0, 3.0]])
LIMITS = {"low": -0.5}


def writes(x):
    out = np.zeros((*x.shape[:-1], 2))
    out[..., 0] = np.sin(x[..., 0])
    out[..., 1] = x[..., 1]
    out[..., 1] += x[..., 2]  # with a traced number it is followed
    return out


def floats(x):
    out = np.zeros_like(x, dtype=float)
    out[..., 1] = x[..., 0]
    return (out + np.full_like(x, 3.0, dtype=float))[..., :2] * x[..., 1:]


def masks(x):
    y = x[..., :2].copy()
    y[y < 0.0] = 0.0
    return y


def moved(x):
    a, b, c = np.moveaxis(x, -1, 0)
    return np.moveaxis(np.array([a * b, c]), 0, -1)


def fills(x):
    out = np.full_like(x[..., :2], 2.0)
    np.multiply(x[..., 0], out[..., 0], out=out[..., 0])
    np.divide(1.0, x[..., 1], out=out[..., 1], where=x[..., 1] > 0.0)
    return out


def pairs(*values):
    return np.stack(np.broadcast_arrays(*values), axis=-1)


IDIOMS = {
    "operators": lambda x: pairs(x[..., 0] ** 2 - 3 / x[..., 1], -x[..., 1] % 2.0 + abs(x[..., 2])),
    "reflected": lambda x: pairs(2.0 ** x[..., 0], 7.0 // x[..., 1] + 5.0 % x[..., 2]),
    "powers": lambda x: pairs(np.abs(x[..., 0]) ** 0.5 + x[..., 1] ** 3, x[..., 2] ** -1),
    "slices": lambda x: x[..., :2] * x[..., 1:] + x[..., [2, 0]],
    "axes": lambda x: (F @ x[..., None])[..., 0] + np.squeeze(x[..., None, :2], -2),
    "einsum": lambda x: np.einsum("ij,...j->...i", F, x) + np.expand_dims(x[..., 0], -1),
    "matmul": lambda x: x @ F.T + np.dot(x, F.T) + np.matmul(F, x[..., None])[..., 0],
    "norms": lambda x: pairs(np.linalg.norm(x, axis=-1), np.linalg.norm(x[..., :2], 1, axis=-1)),
    "reductions": lambda x: pairs(
        x.sum(axis=-1) + np.prod(x, axis=-1),
        np.mean(x, -1) + x.max(axis=-1) - np.min(x, axis=-1) + np.amax(x, -1),
    ),
    "spread": lambda x: pairs(np.std(x, axis=-1), np.cumsum(x, axis=-1)[..., 1]),
    "vectors": lambda x: np.cross(x, [1.0, 2.0, 3.0])[..., :2] + x[..., :1] * F[:, 0],
    "clipped": lambda x: pairs(np.clip(x[..., 0], -0.5, 0.5), x[..., 1].clip(LIMITS["low"], None)),
    "chosen": lambda x: np.where(x[..., :1] > x[..., 1:2], x[..., :2], np.exp(x[..., 1:])),
    "selected": lambda x: pairs(
        np.select([x[..., 0] > 0.5, x[..., 0] < -0.5], [x[..., 1], 2.0], x[..., 2]),
        np.nan_to_num(x[..., 0]),
    ),
    "truths": lambda x: pairs(
        ((x[..., 0] > 0) & ~(x[..., 1] > 0)) * x[..., 2],
        (x > 0).sum(axis=-1) + 1.0 * np.logical_or(x[..., 0], 0.0) + np.any(x > 1.0, axis=-1),
    ),
    "angles": lambda x: pairs(
        (x[..., 0] + np.pi) % (2 * np.pi) - np.pi, np.rad2deg(np.arctan2(x[..., 1], x[..., 2]))
    ),
    "sinc": lambda x: pairs(np.sinc(x[..., 0]), np.hypot(x[..., 0], x[..., 1])),
    "joined": lambda x: np.concatenate([x[..., 1:2], x[..., :1]], axis=-1).astype(float),
    "asarray": lambda x: np.sin(np.asarray(x))[..., :2] * np.asarray(x)[..., 1:],
    "constant": lambda x: np.broadcast_to(np.array([1.0, np.inf]), (*x.shape[:-1], 2)),
    "like": lambda x: np.zeros_like(x)[..., :2] + np.ones_like(x[..., :2]) * x[..., 1:],
    "rounded": lambda x: np.floor(np.asarray(x))[..., :2] + np.rint(np.asarray(x))[..., 1:],
    "floats": floats,
    "turned": lambda x: np.flip(x, -1)[..., :2] + np.roll(x, 1, axis=-1)[..., 1:] + x.T.T[..., :2],
    "interior": lambda x: pairs(np.inner(x, F[0]), np.tensordot(x, F[1], axes=([-1], [0]))),
    "parts": lambda x: np.array_split(x, [2], axis=-1)[0] + np.atleast_1d(x)[..., :2].real,
    "outer": lambda x: np.add.outer(np.zeros(2), x[..., 0]).T if x.ndim == 1 else x[..., [0, 0]],
    "writes": writes,
    "masks": masks,
    "moved": moved,
    "fills": fills,
}
SPECIAL = np.array([0.0, -0.0, 1.0, -1.0, 0.5, 2.5, -1.5, 1e300, np.inf, -np.inf, np.nan])


def everything(x):
    """Each operation there is, of any numbers."""
    a, b = x[..., 0], x[..., 1]
    one = (np.sin, np.cos, np.tan, np.arcsin, np.arccos, np.arctan, np.sinh, np.cosh, np.tanh)
    one += (np.arcsinh, np.arccosh, np.arctanh, np.exp, np.exp2, np.expm1, np.log, np.log2)
    one += (np.log10, np.log1p, np.sqrt, np.cbrt, np.floor, np.ceil, np.trunc, np.rint, np.abs)
    one += (np.sign, np.square, np.reciprocal, np.isnan, np.isfinite, np.isinf, np.radians)
    two = (np.arctan2, np.hypot, np.fmod, np.copysign, np.remainder, np.floor_divide, np.minimum)
    two += (np.maximum, np.fmin, np.fmax, np.heaviside, np.less, np.equal, np.logical_xor)
    values = [f(a) * 1.0 for f in one] + [f(a, b) * 1.0 for f in two]
    values += [np.power(np.abs(a), b), np.where((a > b) | ~(a <= 1.0), a, b)]
    return np.stack(values, axis=-1)


def traced(function, widths, height):
    found = trace(function, widths, (height,))
    assert isinstance(found, Program), found
    return found


@pytest.mark.parametrize("name", IDIOMS)
def test_an_idiom_is_traced(name):
    x = np.random.default_rng(2).normal(size=(2, 3, 3)) * 1.3
    with np.errstate(all="ignore"):
        due = IDIOMS[name](x)
    program = traced(IDIOMS[name], (3,), 2)
    value, slope = program.batch([x], (2, 3))
    assert slope.shape == (2, 0, 2, 3)
    if name == "outer":  # it is another function of one run
        due = np.stack([x[..., 0]] * 2, axis=-1)
    np.testing.assert_allclose(np.moveaxis(value, 0, -1), due, rtol=1e-14, atol=1e-15)


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_each_printer_computes_what_the_function_does():
    """In every corner of float64: infinities, NaN, zeros of both signs."""
    pairs_ = np.stack(np.meshgrid(SPECIAL, SPECIAL), axis=-1).reshape(-1, 2)
    points = np.concatenate([pairs_, np.random.default_rng(1).normal(size=(20, 2))])
    due = everything(points)
    columns = ((0, 0), (0, 1))
    program = traced(everything, (2,), due.shape[-1]).by(columns)
    again = pickle.loads(pickle.dumps(program))
    value, slope = again.batch([points], (len(points),))
    np.testing.assert_allclose(value.T, due, rtol=1e-14)
    for k, point in enumerate(points):
        one, by, finite = program.single([point])
        np.testing.assert_allclose(one, due[k], rtol=1e-13)
        np.testing.assert_allclose(by, slope[..., k], rtol=1e-12, atol=1e-14)
        assert finite == bool(np.isfinite(one).all() and np.isfinite(by).all())


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_machine_code_computes_what_the_function_does():
    pytest.importorskip("llvmlite", reason="machine code is written by LLVM")
    from pgm.kernels.machine.emitter.kinds import ADDRESS
    from pgm.kernels.machine.emitter.module import Module
    from pgm.kernels.machine.emitter.traces import written

    pairs_ = np.stack(np.meshgrid(SPECIAL, SPECIAL), axis=-1).reshape(-1, 2)
    points = np.concatenate([pairs_, np.random.default_rng(1).normal(size=(20, 2))])
    due = everything(points)
    program = traced(everything, (2,), due.shape[-1]).by(((0, 0), (0, 1)))
    slope = program.batch([points], (len(points),))[1]
    outputs = [*program.value, *(k for k in program.slope if k is not None)]
    module = Module()
    code = module.function("everything", (ADDRESS, ADDRESS))
    x, out = (code.memory(each) for each in code.arguments)
    for k, number in enumerate(written(code, program.graph, outputs, lambda _, i: x.load(i))):
        out.store(k, number)
    function, found = module.compile().callable("everything"), np.zeros(len(outputs))
    height = len(program.value)
    for k, point in enumerate(points):
        function(point.ctypes.data, found.ctypes.data)
        tame = np.isfinite(point).all()  # the power of infinity to .5 is C's own
        last = None if tame else -2
        np.testing.assert_allclose(found[:height][:last], due[k][:last], rtol=1e-13)
        if tame:
            by = np.zeros(len(program.slope))
            by[[j for j, each in enumerate(program.slope) if each is not None]] = found[height:]
            np.testing.assert_allclose(by.reshape(-1, 2), slope[..., k], rtol=1e-12, atol=1e-14)


def branches(x):
    if x[..., 0] > 0:
        return x[..., :2]
    return -x[..., :2]


def reads_back(x):
    out = np.zeros((*x.shape[:-1], 2))
    out[..., 0] = x[..., 0]
    return out * 2.0


def written(x):
    out = np.zeros((*x.shape[:-1], 2))
    out[..., 0], out[..., 1] = x[..., 0], x[..., 1]
    return out


def compares_back(x):
    return np.where(written(x) > 0.0, written(x), 0.0)


def limits_back(x):
    out = written(x)
    return np.where(out > 5.0, 5.0, out)


def orders_back(x):
    return np.sort(written(x), axis=-1)


def cleans_back(x):
    return np.nan_to_num(written(x))


def catches(x):
    try:
        return x[..., :2] if x[..., 0] > 0 else x[..., 1:]
    except Exception:
        return x[..., :2]


def raises_errors(x):
    with np.errstate(divide="raise"):
        return 1.0 / x[..., :2]


def grows(x):
    for _ in range(3000):
        x = np.sin(x)
    return x[..., :2]


held = []


def holds(x):
    held.append(x)
    return held[0][..., :2] + x[..., :2]


REASONS = {
    "branches on a value": branches,
    r"in branches: if x\[\.\.\., 0\] > 0:": branches,
    "with float()": lambda x: np.stack([math.sin(x[..., 0]), x[..., 1]], -1),
    "arrays of floats": reads_back,
    "float(), math": compares_back,
    "float(), math, or arrays": cleans_back,
    "math, or arrays": limits_back,
    "or arrays of floats that": orders_back,
    "branches": catches,
    "looks a value up": lambda x: np.stack([[1.0, 2.0][x[..., 0].item()], x[..., 1]], -1),
    "makes an integer": lambda x: x[..., :2] * int(x[..., 0]),
    "makes int64 of values": lambda x: x[..., :2] * np.arange(9.0)[x[..., 0].astype(int)],
    "np.erf is not traced": lambda x: special.erf(x[..., :2]),
    "Cannot cast": lambda x: np.stack([np.interp(x[..., 0], [0, 1], [0, 3]), x[..., 1]], -1),
    "raise errors": raises_errors,
    "more than 2000 operations": grows,
    "looks for places": lambda x: x[..., :2] * len(np.where(x > 0)),
    "complex": lambda x: np.abs(x[..., :2] * 1j),
    "never written": lambda x: np.empty_like(x[..., :2]),
    "it fails on traced numbers: ValueError: assignment destination is read-only": lambda x: x.fill(
        0
    ),
    r"returns shape \(3,\)": lambda x: x,
    "without out=": lambda x: np.sin(x[..., :2], where=x[..., :2] > 0),
    "subtract of truth values": lambda x: (x > 0)[..., :2] - (x > 1)[..., :2],
    "computes with str": lambda x: np.array(["a", "b"]),
}


@pytest.mark.parametrize("reason", REASONS)
def test_the_reason_for_no_trace(reason):
    found = trace(REASONS[reason], (3,), (2,))
    assert isinstance(found, str)
    assert reason.replace("\\", "") in found


def test_numbers_of_an_earlier_call_are_refused():
    held.clear()
    assert isinstance(trace(holds, (3,), (2,)), Program)
    assert "earlier call" in trace(holds, (3,), (2,))


def counter():
    calls = []

    def function(x):
        calls.append(1)
        return x[..., :2] * len(calls)

    return function


DRAWS = np.random.default_rng(0)


@pytest.mark.parametrize(
    "function",
    [
        counter(),
        lambda x: x[..., :2] + DRAWS.normal(),
        lambda x: x[..., :2] if x.ndim == 1 else 2.0 * x[..., :2],
        lambda x: np.moveaxis(np.nan_to_num(np.array([x[..., 0], x[..., 1]])), 0, -1),
        lambda x: x[..., :2] * (1.0 if type(x) is np.ndarray else 1.0 + 1e-11),
    ],
    ids=["memory", "random", "of one run", "of NaN", "just not the same"],
)
def test_a_trace_that_is_not_the_function_is_not_used(function):
    tracer = Tracer(function, (3,), np.zeros(2, dtype=bool))
    assert not tracer.confirm([np.zeros(3)])
    assert "are not those of its trace" in tracer.reason
    assert tracer.trace is None


def test_a_function_whose_closure_changes_is_traced_again():
    step = 0.5
    tracer = Tracer(lambda x: step * x[..., :2], (3,), np.zeros(2, dtype=bool))
    for step in (0.5, 2.0):
        assert tracer.confirm([np.ones(3)], anew=True)
        assert tracer.trace.single([np.ones(3)])[0].tolist() == [step, step]


def test_a_trace_that_a_call_doubts_is_made_anew_once_and_then_given_up_for_a_while():
    tracer, at = Tracer(lambda x: x[..., :2], (3,), np.zeros(2, dtype=bool)), [np.ones(3)]
    assert tracer.confirm(at)
    first = tracer.trace
    tracer.prove(first)
    tracer.doubt(first, "moved", moved=True)
    assert tracer.trace is tracer.reason is None
    assert tracer.confirm(at)
    tracer.doubt(first, "of another call", moved=True)  # has no say about the new one
    tracer.doubt(tracer.trace, "moved again", moved=True)
    assert (tracer.reason, tracer.traced()) == ("moved again", "moved again")
    assert [tracer.confirm(at) for _ in range(3)] == [False, True, True]
    tracer.doubt(tracer.trace, "again", moved=True)
    assert [tracer.confirm(at) for _ in range(5)] == [False, False, False, True, True]
    tracer.prove(tracer.trace)
    assert tracer.reason is None
    tracer.doubt(tracer.trace, "cancels", moved=False)  # the same function has the same trace
    assert tracer.reason == "cancels"
    tracer.renew()
    assert tracer.confirm(at)


def test_a_turn_more_is_the_same_angle():
    """At the branch the last digit decides on which side of it an angle is."""

    def wrapped(x):
        turned = x[..., :1] + (2 * np.pi if type(x) is np.ndarray else 0.0)
        return np.concatenate([turned, x[..., 1:2]], axis=-1)

    assert Tracer(wrapped, (3,), np.array([True, False])).confirm([np.zeros(3)])
    assert not Tracer(wrapped, (3,), np.array([False, False])).confirm([np.zeros(3)])
