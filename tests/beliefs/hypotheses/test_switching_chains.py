"""Chains of modes and continuous states against sums over all sequences of modes."""

import numpy as np
import pytest
from filterpy.kalman import IMMEstimator, KalmanFilter
from scipy.stats import multivariate_normal

import pgm
from pgm.beliefs.hypotheses import cases
from tests.beliefs.hypotheses.enumerated import drawn

X, Z, U = pgm.Variable("x"), pgm.Variable("z"), pgm.Variable("u")
MODE = pgm.Discrete("mode", states=("calm", "wild"))
TABLE = [[0.9, 0.1], [0.2, 0.8]]


def walk(given=MODE, q=(0.01, 4.0), sensor=None, prior=1.0):
    """A target that drifts calmly or wildly."""
    motions = {k: pgm.LinearGaussianCPD(X, {X.previous: 1.0}, cov=v) for k, v in enumerate(q)}
    return pgm.DynamicBayesianNetwork(
        prior=[pgm.TableCPD(MODE, table=[0.5, 0.5]), pgm.GaussianCPD(X, 0.0, prior)],
        transition=[
            pgm.TableCPD(MODE, given=MODE.previous, table=TABLE),
            pgm.SwitchingCPD(X, given=given, cases=motions),
        ],
        observation=[sensor or pgm.LinearGaussianCPD(Z, {X: 1.0}, cov=0.25)],
    )


READ = {Z: [[0.1], [0.0], [3.0], [5.5], [5.4]]}


def far(found, wanted):
    """The largest difference of two arrays."""
    return float(np.abs(np.asarray(found) - np.asarray(wanted)).max())


@pytest.mark.parametrize("seed", range(12))
def test_as_many_gaussians_as_paths_are_exact(seed):
    rng = np.random.default_rng(seed)
    modes, steps = int(rng.integers(2, 4)), 4
    world = drawn(rng, modes, int(rng.integers(1, 4)), int(rng.integers(1, 3)), zeros=seed % 2 == 1)
    values = world.drawn(rng, steps)
    if seed % 3 == 0:
        values[1] = np.nan
    evidence, p, mean, cov = world.enumerated(values)
    found = pgm.smooth(world.model, {world.z: values}, belief=pgm.Gaussians(modes ** (steps + 1)))
    assert far(found.log_evidence, evidence) < 1e-10
    assert far(found[world.mode].probabilities, p) < 1e-10
    assert far(found[world.x].mean, mean) < 1e-10
    assert far(found[world.x].cov, cov) < 1e-10
    last = found.filtered
    assert far(last[world.mode].probabilities[-1], p[-1]) < 1e-10
    assert far(last[world.x].mean[-1], mean[-1]) < 1e-10


def test_filtered_and_lagged_beliefs_know_no_later_reading():
    rng = np.random.default_rng(5)
    world = drawn(rng, 2, 2, 1)
    values = world.drawn(rng, 4)
    many = pgm.Gaussians(32)
    filtered = pgm.filter(world.model, {world.z: values}, belief=many)
    lagged = pgm.smooth(world.model, {world.z: values}, lag=2, belief=many)
    assert str(lagged.kind) == "fixed-lag (2)"
    for step in range(5):
        known = values.copy()
        known[step:] = np.nan
        _, p, mean, _ = world.enumerated(known)
        assert far(filtered[world.mode.at(step)].probabilities, p[step]) < 1e-10
        assert far(filtered[world.x.at(step)].mean, mean[step]) < 1e-10
        known = values.copy()
        known[step + 2 :] = np.nan
        _, p, mean, cov = world.enumerated(known)
        assert far(lagged[world.mode.at(step)].probabilities, p[step]) < 1e-10
        assert far(lagged[world.x.at(step)].cov, cov[step]) < 1e-10


def test_few_gaussians_are_near_in_models_whose_modes_differ_in_all():
    rng = np.random.default_rng(3)
    errors = {count: [] for count in (2, 8)}
    for _ in range(30):
        world = drawn(rng, 2, int(rng.integers(1, 4)), int(rng.integers(1, 3)))
        values = world.drawn(rng, 8)
        evidence, p, _, _ = world.enumerated(values)
        for count, own in errors.items():
            found = pgm.smooth(world.model, {world.z: values}, belief=pgm.Gaussians(count))
            off = far(found[world.mode].probabilities[1:], p[1:])
            own.append((off, far(found.log_evidence, evidence)))
    two, eight = (np.mean(errors[count], axis=0) for count in (2, 8))
    assert two[0] < 0.03
    assert eight[0] < 0.003
    assert eight[1] < 0.003


