"""DLPack's capsules, against NumPy's own."""

import gc
import weakref
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from pgm.kernels import dlpack


class Owner:
    """The keeper of some memory."""


def lent(array, owner):
    place = array.__array_interface__["data"][0]
    made = dlpack.capsule(place, array.shape, array.strides, (dlpack.HERE, 0), owner)
    return SimpleNamespace(__dlpack__=lambda **_: made, __dlpack_device__=lambda: (dlpack.HERE, 0))


@pytest.mark.parametrize("turned", [False, True])
def test_numpy_takes_what_is_lent(turned):
    array = np.arange(24.0).reshape(2, 3, 4)
    array = array.transpose(2, 0, 1)[1:] if turned else array
    found = np.from_dlpack(lent(array, None))
    assert_array_equal(found, array)
    assert np.shares_memory(found, array)


def test_owners_are_kept_until_a_consumer_is_done():
    array, owner = np.arange(6.0), Owner()
    gone = weakref.ref(owner)
    found = np.from_dlpack(lent(array, owner))
    del owner
    gc.collect()
    assert gone() is not None
    del found
    gc.collect()
    assert gone() is None


def test_owners_are_kept_no_longer_than_a_capsule_that_nobody_takes():
    owner = Owner()
    gone, capsule = weakref.ref(owner), lent(np.arange(6.0), owner)
    del owner
    gc.collect()
    assert gone() is not None
    del capsule
    gc.collect()
    assert gone() is None


@pytest.mark.parametrize("kind", [np.float64, np.float32, np.int64, np.uint8, np.complex128, bool])
def test_tensors_of_numpys(kind):
    array = np.arange(24).astype(kind).reshape(2, 3, 4)[:, ::2]
    tensor = dlpack.opened(array.__dlpack__())
    place = array.__array_interface__["data"][0]
    assert tensor[:3] == (place, array.shape, array.strides)
    assert tensor.type in (array.dtype.str, f"<{array.dtype.kind}{array.dtype.itemsize}")
    assert tensor.device == (dlpack.HERE, 0)


def test_memory_of_numpys_is_given_back():
    owner = np.arange(1000.0)
    gone = weakref.ref(owner)
    tensor = dlpack.opened(owner.__dlpack__())
    del owner
    gc.collect()
    assert gone() is not None
    del tensor
    gc.collect()
    assert gone() is None


def test_a_capsule_is_consumed_once():
    capsule = np.arange(3.0).__dlpack__()
    dlpack.opened(capsule)
    with pytest.raises(ValueError, match="has been consumed"):
        dlpack.opened(capsule)
    with pytest.raises(ValueError, match="has no tensor"):
        dlpack.opened("no capsule")
