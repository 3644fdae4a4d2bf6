"""Modes and continuous states whose numbers are sharp, singular, far apart or no numbers."""

import numpy as np
import pytest

import pgm
from pgm.kernels import merging
from tests.beliefs.hypotheses.test_switching_chains import MODE, TABLE, X, Z, far, walk

NONE = np.zeros(0, dtype=int)
PAIR = pgm.Variable("pair", components=("at", "bias"))


def exact(model, evidence, steps):
    """The static mixed network of all steps."""
    static = {v.at(t): a[t - 1] for v, a in evidence.items() for t in range(1, steps + 1)}
    return pgm.infer(pgm.compile(model.unroll(steps)), static)


@pytest.mark.parametrize("prior", [1e6, 1e10, 1e14, 1e18])
def test_smoothing_that_sharpens_keeps_its_digits(prior):
    read = {Z: [[1.0], [1.5], [0.3], [0.9]]}
    model = walk(q=(0.1, 4.0), prior=prior)
    wanted = exact(model, read, 4)[X.at(0)]
    for belief in (None, pgm.Gaussians(5), pgm.Gaussians(64), pgm.Gaussians(mix=True)):
        found = pgm.smooth(model, read, belief=belief)[X.at(0)]
        assert far(found.cov / wanted.cov, 1.0) < 1e-3
        assert far(found.mean, wanted.mean) < 1e-3
        if belief == pgm.Gaussians(64):
            assert far(found.cov / wanted.cov, 1.0) < 1e-9


@pytest.mark.parametrize("prior", [1e4, 1e8, 1e12])
def test_two_sharp_sensors_of_a_place_and_its_bias(prior):
    y = pgm.Variable("y")
    cases = {
        k: pgm.LinearGaussianCPD(PAIR, {PAIR.previous: 1.0}, cov=np.diag([1.0, q]))
        for k, q in enumerate((1e-3, 1e-2))
    }
    model = pgm.DynamicBayesianNetwork(
        prior=[
            pgm.TableCPD(MODE, table=[0.5, 0.5]),
            pgm.GaussianCPD(PAIR, [0.0, 0.0], np.diag([prior, 1e-2])),
        ],
        transition=[
            pgm.TableCPD(MODE, given=MODE.previous, table=TABLE),
            pgm.SwitchingCPD(PAIR, given=MODE, cases=cases),
        ],
        observation=[
            pgm.LinearGaussianCPD(Z, {PAIR: [[1.0, 0.0]]}, cov=1e-3),
            pgm.LinearGaussianCPD(y, {PAIR: [[1.0, 1.0]]}, cov=1e-3),
        ],
    )
    read = {Z: [[1000.0], [1000.5], [999.0]], y: [[1000.1], [1000.5], [999.2]]}
    wanted = exact(model, read, 3)[PAIR.at(0)]
    for belief in (None, pgm.Gaussians(16), pgm.Gaussians(mix=True)):
        found = pgm.smooth(model, read, belief=belief)[PAIR.at(0)]
        within = 1e-8 if belief == pgm.Gaussians(16) else 5e-3  # of what merging loses
        assert far(np.diag(found.cov) / np.diag(wanted.cov), 1.0) < within
        assert far((found.mean - wanted.mean) / wanted.std, 0.0) < within


def test_coasting_that_is_unstable_is_smoothed():
    cases = {
        k: pgm.LinearGaussianCPD(X, {X.previous: 2.0}, cov=q) for k, q in enumerate((0.1, 0.1001))
    }
    model = walk().replace(
        transition=[walk().transition[0], pgm.SwitchingCPD(X, given=MODE, cases=cases)]
    )
    read = np.full((20, 1), np.nan)
    read[-1] = 2.0**20
    plain = walk().replace(prior=walk().prior[1:], transition=[cases[0]])
    wanted = pgm.smooth(plain, {Z: read})
    for belief in (None, pgm.Gaussians(mix=True)):
        found = pgm.smooth(model, {Z: read}, belief=belief)
        assert far((found[X].mean - wanted[X].mean) / wanted[X].std, 0.0) < 1e-2
        assert far(found[X].cov / wanted[X].cov, 1.0) < 1e-2


def test_a_mode_that_is_unlikely_beyond_all_numbers_is_kept():
    """Two readings of what one mode expects, and then many of what the other does."""
    mode = pgm.Discrete("state", states=("a1", "a2", "b"))
    moves = {
        k: pgm.LinearGaussianCPD(X, {X.previous: 0.5}, cov=q) for k, q in enumerate((0.1, 0.3, 0.1))
    }
    looks = {
        k: pgm.LinearGaussianCPD(Z, {X: 1.0}, offset=o, cov=0.1) for k, o in enumerate((0, 0, 30))
    }
    model = pgm.DynamicBayesianNetwork(
        prior=[pgm.TableCPD(mode, table=[0.3, 0.3, 0.4]), pgm.GaussianCPD(X, 0.0, 1.0)],
        transition=[
            pgm.TableCPD(
                mode,
                given=mode.previous,
                table=[[0.9, 0.1, 0.0], [0.2, 0.8, 0.0], [0.0, 0.0, 1.0]],
            ),
            pgm.SwitchingCPD(X, given=mode, cases=moves),
        ],
        observation=[pgm.SwitchingCPD(Z, given=mode, cases=looks)],
    )
    read = {Z: [[0.0]] * 2 + [[30.0]] * 4}
    many = pgm.smooth(model, read, belief=pgm.Gaussians(300))
    for count in (None, 4, 8):
        found = pgm.smooth(model, read, belief=pgm.Gaussians(count))
        assert far(found.log_evidence, many.log_evidence) < 1e-6
        assert far(found[mode].probabilities[:, 2], 1.0) < 1e-6


