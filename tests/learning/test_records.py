"""Networks without time learnt from records: against counts, regressions, and plain EM."""

import numpy as np
import pytest
from scipy import optimize, stats

import pgm
from pgm.learning import Coefficients, Covariance, DegreesOfFreedom, Offset, Parameter, Table

A, B, C = (
    pgm.Discrete(n, states=("0", "1", "2")[:k]) for n, k in zip("abc", (2, 3, 2), strict=True)
)
X, Y = pgm.Variable("x", ("p", "q")), pgm.Variable("y", ("r", "s"))
U, V, K = pgm.variables("u v k")
EVERY = (Coefficients(), Offset(), Covariance())


def tables(rng):
    """A common parent of two, one of which depends on the other."""

    def drawn(*shape):
        return rng.dirichlet(np.ones(shape[-1]), size=shape[:-1])

    return pgm.BayesianNetwork(
        [
            pgm.TableCPD(A, table=drawn(2)),
            pgm.TableCPD(B, A, table=drawn(2, 3)),
            pgm.TableCPD(C, (A, B), table=drawn(2, 3, 2)),
        ]
    )


LEARN = {A: Table(), B: Table(prior_counts=0.5), C: Table(prior_counts=2.0)}


def counted(states, weights):
    """The tables of complete records, by the definition."""
    a, b, c = states
    ones = [np.zeros(2), np.full((2, 3), 0.5), np.full((2, 3, 2), 2.0)]
    for k, w in enumerate(weights):
        ones[0][a[k]] += w
        ones[1][a[k], b[k]] += w
        ones[2][a[k], b[k], c[k]] += w
    return [t / t.sum(axis=-1, keepdims=True) for t in ones]


def test_complete_records_of_tables_are_counted():
    rng = np.random.default_rng(1)
    drawn = tables(rng).sample(200, rng=rng)
    weights = rng.random(200)
    found = pgm.fit(tables(rng), drawn, learn=LEARN, weights=weights)
    assert found.status.closed
    assert "no search was needed" in found.status.stopped
    for v, due in zip((A, B, C), counted([drawn[v] for v in (A, B, C)], weights), strict=True):
        np.testing.assert_allclose(found.model.cpd(v).table, due, atol=1e-9)
    assert found.posterior.log_evidence.shape == (200,)
    assert found.log_evidence[-1] == pytest.approx(weights @ found.posterior.log_evidence)


def test_posteriors_are_of_the_records_in_their_order():
    evidence = {A: np.array([1, 0]), B: np.array([-1, 2]), C: np.array([0, 0])}
    found = pgm.fit(tables(np.random.default_rng(0)), evidence, learn={A: Table()})
    due = pgm.infer(pgm.compile(found.model), evidence)
    np.testing.assert_allclose(found.posterior.log_evidence, due.log_evidence)
    np.testing.assert_allclose(found.posterior[B].probabilities, due[B].probabilities)


def plain_em(net, states, weights, steps):
    """EM by enumeration of all 12 configurations of each record; also ln p + ln prior."""
    ts = [net.cpd(v).table for v in (A, B, C)]
    fits = np.ones((len(weights), 2, 3, 2))
    for axis, column in enumerate(states):
        keep = np.ones(4, int)
        keep[[0, axis + 1]] = len(weights), -1
        same = (np.arange(fits.shape[axis + 1]) == column[:, None]) | (column < 0)[:, None]
        fits = fits * same.reshape(keep)
    for _ in range(steps):
        prior = [np.zeros(2), np.full((2, 3), 0.5), np.full((2, 3, 2), 2.0)]
        joint = fits * ts[0][:, None, None] * ts[1][:, :, None] * ts[2]
        total = joint.sum((1, 2, 3))
        reached = weights @ np.log(total)
        reached += sum(np.sum(n * np.log(t)) for n, t in zip(prior, ts, strict=True))
        share = np.tensordot(weights / total, joint, axes=1)
        parts = share.sum((1, 2)), share.sum(2), share
        ts = [n + part for n, part in zip(prior, parts, strict=True)]
        ts = [t / t.sum(axis=-1, keepdims=True) for t in ts]
    return ts, reached


