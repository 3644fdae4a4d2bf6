"""The result of learning."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from pgm.kernels.arrays import Array


@dataclass(frozen=True)
class FitStatus:
    iterations: int
    e_steps: int
    accepted: int
    refused: int
    halved: int
    converged: bool
    reason: str


@dataclass(frozen=True, eq=False)
class Fit:
    model: Any
    parameters: Any
    log_evidence: Array
    posterior: Any
    status: FitStatus
