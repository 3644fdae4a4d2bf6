"""Sightings that leave open what was seen, against sums over all that they may be of."""

from itertools import product

import numpy as np
import pytest

import pgm

X = pgm.Variable("x", components=("e", "n"))
Z = pgm.Variable("z", components=("de", "dn"))
MARK = pgm.Variable("mark", components=("e", "n"))
MARKS = np.array([[0.0, 1.0], [1.5, -0.5], [-1.0, -1.0]])
STEPS = np.array([1, 1, 2])
READ = np.array([[0.2, 0.7], [1.0, -0.2], [-0.3, 0.4]])
NOISE, VOLUME = 0.5, 40.0
MODEL = pgm.DynamicBayesianNetwork(
    prior=[pgm.GaussianCPD(X, [0.2, -0.1], 0.5)],
    transition=[pgm.LinearGaussianCPD(X, {X.previous: np.eye(2)}, cov=0.2)],
    observation=[pgm.LinearGaussianCPD(Z, {MARK: np.eye(2), X: -np.eye(2)}, cov=NOISE)],
)
MANY = pgm.Gaussians(200)


def far(found, wanted):
    return float(np.abs(np.asarray(found) - np.asarray(wanted)).max())


def open_sightings(read=READ, steps=STEPS, **options):
    unknown = pgm.unknown(MARKS, **options)
    return {Z: pgm.sightings(read, step=steps, given={MARK: unknown})}


def every_assignment(shares, spurious, *, exclusive):
    """Each assignment of the sightings as a run of an ordinary smoother, with its log-weight."""
    found = [
        each
        for each in product(range(4 if spurious else 3), repeat=3)
        if not (exclusive and each[0] == each[1] < 3)
    ]
    logs = np.array(
        [
            sum(
                np.log(spurious / VOLUME) if k == 3 else np.log(shares[k] * (1 - spurious))
                for k in each
            )
            for each in found
        ]
    )
    marks = np.array([[MARKS[min(k, 2)] for k in each] for each in found])
    read = np.array([[READ[i] if k < 3 else [np.nan] * 2 for i, k in enumerate(e)] for e in found])
    posterior = pgm.smooth(
        MODEL, {Z: pgm.sightings(read, step=STEPS, given={MARK: marks})}, steps=2
    )
    return found, logs + posterior.log_evidence, posterior


@pytest.mark.parametrize("association", ["sum", "joint"])
@pytest.mark.parametrize("spurious", [0.0, 0.1])
def test_candidates_are_summed_over_as_hypotheses(association, spurious):
    weights = [0.5, 0.2, 0.3]
    found, logs, each = every_assignment(weights, spurious, exclusive=association == "joint")
    share = np.exp(logs - np.logaddexp.reduce(logs))
    options = {"weights": weights, "association": association}
    if association == "joint":
        options["gate"] = 1 - 1e-12
    if spurious:
        options |= {"spurious": spurious, "volume": VOLUME}
    posterior = pgm.smooth(MODEL, open_sightings(**options), steps=2, belief=MANY)
    assert far(posterior.log_evidence, np.logaddexp.reduce(logs)) < 1e-12
    mean = np.einsum("a,ati->ti", share, each[X].mean)
    away = each[X].mean - mean
    cov = np.einsum("a,atij->tij", share, each[X].cov)
    cov += np.einsum("a,ati,atj->tij", share, away, away)
    assert far(posterior[X].mean, mean) < 1e-11
    assert far(posterior[X].cov, cov) < 1e-11
    seen = posterior.associations[Z]
    last = [share[[a[2] == k for a in found]].sum() for k in range(3)]
    assert far(seen.probability[2, :3], last) < 1e-11
    assert far(seen.probability.sum(axis=-1), 1.0) < 1e-12


@pytest.mark.parametrize("association", ["sum", "joint"])
def test_what_a_sighting_is_of_is_told_given_its_whole_step(association):
    """The first of two sightings, against the sum over all pairs of candidates."""
    logs = np.full((3, 3), -np.inf)
    for pair in product(range(3), repeat=2):
        if association == "joint" and pair[0] == pair[1]:
            continue
        marks = np.array([MARKS[k] for k in pair])
        seen = pgm.sightings(READ[:2], step=[1, 1], given={MARK: marks})
        logs[pair] = pgm.filter(MODEL, {Z: seen}, steps=1).log_evidence
    share = np.exp(logs - np.logaddexp.reduce(logs.ravel()))
    options = {"association": association}
    if association == "joint":
        options["gate"] = 1 - 1e-12
    unknown = pgm.unknown(MARKS, **options)
    read = {Z: pgm.sightings(READ[:2], step=[1, 1], given={MARK: unknown})}
    found = pgm.filter(MODEL, read, steps=1, belief=MANY).associations[Z]
    assert far(found.probability[0, :3], share.sum(axis=1)) < 1e-11
    assert far(found.probability[1, :3], share.sum(axis=0)) < 1e-11


