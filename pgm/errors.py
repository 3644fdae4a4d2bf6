"""Errors and warnings: each names the object, the step, what was found, what to do."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any


class PgmError(Exception):
    """Base of all errors of this library.

    Parameters
    ----------
    message : str
        What was found and what to do about it.
    variable, cpd, cluster, step, run : optional
        The objects concerned, for programs that handle the error; a run is counted from 0. They
        are attributes, None where not given.
    """

    def __init__(
        self,
        message: str,
        *,
        variable: Any = None,
        cpd: Any = None,
        cluster: Any = None,
        step: int | None = None,
        run: int | None = None,
    ) -> None:
        super().__init__(message)
        self.variable = variable
        self.cpd = cpd
        self.cluster = cluster
        self.step = step
        self.run = run


class ModelError(PgmError, ValueError):
    """A variable, factor, CPD or network that is not well formed.

    Parameters and attributes are those of a `PgmError`; it is a `ValueError` too.
    """


class GraphError(PgmError, ValueError):
    """A cluster graph that is not valid, or one asked for something it does not have.

    Parameters and attributes are those of a `PgmError`; it is a `ValueError` too.
    """


class FileError(PgmError, ValueError):
    """A file that cannot be read as what it should be.

    Parameters
    ----------
    message : str
        What was found and what to do about it.
    path, line : optional
        The file, where it has a name, and the line of it, from 1.
    """

    def __init__(self, message: str, *, path: str | None = None, line: int | None = None) -> None:
        super().__init__(message)
        self.path = path
        self.line = line


class EvidenceError(PgmError, ValueError):
    """Evidence that does not fit the model.

    Parameters and attributes are those of a `PgmError`; it is a `ValueError` too.
    """


class LinearisationError(PgmError, ValueError):
    """A function or lineariser that gives values that cannot be used.

    Parameters and attributes are those of a `PgmError`; it is a `ValueError` too.
    """


class NumericalError(PgmError, ArithmeticError):
    """A quantity that does not exist for these numbers, like the inverse of a singular matrix.

    Parameters and attributes are those of a `PgmError`; it is an `ArithmeticError` too.
    """


class ArrayError(PgmError, TypeError):
    """A value that was taken for an array, like a belief handed to `numpy.asarray`.

    Parameters and attributes are those of a `PgmError`; it is a `TypeError` too.
    """


class ExecutorError(PgmError, RuntimeError):
    """An executor that takes no work, or loses what it was handed.

    Parameters
    ----------
    message : str
        What was found and what to do about it.
    runs : sequence of (int, int), optional
        The runs that were lost: the first of each row of them, and that after its last.
    **where
        As of a `PgmError`.
    """

    def __init__(self, message: str, *, runs: Sequence[tuple[int, int]] = (), **where: Any) -> None:
        super().__init__(message, **where)
        self.runs = tuple(runs)


class PrecisionWarning(UserWarning):
    """An answer of which rounding leaves few digits; ``status.digits`` says how many."""


class GridWarning(UserWarning):
    """A grid's answer that is not what the model says; the status says by how much."""


class ParticleWarning(UserWarning):
    """A particle filter's answer that rests on few particles; the status says on how many."""
