"""Markov networks of continuous variables: drawn ones against dense linear algebra; refusals."""

import networkx as nx
import numpy as np
import pytest
from crossed import slow_after
from numpy.testing import assert_allclose

import pgm

A, B, C, D = pgm.variables("a b c d")


def width(scope):
    return sum(v.dimension for v in scope)


class Line:
    """A linear function of several variables, M x + b, of which nobody knows that it is linear."""

    def __init__(self, matrix, offset):
        self.matrix, self.offset = matrix, offset

    def __call__(self, *parts):
        return np.concatenate(parts, axis=-1) @ self.matrix.T + self.offset


def drawn(rng):
    """A network of vectors: forms with flat directions, residuals, CPDs, on cycles too.

    Beside it, its rows: by factor the scope, and (K, h, g) there.
    """
    count = int(rng.integers(1, 6))
    sizes = rng.integers(1, 4, size=count).tolist()
    every = [pgm.Variable(f"x{k}", tuple("abc"[:d]) if d > 1 else ()) for k, d in enumerate(sizes)]
    factors, dense = [], []

    def residual(scope, matrix, offset, cov):
        weight = np.linalg.inv(cov)
        level = -0.5 * (offset @ weight @ offset + np.linalg.slogdet(2.0 * np.pi * cov)[1])
        dense.append((scope, matrix.T @ weight @ matrix, -matrix.T @ weight @ offset, level))

    for _ in range(int(rng.integers(1, 7))):
        most = int(rng.integers(1, min(3, count) + 1))
        scope = [every[k] for k in rng.permutation(count)[:most]]
        child, *parents = scope
        size, own = width(scope), child.dimension
        match int(rng.integers(4)):
            case 0:
                root = rng.normal(size=(int(rng.integers(0, size + 1)), size))
                slope, level = root.T @ rng.normal(size=len(root)), rng.normal()
                factors.append(pgm.CanonicalForm(scope, root.T @ root, slope, level))
                dense.append((scope, root.T @ root, slope, level))
            case 1:
                rows = int(rng.integers(1, 4))
                matrix, offset = rng.normal(size=(rows, size)), rng.normal(size=rows)
                root = rng.normal(size=(rows, rows))
                cov = root @ root.T + 0.1 * np.eye(rows)
                factors.append(pgm.NonlinearGaussianFactor(scope, Line(matrix, offset), cov))
                residual(scope, matrix, offset, cov)
            case what:
                matrices = {p: rng.normal(size=(own, p.dimension)) for p in parents}
                offset, cov = rng.normal(size=own), rng.uniform(0.1, 2.0) * np.eye(own)
                if not parents:
                    factors.append(pgm.GaussianCPD(child, offset, cov))
                elif what == 2:
                    factors.append(pgm.LinearGaussianCPD(child, matrices, offset=offset, cov=cov))
                else:
                    line = Line(np.hstack(list(matrices.values())), offset)
                    factors.append(pgm.NonlinearGaussianCPD(child, parents, line, cov=cov))
                matrix = np.hstack([np.eye(own), *(-m for m in matrices.values())])
                residual(scope, matrix, -offset, cov)
    for v in every:
        if rng.random() < 0.8:
            form = rng.uniform(0.1, 2.0) * np.eye(v.dimension), rng.normal(size=v.dimension), 0.3
            factors.append(pgm.CanonicalForm(v, *form))
            dense.append(([v], *form))
    if rng.random() < 0.3:  # a number
        level = rng.normal()
        nothing = pgm.CanonicalForm((), np.zeros((0, 0)), np.zeros(0), level)
        factors.append(nothing if rng.random() < 0.5 else pgm.Table((), 1.0, level))
        dense.append(([], np.zeros((0, 0)), np.zeros(0), level))
    return pgm.MarkovNetwork(factors), dense


