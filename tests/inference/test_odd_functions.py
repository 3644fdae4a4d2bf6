"""Functions that lose a number, wrap an angle, reuse their result: one run, many, and online."""

import re
from functools import partial

import numpy as np
import pytest
from robots import DRIVE, drive_cpd, m, u, x
from zoo import MODELS, RULES, SIGHT, T, at_step, of_run, plain, recording, seen

import pgm

rules = pytest.mark.parametrize("rule", ["taylor", "unscented"])
# How many runs, of which the one at fault is the second; none is that run alone.
runs = pytest.mark.parametrize("runs", [None, 3, 40], ids=["one", "few", "many"])


def of_runs(evidence, runs):
    return of_run(evidence, 1 if runs is None else np.arange(runs) % 3)


def online(model, evidence, rule):
    robot = pgm.OnlineFilter(model, rule)
    belief = robot.initial()
    for step in range(T + 1):
        inputs, readings = at_step(evidence, step)
        belief = robot.predict(belief, inputs) if step else belief
        belief = robot.update(belief, readings)
    return belief


def refusal(work, *arguments, **options):
    with pytest.raises(pgm.LinearisationError) as caught:
        work(*arguments, **options)
    return caught.value


@pytest.mark.parametrize("row", [0, 5])
@pytest.mark.parametrize("where", ["drive", "sight"])
@rules
def test_values_that_are_not_finite_are_refused_alike(where, rule, row):
    """Of one run in any company, and online: the same words, the same step."""
    evidence = recording("plain")
    given = evidence[u] if where == "drive" else evidence[SIGHT.z].given[m]
    at = given[1, row, 0]

    def broken(state, other):
        value = np.array((DRIVE if where == "drive" else SIGHT.function)(state, other))
        value[np.abs(other[..., 0] - at) < 1e-9] = np.nan
        return value

    if where == "drive":
        model = plain(drive_cpd(function=broken))
    else:
        model = plain(sensor=SIGHT.cpd(function=broken))
    alone = refusal(pgm.filter, model, of_run(evidence, 1), lineariser=RULES[rule])
    due = row + 1 if where == "drive" else evidence[SIGHT.z].step[row]
    assert (alone.step, alone.run, alone.cpd) == (due, 0, model.cpds[1 if where == "drive" else 2])
    words = str(alone)
    assert f"at step {due}, run 0, has values that are NaN or infinite, at (" in words
    assert str(refusal(online, model, of_run(evidence, 1), RULES[rule])) == words
    for some in (3, 40):
        found = refusal(pgm.filter, model, of_runs(evidence, some), lineariser=RULES[rule])
        assert (found.step, found.run, found.cpd) == (due, 1, alone.cpd)
        assert re.sub("run 1", "run 0", str(found)) == words
    found = refusal(online, model, evidence, RULES[rule])
    assert re.sub("run 1", "run 0", str(found)) == words


@runs
@rules
@pytest.mark.parametrize("lost", ["one component", "all"])
def test_what_is_lost_where_nothing_is_read_does_not_matter(lost, rule, runs):
    """The function of a missing component need not have a value."""
    y, far = pgm.variables("y far")
    pair = pgm.Variable("pair", ("near", "far"))

    def network(hole):
        def sight(y, far):
            return np.concatenate([np.sin(y) - far, np.where(far > 5.0, hole, y**2 - far)], axis=-1)

        return pgm.DynamicBayesianNetwork(
            [pgm.GaussianCPD(y, 1.0, 0.3)],
            [pgm.LinearGaussianCPD(y, {y.previous: 1.0}, cov=0.1)],
            [pgm.NonlinearGaussianCPD(pair, (y, far), sight, 0.1 * np.eye(2))],
        )

    lead, own = ((), ()) if runs is None else ((runs,), (1,))
    values, given = np.full((*lead, 3, 2), 0.3), np.full((*lead, 3, 1), 0.2)
    values[(*own, 1)] = [np.nan if lost == "all" else 0.3, np.nan]
    given[(*own, 1)] = 9.0
    evidence = {pair: pgm.sightings(values, [1, 2, 2], {far: given})}
    found, due = (
        pgm.filter(network(hole), evidence, steps=2, lineariser=RULES[rule])
        for hole in (np.nan, 7.0)
    )
    np.testing.assert_allclose(found[y].mean, due[y].mean, rtol=1e-12)
    np.testing.assert_allclose(found[y].cov, due[y].cov, rtol=1e-12)
    np.testing.assert_allclose(found.log_evidence, due.log_evidence, rtol=1e-12)


