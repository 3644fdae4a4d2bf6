"""An interpreter of PTX, so that kernels for a card are run where there is none.

It follows NVIDIA's "Parallel Thread Execution ISA" in instructions on 32 and 64 bits, which is all
that sweeps and libdevice's functions of float64 consist of; any other is refused. Each function is
translated to one of Python's. Addresses are those of this process; memory of a thread's own is
told apart by a bit, and an instruction that reaches memory of another space than its own is an
error. It is written from the manual alone and shares nothing with the printer of the code.
"""

import ctypes
import math
import re
import struct
from itertools import count

import numpy as np

LOCAL, GENERIC = 1 << 62, 1 << 61  # marks of addresses in local memory: in its space, and generic
M32, M64 = (1 << 32) - 1, (1 << 64) - 1
MASK = {"32": M32, "64": M64, "16": 0xFFFF, "8": 0xFF}
C_TYPES = {"64": ctypes.c_uint64, "32": ctypes.c_uint32, "16": ctypes.c_uint16, "8": ctypes.c_uint8}
fma = ctypes.CDLL(None).fma
fma.restype, fma.argtypes = ctypes.c_double, [ctypes.c_double] * 3
fmaf = ctypes.CDLL(None).fmaf
fmaf.restype, fmaf.argtypes = ctypes.c_float, [ctypes.c_float] * 3


def F(bits):
    """The float of 64 bits."""
    return struct.unpack("<d", struct.pack("<Q", bits))[0]


def U(number):
    """The 64 bits of a float."""
    return struct.unpack("<Q", struct.pack("<d", number))[0]


def F32(bits):
    """The float of 32 bits."""
    return struct.unpack("<f", struct.pack("<I", bits))[0]


def U32(number):
    """The 32 bits of a float."""
    return int(np.float32(number).view(np.uint32))


def S(bits, width):
    """The signed number of bits."""
    return bits - (1 << width) if bits >> (width - 1) else bits


def div(a, b):
    if b != 0.0:
        return a / b
    if a == 0.0 or a != a:
        return math.nan
    return math.copysign(math.inf, a) * math.copysign(1.0, b)


def mul(a, b):
    return a * b  # Python's floats overflow to infinity in products


def sqrt(a):
    return math.sqrt(a) if a >= 0.0 else (a if a == 0.0 else math.nan)


def log2(a):
    return math.log2(a) if a > 0.0 else (-math.inf if a == 0.0 else math.nan)


def least(a, b):
    if a != a or b != b:
        return b if a != a else a
    return a if a < b or (a == b and math.copysign(1.0, a) < 0.0) else b


def most(a, b):
    return -least(-a, -b)


def rounded(a, way):
    """A float without its fraction, rounded to nearest even, down, up or to zero."""
    if not math.isfinite(a) or abs(a) >= 2.0**52:
        return a
    whole = {"rni": round, "rmi": math.floor, "rpi": math.ceil, "rzi": math.trunc}[way](a)
    return math.copysign(float(whole), a)


def to_whole(a, way, kind):
    """A whole number of a float, the bounds beyond them, as of `cvt`."""
    width = int(kind[1:])
    if a != a:
        return 1 << (width - 1)
    low, high = (-(1 << (width - 1)), (1 << (width - 1)) - 1) if kind[0] == "s" else (0, MASK[kind[1:]])
    found = rounded(a, way)
    found = (high if found > 0 else low) if math.isinf(found) else int(found)
    return max(low, min(high, found)) & MASK[kind[1:]]


def gross(a):
    """An approximation as of `rcp.approx.ftz.f64`, whose lower 32 bits are zero."""
    bits = U(a)
    if not bits & 0x7FF0000000000000:
        bits &= 1 << 63
    return F(bits & ~M32)


def rcp_approx(a):
    return gross(div(1.0, gross(a)))