@pytest.mark.filterwarnings("ignore::pgm.ConvergenceWarning")
@pytest.mark.parametrize("seed", [1, 2])
def test_records_with_gaps_are_learnt_by_em(seed):
    rng = np.random.default_rng(seed)
    drawn = tables(rng).sample(60, rng=rng)
    states = [np.where(rng.random(60) < 0.2, -1, drawn[v]) for v in (A, B, C)]
    start, weights = tables(rng), rng.random(60)
    due, total = plain_em(start, states, weights, 3000)
    evidence = dict(zip((A, B, C), states, strict=True))
    settled = {"learn": LEARN, "weights": weights, "tolerance": 0.0}
    found = pgm.fit(start, evidence, iterations=100, accelerate=False, **settled)
    for v, table in zip((A, B, C), due, strict=True):
        np.testing.assert_allclose(found.model.cpd(v).table, table, atol=1e-7)
    reached = found.log_evidence + found.log_prior
    assert reached[-1] == pytest.approx(total, abs=1e-8)
    assert (np.diff(reached) >= -1e-12 * abs(total)).all()
    assert not found.status.closed


def gaussian(rng):
    def spread(n):
        root = rng.normal(size=(n, n))
        return root @ root.T + 0.5 * np.eye(n)

    return pgm.BayesianNetwork(
        [
            pgm.GaussianCPD(X, rng.normal(size=2), spread(2)),
            pgm.LinearGaussianCPD(
                Y,
                {X: rng.normal(size=(2, 2)), U: rng.normal(size=(2, 1))},
                offset=rng.normal(size=2),
                cov=spread(2),
            ),
        ]
    )


def test_complete_records_of_a_linear_gaussian_are_a_regression():
    """With a known input, far from zero, and weights."""
    rng = np.random.default_rng(2)
    u, weights = 1e3 + rng.normal(size=(300, 1)), rng.random(300)
    drawn = gaussian(rng).sample(300, inputs={U: u}, rng=rng)
    learn = {X: (Offset(), Covariance()), Y: EVERY}
    found = pgm.fit(gaussian(rng), {**drawn, U: u}, learn=learn, weights=weights)
    assert found.status.closed
    x, y = drawn[X], drawn[Y]
    mean = weights @ x / weights.sum()
    cov = (x - mean).T @ (weights[:, None] * (x - mean)) / weights.sum()
    np.testing.assert_allclose(found.model.cpd(X).mean, mean, atol=1e-9)
    np.testing.assert_allclose(found.model.cpd(X).cov, cov, atol=1e-9)
    design = np.column_stack([x, u - 1e3, np.ones(300)]) * np.sqrt(weights)[:, None]
    best = np.linalg.lstsq(design, y * np.sqrt(weights)[:, None], rcond=None)[0]
    left = y * np.sqrt(weights)[:, None] - design @ best
    cpd = found.model.cpd(Y)
    np.testing.assert_allclose(cpd.matrices[X], best[:2].T, atol=1e-9)
    np.testing.assert_allclose(cpd.matrices[U], best[2:3].T, atol=1e-9)
    np.testing.assert_allclose(cpd.cov, left.T @ left / weights.sum(), atol=1e-9)


def joint(net):
    """Mean and covariance of (x, y) of a network without the input's part."""
    x, y = net.cpd(X), net.cpd(Y)
    F = y.matrices[X]
    mean = np.concatenate([x.mean, F @ x.mean + y.offset])
    across = F @ x.cov
    return mean, np.block([[x.cov, across.T], [across, F @ across.T + y.cov]])


