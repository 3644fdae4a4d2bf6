"""Sums over axes against NumPy's own."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pgm.beliefs.discrete.sums import AxisSums
from pgm.kernels.semirings import LOG_SUM_PRODUCT, MAX_PRODUCT, SUM_PRODUCT

shapes = st.lists(st.integers(1, 9), min_size=1, max_size=5).map(tuple)


@given(shapes, st.integers(0, 31), st.sampled_from([(), (1,), (3,), (200,)]), st.integers(0, 99))
def test_sums_are_those_of_numpy(shape, chosen, tail, seed):
    axes = tuple(k for k in range(len(shape)) if chosen >> k & 1)
    table = np.random.default_rng(seed).random((*shape, *tail))
    sums = AxisSums.of(shape, axes)
    for semiring, due in (
        (SUM_PRODUCT, table.sum(axis=axes)),
        (MAX_PRODUCT, table.max(axis=axes)),
        (LOG_SUM_PRODUCT, np.log(np.exp(table).sum(axis=axes))),
    ):
        if semiring is LOG_SUM_PRODUCT and not axes:
            continue
        found = sums.total(table, semiring).reshape(due.shape)
        np.testing.assert_allclose(found, due, rtol=1e-12)


@pytest.mark.parametrize(
    ("shape", "axes", "by_matrix"),
    [((64, 2), (1,), True), ((64, 2, 4), (1,), True), ((4, 2, 64), (1,), False)],
)
def test_a_matrix_sums_few_last_entries(shape, axes, by_matrix):
    assert (AxisSums.of(shape, axes).last is not None) == by_matrix
