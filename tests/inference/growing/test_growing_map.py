"""Maps that grow, against all rows at once, and against `infer`."""

import gc
import pickle

import numpy as np
import pytest
from growing.dense_maps import POSE, dense, edge, free, linear, rings
from numpy.testing import assert_allclose

import pgm
from models import motion
from pgm.inference.growing import growing_map
from pgm.inference.growing.cliques import Clique


@pytest.fixture(params=["numpy", "machine"])
def machine(request, monkeypatch):
    """Whether rows are made triangular by machine code, of maps of any size."""
    if request.param == "machine":
        pytest.importorskip("llvmlite")
        monkeypatch.setattr(growing_map, "SEVERAL", 1)
    return request.param == "machine"


def assert_dense(grown, tolerance=1e-8):
    """Means, covariances and joints are those of all rows, at the map's points."""
    means, cov, place = dense(grown.network.cpds, grown.evidence, grown.points)
    assert list(means) == list(grown.variables)
    for variable, mean in means.items():
        own = cov[place[variable], place[variable]]
        scale = np.sqrt(np.diagonal(own))
        assert_allclose((grown[variable].mean - mean) / scale, 0.0, atol=tolerance)
        assert_allclose(
            grown[variable].cov / np.outer(scale, scale),
            own / np.outer(scale, scale),
            atol=tolerance,
        )
    return cov, place


def grow(steps, **options):
    grown = pgm.GrowingMap(**options)
    for cpds, evidence, start in steps:
        grown = grown.add(cpds, evidence, start=start)
    return grown


@pytest.mark.parametrize("seed", range(6))
def test_linear_networks_of_any_sizes(seed, machine):
    grown = pgm.GrowingMap(tolerance=0.0, compiled=machine)
    for cpds, evidence, _ in linear(seed, 12):
        grown = grown.add(cpds, evidence)
        cov, place = assert_dense(grown)
    some = grown.variables[::3]
    places = np.concatenate([np.arange(len(cov))[place[v]] for v in some])
    joint = grown.joint(*some)
    assert joint.scope == some
    assert_allclose(joint.cov, cov[np.ix_(places, places)], rtol=1e-8, atol=1e-10)
    assert_allclose(joint.mean, np.concatenate([grown[v].mean for v in some]))
    posterior = pgm.infer(pgm.compile(grown.network), grown.evidence)
    for variable in grown.variables:
        assert_allclose(grown[variable].mean, posterior[variable].mean, atol=1e-8)


@pytest.mark.parametrize("every", [1, 3, 10])
@pytest.mark.parametrize("seed", range(4))
def test_pose_graphs(seed, every, machine):
    grown = pgm.GrowingMap(threshold=0.05, every=every, tolerance=0.0, compiled=machine)
    moved = 0
    for cpds, evidence, start in rings(seed, 16):
        grown = grown.add(cpds, evidence, start=start)
        moved += grown.status.relinearised
        assert_dense(grown)
    assert moved


@pytest.mark.parametrize("seed", range(3))
def test_means_are_the_same_one_by_one_and_all_at_once(seed):
    """Each is found by the cliques above it, in maps with and without means of before."""
    for count in (17, 21, 34):
        grown = grow(rings(seed, count), every=10, tolerance=0.02)
        again = pickle.loads(pickle.dumps(grown))
        found = grown.means(grown.variables)
        for k in np.random.default_rng(seed).permutation(len(found)):
            assert (again[again.variables[k]].mean == found[k]).all()


@pytest.mark.parametrize("seed", range(3))
def test_means_lag_by_no_more_than_about_the_tolerance(seed):
    steps = rings(seed, 40, closures=0.2)
    options = {"threshold": np.inf, "every": 1}
    exact = grow(steps, tolerance=0.0, **options)
    every = exact.variables
    away = [
        np.abs(grow(steps, tolerance=size, **options).means(every) - exact.means(every)).max()
        for size in (1e-1, 1e-3, 1e-5)
    ]
    assert away[0] < 0.5
    assert away[1] < 1e-2
    assert away[2] < 1e-4
    assert away[0] > 0.0


@pytest.mark.parametrize("seed", range(3))
def test_settled_is_what_infer_finds(seed, machine):
    grown = grow(rings(seed, 25), compiled=machine).settled()
    posterior = pgm.infer(
        pgm.compile(grown.network),
        grown.evidence,
        start=grown.points,
        schedule=pgm.Calibration(iterations=20, tolerance=1e-10),
    )
    away = grown.means(grown.variables) - posterior.means(grown.variables)
    assert np.abs(away / posterior.stds(grown.variables)).max() < 1e-8
    assert_allclose(
        grown.covs(grown.variables), posterior.covs(grown.variables), rtol=1e-7, atol=1e-12
    )
    joint = grown.variables[3], grown.variables[-2]
    assert_allclose(grown.joint(*joint).cov, posterior.joint(*joint).cov, rtol=1e-7, atol=1e-12)
    assert_allclose(grown.stds(grown.variables), posterior.stds(grown.variables), rtol=1e-7)