@pytest.mark.filterwarnings("ignore::pgm.ConvergenceWarning")
def test_gaps_of_components_are_learnt_by_em():
    """A saturated network is one Gaussian: EM of its mean and covariance, ten lines."""
    rng = np.random.default_rng(3)

    def net(rng):
        full = gaussian(rng)
        old = full.cpd(Y)
        return full.replace(
            pgm.LinearGaussianCPD(Y, {X: old.matrices[X]}, offset=old.offset, cov=old.cov)
        )

    drawn = net(rng).sample(50, rng=rng)
    rows = np.concatenate([drawn[X], drawn[Y]], axis=1)
    rows[rng.random(rows.shape) < 0.1] = np.nan
    start = net(rng)
    mean, cov = joint(start)
    for _ in range(300):
        first, second = np.zeros(4), np.zeros((4, 4))
        for row in rows:
            o = ~np.isnan(row)
            gain = cov[:, o] @ np.linalg.inv(cov[np.ix_(o, o)]) if o.any() else np.zeros((4, 0))
            m = mean + gain @ (row[o] - mean[o])
            first += m
            second += np.outer(m, m) + cov - gain @ cov[o]
        mean = first / len(rows)
        cov = second / len(rows) - np.outer(mean, mean)
    evidence = {X: rows[:, :2], Y: rows[:, 2:]}
    learn = {X: (Offset(), Covariance()), Y: EVERY}
    found = pgm.fit(start, evidence, learn=learn, iterations=50, tolerance=0.0, accelerate=False)
    for ours, due in zip(joint(found.model), (mean, cov), strict=True):
        np.testing.assert_allclose(ours, due, atol=1e-8)
    assert (np.diff(found.log_evidence) >= -1e-12 * abs(found.log_evidence[0])).all()


def regressions(slopes, cov):
    kinds = {
        s: pgm.LinearGaussianCPD(V, {U: slope}, cov=cov)
        for s, slope in zip(A.states, slopes, strict=True)
    }
    return pgm.BayesianNetwork(
        [
            pgm.TableCPD(A, table=[0.5, 0.5]),
            pgm.GaussianCPD(U, 0.0, 1.0),
            pgm.SwitchingCPD(V, A, cases=kinds),
        ]
    )


def test_a_mixture_of_regressions_is_learnt_by_em():
    rng = np.random.default_rng(4)
    drawn = regressions([-1.0, 2.0], 0.1).sample(150, rng=rng)
    kind = np.where(rng.random(150) < 0.9, -1, drawn[A])
    u, v = drawn[U][:, 0], drawn[V][:, 0]
    share, slopes, cov = np.array([0.5, 0.5]), np.array([0.0, 1.0]), np.array([1.0, 1.0])
    for _ in range(500):
        r = v[:, None] - u[:, None] * slopes
        w = share * np.exp(-0.5 * r**2 / cov) / np.sqrt(cov)
        w[kind >= 0] *= np.eye(2)[kind[kind >= 0]]
        w /= w.sum(axis=1, keepdims=True)
        share = w.mean(axis=0)
        slopes = (w * (u * v)[:, None]).sum(0) / (w * u[:, None] ** 2).sum(0)
        cov = (w * (v[:, None] - u[:, None] * slopes) ** 2).sum(0) / w.sum(0)
    found = pgm.fit(
        regressions([0.0, 1.0], 1.0),
        {A: kind, U: drawn[U], V: drawn[V]},
        learn={A: Table(), V: (Coefficients(), Covariance())},
        tolerance=1e-10,
    )
    np.testing.assert_allclose(found.model.cpd(A).table, share, atol=1e-5)
    cases = found.model.cpd(V).cases.values()
    np.testing.assert_allclose([c.matrices[U][0, 0] for c in cases], slopes, atol=1e-5)
    np.testing.assert_allclose([c.cov[0, 0] for c in cases], cov, atol=1e-5)


def test_noise_and_calibration_of_a_function():
    sees = pgm.NonlinearGaussianCPD(V, (U, K), function=lambda u, k: k * np.exp(u), cov=1.0)
    net = pgm.BayesianNetwork([pgm.GaussianCPD(U, 0.0, 1.0), sees])
    rng = np.random.default_rng(5)
    u = rng.normal(size=(100, 1))
    v = 2.0 * np.exp(u) + 0.1 * rng.normal(size=(100, 1))
    found = pgm.fit(net, {U: u, V: v}, learn={K: Parameter(1.0), V: Covariance()})
    scale = (np.exp(u) * v).sum() / np.exp(2 * u).sum()
    np.testing.assert_allclose(found.parameters[K], scale, rtol=1e-6)
    due = np.mean((v - scale * np.exp(u)) ** 2)
    np.testing.assert_allclose(found.model.cpd(V).cov[0, 0], due, rtol=1e-4)


