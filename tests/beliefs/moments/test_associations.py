"""Sightings without identity: against enumeration, and against sightings that are known."""

import itertools

import numpy as np
import pytest
from scipy.special import logsumexp
from scipy.stats import multivariate_normal, norm

import pgm

x = pgm.Variable("x", components=("east", "north"))
m = pgm.Variable("m", components=("east", "north"))
z = pgm.Variable("z", components=("east", "north"))
fix = pgm.Variable("fix", components=("east", "north"))
MARKS = np.array([[0.0, 5.0], [4.0, 5.0], [8.0, 0.0]])
NOISE, MOTION, START = 0.3**2, 0.1**2, 0.5**2
PARTICLES = pgm.Particles(40_000, seed=4)


def robot(grouped=False):
    """A robot that sees where landmarks are from it."""
    eye = np.eye(2)
    return pgm.DynamicBayesianNetwork(
        prior=[pgm.GaussianCPD(x, mean=[1.0, 1.0], cov=START * eye)],
        transition=[pgm.LinearGaussianCPD(x, given={x.previous: eye}, cov=MOTION * eye)],
        observation=[
            pgm.LinearGaussianCPD(z, given={m: eye, x: -eye}, cov=NOISE * eye),
            pgm.LinearGaussianCPD(fix, given={x: eye}, cov=4.0 * eye),
        ],
    )


def nonlinear():
    def seen(x, m):
        away = m - x
        return np.stack([np.hypot(away[..., 0], away[..., 1]), away[..., 1]], axis=-1)

    plain = robot()
    sensor = pgm.NonlinearGaussianCPD(z, (x, m), seen, cov=NOISE * np.eye(2))
    return pgm.DynamicBayesianNetwork(plain.prior, plain.transition, [sensor])


SEEN = np.array([[-1.2, 4.1], [2.8, 3.7], [7.4, -1.2], [3.1, 4.4]])
STEP = np.array([1, 1, 2, 3])
TRUTH = [0, 1, 2, 1]


def open_(values=SEEN, step=STEP, **named):
    return {
        z: pgm.sightings(
            values,
            step=step,
            given={m: pgm.unknown(MARKS, **({"association": "likelihood"} | named))},
        )
    }


def known(values=SEEN, step=STEP, which=TRUTH):
    return {z: pgm.sightings(values, step=step, given={m: MARKS[which]})}


@pytest.mark.parametrize("run", [pgm.filter, pgm.smooth])
@pytest.mark.parametrize("model", [robot(), nonlinear()], ids=["linear", "nonlinear"])
def test_likeliest_candidates_are_those_that_were_seen(run, model):
    values, which = SEEN.copy(), TRUTH
    if len(model.observation) == 1:
        values[:, 0] = np.hypot(SEEN[:, 0], SEEN[:, 1])
    found = run(model, open_(values), steps=4)
    exact = run(model, known(values, which=which), steps=4)
    np.testing.assert_allclose(found[x].mean, exact[x].mean)
    np.testing.assert_allclose(found[x].cov, exact[x].cov)
    np.testing.assert_allclose(found.log_evidence, exact.log_evidence)
    assert found.associations[z].candidate.tolist() == TRUTH
    assert found.associations[z].step.tolist() == STEP.tolist()
    assert dict(exact.associations) == {}


dust = pgm.Variable("dust")


def refusing(fault, value):
    """An argument of a CPD that fails with candidate 2 in dust, or has this value there."""

    def refused(x, m, dust):
        wrong = (dust[..., 0] > 0.0) & (m[..., 0] == MARKS[2, 0])
        if fault is not None and wrong.any():
            raise fault
        return np.where(wrong[..., None], value, m - x)

    return refused


def noise_in(m, dust):
    return NOISE - refusing(None, 1.0)(m, m, dust)


def untold(*belief):
    raise ArithmeticError("in the dust")


