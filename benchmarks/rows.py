"""Every row, in the order in which they run."""

from __future__ import annotations

from dataclasses import replace

from benchmarks import agreement, cliffs, neighbours
from benchmarks.row import Prepare, Row, part
from benchmarks.timing import least
from benchmarks.work import (
    chains,
    clouds,
    fields,
    landmarks,
    manoeuvres,
    pose_graphs,
    repository,
    robots,
    rooms,
    scans,
    tables,
    targets,
)

COMPONENTS = 12, 24, 50
SHORT = {"taylor": "ekf", "unscented": "ukf"}
QUICK = ("asia", "alarm")  # networks of the quick run


def one_step(rule: str) -> Row:
    """One prediction and one update, for many simulations that were driven differently."""
    return Row(
        name=f"{SHORT[rule]}_one_step",
        unit="simulation",
        work=lambda size: robots.draw(size, 1, own_controls=True),
        contenders={
            "pgm": part("pgm_robots", "filtering", rule),
            "pgm_compiled": part("pgm_robots", "filtering", rule, compiled=True),
            "filterpy": part(f"filterpy_{rule}", "filtering"),
            "stonesoup": part("stonesoup_robots", "filtering", rule),
            "dynamax": part("dynamax_robots", "one_step", rule),
        },
        check=agreement.beliefs,
        size=10_000,
        quick=10_000,
        most={"filterpy": 500, "stonesoup": 100},
    )


def many_robots(rule: str) -> Row:
    """The filter of many robots, 200 steps each."""
    return Row(
        name=f"{SHORT[rule]}_robots",
        unit="robot and step",
        work=lambda size: robots.draw(size, 200),
        contenders={
            "pgm": part("pgm_robots", "filtering", rule),
            "pgm_compiled": part("pgm_robots", "filtering", rule, compiled=True),
            "filterpy": part(f"filterpy_{rule}", "filtering"),
            "stonesoup": part("stonesoup_robots", "filtering", rule),
            "dynamax": part("dynamax_robots", "filtering", rule),
        },
        check=agreement.beliefs,
        size=1_000,
        quick=1_000,
        most={"filterpy": 5, "stonesoup": 2},
    )


def smoother(rule: str) -> Row:
    """One robot, forward and back."""
    return Row(
        name=f"rts_{rule}",
        unit="step",
        work=lambda size: robots.draw(1, size),
        contenders={
            "pgm": part("pgm_robots", "smoothing", rule),
            "pgm_compiled": part("pgm_robots", "smoothing", rule, compiled=True),
            "filterpy": part(f"filterpy_{rule}", "smoothing"),
            **_taylor_only(rule, filterpy_scalar=part("filterpy_scalar", "smoothing")),
            "stonesoup": part("stonesoup_robots", "smoothing", rule),
            "dynamax": part("dynamax_robots", "smoothing", rule),
            **_taylor_only(rule, cuthbert=part("cuthbert_robots", "smoothing")),
        },
        check=agreement.beliefs,
        size=10_000,
        quick=2_000,
        most={"stonesoup": 500},
    )


def short() -> Row:
    """One robot over 60 steps, forward and back: a call that is made many times."""
    return Row(
        name="short",
        unit="step",
        work=lambda size: robots.draw(1, size),
        contenders={
            "pgm": part("pgm_robots", "prepared", "taylor"),
            "pgm_compiled": part("pgm_robots", "prepared", "taylor", compiled=True),
            "dynamax": part("dynamax_robots", "smoothing", "taylor"),
        },
        check=agreement.beliefs,
        size=60,
        quick=60,
    )


def no_jacobian(runs: str) -> Row:
    """Taylor where no Jacobian is given: `pgm` with those of traces, and by differences."""
    one = runs == "one"
    return Row(
        name=f"no_jacobian_{runs}",
        unit="step" if one else "robot and step",
        work=lambda size: robots.draw(1, size) if one else robots.draw(size, 200),
        contenders={
            "pgm": part("pgm_robots", "no_jacobian", runs, "traced"),
            "pgm_differences": part("pgm_robots", "no_jacobian", runs, "differences"),
        },
        check=agreement.beliefs,
        size=10_000 if one else 1_000,
        quick=2_000 if one else 1_000,
    )


