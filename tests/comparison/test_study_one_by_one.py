"""Studies of models whose runs are drawn one by one: switching, mixtures, any density."""

import numpy as np
import pytest
from comparison.test_study_workers import require_same
from numpy.testing import assert_allclose, assert_array_equal

import pgm
from pgm.comparison import drawn_runs
from pgm.comparison.studying import _FEW
from pgm.errors import FileError, ModelError
from pgm.examples import walk, x, z

mode = pgm.Discrete("mode", states=("calm", "gusty"))
SWITCHING = pgm.DynamicBayesianNetwork(
    prior=[pgm.TableCPD(mode, table=[0.5, 0.5]), pgm.GaussianCPD(x, 0.0, 1.0)],
    transition=[
        pgm.TableCPD(mode, given=mode.previous, table=[[0.9, 0.1], [0.2, 0.8]]),
        pgm.SwitchingCPD(
            x,
            given=mode,
            cases={
                name: pgm.LinearGaussianCPD(x, {x.previous: 1.0}, cov=cov)
                for name, cov in (("calm", 0.1), ("gusty", 4.0))
            },
        ),
    ],
    observation=[pgm.LinearGaussianCPD(z, {x: 1.0}, cov=0.5)],
)
OUTLIERS = pgm.MixtureCPD(
    [pgm.LinearGaussianCPD(z, {x: 1.0}, cov=cov) for cov in (0.5, 25.0)], weights=[0.9, 0.1]
)
LAPLACE = pgm.SampledCPD(
    z,
    x,
    log_density=lambda z, x: -np.abs(z - x)[..., 0] - np.log(2.0),
    sample=lambda x, size, rng: x + rng.laplace(size=(*size, 1)),
)
T, METHODS = 5, {"one": pgm.Filtering(), "two": pgm.Gaussians(2), "back": pgm.Smoothing()}


def switching(runs, **given):
    return pgm.study(SWITCHING, steps=T, **({"methods": METHODS} | given), runs=runs, seed=3)


@pytest.fixture(scope="module")
def study():
    return switching(_FEW + 8)


def test_a_run_has_a_generator_of_its_own(study):
    for k in (0, 7, _FEW + 7):
        seeds = np.random.SeedSequence(3, spawn_key=(k,))
        rng = np.random.Generator(np.random.Philox(seeds))
        due, found = SWITCHING.sample(steps=T, rng=rng), study.run(k)
        for variable in (x, z, mode):
            assert_array_equal(found[variable], due[variable])
        assert_array_equal(found.evidence[z], due[z])


def test_figures_are_plain_means_over_runs():
    study = switching(9)
    errors = {name: [] for name in METHODS}
    square, held, nis = [], [], []
    for run in map(study.run, range(study.runs)):
        for name, method in METHODS.items():
            infer = pgm.smooth if name == "back" else pgm.filter
            belief = method if name == "two" else None
            found = infer(SWITCHING, run.evidence, belief=belief)
            gaussian = found[x].gaussian()
            errors[name].append(gaussian.mean - run[x])
            if name == "two":
                square.append((errors[name][-1] ** 2 / gaussian.cov[..., 0])[:, 0])
                held.append(square[-1] <= 3.841458820694124)
            if name == "one":
                nis.append(found.innovations[z].nis)
    for name, each in errors.items():
        rmse, mean = np.sqrt(np.mean(np.square(each), axis=0)), np.mean(each, axis=0)
        assert_allclose(study[name].rmse.by_step, rmse, rtol=1e-9)
        assert_allclose(study[name].bias.by_step, mean, rtol=1e-9, atol=1e-12)
    assert_allclose(study["two"].nees.by_step, np.mean(square, axis=0), rtol=1e-9)
    assert_allclose(study["two"].coverage.by_step, np.mean(held, axis=0))
    assert_allclose(study["one"].nis[z].value, np.nanmean(nis), rtol=1e-9)
    assert not study["two"].nis  # which a family of beliefs need not have


def test_a_mixture_filter_is_nearer(study):
    one, two = (study[name].rmse.value[0] for name in ("one", "two"))
    assert study["back"].rmse.value[0] < min(one, two)
    gap = study["one"].nees.value - 1.0
    assert abs(gap) < 5 * study["one"].nees.error


def test_blocks_and_files_change_no_draw(study, tmp_path, monkeypatch):
    given = {"methods": {"one": pgm.Filtering()}, "file": tmp_path / "study.npz"}
    switching(_FEW, **given)
    longer = switching(_FEW + 8, **given)
    for name in ("rmse", "nees"):
        one, other = (getattr(each["one"], name).by_step for each in (longer, study))
        assert_array_equal(one, other)
    require_same(switching(_FEW + 8, compiled=False, methods=METHODS), study)
    monkeypatch.setattr(drawn_runs, "MOST", 4)
    with pytest.raises(FileError, match="block"):
        switching(_FEW + 8, **given)
    few = switching(10, methods={"one": pgm.Filtering()})
    assert_array_equal(few.run(9)[x], study.run(9)[x])


@pytest.mark.parametrize("sensor", [OUTLIERS, LAPLACE], ids=["mixture", "any density"])
def test_families_of_beliefs_on_sensors_of_any_density(sensor):
    model, cloud = walk.replace(observation=[sensor]), pgm.Particles(400, seed=20)
    found = pgm.study(model, steps=3, runs=6, methods={"PF": cloud}, seed=2)
    errors = []
    for k in range(6):
        run = found.run(k)
        own = pgm.filter(model, run.evidence, belief=pgm.Particles(400, seed=20 + k))
        errors.append(own[x].mean - run[x])
    assert_allclose(found["PF"].bias.by_step, np.mean(errors, axis=0), rtol=1e-9, atol=1e-12)
    assert found["PF"].runs == 6


def test_what_a_method_does_not_know_is_refused():
    model = walk.replace(observation=[LAPLACE])
    with pytest.raises(ModelError, match=r"is no Gaussian CPD.*pgm\.Particles"):
        pgm.study(model, steps=3, runs=6, methods={"EKF": pgm.Taylor()}, seed=2)
    with pytest.raises(ModelError, match="is for networks of continuous variables"):
        switching(3, methods={"PF": pgm.Particles(50, seed=1)})
