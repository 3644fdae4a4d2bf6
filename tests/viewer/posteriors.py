"""Posteriors of every kind, small."""

import warnings
from functools import cache

import numpy as np

import pgm
from models import motion, sensors

x = pgm.Variable("x", components=("east", "north", "heading"), angles=("heading",))
u = pgm.Variable("u", components=("v", "omega", "dt"))
m = pgm.Variable("m", components=("east", "north"))
z = pgm.Variable("z", components=("range", "bearing"), angles=("bearing",))
STEPS = 40

weather = pgm.Discrete("weather", states=("sun", "rain", "fog"))
umbrella = pgm.Discrete("umbrella", states=("no", "yes"))


def robot():
    return pgm.DynamicBayesianNetwork(
        prior=[pgm.GaussianCPD(x, np.zeros(3), np.diag([0.5, 0.5, 0.05]))],
        transition=[
            pgm.NonlinearGaussianCPD(
                x,
                (x.previous, u),
                motion.velocity,
                np.diag([0.02, 0.02, 0.002]),
                jacobian={x.previous: motion.velocity_by_state},
            )
        ],
        observation=[
            pgm.NonlinearGaussianCPD(z, (x, m), sensors.range_bearing, np.diag([0.2, 0.01]))
        ],
    )


def drive(steps=STEPS, runs=()):
    """Controls and sightings, two at every third step."""
    rng = np.random.default_rng(3)
    controls = np.tile([1.0, 0.15, 0.5], (*runs, steps, 1))
    controls[..., :2] += 0.05 * rng.standard_normal((*runs, steps, 2))
    pose, places, marks = np.zeros(3), [], []
    for step in range(1, steps + 1):
        pose = motion.velocity(pose, controls.reshape(-1, steps, 3)[0, step - 1])
        if step % 3 == 0:
            for mark in ((5.0, 5.0), (-3.0, 8.0)):
                noise = rng.standard_normal(2) * [0.4, 0.1]
                places.append(sensors.range_bearing(pose, np.array(mark)) + noise)
                marks.append(mark)
    at = [3 + 3 * (k // 2) for k in range(len(marks))]
    return {u: controls, z: pgm.sightings(np.array(places), step=at, given={m: np.array(marks)})}


@cache
def smoothed():
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", pgm.ConvergenceWarning)  # three, to be shown
        return pgm.smooth(robot(), drive(), iterations=3)


@cache
def simulated():
    """A drive drawn from the model, and its smoothed beliefs."""
    due = drive()
    seen = pgm.sightings(step=due[z].step, given=due[z].given)
    drawn = robot().sample({u: due[u], z: seen}, rng=1)
    return drawn, pgm.smooth(robot(), drawn.evidence)


@cache
def filtered():
    return pgm.filter(robot(), drive())


@cache
def batch():
    return pgm.smooth(robot(), drive(runs=(12,)))


def still():
    """A static state read with noise: its transition is exact, its potentials are singular."""
    a, b = pgm.variables("a b")
    model = pgm.DynamicBayesianNetwork(
        prior=[pgm.GaussianCPD(a, 0.0, 1.0)],
        transition=[pgm.LinearGaussianCPD(a, given={a.previous: 1.0}, cov=0.0)],
        observation=[pgm.LinearGaussianCPD(b, given={a: 1.0}, cov=0.5)],
    )
    return pgm.smooth(model, {b: np.arange(5.0)[:, None]})


def days(schedule=None):
    model = pgm.DynamicBayesianNetwork(
        prior=[pgm.TableCPD(weather, table=[0.5, 0.3, 0.2])],
        transition=[
            pgm.TableCPD(
                weather,
                given=(weather.previous,),
                table=[[0.7, 0.2, 0.1], [0.3, 0.5, 0.2], [0.2, 0.2, 0.6]],
            )
        ],
        observation=[
            pgm.TableCPD(umbrella, given=(weather,), table=[[0.9, 0.1], [0.2, 0.8], [0.5, 0.5]])
        ],
    )
    evidence = {umbrella: ["no", "yes", "yes", "no", "yes", "no", "no", "yes"]}
    return pgm.infer(pgm.compile(model, steps=8), evidence, schedule=schedule)


def lattice(size=4, method=None, schedule=None):
    """A grid of scalars, on a graph with loops."""
    at = {(i, j): pgm.Variable(f"x{i},{j}") for i in range(size) for j in range(size)}
    cpds = []
    for (i, j), v in at.items():
        given = {at[k]: 0.45 for k in ((i - 1, j), (i, j - 1)) if k in at}
        cpds.append(
            pgm.LinearGaussianCPD(v, given=given, cov=1.0)
            if given
            else pgm.GaussianCPD(v, 0.0, 1.0)
        )
    graph = pgm.compile(pgm.BayesianNetwork(cpds), method=method or pgm.LTRIP())
    return pgm.infer(graph, {at[size - 1, size - 1]: 2.0}, schedule=schedule or pgm.Flooding())


@cache
def modes():
    """Two modes of a network without time, mirror images, in two runs; one cluster is observed."""
    a, b, square, product = pgm.variables("a b square product")
    net = pgm.BayesianNetwork(
        [
            pgm.GaussianCPD(a, 0.0, 1.0),
            pgm.LinearGaussianCPD(b, given={a: 1.0}, cov=0.1),
            pgm.NonlinearGaussianCPD(square, a, np.square, 0.05),
            pgm.NonlinearGaussianCPD(product, (a, b), np.multiply, 0.05),
        ]
    )
    return pgm.estimate(net, {square: [[0.8], [1.0]], product: [[0.9], [0.7]]}, effort=1000)


def tree():
    """A junction tree of tables with one observed."""
    names = "a b c d e f"
    a, b, c, d, e, f = (pgm.Discrete(name, states=("no", "yes")) for name in names.split())
    pair = [[0.8, 0.2], [0.3, 0.7]]
    both = [[[0.9, 0.1], [0.4, 0.6]], [[0.5, 0.5], [0.2, 0.8]]]
    net = pgm.BayesianNetwork(
        [
            pgm.TableCPD(a, table=[0.6, 0.4]),
            pgm.TableCPD(b, given=(a,), table=pair),
            pgm.TableCPD(c, given=(a,), table=pair),
            pgm.TableCPD(d, given=(b, c), table=both),
            pgm.TableCPD(e, given=(d,), table=pair),
            pgm.TableCPD(f, given=(d,), table=pair),
        ]
    )
    return pgm.infer(pgm.compile(net), {e: "yes"})


def balanced():
    p = pgm.Variable("p", components=("place", "speed"))
    q = pgm.Variable("q")
    model = pgm.DynamicBayesianNetwork(
        prior=[pgm.GaussianCPD(p, [0.0, 1.0], np.eye(2))],
        transition=[
            pgm.LinearGaussianCPD(
                p, given={p.previous: [[1.0, 1.0], [0.0, 1.0]]}, cov=0.1 * np.eye(2)
            )
        ],
        observation=[pgm.LinearGaussianCPD(q, given={p: [[1.0, 0.0]]}, cov=0.3)],
    )
    graph = pgm.compile(model, steps=8, method=pgm.Balanced())
    return pgm.infer(graph, {q: np.arange(8.0)[:, None]})


HOSTILE = (
    "<script>window.hacked=1</script>",
    "</script><img src=x onerror=window.hacked=2>",
    "<!--",
)


def hostile():
    first, second, third = (pgm.Variable(name) for name in HOSTILE)
    net = pgm.BayesianNetwork(
        [
            pgm.GaussianCPD(first, 0.0, 1.0),
            pgm.LinearGaussianCPD(second, given={first: 1.0}, cov=1.0),
            pgm.LinearGaussianCPD(third, given={second: 1.0}, cov=1.0),
        ]
    )
    return pgm.infer(pgm.compile(net), {third: 1.0})


def hostile_states():
    v = pgm.Discrete("{{numbers}} & co", states=HOSTILE)
    w = pgm.Discrete("w", states=("</script><script>window.hacked=3</script>", "ok"))
    net = pgm.BayesianNetwork(
        [
            pgm.TableCPD(v, table=[0.5, 0.25, 0.25]),
            pgm.TableCPD(w, given=(v,), table=[[0.9, 0.1], [0.2, 0.8], [0.5, 0.5]]),
        ]
    )
    return pgm.infer(pgm.compile(net), {w: w.states[0]})


@cache
def particles():
    return pgm.filter(robot(), drive(12), belief=pgm.Particles(400, seed=0))


@cache
def grid():
    cells = pgm.Grid({"east": (-3, 8, 22), "north": (-3, 8, 22), "heading": 24})
    return pgm.filter(robot(), drive(4), belief=cells)


def branches(count):
    """A tree of scalars, each the child of one not far before it."""
    rng = np.random.default_rng(0)
    made = [pgm.Variable(f"v{k}") for k in range(count)]
    cpds = [pgm.GaussianCPD(made[0], 0.0, 1.0)]
    for k in range(1, count):
        parent = made[int(rng.integers(max(0, k - 40), k))]
        cpds.append(pgm.LinearGaussianCPD(made[k], given={parent: 0.8}, cov=1.0))
    return pgm.infer(pgm.compile(pgm.BayesianNetwork(cpds)), {made[-1]: 1.0})


def factorial(runs=()):
    """A chain of tables with two states and a hidden control."""
    a, b = pgm.Discrete("a", states=("x", "y")), pgm.Discrete("b", states=3)
    c, seen = pgm.Discrete("c", states=("go", "stop")), pgm.Discrete("seen", states=2)
    rng = np.random.default_rng(0)

    def drawn(*shape):
        return rng.dirichlet(np.ones(shape[-1]), shape[:-1])

    model = pgm.DynamicBayesianNetwork(
        prior=[pgm.TableCPD(a, table=drawn(2)), pgm.TableCPD(b, given=(a,), table=drawn(2, 3))],
        transition=[
            pgm.TableCPD(c, table=[0.4, 0.6]),
            pgm.TableCPD(a, given=(a.previous, c), table=drawn(2, 2, 2)),
            pgm.TableCPD(b, given=(b.previous, a), table=drawn(3, 2, 3)),
        ],
        observation=[pgm.TableCPD(seen, given=(b,), table=drawn(3, 2))],
    )
    return pgm.smooth(model, {seen: rng.integers(0, 2, (*runs, 5))})


def driven():
    """A linear chain with two states and a hidden control, some of its readings missing."""
    x, w = pgm.Variable("x", components=("place", "speed")), pgm.Variable("w")
    push, asked, z = pgm.variables("push asked z")
    model = pgm.DynamicBayesianNetwork(
        prior=[pgm.GaussianCPD(x, [0.0, 1.0], np.eye(2)), pgm.GaussianCPD(w, 0.0, 1.0)],
        transition=[
            pgm.LinearGaussianCPD(push, given={asked: 1.0}, cov=0.1),
            pgm.LinearGaussianCPD(
                x,
                given={x.previous: [[1.0, 1.0], [0.0, 1.0]], push: [[0.0], [1.0]]},
                cov=0.1 * np.eye(2),
            ),
            pgm.LinearGaussianCPD(w, given={w.previous: 0.9}, cov=0.2),
        ],
        observation=[pgm.LinearGaussianCPD(z, given={x: [[1.0, 0.0]], w: 1.0}, cov=0.3)],
    )
    readings = np.array([1.0, np.nan, 2.0, 3.0, 4.0, np.nan, 5.0, 6.0])[:, None]
    return pgm.smooth(model, {asked: np.zeros((8, 1)), z: readings})