def test_a_case_that_no_record_has_stays_as_it_is():
    rng = np.random.default_rng(8)
    net, (u, v) = regressions([0.5, -2.0], 0.7), rng.normal(size=(2, 30, 1))
    seen = {A: np.zeros(30, dtype=int), U: u, V: v}
    found = pgm.fit(net, seen, learn={V: EVERY})
    first, other = found.model.cpd(V).cases.values()
    (slope, _), (left,), *_ = np.linalg.lstsq(np.hstack([u, np.ones((30, 1))]), v[:, 0])
    np.testing.assert_allclose([first.matrices[U][0, 0], first.cov[0, 0]], [slope, left / 30])
    assert found.status.closed
    assert (other.matrices[U][0, 0], other.cov[0, 0]) == (-2.0, 0.7)


def test_of_collinear_parents_the_coefficients_nearest_to_the_start_are_taken():
    rng = np.random.default_rng(10)
    near, far, sum_ = pgm.variables("near far sum")
    start = pgm.LinearGaussianCPD(sum_, {near: 1.0, far: 1.0}, cov=1.0)
    roots = [pgm.GaussianCPD(each, 0.0, 1.0) for each in (near, far)]
    one, y = rng.normal(size=(2, 40, 1))
    data = {near: one, far: 5.0 * one, sum_: y}
    learn = {sum_: (Coefficients(), Offset(), Covariance())}
    found = pgm.fit(pgm.BayesianNetwork([*roots, start]), data, learn=learn).model.cpd(sum_)
    unit = one - one.mean()  # both parents in units of their deviations
    move = np.linalg.pinv(np.hstack([unit, unit])) @ (y - y.mean() - 6.0 * unit)
    due = np.array([1.0, 1.0]) + move[:, 0] / [1.0, 5.0]
    learnt = [found.matrices[near][0, 0], found.matrices[far][0, 0]]
    np.testing.assert_allclose(learnt, due, rtol=1e-9)


def test_noise_that_vanishes_in_a_direction_is_refused():
    """A singular covariance has another density than the data's, and no largest one."""
    net = pgm.BayesianNetwork([pgm.GaussianCPD(X, np.zeros(2), np.eye(2))])
    line = np.random.default_rng(9).normal(size=(50, 1)) * [0.1, 0.3]
    learn = {X: (Offset(), Covariance())}
    for rows in (line, line[:2] + np.eye(2), 1e-6 * line, np.ones((3, 2))):
        with pytest.raises(pgm.ModelError, match="vanishes"):
            pgm.fit(net, {X: rows}, learn=learn)
    # What is singular by declaration stays so.
    flat = net.replace(pgm.GaussianCPD(X, np.zeros(2), [[1.0, 3.0], [3.0, 9.0]]))
    found = pgm.fit(flat, {X: line}, learn={X: Covariance()}).model.cpd(X)
    np.testing.assert_allclose(found.cov, line.T @ line / 50, rtol=1e-9)


@pytest.mark.parametrize("size", [1.0, 1e-12, 1e9])
def test_noise_is_judged_beside_the_rounding_of_readings(size):
    """The start says nothing of it: noise of 10⁻⁹ of the readings is noise, rounding is none."""
    rng = np.random.default_rng(0)
    u, noise = rng.normal(size=(2, 50, 1))
    sees = pgm.LinearGaussianCPD(V, {U: size}, cov=size**2)
    net = pgm.BayesianNetwork([pgm.GaussianCPD(U, 0.0, 1.0), sees])
    both = np.hstack([u, np.ones((50, 1))])
    for part in (1e-6, 1e-8, 1e-9, 1e-13):
        v = size * (1.0 + 2.0 * u + part * noise)
        found = pgm.fit(net, {U: u, V: v}, learn={V: EVERY}).model.cpd(V)
        left = part * (noise - both @ np.linalg.lstsq(both, noise)[0])
        due = size * np.sqrt(np.mean(left**2))
        np.testing.assert_allclose(np.sqrt(found.cov[0, 0]), due, rtol=1e-5 + 1e-15 / part)
    for part in (1e-17, 0.0):
        v = size * (1.0 + 2.0 * u + part * noise)
        with pytest.raises(pgm.ModelError, match="vanishes"):
            pgm.fit(net, {U: u, V: v}, learn={V: EVERY})