@pytest.mark.parametrize("seed", range(3))
def test_the_order_of_additions_makes_no_difference_once_settled(seed):
    steps = rings(seed, 14)
    edges = [
        ([cpd], {cpd.child: evidence[cpd.child]}, {})
        for cpds, evidence, _ in steps
        for cpd in cpds[1:]
    ]
    spanning = [
        ([cpds[0], *cpds[1:2]], {v: evidence[v] for v in list(evidence)[:1]}, start)
        for cpds, evidence, start in steps
    ]
    more = [step for step in edges if step[0][0] not in {c for s in spanning for c in s[0]}]
    first = grow(steps).settled()
    for turn in range(2):
        order = np.random.default_rng(turn).permutation(len(more))
        other = grow([*spanning, *(more[k] for k in order)]).settled()
        assert set(other.variables) == set(first.variables)
        assert_allclose(other.means(first.variables), first.means(first.variables), atol=1e-9)
    whole = [part for cpds, evidence, start in steps for part in [(cpds, evidence, start)]]
    everything = pgm.GrowingMap().add(
        [cpd for cpds, _, _ in whole for cpd in cpds],
        {v: value for _, evidence, _ in whole for v, value in evidence.items()},
        start={v: value for _, _, start in whole for v, value in start.items()},
    )
    found = everything.settled().means(first.variables)
    assert_allclose(found, first.means(first.variables), atol=1e-9)


def test_maps_are_values():
    steps = rings(5, 20)
    grown = pgm.GrowingMap(threshold=0.05, every=1)
    maps, answers = [], []
    for cpds, evidence, start in steps:
        grown = grown.add(cpds, evidence, start=start)
        maps.append(grown)
        answers.append([grown.means([v])[0] for v in grown.variables])
    # Another one that grows from the middle, and goes its own way.
    cpds, evidence, start = steps[10]
    shifted = {v: np.add(value, [0.5, 0.0, 0.0]) for v, value in evidence.items()}
    branch = maps[9].add(cpds, shifted, start=start)
    assert abs(branch.means(branch.variables[-1:]) - answers[10][-1]).max() > 0.05
    again = maps[9].add(cpds, evidence, start=start)
    for one, kept in zip(maps, answers, strict=True):
        assert len(one.variables) == len(kept)
        for variable, mean in zip(one.variables, kept, strict=True):
            assert (one.means([variable])[0] == mean).all()
            assert np.isfinite(one[variable].cov).all()
    assert (again.means(again.variables) == np.array(answers[10])).all()
    assert maps[19].variables[-1] not in branch
    with pytest.raises(AttributeError, match="immutable"):
        branch.threshold = 1.0


def test_additions_touch_what_they_change():
    """Along a long chain, each touches a few variables; a closure touches its loop."""
    poses = [pgm.Variable(f"x{k}", **POSE) for k in range(600)]
    grown = pgm.GrowingMap().add(free(poses[0]), {poses[0]: np.zeros(3)})
    for k in range(1, 600):
        z = edge(f"z{k}", poses[k - 1], poses[k])
        grown = grown.add(
            [free(poses[k]), z], {z.child: [1.0, 0.0, 0.1]}, start={poses[k]: [k, 0, 0]}
        )
        assert grown.status.relinearised == 0 or k > 1
        assert poses[k] in grown.touched
    touched = [grown.status.touched]
    for k, far in ((0, 3), (1, 400)):
        z = edge(f"c{k}", poses[599 - far], poses[599])
        one = pgm.GrowingMap(threshold=np.inf)
        one = grown.add(z, {z.child: [0.0, 0.0, 0.0]})
        touched.append(len(one.touched))
    assert touched[0] < 64  # with those of the last twenty additions, which are linearised anew
    assert touched[1] < 40 < touched[2] < 600
    assert grown.status.variables == 599
    assert grown.status.cpds == 1199
    assert "599 hidden variables, 1199 CPDs" in repr(grown)
    restored = pickle.loads(pickle.dumps(grown))
    assert (restored.means(poses[1:]) == grown.means(poses[1:])).all()
    # Keys that are made of objects are of these objects now.
    kept = [f.given for home in restored._tree.homes for f, _ in home.factors]
    made = [type(each).of(each.cpd, restored._contents.known, each.reading) for each in kept]
    assert [each.key for each in kept] == [each.key for each in made]
    assert {each.key for each in kept} == set(restored._contents.plates) - {
        each.key for each in restored._contents.plates.values() if not each.parents
    }
    z = edge("after", poses[3], poses[599])
    after = {z.child: np.zeros(3)}
    assert (restored.add(z, after).means(poses[1:]) == grown.add(z, after).means(poses[1:])).all()


