"""What calls return is found in `pgm.results`, and by its old names with a note."""

import inspect
import pickle
import subprocess
import sys
import warnings

import pytest

import pgm
from pgm import results
from pgm.examples import rain, rainy, squares, still, walk, wet, x, z
from tests.beliefs.own.ensemble import EnsembleKalman

GIVEN = {z: [[2.0], [3.0]]}
LOG = {"odometry": {pgm.Variable("u"): pgm.stamped([0.0, 1.0, 2.0], [1.0, 1.0, 1.0])}}
LOG["sensors"] = {z: pgm.stamped([0.1, 1.9], [4.0, 5.0])}
GRID = pgm.Grid({"x": (-9.0, 12.0, 100)})
CLOUD = pgm.Particles(200, seed=0)
M = pgm.Variable("m")
SEES = pgm.DynamicBayesianNetwork(
    walk.prior, walk.transition, [pgm.LinearGaussianCPD(z, {x: 1.0, M: 1.0}, cov=1.0)]
)


def fitted():
    return pgm.fit(walk, GIVEN, learn={z: pgm.learning.Covariance()}, iterations=30)


def online():
    robot = pgm.OnlineFilter(walk)
    return robot.predict(robot.initial())


def read():
    return pgm.OnlineFilter(walk).update(online(), {z: [4.0]})


def studied():
    return pgm.study(walk, steps=2, runs=3, methods={"KF": pgm.Filtering()}, seed=1)


def sighted():
    """A map of one landmark, which is sighted without its name."""
    sees = pgm.LinearGaussianCPD(z, {M: 1.0}, cov=1.0)
    there = pgm.Variable("there")
    grown = pgm.GrowingMap().add(pgm.GaussianCPD(there, 0.0, 1.0))
    return grown.add(sees, {z: 1.0, M: pgm.unknown([there], association="likelihood")})


# What the table of the module says, as calls.
CALLS = {
    "Association": lambda: sighted().associations[z],
    "Associations": lambda: pgm.filter(
        SEES,
        {
            z: pgm.sightings(
                [[1.0]], step=[1], given={M: pgm.unknown([[0.0], [5.0]], association="likelihood")}
            )
        },
        steps=1,
    ).associations[z],
    "Audit": lambda: pgm.audit(pgm.smooth(squares, {z: [[4.0]]}), samples=20, rng=0),
    "CliqueTree": lambda: sighted().cliques,
    "Cluster": lambda: pgm.compile(rainy).clusters[0],
    "Comparison": lambda: pgm.compare(walk, GIVEN),
    "Compilation": lambda: pgm.compile(walk, 3).compilation,
    "ControlReport": lambda: next(iter(pgm.timeline(**LOG).controls.values())),
    "Derivatives": lambda: squares.observation[0].derivatives,
    "Fit": fitted,
    "FitStatus": lambda: fitted().status,
    "GridBelief": lambda: pgm.filter(walk, GIVEN, belief=GRID)[x],
    "GridFigures": lambda: pgm.filter(walk, GIVEN, belief=GRID).status._figures,
    "Growth": lambda: pgm.GrowingMap().status,
    "Innovations": lambda: pgm.filter(walk, GIVEN).innovations[z],
    "Judgement": lambda: pgm.compare(walk, GIVEN, oracle=GRID)["Taylor", "filter"].by_oracle[
        "Grid"
    ],
    "Lost": lambda: pgm.filter(walk, GIVEN).lost,
    "MostProbable": lambda: pgm.most_probable(pgm.compile(rainy), {wet: "yes"}),
    "MaxMarginals": lambda: pgm.max_marginals(pgm.compile(rainy), {wet: "yes"}),
    "OnlineBelief": online,
    "ParticleBelief": lambda: pgm.filter(walk, GIVEN, belief=CLOUD)[x],
    "ParticleFigures": lambda: pgm.filter(walk, GIVEN, belief=CLOUD).status._figures,
    "PointMixture": lambda: pgm.filter(walk, GIVEN, belief=CLOUD).predicted[z],
    "Posterior": lambda: pgm.infer(pgm.compile(rainy), {rain: "no"}),
    "Predictions": lambda: online().predicted,
    "ReadingReport": lambda: pgm.timeline(**LOG).readings[z],
    "Rejections": lambda: pgm.filter(walk, GIVEN, gate=0.9).rejected[z],
    "Row": lambda: pgm.compare(walk, GIVEN)["Taylor", "filter"],
    "Sample": lambda: walk.sample(steps=3, rng=0),
    "Stamped": lambda: pgm.stamped([0.0], [1.0]),
    "SensitiveEntry": lambda: pgm.sensitivity(rainy, {rain: "no"}).ranked(1)[0],
    "Sensitivities": lambda: pgm.sensitivity(rainy, {rain: "no"}),
    "Sensitivity": lambda: pgm.sensitivity(rainy, {rain: "no"})[rain],
    "Statistic": lambda: studied()["KF"].nees,
    "Status": lambda: pgm.smooth(walk, GIVEN).status,
    "StepInnovations": lambda: read().innovations[z],
    "Study": studied,
    "StudyRow": lambda: studied()["KF"],
    "Timeline": lambda: pgm.timeline(**LOG),
    "Verdict": lambda: pgm.estimate(walk, GIVEN).verdict,
}
# Those that had the same name before, in the package itself.
OLD = sorted(
    set(results.__all__)
    - {"Compilation", "ControlReport", "Derivatives", "GridFigures", "Innovations"}
    - {"Association", "CliqueTree", "Growth", "ParticleFigures", "ReadingReport", "Row", "Sample"}
    - {
        "Judgement",
        "MaxMarginals",
        "PointMixture",
        "SensitiveEntry",
        "Sensitivities",
        "Sensitivity",
    }
    - {"Predictions", "Statistic", "StepInnovations", "Study", "StudyRow", "Verdict"}
)
# What posteriors, statuses and filters are of, by the name of their class before.
POSTERIORS = {
    "Posterior": lambda: pgm.infer(pgm.compile(rainy), {rain: "no"}),
    "ChainPosterior": lambda: pgm.filter(walk, GIVEN),
    "KeptPosterior": lambda: pgm.filter(walk, GIVEN, keep=x),
    "StatePosterior": lambda: pgm.filter(still, {wet: ["no", "yes"]}),
    "GridPosterior": lambda: pgm.filter(walk, GIVEN, belief=GRID),
    "ParticlePosterior": lambda: pgm.filter(walk, GIVEN, belief=CLOUD),
}
STATUSES = {"GridStatus": "GridPosterior", "ParticleStatus": "ParticlePosterior"}
ROBOTS = {"OnlineFilter": None, "OnlineGrid": GRID, "OnlineParticles": CLOUD}
BELIEFS = {"OnlineGridBelief": "OnlineGrid", "OnlineParticleBelief": "OnlineParticles"}
PARTS = {
    **dict.fromkeys(sorted(set(POSTERIORS) - {"Posterior"}), "pgm.results.Posterior"),
    **dict.fromkeys(STATUSES, "pgm.results.Status"),
    **dict.fromkeys(sorted(set(ROBOTS) - {"OnlineFilter"}), "pgm.OnlineFilter"),
    **dict.fromkeys(BELIEFS, "pgm.results.OnlineBelief"),
}


