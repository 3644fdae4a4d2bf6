"""Joint compatibility: against every hypothesis, looked at one by one."""

import itertools

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.stats import chi2, multivariate_normal

import pgm
from models import sensors
from pgm.kernels import joint_compatibility

x = pgm.Variable("x", components=("east", "north", "heading"), angles=("heading",))
m = pgm.Variable("m", components=("east", "north"))
z = pgm.Variable("z", components=("range", "bearing"), angles=("bearing",))
NOISE = np.diag([0.1**2, 0.02**2])
GATE = 0.99


def robot(start=(0.0, 0.0, 0.0), cov=(0.05, 0.05, 0.12)):
    return pgm.DynamicBayesianNetwork(
        prior=[pgm.GaussianCPD(x, start, np.diag(np.square(cov)))],
        transition=[pgm.LinearGaussianCPD(x, {x.previous: np.eye(3)}, cov=1e-4 * np.eye(3))],
        observation=[
            pgm.NonlinearGaussianCPD(
                z,
                (x, m),
                sensors.range_bearing,
                cov=NOISE,
                jacobian={x: sensors.range_bearing_by_state},
            )
        ],
    )


def enumerated(values, marks, mean, cov, weights):
    """The best hypothesis of all: most pairings within the joint gate, then the likeliest."""
    rows, off = {}, {}
    for i, k in itertools.product(range(len(values)), range(len(marks))):
        rows[i, k] = sensors.range_bearing_by_state(mean, marks[k])
        miss = values[i] - sensors.range_bearing(mean, marks[k])
        off[i, k] = np.array([miss[0], (miss[1] + np.pi) % (2 * np.pi) - np.pi])
    best, found = (-1, -np.inf), None
    for each in itertools.product(range(-1, len(marks)), repeat=len(values)):
        pairs = [(i, k) for i, k in enumerate(each) if k >= 0]
        if len({k for _, k in pairs}) < len(pairs):
            continue
        score = 0.0
        if pairs:
            whole = np.vstack([rows[pair] for pair in pairs])
            miss = np.concatenate([off[pair] for pair in pairs])
            spread = whole @ cov @ whole.T + np.kron(np.eye(len(pairs)), NOISE)
            alone = [
                off[p] @ np.linalg.solve(rows[p] @ cov @ rows[p].T + NOISE, off[p]) for p in pairs
            ]
            if max(alone) > chi2.ppf(GATE, 2):
                continue
            if miss @ np.linalg.solve(spread, miss) > chi2.ppf(GATE, miss.size):
                continue
            score = multivariate_normal(np.zeros(miss.size), spread).logpdf(miss)
            score += sum(np.log(weights[k]) for _, k in pairs)
        if (len(pairs), score) > best:
            best, found = (len(pairs), score), each
    return found


@pytest.mark.parametrize("weights", [None, [0.1, 0.3, 0.2, 0.4]], ids=["alike", "weighed"])
def test_the_best_of_all_hypotheses_is_found(weights):
    runs, marks = 40, np.array([[5.0, 0.0], [5.0, 0.6], [4.6, 1.4], [5.4, -0.7]])
    rng = np.random.default_rng(8)
    states = np.array([0.05, 0.05, 0.12]) * rng.normal(size=(runs, 3))
    seen = np.array([rng.permutation(4)[:3] for _ in range(runs)])
    values = sensors.range_bearing(np.tile(states[:, None], (1, 3, 1)), marks[seen])
    values = values + rng.normal(size=values.shape) @ np.sqrt(NOISE)
    values[::5, 1] += [0.7, 0.1]  # of nothing
    model, given = robot(), {m: pgm.unknown(marks, gate=GATE, weights=weights, association="joint")}
    evidence = {z: pgm.sightings(values, step=np.zeros(3, int), given=given)}
    found = pgm.filter(model, evidence, steps=0)
    weights = np.full(4, 0.25) if weights is None else weights
    cov = np.diag(np.square([0.05, 0.05, 0.12]))
    due = [enumerated(each, marks, np.zeros(3), cov, weights) for each in values]
    assert_array_equal(found.associations[z].candidate, due)
    assert len({tuple(np.sort(each)) for each in due}) > 3
    assert any(-1 in each for each in due)
    # Taken in as if they had been known; online as offline.
    one = {z: pgm.sightings(values[0], step=np.zeros(3, int), given={m: marks[list(due[0])]})}
    if -1 not in due[0]:
        assert_allclose(found[x].mean[0, 0], pgm.filter(model, one, steps=0)[x].mean[0])
    online = pgm.OnlineFilter(model)
    belief = online.update(online.initial(), {z: pgm.sightings(values, given=given)})
    assert_array_equal(belief.associations[z].candidate, due)
    assert_allclose(belief[x].mean, found[x].mean[:, 0], atol=1e-12)


