"""The digits that a status tells, the warning below six, and numbers at the ends of float64."""

import warnings

import numpy as np
import pytest
from crossed import crossed
from drawn_chains import draw
from judged_chains import Judge
from precise import Reference, floats

import pgm
from pgm.posteriors.status import FAR_APART, digits

x = pgm.Variable("x", components=("position", "velocity"))
z = pgm.Variable("z")
STEPS = 8


def tracked(prior, reading, push=0.01):
    """A constant velocity, deviations of the prior and of readings."""
    moved = np.array([[1.0, 1.0], [0.0, 1.0]])
    return pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(x, [0.0, 0.0], np.eye(2) * prior**2)],
        [pgm.LinearGaussianCPD(x, {x.previous: moved}, cov=np.diag([0.0, push]))],
        [pgm.LinearGaussianCPD(z, {x: [[1.0, 0.0]]}, cov=[[reading**2]])],
    )


def record(runs=None):
    lead = () if runs is None else (runs,)
    return 30.0 + np.cumsum(np.random.default_rng(3).normal(size=(*lead, STEPS, 1)), axis=-2)


def balanced(model, evidence, schedule):
    tree = pgm.compile(model, steps=STEPS, method=pgm.Balanced())
    return pgm.infer(tree, evidence, schedule=schedule)


WAYS = {
    "filter": pgm.filter,
    "smooth": pgm.smooth,
    "balanced": lambda model, evidence: balanced(model, evidence, pgm.Smoothing()),
}


@pytest.mark.parametrize("way", WAYS)
def test_ordinary_models_need_no_more_than_float64(way):
    """A robot with a prior deviation of a thousand and a receiver of one metre."""
    assert WAYS[way](tracked(1e3, 1.0), {z: record()}).status.digits is None


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("runs", [None, 40])
def test_digits_are_measured_where_deviations_lie_far_apart(way, runs):
    """A number for each run; a prior deviation of 1e6 and a receiver of one leave more than ten."""
    status = WAYS[way](tracked(1e6, 1.0), {z: record(runs)}).status
    assert np.shape(status.digits) == (() if runs is None else (runs,))
    assert (status.digits > 10.0).all()
    assert "digits" not in repr(status)
    assert not status.digits.flags.writeable


def test_a_robot_with_a_wide_prior_is_not_warned():
    robot = pgm.OnlineFilter(tracked(1e6, 1.0))
    belief = robot.initial()
    measured = []
    for value in record():
        belief = robot.update(robot.predict(belief), {z: value})
        measured.append(belief.status.digits)
    assert measured[-1] is None or measured[-1] > 10.0


def test_digits_are_those_of_an_error():
    found = digits(np.array([1e-3, 1e-7, 0.0, 2.0]), (2, 2))
    due = -np.log10([[1e-3, 1e-7], [np.finfo(float).eps, 2.0]])
    np.testing.assert_allclose(found, due)


@pytest.mark.parametrize(("error", "told"), [(0.99e-6, False), (1.01e-6, True)])
def test_the_warning_is_for_less_than_six_digits(error, told):
    """In any run; the words say where these are to be found."""
    status = pgm.results.Status(1, np.empty((0, 2)), np.ones(2, dtype=bool))
    measured = digits(np.array([1e-12, error]), (2,))
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        status = status._measured(measured, FAR_APART)
        status._warn()
    assert status.digits is measured
    assert len(caught) == told
    assert ("digits left" in repr(status)) == told
    if told:
        assert caught[0].category is pgm.PrecisionWarning
        assert "fewer than 6 decimal digits" in str(caught[0].message)
        assert "status.digits says in which runs" in str(caught[0].message)


# ---- right, or told


def asked(way, model, evidence):
    """Beliefs at the last step, the log-evidence, and the status that tells least."""
    if way != "online":
        posterior = WAYS[way](model, evidence)
        return posterior[x.at(STEPS)], posterior.log_evidence, posterior.status
    robot = pgm.OnlineFilter(model)
    belief, least = robot.initial(), None
    for value in evidence[z]:
        belief = robot.update(robot.predict(belief), {z: value})
        if least is None or (belief.status.digits or 16.0) < (least.digits or 16.0):
            least = belief.status
    return belief[x], belief.log_evidence, least


@crossed(("prior", "way"), [1e9, 1e12, 1e14, 1e15, 1e17, 1e20, 1e40, 1e100], [*WAYS, "online"])
def test_a_prior_that_is_too_wide_is_told(way, prior):
    """The belief is right to 1e-6 deviations, or the warning comes."""
    values = record()
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        belief, log_evidence, status = asked(way, tracked(prior, 0.1), {z: values})
    readings = [(z, k + 1, row, {}) for k, row in enumerate(values)]
    due = Reference(tracked(prior, 0.1), STEPS, {}, readings)
    mean, cov = (floats(part) for part in due.filtered[STEPS])
    std = np.sqrt(np.diag(cov))
    right = (np.abs(belief.mean - mean) <= 1e-6 * std).all()
    right &= (np.abs(belief.cov - cov) <= 1e-6 * np.outer(std, std)).all()
    right &= abs(log_evidence - float(due.log_evidence)) < 1e-6
    told = status.digits is not None and status.digits < 6.0
    # Beliefs without a digit may be lost, too.
    caught = [each for each in caught if not (told and each.category is pgm.LostWarning)]
    assert all(each.category is pgm.PrecisionWarning for each in caught)
    assert bool(caught) == told
    assert ("digits left" in repr(status)) == told
    assert right or told
    assert (right and not told) or prior > 1e13


