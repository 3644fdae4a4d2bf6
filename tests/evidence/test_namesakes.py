"""Two different variables of one name: refusals say how they differ; equal ones are the same."""

import numpy as np
import pytest

import pgm

x, twin = (pgm.Variable("x", components=("p", "v")) for _ in range(2))
other, z = pgm.Variable("x"), pgm.Variable("z")
blind = pgm.Variable("z", components=("range",))
MODEL = pgm.DynamicBayesianNetwork(
    [pgm.GaussianCPD(x, [0.0, 1.0], 1.0)],
    [pgm.LinearGaussianCPD(twin, {x.previous: 1.0}, 0.1)],
    [pgm.LinearGaussianCPD(z, {twin: [[1.0, 0.0]]}, 0.1)],
)
EVIDENCE = {pgm.Variable("z"): np.ones((3, 1))}
FOUND = pgm.filter(MODEL, EVIDENCE)
ROBOT = pgm.OnlineFilter(MODEL)
MARGINAL = FOUND[x.at(1)]


def test_equal_variables_are_one():
    assert FOUND[twin].mean.shape == FOUND[pgm.Variable("x", ("p", "v"))].mean.shape == (4, 2)
    assert FOUND[twin.at(3).previous].mean.tolist() == FOUND[x.at(2)].mean.tolist()
    assert FOUND.joint(x.at(1), twin.at(2)).scope == (x.at(1), x.at(2))


def test_angles_are_in_the_order_of_the_components():
    """So a set of them, whose order is of the process, makes the same variable each time."""
    pose = [
        pgm.Variable("pose", components=("east", "roll", "yaw"), angles=angles)
        for angles in (("roll", "yaw"), ("yaw", "roll"), {"yaw", "roll"}, ["yaw", "yaw", "roll"])
    ]
    assert len(set(pose)) == 1
    assert pose[1].angles == ("roll", "yaw")


ASKED = {
    "a parent": lambda: pgm.LinearGaussianCPD(z, {x: [[1.0, 0.0]], other.previous: 1.0}, 1.0),
    "a CPD": lambda: MODEL.replace(observation=[pgm.LinearGaussianCPD(z, {other: 1.0}, 0.1)]),
    "a marginal": lambda: FOUND[other],
    "one step": lambda: FOUND[other.at(1)],
    "a joint": lambda: FOUND.joint(x.at(1), other.at(2)),
    "a marginal of a marginal": lambda: MARGINAL.marginal(other.at(1)),
    "what is kept": lambda: pgm.filter(MODEL, EVIDENCE, keep=other),
    "a start": lambda: pgm.smooth(MODEL, EVIDENCE, start={other: np.zeros((4, 1))}),
    "an online belief": lambda: ROBOT.initial()[other],
    "a parent's value": lambda: MODEL.observation[0].log_density(0.0, {other: 0.0}),
    "a Jacobian": lambda: pgm.NonlinearGaussianCPD(
        z, x, lambda x: x[..., :1], 0.1, jacobian={other: lambda x: x}
    ),
    "what is learnt": lambda: pgm.fit(
        MODEL, EVIDENCE, learn={z: pgm.learning.Coefficients(free={other: True})}
    ),
}


@pytest.mark.parametrize("asked", ASKED.values(), ids=ASKED)
def test_another_variable_of_the_name(asked):
    with pytest.raises(pgm.PgmError) as caught:
        asked()
    assert "components ('p', 'v')" in str(caught.value)
    assert "components ('x')" in str(caught.value)


@pytest.mark.parametrize(
    "asked",
    [
        lambda: FOUND.innovations[blind],
        lambda: pgm.filter(MODEL, {blind: np.ones((3, 1))}),
        lambda: pgm.filter(MODEL, EVIDENCE, gate={blind: 0.99}),
        lambda: ROBOT.update(ROBOT.initial(), {blind: [1.0]}),
    ],
)
def test_another_sensor_of_the_name(asked):
    with pytest.raises(pgm.PgmError) as caught:
        asked()
    assert "components ('z')" in str(caught.value)
    assert "components ('range')" in str(caught.value)


def test_states_of_the_same_name():
    wet, rain = pgm.Discrete("wet", 2), pgm.Discrete("wet", ("no", "yes"))
    net = pgm.BayesianNetwork([pgm.TableCPD(wet, table=[0.5, 0.5])])
    graph = pgm.compile(net)
    for asked in (
        lambda: pgm.query(net, rain),
        lambda: pgm.infer(graph, {})[rain],
        lambda: pgm.infer(graph, {rain: "yes"}),
        lambda: pgm.most_probable(graph, {}).states(rain),
        lambda: pgm.ClusterGraph(net, [{rain}]),
    ):
        with pytest.raises(pgm.PgmError, match=r"\('0', '1'\).*\('no', 'yes'\)"):
            asked()


def test_a_difference_that_a_list_cut_short_does_not_show():
    names = [f"c{k}" for k in range(12)]
    first, second = (pgm.Variable("y", [*names[:10], end, "last"]) for end in ("c10", "other"))
    with pytest.raises(pgm.ModelError, match=r"number 11 is 'c10' and 'other'"):
        pgm.LinearGaussianCPD(z, {first: np.ones((1, 12)), second.previous: np.ones((1, 12))}, 1.0)


def test_what_is_said_of_a_reading_that_nobody_took_is_true():
    """Its distribution is that of a copy of its CPD in the transition."""
    s, o, copy = (pgm.Discrete(name, 2) for name in ("s", "o", "copy"))
    A, B = np.array([[0.9, 0.1], [0.2, 0.8]]), np.array([[0.8, 0.2], [0.3, 0.7]])
    chain = pgm.DynamicBayesianNetwork(
        [pgm.TableCPD(s, table=[0.5, 0.5])],
        [pgm.TableCPD(s, s.previous, table=A), pgm.TableCPD(copy, s, table=B)],
        [pgm.TableCPD(o, s, table=B)],
    )
    found = pgm.filter(chain, {o: [1, 0, 1, -1]})
    p = np.array([0.5, 0.5])
    for seen in (1, 0, 1):
        p = (p @ A) * B[:, seen]
        p /= p.sum()
    for asked in (found[copy.at(4)], found[o.at(4)], found.predicted[o.at(4)]):
        np.testing.assert_allclose(asked.probabilities, p @ A @ B)
    with pytest.raises(pgm.EvidenceError) as caught:
        found.joint(o.at(4))
    assert "observed" not in str(caught.value)
    assert "posterior[o.at(t)] is the belief" in str(caught.value)
    assert "put a copy of its CPD" in str(caught.value)
    with pytest.raises(pgm.EvidenceError, match=r"predicted\[z\].*posterior\.innovations\[z\]"):
        FOUND[z]
    with pytest.raises(pgm.EvidenceError, match=r"posterior\.innovations\[z\].*put a copy"):
        FOUND.joint(x.at(1), z.at(1))
