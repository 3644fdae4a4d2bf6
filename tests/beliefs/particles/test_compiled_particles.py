"""Particle filters in machine code and threads: the same for any threads, and right."""

from dataclasses import replace

import numpy as np
import pytest
from clouds import (
    cart,
    drive,
    mark,
    move,
    pose,
    range_bearing,
    robot,
    robot_evidence,
    seen,
    x,
    z,
)
from scipy import stats

import pgm
from pgm.beliefs.particles.chain import ParticleChain
from pgm.beliefs.particles.compiled import CompiledChain
from pgm.beliefs.particles.record import Record
from pgm.beliefs.points.model import ParticleModel
from pgm.evidence import bind
from pgm.kernels import resampling
from pgm.schedules.sweep import forward

pytest.importorskip("llvmlite")

BY = pgm.Compiled(threads=2)


def swift(model, evidence, n, compiled=BY, **settings):
    found = pgm.filter(model, evidence, belief=pgm.Particles(n, **settings), compiled=compiled)
    assert found.status.compilation == "compiled"
    return found


def clouds(posterior):
    return posterior._outcome._clouds


def same(first, second):
    pairs = zip(clouds(first), clouds(second), strict=True)
    return all(
        np.array_equal(a.states, b.states) and np.array_equal(a.log_weights, b.log_weights)
        for a, b in pairs
    )


def chain_of(model, evidence, n, threads=2, **settings):
    """The chain of machine code, and that of NumPy, of the same model and particles."""
    bound = bind(model.transition, model.observation, evidence, None)
    settings = pgm.Particles(n, **settings)
    graph = pgm.compile(model, bound.steps)
    made = ParticleModel(model, bound, np.float64), settings, Record(bound.steps, bound.runs)
    return CompiledChain(graph, *made, threads), ParticleChain(graph, *made)


def wide(cov=((0.5, 0.2), (0.2, 0.4))):
    """A cart that is read by two components with correlated noise."""
    w = pgm.Variable("w", components=("a", "b"))
    sensor = pgm.LinearGaussianCPD(w, given={x: [[1.0, 0.0], [0.3, 1.0]]}, offset=0.1, cov=cov)
    return cart().replace(observation=[sensor]), w


# Against what is known


def test_a_linear_model_agrees_with_the_kalman_filter():
    model, readings = cart(), {z: np.array([[0.9], [2.2], [1.8], [3.1], [3.9]])}
    exact = pgm.filter(model, readings)
    found = swift(model, readings, 100_000, seed=1)
    spread = 1.0 / np.sqrt(found.status.effective.min())
    assert np.abs((found[x].mean - exact[x].mean) / exact[x].std).max() < 5.0 * spread
    assert found[x].cov == pytest.approx(exact[x].cov, abs=5.0 * spread)
    assert found.log_evidence == pytest.approx(exact.log_evidence, abs=10.0 * spread)


def test_missing_readings_agree_with_the_kalman_filter():
    model, w = wide()
    values = np.cumsum(np.ones((2, 6, 2)), axis=1)
    values[0, 1] = values[0, 2, 0] = values[1, 2, 1] = values[1, 5] = np.nan
    exact, found = pgm.filter(model, {w: values}), swift(model, {w: values}, 50_000, seed=2)
    spread = 1.0 / np.sqrt(found.status.effective.min())
    assert np.abs((found[x].mean - exact[x].mean) / exact[x].std).max() < 5.0 * spread
    assert found.log_evidence == pytest.approx(exact.log_evidence, abs=10.0 * spread)


def test_a_robot_agrees_with_particles_by_numpy():
    evidence = robot_evidence()
    slow = pgm.filter(robot(), evidence, belief=pgm.Particles(50_000, seed=1))
    found = swift(robot(), evidence, 50_000, seed=1)
    spread = 1.0 / np.sqrt(min(each.status.effective.min() for each in (slow, found)))
    assert not same(slow, found)  # whose draws are by other generators
    assert np.abs((found[pose].mean - slow[pose].mean) / slow[pose].std).max() < 7.0 * spread
    assert found.log_evidence == pytest.approx(slow.log_evidence, abs=15.0 * spread)


