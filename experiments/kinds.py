"""Posteriors and beliefs of the kind that a network leads to."""

from __future__ import annotations

import pgm

Factor = pgm.Gaussian | pgm.GaussianMixture | pgm.CanonicalForm | pgm.Table


def as_gaussian(factor: Factor) -> pgm.Gaussian:
    """A marginal or joint of a continuous network."""
    assert isinstance(factor, pgm.Gaussian)
    return factor


def as_form(factor: Factor) -> pgm.CanonicalForm:
    """A message or belief of a continuous network."""
    assert isinstance(factor, pgm.CanonicalForm)
    return factor


def as_table(factor: Factor) -> pgm.Table:
    """Anything of a discrete network."""
    assert isinstance(factor, pgm.Table)
    return factor
