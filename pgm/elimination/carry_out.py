"""Carrying a plan of elimination out, for factors of any kind.

An *algebra* multiplies the factors of a step and sums variables out of the product. Factors are
numbered as in a `Plan`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Sequence
from typing import Generic, TypeVar

from pgm.elimination.plan import Plan, Scope, Step

F = TypeVar("F")


class Algebra(ABC, Generic[F]):
    """The arithmetic of one kind of factor."""

    @abstractmethod
    def product(self, step: Step, factors: Sequence[F]) -> F:
        """The product of a step's factors, over ``step.scope``."""

    @abstractmethod
    def total(self, product: F, scope: Scope, left: Scope) -> F:
        """The sum of a factor over a scope to the variables `left`, in the scope's order."""

    def made(self, step: Step, factors: Sequence[F]) -> F:
        """The result of a step, of which the product itself is not kept."""
        return self.total(self.product(step, factors), step.scope, step.left)

    def arranged(self, factor: F, scope: Scope, wanted: Scope) -> F:
        """A factor over a scope, as one over the variables wanted, in their order."""
        raise NotImplementedError

    def joint(self, step: Step, product: F, total: F, outside: F | None) -> F:
        """The joint of a step's variables given everything, from that of the variables left.

        It is ``product / total``, which is p(those that leave | those left), times `outside`, the
        joint of ``step.left``; zero where the total is zero. It is None of a root, which leaves
        nothing.
        """
        raise NotImplementedError


def results(
    plan: Plan, given: Callable[[int], F] | Sequence[F], algebra: Algebra[F]
) -> Iterator[F]:
    """The result of each step of a plan, in turn.

    `given` has the factors by number, or makes each when it is asked for, once. A result is let go
    of when a later step takes it.
    """
    take = given if callable(given) else given.__getitem__
    first = len(plan.scopes)
    waiting: dict[int, F] = {}
    for number, step in enumerate(plan.steps, first):
        found = algebra.made(step, [take(k) if k < first else waiting.pop(k) for k in step.factors])
        yield found
        waiting[number] = found


def eliminate(plan: Plan, given: Callable[[int], F] | Sequence[F], algebra: Algebra[F]) -> F:
    """The last result of a plan, over the variables that it wants; see `results`."""
    for found in results(plan, given, algebra):  # noqa: B007, used after the loop
        pass
    left = plan.steps[-1].left
    return found if left == plan.wanted else algebra.arranged(found, left, plan.wanted)


class Calibrated(Generic[F]):
    """The joints of each step's variables given all factors, of a plan of one tree or several.

    A junction tree is such a plan: its clusters are the scopes of the steps, its sepsets what the
    steps leave. Messages to the roots are the steps' results; those back are made by `back`.

    products, totals: Of each step, its product, and its result.
    """

    def __init__(self, plan: Plan, given: Sequence[F], algebra: Algebra[F]) -> None:
        self.plan, self.algebra = plan, algebra
        # By number: the factors given, then the results.
        held, products = [*given], list[F]()
        for step in plan.steps:
            product = algebra.product(step, [held[k] for k in step.factors])
            products.append(product)
            held.append(algebra.total(product, step.scope, step.left))
        self.products, self.totals = products, held[len(given) :]

    def back(self) -> Iterator[tuple[Step, F, F | None]]:
        """Each step, from the last one to the first, with its joint, and that of what it leaves.

        The latter is None of a root, whose result no step takes. This is done once: each product
        is let go of, since all of them take as much memory as all joints.
        """
        algebra, steps, first = self.algebra, self.plan.steps, len(self.plan.scopes)
        # Of each step whose result was taken, the joint of what it leaves.
        waiting: dict[int, F] = {}
        for number in range(len(steps) - 1, -1, -1):
            step, outside = steps[number], waiting.pop(number, None)
            joint = algebra.joint(step, self.products.pop(), self.totals.pop(), outside)
            for factor in step.factors:
                if factor >= first:
                    child = factor - first
                    waiting[child] = algebra.total(joint, step.scope, steps[child].left)
            yield step, joint, outside