def test_the_default_is_as_many_gaussians_as_modes():
    few, two = pgm.filter(walk(), READ), pgm.filter(walk(), READ, belief=pgm.Gaussians(2))
    assert far(few.log_evidence, two.log_evidence) == 0.0
    assert few[X].weights.shape == (6, 2)


@pytest.mark.parametrize("modes", [2, 3, 5])
def test_mixed_gaussians_are_the_interacting_multiple_model_of_filterpy(modes):
    rng = np.random.default_rng(modes)
    f = [np.eye(4) + 0.1 * rng.standard_normal((4, 4)) for _ in range(modes)]
    q = [(k + 1.0) * np.eye(4) * 0.1 for k in range(modes)]
    h = rng.standard_normal((2, 4))
    table, first = rng.dirichlet(np.ones(modes), modes), rng.dirichlet(np.ones(modes))
    values = rng.standard_normal((30, 2))
    x, z = (
        pgm.Variable(n, components=tuple(f"{n}{k}" for k in range(d)))
        for n, d in (("x", 4), ("z", 2))
    )
    mode = pgm.Discrete("mode", states=tuple(f"s{k}" for k in range(modes)))
    motions = {k: pgm.LinearGaussianCPD(x, {x.previous: f[k]}, cov=q[k]) for k in range(modes)}
    model = pgm.DynamicBayesianNetwork(
        prior=[pgm.TableCPD(mode, table=first), pgm.GaussianCPD(x, np.zeros(4), np.eye(4))],
        transition=[
            pgm.TableCPD(mode, given=mode.previous, table=table),
            pgm.SwitchingCPD(x, given=mode, cases=motions),
        ],
        observation=[pgm.LinearGaussianCPD(z, {x: h}, cov=0.3)],
    )
    filters = []
    for k in range(modes):
        own = KalmanFilter(4, 2)
        own.x, own.P, own.F, own.Q = np.zeros((4, 1)), np.eye(4), f[k], q[k]
        own.H, own.R = h, 0.3 * np.eye(2)
        filters.append(own)
    other = IMMEstimator(filters, first.copy(), table)
    found = pgm.filter(model, {z: values}, belief=pgm.Gaussians(mix=True))
    for step, value in enumerate(values, 1):
        other.predict()
        other.update(value[:, None])
        assert far(found[mode.at(step)].probabilities, other.mu) < 1e-10
        assert far(found[x.at(step)].mean, other.x[:, 0]) < 1e-9


def test_mixed_gaussians_are_smoothed_as_mixed():
    """One step, of which the mixture is exact: what flows back is exact, too."""
    few = pgm.smooth(walk(), {Z: [[2.0]]}, belief=pgm.Gaussians(mix=True))
    exact = pgm.smooth(walk(), {Z: [[2.0]]}, belief=pgm.Gaussians(8))
    assert far(few[MODE].probabilities, exact[MODE].probabilities) < 1e-12
    assert far(few[X].mean, exact[X].mean) < 1e-12
    assert far(few[X].cov, exact[X].cov) < 1e-12
    several = pgm.smooth(walk(), READ, belief=pgm.Gaussians(mix=True))
    exact = pgm.smooth(walk(), READ, belief=pgm.Gaussians(64))
    assert far(several[MODE].probabilities, exact[MODE].probabilities) < 0.05


def test_runs_are_each_as_if_alone(monkeypatch):
    rng = np.random.default_rng(2)
    world = drawn(rng, 2, 2, 1)
    values = np.array([world.drawn(rng, 7) for _ in range(6)])
    values[1, 2] = np.nan
    whole = {}
    for count in (2, 5):
        belief = pgm.Gaussians(count)
        whole[count] = pgm.smooth(world.model, {world.z: values.reshape(2, 3, 7, 1)}, belief=belief)
        for run in range(6):
            alone = pgm.smooth(world.model, {world.z: values[run]}, belief=belief)
            at = divmod(run, 3)
            assert far(whole[count].log_evidence[at], alone.log_evidence) < 1e-12
            assert far(whole[count][world.x].mean[at], alone[world.x].mean) < 1e-12
            own = whole[count][world.mode].probabilities[at]
            assert far(own, alone[world.mode].probabilities) < 1e-12
    monkeypatch.setattr(cases, "_WINDOW", 50)  # so that evidence is repeated for a step or two
    again = pgm.smooth(world.model, {world.z: values.reshape(2, 3, 7, 1)}, belief=pgm.Gaussians(5))
    assert far(again[world.x].cov, whole[5][world.x].cov) < 1e-12


