"""Fixed lags online: step by step what recorded readings give; immutable, of constant size."""

import pickle
from concurrent.futures import ThreadPoolExecutor
from types import SimpleNamespace

import numpy as np
import pytest
from crossed import combinations
from numpy.testing import assert_array_equal
from robots import LANDMARKS, SENSORS, drive_cpd, m, network, u, x
from textbooks import assert_belief, assert_covs, assert_log, assert_means, refusal
from zoo import MODELS, RULES, TOLERANCE, T, at_step, model_of, of_run, recording

import pgm

SIGHT = SENSORS["range_bearing"]
ROBOT = network(SIGHT.cpd())
z = SIGHT.z
# Where float64 has too few digits to go back over a step.
SHARP = {"an exact range", "sharp readings"}
FEW = ["grouped", "everything", "a motion without noise"]


def journey(robot, evidence, steps=T):
    """The beliefs of all steps, each predicted and then updated."""
    belief = robot.initial()
    for step in range(steps + 1):
        inputs, readings = at_step(evidence, step)
        if step:
            belief = robot.predict(belief, inputs)
        before, belief = belief, robot.update(belief, readings)
        yield before, belief


def assert_step(belief, marginals, tolerance):
    for variable in belief.layout.model.states:
        found, due = belief[variable], marginals[variable.at(belief.step)]
        mean = np.broadcast_to(found.mean, due.mean.shape)
        cov = np.broadcast_to(found.cov, due.cov.shape)
        assert_belief(SimpleNamespace(mean=mean, cov=cov), due.mean, due.cov, tolerance)


@pytest.mark.parametrize("name", MODELS)
@pytest.mark.parametrize("run", [None, 1], ids=["batch", "one"])
def test_a_lag_online_is_that_of_the_record(name, run):
    """Linearised once: the filter, and what going back over its last transitions gives."""
    model = model_of(name, run)
    evidence = recording(name) if run is None else of_run(recording(name), run)
    schedule, tolerance = pgm.FixedLag(3), TOLERANCE.get(name, 1e-9)
    due = pgm.infer(pgm.compile(model, T), evidence, schedule=schedule)
    robot, refused = pgm.OnlineFilter(model, schedule=schedule), []
    for _, belief in journey(robot, evidence):
        assert_step(belief, due.filtered, tolerance)
        try:
            behind = belief.lagged
        except pgm.NumericalError:
            refused.append(belief.step)
            continue
        assert behind.step == max(belief.step - 3, 0)
        assert behind.kind == pgm.Kind(belief.step - behind.step)
        if belief.step >= 3:
            assert_step(behind, due, tolerance)
    assert_log(belief.log_evidence, due.log_evidence, tolerance)
    assert bool(refused) == (name in SHARP)


@pytest.mark.parametrize(
    ("name", "rule"),
    [(name, "taylor") for name in MODELS] + combinations(FEW, ["unscented", "bare function"]),
)
@pytest.mark.filterwarnings("ignore::pgm.ConvergenceWarning")  # some windows settle
def test_windows_online_are_those_of_the_record(name, rule):
    """To the last bit, but for the order of sums: they are the same windows."""
    evidence, lag = recording(name), 2
    due = pgm.smooth(MODELS[name], evidence, lineariser=RULES[rule], lag=lag, iterations=3)
    robot = pgm.OnlineFilter(MODELS[name], RULES[rule], pgm.FixedLag(lag, iterations=3))
    iterations, converged = 0, np.ones(due.status.converged.shape, dtype=bool)
    for _, belief in journey(robot, evidence):
        assert_step(belief, due.filtered, 1e-11)
        if belief.step >= lag:
            assert_step(belief.lagged, due, 1e-11)
        iterations = max(iterations, belief.status.iterations)
        converged = converged & belief.status.converged
    assert_log(belief.log_evidence, due.log_evidence, 1e-11)
    assert iterations == due.status.iterations
    assert_array_equal(converged, due.status.converged)


