"""Iterations that are not to settle: of an experiment that says in its tables how far they went."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from contextlib import contextmanager

import pgm


@contextmanager
def unsettled() -> Iterator[None]:
    """Without a `ConvergenceWarning`, also as a decorator."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", pgm.ConvergenceWarning)
        yield
