"""Structured tables of discrete CPDs: sparse matrices, mappings, shifts."""

import numpy as np
import pytest
from scipy import sparse

import pgm

X, Y, U = pgm.Discrete("x", 2), pgm.Discrete("y", 3), pgm.Discrete("u", ("stay", "go"))


@pytest.mark.parametrize("kind", ["coo", "csc", "csr", "dia", "dok", "lil"])
def test_sparse_matrices_of_all_kinds(kind):
    table = getattr(sparse, f"{kind}_array")(np.eye(2))
    assert (pgm.TableCPD(X, given=X.previous, table=table).table == np.eye(2)).all()


def test_a_state_given_by_name_and_by_index():
    table = {"stay": np.eye(2), "go": np.eye(2), 0: np.full((2, 2), 0.5)}
    with pytest.raises(pgm.ModelError, match="by its name and its index"):
        pgm.TableCPD(X, given=(X.previous, U), table=table)


def test_no_values():
    cpd = pgm.TableCPD(Y, given=X, table=sparse.csr_array(np.full((2, 3), 1 / 3)))
    assert cpd.log_density(np.zeros((0,), dtype=int), {X: 1}).shape == (0,)
    assert cpd.sample({X: np.zeros((0,), dtype=int)}, rng=0).shape == (0,)


@pytest.mark.parametrize("cells", [10**30, -(10**30), 2**63 - 1])
@pytest.mark.parametrize("edge", ["slide", "wrap", "stay"])
def test_shifts_of_no_64_bit_number(cells, edge):
    with pytest.raises(pgm.ModelError, match="is of more than"):
        pgm.shifts(3, {cells: 1.0}, edge=edge)


def test_a_shift_written_in_two_ways():
    with pytest.raises(pgm.ModelError, match="one shift twice"):
        pgm.shifts(3, {1: 0.5, (1,): 0.5})


def test_a_function_that_returns_no_numbers():
    v, z = pgm.Variable("v"), pgm.Discrete("z", 2)
    cpd = pgm.TableCPD(z, given=X, inputs=v, table=lambda _: "a table")
    with pytest.raises(pgm.ModelError, match="the function of the table must return numbers"):
        cpd.log_density(0, {X: 0, v: 1.0})
