"""Runs with gaps at different cells, against dense conditional Gaussians row by row."""

import numpy as np
import pytest

import pgm

A, B = pgm.Variable("a", ("p", "q")), pgm.Variable("b")


def drawn(seed):
    """CPDs of a linear network in topological order, and the mean and covariance of all."""
    rng = np.random.default_rng(seed)
    cpds, places = [], {}
    mean, cov = np.zeros(0), np.zeros((0, 0))
    for k in range(rng.integers(2, 7)):
        d = int(rng.integers(1, 4))
        child = pgm.Variable(f"v{k}", tuple("abc"[:d]))
        others = list(places)
        chosen = rng.permutation(k)[: rng.integers(0, min(k, 3) + 1)]
        given = {others[j]: rng.normal(size=(d, others[j].dimension)) for j in chosen}
        offset, root = rng.normal(size=d), rng.normal(size=(d, d))
        noise = root @ root.T + 0.1 * np.eye(d)
        slope = np.zeros((d, mean.size))
        for parent, matrix in given.items():
            slope[:, places[parent]] = matrix
        places[child] = np.arange(mean.size, mean.size + d)
        cross = slope @ cov
        mean = np.concatenate([mean, offset + slope @ mean])
        cov = np.block([[cov, cross.T], [cross, cross @ slope.T + noise]])
        cpds.append(
            pgm.LinearGaussianCPD(child, given, noise, offset=offset)
            if given
            else pgm.GaussianCPD(child, offset, noise)
        )
    return rng, cpds, places, mean, cov


def with_gaps(rng, places, mean, cov):
    """Rows that were drawn, some cells of which are NaN, or whole variables, or whole rows."""
    rows = rng.multivariate_normal(mean, cov, size=rng.integers(1, 9))
    gaps = rng.random(rows.shape) < rng.choice([0.2, 0.5, 0.8])
    for own in places.values():
        gaps[np.ix_(rng.random(len(rows)) < 0.4, own)] = True
        if rng.random() < 0.2:
            gaps[:, own] = False
    if rng.random() < 0.3:
        gaps[0] = True
    if rng.random() < 0.3:
        gaps[-1] = False
    rows[gaps] = np.nan
    if len(rows) > 3:
        rows[2] = rows[1]
    return rows


def conditioned(row, mean, cov):
    """The mean and covariance of all components given those observed, and their log-density."""
    seen = ~np.isnan(row)
    if not seen.any():
        return mean, cov, 0.0
    own, away = cov[np.ix_(seen, seen)], (row - mean)[seen]
    gain = np.linalg.solve(own, cov[seen]).T
    found, left = mean + gain @ away, cov - gain @ cov[seen]
    found[seen], left[seen], left[:, seen] = row[seen], 0.0, 0.0
    log = -0.5 * (away @ np.linalg.solve(own, away) + np.linalg.slogdet(2 * np.pi * own)[1])
    return found, left, log


def check(seed):
    rng, cpds, places, mean, cov = drawn(seed)
    rows = with_gaps(rng, places, mean, cov)
    network = pgm.BayesianNetwork([cpds[k] for k in rng.permutation(len(cpds))])
    evidence = {v: rows[:, places[v]] for v in rng.permutation(np.array([*places], dtype=object))}
    posterior = pgm.infer(pgm.compile(network), evidence)
    scope = [v for v in places if np.isnan(rows[:, places[v]]).any()]
    own = np.concatenate([places[v] for v in scope]) if scope else None
    joint = posterior.joint(*scope) if scope else None
    for k, row in enumerate(rows):
        due, left, log = conditioned(row, mean, cov)
        np.testing.assert_allclose(posterior.log_evidence[k], log, rtol=1e-9, atol=1e-9)
        if scope:
            seen = ~np.isnan(row[own])
            np.testing.assert_allclose(joint.mean[k], due[own], rtol=1e-8, atol=1e-8)
            np.testing.assert_allclose(joint.cov[k], left[np.ix_(own, own)], rtol=1e-8, atol=1e-8)
            assert (joint.mean[k][seen] == row[own][seen]).all()
            assert not joint.cov[k][seen].any()
        for v in scope:
            np.testing.assert_allclose(posterior[v].mean[k], due[places[v]], rtol=1e-8, atol=1e-8)
    for v in [v for v in places if v not in scope]:
        with pytest.raises(pgm.EvidenceError, match="is observed"):
            posterior[v]