@pytest.mark.parametrize("noise", [None, pgm.StudentT(3.0)], ids=["gaussian", "student"])
@pytest.mark.parametrize("runs", [(), (3,)])
def test_log_densities_are_those_of_numpy(runs, noise):
    (sensor,) = robot().observation
    about = sensor.child, sensor.given, sensor.function
    cov = [[0.09, 0.03], [0.03, 0.04]]
    model = robot().replace(observation=[pgm.NonlinearGaussianCPD(*about, cov, noise=noise)])
    evidence = dict(robot_evidence(runs=runs))
    values = np.array(evidence[seen].values)
    values[..., 1, 1] = values[..., 2, 0] = values[..., 4, :] = np.nan
    values[..., 3, 1] += 4.0 * np.pi
    if runs:
        values[1, 5] = np.nan
    evidence[seen] = pgm.sightings(values, step=evidence[seen].step, given=evidence[seen].given)
    quick, slow = chain_of(model, evidence, 5000)
    assert quick.account == "compiled"
    cloud = slow.start()
    for step in range(1, 5):
        due = slow._log_likelihood(step, cloud)
        assert quick._log_likelihood(step, cloud) == pytest.approx(due, rel=1e-12, abs=1e-12)


def test_noise_has_the_words_of_numpys_philox():
    evidence, n = dict(robot_evidence(runs=(2,))), 4500
    evidence[move] = np.stack([np.full((8, 2), 0.1), np.tile([0.4, 0.2], (8, 1))])
    quick, _ = chain_of(robot(), evidence, n, seed=7)
    old = quick.start()
    new = quick.predict(1, old)
    seeds = np.random.SeedSequence(7, spawn_key=(1,))
    source = np.random.Philox(key=seeds.generate_state(2, np.uint64), counter=[0, 1, 0, 0])
    words = source.random_raw(4 * n).reshape(n, 4)[:, :3]
    white = stats.norm.ppf(((words >> np.uint64(12)).astype(float) + 0.5) * 2.0**-52)
    before = old.states[:, n:] if new.ancestors is None else old.states[:, new.ancestors[n:]]
    due = drive(before.T, np.tile([0.4, 0.2], (n, 1))) + white * [0.1, 0.1, 0.06]
    assert pytest.approx(due, abs=1e-12) == new.states[:, n:].T


# The same for any threads, and among other runs


@pytest.mark.filterwarnings("ignore::pgm.ParticleWarning")  # of few particles
@pytest.mark.parametrize("n", [8, 4097, 10_000])
def test_any_number_of_threads_draws_the_same_particles(n, monkeypatch):
    monkeypatch.setattr("pgm.beliefs.particles.compiled._APIECE", 1)
    evidence = robot_evidence()
    one = swift(robot(), evidence, n, compiled=True, seed=3, threshold=0.9)
    assert one.status.resampled.any()
    for threads in (1, 2, 3):
        found = swift(robot(), evidence, n, pgm.Compiled(threads), seed=3, threshold=0.9)
        assert same(one, found)
        assert np.array_equal(one[pose].cov, found[pose].cov)
        assert one.log_evidence == found.log_evidence


def test_a_compiled_graph_has_the_same_particles():
    evidence, few = robot_evidence(), pgm.Particles(1000, seed=3)
    graph = pgm.compile(robot(), 8, compiled=BY)
    found = pgm.infer(graph, evidence, schedule=pgm.Filtering(), belief=few)
    assert same(found, swift(robot(), evidence, 1000, seed=3))


def test_a_run_has_the_same_particles_among_others():
    readings = np.random.default_rng(0).normal(size=(3, 6, 1))
    together = swift(cart(0.1), {z: readings}, 5000, seed=3)
    few = swift(cart(0.1), {z: readings[:2]}, 5000, seed=3)
    assert together.status.resampled.any()
    for all_, some in zip(clouds(together), clouds(few), strict=True):
        for run in range(2):
            assert np.array_equal(all_.run(run).states, some.run(run).states)
            assert np.array_equal(all_.run(run).log_weights, some.run(run).log_weights)
    assert np.array_equal(together.log_evidence[:2], few.log_evidence)