@pytest.mark.parametrize(
    ("named", "message", "run"),
    [
        ({"function": refusing(ArithmeticError("in the dust"), 0.0)}, "run 1, candidate 2,", 1),
        ({"function": refusing(None, np.nan)}, "run 1, candidate 2, has values that are NaN", 1),
        ({"cov": pgm.noise(noise_in, given=(m, dust), diagonal=True)}, "run 1, candidate 2,", 1),
        ({"lineariser": untold}, "in a call for runs 0 to 2: ArithmeticError", None),
    ],
    ids=["function", "values", "noise", "lineariser"],
)
def test_errors_name_the_run_and_the_candidate(named, message, run):
    """All sightings of a step are read with all candidates of all runs in one call."""
    given = {"function": refusing(None, 0.0), "cov": NOISE * np.eye(2)} | named
    plain, rough = robot(), np.zeros((3, len(STEP), 1))
    rough[1, 1] = 1.0
    model = pgm.DynamicBayesianNetwork(
        plain.prior, plain.transition, [pgm.NonlinearGaussianCPD(z, (x, m, dust), **given)]
    )
    values = np.broadcast_to(SEEN, (3, *SEEN.shape))
    seen = pgm.sightings(
        values, step=STEP, given={m: pgm.unknown(MARKS, association="likelihood"), dust: rough}
    )
    with pytest.raises(pgm.PgmError, match=f"at step 1, {message}") as refusal:
        pgm.filter(model, {z: seen}, steps=4, compiled=False)
    assert (refusal.value.step, refusal.value.run) == (1, run)


def test_equal_calls_have_equal_answers():
    """The first one of a graph, too, whose derivatives are those of the trace."""
    graph = pgm.compile(nonlinear(), 4, compiled=False)
    first, later = (
        pgm.infer(graph, open_(), schedule=pgm.Filtering()).associations[z] for _ in range(2)
    )
    np.testing.assert_array_equal(first.probability, later.probability)
    online = pgm.OnlineFilter(nonlinear(), compiled=False)
    first, later = (
        online.update(
            online.initial(),
            {z: pgm.sightings(SEEN[:2], given={m: pgm.unknown(MARKS, association="likelihood")})},
        )
        for _ in range(2)
    )
    np.testing.assert_array_equal(
        first.associations[z].probability, later.associations[z].probability
    )


def test_probabilities_are_those_of_the_innovations():
    """At step 1 the belief is N((1, 1), .26 I): a twin of three lines."""
    found = pgm.filter(robot(), open_(weights=[1.0, 2.0, 1.0], new=0.1, volume=50.0), steps=3)
    spread = (START + MOTION + NOISE) * np.eye(2)
    for row in (0, 1):
        terms = [
            w * 0.9 * multivariate_normal(mark - 1.0, spread).pdf(SEEN[row])
            for w, mark in zip([0.25, 0.5, 0.25], MARKS, strict=True)
        ]
        terms = np.array([*terms, 0.0, 0.1 / 50.0])
        np.testing.assert_allclose(found.associations[z].probability[row], terms / terms.sum())


def test_sightings_come_in_any_order_and_of_any_run():
    order = np.array([3, 0, 2, 1])
    shuffled = pgm.filter(robot(), open_(SEEN[order], STEP[order]), steps=4)
    assert shuffled.associations[z].candidate.tolist() == [TRUTH[k] for k in order]
    assert shuffled.associations[z].step.tolist() == STEP[order].tolist()
    runs = np.stack([SEEN, SEEN[[1, 0, 3, 2]] + 0.05])
    both = pgm.filter(robot(), open_(runs), steps=4)
    for run in range(2):
        alone = pgm.filter(robot(), open_(runs[run]), steps=4)
        np.testing.assert_allclose(both[x].mean[run], alone[x].mean)
        np.testing.assert_allclose(both.log_evidence[run], alone.log_evidence)
        np.testing.assert_array_equal(
            both.associations[z].candidate[run], alone.associations[z].candidate
        )
    kept = pgm.filter(robot(), open_(runs), steps=4, keep=x)
    np.testing.assert_array_equal(kept.associations[z].candidate, both.associations[z].candidate)


