"""The weights of sightings as results show them."""

from __future__ import annotations

import numpy as np

from pgm.display import Summary, number
from pgm.inference.chain.plan import ChainPlan
from pgm.inference.chain.weights import shown
from pgm.inference.posterior import EachSensor
from pgm.kernels.arrays import Array

# Below this share of a Gaussian's information a sighting is counted as one hardly used.
_HARDLY = 0.1


class Weights(EachSensor[Array]):
    """The weights of each sensor that was read, (*runs, M)."""

    _what = "weights"

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

    def _summary(self) -> Summary:
        lines = []
        for variable, weight in self.items():
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
