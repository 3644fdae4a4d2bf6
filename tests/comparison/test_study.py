"""Studies: runs drawn by counters, and their figures against plain means of filters' errors."""

import pickle

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.stats import chi2

import pgm
from pgm.comparison import drawn_runs, studying
from pgm.comparison.study_methods import methods_of
from pgm.comparison.study_rows import rows_of
from pgm.comparison.sums import joined
from pgm.errors import EvidenceError, LinearisationError, ModelError
from pgm.examples import squares, still, walk, x, z

T = 6
p = pgm.Variable("p", components=("east", "heading"), angles=("heading",))
u = pgm.Variable("u")
m = pgm.Variable("m")
r = pgm.Variable("r", components=("range", "bearing"), angles=("bearing",))


def move(p, u):
    return np.stack([p[..., 0] + np.cos(p[..., 1]), p[..., 1] + u[..., 0]], axis=-1)


def sight(p, m):
    return np.stack([np.hypot(p[..., 0], m[..., 0]), m[..., 0] - p[..., 1]], axis=-1)


ROBOT = pgm.DynamicBayesianNetwork(
    [pgm.GaussianCPD(p, [0.0, 3.0], [0.1, 0.02])],
    [pgm.NonlinearGaussianCPD(p, (p.previous, u), move, cov=[0.05, 0.01])],
    [pgm.NonlinearGaussianCPD(r, (p, m), sight, cov=[0.1, 0.05], noise=pgm.StudentT(5.0))],
)
# Two readings at one step, out of order, and steps without any.
INPUTS = {
    u: np.full((T, 1), 0.3),
    r: pgm.sightings(step=[4, 1, 1, 6], given={m: [[1.0], [2.0], [3.0], [4.0]]}),
}
METHODS = {
    "EKF": pgm.Taylor(),
    "IEKF": pgm.Filtering(iterations=3, tolerance=0.0),
    "URTS": (pgm.Unscented(), pgm.Smoothing()),
}


def robots(runs, **given):
    return pgm.study(ROBOT, INPUTS, runs=runs, methods=METHODS, seed=5, **given)


@pytest.fixture(scope="module")
def study():
    return robots(40)


def stacked(study, variable):
    return np.stack([study.run(k)[variable] for k in range(study.runs)])


def test_a_run_is_drawn_by_its_own_counters():
    """Noise of run, row, variable and request, by NumPy's generator alone."""
    drawn = pgm.study(walk, steps=3, runs=30, methods=METHODS, seed=8).run(21)
    key = np.random.Philox(8).state["state"]["key"]

    def normal(row, variable):
        word = np.random.Philox(key=key, counter=[21, row, variable, 0]).random_raw()
        found = (int(word) >> 12) / 2**52 + 2.0**-53
        from scipy.special import ndtri

        return ndtri(found)

    states = np.cumsum([normal(step, 0) for step in range(4)])
    assert_allclose(drawn[x][:, 0], states, rtol=1e-14)
    noise = np.sqrt(2.0) * np.array([normal(row, 1) for row in range(3)])
    assert_allclose(drawn[z][:, 0], states[1:] + noise, rtol=1e-13)


def test_a_run_is_the_same_in_a_longer_study_and_in_smaller_blocks(study, monkeypatch):
    longer = robots(1100)
    monkeypatch.setattr(drawn_runs, "MOST", 8)
    for other in (longer, robots(40)):
        for k in (0, 7, 39):
            for variable in (p, r):
                assert_array_equal(study.run(k)[variable], other.run(k)[variable])
    assert np.isfinite(longer.run(1099)[r]).all()


def test_blocks_in_any_order_give_the_same_digits(monkeypatch):
    monkeypatch.setattr(drawn_runs, "MOST", 8)
    found = robots(30)
    drawn, methods = found._drawn, methods_of(METHODS, ROBOT)
    graph = pgm.compile(ROBOT, T)
    asked = studying._Asked(graph, graph, (p,), 0.95)
    blocks = {k: studying.of_block(drawn, k, methods, asked) for k in reversed(drawn.blocks)}
    assert len(blocks) == 4
    rows = rows_of(joined(blocks[k] for k in drawn.blocks), methods, (p,), 0.95)
    for row, other in zip(found.rows, rows, strict=True):
        for name, statistic in row._statistics().items():
            its = other._statistics()[name]
            for each in ("value", "error", "by_step", "error_by_step"):
                assert_array_equal(getattr(statistic, each), getattr(its, each))