@pytest.mark.parametrize("seed", range(40))
def test_drawn_networks(seed):
    check(seed)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(40, 300))
def test_many_drawn_networks(seed):
    check(seed)


# A nonlinear network, whose rows are inferred one by one for comparison.
X = pgm.Variable("x", ("east", "north"))
Y, Z, W = pgm.variables("y z w")
PRIOR = pgm.GaussianCPD(X, [1.0, 2.0], [[0.5, 0.2], [0.2, 0.4]])
FAR = pgm.NonlinearGaussianCPD(Y, X, lambda x: np.hypot(x[..., 0], x[..., 1])[..., None], 0.1)
BENT = pgm.BayesianNetwork(
    [
        PRIOR,
        FAR,
        pgm.NonlinearGaussianCPD(Z, (X, Y), lambda x, y: x[..., :1] * y, 0.2),
        pgm.LinearGaussianCPD(W, {Y: 2.0}, cov=0.5),
    ]
)
GAP = np.nan
BENT_ROWS = {
    X: np.array([[1.0, 2.0], [GAP, GAP], [GAP, GAP], [0.5, 1.5], [GAP, GAP], [GAP, GAP]]),
    Y: np.array([[2.0], [GAP], [2.2], [GAP], [GAP], [1.9]]),
    Z: np.array([[GAP], [2.5], [2.0], [1.0], [GAP], [2.2]]),
    W: np.array([[4.0], [4.5], [GAP], [4.1], [GAP], [GAP]]),
}


def row_by_row(graph, evidence, **options):
    """For each row the posterior of what it has, as by calls of their own."""
    for k in range(len(next(iter(evidence.values())))):
        yield pgm.infer(
            graph, {v: a[k] for v, a in evidence.items() if not np.isnan(a[k]).any()}, **options
        )


@pytest.mark.parametrize("rule", [pgm.Taylor(), pgm.Unscented()])
@pytest.mark.parametrize("iterations", [1, 30])
def test_functions_are_linearised_as_in_calls_of_their_own(rule, iterations):
    graph = pgm.compile(BENT)
    options = {"lineariser": rule, "schedule": pgm.Calibration(iterations)}
    found = pgm.infer(graph, BENT_ROWS, **options)
    for k, one in enumerate(row_by_row(graph, BENT_ROWS, **options)):
        np.testing.assert_allclose(found.log_evidence[k], one.log_evidence, rtol=1e-12)
        assert found.status.converged[k] == one.status.converged
        for v, rows in BENT_ROWS.items():
            if np.isnan(rows[k]).any():
                np.testing.assert_allclose(found[v].mean[k], one[v].mean, rtol=1e-10)
                np.testing.assert_allclose(found[v].cov[k], one[v].cov, rtol=1e-10)
            else:
                np.testing.assert_array_equal(found[v].mean[k], rows[k])
                assert not found[v].cov[k].any()
    assert found.log_evidence_kind == {1: "linearised", 30: "laplace"}.get(
        iterations if isinstance(rule, pgm.Taylor) else 1
    )
    if iterations == 30:
        assert found.status.residuals.shape == (found.status.iterations - 1, 6)


def test_a_function_of_what_was_observed_in_part():
    """As of the same two scalars, one of which is observed."""
    east, north = pgm.variables("east north")
    slope = 0.2 / 0.5
    apart = pgm.BayesianNetwork(
        [
            pgm.GaussianCPD(east, 1.0, 0.5),
            pgm.LinearGaussianCPD(north, {east: slope}, cov=0.4 - slope * 0.2, offset=2.0 - slope),
            pgm.NonlinearGaussianCPD(Y, (east, north), lambda e, n: np.hypot(e, n), 0.1),
        ]
    )
    options = {"schedule": pgm.Calibration(50)}
    due = pgm.infer(pgm.compile(apart), {east: 0.7, Y: 2.5}, **options)
    both = pgm.compile(pgm.BayesianNetwork([PRIOR, FAR]))
    found = pgm.infer(both, {X: [0.7, GAP], Y: 2.5}, **options)
    np.testing.assert_allclose(found[X].mean, [0.7, due[north].mean[0]], rtol=1e-8)
    np.testing.assert_allclose(found[X].cov, [[0, 0], [0, due[north].cov[0, 0]]], rtol=1e-7)
    np.testing.assert_allclose(found.log_evidence, due.log_evidence, rtol=1e-7)


