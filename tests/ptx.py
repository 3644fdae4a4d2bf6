"""An interpreter of PTX, so that kernels for a card are run where there is none.

It follows NVIDIA's "Parallel Thread Execution ISA" in instructions on 32 and 64 bits, which is all
that sweeps and libdevice's functions of float64 consist of; any other is refused. Each function is
translated to one of Python's. Addresses are those of this process; memory of a thread's own is
told apart by a bit, and an instruction that reaches memory of another space than its own is an
error. It is written from the manual alone and shares nothing with the printer of the code.
"""

import ctypes
import re

import numpy as np
import ptx_numbers
from ptx_numbers import M64, MASK, U
from ptx_translation import GENERIC, LOCAL, Translation, python_name

C_TYPES = {"64": ctypes.c_uint64, "32": ctypes.c_uint32, "16": ctypes.c_uint16, "8": ctypes.c_uint8}


class Memory:
    """Memory of this process; with `regions`, pairs of addresses, only inside these."""

    def __init__(self, regions=None):
        self.regions = regions

    def place(self, address, space, size):
        if space == "local":
            assert address & LOCAL, "an instruction on local memory reaches elsewhere"
            return address ^ LOCAL
        assert not address & LOCAL, "an address of the local space is taken for a generic one"
        if address & GENERIC:
            assert not space, f"an instruction on {space} memory reaches a thread's own"
            return address ^ GENERIC
        assert address % size == 0, f"{address:#x} is no multiple of {size}"
        if self.regions is not None:
            assert any(low <= address and address + size <= high for low, high in self.regions), (
                f"{address:#x} lies outside of the memory that was given"
            )
        return address

    def load(self, address, space, width):
        return C_TYPES[width].from_address(self.place(address, space, int(width) // 8)).value

    def store(self, address, space, width, value):
        bits = value if value.__class__ is int else U(value)
        place = self.place(address, space, int(width) // 8)
        C_TYPES[width].from_address(place).value = bits & MASK[width]


class Room:
    """Memory that begins at a multiple of some alignment."""

    def __init__(self, size, alignment, content=b""):
        self.bytes = np.zeros(size + alignment, np.uint8)
        start = self.bytes.ctypes.data
        self.address = start + -start % alignment
        if content:
            ctypes.memmove(self.address, bytes(content), len(content))


class Program:
    """A module of PTX; ``program.launch(name, arguments, blocks, threads)`` runs a kernel."""

    def __init__(self, text, regions=None):
        self.memory = Memory(regions)
        self.rooms, self.functions, self.entries = {}, {}, {}
        text = re.sub(r"//.*", "", text)
        # Regions beside those of the program's own constants are checked.
        for found in re.finditer(
            r"\.(?:global|const) \.align (\d+) \.b8 (\S+)\[(\d+)\](?: = \{([^}]*)\})?;", text
        ):
            alignment, name, size, content = found.groups()
            numbers = [int(each) for each in content.split(",")] if content else []
            room = Room(int(size), int(alignment), bytes(numbers))
            self.rooms[name] = room
            if regions is not None:
                regions.append((room.address, room.address + int(size)))
        names = {
            **vars(ptx_numbers),
            "Room": Room,
            "load": self.memory.load,
            "store": self.memory.store,
            "functions": self.functions,
        }
        for name, parameters, body, entry in functions_of(text):
            source = Translation(name, parameters, body, self.rooms).source()
            exec(compile(source, f"<{name}>", "exec"), names)
            self.functions[name] = names[python_name(name)]
            if entry:
                self.entries[name] = self.functions[name]

    def launch(self, name, arguments, blocks, threads):
        """Run a kernel in all threads, one after another."""
        for block in range(blocks):
            for thread in range(threads):
                place = {"ctaid": block, "ntid": threads, "tid": thread, "nctaid": blocks}
                self.entries[name]([{0: each & M64} for each in arguments], place)


def functions_of(text):
    """The functions of a module: name, names of parameters, lines, and whether it is a kernel."""
    pattern = re.compile(
        r"(\.entry|\.func)\s+(?:\([^)]*\)\s*)?([\w$]+)\s*(?:\(([^)]*)\))?([^{};]*)([{;])", re.S
    )
    place = 0
    while found := pattern.search(text, place):
        kind, name, parameters, _, end = found.groups()
        place = found.end()
        if end == ";":
            continue
        depth, first = 1, place
        while depth:
            depth += {"{": 1, "}": -1}.get(text[place], 0)
            place += 1
        names = re.findall(r"([\w$]+)(?:\[\d+\])?\s*(?:,|$)", (parameters or "").strip())
        yield name, names, text[first : place - 1], kind == ".entry"
