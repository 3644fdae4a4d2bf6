"""Calls of the driver of cards, as NVIDIA's own bindings take them where there is no driver.

What they do is tested with a fake one, in `test_card_calls.py`.
"""

import numpy as np
import pytest

from pgm.kernels.machine.emitter.driver import Device
from pgm.kernels.machine.emitter.kinds import ADDRESS, WHOLE

bindings = pytest.importorskip("cuda.bindings.driver", reason="bindings come with the extra gpu")


@pytest.fixture
def device():
    """A card that is not there."""
    try:
        bindings.cuInit(0)
    except RuntimeError:
        found = object.__new__(Device)
        found._driver, found._device = bindings, bindings.CUdevice(0)
        found._context = bindings.CUcontext(0)
        return found
    pytest.skip("this machine has a driver")


def entered(context):
    with context:
        pass


CALLS = {
    "current": lambda device, _: entered(device.current()),
    "name": lambda device, _: device.name,
    "free": lambda device, _: device.free(),
    "room": lambda device, _: entered(device.room(100)),
    "put": lambda device, here: device.put(256, here, 8),
    "get": lambda device, here: device.get(256, here, 8),
    "put lines": lambda device, here: device.put(256, here, 8, 2, 16, 8),
    "get lines": lambda device, here: device.get(256, here, 8, 2, 16, 8),
    "held": lambda device, _: device.held(100),
    "settle": lambda device, _: device.settle(),
    "own": lambda device, _: device.require_own(256),
    "kernel": lambda device, _: device.kernel(".version 6.3", "sweep"),
    "launch": lambda device, _: device.launch(
        bindings.CUfunction(0), 1000, (256, 0, 1000), (ADDRESS, WHOLE, WHOLE)
    ),
    "capability": lambda device, _: device._told(
        bindings.CUdevice_attribute.CU_DEVICE_ATTRIBUTE_COMPUTE_CAPABILITY_MAJOR
    ),
}


@pytest.mark.parametrize("name", CALLS)
def test_arguments_are_those_of_nvidias_bindings(name, device):
    """These look for a driver once they have taken the arguments; wrong ones are a TypeError."""
    with pytest.raises(RuntimeError, match="NVIDIA driver library"):
        CALLS[name](device, np.zeros(4).ctypes.data)


def test_wrong_arguments_are_found(device):
    with pytest.raises(TypeError):
        device.put("nowhere", 0, 8)


def test_without_a_driver_it_says_so(device):
    with pytest.raises(OSError, match="this machine has no driver of NVIDIA's cards"):
        Device()
