"""Runs of a chain of tables whose measurements have probability zero: refused, or allowed."""

import itertools
from functools import cache

import numpy as np
import pytest
from crossed import slow_after
from numpy.testing import assert_allclose, assert_array_equal

import pgm
from pgm import examples
from pgm.beliefs.markov import impossible_runs, run
from pgm.schedules.impossible import ImpossibleEvidence

CLOSE = {"rtol": 1e-11, "atol": 1e-14}
T = 3
x, z = pgm.Discrete("x", 3), pgm.Discrete("z", 3)
PRIOR = np.array([0.6, 0.4, 0.0])
MOTION = np.array([[0.7, 0.3, 0.0], [0.0, 0.5, 0.5], [0.2, 0.0, 0.8]])
SEEN = np.array([[0.9, 0.1, 0.0], [0.0, 1.0, 0.0], [0.0, 0.3, 0.7]])
SINGLE = pgm.DynamicBayesianNetwork(
    [pgm.TableCPD(x, table=PRIOR)],
    [pgm.TableCPD(x, x.previous, table=MOTION)],
    [pgm.TableCPD(z, x, table=SEEN)],
)
# Every measurement at every step, none among them.
READINGS = np.array(list(itertools.product((-1, 0, 1, 2), repeat=T)))

# Two states, a hidden control, a command that differs by run, and a soft measurement.
a, b, c = pgm.Discrete("a", 2), pgm.Discrete("b", 3), pgm.Discrete("c", 2)
u, v, w = pgm.Discrete("u", 2), pgm.Discrete("v", 3), pgm.Discrete("w", 2)
PA, PB = np.array([1.0, 0.0]), np.array([[0.5, 0.5, 0.0], [0.2, 0.3, 0.5]])
TC = np.array([[1.0, 0.0], [0.3, 0.7]])
TA = np.array([[[1.0, 0.0], [0.4, 0.6]], [[0.0, 1.0], [0.5, 0.5]]])
TB = np.array([[[1, 0, 0], [0.5, 0.5, 0]], [[0, 1, 0], [0, 0.2, 0.8]], [[0, 0, 1], [0.6, 0, 0.4]]])
OV = np.array(
    [[[1, 0, 0], [0.5, 0.5, 0]], [[0, 1, 0], [0, 0.5, 0.5]], [[0, 0, 1.0], [0.1, 0.2, 0.7]]]
)
OW = np.array([[[1.0, 0.0], [0.6, 0.4]], [[0.0, 1.0], [0.3, 0.7]]])
SEVERAL = pgm.DynamicBayesianNetwork(
    [pgm.TableCPD(a, table=PA), pgm.TableCPD(b, a, table=PB)],
    [
        pgm.TableCPD(c, u, table=TC),
        pgm.TableCPD(a, (c, a.previous), table=TA),
        pgm.TableCPD(b, (b.previous, a), table=TB),
    ],
    [pgm.TableCPD(v, (b, a), table=OV), pgm.TableCPD(w, (c, u), table=OW)],
)
RUNS = 80


def single_paths(readings):
    """All paths of x with p(path), and by step the likelihood of the measurements on them."""
    paths = np.array(list(itertools.product(range(3), repeat=T + 1)))
    prior = PRIOR[paths[:, 0]]
    likely = np.ones((T + 1, len(paths)))
    for t in range(1, T + 1):
        prior = prior * MOTION[paths[:, t - 1], paths[:, t]]
        if readings[t - 1] >= 0:
            likely[t] = SEEN[paths[:, t], readings[t - 1]]
    return {x: paths.T}, prior, likely