@pytest.mark.parametrize("run", [None, 1], ids=["batch", "one"])
@pytest.mark.parametrize("damping", [0.3, pgm.LevenbergMarquardt()], ids=repr)
def test_windows_of_one_run_and_of_a_batch_with_damping(run, damping):
    evidence = recording("plain") if run is None else of_run(recording("plain"), run)
    schedule = pgm.FixedLag(1, iterations=4, tolerance=0, damping=damping)
    due = pgm.infer(pgm.compile(ROBOT, T), evidence, schedule=schedule)
    for _, belief in journey(pgm.OnlineFilter(ROBOT, schedule=schedule), evidence):
        assert_step(belief, due.filtered, 1e-11)
        if belief.step:
            assert_step(belief.lagged, due, 1e-11)


def seen(step, count=1, lead=()):
    """Sightings of so many landmarks."""
    rng = np.random.default_rng(step)
    marks = np.broadcast_to(LANDMARKS[:count], (*lead, count, 2))
    values = np.stack(
        [np.hypot(*(marks - [step, 0.1 * step]).T).T, np.arctan2(*(marks - [step, 0.1]).T[::-1]).T],
        axis=-1,
    )
    return pgm.sightings(values + 0.05 * rng.normal(size=values.shape), given={m: marks})


def rows(given, which):
    return pgm.sightings(given.values[..., which, :], given={m: given.given[m][..., which, :]})


MOVE = {u: np.array([1.0, 0.1])}
ONCE, AGAIN = pgm.FixedLag(2), pgm.FixedLag(2, iterations=30, tolerance=1e-11)


def test_updates_of_a_step_in_a_window_are_one_update_in_any_order():
    robot = pgm.OnlineFilter(ROBOT, schedule=AGAIN)
    one = two = robot.initial()
    for step in range(1, 6):
        one, two = robot.predict(one, MOVE), robot.predict(two, MOVE)
        both = seen(step, 2)
        one = robot.update(one, {z: both})
        two = robot.update(robot.update(two, {z: rows(both, [1])}), {z: rows(both, [0])})
        assert_belief(two[x], one[x].mean, one[x].cov, 1e-8)
        assert_belief(two.lagged[x], one.lagged[x].mean, one.lagged[x].cov, 1e-8)
    assert_log(two.log_evidence, one.log_evidence, 1e-8)


def test_further_updates_of_a_linear_step_are_those_of_one():
    a, b = pgm.variables("a b")
    model = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(a, 0.0, 1.0)],
        [pgm.LinearGaussianCPD(a, {a.previous: 0.9}, cov=0.2)],
        [pgm.LinearGaussianCPD(b, {a: 1.0}, cov=0.3)],
    )
    values = np.random.default_rng(0).normal(size=(12, 1))
    evidence = {b: pgm.sightings(values, step=np.repeat(np.arange(1, 7), 2))}
    for schedule in (pgm.FixedLag(3), pgm.FixedLag(3, iterations=2)):
        due = pgm.infer(pgm.compile(model, 6), evidence, schedule=schedule)
        robot = pgm.OnlineFilter(model, schedule=schedule)
        belief = robot.initial()
        for step in range(1, 7):
            belief = robot.predict(belief)
            for value in values[2 * step - 2 : 2 * step]:
                belief = robot.update(belief, {b: value})
            assert_step(belief, due.filtered, 1e-12)
            if step >= 3:
                assert_step(belief.lagged, due, 1e-12)


@pytest.mark.parametrize("schedule", [ONCE, AGAIN], ids=["once", "again"])
def test_steps_without_an_update(schedule):
    """Predicted beliefs lag too: nothing has been read that says more."""
    robot = pgm.OnlineFilter(ROBOT, schedule=schedule)
    belief = robot.update(robot.initial(), {})
    read = {1: seen(1), 4: seen(4), 5: seen(5)}
    steps = [step for step in read for _ in range(len(read[step].values))]
    evidence = {
        u: np.tile(MOVE[u], (6, 1)),
        z: pgm.sightings(
            np.concatenate([each.values for each in read.values()]),
            step=steps,
            given={m: np.concatenate([each.given[m] for each in read.values()])},
        ),
    }
    due = pgm.infer(pgm.compile(ROBOT, 6), evidence, schedule=schedule)
    for step in range(1, 7):
        belief = robot.predict(belief, MOVE)
        assert str(belief.kind) == "predicted"
        assert belief.lagged.step == max(step - 2, 0)
        known = min(step - 1, 2) if step < 3 else 1
        assert belief.lagged.kind == pgm.Kind(known if step > 1 else 0)
        before = belief
        if step in read:
            belief = robot.update(belief, {z: read[step]})
            assert belief.lagged.kind == pgm.Kind(min(step, 2))
            again = robot.update(robot.update(before, {}), {z: read[step]})
            assert_belief(again[x], belief[x].mean, belief[x].cov, 1e-8)
            assert_step(belief, due.filtered, 1e-8)
        if step in (3, 4, 5):
            assert_step(belief.lagged, due, 1e-8)