def test_what_is_beyond_the_gate_is_left_out():
    values = np.concatenate([SEEN, [[20.0, 20.0]]])
    step = np.append(STEP, 2)
    found = pgm.smooth(robot(), open_(values, step, gate=0.999), steps=4)
    exact = pgm.smooth(robot(), known(), steps=4)
    np.testing.assert_allclose(found[x].mean, exact[x].mean)
    np.testing.assert_allclose(found.log_evidence, exact.log_evidence)
    assert found.associations[z].candidate.tolist() == [*TRUTH, -1]


@pytest.mark.parametrize(("spurious", "new", "told"), [(0.1, 0.05, -1), (0.05, 0.1, -2)])
def test_spurious_and_new_sightings(spurious, new, told):
    values = np.concatenate([SEEN, [[-6.0, -7.0]]])
    named = {"spurious": spurious, "new": new, "volume": 400.0}
    found = pgm.filter(robot(), open_(values, np.append(STEP, 2), **named), steps=4)
    assert found.associations[z].candidate.tolist() == [*TRUTH, told]
    exact = pgm.filter(robot(), known(), steps=4)
    np.testing.assert_allclose(found[x].mean, exact[x].mean)


def test_missing_sightings_and_components():
    values = SEEN.copy()
    values[1], values[3, 0] = np.nan, np.nan
    found = pgm.filter(robot(), open_(values, gate=0.9999), steps=3)
    exact = pgm.filter(robot(), known(values, which=[0, 0, 2, 1]), steps=3)
    assert found.associations[z].candidate[[0, 1, 2]].tolist() == [0, -1, 2]
    assert np.isnan(found.associations[z].probability[1]).all()
    np.testing.assert_allclose(found[x].mean[:3], exact[x].mean[:3])


def test_known_sensors_are_taken_in_before():
    """A fix tells which landmark it was, where the prior does not."""
    far = {**open_(np.array([[1.0, 4.0]]), np.array([1])), fix: np.array([[3.0, 1.0], [3, 1]])}
    assert pgm.filter(robot(), far).associations[z].candidate.tolist() == [1]
    near = {**far, fix: np.array([[-1.0, 1.0], [-1, 1]])}
    assert pgm.filter(robot(), near).associations[z].candidate.tolist() == [0]


def test_online_is_offline():
    offline = pgm.filter(robot(), open_(gate=0.9999, new=0.1, volume=90.0), steps=3)
    for lag in (None, 2):
        online = pgm.OnlineFilter(robot(), lag=lag)
        belief, taken = online.initial(), []
        for step in range(1, 4):
            belief = online.predict(belief)
            given = {
                m: pgm.unknown(MARKS, gate=0.9999, new=0.1, volume=90.0, association="likelihood")
            }
            read = pgm.sightings(SEEN[step == STEP], given=given)
            belief = online.update(belief, {z: read})
            taken += belief.associations[z].candidate.tolist()
            np.testing.assert_allclose(belief[x].mean, offline[x].mean[step])
        assert taken == offline.associations[z].candidate.tolist()
        np.testing.assert_allclose(belief.log_evidence, offline.log_evidence)
        assert dict(online.predict(belief).associations) == {}


def enumerated(spurious, volume, steps=3):
    """The log-evidence and last mean, over all associations of the sightings."""
    total, means = [], []
    model = robot()
    for which in itertools.product(range(len(MARKS) + 1), repeat=len(SEEN)):
        which = np.array(which)
        kept = which < len(MARKS)
        given = {z: pgm.sightings(SEEN[kept], step=STEP[kept], given={m: MARKS[which[kept]]})}
        found = pgm.filter(model, given, steps=steps)
        shares = np.where(kept, (1.0 - spurious) / len(MARKS), spurious / volume)
        total.append(found.log_evidence + np.log(shares).sum())
        means.append(found[x].mean[-1])
    weights = np.exp(np.array(total) - logsumexp(total))
    return logsumexp(total), weights @ np.array(means)


