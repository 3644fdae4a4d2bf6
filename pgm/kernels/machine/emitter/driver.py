"""The driver of NVIDIA's cards: kernels loaded and launched, and memory of a card.

It is NVIDIA's own, by way of its package `cuda-bindings`: the driver makes machine code of PTX, so
that no toolkit is due. It has not been run on a card yet.
"""

from __future__ import annotations

import weakref
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import cache
from importlib import import_module
from typing import Any, Never

from pgm.kernels.machine.emitter.kinds import Kind, symbol

# The oldest CUDA of a driver, by its number for it, that knows the PTX that is printed.
_OLDEST = 12000
# Threads of a block. Each may have 255 registers, of which a block has 65,536.
THREADS = 128
# CUDA's number for memory that does not suffice.
_NO_MEMORY = 2
# The longest distance in bytes between lines that are copied together.
_PITCH = 2**31 - 1


class OutOfMemory(OSError):
    """The card's memory does not suffice."""


class Held:
    """Memory of a card, at an address, until nobody holds it any more."""

    def __init__(self, address: int, device: Device) -> None:
        self.address, self.device = address, device

    def __reduce__(self) -> Never:
        raise TypeError("memory of a card is neither copied nor pickled: .home() copies an array")


class Device:
    """The first card of this machine; CUDA_VISIBLE_DEVICES chooses which of several that is.

    Raises an ImportError without `cuda-bindings`, and an OSError without a card, or where the
    driver is too old, as its methods do where the driver fails.

    Attributes
    ----------
    capability : tuple of int
        The compute capability.
    """

    def __init__(self) -> None:
        self._driver = driver = import_module("cuda.bindings.driver")
        try:
            found = driver.cuInit(0)
        except Exception as error:  # of a class of cuda-pathfinder's own
            raise OSError("this machine has no driver of NVIDIA's cards") from error
        if int(found[0]):
            raise OSError(f"this machine has no card: {self._name(found[0])}")
        version = self._asked(driver.cuDriverGetVersion())
        if version < _OLDEST:
            raise OSError(
                f"the driver of the card is too old: it knows CUDA {_dotted(version)}, and "
                f"{_dotted(_OLDEST)} was due; update it"
            )
        if not self._asked(driver.cuDeviceGetCount()):
            raise OSError("this machine has no card")
        self._device = self._asked(driver.cuDeviceGet(0))
        self._context = self._asked(driver.cuDevicePrimaryCtxRetain(self._device))
        asked = driver.CUdevice_attribute
        self.capability: tuple[int, int] = (
            self._told(asked.CU_DEVICE_ATTRIBUTE_COMPUTE_CAPABILITY_MAJOR),
            self._told(asked.CU_DEVICE_ATTRIBUTE_COMPUTE_CAPABILITY_MINOR),
        )

    @contextmanager
    def current(self) -> Iterator[None]:
        """A context in which the thread at hand uses this card; what it used before is so again."""
        self._asked(self._driver.cuCtxPushCurrent(self._context))
        try:
            yield
        finally:
            self._asked(self._driver.cuCtxPopCurrent())

    @property
    def name(self) -> str:
        """The name of the card."""
        given: bytes = self._asked(self._driver.cuDeviceGetName(256, self._device))
        return given.split(b"\0")[0].decode()

    def free(self) -> int:
        """Bytes of the card's memory that nobody has taken."""
        found: int = self._asked(self._driver.cuMemGetInfo())[0]
        return found

    @contextmanager
    def room(self, count: int) -> Iterator[int]:
        """The address of so many bytes of the card's memory, which are free again afterwards."""
        place = self._asked(self._driver.cuMemAlloc(max(count, 1)))
        try:
            yield int(place)
        finally:
            self._asked(self._driver.cuMemFree(place))

    def held(self, count: int) -> Held:
        """So many bytes of the card's memory, which are free again when nobody holds them."""
        with self.current():
            place = int(self._asked(self._driver.cuMemAlloc(max(count, 1))))
        found = Held(place, self)
        weakref.finalize(found, self._free, place).atexit = False
        return found

    def _free(self, place: int) -> None:
        with self.current():
            self._asked(self._driver.cuMemFree(place))

    def settle(self) -> None:
        """Wait until all that the program has asked of this card is done, by whichever library."""
        self._asked(self._driver.cuCtxSynchronize())

    def require_own(self, place: int) -> None:
        """Raise an OSError unless an address is one of this card's memory."""
        asked = self._driver.CUpointer_attribute
        given = self._driver.CUdeviceptr(place)
        kind, own = (
            self._asked(self._driver.cuPointerGetAttribute(each, given))
            for each in (
                asked.CU_POINTER_ATTRIBUTE_MEMORY_TYPE,
                asked.CU_POINTER_ATTRIBUTE_DEVICE_ORDINAL,
            )
        )
        if int(kind) != int(self._driver.CUmemorytype.CU_MEMORYTYPE_DEVICE) or int(own):
            raise OSError("the memory is not the first card's")

    def put(
        self, place: int, address: int, count: int, lines: int = 1, here: int = 0, there: int = 0
    ) -> None:
        """Copy bytes from an address of this machine's memory to one of the card's.

        They are so many of each of some lines, whose distances are those `here`, and on the card.
        """
        if lines > 1 and max(here, there) <= _PITCH:
            lying = self._driver.CUDA_MEMCPY2D()
            self._here(lying, "src", address, here)
            self._there(lying, "dst", place, there)
            self._copy(lying, count, lines)
            return
        for k in range(lines):
            self._asked(self._driver.cuMemcpyHtoD(place + k * there, address + k * here, count))

    def get(
        self, place: int, address: int, count: int, lines: int = 1, here: int = 0, there: int = 0
    ) -> None:
        """Copy bytes from an address of the card's memory to one of this machine's; see `put`."""
        if lines > 1 and max(here, there) <= _PITCH:
            lying = self._driver.CUDA_MEMCPY2D()
            self._there(lying, "src", place, there)
            self._here(lying, "dst", address, here)
            self._copy(lying, count, lines)
            return
        for k in range(lines):
            self._asked(self._driver.cuMemcpyDtoH(address + k * here, place + k * there, count))

    def kernel(self, text: str, name: str) -> Any:
        """A kernel of a module of PTX, which the driver compiles; it lasts as the context does."""
        module = self._asked(self._driver.cuModuleLoadData(text.encode() + b"\0"))
        return self._asked(self._driver.cuModuleGetFunction(module, symbol(name).encode()))

    def launch(self, kernel: Any, count: int, given: Sequence[int], kinds: Sequence[Kind]) -> None:
        """Run a kernel in so many threads, or some more, and wait until all of them have ended."""
        blocks, driver = -(-count // THREADS), self._driver
        arguments = tuple(given), tuple(kind.in_c for kind in kinds)
        self._asked(driver.cuLaunchKernel(kernel, blocks, 1, 1, THREADS, 1, 1, 0, 0, arguments, 0))
        self._asked(driver.cuCtxSynchronize())

    def _here(self, lying: Any, end: str, address: int, distance: int) -> None:
        """Tell of lines of this machine's memory, at the ``"src"`` of a copy or its ``"dst"``."""
        setattr(lying, f"{end}MemoryType", self._driver.CUmemorytype.CU_MEMORYTYPE_HOST)
        setattr(lying, f"{end}Host", address)
        setattr(lying, f"{end}Pitch", distance)

    def _there(self, lying: Any, end: str, place: int, distance: int) -> None:
        """Tell of lines of the card's memory."""
        setattr(lying, f"{end}MemoryType", self._driver.CUmemorytype.CU_MEMORYTYPE_DEVICE)
        setattr(lying, f"{end}Device", place)
        setattr(lying, f"{end}Pitch", distance)

    def _copy(self, lying: Any, count: int, lines: int) -> None:
        lying.WidthInBytes, lying.Height = count, lines
        self._asked(self._driver.cuMemcpy2DUnaligned(lying))

    def _told(self, attribute: Any) -> int:
        found: int = self._asked(self._driver.cuDeviceGetAttribute(attribute, self._device))
        return found

    def _asked(self, found: tuple[Any, ...]) -> Any:
        """The answer of the driver, one or several; its errors are raised."""
        error, *answer = found
        if int(error):
            kind = OutOfMemory if int(error) == _NO_MEMORY else OSError
            raise kind(f"the card's driver has failed: {self._name(error)}")
        return answer[0] if len(answer) == 1 else answer

    def _name(self, error: Any) -> str:
        _, text = self._driver.cuGetErrorString(error)
        return text.decode() if text else f"error {int(error)}"


@cache
def device() -> Device:
    """The card of this machine; see `Device`."""
    return Device()


def _dotted(version: int) -> str:
    return f"{version // 1000}.{version % 1000 // 10}"
