"""Batches, seeds, online filters, what is asked of beliefs, and what is refused."""

import pickle

import numpy as np
import pytest
from clouds import cart, move, pose, robot, robot_evidence, seen, x, z

import pgm


def few(**named):
    return pgm.Particles(200, seed=7, **named)


@pytest.mark.filterwarnings("ignore::pgm.ParticleWarning")
def test_the_first_run_of_a_batch_is_a_run_by_itself():
    given = robot_evidence(6, runs=(2, 2))
    batch = pgm.smooth(robot(), given, belief=few())
    alone = {
        move: given[move],
        seen: pgm.sightings(given[seen].values[0, 0], given[seen].step, given[seen].given),
    }
    single = pgm.smooth(robot(), alone, belief=few())
    np.testing.assert_array_equal(batch[pose][0, 0].states, single[pose].states)
    np.testing.assert_array_equal(batch.filtered[pose][0, 0].weights, single.filtered[pose].weights)
    np.testing.assert_allclose(batch.log_evidence[0, 0], single.log_evidence, atol=1e-12)
    assert batch[pose].mean.shape == (2, 2, 7, 3)
    assert not np.array_equal(batch[pose][0, 1].states, single[pose].states)


@pytest.mark.filterwarnings("ignore::pgm.ParticleWarning")
def test_blocks_change_nothing(monkeypatch):
    given = robot_evidence(3, runs=(3,))
    whole = pgm.filter(robot(), given, belief=pgm.Particles(300, seed=1))
    alone = pgm.filter(
        robot(),
        {
            move: given[move],
            seen: pgm.sightings(given[seen].values[0], given[seen].step, given[seen].given),
        },
        belief=pgm.Particles(300, seed=1),
    )
    monkeypatch.setattr("pgm.beliefs.points.cloud.BLOCK", 650)  # two runs, then one
    parted = pgm.filter(robot(), given, belief=pgm.Particles(300, seed=1))
    np.testing.assert_array_equal(whole[pose].states, parted[pose].states)
    np.testing.assert_array_equal(whole[pose][0].states, alone[pose].states)


def test_seeds_reproduce_and_differ():
    given = robot_evidence(4)
    one, same = (pgm.filter(robot(), given, belief=few()) for _ in range(2))
    other = pgm.filter(robot(), given, belief=pgm.Particles(200, seed=8))
    np.testing.assert_array_equal(one[pose].states, same[pose].states)
    assert not np.array_equal(one[pose].states, other[pose].states)


@pytest.mark.filterwarnings("ignore::pgm.ParticleWarning")
def test_online_is_offline():
    given, steps = robot_evidence(6), 6
    offline = pgm.filter(robot(), given, belief=few())
    online = pgm.OnlineFilter(robot(), belief=few())
    belief = online.initial()
    for step in range(1, steps + 1):
        belief = online.predict(belief, {move: given[move][step - 1]})
        assert str(belief.kind) == "predicted"
        now = np.flatnonzero(given[seen].step == step)
        (mark,) = given[seen].given
        marks = given[seen].given[mark][now]
        read = pgm.sightings(given[seen].values[now], given={mark: marks})
        belief = online.update(belief, {seen: read})
        np.testing.assert_array_equal(belief[pose].states, offline[pose][step].states)
        np.testing.assert_allclose(belief[pose].weights, offline[pose][step].weights, atol=1e-12)
    np.testing.assert_allclose(belief.log_evidence, offline.log_evidence, atol=1e-9)
    assert belief.status.effective.shape == (1,)


def test_online_goes_from_one_run_to_many():
    online = pgm.OnlineFilter(cart(), belief=few())
    belief = online.predict(online.initial())
    many = online.update(belief, {z: np.zeros((3, 1))})
    assert many[x].mean.shape == (3, 2)
    assert many.log_evidence.shape == (3,)
    with pytest.raises(pgm.PgmError):
        online.update(many, {z: np.zeros((2, 1))})


def test_what_a_belief_answers():
    given = robot_evidence(4)
    belief = pgm.filter(robot(), given, belief=few())[pose][4]
    assert belief.lead == ()
    states, weights = belief.states, belief.weights
    np.testing.assert_allclose(weights.sum(), 1.0)
    mean = weights @ states
    np.testing.assert_allclose(belief.mean, mean, atol=1e-12)
    apart = states - mean
    np.testing.assert_allclose(belief.cov, (apart.T * weights) @ apart, atol=1e-12)
    np.testing.assert_allclose(belief.std, np.sqrt(np.diag(belief.cov)))
    np.testing.assert_allclose(belief.effective, 1.0 / (weights**2).sum())
    np.testing.assert_allclose(belief.gaussian().cov, belief.cov)
    part = belief.marginal("heading", "east")
    np.testing.assert_allclose(part.mean, mean[[2, 0]])
    counts, (edges,) = belief.histogram("east", bins=10)
    np.testing.assert_allclose(
        counts, np.histogram(states[:, 0], bins=edges, weights=weights)[0], atol=1e-12
    )
    drawn = belief.sample(20_000, rng=1)
    assert np.abs(drawn.mean(axis=0) - mean).max() < 0.02
    assert pickle.loads(pickle.dumps(belief)).mean.tolist() == belief.mean.tolist()
    with pytest.raises(ValueError, match="read-only"):
        belief.states[0] = 0.0


