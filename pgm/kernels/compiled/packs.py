"""Packs of floats, on which arithmetic goes at once: the same component of eight runs, or a row's.

A kernel takes pointers to floats or to packs, and is compiled for each; a comparison of packs is a
pack of truths, so that kernels choose by `where` in place of branching.
"""

from __future__ import annotations

import math
import operator
from typing import Any

from llvmlite import binding, ir
from numba import types
from numba.core import cgutils
from numba.core.typeconv import Conversion
from numba.core.typing.templates import ConcreteTemplate, infer_global, signature
from numba.extending import intrinsic, lower_builtin, lower_cast, models, register_model

RUNS, ROW = 8, 4  # how many runs go at once, and floats of a row
_DOUBLE, _BIT, _INT = ir.DoubleType(), ir.IntType(1), ir.IntType(32)


class Pack(types.Type):
    """So many floats, or truths."""

    def __init__(self, lanes: int, scalar: Any = types.float64) -> None:
        self.lanes, self.scalar = lanes, scalar
        super().__init__(f"Pack({scalar}, {lanes})")

    def unify(self, typing: Any, other: Any) -> Any:
        """A scalar beside a pack is that in all of its places."""
        return self if self.can_convert_from(typing, other) else None

    def can_convert_from(self, typing: Any, other: Any) -> Any:
        """Scalars of its kind are packs of equals."""
        known = types.Float if self.scalar is types.float64 else types.Boolean
        return Conversion.safe if isinstance(other, known) else None


class Packs(types.CPointer):
    """A pointer to packs, which lie wherever floats may."""


@register_model(Pack)
class _PackModel(models.PrimitiveModel):
    def __init__(self, manager: Any, kind: Pack) -> None:
        each = _DOUBLE if kind.scalar is types.float64 else _BIT
        super().__init__(manager, kind, ir.VectorType(each, kind.lanes))


register_model(Packs)(models.PointerModel)
RUN_PACK, ROW_PACK = Pack(RUNS), Pack(ROW)
_KINDS = [(pack, Pack(pack.lanes, types.boolean)) for pack in (RUN_PACK, ROW_PACK)]
NUMBERS = types.CPointer(types.float64)


def splat(builder: Any, value: Any, count: int) -> Any:
    """A pack of equals."""
    kind = ir.VectorType(value.type, count)
    one = builder.insert_element(ir.Constant(kind, ir.Undefined), value, ir.Constant(_INT, 0))
    return builder.shuffle_vector(one, one, ir.Constant(ir.VectorType(_INT, count), [0] * count))


@lower_cast(types.Float, Pack)
@lower_cast(types.Boolean, Pack)
def _spread(context: Any, builder: Any, source: Any, target: Any, value: Any) -> Any:
    if isinstance(source, types.Float):
        value = context.cast(builder, value, source, types.float64)
    else:
        value = context.cast(builder, value, source, types.boolean)
    return splat(builder, value, target.lanes)


def _define(function: Any, result: int, arguments: int, kinds: int, make: Any) -> None:
    """A function of packs of floats (kind 0) or truths (1)."""
    cases = []
    for pair in _KINDS:
        case = signature(pair[result], *[pair[kinds]] * arguments)
        cases.append(case)

        def lower(context: Any, builder: Any, sig: Any, given: Any) -> Any:
            return make(builder, *given)

        lower_builtin(function, *case.args)(lower)
    infer_global(function)(type("_Typed", (ConcreteTemplate,), {"cases": cases}))


def _intrinsic(name: str) -> Any:
    def make(builder: Any, *given: Any) -> Any:
        kind = given[0].type
        suffix = f"v{kind.count}f64" if isinstance(kind, ir.VectorType) else "f64"
        return _call(builder, kind, f"llvm.{name}.{suffix}", given)

    return make


def _call(builder: Any, kind: Any, name: str, given: Any) -> Any:
    signature = ir.FunctionType(kind, [kind] * len(given))
    return builder.call(cgutils.get_or_insert_function(builder.module, signature, name), given)