@pytest.mark.parametrize("rule", [pgm.Taylor(), pgm.Unscented()])
def test_nonlinear_cases_are_weighted_filters_of_each_path(rule):
    """Each sequence of modes is an ordinary chain, whose functions read the mode as an input."""
    mode = pgm.Variable("which")

    def turn(x, k=None):
        return np.sin(x) + x if k is None else np.where(k > 0.5, np.sin(x) + x, 0.5 * x)

    def look(x, k=None):
        return x**2 if k is None else np.where(k > 0.5, x, x**2)

    switching = pgm.DynamicBayesianNetwork(
        prior=[pgm.TableCPD(MODE, table=[0.3, 0.7]), pgm.GaussianCPD(X, 1.0, 0.2)],
        transition=[
            pgm.TableCPD(MODE, given=MODE.previous, table=TABLE),
            pgm.SwitchingCPD(
                X,
                given=MODE,
                cases={
                    0: pgm.LinearGaussianCPD(X, {X.previous: 0.5}, cov=0.1),
                    1: pgm.NonlinearGaussianCPD(X, X.previous, turn, cov=0.3),
                },
            ),
        ],
        observation=[
            pgm.SwitchingCPD(
                Z,
                given=MODE,
                cases={
                    0: pgm.NonlinearGaussianCPD(Z, X, look, cov=0.2),
                    1: pgm.LinearGaussianCPD(Z, {X: 1.0}, cov=0.2),
                },
            )
        ],
    )
    noise = pgm.noise(lambda k: np.where(k > 0.5, 0.3, 0.1)[..., None], given=mode)
    ordinary = pgm.DynamicBayesianNetwork(
        prior=[pgm.GaussianCPD(X, 1.0, 0.2)],
        transition=[pgm.NonlinearGaussianCPD(X, (X.previous, mode), turn, cov=noise)],
        observation=[pgm.NonlinearGaussianCPD(Z, (X, mode), look, cov=0.2)],
    )
    values = np.array([[1.1], [0.7], [1.9]])
    paths = np.array(np.meshgrid(*[[0, 1]] * 4, indexing="ij")).reshape(4, -1).T
    table = np.array(TABLE)
    logs = np.log(np.array([0.3, 0.7])[paths[:, 0]])
    for a, b in zip(paths.T[:-1], paths.T[1:], strict=True):
        logs = logs + np.log(table[a, b])
    evidence = {Z: np.tile(values, (len(paths), 1, 1)), mode: paths[:, 1:, None].astype(float)}
    each = pgm.filter(ordinary, evidence, lineariser=rule)
    logs = logs + each.log_evidence
    share = np.exp(logs - np.logaddexp.reduce(logs))
    found = pgm.filter(switching, {Z: values}, lineariser=rule, belief=pgm.Gaussians(16))
    assert far(found.log_evidence, np.logaddexp.reduce(logs)) < 1e-12
    assert far(found[X.at(3)].mean, share @ each[X.at(3)].mean) < 1e-12
    wanted = [share[paths[:, 3] == k].sum() for k in (0, 1)]
    assert far(found[MODE.at(3)].probabilities, wanted) < 1e-12
    smoothed = pgm.smooth(switching, {Z: values}, lineariser=rule, belief=pgm.Gaussians(16))
    later = pgm.smooth(ordinary, evidence, lineariser=rule)
    assert far(smoothed[X].mean[:, 0], share @ later[X].mean[..., 0]) < 1e-12


def observed_world():
    """A model whose motion and sensor an observed variable chooses, too; and its evidence."""
    rng = np.random.default_rng(0)
    ground = pgm.Discrete("ground", states=("ice", "sand"))
    slips = {(a, b): (0.3 + 0.4 * a + 0.2 * b, 0.1 + 0.3 * b) for a in (0, 1) for b in (0, 1)}
    model = pgm.DynamicBayesianNetwork(
        prior=[pgm.TableCPD(MODE, table=[0.4, 0.6]), pgm.GaussianCPD(X, 0.0, 1.0)],
        transition=[
            pgm.TableCPD(MODE, given=MODE.previous, table=TABLE),
            pgm.SwitchingCPD(
                X,
                given=(ground, MODE),
                cases={
                    k: pgm.LinearGaussianCPD(X, {X.previous: f, U: 1.0}, cov=q)
                    for k, (f, q) in slips.items()
                },
            ),
        ],
        observation=[
            pgm.SwitchingCPD(
                Z,
                given=(ground, MODE),
                cases={
                    k: pgm.LinearGaussianCPD(Z, {X: 2 * f}, cov=q + 0.1)
                    for k, (f, q) in slips.items()
                },
            )
        ],
    )
    read, pushed = rng.normal(size=(2, 3, 4, 1))
    return model, ground, {Z: read, U: pushed, ground: rng.integers(0, 2, (3, 4))}


