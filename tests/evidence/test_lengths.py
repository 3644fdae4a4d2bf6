"""Arrays that do not tell one number of steps are refused, or warned of, with what to write."""

import warnings

import numpy as np
import pytest

import pgm

x, u, z = pgm.Variable("x", components=("p", "v")), pgm.Variable("u"), pgm.Variable("z")
pair = pgm.Variable("pair", components=("p", "v"))
MODEL = pgm.DynamicBayesianNetwork(
    [pgm.GaussianCPD(x, [0.0, 1.0], 1.0)],
    [pgm.LinearGaussianCPD(x, {x.previous: [[1, 1], [0, 1]], u: [[0], [1]]}, 0.01)],
    [
        pgm.LinearGaussianCPD(z, {x: [[1, 0]]}, 0.25),
        pgm.LinearGaussianCPD(pair, {x: 1.0}, 0.25),
    ],
)
s, o = pgm.Discrete("s", 2), pgm.Discrete("o", 2)
HMM = pgm.DynamicBayesianNetwork(
    [pgm.TableCPD(s, table=[0.5, 0.5])],
    [pgm.TableCPD(s, s.previous, table=[[0.9, 0.1], [0.2, 0.8]])],
    [pgm.TableCPD(o, s, table=[[0.8, 0.2], [0.3, 0.7]])],
)
T = 6
US, ZS = np.linspace(-1.0, 1.0, T)[:, None], np.sin(np.arange(1.0, T + 1))[:, None]
KNOWN = pgm.constant([0.0])


def refused(evidence, *words, model=MODEL, steps=None, variable=None):
    with pytest.raises(pgm.EvidenceError) as caught:
        pgm.filter(model, evidence, steps=steps)
    for word in words:
        assert word in str(caught.value)
    assert variable is None or caught.value.variable == variable


def test_readings_that_end_early():
    """The refusal says how to go on, and all ways that it names give the same forecast."""
    inputs = {u: np.zeros((T + 4, 1))}
    told = "give it 4 rows more, of NaN", f"pgm.sightings(values, step=np.arange(1, {T + 1}))"
    refused(inputs | {z: ZS}, *told, f"steps={T + 4} says so", variable=z)
    padded = np.concatenate([ZS, np.full((4, 1), np.nan)])
    first = pgm.filter(MODEL, inputs | {z: padded})[x]
    second = pgm.filter(MODEL, inputs | {z: pgm.sightings(ZS, step=np.arange(1, T + 1))})[x]
    third = pgm.filter(MODEL, inputs | {z: ZS}, steps=T + 4)
    np.testing.assert_allclose(first.mean, second.mean, rtol=1e-12)
    np.testing.assert_array_equal(second.mean, third[x].mean)
    assert third.innovations[z].residual.shape == ZS.shape
    known = pgm.filter(MODEL, {u: np.zeros((T, 1)), z: ZS})[x]
    mean, cov, move = known.mean[-1], known.cov[-1], np.array([[1.0, 1.0], [0.0, 1.0]])
    for _ in range(4):
        mean, cov = move @ mean, move @ cov @ move.T + 0.01 * np.eye(2)
    np.testing.assert_allclose(first.mean[-1], mean, rtol=1e-10)
    np.testing.assert_allclose(first.cov[-1], cov, rtol=1e-10)


def test_arrays_that_do_not_end_early():
    """Inputs must be known at all steps, and 4 runs of one row are no run of 4 steps."""
    refused({u: US[:2], z: ZS[:2]}, "give u 1 row more", steps=3, variable=u)
    refused({u: np.zeros((4, 1)), z: np.zeros((4, 1, 1))}, "np.reshape", steps=4, variable=z)
    refused({u: US[:2], z: ZS[:3]}, "leave a row of it out", steps=2, variable=z)


def test_states_that_end_early():
    shorter = pgm.filter(HMM, {o: [0, 1]}, steps=4)[s]
    said = pgm.filter(HMM, {o: pgm.sightings([0, 1], step=np.arange(1, 3))}, steps=4)[s]
    padded = pgm.filter(HMM, {o: [0, 1, -1, -1]}, steps=4)[s]
    np.testing.assert_allclose(said.probabilities, padded.probabilities)
    np.testing.assert_array_equal(said.probabilities, shorter.probabilities)