def test_a_run_has_its_own_place_in_a_part_of_the_runs():
    model, readings = cart(0.1), np.random.default_rng(0).normal(size=(3, 6, 1))
    bound = bind(model.transition, model.observation, {z: readings}, None)
    last = bind(model.transition, model.observation, {z: readings[2:]}, None)
    ends = []
    for part in (bound, replace(last, first_run=2)):
        cloud, record = pgm.Particles(500, seed=1), Record(part.steps, part.runs)
        made = ParticleModel(model, part, np.float64), cloud, record
        forward(CompiledChain(pgm.compile(model, 6), *made, 2), part.steps, record)
        ends.append(record.clouds[-1].run(part.runs - 1))
    assert np.array_equal(ends[0].states, ends[1].states)
    assert np.array_equal(ends[0].log_weights, ends[1].log_weights)


def test_seeds_have_draws_of_their_own():
    first, second = (swift(cart(), {z: [[1.0]]}, 100, seed=seed) for seed in (1, 2))
    assert not np.isin(clouds(first)[1].states, clouds(second)[1].states).any()


# Resampling


@pytest.mark.parametrize("kind", ["equal", "uneven", "one", "ends", "few"])
def test_systematic_resampling_draws_as_numpy_does(kind, monkeypatch):
    monkeypatch.setattr("pgm.beliefs.particles.compiled._APIECE", 1)
    n, rng = 3 * 4096 + 17, np.random.default_rng(5)
    # Multiples of a power of two, whose sums are exact.
    weights = {
        "equal": np.ones(n),
        "uneven": rng.integers(0, 100, n).astype(float),
        "one": np.eye(1, n, 5000)[0],
        "ends": np.eye(1, n, 0)[0] + np.eye(1, n, n - 1)[0],
        "few": np.where(np.arange(n) % 4096 == 4095, 1.0, 0.0),
    }[kind]
    quick, _ = chain_of(cart(), {z: [[1.0]]}, n)
    cloud = quick.start()
    cloud = cloud.known(np.zeros(n), weights, np.ones(1))
    for offset in (0.0, 0.25, 1.0 - 2.0**-53):

        class Fixed:
            def random(self, offset=offset):
                return offset

        due = resampling.indices(resampling.systematic(weights, n, Fixed()))
        source, _, log_weights = quick._resampled(cloud, np.array([True]), [Fixed()])
        # Of the last offset NumPy may round the last level away.
        assert len(source) == n
        assert np.array_equal(source[: len(due)], due)
        assert (weights[source] > 0.0).all()
        assert (log_weights == -np.log(n)).all()


@pytest.mark.parametrize("scheme", ["stratified", "residual", "multinomial"])
def test_other_resampling_is_numpys(scheme):
    exact = pgm.filter(cart(), {z: [[0.9], [2.2]]})
    found = swift(cart(), {z: [[0.9], [2.2]]}, 20_000, resampling=scheme, threshold=1.0)
    assert found[x].mean == pytest.approx(exact[x].mean, abs=0.05)


# Odd evidence and models


def test_a_transition_of_several_cpds_and_a_hidden_control():
    s, v, told = pgm.variables("s v told")
    model = pgm.DynamicBayesianNetwork(
        prior=[pgm.GaussianCPD(s, mean=0.0, cov=1.0)],
        transition=[
            pgm.LinearGaussianCPD(v, given={told: 1.0}, cov=0.2),
            pgm.NonlinearGaussianCPD(
                s, (s.previous, v), lambda a, b: 0.5 * a + b, cov=0.3, jacobian=None
            ),
        ],
        observation=[pgm.LinearGaussianCPD(z, given={s: 1.0, v: 0.5}, cov=0.5)],
    )
    evidence = {told: [[1.0], [0.5], [2.0]], z: [[1.2], [np.nan], [2.0]]}
    exact, found = pgm.filter(model, evidence), swift(model, evidence, 100_000, seed=4)
    for variable in (s, v):
        off = (found[variable].mean - exact[variable].mean) / exact[variable].std
        assert np.abs(off).max() < 0.03
    assert found.log_evidence == pytest.approx(exact.log_evidence, abs=0.03)


def test_no_sightings_at_all():
    none = pgm.sightings(np.zeros((0, 2)), step=np.zeros(0, int), given={mark: np.zeros((0, 2))})
    found = swift(robot(), {move: np.ones((3, 2)), seen: none}, 1000)
    assert found.log_evidence == 0.0
    assert found.status.effective == pytest.approx(1000.0)


