"""Studies with an oracle, and with families of beliefs: against calls run by run."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import pgm
from pgm.comparison.study_methods import ORACLES
from pgm.errors import ModelError, NumericalError
from pgm.examples import squares, walk, x, z

# Of so few particles and cells as are quick; what becomes of their answers is tested.
pytestmark = [
    pytest.mark.filterwarnings("ignore::pgm.errors.ParticleWarning"),
    pytest.mark.filterwarnings("ignore::pgm.errors.GridWarning"),
]
GRID = pgm.Grid({"x": (-6.0, 8.0, 300)})
# Nonlinear enough for methods to differ, and for none to fail.
bent = squares.replace(
    observation=[pgm.NonlinearGaussianCPD(z, x, lambda x: x + 0.2 * x**2, cov=1.0)]
)
METHODS = {"EKF": pgm.Taylor(), "UKF": pgm.Unscented(), "RTS": pgm.Smoothing()}


@pytest.fixture(scope="module")
def by_grid():
    return pgm.study(bent, steps=3, runs=40, methods=METHODS, seed=4, oracle=GRID)


def test_kl_is_that_of_comparisons_run_by_run(by_grid):
    each = {name: [] for name in METHODS}
    for k in range(40):
        evidence = by_grid.run(k).evidence
        for name, rule, schedule in (
            ("EKF", pgm.Taylor(), pgm.Filtering()),
            ("UKF", pgm.Unscented(), pgm.Filtering()),
            ("RTS", pgm.Taylor(), pgm.Smoothing()),
        ):
            found = pgm.compare(
                bent, evidence, linearisers={"it": rule}, schedules=[schedule], oracle=GRID
            )
            each[name].append(found.rows[0].by_oracle["Grid"].kl_by_step)
    for name, values in each.items():
        row = by_grid[name]
        assert_allclose(row.kl.by_step, np.mean(values, axis=0), rtol=1e-9)
        spread = np.std(values, axis=0, ddof=1) / np.sqrt(40)
        assert_allclose(row.kl.error_by_step, spread, rtol=1e-9, atol=1e-12)
        assert_allclose(row.kl.value, np.mean(values), rtol=1e-9)
        assert row.kl_error == 0.0
        assert row.doubtful.size == 0
        assert (row.belief, row.weak) == (None, "")
    assert "KL" in str(by_grid)
    frame = by_grid.to_frame()
    kept = frame[(frame.method == "EKF") & (frame.statistic == "KL")]
    assert kept["value"].item() == by_grid["EKF"].kl.value
    assert pgm.plot.study(by_grid, statistic="kl").get_ylabel() == "KL"


def test_errors_of_draws_are_those_of_independent_runs():
    """The oracle's Monte Carlo errors of the runs, of seeds of their own, added as bent."""
    oracle = pgm.Particles(400, seed=9)
    methods = {"wrong": (pgm.Taylor(), pgm.Filtering())}
    found = pgm.study(bent, steps=2, runs=6, methods=methods, seed=4, oracle=oracle, repeats=4)
    kl, by_step, error = [], [], []
    for k in range(6):
        own = oracle.with_seed(9 + ORACLES + 4 * k)
        each = pgm.compare(
            bent,
            found.run(k).evidence,
            linearisers={"wrong": pgm.Taylor()},
            schedules=[pgm.Filtering()],
            oracle=own,
            repeats=4,
        )
        judgement = each.rows[0].by_oracle["Particles"]
        kl.append(judgement.kl_by_step)
        by_step.append(judgement.error_by_step)
        error.append(judgement.error)
    row = found["wrong"]
    assert_allclose(row.kl.by_step, np.mean(kl, axis=0), rtol=1e-9)
    assert_allclose(row.kl_error_by_step, np.sqrt(np.sum(np.square(by_step), axis=0)) / 6)
    assert_allclose(row.kl_error, np.sqrt(np.sum(np.square(error))) / 6)
    assert row.kl_error < row.kl.error  # which counts it in


def test_an_oracle_of_few_draws_is_told_to_be_too_weak():
    oracle = pgm.Particles(60, seed=1)
    exact = {"KF": pgm.Taylor(), "the same": pgm.Unscented()}
    found = pgm.study(walk, steps=4, runs=8, methods=exact, seed=2, oracle=oracle)
    row = found["KF"]
    assert "KL is known to ±" in row.weak or "not to be trusted in" in row.weak
    assert "the oracle is too weak" in repr(found)
    assert "the oracle is too weak" in repr(row)
    # Of right beliefs the KL is zero, but for the oracle's errors.
    assert abs(row.kl.value) < 4.0 * max(row.kl.error, row.kl_error)


def test_runs_in_which_the_oracle_fails_are_numbered(monkeypatch):
    infer, calls = type(GRID).infer, []

    def failing(self, *asked):
        calls.append(1)
        if len(calls) == 3:
            raise NumericalError("no cell has any probability")
        return infer(self, *asked)

    monkeypatch.setattr(type(GRID), "infer", failing)
    methods = {"KF": pgm.Taylor()}
    found = pgm.study(walk, steps=2, runs=5, methods=methods, seed=2, oracle=GRID)["KF"]
    assert found.doubtful.tolist() == [2]
    assert found.runs == 5
    assert found.weak == "its beliefs are not to be trusted in 1 run, such as 2"


