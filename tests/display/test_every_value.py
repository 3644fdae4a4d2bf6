"""All public values, small and large, are printed in a few lines, and in HTML, without fault."""

import inspect
import warnings
from html.parser import HTMLParser

import numpy as np
import pytest
from display.every_value import HOSTILE, every

import pgm
from pgm import consistency, maps
from pgm.display.summary import LINES

with warnings.catch_warnings():
    warnings.simplefilter("ignore")  # of particles that are few and cells that are wide
    VALUES = every()
# Names decide how wide these are.
NAMED = ("hostile", "small: ", "online filter", "online lag", "posterior of", "discrete posterior")
VOID = {"br", "hr", "img"}
# Lineariser is a protocol, BeliefFamily and StatisticalRegression are bases.
BASES = {"BeliefFamily", "Lineariser", "StatisticalRegression"}


class Markup(HTMLParser):
    """The elements of a text, each of which is closed where it was opened."""

    def __init__(self, text):
        super().__init__()
        self.open, self.seen = [], []
        self.feed(text)
        self.close()
        assert not self.open

    def handle_starttag(self, tag, attributes):
        self.seen.append((tag, dict(attributes)))
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attributes):
        self.seen.append((tag, dict(attributes)))

    def handle_endtag(self, tag):
        assert self.open.pop() == tag


@pytest.mark.parametrize("value", VALUES.values(), ids=VALUES)
def test_text_is_short(value, request):
    for text in (repr(value), str(value)):
        lines = text.splitlines()
        assert 1 <= len(lines) <= LINES
        assert text == text.rstrip("\n")
        assert " object at 0x" not in text
        assert all(line.isprintable() for line in lines)
        if not any(name in request.node.name for name in NAMED):
            assert max(map(len, lines[1:]), default=0) <= 100
            assert len(lines[0]) <= 125


# Posteriors are pages of the viewer, which has tests of its own.
PAGES = (pgm.results.Posterior,)
ELEMENTS = {name: value for name, value in VALUES.items() if not isinstance(value, PAGES)}


@pytest.mark.parametrize("value", ELEMENTS.values(), ids=ELEMENTS)
def test_html_is_sound(value):
    text = value._repr_html_()
    tags = {tag for tag, _ in Markup(text).seen}
    assert not {"script", "b>", "i", "style"} & tags
    assert not any(
        key.startswith("on") for _, attributes in Markup(text).seen for key in attributes
    )
    assert HOSTILE not in text
    assert len(text) < 200_000


def test_each_public_class_has_a_value():
    here = {cls for value in VALUES.values() for cls in type(value).__mro__}
    spaces = (pgm, consistency, pgm.comparison, pgm.recordings, pgm.results)
    for space in spaces:
        for name in set(space.__all__) - BASES - {"Oracle"}:
            found = getattr(space, name)
            if inspect.isclass(found) and not issubclass(found, BaseException):
                assert found in here, name
    assert maps.OccupancyMap in here


def test_print_options_are_neither_used_nor_changed():
    before = np.get_printoptions()
    texts = {name: repr(value) for name, value in VALUES.items()}
    assert np.get_printoptions() == before
    with np.printoptions(precision=1, threshold=2, suppress=True):
        again = {name: repr(value) for name, value in VALUES.items()}
    assert texts == again
