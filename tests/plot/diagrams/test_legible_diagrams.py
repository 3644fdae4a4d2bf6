"""Networks and cluster graphs, ordinary and extreme, are legible as far as a program can tell."""

import pytest

from tests.plot.diagrams.zoo import GRAPHS, LARGE, NETWORKS
from tests.plot.legible import assert_legible

ZOO = NETWORKS | GRAPHS


@pytest.mark.parametrize("name", ZOO)
def test_pictures_are_legible(name):
    assert_legible(ZOO[name]())


@pytest.mark.slow
@pytest.mark.parametrize("name", LARGE)
def test_large_pictures_are_legible(name):
    assert_legible(LARGE[name]())
