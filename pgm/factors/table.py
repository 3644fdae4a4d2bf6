"""Discrete factors: tables."""

from __future__ import annotations

from pgm.immutable import Immutable


class Table(Immutable):
    """A non-negative array times exp(log_scale)."""
