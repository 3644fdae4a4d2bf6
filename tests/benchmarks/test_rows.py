"""What is compared must be the same work."""

import numpy as np
import pytest

import pgm
from benchmarks import agreement, cliffs, neighbours
from benchmarks.libraries import pgm_robots
from benchmarks.row import Row, part
from benchmarks.rows import ROWS
from benchmarks.timing import Contender
from benchmarks.work import robots

TINY = {
    "linear": 4,
    "map": 100,
    "online_taylor": 100,
    "particles_own": 100_000,
    "particles_plain": 100_000,
    "particles_backwards": 1_000,
    "likelihood_field": 2_000,
    "landmarks_30": 20,
    "landmarks_300": 40,
    "field_60": 6,
    "field_chain": 30,
}
A_FEW_POSES = 40
COMPILED = (
    "dynamax",
    "dynamax_sequential",
    "dynamax_smoother",
    "dynamax_called",
    "cuthbert",
)  # for seconds each
QUICK = (
    "repository_asia",
    "repository_sachs",
    "cold_asia",
    "cold_cancer",
    "sets_asia",
    "sets_alarm",
    "reading_asia",
)


def slow(row, library):
    """Whether a row takes seconds: of networks, all but a few do, or are large."""
    network = row.name.startswith(("repository_", "cold_", "sets_", "reading_"))
    return library in COMPILED or (network and row.name not in QUICK)


PAIRS = [
    pytest.param(row, library, marks=[pytest.mark.slow] if slow(row, library) else [])
    for row in ROWS
    # Whose contenders are no libraries: see test_cliffs.py and test_neighbours.py.
    if row not in (*cliffs.ROWS, *neighbours.ROWS)
    for library in row.contenders
    if library != "pgm" and library not in row.unchecked
]


@pytest.mark.parametrize(("row", "library"), PAIRS, ids=lambda each: getattr(each, "name", each))
@pytest.mark.filterwarnings("ignore:::(jax|tensorflow_probability|stonesoup|fastprogress|pgmpy)")
def test_libraries_agree(row, library):
    if library == "pgm_compiled":
        pytest.importorskip("llvmlite", reason="sweeps are compiled by llvmlite")
    elif not library.startswith("pgm_"):
        package = library.split("_")[0]
        pytest.importorskip(package, reason=f"{package} comes with the extra bench")
    tiny = TINY.get(row.name, A_FEW_POSES if row.name.startswith("graph_") else 4)
    size = row.size_for(library, min(tiny, row.quick or row.size))
    try:
        contender = row.contenders[library](row.work(size))
    except ImportError as error:
        pytest.skip(str(error))
    row.agree({library: contender}, size)
    due = row.contenders["pgm"](row.work(size)).units
    assert contender.units == (due // 64 if library == "pgm_alone" else due)  # one run of 64


def test_agreement_is_asked_of_every_library():
    row = ROWS[0]

    def wrong(work):
        right = row.contenders["pgm"](work)

        def call():
            means, covs = right.call()
            return means, 1.01 * covs

        return Contender(call, right.units)

    with pytest.raises(AssertionError, match="covariances of wrong differ from pgm's by up"):
        row.agree({"wrong": wrong(row.work(3))}, 3)


def test_optima_are_held_to_metres_and_to_each_poses_own_size():
    covs = np.stack([np.eye(3), 1e-4 * np.eye(3)])
    ours = np.zeros((2, 3)), covs
    agreement.optima("close", ours, (ours[0] + 9e-6, covs * (1 + 9e-5)))
    with pytest.raises(AssertionError, match="means of off"):
        agreement.optima("off", ours, (ours[0] + 1.1e-5, covs))
    with pytest.raises(AssertionError, match="covariances of off"):
        agreement.optima("off", ours, (ours[0], covs * np.array([1.0, 1.0002])[:, None, None]))


def test_places_are_held_to_three_tenths_of_a_metre():
    ours = np.array([5.0, 2.0, 0.5])
    agreement.places("close", ours, ours + np.array([0.29, -0.29, 0.09]))
    for off in ([0.31, 0.0, 0.0], [0.0, -0.31, 0.0], [0.0, 0.0, 0.11]):
        with pytest.raises(AssertionError, match=r"poses.* of off"):
            agreement.places("off", ours, ours + off)


def test_probabilities_must_agree_too():
    with pytest.raises(AssertionError, match="probabilities of off"):
        agreement.marginals("off", [np.array([0.5, 0.5])], [np.array([0.5, 0.5 + 1e-9])])


def test_networks_must_be_the_same():
    a, b = pgm.Discrete("a", 2), pgm.Discrete("b", 2)
    prior = pgm.TableCPD(a, table=[0.4, 0.6])
    table = np.array([[0.1, 0.9], [0.8, 0.2]])
    ours = pgm.BayesianNetwork([prior, pgm.TableCPD(b, a, table=table)])
    agreement.networks("pgm", ours, ours)
    three = pgm.Discrete("b", 3)
    for match, cpd in (
        ("other variables", pgm.TableCPD(three, a, table=[[0.1, 0.8, 0.1], [0.1, 0.1, 0.8]])),
        ("other parents of b", pgm.TableCPD(b, table=[0.5, 0.5])),
        ("probabilities of b", pgm.TableCPD(b, a, table=[[0.1, 0.9], [0.8 + 1e-12, 0.2 - 1e-12]])),
    ):
        with pytest.raises(AssertionError, match=match):
            agreement.networks("pgm", ours, pgm.BayesianNetwork([prior, cpd]))


def test_a_missing_library_is_left_out_and_named():
    row = Row(
        "name",
        "unit",
        lambda size: size,
        {"pgm": lambda work: Contender(lambda: work, work), "other": part("other", "filtering")},
        lambda *found: None,
        size=3,
        quick=2,
    )
    here, missing = row.prepared(3)
    assert here["pgm"].call() == 3
    assert "benchmarks.libraries.other" in missing["other"]


def test_a_slow_library_is_given_less():
    row = ROWS[0]
    assert row.size_for("pgm", row.size) == row.size
    assert row.size_for("stonesoup", row.size) == row.most["stonesoup"]
    assert row.size_for("stonesoup", 3) == 3


@pytest.mark.parametrize("rule", ["taylor", "unscented"])
def test_online_ends_where_the_filter_does(rule):
    work = robots.draw(1, 20)
    online = pgm_robots.online(rule, work).call()
    whole = pgm_robots.filtering(rule, work).call()
    for one, other in zip(online, whole, strict=True):
        np.testing.assert_allclose(one, other[0], rtol=0, atol=1e-12)
