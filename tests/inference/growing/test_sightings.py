"""Sightings whose landmark nobody named, against the joint Gaussian of all rows at once."""

import itertools
import pickle

import numpy as np
import pytest
from growing.dense_maps import POSE, dense, edge, free
from numpy.testing import assert_allclose
from scipy.stats import chi2, multivariate_normal

import pgm
from models import motion, sensors
from pgm.kernels import joint_compatibility

POSES = [pgm.Variable(f"x{k}", **POSE) for k in range(4)]
MARKS = [pgm.Variable(f"l{k}", ("east", "north")) for k in range(5)]
M, M2 = pgm.variables(["m", "m2"], ("east", "north"))
NOISE = np.diag([0.1**2, 0.03**2])
PLACES = np.array([[4.0, 1.0], [4.2, 1.9], [3.9, 2.7], [5.0, -2.0], [1.0, 5.0]])
MOVED = 0.4, 0.2, -0.1
PATH = np.array([[0.0, 0.0, 0.1], [0.5, 0.1, 0.2], [1.0, 0.2, 0.1], [1.4, 0.4, 0.0]])


def sees(name, pose, mark):
    """A range and a bearing of a landmark."""
    return pgm.NonlinearGaussianCPD(
        pgm.Variable(name, ("range", "bearing"), angles=("bearing",)),
        given=(pose, mark),
        function=sensors.range_bearing,
        jacobian={
            pose: sensors.range_bearing_by_state,
            mark: sensors.range_bearing_by_landmark,
        },
        cov=NOISE,
    )


def read(rng, pose, mark):
    return sensors.range_bearing(PATH[pose], PLACES[mark]) + rng.normal(size=2) @ np.sqrt(NOISE)


def step(rng, k):
    """A pose and the motion to it, from the one before."""
    z = edge(f"o{k}", POSES[k - 1], POSES[k])
    exact = motion.relative(PATH[k - 1][None], PATH[k][None])[0]
    told = exact + rng.normal(size=3) * [0.1, 0.1, 0.03]
    return [free(POSES[k]), z], {z.child: told}, {POSES[k]: PATH[k]}


def mapped(seed=0, heading=0.05):
    """A map of three poses, each of which has seen all landmarks."""
    rng = np.random.default_rng(seed)
    grown = pgm.GrowingMap(tolerance=0.0, threshold=0.02, every=1)
    grown = grown.add(pgm.GaussianCPD(POSES[0], PATH[0], np.square([0.2, 0.2, heading])))
    for k in range(3):
        cpds, evidence, start = step(rng, k) if k else ([], {}, {})
        for j, mark in enumerate(MARKS):
            if not k:
                cpds.append(free(mark))
                start[mark] = PLACES[j]
            cpds.append(sees(f"z{k}_{j}", POSES[k], mark))
            evidence[cpds[-1].child] = read(rng, k, j)
        grown = grown.add(cpds, evidence, start=start)
    return grown, rng


def at_means(grown):
    """Means by variable, all rows' covariance and where each variable stands in it."""
    return dense(grown.network.cpds, grown.evidence, grown.points)


def innovation(belief, reading, pose, mark, size):
    """The residual of a reading and its slopes by all components, at the means."""
    means, cov, place = belief
    x, m = means[pose], means[mark]
    slope = np.zeros((2, len(cov)))
    slope[:, place[pose]] = sensors.range_bearing_by_state(x, m)
    slope[:, place[mark]] = sensors.range_bearing_by_landmark(x, m)
    left = reading - sensors.range_bearing(x, m)
    left[1] -= 2 * np.pi * np.round(left[1] / (2 * np.pi))
    return left[:size], slope[:size]


def shares(belief, reading, pose, marks, unknown, size=2):
    """The probabilities of all candidates, of spurious and of new, by the dense belief."""
    found = []
    for mark, weight in zip(marks, unknown["weights"], strict=True):
        left, slope = innovation(belief, reading, pose, mark, size)
        spread = slope @ belief[1] @ slope.T + NOISE[:size, :size]
        near = left @ np.linalg.solve(spread, left) <= chi2.ppf(unknown["gate"], size)
        found.append(near * weight * multivariate_normal(np.zeros(size), spread).pdf(left))
    rest = 1.0 - unknown["spurious"] - unknown["new"]
    found = [rest * each / sum(unknown["weights"]) for each in found]
    found += [unknown[name] / unknown["volume"] for name in ("spurious", "new")]
    return np.array(found) / sum(found)