def online(rule: str) -> Row:
    """One robot in its loop."""
    return Row(
        name=f"online_{rule}",
        unit="step",
        work=lambda size: robots.draw(1, size),
        contenders={
            "pgm": part("pgm_robots", "online", rule),
            "pgm_compiled": part("pgm_robots", "online", rule, compiled=True),
            "filterpy": part(f"filterpy_{rule}", "online"),
            **_taylor_only(rule, filterpy_scalar=part("filterpy_scalar", "online")),
            "stonesoup": part("stonesoup_robots", "online", rule),
            "dynamax": part("dynamax_robots", "online", rule),
            **_taylor_only(rule, gtsam=part("gtsam_online", "online")),
        },
        check=agreement.beliefs,
        size=1_000,
        quick=300,
        most={"stonesoup": 200},
    )


def most_probable() -> Row:
    """The most probable poses of a whole drive from dead reckoning, and all their marginals."""
    return Row(
        name="map",
        unit="pose",
        work=lambda size: robots.precise(size),
        contenders={
            "pgm": part("pgm_robots", "iterated"),
            "pgm_compiled": part("pgm_robots", "iterated", compiled=True),
            "gtsam": part("gtsam_robots", "smoothing", "gauss_newton"),
            "gtsam_levenberg_marquardt": part("gtsam_robots", "smoothing", "levenberg_marquardt"),
            "gtsam_optimum_alone": part("gtsam_robots", "optimising", "gauss_newton"),
            "gtsam_building": part("gtsam_robots", "building"),
        },
        check=agreement.optima,
        size=10_000,
        quick=5_000,
        unchecked=frozenset({"gtsam_optimum_alone", "gtsam_building"}),
    )


def linear() -> Row:
    """Smoothing a linear network: parallel in time, or not."""
    return Row(
        name="linear",
        unit="step",
        work=targets.draw,
        contenders={
            "pgm": part("pgm_targets", "smoothing", "balanced"),
            "pgm_sequential": part("pgm_targets", "smoothing", "sequential"),
            "pgm_compiled": part("pgm_targets", "smoothing", "sequential", compiled=True),
            "dynamax": part("dynamax_targets", "smoothing", "parallel"),
            "dynamax_sequential": part("dynamax_targets", "smoothing", "sequential"),
            "cuthbert": part("cuthbert_targets", "smoothing"),
        },
        check=agreement.beliefs,
        size=10_000,
        quick=16,  # XLA compiles parallel scans for half a minute, by length
    )


def components(count: int) -> Row:
    """Smoothing a linear system of so many components."""
    return Row(
        name=f"components_{count}",
        unit="step",
        work=lambda size: targets.system(count, size),
        contenders={
            "pgm": part("pgm_targets", "smoothing", "sequential"),
            "pgm_compiled": part("pgm_targets", "smoothing", "sequential", compiled=True),
            "dynamax": part("dynamax_targets", "smoothing", "sequential"),
        },
        check=agreement.beliefs,
        size=2_000,
        quick=500,
    )


def hidden_markov(states: int, steps: int, quick: int) -> Row:
    """Smoothing one run of a hidden Markov model, from its symbols to all marginals."""
    return Row(
        name=f"markov_{states}",
        unit="step",
        work=lambda size: chains.draw(states, size),
        contenders={
            "pgm": part("pgm_chains", "smoothing"),
            "dynamax": part("dynamax_chains", "smoothing", "two_filter"),
            "dynamax_smoother": part("dynamax_chains", "smoothing", "smoother"),
            "dynamax_called": part("dynamax_chains", "called"),
            "hmmlearn": part("hmmlearn_chains", "smoothing"),
        },
        check=agreement.beliefs_of_states,
        size=steps,
        quick=quick,
        timed=least,  # a large matrix shares the caches with other processes
    )


