"""Plans of elimination by an order: of the variables that leave, or of the factors that enter.

Variables are labels, and factors numbers, as in a `Plan`.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence

from pgm.compile.elimination import Adjacency, min_fill
from pgm.elimination.plan import Label, Plan, Scope, Step, joint_states

# From this cost of a plan on, a second order is tried: that takes less time than it may save.
LARGE = 2**16


def by_fill(
    scopes: Sequence[Scope], sizes: Sequence[int], wanted: Collection[Label]
) -> tuple[list[Label], Plan]:
    """The order of min-fill, the variables wanted last, and the plan that sums out in this order.

    scopes: The scopes of the factors, in any order.
    sizes: The number of states of each variable; their labels are its indices.

    Fill is weighted by the numbers of states. If the plan's products together have more than 2¹⁶
    entries, plain fill is tried too, and the plan of fewer entries is taken. The plan tells a
    variable by its place in the order that is returned.
    """
    adjacent: list[set[Label]] = [set() for _ in sizes]
    for scope in scopes:
        for x in scope:
            adjacent[x].update(scope)
    for x, near in enumerate(adjacent):
        near.discard(x)
    best = _ordered(scopes, adjacent, sizes, sizes, wanted)
    if best[1].cost > LARGE:
        plain = _ordered(scopes, adjacent, sizes, [1] * len(sizes), wanted)
        best = min(best, plain, key=lambda each: each[1].cost)
    return best


def _ordered(
    scopes: Sequence[Scope],
    adjacent: Adjacency,
    sizes: Sequence[int],
    weights: Sequence[int],
    wanted: Collection[Label],
) -> tuple[list[Label], Plan]:
    """The order of min-fill with some weights of the variables, and its plan; see `by_fill`."""
    stages = [0] * len(sizes)
    for x in wanted:
        stages[x] = 1
    order = min_fill(adjacent, weights, stages)
    place = [0] * len(order)
    for k, x in enumerate(order):
        place[x] = k
    turned = [tuple(sorted([place[x] for x in scope])) for scope in scopes]
    return order, in_order(turned, [sizes[x] for x in order], len(order) - len(wanted))


def in_order(scopes: Sequence[Scope], sizes: Sequence[int], out: int) -> Plan:
    """The plan that sums variables out in the order of their labels, the first `out` of them.

    scopes: The scopes of the factors, of ascending labels; each scope has a variable.
    sizes: The number of states of each variable.

    That is bucket elimination (Dechter, 1999). Each variable that leaves has a bucket, and each
    factor waits in that of its first variable. A step multiplies the factors of a bucket, the
    smallest first, and its result goes on to a later bucket. One that is alone in its bucket has
    lost one more variable already, by the step that made it. The last step multiplies what is left,
    over variables that stay. All axes follow the labels, so that none is ever turned, and sums are
    over the first ones.
    """
    buckets: list[list[int]] = [[] for _ in range(out + 1)]
    held = list(scopes)
    for factor, scope in enumerate(held):
        buckets[min(scope[0], out)].append(factor)
    first = len(held)
    made: list[Step] = []
    plan = Plan(scopes, sizes, made, tuple(range(out, len(sizes))))

    def product(factors: Sequence[int], scope: Scope, left: Scope) -> Step:
        """A step of some factors, the smallest first."""
        turn = sorted(factors, key=lambda factor: plan.entries(held[factor]))
        return Step(tuple(turn), tuple([held[factor] for factor in turn]), scope, left)

    for place in range(out):
        found = buckets[place]
        if len(found) == 1 and found[0] >= first:
            factor = found[0]
            held[factor] = held[factor][1:]
            old = made[factor - first]
            made[factor - first] = Step(old.factors, old.scopes, old.scope, held[factor])
        else:
            scope = tuple(sorted({x for factor in found for x in held[factor]}))
            factor = len(held)
            made.append(product(found, scope, scope[1:]))
            held.append(scope[1:])
        left = held[factor]
        buckets[min(left[0], out) if left else out].append(factor)
    made.append(product(buckets[out], plan.wanted, plan.wanted))
    return plan


def next_smallest(
    scopes: Sequence[Scope],
    wanted: Scope,
    sizes: Mapping[Label, int],
    maps: Sequence[bool] = (),
    *,
    back: bool = False,
) -> Plan:
    """The plan that multiplies the first factor by the others, one a step, as it stays smallest.

    Next comes the factor after which the product has the fewest entries. A variable leaves with the
    last factor that has it, unless it is wanted.

    scopes: The scopes of the first factor, and of the tables p(child | parents) after it: the
        parents, then the child.
    maps: Of each table, whether it may be a *map*, a matrix that is applied along the parent's axis
        of the product, which becomes the child's, or, with `back`, along the child's. It is one
        where that variable leaves, and the other is new: a step of two factors, which ends in the
        axes that it began with, but one.
    """
    array, *tables = scopes
    waiting = dict(enumerate(tables, 1))
    may = dict(enumerate(maps, 1))
    known = {x for table in tables for x in table}
    steps: list[Step] = []
    before = tuple(x for x in array if x in known or x in wanted)
    taken = 0
    if before != array or not tables:
        steps.append(Step((0,), (array,), array, before))
        taken = len(scopes)
    while waiting:
        found = [_next(k, before, waiting, wanted, may.get(k, False), back) for k in waiting]
        best = min(found, key=lambda step: joint_states(step.left, sizes))
        factor = best.factors[1]
        steps.append(best._replace(factors=(taken, factor)))
        before, taken = best.left, len(scopes) + len(steps) - 1
        del waiting[factor]
    return Plan(scopes, sizes, steps, wanted)


def _next(
    factor: int,
    before: Scope,
    waiting: Mapping[int, Scope],
    wanted: Scope,
    may: bool,
    back: bool,
) -> Step:
    """The step that multiplies one table in, as a map if it can be one.

    before: The variables of the product so far.
    waiting: The scopes of the tables still to come, this one included.
    may: Whether the table may be a map.
    """
    own = waiting[factor]
    needed = {x for k, scope in waiting.items() if k != factor for x in scope}.union(wanted)
    scope, axis = tuple(dict.fromkeys((*before, *own))), -1
    if may and len(own) == 2:
        gone, new = reversed(own) if back else own
        if gone in before and gone not in needed and new not in before:
            axis = before.index(gone)
            scope = (*before[: axis + 1], new, *before[axis + 1 :])
    left = tuple(x for x in scope if x in needed)
    return Step((0, factor), (before, own), scope, left, axis)
