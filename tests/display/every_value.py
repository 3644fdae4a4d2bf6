"""One value at least of each public kind, small and large ones; by `every`."""

import io

import numpy as np

import pgm
from models import motion, sensors
from pgm import consistency, maps

HOSTILE = '<script>alert("1")</script>&$x_{\n\x1b[31m'
X = pgm.Variable("x", components=("east", "north", "heading"), angles=("heading",))
U = pgm.Variable("u", components=("v", "omega", "dt"))
M = pgm.Variable("m", components=("east", "north"))
Z = pgm.Variable("z", components=("range", "bearing"), angles=("bearing",))
A, B, C = pgm.variables("a b c")
RAIN, WET = (pgm.Discrete(name, ("no", "yes")) for name in ("rain", "wet"))
DAY = pgm.Discrete("day", 40)
PLACE = pgm.Discrete("place", ("hall", "door", "kitchen"))
HEARD = pgm.Discrete("heard", ("silence", "steps"))
STEPS, RUNS = 40, 30
APART = pgm.NonlinearGaussianFactor((A, B), lambda a, b: b - a - 1.0, cov=0.1)


def robot(steps=STEPS):
    """A robot that sees landmarks, with its evidence."""
    model = pgm.DynamicBayesianNetwork(
        prior=[pgm.GaussianCPD(X, np.zeros(3), np.diag([0.1, 0.1, 0.05]) ** 2)],
        transition=[
            pgm.NonlinearGaussianCPD(X, (X.previous, U), motion.velocity, 0.01 * np.eye(3))
        ],
        observation=[pgm.NonlinearGaussianCPD(Z, (X, M), sensors.range_bearing, 0.01 * np.eye(2))],
    )
    controls = np.tile([1.0, 0.1, 0.5], (steps, 1))
    marks = np.tile([[30.0, 5.0]], (steps + 1, 1))
    asked = {U: controls, Z: pgm.sightings(step=np.arange(steps + 1), given={M: marks})}
    return model, asked