def named(name, package=pgm):
    """What an old name stands for, of which its note tells."""
    with pytest.warns(DeprecationWarning, match=rf"^{package.__name__}\.{name} is pgm\.") as told:
        found = getattr(package, name)
    assert [each.filename for each in told] == [__file__]
    return found


@pytest.mark.parametrize("name", results.__all__)
def test_each_is_a_class_that_a_call_returns(name):
    found = getattr(results, name)
    assert inspect.isclass(found)
    assert isinstance(CALLS[name](), found)


def test_the_calls_are_of_these_names():
    assert set(CALLS) == set(results.__all__)


@pytest.mark.parametrize("name", results.__all__)
def test_each_is_told_in_one_line_and_where_it_is_defined(name):
    (line,) = [line for line in results.__doc__.splitlines() if line.startswith(f"`{name}` ")]
    assert len(line) <= 100
    rule = next(each for each in results.__doc__.splitlines() if each.startswith("=="))
    first, second, _ = (len(column) + 1 for column in rule.split())
    what, whence = line[first : first + second], line[first + second :]
    assert what.strip()
    assert whence.startswith("`")
    found = getattr(results, name)
    assert inspect.getdoc(found)
    # Pickles and `help` name the module that defines it, which need not be this one.
    assert pickle.loads(pickle.dumps(found)) is found


def test_the_table_tells_of_no_others():
    told = [line.split("`")[1] for line in results.__doc__.splitlines() if line.startswith("`")]
    assert sorted(told) == sorted(results.__all__)
    assert [name for name in dir(results) if not name.startswith("__")] == results.__all__


@pytest.mark.parametrize("name", OLD)
def test_an_old_name_tells_the_new_one_and_is_the_same(name):
    with pytest.warns(
        DeprecationWarning, match=rf"^pgm\.{name} is pgm\.results\.{name} now$"
    ) as told:
        assert getattr(pgm, name) is getattr(results, name)
    assert [each.filename for each in told] == [__file__]


@pytest.mark.parametrize("package", [pgm, pgm.inference])
@pytest.mark.parametrize(("name", "new"), PARTS.items())
def test_a_class_of_one_family_tells_what_stands_for_it_and_how_the_family_is_told(
    package, name, new
):
    told = rf"^{package.__name__}\.{name} is {new} now, .*(: pgm\.|ask )"
    with pytest.warns(DeprecationWarning, match=told) as notes:
        found = getattr(package, name)
    assert [each.filename for each in notes] == [__file__]
    space, _, last = new.rpartition(".")
    assert issubclass(found, getattr(sys.modules[space], last))
    assert found.__name__ == name
    assert inspect.getdoc(found)


@pytest.mark.parametrize("name", sorted(set(POSTERIORS) - {"Posterior"}))
def test_isinstance_tells_posteriors_apart_as_it_did(name):
    whole = named(name)
    of = [each for each, make in POSTERIORS.items() if isinstance(make(), whole)]
    assert of == [name]
    assert not isinstance(3, whole)