def test_dead_members_begin_no_component_and_bar_none():
    logs = np.log([0.2, 0.5, 0.0001, 0.2999])
    mean, cov = np.array([[10.0, 0.0, 20.0, 0.1]]), np.ones((1, 1, 4))
    one, _ = merging.seeded(logs, np.zeros(4, int), mean, cov, 3, 0.05, NONE)
    dead = np.append(logs, -np.inf)
    kind = np.append(np.zeros(4, int), 1)
    mean, cov = np.append(mean, [[5.0]], axis=1), np.ones((1, 1, 5))
    other, _ = merging.seeded(dead, kind, mean, cov, 3, 0.05, NONE)
    assert len({*one.tolist()}) == 3
    assert [one.tolist().index(k) for k in one] == [other[:4].tolist().index(k) for k in other[:4]]


def test_a_run_is_merged_as_if_alone_where_others_have_more_hypotheses():
    mode = pgm.Discrete("level", states=("a", "b", "c"))
    gauge = pgm.Discrete("gauge", states=("low", "high"))
    moves = {
        k: pgm.LinearGaussianCPD(X, {X.previous: 0.9}, offset=o, cov=0.2)
        for k, o in enumerate((0.0, 3.0, -3.0))
    }
    model = pgm.DynamicBayesianNetwork(
        prior=[pgm.TableCPD(mode, table=[0.4, 0.3, 0.3]), pgm.GaussianCPD(X, 0.0, 1.0)],
        transition=[
            pgm.TableCPD(mode, given=mode.previous, table=np.full((3, 3), 1 / 3)),
            pgm.SwitchingCPD(X, given=mode, cases=moves),
        ],
        observation=[
            pgm.LinearGaussianCPD(Z, {X: 1.0}, cov=0.5),
            pgm.TableCPD(gauge, given=mode, table=[[1.0, 0.0], [0.5, 0.5], [0.0, 1.0]]),
        ],
    )
    read = np.array([[[0.5], [1.0], [1.2]], [[-1.0], [0.3], [2.0]]])
    gauges = np.array([[0, 0, 0], [1, -1, 1]])
    for count in (4, 5, 8):
        belief = pgm.Gaussians(count)
        together = pgm.smooth(model, {Z: read, gauge: gauges}, belief=belief)
        for run in range(2):
            alone = pgm.smooth(model, {Z: read[run], gauge: gauges[run]}, belief=belief)
            assert far(together.log_evidence[run], alone.log_evidence) < 1e-12
            assert far(together[X].mean[run], alone[X].mean) < 1e-12


def test_a_contradiction_is_judged_by_the_size_of_its_own_component():
    """One component is of a thousand millions, and another is not what a fault makes certain."""
    sensor = pgm.Variable("sensor", components=("p", "q"))
    fault = pgm.Discrete("fault", states=("stuck", "ok"))
    model = pgm.DynamicBayesianNetwork(
        prior=[pgm.GaussianCPD(PAIR, [1e9, 0.0], np.diag([1e12, 1.0]))],
        transition=[
            pgm.TableCPD(fault, table=[0.1, 0.9]),
            pgm.LinearGaussianCPD(PAIR, {PAIR.previous: np.eye(2)}, cov=np.diag([1.0, 0.01])),
        ],
        observation=[
            pgm.SwitchingCPD(
                sensor,
                given=fault,
                cases={
                    0: pgm.LinearGaussianCPD(sensor, {PAIR: np.diag([1, 0])}, np.diag([1.0, 0.0])),
                    1: pgm.LinearGaussianCPD(sensor, {PAIR: np.eye(2)}, np.diag([1.0, 0.1])),
                },
            )
        ],
    )
    found = pgm.filter(model, {sensor: [[1e9, 0.7]]})
    assert far(found[fault].probabilities, [[0.0, 1.0]]) == 0.0