def solved(network, dense, evidence):
    """Hidden variables, their mean and covariance, ln Z, and how far apart eigenvalues are.

    The first three are None where there is no proper belief, or none for certain.
    """
    ends = np.cumsum([0, *(v.dimension for v in network.variables)])
    places = {v: np.arange(ends[k], ends[k + 1]) for k, v in enumerate(network.variables)}
    K, h, g = np.zeros((ends[-1], ends[-1])), np.zeros(ends[-1]), 0.0
    for scope, matrix, slope, level in dense:
        at = np.concatenate([np.zeros(0, int), *(places[v] for v in scope)])
        K[np.ix_(at, at)] += matrix
        h[at] += slope
        g += level
    hidden = [v for v in network.variables if v not in evidence]
    if evidence:
        seen = np.concatenate([places[v] for v in evidence])
        value = np.concatenate([*evidence.values()])
        g += h[seen] @ value - 0.5 * value @ K[np.ix_(seen, seen)] @ value
        h = h - K[:, seen] @ value
    at = np.concatenate([np.zeros(0, int), *(places[v] for v in hidden)])
    K, h = K[np.ix_(at, at)], h[at]
    values = np.linalg.eigvalsh(K)
    least = values.min(initial=np.inf) / max(values.max(initial=0.0), 1.0)
    if least < 1e-6:  # improper but for rounding, or hard to tell from it
        return hidden, None, None, least
    cov = np.linalg.inv(K)
    total = g + 0.5 * h @ cov @ h + 0.5 * np.linalg.slogdet(2.0 * np.pi * cov)[1]
    return hidden, (cov @ h, cov), total, least


@pytest.mark.parametrize("seed", slow_after(3, range(10)))
def test_drawn_networks_equal_dense_algebra(seed):
    """A hundred networks each: moments, ln Z, beliefs and messages with their constants."""
    rng = np.random.default_rng(seed)
    for _ in range(100):
        network, dense = drawn(rng)
        every = network.variables
        evidence = {v: rng.normal(size=v.dimension) for v in every if rng.random() < 0.2}
        hidden, moments, total, least = solved(network, dense, evidence)
        graph = pgm.compile(network)
        graph.check()
        if least < 1e-12:
            with pytest.raises(pgm.NumericalError, match="no proper belief"):
                _ = pgm.infer(graph, evidence).log_evidence
            continue
        if moments is None:
            continue
        (mean, cov), close = moments, 1e-10 if least > 1e-3 else 1e-7
        posterior = pgm.infer(graph, evidence)
        assert_allclose(posterior.log_evidence, total, rtol=close, atol=close)
        at, std = 0, np.sqrt(np.diag(cov))
        for v in hidden:
            own = slice(at, at + v.dimension)
            off = (posterior[v].mean - mean[own]) / std[own]
            assert_allclose(off, 0.0, atol=close * (1.0 + np.abs(mean[own] / std[own]).max()))
            ratio = (posterior[v].cov - cov[own, own]) / np.outer(std[own], std[own])
            assert_allclose(ratio, 0.0, atol=close)
            at += v.dimension
        whole = 0.0
        for part in nx.connected_components(graph.to_networkx()):
            beliefs = [posterior.belief(k) for k in part]
            each = [float(b.log_integral if b.scope else b.g) for b in beliefs]
            assert_allclose(each, each[0], atol=1e-7)
            whole += each[0]
        assert_allclose(whole, total, rtol=1e-9, atol=1e-7)
        for k in range(len(graph)):
            found = posterior.potential(k)
            level = float(found.g)
            for other in graph.neighbours(k):
                message = posterior.message(other, k)
                level += float(message.g)
                found = found * message if message.scope else found
            due = posterior.belief(k)
            assert_allclose(level, due.g, rtol=1e-8, atol=1e-6)
            if due.scope:
                assert_allclose(found.rearrange(due.scope).K, due.K, atol=1e-7)


def test_a_network_of_all_methods_and_runs():
    forms = [
        pgm.CanonicalForm(pair, [[1.0, -0.4], [-0.4, 1.0]], [k, 0.5])
        for k, pair in enumerate([(A, B), (B, C), (C, D), (D, A)])
    ]
    network = pgm.MarkovNetwork(forms)
    exact = pgm.infer(pgm.compile(network), {A: [[1.0], [2.0]]})
    assert exact.log_evidence.shape == (2,)
    for method in (pgm.Bethe(), pgm.LTRIP(), pgm.JoinGraph(3)):
        graph = pgm.compile(network, method=method)
        found = pgm.infer(graph, {A: [[1.0], [2.0]]}, schedule=pgm.Flooding(200))
        assert_allclose(found[C].mean, exact[C].mean, atol=1e-8)
    drawn_ = exact.sample(20_000, rng=0)
    assert_allclose(drawn_[B].mean(axis=0), exact[B].mean, atol=0.03)


