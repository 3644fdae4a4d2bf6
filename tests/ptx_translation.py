"""Functions of PTX translated to Python: registers are variables, blocks are branches."""

import math
import re

from ptx_numbers import M32, M64, MASK, F

LOCAL, GENERIC = 1 << 62, 1 << 61  # marks of addresses in local memory: in its space, and generic


def python_name(name):
    """The name of a function in Python."""
    return "function_" + name.replace("$", "_S_")


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
            return (
                f"({found} if {found}.__class__ is float else F({found}))"
                if (found.isidentifier())
                else f"F({found})"
            )
        bits = (
            f"({found} if {found}.__class__ is int else U({found}))"
            if (found.isidentifier())
            else (found if found.isdigit() or "place" in found else f"U({found})")
        )
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
            return (
                f"({both} << {by} >> 32) & {M32}" if "l" in parts else f"({both} >> {by}) & {M32}"
            )
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
            found = {"ne": f"({both} and {a} != {b})", "equ": f"(not {both} or {a} == {b})"}[
                relation
            ]
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
    found, depth = [""], 0
    for letter in text:
        depth += {"{": 1, "}": -1}.get(letter, 0)
        if letter == "," and not depth:
            found.append("")
        else:
            found[-1] += letter
    return [each.strip() for each in found if each.strip()]