def unrolled(model, evidence, run, steps):
    """The static mixed network of all steps, whose beliefs are exact, with the run's evidence."""
    static = {
        v.at(t): np.asarray(values)[run, t - 1]
        for v, values in evidence.items()
        for t in range(1, steps + 1)
    }
    return pgm.infer(pgm.compile(model.unroll(steps)), static)


def test_observed_variables_choose_motions_and_sensors():
    model, ground, evidence = observed_world()
    found = pgm.smooth(model, evidence, belief=pgm.Gaussians(32))
    for run in range(3):
        exact = unrolled(model, evidence, run, 4)
        even = 4 * np.log(ground.size)  # of the observed variable, which has no CPD over time
        assert far(found.log_evidence[run], exact.log_evidence + even) < 1e-12
        for step in range(5):
            assert far(found[X].mean[run, step], exact[X.at(step)].mean) < 1e-12
            own = found[MODE].probabilities[run, step]
            assert far(own, exact[MODE.at(step)].probabilities) < 1e-12


def test_observed_variables_alone_choose_among_motions_and_leave_one_gaussian():
    model, ground, evidence = observed_world()
    motion = {k: c for (k, m), c in model.transition[1].cases.items() if m == 0}
    sensor = {k: c for (k, m), c in model.observation[0].cases.items() if m == 0}
    model = pgm.DynamicBayesianNetwork(
        prior=model.prior[1:],
        transition=[pgm.SwitchingCPD(X, given=ground, cases=motion)],
        observation=[pgm.SwitchingCPD(Z, given=ground, cases=sensor)],
    )
    found = pgm.smooth(model, evidence)
    assert found[X].weights.shape == (3, 5, 1)
    for run in range(3):
        exact = unrolled(model, evidence, run, 4)
        assert far(found[X].mean[run, 2], exact[X.at(2)].mean) < 1e-12


def test_sightings_say_in_which_state_each_was_taken():
    fault = pgm.Discrete("fault", states=("no", "yes"))
    sensor = pgm.SwitchingCPD(
        Z,
        given=fault,
        cases={
            0: pgm.LinearGaussianCPD(Z, {X: 1.0}, cov=0.25),
            1: pgm.LinearGaussianCPD(Z, {X: 1.0}, cov=25.0),
        },
    )
    seen = pgm.sightings([[0.1], [3.0], [2.0]], step=[1, 1, 2], given={fault: [0, 1, 0]})
    found = pgm.filter(walk(sensor=sensor), {Z: seen}, steps=2, belief=pgm.Gaussians(8))
    other = pgm.Variable("other")
    twin = walk().replace(
        observation=[
            pgm.LinearGaussianCPD(Z, {X: 1.0}, cov=0.25),
            pgm.LinearGaussianCPD(other, {X: 1.0}, cov=25.0),
        ]
    )
    read = {
        Z: pgm.sightings([[0.1], [2.0]], step=[1, 2]),
        other: pgm.sightings([[3.0]], step=[1]),
    }
    wanted = pgm.filter(twin, read, steps=2, belief=pgm.Gaussians(8))
    assert far(found.log_evidence, wanted.log_evidence) < 1e-12
    assert far(found[X].mean, wanted[X].mean) < 1e-12


