"""Plans of elimination against the product of all factors, made whole by NumPy."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pgm.elimination import (
    Calibrated,
    Plan,
    Step,
    TableAlgebra,
    by_fill,
    eliminate,
    in_order,
    next_smallest,
    results,
)
from pgm.kernels.semirings import LOG_SUM_PRODUCT, MAX_PRODUCT, SUM_PRODUCT

SEMIRINGS = {"sum": SUM_PRODUCT, "log": LOG_SUM_PRODUCT, "max": MAX_PRODUCT}


@st.composite
def problems(draw):
    """Draw factors over some variables, each variable in one factor at least, and those wanted."""
    count = draw(st.integers(1, 6))
    sizes = draw(st.lists(st.integers(1, 3), min_size=count, max_size=count))
    labels = st.integers(0, count - 1)
    scopes = draw(st.lists(st.sets(labels, min_size=1, max_size=3), min_size=1, max_size=5))
    missing = set(range(count)).difference(*scopes)
    scopes = [draw(st.permutations(sorted(scope))) for scope in [*scopes, *({x} for x in missing)]]
    wanted = draw(st.sets(labels, min_size=1))
    seed = draw(st.integers(0, 2**16))
    return [tuple(scope) for scope in scopes], sizes, sorted(wanted), seed


def drawn(scopes, sizes, seed, runs=()):
    """Draw a table for each scope, some of them zero here and there."""
    rng = np.random.default_rng(seed)
    found = []
    for scope in scopes:
        shape = (*(sizes[x] for x in scope), *runs)
        found.append(rng.random(shape) * (rng.random(shape) < 0.9))
    return found


def dense(scopes, sizes, tables, wanted, *, by="sum"):
    """The product of all tables, with an axis for each variable, summed to those wanted."""
    runs = max(table.shape[len(scope) :] for scope, table in zip(scopes, tables, strict=True))
    whole = np.ones((*sizes, *runs))
    for scope, table in zip(scopes, tables, strict=True):
        turned = table.transpose(*np.argsort(scope), *range(len(scope), table.ndim))
        shape = [sizes[x] if x in scope else 1 for x in range(len(sizes))]
        whole = whole * turned.reshape(*shape, *(table.shape[len(scope) :] or (1,) * len(runs)))
    gone = tuple(x for x in range(len(sizes)) if x not in wanted)
    return whole.max(axis=gone) if by == "max" else whole.sum(axis=gone)


def entered(tables, semiring):
    return [semiring.entries(table) for table in tables]


def left(table, semiring):
    return table if semiring.linear else np.exp(table)


@given(problems(), st.sampled_from(sorted(SEMIRINGS)))
def test_variables_are_eliminated_in_the_order_of_least_fill(problem, name):
    scopes, sizes, wanted, seed = problem
    semiring = SEMIRINGS[name]
    order, plan = by_fill(scopes, sizes, wanted)
    tables = drawn(scopes, sizes, seed)
    turned = [
        table.transpose(np.argsort([order.index(x) for x in scope]))
        for scope, table in zip(scopes, tables, strict=True)
    ]
    algebra = TableAlgebra(semiring, plan.sizes, aligned=0)
    found = left(eliminate(plan, entered(turned, semiring), algebra), semiring)
    asked = order[len(order) - len(wanted) :]
    due = dense(scopes, sizes, tables, wanted, by=name)
    np.testing.assert_allclose(found, due.transpose(np.argsort(np.argsort(asked))), atol=1e-14)


@given(problems(), st.sampled_from(sorted(SEMIRINGS)), st.booleans())
def test_factors_enter_as_the_product_stays_smallest(problem, name, watched):
    scopes, sizes, wanted, seed = problem
    semiring = SEMIRINGS[name]
    tables = drawn(scopes, sizes, seed)
    tables[0] = drawn(scopes[:1], sizes, seed, runs=(2,))[0]  # the others are the same in all runs
    wanted = tuple(np.random.default_rng(seed).permutation(wanted).tolist())
    plan = next_smallest(scopes, wanted, dict(enumerate(sizes)))
    algebra = TableAlgebra(semiring, plan.sizes, watched=watched)
    found = left(eliminate(plan, entered(tables, semiring), algebra), semiring)
    due = dense(scopes, sizes, tables, wanted, by=name)
    order = np.argsort(np.argsort(wanted))
    np.testing.assert_allclose(found, due.transpose(*order, due.ndim - 1), atol=1e-14)


def test_a_variable_that_no_factor_has_is_alike_in_all_its_states():
    plan = next_smallest([(0,), (0, 1)], (2, 1), {0: 2, 1: 3, 2: 4})
    array, table = np.array([0.2, 0.8]), np.arange(6.0).reshape(2, 3)
    found = eliminate(plan, [array, table], TableAlgebra(SUM_PRODUCT, plan.sizes))
    np.testing.assert_allclose(found, np.broadcast_to(array @ table, (4, 3)), rtol=1e-15)


@pytest.mark.parametrize("name", sorted(SEMIRINGS))
def test_many_labels(name):
    """More of them than einsum has letters."""
    semiring = SEMIRINGS[name]
    a, b = np.random.default_rng(0).random((2, 3, 3))
    plan = next_smallest([(70, 60), (60, 80)], (70, 80), dict.fromkeys((60, 70, 80), 3))
    found = eliminate(
        plan, entered([a, b], semiring), TableAlgebra(semiring, plan.sizes, watched=False)
    )
    pairs = a[:, :, None] * b
    due = pairs.max(axis=1) if name == "max" else a @ b
    np.testing.assert_allclose(left(found, semiring), due, rtol=1e-14)


def test_large_products_are_those_of_matrices():
    rng = np.random.default_rng(1)
    a, b = rng.random((40, 40, 7)), rng.random((40, 40))
    plan = next_smallest([(0, 1), (1, 2)], (0, 2), dict.fromkeys(range(3), 40))
    found = eliminate(plan, [a, b], TableAlgebra(SUM_PRODUCT, plan.sizes, watched=False))
    np.testing.assert_allclose(found, np.einsum("xyr,yz->xzr", a, b), rtol=1e-13)


def test_scaled_results_stay_in_range_and_underflow_is_noticed():
    scopes = [(k, k + 1) for k in range(400)]
    plan = in_order(scopes, [2] * 401, 400)
    tables = [np.array([[2e-3, 1e-3], [1e-3, 3e-3]])[..., None]] * 400
    kept = TableAlgebra(SUM_PRODUCT, plan.sizes, scaled=True, aligned=1)
    found = eliminate(plan, tables, kept)[:, 0]
    due = np.ones(2)
    for table in tables:
        due = due @ table[..., 0]
        due /= due.max()
    np.testing.assert_allclose(found, due, rtol=1e-12)
    lost = TableAlgebra(SUM_PRODUCT, plan.sizes, aligned=1)
    with np.errstate(all="raise"), pytest.raises(FloatingPointError):
        eliminate(plan, tables, lost)


def test_what_a_plan_tells_of_its_size():
    plan = in_order([(0,), (0, 1, 2), (1, 2)], [2, 3, 5], 2)
    assert [(step.factors, step.scope, step.left) for step in plan.steps] == [
        ((0, 1), (0, 1, 2), (1, 2)),
        ((2, 3), (1, 2), (2,)),
        ((4,), (2,), (2,)),
    ]
    assert plan.products == [30, 15, 5]
    assert (plan.cost, plan.largest) == (50, 15)
    # The product of all, then that of two results of 15 entries each, one of them given.
    assert plan.peak == 30


def test_results_come_step_by_step_and_factors_are_made_when_asked_for():
    asked = []
    plan = in_order([(0, 1), (1, 2)], [2, 2, 2], 2)

    def given_(factor):
        asked.append(factor)
        return np.ones((2, 2))

    made = results(plan, given_, TableAlgebra(SUM_PRODUCT, plan.sizes, aligned=0))
    np.testing.assert_array_equal(next(made), [2.0, 2.0])
    assert asked == [0]
    np.testing.assert_array_equal(next(made), [4.0, 4.0])


# Two trees: clusters (0, 1) and (1, 2) hang on (1, 3); (4,) stands by itself.
TREE = Plan(
    [(0, 1), (1, 2), (1, 3), (4,)],
    [2, 3, 2, 3, 4],
    [
        Step((0,), ((0, 1),), (0, 1), (1,)),
        Step((1,), ((1, 2),), (1, 2), (1,)),
        Step((2, 4, 5), ((1, 3), (1,), (1,)), (1, 3), ()),
        Step((3,), ((4,),), (4,), ()),
    ],
    (),
)


@pytest.mark.parametrize("seed", range(20))
@pytest.mark.parametrize("name", ["sum", "log"])
def test_both_ways_make_the_joints_of_clusters(seed, name):
    semiring = SEMIRINGS[name]
    tables = drawn(TREE.scopes, TREE.sizes, seed, runs=(3,))
    tables[1][:, :, 0] *= np.array([0.0, 1.0, 1.0])[:, None]  # a message of zero
    calibrated = Calibrated(TREE, entered(tables, semiring), TableAlgebra(semiring, TREE.sizes))
    due = dense(TREE.scopes, TREE.sizes, tables, range(5))
    due = due / due.sum(axis=(0, 1, 2, 3, 4))
    seen = []
    for step, joint, outside in calibrated.back():
        gone = tuple(x for x in range(5) if x not in step.scope)
        np.testing.assert_allclose(left(joint, semiring), due.sum(axis=gone), atol=1e-14)
        if outside is not None:
            gone = tuple(x for x in range(5) if x not in step.left)
            np.testing.assert_allclose(left(outside, semiring), due.sum(axis=gone), atol=1e-14)
        seen.append(step)
    assert seen == list(reversed(TREE.steps))
    assert TREE.roots == [2, 3]
