"""Matrices in the memory of machine code, and sweeps over them, against NumPy.

The steps over them are in `test_step.py`, as those over all kinds.
"""

import numpy as np
import pytest
from crossed import slow_after
from machine_code import over_matrices
from numpy.testing import assert_allclose

import pgm
from pgm.kernels import step
from pgm.kernels.machine.matrices.loops import Loops
from pgm.kernels.machine.sweeps import chain as sweeps

SIZES = slow_after(
    6,
    [(1, 1), (3, 2), (5, 3), (7, 9), (13, 5), (60, 33), (2, 1), (4, 4), (8, 8), (24, 12)],
)
LANES = (1, 8)


def assert_computed(make, due, *arrays, lanes):
    """What `make` gives of matrices in memory is due, (lanes, m, n) each."""
    shapes = [each.shape[1:] for each in arrays]
    found = over_matrices(make, shapes, matrices=Loops, lanes=lanes)(*arrays)
    for place, (one, other) in enumerate(zip(found, due, strict=True)):
        assert one.shape == other.shape
        size = np.abs(other).max(initial=1e-300)
        assert_allclose(one / size, other / size, atol=1e-12, err_msg=f"result {place}")


def drawn(n, d, lanes):
    """A square matrix, a wide one, a covariance and a vector, for each run."""
    rng = np.random.default_rng(100 * n + d)
    a, b, v = (rng.normal(size=(lanes, *shape)) for shape in ((n, n), (d, n), (n, 1)))
    return a, b, a @ turned(a) + np.eye(n), v


def turned(arrays):
    return np.swapaxes(arrays, 1, 2)


def single(numbers):
    return np.asarray(numbers, float)[:, None, None]


