"""Of long axes the ends are shown."""

import numpy as np
import pytest

from pgm.display import few, places


def test_few_of_many():
    assert few(3) == [0, 1, 2]
    assert few(12) == list(range(12))
    assert few(100, 5) == [0, 1, 2, None, 98, 99]
    assert few(0) == []


@pytest.mark.parametrize(
    "shape",
    [
        (),
        (0,),
        (1,),
        (12,),
        (13,),
        (1000,),
        (2, 6),
        (2, 7),
        (1, 500),
        (500, 1),
        (1000, 61),
        (3, 4, 5),
        (0, 61),
        (7, 0),
        (2, 1000),
    ],
)
@pytest.mark.parametrize("most", [1, 3, 5, 12])
def test_places_are_few_in_order_and_at_the_ends(shape, most):
    found = places(shape, most)
    kept = [place for place in found if place is not None]
    flat = [int(np.ravel_multi_index(place, shape)) if shape else 0 for place in kept]
    size = int(np.prod(shape))
    assert flat == sorted(set(flat))
    assert len(found) <= max(most, 4)
    if size <= most:
        assert flat == list(range(size))
        return
    assert flat[0] == 0
    assert flat[-1] == size - 1 or found[-1] is None
    gaps = np.diff([*flat, size] if found[-1] is None else flat) > 1
    assert gaps.sum() == found.count(None)