@pytest.mark.parametrize("schedule", [ONCE, AGAIN], ids=["once", "again"])
def test_a_belief_is_a_value(schedule):
    """Going on from one twice, in any order, gives the same; what was, stays."""
    robot = pgm.OnlineFilter(ROBOT, schedule=schedule)
    belief, kept = robot.initial(), []
    for step in range(1, 6):
        belief = robot.update(robot.predict(belief, MOVE), {z: seen(step)})
        kept.append(
            (belief, belief.mean.copy(), belief.lagged.mean.copy(), belief.lagged.cov.copy())
        )
    ahead = robot.predict(belief, MOVE)
    others = [robot.update(ahead, {z: seen(k)}) for k in (6, 7, 6)]
    assert_array_equal(others[0].mean, others[2].mean)
    assert_array_equal(others[0].lagged.cov, others[2].lagged.cov)
    assert (others[0].lagged.mean != others[1].lagged.mean).all()
    fresh = pgm.OnlineFilter(ROBOT, schedule=schedule)
    again = fresh.initial()
    for step, (old, mean, behind, cov) in enumerate(kept, 1):
        again = fresh.update(fresh.predict(again, MOVE), {z: seen(step)})
        for each in (old, again):
            assert_array_equal(each.mean, mean)
            assert_array_equal(each.lagged.mean, behind)
            assert_array_equal(each.lagged.cov, cov)
        with pytest.raises(ValueError, match="read-only"):
            old.lagged.mean[...] = 0.0


@pytest.mark.parametrize("schedule", [ONCE, AGAIN], ids=["once", "again"])
@pytest.mark.parametrize("lead", [(), (3,)], ids=["one", "batch"])
def test_pickles_go_on_and_do_not_grow(schedule, lead):
    robot, sizes = pgm.OnlineFilter(ROBOT, schedule=schedule), []
    belief = robot.initial()
    for step in range(1, 16):
        belief = robot.update(robot.predict(belief, MOVE), {z: seen(step, lead=lead)})
        sizes.append(len(pickle.dumps((robot, belief))))
    assert max(sizes[5:]) - min(sizes[5:]) < 0.02 * sizes[-1]
    other, copied = pickle.loads(pickle.dumps((robot, belief)))
    ours, theirs = (
        one.update(one.predict(each, MOVE), {z: seen(16, lead=lead)})
        for one, each in ((robot, belief), (other, copied))
    )
    for one, other in (
        (ours, theirs),
        (ours.lagged, theirs.lagged),
        (belief.lagged, copied.lagged),
    ):
        assert_belief(one[x], other.mean, other.cov, 1e-12)


def test_what_a_belief_holds_does_not_grow():
    for schedule in (ONCE, AGAIN):
        robot = pgm.OnlineFilter(ROBOT, schedule=schedule)
        belief, held = robot.initial(), []
        for step in range(1, 13):
            belief = robot.update(robot.predict(belief, MOVE), {z: seen(step)})
            behind = belief.behind
            held.append(len(behind.passed if schedule is ONCE else behind.entries))
        assert held == [1] + [2] * 11 if schedule is ONCE else held == [2, 3] + [2] * 10


@pytest.mark.parametrize("schedule", [ONCE, AGAIN], ids=["once", "again"])
def test_threads_may_go_on_from_one_belief(schedule):
    robot = pgm.OnlineFilter(ROBOT, schedule=schedule)
    belief = robot.initial()
    for step in range(1, 5):
        belief = robot.update(robot.predict(belief, MOVE), {z: seen(step)})

    def ahead(step):
        return robot.update(robot.predict(belief, MOVE), {z: seen(step)}).lagged.mean

    with ThreadPoolExecutor(4) as pool:
        found = list(pool.map(ahead, [*range(5, 13)] * 3))
    for step, each in zip([*range(5, 13)] * 3, found, strict=True):
        assert_array_equal(each, ahead(step))