def markov_runs() -> Row:
    """64 runs of a thousand states in one call, and one of them by itself."""
    return Row(
        name="markov_runs",
        unit="run and step",
        work=lambda size: chains.draw(1_000, size, runs=64),
        contenders={
            "pgm": part("pgm_chains", "together"),
            "pgm_alone": part("pgm_chains", "alone"),
        },
        check=agreement.beliefs_of_states,
        size=300,
        quick=20,
        timed=least,
    )


def markov_shifts() -> Row:
    """A hundred thousand states, cells of a map, of which no matrix is ever formed."""
    return Row(
        name="markov_shifts",
        unit="step",
        work=lambda size: chains.shifting((400, 250), size),
        contenders={"pgm": part("pgm_chains", "smoothing")},
        check=agreement.beliefs_of_states,
        size=100,
        quick=20,
        timed=least,
    )


def switching(kind: str, modes: int) -> Row:
    """One target with several motions, by the interacting multiple model or its peer of order 2.

    filterpy has the former alone, which costs less.
    """
    return Row(
        name=f"{kind}_{modes}",
        unit="step",
        work=lambda size: manoeuvres.draw(modes, size),
        contenders={
            "pgm": part("pgm_manoeuvres", "filtering", kind),
            "pgm_compiled": part("pgm_manoeuvres", "filtering", kind, compiled=True),
            "filterpy": part("filterpy_manoeuvres", "filtering"),
        },
        check=agreement.modes,
        size=2_000,
        quick=500,
        unchecked=frozenset() if kind == "imm" else frozenset({"filterpy"}),
    )


def switching_runs() -> Row:
    """A thousand targets of two motions, in one call."""
    return Row(
        name="imm_runs",
        unit="run and step",
        work=lambda size: manoeuvres.draw(2, 60, runs=size),
        contenders={
            "pgm": part("pgm_manoeuvres", "filtering", "imm"),
            "pgm_compiled": part("pgm_manoeuvres", "filtering", "imm", compiled=True),
            "filterpy": part("filterpy_manoeuvres", "filtering"),
        },
        check=agreement.modes,
        size=1_000,
        quick=1_000,
        most={"filterpy": 5},
    )


def on_grid(schedule: str, kind: str = "") -> Row:
    """A robot's pose as probabilities of half a million cells, two sightings a step."""
    peers = {"stonesoup": part("stonesoup_rooms", "filtering")} if schedule == "filter" else {}
    return Row(
        name="_".join(filter(None, ("grid", kind, schedule))),
        unit="cell and step",
        work=lambda size: rooms.draw(size, kind),
        contenders={"pgm": part("pgm_rooms", "on_grid", schedule), **peers},
        check=agreement.beliefs_of_states,
        size=40,
        quick=10,
        most={"stonesoup": 3},
        unchecked=frozenset(peers),
        repeats=5,
        timed=least,
    )


def bootstrap(functions: str) -> Row:
    """A million particles, moved and weighed by a range and a bearing a step."""
    ours = {"": "float64", "_float32": "float32"}
    return Row(
        name=f"particles_{functions}",
        unit="particle and step",
        work=clouds.draw,
        contenders={
            **{
                f"pgm{name}": part("pgm_clouds", "filtering", functions, dtype)
                for name, dtype in ours.items()
            },
            "particles": part("particles_clouds", "filtering", functions),
        },
        check=agreement.drawn_beliefs,
        size=1_000_000,
        quick=200_000,
        timed=least,
    )


def backwards() -> Row:
    """As many trajectories as particles, drawn backwards by moves, or of all particles."""
    return Row(
        name="particles_backwards",
        unit="trajectory and step",
        work=clouds.draw,
        contenders={
            "pgm": part("pgm_clouds", "smoothing", "metropolis"),
            "pgm_full": part("pgm_clouds", "smoothing", "full"),
        },
        check=agreement.drawn_beliefs,
        size=10_000,
        quick=2_000,
        repeats=3,
        timed=least,
    )


def likelihood_field() -> Row:
    """Particles that a laser's scans weigh in a map: whole steps, of which scans take the most.

    The peer's sensor cannot be called alone, so it is a step of both: motion, 60 beams by a
    likelihood field, and particles drawn anew. The peer's model of the sensor is another one.
    """
    return Row(
        name="likelihood_field",
        unit="particle, beam and step",
        work=scans.draw,
        contenders={
            "pgm": part("pgm_scans", "filtering"),
            "amcl": part("amcl_scans", "filtering"),
        },
        check=agreement.places,
        size=5_000,
        quick=5_000,
        timed=least,
    )


