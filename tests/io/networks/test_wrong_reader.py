"""Files that were given to another reader: what they are, and where to go."""

import gzip
import io
import json

import pytest

import pgm
from pgm.examples import coin

XML = '<?xml version="1.0" encoding="UTF-8"?>\n<!-- made by hand -->\n'
FILES = {
    "Hugin": ("% a comment\nnet\n{\n  node_size = (80 40);\n}\nnode A\n{\n}\n", 2, "loadBN"),
    "Hugin .*NET": ("class Sprinkler {\n}\n", 1, "pgm.from_pyagrum"),
    "GeNIe .*XDSL": (
        XML + '<smile version="1.0" id="n"></smile>\n',
        3,
        "turns the order of several parents",
    ),
    "GeNIe .*DSL": ("net Asia\n{\n HEADER = {}\n}", 1, "network.dsl"),
    "Netica": ("// ~->[DNET-1]->~\n\nbnet Asia {\n};\n", 3, "GeNIe opens it.*network.net"),
    "Microsoft .*DSC": ('belief network "asia"\nnode a {}\n', 1, "GeNIe opens it"),
    "Microsoft .*XBN": ("<ANALYSISNOTEBOOK ROOT='a'>", 1, "GeNIe opens it"),
    "Weka": ("% 1. Title\n@RELATION iris\n@DATA\n", 2, "loadarff"),
}
OURS = {
    pgm.read_bif: "/* a\nb */ network n {\n}\nvariable a {\n}\n",
    pgm.read_xmlbif: XML
    + "<!DOCTYPE BIF [\n<!ELEMENT BIF (NETWORK)*>\n]>\n<BIF VERSION='0.3'></BIF>",
    pgm.read_uai: "# a comment\n#\nBAYES\n1\n2\n1\n1 0\n2\n0.5 0.5\n",
}


@pytest.mark.parametrize("kind", FILES)
@pytest.mark.parametrize("reader", OURS)
def test_files_of_other_programs(kind, reader):
    text, line, remedy = FILES[kind]
    packed = io.BytesIO(gzip.compress(("\ufeff" + text).replace("\n", "\r\n").encode()))
    for file in (io.StringIO(text), packed):
        with pytest.raises(pgm.FileError, match=rf"it is a.* {kind}.*{remedy}") as caught:
            reader(file)
        assert caught.value.line == line


BY_PYAGRUM = [
    ("net", "net\n{\n}\n"),
    ("net", "class Sprinkler\n{\n inputs = ();\n node A\n {\n }\n}\n"),
    ("net", "class Sprinkler {\n node A\n {\n }\n}\n"),
    ("o3prm", "class C {\n int (0, 1) A  {[0.25, 0.75]};\n}\n"),
    ("o3prm", "class C extends B {\n boolean A {\n"),
    ("o3prm", "type state labels(OK, NOK);\nclass A {\n}\n"),
    ("o3prm", "class C {\n state s dependson r {\n"),
    ("o3prm", "import fr.lip6.printers;\nsystem S {\n}\n"),
    ("net", XML + '<smile version="1.0" id="n"></smile>\n'),
    ("net", "bnet Asia {\n};\n"),
    ("dsl", "net Asia\n{\n HEADER = {}\n}"),
    ("jgum", '{"type":"BN","GumJsonVersion":"1.0","nodes":["A[2]"]}'),
]


@pytest.mark.parametrize(("ending", "text"), BY_PYAGRUM)
@pytest.mark.parametrize("reader", OURS)
def test_files_that_pyagrum_reads(ending, text, reader):
    way = rf"pgm\.from_pyagrum\(pyagrum\.loadBN\('network\.{ending}'\)\), .*sepset\[files\]"
    with pytest.raises(pgm.FileError, match=way):
        reader(io.StringIO(text))


@pytest.mark.parametrize("reader", OURS)
@pytest.mark.parametrize("due", OURS)
def test_files_of_each_other(reader, due):
    if reader is due:
        return
    with pytest.raises(pgm.FileError, match=rf"pgm\.{due.__name__} reads it"):
        reader(io.StringIO(OURS[due]))


PAGES = {
    "plain": ("<!DOCTYPE html>\n<html><body>network n { }</body></html>", 1),
    "lower case": ("\n <!doctype html>\n<head>", 2),
    "without a type": ("<HTML lang='en'>", 1),
    "XHTML": (XML + '<!DOCTYPE html PUBLIC "-//W3C//DTD XHTML 1.0 Strict//EN">\n<html>', 3),
}
READERS = {
    **{reader.__name__: reader for reader in OURS},
    "read_uai_evidence": lambda file: pgm.read_uai_evidence(file, coin),
    "read_tum": pgm.read_tum,
    "read_pose_graph": pgm.recordings.read_pose_graph,
    "read_csv": lambda file: pgm.recordings.read_csv(file, {"truth": {"t": "t", "x": "x"}}),
}


@pytest.mark.parametrize("page", PAGES)
@pytest.mark.parametrize("reader", READERS)
def test_web_pages(page, reader):
    text, line = PAGES[page]
    packed = io.BytesIO(gzip.compress(("\ufeff" + text).encode()))
    for file in (io.StringIO(text), packed, io.BytesIO(text.encode())):
        with pytest.raises(pgm.FileError, match=r"it is a web page .*save the raw file") as caught:
            READERS[reader](file)
        assert caught.value.line == line


@pytest.mark.parametrize(
    "text", ['{"nodes": []}', '\n[\n {"id": 1}]', "{}", "[]", "[[0.2, 0.8]]", '["a"]', "[-1, 2]"]
)
@pytest.mark.parametrize("reader", [*list(READERS)[:4]])
def test_json(text, reader):
    assert json.loads(text) is not None
    with pytest.raises(pgm.FileError, match=r"it is JSON, .*BIF, XMLBIF or UAI") as caught:
        READERS[reader](io.StringIO(text))
    assert caught.value.line == 1 + text.startswith("\n")


@pytest.mark.parametrize("text", ["{ network", "[ network ]", "html", "<!-- html -->\n<BIFF>"])
def test_what_is_neither_is_not_called_so(text):
    for reader in OURS:
        with pytest.raises(pgm.FileError) as caught:
            reader(io.StringIO(text))
        assert "web page" not in str(caught.value)
        assert "JSON" not in str(caught.value)


def test_a_network_given_as_evidence():
    with pytest.raises(pgm.FileError, match=r"it is a UAI file; pgm.read_uai reads it"):
        pgm.read_uai_evidence(io.StringIO(OURS[pgm.read_uai]), coin)


def test_the_line_behind_comments():
    with pytest.raises(pgm.FileError, match="the number of tables is due") as caught:
        pgm.read_uai(io.StringIO("#\n# an example\n#\nMARKOV\n1\n2\n"))
    assert caught.value.line == 7
    with pytest.raises(pgm.FileError, match="expected BAYES") as caught:
        pgm.read_uai(io.StringIO("#\n\nBAYESIAN\n"))
    assert caught.value.line == 3
