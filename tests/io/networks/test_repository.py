"""The networks that the pgmpy wheel carries, read by pgmpy and by us."""

import gzip
import importlib.util
from pathlib import Path

import numpy as np
import pytest
from files import same, written

import pgm

FOUND = importlib.util.find_spec("pgmpy")
FOLDER = Path(FOUND.origin).parent / "utils" / "example_models" if FOUND and FOUND.origin else None
pytestmark = pytest.mark.skipif(FOLDER is None, reason="pgmpy is not installed")

SMALL = ("asia", "survey")
LARGE = (
    *(
        "cancer",
        "earthquake",
        "sachs",
        "child",
        "alarm",
        "insurance",
        "hailfinder",
        "win95pts",
        "hepar2",
    ),
    *("andes", "pigs", "water", "munin1", "mildew", "barley", "link", "pathfinder", "munin"),
)
NAMES = [*SMALL, *(pytest.param(name, marks=pytest.mark.slow) for name in LARGE)]


def path(name):
    found = FOLDER / f"{name}.bif.gz"
    if not found.is_file():
        pytest.skip(f"this pgmpy has no {name}")
    return found


@pytest.mark.parametrize("name", NAMES)
def test_pgmpy_reads_the_same(name):
    readwrite = pytest.importorskip("pgmpy.readwrite")
    network = pgm.read_bif(path(name))
    theirs = readwrite.BIFReader(string=gzip.decompress(path(name).read_bytes()).decode())
    assert {v.name: list(v.states) for v in network.variables} == theirs.variable_states
    for cpd in network.cpds:
        assert [v.name for v in cpd.given] == theirs.variable_parents[cpd.child.name]
        due = theirs.variable_cpds[cpd.child.name].T
        np.testing.assert_array_equal(cpd.table.reshape(-1, cpd.child.size), due)


@pytest.mark.parametrize("name", NAMES)
def test_round_trips(name, tmp_path):
    network = pgm.read_bif(path(name))
    pgm.write_bif(network, tmp_path / "a.bif.gz")
    same(network, pgm.read_bif(tmp_path / "a.bif.gz"))
    pgm.write_xmlbif(network, tmp_path / "a.xml")
    same(network, pgm.read_xmlbif(tmp_path / "a.xml"))


@pytest.mark.parametrize("name", SMALL)
def test_pgmpy_reads_what_we_write(name, tmp_path):
    readwrite = pytest.importorskip("pgmpy.readwrite")
    network = pgm.read_bif(path(name))
    text = written(pgm.write_bif, network).decode()
    (tmp_path / "a.xml").write_bytes(written(pgm.write_xmlbif, network))
    for reader in (readwrite.BIFReader(string=text), readwrite.XMLBIFReader(tmp_path / "a.xml")):
        back = pgm.from_pgmpy(reader.get_model())
        for cpd in network.cpds:
            assert back.cpd(cpd.child).given == cpd.given
            np.testing.assert_array_equal(back.cpd(cpd.child).table, cpd.table)
