"""Networks and cluster graphs that are hard to draw, each as a function that draws it."""

from __future__ import annotations

import warnings
from itertools import combinations

import numpy as np

import pgm
import pgm.plot
from models.unknown_landmarks import unknown_landmarks

_linear = pgm.LinearGaussianCPD


def static(parents, name="v"):
    """A network of scalars whose parents are given by number."""
    v = pgm.variables([f"{name}{k}" for k in range(len(parents))])
    return pgm.BayesianNetwork(
        _linear(v[k], given={v[p]: 1.0 for p in given}, cov=1.0)
        if given
        else pgm.GaussianCPD(v[k], 0.0, 1.0)
        for k, given in enumerate(parents)
    )


def random_parents(count, seed=0, reach=8):
    """Up to two parents each, among the last few."""
    rng = np.random.default_rng(seed)
    return [
        rng.choice(np.arange(max(0, k - reach), k), size=min(k, 1 + k % 2), replace=False).tolist()
        for k in range(count)
    ]


def random_tree(count, seed=0, reach=30):
    rng = np.random.default_rng(seed)
    return [[], *([int(rng.integers(max(0, k - reach), k))] for k in range(1, count))]


def square(side):
    """A grid, whose network has loops of all sizes."""
    return [
        [n for n, there in ((k - 1, k % side), (k - side, k >= side)) if there]
        for k in range(side * side)
    ]


def robots(count):
    """Robots each of which sees every other."""
    x = pgm.variables([f"r{k}" for k in range(1, count + 1)])
    z = pgm.variables([f"z{i + 1}_{j + 1}" for i, j in combinations(range(count), 2)])
    return pgm.DynamicBayesianNetwork(
        prior=[pgm.GaussianCPD(one, 0.0, 1.0) for one in x],
        transition=[_linear(one, given={one.previous: 1.0}, cov=0.1) for one in x],
        observation=[
            _linear(one, given={x[i]: 1.0, x[j]: -1.0}, cov=0.1)
            for one, (i, j) in zip(z, combinations(range(count), 2), strict=True)
        ],
    )


def hub(landmarks):
    """A robot that sees landmarks whose places are unknown."""
    x, u = pgm.variables("x u")
    m = pgm.variables([f"m{k}" for k in range(1, landmarks + 1)])
    z = pgm.variables([f"z{k}" for k in range(1, landmarks + 1)])
    return pgm.DynamicBayesianNetwork(
        prior=[pgm.GaussianCPD(one, 0.0, 1.0) for one in (x, *m)],
        transition=[
            _linear(x, given={x.previous: 1.0, u: 1.0}, cov=0.1),
            *(_linear(one, given={one.previous: 1.0}, cov=0.0) for one in m),
        ],
        observation=[
            _linear(one, given={x: 1.0, place: -1.0}, cov=0.1)
            for one, place in zip(z, m, strict=True)
        ],
    )


def sensors(count):
    """A robot with many sensors, and an input each for some of them."""
    x, u = pgm.variables("x u")
    z = pgm.variables([f"z{k}" for k in range(1, count + 1)])
    m = pgm.variables([f"m{k}" for k in range(1, count + 1)])
    return pgm.DynamicBayesianNetwork(
        prior=[pgm.GaussianCPD(x, 0.0, 1.0)],
        transition=[_linear(x, given={x.previous: 1.0, u: 1.0}, cov=0.1)],
        observation=[
            _linear(one, given={x: 1.0, place: 1.0}, cov=0.1)
            for one, place in zip(z, m, strict=True)
        ],
    )


def tracker():
    """GPS, a gyro and odometry."""
    x, bias = pgm.variables("x bias")
    odometry, gps, gyro = pgm.variables("odometry gps gyro")
    return pgm.DynamicBayesianNetwork(
        prior=[pgm.GaussianCPD(x, 0.0, 1.0), pgm.GaussianCPD(bias, 0.0, 1.0)],
        transition=[
            _linear(x, given={x.previous: 1.0, odometry: 1.0, bias.previous: 1.0}, cov=0.1),
            _linear(bias, given={bias.previous: 1.0}, cov=0.1),
        ],
        observation=[
            _linear(gps, given={x: 1.0}, cov=0.1),
            _linear(gyro, given={x: 1.0, bias: 1.0}, cov=0.1),
        ],
    )


def discrete():
    cloudy, rain, wet = (
        pgm.Discrete(name, states=("no", "yes")) for name in ("cloudy", "rain", "wet grass")
    )
    sprinkler = pgm.Discrete("sprinkler", states=("off", "on"))
    half = [[0.5, 0.5], [0.5, 0.5]]
    return pgm.BayesianNetwork(
        [
            pgm.TableCPD(cloudy, table=[0.5, 0.5]),
            pgm.TableCPD(rain, given=(cloudy,), table=half),
            pgm.TableCPD(sprinkler, given=(cloudy,), table=half),
            pgm.TableCPD(wet, given=(rain, sprinkler), table=[half, half]),
        ]
    )


def landmarks():
    seen = [(0, 0), (1, 0), (1, 1), (2, 1), (3, 1), (3, 2), (4, 2), (4, 0)]
    return unknown_landmarks(4, seen, [(0.0, 1.0), (2.0, 2.0), (4.0, 1.0)])