def test_impossible_measurements_are_raised_ignored_or_restarted():
    readings = {z: [[0.5], [1e200], [1.0]]}
    with pytest.raises(pgm.EvidenceError, match="impossible"):
        swift(cart(), readings, 1000)
    with pytest.raises(pgm.EvidenceError, match="nor of those of the prior"):
        swift(cart(), readings, 1000, impossible="restart")
    with pytest.warns(pgm.ParticleWarning, match="no particle explains"):
        found = swift(cart(), readings, 1000, impossible="ignore")
    assert found.status.ignored.tolist() == [False, False, True, False]
    assert np.isneginf(found.log_evidence)
    assert np.isfinite(found[x].mean).all()


def test_a_value_that_is_not_finite_is_refused_as_by_numpy():
    def broken(x):
        return np.sqrt(x[..., :1] - 1e6)

    model = cart().replace(observation=[pgm.NonlinearGaussianCPD(z, (x,), broken, cov=1.0)])
    with pytest.raises(pgm.LinearisationError, match="NaN or infinite, at the particle"):
        pgm.filter(model, {z: [[1.0]]}, belief=pgm.Particles(1000), compiled=BY)


def test_smoothers_draw_their_trajectories_by_numpy():
    readings = {z: [[0.9], [2.2], [1.8]]}
    exact = pgm.smooth(cart(), readings)
    found = pgm.smooth(cart(), readings, belief=pgm.Particles(5000), compiled=BY)
    assert found.status.compilation == "compiled; trajectories are drawn by NumPy"
    assert found.status.compilation in str(found.status)
    assert np.abs((found[x].mean - exact[x].mean) / exact[x].std).max() < 0.1


# What is left to NumPy, or refused


def untraced(x):
    return np.array([[float(each[0])] for each in np.asarray(x).reshape(-1, 2)])


def sensors():
    yield "cauchy", pgm.LinearGaussianCPD(z, {x: [[1.0, 0.0]]}, cov=1.0, noise=pgm.Cauchy(2.0))
    yield "untraced", pgm.NonlinearGaussianCPD(z, (x,), untraced, cov=1.0)
    one, other = (pgm.LinearGaussianCPD(z, {x: [[1.0, 0.0]]}, cov=cov) for cov in (1.0, 9.0))
    yield "mixture", pgm.MixtureCPD([one, other], weights=[0.9, 0.1])


LEFT = dict(sensors())


@pytest.mark.parametrize("name", LEFT)
def test_a_sensor_without_machine_code_is_weighed_by_numpy(name):
    model, w = wide()
    model = model.replace(observation=[LEFT[name], *model.observation])
    evidence = {z: [[1.0], [np.nan], [2.0]], w: np.ones((3, 2))}
    quick, slow = chain_of(model, evidence, 20_003, seed=5)  # of no whole number of packs
    cloud = slow.start()
    for step in (1, 2, 3):
        due, log_density = slow.take(step, cloud)
        found, found_density = quick.take(step, cloud)
        assert found.log_weights == pytest.approx(due.log_weights, abs=1e-10)
        assert found_density == pytest.approx(log_density, abs=1e-10)
        assert found.effective == pytest.approx(due.effective, rel=1e-10)
        assert quick._log_likelihood(step, cloud) == pytest.approx(
            slow._log_likelihood(step, cloud), abs=1e-10
        )
    told = pgm.filter(model, evidence, belief=pgm.Particles(100), compiled=BY).status.compilation
    assert told.startswith(f"compiled; weighed by NumPy: {LEFT[name]!r}")


def transitions():
    matrix = [[1.0, 0.5], [0.0, 0.9]]
    student = pgm.StudentT(5.0)
    yield "student", pgm.LinearGaussianCPD(x, {x.previous: matrix}, cov=0.1, noise=student)
    yield "untraced", pgm.NonlinearGaussianCPD(x, (x.previous,), unmoved, cov=0.1)


def unmoved(x):
    return np.array([[float(a), float(b)] for a, b in np.asarray(x).reshape(-1, 2)])


MOVED = dict(transitions())


@pytest.mark.parametrize("name", MOVED)
def test_a_transition_without_machine_code_has_numpys_answer(name):
    model = cart().replace(transition=[MOVED[name]])
    cloud = pgm.Particles(1000, seed=5)
    due = pgm.filter(model, {z: [[1.0], [2.0]]}, belief=cloud)
    found = pgm.filter(model, {z: [[1.0], [2.0]]}, belief=cloud, compiled=BY)
    assert found.status.compilation.startswith("not compiled: ")
    assert repr(MOVED[name]) in found.status.compilation
    assert same(due, found)