def several_paths(commands, readings, weights):
    """The same of a, b and c; at step 0 the control c is 0, whatever it was."""
    first = [(i, j, 0) for i in range(2) for j in range(3)]
    later = list(itertools.product(range(2), range(3), range(2)))
    paths = np.array(list(itertools.product(first, *[later] * T)))
    one, two, three = paths[..., 0].T, paths[..., 1].T, paths[..., 2].T
    prior = PA[one[0]] * PB[one[0], two[0]]
    likely = np.ones((T + 1, len(paths)))
    for t in range(1, T + 1):
        command = commands[t - 1]
        prior = prior * TC[command, three[t]] * TA[three[t], one[t - 1], one[t]]
        prior = prior * TB[two[t - 1], one[t], two[t]]
        if readings[t - 1] >= 0:
            likely[t] = OV[two[t], one[t], readings[t - 1]]
        likely[t] = likely[t] * (OW[three[t], command] @ weights[t - 1])
    return {a: one, b: two, c: three}, prior, likely


class Due:
    """The answers of one run by summing over paths; NaN where they know what is impossible."""

    def __init__(self, states, prior, likely):
        self.states, self.prior, self.likely = states, prior, likely

    def known(self, last):
        return self.prior * np.prod(self.likely[: last + 1], axis=0)

    def evidence(self):
        return self.known(T).sum()

    @cache  # noqa: B019  # worlds are few
    def joint(self, last, *variables):
        p = self.known(min(last, T))
        table = np.zeros([each.size for each in variables])
        np.add.at(table, tuple(self.states[each.template][each.step] for each in variables), p)
        return table / p.sum() if p.sum() > 0.0 else np.full(table.shape, np.nan)

    @property
    def first(self):
        """The first step whose measurements are impossible, T + 1 if none are."""
        possible = [self.known(t).sum() > 0.0 for t in range(T + 1)]
        return [*possible, False].index(False)


def single():
    return SINGLE, {z: READINGS}, [Due(*single_paths(own)) for own in READINGS]


def several():
    rng = np.random.default_rng(3)
    commands, readings = rng.integers(0, 2, (RUNS, T)), rng.integers(-1, 3, (RUNS, T))
    weights = rng.random((RUNS, T, 2))
    weights[rng.random((RUNS, T)) < 0.3] = [0.0, 1.0]
    rows = zip(commands, readings, weights, strict=True)
    evidence = {u: commands, v: readings, w: pgm.soft(weights)}
    return SEVERAL, evidence, [Due(*several_paths(*row)) for row in rows]


@pytest.fixture(params=[single, several], scope="module")
def world(request):
    return request.param()


@pytest.fixture(params=["numbers", "logarithms"])
def arithmetic(request, monkeypatch):
    if request.param == "logarithms":
        monkeypatch.setattr(run, "TINY", 2.0)
        monkeypatch.setattr(impossible_runs, "TINY", 2.0)


def asked(model, evidence, lag):
    if lag == 0:
        return pgm.filter(model, evidence, impossible="allow")
    return pgm.smooth(model, evidence, lag=None if lag > T else lag, impossible="allow")


def test_runs_are_lost_at_all_steps(world):
    _, _, due = world
    first = np.bincount([each.first for each in due], minlength=T + 2)
    assert (first[2:] > 3).all()


@pytest.mark.usefixtures("arithmetic")
@pytest.mark.parametrize("lag", slow_after(2, [0, 2, 1, 9]))
def test_beliefs_are_those_by_enumeration_or_nan(world, lag):
    model, evidence, due = world
    found = asked(model, evidence, lag)
    with np.errstate(divide="ignore"):
        log_evidence = np.log([each.evidence() for each in due])
    assert_allclose(found.log_evidence, log_evidence, **CLOSE)
    for variable in (*model.states, *model.controls):
        for t in range(0 if variable in model.states else 1, T + 1):
            here = variable.at(t)
            expected = [each.joint(t + lag, here) for each in due]
            assert_allclose(found[here].values, expected, **CLOSE)
            expected = [each.joint(t, here) for each in due]
            assert_allclose(found.filtered[here].values, expected, **CLOSE)
            expected = [each.joint(t - 1, here) for each in due]
            assert_allclose(found.predicted[here].values, expected, **CLOSE)
        stacked, late = found[variable].values, variable not in model.states
        assert_array_equal(stacked[:, 2 - late], found[variable.at(2)].values)


