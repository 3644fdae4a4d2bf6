"""A truth of which some components are not known, against statistics of those that are."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.stats import chi2

import pgm
from pgm import consistency
from tests.dense import random_covariance

x = pgm.Variable("x", components=("east", "north", "heading"), angles=("heading",))
RUNS, T = 40, 6
RNG = np.random.default_rng(3)
COV = random_covariance(RNG, 3, lead=(RUNS, T)) + 0.1 * np.eye(3)
BELIEF = pgm.Gaussian(x, RNG.normal(size=(RUNS, T, 3)), COV, steps=np.arange(1, T + 1))
WHOLE = BELIEF.sample(rng=1)
KNOWN = RNG.random(WHOLE.shape) < 0.6
KNOWN[:, 2] = False  # a step of which nothing is known
KNOWN[7] = False  # a run
TRUTH = np.where(KNOWN, WHOLE, np.nan)


def test_errors_are_those_of_the_components_known():
    found = consistency.error(BELIEF, TRUTH)
    assert_array_equal(np.isnan(found), ~KNOWN)
    assert_array_equal(found[KNOWN], consistency.error(BELIEF, WHOLE)[KNOWN])


@pytest.mark.parametrize("components", [(), ("heading", "east")])
def test_nees_is_that_of_the_marginal_known(components):
    chosen = [0, 1, 2] if not components else [2, 0]
    found = consistency.nees(BELIEF, TRUTH, components)
    errors = consistency.error(BELIEF, WHOLE)
    for run, step in np.ndindex(RUNS, T):
        seen = [k for k in chosen if KNOWN[run, step, k]]
        if not seen:
            assert np.isnan(found[run, step])
            continue
        part = errors[run, step, seen]
        due = part @ np.linalg.solve(COV[run, step][np.ix_(seen, seen)], part)
        assert_allclose(found[run, step], due, rtol=1e-9)


def test_anees_counts_the_degrees_of_freedom_known():
    found = consistency.anees(BELIEF, TRUTH, confidence=0.9)
    dof = KNOWN.sum(axis=(0, 2))
    assert_array_equal(found.dof, dof)
    assert_array_equal(found.count, KNOWN.any(axis=2).sum(axis=0))
    there = found.count > 0
    assert np.isnan(found.value[~there]).all()
    assert_allclose(found.low[there], (chi2.ppf(0.05, dof) / found.count)[there])
    assert_allclose(found.high[there], (chi2.ppf(0.95, dof) / found.count)[there])
    total = np.nansum(consistency.nees(BELIEF, TRUTH), axis=0)
    assert_allclose(found.value[there], total[there] / found.count[there])
    title, inside, heads, *rows = repr(found).splitlines()
    assert title == f"Average({found.value.shape} of them)"
    assert inside.split()[0] == str(found.inside.sum())
    assert heads.split()[-1] == "of"
    assert [int(row.split()[-1]) for row in rows] == found.count.tolist()


def test_coverage_is_of_the_regions_of_what_is_known():
    levels = np.array([0.3, 0.9])
    found = consistency.coverage(BELIEF, TRUTH, levels)
    dof = KNOWN.sum(axis=-1)
    there = dof > 0
    values = consistency.nees(BELIEF, TRUTH)[there]
    due = [np.mean(values <= chi2.ppf(level, dof[there])) for level in levels]
    assert_allclose(found.actual, due)
    assert found.count == there.sum()
    assert found.runs == RUNS - 1
    flat = consistency.coverage(pgm.Gaussian(x, BELIEF.mean, COV), TRUTH, levels)
    assert flat.runs == flat.count == found.count


def test_lengths_are_of_errors_known_in_all_components():
    plane = ("east", "north")
    whole = KNOWN[..., :2].all(axis=-1)
    lengths = np.linalg.norm(consistency.error(BELIEF, WHOLE)[..., :2], axis=-1)
    due = np.sqrt(np.mean(lengths[whole] ** 2))
    assert_allclose(consistency.rmse(BELIEF, TRUTH, plane), due)
    found = consistency.rmse_over_time(BELIEF, TRUTH, plane, percentiles=(10, 80))
    assert_array_equal(found.count, whole.sum(axis=0))
    assert found.runs == RUNS
    for step in range(T):
        some = lengths[whole[:, step], step]
        ours = found.rms[step], found.low[step], found.median[step], found.high[step]
        if some.size:
            assert_allclose(ours, [np.sqrt(np.mean(some**2)), *np.percentile(some, (10, 50, 80))])
        else:
            assert np.isnan(ours).all()


def test_a_component_that_is_never_known_needs_no_scale():
    """Nor does it spoil the others, whatever the belief says of it."""
    flat = np.diag([1.0, 4.0, 0.0])
    belief = pgm.Gaussian(x, np.zeros((5, 3)), flat)
    truth = np.tile([1.0, 2.0, np.nan], (5, 1))
    assert_allclose(consistency.nees(belief, truth), 2.0)
    assert consistency.anees(belief, truth).dof == 10


@pytest.mark.parametrize("statistic", [consistency.rmse, consistency.coverage])
def test_a_truth_of_which_nothing_is_known_is_refused(statistic):
    with pytest.raises(pgm.ModelError, match=r"no truth of \(x\) is known, .* \(east, north, head"):
        statistic(BELIEF, np.full((T, 3), np.nan))
    one = np.where([True, False, False], WHOLE, np.nan)
    assert consistency.rmse(BELIEF, one, ("east",)) > 0.0
    with pytest.raises(pgm.ModelError, match=r"in \(north\); name components that are"):
        consistency.rmse(BELIEF, one, ("north",))


def test_a_right_model_is_right_about_what_is_known(right, truth):
    rng = np.random.default_rng(0)
    gaps = np.where(rng.random(truth.shape) < 0.5, np.nan, truth)
    (point,) = right.graph.model.states
    assert consistency.anees(right[point], gaps, confidence=0.999).inside.mean() > 0.95
    assert consistency.coverage(right[point], gaps, [0.5, 0.9], band=0.999).inside.all()


def test_they_are_drawn():
    for plot in (pgm.plot.nees, pgm.plot.rmse, pgm.plot.coverage):
        ax = plot(BELIEF, TRUTH)
        ax.figure.canvas.draw()