OPEN = {
    "weights": [1.0, 2.0, 1.5, 1.0, 0.5],
    "gate": 0.999,
    "spurious": 0.1,
    "new": 0.05,
    "volume": 60.0,
}


@pytest.mark.parametrize("seed", range(4))
def test_probabilities_are_those_of_the_joint_belief(seed):
    grown, rng = mapped(seed)
    cpds, evidence, start = step(rng, 3)
    seen = [sees(f"y{j}", POSES[3], M) for j in range(6)]
    values = [*(read(rng, 3, j) for j in range(5)), np.array([9.0, 2.0])]
    stage = grown.add(cpds, evidence, start=start)
    belief = at_means(stage)
    readings = {cpd.child: value for cpd, value in zip(seen, values, strict=True)}
    found = grown.add(
        [*seen, *cpds], evidence | readings | {M: pgm.unknown(MARKS, **OPEN)}, start=start
    )
    assert list(found.associations) == list(readings)
    for sighting, reading in readings.items():
        due = shares(belief, reading, POSES[3], MARKS, OPEN)
        one = found.associations[sighting]
        assert one.candidates == tuple(MARKS)
        assert_allclose(one.probability, due, atol=1e-9)
        likeliest = int(np.argmax(due))
        assert one.candidate == (likeliest if likeliest < 5 else 4 - likeliest)
        assert one.variable == (MARKS[likeliest] if likeliest < 5 else None)
    assert found.associations[seen[5].child].candidate == -1
    assert {one.variable for one in found.associations.values()} > {MARKS[3], MARKS[4]}


def test_the_map_is_that_of_the_names():
    """Whatever was taken is added as if it had been named, to the last motion and its posterior."""
    grown, rng = mapped()
    cpds, evidence, start = step(rng, 3)
    seen = [sees(f"y{j}", POSES[3], M) for j in range(5)]
    readings = {cpd.child: read(rng, 3, j) for j, cpd in enumerate(seen)}
    given = {M: pgm.unknown(MARKS, gate=0.999)}
    found = grown.add([*cpds, *seen], evidence | readings | given, start=start)
    taken = {z: one.variable for z, one in found.associations.items()}
    named = [sees(z.name, POSES[3], mark) for z, mark in taken.items()]
    due = grown.add([*cpds, *named], evidence | readings, start=start)
    for variable in due.variables:
        assert_allclose(found[variable].mean, due[variable].mean, atol=1e-9)
        assert_allclose(found[variable].cov, due[variable].cov, atol=1e-12)
    assert set(found.touched) >= set(due.touched)
    assert found.status.touched == len(found.touched)
    assert found.status.cpds == due.status.cpds
    assert found.status.eliminated > due.status.eliminated
    assert found.relinearised == due.relinearised
    assert M not in found.network.variables
    assert {cpd.child: cpd.given[1] for cpd in found.network.cpds if cpd.child in taken} == taken
    assert set(found.evidence) == set(due.evidence)
    settled = found.settled()
    assert settled.associations == found.associations
    posterior = pgm.infer(
        pgm.compile(settled.network),
        settled.evidence,
        start=settled.points,
        schedule=pgm.Calibration(iterations=10, tolerance=1e-12),
    )
    for variable in settled.variables:
        assert_allclose(settled[variable].mean, posterior[variable].mean, atol=1e-8)
    assert len(found.add([]).associations) == len(grown.associations) == 0
    with pytest.raises(pgm.EvidenceError, match="no open sighting y0; it has"):
        grown.associations[seen[0].child]
    restored = pickle.loads(pickle.dumps(found))
    assert {z: one.variable for z, one in restored.associations.items()} == taken


def enumerated(belief, readings, pose, gate, weights):
    """The best hypothesis of all: most pairings within the joint gate, then the likeliest."""
    cov = belief[1]
    parts = {
        (i, j): innovation(belief, reading, pose, mark, 2)
        for i, reading in enumerate(readings)
        for j, mark in enumerate(MARKS)
    }

    def square(pairs):
        left = np.concatenate([parts[pair][0] for pair in pairs])
        slope = np.vstack([parts[pair][1] for pair in pairs])
        spread = slope @ cov @ slope.T + np.kron(np.eye(len(pairs)), NOISE)
        return left @ np.linalg.solve(spread, left), left, spread

    best, found = (-1, -np.inf), None
    for each in itertools.product(range(-1, len(MARKS)), repeat=len(readings)):
        pairs = [(i, j) for i, j in enumerate(each) if j >= 0]
        if len({j for _, j in pairs}) < len(pairs):
            continue
        score = 0.0
        if pairs:
            if max(square([pair])[0] for pair in pairs) > chi2.ppf(gate, 2):
                continue
            whole, left, spread = square(pairs)
            if whole > chi2.ppf(gate, left.size):
                continue
            score = multivariate_normal(np.zeros(left.size), spread).logpdf(left)
            score += sum(np.log(weights[j] / sum(weights)) for _, j in pairs)
        if (len(pairs), score) > best:
            best, found = (len(pairs), score), each
    return list(found)