@runs
def test_a_mean_that_is_lost_at_a_step_without_readings_is_refused(runs):
    """Though the next function would map it back to a number."""
    evidence = recording("plain")
    at = evidence[u][1, 3, 0]

    def broken(state, control):
        value = DRIVE(np.nan_to_num(state), control)
        value[np.abs(control[..., 0] - at) < 1e-9] = np.nan
        return value

    def slope(state, control):
        return DRIVE.by_state(np.nan_to_num(state), control)

    drive = drive_cpd(function=broken, jacobian={x.previous: slope})
    model = MODELS["plain"].replace(transition=[drive], observation=[])
    found = refusal(pgm.filter, model, {u: of_runs(evidence, runs)[u]})
    assert (found.step, found.run, found.cpd) == (4, 0 if runs is None else 1, drive)


@runs
def test_integers_will_do(runs):
    """Once the function is no longer on trial."""

    def rounded(state, control):
        value = np.round(DRIVE(state, control))
        return value if value.ndim == 3 else value.astype(int)

    evidence = of_runs(recording("plain"), runs)
    whole, floats = (
        plain(drive_cpd(function=function, jacobian={x.previous: DRIVE.by_state}))
        for function in (rounded, lambda *given: np.round(DRIVE(*given)))
    )
    found, due = (pgm.filter(model, evidence) for model in (whole, floats))
    np.testing.assert_array_equal(found[x].mean, due[x].mean)
    np.testing.assert_array_equal(found.log_evidence, due.log_evidence)
    robot = online(whole, evidence, pgm.Taylor())
    np.testing.assert_allclose(robot[x].mean, due[x].mean[..., -1, :], atol=1e-12)


@runs
def test_headings_that_a_function_wraps_stay_on_their_chart(runs):
    """Three turns and more: of a heading that is wrapped, and of readings that are."""
    state, push = pgm.Variable("state", ("place", "way"), angles=("way",)), pgm.Variable("push")
    read = pgm.Variable("read", ("place", "way"), angles=("way",))

    def turn(state, push):
        return state + np.concatenate([push, np.full_like(push, 1.5)], axis=-1)

    def wrapped(state, push):
        out = turn(state, push)
        out[..., 1] = np.arctan2(np.sin(out[..., 1]), np.cos(out[..., 1]))
        return out

    def network(function):
        by_state = {state.previous: lambda x, u: np.broadcast_to(np.eye(2), (*x.shape, 2))}
        drive = pgm.NonlinearGaussianCPD(
            state, (state.previous, push), function, 0.1 * np.eye(2), jacobian=by_state
        )
        return pgm.DynamicBayesianNetwork(
            [pgm.GaussianCPD(state, [0.0, 0.0], np.eye(2))],
            [drive],
            [pgm.LinearGaussianCPD(read, {state: np.eye(2)}, cov=0.2 * np.eye(2))],
        )

    lead = () if runs is None else (runs,)
    truth = np.stack([np.zeros(14), 1.5 * np.arange(1.0, 15.0)], axis=-1)
    readings = truth + 0.1 * np.random.default_rng(0).normal(size=(*lead, 14, 2))
    evidence = {push: np.zeros((14, 1)), read: np.arctan2(np.sin(readings), np.cos(readings))}
    found, due = (pgm.filter(network(function), evidence) for function in (wrapped, turn))
    np.testing.assert_allclose(found[state].mean, due[state].mean, rtol=0, atol=1e-10)
    np.testing.assert_allclose(found[state].cov, due[state].cov, rtol=0, atol=1e-12)
    np.testing.assert_allclose(found.log_evidence, due.log_evidence, rtol=1e-10)
    assert found[state].mean[..., -1, 1].min() > 6.0 * np.pi