def test_a_balanced_tree_was_a_chain_too():
    found = pgm.smooth(walk, GIVEN, method=pgm.Balanced())
    assert isinstance(found, named("ChainPosterior"))


@pytest.mark.parametrize("name", STATUSES)
def test_isinstance_tells_statuses_apart_as_it_did(name):
    whole = named(name)
    of = [each for each, make in POSTERIORS.items() if isinstance(make().status, whole)]
    assert of == [STATUSES[name]]
    robots = [
        each
        for each, belief in ROBOTS.items()
        if isinstance(pgm.OnlineFilter(walk, belief=belief).initial().status, whole)
    ]
    assert robots == [{"GridStatus": "OnlineGrid"}.get(name, "OnlineParticles")]


@pytest.mark.parametrize("name", BELIEFS)
def test_isinstance_tells_online_beliefs_apart_as_it_did(name):
    whole = named(name)
    of = [
        each
        for each, belief in ROBOTS.items()
        if isinstance(pgm.OnlineFilter(walk, belief=belief).initial(), whole)
    ]
    assert of == [BELIEFS[name]]


@pytest.mark.parametrize("name", sorted(set(ROBOTS) - {"OnlineFilter"}))
def test_an_online_filter_is_made_by_its_old_name(name):
    """The belief was the second argument, which is a lineariser now."""
    made = named(name)
    for robot in (made(walk, ROBOTS[name]), made(walk, belief=ROBOTS[name])):
        for each in (robot, robot.renewed(), pickle.loads(pickle.dumps(robot))):
            assert isinstance(each, made)
            belief = each.update(each.predict(each.initial()), {z: [4.0]})
            assert belief.step == 1
        due = pgm.OnlineFilter(walk, belief=ROBOTS[name])
        assert repr(robot) == repr(due)
        assert belief[x].mean == due.update(due.predict(due.initial()), {z: [4.0]})[x].mean
    of = [
        each
        for each, belief in ROBOTS.items()
        if isinstance(pgm.OnlineFilter(walk, belief=belief), made)
    ]
    assert of == [name]

    class Mine(made):
        """A subclass of a user's own."""

    assert isinstance(Mine(walk, ROBOTS[name]), Mine)
    assert not isinstance(due, Mine)


@pytest.mark.parametrize(
    "name", ["GridFigures", "ParticleFigures", "OnlineTables", "GridPosteriors"]
)
@pytest.mark.parametrize("package", [pgm, pgm.inference])
def test_what_never_was_a_name(package, name):
    if package is pgm or name not in results.__all__:
        with pytest.raises(AttributeError, match=f"'{package.__name__}' has no attribute '{name}'"):
            getattr(package, name)


def test_dir_of_a_status_has_the_figures_of_its_family():
    for make in POSTERIORS.values():
        status = make().status
        assert set(status.numbers) <= set(dir(status))
        assert {"converged", "numbers"} <= set(dir(status))
        assert all(hasattr(status, each) for each in dir(status))
    assert {"outside", "added", "coarse"} <= set(dir(pgm.filter(walk, GIVEN, belief=GRID).status))
    assert {"effective", "few"} <= set(dir(pgm.filter(walk, GIVEN, belief=CLOUD).status))
    assert "members" in dir(pgm.filter(walk, GIVEN, belief=EnsembleKalman(40)).status)
    assert not {"phrases", "on_a_line", "outside"} & set(dir(pgm.filter(walk, GIVEN).status))


def test_the_package_itself_holds_no_results():
    assert "results" in pgm.__all__
    for names in (dir(pgm), pgm.__all__, vars(pgm)):
        assert not set(names) & {*OLD, *PARTS}
        assert not set(names) & set(results.__all__)


def test_a_name_without_a_place():
    with pytest.raises(
        AttributeError, match=r"module 'pgm\.results' has no attribute 'Posteriors'"
    ):
        results.Posteriors  # noqa: B018


def run(*programs):
    """What programs print, each line of code in one process, where warnings are errors."""
    command = [sys.executable, "-W", "error", "-c", "; ".join(programs)]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout


def test_results_are_there_without_an_import_of_their_own_and_load_no_scipy():
    asked = "print(pgm.results.Posterior.__name__, 'scipy' in sys.modules)"
    more = "print(pgm.results.Comparison.__name__, pgm.results.Fit.__name__)"
    found = run("import sys, pgm", asked, more).split()
    assert found == ["Posterior", "False", "Comparison", "Fit"]


def test_an_old_name_can_be_imported():
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        from pgm import Posterior
    assert Posterior is results.Posterior
    assert {str(each.message) for each in told} == {"pgm.Posterior is pgm.results.Posterior now"}


def test_an_old_name_can_be_imported_from_where_it_was():
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        from pgm.inference import GridPosterior
    assert issubclass(GridPosterior, results.Posterior)
    (note,) = {str(each.message) for each in told}
    assert note.startswith("pgm.inference.GridPosterior is pgm.results.Posterior now, ")