def test_angles_have_circular_means():
    model = pgm.DynamicBayesianNetwork(
        prior=[pgm.GaussianCPD(pose, [0.0, 0.0, 3.1], np.diag([1.0, 1.0, 0.3]) ** 2)],
        transition=[pgm.LinearGaussianCPD(pose, {pose.previous: 1.0}, cov=0.01 * np.eye(3))],
    )
    belief = pgm.filter(model, {}, steps=1, belief=pgm.Particles(20_000))[pose]
    assert abs(np.angle(np.exp(1j * (belief.mean[0, 2] - 3.1)))) < 0.01
    assert abs(belief.std[0, 2] - 0.3) < 0.01
    probabilities, (edges,) = belief[0].histogram("heading", bins=8)
    assert edges[0] == -np.pi
    np.testing.assert_allclose(probabilities.sum(), 1.0)


def test_weights_far_below_float64_do_no_harm():
    model = cart(noise=1e-4)
    given = {z: pgm.sightings([[40.0]], step=[1])}  # thousands of deviations off
    with pytest.warns(pgm.ParticleWarning, match="worth"):
        found = pgm.filter(model, given, steps=2, belief=few())
    assert found.log_evidence < -1e5
    assert np.isfinite(found[x].mean).all()
    np.testing.assert_allclose(found[x][1].weights.sum(), 1.0)


def test_an_online_filter_warns_too():
    robot = pgm.OnlineFilter(cart(noise=1e-4), belief=few())
    belief = robot.predict(robot.predict(robot.initial()))
    with pytest.warns(pgm.ParticleWarning, match="worth"):
        robot.update(belief, {z: [40.0]})


def impossible():
    """A reading whose distance overflows float64: none of the particles explains it."""
    return {z: pgm.sightings([[1e200]], step=[2])}


def test_impossible_evidence_is_refused_by_step_and_sensor():
    with pytest.raises(pgm.EvidenceError, match=r"\[z\].* at step 2, run 0|z at step 2") as caught:
        pgm.filter(cart(1e-3), impossible(), steps=3, belief=few())
    assert caught.value.step == 2


def test_impossible_evidence_is_ignored_where_that_is_the_policy():
    with pytest.warns(pgm.ParticleWarning, match="no particle explains"):
        found = pgm.filter(cart(1e-3), impossible(), steps=3, belief=few(impossible="ignore"))
    assert found.log_evidence == -np.inf
    assert found.status.ignored.tolist() == [False, False, True, False]
    assert np.isfinite(found[x].mean).all()


def test_a_restart_begins_at_the_prior():
    def near(x):  # a reading that is possible from the prior alone
        return np.where(np.abs(x[..., :1]) < 5.0, x[..., :1], 1e200)

    model = pgm.DynamicBayesianNetwork(
        prior=[pgm.GaussianCPD(x, [0.0, 0.0], np.eye(2))],
        transition=[
            pgm.LinearGaussianCPD(x, {x.previous: 1.0}, offset=[20.0, 0.0], cov=0.1 * np.eye(2))
        ],
        observation=[pgm.NonlinearGaussianCPD(z, x, near, cov=0.1)],
    )
    given = {z: pgm.sightings([[0.5]], step=[1])}
    with pytest.raises(pgm.EvidenceError, match="impossible"):
        pgm.filter(model, given, steps=1, belief=few())
    with pytest.warns(pgm.ParticleWarning, match="no particle explains"):
        found = pgm.filter(model, given, steps=1, belief=few(impossible="restart"))
    assert found.status.restarted.tolist() == [False, True]
    assert abs(found[x].mean[1, 0] - 0.5 / 1.1) < 0.1
    assert found.log_evidence == -np.inf


@pytest.mark.parametrize(
    ("named", "message"),
    [
        ({"n": 0}, "n is a whole number"),
        ({"n": 2.5}, "n is a whole number"),
        ({"seed": -1}, "seed is a whole number"),
        ({"resampling": "best"}, "resampling is one of systematic"),
        ({"smoothing": "none"}, "smoothing is one of metropolis"),
        ({"impossible": "hope"}, "impossible is one of raise"),
        ({"threshold": 1.5}, "threshold is a share"),
        ({"moves": 0}, "moves is a whole number"),
        ({"trajectories": 0}, "trajectories is a whole number"),
        ({"dtype": np.int64}, "dtype is np.float64"),
    ],
)
def test_particles_that_are_none(named, message):
    with pytest.raises(pgm.ModelError, match=message):
        pgm.Particles(**({"n": 10} | named))