def test_a_motion_may_depend_on_the_mode_before_and_tables_on_several_variables():
    turn = pgm.Discrete("turn", states=("left", "right", "none"))
    rng = np.random.default_rng(4)
    table = rng.dirichlet(np.ones(3), (3, 2))
    motion = {
        (a, b, c): pgm.LinearGaussianCPD(
            X, {X.previous: rng.normal()}, cov=rng.uniform(0.1, 1.0), offset=rng.normal()
        )
        for a in range(2)
        for b in range(2)
        for c in range(3)
    }
    gauge, size = pgm.Discrete("gauge", states=("low", "high")), pgm.Variable("size")
    model = pgm.DynamicBayesianNetwork(
        prior=[
            pgm.TableCPD(MODE, table=[0.5, 0.5]),
            pgm.TableCPD(turn, given=MODE, table=rng.dirichlet(np.ones(3), 2)),
            pgm.SwitchingCPD(
                X,
                given=turn,
                cases={k: pgm.GaussianCPD(X, float(k), 1.0 + k) for k in range(3)},
            ),
        ],
        transition=[
            pgm.TableCPD(MODE, given=MODE.previous, table=TABLE),
            pgm.TableCPD(turn, given=(turn.previous, MODE), table=table),
            pgm.SwitchingCPD(X, given=(MODE.previous, MODE, turn), cases=motion),
        ],
        observation=[
            pgm.LinearGaussianCPD(Z, {X: 1.0}, cov=0.25),
            pgm.TableCPD(gauge, given=turn, table=[[0.9, 0.1], [0.5, 0.5], [0.2, 0.8]]),
            pgm.SwitchingCPD(
                size,
                given=MODE,
                cases={k: pgm.GaussianCPD(size, float(k), 0.5) for k in range(2)},
            ),
        ],
    )
    evidence = {Z: [[[0.5], [1.0], [-1.0]]], gauge: [[0, 1, 0]], size: [[[0.2], [0.9], [0.1]]]}
    found = pgm.smooth(model, evidence, belief=pgm.Gaussians(6**4))
    exact = unrolled(model, evidence, 0, 3)
    assert far(found.log_evidence, exact.log_evidence) < 1e-12
    for step in range(4):
        for v in (MODE, turn):
            own = found[v].probabilities[0, step]
            assert far(own, exact[v.at(step)].probabilities) < 1e-12
        assert far(found[X].mean[0, step], exact[X.at(step)].mean) < 1e-12
    joint = found.joint(turn.at(2), MODE.at(2)).probabilities[0]
    assert far(joint, exact.joint(turn.at(2), MODE.at(2)).probabilities) < 1e-12
    few = pgm.smooth(model, evidence)
    assert few[X].weights.shape[-1] == 6
    assert far(few.log_evidence, exact.log_evidence) < 0.05


def outlier(right, wrong):
    """A still target, with readings that are sometimes of another kind, which none remembers."""
    kind = pgm.Discrete("kind", states=("right", "wrong"))
    model = pgm.DynamicBayesianNetwork(
        prior=[pgm.GaussianCPD(X, 0.0, 1.0)],
        transition=[
            pgm.TableCPD(kind, table=[0.7, 0.3]),
            pgm.LinearGaussianCPD(X, {X.previous: 1.0}, cov=0.1),
        ],
        observation=[pgm.SwitchingCPD(Z, given=kind, cases={"right": right, "wrong": wrong})],
    )
    return model, kind


def test_modes_that_nothing_remembers_leave_one_gaussian():
    model, kind = outlier(
        pgm.LinearGaussianCPD(Z, {X: 1.0}, cov=0.25), pgm.GaussianCPD(Z, 0.0, 100.0)
    )
    found = pgm.filter(model, {Z: [[0.5], [8.0]]})
    assert found[X].weights.shape == (3, 1)
    # The probabilistic data association of one reading, in ten lines.
    mean, var = 0.0, 1.0
    for step, z in enumerate((0.5, 8.0), 1):
        var += 0.1
        each = multivariate_normal.pdf(z, mean, var + 0.25), multivariate_normal.pdf(z, 0, 100)
        logs = np.log(np.array([0.7, 0.3]) * each)
        right, wrong = np.exp(logs - np.logaddexp(*logs))
        gain = var / (var + 0.25)
        moved, shrunk = mean + gain * (z - mean), (1 - gain) * var
        new = right * moved + wrong * mean
        var = right * (shrunk + (moved - new) ** 2) + wrong * (var + (mean - new) ** 2)
        mean = new
        assert far(found[X.at(step)].mean, mean) < 1e-12
        assert far(found[X.at(step)].cov, var) < 1e-12
        assert far(found[kind.at(step)].probabilities, [right, wrong]) < 1e-12


