"""One description has two printers, which cut what is long and escape what is foreign."""

from html import unescape

import numpy as np
import pytest

import pgm
from pgm.display import InCode, Listing, NoArray, Shown, Summary, brief, table, titled
from pgm.display.summary import CELL, LINES, WIDTH

ROWS = [["a", "1", "20"], None, ["bb", "300", "4"]]


def test_columns_are_aligned():
    text = Summary("Title", [Listing(["", "x", "y"], ROWS), "A note."]).text()
    assert text.splitlines() == [
        "Title",
        "         x   y",
        "  a      1  20",
        "  ...",
        "  bb   300   4",
        "  A note.",
    ]


def test_html_has_the_same_cells():
    html = Summary("Title", [Listing(["", "x", "y"], ROWS), "A note."]).html("<svg></svg>")
    for part in ("<b>Title</b>", "<svg></svg>", ">300</td>", ">x</th>", "<p>A note.</p>"):
        assert part in html
    assert html.count("<tr>") == 4
    assert html.count("text-align: left") == 3


def test_long_things_are_cut():
    wide = Listing([f"column {k}" for k in range(40)], [["12345678"] * 40])
    lines = Summary("Title", [wide]).text().splitlines()
    assert max(map(len, lines)) <= WIDTH
    assert all(line.endswith("...") for line in lines[1:])
    many = Summary("Title", [f"line {k}" for k in range(100)])
    assert many.text().splitlines()[-2:] == ["  line 17", "  ..."]
    assert len(many.text().splitlines()) == LINES
    assert "line 99" in many.html()
    cell = Listing([""], [["x" * 200]]).lines(WIDTH)[0]
    assert cell == "x" * (CELL - 3) + "..."
    words = Summary("Title", [" ".join(["word"] * 50)]).text().splitlines()
    assert max(map(len, words)) <= WIDTH
    assert " ".join(words).split().count("word") == 50


@pytest.mark.parametrize("name", ["<script>", "a\nb", "\x1b[31m", 'x" onload="y', "\u202etxet"])
def test_foreign_text_stays_text(name):
    shown = Summary(name, [Listing([name], [[name]]), name])
    assert len(shown.text().splitlines()) == 4
    assert all(line.isprintable() for line in shown.text().splitlines())
    html = shown.html()
    assert "<script>" not in html
    assert 'onload="y"' not in html
    plain = name.encode("unicode_escape").decode() if not name.isprintable() else name
    assert unescape(html).count(plain) == 4


def test_empty_listings():
    assert Summary("Title", [Listing(["a"], [])]).text() == "Title\n  a"
    assert Summary("Title", [Listing(["", ""], [])]).text() == "Title"
    assert Summary("Title").text() == "Title"


class Thing(Shown, NoArray):
    _arrays = ".numbers"

    @property
    def _title(self):
        return "Thing(<1>)"


class Choice(InCode):
    def __repr__(self):
        return "Choice('<b>')"


def test_values_show_themselves():
    assert repr(Thing()) == str(Thing()) == "Thing(<1>)"
    assert Thing()._repr_html_() == "<div><p><b>Thing(&lt;1&gt;)</b></p></div>"
    assert Choice()._repr_html_() == "<code>Choice(&#x27;&lt;b&gt;&#x27;)</code>"
    assert titled(Thing()) == "Thing(<1>)"
    assert titled([1] * 100) == "[1, 1, 1, 1, ...]"
    with pytest.raises(NotImplementedError, match="Shown has no title"):
        repr(Shown())


def test_any_value_in_a_few_words():
    assert brief([0.5, 0.0]) == "[0.5, 0.0]"
    assert brief(np.eye(2)) == "array([[1.0, 0.0], [0.0, 1.0]])"
    assert brief(np.zeros((100, 2))) == "array of shape (100, 2)"
    assert "\n" not in brief("a\nb")
    assert len(brief(list(range(10**5)))) < 100


def test_rows_that_are_no_numbers():
    listing = table([("step", [0, 1]), ("value", [[1.0, 2.0], [3.0, 4.0]]), ("who", "abc")])
    assert listing.heads == ["step", "value", "", "who"]
    assert listing.rows == [("0", "1", "2", "'abc'"), ("1", "3", "4", "'abc'")]


BELIEF = pgm.Gaussian(pgm.Variable("a"), [0.0], [[1.0]])
NUMBERLESS = {
    "gaussian": (BELIEF, r"a Gaussian is no array; take its \.mean and \.cov"),
    "form": (pgm.CanonicalForm.from_gaussian(BELIEF), r"take its \.K, \.h and \.g"),
    "affine": (pgm.AffineGaussian([[1.0]], [0.0], [[1.0]]), r"take its \.F, \.b and \.cov"),
    "table": (pgm.Table(pgm.Discrete("d", 2), [0.5, 0.5]), r"take its \.values"),
}


@pytest.mark.parametrize(("value", "words"), NUMBERLESS.values(), ids=NUMBERLESS)
def test_values_are_no_arrays(value, words):
    for call in (np.asarray, np.array, lambda v: np.asarray([v, v]), np.sum):
        with pytest.raises(pgm.ArrayError, match=words):
            call(value)
    with pytest.raises(TypeError):
        np.asarray(value, dtype=float)
    # As evidence it is refused in the words of evidence.
    with pytest.raises(pgm.PgmError, match="which makes no array"):
        pgm.Gaussian(pgm.Variable("a"), value, 1.0)


def test_lists_of_values_may_still_be_held():
    held = np.empty(2, dtype=object)
    held[:] = [BELIEF, BELIEF]
    assert held[0] is held[1] is BELIEF
    assert np.asarray(BELIEF, dtype=object)[()] is BELIEF
    assert np.array([BELIEF] * 3, dtype=object).shape == (3,)
    pandas = pytest.importorskip("pandas")
    assert pandas.DataFrame({"belief": [BELIEF]})["belief"][0] is BELIEF