@pytest.mark.parametrize("steps", [T, None])
def test_one_control_more_than_readings(steps):
    longer = np.concatenate([US, [[0.5]]])
    words = "leave a row of u out", "values[..., :-1, :]", "values[..., 1:, :]"
    refused({u: longer, z: ZS}, *words, steps=steps, variable=u)


@pytest.mark.parametrize("steps", [T, None])
def test_one_reading_more_than_controls(steps):
    longer = np.concatenate([[[0.1]], ZS])
    evidence = {u: US, z: longer}
    refused(evidence, f"pgm.sightings(values, step=np.arange({T + 1}))", steps=steps, variable=z)
    assert (
        pgm.filter(MODEL, {u: US, z: pgm.sightings(longer, step=np.arange(T + 1))})[x].steps[-1]
        == T
    )


def test_other_lengths():
    refused({u: US[:3], z: ZS}, "give u 3 rows more: an input must be known", variable=u)
    refused({u: US[:1], z: ZS}, "pgm.constant(value) where u is equal", variable=u)
    refused({u: US, z: ZS}, "leave the others out, values[..., :2, :]", "or give steps=6", steps=2)
    refused({u: US, z: ZS}, "steps 1..0 (none)", steps=0)
    refused({u: US[:1]}, "1 row, of steps 1, where steps 1..3", steps=3)
    with pytest.raises(pgm.EvidenceError, match=r"steps 1\.\.9 are asked for; give u 3 rows more"):
        pgm.infer(pgm.compile(MODEL, 9), {u: US})


def test_nothing_tells_the_number_of_steps():
    """A control that is missing is named, since its array would tell."""
    refused({z: pgm.sightings(ZS, step=range(T))}, "no evidence for u", "steps=", variable=u)
    refused({u: KNOWN, z: pgm.sightings(ZS, step=range(T))}, "steps=, the last step, T: 5")
    refused({u: KNOWN}, "give steps=, the last step, T")
    refused({}, "give steps=, the last step, T", model=HMM)


COLUMNS = {
    "scalars": (MODEL, {u: KNOWN, z: ZS[:, :, None]}, "np.reshape(values, (-1, 1))"),
    "a list": (MODEL, {u: KNOWN, z: [np.array([[value]]) for (value,) in ZS]}, "(6, 1, 1)"),
    "rows": (MODEL, {u: KNOWN, pair: np.zeros((T, 1, 2))}, "np.reshape(values, (-1, 2))"),
    "controls": (MODEL, {u: US[:, None]}, "evidence for u is of 6 runs with one step each"),
    "states": (HMM, {o: [[0], [1], [1]]}, "np.reshape(values, -1)"),
    "weights": (HMM, {o: pgm.soft(np.ones((3, 1, 2)))}, "np.reshape(values, (-1, 2))"),
}


@pytest.mark.parametrize(("model", "evidence", "words"), COLUMNS.values(), ids=COLUMNS)
def test_columns_are_runs_of_one_step_and_told(model, evidence, words):
    with pytest.warns(pgm.EvidenceWarning) as caught:
        pgm.smooth(model, evidence)
    (one,) = caught
    assert words in str(one.message)
    assert one.filename == __file__
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        pgm.smooth(model, evidence, steps=1)  # meant
        pgm.infer(pgm.compile(model, 1), evidence)


def test_runs_that_the_model_has_are_no_columns():
    runs = MODEL.replace(prior=[pgm.GaussianCPD(x, np.zeros((T, 2)), 1.0)])
    found = pgm.filter(runs, {u: KNOWN, z: ZS[:, :, None]})
    assert found[x].mean.shape == (T, 2, 2)