STATIC = {
    "one": [[]],
    "chain": [[], *([k] for k in range(9))],
    "children": [[], *([0] for _ in range(40))],
    "parents": [[]] * 30 + [list(range(30))],
    "random 40": random_parents(40),
    "square": square(6),
    "loose": [[]] * 12,
}
DYNAMIC = {
    "two robots": (robots(2), 2),
    "seven robots": (robots(7), 1),
    "hub of 3": (hub(3), 2),
    "hub of 12": (hub(12), 1),
    "sensors 20": (sensors(20), 1),
    "tracker": (tracker(), 3),
}
NETWORKS = {
    **{
        f"static {name}": lambda p=parents: pgm.plot.network(static(p))
        for name, parents in STATIC.items()
    },
    "static cpds": lambda: pgm.plot.network(static(random_parents(12)), cpds=True),
    "discrete": lambda: pgm.plot.network(discrete(), cpds=True),
    "unknown landmarks": lambda: pgm.plot.network(landmarks()),
    "unknown landmarks cpds": lambda: pgm.plot.network(landmarks(), cpds=True),
    **{
        f"dynamic {name}": lambda m=model, s=steps: pgm.plot.network(m, steps=s)
        for name, (model, steps) in DYNAMIC.items()
    },
    **{
        f"dynamic {name} cpds": lambda m=model: pgm.plot.network(m, cpds=True)
        for name, (model, _) in DYNAMIC.items()
    },
}


def flooded(graph, iterations):
    schedule = pgm.Flooding(iterations=iterations, tolerance=0.0)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", pgm.ConvergenceWarning)  # pictures of messages on their way
        return pgm.infer(graph, {}, schedule=schedule).status.by_edge


def _bethe(parents):
    return pgm.compile(static(parents), method=pgm.Bethe())


def sighted():
    """20 sensors, read at some steps, some of them often."""
    model, steps = sensors(20), 4
    evidence = {model.inputs[0]: np.ones((steps, 1))}
    for k, (one, place) in enumerate(zip(model.sensors, model.inputs[1:], strict=True)):
        at = np.arange(k % 3, steps, 1 + k % 2).repeat(1 + k % 4)
        ones = np.ones((len(at), 1))
        evidence[one] = pgm.sightings(ones, step=at, given={place: ones})
    return pgm.compile(model, steps), evidence


def _drawn(graph, **keywords):
    return lambda: pgm.plot.cluster_graph(graph(), **keywords)


def _chain(steps, model=tracker):
    return lambda: pgm.compile(model(), steps)


def _balanced(steps):
    return lambda: pgm.compile(tracker(), steps, method=pgm.Balanced())


def _tree(parents):
    return lambda: pgm.compile(static(parents))


def _flooded(iterations):
    graph = _bethe(square(3))
    return pgm.plot.cluster_graph(graph, residuals=flooded(graph, iterations))


def _sighted():
    graph, evidence = sighted()
    return pgm.plot.cluster_graph(graph, evidence=evidence)


GRAPHS = {
    "chain 4": _drawn(_chain(4)),
    "chain 4 messages": _drawn(_chain(4), messages=True),
    "chain part": _drawn(_chain(1000), steps=3, sizes=True),
    "chain around": _drawn(_chain(1000), around=500, messages=True),
    "chain 20 sensors": _drawn(_chain(4, lambda: sensors(20))),
    "chain 20 sensors sighted": _sighted,
    "chain hub": _drawn(_chain(3, lambda: hub(12))),
    "chain ten robots": _drawn(_chain(3, lambda: robots(10))),
    "balanced 8": _drawn(_balanced(8), messages=True),
    "junction tree 12": _drawn(_tree(random_parents(12)), messages=True),
    "junction tree 40": _drawn(_tree(random_parents(40)), sizes=True, colour="size"),
    "discrete": _drawn(lambda: pgm.compile(discrete()), sizes=True, colour="size"),
    "tree around": _drawn(_tree(random_tree(150)), around=70),
    "bethe 4": _drawn(lambda: _bethe(square(2)), messages=True),
    "ltrip 25": _drawn(lambda: pgm.compile(static(square(5)), method=pgm.LTRIP())),
    "residuals": lambda: _flooded(5),
    "residuals of rounding": lambda: _flooded(300),
    "star": _drawn(lambda: _bethe([[], *([0] for _ in range(30))])),
}
LARGE = {
    "chain 60": _drawn(_chain(60)),
    "tree 80": _drawn(_tree(random_tree(80))),
    "bethe 40": _drawn(lambda: _bethe(random_parents(40)), messages=True),
    "static random 100": lambda: pgm.plot.network(static(random_parents(100))),
    "static tree 100": lambda: pgm.plot.network(static(random_tree(100))),
    "dynamic tracker long": lambda: pgm.plot.network(tracker(), steps=20),
    "bethe 80": _drawn(lambda: _bethe(random_parents(80))),
    "balanced 60": _drawn(_balanced(60)),
    "static random 200": lambda: pgm.plot.network(static(random_parents(200))),
    "dynamic ten robots": lambda: pgm.plot.network(robots(10), steps=1),
    "dynamic ten robots cpds": lambda: pgm.plot.network(robots(10), cpds=True),
    "chain 150": _drawn(_chain(150)),
    "tree 150": _drawn(_tree(random_tree(150))),
    "bethe 200": _drawn(lambda: _bethe(random_parents(200))),
    "tree 500": _drawn(_tree(random_tree(500))),
    "tree 1000": _drawn(_tree(random_tree(1000))),
}