@pytest.mark.parametrize("schedule", [ONCE, AGAIN], ids=["once", "again"])
def test_one_robot_may_become_many(schedule):
    """By readings of many runs, after which each goes on as it would alone."""
    robot = pgm.OnlineFilter(ROBOT, schedule=schedule)
    many, alone = robot.initial(), [robot.initial() for _ in range(2)]
    for step in range(1, 7):
        lead = (2,) if step > 2 else ()
        one = seen(step)
        given = one
        if lead:
            values = np.stack([one.values, one.values + 0.02])
            given = pgm.sightings(values, given={m: np.stack([one.given[m]] * 2)})
        many = robot.update(robot.predict(many, MOVE), {z: given})
        for k in range(2):
            own = pgm.sightings(given.values[k], given={m: one.given[m]}) if lead else one
            alone[k] = robot.update(robot.predict(alone[k], MOVE), {z: own})
            for ours, theirs in ((many, alone[k]), (many.lagged, alone[k].lagged)):
                part = ours[x].mean[k] if ours.lead else ours[x].mean
                spread = ours[x].cov[k] if ours.lead else ours[x].cov
                assert_means(part, theirs[x].mean, theirs[x].cov, 1e-8)
                assert_covs(spread, theirs[x].cov, 1e-8)
    assert many.lagged.lead == (2,)
    assert robot.predict(many, {u: np.tile(MOVE[u], (2, 1))}).lagged[x].mean.shape == (2, 3)


def test_without_a_lag_it_is_the_filter_s_belief():
    for iterations in (1, 4):
        evidence = of_run(recording("plain"), 0)
        robot = pgm.OnlineFilter(ROBOT, schedule=pgm.FixedLag(0, iterations, tolerance=0))
        filter_ = pgm.OnlineFilter(ROBOT, schedule=pgm.Filtering(iterations, tolerance=0))
        both = zip(journey(robot, evidence), journey(filter_, evidence), strict=True)
        for (_, ours), (_, theirs) in both:
            assert_array_equal(ours.mean, theirs.mean)
            assert_array_equal(ours.cov, theirs.cov)
            assert ours.lagged is ours


def test_a_lag_is_a_schedule_of_that_lag():
    robot = pgm.OnlineFilter(ROBOT, lag=2)
    assert robot.schedule == pgm.FixedLag(2)
    evidence = of_run(recording("plain"), 0)
    both = zip(journey(robot, evidence), journey(made(ONCE)[0], evidence), strict=True)
    for (_, ours), (_, theirs) in both:
        assert ours.lagged.kind == theirs.lagged.kind
        assert_array_equal(ours.lagged.mean, theirs.lagged.mean)


def made(schedule, steps=3, lead=()):
    robot = pgm.OnlineFilter(ROBOT, schedule=schedule)
    belief = robot.initial()
    for step in range(1, steps + 1):
        belief = robot.update(robot.predict(belief, MOVE), {z: seen(step, lead=lead)})
    return robot, belief


def exact(iterations=1, **options):
    """A sensor without noise, through which float64 does not go back."""
    model = network(SIGHT.cpd(cov=np.diag([0.0, 0.01])))
    robot = pgm.OnlineFilter(model, schedule=pgm.FixedLag(1, iterations, tolerance=0, **options))
    belief = robot.update(robot.predict(robot.initial(), MOVE), {z: seen(1)})
    return robot.predict(belief, MOVE)


def more_runs():
    robot, belief = made(AGAIN, lead=(2,))
    return robot.predict(belief, {u: np.tile(MOVE[u], (5, 2, 1))})