@pytest.mark.parametrize(
    ("size", "part", "start"),
    [(1e-20, 1e-1, 1.0), (1e-20, 1e-6, 1.0), (1e-20, 1e-12, 1.0), (1e-140, 1e-3, 1.0),
     (1e20, 1e-12, 1.0), (1.0, 1e-12, 1e20), (1.0, 1e-6, 1e150)],
)  # fmt: skip
def test_a_closed_form_is_the_same_from_any_start(size, part, start):
    """By least squares of readings and noise apart, which lose no digits of the latter."""
    rng = np.random.default_rng(0)
    u, noise = rng.normal(size=(2, 50, 1))
    both = np.hstack([u, np.ones((50, 1))])
    sees = pgm.LinearGaussianCPD(V, {U: start}, offset=-start, cov=max(start, 1.0))
    net = pgm.BayesianNetwork([pgm.GaussianCPD(U, 0.0, 1.0), sees])
    found = pgm.fit(net, {U: u, V: size * (1.0 + 2.0 * u + part * noise)}, learn={V: EVERY})
    slope, offset = [2.0, 1.0] + part * np.linalg.lstsq(both, noise)[0][:, 0]
    left = part * (noise - both @ np.linalg.lstsq(both, noise)[0])
    cpd = found.model.cpd(V)
    np.testing.assert_allclose(cpd.matrices[U] / size, [[slope]], rtol=1e-13)
    np.testing.assert_allclose(cpd.offset / size, [offset], rtol=1e-13)
    due = np.sqrt(np.mean(left**2))
    np.testing.assert_allclose(np.sqrt(cpd.cov[0, 0]) / size, due, rtol=1e-12 + 1e-15 / part)


@pytest.mark.parametrize("gaps", [0.0, 0.2])
def test_rows_on_a_line_leave_no_noise_across_it_with_gaps_or_without(gaps):
    rng = np.random.default_rng(0)
    net = pgm.BayesianNetwork([pgm.GaussianCPD(X, np.zeros(2), np.eye(2))])
    line = rng.normal(size=(50, 1)) * [0.1, 0.3]
    rows = np.where(rng.random((50, 2)) < gaps, np.nan, line)
    learn = {X: (Offset(), Covariance())}
    if not gaps:
        with pytest.raises(pgm.ModelError, match="vanishes"):
            pgm.fit(net, {X: rows}, learn=learn)
        return
    with pytest.warns(pgm.ConvergenceWarning, match=r"the noise of GaussianCPD\(x\) vanishes"):
        found = pgm.fit(net, {X: rows}, learn=learn)
    assert not found.status.converged
    bounded = {X: (Offset(), Covariance(lower=1e-8))}
    assert pgm.fit(net, {X: rows}, learn=bounded).status.converged


def test_a_data_frame_of_tables_and_pgmpy():
    """As the estimator of pgmpy, whose pseudo-counts are added."""
    estimators = pytest.importorskip("pgmpy.estimators")
    models = pytest.importorskip("pgmpy.models")
    pandas = pytest.importorskip("pandas")
    rng = np.random.default_rng(6)
    drawn = tables(rng).sample(100, rng=rng)
    names = {repr(v): np.array(v.states, dtype=object)[drawn[v]] for v in (A, B, C)}
    frame = pandas.DataFrame(names, dtype=object)  # pgmpy 1.0 knows no strings of pandas 3
    found = pgm.fit(
        tables(rng), pgm.records(frame, (A, B, C)), learn=dict.fromkeys((A, B, C), Table(1.0))
    )
    kind = getattr(models, "DiscreteBayesianNetwork", models.BayesianNetwork)
    theirs = kind([("a", "b"), ("a", "c"), ("b", "c")])
    states = {repr(v): list(v.states) for v in (A, B, C)}
    made = estimators.BayesianEstimator(theirs, frame, state_names=states)
    due = made.estimate_cpd("b", prior_type="dirichlet", pseudo_counts=np.ones((3, 2)))
    np.testing.assert_allclose(found.model.cpd(B).table.T, due.get_values(), atol=1e-9)