@pytest.mark.parametrize("count", [2, 3, 5, 64])
def test_an_unlikely_member_that_is_far_wider_and_singular_is_merged(count):
    push, move = np.array([[0.5], [1.0]]), [[1.0, 1.0], [0.0, 1.0]]
    cases = {
        k: pgm.LinearGaussianCPD(PAIR, {PAIR.previous: move}, cov=q * push @ push.T)
        for k, q in enumerate((0.0, 1e6))
    }
    model = pgm.DynamicBayesianNetwork(
        prior=[
            pgm.TableCPD(MODE, table=[0.99, 0.01]),
            pgm.GaussianCPD(PAIR, [0.0, 1.0], np.zeros((2, 2))),
        ],
        transition=[
            pgm.TableCPD(MODE, given=MODE.previous, table=[[0.99, 0.01], [0.2, 0.8]]),
            pgm.SwitchingCPD(PAIR, given=MODE, cases=cases),
        ],
        observation=[pgm.LinearGaussianCPD(Z, {PAIR: [[1.0, 0.0]]}, cov=1.0)],
    )
    read = {Z: [[1.0], [1.5], [3.3], [2.9]]}
    found = pgm.smooth(model, read, belief=pgm.Gaussians(count))
    assert far(found.log_evidence, exact(model, read, 4).log_evidence) < 1e-2


def test_a_belief_of_rank_one_flows_back():
    move = [
        [0.3, -0.37, -0.36, -0.4],
        [0.37, 0.48, 0.05, -0.26],
        [-0.44, -0.48, 0.16, 0.24],
        [0.01, -0.18, -0.1, -0.07],
    ]
    push = np.array([[1.23], [-1.22], [0.04], [2.14]])
    x = pgm.Variable("wide", components=tuple("abcd"))
    cases = {
        k: pgm.LinearGaussianCPD(x, {x.previous: move}, cov=q * push @ push.T)
        for k, q in enumerate((1.0, 4.0))
    }
    look = pgm.LinearGaussianCPD(Z, {x: [[-1.41, -0.72, 0.12, -1.71]]}, cov=7.388897504837709e-06)
    model = pgm.DynamicBayesianNetwork(
        prior=[
            pgm.TableCPD(MODE, table=[0.5, 0.5]),
            pgm.GaussianCPD(x, np.zeros(4), np.zeros((4, 4))),
        ],
        transition=[
            pgm.TableCPD(MODE, given=MODE.previous, table=TABLE),
            pgm.SwitchingCPD(x, given=MODE, cases=cases),
        ],
        observation=[look],
    )
    found = pgm.smooth(model, {Z: [[1.0], [0.2]]})
    assert np.isfinite(found[x].cov).all()
    assert (
        far(found.log_evidence, exact(model, {Z: np.array([[1.0], [0.2]])}, 2).log_evidence) < 0.1
    )


def rooted(chance):
    """A mode whose motion has no value below zero."""

    def function(v):
        with np.errstate(invalid="ignore"):
            return np.sqrt(v)

    cases = {
        0: pgm.LinearGaussianCPD(X, {X.previous: 1.0}, cov=0.1),
        1: pgm.NonlinearGaussianCPD(X, X.previous, function, cov=0.1),
    }
    return pgm.DynamicBayesianNetwork(
        prior=[pgm.TableCPD(MODE, table=[1.0, 0.0]), pgm.GaussianCPD(X, -5.0, 0.01)],
        transition=[
            pgm.TableCPD(MODE, given=MODE.previous, table=[[1 - chance, chance], [0.0, 1.0]]),
            pgm.SwitchingCPD(X, given=MODE, cases=cases),
        ],
        observation=[pgm.LinearGaussianCPD(Z, {X: 1.0}, cov=0.1)],
    )


def test_an_impossible_mode_may_have_no_value_and_a_possible_one_is_named():
    read = {Z: np.array([[[-5.0], [-4.9]], [[-5.1], [np.nan]]])}
    plain = rooted(0.0)
    one = plain.replace(prior=plain.prior[1:], transition=[plain.transition[1].cases[0,]])
    wanted = pgm.smooth(one, read)
    found = pgm.smooth(plain, read)
    assert far(found.log_evidence, wanted.log_evidence) < 1e-12
    assert far(found[X].mean, wanted[X].mean) < 1e-12
    assert far(found[MODE].probabilities[..., 0], 1.0) == 0.0
    with pytest.raises(pgm.LinearisationError, match="has values that are NaN or infinite") as told:
        pgm.smooth(rooted(0.1), read)
    assert told.value.step == 1
    with pytest.raises(pgm.NumericalError, match="or expects readings too far from these"):
        pgm.filter(walk(), {Z: [[1e200]]})


def test_too_many_gaussians_are_refused_before_memory_is_taken(monkeypatch):
    monkeypatch.setattr("pgm.resources.most_memory", lambda: 2**30)
    with pytest.raises(pgm.GraphError, match="keep fewer Gaussians"):
        pgm.filter(walk(), {Z: np.zeros((5, 1))}, belief=pgm.Gaussians(30_000))


def test_a_control_stands_at_no_step_where_there_are_none():
    control = pgm.Discrete("control", states=("k", "l"))
    model = walk().replace(transition=[*walk().transition, pgm.TableCPD(control, table=[0.4, 0.6])])
    found = pgm.smooth(model, {}, steps=0)
    assert found[control].probabilities.shape == (0, 2)
    assert found[MODE].probabilities.shape == (1, 2)