def test_markov_networks_and_loops():
    a, b, c = pgm.Variable("a", ("p", "q")), pgm.Variable("b"), pgm.Variable("c")
    K = np.array([[2.0, 0.5, 0.3], [0.5, 1.5, -0.4], [0.3, -0.4, 1.0]])
    forms = [
        pgm.CanonicalForm((a, b), K, [0.3, -0.2, 0.1], g=0.7),
        pgm.CanonicalForm((b, c), [[0.5, 0.4], [0.4, 1.0]], [0.0, 1.0], g=-0.1),
        pgm.CanonicalForm((a, c), 0.2 * np.eye(3), [0.1, 0.1, 0.0], g=0.0),
    ]
    total = forms[0] * forms[1] * forms[2]
    at = [[a, b, c].index(v) for v in total.scope]
    order = np.concatenate([{0: [0, 1], 1: [2], 2: [3]}[k] for k in at])
    back = np.argsort(order)
    K, h = total.K[np.ix_(back, back)], total.h[back]
    cov = np.linalg.inv(K)
    log_z = total.g + 0.5 * (h @ cov @ h + np.linalg.slogdet(2 * np.pi * cov)[1])
    rows = np.array(
        [
            [0.1, GAP, 0.2, GAP],
            [GAP, GAP, 1.0, -1.0],
            [0.3, 0.4, 0.5, GAP],
            [GAP, 0.4, GAP, 0.1],
            [GAP] * 4,
        ]
    )
    evidence = {a: rows[:, :2], b: rows[:, 2:3], c: rows[:, 3:]}
    graph = pgm.compile(pgm.MarkovNetwork(forms))
    found = pgm.infer(graph, evidence)
    joint = found.joint(a, b, c)
    for k, row in enumerate(rows):
        due, left, log = conditioned(row, cov @ h, cov)
        np.testing.assert_allclose(found.log_evidence[k], log + log_z, rtol=1e-10)
        np.testing.assert_allclose(joint.mean[k], due, atol=1e-10)
        np.testing.assert_allclose(joint.cov[k], left, atol=1e-10)
    loop = pgm.ClusterGraph(
        graph.network,
        [{a, b}, {b, c}, {a, c}],
        {(0, 1): {b}, (1, 2): {c}, (0, 2): {a}},
    )
    rounds = pgm.infer(loop, evidence, schedule=pgm.Flooding(200, tolerance=1e-12))
    assert rounds.log_evidence_kind == "bethe"
    np.testing.assert_allclose(rounds[a].mean, found[a].mean, atol=1e-9)  # means are exact
    assert rounds.status.converged.all()


SMALL = pgm.BayesianNetwork(
    [pgm.GaussianCPD(A, [0.0, 1.0], np.eye(2)), pgm.LinearGaussianCPD(B, {A: [[1.0, -1.0]]}, 0.5)]
)


def test_all_axes_of_runs_and_shared_evidence():
    graph = pgm.compile(SMALL)
    seen = np.array([[0.3], [GAP], [1.0]])
    parts = np.array([[[0.5, GAP]], [[GAP, GAP]]])
    found = pgm.infer(graph, {A: parts, B: seen})  # (2, 1) and (3,) runs
    assert found[A].mean.shape == (2, 3, 2)
    assert found.log_evidence.shape == (2, 3)
    assert found.joint(B, A).cov.shape == (2, 3, 3, 3)
    for j in range(2):
        for k in range(3):
            one = pgm.infer(graph, {A: parts[j, 0], B: seen[k]})
            np.testing.assert_allclose(found[A].mean[j, k], one[A].mean)
            np.testing.assert_allclose(found[B].cov[j, k], one[B].cov if k == 1 else 0.0)
            np.testing.assert_allclose(found.log_evidence[j, k], one.log_evidence)
    drawn = found.sample(7, rng=0)
    assert drawn[A].shape == (7, 2, 3, 2)
    assert (drawn[A][:, 0, :, 0] == 0.5).all()
    assert (drawn[B][:, :, 2] == 1.0).all()
    assert drawn[B][:, 0, 1].std() > 0.0