def test_angles_of_residuals_are_wrapped_and_robust_ones_weighed():
    """A turn of nearly π between two headings, one of which is held; and a wrong one."""
    p, q = (pgm.Variable(name, ("heading",), angles=("heading",)) for name in "pq")

    def turned(p, q):
        return q - p - 3.1

    between = pgm.NonlinearGaussianFactor((p, q), turned, 0.01, angles=(True,))
    held = pgm.NonlinearGaussianFactor(p, lambda p: p - 0.2, 1e-6, angles=[True])
    network = pgm.MarkovNetwork([held, between])
    start = {p: [0.0], q: [-3.0]}
    found = pgm.infer(pgm.compile(network), {}, schedule=pgm.Calibration(20), start=start)
    assert_allclose(found[q].mean, [3.3 - 2.0 * np.pi], atol=1e-6)
    noise = pgm.Cauchy(2.385)
    wrong = pgm.NonlinearGaussianFactor(q, lambda q: q - 1.0, 0.01, noise=noise)
    robust = pgm.MarkovNetwork([held, between, wrong])
    found = pgm.infer(pgm.compile(robust), {}, schedule=pgm.Calibration(100), start=start)
    assert found.weights[wrong] < 0.05
    assert found.log_evidence_kind == "linearised bound"


def test_a_cycle_of_cpds_and_two_of_one_child():
    loop = [pgm.LinearGaussianCPD(x, {y: 0.5}, cov=1.0) for x, y in ((A, B), (B, A))]
    twice = pgm.GaussianCPD(A, 1.0, 0.5)
    network = pgm.MarkovNetwork([*loop, twice, twice])
    K = np.array([[1.25, -1.0], [-1.0, 1.25]]) + np.diag([4.0, 0.0])
    joint = pgm.infer(pgm.compile(network), {}).joint(A, B)
    assert_allclose(joint.cov, np.linalg.inv(K), rtol=1e-12)
    assert_allclose(joint.mean, np.linalg.solve(K, [4.0, 0.0]), rtol=1e-12)


def test_scales_and_certain_factors():
    """Units a hundred million apart, and a relation without noise."""
    exact = pgm.NonlinearGaussianFactor((A, B), lambda a, b: b - 2.0 * a, 0.0)
    large = pgm.GaussianCPD(A, 1e8, 1e14)
    network = pgm.MarkovNetwork([large, exact, pgm.GaussianCPD(B, 2.1e8, 1e14)])
    found = pgm.infer(pgm.compile(network), {})
    assert_allclose(found[B].mean, 2.0 * found[A].mean, rtol=1e-12)
    assert_allclose(found[A].mean, [(1.0 + 4.2) / 5.0 * 1e8], rtol=1e-12)


def test_pages_and_pictures(tmp_path):
    network = pgm.MarkovNetwork(
        [pgm.CanonicalForm((A, B), np.eye(2), [1.0, 0.0]), pgm.GaussianCPD(A, 0.0, 1.0)]
    )
    pgm.view(pgm.infer(pgm.compile(network), {}), path=tmp_path / "page.html")
    text = (tmp_path / "page.html").read_text()
    assert "CanonicalForm" in text
    assert "<svg" in network._repr_html_()