@pytest.mark.usefixtures("arithmetic")
@pytest.mark.parametrize("lag", [0, 1, 9])
def test_joints_and_clusters(world, lag):
    model, evidence, due = world
    found, last = asked(model, evidence, lag), model.states[-1]
    for scope in [(last.at(0), last.at(1)), (last.at(2), model.states[0].at(1))]:
        latest = max(each.step for each in scope)
        expected = [each.joint(latest + lag, *scope) for each in due]
        assert_allclose(found.joint(*scope).values, expected, **CLOSE)
    for cluster in range(T + 1):
        belief = found.belief(cluster)
        total = np.nansum(belief.values.reshape(len(due), -1), axis=1) * np.exp(belief.log_scale)
        known = [each.known(min(cluster + lag, T)).sum() for each in due]
        assert_allclose(total, known, **CLOSE)
        assert np.isfinite(found.potential(cluster).values).all()


def test_messages(world):
    """Forward ones are of the filter; backward ones are NaN where the evidence is impossible."""
    model, evidence, due = world
    found = pgm.smooth(model, evidence, impossible="allow")
    lost = np.array([each.first <= T for each in due])
    for t in range(T):
        forward = found.message(t, t + 1)
        values = forward.values * np.exp(forward.log_scale)[(..., *[None] * len(model.states))]
        known = np.array([each.first > t for each in due])
        expected = [
            each.joint(t, *(s.at(t) for s in model.states)) * each.known(t).sum() for each in due
        ]
        assert_allclose(values[known], np.array(expected)[known], **CLOSE)
        assert not np.nan_to_num(values[~known]).any()
        back = found.message(t + 1, t)
        assert np.isnan(back.values[lost]).all()
        both = forward.values[~lost] * back.values[~lost]
        scale = (forward.log_scale + back.log_scale)[~lost]
        total = both.reshape(len(both), -1).sum(axis=1) * np.exp(scale)
        assert_allclose(total, [each.evidence() for each in np.array(due)[~lost]], **CLOSE)


def test_others_are_as_they_are_alone(world):
    model, evidence, due = world
    found = pgm.smooth(model, evidence, impossible="allow")
    kept = [k for k, each in enumerate(due) if each.first > T]
    some = {v: own[kept] for v, own in evidence.items() if isinstance(own, np.ndarray)}
    if w in evidence:
        some[w] = pgm.soft(evidence[w].weights[kept])
    alone = pgm.smooth(model, some)
    for state in model.states:
        assert_allclose(found[state].values[kept], alone[state].values, rtol=1e-14)
    assert_allclose(found.log_evidence[kept], alone.log_evidence, rtol=1e-14)


def test_infer_takes_it_too_with_axes_of_runs():
    graph = pgm.compile(SINGLE, T)
    evidence = READINGS.reshape(4, 16, T)
    found = pgm.infer(graph, {z: evidence}, schedule=pgm.Filtering(), impossible="allow")
    flat = pgm.filter(SINGLE, {z: READINGS}, impossible="allow")
    assert found.log_evidence.shape == (4, 16)
    assert_array_equal(found.log_evidence.ravel(), flat.log_evidence)
    assert_array_equal(found[x].values.reshape(-1, T + 1, 3), flat[x].values)
    assert "-inf" in repr(found)


def test_a_single_run_and_runs_that_are_all_impossible():
    single = pgm.filter(SINGLE, {z: [0, 0, 2]}, impossible="allow")
    assert np.isneginf(single.log_evidence)
    assert single.log_evidence.shape == ()
    due = Due(*single_paths([0, 0, 2]))
    assert due.first == 3
    assert_allclose(single[x].values, [due.joint(t, x.at(t)) for t in range(T + 1)], **CLOSE)
    smooth = pgm.smooth(SINGLE, {z: [0, 0, 2]}, impossible="allow")
    assert np.isnan(smooth[x].values).all()
    every = pgm.smooth(SINGLE, {z: [[0, 0, 2], [0, 2, 0]]}, impossible="allow")
    assert np.isneginf(every.log_evidence).all()
    assert np.isnan(every[x].values).all()
    assert "nan" in repr(every)