def test_particles_sum_out_what_was_seen():
    log_evidence, mean = enumerated(0.2, 100.0)
    evidence = open_(spurious=0.2, volume=100.0, association="sum")
    found = pgm.filter(robot(), evidence, steps=3, belief=PARTICLES)
    np.testing.assert_allclose(found.log_evidence, log_evidence, atol=0.05)
    np.testing.assert_allclose(found[x].mean[-1], mean, atol=0.01)
    told = found.associations[z]
    assert told.candidate.tolist() == TRUTH
    np.testing.assert_allclose(told.probability.sum(axis=-1), 1.0)
    smoothed = pgm.smooth(robot(), evidence, steps=3, belief=pgm.Particles(2000, trajectories=2000))
    assert smoothed.associations[z].candidate.tolist() == TRUTH


def test_particles_take_the_likeliest_by_point():
    found = pgm.filter(robot(), open_(gate=0.999999), steps=3, belief=PARTICLES)
    exact = pgm.filter(robot(), known(), steps=3)
    np.testing.assert_allclose(found[x].mean, exact[x].mean, atol=0.02)
    # Each sighting's term has the weight of one of three candidates.
    np.testing.assert_allclose(
        found.log_evidence, exact.log_evidence - 4.0 * np.log(3.0), atol=0.05
    )


def test_particles_online():
    evidence = {"spurious": 0.2, "volume": 100.0, "association": "sum"}
    few = pgm.Particles(500)
    offline = pgm.filter(robot(), open_(**evidence), steps=3, belief=few)
    online = pgm.OnlineFilter(robot(), belief=few)
    belief = online.initial()
    for step in range(1, 4):
        given = {m: pgm.unknown(MARKS, **({"association": "likelihood"} | evidence))}
        read = {z: pgm.sightings(SEEN[step == STEP], given=given)}
        belief = online.update(online.predict(belief), read)
        np.testing.assert_array_equal(belief[x].states, offline[x][step].states)


GRID = pgm.Grid({"east": (-1.5, 3.5, 100), "north": (-1.5, 3.5, 100)})


def test_grids_sum_out_what_was_seen():
    log_evidence, mean = enumerated(0.2, 100.0)
    evidence = open_(spurious=0.2, volume=100.0, association="sum")
    found = pgm.filter(robot(), evidence, steps=3, belief=GRID)
    np.testing.assert_allclose(found.log_evidence, log_evidence, atol=1e-3)
    np.testing.assert_allclose(found[x].mean[-1], mean, atol=1e-3)
    drawn = pgm.filter(robot(), evidence, steps=3, belief=PARTICLES)
    for each, other in (
        (found, drawn),
        (pgm.smooth(robot(), evidence, steps=3, belief=GRID), None),
    ):
        assert each.associations[z].candidate.tolist() == TRUTH
        if other is not None:
            told = other.associations[z].probability
            np.testing.assert_allclose(each.associations[z].probability, told, atol=0.01)


def test_grids_take_the_likeliest_by_cell_in_batches_and_online():
    runs = np.stack([SEEN, SEEN[[1, 0, 3, 2]] + 0.05])
    runs[1, 0] = np.nan
    both = pgm.filter(robot(), open_(runs), steps=3, belief=GRID)
    exact = pgm.filter(robot(), known(), steps=3)
    np.testing.assert_allclose(both[x].mean[0], exact[x].mean, atol=2e-3)
    assert both.associations[z].candidate[0].tolist() == TRUTH
    assert np.isnan(both.associations[z].probability[1, 0]).all()
    online = pgm.OnlineFilter(robot(), belief=GRID)
    belief = online.initial()
    for step in range(1, 4):
        read = pgm.sightings(
            SEEN[step == STEP], given={m: pgm.unknown(MARKS, association="likelihood")}
        )
        belief = online.update(online.predict(belief), {z: read})
    np.testing.assert_allclose(belief.log_evidence, both.log_evidence[0], atol=1e-9)