@pytest.mark.parametrize("seed", range(8))
def test_the_best_of_all_hypotheses_is_found(seed):
    """A robot that hardly knows where it looks, and whose landmarks are known by each other."""
    grown, rng = mapped(seed)
    grown = grown.settled()
    lost = pgm.NonlinearGaussianCPD(
        POSES[3], POSES[2], lambda x: x + np.array(MOVED), cov=np.square([0.3, 0.3, 0.3])
    )
    stage = grown.add(lost)
    belief = dense_of(grown, stage)
    few = rng.permutation(5)[:4]
    seen = [sees(f"y{j}", POSES[3], M) for j in range(4)]
    values = [read(rng, 3, j) for j in few]
    if seed % 2:
        values[1] = values[1] + [0.9, 0.3]  # of nothing, maybe
    readings = {cpd.child: value for cpd, value in zip(seen, values, strict=True)}
    weights = [0.1, 0.3, 0.2, 0.2, 0.2]
    given = {M: pgm.unknown(MARKS, gate=0.99, weights=weights, association="joint")}
    found = grown.add([lost, *seen], readings | given)
    due = enumerated(belief, values, POSES[3], 0.99, weights)
    assert [found.associations[z].candidate for z in readings] == due
    assert all(set(one.probability) == {0.0, 1.0} for one in found.associations.values())
    taken = [one.variable for one in found.associations.values() if one.variable]
    assert len(set(taken)) == len(taken)


def dense_of(grown, stage):
    """The dense belief of a map and one motion more, whose slope is the identity."""
    means, cov, place = at_means(grown)
    last, size = place[POSES[2]], len(cov)
    across = cov[:, last]
    own = cov[last, last] + np.square(0.3) * np.eye(3)
    whole = np.block([[cov, across], [across.T, own]])
    means = means | {POSES[3]: means[POSES[2]] + MOVED}
    assert_allclose(stage[POSES[3]].mean, means[POSES[3]], atol=1e-9)
    return means, whole, place | {POSES[3]: slice(size, size + 3)}


def test_joint_decisions_are_of_joint_covariances():
    """Each sighting by itself is nearest to the wrong landmark; together they are put right."""
    x, m, a, b = pgm.variables("x m a b")
    z, w = pgm.variables("z w")
    prior = [pgm.GaussianCPD(x, 0.0, 4.0), pgm.GaussianCPD(a, 0.0, 0.01)]
    prior.append(pgm.LinearGaussianCPD(b, {a: 1.0}, cov=0.0001, offset=1.0))
    grown = pgm.GrowingMap().add(prior)
    seen = [pgm.LinearGaussianCPD(v, {m: 1.0, x: -1.0}, cov=0.01) for v in (z, w)]
    readings = {z: 1.2, w: 2.2}  # nearest both to b, by themselves
    alone = grown.add(seen, readings | {m: pgm.unknown([a, b], gate=0.999)})
    assert [one.variable for one in alone.associations.values()] == [b, b]
    given = {m: pgm.unknown([a, b], gate=0.999, association="joint")}
    both = grown.add(seen, readings | given)
    assert [one.variable for one in both.associations.values()] == [a, b]
    assert_allclose(both[x].mean, [-1.2 * 4.0 / 4.01], atol=0.02)


def test_what_is_of_no_candidate_stays_free():
    grown, rng = mapped()
    grown = grown.settled()
    far, near = sees("far", POSES[2], M), sees("near", POSES[2], M)
    values = {far.child: [9.0, 2.0], near.child: read(rng, 2, 3)}
    open_ = pgm.unknown(MARKS, gate=0.999, new=0.1, volume=60.0)
    found = grown.add([far, near], values | {M: open_})
    one = found.associations[far.child]
    assert one.candidate == -2
    assert one.variable is None
    assert_allclose(one.probability, [0, 0, 0, 0, 0, 0, 1])
    assert found.associations[near.child].variable == MARKS[3]
    assert far.child not in found.evidence
    assert far.child not in found.network.variables
    own = pgm.Variable("l9", ("east", "north"))
    again = sees("far", POSES[2], own)
    more = found.add([free(own), again], {far.child: [9.0, 2.0]}, start={own: [-3.0, 8.0]})
    more = more.settled()
    assert_allclose(
        sensors.range_bearing(more[POSES[2]].mean, more[own].mean), [9.0, 2.0], atol=1e-6
    )
    only = grown.add(far, {far.child: [9.0, 2.0], M: open_})
    assert only.status.cpds == grown.status.cpds
    assert only.touched == ()
    # Where nothing is declared, what is beyond the gate is spurious.
    bare = grown.add(far, {far.child: [9.0, 2.0], M: pgm.unknown(MARKS, gate=0.999)})
    assert bare.associations[far.child].candidate == -1