class Reusing:
    """A function that returns the same array each time, and keeps it writable."""

    def __init__(self, function):
        self.function, self.room = function, {}

    def __call__(self, *given):
        value = np.asarray(self.function(*given))
        room = self.room.setdefault(value.shape, np.empty(value.shape))
        room[...] = value
        assert room.flags.writeable
        return room


@runs
@pytest.mark.parametrize("derivatives", ["given", "by differences", "unscented"])
def test_functions_may_reuse_their_results(runs, derivatives):
    """Two sensors of one function, too: beliefs and linearisations are no views of its array."""
    rule = pgm.Unscented() if derivatives == "unscented" else pgm.Taylor()

    def network(wrap):
        function, slope, by_state = (
            wrap(SIGHT.function),
            wrap(DRIVE.by_state),
            wrap(SIGHT.by_state),
        )
        given = derivatives == "given"
        return pgm.DynamicBayesianNetwork(
            prior=MODELS["plain"].prior,
            transition=[
                drive_cpd(function=wrap(DRIVE), jacobian={x.previous: slope} if given else None)
            ],
            observation=[
                pgm.NonlinearGaussianCPD(
                    z, (x, m), function, SIGHT.cov, jacobian={x: by_state} if given else None
                )
                for z in (SIGHT.z, seen)
            ],
        )

    evidence = recording("plain")
    sights = evidence[SIGHT.z]
    others = {m: sights.given[m] + [0.3, -0.2]}
    evidence[seen] = pgm.sightings(sights.values + 0.1, sights.step, others)
    evidence = of_runs(evidence, runs)
    found, due = (
        pgm.smooth(network(wrap), evidence, lineariser=rule) for wrap in (Reusing, lambda f: f)
    )
    for ours, theirs in (
        (found.filtered, due.filtered),
        (found.predicted, due.predicted),
        (found, due),
    ):
        np.testing.assert_array_equal(ours[x].mean, theirs[x].mean)
        np.testing.assert_array_equal(ours[x].cov, theirs[x].cov)
    np.testing.assert_array_equal(found.innovations[seen].residual, due.innovations[seen].residual)
    filtered = pgm.filter(network(Reusing), evidence, lineariser=rule)
    np.testing.assert_array_equal(filtered[x].mean, due.filtered[x].mean)
    robot = online(network(Reusing), evidence, rule)
    np.testing.assert_allclose(robot[x].mean, due[x].mean[..., -1, :], atol=1e-11)


def test_an_online_belief_is_no_view_of_a_functions_array():
    robot = pgm.OnlineFilter(plain(drive_cpd(function=Reusing(DRIVE))))
    belief = robot.predict(robot.initial(), {u: [1.0, 0.1]})
    mean = belief[x].mean.copy()
    robot.predict(belief, {u: [1.0, 0.1]})
    np.testing.assert_array_equal(belief[x].mean, mean)


def test_a_function_may_set_entries_by_a_mask():
    def drive(state, control):
        moved = DRIVE(state, control)
        moved[moved[..., 0] < -99.0] = 0.0
        length = moved[..., 0]
        length[length > 99.0] = 99.0
        return moved

    robot, due = (pgm.OnlineFilter(plain(drive_cpd(function=each))) for each in (drive, DRIVE))
    found, due = (each.predict(each.initial(), {u: [1.0, 0.1]}) for each in (robot, due))
    np.testing.assert_array_equal(found[x].mean, due[x].mean)