def test_draws_are_of_the_joint_and_of_each_run_by_itself():
    found = pgm.infer(pgm.compile(SMALL), {A: [[GAP, 0.2], [GAP, GAP], [GAP, GAP]]})
    drawn = found.sample(20_000, rng=1)
    both = np.concatenate([drawn[A], drawn[B]], axis=-1)
    joint = found.joint(A, B)
    np.testing.assert_allclose(both.mean(axis=0), joint.mean, atol=0.05)
    away = both - both.mean(axis=0)
    np.testing.assert_allclose(
        np.einsum("nki,nkj->kij", away, away) / len(both), joint.cov, atol=0.06
    )
    # Two runs in which nothing was observed share their belief, and not their draws.
    assert abs(np.corrcoef(drawn[A][:, 1, 0], drawn[A][:, 2, 0])[0, 1]) < 0.05


def test_what_was_observed_nowhere_is_as_if_left_out():
    graph = pgm.compile(SMALL)
    found, due = pgm.infer(graph, {A: [GAP, GAP], B: 0.5}), pgm.infer(graph, {B: 0.5})
    np.testing.assert_array_equal(found[A].mean, due[A].mean)
    assert found.belief(0).scope == due.belief(0).scope
    empty = pgm.infer(graph, {A: np.full((4, 2), GAP), B: np.full((4, 1), GAP)})
    assert empty[A].mean.tolist() == [[0.0, 1.0]] * 4
    np.testing.assert_allclose(empty.log_evidence, np.zeros(4), atol=1e-15)
    assert empty.sample(3, rng=0)[B].shape == (3, 4, 1)


def test_a_start_is_of_what_each_run_leaves_hidden():
    graph = pgm.compile(BENT)
    rng = np.random.default_rng(0)
    start = {v: 2.0 + rng.normal(size=(6, v.dimension)) for v in (X, Y)}
    options = {"schedule": pgm.Calibration(1)}
    found = pgm.infer(graph, BENT_ROWS, start=start, **options)
    for k in range(6):
        own = {v: a[k] for v, a in BENT_ROWS.items() if not np.isnan(a[k]).any()}
        began = {v: a[k] for v, a in start.items() if v not in own}
        one = pgm.infer(graph, own, start=began, **options)
        np.testing.assert_allclose(found.log_evidence[k], one.log_evidence, rtol=1e-10)
    with pytest.raises(pgm.EvidenceError, match="start"):
        pgm.infer(graph, BENT_ROWS, start={A: [0.0, 0.0], **start}, **options)


def test_a_model_whose_prior_differs_by_run():
    prior = pgm.GaussianCPD(A, np.arange(6.0).reshape(3, 2), np.eye(2))
    network = SMALL.replace(prior)
    evidence = {A: [[GAP, 1.0], [GAP, GAP], [GAP, 3.0]], B: [[0.1], [0.2], [GAP]]}
    found = pgm.infer(pgm.compile(network), evidence)
    for k in range(3):
        alone = SMALL.replace(pgm.GaussianCPD(A, prior.mean[k], np.eye(2)))
        one = pgm.infer(pgm.compile(alone), {v: rows[k] for v, rows in evidence.items()})
        np.testing.assert_allclose(found[A].mean[k], one[A].mean)
        np.testing.assert_allclose(found.log_evidence[k], one.log_evidence)


def test_readings_of_robust_noise():
    """They have weights, NaN where there is none, and no belief where they were not read."""
    reading = pgm.LinearGaussianCPD(Z, {Y: 1.0}, cov=0.1, noise=pgm.Cauchy(1.0))
    network = pgm.BayesianNetwork(
        [
            pgm.GaussianCPD(Y, 0.0, 1.0),
            pgm.LinearGaussianCPD(W, {Y: 1.0}, cov=0.3),
            reading,
        ]
    )
    rows = {Y: [[GAP], [0.5], [GAP]], Z: [[9.0], [0.4], [GAP]], W: [[0.1], [GAP], [0.2]]}
    options = {"schedule": pgm.Calibration(60)}
    found = pgm.infer(pgm.compile(network), rows, **options)
    assert found.weights[Z][0] < 0.1 < found.weights[Z][1]
    assert np.isnan(found.weights[Z][2])
    one = pgm.infer(pgm.compile(network), {Z: 9.0, W: 0.1}, **options)
    np.testing.assert_allclose(found[Y].mean[0], one[Y].mean, rtol=1e-9)
    assert found.log_evidence_kind == one.log_evidence_kind
    with pytest.raises(pgm.EvidenceError, match="its noise is robust"):
        found[Z]


