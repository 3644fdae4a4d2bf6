"""Rows of a comparison beside linearisers and schedules: each kind, its scores, and refusals."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.stats import multivariate_normal

import pgm
from pgm import ModelError, consistency
from pgm.examples import walk

T = 6
x = pgm.Variable("x", components=("east", "north", "heading"), angles=("heading",))
z = pgm.Variable("z", components=("east", "north"))
EVERY = np.arange(T + 1)


def drive(x):
    heading = x[..., 2]
    return x + np.stack([np.cos(heading), np.sin(heading), 0.3 + 0.0 * heading], axis=-1)


def network(noise=0.3, deviation=0.1):
    place = np.eye(2, 3)
    return pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(x, [0.0, 0.0, 0.5], np.diag([0.2, 0.2, 0.3]))],
        [pgm.NonlinearGaussianCPD(x, x.previous, drive, cov=deviation**2)],
        [pgm.LinearGaussianCPD(z, {x: place}, cov=noise)],
    )


MODEL = network()
SEEN = pgm.sightings(step=EVERY)
DRAWN = MODEL.sample({z: SEEN}, steps=T, rng=0)
READ = {z: pgm.sightings(DRAWN[z], step=EVERY)}
TRUTH = {x: DRAWN[x]}
BEST = pgm.smooth(MODEL, READ, steps=T, lineariser=pgm.Cubature())


def compared(rows, **given):
    return pgm.compare(MODEL, READ, rows=rows, truth=TRUTH, steps=T, **given)


def scores(belief, row):
    """The scores of a belief, each by its own formula."""
    errors = consistency.error(belief, TRUTH[x])
    assert_allclose(list(row.rmse.values()), np.sqrt(np.mean(errors**2, axis=-2)))
    assert row.nees == pytest.approx(consistency.nees(belief, TRUTH[x]).mean())
    due = [
        multivariate_normal(cov=cov).logpdf(e) for cov, e in zip(belief.cov, errors, strict=True)
    ]
    assert row.log_score == pytest.approx(np.mean(due))


def test_posteriors_are_rows_as_they_are():
    other = pgm.smooth(network(0.6), READ, steps=T)
    found = compared(
        {"best": BEST, "forward": BEST.filtered, "other": other},
        oracle=pgm.smooth(MODEL, READ, steps=T),
    )
    assert [row.kind.name for row in found.rows] == ["smoothed", "filtered", "smoothed"]
    scores(BEST[x], found["best"])
    scores(BEST.filtered[x], found["forward", "filtered"])
    scores(other[x], found["other", "smoothed", x])
    due = consistency.kl(pgm.smooth(MODEL, READ, steps=T)[x], other[x])
    assert_allclose(found["other"].kl_by_step, due)
    assert np.isnan(found["best"].seconds)
    assert found["best"].log_evidence == BEST.log_evidence
    assert "Comparison of 3 rows" in repr(found)


def test_models_noises_schedules_and_families_are_run():
    """Each as the call that it stands for."""
    noisy, huber = network(0.6), pgm.Huber(1.5)
    robust = MODEL.replace(
        observation=[pgm.LinearGaussianCPD(z, {x: np.eye(2, 3)}, cov=0.3, noise=huber)]
    )
    cloud = pgm.Particles(300, seed=4)
    rows = {
        "noisy": noisy,
        "Huber": huber,
        "iterated": pgm.Smoothing(iterations=4),
        "cubature": pgm.Cubature(),
        "particles": cloud,
    }
    found = compared(rows)
    assert len(found.rows) == 9
    for schedule, run in (("filter", pgm.filter), ("smoother", pgm.smooth)):
        scores(run(noisy, READ, steps=T)[x], found["noisy", schedule])
        scores(run(robust, READ, steps=T)[x], found["Huber", schedule])
        scores(run(MODEL, READ, steps=T, lineariser=pgm.Cubature())[x], found["cubature", schedule])
        scores(run(MODEL, READ, steps=T, belief=cloud)[x].gaussian(), found["particles", schedule])
    row = found["iterated"]
    assert row.schedule == "smoother × 4"
    assert row.converged in (0.0, 1.0)
    assert row.seconds > 0.0
    both = compared({"noisy": noisy}, linearisers=[pgm.Taylor()])
    assert [row.lineariser for row in both.rows] == ["Taylor", "Taylor", "noisy", "noisy"]


def test_an_audit_is_a_row_by_its_corrected_moments():
    audit = pgm.audit(BEST, samples=200, rng=0)
    found = compared({"audit": audit, "best": BEST}, oracle=BEST)
    scores(audit.corrected[x], found["audit"])
    assert found["audit"].kl == pytest.approx(consistency.kl(BEST[x], audit.corrected[x]).mean())


def test_gaussians_and_values_are_rows():
    belief, values = BEST[x], BEST[x].mean.copy()
    values[2] = np.nan
    values[:, 2] = np.nan
    found = compared({"Gaussian": belief, "values": {x: values}, "both": {x: belief}}, oracle=BEST)
    scores(belief, found["Gaussian"])
    assert found["both"].kl == found["Gaussian"].kl == pytest.approx(0.0, abs=1e-12)
    row = found["values"]
    kept = np.delete(EVERY, 2)
    errors = (values - TRUTH[x])[kept][:, :2]
    assert_allclose([row.rmse["east"], row.rmse["north"]], np.sqrt(np.mean(errors**2, axis=0)))
    assert np.isnan([row.rmse["heading"], row.kl, row.nees, row.log_score]).all()
    assert row.left_out == 0


def test_imported_poses_are_a_row_and_a_truth():
    times = 0.5 * np.arange(T + 1)
    names = {"position": ("east", "north"), "heading": "heading"}
    path = pgm.Poses.of(BEST[x], times=times, **names)
    later = pgm.Poses(path.times[1:] + 0.004, path.position[1:], path.orientation[1:])
    values = later.along(x, times=times, **names)
    assert np.isnan(values[0]).all()
    assert_allclose(values[1:, :2], BEST[x].mean[1:, :2])
    row = compared({"odometry": {x: values}})["odometry"]
    errors = consistency.error(BEST[x], TRUTH[x])[1:]
    assert_allclose(list(row.rmse.values()), np.sqrt(np.mean(errors**2, axis=0)), rtol=1e-9)
    against = pgm.compare(MODEL, READ, rows={"best": BEST}, oracle={x: values}, steps=T)["best"]
    assert_allclose(list(against.rmse.values()), 0.0, atol=1e-9)
    with pytest.raises(ModelError, match=r"'odometry', which is Poses; .*along\(x, times="):
        compared({"odometry": path})
    with pytest.raises(ModelError, match=r"truth= is Poses; .*along\(x, times="):
        pgm.compare(MODEL, READ, truth=path, steps=T)


def test_errors_over_runs_are_those_of_independent_runs():
    """By the spread of many batches of six; NaN of one run."""
    found = []
    for seed in range(80):
        drawn = MODEL.sample({z: SEEN}, steps=T, runs=6, rng=seed)
        read = {z: pgm.sightings(drawn[z], step=EVERY)}
        plan = [pgm.Smoothing()]
        row = pgm.compare(
            MODEL, read, linearisers=[pgm.Cubature()], schedules=plan, truth={x: drawn[x]}, steps=T
        ).rows[0]
        found.append(
            [
                *(row.nees, row.log_score, row.rmse["east"]),
                *(row.nees_error, row.log_score_error, row.rmse_error["east"]),
            ]
        )
    values, errors = np.split(np.array(found), 2, axis=1)
    assert_allclose(np.sqrt(np.mean(errors**2, axis=0)), values.std(axis=0), rtol=0.25)
    single = compared({"best": BEST})["best"]
    assert np.isnan([single.nees_error, single.log_score_error, single.rmse_error["east"]]).all()


def test_several_oracles_and_a_truth_have_columns_of_their_own():
    smoothed = pgm.smooth(MODEL, READ, steps=T)
    audit = pgm.audit(BEST, samples=300, rng=0)
    rows = {"Taylor": smoothed}
    found = pgm.compare(MODEL, READ, rows=rows, oracle=[BEST, audit, TRUTH], steps=T)
    assert found.oracles == ("oracle", "Audit")
    row = found["Taylor"]
    assert_allclose(row.by_oracle["oracle"].kl_by_step, consistency.kl(BEST[x], smoothed[x]))
    assert row.kl == row.by_oracle["oracle"].kl
    assert row.nees > 0.0
    head = repr(found).splitlines()[1]
    assert "KL oracle" in head
    assert "KL Audit" in head
    assert found.oracle.endswith("; the truth of x")
    assert found.oracle in repr(found).splitlines()[0]
    twice = pgm.compare(MODEL, READ, rows=rows, oracle=[audit, audit], steps=T)
    assert twice.oracles == ("Audit 1", "Audit 2")
    filtered = pgm.compare(
        MODEL,
        READ,
        rows={"a": BEST, "b": BEST.filtered},
        oracle={"a": BEST.filtered, "b": audit},
        steps=T,
    )
    assert [list(row.by_oracle) for row in filtered.rows] == [["b"], ["a"]]


REFUSED = [
    ({"rows": [BEST]}, "rows= maps labels to rows"),
    ({"rows": {}}, "rows= is empty"),
    ({"rows": {1: BEST}}, "found the name 1"),
    ({"rows": {"a": 3}}, "rows= has 'a', which is 3; a row is a posterior"),
    ({"rows": {"a": {z: np.zeros((T + 1, 2))}}}, "'a' of rows= has values of z; the states"),
    ({"rows": {"a": {x: np.zeros((T, 3))}}}, r"shape \(6, 3\); \(7, 3\) was due"),
    ({"rows": {"a": {x: np.full((T + 1, 3), np.nan)}}}, "infinite, or NaN throughout"),
    ({"rows": {"a": {}}}, "'a' of rows= is empty"),
    ({"rows": {"a": BEST[x][1:]}}, r"means of shape \(6, 3\); \(7, 3\) was due"),
    ({"rows": {"a": walk}}, "has no state x, which is compared"),
    ({"rows": {"Taylor": network(0.6)}, "linearisers": [pgm.Taylor()]}, "'Taylor', filter both"),
    ({"rows": {"a": BEST}, "oracle": BEST.filtered}, "are filtered, and a row's are smoothed"),
    ({"rows": {"a": BEST}, "oracle": {"b": 3, "c": BEST}}, "oracle= has 'b', which is a pgm.Grid"),
    ({"rows": {"a": BEST}, "oracle": [TRUTH, TRUTH]}, "give the truth once"),
    ({"rows": {"a": BEST}, "oracle": BEST, "repeats": 3}, "repeats is a whole number"),
]


@pytest.mark.parametrize(("given", "told"), REFUSED)
def test_what_is_no_row_or_oracle_is_refused_before_any_run(given, told, monkeypatch):
    def ran(*_, **__):
        raise AssertionError("work was started")

    monkeypatch.setattr("pgm.comparison.entries.send", ran)
    with pytest.raises(ModelError, match=told):
        pgm.compare(MODEL, READ, steps=T, **given)


def test_a_posterior_of_other_steps_is_refused():
    short = {z: pgm.sightings(DRAWN[z][:-1], step=EVERY[:-1])}
    with pytest.raises(ModelError, match=r"'a' of rows=: its marginal of x .*\(6, 3\); \(7, 3\)"):
        compared({"a": pgm.smooth(MODEL, short, steps=T - 1)})


def test_a_row_that_fails_has_its_error_and_the_rest_are_judged():
    bad = network().replace(
        transition=[
            pgm.NonlinearGaussianCPD(
                x, x.previous, lambda x: np.where(x > 1e-9, x, np.nan) if x.size > 9 else x, cov=0.1
            )
        ]
    )
    found = compared({"bad": bad, "best": BEST}, schedules=[pgm.Filtering()])
    assert found["bad"].error.startswith("LinearisationError")
    assert np.isfinite(found["best"].nees)
    with pytest.raises(ModelError, match=r"\['bad', 'best'\]"):
        found["worst"]
    many = compared({"noisy": network(0.6)})
    with pytest.raises(ModelError, match=r"name the schedule, \['noisy', 'filter'\]"):
        many["noisy"]
