"""Variables, CPDs and statuses as the page names them."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np

from pgm.cpds import CPD
from pgm.inference import Status
from pgm.variables import Discrete, Variable


def variable(given: Variable) -> dict[str, Any]:
    """A variable: its name, components and angles, or states."""
    if isinstance(given, Discrete):
        return {"name": repr(given), "states": list(given.states)}
    return {
        "name": repr(given),
        "components": list(given.components),
        "angles": given.angle_mask.tolist(),
    }


def cpd(given: CPD, family: Iterable[Variable] | None = None) -> dict[str, Any]:
    """A CPD: its class, child and parents, each by name and by how many steps before it stands.

    Without a step of its own, a name holds for every step, as ``x`` of ``x[t-1]``.
    """
    child, *parents = (given.child, *given.parents) if family is None else tuple(family)
    return {
        "kind": type(given).__name__,
        "child": _place(child),
        "given": [_place(parent) for parent in parents],
    }


def _place(given: Variable) -> list[Any]:
    return [given.name if given.step is None else repr(given), given.lag]


def went(status: Status, run: int) -> dict[str, Any] | None:
    """The residuals of a schedule's iterations in one run; None where nothing was iterated."""
    residuals = np.asarray(status.residuals)
    if not len(residuals):
        return None
    each = residuals.reshape(len(residuals), -1)[:, run]
    return {
        "residuals": [number(value) for value in each],
        "converged": bool(np.asarray(status.converged).reshape(-1)[run]),
    }


def number(value: float) -> float | None:
    """A number of JSON, which knows no NaN and no infinity."""
    return float(value) if np.isfinite(value) else None


def listed(values: Iterable[float]) -> str:
    """Values of evidence, to six digits."""
    shown = [f"{value:.6g}" if np.isfinite(value) else "not taken" for value in values]
    return shown[0] if len(shown) == 1 else f"({', '.join(shown)})"