def rsqrt_approx(a):
    a = gross(a)
    return gross(div(1.0, sqrt(a))) if a else math.copysign(math.inf, a)


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
        self.names = {
            **{name: globals()[name] for name in ("F", "U", "S", "div", "mul", "sqrt", "fma")},
            **{name: globals()[name] for name in ("least", "most", "rounded", "to_whole", "gross")},
            **{name: globals()[name] for name in ("rcp_approx", "rsqrt_approx", "Room", "math", "np")},
            **{name: globals()[name] for name in ("F32", "U32", "fmaf", "log2")},
            **{"INF": math.inf, "MINUS_INF": -math.inf, "NAN": math.nan},
            "load": self.memory.load,
            "store": self.memory.store,
            "functions": self.functions,
        }
        for name, parameters, body, entry in functions_of(text):
            source = Translation(name, parameters, body, self.rooms).source()
            exec(compile(source, f"<{name}>", "exec"), self.names)
            self.functions[name] = self.names[python_name(name)]
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


def python_name(name):
    return "f_" + name.replace("$", "S_")


class Translation:
    """A function of PTX as one of Python: its registers are variables, its blocks branches."""

    def __init__(self, name, parameters, body, rooms):
        self.name, self.parameters, self.rooms = name, parameters, rooms
        self.blocks, self.labels, self.depots = [[]], {}, []
        self.inner = {
            each.strip()
            for found in re.findall(r"\.reg \.\w+\s+([^%;]*);", body)
            for each in found.split(",")
        }
        for statement in statements(body):
            if statement.endswith(":"):
                self.blocks.append([])
                self.labels[statement[:-1]] = len(self.blocks) - 1
            elif found := re.match(r"\.local \.align (\d+) \.b8\s+(\S+)\[(\d+)\]", statement):
                self.depots.append(found.groups())
            elif not statement.startswith("."):
                self.blocks[-1].append(statement)
                if re.search(r"\bbra\b", statement):  # what follows is a block of its own
                    self.blocks.append([])

    def source(self):
        lines = [f"def {python_name(self.name)}(given, place):", "  calls, result, cc = {}, {}, 0"]
        for alignment, name, size in self.depots:
            lines.append(f"  room_{name} = Room({size}, {alignment})")
            lines.append(f"  {name} = room_{name}.address | {LOCAL}")
        lines += ["  block = 0", "  while True:"]
        self._branch(lines, 0, len(self.blocks), "    ")
        return "\n".join(lines)

    def _branch(self, lines, first, last, indent):
        if last - first == 1:
            for statement in self.blocks[first]:
                lines += [indent + line for line in self.python(statement)]
            lines += [f"{indent}block = {first + 1}", f"{indent}continue"]
            return
        middle = (first + last) // 2
        lines.append(f"{indent}if block < {middle}:")
        self._branch(lines, first, middle, indent + " ")
        lines.append(f"{indent}else:")
        self._branch(lines, middle, last, indent + " ")

    # Operands

    def raw(self, text):
        """An operand as it stands, a float or bits."""
        text = text.strip()
        if found := re.fullmatch(r"%(n?ctaid|n?tid)\.x", text):
            return f"place[{found[1]!r}]"
        if text.startswith("%"):
            return f"of_{text[1:]}"
        if text in self.inner:  # a register of a block of its own
            return f"inner_{text}"
        if text.startswith("0d"):
            number = F(int(text[2:], 16))
            if math.isfinite(number):
                return repr(number)
            return "NAN" if number != number else "INF" if number > 0.0 else "MINUS_INF"
        if text.startswith("0f"):
            return str(int(text[2:], 16))
        if re.fullmatch(r"-?(0x[0-9A-Fa-f]+|\d+)", text):
            return str(int(text, 0) & M64)
        if text in self.rooms:
            return str(self.rooms[text].address)
        if any(text == name for _, name, _ in self.depots):
            return text
        raise NotImplementedError(f"operand {text}")

    def of(self, text, kind):
        """An operand as one of a type."""
        found = self.raw(text)
        if kind == "pred":
            return found
        if kind == "f64":
            if re.fullmatch(r"-?[\d.]+(e[+-]?\d+)?", found) and not found.isdigit():
                return f"({found})"
            return f"({found} if {found}.__class__ is float else F({found}))" if (
                found.isidentifier()
            ) else f"F({found})"
        bits = f"({found} if {found}.__class__ is int else U({found}))" if (
            found.isidentifier()
        ) else (found if found.isdigit() or "place" in found else f"U({found})")
        width = int(kind[1:])
        if kind == "f32":
            return f"F32({bits})"
        if found.isdigit():
            bits = str(int(found) & MASK[kind[1:]])
        return f"S({bits}, {width})" if kind[0] == "s" else bits

    # Instructions

    def python(self, statement):
        guard = ""
        if found := re.match(r"@(!?)%(\w+)\s+(.*)", statement, re.S):
            guard = f"if {'not ' if found[1] else ''}of_{found[2]}: "
            statement = found[3]
        operation, _, rest = statement.partition(" ") if " " in statement else (statement, "", "")
        operation, rest = operation.strip(), rest.strip()
        lines = self.instruction(operation, rest)
        if not guard:
            return lines
        return [guard.rstrip(), *(" " + line for line in lines)]

    def instruction(self, operation, rest):
        name, *parts = operation.split(".")
        if name == "bra":
            return [f"block = {self.labels[rest]}", "continue"]
        if name == "ret":
            return ["return result"]
        if name == "call":
            return self.call(rest)
        if name in ("ld", "st"):
            return self.transfer(name, parts, rest)
        operands = split(rest)
        if name == "mov" and operands[0].startswith("{"):
            low, high = (self.raw(each) for each in split(operands[0][1:-1]))
            bits = self.of(operands[1], "b64")
            return [f"{low}, {high} = {bits} & {M32}, {bits} >> 32"]
        if name == "mov" and operands[1].startswith("{"):
            low, high = (self.of(each, "b32") for each in split(operands[1][1:-1]))
            return [f"{self.raw(operands[0])} = {low} | {high} << 32"]
        to, *given = operands
        found = self.value(name, parts, given)
        if isinstance(found, list):  # of several lines, the last the value
            return [*found[:-1], f"{self.raw(to)} = {found[-1]}"]
        return [f"{self.raw(to)} = {found}"]

    def call(self, rest):
        found = re.fullmatch(r"(?:\((\w+)\),\s*)?([\w$]+),?\s*(?:\(([^)]*)\))?", rest.strip())
        result, name, given = found.groups()
        names = [each.strip() for each in (given or "").split(",") if each.strip()]
        values = ", ".join(f"calls[{each!r}]" for each in names)
        made = f"functions[{name!r}]([{values}], place)"
        lines = [f"found = {made}"]
        if result:
            lines.append(f"calls[{result!r}] = found")
        # Each call declares its parameters anew.
        return lines + [f"del calls[{each!r}]" for each in names]

    def transfer(self, name, parts, rest):
        kind, vector = parts[-1], "v2" in parts or "v4" in parts
        space = next((each for each in parts if each in ("global", "local", "param", "const")), "")
        space = "global" if space == "const" else space
        width = kind[1:]
        operands = split(rest)
        to, where = operands if name == "ld" else reversed(operands)
        base, _, offset = where.strip("[]").partition("+")
        offset = int(offset or 0)
        registers = split(to[1:-1]) if vector else [to]
        lines = []
        for k, register in enumerate(registers):
            here = offset + k * int(width) // 8
            if space == "param":
                if name == "st" and base.startswith("func_retval"):
                    lines.append(f"result[{here}] = {self.of(register, kind)}")
                elif name == "st":
                    lines.append(
                        f"calls.setdefault({base!r}, {{}})[{here}] = {self.of(register, kind)}"
                    )
                elif base in self.parameters:
                    number = self.parameters.index(base)
                    lines.append(f"{self.raw(register)} = given[{number}][{here}]")
                else:
                    lines.append(f"{self.raw(register)} = calls[{base!r}][{here}]")
                continue
            address = f"{self.of(base, 'b64')} + {here} & {M64}"
            if name == "ld":
                loaded = f"load({address}, {space!r}, {width!r})"
                lines.append(f"{self.raw(register)} = {loaded}")
            else:
                value = self.of(register, kind)
                lines.append(f"store({address}, {space!r}, {width!r}, {value})")
        return lines

    def value(self, name, parts, given):
        kind = parts[-1]
        if name in ("mov", "selp"):
            if name == "mov":
                if kind == "pred":
                    return self.predicate(given[0])
                return self.of(given[0], kind) if kind[1:] == "32" else self.raw(given[0])
            yes, no, truth = self.raw(given[0]), self.raw(given[1]), self.raw(given[2])
            if kind[1:] == "32":
                yes, no = self.of(given[0], kind), self.of(given[1], kind)
            return f"{yes} if {truth} else {no}"
        if name == "cvta":
            found = self.of(given[0], "b64")
            if "to" in parts:
                return found if "global" in parts else f"({found} ^ {LOCAL | GENERIC})"
            return found if "global" in parts else f"({found} ^ {LOCAL | GENERIC})"
        if name == "cvt":
            return self.converted(parts, given[0])
        if name == "setp":
            return self.compared(parts, given)
        if kind == "pred":
            one = self.predicate(given[0])
            if name == "not":
                return f"not {one}"
            return f"{one} {({'and': '&', 'or': '|', 'xor': '^'})[name]} {self.predicate(given[1])}"
        if kind == "f64":
            return self.floats(name, parts, [self.of(each, kind) for each in given])
        if kind == "f32":
            found = self.floats(name, parts, [self.of(each, kind) for each in given])
            return f"U32({found.replace('fma(', 'fmaf(')})"
        return self.wholes(name, parts, given)

    def predicate(self, text):
        return {"-1": "True", "0": "False", "1": "True"}.get(text) or self.raw(text)

    def floats(self, name, parts, given):
        assert set(parts) <= {"rn", "f64", "f32", "approx", "ftz"}, (name, parts)
        approximate = "approx" in parts
        forms = {
            "add": "({} + {})",
            "sub": "({} - {})",
            "mul": "mul({}, {})",
            "div": "div({}, {})",
            "fma": "fma({}, {}, {})",
            "neg": "(-{})",
            "abs": "abs({})",
            "min": "least({}, {})",
            "max": "most({}, {})",
            "sqrt": "sqrt({})",
            "rcp": "rcp_approx({})" if approximate else "div(1.0, {})",
            "rsqrt": "rsqrt_approx({})",
            "copysign": "math.copysign({1}, {0})",
            "ex2": "float(np.exp2({}))",
            "lg2": "log2({})",
        }
        assert approximate or name not in ("rsqrt", "ex2", "lg2")
        assert not approximate or name in ("rsqrt", "rcp", "ex2", "lg2"), (name, parts)
        return forms[name].format(*given)

    def wholes(self, name, parts, texts):
        kind = parts[-1]
        width, mask = kind[1:], MASK[kind[1:]]
        bits = int(width)
        given = [self.of(each, kind) for each in texts]
        plain = [self.of(each, "u" + width) for each in texts]
        if name in ("add", "sub", "addc", "subc", "mad", "madc", "mul") and (
            "cc" in parts or name.endswith("c")
        ):
            return self.carried(name, parts, plain, bits)
        if name == "mul":
            product = f"{given[0]} * {given[1]}"
            if "wide" in parts:
                return f"({product}) & {MASK[str(2 * bits)]}"
            return f"(({product}) >> {bits}) & {mask}" if "hi" in parts else f"({product}) & {mask}"
        if name == "mad":
            if "wide" in parts:
                wide = kind[0] + str(2 * bits)
                return f"({given[0]} * {given[1]} + {self.of(texts[2], wide)}) & {M64}"
            assert "lo" in parts
            return f"({given[0]} * {given[1]} + {given[2]}) & {mask}"
        if name in ("shl", "shr"):
            by = self.of(texts[1], "u32")
            if name == "shl":
                return f"({plain[0]} << {by}) & {mask} if {by} < {bits} else 0"
            return f"({given[0]} >> min({by}, {bits})) & {mask}"
        if name == "shf":
            both, by = f"({plain[1]} << 32 | {plain[0]})", f"({plain[2]} & 31)"
            assert "wrap" in parts
            return f"({both} << {by} >> 32) & {M32}" if "l" in parts else f"({both} >> {by}) & {M32}"
        if name == "bfe":
            return f"({plain[0]} >> {plain[1]}) & ((1 << {plain[2]}) - 1)"
        if name == "clz":
            return f"{bits} - ({plain[0]}).bit_length()"
        if name == "popc":
            return f"({plain[0]}).bit_count()"
        forms = {
            "add": "({} + {})",
            "sub": "({} - {})",
            "and": "({} & {})",
            "or": "({} | {})",
            "xor": "({} ^ {})",
            "not": "(~{})",
            "neg": "(-{})",
            "abs": "abs({})",
            "min": "min({}, {})",
            "max": "max({}, {})",
            "div": "int(math.copysign(1, {0}) * math.copysign(1, {1})) * (abs({0}) // abs({1}))",
            "rem": "int(math.copysign(1, {0})) * (abs({0}) % abs({1}))",
        }
        return f"{forms[name].format(*given)} & {mask}"

    def carried(self, name, parts, given, bits):
        """Arithmetic that takes a carry, or leaves one."""
        mask = MASK[str(bits)]
        takes = "cc" if name.endswith("c") else "0"
        first = given[0]
        if name.startswith("mad"):
            product = f"{given[0]} * {given[1]}"
            part = f"({product} >> {bits})" if "hi" in parts else f"({product} & {mask})"
            whole = f"{part} + {given[2]} + {takes}"
        elif name.startswith("sub"):
            whole = f"{first} - {given[1]} - {takes}"
        else:
            whole = f"{first} + {given[1]} + {takes}"
        lines = [f"found = {whole}"]
        if "cc" in parts:
            lines.append(f"cc = (found >> {bits}) & 1")
        return [*lines, f"found & {mask}"]

    def converted(self, parts, text):
        way = parts[0] if parts[0][0] == "r" else ""
        to, source = parts[-2:]
        given = self.of(text, source)
        if "f32" in (source, to):
            if source[0] != "f":
                return f"U32({given})"
            if to == "f64":
                return given
            if to == "f32":
                return f"U32(rounded({given}, {way!r}))" if way != "rn" else f"U32({given})"
            return f"to_whole({given}, {way!r}, {to!r})"
        if source == "f64" and to == "f64":
            return f"rounded({given}, {way!r})"
        if source == "f64":
            return f"to_whole({given}, {way!r}, {to!r})"
        if to == "f64":
            return f"float({given})"
        return f"{given} & {MASK[to[1:]]}"

    def compared(self, parts, given):
        relation, kind = parts[0], parts[-1]
        a, b = (self.of(each, kind) for each in given[:2])
        signs = {"eq": "==", "lt": "<", "le": "<=", "gt": ">", "ge": ">="}
        opposite = {"ltu": ">=", "leu": ">", "gtu": "<=", "geu": "<"}
        if kind[0] != "f":
            names = {**signs, "ne": "!=", "lo": "<", "ls": "<=", "hi": ">", "hs": ">="}
            found = f"({a} {names[relation]} {b})"
        elif relation in signs:
            found = f"({a} {signs[relation]} {b})"
        elif relation in opposite:
            found = f"(not {a} {opposite[relation]} {b})"
        elif relation == "neu":
            found = f"({a} != {b})"
        elif relation in ("nan", "num"):
            found = f"({'not ' if relation == 'nan' else ''}({a} == {a} and {b} == {b}))"
        else:
            both = f"({a} == {a} and {b} == {b})"
            found = {"ne": f"({both} and {a} != {b})", "equ": f"(not {both} or {a} == {b})"}[relation]
        if len(parts) == 3:  # joined with a predicate
            sign = {"and": "&", "or": "|", "xor": "^"}[parts[1]]
            found = f"{found} {sign} {self.predicate(given[2])}"
        return found


def statements(body):
    """The statements and labels of a function, in order."""
    # Vectors of operands have braces too; those of blocks are no statements.
    body = re.sub(r"\{([^{};\n]*)\}", r"<\1>", body)
    body = body.replace("{", ";").replace("}", ";").replace("<", "{").replace(">", "}")
    for part in body.split(";"):
        while found := re.match(r"\s*([\w$]+):", part):
            yield f"{found[1]}:"
            part = part[found.end() :]
        part = " ".join(part.split())
        if part:
            yield part


def split(text):
    """Operands, apart by commas outside of braces."""
    found, depth = [""], count(0)
    depth = 0
    for letter in text:
        depth += {"{": 1, "}": -1}.get(letter, 0)
        if letter == "," and not depth:
            found.append("")
        else:
            found[-1] += letter
    return [each.strip() for each in found if each.strip()]
