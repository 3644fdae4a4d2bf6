"""Errors and normalised errors against direct computation."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.stats import multivariate_normal

import pgm
from pgm import consistency

x = pgm.Variable("x", components=("east", "north", "heading"), angles=("heading",))
rng = np.random.default_rng(0)
ROOTS = rng.normal(size=(4, 5, 3, 3))
COVS = ROOTS @ ROOTS.swapaxes(-1, -2) + 0.1 * np.eye(3)
BELIEF = pgm.Gaussian(x, rng.normal(size=(4, 5, 3)), COVS, steps=np.arange(5))


def test_errors_of_angles_are_wrapped():
    belief = pgm.Gaussian(x, [0.0, 0.0, 3.1], np.eye(3))
    assert_allclose(consistency.error(belief, [1.0, -1.0, -3.1]), [-1.0, 1.0, 6.2 - 2 * np.pi])


def test_nees_is_the_mahalanobis_distance():
    truth = BELIEF.mean + rng.normal(size=BELIEF.mean.shape)
    difference = BELIEF.mean - truth
    due = np.einsum("...i,...ij,...j->...", difference, np.linalg.inv(COVS), difference)
    assert_allclose(consistency.nees(BELIEF, truth), due, rtol=1e-9)


def test_nees_of_components_is_that_of_their_marginal_in_any_order():
    truth = BELIEF.mean + rng.normal(size=BELIEF.mean.shape)
    difference = (BELIEF.mean - truth)[..., [2, 0]]
    inverse = np.linalg.inv(COVS[..., [[2], [0]], [2, 0]])
    due = np.einsum("...i,...ij,...j->...", difference, inverse, difference)
    assert_allclose(consistency.nees(BELIEF, truth, ("heading", "east")), due, rtol=1e-9)


def test_whole_turns_change_no_statistic():
    truth = BELIEF.mean + rng.uniform(-1.0, 1.0, size=BELIEF.mean.shape)
    turned = truth + 2.0 * np.pi * np.array([0, 0, 1]) * rng.integers(-3, 4, size=(4, 5, 1))
    assert np.abs(turned - truth).max() > 6.0
    for statistic in (
        consistency.nees,
        consistency.rmse,
        lambda *given: consistency.rmse_over_time(*given).high,
        lambda *given: consistency.anees(*given).value,
        lambda *given: consistency.coverage(*given, [0.2, 0.5, 0.9]).actual,
    ):
        assert_allclose(statistic(BELIEF, turned), statistic(BELIEF, truth), rtol=1e-9)


def test_rmse_of_some_components():
    truth = BELIEF.mean + np.array([3.0, 4.0, 0.5])
    assert_allclose(consistency.rmse(BELIEF, truth, ("east", "north")), 5.0)
    assert_allclose(consistency.rmse(BELIEF, truth, ("heading",)), 0.5)


def test_rmse_over_time_and_its_percentiles():
    runs, steps = 101, 3
    sizes = np.arange(runs)[:, None] * np.array([1.0, 2.0, 0.5])
    mean = np.zeros((runs, steps, 3))
    belief = pgm.Gaussian(x, mean, np.eye(3), steps=np.arange(1, 4))
    truth = mean.copy()
    truth[..., 0], truth[..., 1] = 0.6 * sizes, -0.8 * sizes
    found = consistency.rmse_over_time(belief, truth, ("east", "north"), percentiles=(10, 80))
    np.testing.assert_array_equal(found.steps, [1, 2, 3])
    assert found.runs == runs
    assert_allclose(found.low, [10.0, 20.0, 5.0])
    assert_allclose(found.median, [50.0, 100.0, 25.0])
    assert_allclose(found.high, [80.0, 160.0, 40.0])
    # Σ k² for k = 0 … 100 is 338350.
    assert_allclose(found.rms, np.sqrt(338350 / 101) * np.array([1.0, 2.0, 0.5]))
    total = consistency.rmse(belief, truth, ("east", "north"))
    assert_allclose(np.sqrt(np.mean(found.rms**2)), total)


def test_kl_of_one_dimension_and_across_the_turn():
    a, b = (pgm.Variable(name, components=("t",), angles=("t",)) for name in "ab")
    p, q = pgm.Gaussian(a, [3.1], [[0.04]]), pgm.Gaussian(a, [-3.1], [[0.09]])
    offset = 6.2 - 2 * np.pi
    due = np.log(0.3 / 0.2) + (0.04 + offset**2) / (2 * 0.09) - 0.5
    assert_allclose(consistency.kl(p, q), due, rtol=1e-12)
    with pytest.raises(pgm.ModelError, match="scope"):
        consistency.kl(p, pgm.Gaussian(b, [0.0], [[1.0]]))


def test_log_scores_are_log_densities():
    """SciPy's of the components that are known, and of none NaN."""
    rng = np.random.default_rng(3)
    root = rng.normal(size=(4, 3, 3))
    belief = pgm.Gaussian(x, rng.normal(size=(4, 3)), root @ root.swapaxes(1, 2) + np.eye(3))
    truth = rng.normal(size=(4, 3))
    truth[1, 1], truth[2], truth[3, 2] = np.nan, np.nan, truth[3, 2] + 4 * np.pi
    found = consistency.log_score(belief, truth)
    assert np.isnan(found[2])
    off = consistency.error(belief, truth)
    for k, known in ((0, [0, 1, 2]), (1, [0, 2]), (3, [0, 1, 2])):
        law = multivariate_normal(cov=belief.cov[k][np.ix_(known, known)])
        assert found[k] == pytest.approx(law.logpdf(off[k, known]))
    alone = consistency.log_score(belief, truth, ("north",))
    assert alone[0] == pytest.approx(
        multivariate_normal(belief.mean[0, 1], belief.cov[0, 1, 1]).logpdf(truth[0, 1])
    )
    with pytest.raises(pgm.NumericalError, match="singular"):
        consistency.log_score(pgm.Gaussian(x, np.zeros(3), np.diag([1.0, 0.0, 1.0])), np.zeros(3))