def test_what_is_refused():
    sloping = pgm.CanonicalForm(A, [[0.0]], [1.0])
    negative = pgm.CanonicalForm(A, [[-1.0]], [0.0])
    proper = pgm.GaussianCPD(A, 0.0, 0.1)
    for form, words in ((sloping, "has a slope, 1"), (negative, "is not positive semidefinite")):
        with pytest.raises(pgm.ModelError, match=words):
            pgm.infer(pgm.compile(pgm.MarkovNetwork([form, proper])), {})
    network = pgm.MarkovNetwork([proper])
    with pytest.raises(pgm.EvidenceError, match="which the network does not have"):
        pgm.infer(pgm.compile(network), {B: 1.0})
    with pytest.raises(pgm.ModelError, match="is a stack of factors"):
        pgm.MarkovNetwork([pgm.CanonicalForm(A, np.ones((2, 1, 1)), np.ones((2, 1)))])
    with pytest.raises(pgm.ModelError, match="are tables, or Gaussian"):
        pgm.MarkovNetwork([pgm.SampledCPD(A, (), sample=lambda rng: rng)])


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"cov": [1.0, 1.0], "angles": (True,)}, "found 2 by cov=, 1 by angles="),
        ({"cov": [1.0, 1.0], "value": 3.0}, "found 2 by cov=, 1 by value="),
        (
            {"cov": 1.0, "value": [[1.0]]},
            r"value has shape \(1, 1\); a factor has one, \(d,\), and",
        ),
        ({"cov": 1.0, "value": []}, r"value has shape \(0,\); a factor has one"),
        ({"cov": 1.0, "value": np.nan}, "the value has entries that are NaN or infinite"),
        ({"cov": 1.0, "value": "far"}, r"of \(a, b\): value must be numbers"),
        ({"cov": 1.0, "size": 0}, "size is how many components"),
        ({"cov": 1.0, "angles": "yes"}, "angles is a mask"),
        ({"cov": -1.0}, "whose residual is the child here"),
        ({"cov": 1.0, "jacobian": {C: None}}, "not among its parents"),
    ],
)
def test_residuals_that_do_not_fit(options, words):
    with pytest.raises(pgm.ModelError, match=words):
        pgm.NonlinearGaussianFactor((A, B), lambda a, b: a - b, **options)


def test_scales_far_apart():
    """What is in kilometres is informed as surely as what is in micrometres beside it."""
    form = pgm.CanonicalForm((A, B), np.diag([1e12, 1e-3]), [1e12, 5e-3])
    found = pgm.infer(pgm.compile(pgm.MarkovNetwork([form])), {})
    assert found[A].mean == pytest.approx([1.0], rel=1e-12)
    assert found[B].mean == pytest.approx([5.0], rel=1e-12)
    assert found[B].cov == pytest.approx(np.array([[1e3]]), rel=1e-12)
    z = 0.5 * (1e12 + 25e-3) + np.log(2 * np.pi) - 0.5 * np.log(1e12 * 1e-3)
    assert found.log_evidence == pytest.approx(z, rel=1e-15)


def infer(factors, evidence=(), **options):
    graph = pgm.compile(pgm.MarkovNetwork(factors))
    return pgm.infer(graph, dict(evidence), **options)


@pytest.mark.parametrize("turned", [False, True])
@pytest.mark.parametrize("size", [1e9, 1e12, 3e13])
def test_nearly_flat_forms_are_told(size, turned):
    """What entries hold few digits of is kept, with a number; exact by a quotient of integers."""
    matrix = np.array([[size + 1.0, -size], [-size, size + 1.0]])
    scope = (B, A) if turned else (A, B)
    factors = [pgm.CanonicalForm(scope, matrix, [0.0, 0.0]), pgm.GaussianCPD(A, 5.0, 1.0)]
    # (s + 1) (s + 2) − s² = 3 s + 2, in integers.
    whole = int(size)
    due = 5.0 * (whole + 1) / (3 * whole + 2)
    if size < 1e10:
        found = infer(factors)
    else:
        with pytest.warns(pgm.PrecisionWarning, match="nearly flat along a direction"):
            found = infer(factors)
    error = abs(float(found[A].mean[0]) - due) / float(found[A].std[0])
    digits = 6.0 if found.status.digits is None else float(found.status.digits)
    assert error < 10.0**-digits