def test_angles_observed_in_part():
    pose = pgm.Variable("pose", ("east", "heading"), angles=("heading",))
    network = pgm.BayesianNetwork(
        [
            pgm.GaussianCPD(pose, [0.0, 3.0], [[1.0, 0.5], [0.5, 1.0]]),
            pgm.LinearGaussianCPD(B, {pose: [[1.0, 0.0]]}, cov=1.0),
        ]
    )
    found = pgm.infer(pgm.compile(network), {pose: [GAP, -3.0]})
    turned = 2 * np.pi - 3.0
    np.testing.assert_allclose(found[pose].mean, [0.5 * (turned - 3.0), -3.0])
    np.testing.assert_allclose(found[pose].cov, [[0.75, 0.0], [0.0, 0.0]], atol=1e-15)


def test_what_has_no_answer_is_refused_in_words():
    graph = pgm.compile(SMALL)
    found = pgm.infer(graph, {A: [[GAP, 0.2], [GAP, GAP]], B: [[1.0], [2.0]]})
    with pytest.raises(pgm.GraphError, match="give runs of one pattern of gaps to a call"):
        found.belief(0)
    with pytest.raises(pgm.EvidenceError, match="b is observed in all runs"):
        found.joint(A, B)
    with pytest.raises(pgm.EvidenceError, match="y is not in the network"):
        found[Y]
    with pytest.raises(pgm.EvidenceError, match="joint takes one or more"):
        found.joint()
    with pytest.raises(pgm.ModelError, match="different gaps"):
        pgm.audit(found, rng=0)
    with pytest.raises(pgm.GraphError, match="several patterns of these"):
        pgm.view(found, "/nowhere/page.html")
    assert "2 patterns of gaps" in repr(found)
    assert "<table" in found._repr_html_()


def test_errors_name_the_run_of_all():
    """Runs of a pattern are counted by themselves inside."""
    twice = pgm.LinearGaussianCPD(B, {Y: 2.0}, cov=0.0)
    network = pgm.BayesianNetwork([pgm.GaussianCPD(Y, 0.0, 1.0), twice])
    rows = {Y: [[GAP], [1.0], [GAP], [1.0]], B: [[1.0], [2.0], [GAP], [3.0]]}
    with pytest.raises(pgm.NumericalError, match="run 1 is run 3 of all") as caught:
        pgm.infer(pgm.compile(network), rows)
    assert caught.value.run == 3
    driven = pgm.BayesianNetwork([pgm.LinearGaussianCPD(Y, {Z: 1.0}, cov=1.0)])
    with pytest.raises(pgm.EvidenceError, match=r"no evidence for z .* run 0 is run 0 of all"):
        pgm.infer(pgm.compile(driven), {Y: [[1.0], [2.0]], Z: [[GAP], [1.0]]})
    late = {Y: [[GAP], [np.inf]], B: [[1.0], [1.0]]}
    with pytest.raises(pgm.EvidenceError, match="infinite"):
        pgm.infer(pgm.compile(network), late)


def test_evidence_that_changes_afterwards_changes_no_answer():
    rows = np.array([[GAP], [1.0]])
    found = pgm.infer(pgm.compile(SMALL), {B: rows})
    rows[:] = 7.0
    assert found[B].mean.ravel().tolist() == [-1.0, 1.0]
    assert found.belief(0).scope == (A,)