def test_the_gate_of_points_is_of_residuals():
    """A particle two deviations away is within a gate of three, beyond one of one and a half."""
    near = pgm.unknown([[0.0, 0.0]], gate=float(1.0 - np.exp(-4.5)), association="likelihood")
    evidence = {z: pgm.sightings([[0.6, 0.0]], step=[0], given={m: near})}
    still = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(x, mean=[0.0, 0.0], cov=1e-12 * np.eye(2))],
        robot().transition,
        robot().observation,
    )
    found = pgm.filter(still, evidence, steps=0, belief=pgm.Particles(50))
    expected = norm.logpdf([0.6, 0.0], scale=0.3).sum()
    np.testing.assert_allclose(found.log_evidence, expected, atol=1e-4)
    tight = pgm.unknown([[0.0, 0.0]], gate=float(1.0 - np.exp(-1.125)), association="likelihood")
    evidence = {z: pgm.sightings([[0.6, 0.0]], step=[0], given={m: tight})}
    with pytest.raises(pgm.EvidenceError, match="impossible"):
        pgm.filter(still, evidence, steps=0, belief=pgm.Particles(50))


@pytest.mark.parametrize(
    ("named", "message"),
    [
        ({"candidates": [1.0, 2.0]}, r"rows of finite numbers, \(k, d\)"),
        ({"candidates": [[np.nan, 2.0]]}, "not finite"),
        ({"weights": [1.0]}, "one for each candidate"),
        ({"weights": [1.0, -1.0, 1.0]}, "not negative"),
        ({"spurious": 1.5}, "a probability below 1"),
        ({"spurious": 0.6, "new": 0.6, "volume": 1.0}, "sum is below 1"),
        ({"spurious": 0.1}, "uniform over a volume="),
        ({"volume": 3.0}, "uniform over a volume="),
        ({"spurious": 0.1, "volume": -3.0}, "volume is a positive number"),
        ({"gate": 1.0}, "between 0 and 1"),
        ({"association": "nearest"}, '"likelihood", "joint" or "sum"'),
    ],
)
def test_what_is_no_unknown(named, message):
    with pytest.raises(pgm.EvidenceError, match=message):
        pgm.unknown(**{"candidates": MARKS, **named})


def test_what_cannot_be_left_open():
    narrow = {
        z: pgm.sightings(SEEN, step=STEP, given={m: pgm.unknown([[1.0]], association="likelihood")})
    }
    with pytest.raises(pgm.EvidenceError, match="candidates of 1 components"):
        pgm.filter(robot(), narrow, steps=3)
    strange = {m: MARKS[TRUTH], fix: pgm.unknown(MARKS, association="likelihood")}
    with pytest.raises(pgm.EvidenceError, match="no observed parent"):
        pgm.filter(robot(), {z: pgm.sightings(SEEN, step=STEP, given=strange)}, steps=3)
    sensor = pgm.LinearGaussianCPD(z, given={m: np.eye(2), x: -np.eye(2)}, cov=np.zeros((2, 2)))
    sharp = pgm.DynamicBayesianNetwork(robot().prior, robot().transition, [sensor])
    for belief in (GRID, PARTICLES):
        with pytest.raises(pgm.ModelError, match="has no noise in a component"):
            pgm.filter(sharp, open_(), steps=3, belief=belief)
    partly = SEEN.copy()
    partly[1, 0] = np.nan
    with pytest.raises(pgm.EvidenceError, match="give all components or none"):
        pgm.filter(robot(), open_(partly, spurious=0.1, volume=50.0), steps=3)
    with pytest.raises(pgm.EvidenceError, match="alone do that"):
        robot().sample(pgm_steps(open_()), steps=3, rng=1)
    flat = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(x, mean=[0.0, 0.0], cov=np.diag([np.inf, np.inf]))],
        robot().transition,
        robot().observation,
    )
    with pytest.raises(pgm.EvidenceError, match="infinite variance"):
        pgm.filter(flat, open_(), steps=3)


def pgm_steps(evidence):
    """The evidence without its values, to be drawn."""
    return {z: pgm.sightings(step=STEP, given=evidence[z].given)}


def test_no_candidates_are_refused_by_their_shape():
    with pytest.raises(pgm.EvidenceError, match=r"found shape \(0, 2\)"):
        pgm.unknown(np.zeros((0, 2)), association="likelihood")
