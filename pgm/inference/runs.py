"""CPDs that have axes of runs themselves, laid out as the evidence is."""

from __future__ import annotations

from typing import TypeVar

import numpy as np

from pgm.cpds import CPD, GaussianCPD, MixtureCPD

C = TypeVar("C", bound=CPD)


def by_run(cpd: C, lead: tuple[int, ...]) -> C:
    """A CPD whose own axes of runs, if it has any, are all those of the evidence."""
    if isinstance(cpd, GaussianCPD) and cpd._lead():
        assert isinstance(cpd.cov, np.ndarray)
        size = cpd.child.dimension
        mean = np.broadcast_to(cpd.mean, (*lead, size))
        cov = np.broadcast_to(cpd.cov, (*lead, size, size))
        return GaussianCPD(cpd.child, mean, cov)  # type: ignore[return-value]
    if isinstance(cpd, MixtureCPD) and cpd._lead():
        return cpd._with(tuple(by_run(part, lead) for part in cpd.parts))
    return cpd