def test_families_have_each_run_with_a_seed_of_its_own():
    family = pgm.Particles(300, seed=5)
    methods = {"EKF": pgm.Taylor(), "PF": family, "PS": (family, pgm.Smoothing()), "grid": GRID}
    found = pgm.study(bent, steps=3, runs=36, methods=methods, seed=7)  # of two blocks
    calls = {
        "PF": lambda k, run: pgm.filter(bent, run, belief=family.with_seed(5 + k)),
        "PS": lambda k, run: pgm.smooth(bent, run, belief=family.with_seed(5 + k)),
        "grid": lambda k, run: pgm.filter(bent, run, belief=GRID),
    }
    for name, call in calls.items():
        errors, squared = [], []
        for k in range(36):
            run = found.run(k)
            belief = call(k, run.evidence)[x].gaussian()
            errors.append(belief.mean - run[x])
            squared.append((errors[-1] ** 2 / belief.cov[..., 0])[:, 0])
        row = found[name]
        assert_allclose(row.bias.by_step, np.mean(errors, axis=0), atol=1e-10)
        assert_allclose(row.nees.by_step, np.mean(squared, axis=0), rtol=1e-8)
        assert row.nis == {}
        assert row.worst == int(np.argmax(np.max(squared, axis=1)))
    assert found["PF"].belief is family
    assert "NIS z" in repr(found)  # of the EKF alone
    assert pgm.plot.study(found, statistic="nis").get_legend() is None
    assert [row.runs for row in found.rows] == [36] * 4


class Ensemble(pgm.BeliefFamily):
    """An ensemble Kalman filter of the walk, whose draws come from a seed."""

    def __init__(self, seed):
        self.seed = seed

    def begin(self, at):
        return np.random.default_rng(self.seed).normal(size=(at.runs, 200, 1))

    def predict(self, at, belief):
        return belief + np.random.default_rng((self.seed, at.step)).normal(size=belief.shape)

    def take(self, at, belief):
        (seen,) = at.measurements
        gain = belief.var(axis=1, keepdims=True) / (belief.var(axis=1, keepdims=True) + 2.0)
        return belief + gain * (seen.value[:, None, :] - belief), np.zeros(len(belief))

    def moments(self, belief):
        return belief.mean(axis=1), belief.var(axis=1)[..., None]


class Seeded(Ensemble):
    def with_seed(self, seed):
        return Seeded(seed)


def test_clouds_that_collapse_have_figures_without_end():
    """With all weight on one particle a NEES has no bound, and is told."""
    methods = {"PF": pgm.Particles(300, seed=5)}
    row = pgm.study(squares, steps=3, runs=36, methods=methods, seed=7)["PF"]
    assert row.nees.value > 1e6
    assert len(row.diverged) > 2
    run = pgm.study(squares, steps=3, runs=36, methods={"EKF": pgm.Taylor()}, seed=7).run(row.worst)
    belief = pgm.filter(squares, run.evidence, belief=pgm.Particles(300, seed=5 + row.worst))
    assert belief[x].gaussian().cov.min() < 1e-6


def test_a_family_of_ones_own_takes_another_seed_for_each_run():
    given = {"steps": 2, "runs": 5, "seed": 1}
    with pytest.raises(ModelError, match=r"would draw the same in each run.*with_seed\(seed\)"):
        pgm.study(walk, methods={"own": Ensemble(3)}, **given)
    found = pgm.study(walk, methods={"own": Seeded(3)}, **given)
    means = [
        pgm.filter(walk, found.run(k).evidence, belief=Seeded(3 + k))[x].mean - found.run(k)[x]
        for k in range(5)
    ]
    assert_allclose(found["own"].bias.by_step, np.mean(means, axis=0), atol=1e-12)


def test_studies_with_an_oracle_go_on_from_a_file(tmp_path):
    file = tmp_path / "study.npz"
    methods = {"EKF": pgm.Taylor(), "PF": pgm.Particles(50, seed=1)}
    given = {"steps": 2, "methods": methods, "seed": 4}
    oracle = pgm.Particles(40, seed=2)
    pgm.study(bent, runs=32, oracle=oracle, file=file, **given)
    found = pgm.study(bent, runs=40, oracle=oracle, file=file, **given)
    due = pgm.study(bent, runs=40, oracle=oracle, **given)
    for row, other in zip(found.rows, due.rows, strict=True):
        assert_array_equal(row.kl.by_step, other.kl.by_step)
        assert_array_equal(row.kl_error_by_step, other.kl_error_by_step)
        assert_array_equal(row.doubtful, other.doubtful)
        assert_array_equal(row.nees.by_step, other.nees.by_step)
    with pytest.raises(pgm.FileError, match=r"another study: oracle Particles × 8 .*, here none"):
        pgm.study(bent, runs=40, file=file, **given)
    with pytest.raises(pgm.FileError, match="the oracle has other numbers or functions"):
        pgm.study(bent, runs=40, file=file, oracle=pgm.Particles(41, seed=2), **given)


WRONG = {
    r"a\s+posterior or an audit judges one run": {"oracle": pgm.smooth(walk, {z: [[1.0]]})},
    "repeats is a whole number of runs, 4 or more, not 3": {"oracle": GRID, "repeats": 3},
    "a family of beliefs like": {"methods": {"PF": (GRID, pgm.Taylor())}},
    "has 'y', which is no component of the states": {
        "methods": {"PF": pgm.Grid({"y": (0.0, 1.0, 9)})}
    },
    "seed, and would draw the same": {"oracle": Ensemble(3)},
}


@pytest.mark.parametrize("message", WRONG)
def test_wrong_oracles_and_families(message):
    given = {"steps": 2, "runs": 5, "methods": METHODS, "seed": 1} | WRONG[message]
    with pytest.raises(ModelError, match=message):
        pgm.study(walk, **given)


def test_without_an_oracle_there_is_no_kl():
    found = pgm.study(walk, steps=2, runs=5, methods=METHODS, seed=1)
    assert found["EKF"].kl is None
    assert np.isnan(found["EKF"].kl_error)
    with pytest.raises(ModelError, match="has no oracle"):
        pgm.plot.study(found, statistic="kl")
