"""What is written reads back: the same doubles, any name, any kind of source."""

import gzip
import io
from pathlib import Path

import numpy as np
import pytest
from files import CONTROLS, NASTY, networks, same, written
from hypothesis import given, settings
from hypothesis import strategies as st

import pgm
from models.discrete import sprinkler

XML = st.characters(
    exclude_categories=["Cs"], exclude_characters="\ufffe\uffff", min_codepoint=0x20
) | st.sampled_from("\t\n\r")
xml_text = st.sampled_from(NASTY) | st.text(XML, max_size=6)
any_text = st.sampled_from(NASTY + CONTROLS) | st.text(st.characters(), max_size=6)
some = settings(max_examples=60)


@given(networks(any_text))
@some
def test_bif(network):
    same(network, pgm.read_bif(io.BytesIO(written(pgm.write_bif, network))))


@given(networks(xml_text))
@some
def test_xmlbif(network):
    same(network, pgm.read_xmlbif(io.BytesIO(written(pgm.write_xmlbif, network))))


FORMATS = [(pgm.write_bif, pgm.read_bif), (pgm.write_xmlbif, pgm.read_xmlbif)]


@pytest.mark.parametrize(("write", "read"), FORMATS)
@pytest.mark.parametrize("kind", [str, Path])
@pytest.mark.parametrize("name", ["network", "network.gz"])
def test_paths(tmp_path, write, read, kind, name):
    network, path = café(), kind(tmp_path / name)
    write(network, path)
    same(network, read(path))
    assert Path(path).read_bytes().startswith(b"\x1f\x8b") == name.endswith(".gz")


@pytest.mark.parametrize(("write", "read"), FORMATS)
def test_gzip_is_told_by_its_first_bytes(tmp_path, write, read):
    path = tmp_path / "plainly_named"
    path.write_bytes(gzip.compress(written(write, café())))
    same(café(), read(path))
    with gzip.open(path) as file:
        same(café(), read(file))


@pytest.mark.parametrize(("write", "read"), FORMATS)
@pytest.mark.parametrize("encoding", ["utf-8", "latin-1", "utf-16"])
def test_files_opened_as_text(tmp_path, write, read, encoding):
    path = tmp_path / "network"
    with path.open("w", encoding=encoding) as file:
        write(café(), file)
    with path.open(encoding=encoding) as file:
        same(café(), read(file))


@pytest.mark.parametrize(("write", "read"), FORMATS)
@pytest.mark.parametrize("mark", [b"\xef\xbb\xbf", b""])
@pytest.mark.parametrize("end", [b"\n", b"\r\n", b"\r"])
def test_byte_order_marks_and_line_ends(write, read, mark, end):
    data = mark + written(write, café()).replace(b"\n", end)
    same(café(), read(io.BytesIO(data)))
    same(café(), read(io.StringIO(data.decode())))


def test_a_source_may_give_less_than_is_asked_for():
    class Slow(io.RawIOBase):
        def __init__(self, data):
            self.data = data

        def read(self, size=-1):
            piece, self.data = self.data[:7], self.data[7:]
            return piece

    same(café(), pgm.read_bif(Slow(written(pgm.write_bif, café()))))


def test_equal_networks_make_equal_files(tmp_path):
    for name in ("a.gz", "b.gz"):
        pgm.write_bif(café(), tmp_path / name)
    assert (tmp_path / "a.gz").read_bytes() == (tmp_path / "b.gz").read_bytes()


def test_plain_names_are_written_plainly():
    """As the public repositories have them, so that every reader takes them."""
    text = written(pgm.write_bif, sprinkler()).decode()
    assert '"' not in text
    assert text.startswith("network unknown {\n}\nvariable ")


@pytest.mark.parametrize("name", CONTROLS[3:5] + CONTROLS[7:])
def test_names_that_xml_cannot_write(name):
    network = pgm.BayesianNetwork([pgm.TableCPD(pgm.Discrete("a", (name, "b")), table=[0.5, 0.5])])
    with pytest.raises(pgm.ModelError, match=r"XML cannot write the character .*; write BIF"):
        pgm.write_xmlbif(network, io.BytesIO())


@pytest.mark.parametrize("write", [pgm.write_bif, pgm.write_xmlbif, pgm.to_pgmpy])
def test_what_cannot_be_written(write):
    def attempt(network):
        write(network, *([io.BytesIO()] if write is not pgm.to_pgmpy else []))

    x = pgm.Variable("x")
    with pytest.raises(pgm.ModelError, match="tables of discrete variables alone"):
        attempt(pgm.BayesianNetwork([pgm.GaussianCPD(x, 0.0, 1.0)]))
    with pytest.raises(pgm.ModelError, match="is a BayesianNetwork, not list"):
        attempt([])
    a = pgm.Discrete("a", 2)
    with pytest.raises(pgm.ModelError, match=r"a\[3\] is of a step.*'a_3'"):
        attempt(pgm.BayesianNetwork([pgm.TableCPD(a.at(3), table=[0.5, 0.5])]))


def test_nothing_is_written_of_what_cannot_be(tmp_path):
    with pytest.raises(pgm.ModelError):
        pgm.write_bif([], tmp_path / "a")
    assert not (tmp_path / "a").exists()


def test_targets_and_sources_that_are_none(tmp_path):
    with pytest.raises(pgm.FileError, match="a target is a path or an open file, not int"):
        pgm.write_bif(café(), 3)
    for read in (pgm.read_bif, pgm.read_xmlbif, pgm.read_uai):
        with pytest.raises(pgm.FileError, match="a source is a path or an open file, not list"):
            read([])
        with pytest.raises(FileNotFoundError):
            read(tmp_path / "absent")


def café():
    """A small network with a letter that encodings differ in."""
    a = pgm.Discrete("café", ("fermé", "open"))
    b = pgm.Discrete("b", 3)
    rng = np.random.default_rng(0)
    rows = rng.dirichlet(np.ones(3), size=2)
    return pgm.BayesianNetwork([pgm.TableCPD(a, table=[0.1, 0.9]), pgm.TableCPD(b, a, table=rows)])
