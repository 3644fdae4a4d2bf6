"""Models to draw; figures are drawn without a screen."""

import matplotlib

matplotlib.use("Agg")

import numpy as np
import pytest

import pgm
from models.motion import Velocity
from models.sensors import range_bearing
from pgm.clustergraph import Cluster, ClusterGraph

X = pgm.Variable("x", components=("east", "north", "heading"), angles=("heading",))
U = pgm.Variable("u", components=("v", "omega"))
Z = pgm.Variable("z", components=("range", "bearing"), angles=("bearing",))
M = pgm.Variable("m", components=("east", "north"))


@pytest.fixture(autouse=True)
def _figures():
    before = dict(matplotlib.rcParams)
    yield
    assert dict(matplotlib.rcParams) == before


@pytest.fixture
def robot():
    """Program 1: a robot that sees landmarks."""
    return pgm.DynamicBayesianNetwork(
        prior=[pgm.GaussianCPD(X, mean=[0, 0, 0], cov=np.diag([0.5, 0.5, 0.05]) ** 2)],
        transition=[
            pgm.NonlinearGaussianCPD(
                X, given=(X.previous, U), function=Velocity(dt=1.0), cov=np.eye(3) * 1e-3
            )
        ],
        observation=[
            pgm.NonlinearGaussianCPD(Z, given=(X, M), function=range_bearing, cov=np.eye(2) * 0.01)
        ],
    )


def two_states():
    """Two states, a hidden control, a static unknown, and two sensors."""
    a, b, c, w, command, y, gps, place = pgm.variables("a b c w command y gps place")
    linear = pgm.LinearGaussianCPD
    return pgm.DynamicBayesianNetwork(
        prior=[
            pgm.GaussianCPD(a, 0.0, 1.0),
            linear(b, given={a: 1.0}, cov=1.0),
            pgm.GaussianCPD(c, 0.0, 1.0),
        ],
        transition=[
            linear(w, given={command: 1.0}, cov=0.1),
            linear(a, given={a.previous: 1.0, w: 1.0}, cov=0.1),
            linear(b, given={b.previous: 1.0, a: 0.5, a.previous: 0.1}, cov=0.1),
            linear(c, given={c.previous: 1.0}, cov=0.0),
        ],
        observation=[
            linear(y, given={a: 1.0, c: 1.0, place: 1.0}, cov=0.1),
            linear(gps, given={b: 1.0}, cov=0.1),
        ],
    )


def many_inputs():
    """Three states, seven inputs to one of them, and three sensors with inputs of their own."""
    s, z, m = (pgm.variables([f"{name}{k}" for k in range(3)]) for name in "szm")
    u = pgm.variables([f"u{k}" for k in range(7)])
    linear = pgm.LinearGaussianCPD
    return pgm.DynamicBayesianNetwork(
        prior=[pgm.GaussianCPD(state, 0.0, 1.0) for state in s],
        transition=[
            linear(s[0], given={s[0].previous: 1.0, **dict.fromkeys(u, 1.0)}, cov=0.1),
            linear(s[1], given={s[1].previous: 1.0, s[0].previous: 1.0}, cov=0.1),
            linear(s[2], given={s[2].previous: 1.0, s[1]: 1.0, s[0]: 1.0}, cov=0.1),
        ],
        observation=[linear(z[k], given={s[k]: 1.0, m[k]: 1.0}, cov=0.1) for k in range(3)],
    )


def long_names():
    """A robot whose variables have long names."""
    pose, control, sight, place = pgm.variables(
        "robot_pose wheel_odometry landmark_sighting landmark_position"
    )
    linear = pgm.LinearGaussianCPD
    return pgm.DynamicBayesianNetwork(
        prior=[pgm.GaussianCPD(pose, 0.0, 1.0)],
        transition=[linear(pose, given={pose.previous: 1.0, control: 1.0}, cov=1.0)],
        observation=[linear(sight, given={pose: 1.0, place: 1.0}, cov=1.0)],
    )


def crossed_prior():
    """A prior that orders two states otherwise than the transition does."""
    a, b = pgm.variables("a b")
    linear = pgm.LinearGaussianCPD
    return pgm.DynamicBayesianNetwork(
        prior=[pgm.GaussianCPD(a, 0.0, 1.0), linear(b, given={a: 1.0}, cov=1.0)],
        transition=[
            linear(b, given={b.previous: 1.0}, cov=1.0),
            linear(a, given={a.previous: 1.0, b: 1.0}, cov=1.0),
        ],
    )


@pytest.fixture(params=[two_states, many_inputs, long_names, crossed_prior])
def model(request):
    """Models that are hard to draw."""
    return request.param()


class AnyGraph(ClusterGraph):
    """Clusters and edges as they are given; a sepset is the intersection."""

    def __init__(self, scopes, edges):
        self._set(
            _members=scopes,
            _shared=dict.fromkeys(edges),
            _clusters=[Cluster(k, tuple(scope), (), ()) for k, scope in enumerate(scopes)],
            _sepsets={(i, j): tuple(v for v in scopes[i] if v in scopes[j]) for i, j in edges},
        )

    def families(self):
        return ()


@pytest.fixture
def any_graph():
    """How to make a graph of any shape."""
    return AnyGraph