@pytest.mark.parametrize("lanes", LANES)
@pytest.mark.parametrize(("n", "d"), SIZES)
def test_operations(n, d, lanes):
    a, b, s, v = drawn(n, d, lanes)
    even, late = range(0, n, 2), range(n // 2, n)

    def make(_, a, b, s, v):
        return [
            *(a @ a, b @ a, a.T @ b.T, b @ v, v.T @ a, a + s, a.T - s, s - a.T),
            *((a @ s).times(a), (a.T @ s).times(a.T), a.one_minus(), a.T.scaled(v[0, 0])),
            *(a.part(even, late), v.part(even, (0,)), s.bordered(b, (b @ s).times(b))),
            *((v.T @ v)[0, 0], sum(s.diagonal[1:], s.diagonal[0])),
        ]

    due = [
        *(a @ a, b @ a, turned(a) @ turned(b), b @ v, turned(v) @ a, a + s, turned(a) - s),
        *(s - turned(a), a @ s @ turned(a), turned(a) @ s @ a, np.eye(n) - a),
        *(turned(a) * v[:, :1], a[:, ::2, n // 2 :], v[:, ::2]),
        np.block([[s, turned(b)], [b, b @ s @ turned(b)]]),
        *(turned(v) @ v, single(np.trace(s, axis1=1, axis2=2))),
    ]
    assert_computed(make, due, a, b, s, v, lanes=lanes)


@pytest.mark.parametrize("lanes", LANES)
@pytest.mark.parametrize(("n", "d"), SIZES)
def test_roots(n, d, lanes):
    _, b, s, _ = drawn(n, d, lanes)
    lower = np.linalg.cholesky(s)
    pivots = np.einsum("kii->ki", lower)
    share = (pivots**2 / np.einsum("kii->ki", s)).min(axis=1)

    def make(loops, b, s):
        root = s.root()
        white = root.solve(b.T)
        solved = root.solve_transposed(b.T)
        told = [root.share, root.volume, open_share(loops, s), step.inflation(s, root)]
        return [white, solved, root.matrix, *told]

    due = [np.linalg.solve(lower, turned(b)), np.linalg.solve(turned(lower), turned(b)), lower]
    due += [single(share), single(np.log(pivots).sum(axis=1)), single(share)]
    due.append(single(np.einsum("kii,kii->k", s, np.linalg.inv(s))))
    assert_computed(make, due, b, s, lanes=lanes)


def open_share(loops, cov):
    """The least share of a variance that is left open, of components with a variance."""
    varies = [variance != 0.0 for variance in loops.diagonal(cov)]
    return step.open_share(cov, loops.truths(varies, cov.shape[0]))


@pytest.mark.parametrize("lanes", LANES)
@pytest.mark.parametrize(("n", "d"), [(3, 2), (7, 9), (13, 5)])
def test_operations_beside_those_of_matrices(n, d, lanes):
    a, b, s, v = drawn(n, d, lanes)
    places = [*range(n // 2), *range(n // 2 + 2, n + 2)]
    wide = np.zeros((lanes, d, n + 2))
    wide[:, :, places] = b
    known = v > 0.0
    seen = np.where(known & turned(known), s, np.where(np.eye(n) > 0.0, 1.0, 0.0))

    def make(loops, a, b, s, v):
        truths = loops.truths([x > 0.0 for x in loops.beside(v)], n)
        rows = step.seen(truths, v, a, s)
        return [
            *(loops.widened(b, places, n + 2), loops.above(v, b.T.part(range(n), (0,)))),
            *(loops.shifted(a, v), loops.replaced(v, {0: 7.0}), step.known_part(s, truths)),
            *(loops.chosen(v[0, 0] > 0.0, a, s), rows.residual, rows.matrix, rows.noise),
        ]

    replaced = v.copy()
    replaced[:, 0] = 7.0
    due = [wide, np.concatenate([v, turned(b)[:, :, :1]], axis=1), a + turned(v), replaced]
    due += [np.where(known & turned(known), s, 0.0), np.where(v[:, :1] > 0.0, a, s)]
    due += [np.where(known, v, 0.0), np.where(known, a, 0.0), seen]
    assert_computed(make, due, a, b, s, v, lanes=lanes)


def named(name, size):
    return pgm.Variable(name, tuple(f"{name}{k}" for k in range(size)))


def linear(n, d, runs):
    rng = np.random.default_rng(n)
    x, z = named("x", n), named("z", d)
    move = 0.9 * np.linalg.qr(rng.normal(size=(n, n)))[0]
    see = rng.normal(size=(d, n)) / np.sqrt(n)
    model = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(x, np.zeros(n), np.eye(n))],
        [pgm.LinearGaussianCPD(x, {x.previous: move}, cov=0.1 * np.eye(n))],
        [pgm.LinearGaussianCPD(z, {x: see}, cov=0.5 * np.eye(d))],
    )
    return model, x, {z: rng.normal(size=(*runs, 12, d))}


def curved(n, d, runs):
    """Pendulums that push each other, of which two sensors see a part, with gaps."""
    rng = np.random.default_rng(n)
    x, y, z = named("x", n), named("y", 2), named("z", d)

    def moved(state):
        ahead = np.concatenate([state[..., 1:], state[..., :1]], axis=-1)
        return 0.8 * state + 0.2 * np.sin(ahead)

    def ranged(state):
        return np.hypot(state[..., :2], 1.0 + 0.1 * state[..., 2:4])

    model = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(x, rng.normal(size=n), np.eye(n))],
        [pgm.NonlinearGaussianCPD(x, x.previous, moved, cov=0.1 * np.eye(n))],
        [
            pgm.NonlinearGaussianCPD(y, x, ranged, cov=0.2 * np.eye(2)),
            pgm.LinearGaussianCPD(z, {x: rng.normal(size=(d, n))}, cov=0.5 * np.eye(d)),
        ],
    )
    readings = 1.0 + rng.normal(size=(*runs, 12, 2)), rng.normal(size=(*runs, 12, d))
    for values in readings:
        values[rng.random(values.shape) < 0.2] = np.nan
    return model, x, dict(zip((y, z), readings, strict=True))


RULES = {"taylor": pgm.Taylor(), "unscented": pgm.Unscented(), "cubature": pgm.Cubature()}


def sweeps_of(kind, rule, sizes):
    """Cases of that many components, the first of them quick."""
    slow = [pytest.param(kind, rule, size, marks=pytest.mark.slow) for size in sizes[1:]]
    return [(kind, rule, sizes[0]), *slow]


@pytest.mark.parametrize("runs", [(), (11,)], ids=["one", "packs"])
@pytest.mark.parametrize(
    ("kind", "rule", "n"),
    [
        *sweeps_of(linear, "taylor", [24, 6, 12, 50]),
        *sweeps_of(curved, "taylor", [12, 6, 24, 50]),
        # of more components they have more points than are compiled
        *sweeps_of(curved, "unscented", [6, 12, 24]),
        *sweeps_of(curved, "cubature", [6, 12, 24]),
    ],
)
def test_sweeps_are_those_of_numpy(monkeypatch, kind, rule, n, runs):
    monkeypatch.setattr(sweeps, "is_long", lambda chain, lanes: True)
    sweeps.made.cache_clear()
    model, x, evidence = kind(n, n // 3, runs)
    found, due = (
        pgm.smooth(model, evidence, lineariser=RULES[rule], compiled=choice)
        for choice in (True, False)
    )
    off = np.abs(found[x].mean - due[x].mean) / due[x].std
    assert off.max() < 1e-10
    assert_allclose(found[x].cov, due[x].cov, atol=1e-10 * np.abs(due[x].cov).max())
    assert "compiled" in str(found.status.compilation)
    sweeps.made.cache_clear()


@pytest.mark.parametrize("runs", [(), (11,)], ids=["one", "packs"])
@pytest.mark.parametrize("rule", RULES)
def test_a_single_component(monkeypatch, rule, runs):
    """Matrices of one row are columns too."""
    monkeypatch.setattr(sweeps, "is_long", lambda chain, lanes: True)
    sweeps.made.cache_clear()
    x, z = named("x", 1), named("z", 1)
    model = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(x, 0.3, 1.0)],
        [pgm.NonlinearGaussianCPD(x, x.previous, np.sin, cov=0.1)],
        [pgm.NonlinearGaussianCPD(z, x, np.cos, cov=0.2)],
    )
    evidence = {z: np.random.default_rng(1).normal(size=(*runs, 12, 1))}
    found, due = (
        pgm.smooth(model, evidence, lineariser=RULES[rule], compiled=choice)[x]
        for choice in (True, False)
    )
    sweeps.made.cache_clear()
    assert_allclose(found.mean, due.mean, atol=1e-11)
    assert_allclose(found.cov, due.cov, atol=1e-11)


@pytest.mark.parametrize("lanes", LANES)
def test_both_kinds_agree(monkeypatch, lanes):
    """In straight lines and in loops, of a model that either may have."""
    model, x, evidence = curved(5, 2, (8,) if lanes > 1 else ())
    found = []
    for looped in (True, False):
        monkeypatch.setattr(sweeps, "is_long", lambda *_, looped=looped: looped)
        sweeps.made.cache_clear()
        found.append(pgm.smooth(model, evidence, compiled=True, iterations=3, tolerance=0.0)[x])
    sweeps.made.cache_clear()
    assert_allclose(found[0].mean, found[1].mean, atol=1e-11)
    assert_allclose(found[0].cov, found[1].cov, atol=1e-11)