def _of_c(name: str) -> Any:
    """A function of C's, of as many floats at once as the processor and its library can."""

    def make(builder: Any, *given: Any) -> Any:
        count = given[0].type.count
        part, prefix = _VECTORS if _VECTORS[0] <= count else (1, "")
        symbol = f"_ZGV{prefix}N{part}{'v' * len(given)}_{name}"
        if part == 1 or binding.address_of_symbol(symbol) is None:
            part, symbol = 1, name
        kind = ir.VectorType(_DOUBLE, part)
        found = ir.Constant(given[0].type, ir.Undefined)
        for first in range(0, count, part):
            places = [ir.Constant(_INT, first + k) for k in range(part)]
            if part == 1:
                one = [builder.extract_element(pack, places[0]) for pack in given]
                value = _call(builder, _DOUBLE, symbol, one)
                found = builder.insert_element(found, value, places[0])
                continue
            chosen = ir.Constant(ir.VectorType(_INT, part), [p.constant for p in places])
            value = _call(
                builder, kind, symbol, [builder.shuffle_vector(p, p, chosen) for p in given]
            )
            if part == count:
                return value
            for k, place in enumerate(places):
                each = builder.extract_element(value, ir.Constant(_INT, k))
                found = builder.insert_element(found, each, place)
        return found

    return make


def _vectors() -> tuple[int, str]:
    """How many floats the functions of glibc's vector library take at once, and their prefix."""
    try:
        binding.load_library_permanently("libmvec.so.1")
    except RuntimeError:
        return 1, ""
    features = binding.get_host_cpu_features()
    kinds = (("avx512f", (8, "e")), ("avx2", (4, "d")))
    return next((kind for name, kind in kinds if features.get(name)), (1, ""))


_VECTORS = _vectors()


def _remainder(builder: Any, x: Any, y: Any) -> Any:
    """As Python's `%`, of the sign of y."""
    rest, zero = builder.frem(x, y), ir.Constant(x.type, [0.0] * x.type.count)
    other = builder.xor(builder.fcmp_ordered("<", rest, zero), builder.fcmp_ordered("<", y, zero))
    other = builder.and_(other, builder.fcmp_ordered("!=", rest, zero))
    return builder.select(other, builder.fadd(rest, y), rest)


def _quotient(builder: Any, x: Any, y: Any) -> Any:
    """As Python's `//`."""
    exact = builder.fdiv(builder.fsub(x, _remainder(builder, x, y)), y)
    return _intrinsic("rint")(builder, exact)


for _name, _sign in (("add", "+"), ("sub", "-"), ("mul", "*"), ("truediv", "/")):
    _instruction = "fdiv" if _sign == "/" else f"f{_name}"
    for _function in (getattr(operator, _name), getattr(operator, f"i{_name}")):
        _define(
            _function,
            0,
            2,
            0,
            lambda b, x, y, i=_instruction: getattr(b, i)(x, y, flags=("contract",)),
        )
for _name, _sign in (("lt", "<"), ("le", "<="), ("gt", ">"), ("ge", ">="), ("eq", "==")):
    _define(getattr(operator, _name), 1, 2, 0, lambda b, x, y, s=_sign: b.fcmp_ordered(s, x, y))
_define(operator.ne, 1, 2, 0, lambda b, x, y: b.fcmp_unordered("!=", x, y))
_define(operator.neg, 0, 1, 0, lambda b, x: b.fneg(x))
_define(operator.mod, 0, 2, 0, _remainder)
_define(operator.floordiv, 0, 2, 0, _quotient)
for _function, _name in ((operator.and_, "and_"), (operator.or_, "or_")):
    _define(_function, 1, 2, 1, lambda b, x, y, n=_name: getattr(b, n)(x, y))
for _function, _name in ((math.sqrt, "sqrt"), (abs, "fabs")):
    _define(_function, 0, 1, 0, _intrinsic(_name))
