"""Plans of elimination: which factors are multiplied, and which variables each product loses.

A *factor* is whatever has a scope: a table, the weights of evidence, a message, a Gaussian. A plan
knows of factors nothing but their scopes, and of variables nothing but their numbers of states, by
which it tells how large the products get. Factors are numbered: first those that are given, then
the results of the steps, one each, in their order.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

# A variable, told by a number.
Label = int
# The variables of a factor, in the order of its axes.
Scope = tuple[Label, ...]


class Step(NamedTuple):
    """A product of factors, which then loses variables: their states are summed or maximised over.

    factors: The numbers of the factors, in the order in which they are multiplied. Each result of
        a step is a factor of one later step at most.
    scopes: The scopes of these factors.
    scope: The variables of the product, in the order of its axes.
    left: Those of the result, in the order that they have in `scope`.
    axis: The axis of the first of two factors along which the second is applied as a matrix; it
        becomes one of the second's other variable. −1 of a product.
    """

    factors: tuple[int, ...]
    scopes: tuple[Scope, ...]
    scope: Scope
    left: Scope
    axis: int = -1


def joint_states(scope: Scope, sizes: Mapping[Label, int] | Sequence[int]) -> int:
    """The number of joint states of some variables, of their numbers of states."""
    return math.prod([sizes[x] for x in scope])


@dataclass(frozen=True, eq=False)
class Plan:
    """A plan of elimination: steps that make one factor out of many, over the variables wanted.

    scopes: The scopes of the factors given.
    sizes: The number of states of each variable, by label.
    steps: In turn. A result that no later step takes is one of the plan's: of a plan for one joint
        that is the last step's, of a plan for several trees one is each root's.
    wanted: The variables of the last result, in the order of its axes as the caller wants them. One
        that no factor has, so that all its states are alike, may be among them.
    """

    scopes: Sequence[Scope]
    sizes: Mapping[Label, int] | Sequence[int]
    steps: Sequence[Step]
    wanted: Scope

    @cached_property
    def roots(self) -> list[int]:
        """The steps whose results no step takes, by number: of several trees, one of each."""
        first = len(self.scopes)
        taken = {k - first for step in self.steps for k in step.factors if k >= first}
        return [number for number in range(len(self.steps)) if number not in taken]

    @cached_property
    def maps(self) -> frozenset[int]:
        """The numbers of the factors given that are applied as matrices along an axis."""
        return frozenset(step.factors[1] for step in self.steps if step.axis >= 0)

    def entries(self, scope: Scope) -> int:
        """The number of joint states of some variables."""
        return joint_states(scope, self.sizes)

    @cached_property
    def products(self) -> list[int]:
        """The number of entries of each step's product, before variables leave it."""
        return [self.entries(step.scope) for step in self.steps]

    @cached_property
    def largest(self) -> int:
        """The number of entries of the largest result of a step; 1 if there are no steps."""
        return max((self.entries(step.left) for step in self.steps), default=1)

    @cached_property
    def cost(self) -> int:
        """The number of entries of all products together."""
        return sum(self.products)

    @cached_property
    def peak(self) -> int:
        """The most entries that factors held at the same time have together, those given apart.

        They are the product of one step and the results of earlier steps that wait to be taken.
        """
        first = len(self.scopes)
        waiting: dict[int, int] = {}
        held = peak = 0
        for number, (step, entries) in enumerate(zip(self.steps, self.products, strict=True)):
            peak = max(peak, held + entries)
            held -= sum(waiting.pop(factor - first, 0) for factor in step.factors)
            waiting[number] = self.entries(step.left)
            held += waiting[number]
        return peak