def by_step_or_input(name):
    """A cart of which one covariance is a function of an input, or another at each step."""
    u, model = pgm.Variable("u"), cart()
    scales = np.array([0.1, 2.0, 0.5])
    of_input = pgm.noise(lambda u: u[..., None] * 0.3, given=(u,))
    matrix = [[1.0, 0.5], [0.0, 0.9]]
    found = {
        "sensor, by input": {
            "observation": [pgm.LinearGaussianCPD(z, {x: [[1, 0]]}, cov=of_input)]
        },
        "sensor, by step": {
            "observation": [pgm.LinearGaussianCPD(z, {x: [[1, 0]]}, cov=scales[:, None, None])]
        },
        "motion, by step": {
            "transition": [
                pgm.LinearGaussianCPD(
                    x, {x.previous: matrix}, cov=scales[:, None, None] * np.eye(2)
                )
            ]
        },
    }
    evidence = {z: [[1.0], [2.0], [2.5]]}
    if "input" in name:
        evidence[u] = scales[:, None]
    return model.replace(**found[name]), evidence


@pytest.mark.parametrize("name", ["sensor, by input", "sensor, by step", "motion, by step"])
def test_covariances_by_step_or_input_agree_with_the_kalman_filter(name):
    model, evidence = by_step_or_input(name)
    exact = pgm.filter(model, evidence)
    found = pgm.filter(model, evidence, belief=pgm.Particles(50_000, seed=1), compiled=BY)
    assert "has numbers by step or a noise of inputs" in found.status.compilation
    spread = 1.0 / np.sqrt(found.status.effective.min())
    assert np.abs((found[x].mean - exact[x].mean) / exact[x].std).max() < 5.0 * spread
    assert found.log_evidence == pytest.approx(exact.log_evidence, abs=10.0 * spread)


@pytest.mark.filterwarnings("ignore::pgm.ParticleWarning")  # of few particles
@pytest.mark.parametrize(
    ("settings", "told"),
    [
        ({"n": 7}, "8 particles or more"),
        ({"dtype": np.float32}, "dtype="),
        ({"proposal": pgm.Taylor()}, "proposal="),
        ({"number": pgm.KLDSampling({"p": 0.1})}, "number="),
    ],
    ids=["few", "float32", "guided", "number"],
)
def test_particles_without_machine_code_have_numpys_answer(settings, told):
    cloud = pgm.Particles(**{"n": 200} | settings)
    due = pgm.filter(cart(), {z: [[1.0], [2.0]]}, belief=cloud)
    found = pgm.filter(cart(), {z: [[1.0], [2.0]]}, belief=cloud, compiled=BY)
    assert told in found.status.compilation
    assert same(due, found)


def test_a_wrong_trace_is_left_to_numpy(monkeypatch):
    monkeypatch.setattr("pgm.beliefs.particles.compiled.is_right", lambda *given: False)
    evidence, cloud = robot_evidence(), pgm.Particles(500, seed=1)
    found = pgm.filter(robot(), evidence, belief=cloud, compiled=True)
    assert "other values than its trace" in found.status.compilation
    assert same(found, pgm.filter(robot(), evidence, belief=cloud))


def test_without_compiled_nothing_is_told():
    found = pgm.filter(cart(), {z: [[1.0]]}, belief=pgm.Particles(100))
    assert found.status.compilation == ""


def test_online_particles_refuse_machine_code():
    with pytest.raises(pgm.ModelError, match="by NumPy: leave out compiled="):
        pgm.OnlineFilter(cart(), belief=pgm.Particles(100), compiled=True)


def test_range_bearing_is_judged_at_particles_of_all_steps():
    quick, _ = chain_of(robot(), robot_evidence(), 5000)
    cloud = quick.start()
    for step in (1, 2, 3):
        cloud, _ = quick.take(step, quick.predict(step, cloud))
    (points,) = (quick._judged.points[each] for each in quick._sensors)
    states, marks = (np.concatenate(each) for each in zip(*points, strict=True))
    assert len(states) > 300
    assert np.isfinite(range_bearing(states, marks)).all()