def test_candidates_that_are_hidden_variables():
    """Two targets: each assignment is a network of sensors of their own."""
    a, b, which = (pgm.Variable(n, components=("e", "n")) for n in ("a", "b", "which"))
    za, zb = (pgm.Variable(n, components=("de", "dn")) for n in ("za", "zb"))
    states = [pgm.GaussianCPD(a, [0, 0], 1.0), pgm.GaussianCPD(b, [1, 0.5], 0.7)]
    moves = [
        pgm.LinearGaussianCPD(a, {a.previous: np.eye(2), b.previous: 0.1 * np.eye(2)}, cov=0.1),
        pgm.LinearGaussianCPD(b, {b.previous: 0.9 * np.eye(2)}, cov=0.2),
    ]
    unnamed = pgm.LinearGaussianCPD(Z, {which: np.eye(2)}, cov=0.3)
    model = pgm.DynamicBayesianNetwork(states, moves, [unnamed])
    named = [
        pgm.LinearGaussianCPD(za, {a: np.eye(2)}, cov=0.3),
        pgm.LinearGaussianCPD(zb, {b: np.eye(2)}, cov=0.3),
    ]
    twin = pgm.DynamicBayesianNetwork(states, moves, named)
    for association, gate in (("sum", None), ("joint", 1 - 1e-12)):
        logs, means = [], []
        for each in product((0, 1), repeat=3):
            if gate and each[0] == each[1]:
                continue
            rows = [
                np.array([READ[i] if k == own else [np.nan] * 2 for i, k in enumerate(each)])
                for own in (0, 1)
            ]
            read = {z: pgm.sightings(r, step=STEPS) for z, r in zip((za, zb), rows, strict=True)}
            found = pgm.smooth(twin, read, steps=2)
            logs.append(found.log_evidence + 3 * np.log(0.5))
            means.append(np.concatenate([found[a].mean, found[b].mean], axis=-1))
        share = np.exp(np.array(logs) - np.logaddexp.reduce(logs))
        unknown = pgm.unknown([a, b], association=association, gate=gate)
        seen = {Z: pgm.sightings(READ, step=STEPS, given={which: unknown})}
        posterior = pgm.smooth(model, seen, steps=2, belief=MANY)
        assert far(posterior.log_evidence, np.logaddexp.reduce(logs)) < 1e-12
        mean = np.einsum("a,ati->ti", share, means)
        assert far(posterior.joint(a, b).mean, mean) < 1e-11
    plain = pgm.filter(model, seen, steps=2)
    assert isinstance(plain[a], pgm.GaussianMixture)


def test_the_likeliest_is_taken_where_that_is_asked_for():
    """As of ordinary Gaussian beliefs, where candidates are apart."""
    read = MARKS[[0, 1, 2]] + 0.1
    options = {"spurious": 0.05, "volume": VOLUME, "gate": 0.999}
    usual = pgm.smooth(MODEL, open_sightings(read, **options), steps=2)
    mixed = pgm.smooth(MODEL, open_sightings(read, **options), steps=2, belief=pgm.Gaussians(1))
    assert far(mixed[X].mean, usual[X].mean) < 1e-12
    assert far(mixed[X].cov, usual[X].cov) < 1e-12
    assert (mixed.associations[Z].candidate == usual.associations[Z].candidate).all()


def test_a_sighting_of_no_candidate_is_left_out_and_a_missing_one_says_nothing():
    lost = READ.copy()
    lost[1] = 90.0
    gone = READ.copy()
    gone[1] = np.nan
    found = [
        pgm.smooth(MODEL, open_sightings(read, association="sum", gate=0.999), steps=2)
        for read in (lost, gone)
    ]
    assert far(found[0][X].mean, found[1][X].mean) < 1e-12
    assert far(found[0].log_evidence, found[1].log_evidence) < 1e-12
    first, second = (each.associations[Z] for each in found)
    assert first.candidate.tolist()[1] == -1
    assert np.isnan(second.probability[1]).all()
    assert not np.isnan(first.probability).any()


def test_runs_with_sightings_are_each_as_if_alone():
    rng = np.random.default_rng(1)
    read = READ + rng.normal(size=(5, 3, 2))
    for count in (1, 3):
        options = {"association": "sum", "spurious": 0.1, "volume": VOLUME}
        together = pgm.smooth(
            MODEL, open_sightings(read, **options), steps=2, belief=pgm.Gaussians(count)
        )
        for run in range(5):
            alone = pgm.smooth(
                MODEL, open_sightings(read[run], **options), steps=2, belief=pgm.Gaussians(count)
            )
            assert far(together[X].cov[run], alone[X].cov) < 1e-12
            own = together.associations[Z].probability[run]
            assert far(own, alone.associations[Z].probability) < 1e-12