def house():
    """A hidden Markov model, with its evidence."""
    moves = [[0.8, 0.2, 0.0], [0.1, 0.8, 0.1], [0.0, 0.3, 0.7]]
    model = pgm.DynamicBayesianNetwork(
        [pgm.TableCPD(PLACE, table=[1, 0, 0])],
        [pgm.TableCPD(PLACE, PLACE.previous, table=moves)],
        [pgm.TableCPD(HEARD, PLACE, table=[[0.9, 0.1], [0.5, 0.5], [0.2, 0.8]])],
    )
    return model, {HEARD: [0, 1] * (STEPS // 2)}


def networks():
    """Networks without time: of Gaussians, with loops, of tables, a large one, a hostile one."""
    linear = pgm.BayesianNetwork(
        [
            pgm.GaussianCPD(A, 1.0, 4.0),
            pgm.LinearGaussianCPD(B, {A: 2.0}, cov=1.0),
            pgm.LinearGaussianCPD(C, {A: 1.0, B: -1.0}, cov=1.0),
        ]
    )
    tables = pgm.BayesianNetwork(
        [
            pgm.TableCPD(RAIN, table=[0.8, 0.2]),
            pgm.TableCPD(WET, RAIN, table=[[0.9, 0.1], [0.2, 0.8]]),
        ]
    )
    many = pgm.variables([f"v{k}" for k in range(150)])
    first, *others = many
    chain = zip(many, others, strict=False)
    large = pgm.BayesianNetwork(
        [
            pgm.GaussianCPD(first, 0.0, 1.0),
            *(pgm.LinearGaussianCPD(late, {early: 1.0}, cov=1.0) for early, late in chain),
        ]
    )
    bad = pgm.Variable(HOSTILE, components=("<b>", HOSTILE))
    hostile = pgm.BayesianNetwork([pgm.GaussianCPD(bad, [0.0, 1e-30], np.diag([1e30, 0.0]))])
    bad_state = pgm.Discrete(HOSTILE, (HOSTILE, "<i>"))
    return {
        "linear": linear,
        "tables": tables,
        "large": large,
        "hostile": hostile,
        "undirected": pgm.MarkovNetwork([APART, pgm.CanonicalForm(A, [[1.0]], [0.0])]),
        "undirected and mixed": pgm.MarkovNetwork(
            [pgm.Table((bad_state, RAIN), np.eye(2)), APART, pgm.GaussianCPD(A, 0.0, 1.0)]
        ),
        "undirected tables": pgm.MarkovNetwork([pgm.Table((bad_state, RAIN), np.eye(2))]),
    }


def factors():
    """Factors: one, many, singular, infinite, of no variable, of no run, of large scope."""
    many = pgm.variables([f"v{k}" for k in range(300)])
    bad = pgm.Discrete(HOSTILE, (HOSTILE, "<i>"))
    found = {
        "gaussian": pgm.Gaussian(X, [1.0, -2.0, 0.5], np.diag([0.04, 1e-10, 0.0])),
        "wide": pgm.Gaussian(many, np.zeros(300), np.eye(300)),
        "joint": pgm.Gaussian((X.at(1), X.at(2)), np.zeros(6), np.eye(6) + 0.5),
        "runs": pgm.Gaussian(X, np.zeros((1000, 3)), 1e12 * np.eye(3)),
        "no runs": pgm.Gaussian(X, np.zeros((0, 3)), np.eye(3)),
        "steps": pgm.Gaussian(X, np.zeros((7, 1000, 3)), np.eye(3), steps=np.arange(1000)),
        "form": pgm.CanonicalForm((A, B), [[2.0, -1.0], [-1.0, 2.0]], [0.0, 1.0], -3.5),
        "vacuous": pgm.CanonicalForm.vacuous(many),
        "number": pgm.CanonicalForm((), np.zeros((0, 0)), [], 2.0),
        "forms": pgm.CanonicalForm(X, np.zeros((9, 3, 3)), np.zeros(3)),
        "no forms": pgm.CanonicalForm(X, np.zeros((0, 3, 3)), np.zeros(3)),
        "gaussians mixed": pgm.GaussianMixture(
            np.full(40, 0.025), pgm.Gaussian(X, np.arange(120.0).reshape(40, 3), np.eye(3))
        ),
        "mixtures": pgm.GaussianMixture(
            np.full((9, 2), 0.5), pgm.Gaussian(X, np.zeros((9, 2, 3)), np.eye(3))
        ),
        "affine": pgm.AffineGaussian(np.ones((2, 3)), [0.0, np.nan], np.eye(2)),
        "affines": pgm.AffineGaussian(np.ones((5, 30, 30)), np.zeros(30), np.eye(30)),
        "table": pgm.Table(RAIN, [0.25, 0.75]),
        "days": pgm.Table.uniform((DAY, WET, DAY.at(3))),
        "tables": pgm.Table(RAIN, np.ones((9, 50, 2)), lead=(9, 50)),
        "no tables": pgm.Table(RAIN, np.ones((0, 2)), lead=0),
        "zero": pgm.Table((RAIN, WET), np.zeros((2, 2)), -np.inf),
        "scaled": pgm.Table((RAIN, WET), np.ones((2, 2)), -5000.0),
        "scalar table": pgm.Table((), 3.0),
        "hostile table": pgm.Table((bad, RAIN), np.ones((2, 2))),
        "wide table": pgm.Table.uniform([pgm.Discrete(f"d{k}", 2) for k in range(16)]),
    }
    return found | {"ellipse": found["gaussian"].ellipse(), "ellipses": found["runs"].ellipse()}


def cpds():
    """CPDs of every kind."""
    wide = pgm.Variable("wide", components=tuple(f"c{k}" for k in range(40)))
    linear = pgm.LinearGaussianCPD(B, {A: 2.0}, cov=1.0)
    return {
        "prior": pgm.GaussianCPD(X, np.zeros(3), np.diag([np.inf, 1.0, 0.0])),
        "priors": pgm.GaussianCPD(X, np.zeros((60, 3)), np.eye(3)),
        "linear": pgm.LinearGaussianCPD(M, {X: np.ones((2, 3))}, cov=[[1.0, 0.5], [0.5, 1.0]]),
        "wide": pgm.LinearGaussianCPD(wide, {wide.previous: 1.0}, cov=np.eye(40)),
        "noisy": pgm.LinearGaussianCPD(B, {A: 1.0}, cov=pgm.noise(np.eye, given=C)),
        "by step": pgm.LinearGaussianCPD(B, {A: 1.0}, cov=np.ones((3, 1, 1))),
        "nonlinear": robot()[0].transition[0],
        "derivatives": robot()[0].observation[0].derivatives,
        "robust": pgm.LinearGaussianCPD(B, {A: 1.0}, cov=1.0, noise=pgm.StudentT(4.0)),
        "residual": APART,
        "switching": pgm.SwitchingCPD(
            linear.child, pgm.Discrete("mode", 60), dict.fromkeys(range(60), linear)
        ),
        "mixture": pgm.MixtureCPD([linear] * 50, weights=np.full(50, 0.02)),
        "sampled": pgm.SampledCPD(B, A, sample=lambda a, size, rng: a),
        "tables": pgm.TableCPD(DAY, (DAY.previous, WET), table=np.full((40, 2, 40), 1 / 40)),
        "noisy or": pgm.NoisyOr(WET, pgm.Discrete("weather", 40), [np.linspace(0, 1, 40)]),
        "noisy max": pgm.NoisyMax(DAY, (DAY.previous, RAIN), [np.eye(40), np.eye(40)[:2]]),
        "structured": pgm.TableCPD(DAY, DAY.previous, table=pgm.shifts(40, {1: 1.0})),
        "product": pgm.TableCPD(DAY, DAY.previous, table=pgm.Kronecker([np.eye(8), np.eye(5)])),
        "threshold": pgm.Threshold(10.0, below=True, remedy="take more members"),
        "function": pgm.TableCPD(WET, RAIN, table=lambda u: np.eye(2), inputs=U),
    }


def filtered():
    """Posteriors over time, and what belongs to them."""
    model, asked = robot()
    drawn = model.sample(asked, rng=1)
    batch = model.sample(asked, runs=RUNS, rng=2)
    one = pgm.smooth(model, drawn.evidence, iterations=5)
    many = pgm.smooth(model, batch.evidence)
    online = pgm.OnlineFilter(model)
    lagged = pgm.OnlineFilter(model, lag=2)
    belief = online.predict(online.initial(), {U: [1.0, 0.1, 0.5]})
    seen = pgm.sightings([[30.0, 0.1], [np.nan, 0.2]], given={M: [[30.0, 5.0], [9.0, 0.0]]})
    read = online.update(belief, {Z: seen})
    nameless = pgm.unknown([[30.0, 5.0], [0.0, 9.0]], gate=0.99, association="likelihood")
    guess = pgm.sightings(drawn[Z], step=np.arange(STEPS + 1), given={M: nameless})
    guessed = pgm.filter(model, {U: asked[U], Z: guess})
    gated = pgm.filter(model, batch.evidence, gate=0.9)
    empty = pgm.smooth(model, {U: asked[U]})
    errors = consistency.anees(many[X], batch[X])
    grown = pgm.GrowingMap().add(pgm.GaussianCPD(M, np.zeros(2), np.eye(2)))
    landmark = pgm.Variable("landmark", M.components)
    sees = pgm.LinearGaussianCPD(Z, {landmark: np.eye(2)}, cov=1.0)
    sighted = grown.add(sees, {Z: [0.0, 1.0], landmark: pgm.unknown([M], association="likelihood")})
    methods = {"EKF": pgm.Taylor(), "RTS": pgm.Smoothing()}
    studied = pgm.study(model, asked, runs=3, methods=methods, seed=1)
    return {
        "dynamic network": model,
        "sample": drawn,
        "samples": batch,
        "sightings": batch.evidence[Z],
        "listed sightings": pgm.sightings([[1.0, 2.0]] * 500, step=range(500)),
        "unread sightings": asked[Z],
        "unknown": nameless,
        "posterior": one,
        "posteriors": many,
        "empty": empty,
        "kept": pgm.smooth(model, batch.evidence, keep=[X]),
        "filtered": many.filtered,
        "predicted": one.predicted,
        "balanced": pgm.smooth(model, drawn.evidence, method=pgm.Balanced()),
        "lagged": pgm.smooth(model, drawn.evidence, lag=3),
        "status": one.status,
        "statuses": many.status,
        "innovations": one.innovations[Z],
        "many innovations": many.innovations[Z],
        "by sensor": one.innovations,
        "left out": many.left_out,
        "rejections": gated.rejected[Z],
        "rejected": gated.rejected,
        "lost": gated.lost,
        "weights": one.weights,
        "many weights": many.weights,
        "associations": guessed.associations[Z],
        "estimate": pgm.estimate(model, batch.evidence, effort=40),
        "verdict": pgm.estimate(model, batch.evidence, effort=40).verdict,
        "audit": pgm.audit(one, samples=50, rng=0),
        "audits": pgm.audit(many, samples=50, rng=0),
        "check": next(iter(pgm.audit(one, samples=50, rng=0).innovations.values())),
        "belief": one.belief(3),
        "message": many.message(3, 4),
        "online filter": online,
        "online belief": belief,
        "predictions": belief.predicted,
        "step innovations": read.innovations[Z],
        "step innovations by sensor": read.innovations,
        "prepared": pgm.prepare(pgm.compile(model, STEPS), drawn.evidence),
        "online beliefs": pgm.OnlineFilter(
            model.replace(prior=[pgm.GaussianCPD(X, np.zeros((5, 3)), np.eye(3))])
        ).initial(),
        "online lag": lagged,
        "growing map": grown,
        "growth": grown.status,
        "cliques": sighted.cliques,
        "association": sighted.associations[Z],
        "by sighting": sighted.associations,
        "chain": pgm.compile(model, STEPS),
        "compilation": pgm.compile(model, STEPS).compilation,
        "tree": pgm.compile(model, STEPS, method=pgm.Balanced()),
        "short": pgm.compile(model, 1),
        "cluster": pgm.compile(model, STEPS).clusters[3],
        "clusters": pgm.compile(model, STEPS).clusters,
        "sepsets": pgm.compile(model, STEPS).sepsets,
        "anees": errors,
        "overall": errors.overall(),
        "over time": consistency.rmse_over_time(many[X], batch[X]),
        "coverage": consistency.coverage(many[X], batch[X], np.linspace(0.1, 0.9, 50)),
        "ranking": consistency.ranking(one.innovations),
        "ranked": consistency.ranking(one.innovations)[0],
        "whiteness": consistency.whiteness(many.innovations[Z]),
        "comparison": pgm.compare(model, drawn.evidence, truth={X: drawn[X]}),
        "judgement": pgm.compare(model, drawn.evidence, oracle=pgm.smooth(model, drawn.evidence))
        .rows[1]
        .by_oracle["oracle"],
        "row": pgm.compare(model, drawn.evidence, truth={X: drawn[X]}).rows[0],
        "study": studied,
        "study row": studied.rows[0],
        "statistic": studied.rows[0].nees,
    }


def points():
    """Beliefs on grids and of particles."""
    model, asked = robot(6)
    drawn = model.sample(asked, rng=1)
    grid = pgm.Grid({"east": (-4, 8, 12), "north": (-4, 8, 12), "heading": 8})
    few = pgm.Gaussians(4)
    cloud = pgm.Particles(60, seed=1)
    rough = model.replace(
        prior=[pgm.GaussianCPD(X, np.zeros(3), np.eye(3))],
        transition=[pgm.NonlinearGaussianCPD(X, (X.previous, U), motion.velocity, np.eye(3))],
        observation=[pgm.NonlinearGaussianCPD(Z, (X, M), sensors.range_bearing, 9.0 * np.eye(2))],
    )
    found, swarm = (pgm.filter(rough, drawn.evidence, belief=each) for each in (grid, cloud))
    return {
        "gaussians": few,
        "grid": grid,
        "grid posterior": found,
        "grid beliefs": found[X],
        "grid belief": found[X.at(2)],
        "grid status": found.status,
        "grid figures": found.status._figures,
        "grid forecasts": found.predicted[Z],
        "online grid": pgm.OnlineFilter(rough, belief=grid),
        "online grid belief": pgm.OnlineFilter(rough, belief=grid).initial(),
        "particles": cloud,
        "particle posterior": swarm,
        "particle beliefs": swarm[X],
        "particle belief": swarm[X.at(2)],
        "particle forecast": swarm.predicted.filtered.predicted[Z],
        "particle status": swarm.status,
        "particle figures": swarm.status._figures,
        "online particles": pgm.OnlineFilter(rough, belief=cloud),
        "online particle belief": pgm.OnlineFilter(rough, belief=cloud).initial(),
        "kld": pgm.KLDSampling({"east": 1.0, "north": 1.0, "heading": 0.5}),
        "likelihood sampling": pgm.LikelihoodSampling(100.0),
    }


def discrete():
    """Posteriors of tables."""
    model, evidence = house()
    found = pgm.smooth(model, evidence)
    robot = pgm.OnlineFilter(model)
    tables = pgm.compile(networks()["tables"])
    return {
        "states": found,
        "state marginals": found.filtered,
        "state runs": pgm.filter(model, {HEARD: np.zeros((20, 9), dtype=int)}),
        "online states": robot.initial(),
        "online tables": robot,
        "path": pgm.most_probable(pgm.compile(model, STEPS), evidence),
        "assignment": pgm.most_probable(tables, {WET: "yes"}),
        "assignments": pgm.most_probable(tables, {WET: [0, 1, 1]}),
        "sensitivities": pgm.sensitivity(tables, {RAIN: "yes"}, {WET: "yes"}),
        "sensitivities of runs": pgm.sensitivity(tables, {RAIN: "yes"}, {WET: [0, 1, 1]}),
        "sensitivity": pgm.sensitivity(tables, {RAIN: "yes"}, {WET: "yes"})[WET],
        "sensitive entry": pgm.sensitivity(tables, {RAIN: "yes"}).ranked(1)[0],
        "max-marginals": pgm.max_marginals(tables, {WET: "yes"}),
        "max-marginals of runs": pgm.max_marginals(tables, {WET: [0, 1, 1]}),
        "discrete posterior": pgm.infer(tables, {WET: "yes"}),
        "discrete posteriors": pgm.infer(tables, {WET: [0, 1] * 50}),
        "house sample": model.sample(steps=9, runs=4, rng=1),
        "soft": pgm.soft([0.1, 0.9]),
        "softs": pgm.soft(np.ones((1000, 2))),
    }


def logs():
    """Stamped rows, and what became of them."""
    stamps = 1.7e9 + 0.2 * np.arange(200)
    mark = pgm.sightings([[1.0]], step=[0])
    turns = pgm.Variable("turns", components=("distance", "turn"))
    odometry = pgm.stamped(stamps, np.ones((200, 2)))
    seen = pgm.stamped(stamps[::3] + 0.05, np.ones(67), given={M: np.ones((67, 2))})
    ranged = pgm.Variable("range")
    turned = np.tile([0.0, 0.0, 0.0, 1.0], (200, 1))
    poses = pgm.Poses(stamps, np.ones((200, 3)), turned)
    heard = pgm.recordings.Stream(
        stamps[::-1], np.ones(200), ("range",), subject=np.arange(200) % 3
    )
    wheels = pgm.recordings.Stream(stamps, np.ones((200, 2)), ("distance", "turn"))
    graph = pgm.recordings.read_pose_graph(io.StringIO("VERTEX_SE2 0 0 0 0\n"))
    many = {f"sensor {k}": heard for k in range(30)}
    drive = pgm.Recording(odometry=wheels, sightings=many, landmarks={0: [1.0, 2.0]}, name=HOSTILE)
    log = pgm.timeline(stamps, odometry={turns: odometry}, sensors={ranged: seen})
    return {
        "stamped": odometry,
        "seen": seen,
        "timeline": log,
        "control report": log.controls[turns],
        "reading report": log.readings[ranged],
        "constant": pgm.constant([0.5, 0.0]),
        "large constant": pgm.constant(np.zeros((1000, 3))),
        "bare sightings": mark,
        "poses": poses,
        "pose errors": poses.ate(poses),
        "recording": pgm.Recording(odometry=wheels, sightings={"radio": heard}, truth=poses),
        "hostile recording": drive,
        "stream": heard,
        "datum": pgm.recordings.Datum(48.1, -11.5, name=HOSTILE),
        "drive on the earth": pgm.Recording(fixes=heard, datum=(48.1, 11.5)),
        "scans": pgm.recordings.Scans(stamps, np.ones((200, 180)), np.arange(180.0), 8.0),
        "pose graph": graph,
        "edges": graph.edges,
        "empty stream": heard.take(slice(0)),
        "dropped": drive.dropped[0],
        "one pose": pgm.Poses(stamps[:1], np.zeros((1, 3)), turned[:1]),
    }


def graphs():
    """Networks without time, their graphs and posteriors."""
    found = dict(networks())
    for name, network in networks().items():
        found[f"graph of {name}"] = graph = pgm.compile(network)
        found[f"posterior of {name}"] = pgm.infer(graph, {})
    loopy = pgm.compile(networks()["linear"], method=pgm.Bethe())
    found["loopy"] = loopy
    found["loopy posterior"] = pgm.infer(loopy, {C: 1.0}, schedule=pgm.Flooding())
    found["posterior of runs"] = pgm.infer(found["graph of linear"], {C: np.zeros((500, 1))})
    return found


def small():
    """Choices of parameters, variables and maps."""
    rules = [pgm.Taylor(), pgm.Unscented(), pgm.Cubature(), pgm.GaussHermite(3)]
    rules += [pgm.MonteCarlo(100, seed=1), pgm.QuasiMonteCarlo(64, seed=1)]
    schedules = [pgm.Filtering(), pgm.Smoothing(), pgm.FixedLag(2), pgm.Calibration()]
    schedules += [pgm.Flooding(), pgm.Sequential(), pgm.Residual(), pgm.LevenbergMarquardt()]
    methods = [
        pgm.JunctionTree(),
        pgm.JoinGraph(3),
        pgm.Bethe(),
        pgm.LTRIP(),
        pgm.Balanced(),
        pgm.Compiled(2),
    ]
    orders = [pgm.MinFill(), pgm.MinDegree(), pgm.WeightedMinFill(), pgm.NestedDissection()]
    orders += [pgm.StochasticMinFill(seed=1)]
    marks = maps.FeatureMap(np.zeros((300, 2)))
    rest = [X, X.previous, RAIN, pgm.Kronecker([np.eye(2), np.eye(3)]), marks]
    rest += [pgm.smooth(robot()[0], {U: robot()[1][U]}).kind, pgm.noise(np.eye, given=U)]
    rest += [pgm.LinearGaussianCPD(B, {A: 1.0}, cov=np.ones((3, 1, 1))).cov]
    rest += [maps.OccupancyMap(np.zeros((50, 50), dtype=bool), 0.1)]
    rest += [pgm.StudentT(4.0), pgm.Huber(1.5), pgm.Cauchy(2.4), pgm.TruncatedLeastSquares(3.0)]
    cells = pgm.CellProposal(A, [[0.0], [1.0]], [1.0])
    rest += [cells, pgm.Injection(cells)]
    scale = pgm.Variable("scale")
    calibrated = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(A, 1.0, 1.0)],
        [pgm.LinearGaussianCPD(A, {A.previous: 1.0}, cov=0.0)],
        [pgm.NonlinearGaussianCPD(B, (A, scale), lambda a, k: a * k, cov=1.0)],
    )
    learn = {A.at(0): pgm.learning.Offset(), scale: pgm.learning.Parameter(1.0)}
    learn[B] = pgm.learning.Covariance()
    learnt = pgm.fit(calibrated, {B: [[1.0], [2.0], [4.0]]}, learn=learn, iterations=3)
    rest += [learnt, learnt.status, pgm.learning.Table(), pgm.learning.DegreesOfFreedom()]
    every = [*rules, *schedules, *methods, *orders, *rest]
    return {f"{type(value).__name__} {k}": value for k, value in enumerate(every)}


def every():
    """All values, by name."""
    groups = factors, cpds, filtered, points, discrete, logs, graphs, small
    return {f"{group.__name__}: {name}": v for group in groups for name, v in group().items()}
