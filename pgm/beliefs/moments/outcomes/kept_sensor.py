"""The beliefs of a sensor's measurements that are kept of a pass: ahead, and their innovations."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple, TypeVar

import numpy as np
import numpy.typing as npt

from pgm.beliefs.moments.outcomes.outcome import ChainOutcome
from pgm.display import NoArray, Shown, Summary
from pgm.errors import EvidenceError
from pgm.factors import Gaussian
from pgm.factors.scope import listed
from pgm.posteriors.belief_kind import PREDICTED, Kind
from pgm.posteriors.innovations import Innovations
from pgm.posteriors.measurements import one_row
from pgm.posteriors.posterior import require_variable
from pgm.variables import Variable

Kept = TypeVar("Kept", bound=np.generic)


class KeptSensor(NamedTuple):
    """A sensor's measurements before they are taken, and their innovations; None if not read."""

    predicted: Gaussian
    innovations: Innovations | None

    @classmethod
    def of(cls, found: ChainOutcome, sensor: Variable) -> KeptSensor:
        """The measurements and innovations of a posterior that has kept everything."""
        every = found.innovations
        return cls(found.predicted[sensor], dict(every).get(sensor))

    @classmethod
    def joined(cls, parts: Sequence[KeptSensor], lead: tuple[int, ...]) -> KeptSensor:
        """The measurements and innovations of all runs, of axes `lead`, from parts of the runs."""
        beliefs = [part.predicted for part in parts]
        first = beliefs[0]

        def runs(each: Sequence[npt.NDArray[Kept]], axes: int) -> npt.NDArray[Kept]:
            """Arrays of parts as one of all runs, whose last `axes` are not of runs."""
            own = each[0].shape[-axes:]
            rows = np.concatenate([array.reshape(-1, *own) for array in each])
            whole = rows.reshape(*lead, *own)
            whole.flags.writeable = False
            return whole

        mean, cov = runs([b.mean for b in beliefs], 2), runs([b.cov for b in beliefs], 3)
        predicted = Gaussian._make(first.scope, mean, cov, first.steps)
        found = [part.innovations for part in parts if part.innovations is not None]
        if not found:
            return cls(predicted, None)
        axes: dict[str, int] = {"residual": 2, "cov": 3, "nis": 1, "dof": 1, "rejected": 1}
        each: dict[str, Any] = {
            name: runs([getattr(one, name) for one in found], count) for name, count in axes.items()
        }
        return cls(predicted, replace(found[0], **each))


class KeptPredictions(Shown, NoArray):
    """The beliefs of measurements before they are taken, of the sensors that were kept."""

    kind: Kind = PREDICTED

    def __init__(self, kept: dict[Variable, Gaussian]) -> None:
        self._kept = kept

    def __getitem__(self, variable: Variable) -> Gaussian:
        """The belief of a sensor's measurement, ``z`` by row or ``z.at(3)``."""
        template = require_variable(variable).template
        if template not in self._kept:
            raise EvidenceError(
                f"predicted[{variable!r}] was not kept, but those of the measurements "
                f"[{listed(self._kept)}] were: put a sensor into keep=; the predicted marginals of "
                "hidden variables are kept without keep= alone",
                variable=variable,
            )
        found = self._kept[template]
        if variable.step is None:
            return found
        assert found.steps is not None
        row = one_row(found.steps, variable)
        return Gaussian._make((variable,), found.mean[..., row, :], found.cov[..., row, :, :])

    @property
    def _title(self) -> str:
        runs = {math.prod(found.mean.shape[:-2]) for found in self._kept.values()}
        return f"Predicted(kept [{listed(self._kept)}], {max(runs, default=1):,} runs)"

    def _summary(self) -> Summary:
        return Summary(self._title, [f"{v!r}: {g._title}" for v, g in self._kept.items()])