def test_new_landmarks_of_the_addition_are_candidates():
    grown, _ = mapped()
    own = pgm.Variable("l9", ("east", "north"))
    first, again = sees("first", POSES[2], own), sees("again", POSES[2], M)
    at = np.array([7.0, 2.5])
    found = grown.add(
        [again, free(own), first],
        {first.child: at, again.child: at, M: pgm.unknown([*MARKS, own])},
        start={own: [-4.0, 4.0]},
    )
    assert found.associations[again.child].variable == own


def test_missing_components_and_sensors_of_other_sizes():
    grown, rng = mapped()
    grown = grown.settled()
    ranging = pgm.NonlinearGaussianCPD(
        pgm.Variable("r", ("range",)),
        given=(M, POSES[1]),
        function=lambda m, x: sensors.range_bearing(x, m)[..., :1],
        cov=NOISE[:1, :1],
    )
    whole, part = sees("whole", POSES[2], M), sees("part", POSES[2], M)
    nothing = sees("nothing", POSES[0], M)
    values = {
        ranging.child: read(rng, 1, 3)[:1],
        whole.child: read(rng, 2, 4),
        part.child: [*read(rng, 2, 1)[:1], np.nan],
        nothing.child: [np.nan, np.nan],
    }
    named = {"weights": [1.0] * 5, "gate": 0.99, "spurious": 0.0, "new": 0.0, "volume": 1.0}
    open_ = pgm.unknown(MARKS, gate=0.99)
    found = grown.add([ranging, whole, part, nothing], values | {M: open_}).associations
    belief = at_means(grown)
    due = {
        ranging.child: (POSES[1], 1),
        whole.child: (POSES[2], 2),
        part.child: (POSES[2], 1),
    }
    for z, (pose, size) in due.items():
        value = np.array([*np.atleast_1d(values[z]), 0.0])[:2]
        shares_of = shares(belief, value, pose, MARKS, named, size)
        assert_allclose(found[z].probability, shares_of, atol=1e-10)
    assert 0.01 < found[part.child].probability.max() < 0.99
    assert not found[nothing.child].measured
    assert found[nothing.child].candidate == -1
    assert np.isnan(found[nothing.child].probability).all()
    joint = pgm.unknown(MARKS, gate=0.99, association="joint")
    found = grown.add([ranging, whole, part, nothing], values | {M: joint}).associations
    assert found[whole.child].variable == MARKS[4]
    assert found[part.child].variable != found[ranging.child].variable


def test_open_parents_are_decided_in_turn():
    """The second is told apart by what the first has said of the pose."""
    x, p, q, a, b = pgm.variables("x p q a b")
    z, w = pgm.variables("z w")
    marks = [pgm.GaussianCPD(a, 0.0, 1e-4), pgm.GaussianCPD(b, 1.0, 1e-4)]
    grown = pgm.GrowingMap().add([pgm.GaussianCPD(x, 0.0, 1.0), *marks])
    first = pgm.LinearGaussianCPD(z, {p: 1.0, x: -1.0}, cov=1e-4)
    second = pgm.LinearGaussianCPD(w, {q: 1.0, x: -1.0}, cov=1e-4)
    given = {p: pgm.unknown([a]), q: pgm.unknown([a, b])}
    found = grown.add([second, first], {z: 0.6, w: 0.6} | given)
    assert list(found.associations) == [z, w]
    assert_allclose(found.associations[w].probability, [1.0, 0.0, 0.0, 0.0], atol=1e-9)
    alone = grown.add([second], {w: 0.6, q: given[q]})
    assert alone.associations[w].probability[1] > 0.5