def test_a_turned_robot_is_put_right_by_all_sightings_together():
    """Landmarks on a ring: each sighting by itself is nearest to the next landmark."""
    ring = np.linspace(0.0, 2.0 * np.pi, 24, endpoint=False)[[0, 1, 2, 4, 7, 8, 12, 13, 17, 20]]
    marks = 6.0 * np.column_stack([np.cos(ring), np.sin(ring)])
    runs, rng = 60, np.random.default_rng(2)
    turned = np.zeros((runs, 3))
    turned[:, 2] = 0.2 * rng.normal(size=runs)
    seen = np.array([rng.permutation(len(marks))[:6] for _ in range(runs)])
    values = sensors.range_bearing(np.tile(turned[:, None], (1, 6, 1)), marks[seen])
    values = values + rng.normal(size=values.shape) @ np.sqrt(NOISE)
    right = {}
    for way in ("likelihood", "joint"):
        given = {m: pgm.unknown(marks, gate=0.999, association=way)}
        evidence = {z: pgm.sightings(values, step=np.zeros(6, int), given=given)}
        found = pgm.filter(robot(cov=(0.05, 0.05, 0.2)), evidence, steps=0)
        right[way] = (found.associations[z].candidate == seen).mean()
    print(right)
    assert right["joint"] > 0.97 > 0.9 > right["likelihood"]


def test_spurious_and_new_sightings_keep_their_shares():
    marks = np.array([[5.0, 0.0], [0.0, 5.0]])
    values = np.array([[5.0, 0.0], [5.0, np.pi / 2], [9.0, 2.5], [np.nan, np.nan]])
    for shares, due in (({"spurious": 0.1, "new": 0.2}, -2), ({"spurious": 0.2, "new": 0.1}, -1)):
        given = {m: pgm.unknown(marks, gate=GATE, association="joint", volume=60.0, **shares)}
        evidence = {z: pgm.sightings(values, step=np.zeros(4, int), given=given)}
        found = pgm.filter(robot(), evidence, steps=0).associations[z]
        assert_array_equal(found.candidate, [0, 1, due, -1])
        assert np.isnan(found.probability[3]).all()


def test_too_many_hypotheses_are_refused(monkeypatch):
    marks = np.array([[5.0, 0.0], [5.0, 0.02], [5.0, -0.02], [5.02, 0.0]])
    values = np.tile([5.0, 0.0], (4, 1))
    given = {m: pgm.unknown(marks, gate=GATE, association="joint")}
    evidence = {z: pgm.sightings(values, step=np.full(4, 2), given=given)}
    assert len(set(pgm.filter(robot(), evidence, steps=2).associations[z].candidate)) == 4
    monkeypatch.setattr(joint_compatibility, "NODES", 4)
    with pytest.raises(
        pgm.EvidenceError, match=r"4 sightings of z at step 2.*in more than"
    ) as told:
        pgm.filter(robot(), evidence, steps=2)
    assert told.value.step == 2


def test_what_cannot_be_associated_together_is_refused():
    marks = np.array([[5.0, 0.0]])
    with pytest.raises(pgm.EvidenceError, match="give gate="):
        pgm.unknown(marks, association="joint")
    given = {m: pgm.unknown(marks, gate=GATE, association="joint")}
    evidence = {z: pgm.sightings([[5.0, 0.0]], step=[0], given=given)}
    with pytest.raises(pgm.EvidenceError, match="together: that is for Gaussian beliefs"):
        pgm.filter(robot(), evidence, steps=1, belief=pgm.Particles(10))