REFUSALS = [
    refusal(
        "a schedule for records",
        lambda: pgm.OnlineFilter(ROBOT, schedule=pgm.Smoothing()),
        pgm.ModelError,
        "an online filter takes pgm.Filtering(...) or pgm.FixedLag(...), not Smoothing(",
    ),
    refusal(
        "a lag beside a schedule",
        lambda: pgm.OnlineFilter(ROBOT, schedule=pgm.Filtering(iterations=3), lag=2),
        pgm.ModelError,
        "lag=2 beside Filtering(iterations=3",
    ),
    refusal(
        "a lag that is no number",
        lambda: pgm.OnlineFilter(ROBOT, lag=1.5),
        pgm.ModelError,
        "a lag is a whole number of steps, 0 or more, not 1.5",
    ),
    refusal(
        "a filter without a lag",
        lambda: made(pgm.Filtering())[1].lagged,
        pgm.errors.Unanswered,
        "OnlineBelief(filtered, step 3, over [x]) is of a filter without a lag",
        "OnlineFilter(model, lag=5)",
        step=3,
    ),
    refusal(
        "going on from behind",
        lambda: made(ONCE)[0].predict(made(ONCE)[1].lagged, MOVE),
        pgm.ModelError,
        "OnlineBelief(fixed-lag (2), step 1, over [x]) is no belief to go on from",
        "go on from the newest belief",
    ),
    refusal(
        "going on from behind without a lag",
        lambda: made(pgm.Filtering())[0].update(made(AGAIN)[1].lagged, {z: seen(4)}),
        pgm.ModelError,
        "OnlineBelief(fixed-lag (2), step 1, over [x]) is no belief to go on from",
    ),
    refusal(
        "a belief of a filter without a lag",
        lambda: made(AGAIN)[0].predict(made(pgm.Filtering())[1], MOVE),
        pgm.ModelError,
        "OnlineBelief(filtered, step 3, over [x]) is no belief to go on from with FixedLag(lag=2",
        "begin with initial()",
    ),
    refusal(
        "a belief of a filter with another lag",
        lambda: made(pgm.FixedLag(3))[0].predict(made(ONCE)[1], MOVE),
        pgm.ModelError,
        "is no belief to go on from with FixedLag(lag=3",
    ),
    refusal(
        "a belief of a filter with other iterations",
        lambda: made(pgm.FixedLag(2, iterations=3, tolerance=0))[0].update(
            made(AGAIN)[1], {z: seen(3)}
        ),
        pgm.ModelError,
        "is no belief to go on from with FixedLag(lag=2, iterations=3",
    ),
    refusal(
        "other runs",
        more_runs,
        pgm.EvidenceError,
        "evidence of runs (5, 2) after such of runs (2,)",
        "FixedLag(lag=2, iterations=30",
        "all axes (5, 2)",
        step=3,
    ),
    refusal(
        "too few digits",
        lambda: exact().lagged,
        pgm.NumericalError,
        "float64 loses the belief at step 1 given the measurements up to step 2",
        "deviations lie too far apart",
        "pgm.smooth(..., lag=...)",
        "iterations=2",
        step=1,
    ),
    refusal(
        "costs that do not exist",
        lambda: exact(3, damping=pgm.LevenbergMarquardt()),
        pgm.ModelError,
        "its noise is singular",
        "use damping=0.5",
    ),
]


@pytest.mark.parametrize("row", REFUSALS, ids=lambda row: row.name)
def test_refusals(row):
    row.check()


def test_windows_have_the_digits_that_a_lag_without_iterations_has_not():
    belief = exact(iterations=2)
    assert belief.lagged.kind == pgm.Kind(0)
    assert np.isfinite(belief.lagged.mean).all()


def test_steps_that_took_twice_the_digits_are_left_behind():
    """Noise along two directions after a known start: no belief is regular at first."""
    roots = np.array([[0.2, 0.02], [0.03, 0.01], [0.01, 0.1]])
    known = pgm.GaussianCPD(x, [0.0, 0.0, 0.0], np.zeros((3, 3)))
    model = network(SIGHT.cpd(), prior=known, transition=drive_cpd(cov=roots @ roots.T))
    robot = pgm.OnlineFilter(model, schedule=ONCE)
    belief, lost, sights = robot.initial(), [], [seen(step) for step in range(1, 9)]
    record = {
        u: np.tile(MOVE[u], (8, 1)),
        z: pgm.sightings(
            np.concatenate([each.values for each in sights]),
            step=np.arange(1, 9),
            given={m: np.concatenate([each.given[m] for each in sights])},
        ),
    }
    due = pgm.smooth(model, record, lag=2)
    for sight in sights:
        belief = robot.update(robot.predict(belief, MOVE), {z: sight})
        try:
            assert_step(belief.lagged, due, 1e-7)
        except pgm.NumericalError:
            lost.append(belief.step)
    assert lost == [1, 2, 3]