def test_affine_sensors_and_noise_of_known_parents():
    x, m, a, b = pgm.variables("x m a b")
    z, u = pgm.variables("z u")
    grown = pgm.GrowingMap().add([pgm.GaussianCPD(v, k, 1.0) for k, v in enumerate((x, a, b))])
    varying = pgm.noise(lambda u: u[..., None] ** 2, given=u)
    seen = pgm.LinearGaussianCPD(z, {m: 2.0, x: -1.0}, cov=varying, offset=0.5)
    found = grown.add(seen, {z: 3.0, u: 0.7, m: pgm.unknown([a, b])})
    # ẑ = 2 m − x + 0.5, with the variance 4 + 1 + 0.49.
    density = np.exp(-0.5 * np.square([3.0 - 2.5, 3.0 - 4.5]) / 5.49)
    assert_allclose(found.associations[z].probability[:2], density / density.sum())
    posterior = pgm.infer(pgm.compile(found.network), found.evidence)
    assert_allclose(found[a].mean, posterior[a].mean)
    assert found.evidence[u] == 0.7


def test_a_sensor_is_called_once_for_all_candidates():
    calls = []

    def ranging(x, m):
        calls.append(np.shape(m))
        return sensors.range_bearing(x, m)

    grown, rng = mapped()
    slopes = sensors.range_bearing_by_state, sensors.range_bearing_by_landmark
    seen = []
    for j in range(4):
        z = pgm.Variable(f"y{j}", ("range", "bearing"), angles=("bearing",))
        given = POSES[j % 2], M
        jacobian = dict(zip(given, slopes, strict=True))
        seen.append(pgm.NonlinearGaussianCPD(z, given, ranging, NOISE, jacobian=jacobian))
    readings = {cpd.child: read(rng, j % 2, j) for j, cpd in enumerate(seen)}
    grown.add(seen, readings | {M: pgm.unknown(MARKS, gate=0.999)})
    assert sum(shape[0] == 4 * len(MARKS) for shape in calls if shape) == 1
    assert len(calls) < 8


def test_too_many_hypotheses_are_refused(monkeypatch):
    grown, rng = mapped()
    seen = [sees(f"y{j}", POSES[2], M) for j in range(3)]
    readings = {cpd.child: read(rng, 2, 1) for cpd in seen}
    open_ = pgm.unknown(MARKS, gate=0.9999999, association="joint")
    monkeypatch.setattr(joint_compatibility, "NODES", 2)
    words = r"3 sightings \(y0, y1, y2\) that leave m open fit .* in more than 2 ways"
    with pytest.raises(pgm.EvidenceError, match=words):
        grown.add(seen, readings | {M: open_})


def test_associations_are_shown():
    grown, rng = mapped()
    seen = sees("y", POSES[2], M)
    one = grown.add(seen, {seen.child: read(rng, 2, 3), M: pgm.unknown(MARKS)}).associations
    found = one[seen.child]
    assert repr(found).splitlines()[0] == "Association(l3, of 5 candidates)"
    assert "probability" in str(found)
    with pytest.raises(AttributeError, match="immutable"):
        found.candidate = 2
    with pytest.raises(TypeError):
        one[seen.child] = found
    with pytest.raises(ValueError, match="read-only"):
        found.probability[0] = 1.0


def test_sensors_may_list_their_parents_in_any_order():
    x, m, a, b, z, w = pgm.variables("x m a b z w")
    grown = pgm.GrowingMap().add([pgm.GaussianCPD(v, k, 1.0) for k, v in enumerate((x, a, b))])
    one = pgm.LinearGaussianCPD(z, {m: 1.0, x: -1.0}, cov=0.1)
    other = pgm.LinearGaussianCPD(w, {x: -1.0, m: 1.0}, cov=0.1)
    found = grown.add([one, other], {z: 1.0, w: 2.0, m: pgm.unknown([a, b])}).associations
    for cpd, value in ((one, 1.0), (other, 2.0)):
        alone = grown.add(cpd, {cpd.child: value, m: pgm.unknown([a, b])}).associations
        assert found[cpd.child].probability == pytest.approx(alone[cpd.child].probability)


def test_readings_beyond_all_densities_are_refused():
    x, m, a, b, z = pgm.variables("x m a b z")
    grown = pgm.GrowingMap().add([pgm.GaussianCPD(v, k, 1.0) for k, v in enumerate((x, a, b))])
    sees = pgm.LinearGaussianCPD(z, {m: 1.0, x: -1.0}, cov=0.1)
    with pytest.raises(pgm.NumericalError, match="more than 1e150 deviations") as info:
        grown.add(sees, {z: 1e160, m: pgm.unknown([a, b])})
    assert info.value.cpd is sees
    beyond = grown.add(sees, {z: 1e160, m: pgm.unknown([a, b], gate=0.999)})
    assert beyond.associations[z].candidate == -1