@pytest.mark.parametrize("seed", [1083])
def test_a_drawn_chain_that_tells(seed):
    """Of its answers some are wrong, and all tell."""
    case = draw(seed, 8)
    with pytest.warns(pgm.PrecisionWarning, match="status.digits says in which runs"):
        posterior = pgm.smooth(case.model, case.evidence, steps=case.steps)
    assert posterior.status.digits < 6.0
    assert "0.0 digits left" in repr(posterior.status)
    assert {v.category for v in Judge(case).verdicts()} == {"told", "cried"}


# ---- numbers at the ends of float64


def anywhere(rng, *shape, signed=False):
    """Numbers from 1e-320 to 1e308, a few of them zero, most of them plain."""
    exponents = np.where(rng.random(shape) < 0.8, 0.0, rng.uniform(-320.0, 308.0, shape))
    numbers = rng.uniform(1.0, 1.7, shape) * 10.0**exponents
    numbers[rng.random(shape) < 0.1] = 0.0
    return numbers * rng.choice([-1.0, 1.0], shape) if signed else numbers


def extreme(seed):
    """A model of two components and a reading of one or two, and evidence."""
    rng = np.random.default_rng([seed, 19])
    sizes = rng.integers(1, 3)
    v = pgm.Variable("v", components=("a", "b"))
    y = pgm.Variable("y", components=("c", "d")[:sizes])

    def noise(size):
        return np.diag(anywhere(rng, size))

    model = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(v, anywhere(rng, 2, signed=True), noise(2))],
        [
            pgm.LinearGaussianCPD(
                v,
                {v.previous: anywhere(rng, 2, 2, signed=True)},
                offset=anywhere(rng, 2, signed=True),
                cov=noise(2),
            )
        ],
        [pgm.LinearGaussianCPD(y, {v: anywhere(rng, sizes, 2, signed=True)}, cov=noise(sizes))],
    )
    lead = (40,) if seed % 10 == 9 else ()
    return v, y, model, anywhere(rng, *lead, 4, sizes, signed=True)


def finite(belief, log_evidence):
    assert np.isfinite(belief.mean).all()
    assert np.isfinite(belief.cov).all()
    assert (np.diagonal(belief.cov, axis1=-2, axis2=-1) >= 0.0).all()
    assert np.isfinite(log_evidence).all()
    return True


def by_chain(run, model, v, evidence):
    posterior = run(model, evidence)
    return finite(posterior[v], posterior.log_evidence)


def by_robot(model, v, evidence):
    [(y, values)] = evidence.items()
    robot = pgm.OnlineFilter(model)
    belief = robot.initial()
    for step in range(values.shape[-2]):
        belief = robot.update(robot.predict(belief), {y: values[..., step, :]})
        finite(belief[v], belief.log_evidence)
    return True


def by_tree(schedule):
    def run(model, evidence):
        tree = pgm.compile(model, steps=4, method=pgm.Balanced())
        return pgm.infer(tree, evidence, schedule=schedule)

    return run


ENDS = {
    "filter": lambda *a: by_chain(pgm.filter, *a),
    "smooth": lambda *a: by_chain(pgm.smooth, *a),
    "balanced filter": lambda *a: by_chain(by_tree(pgm.Filtering()), *a),
    "balanced": lambda *a: by_chain(by_tree(pgm.Smoothing()), *a),
    "online": by_robot,
}


@pytest.mark.filterwarnings("ignore::pgm.PrecisionWarning")
@pytest.mark.parametrize("way", ENDS)
def test_numbers_at_the_ends_of_float64(way):
    """A finite answer, or an error of this library; NumPy's warnings are errors here."""
    answered = 0
    for seed in range(60):
        v, y, model, values = extreme(seed)
        try:
            answered += ENDS[way](model, v, {y: values})
        except pgm.PgmError:
            continue
        except Exception as error:
            raise AssertionError(f"seed {seed}") from error
    assert answered >= 10


@pytest.mark.parametrize("way", ["filter", "online"])
@pytest.mark.parametrize("apart", [1e-7, 1e-8, 0.0])
def test_an_exact_reading_that_rounding_hides_is_told(apart, way):
    """All but a repetition, it would determine the state; a repetition says nothing."""
    state, sharp = pgm.Variable("state", ("a", "b")), pgm.Variable("sharp")
    exact, truth = pgm.Variable("exact", ("p", "q")), np.array([1.1, 0.37])
    see, know = np.array([[1.0, 2.0]]), np.array([[1.0, -2.0], [1.0 + apart, -2.0]])
    nothing = np.zeros((2, 2))
    model = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(state, [0.0, 0.0], np.diag([1e8, 1e6]))],
        [pgm.LinearGaussianCPD(state, {state.previous: 1.0}, cov=nothing)],
        [
            pgm.LinearGaussianCPD(sharp, {state: see}, cov=1e-13),
            pgm.LinearGaussianCPD(exact, {state: know}, cov=nothing),
        ],
    )

    def run():
        if way == "filter":
            values = {sharp: see @ truth, exact: know @ truth}
            seen = {z: pgm.sightings([value], step=[0]) for z, value in values.items()}
            return pgm.filter(model, seen, steps=0)
        robot = pgm.OnlineFilter(model)
        belief = robot.update(robot.initial(), {sharp: see @ truth})
        return robot.update(belief, {exact: know @ truth})

    if apart:
        with pytest.warns(pgm.PrecisionWarning):
            found = run()
        assert found.status.digits < 2
    else:
        found = run()
        assert found.status.digits > 6
    np.testing.assert_allclose(found[state].mean.reshape(-1), truth, atol=1e-6)