def test_a_mode_and_open_sightings_stand_in_one_model():
    """The mode of the motion is hidden, and so is what was seen: all paths of both, by runs."""
    mode = pgm.Discrete("mode", states=("slow", "fast"))
    table = np.array([[0.8, 0.2], [0.4, 0.6]])
    cases = {
        k: pgm.LinearGaussianCPD(X, {X.previous: np.eye(2)}, cov=q)
        for k, q in enumerate((0.1, 2.0))
    }
    model = MODEL.replace(
        prior=[pgm.TableCPD(mode, table=[0.5, 0.5]), *MODEL.prior],
        transition=[
            pgm.TableCPD(mode, given=mode.previous, table=table),
            pgm.SwitchingCPD(X, given=mode, cases=cases),
        ],
    )
    found = pgm.smooth(model, open_sightings(association="sum"), steps=2, belief=MANY)
    logs, means, ends = [], [], []
    for path in product((0, 1), repeat=3):
        weight = 0.5 * table[path[0], path[1]] * table[path[1], path[2]]
        q = pgm.noise(lambda u: u[..., None] * np.eye(2), given=(U := pgm.Variable("u"),))
        moving = pgm.LinearGaussianCPD(X, {X.previous: np.eye(2)}, cov=q)
        level = np.array([(0.1, 2.0)[k] for k in path[1:]])[:, None]
        for each in product(range(3), repeat=3):
            own = {
                Z: pgm.sightings(READ, step=STEPS, given={MARK: MARKS[list(each)]}),
                U: level,
            }
            one = pgm.smooth(MODEL.replace(transition=[moving]), own)
            logs.append(np.log(weight) + 3 * np.log(1 / 3) + one.log_evidence)
            means.append(one[X].mean)
            ends.append(path[2])
    share = np.exp(np.array(logs) - np.logaddexp.reduce(logs))
    assert far(found.log_evidence, np.logaddexp.reduce(logs)) < 1e-12
    assert far(found[X].mean, np.einsum("a,ati->ti", share, means)) < 1e-11
    last = [share[np.array(ends) == k].sum() for k in (0, 1)]
    assert far(found[mode.at(2)].probabilities, last) < 1e-11


def test_one_gaussian_is_consistent_where_the_likeliest_candidate_is_not():
    """Probabilistic data association of six landmarks, a tenth of the sightings spurious."""
    rng = np.random.default_rng(0)
    marks, runs, steps, spurious = rng.uniform(-4, 4, (6, 2)), 60, 20, 0.1
    at = rng.standard_normal((runs, 2))
    true, read = [at], []
    for _ in range(steps):
        at = at + 0.5 * rng.standard_normal((runs, 2))
        which, wrong = rng.integers(6, size=runs), rng.random(runs) < spurious
        anywhere = 5.0 * rng.standard_normal((runs, 2))
        seen = marks[which] - at + 0.3 * rng.standard_normal((runs, 2))
        read.append(np.where(wrong[:, None], anywhere, seen))
        true.append(at)
    true, read = np.stack(true, 1), np.stack(read, 1)
    model = pgm.DynamicBayesianNetwork(
        prior=[pgm.GaussianCPD(X, [0, 0], 1.0)],
        transition=[pgm.LinearGaussianCPD(X, {X.previous: 1.0}, cov=0.25)],
        observation=[pgm.LinearGaussianCPD(Z, {MARK: 1.0, X: -1.0}, cov=0.09)],
    )
    unknown = pgm.unknown(marks, spurious=spurious, volume=100 * np.pi, association="sum")
    seen = {Z: pgm.sightings(read, step=np.arange(1, steps + 1), given={MARK: unknown})}
    found = {"filtered": pgm.filter(model, seen, steps=steps)}
    found["smoothed"] = pgm.smooth(model, seen, steps=steps)
    errors = {}
    for name, posterior in found.items():
        error = posterior[X].mean - true
        precision = np.linalg.inv(posterior[X].cov)
        nees = np.einsum("rti,rtij,rtj->rt", error, precision, error).mean() / 2
        errors[name] = np.sqrt((error**2).sum(axis=-1).mean())
        assert 0.9 < nees < 1.15
    assert errors["smoothed"] < errors["filtered"] < 0.8


