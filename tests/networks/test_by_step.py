"""Numbers that change from step to step, beside dense joints, twins by input and unrolled nets."""

import copy
import pickle

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import pgm
from pgm.learning import Coefficients, Covariance, Offset, Table
from tests.beliefs.own.ensemble import EnsembleKalman
from tests.dense import linear_joint, random_covariance

T = 6
x = pgm.Variable("x", components=("p", "v"))
z, u, k, m = pgm.variables("z u k m")
mode = pgm.Discrete("mode", states=("free", "held"))


class Numbers:
    """Drawn matrices, offsets and covariances of T steps."""

    def __init__(self, seed=0):
        rng = np.random.default_rng(seed)
        self.F = np.eye(2) + 0.4 * rng.normal(size=(T, 2, 2))
        self.B = rng.normal(size=(T, 2, 1))
        self.b = rng.normal(size=(T, 2))
        self.Q = 0.3 * random_covariance(rng, 2, lead=(T,)) + 0.1 * np.eye(2)
        self.H = rng.normal(size=(T, 1, 2))
        self.c = rng.normal(size=(T, 1))
        self.R = rng.uniform(0.2, 1.0, size=(T, 1, 1))
        self.us, self.zs = rng.normal(size=(T, 1)), rng.normal(size=(T, 1))


own = Numbers()
prior = pgm.GaussianCPD(x, [0.3, -1.0], np.diag([1.0, 2.0]))


def model(numbers=own, *, control=True, noise=None):
    given = {x.previous: numbers.F} | ({u: numbers.B} if control else {})
    return pgm.DynamicBayesianNetwork(
        [prior],
        [pgm.LinearGaussianCPD(x, given, numbers.Q, offset=numbers.b)],
        [pgm.LinearGaussianCPD(z, {x: numbers.H}, numbers.R, offset=numbers.c, noise=noise)],
    )


def by_input(numbers=own, *, noise=None):
    """The same numbers as functions of an input, the number of the step."""

    def at(step):
        return np.asarray(step)[..., 0].astype(int) - 1

    return pgm.DynamicBayesianNetwork(
        [prior],
        [
            pgm.NonlinearGaussianCPD(
                x,
                (x.previous, k),
                lambda x, k: (numbers.F[at(k)] @ x[..., None])[..., 0] + numbers.b[at(k)],
                pgm.noise(lambda k: numbers.Q[at(k)], given=k),
                jacobian={x.previous: lambda x, k: numbers.F[at(k)]},
            )
        ],
        [
            pgm.NonlinearGaussianCPD(
                z,
                (x, k),
                lambda x, k: (numbers.H[at(k)] @ x[..., None])[..., 0] + numbers.c[at(k)],
                pgm.noise(lambda k: numbers.R[at(k)], given=k),
                jacobian={x: lambda x, k: numbers.H[at(k)]},
                noise=noise,
            )
        ],
    )


STEPS = np.arange(1, T + 1)[:, None]


def dense(numbers=own, *, control=True):
    """The joint of all states and measurements: entry k of the arrays is of step k + 1."""
    nodes = [(("x", 0), {}, prior.mean, prior.cov)]
    for t in range(1, T + 1):
        moved = numbers.b[t - 1] + control * numbers.B[t - 1] @ numbers.us[t - 1]
        nodes.append((("x", t), {("x", t - 1): numbers.F[t - 1]}, moved, numbers.Q[t - 1]))
        seen = {("x", t): numbers.H[t - 1]}
        nodes.append((("z", t), seen, numbers.c[t - 1], numbers.R[t - 1]))
    return linear_joint(nodes)


def close(found, mean, cov, tolerance=1e-12):
    assert_allclose(found.mean, mean, rtol=tolerance, atol=tolerance)
    assert_allclose(found.cov, cov, rtol=tolerance, atol=tolerance)


@pytest.mark.parametrize("compiled", [False, True])
@pytest.mark.parametrize("lag", [0, 2, T])
def test_filters_and_smoothers_equal_the_dense_joint(compiled, lag):
    posterior = (
        pgm.smooth(model(), {u: own.us, z: own.zs}, lag=lag or None, compiled=compiled)
        if lag
        else pgm.filter(model(), {u: own.us, z: own.zs}, compiled=compiled)
    )
    for t in range(T + 1):
        known = {("z", s): own.zs[s - 1] for s in range(1, min(t + lag, T) + 1)}
        given, total = dense().given(known)
        close(posterior[x.at(t)], *given.marginal(("x", t)))
    assert posterior.log_evidence == pytest.approx(total, abs=1e-12)
    assert posterior.log_evidence_kind == "exact"
    assert posterior.status.compilation == ("compiled" if compiled else "by NumPy: compiled=False")