def test_figures_are_plain_means_over_runs(study, monkeypatch):
    monkeypatch.setattr(drawn_runs, "MOST", 16)
    runs = 40
    evidence = {**INPUTS, r: pgm.sightings(stacked(study, r), INPUTS[r].step, INPUTS[r].given)}
    truth = stacked(study, p)
    beliefs = {
        "EKF": pgm.filter(ROBOT, evidence),
        "IEKF": pgm.filter(ROBOT, evidence, iterations=3, tolerance=0.0),
        "URTS": pgm.smooth(ROBOT, evidence, lineariser=pgm.Unscented()),
    }
    for found in (study, robots(runs)):  # of one block, and of three
        assert found["EKF"].unsettled == 0
        for name, posterior in beliefs.items():
            row, belief = found[name], posterior[p]
            error = belief.mean - truth
            error[..., 1] = np.angle(np.exp(1j * error[..., 1]))
            nees = np.einsum("rti,rtij,rtj->rt", error, np.linalg.inv(belief.cov), error)
            held = nees <= chi2.ppf(0.95, 2)
            for statistic, values in ((row.bias, error), (row.nees, nees), (row.coverage, held)):
                assert_allclose(statistic.by_step, values.mean(axis=0), atol=1e-10)
                spread = values.std(axis=0, ddof=1) / np.sqrt(runs)
                assert_allclose(statistic.error_by_step, spread, atol=1e-10)
                assert_allclose(statistic.value, values.mean(axis=(0, 1)), atol=1e-10)
                spread = values.mean(axis=1).std(axis=0, ddof=1) / np.sqrt(runs)
                assert_allclose(statistic.error, spread, atol=1e-10)
            rmse = np.sqrt((error**2).mean(axis=(0, 1)))
            assert_allclose(row.rmse.value, rmse, atol=1e-10)
            spread = (error**2).mean(axis=1).std(axis=0, ddof=1) / np.sqrt(runs)
            assert_allclose(row.rmse.error, spread / (2.0 * rmse), atol=1e-10)
            assert row.worst == nees.max(axis=1).argmax()
            nis = posterior.innovations[r].nis
            assert_allclose(row.nis[r].by_step, nis.mean(axis=0), atol=1e-10)
            assert_allclose(row.nis[r].value, np.nanmean(nis), atol=1e-10)
            assert_allclose(row.nis[r].expected, 8.0 / 3.0)


def test_machine_code_gives_the_same_figures(study):
    pytest.importorskip("llvmlite")
    found = robots(40, compiled=True)
    for row, other in zip(found.rows, study.rows, strict=True):
        for name, statistic in row._statistics().items():
            assert_allclose(statistic.by_step, other._statistics()[name].by_step, atol=1e-9)
    with pytest.raises(ModelError, match="compiled='yes'"):
        robots(40, compiled="yes")


def test_a_linear_filter_is_consistent():
    found = pgm.study(walk, steps=5, runs=3000, methods={"KF": pgm.Filtering()}, seed=2)["KF"]
    for statistic in (found.nees, found.nis[z], found.coverage, found.bias):
        assert abs(statistic.value - statistic.expected) < 4.0 * statistic.error
    variance = [1.0]
    for _ in range(5):
        predicted = variance[-1] + 1.0
        variance.append(predicted * 2.0 / (predicted + 2.0))
    off = found.rmse.by_step[:, 0] - np.sqrt(variance)
    assert (np.abs(off) < 4.0 * found.rmse.error_by_step[:, 0]).all()
    assert found.diverged.size == found.failed.size == 0


def test_runs_that_diverged_are_told_and_can_be_looked_at():
    """The filter believes in +x where x² was seen of a negative x."""
    sensor = pgm.NonlinearGaussianCPD(z, given=x, function=lambda x: x**2, cov=0.1)
    model = squares.replace(observation=[sensor])
    found = pgm.study(model, steps=3, runs=60, methods={"EKF": pgm.Taylor()}, seed=1)
    due = []
    for k in range(60):
        run = found.run(k)
        belief = pgm.filter(model, run.evidence)[x]
        nees = (belief.mean[-1, 0] - run[x][-1, 0]) ** 2 / belief.cov[-1, 0, 0]
        due += [k] * bool(nees > chi2.ppf(1.0 - 1e-6, 1))
    assert 5 < len(due) < 55
    assert found["EKF"].diverged.tolist() == due
    assert f"{len(due)} diverged" in repr(found["EKF"])


