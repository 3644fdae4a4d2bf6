"""The outcome of a bound call."""

from __future__ import annotations

from dataclasses import fields
from functools import cached_property
from typing import Any

from pgm.beliefs.moments.bound.call import Made
from pgm.beliefs.moments.outcomes.outcome import ChainOutcome
from pgm.beliefs.moments.passes.backward import Beliefs
from pgm.beliefs.moments.passes.forward import Filtered, Forward
from pgm.beliefs.moments.steps.plan import ChainPlan
from pgm.compile import DynamicGraph
from pgm.posteriors.belief_kind import SMOOTHED, Kind
from pgm.posteriors.status import Status


class BoundOutcome(ChainOutcome):
    """The outcome of a bound call, whose parts are made when they are asked for."""

    _made: Made
    _closest: float

    @classmethod
    def of(
        cls, graph: DynamicGraph, status: Status, kind: Kind, made: Made, closest: float
    ) -> BoundOutcome:
        """The outcome of a call; `closest` is the least share of a variance on its way."""
        found = object.__new__(cls)  # whose other fields are found below
        parts = {"graph": graph, "status": status, "kind": kind, "associations": {}}
        parts["_reverse_given"] = None  # it is made when it is asked for
        smoothed = made.beliefs if kind == SMOOTHED else None
        own = {"_made": made, "_closest": closest, "_lead": made.evidence.lead}
        found.__dict__.update(parts, _smoothed=smoothed, **own)
        return found

    @cached_property
    def _planned(self) -> ChainPlan:  # type: ignore[override]  # frozen there
        return self._made.swept

    @cached_property
    def _swept(self) -> Forward | Filtered:
        return self._made.forward(self._closest)

    @property
    def _beliefs(self) -> Beliefs:
        return self._made.beliefs

    def __reduce__(self) -> tuple[Any, ...]:
        # What is bound to memory of this process stays there.
        return ChainOutcome, tuple(getattr(self, each.name) for each in fields(ChainOutcome))