def test_trees_the_static_network_and_draws_are_of_the_same_model():
    evidence = {u: own.us, z: own.zs}
    given, total = dense().given({("z", t): own.zs[t - 1] for t in range(1, T + 1)})
    balanced = pgm.infer(pgm.compile(model(), T, method=pgm.Balanced()), evidence)
    static = model().unroll(T)
    read = {v.at(t): a[t - 1] for t in range(1, T + 1) for v, a in ((u, own.us), (z, own.zs))}
    alone = pgm.infer(pgm.compile(static), read)
    for posterior in (balanced, alone):
        assert posterior.log_evidence == pytest.approx(total, abs=1e-11)
        for t in range(T + 1):
            close(posterior[x.at(t)], *given.marginal(("x", t)), 1e-11)
    drawn = model().sample({u: own.us}, runs=40_000, rng=3)
    whole = dense()
    for t in (1, T):
        assert_allclose(drawn[x][:, t].mean(axis=0), whole.marginal(("x", t))[0], atol=0.2)
        spread = np.sqrt(np.diag(whole.marginal(("x", t))[1]))
        assert_allclose(drawn[x][:, t].std(axis=0), spread, rtol=0.02)


@pytest.mark.parametrize("compiled", [None, False, True])
@pytest.mark.parametrize("lag", [None, 2])
def test_online_steps_equal_recorded_ones(compiled, lag):
    robot = pgm.OnlineFilter(model(), lag=lag, compiled=compiled)
    belief = robot.initial()
    for t in range(T):
        belief = robot.predict(belief, {u: own.us[t]})
        belief = robot.update(belief, {z: own.zs[t]})
    recorded = pgm.filter(model(), {u: own.us, z: own.zs})
    close(belief[x], recorded[x].mean[-1], recorded[x].cov[-1])
    assert belief.log_evidence == pytest.approx(recorded.log_evidence, abs=1e-12)
    if lag:
        smoothed = pgm.smooth(model(), {u: own.us, z: own.zs}, lag=lag)
        close(belief.lagged[x], smoothed[x].mean[T - lag], smoothed[x].cov[T - lag])
    if compiled:
        assert "has numbers of its own at each step" in robot.compilation
    with pytest.raises(pgm.ModelError, match="none of step 7; give its arrays 7 entries") as caught:
        robot.predict(belief, {u: own.us[0]})
    assert caught.value.cpd is robot.model.transition[0]
    with pytest.raises(pgm.ModelError, match="entry 0 of its arrays is of step 1"):
        robot.update(robot.initial(), {z: own.zs[0]})


BELIEFS = [
    pgm.Particles(200, seed=2),
    pgm.Particles(200, seed=2, proposal=pgm.Taylor()),
    pgm.Grid({"p": (-12, 12, 40), "v": (-12, 12, 30)}),
    EnsembleKalman(50),
]


@pytest.mark.parametrize("belief", BELIEFS, ids=["particles", "guided", "grid", "own"])
def test_beliefs_of_other_families_take_the_numbers_of_each_step(belief):
    """Draws of one seed are the same; so are sums over cells."""
    here = pgm.filter(model(control=False), {z: own.zs}, belief=belief)
    there = pgm.filter(by_input(), {z: own.zs, k: STEPS}, belief=belief)
    assert_allclose(here[x].mean, there[x].mean, atol=1e-10)
    if not isinstance(belief, EnsembleKalman):
        robot = pgm.OnlineFilter(model(control=False), belief=belief)
        online = robot.initial()
        for reading in own.zs:
            online = robot.update(robot.predict(online), {z: reading})
        assert online.log_evidence == pytest.approx(float(here.log_evidence), abs=1e-10)
        with pytest.raises(pgm.ModelError, match="none of step 7"):
            robot.predict(online)