def test_what_is_not_for_particles():
    given = cart().sample({}, steps=2, rng=1).evidence
    for named in ({"lineariser": pgm.Unscented()}, {"keep": [x]}):
        with pytest.raises(pgm.ModelError, match="particles linearise nothing"):
            pgm.filter(cart(), given, belief=few(), **named)
    with pytest.raises(pgm.ModelError, match="need no linearising"):
        pgm.filter(cart(), given, belief=few(), iterations=2)
    with pytest.raises(pgm.ModelError, match="no lag online"):
        pgm.OnlineFilter(cart(), belief=few(), lag=2)
    with pytest.raises(pgm.ModelError, match=r"belief= is a pgm.Grid.* or pgm.Particles"):
        pgm.filter(cart(), given, belief=100)
    with pytest.raises(pgm.ModelError, match="would take"):
        pgm.filter(cart(), given, belief=pgm.Particles(10**12))
    flat = cart().replace(prior=[pgm.GaussianCPD(x, [0.0, 0.0], np.inf)])
    with pytest.raises(pgm.ModelError, match="infinite variance"):
        pgm.filter(flat, given, belief=few())
    with pytest.raises(pgm.ModelError, match="has no noise"):
        pgm.filter(cart(0.0), given, belief=few())


def test_what_posteriors_refuse():
    given = cart().sample({}, steps=3, rng=1).evidence
    found = pgm.filter(cart(), given, belief=few())
    with pytest.raises(pgm.EvidenceError, match="no hidden variable"):
        found.joint(z)
    with pytest.raises(pgm.ModelError, match="after the last step"):
        found[x.at(9)]
    with pytest.raises(pgm.EvidenceError, match="not drawn together"):
        found.joint(x.at(1), x.at(2))
    with pytest.raises(pgm.EvidenceError, match="joint takes variables"):
        found.joint()
    belief = found[x]
    with pytest.raises(pgm.ModelError, match="index a run and a step"):
        belief.histogram("p")
    with pytest.raises(pgm.ModelError, match="is no component"):
        belief.marginal("q")
    with pytest.raises(pgm.ModelError, match="leading axes"):
        belief[9]
    with pytest.raises(pgm.ModelError, match="whole variables"):
        belief.marginal("p").gaussian()


def test_a_function_that_has_no_value_is_told_with_its_step():
    model = robot().replace(
        observation=[
            pgm.NonlinearGaussianCPD(
                seen,
                robot().observation[0].given,
                lambda x, m: np.full((*x.shape[:-1], 2), np.nan),
                np.eye(2),
            )
        ]
    )
    with pytest.raises(pgm.LinearisationError, match="at step 1, run 0, its function has values"):
        pgm.filter(model, robot_evidence(2), belief=few())


def test_the_number_follows_the_spread():
    bins = {"p": 0.5, "v": 0.5}
    number = pgm.KLDSampling(bins, epsilon=0.05, delta=0.05, least=50, most=4000)
    wide = cart().replace(prior=[pgm.GaussianCPD(x, [0.0, 0.0], np.diag([8.0, 2.0]) ** 2)])
    given = {z: pgm.sightings([[1.0], [2.0]], step=[2, 3])}
    belief = pgm.Particles(8000, seed=1, number=number)
    found = pgm.filter(wide, given, steps=5, belief=belief)
    count = found.status.number
    assert count.tolist()[:2] == [8000, 4000]  # the most
    assert (count[3:] < 3000).all()
    assert (count >= 50).all()
    states = found[x][4].states  # drawn of the belief at step 3, then moved
    exact = pgm.filter(wide, given, steps=5)
    assert np.abs(states.mean(axis=0) - exact[x].mean[4]).max() < 0.2
    with pytest.raises(pgm.ModelError, match="number of particles differs"):
        found[x].states  # noqa: B018
    smoothed = pgm.smooth(wide, given, steps=5, belief=belief)
    assert smoothed[x].states.shape == (6, 8000, 2)
    pickle.loads(pickle.dumps(belief))


def test_numbers_that_are_none():
    for named, message in (
        ({"widths": {}}, "maps components"),
        ({"widths": {"p": -1.0}}, "width of bins of 'p'"),
        ({"epsilon": 0.0}, "epsilon"),
        ({"delta": 1.0}, "delta"),
        ({"least": 10, "most": 5}, "least and most"),
    ):
        with pytest.raises(pgm.ModelError, match=message):
            pgm.KLDSampling(**({"widths": {"p": 1.0}} | named))
    with pytest.raises(pgm.ModelError, match=r"number is a pgm.KLDSampling"):
        pgm.Particles(10, number=20)
    unknown = pgm.Particles(10, number=pgm.KLDSampling({"q": 1.0}))
    with pytest.raises(pgm.ModelError, match="'q' is no component"):
        pgm.filter(cart(), {}, steps=2, belief=unknown)


def test_a_function_that_fails_is_told_with_its_step():
    def broken(x, m):
        raise RuntimeError("no map")

    model = robot().replace(
        observation=[
            pgm.NonlinearGaussianCPD(seen, robot().observation[0].given, broken, np.eye(2))
        ]
    )
    with pytest.raises(pgm.ModelError, match="seen at step 1 failed: RuntimeError: no map"):
        pgm.filter(model, robot_evidence(2), belief=few())