def discrete(name: str, task: tables.Task) -> Row:
    """New evidence on a compiled discrete network, then all marginals."""
    return Row(
        name=f"discrete_{name}",
        unit="set of evidence",
        work=lambda size: [task],
        contenders={
            "pgm": part("pgm_tables", "marginals"),
            "pyagrum": part("pyagrum_tables", "marginals"),
        },
        check=agreement.marginals,
        size=1,
        quick=1,
    )


def new_evidence(name: str) -> Row:
    """New evidence on a compiled network of the repository, then all marginals."""
    return Row(
        name=f"repository_{name}",
        unit="set of evidence",
        work=lambda size: repository.several(name, size),
        contenders={
            "pgm": part("pgm_tables", "marginals"),
            "pyagrum": part("pyagrum_tables", "marginals"),
            "pgmpy": part("pgmpy_tables", "marginals"),
        },
        check=agreement.marginals,
        size=20,
        quick=10 if name in QUICK else 0,
        most={"pgmpy": 1 if name == "andes" else 4},
    )


def cold_start(name: str) -> Row:
    """A network just read: compiled, asked for the first time, all marginals."""
    return Row(
        name=f"cold_{name}",
        unit="network",
        work=lambda size: repository.several(name, 1)[0],
        contenders={
            "pgm": part("pgm_cold", "marginals"),
            "pyagrum": part("pyagrum_cold", "marginals", "lazy_propagation"),
            "pyagrum_shafer_shenoy": part("pyagrum_cold", "marginals", "shafer_shenoy"),
        },
        check=agreement.marginals,
        size=1,
        quick=int(name in (*QUICK, "andes")),
        timed=least,
    )


def many_sets(name: str) -> Row:
    """A thousand sets of evidence at once, other leaves in each, and all marginals."""
    return Row(
        name=f"sets_{name}",
        unit="set of evidence",
        work=lambda size: repository.many(name, size),
        contenders={
            "pgm": part("pgm_sets", "marginals"),
            "pyagrum": part("pyagrum_sets", "marginals"),
        },
        check=agreement.marginals,
        size=1_000,
        quick=1_000 if name in QUICK else 200 if name == "andes" else 0,
        most={"pyagrum": 20},
    )


def reading(name: str) -> Row:
    """A gzipped BIF file into a network."""
    return Row(
        name=f"reading_{name}",
        unit="file",
        work=lambda size: repository.path(name),
        contenders={
            "pgm": part("pgm_reading", "reading"),
            "pgmpy": part("pgmpy_reading", "reading"),
        },
        check=agreement.networks,
        size=1,
        quick=int(name == "alarm"),
        repeats=3,
    )


def pose_graph(name: str) -> Row:
    """A published pose graph, from poses near the optimum to it and to the marginals of all."""
    return Row(
        name=pose_graphs.title(name),
        unit="pose",
        work=lambda size: pose_graphs.published(name, size),
        contenders={
            "pgm": part("pgm_maps", "marginals"),
            "pgm_compiled": part("pgm_maps", "marginals", compiled=True),
            "gtsam": part("gtsam_maps", "marginals", "surveyed"),
        },
        check=agreement.maps,
        size=pose_graphs.PUBLISHED[name][0],
        quick=300,
        repeats=5,
        timed=least,
    )


def whole_program(name: str) -> Row:
    """A published pose graph from its numbers on: declared, compiled, solved."""
    return replace(
        pose_graph(name),
        name=f"{pose_graphs.title(name)}_whole",
        contenders={
            "pgm": part("pgm_maps", "whole"),
            "pgm_compiled": part("pgm_maps", "whole", compiled=True),
            "gtsam": part("gtsam_maps", "whole", "surveyed"),
        },
    )


