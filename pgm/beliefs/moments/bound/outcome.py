"""The outcome of a bound call."""

from __future__ import annotations

from dataclasses import fields
from functools import cached_property
from typing import Any

from pgm.beliefs.moments.bound.call import Made
from pgm.beliefs.moments.bound.passes import Went
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
    _went: Went

    @classmethod
    def of(
        cls, graph: DynamicGraph, status: Status, kind: Kind, made: Made, went: Went
    ) -> BoundOutcome:
        """The outcome of a call whose sweeps `went` so."""
        found = object.__new__(cls)  # whose other fields are found below
        parts = {"graph": graph, "status": status, "kind": kind, "associations": {}}
        parts["_reverse_given"] = None  # it is made when it is asked for
        smoothed = made.beliefs if kind == SMOOTHED else None
        own = {"_made": made, "_went": went, "_lead": made.evidence.lead}
        found.__dict__.update(parts, _smoothed=smoothed, **own)
        return found

    @cached_property
    def _planned(self) -> ChainPlan:  # type: ignore[override]  # frozen there
        return self._made.swept

    @cached_property
    def _swept(self) -> Forward | Filtered:  # type: ignore[override]  # frozen there
        return self._made.forward(*self._went)

    @property
    def _held(self) -> bool | None:
        return None if self.associations else self._went.held

    def _misfit(self) -> str:
        return ""  # the call before was not bound, and has looked

    @property
    def _beliefs(self) -> Beliefs:
        return self._made.beliefs

    def __reduce__(self) -> tuple[Any, ...]:
        # What is bound to memory of this process stays there.
        return ChainOutcome, tuple(getattr(self, each.name) for each in fields(ChainOutcome))