def test_rows_keep_digits_where_squares_lose_them(machine):
    a, b, c = pgm.variables("a b c")
    at, difference = pgm.variables("at difference")
    grown = pgm.GrowingMap(tolerance=0.0, compiled=machine)
    grown = grown.add(
        [pgm.GaussianCPD(a, 0.0, np.inf), pgm.LinearGaussianCPD(at, {a: 1.0}, 0.01)], {at: 1.0}
    )
    sharp = pgm.LinearGaussianCPD(b, {a: 1.0}, cov=1e-16, offset=0.3)
    grown = grown.add([sharp, pgm.LinearGaussianCPD(difference, {b: 1.0}, 0.01)], {difference: 2.0})
    grown = grown.add(pgm.LinearGaussianCPD(c, {a: -1.0, b: 1.0}, cov=1e-16))
    share = 1e-16 / (1e-16 + 0.02)
    found = grown[b].mean - grown[a].mean
    assert_allclose(found, 0.3 + share * 0.7, rtol=1e-13)
    # c = b − a + noise: of variances 1e-16 each, but for what the measurements tell.
    assert_allclose(grown[c].cov[0, 0], 1e-16 + 1e-16 * 0.02 / (1e-16 + 0.02), rtol=1e-9)


def test_flat_priors_and_missing_components():
    x, z, w = (pgm.Variable(n, ("p", "q")) for n in "xzw")
    half = pgm.GaussianCPD(x, [1.0, 2.0], [4.0, np.inf])
    sees = pgm.LinearGaussianCPD(z, {x: 1.0}, cov=[[2.0, 1.0], [1.0, 2.0]])
    also = pgm.LinearGaussianCPD(w, {x: 1.0}, cov=[[2.0, 1.0], [1.0, 2.0]])
    evidence = {z: [3.0, 5.0], w: [np.nan, 4.0]}
    grown = pgm.GrowingMap().add([half, sees, also], evidence)
    posterior = pgm.infer(pgm.compile(grown.network), grown.evidence)
    assert_allclose(grown[x].mean, posterior[x].mean, rtol=1e-12)
    assert_allclose(grown[x].cov, posterior[x].cov, rtol=1e-12)


def test_angles_are_read_at_the_nearest_branch():
    x = pgm.Variable("x", ("heading",), angles=("heading",))
    z = pgm.Variable("z", ("heading",), angles=("heading",))
    compass = pgm.LinearGaussianCPD(z, {x: 1.0}, cov=0.1)
    start = 3.1 + 4 * np.pi
    grown = pgm.GrowingMap().add([free(x), compass], {z: -3.1}, start={x: start})
    assert_allclose(grown[x].mean, 2 * np.pi - 3.1 + 4 * np.pi)


@pytest.mark.parametrize("turns", [0, 1, -3])
def test_motions_of_hidden_poses(turns):
    """Children of functions, started whole turns from where their parents lead to."""
    u = pgm.Variable("u", ("forward", "left", "turn"))
    poses = [pgm.Variable(f"x{k}", **POSE) for k in range(8)]
    grown = pgm.GrowingMap(threshold=0.01, every=1, tolerance=0.0)
    grown = grown.add(pgm.GaussianCPD(poses[0], [0.0, 0.0, 3.0], [1.0, 1.0, 0.1]))
    for k in range(1, 8):
        step = pgm.NonlinearGaussianCPD(
            poses[k],
            given=(poses[k - 1], u),
            function=motion.increment,
            cov=[0.1, 0.1, 0.01],
            jacobian={
                poses[k - 1]: motion.increment_by_state,
                u: motion.increment_by_control,
            },
        )
        z = edge(f"z{k}", poses[0], poses[k])
        before = grown.means(poses[k - 1 : k])[0]
        start = np.add(before, [0.1, 0.0, 0.2 + turns * 2 * np.pi])
        evidence = {z.child: [k, 0.0, 0.2 * k]} | ({u: [1.0, 0.0, 0.2]} if k == 1 else {})
        grown = grown.add([step, z], evidence, start={poses[k]: start})
        assert_dense(grown)
        assert abs(grown[poses[k]].mean - start)[2] < 1.0


