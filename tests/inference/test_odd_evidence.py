"""Evidence that is legal, and easily forgotten."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

import pgm
from pgm import examples

x, i, m = pgm.variables("x i m")
z, other = pgm.variables("z other")
WALK = pgm.LinearGaussianCPD(x, {x.previous: 1.0}, cov=0.1)
PRIOR = pgm.GaussianCPD(x, 0.0, 1.0)


def test_two_sensors_may_share_an_input_with_other_axes_of_runs():
    seen = [pgm.NonlinearGaussianCPD(each, (x, m), lambda x, m: x - m, 0.1) for each in (z, other)]
    model = pgm.DynamicBayesianNetwork([PRIOR], [WALK], seen)
    rng = np.random.default_rng(0)
    many, one, values = rng.normal(size=(5, 2, 1)), rng.normal(size=(2, 1)), np.zeros((2, 1))
    posterior = pgm.filter(
        model,
        {
            z: pgm.sightings(values, [1, 2], {m: many}),
            other: pgm.sightings(values, [1, 2], {m: one}),
        },
        steps=2,
    )
    for run in range(5):
        alone = pgm.filter(
            model,
            {
                z: pgm.sightings(values, [1, 2], {m: many[run]}),
                other: pgm.sightings(values, [1, 2], {m: one}),
            },
            steps=2,
        )
        assert_allclose(posterior[x].mean[run], alone[x].mean, atol=1e-12)


def test_no_readings_may_be_written_as_an_empty_list():
    model = pgm.DynamicBayesianNetwork(
        [PRIOR], [WALK], [pgm.NonlinearGaussianCPD(z, (x, m), lambda x, m: x - m, 0.1)]
    )
    none = pgm.sightings([], step=[], given={m: []})
    bare = pgm.filter(model, {}, steps=3)
    assert_allclose(pgm.filter(model, {z: none}, steps=3)[x].mean, bare[x].mean)
    robot = pgm.OnlineFilter(model)
    belief = robot.update(robot.initial(), {z: pgm.sightings([], given={m: []})})
    assert_allclose(belief[x].cov, 1.0)


def test_a_function_of_inputs_alone_may_not_give_nan():
    w = pgm.Variable("w")
    model = pgm.DynamicBayesianNetwork(
        [PRIOR],
        [WALK, pgm.NonlinearGaussianCPD(w, i, np.sqrt, 1.0)],
    )
    with np.errstate(invalid="ignore"), pytest.raises(pgm.LinearisationError, match="step 2"):
        pgm.filter(model, {i: [[1.0], [-1.0], [1.0]]})


def test_innovations_of_a_sensor_that_sees_nothing_hidden():
    model = pgm.DynamicBayesianNetwork(
        [PRIOR], [WALK], [pgm.NonlinearGaussianCPD(z, m, lambda m: 2.0 * m, 0.25)]
    )
    posterior = pgm.filter(model, {z: np.ones((3, 1)), m: np.full((3, 1), 0.25)})
    assert_allclose(posterior.innovations[z].residual, 0.5)
    assert_allclose(posterior.innovations[z].nis[1:], 1.0)


def test_a_lost_cpd_is_found_by_the_check(monkeypatch):
    model = pgm.DynamicBayesianNetwork(
        [PRIOR], [WALK], [pgm.LinearGaussianCPD(z, {x: 1.0}, cov=1.0)]
    )
    graph = pgm.compile(model, 3)
    whole = type(model).cpds_at
    monkeypatch.setattr(type(model), "cpds_at", lambda self, step: whole(self, step)[:1])
    with pytest.raises(pgm.GraphError, match="assigned to 0 clusters"):
        graph.check()


@pytest.mark.filterwarnings("ignore::pgm.PrecisionWarning")
def test_a_reading_that_float64_cannot_hold_is_refused_by_its_run():
    """Among several runs; of one run there is none to name."""
    huge = np.array([[[9.0]], [[1e300]], [[1.0]]])
    for readings, of in ((huge, ", run 1, "), (huge[1], " ")):
        with pytest.raises(pgm.NumericalError, match=f"z at step 1{of}is indefinite or not finite"):
            pgm.smooth(examples.squares, {examples.z: readings}, steps=1)
    posterior = pgm.infer(pgm.compile(examples.square), {examples.y: huge[:, 0]})
    with pytest.raises(pgm.NumericalError, match="beyond the range of float64 in run 1: a meas"):
        posterior.log_evidence  # noqa: B018


def test_angles_that_are_infinite_throughout_are_refused_alone():
    """Without a warning of the look whether they are degrees."""
    heading = pgm.Variable("heading", angles=("heading",))
    sensor = pgm.LinearGaussianCPD(heading, {x: 1.0}, cov=1.0)
    model = pgm.DynamicBayesianNetwork([PRIOR], [WALK], [sensor])
    with pytest.raises(pgm.EvidenceError, match="heading has infinite entries"):
        pgm.filter(model, {heading: np.full((3, 1), np.inf)})
