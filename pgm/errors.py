"""Errors and warnings: each names the object, the step, what was found, what to do."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from typing import Any


class PgmError(Exception):
    """Base of all errors of this library.

    Arguments that are not as a docstring describes them are refused before any work begins, with a
    `ModelError`, `GraphError` or `EvidenceError`; sections "Raises" list what else can happen. The
    objects concerned are attributes, None where not given: `variable`, `cpd`, `cluster`, `step`,
    and `run`, counted from 0.
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
    """A variable, factor, CPD, schedule or network is not well formed; also a `ValueError`."""


class GraphError(PgmError, ValueError):
    """A cluster graph is not valid, or lacks what is asked of it; also a `ValueError`."""


class FileError(PgmError, ValueError):
    """A file cannot be read in the format expected; also a `ValueError`.

    Its attributes are `path`, where the file has a name, and `line`, counted from 1.
    """

    def __init__(self, message: str, *, path: str | None = None, line: int | None = None) -> None:
        super().__init__(message)
        self.path = path
        self.line = line


class EvidenceError(PgmError, ValueError):
    """Evidence that does not fit the model; a `ValueError` too."""


class Unanswered(EvidenceError, AttributeError):
    """A question without answer in a family; an `AttributeError` too: `hasattr` says False."""


class LinearisationError(PgmError, ValueError):
    """A function or lineariser that gives values that cannot be used; a `ValueError` too."""


class NumericalError(PgmError, ArithmeticError):
    """A quantity that does not exist, like a singular inverse; an `ArithmeticError` too."""


class ArrayError(PgmError, TypeError):
    """A value taken for an array, like a belief handed to `numpy.asarray`; a `TypeError` too."""


class ExecutorError(PgmError, RuntimeError):
    """An executor refuses work, or loses a result; also a `RuntimeError`.

    Its attribute `runs` has those that were lost: of each row the first and the one after it.
    """

    def __init__(self, message: str, *, runs: Sequence[tuple[int, int]] = (), **where: Any) -> None:
        super().__init__(message, **where)
        self.runs = tuple(runs)


class EvidenceWarning(UserWarning):
    """Evidence taken as its shape says, where another meaning is likelier; it says how to ask."""


class PrecisionWarning(UserWarning):
    """Rounding leaves few correct digits; ``status.digits`` says how many."""


class ConvergenceWarning(UserWarning):
    """An iteration that ended before it settled; ``status`` says how far from that it was.

    A tolerance of 0 asks for just so many iterations, of which nothing is told unless they diverge.
    """


class LostWarning(UserWarning):
    """A belief that innovations or gates say is wrong; ``posterior.lost`` says where."""


class LinearisationWarning(UserWarning):
    """Functions that bend too much over a belief for any line; ``posterior.nonlinearity`` says how.

    The first call of a model by a rule looks for them, at the steps with the widest beliefs. A call
    of more than 20,000 steps, of all runs together, does not look, nor one that has given a
    `LostWarning`; a filter of eight or more runs tells in ``print`` alone.
    """


class GridWarning(UserWarning):
    """A grid's answer differs from the model's; the status says by how much."""


class ParticleWarning(UserWarning):
    """A particle filter's answer that rests on few particles; the status says on how many."""


class BeliefWarning(UserWarning):
    """A belief family's own figure beyond its threshold; ``status.numbers`` has all of them."""


def levels_to_user() -> int:
    """The number of calls up to a user's own line, for a warning to point at."""
    frame, levels = sys._getframe(1), 1
    while frame.f_back is not None:
        name = frame.f_globals.get("__name__", "")
        # contextlib and NumPy's errstate stand in decorators.
        if not name.startswith(("pgm.", "numpy.")) and name != "contextlib":
            break
        frame, levels = frame.f_back, levels + 1
    return levels
