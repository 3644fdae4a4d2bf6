"""Bare names of docstrings lead to the reference of results, and back."""

import pytest
from building.links import place

KNOWN = {"pgm.filter", "pgm.Gaussian", "pgm.results.Posterior", "pgm.plot.network"}


@pytest.mark.parametrize(
    ("name", "module", "due"),
    [
        ("Posterior", "pgm", "pgm.results.Posterior"),
        ("Posterior", None, "pgm.results.Posterior"),
        ("Gaussian", "pgm.results", "pgm.Gaussian"),
        ("Gaussian", "pgm.consistency", "pgm.Gaussian"),
        ("filter", "pgm.results", "pgm.filter"),
        ("filter", "pgm.plot", None),
        ("network", "pgm.results", None),
        ("Nothing", "pgm", None),
        ("", None, None),
    ],
)
def test_a_bare_name_means_what_is_documented(name, module, due):
    assert place(name, module, KNOWN) == due