def test_forms_of_rank_two():
    """Two squares of three variables, nearly of one direction, with any order of the scope."""
    rng = np.random.default_rng(0)
    for trial in range(50):
        root = rng.normal(size=(2, 3))
        root[:, 1] = root[:, 0] + 10.0 ** -(trial % 6) * root[:, 1]
        target = rng.normal(size=2)
        order = rng.permutation(3)
        scope = tuple((A, B, C)[k] for k in order)
        form = pgm.CanonicalForm(
            scope, (root.T @ root)[np.ix_(order, order)], (root.T @ target)[order]
        )
        found = infer([form, *(pgm.GaussianCPD(v, 0.0, 100.0) for v in (A, B, C))])
        joint = np.linalg.inv(root.T @ root + np.eye(3) / 100.0)
        due = joint @ (root.T @ target)
        for k, v in enumerate((A, B, C)):
            assert abs(found[v].mean[0] - due[k]) < 1e-6 * np.sqrt(joint[k, k])


def test_slopes_are_not_dropped():
    form = pgm.CanonicalForm(
        (A, B), 1e6 * np.array([[1.0, -1.0], [-1.0, 1.0]]), [1e13 + 500, -1e13]
    )
    with pytest.raises(pgm.ModelError, match="has a slope"):
        infer([form, pgm.GaussianCPD(A, 0.0, 1.0)])


@pytest.mark.parametrize("seed", range(20))
def test_large_numbers_beside_a_flat_direction_are_no_slope(seed):
    """A component that the form does not have, and a difference of two beside a far third."""
    rng = np.random.default_rng(seed)
    a, b = rng.normal(size=2)
    far = pgm.CanonicalForm(C, 4.0, 2e6)
    apart = pgm.CanonicalForm((A, B), [[a * a, -a * b], [-a * b, b * b]], [a * 0.3, -b * 0.3])
    pair = pgm.CanonicalForm((A, B), np.array([[2.0, 1.0], [1.0, 2.0 + a * a]]), [a, 1e6 * b])
    for form in (apart * far, pair.extend((A, D, B)), (apart * far).extend((C, A, D, B))):
        held = [pgm.CanonicalForm(v, 1.0, 0.5) for v in (A, D)]
        found = pgm.infer(pgm.compile(pgm.MarkovNetwork([form, *held])), {})
        whole = form
        for each in held:
            whole = whole * each
        for v in form.scope:
            assert_allclose(found[v].mean, whole.gaussian().marginal(v).mean, rtol=1e-8)


def test_integrals_beyond_numbers():
    with pytest.warns(pgm.PrecisionWarning), np.errstate(over="ignore"):
        found = infer([pgm.CanonicalForm(A, [[1.0]], [1e160])])
    with pytest.raises(pgm.NumericalError, match="beyond the range"):
        found.log_evidence  # noqa: B018


def stairs(a):
    return np.floor(a * 100.0) / 100.0


def test_the_order_of_factors_does_not_matter():
    """A CPD that becomes a residual keeps its Jacobian, its shape's check and its noise."""
    slope = {A: lambda a: np.ones((*a.shape[:-1], 1, 1))}
    steps = pgm.NonlinearGaussianCPD(B, A, stairs, cov=0.01, jacobian=slope)
    first, second = pgm.GaussianCPD(A, 0.005, 1.0), pgm.GaussianCPD(B, 1.0, 0.01)
    schedule = pgm.Calibration(iterations=30, tolerance=0.01)
    means = [
        infer(factors, schedule=schedule)[A].mean[0]
        for factors in ([first, steps, second], [second, first, steps])
    ]
    assert_allclose(means, 0.985, atol=0.02)
    pair = pgm.Variable("pair", ("p", "q"))
    short = pgm.NonlinearGaussianCPD(pair, A, lambda a: a, cov=np.eye(2))
    known = pgm.GaussianCPD(pair, [0.0, 0.0], np.eye(2))
    for factors in ([short, known, first], [known, short, first]):
        with pytest.raises(pgm.ModelError, match="returned shape"):
            infer(factors)
    heavy = pgm.LinearGaussianCPD(B, {A: 1.0}, cov=0.1, noise=pgm.Cauchy(2.385))
    many = pgm.Calibration(iterations=100)
    near = pgm.GaussianCPD(B, 3.0, 1.0)
    found = [
        infer(factors, schedule=many) for factors in ([first, heavy, near], [near, first, heavy])
    ]
    assert_allclose(found[0][A].mean, found[1][A].mean, rtol=1e-9)
    assert list(found[0].weights) == [heavy]