def test_the_step_before_all_measurements():
    """At step 0, where the filter's beliefs are all NaN, and the prediction is the prior."""
    seen = pgm.sightings([[2, 0], [0, 0]], step=[0, 1])
    found = pgm.filter(SINGLE, {z: seen}, steps=1, impossible="allow")
    assert np.isnan(found[x].values[0]).all()
    assert_allclose(found.predicted[x].values[0, 0], PRIOR)
    assert_allclose(found[x].values[1, 1], [1.0, 0.0, 0.0])
    assert found.potential(0).values[0].sum() == 0.0


def textbook(readings, steps):
    """Filtered beliefs of one run by a loop, NaN from the first impossible measurement on."""
    belief, log_evidence, found = PRIOR, 0.0, [PRIOR]
    for t in range(steps):
        belief = belief @ MOTION
        if readings[t] >= 0:
            belief = belief * SEEN[:, readings[t]]
            total = belief.sum()
            if total == 0.0:
                return np.array([*found, *np.full((steps - t, 3), np.nan)]), -np.inf
            belief, log_evidence = belief / total, log_evidence + np.log(total)
        found.append(belief)
    return np.array(found), log_evidence


@pytest.mark.parametrize("lost", [[], [0], [0, 1, 2], [1]])
def test_many_steps(lost):
    """The sweep over many steps at once goes on for the other runs; blocks, for one run."""
    steps, rng = 300, np.random.default_rng(0)
    readings = np.stack([drawn(rng, steps) for _ in range(3)])
    for k in lost:
        readings[k, 100 + 50 * k] = 0
        readings[k, 101 + 50 * k] = 2  # from the first state none leads to the third
    found = pgm.filter(SINGLE, {z: readings}, impossible="allow")
    for k, own in enumerate(readings):
        due, log_evidence = textbook(own, steps)
        assert (log_evidence == -np.inf) == (k in lost)
        assert_allclose(found[x].values[k], due, rtol=1e-9, atol=1e-12)
        assert_allclose(found.log_evidence[k], log_evidence, rtol=1e-12)
        alone = pgm.filter(SINGLE, {z: own}, impossible="allow")
        assert_allclose(alone[x].values, due, rtol=1e-9, atol=1e-12)
        assert_allclose(alone.log_evidence, log_evidence, rtol=1e-12)
    smoothed = pgm.smooth(SINGLE, {z: readings}, impossible="allow")[x].values
    assert_array_equal(np.isnan(smoothed).any(axis=(1, 2)), [k in lost for k in range(3)])
    for k in set(range(3)) - set(lost):
        assert_allclose(smoothed[k], pgm.smooth(SINGLE, {z: readings[k]})[x].values, rtol=1e-9)


def drawn(rng, steps):
    state, found = rng.choice(3, p=PRIOR), []
    for _ in range(steps):
        state = rng.choice(3, p=MOTION[state])
        found.append(rng.choice(3, p=SEEN[state]))
    return np.array(found)


def test_states_that_become_too_small_for_numbers_are_no_impossible_ones():
    """p(second state) falls to 1e-840, while none of the tables has a number below 1e-40."""
    s, o = pgm.Discrete("s", 2), pgm.Discrete("o", 3)
    small = 1e-40
    model = pgm.DynamicBayesianNetwork(
        [pgm.TableCPD(s, table=[1.0 - small, small])],
        [pgm.TableCPD(s, s.previous, table=np.eye(2))],
        [pgm.TableCPD(o, s, table=[[1.0, 0.0, 0.0], [small, 1.0 - small, 0.0]])],
    )
    due = 21 * np.log(small)
    single = pgm.filter(model, {o: [0] * 20 + [1]})
    assert_allclose(single.log_evidence, due, rtol=1e-12)
    assert_allclose(single[s].values[-1], [0.0, 1.0])
    runs = [[0] * 20 + [1], [0] * 20 + [2], [0] * 21]
    found = pgm.filter(model, {o: runs}, impossible="allow")
    assert_allclose(found.log_evidence, [due, -np.inf, 0.0], rtol=1e-12, atol=1e-30)
    assert_array_equal(np.isnan(found[s].values[:, -1, 0]), [False, True, False])
    assert not np.isnan(found[s].values[1, :-1]).any()
    with pytest.raises(ImpossibleEvidence) as caught:
        pgm.filter(model, {o: runs})
    assert (caught.value.run, caught.value.step) == (1, 21)
    assert caught.value.lost.tolist() == [False, True, False]