def test_refusals():
    with pytest.raises(pgm.ModelError, match=r"shape \(2,\)"):
        consistency.error(BELIEF, [0.0, 0.0])
    with pytest.raises(pgm.ModelError, match="up"):
        consistency.rmse(BELIEF, BELIEF.mean, ("up",))
    with pytest.raises(pgm.ModelError, match="tuple of names"):
        consistency.nees(BELIEF, BELIEF.mean, "east")
    with pytest.raises(pgm.ModelError, match="name each of them once"):
        consistency.nees(BELIEF, BELIEF.mean, ("east", "east"))
    for percentiles in ((95, 5), (5, 50, 95), (5, np.nan), 5, ("a", "b")):
        with pytest.raises(pgm.ModelError, match="percentile"):
            consistency.rmse_over_time(BELIEF, BELIEF.mean, percentiles=percentiles)
    with pytest.raises(pgm.ModelError, match="over time"):
        consistency.rmse_over_time(pgm.Gaussian(x, np.zeros(3), np.eye(3)), np.zeros(3))


def test_a_singular_component_does_not_spoil_the_others():
    belief = pgm.Gaussian(x, np.zeros(3), np.diag([1.0, 0.0, 4.0]))
    assert_allclose(consistency.nees(belief, [1.0, 0.0, 1.0], ("east", "heading")), 1.25)


STATISTICS = (
    consistency.error,
    consistency.nees,
    consistency.rmse,
    consistency.anees,
    consistency.coverage,
    consistency.rmse_over_time,
)
every_statistic = pytest.mark.parametrize("statistic", STATISTICS)


@every_statistic
def test_a_truth_that_is_infinite_is_refused(statistic):
    steps = np.arange(3, 8)
    belief = pgm.Gaussian(x, BELIEF.mean, BELIEF.cov, steps=steps)
    truth = BELIEF.mean.copy()
    truth[2, 1, 1], truth[3, 0, 0] = -np.inf, np.inf
    with pytest.raises(
        pgm.ModelError,
        match=r"\(2 of 60\), the first of north at run 2, step 4; .* not known is NaN",
    ):
        statistic(belief, truth)
    with pytest.raises(pgm.ModelError, match=r"\(2 of 60\), the first of north at run 2, 1; a tr"):
        consistency.rmse(pgm.Gaussian(x, BELIEF.mean, BELIEF.cov), truth)
    with pytest.raises(pgm.ModelError, match=r"\(1 of 3\), the first of heading; a truth"):
        consistency.rmse(pgm.Gaussian(x, np.zeros(3), np.eye(3)), [0.0, 0.0, np.inf])


@every_statistic
@pytest.mark.parametrize("shape", [(4, 1, 3), (4, 6, 3), (1, 3), (3,), (3, 3)])
def test_a_truth_at_other_steps_is_refused(statistic, shape):
    with pytest.raises(pgm.ModelError, match=r"of steps, must agree: .* its 5 steps"):
        statistic(BELIEF, np.zeros(shape))


