"""Pictures of beliefs, ordinary and extreme, are legible as far as a program can tell."""

import pytest

from tests.plot.beliefs.zoo import BELIEFS
from tests.plot.legible import assert_legible

ZOO = BELIEFS


@pytest.mark.parametrize("name", ZOO)
def test_pictures_are_legible(name):
    assert_legible(ZOO[name]())
