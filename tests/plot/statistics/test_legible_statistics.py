"""Curves of statistics, ordinary and extreme, are legible as far as a program can tell."""

import pytest

from tests.plot.legible import assert_legible
from tests.plot.statistics.zoo import STATISTICS

ZOO = STATISTICS


@pytest.mark.parametrize("name", ZOO)
def test_pictures_are_legible(name):
    drawn = ZOO[name]()
    assert_legible(drawn[0] if isinstance(drawn, tuple) else drawn)