# Of discrete variables and continuous ones: enumerated, row by row.
MODE, SEEN = pgm.Discrete("mode", ("low", "high", "off")), pgm.Discrete("seen", 2)
P, Q = pgm.Variable("p", ("u", "v")), pgm.Variable("q")
SHARES = np.array([0.5, 0.3, 0.2])
REPORT = np.array([[0.9, 0.1], [0.2, 0.8], [1.0, 0.0]])
OF_MODE = [
    (np.array([0.0, 1.0]), np.array([[1.0, 0.3], [0.3, 0.5]])),
    (np.array([2.0, -1.0]), np.array([[0.5, 0.0], [0.0, 2.0]])),
    (np.array([1.0, 1.0]), np.array([[2.0, -0.5], [-0.5, 1.0]])),
]
MIXED = pgm.BayesianNetwork(
    [
        pgm.TableCPD(MODE, table=SHARES),
        pgm.TableCPD(SEEN, given=MODE, table=REPORT),
        pgm.SwitchingCPD(
            P, MODE, {s: pgm.GaussianCPD(P, *OF_MODE[k]) for k, s in enumerate(MODE.states)}
        ),
        pgm.LinearGaussianCPD(Q, {P: [[1.0, -2.0]]}, cov=0.5, offset=0.3),
    ]
)


def enumerated(row, mode, seen):
    """ln p, the weights of modes, and mean and covariance of (p, q) in each."""
    slope = np.array([[1.0, 0.0], [0.0, 1.0], [1.0, -2.0]])
    logs, parts = [], []
    for k, (mean, cov) in enumerate(OF_MODE):
        due = slope @ mean + [0.0, 0.0, 0.3]
        found, left, log = conditioned(row, due, slope @ cov @ slope.T + np.diag([0, 0, 0.5]))
        share = SHARES[k] * (REPORT[k, seen] if seen >= 0 else 1.0)
        logs.append(log + np.log(share) if share and mode in (-1, k) else -np.inf)
        parts.append((found, left))
    total = np.logaddexp.reduce(logs)
    weights = np.exp(np.array(logs) - total)
    mean = sum(w * m for w, (m, _) in zip(weights, parts, strict=True))
    cov = sum(
        w * (c + np.outer(m - mean, m - mean)) for w, (m, c) in zip(weights, parts, strict=True)
    )
    return total, weights, mean, cov


def test_mixed_networks():
    rng = np.random.default_rng(4)
    rows = rng.normal(size=(60, 3))
    rows[rng.random(rows.shape) < 0.4] = GAP
    rows[7] = GAP
    mode = np.where(rng.random(60) < 0.3, rng.integers(0, 3, 60), -1)
    seen = np.where((rng.random(60) < 0.6) & (mode < 2), rng.integers(0, 2, 60), -1)
    evidence = {P: rows[:, :2], Q: rows[:, 2:], MODE: mode, SEEN: seen}
    found = pgm.infer(pgm.compile(MIXED), evidence)
    joint, tables = found.joint(P, Q), found.joint(MODE, SEEN).probabilities
    drawn = found.sample(2, rng=0)
    assert found.status.converged.shape == (60,)
    for k in range(60):
        log, weights, mean, cov = enumerated(rows[k], mode[k], seen[k])
        np.testing.assert_allclose(found.log_evidence[k], log, rtol=1e-10)
        np.testing.assert_allclose(found[MODE].probabilities[k], weights, atol=1e-12)
        np.testing.assert_allclose(joint.mean[k], mean, atol=1e-10)
        np.testing.assert_allclose(joint.cov[k], cov, atol=1e-10)
        np.testing.assert_allclose(found[P].cov[k], cov[:2, :2], atol=1e-10)
        report = REPORT if seen[k] < 0 else np.eye(2)[seen[k]]
        np.testing.assert_allclose(tables[k], weights[:, None] * report, atol=1e-12)
        known = ~np.isnan(rows[k, :2])
        assert (drawn[P][:, k, known] == rows[k, :2][known]).all()
        assert mode[k] < 0 or (drawn[MODE][:, k] == mode[k]).all()
    with pytest.raises(pgm.EvidenceError, match="neither a table nor a mixture"):
        found.joint(P, MODE)
    with pytest.raises(pgm.PgmError, match="weights"):
        found.weights  # noqa: B018