@pytest.mark.parametrize("noise", [None, pgm.StudentT(4.0), pgm.Huber(1.0)])
@pytest.mark.parametrize("compiled", [False, True])
def test_gates_weights_and_runs_equal_those_of_a_twin_by_input(noise, compiled):
    readings = np.stack([own.zs, own.zs + 0.5, own.zs])
    readings[1, 2], readings[2, 4] = np.nan, 40.0
    schedules = [
        pgm.Smoothing(),
        pgm.Smoothing(4, tolerance=0.0),
        pgm.FixedLag(2, 2, tolerance=0.0),
    ]
    if noise is None:
        schedules.append(pgm.Filtering(gate=0.99))
    for schedule in schedules:
        here = pgm.compile(model(control=False, noise=noise), T, compiled=compiled)
        there = pgm.compile(by_input(noise=noise), T, compiled=compiled)
        one = pgm.infer(here, {z: readings}, schedule=schedule)
        other = pgm.infer(there, {z: readings, k: STEPS}, schedule=schedule)
        close(one[x], other[x].mean, other[x].cov, 1e-10)
        assert_allclose(one.log_evidence, other.log_evidence, atol=1e-10)


def switching(numbers=own):
    """A mode that chooses among motions, and among readings, of which one changes by step."""
    return pgm.DynamicBayesianNetwork(
        [pgm.TableCPD(mode, table=[0.6, 0.4]), prior],
        [
            pgm.TableCPD(mode, given=mode.previous, table=[[0.8, 0.2], [0.3, 0.7]]),
            pgm.SwitchingCPD(
                x,
                mode,
                {
                    "free": pgm.LinearGaussianCPD(x, {x.previous: numbers.F}, numbers.Q),
                    "held": pgm.LinearGaussianCPD(x, {x.previous: 0.5}, 0.3),
                },
            ),
        ],
        [
            pgm.SwitchingCPD(
                z,
                mode,
                {
                    "free": pgm.LinearGaussianCPD(z, {x: numbers.H}, numbers.R),
                    "held": pgm.LinearGaussianCPD(z, {x: [[1.0, 0.0]]}, 2.0 * numbers.R),
                },
            )
        ],
    )


def mixture(numbers=own):
    parts = [
        pgm.LinearGaussianCPD(x, {x.previous: numbers.F}, numbers.Q),
        pgm.LinearGaussianCPD(x, {x.previous: 0.5}, 0.3),
    ]
    seen = pgm.LinearGaussianCPD(z, {x: numbers.H}, numbers.R)
    return pgm.DynamicBayesianNetwork([prior], [pgm.MixtureCPD(parts, [0.7, 0.3])], [seen])


def hidden_markov(numbers=own):
    readings = {
        "free": pgm.LinearGaussianCPD(z, {}, numbers.R, offset=numbers.c),
        "held": pgm.LinearGaussianCPD(z, {}, 1.0),
    }
    tables = pgm.TableCPD(mode, table=[0.6, 0.4])
    moves = pgm.TableCPD(mode, given=mode.previous, table=[[0.8, 0.2], [0.3, 0.7]])
    return pgm.DynamicBayesianNetwork([tables], [moves], [pgm.SwitchingCPD(z, mode, readings)])


@pytest.mark.parametrize("made", [switching, mixture, hidden_markov])
def test_cases_and_parts_of_mixtures_equal_the_unrolled_network(made):
    net, count = made(), 4
    few = Numbers()
    for name in ("F", "B", "b", "Q", "H", "c", "R", "us", "zs"):
        setattr(few, name, getattr(own, name)[:count])
    net = made(few)
    assert net.steps == count
    wide = {} if net.discrete else {"belief": pgm.Gaussians(100)}
    posterior = pgm.filter(net, {z: few.zs}, **wide)
    read = {z.at(t + 1): few.zs[t] for t in range(count)}
    static = pgm.infer(pgm.compile(net.unroll(count)), read)
    assert posterior.log_evidence == pytest.approx(float(static.log_evidence), abs=1e-12)
    for state in net.states:
        found, due = posterior[state.at(count)], static[state.at(count)]
        if state == mode:
            assert_allclose(found.probabilities, due.probabilities, atol=1e-12)
        else:
            assert_allclose(found.mean, due.mean, atol=1e-12)
    robot = pgm.OnlineFilter(net, **wide)
    belief = robot.initial()
    for reading in few.zs:
        belief = robot.update(robot.predict(belief), {z: reading})
    assert belief.log_evidence == pytest.approx(float(posterior.log_evidence), abs=1e-12)
    assert net.sample(rng=0)[net.states[0]].shape[0] == count + 1