def test_runs_that_fail_are_left_out_and_told():
    def slope(x):
        return np.where(x > 2.0, np.nan, 1.0)[..., None]

    sensor = pgm.NonlinearGaussianCPD(z, x, lambda x: x + 0.0, cov=2.0, jacobian={x: slope})
    model = walk.replace(observation=[sensor])
    methods = {"EKF": pgm.Taylor(), "UKF": pgm.Unscented()}
    found = pgm.study(model, steps=3, runs=21, methods=methods, seed=3)
    failed = []
    for k in range(21):
        try:
            pgm.filter(model, found.run(k).evidence)
        except LinearisationError:
            failed.append(k)
    assert 0 < len(failed) < 21
    assert found["EKF"].failed.tolist() == failed
    assert found["EKF"].runs == 21 - len(failed)
    assert found["UKF"].runs == 21
    kept = [k for k in range(21) if k not in failed]
    means = [pgm.filter(model, found.run(k).evidence)[x].mean - found.run(k)[x] for k in kept]
    assert_allclose(found["EKF"].bias.value, np.mean(means, axis=(0, 1)), atol=1e-12)
    never = {x: lambda x: np.full((*x.shape, 1), np.nan)}
    sensor = pgm.NonlinearGaussianCPD(z, x, lambda x: x + 0.0, cov=2.0, jacobian=never)
    model = walk.replace(observation=[sensor])
    with pytest.raises(LinearisationError, match="run 0"):
        pgm.study(model, steps=3, runs=2, methods={"EKF": pgm.Taylor()}, seed=3)


def test_runs_whose_iterations_do_not_settle_are_told():
    methods = {"IEKF": pgm.Filtering(iterations=2, tolerance=1e-12)}
    row = pgm.study(ROBOT, INPUTS, runs=9, methods=methods, seed=1)["IEKF"]
    assert row.unsettled == 9
    assert "iterations had not settled in 9 runs" in repr(row)


def test_steps_at_which_the_state_is_known_have_no_nees():
    known = walk.replace(prior=[pgm.GaussianCPD(x, 0.0, cov=0.0)])
    row = pgm.study(known, steps=2, runs=50, methods=METHODS, seed=3)["EKF"]
    assert np.isnan(row.nees.by_step[0])
    assert np.isfinite(row.nees.by_step[1:]).all()
    assert row.rmse.by_step[0] == 0.0


def test_the_worst_run_is_none_where_no_run_has_a_nees():
    fixed = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(x, 0.0, cov=0.0)],
        [pgm.LinearGaussianCPD(x, {x.previous: 1.0}, cov=0.0)],
        [pgm.LinearGaussianCPD(z, {x: 1.0}, cov=1.0)],
    )
    assert pgm.study(fixed, steps=2, runs=4, methods=METHODS, seed=3)["EKF"].worst is None


def test_a_run_that_failed_is_not_the_worst():
    """Of run 0 alone the sensor's slope has no value: the worst is that of the others."""
    drawn = pgm.study(walk, steps=3, runs=6, methods={"EKF": pgm.Taylor()}, seed=3)
    predicted = pgm.filter(walk, drawn.run(0).evidence)[x].mean[1]

    def slope(x):
        return np.where(np.abs(x - predicted) < 1e-9, np.nan, 1.0)[..., None]

    sensor = pgm.NonlinearGaussianCPD(z, x, lambda x: x + 0.0, cov=2.0, jacobian={x: slope})
    model = walk.replace(observation=[sensor])
    found = pgm.study(model, steps=3, runs=6, methods={"EKF": pgm.Taylor()}, seed=3)
    assert found["EKF"].failed.tolist() == [0]
    largest = []
    for k in range(1, 6):
        run = found.run(k)
        belief = pgm.filter(walk, run.evidence)[x]
        largest.append(((belief.mean - run[x]) ** 2 / belief.cov[..., 0]).max())
    assert found["EKF"].worst == 1 + int(np.argmax(largest))


def test_a_single_run_has_no_errors():
    row = robots(1)["EKF"]
    assert np.isnan(row.nees.error)
    assert np.isnan(row.rmse.error_by_step).all()
    assert np.isfinite(row.rmse.by_step).all()


def test_of_several_states_rows_are_named():
    y = pgm.Variable("y")
    both = pgm.DynamicBayesianNetwork(
        [*walk.prior, pgm.GaussianCPD(y, 0.0, 1.0)],
        [*walk.transition, pgm.LinearGaussianCPD(y, {y.previous: 0.5}, cov=1.0)],
        walk.observation,
    )
    given = {"steps": 2, "runs": 5, "methods": METHODS, "seed": 1}
    found = pgm.study(both, **given)
    assert found["EKF", y].state == y
    assert "NEES of y" in repr(found)
    with pytest.raises(ModelError, match=r"name the state, \['EKF', x\]"):
        found["EKF"]
    assert pgm.study(both, states=[y], **given).states == (y,)


