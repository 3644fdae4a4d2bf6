"""Iterations go on with the runs that have not settled, which changes no answer."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

import pgm
from pgm.beliefs.moments.smoothers.smoother import Chain
from pgm.linearisers.numbering import Numbering
from pgm.schedules import iteration

RUNS, STEPS = 24, 12
place = pgm.Variable("p", components=("east", "north"))
mark = pgm.Variable("m", components=("east", "north"))
far = pgm.Variable("far")
TURNED = np.array([[np.cos(0.1), -np.sin(0.1)], [np.sin(0.1), np.cos(0.1)]])


def distance(p, m):
    return np.hypot(m[..., :1] - p[..., :1], m[..., 1:] - p[..., 1:])


def drawn(noise=None):
    """Return a place that is hardly known, of given noise, and ranges to two beacons in many runs.

    They are drawn with Gaussian noise.
    """

    def model(noise):
        return pgm.DynamicBayesianNetwork(
            [pgm.GaussianCPD(place, [0.0, 0.0], cov=9.0)],
            [pgm.LinearGaussianCPD(place, {place.previous: TURNED}, cov=0.01)],
            [pgm.NonlinearGaussianCPD(far, (place, mark), distance, cov=0.04, noise=noise)],
        )

    marks = np.resize([[4.0, 1.0], [-3.0, 5.0]], (STEPS + 1, 2))
    seen = pgm.sightings(step=np.arange(STEPS + 1), given={mark: marks})
    return model(noise), model(None).sample({far: seen}, steps=STEPS, runs=RUNS, rng=3).evidence


@pytest.mark.parametrize("compiled", [True, False])
@pytest.mark.parametrize(
    "options",
    [
        {"damping": pgm.LevenbergMarquardt()},
        {"damping": 0.3, "lineariser": pgm.Unscented()},
        {"damping": pgm.LevenbergMarquardt(), "noise": pgm.StudentT(4.0)},
    ],
    ids=["LM", "Unscented", "StudentT"],
)
@pytest.mark.filterwarnings("ignore::pgm.ConvergenceWarning")
def test_answers_are_those_of_all_runs_together_and_of_each_alone(options, compiled, monkeypatch):
    options = {"iterations": 20, "compiled": compiled, **options}
    model, evidence = drawn(options.pop("noise", None))
    sizes, of_runs = [], Chain.of_runs

    def narrowed(chain, runs):
        sizes.append(len(runs))
        return of_runs(chain, runs)

    monkeypatch.setattr(Chain, "of_runs", narrowed)
    found = pgm.smooth(model, evidence, steps=STEPS, **options)
    assert sizes
    assert max(sizes) <= RUNS / 2
    assert min(sizes) >= 8
    monkeypatch.setattr(iteration, "_FEWEST", RUNS)
    due = pgm.smooth(model, evidence, steps=STEPS, **options)
    settled = due.status.converged
    assert settled.any()
    assert (found.status.converged == settled).all()
    assert_allclose(found[place].mean[settled], due[place].mean[settled], rtol=0, atol=1e-12)
    assert_allclose(found[place].cov[settled], due[place].cov[settled], rtol=1e-11, atol=1e-14)
    assert_allclose(found.log_evidence[settled], due.log_evidence[settled], rtol=0, atol=1e-11)
    assert_allclose(found.status.residuals[:, settled], due.status.residuals[:, settled], atol=1e-9)
    slowest = np.argsort(found.status.residuals[6] * settled)[-2:]
    for run in slowest.tolist():
        own = {
            far: pgm.sightings(evidence[far].values[run], evidence[far].step, evidence[far].given)
        }
        alone = pgm.smooth(model, own, steps=STEPS, **{**options, "compiled": False})
        off = np.abs(alone[place].mean - found[place].mean[run]) / alone[place].std
        assert off.max() < 1e-4


@pytest.mark.filterwarnings("ignore::pgm.ConvergenceWarning")
def test_losses_that_remember_their_stage_are_iterated_together(monkeypatch):
    model, evidence = drawn(pgm.TruncatedLeastSquares(3.0))
    monkeypatch.setattr(Chain, "of_runs", None)
    found = pgm.smooth(model, evidence, steps=STEPS, iterations=20)
    assert found.status.converged.mean() > 0.5


def test_chosen_runs_keep_their_numbers():
    chosen = Numbering(3).of(np.array([4, 1, 4]))
    assert [chosen.words(k) for k in range(3)] == ["run 7", "run 4", "run 7"]
    assert chosen.of(np.array([1])).only(1) == 4
    assert Numbering(3).of(slice(2, 5)).run(1) == 6
