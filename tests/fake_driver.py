"""A driver of cards as `cuda-bindings` has it, whose card is the interpreter of `ptx`.

Memory of the card is apart from that of the program, so that whatever is not copied is not there,
and kernels reach nothing but what was taken and not given back. Calls take what NVIDIA's take, and
give an error and their answers.
"""

import ctypes
import sys
from enum import IntEnum
from types import ModuleType, SimpleNamespace

import numpy as np
from ptx import Program

OK, INVALID, MEMORY, NO_DEVICE = 0, 1, 2, 100
WORDS = {
    INVALID: b"invalid argument",
    MEMORY: b"out of memory",
    NO_DEVICE: b"no CUDA-capable device",
}


class Attribute(IntEnum):
    CU_DEVICE_ATTRIBUTE_COMPUTE_CAPABILITY_MAJOR = 75
    CU_DEVICE_ATTRIBUTE_COMPUTE_CAPABILITY_MINOR = 76


class MemoryType(IntEnum):
    CU_MEMORYTYPE_HOST = 1
    CU_MEMORYTYPE_DEVICE = 2


class PointerAttribute(IntEnum):
    CU_POINTER_ATTRIBUTE_MEMORY_TYPE = 2
    CU_POINTER_ATTRIBUTE_DEVICE_ORDINAL = 9


class Lying(SimpleNamespace):
    """Lines of memory that are copied together, of NVIDIA's structure for that."""

    NAMES = "MemoryType", "Host", "Device", "Pitch"

    def __init__(self):
        names = {end + name: 0 for end in ("src", "dst") for name in self.NAMES}
        super().__init__(**names, WidthInBytes=0, Height=0)

    def begin(self, end):
        device = getattr(self, f"{end}MemoryType") == MemoryType.CU_MEMORYTYPE_DEVICE
        return getattr(self, end + ("Device" if device else "Host")), device


class Driver:
    """A driver, and its card: its capability, CUDA's version, and its memory in bytes."""

    CUdevice_attribute, CUmemorytype, CUDA_MEMCPY2D = Attribute, MemoryType, Lying
    CUpointer_attribute, CUdeviceptr = PointerAttribute, int

    def __init__(self, capability=(8, 0), version=13000, memory=2**30, cards=1):
        self.capability, self.version, self.memory, self.cards = capability, version, memory, cards
        self.contexts, self.taken, self.regions, self.launched = [], {}, [], []
        self.ordinal = 0  # of the card on which memory lies that others have taken
        self.peak = 0  # the most bytes that were taken

    def cuInit(self, flags):
        return (OK if self.cards else NO_DEVICE,)

    def cuDriverGetVersion(self):
        return OK, self.version

    def cuDeviceGetCount(self):
        return OK, self.cards

    def cuDeviceGet(self, ordinal):
        return (OK, f"device {ordinal}") if ordinal < self.cards else (INVALID, None)

    def cuDeviceGetName(self, length, device):
        return OK, b"an interpreter".ljust(length, b"\0")

    def cuDeviceGetAttribute(self, attribute, device):
        place = Attribute(attribute) - Attribute.CU_DEVICE_ATTRIBUTE_COMPUTE_CAPABILITY_MAJOR
        return OK, self.capability[place]

    def cuDevicePrimaryCtxRetain(self, device):
        return OK, f"context of {device}"

    def cuCtxPushCurrent(self, context):
        self.contexts.append(context)
        return (OK,)

    def cuCtxPopCurrent(self):
        return OK, self.contexts.pop()

    def cuMemGetInfo(self):
        assert self.contexts
        return OK, self.memory - sum(map(len, self.taken.values())), self.memory

    def cuMemAlloc(self, count):
        assert self.contexts
        if count > self.cuMemGetInfo()[1]:
            return MEMORY, None
        room = np.full(count + 256, 255, np.uint8)  # of which each float is NaN
        place = room.ctypes.data + -room.ctypes.data % 256
        self.taken[place] = room[place - room.ctypes.data :][:count]
        self.peak = max(self.peak, sum(map(len, self.taken.values())))
        self._renew()
        return OK, place

    def cuMemFree(self, place):
        if place not in self.taken:
            return (INVALID,)
        del self.taken[place]
        self._renew()
        return (OK,)

    def cuMemcpyHtoD(self, place, address, count):
        return self._copied(place, address, place, count)

    def cuMemcpyDtoH(self, address, place, count):
        return self._copied(address, place, place, count)

    def cuMemcpy2DUnaligned(self, lying):
        (source, _), (to, here) = lying.begin("src"), lying.begin("dst")
        assert min(lying.srcPitch, lying.dstPitch) >= lying.WidthInBytes
        for _ in range(lying.Height):
            found = self._copied(to, source, to if here else source, lying.WidthInBytes)
            if found != (OK,):
                return found
            source, to = source + lying.srcPitch, to + lying.dstPitch
        return (OK,)

    def cuPointerGetAttribute(self, attribute, place):
        if not self._holds(place, 1):
            return INVALID, None
        memory = attribute == PointerAttribute.CU_POINTER_ATTRIBUTE_MEMORY_TYPE
        return OK, MemoryType.CU_MEMORYTYPE_DEVICE if memory else self.ordinal

    def cuModuleLoadData(self, image):
        assert image.endswith(b"\0")
        return OK, Program(image[:-1].decode(), self.regions)

    def cuModuleGetFunction(self, module, name):
        name = name.decode()
        return (OK, (module, name)) if name in module.entries else (INVALID, None)

    def cuLaunchKernel(self, kernel, x, y, z, bx, by, bz, shared, stream, arguments, extra):
        assert self.contexts
        assert (y, z, by, bz, shared, stream, extra) == (1, 1, 1, 1, 0, 0, 0)
        program, name = kernel
        given, kinds = arguments
        values = [kind(each).value for each, kind in zip(given, kinds, strict=True)]
        assert all(kind in (ctypes.c_void_p, ctypes.c_int64) for kind in kinds)
        program.launch(name, values, x, bx)
        self.launched.append((x, bx))
        return (OK,)

    def cuCtxSynchronize(self):
        return (OK,)

    def cuGetErrorString(self, error):
        return OK, WORDS[error]

    def _copied(self, to, source, place, count):
        if not self._holds(place, count):
            return (INVALID,)
        ctypes.memmove(to, source, count)
        return (OK,)

    def _holds(self, place, count):
        return any(low <= place and place + count <= high for low, high in self._rooms())

    def _rooms(self):
        return [(place, place + len(room)) for place, room in self.taken.items()]

    def _renew(self):
        # Those of the constants of programs stay.
        own = [each for each in self.regions if each not in self._known]
        self._known = set(self._rooms())
        self.regions[:] = [*own, *self._known]

    _known: set = frozenset()


def install(monkeypatch, driver):
    """Have NVIDIA's package be this driver, or missing for None."""
    bindings = SimpleNamespace(driver=driver)
    for name, module in (
        ("cuda", ModuleType("cuda")),
        ("cuda.bindings", bindings if driver else None),
        ("cuda.bindings.driver", driver),
    ):
        monkeypatch.setitem(sys.modules, name, module)
    return driver