@pytest.mark.parametrize("association", ["sum", "joint"])
def test_crossing_targets_are_followed(association):
    """Two targets cross, and no reading says whose it is."""
    rng = np.random.default_rng(0)
    steps, runs, spurious = 40, 40, 0.05
    move = np.array([[1.0, 1.0], [0.0, 1.0]])
    drift = 0.002 * np.array([[1 / 3, 0.5], [0.5, 1.0]])
    a, b, which = (pgm.Variable(n, components=("p", "v")) for n in ("a", "b", "which"))
    z = pgm.Variable("z")
    at = np.array([-10, 0.5, 10, -0.5]) + rng.standard_normal((runs, 4)) * [1, 0.1, 1, 0.1]
    root = np.linalg.cholesky(np.kron(np.eye(2), drift))
    true, read = [at], []
    for _ in range(steps):
        at = at @ np.kron(np.eye(2), move).T + rng.standard_normal((runs, 4)) @ root.T
        seen = at[:, [0, 2]] + 0.5 * rng.standard_normal((runs, 2))
        seen = np.where(rng.random((runs, 1)) < 0.5, seen, seen[:, ::-1])
        wrong = rng.random((runs, 2)) < spurious
        read.append(np.where(wrong, 20.0 * rng.standard_normal((runs, 2)), seen))
        true.append(at)
    true, read = np.stack(true, 1), np.stack(read, 1)
    model = pgm.DynamicBayesianNetwork(
        prior=[
            pgm.GaussianCPD(a, [-10, 0.5], np.diag([1, 0.01])),
            pgm.GaussianCPD(b, [10, -0.5], np.diag([1, 0.01])),
        ],
        transition=[pgm.LinearGaussianCPD(v, {v.previous: move}, cov=drift) for v in (a, b)],
        observation=[pgm.LinearGaussianCPD(z, {which: [[1.0, 0.0]]}, cov=0.25)],
    )
    gate = 0.9999 if association == "joint" else None
    unknown = pgm.unknown(
        [a, b], spurious=spurious, volume=50.0, association=association, gate=gate
    )
    numbers = np.repeat(np.arange(1, steps + 1), 2)
    seen = {z: pgm.sightings(read.reshape(runs, -1, 1), step=numbers, given={which: unknown})}
    found = pgm.filter(model, seen, steps=steps, belief=pgm.Gaussians(2))
    joint = found.joint(a, b)
    error = joint.mean - true
    nees = np.einsum("rti,rtij,rtj->rt", error, np.linalg.inv(joint.cov), error).mean() / 4
    assert 0.85 < nees < 1.15
    assert np.sqrt((error[..., [0, 2]] ** 2).mean()) < 0.5


def test_what_cannot_be_is_refused():
    seen = open_sightings(association="sum")
    with pytest.raises(pgm.PgmError, match="to be summed out"):
        pgm.OnlineFilter(MODEL).update(
            pgm.OnlineFilter(MODEL).initial(),
            {Z: pgm.sightings(READ[:1], given={MARK: pgm.unknown(MARKS, association="sum")})},
        )
    other = pgm.Variable("other", components=("e", "n"))
    foreign = {
        Z: pgm.sightings(
            READ, step=STEPS, given={MARK: pgm.unknown([other, MARK], association="likelihood")}
        )
    }
    with pytest.raises(pgm.EvidenceError, match="where they are hidden in a dynamic network"):
        pgm.filter(MODEL, foreign, steps=2)
    bent = pgm.Variable("bent", components=("e", "turn"), angles=("turn",))
    model = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(bent, [0, 0], 1.0), *MODEL.prior],
        [pgm.LinearGaussianCPD(bent, {bent.previous: 1.0}, cov=1.0), *MODEL.transition],
        MODEL.observation,
    )
    wrong = {
        Z: pgm.sightings(
            READ, step=STEPS, given={MARK: pgm.unknown([bent], association="likelihood")}
        )
    }
    with pytest.raises(pgm.EvidenceError, match="which has components"):
        pgm.filter(model, wrong, steps=2)
    particles = {
        Z: pgm.sightings(READ, step=STEPS, given={MARK: pgm.unknown([X], association="likelihood")})
    }
    with pytest.raises(pgm.EvidenceError, match="left open among variables"):
        pgm.filter(MODEL, particles, steps=2, belief=pgm.Particles(10, seed=0))
    many = pgm.unknown(np.zeros((70, 2)), gate=0.99, association="joint")
    with pytest.raises(pgm.EvidenceError, match="70 candidates, of which none is to be seen twice"):
        pgm.filter(
            MODEL,
            {Z: pgm.sightings(READ, step=STEPS, given={MARK: many})},
            steps=2,
            belief=pgm.Gaussians(2),
        )
    crowd = pgm.unknown(np.zeros((9, 2)), gate=0.9999, association="joint")
    with pytest.raises(pgm.EvidenceError, match="assignments to candidates") as caught:
        pgm.filter(
            MODEL,
            {Z: pgm.sightings(np.zeros((6, 2)), step=[1] * 6, given={MARK: crowd})},
            steps=1,
            belief=pgm.Gaussians(2),
        )
    assert caught.value.step == 1
    assert pgm.filter(MODEL, seen, steps=2)[X].weights.shape[-1] == 1