def test_impossible_rows_are_told_and_the_others_answered():
    """By tables, by soft evidence, by CPDs without noise, in groups and where all share."""
    twice = pgm.BayesianNetwork(
        [
            *MIXED.cpds,
            pgm.LinearGaussianCPD(Y, {Q: 2.0}, cov=0.0),
        ]
    )
    graph = pgm.compile(twice)
    rows = {
        MODE: [2, -1, 0, -1, -1, 1],
        SEEN: [1, 1, -1, -1, 0, -1],
        P: [[0.1, GAP], [GAP, GAP], [0.3, 0.4], [GAP, 1.0], [GAP, GAP], [GAP, GAP]],
        Q: [[1.0], [1.0], [GAP], [2.0], [1.0], [GAP]],
        Y: [[2.0], [2.0], [1.0], [5.0], [GAP], [3.0]],
    }
    with pytest.raises(pgm.PgmError, match='impossible="allow" give such runs'):
        pgm.infer(graph, rows)
    found = pgm.infer(graph, rows, impossible="allow")
    assert np.isneginf(found.log_evidence).tolist() == [True, False, False, True, False, False]
    lost = np.isneginf(found.log_evidence)
    assert np.isnan(found[P].mean[lost]).all()
    assert np.isnan(found[MODE].probabilities[lost]).all()
    drawn = found.sample(3, rng=0)
    assert np.isnan(drawn[P][:, lost]).all()
    assert (drawn[MODE][:, lost] == -1).all()
    for k in np.flatnonzero(~lost):
        own = {v: a[k] for v, a in rows.items()}
        one = pgm.infer(graph, own)
        np.testing.assert_allclose(found.log_evidence[k], one.log_evidence, rtol=1e-10)
        np.testing.assert_allclose(found[MODE].probabilities[k], one_of(one, MODE, own))
    none = pgm.infer(graph, {Q: 1.0, Y: 3.0}, impossible="allow")
    assert np.isneginf(none.log_evidence)
    assert np.isnan(none[P].mean).all()
    clear = pgm.infer(graph, {Q: 1.0}, impossible="allow")
    np.testing.assert_allclose(clear.log_evidence, pgm.infer(graph, {Q: 1.0}).log_evidence)
    with pytest.raises(pgm.ModelError, match='"raise" or "allow"'):
        pgm.infer(graph, {Q: 1.0}, impossible="maybe")


def one_of(posterior, variable, evidence):
    """The probabilities of a state that may be observed."""
    state = evidence[variable]
    return np.eye(variable.size)[state] if state >= 0 else posterior[variable].probabilities


def test_impossible_rows_of_a_gaussian_network():
    network = pgm.BayesianNetwork(
        [pgm.GaussianCPD(Y, 0.0, 1.0), pgm.LinearGaussianCPD(B, {Y: 2.0}, cov=0.0)]
    )
    graph = pgm.compile(network)
    rows = {Y: [[1.0], [1.0], [GAP]], B: [[2.0], [3.0], [4.0]]}
    found = pgm.infer(graph, rows, impossible="allow")
    assert np.isneginf(found.log_evidence).tolist() == [False, True, False]
    np.testing.assert_allclose(found[Y].mean.ravel(), [1.0, np.nan, 2.0])
    whole = pgm.infer(graph, {Y: [[1.0], [1.0]], B: [[2.0], [3.0]]}, impossible="allow")
    assert np.isneginf(whole.log_evidence).tolist() == [False, True]
    with pytest.raises(pgm.NumericalError, match=r'run 1 .*; .*impossible="allow"'):
        pgm.infer(graph, rows)


def test_the_completed_table():
    pd = pytest.importorskip("pandas")
    frame = pd.DataFrame(
        {
            "q": [1.0, None, 0.2, np.nan],
            "mode": ["low", None, "off", pd.NA],
            "seen": pd.array([1, 0, pd.NA, pd.NA], dtype="Int64"),
        }
    )
    found = pgm.infer(pgm.compile(MIXED), pgm.records(frame, MIXED))
    full = found.to_frame()
    names = ["q", "mode", "seen", "p.u", "p.v"]
    more = ["std_q", "probability_mode", "probability_seen", "std_p.u", "std_p.v"]
    assert [*full.columns] == names + more
    assert full.index.name == "run"
    assert full["mode"].tolist()[::2] == ["low", "off"]
    assert full["seen"].tolist()[:2] == ["1", "0"]
    for k in range(4):
        at = {"low": 0, "off": 2}.get(frame["mode"][k] if k in (0, 2) else None, -1)
        row = np.array([GAP, GAP, found[Q].mean[k, 0] if k in (1, 3) else frame["q"][k]])
        seen = {0: 1, 1: 0}.get(k, -1)
        due = row if k in (0, 2) else np.full(3, GAP)
        _, weights, mean, cov = enumerated(due, at, seen)
        np.testing.assert_allclose(full[["p.u", "p.v", "q"]].iloc[k], mean)
        deviations = full[["std_p.u", "std_p.v", "std_q"]].iloc[k]
        np.testing.assert_allclose(deviations, np.sqrt(np.diagonal(cov)), atol=1e-12)
        assert full["mode"][k] == MODE.states[weights.argmax()]
        np.testing.assert_allclose(full["probability_mode"][k], weights.max())