@pytest.mark.parametrize("count", [None, 8])
def test_a_certain_reading_outweighs_every_density(count):
    """A sensor that is stuck says 7 exactly; when it works it is as unlikely as may be to do so."""
    model, kind = outlier(pgm.LinearGaussianCPD(Z, {X: 1.0}, cov=0.5), pgm.GaussianCPD(Z, 7.0, 0.0))
    runs = np.array([[[7.0], [0.5], [7.0]], [[0.1], [0.2], [0.3]]])
    found = pgm.smooth(model, {Z: runs}, belief=pgm.Gaussians(count))
    assert far(found[kind].probabilities[..., 0], [[0, 1, 0], [1, 1, 1]]) == 0.0
    wanted = 2 * np.log(0.3) + np.log(0.7) + multivariate_normal.logpdf(0.5, 0.0, 1.2 + 0.5)
    assert far(found.log_evidence[0], wanted) < 1e-12
    still = outlier(pgm.LinearGaussianCPD(Z, {X: 1.0}, cov=0.5), pgm.GaussianCPD(Z, 0.0, 9.0))[0]
    missing = np.where(runs == 7.0, np.nan, runs)
    plain = pgm.smooth(
        still.replace(
            transition=still.transition[1:], observation=[still.observation[0].cases[0,]]
        ),
        {Z: missing},
    )
    assert far(found[X].mean[0], plain[X].mean[0]) < 1e-12
    assert far(found[X].cov[0], plain[X].cov[0]) < 1e-12


def test_what_is_certain_is_counted_over_all_readings():
    """Each of two hypotheses makes one of two readings certain: densities decide between them."""
    bias = pgm.Discrete("bias", states=("a", "b"))
    other = pgm.Variable("other")
    exact = pgm.LinearGaussianCPD(Z, {X: 1.0}, cov=0.0)
    noisy = pgm.LinearGaussianCPD(Z, {X: 1.0}, cov=1.0)
    exact2 = pgm.LinearGaussianCPD(other, {X: 1.0}, cov=0.0)
    noisy2 = pgm.LinearGaussianCPD(other, {X: 1.0}, cov=2.0)
    model = pgm.DynamicBayesianNetwork(
        prior=[pgm.TableCPD(bias, table=[0.5, 0.5]), pgm.GaussianCPD(X, 1.0, 0.0)],
        transition=[
            pgm.TableCPD(bias, given=bias.previous, table=np.eye(2)),
            pgm.LinearGaussianCPD(X, {X.previous: 1.0}, cov=0.0),
        ],
        observation=[
            pgm.SwitchingCPD(Z, given=bias, cases={"a": exact, "b": noisy}),
            pgm.SwitchingCPD(other, given=bias, cases={"a": noisy2, "b": exact2}),
        ],
    )
    read = {Z: pgm.sightings([[1.0]], step=[1]), other: pgm.sightings([[1.0]], step=[2])}
    found = pgm.smooth(model, read, steps=2)
    assert far(found.filtered[bias.at(1)].probabilities, [1.0, 0.0]) == 0.0
    densities = (
        multivariate_normal.pdf(0.0, 0.0, [[2.0]]),
        multivariate_normal.pdf(0.0, 0.0, [[1.0]]),
    )
    wanted = np.array(densities) / sum(densities)
    assert far(found[bias].probabilities, np.tile(wanted, (3, 1))) < 1e-12
    assert far(found.log_evidence, np.log(0.5 * sum(densities))) < 1e-12


def test_a_contradiction_is_no_error_while_a_hypothesis_is_left():
    model, kind = outlier(pgm.GaussianCPD(Z, 3.0, 0.0), pgm.GaussianCPD(Z, 7.0, 0.0))
    found = pgm.filter(model, {Z: [[3.0], [7.0]]})
    assert far(found[kind].probabilities, [[1, 0], [0, 1]]) == 0.0
    assert far(found.log_evidence, np.log(0.7 * 0.3)) < 1e-12


def test_impossible_readings_are_refused_with_run_and_step():
    model, _ = outlier(
        pgm.LinearGaussianCPD(Z, {X: 0.0}, offset=3.0, cov=0.0), pgm.GaussianCPD(Z, 7.0, 0.0)
    )
    with pytest.raises(pgm.NumericalError, match="step 2, run 1, have probability zero") as caught:
        pgm.filter(model, {Z: [[[3.0], [7.0]], [[3.0], [4.0]]]})
    assert (caught.value.step, caught.value.run) == (2, 1)


