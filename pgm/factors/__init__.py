"""Factors: the canonical form, its moment form, and affine Gaussian conditionals."""

from pgm.factors.affine import AffineGaussian
from pgm.factors.canonical import CanonicalForm
from pgm.factors.gaussian import Ellipse, Gaussian

__all__ = ["AffineGaussian", "CanonicalForm", "Ellipse", "Gaussian"]
