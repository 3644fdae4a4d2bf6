"""Vectors and registers that share their memory."""

import pickle

import numpy as np
import pytest

from pgm.inference.growing.registers import Register
from pgm.inference.growing.vectors import Vector


@pytest.mark.parametrize("size", [1, 31, 32, 33, 1024, 1025, 40000])
def test_vectors_are_lists_that_stay(size):
    rng = np.random.default_rng(size)
    vector, plain = Vector(), []
    kept = []
    while len(plain) < size:
        more = list(rng.integers(0, 1000, size=int(rng.integers(1, 1 + size // 3 + 1))))
        vector, plain = vector.extended(more), [*plain, *more]
        places = rng.integers(0, len(plain), size=min(len(plain), 50)).tolist()
        vector = vector.replaced({k: -k for k in places})
        for k in places:
            plain[k] = -k
        kept.append((vector, list(plain)))
    for one, values in kept:
        assert list(one) == values
        assert len(one) == len(values)
        some = rng.integers(0, len(values), size=20).tolist()
        assert one.some(some) == [one[k] for k in some] == [values[k] for k in some]
    assert vector.replaced({}) is vector
    assert [vector.get(k) for k in range(size)] == plain[:size]
    assert vector.get(len(plain)) is None


def test_vectors_with_gaps_have_none_there():
    vector = Vector().replaced({7: "a", 9000: "b"})
    assert len(vector) == 9001
    assert [vector.get(k) for k in (7, 8, 700, 9000, 9001, 10**9)] == [
        "a",
        None,
        None,
        "b",
        None,
        None,
    ]


def test_registers_share_until_they_part():
    empty = Register()
    one = empty.extended({"a": 1})
    two = one.extended({"b": 2, "c": 3})
    other = one.extended({"b": 5})
    assert dict(empty) == {}
    assert dict(one) == {"a": 1}
    assert dict(two) == {"a": 1, "b": 2, "c": 3}
    assert dict(other) == {"a": 1, "b": 5}
    assert "b" not in one
    assert one.get("b") is None
    with pytest.raises(KeyError):
        one["b"]
    assert two._entries is one._entries is not other._entries
    assert dict(pickle.loads(pickle.dumps(one))) == {"a": 1}
