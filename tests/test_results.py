"""What calls return is found in `pgm.results`, and by its old names with a note."""

import inspect
import pickle
import subprocess
import sys
import warnings

import pytest

import pgm
from pgm import results
from pgm.examples import rain, rainy, squares, walk, wet, x, z

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


# What the table of the module says, as calls.
CALLS = {
    "Associations": lambda: pgm.filter(
        SEES,
        {z: pgm.sightings([[1.0]], step=[1], given={M: pgm.unknown([[0.0], [5.0]])})},
        steps=1,
    ).associations[z],
    "Audit": lambda: pgm.audit(pgm.smooth(squares, {z: [[4.0]]}), samples=20, rng=0),
    "Cluster": lambda: pgm.compile(rainy).clusters[0],
    "Comparison": lambda: pgm.compare(walk, GIVEN),
    "Compilation": lambda: pgm.compile(walk, 3).compilation,
    "ControlReport": lambda: next(iter(pgm.timeline(**LOG).controls.values())),
    "Derivatives": lambda: squares.observation[0].derivatives,
    "Fit": fitted,
    "FitStatus": lambda: fitted().status,
    "GridBelief": lambda: pgm.filter(walk, GIVEN, belief=GRID)[x],
    "GridFigures": lambda: pgm.filter(walk, GIVEN, belief=GRID).status._figures,
    "Innovations": lambda: pgm.filter(walk, GIVEN).innovations[z],
    "Lost": lambda: pgm.filter(walk, GIVEN).lost,
    "MostProbable": lambda: pgm.most_probable(pgm.compile(rainy), {wet: "yes"}),
    "OnlineBelief": online,
    "ParticleBelief": lambda: pgm.filter(walk, GIVEN, belief=CLOUD)[x],
    "ParticleFigures": lambda: pgm.filter(walk, GIVEN, belief=CLOUD).status._figures,
    "Posterior": lambda: pgm.infer(pgm.compile(rainy), {rain: "no"}),
    "ReadingReport": lambda: pgm.timeline(**LOG).readings[z],
    "Rejections": lambda: pgm.filter(walk, GIVEN, gate=0.9).rejected[z],
    "Row": lambda: pgm.compare(walk, GIVEN)["Taylor", "filter"],
    "Sample": lambda: walk.sample(steps=3, rng=0),
    "Stamped": lambda: pgm.stamped([0.0], [1.0]),
    "Status": lambda: pgm.smooth(walk, GIVEN).status,
    "Timeline": lambda: pgm.timeline(**LOG),
}
# By the name of the version before, where it stands now.
OLD = {
    name: f"pgm.results.{name}"
    for name in results.__all__
    if name
    not in (
        *("Compilation", "ControlReport", "Derivatives"),
        *("Innovations", "ReadingReport", "Row", "Sample"),
    )
}
OLD |= dict.fromkeys(
    ("ChainPosterior", "GridPosterior", "KeptPosterior", "ParticlePosterior", "StatePosterior"),
    "pgm.results.Posterior",
)
OLD |= dict.fromkeys(("OnlineGridBelief", "OnlineParticleBelief"), "pgm.results.OnlineBelief")
OLD |= dict.fromkeys(("OnlineGrid", "OnlineParticles", "OnlineTables"), "pgm.OnlineFilter")
OLD |= {"GridStatus": "pgm.results.GridFigures", "ParticleStatus": "pgm.results.ParticleFigures"}


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


@pytest.mark.parametrize(("name", "new"), OLD.items())
def test_an_old_name_tells_the_new_one_and_is_the_same(name, new):
    space, _, last = new.rpartition(".")
    due = getattr(sys.modules[space], last)
    with pytest.warns(DeprecationWarning, match=rf"^pgm\.{name} is {new} now$") as told:
        assert getattr(pgm, name) is due
    assert [each.filename for each in told] == [__file__]


def test_the_package_itself_holds_no_results():
    assert "results" in pgm.__all__
    for names in (dir(pgm), pgm.__all__, vars(pgm)):
        assert not set(names) & set(OLD)
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
    assert run("import sys, pgm", asked).split() == ["Posterior", "False"]
    program = "print(pgm.results.Comparison.__name__, pgm.results.Fit.__name__)"
    assert run("import pgm", program).split() == ["Comparison", "Fit"]


def test_an_old_name_can_be_imported():
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        from pgm import Posterior
    assert Posterior is results.Posterior
    assert {str(each.message) for each in told} == {"pgm.Posterior is pgm.results.Posterior now"}