def test_frames(study):
    frame = study.to_frame()
    row = frame[(frame.method == "URTS") & (frame.statistic == "RMSE heading")]
    assert row["value"].item() == study["URTS"].rmse.value[1]
    steps = study.to_frame(by_step=True)
    one = steps[(steps.method == "EKF") & (steps.statistic == "NIS r") & (steps.step == 4)]
    assert one["value"].item() == study["EKF"].nis[r].by_step[4]


def test_a_study_is_pickled_and_draws_again():
    found = pgm.study(walk, steps=2, runs=3, methods=METHODS, seed=1)
    again = pickle.loads(pickle.dumps(found))
    assert_array_equal(again["EKF"].nis[z].by_step, found["EKF"].nis[z].by_step)
    assert_array_equal(again.run(2)[x], found.run(2)[x])


ANY = pgm.SampledCPD(
    z,
    x,
    log_density=lambda z, x: -np.abs(z - x)[..., 0],
    sample=lambda x, size, rng: x + rng.laplace(size=(*size, 1)),
)
WRONG = {
    "a DynamicBayesianNetwork": {"model": "walk"},
    "runs = 0; a whole number, 1 or more": {"runs": 0},
    "seed = -1; a whole number, 0 or more": {"seed": -1},
    "methods= maps names": {"methods": [pgm.Taylor()]},
    "methods= is empty": {"methods": {}},
    "has 'EKF', which is 3": {"methods": {"EKF": 3}},
    "a schedule over time, or a pair": {"methods": {"EKF": (pgm.Taylor(), pgm.Unscented())}},
    "a confidence lies between": {"confidence": 1.5},
    "one probability": {"confidence": [0.5, 0.9]},
    "is no state": {"states": [z]},
    "SampledCPD.* is no Gaussian CPD": {"model": walk.replace(observation=[ANY])},
    "continuous states .* has none": {"model": still},
    "draws anew for each run": {"methods": {"MC": pgm.MonteCarlo(9, seed=1, fresh_per_run=True)}},
    "progress= is True": {"progress": 3},
    "axes of runs": {
        "model": walk.replace(prior=[pgm.GaussianCPD(x, [[0.0], [1.0]], cov=1.0)]),
    },
}


@pytest.mark.parametrize("message", WRONG)
def test_wrong_arguments(message):
    given = {"model": walk, "steps": 2, "runs": 5, "methods": METHODS, "seed": 1} | WRONG[message]
    with pytest.raises(ModelError, match=message):
        pgm.study(**given)


def test_inputs_of_several_runs_are_refused():
    inputs = {**INPUTS, u: np.zeros((3, T, 1))}
    with pytest.raises(EvidenceError, match=r"have axes of runs \(3,\)"):
        pgm.study(ROBOT, inputs, runs=5, methods=METHODS, seed=1)


def test_what_a_study_has_not(study):
    with pytest.raises(ModelError, match=r"has runs 0 to 39, not 40"):
        study.run(40)
    with pytest.raises(ModelError, match="asked for a method of"):
        study["PF"]
    for key in (np.array([1, 2]), ("EKF", np.array([1, 2])), 0):
        with pytest.raises(ModelError, match="asked for a method of"):
            study[key]


def test_readings_of_several_runs_are_refused():
    with pytest.raises(EvidenceError, match=r"shape \(3, 4, 1\), which has axes of runs"):
        pgm.study(walk, {z: np.zeros((3, 4, 1))}, runs=3, methods={"KF": pgm.Taylor()}, seed=1)


def test_a_study_draws_again_whatever_becomes_of_its_inputs():
    a, b, c = (pgm.Variable(name) for name in "abc")
    model = pgm.DynamicBayesianNetwork(
        prior=[pgm.GaussianCPD(a, 0.0, 1.0)],
        transition=[pgm.LinearGaussianCPD(a, {a.previous: 1.0, b: 1.0}, cov=1.0)],
        observation=[pgm.LinearGaussianCPD(c, {a: 1.0}, cov=1.0)],
    )
    pushes = np.ones((4, 1))
    found = pgm.study(model, {b: pushes}, runs=3, methods={"KF": pgm.Taylor()}, seed=1)
    before = found.run(2)[a]
    pushes[:] = 1e3
    np.testing.assert_array_equal(found.run(2)[a], before)


def test_a_model_without_sensors_is_refused():
    model = pgm.DynamicBayesianNetwork(prior=walk.prior, transition=walk.transition, observation=[])
    with pytest.raises(ModelError, match="has no sensors"):
        pgm.study(model, steps=3, runs=3, methods={"KF": pgm.Taylor()}, seed=1)
