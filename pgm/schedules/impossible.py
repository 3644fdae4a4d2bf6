"""Evidence of probability zero: the error that refuses it, and the argument that allows it."""

from __future__ import annotations

from typing import Any

import numpy as np

from pgm.errors import EvidenceError, ModelError
from pgm.kernels.arrays import Mask

RAISE, ALLOW = "raise", "allow"

# What the user can do besides where there are several runs, whichever function raised the error.
OF_RUNS = (
    f'; pgm.infer and pgm.query with impossible="{ALLOW}" give such runs a log-evidence of −∞ and '
    "beliefs of NaN"
)
# The same over time.
OVER_TIME = (
    f'; pgm.filter, pgm.smooth and pgm.infer with impossible="{ALLOW}" give such runs a '
    "log-evidence of −∞, and NaN for the beliefs that know this measurement"
)


def allows(impossible: object) -> bool:
    """Whether impossible evidence is allowed, from the user's ``"raise"`` or ``"allow"``.

    Any other value raises `ModelError`.
    """
    if impossible not in (RAISE, ALLOW):
        raise ModelError(f'impossible is "{RAISE}" or "{ALLOW}", not {impossible!r}')
    return impossible == ALLOW


class ImpossibleEvidence(EvidenceError):
    """The error for evidence of probability zero in some runs, which `lost`, (runs,), marks.

    On a chain a run is marked if its measurements up to the error's `step` have probability zero.
    `lead` is the shape of the user's axes of runs. The error's `run` is the first marked one, as
    its number among all runs, counted through along these axes; None if there are no such axes.
    `where` has the error's other attributes by name, as `PgmError` takes them.
    """

    def __init__(self, message: str, lost: Mask, lead: tuple[int, ...], **where: Any) -> None:
        run = int(lost.argmax()) if lead else None
        super().__init__(message, run=run, **where)
        self.lost = np.atleast_1d(lost)