@rules
def test_a_function_that_changes_its_argument_is_refused(rule):
    def drive(state, control):
        state[..., 0] += 1.0
        return state + control[..., :1]

    model = plain(pgm.NonlinearGaussianCPD(x, (x.previous, u), drive, cov=np.eye(3)))
    robot = pgm.OnlineFilter(model, RULES[rule])
    with pytest.raises(pgm.ModelError, match=r"trial call .* read-only"):
        robot.predict(robot.initial(), {u: [1.0, 0.1]})


@pytest.mark.parametrize("what", ["function", "jacobian"])
@pytest.mark.parametrize("runs", [(), (2,), (40,)])
@rules
def test_a_function_that_changes_its_argument_at_times_is_refused(rule, runs, what):
    """A trial call does not see it; the belief would be another one."""
    level, flow = pgm.variables("level flow")

    def clipped(level):
        if (level < 0.0).any():
            level[level < 0.0] = 0.0
        return np.sqrt(np.maximum(level, 0.0) + 1.0)

    def right(level):
        return np.sqrt(np.maximum(level, 0.0) + 1.0)

    def slope(level):
        return 0.5 * np.where(level > 0.0, 1.0 / right(level), 0.0)[..., None]

    def clipped_slope(level):
        clipped(level)
        return slope(level)

    taken = (clipped, slope) if what == "function" else (right, clipped_slope)
    if what == "jacobian" and "taylor" not in rule:
        return
    function, derivative = taken
    model = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(level, 1.0, 1.0)],
        [pgm.LinearGaussianCPD(level, {level.previous: 1.0}, offset=[-1.0], cov=0.5)],
        [pgm.NonlinearGaussianCPD(flow, level, function, 0.1, jacobian={level: derivative})],
    )
    evidence = {flow: np.ones((*runs, 4, 1))}
    for call in (pgm.filter, partial(pgm.smooth, iterations=3)):
        with pytest.raises(pgm.ModelError, match="read-only") as caught:
            call(model, evidence, lineariser=RULES[rule])
        assert caught.value.cpd.child == flow


@pytest.mark.parametrize("runs", [(), (40,)])
def test_a_prediction_that_a_rule_makes_indefinite_is_refused(runs):
    """A belief of negative variance is none, even if no later step would notice."""
    y, v = pgm.variables("y v")
    rule = pgm.Unscented(alpha=0.5, beta=-3.0, kappa=0.0)
    model = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(y, 0.0, 1.0)],
        [pgm.NonlinearGaussianCPD(y, (y.previous, v), lambda y, v: v * y**2, cov=0.01)],
        [],
    )
    small, large = (np.full((*runs, 1, 1), value) for value in (0.001, 3.0))
    words = "predicted covariance at step 1 is indefinite"
    with pytest.raises(pgm.NumericalError, match=words):
        pgm.filter(model, {v: large}, lineariser=rule, steps=1)
    assert (pgm.filter(model, {v: small}, lineariser=rule, steps=1)[y].std > 0.0).all()
    robot = pgm.OnlineFilter(model, rule)
    belief = robot.predict(robot.initial(), {v: small[..., 0, :]})  # a step that is laid out
    assert (belief[y].std > 0.0).all()
    with pytest.raises(pgm.NumericalError, match=words):
        robot.predict(robot.initial(), {v: large[..., 0, :]})


def test_an_error_that_is_not_finite_is_named_online_too():
    """A rule's covariance of NaN, told as NaN and not as indefinite."""
    y = pgm.Variable("y")

    def lost(function, at):
        slope, value = function.jacobian(at.mean), function(at.mean)
        return pgm.AffineGaussian(slope, value - slope @ at.mean, np.full((1, 1), np.nan))

    model = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(y, 0.0, 1.0)],
        [pgm.NonlinearGaussianCPD(y, y.previous, lambda y: 1.0 * y, 1.0)],
        [],
    )
    robot = pgm.OnlineFilter(model, lineariser=lost)
    with pytest.raises(pgm.LinearisationError, match="NaN or infinite") as caught:
        robot.predict(robot.initial())
    assert caught.value.cpd.child == y
