"""Gates: a sighting, one measurement of a sensor, is left out if its innovation is too large.

A gate is a probability: a sighting is taken in where νᵀS⁻¹ν, of its innovation ν with covariance S,
is within the χ² quantile of that probability. There is one gate for all sensors, or a mapping from
some of the sensors to their gates, or None: no gate.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from pgm.boundary import is_number
from pgm.errors import ModelError
from pgm.immutable import Immutable
from pgm.variables import Variable


class Gates(Immutable, Mapping[Variable, float]):
    """A hashable mapping from some sensors to their gates; sensors that it lacks have none."""

    _gates: dict[Variable, float]

    def __init__(self, gates: Mapping[Variable, float]) -> None:
        self._set(_gates=dict(gates))

    def __getitem__(self, sensor: Variable) -> float:
        return self._gates[sensor]

    def __iter__(self) -> Iterator[Variable]:
        return iter(self._gates)

    def __len__(self) -> int:
        return len(self._gates)

    def __hash__(self) -> int:
        return hash(frozenset(self._gates.items()))

    def __repr__(self) -> str:
        return repr(dict(self._gates))


Gate = float | Mapping[Variable, float] | None


def as_gate(owner: str, gate: object) -> float | Gates | None:
    """A gate as schedules keep it: None, a float, or `Gates`; any other value is refused.

    The error is a `ModelError`, whose text begins with `owner`.
    """
    if gate is None:
        return None
    if not isinstance(gate, Mapping):
        return _probability(owner, gate, "")
    for sensor in gate:
        if not isinstance(sensor, Variable):
            raise ModelError(
                f"{owner}: gate= maps sensors' variables to probabilities, not {sensor!r}"
            )
    return Gates({sensor: _probability(owner, p, f" of {sensor!r}") for sensor, p in gate.items()})


def _probability(owner: str, value: object, of: str) -> float:
    """One gate as a float above 0 and below 1; any other value is refused.

    The error is a `ModelError`, whose text begins with `owner`. After the words "a gate" the text
    has `of`: " of " and the sensor's repr, or "" for the gate of all sensors.
    """
    if not is_number(value) or not 0.0 < value < 1.0:
        none = "left out for no gate" if of else "or None for no gate"
        raise ModelError(
            f"{owner}: a gate{of} is a probability between 0 and 1, such as 0.99, {none}; found "
            f"{value!r}"
        )
    return float(value)


def gate_of(gate: Gate, sensor: Variable) -> float | None:
    """The gate of one sensor; None where it has none."""
    return gate.get(sensor) if isinstance(gate, Mapping) else gate