def test_hidden_controls_without_parents_have_offsets_by_step():
    drive = pgm.LinearGaussianCPD(u, {}, 0.2, offset=own.us)
    moved = pgm.LinearGaussianCPD(x, {x.previous: 0.9, u: own.B}, own.Q)
    net = pgm.DynamicBayesianNetwork(
        [prior], [drive, moved], [pgm.LinearGaussianCPD(z, {x: own.H}, 0.5)]
    )
    read = {z.at(t): own.zs[t - 1] for t in range(1, T + 1)}
    static = pgm.infer(pgm.compile(net.unroll(T)), read)
    for compiled in (False, True):
        posterior = pgm.smooth(net, {z: own.zs}, compiled=compiled)
        assert posterior.log_evidence == pytest.approx(float(static.log_evidence), abs=1e-11)
        for t in range(1, T + 1):
            close(posterior[u.at(t)], static[u.at(t)].mean, static[u.at(t)].cov, 1e-11)


def test_arrays_tell_the_number_of_steps_and_take_no_other():
    net = model(control=False)
    assert (net.steps, net.transition[0].steps, net.observation[0].steps) == (T, T, T)
    sighted = {z: pgm.sightings(own.zs[2:4], step=[3, 4])}
    assert pgm.filter(net, sighted)[x].mean.shape == (T + 1, 2)
    cpd = net.transition[0]
    asked = [
        (lambda: pgm.filter(net, {z: own.zs}, steps=5), pgm.EvidenceError, "5 steps are asked for"),
        (lambda: pgm.filter(net, {z: own.zs[:4]}), pgm.EvidenceError, "z has 4 rows"),
        (lambda: pgm.compile(net, 3), pgm.GraphError, "give its arrays 3 entries, or steps=6"),
        (lambda: net.unroll(3), pgm.ModelError, "3 steps are asked for"),
        (lambda: net.sample(steps=9, rng=0), pgm.EvidenceError, "9 steps are asked for"),
    ]
    for call, error, words in asked:
        with pytest.raises(error, match=words) as caught:
            call()
        assert caught.value.cpd is cpd
        assert repr(cpd) in str(caught.value)
    with pytest.raises(pgm.EvidenceError, match="a sighting of z at step 0: LinearGaussianCPD"):
        pgm.filter(net, {z: pgm.sightings(own.zs[:2], step=[0, 1])})


def test_a_cpd_at_a_step_has_its_numbers():
    cpd = model().transition[0]
    placed = cpd.at(2)
    assert (placed.steps, placed.origin) == (None, cpd)
    assert_array_equal(placed.matrices[x.at(1)], own.F[1])
    assert_array_equal(placed.offset, own.b[1])
    assert_array_equal(placed.cov, own.Q[1])
    assert "each of the steps 1..6; of step 1" in str(cpd)
    values = {x.at(1): [1.0, 2.0], u.at(2): [0.5]}
    mean = own.F[1] @ [1.0, 2.0] + own.B[1] @ [0.5] + own.b[1]
    due = pgm.GaussianCPD(x, mean, own.Q[1]).log_density([0.0, 1.0])
    assert placed.log_density([0.0, 1.0], values) == pytest.approx(float(due), abs=1e-12)
    with pytest.raises(pgm.ModelError, match=r"cpd.at\(step\) has the numbers of one step"):
        cpd.log_density([0.0, 1.0], {x.previous: [1.0, 2.0], u: [0.5]})
    with pytest.raises(pgm.ModelError, match="none of step 7"):
        cpd.at(7)
    for same in (pickle.loads(pickle.dumps(model())), copy.deepcopy(model())):
        found = pgm.smooth(same, {same.inputs[0]: own.us, same.sensors[0]: own.zs})
        close(found[x], pgm.smooth(model(), {u: own.us, z: own.zs})[x].mean, found[x].cov)


REFUSED = [
    ({"F": own.F[:5]}, "found 5 of the matrix of x"),
    ({"F": own.F[:0]}, "entry for each of no steps"),
    ({"F": own.F[None]}, r"\(2, 2\) was due or, for T steps that differ, \(T, 2, 2\)"),
    ({"F": own.F[..., :1]}, r"\(T, 2, 2\)"),
    ({"F": np.where(own.F[2] == own.F, np.nan, own.F)}, "NaN or infinite"),
    ({"b": own.b.T}, r"\(2,\) was due or, for T steps that differ, \(T, 2\)"),
    ({"b": own.b[:4]}, "4 of the offset"),
    ({"Q": np.ones((T, 2))}, r"cov\[..., None\] \* np.eye"),
    ({"Q": own.Q[None]}, r"\(T, 2, 2\)"),
    ({"Q": -own.Q}, "at step 1 has the negative variance"),
    ({"Q": np.where(np.arange(T)[:, None, None] == 3, np.inf, own.Q)}, "at step 4"),
]