def test_angles_are_merged_on_the_branch_of_the_likeliest():
    """Two modes turn a heading by half a turn, one way or the other: they are one heading."""
    heading = pgm.Variable("heading", angles=("heading",))
    compass = pgm.Variable("compass", angles=("compass",))
    way = pgm.Discrete("way", states=("left", "right"))
    model = pgm.DynamicBayesianNetwork(
        prior=[pgm.GaussianCPD(heading, 0.0, 0.01)],
        transition=[
            pgm.TableCPD(way, table=[0.5, 0.5]),
            pgm.SwitchingCPD(
                heading,
                given=way,
                cases={
                    k: pgm.LinearGaussianCPD(
                        heading, {heading.previous: 1.0}, offset=s * (np.pi - 0.01), cov=0.01
                    )
                    for k, s in enumerate((1.0, -1.0))
                },
            ),
        ],
        observation=[pgm.LinearGaussianCPD(compass, {heading: 1.0}, cov=0.04)],
    )
    for read in (3.1, -3.1):
        found = pgm.smooth(model, {compass: [[read], [0.0]]})
        assert found[heading].std.max() < 0.2
        mean = found[heading].mean[:, 0]
        away = np.angle(np.exp(1j * (mean - [0.0, np.pi, 0.0])))
        assert np.abs(away).max() < 0.1


def test_beliefs_that_are_certain_of_something_can_be_merged():
    """One component of the state has no variance: divergences are found all the same."""
    x = pgm.Variable("x", components=("a", "b"))
    moves = {
        k: pgm.LinearGaussianCPD(
            x, {x.previous: [[1.0, 0.0], [k, 1.0]]}, cov=np.diag([0.0, 0.1 + k])
        )
        for k in (0, 1)
    }
    model = pgm.DynamicBayesianNetwork(
        prior=[
            pgm.TableCPD(MODE, table=[0.5, 0.5]),
            pgm.GaussianCPD(x, [1.0, 0.0], np.zeros((2, 2))),
        ],
        transition=[
            pgm.TableCPD(MODE, given=MODE.previous, table=TABLE),
            pgm.SwitchingCPD(x, given=MODE, cases=moves),
        ],
        observation=[pgm.LinearGaussianCPD(Z, {x: [[0.0, 1.0]]}, cov=0.2)],
    )
    read = {Z: [[0.3], [1.2], [1.0], [2.0]]}
    few = pgm.smooth(model, read, belief=pgm.Gaussians(4))
    many = pgm.smooth(model, read, belief=pgm.Gaussians(64))
    assert far(few[MODE].probabilities, many[MODE].probabilities) < 0.02
    assert far(few[x].mean, many[x].mean) < 0.05
    assert far(few[x].mean[..., 0], 1.0) < 1e-12


def test_each_mode_keeps_a_gaussian_however_unlikely():
    """One seed a mode: else the mass of an unlikely mode would move to others."""
    tall = walk(q=(0.01, 0.0101))
    found = pgm.filter(tall, {Z: np.zeros((5, 1))}, belief=pgm.Gaussians(3))
    exact = pgm.filter(tall, {Z: np.zeros((5, 1))}, belief=pgm.Gaussians(64))
    assert far(found[MODE].probabilities, exact[MODE].probabilities) < 1e-3


def test_a_drawn_world_is_filtered_as_it_was_drawn():
    drawn_world = walk().sample(steps=40, runs=50, rng=0)
    found = pgm.smooth(walk(), drawn_world.evidence)
    right = found[MODE].probabilities.argmax(axis=-1) == drawn_world[MODE]
    assert right.mean() > 0.85
    error = found[X].mean - drawn_world[X]
    nees = (error[..., 0] ** 2 / found[X].cov[..., 0, 0]).mean()
    assert 0.9 < nees < 1.1


def test_linearisations_of_a_filter_may_be_repeated():
    sensor = pgm.NonlinearGaussianCPD(Z, X, lambda x: np.exp(x), cov=0.01)
    model = walk(sensor=sensor)
    read = {Z: [[1.5], [2.0]]}
    once, often = (pgm.filter(model, read, iterations=n) for n in (1, 50))
    assert not once.status.converged
    assert often.status.converged
    assert often.status.iterations > 2
    assert far(often[X].mean[1], np.log(1.5)) < 0.03 < far(once[X].mean[1], np.log(1.5))


def refused(match, **options):
    with pytest.raises(pgm.PgmError, match=match):
        pgm.filter(walk(), READ, **options)


