"""A cluster graph's place for the plans that the layers above compile from it."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from typing import Any, TypeVar

from pgm.immutable import Immutable

T = TypeVar("T")

# Plans that a graph keeps: one for each set of observed variables that is asked about in turn.
PLANS_KEPT = 32


class Deriving(Immutable):
    """Base of graphs, which keep the latest plans that were made of them."""

    def derived(self, make: Callable[..., T], *key: Any) -> T:
        """The result of a function of this graph and a key, made once.

        The place of plans that the layers above compile from the structure; the latest are kept.

        Parameters
        ----------
        make : callable
            ``make(graph, *key)``.
        *key : hashable

        Returns
        -------
        object
            The result of that call.
        """
        plans = self._derived
        found: T = plans.pop((make, key)) if (make, key) in plans else make(self, *key)
        plans[make, key] = found
        if len(plans) > PLANS_KEPT:
            del plans[next(iter(plans))]
        return found

    @cached_property
    def _derived(self) -> dict[Any, Any]:
        return {}

    def __getstate__(self) -> dict[str, Any]:
        return {k: v for k, v in super().__getstate__().items() if k != "_derived"}