_define(math.log, 0, 1, 0, _of_c("log"))


def of_c(name: str, arguments: int) -> Any:
    """A function of C's, by its name there, of one or two packs."""
    make = _of_c(name)

    def lower(context: Any, builder: Any, kind: Any, given: Any) -> Any:
        return make(builder, *given)

    @intrinsic
    def one(typing: Any, x: Any) -> Any:
        return x(x), lower

    @intrinsic
    def two(typing: Any, x: Any, y: Any) -> Any:
        kind = x if isinstance(x, Pack) else y
        return kind(kind, kind), lower

    return one if arguments == 1 else two


@lower_builtin(operator.getitem, Packs, types.Integer)
def _load(context: Any, builder: Any, kind: Any, given: Any) -> Any:
    return builder.load(builder.gep(given[0], [given[1]]), align=8)


@lower_builtin(operator.setitem, Packs, types.Integer, types.Any)
def _store(context: Any, builder: Any, kind: Any, given: Any) -> Any:
    value = context.cast(builder, given[2], kind.args[2], kind.args[0].dtype)
    builder.store(value, builder.gep(given[0], [given[1]]), align=8)


@intrinsic
def where(typing: Any, truth: Any, yes: Any, no: Any) -> Any:
    """One or the other number, by a truth."""
    packs = [kind.lanes for kind in (truth, yes, no) if isinstance(kind, Pack)]
    kind = Pack(packs[0]) if packs else types.float64
    truth = Pack(packs[0], types.boolean) if packs else types.boolean

    def made(context: Any, builder: Any, kind: Any, given: Any) -> Any:
        return builder.select(*given)

    return kind(truth, kind, kind), made


@intrinsic
def opposite(typing: Any, truth: Any) -> Any:
    """Not."""
    return truth(truth), lambda context, builder, kind, given: builder.not_(*given)


@intrinsic
def bits(typing: Any, truth: Any) -> Any:
    """Truths as the bits of a number."""

    def made(context: Any, builder: Any, kind: Any, given: Any) -> Any:
        lanes = getattr(truth, "lanes", 1)
        return builder.zext(builder.bitcast(given[0], ir.IntType(lanes)), ir.IntType(64))

    return types.int64(truth), made


def _constant(count: Any) -> Any:
    @intrinsic
    def found(typing: Any, value: Any) -> Any:
        def made(context: Any, builder: Any, kind: Any, given: Any) -> Any:
            return ir.Constant(ir.IntType(64), count(value))

        return types.int64(value), made

    return found


# Of a pointer: how many runs it holds at once; to how many components a row is filled up. Of a
# truth, its bits if it is true of all.
lanes = _constant(lambda kind: RUNS if isinstance(kind, Packs) else 1)
full = _constant(lambda kind: 2 ** getattr(kind, "lanes", 1) - 1)
per_row = _constant(lambda kind: 1 if isinstance(kind, Packs) else ROW)


def _rounding(name: str) -> Any:
    @intrinsic
    def rounded(typing: Any, value: Any) -> Any:
        return value(value), lambda context, builder, kind, given: _intrinsic(name)(builder, *given)

    return rounded


# The nearest whole number, and others.
whole, floor, ceil, trunc = (_rounding(name) for name in ("rint", "floor", "ceil", "trunc"))


@intrinsic
def every(typing: Any, truth: Any) -> Any:
    """Whether all truths of a pack are."""
    return _counted(truth, "==", -1)


@intrinsic
def some(typing: Any, truth: Any) -> Any:
    """Whether one of the truths of a pack is."""
    return _counted(truth, "!=", 0)


def _counted(truth: Any, sign: str, number: int) -> Any:
    def made(context: Any, builder: Any, kind: Any, given: Any) -> Any:
        whole = ir.IntType(getattr(truth, "lanes", 1))
        found = builder.bitcast(given[0], whole)
        return builder.icmp_unsigned(sign, found, ir.Constant(whole, number))

    return types.boolean(truth), made