def test_weights_of_observed_children():
    heavy = pgm.LinearGaussianCPD(B, {A: 1.0}, cov=0.1, noise=pgm.Cauchy(2.385))
    prior, flat = pgm.GaussianCPD(A, 0.0, 1.0), pgm.CanonicalForm(A, [[0.0]], [0.0])
    many = pgm.Calibration(iterations=100)
    found = infer([prior, heavy, flat], {B: 30.0}, schedule=many)
    twin = pgm.infer(pgm.compile(pgm.BayesianNetwork([prior, heavy])), {B: 30.0}, schedule=many)
    assert list(found.weights) == [heavy]
    assert_allclose(found.weights[heavy], twin.weights[B], rtol=1e-6)
    assert_allclose(found[A].mean, twin[A].mean, atol=1e-9)


def test_a_variable_called_residual():
    own = pgm.Variable("residual")
    found = infer([pgm.NonlinearGaussianFactor(own, lambda a: a - 1.0, cov=1.0)])
    assert_allclose(found[own].mean, [1.0])


class Wave:
    """A function of several vectors, f(x) = A x + s sin(B x), and its Jacobian."""

    def __init__(self, rng, rows, size):
        self.A, self.B = rng.normal(size=(2, rows, size))
        self.s = rng.uniform(-0.5, 0.5, rows)

    def __call__(self, *parts):
        x = np.concatenate(parts, axis=-1)
        return x @ self.A.T + self.s * np.sin(x @ self.B.T)

    def jacobian(self, x):
        return self.A + (self.s * np.cos(self.B @ x))[:, None] * self.B


@pytest.mark.parametrize("seed", slow_after(2, range(10)))
def test_nonlinear_networks_stand_where_their_cost_is_least(seed):
    """Of 100 each: the means are stationary, and the covariance is that of Gauss and Newton."""
    rng = np.random.default_rng(seed)
    for _ in range(100):
        sizes = rng.integers(1, 3, size=rng.integers(1, 5)).tolist()
        every = [
            pgm.Variable(f"x{k}", ("a", "b")[:d] if d > 1 else ()) for k, d in enumerate(sizes)
        ]
        ends = np.cumsum([0, *sizes])
        places = {v: np.arange(ends[k], ends[k + 1]) for k, v in enumerate(every)}
        factors, rows = [], []
        for v in every:
            mean = rng.normal(size=v.dimension)
            factors.append(pgm.GaussianCPD(v, mean, np.eye(v.dimension)))
            rows.append((places[v], None, mean, np.eye(v.dimension)))
        for _ in range(int(rng.integers(1, 6))):
            scope = [every[k] for k in rng.permutation(len(every))[: rng.integers(1, 4)]]
            count, at = int(rng.integers(1, 3)), np.concatenate([places[v] for v in scope])
            wave, root = Wave(rng, count, len(at)), rng.normal(size=(count, count))
            value, cov = rng.normal(size=count), root @ root.T + 0.5 * np.eye(count)
            factors.append(pgm.NonlinearGaussianFactor(scope, wave, cov, value=value))
            rows.append((at, wave, value, cov))
        posterior = pgm.infer(pgm.compile(pgm.MarkovNetwork(factors)), {})
        mean = np.concatenate([posterior[v].mean for v in every])
        slope, precision = np.zeros(len(mean)), np.zeros((len(mean), len(mean)))
        for at, wave, value, cov in rows:
            J = np.eye(len(at)) if wave is None else wave.jacobian(mean[at])
            found = mean[at] if wave is None else wave(mean[at])
            slope[at] += J.T @ np.linalg.solve(cov, found - value)
            precision[np.ix_(at, at)] += J.T @ np.linalg.solve(cov, J)
        if not posterior.status.converged:
            continue
        cov = np.linalg.inv(precision)
        std = np.sqrt(np.diag(cov))
        assert_allclose(cov @ slope / std, 0.0, atol=1e-7)
        for v in every:
            scale = np.outer(std[places[v]], std[places[v]])
            own = cov[np.ix_(places[v], places[v])]
            assert_allclose(posterior[v].cov / scale, own / scale, atol=1e-6)
