"""Studies of models that switch, have mixtures, or any density."""

import numpy as np
import pytest
from comparison.test_study_workers import require_same
from numpy.testing import assert_allclose, assert_array_equal
from scipy.special import ndtri

import pgm
from pgm.comparison import drawn_runs
from pgm.comparison.studying import _FEW
from pgm.errors import FileError, ModelError
from pgm.examples import walk, x, z
from pgm.networks.counted import CASES

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


def test_a_run_is_drawn_by_its_own_counters(study):
    """A case's noise is of requests of its own, whichever cases hold in other runs."""
    key, place = np.random.Philox(3).state["state"]["key"], SWITCHING.variables.index

    def uniform(run, step, variable, request):
        counter = [run, step, place(variable), request]
        word = np.random.Philox(key=key, counter=counter).random_raw()
        return (int(word) >> 12) / 2**52 + 2.0**-53

    for k in (0, 7, _FEW + 7):
        run = study.run(k)
        modes = [int(uniform(k, 0, mode, 0) > 0.5)]
        for step in range(1, T + 1):
            modes.append(int(uniform(k, step, mode, 0) > (0.9, 0.2)[modes[-1]]))
        assert_array_equal(run[mode], modes)
        noise = [
            ndtri(uniform(k, step, x, CASES * (1 + now))) * (0.1, 4.0)[now] ** 0.5
            for step, now in enumerate(modes)
        ]
        assert_allclose(np.diff(run[x][:, 0]), noise[1:], rtol=1e-9, atol=1e-12)


def test_the_law_of_the_draws():
    drawn = drawn_runs.drawn_runs(SWITCHING, {}, T, 1000, 4).sample(0)
    gusty = drawn[mode][:, 1:] == 1
    moves = np.diff(drawn[x][..., 0], axis=1)
    for variance, which in ((0.1, ~gusty), (4.0, gusty)):
        assert_allclose(moves[which].var(), variance, rtol=5 * np.sqrt(2.0 / which.sum()))
    stay = (drawn[mode][:, 1:] == 1)[drawn[mode][:, :-1] == 1].mean()
    assert abs(stay - 0.8) < 5 * np.sqrt(0.16 / 2000)


def test_other_densities_have_a_generator_for_each_run():
    model = walk.replace(observation=[LAPLACE])
    found = pgm.study(model, steps=3, runs=6, methods={"PF": pgm.Particles(500, seed=1)}, seed=3)
    for k in (0, 5):
        rng = np.random.Generator(np.random.Philox(np.random.SeedSequence(3, spawn_key=(k,))))
        due, run = model.sample(steps=3, rng=rng), found.run(k)
        assert_array_equal(run[x], due[x])
        assert_array_equal(run.evidence[z], due[z])


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
        assert_allclose(one, other, rtol=1e-12)
    require_same(switching(_FEW + 8, compiled=False, methods=METHODS), study)
    monkeypatch.setattr(drawn_runs, "MOST", 4)
    with pytest.raises(FileError, match="block"):
        switching(_FEW + 8, **given)
    few = switching(10, methods={"one": pgm.Filtering()})
    assert_array_equal(few.run(9)[mode], study.run(9)[mode])
    assert_allclose(few.run(9)[x], study.run(9)[x], rtol=1e-12)


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
