"""Tallies side by side have the digits of each by itself."""

import pickle

import numpy as np
from numpy.testing import assert_array_equal

import pgm
from pgm.comparison.packed_tallies import PackedTallies, joined
from pgm.comparison.tally import Tally

x, z = pgm.variables("x z")
CELLS = {("error", x): slice(0, 2), ("nees", x): 2, ("nis", z): 3}
DOF = np.array([2.0, np.nan, 1.0])


def values(runs, seed):
    """Values (runs, steps, cells), some of them missing."""
    found = np.random.default_rng(seed).normal(size=(runs, 3, 4)) + 7.0
    found[0, 1, 2] = found[:, 2, 3] = np.nan
    return found


def packed(given):
    return PackedTallies(Tally.of(given), CELLS, {("dof", z): DOF})


def alone(given):
    known, mean, spread, runs, centre, scatter = Tally.of(given)
    own = {
        key: Tally(
            known[..., k], mean[..., k], spread[..., k], runs, centre[..., k], scatter[..., k]
        )
        for key, k in CELLS.items()
    }
    every = np.broadcast_to(DOF, (len(given), 3))
    return own | {("dof", z): Tally.of(every)}


def assert_same(found, due):
    assert set(found) == set(due)
    assert len(found) == len(due) == 4
    for key, tally in due.items():
        for one, two in zip(found[key], tally, strict=True):
            assert_array_equal(one, two, err_msg=str(key))


def test_blocks_are_joined_as_each_tally_is():
    blocks = [values(runs, seed) for seed, runs in enumerate((8, 8, 3))]
    found, due = packed(blocks[0]), alone(blocks[0])
    assert_same(found, due)
    for block in blocks[1:]:
        found, due = joined(found, packed(block)), joined(due, alone(block))
        assert isinstance(found, PackedTallies)
        assert_same(found, due)
    assert_same(pickle.loads(pickle.dumps(found)), due)


def test_what_is_not_packed_is_joined_too():
    one, other = values(8, 1), values(1, 2)
    due = joined(alone(one), alone(other))
    assert_same(joined(packed(one), alone(other)), due)
    assert_same(joined(alone(one), packed(other)), due)
    assert_same(joined({}, packed(other)), alone(other))
