"""Factors: canonical form, its moment form, affine Gaussian conditionals; tables."""

from pgm.factors.affine import AffineGaussian
from pgm.factors.canonical import CanonicalForm
from pgm.factors.gaussian import Ellipse, Gaussian
from pgm.factors.gaussian_mixture import GaussianMixture
from pgm.factors.table import Table

__all__ = ["AffineGaussian", "CanonicalForm", "Ellipse", "Gaussian", "GaussianMixture", "Table"]
