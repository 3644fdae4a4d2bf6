"""Beliefs of a hidden Markov model's measurements, against sums over all states by ten lines."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

import pgm

s, c, o = pgm.Discrete("s", 3), pgm.Discrete("c", 2), pgm.Discrete("o", 2)
u, r = pgm.Discrete("u", 2), pgm.Variable("r")
RNG = np.random.default_rng(5)


def table(*shape):
    return RNG.dirichlet(np.ones(shape[-1]), shape[:-1])


FIRST, OF_C, MOVE, READ, TOLD = table(3), table(2), table(3, 2, 3), table(3, 2), table(2, 3, 2)
MEANS, COVS = [0.0, 2.0, -1.0], [0.5, 1.0, 2.0]
MODEL = pgm.DynamicBayesianNetwork(
    [pgm.TableCPD(s, table=FIRST)],
    [pgm.TableCPD(c, table=OF_C), pgm.TableCPD(s, given=(s.previous, c), table=MOVE)],
    [
        pgm.TableCPD(o, given=s, table=READ),
        pgm.SwitchingCPD(r, s, {k: pgm.GaussianCPD(r, MEANS[k], COVS[k]) for k in range(3)}),
    ],
)
STEP = np.einsum("c,scx->sx", OF_C, MOVE)


def chain(weights, smoothed=False):
    """Predicted, filtered and smoothed probabilities by step, of weights (T+1, states)."""
    ahead, known = [FIRST], []
    for w in weights:
        found = ahead[-1] * w
        known.append(found / found.sum())
        ahead.append(known[-1] @ STEP)
    back, all_ = np.ones(3), [None] * len(weights)
    for t in reversed(range(len(weights))):
        all_[t] = known[t] * back / (known[t] @ back)
        back = STEP @ (weights[t] * back)
    return np.array(ahead[:-1]), np.array(known), np.array(all_)


def density(value):
    return np.exp(-0.5 * (value - np.array(MEANS)) ** 2 / COVS) / np.sqrt(COVS)


OS, RS = np.array([1, -1, 0, 1]), np.array([[0.3], [1.9], [np.nan], [-4.0]])
WEIGHTS = np.ones((7, 3))
for k, (state, value) in enumerate(zip(OS, RS[:, 0], strict=True), 1):
    WEIGHTS[k] *= READ[:, state] if state >= 0 else 1.0
    WEIGHTS[k] *= density(value) if np.isfinite(value) else 1.0


@pytest.mark.parametrize("how", [pgm.filter, pgm.smooth])
def test_one_step_ahead_beyond_the_last_and_not_taken(how):
    found = how(MODEL, {o: OS, r: RS}, steps=6)
    ahead, known, smoothed = chain(WEIGHTS)
    assert_allclose(found.predicted[o].probabilities, (ahead @ READ)[1:], rtol=1e-12)
    assert_allclose(found.predicted[o.at(5)].probabilities, ahead[5] @ READ, rtol=1e-12)
    mixture = found.predicted[r]
    assert_allclose(mixture.weights, ahead[1:], rtol=1e-12)
    assert_allclose(mixture.mean[:, 0], ahead[1:] @ MEANS, rtol=1e-12)
    assert_allclose(mixture.components.cov[..., 0, 0], [COVS] * 6)
    belief = known if how is pgm.filter else smoothed
    for t in (2, 5):
        assert_allclose(found[o.at(t)].probabilities, belief[t] @ READ, rtol=1e-12)
    assert_allclose(found[r.at(3)].weights, belief[3], rtol=1e-12)
    with pytest.raises(pgm.EvidenceError, match=r"o\[3\] has evidence there"):
        found[o.at(3)]


def test_runs_and_observed_parents():
    """Of each run the parent that it was told, also where nothing was read."""
    model = MODEL.replace(observation=[pgm.TableCPD(o, given=(u, s), table=TOLD)])
    told, seen = RNG.integers(2, size=(4, 6)), RNG.integers(2, size=(4, 2))
    evidence = {o: pgm.sightings(seen, step=[2, 5]), u: told}
    found = pgm.filter(model, evidence).predicted[o].probabilities
    assert found.shape == (4, 6, 2)
    for run in range(4):
        weights = np.ones((7, 3))
        for t, state in zip((2, 5), seen[run], strict=True):
            weights[t] = TOLD[told[run, t - 1], :, state]
        ahead = chain(weights)[0]
        due = [ahead[t] @ TOLD[told[run, t - 1]] for t in range(1, 7)]
        assert_allclose(found[run], due, rtol=1e-12)
    given = pgm.sightings([1, -1, -1], step=[1, 3, 3], given={u: [0, 1, 0]})
    alone = pgm.filter(model, {o: given}, steps=4).predicted[o].probabilities
    weights = np.ones((7, 3))
    weights[1] = TOLD[0, :, 1]
    ahead = chain(weights)[0]
    assert_allclose(alone, [ahead[1] @ TOLD[0], ahead[3] @ TOLD[1], ahead[3] @ TOLD[0]], rtol=1e-12)
    with pytest.raises(pgm.EvidenceError, match=r"observed parents \[u\]"):
        pgm.filter(model, {}, steps=4).predicted[o]


def test_readings_left_out_are_those_of_a_run_without_them():
    found = pgm.smooth(MODEL, {o: OS, r: RS}, steps=6).left_out
    for row in range(4):
        rest = np.where(np.arange(4) == row, -1, OS)
        again = pgm.smooth(MODEL, {o: rest, r: RS}, steps=6)
        due = again[o.at(row + 1)].probabilities
        assert_allclose(found[o].probabilities[row], due, rtol=1e-12)
        rest = np.where(np.arange(4)[:, None] == row, np.nan, RS)
        again = pgm.smooth(MODEL, {o: OS, r: rest}, steps=6)
        assert_allclose(found[r].weights[row], again[r.at(row + 1)].weights, rtol=1e-12)


def test_a_reading_that_alone_rules_out_a_state_is_left_out():
    """Its likelihood is zero in states that the others allow; single and joint runs, and logs."""
    sure = MODEL.replace(observation=[pgm.TableCPD(o, given=s, table=[[1, 0], [0.5, 0.5], [0, 1]])])
    steps = 40
    seen = RNG.integers(2, size=(3, steps))
    found = pgm.smooth(sure, {o: seen}).left_out[o].probabilities
    for row in (0, 17, steps - 1):
        rest = np.where(np.arange(steps) == row, -1, seen)
        again = pgm.smooth(sure, {o: rest})[o.at(row + 1)].probabilities
        assert_allclose(found[:, row], again, rtol=1e-11)
    single = pgm.DynamicBayesianNetwork(
        [pgm.TableCPD(s, table=[1, 0, 0])],
        [pgm.TableCPD(s, s.previous, table=[[1, 1e-200, 0], [0, 1, 0], [0, 1e-3, 1.0 - 1e-3]])],
        [pgm.TableCPD(o, s, table=[[1, 0], [1e-180, 1], [0, 1]])],
    )
    told = pgm.smooth(single, {o: [0, 0, 0]}).left_out[o].probabilities
    again = pgm.smooth(single, {o: [0, -1, 0]})[o.at(2)].probabilities
    assert_allclose(told[1], again, rtol=1e-10)


def test_impossible_runs_have_no_forecasts():
    sure = MODEL.replace(observation=[pgm.TableCPD(o, given=s, table=[[1, 0], [1, 0], [1, 0]])])
    found = pgm.filter(sure, {o: [[0, 0, 0], [0, 1, 0]]}, steps=4, impossible="allow")
    ahead = found.predicted[o].probabilities
    assert np.isfinite(ahead[0]).all()
    assert np.isfinite(ahead[1, :2]).all()
    assert np.isnan(ahead[1, 2:]).all()


@pytest.mark.parametrize("runs", [(), (2,)])
def test_in_a_robots_loop(runs):
    """Of each step before its readings are taken, those of the record."""
    heard = np.broadcast_to([1, 0, 1, -1], (*runs, 4))
    values = np.broadcast_to([[0.5], [np.nan], [1.0], [np.nan]], (*runs, 4, 1))
    due = pgm.filter(MODEL, {o: heard, r: values}).predicted
    robot = pgm.OnlineFilter(MODEL, lag=2)
    belief = robot.initial()
    for k in range(4):
        belief = robot.predict(belief)
        found, own = belief.predicted, due[r]
        for one, other in (  # the prior is of one run until evidence is of several
            (found[o].probabilities, due[o].probabilities[..., k, :]),
            (found[r].mean, own.mean[..., k, :]),
            (found[r].cov, own.cov[..., k, :, :]),
        ):
            assert_allclose(np.broadcast_to(one, other.shape), other, rtol=1e-12)
        assert found[s].probabilities.tolist() == belief[s].probabilities.tolist()
        belief = robot.update(belief, {o: heard[..., k], r: values[..., k, :]})
    with pytest.raises(pgm.EvidenceError, match="knows measurements of its step"):
        belief.predicted[o]


def test_in_a_loop_with_observed_parents():
    told = pgm.DynamicBayesianNetwork(
        [pgm.TableCPD(s, table=FIRST)],
        [pgm.TableCPD(s, s.previous, table=MOVE[:, 0])],
        [pgm.TableCPD(o, given=(u, s), table=TOLD)],
    )
    belief = pgm.OnlineFilter(told).initial()
    found = belief.predicted.of(o, given={u: [1, 0]})
    assert_allclose(found.probabilities, [FIRST @ TOLD[1], FIRST @ TOLD[0]], rtol=1e-12)
    with pytest.raises(pgm.EvidenceError, match=r"depends on \[u\], which nothing tells"):
        belief.predicted[o]


def test_mixtures_that_states_choose():
    """A sensor's mixture of CPDs counts by its components, as drawn readings do."""
    place, read = pgm.Discrete("place", 2), pgm.Variable("read")
    means, noises, shares = ((0.0, 5.0), (2.0, 7.0)), (1.0, 4.0), (0.7, 0.3)
    cases = {
        k: pgm.MixtureCPD(
            [pgm.GaussianCPD(read, m, v) for m, v in zip(own, noises, strict=True)], shares
        )
        for k, own in enumerate(means)
    }
    model = pgm.DynamicBayesianNetwork(
        [pgm.TableCPD(place, table=[0.6, 0.4])],
        [pgm.TableCPD(place, place.previous, table=[[0.8, 0.2], [0.3, 0.7]])],
        [pgm.SwitchingCPD(read, place, cases)],
    )
    found = pgm.smooth(model, {read: [[0.5], [3.0]]}, steps=3)
    ahead, states = found.predicted[read], found.predicted[place].probabilities[1:]
    each = states[:, :, None] * shares
    mean = np.einsum("tkc,kc->t", each, means)
    square = np.einsum("tkc,kc->t", each, np.square(means) + noises)
    assert_allclose(ahead.mean[:, 0], mean, rtol=1e-12)
    assert_allclose(ahead.cov[:, 0, 0], square - mean**2, rtol=1e-12)
    less = pgm.smooth(model, {read: [[np.nan], [3.0]]}, steps=3)
    assert_allclose(found.left_out[read].mean[0], less[read.at(1)].mean, rtol=1e-12)