def test_completed_tables_of_every_kind():
    """Of tables, of gaps that are integrated out, without runs, and where there is no belief."""
    pytest.importorskip("pandas")
    tables = pgm.BayesianNetwork(MIXED.cpds[:2])
    found = pgm.infer(
        pgm.compile(tables), {SEEN: [1, -1, 1], MODE: [-1, -1, 2]}, impossible="allow"
    )
    full = found.to_frame()
    assert [*full.columns] == ["seen", "mode", "probability_seen", "probability_mode"]
    assert full["mode"].tolist() == ["high", "low", "off"]
    assert full["seen"].tolist() == ["1", "0", "1"]
    due = SHARES * REPORT[:, 1]
    np.testing.assert_allclose(full["probability_mode"], [due[1] / due.sum(), 0.5, 1.0])
    leaves = pgm.infer(pgm.compile(SMALL), {A: [0.5, 0.5], B: [[GAP], [1.0]]}).to_frame()
    assert leaves.columns.tolist() == ["a.p", "a.q", "b", "std_a.p", "std_a.q", "std_b"]
    np.testing.assert_allclose(leaves["b"], [0.0, 1.0], atol=1e-15)
    np.testing.assert_allclose(leaves["std_b"], [np.sqrt(0.5), 0.0])
    one = pgm.infer(pgm.compile(SMALL), {B: 0.5}).to_frame()
    assert len(one) == 1
    assert one["b"].tolist() == [0.5]
    lost = pgm.infer(pgm.compile(tables), {SEEN: [1, 0], MODE: [2, -1]}, impossible="allow")
    assert lost.to_frame()["mode"].tolist() == ["off", "low"]
    exact = pgm.BayesianNetwork(
        [pgm.GaussianCPD(Y, 0.0, 1.0), pgm.LinearGaussianCPD(B, {Y: 2.0}, cov=0.0), FLAT]
    )
    full = pgm.infer(
        pgm.compile(exact), {Y: [[1.0], [1.0]], B: [[2.0], [3.0]]}, impossible="allow"
    ).to_frame()
    np.testing.assert_array_equal(full["w"], [3.0, np.nan])
    assert full["b"].tolist() == [2.0, 3.0]
    twin = pgm.BayesianNetwork([pgm.GaussianCPD(v, 0.0, 1.0) for v in pgm.variables("x std_x")])
    with pytest.raises(pgm.EvidenceError, match="would be called 'std_x'"):
        pgm.infer(pgm.compile(twin), {}).to_frame()
    from pgm.examples import walk, z

    with pytest.raises(pgm.EvidenceError, match=r"name the variables, posterior.to_frame"):
        pgm.smooth(walk, {z: [[1.0]]}).to_frame()


FLAT = pgm.GaussianCPD(W, 3.0, 0.25)


def test_records_of_frames():
    pd = pytest.importorskip("pandas")
    frame = pd.DataFrame({"y": [1.0, pd.NA, None], "b": pd.array([1.5, pd.NA, 2.5], "Float64")})
    network = pgm.BayesianNetwork(
        [pgm.GaussianCPD(Y, 0.0, 1.0), pgm.LinearGaussianCPD(B, {Y: 1.0}, cov=1.0)]
    )
    evidence = pgm.records(frame, network)
    np.testing.assert_array_equal(evidence[Y].ravel(), [1.0, np.nan, np.nan])
    np.testing.assert_array_equal(evidence[B].ravel(), [1.5, np.nan, 2.5])
    found = pgm.infer(pgm.compile(network), evidence)
    np.testing.assert_allclose(found[Y].mean.ravel(), [1.0, 0.0, 1.25])
    with pytest.raises(pgm.EvidenceError, match=r"columns \('other'\) are of no variable"):
        pgm.records(frame.assign(other=1.0), network)