def city() -> Row:
    """A drawn world of as many poses and edges as the pose graph city10000."""
    return replace(
        pose_graph("m3500"),
        name="graph_city",
        work=pose_graphs.city,
        size=pose_graphs.CITY[0],
        repeats=3,
    )


def growing() -> Row:
    """A published pose graph pose by pose, each with its edges to those before it."""
    return replace(
        pose_graph("m3500"),
        name=f"{pose_graphs.title('m3500')}_growing",
        contenders={
            "pgm": part("pgm_growing", "growing"),
            "pgm_compiled": part("pgm_growing", "growing", compiled=True),
            "gtsam": part("gtsam_growing", "growing"),
        },
        check=agreement.ways,
        repeats=2,
    )


def landmark_map(count: int, *, reckoned: bool) -> Row:
    """Landmarks and poses that a robot finds out at once, from dead reckoning or near the truth."""
    poses = round(count * landmarks.A_LANDMARK)
    return Row(
        name=f"landmarks_{count}",
        unit="pose",
        work=lambda size: landmarks.draw(size, reckoned=reckoned),
        contenders={
            "pgm": part("pgm_maps", "marginals"),
            "pgm_compiled": part("pgm_maps", "marginals", compiled=True),
            "gtsam": part("gtsam_maps", "marginals", "mapped"),
        },
        check=agreement.maps,
        size=poses,
        quick=min(poses, 400),
        repeats=5,
        timed=least,
    )


def field(side: int, quick: int) -> Row:
    """A square of scalars: all means and variances, where SciPy finds means alone."""
    return Row(
        name=f"field_{side}",
        unit="variable",
        work=fields.grid,
        contenders={
            "pgm": part("pgm_maps", "marginals"),
            "pgm_compiled": part("pgm_maps", "marginals", compiled=True),
            "scipy": part("scipy_fields", "means"),
        },
        check=agreement.maps,
        size=side,
        quick=quick,
        repeats=3,
        timed=least,
    )


def long_chain() -> Row:
    """A chain that is declared without time, likewise."""
    return replace(field(1, 2_000), name="field_chain", work=fields.chain, size=100_000)


def declaration() -> Row:
    """A field declared and compiled, and nothing asked of it."""
    return Row(
        name="field_declared",
        unit="network",
        work=fields.grid,
        contenders={"pgm": part("pgm_maps", "declared")},
        check=agreement.maps,
        size=100,
        quick=100,  # what is asked are seconds
        unchecked=frozenset({"pgm"}),
        repeats=3,
        timed=least,
    )


def _taylor_only(rule: str, **contenders: Prepare) -> dict[str, Prepare]:
    return contenders if rule == "taylor" else {}


ROWS = [
    *(make(rule) for make in (one_step, many_robots, smoother, online) for rule in SHORT),
    short(),
    *(no_jacobian(runs) for runs in ("one", "many")),
    most_probable(),
    linear(),
    *map(components, COMPONENTS),
    hidden_markov(1_000, steps=300, quick=100),
    hidden_markov(100, steps=2_000, quick=500),
    hidden_markov(10, steps=10_000, quick=10_000),
    markov_runs(),
    markov_shifts(),
    *(switching("imm", modes) for modes in (2, 3, 5)),
    *(switching("gpb2", modes) for modes in (2, 3)),
    switching_runs(),
    *(on_grid(each, kind) for kind in rooms.KINDS for each in ("filter", "smoother")),
    *(bootstrap(functions) for functions in clouds.FUNCTIONS),
    backwards(),
    likelihood_field(),
    *cliffs.ROWS,
    *neighbours.ROWS,
    *map(pose_graph, pose_graphs.PUBLISHED),
    *map(whole_program, ("m3500", "intel")),
    city(),
    growing(),
    landmark_map(30, reckoned=True),
    landmark_map(300, reckoned=False),
    *(field(side, quick) for side, quick in ((60, 30), (100, 0), (300, 0))),
    long_chain(),
    declaration(),
    discrete("asia", tables.medical()),
    discrete("random_200", tables.random()),
    *(make(name) for make in (new_evidence, cold_start, many_sets) for name in repository.NAMES),
    *(reading(name) for name in (*repository.NAMES, *repository.LARGE)),
]