def test_starts_come_from_priors_and_parents():
    a, b, c = pgm.variables("a b c")
    grown = pgm.GrowingMap().add(pgm.GaussianCPD(a, 2.0, 1.0))
    double = pgm.NonlinearGaussianCPD(b, given=a, function=lambda a: a**2, cov=0.1)
    grown = grown.add([pgm.LinearGaussianCPD(c, {b: 1.0}, 1.0, offset=1.0), double])
    assert {v: float(point[0]) for v, point in grown.points.items()} == {a: 2.0, b: 4.0, c: 5.0}
    assert_allclose(grown[c].cov, [[16.0 + 0.1 + 1.0]])
    assert grown.touched == (a, b, c)


def test_known_parents_are_kept():
    m = pgm.Variable("m", ("east", "north"))
    x, u = pgm.variables("x u")
    z = [pgm.Variable(f"z{k}") for k in range(2)]

    def far(x, m):
        return np.hypot(m[..., :1] - x, m[..., 1:])

    sees = [pgm.NonlinearGaussianCPD(v, given=(x, m), function=far, cov=0.01) for v in z]
    grown = pgm.GrowingMap().add([pgm.GaussianCPD(x, 0.0, 1.0), sees[0]], {z[0]: 5.0, m: [3, 4]})
    varying = pgm.LinearGaussianCPD(
        u, {x: 1.0}, cov=pgm.noise(lambda m: m[..., :1, None] ** 2, given=m)
    )
    grown = grown.add([sees[1], varying], {z[1]: 5.1, u: 0.3}).settled()
    posterior = pgm.infer(
        pgm.compile(grown.network), grown.evidence, schedule=pgm.Calibration(iterations=30)
    )
    assert_allclose(grown[x].mean, posterior[x].mean, atol=1e-7)
    assert_allclose(grown[x].cov, posterior[x].cov, rtol=1e-6)


def test_parts_that_nothing_joins_yet():
    a, b, z = pgm.variables("a b z")
    grown = pgm.GrowingMap().add(pgm.GaussianCPD(a, 1.0, 1.0)).add(pgm.GaussianCPD(b, 2.0, 4.0))
    assert grown.touched == (b,)
    assert_allclose(grown.joint(a, b).cov, [[1.0, 0.0], [0.0, 4.0]])
    joined = grown.add(pgm.LinearGaussianCPD(z, {a: 1.0, b: -1.0}, 1.0), {z: 0.0})
    assert_allclose(joined.joint(b, a).cov, [[4 - 16 / 6, 4 / 6], [4 / 6, 1 - 1 / 6]])
    assert_allclose(grown.joint(a, b).cov, [[1.0, 0.0], [0.0, 4.0]])


def test_machine_code_takes_over_after_thousands_of_cliques(monkeypatch):
    pytest.importorskip("llvmlite")
    monkeypatch.setattr(growing_map, "ENOUGH", 10)
    steps = rings(2, 20)
    assert not pgm.GrowingMap()._machine
    taken = grow(steps)
    assert taken._machine
    assert not grow(steps, compiled=False)._machine
    found = grow(steps, compiled=False).means(taken.variables)
    assert_allclose(taken.means(taken.variables), found, atol=1e-9)


def test_nothing_is_added_in_vain():
    a = pgm.Variable("a")
    empty = pgm.GrowingMap()
    assert empty.add([]).status.touched == 0
    assert empty.settled() is empty
    assert repr(empty) == "GrowingMap(0 hidden variables, 0 CPDs, 0 cliques)"
    held = empty.add(pgm.GaussianCPD(a, 1.0, 1.0), {a: 3.0})
    assert held.variables == ()
    assert a not in held
    assert held.evidence[a] == 3.0


def test_cliques_that_are_no_more_are_forgotten():
    """A map keeps its own alone, though means are found by those of before."""

    def alive():
        gc.collect()
        return sum(isinstance(each, Clique) for each in gc.get_objects())

    before = alive()
    poses = [pgm.Variable(f"x{k}", **POSE) for k in range(60)]
    grown = pgm.GrowingMap(every=7).add(free(poses[0]), {poses[0]: np.zeros(3)})
    for k in range(1, 60):
        z = edge(f"z{k}", poses[k - 1], poses[k])
        grown = grown.add(
            [free(poses[k]), z], {z.child: [1.0, 0.0, 0.1]}, start={poses[k]: [k, 0, 0]}
        )
        assert np.isfinite(grown[poses[k]].mean).all()
    assert alive() - before == grown.status.cliques