def test_columns_beside_rows():
    refused({u: US, z: ZS[:, :, None]}, "6 steps of one run are np.reshape(values, (-1, 1))")
    refused({u: US, pair: np.zeros((T, 2, 1))}, "(6, 2, 1)", "np.asarray(value)[..., 0]")
    refused({u: US, pair: np.zeros((2, T))}, "(2, 6)", "np.swapaxes(value, -1, -2)")
    seen = pgm.sightings(ZS[:, :, None], step=range(T))
    told = "1 measurements with 6 steps", "np.reshape(values, (-1, 1))"
    refused({u: US, z: seen}, *told, steps=T)
    robot = pgm.OnlineFilter(MODEL)
    with pytest.raises(pgm.EvidenceError, match=r"shape \(2, 1\).*\[\.\.\., 0\]"):
        robot.update(robot.initial(), {pair: [[0.1], [0.2]]})


def test_a_sensor_in_the_transition():
    where = "if it is a sensor's measurement, the CPD belongs in observation="
    inside = MODEL.replace(transition=[*MODEL.transition, MODEL.observation[0]], observation=[])
    refused({u: US, z: ZS}, "evidence for z", where, model=inside, variable=z)
    robot = pgm.OnlineFilter(inside)
    with pytest.raises(pgm.EvidenceError, match=where):
        robot.update(robot.initial(), {z: [1.0]})
    tables = HMM.replace(transition=[*HMM.transition, *HMM.observation], observation=[])
    refused({o: [0, 1]}, where, model=tables, variable=o)
    with pytest.raises(pgm.EvidenceError) as caught:
        pgm.filter(MODEL, {u: US, x: np.zeros((T, 2))})
    assert "declare a sensor of it" in str(caught.value)
    assert "observation=" not in str(caught.value)  # motion depends on it: it is no measurement


def test_other_parts_that_CPDs_do_not_belong_in():
    prior, motion, sensor = *MODEL.prior, *MODEL.transition, MODEL.observation[0]
    with pytest.raises(
        pgm.ModelError, match=r"state z has a prior .* belongs in observation= alone"
    ):
        pgm.DynamicBayesianNetwork([prior, sensor], [motion])
    with pytest.raises(pgm.ModelError, match=r"state x .* a motion belongs in transition="):
        pgm.DynamicBayesianNetwork([prior], [], [motion])


SEEN = pgm.sightings(ZS, step=np.arange(1, T + 1))
LONGER = np.concatenate([US, [[0.5]]])


@pytest.mark.parametrize("call", [pgm.filter, pgm.smooth])
def test_one_control_more_than_sightings_is_told(call):
    """The two ways that it names are silent: T steps without the row, or a forecast of T + 1."""
    with pytest.warns(pgm.EvidenceWarning) as caught:
        told = call(MODEL, {u: LONGER, z: SEEN})
    (one,) = caught
    for words in ("u has 7 rows", "last sighting is at step 6", "values[..., :-1, :]", "steps=7"):
        assert words in str(one.message)
    assert one.filename == __file__
    forecast = call(MODEL, {u: LONGER, z: SEEN}, steps=T + 1)[x]
    np.testing.assert_array_equal(told[x].mean, forecast.mean)
    dropped = call(MODEL, {u: LONGER[:-1], z: SEEN})[x]
    plain = call(MODEL, {u: US, z: ZS})[x]
    np.testing.assert_allclose(dropped.mean, plain.mean, rtol=1e-12)


@pytest.mark.parametrize(
    ("evidence", "steps"),
    [
        ({u: LONGER, z: pgm.sightings(ZS[::2], step=[1, 3, 6])}, None),  # a slow sensor
        ({u: np.zeros((T + 2, 1)), z: SEEN}, None),  # a forecast of several steps
        ({u: US, z: SEEN}, None),
        ({u: LONGER, z: SEEN, pair: np.zeros((T + 1, 2))}, None),  # measured at the last step
        ({u: LONGER, z: SEEN}, T + 1),
        ({u: US[:1], z: pgm.sightings(ZS[:1], step=[0])}, None),  # only the start was seen
    ],
    ids=["some", "several", "equal", "plain", "asked", "start"],
)
def test_other_sightings_are_not_told(evidence, steps):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        pgm.filter(MODEL, evidence, steps=steps)