def test_what_cannot_be_is_refused():
    refused("1 Gaussian for .mode., .* have 2 joint states", belief=pgm.Gaussians(1))
    refused("mix=True keeps a Gaussian for each joint state", belief=pgm.Gaussians(3, mix=True))
    refused("gate= is not for mixtures of Gaussians", gate=0.99)
    refused("Grid.* is for networks of continuous variables", belief=pgm.Grid({X: (-5.0, 5.0, 50)}))
    with pytest.raises(pgm.ModelError, match="a count of Gaussians is a whole number"):
        pgm.Gaussians(0)
    with pytest.raises(pgm.ModelError, match="mix says whether"):
        pgm.Gaussians(2, mix="yes")
    plain = walk().replace(
        prior=walk().prior[1:], transition=[pgm.LinearGaussianCPD(X, {X.previous: 1.0}, cov=1.0)]
    )
    with pytest.raises(pgm.ModelError, match="here is neither: leave belief= out"):
        pgm.filter(plain, READ, belief=pgm.Gaussians(2))
    with pytest.raises(pgm.ModelError, match="belief of infinite variance has none"):
        pgm.filter(walk(prior=np.inf), READ)
    bent = walk(sensor=pgm.NonlinearGaussianCPD(Z, X, np.sin, cov=1.0))
    with pytest.raises(pgm.ModelError, match="linearises again at smoothed beliefs"):
        pgm.smooth(bent, READ, iterations=2)
    before = walk(given=MODE.previous)
    with pytest.raises(pgm.ModelError, match="mix=True mixes the Gaussians of all states"):
        pgm.filter(before, READ, belief=pgm.Gaussians(mix=True))
    found = pgm.filter(walk(), READ)
    with pytest.raises(pgm.EvidenceError, match="joints of variables of one step"):
        found.joint(X.at(1), X.at(2))
    with pytest.raises(pgm.EvidenceError, match="neither a table nor a mixture"):
        found.joint(X, MODE)
    with pytest.raises(pgm.EvidenceError, match="joint takes variables"):
        found.joint()


def test_a_sensor_of_readings_that_no_hidden_variable_has_the_kind_of_is_refused():
    sign = pgm.Discrete("sign", states=("a", "b"))
    with pytest.raises(pgm.ModelError, match="all hidden variables are continuous"):
        pgm.DynamicBayesianNetwork(
            prior=[pgm.GaussianCPD(X, 0.0, 1.0)],
            transition=[pgm.LinearGaussianCPD(X, {X.previous: 1.0}, cov=1.0)],
            observation=[pgm.TableCPD(sign, table=[0.5, 0.5])],
        )
    with pytest.raises(pgm.ModelError, match="are tables, or SwitchingCPDs"):
        pgm.DynamicBayesianNetwork(
            prior=[pgm.TableCPD(MODE, table=[0.5, 0.5])],
            transition=[pgm.TableCPD(MODE, given=MODE.previous, table=TABLE)],
            observation=[pgm.GaussianCPD(Z, 0.0, 1.0)],
        )


@pytest.mark.parametrize("count", [3, 4, 8])
def test_merging_of_equal_gaussians_loses_nothing(count):
    """Steps left and right in either order lead to one place: its two pasts have equal moments.

    Three Gaussians then hold what four do, and the later reading makes the merged one wider.
    """
    x, z = pgm.variables("x z")
    side = pgm.Discrete("side", states=("left", "right"))
    moves = {
        name: pgm.LinearGaussianCPD(x, {x.previous: 1.0}, offset=off, cov=0.01)
        for name, off in (("left", -2.0), ("right", 2.0))
    }
    even = pgm.TableCPD(side, table=[0.5, 0.5])
    model = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(x, 0.0, 1.0)],
        [even, pgm.SwitchingCPD(x, side, moves)],
        [pgm.LinearGaussianCPD(z, {x: 1.0}, cov=0.01)],
    )
    posterior = pgm.smooth(model, {z: [[np.nan], [np.nan], [0.0]]}, belief=pgm.Gaussians(count))
    # The start given the path's sum of moves s: N(−s κ, 1 − κ), where κ = 1 / 1.04.
    moved = np.array([-6.0, -2.0, 2.0, 6.0])
    weight = np.array([1.0, 3.0, 3.0, 1.0]) * np.exp(-0.5 * moved**2 / 1.04)
    weight /= weight.sum()
    var = weight @ (moved / 1.04) ** 2 + 1.0 - 1.0 / 1.04
    np.testing.assert_allclose(posterior[x].cov[0, 0, 0], var, rtol=1e-10)
    np.testing.assert_allclose(posterior[x].mean[0], 0.0, atol=1e-12)