def test_tables_that_are_functions_of_inputs():
    s, o, i = pgm.Discrete("s", 2), pgm.Discrete("o", 2), pgm.Variable("i")
    sensor = pgm.TableCPD(
        o, s, inputs=i, table=lambda i: np.eye(2) if i[0] > 0 else np.full((2, 2), 0.5)
    )
    model = pgm.DynamicBayesianNetwork(
        [pgm.TableCPD(s, table=[0.5, 0.5])],
        [pgm.TableCPD(s, s.previous, inputs=i, table=lambda i: np.eye(2))],
        [sensor],
    )
    seen = {o: [0, 1, 0], i: np.array([[1.0], [-1.0], [1.0]])}
    assert_allclose(pgm.filter(model, seen).log_evidence, 2 * np.log(0.5))
    seen[i] = np.ones((3, 1))
    found = pgm.filter(model, seen, impossible="allow")
    assert_allclose(found[s].values, [[0.5, 0.5], [1, 0], [np.nan] * 2, [np.nan] * 2])


@pytest.mark.parametrize("ask", [pgm.filter, pgm.smooth])
def test_a_refusal_names_step_run_and_the_way_out(ask):
    with pytest.raises(
        ImpossibleEvidence, match=r"'?z'? at step 3 .*first in run 1\).*allow"
    ) as caught:
        ask(SINGLE, {z: [[0, 0, 1], [0, 0, 2], [1, 0, 2]]})
    error = caught.value
    assert (error.step, error.run, error.variable) == (3, 1, z)
    assert error.lost.tolist() == [False, True, True]
    with pytest.raises(pgm.EvidenceError) as caught:
        ask(SINGLE, {z: [0, 0, 2]})
    assert (caught.value.step, caught.value.run) == (3, None)
    assert "allow" not in str(caught.value)


def test_where_it_cannot_be_asked_the_message_does_not_name_it():
    with pytest.raises(pgm.EvidenceError, match="at step 3") as caught:
        pgm.most_probable(pgm.compile(SINGLE, T), {z: [[0, 0, 1], [0, 0, 2]]})
    assert caught.value.run == 1
    assert "allow" not in str(caught.value)
    robot = pgm.OnlineFilter(SINGLE)
    belief = robot.predict(robot.update(robot.initial(), {z: [0, 0]}))
    with pytest.raises(pgm.EvidenceError, match="at step 1") as caught:
        robot.update(belief, {z: [0, 2]})
    assert caught.value.run == 1
    assert "allow" not in str(caught.value)


def test_it_is_refused_where_it_is_not_for():
    with pytest.raises(pgm.ModelError, match='"raise" or "allow", not None'):
        pgm.filter(SINGLE, {z: READINGS}, impossible=None)
    seen = {examples.z: np.zeros((T, 1))}
    for ask in (pgm.filter, pgm.smooth):
        with pytest.raises(pgm.GraphError, match="and over time of tables, not for"):
            ask(examples.walk, seen, impossible="allow")
        with pytest.raises(pgm.GraphError, match="and over time of tables, not for"):
            ask(examples.walk, seen, belief=pgm.Grid({"x": (-5.0, 5.0, 20)}), impossible="allow")
    with pytest.raises(pgm.GraphError, match="particles have their own"):
        pgm.filter(examples.walk, seen, belief=pgm.Particles(10), impossible="allow")
    with pytest.raises(TypeError, match="impossible"):
        pgm.most_probable(pgm.compile(SINGLE, T), {z: READINGS}, impossible="allow")