@pytest.mark.parametrize(("changed", "words"), REFUSED)
def test_other_shapes_are_refused(changed, words):
    found = {"F": own.F, "b": own.b, "Q": own.Q} | changed
    with pytest.raises(pgm.ModelError, match=words) as caught:
        pgm.LinearGaussianCPD(x, {x.previous: found["F"]}, found["Q"], offset=found["b"])
    assert caught.value.variable in (x, x.previous)


def test_there_is_no_step_in_priors_static_networks_and_plates():
    still = pgm.LinearGaussianCPD(x, {}, own.Q)
    moved = model(control=False).transition
    with pytest.raises(pgm.ModelError, match="the prior is of step 0 alone"):
        pgm.DynamicBayesianNetwork([still], moved)
    for made in (pgm.BayesianNetwork, pgm.MarkovNetwork):
        with pytest.raises(pgm.ModelError, match="a network without time has no steps"):
            made([still])
    with pytest.raises(pgm.ModelError, match="a plate stands in a network without time"):
        pgm.plate(still, {x: pgm.variables("a b")})
    sensor = pgm.LinearGaussianCPD(z, {x: own.H[:3]}, 1.0)
    with pytest.raises(pgm.ModelError, match="has arrays of 3 steps, and LinearGaussian"):
        pgm.DynamicBayesianNetwork([prior], moved, [sensor])
    with pytest.raises(pgm.ModelError, match="singular"):
        pgm.LinearGaussianCPD(z, {x: own.H}, 0.0 * own.R, noise=pgm.StudentT(3.0))


def test_what_is_the_same_at_all_steps_is_learnt_beside_what_is_not():
    """The M step of a covariance has residuals by the matrix of each step."""
    one = Numbers(4)
    net = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(x, [0.0, 0.0], 1e-12)],
        [pgm.LinearGaussianCPD(x, {x.previous: one.F}, 1e-12)],
        [pgm.LinearGaussianCPD(z, {x: one.H}, 0.7, offset=one.c)],
    )
    found = pgm.fit(net, {z: one.zs}, learn={z: Covariance()}, iterations=50)
    due = np.mean((one.zs - one.c) ** 2)
    assert_allclose(found.model.observation[0].cov, [[due]], rtol=1e-6)
    assert_array_equal(found.model.observation[0].offset, one.c)
    scaled = net.replace(observation=[pgm.LinearGaussianCPD(z, {x: 1e-9 * one.H}, one.R)])
    found = pgm.fit(scaled, {z: one.zs}, learn={z: Covariance("scaled")}, iterations=50)
    factor = np.mean(one.zs**2 / one.R[..., 0])
    assert_allclose(found.model.observation[0].cov.covs, factor * one.R, rtol=1e-6)
    for part, words in [
        (Coefficients(), "the matrix of x is another at each step"),
        (Offset(), "its offset is another at each step"),
    ]:
        with pytest.raises(pgm.ModelError, match=words):
            pgm.fit(net, {z: one.zs}, learn={z: part})
    with pytest.raises(pgm.ModelError, match="its noise is another at each step"):
        pgm.fit(scaled, {z: one.zs}, learn={z: Covariance()})
    rated = pgm.fit(hidden_markov(), {z: own.zs}, learn={mode: Table()}, iterations=2, tolerance=0)
    assert rated.log_evidence[-1] >= rated.log_evidence[0]


def test_measurements_are_foretold_with_the_numbers_of_their_steps():
    net = model(control=False)
    read = {z: own.zs[:3]}
    whole = dense(control=False)
    for compiled in (False, True):
        posterior = pgm.filter(net, read, steps=T, compiled=compiled)
        for t in range(1, T + 1):
            before = {("z", s): own.zs[s - 1] for s in range(1, min(t - 1, 3) + 1)}
            close(posterior.predicted[z.at(t)], *whole.given(before)[0].marginal(("z", t)))
        given = whole.given({("z", s): own.zs[s - 1] for s in (1, 2, 3)})[0]
        close(pgm.smooth(net, read, steps=T)[z.at(5)], *given.marginal(("z", 5)))
    robot = pgm.OnlineFilter(net)
    belief = robot.initial()
    for t in range(3):
        belief = robot.update(robot.predict(belief), {z: own.zs[t]})
    recorded, innovation = posterior.innovations[z], belief.innovations[z]
    assert_allclose(innovation.residual, recorded.residual[2], atol=1e-12)
    assert_allclose(innovation.cov, recorded.cov[2], atol=1e-12)
    with pytest.raises(pgm.EvidenceError, match="at step 0"):
        posterior.predicted[z.at(0)]