@every_statistic
def test_several_truths_of_one_belief_are_refused(statistic):
    one = BELIEF.run(0)
    for belief in (one, pgm.Gaussian(x, one.mean, one.cov[0])):
        with pytest.raises(pgm.ModelError, match=r"of runs, must agree: .* one for all"):
            statistic(belief, np.zeros((7, 5, 3)))


def test_one_truth_may_be_that_of_all_runs():
    truth = np.random.default_rng(1).normal(size=(5, 3))
    due = consistency.nees(BELIEF, np.broadcast_to(truth, (4, 5, 3)))
    np.testing.assert_array_equal(consistency.nees(BELIEF, truth), due)
    assert consistency.coverage(BELIEF, truth).runs == 4


@every_statistic
def test_what_is_no_belief_and_no_truth_is_refused(statistic):
    with pytest.raises(pgm.ModelError, match=r"a belief is a Gaussian, .* not ndarray"):
        statistic(BELIEF.mean, BELIEF.mean)
    w = pgm.Variable("w")
    still = pgm.LinearGaussianCPD(w, {w.previous: 1.0}, cov=0.0)
    model = pgm.DynamicBayesianNetwork([pgm.GaussianCPD(w, 0.0, 1.0)], [still], [])
    gridded = pgm.filter(model, {}, steps=0, belief=pgm.Grid({"w": (-9.0, 9.0, 9)}))
    with pytest.raises(pgm.ModelError, match=r"not GridBelief\(.*; belief\.gaussian\(\) has"):
        statistic(gridded[w], np.zeros((1, 1)))
    for truth in ("truth", [["a"]], [[1.0, 2.0], [3.0]], None):
        with pytest.raises(pgm.ModelError, match="a truth"):
            statistic(BELIEF, truth)


def test_kl_refuses_what_it_cannot_compare():
    for p, q in ((BELIEF, BELIEF.mean), (None, BELIEF)):
        with pytest.raises(pgm.ModelError, match="a belief is a Gaussian"):
            consistency.kl(p, q)
    with pytest.raises(pgm.ModelError, match=r"\(4, 5\) and \(3, 5\); they must broadcast"):
        consistency.kl(BELIEF, pgm.Gaussian(x, np.zeros((3, 5, 3)), np.eye(3)))


def test_singular_covariances_are_named_with_their_remedies():
    cov = np.broadcast_to(np.diag([1.0, 2.0, 3.0]), (4, 5, 3, 3)).copy()
    cov[2, 0, 1, 1] = cov[3, 4, 0, 0] = 0.0
    belief = pgm.Gaussian(x, np.zeros((4, 5, 3)), cov, steps=np.arange(5))
    with pytest.raises(
        pgm.NumericalError, match=r"2 of 20, the first at run 2, step 0, in north\)"
    ):
        consistency.nees(belief, np.zeros((4, 5, 3)))
    with pytest.raises(pgm.NumericalError, match=r"1 of 20, the first at run 3, step 4, in east\)"):
        consistency.nees(belief, np.zeros((4, 5, 3)), ("heading", "east"))
    with pytest.raises(pgm.NumericalError, match=r"singular \(north\), .*=\(\.\.\.\)$") as caught:
        consistency.nees(pgm.Gaussian(x, np.zeros(3), cov[2, 0]), np.zeros(3))
    # What the message advises.
    assert caught.value.variable == x
    kept = [1, 2, 3]
    rest = belief[..., kept]
    assert rest.steps.tolist() == kept
    assert consistency.nees(rest, np.zeros((4, 3, 3))).max() == 0.0
    assert consistency.nees(belief, np.zeros((4, 5, 3)), ("heading",)).max() == 0.0


def test_sizes_over_time_are_numbers():
    sizes = np.ones((4, 5))
    assert consistency.over_time(sizes.tolist(), np.arange(5)).rms.tolist() == [1.0] * 5
    sizes[2, 3] = np.nan
    with pytest.raises(pgm.ModelError, match="1 of the 20 sizes are NaN"):
        consistency.over_time(sizes, np.arange(5))
    with pytest.raises(pgm.ModelError, match="over the steps"):
        consistency.over_time(np.ones((5, 4)), np.arange(5))
    with pytest.raises(pgm.ModelError, match="a size must be numbers"):
        consistency.over_time("sizes", np.arange(5))