def test_what_records_cannot_be_learnt_from():
    rng = np.random.default_rng(7)
    net, data = tables(rng), {A: np.array([0, 1]), B: np.array([0, 1]), C: np.array([0, 1])}

    def refused(error, told, evidence=data, model=net, learn=LEARN, **options):
        with pytest.raises(error, match=told):
            pgm.fit(model, evidence, learn=learn, **options)

    refused(pgm.EvidenceError, "weights= has shape", weights=np.ones(3))
    refused(pgm.EvidenceError, "0 or more", weights=[-1.0, 1.0])
    refused(pgm.EvidenceError, "nothing in the evidence tells", {A: np.array([0, 1])})
    refused(pgm.EvidenceError, "weights are all zero", {**data, A: pgm.soft([0.0, 0.0])})
    refused(pgm.ModelError, "has no CPD of it", learn={B.at(0): Table()})
    refused(pgm.ModelError, "Calibration", schedule=pgm.Smoothing())
    refused(pgm.ModelError, "without steps=", steps=3)
    refused(pgm.ModelError, "without belief=", belief=pgm.Gaussians(3))
    zero = net.replace(pgm.TableCPD(A, table=[1.0, 0.0]))
    refused(pgm.EvidenceError, "probability zero", model=zero)
    causes = net.replace(pgm.NoisyOr(C, given=A, probabilities=[0.5]))
    refused(pgm.ModelError, r"TableCPD\(c, parents, table=cpd.table\)", model=causes)
    line = gaussian(rng)
    two = {X: [[0.0, 1.0], [1.0, 2.0]], Y: np.ones((2, 2)), U: np.ones((2, 1))}
    refused(pgm.ModelError, "explained exactly", two, line, {Y: EVERY})
    chosen = regressions([0.0, 1.0], 1.0)
    gaps = {U: [[0.0], [np.nan]], V: [[1.0], [2.0]]}
    refused(pgm.ModelError, "has discrete variables too", gaps, chosen, {V: Covariance()})
    walk = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(U, 0.0, 1.0)],
        [pgm.LinearGaussianCPD(U, {U.previous: 1.0}, cov=1.0)],
        [pgm.LinearGaussianCPD(V, {U: 1.0}, cov=1.0)],
    )
    refused(pgm.ModelError, "weights= are", {V: [[1.0]]}, walk, {V: Covariance()}, weights=[1.0])


def test_robust_regression_of_complete_records_is_the_likeliest():
    """Against the Student-t likelihood of the residuals, maximised by its own search."""
    rng = np.random.default_rng(0)
    u = rng.normal(size=(200, 1))
    v = 1.0 + 2.0 * u + 0.5 * rng.standard_t(3, size=(200, 1))
    weights = rng.random(200)
    sees = pgm.LinearGaussianCPD(V, {U: 1.0}, cov=1.0, noise=pgm.StudentT(5.0))
    net = pgm.BayesianNetwork([pgm.GaussianCPD(U, 0.0, 4.0), sees])
    learn = {V: (*EVERY, DegreesOfFreedom())}
    found = pgm.fit(net, {U: u, V: v}, learn=learn, weights=weights, tolerance=1e-10)

    def cost(p):
        log_p = stats.t.logpdf(v - p[0] - p[1] * u, np.exp(p[3]), scale=np.exp(p[2]))
        return -float(weights @ log_p[:, 0])

    due = optimize.minimize(cost, [0.0, 1.0, 0.0, 1.5], method="BFGS", options={"gtol": 1e-7}).x
    cpd = found.model.cpd(V)
    learnt = [*cpd.offset, cpd.matrices[U][0, 0], np.sqrt(cpd.cov[0, 0]), cpd.noise.dof]
    np.testing.assert_allclose(learnt, [*due[:2], *np.exp(due[2:])], rtol=1e-5)
    assert (np.diff(found.log_evidence) >= -1e-9).all()
    assert not found.status.closed


