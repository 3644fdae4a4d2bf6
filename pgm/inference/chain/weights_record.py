"""The weights of sightings as results show them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from pgm.display import Shown, Summary, number
from pgm.errors import EvidenceError
from pgm.factors.scope import listed
from pgm.inference.chain.plan import ChainPlan
from pgm.inference.chain.weights import shown
from pgm.inference.posterior import require_variable
from pgm.kernels.arrays import Array
from pgm.variables import Variable

# Below this share of a Gaussian's information a sighting is counted as one hardly used.
_HARDLY = 0.1


class Weights(Shown, Mapping[Variable, Array]):
    """The weights of each sensor that was read, (*runs, M)."""

    def __init__(self, weights: Mapping[Variable, Array]) -> None:
        self._weights = dict(weights)

    @classmethod
    def of(cls, plan: ChainPlan) -> Weights:
        """The weights of a plan, in the order of the evidence."""
        found = {}
        for sensor in plan.sensors:
            weight = sensor.weights.weight if sensor.robust else np.ones(sensor.family.shape[:2])
            rows = np.broadcast_to(shown(weight, sensor.taken), weight.shape)
            back = np.argsort(sensor.order)
            each = rows[back].swapaxes(0, 1).reshape(*plan.lead, len(back))
            each.flags.writeable = False
            found[sensor.variable] = each
        return cls(found)

    def __getitem__(self, variable: Variable) -> Array:
        if require_variable(variable) not in self._weights:
            raise EvidenceError(
                f"there are no weights of {variable!r}; measurements were given of {list(self)}",
                variable=variable,
            )
        return self._weights[variable]

    def __contains__(self, variable: object) -> bool:
        return variable in self._weights

    def __iter__(self) -> Iterator[Variable]:
        return iter(self._weights)

    def __len__(self) -> int:
        return len(self._weights)

    @property
    def _title(self) -> str:
        return f"Weights({listed(self._weights)})"

    def _summary(self) -> Summary:
        lines = []
        for variable, weight in self._weights.items():
            seen = weight[~np.isnan(weight)]
            if not seen.size:
                lines.append(f"{variable!r}: nothing read")
                continue
            few = int((seen < _HARDLY).sum())
            lines.append(
                f"{variable!r}: {number(seen.min())} to {number(seen.max())}, median "
                f"{number(float(np.median(seen)))}; {few} of {seen.size} below {_HARDLY}"
            )
        return Summary(self._title, lines)


def evidence_kind(plan: ChainPlan, *, fixed: bool) -> str:
    """The kind of a log-evidence, of a plan linearised where a smoother settled or elsewhere."""
    affine = all(family.exact for family in plan.families)
    if not plan.robust:
        taylor = all(family.taylor for family in plan.families)
        return "exact" if affine else "laplace" if fixed and taylor else "linearised"
    for sensor in plan.robust:
        noise = sensor.family.cpd.noise
        if noise is not None and not noise.is_proper(sensor.height):
            return "unnormalised"
    return "bound" if affine else "linearised bound"