@pytest.mark.parametrize("noise", [pgm.Huber(1.3), pgm.Cauchy(2.0), pgm.TruncatedLeastSquares(2.5)])
def test_robust_noise_of_records_is_that_of_runs_of_one_reading(noise):
    """A record of a hidden vector and its reading is a run of a dynamic network with one step."""
    rng = np.random.default_rng(11)
    prior = pgm.GaussianCPD(X, [0.3, -0.2], [[1.0, 0.4], [0.4, 0.8]])
    sees = pgm.LinearGaussianCPD(Y, {X: [[1.0, 0.5], [0.0, 1.2]]}, cov=np.eye(2), noise=noise)
    learn = {Y: (Coefficients(), Offset(), Covariance("diagonal"))}
    readings = rng.standard_t(2, size=(60, 2)) + rng.normal(size=(60, 2))
    readings[rng.random((60, 2)) < 0.2] = np.nan
    stays = pgm.LinearGaussianCPD(X, {X.previous: np.eye(2)}, cov=np.zeros((2, 2)))
    chain = pgm.DynamicBayesianNetwork([prior], [stays], [sees])
    settings = {"learn": learn, "iterations": 30, "tolerance": 0.0, "accelerate": False}
    settled = {"iterations": 300, "tolerance": 1e-11}
    runs = {Y: readings[:, None]}
    due = pgm.fit(chain, runs, steps=1, schedule=pgm.Smoothing(**settled), **settings)
    found = pgm.fit(
        pgm.BayesianNetwork([prior, sees]),
        {Y: readings},
        schedule=pgm.Calibration(**settled),
        **settings,
    )
    cpd, twin = found.model.cpd(Y), due.model.observation[0]
    np.testing.assert_allclose(cpd.matrices[X], twin.matrices[X], rtol=1e-8)
    np.testing.assert_allclose(cpd.offset, twin.offset, rtol=1e-8)
    np.testing.assert_allclose(cpd.cov, twin.cov, rtol=1e-8)
    np.testing.assert_allclose(found.log_evidence, due.log_evidence, rtol=1e-9)


@pytest.mark.filterwarnings("ignore::pgm.ConvergenceWarning")
def test_soft_evidence_is_learnt_from_by_its_likelihoods():
    """Against EM by enumeration: a state counts by its weight times its probability."""
    rng = np.random.default_rng(12)
    net = tables(rng)
    soft = rng.random((40, 3))
    soft[:5] = 1.0  # says nothing
    soft[5:10] = [0.0, 1.0, 0.0]  # as an observed state
    a, c = rng.integers(-1, 2, 40), rng.integers(0, 2, 40)
    weights = rng.random(40)
    evidence = {A: a, B: pgm.soft(soft), C: c}
    settled = {"iterations": 50, "tolerance": 0.0, "accelerate": False}
    found = pgm.fit(net, evidence, learn=LEARN, weights=weights, **settled)
    ts = [net.cpd(v).table for v in (A, B, C)]
    told = ((np.arange(2) == a[:, None]) | (a[:, None] < 0))[:, :, None, None]
    told = told * soft[:, None, :, None] * (np.arange(2) == c[:, None])[:, None, None, :]
    for _ in range(50):
        joint = told * ts[0][:, None, None] * ts[1][:, :, None] * ts[2]
        share = np.tensordot(weights / joint.sum((1, 2, 3)), joint, axes=1)
        ts = [share.sum((1, 2)), share.sum(2) + 0.5, share + 2.0]
        ts = [t / t.sum(axis=-1, keepdims=True) for t in ts]
    for v, due in zip((A, B, C), ts, strict=True):
        np.testing.assert_allclose(found.model.cpd(v).table, due, atol=1e-9)
    assert (np.diff(found.log_evidence + found.log_prior) >= -1e-9).all()
