"""Packs of floats, on which arithmetic goes at once: the same component of eight runs, or a row's.

A kernel takes pointers to floats or to packs, and is compiled for each; a comparison of packs is a
pack of truths, so that kernels choose by `where` in place of branching.
"""

from __future__ import annotations

import math
import operator
from typing import Any

from llvmlite import binding, ir
from numba import config, types
from numba.core import cgutils
from numba.core.typeconv import Conversion
from numba.core.typing.templates import ConcreteTemplate, infer_global, signature
from numba.extending import intrinsic, lower_builtin, lower_cast, models, register_model

from pgm.kernels.compiled.tables import ROW, RUNS

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
_FLOATS = {lanes: Pack(lanes) for lanes in (RUNS, ROW)}
_TRUTHS = {lanes: Pack(lanes, types.boolean) for lanes in (RUNS, ROW)}
RUN_PACK, ROW_PACK = _FLOATS.values()
NUMBERS = types.CPointer(types.float64)


def splat(builder: Any, value: Any, count: int) -> Any:
    """A pack of equals."""
    kind = ir.VectorType(value.type, count)
    one = builder.insert_element(ir.Constant(kind, ir.Undefined), value, ir.Constant(_INT, 0))
    return builder.shuffle_vector(one, one, ir.Constant(ir.VectorType(_INT, count), [0] * count))


@lower_cast(types.Float, Pack)
@lower_cast(types.Boolean, Pack)
def _spread(context: Any, builder: Any, source: Any, target: Any, value: Any) -> Any:
    return splat(builder, context.cast(builder, value, source, target.scalar), target.lanes)


def _define(function: Any, make: Any, count: int = 2, kinds: str = "ff") -> None:
    """A function of so many packs of floats (f) or truths (t), to one of such."""
    cases = []
    for lanes in (RUNS, ROW):
        argument, result = (_FLOATS[lanes] if kind == "f" else _TRUTHS[lanes] for kind in kinds)
        cases.append(signature(result, *[argument] * count))
        lower_builtin(function, *cases[-1].args)(
            lambda _, builder, kind, given: make(builder, *given)
        )
    infer_global(function)(type("_Typed", (ConcreteTemplate,), {"cases": cases}))


def _call(builder: Any, name: str, given: Any) -> Any:
    kind = given[0].type
    function = ir.FunctionType(kind, [kind] * len(given))
    return builder.call(cgutils.get_or_insert_function(builder.module, function, name), given)


def _intrinsic(name: str) -> Any:
    def make(builder: Any, *given: Any) -> Any:
        count = getattr(given[0].type, "count", 0)
        return _call(builder, f"llvm.{name}.{f'v{count}' if count else ''}f64", given)

    return make


def _vectors() -> tuple[int, str]:
    """How many floats functions of glibc's vector library take, and what their names begin with."""
    try:
        binding.load_library_permanently("libmvec.so.1")
        has = binding.get_host_cpu_features().get
    except RuntimeError:
        return 1, ""
    if config.CPU_NAME or config.CPU_FEATURES is not None:  # code may be for another processor
        return 1, ""
    return (8, "_ZGVeN8") if has("avx512f") else (4, "_ZGVdN4") if has("avx2") else (1, "")


_TOGETHER, _PREFIX = _vectors()


def _of_c(name: str) -> Any:
    """A function of C's, of as many floats at once as the processor and its library can."""

    def make(builder: Any, *given: Any) -> Any:
        count, symbol = given[0].type.count, f"{_PREFIX}{'v' * len(given)}_{name}"
        if count > 1 and (count != _TOGETHER or binding.address_of_symbol(symbol) is None):
            halves = []
            for first in (0, count // 2):
                places = ir.Constant(
                    ir.VectorType(_INT, count // 2), [*range(first, first + count // 2)]
                )
                halves.append(make(builder, *[builder.shuffle_vector(x, x, places) for x in given]))
            whole = ir.Constant(ir.VectorType(_INT, count), [*range(count)])
            return builder.shuffle_vector(*halves, whole)
        if count > 1:
            return _call(builder, symbol, given)
        first = ir.Constant(_INT, 0)
        return splat(
            builder, _call(builder, name, [builder.extract_element(x, first) for x in given]), 1
        )

    return make


def of_c(name: str, count: int) -> Any:
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

    return one if count == 1 else two


def _divided(builder: Any, x: Any, y: Any) -> tuple[Any, Any]:
    """The remainder of C's, of the sign of x, and whether Python's, of that of y, is another."""
    rest, zero = builder.frem(x, y), ir.Constant(x.type, [0.0] * x.type.count)
    other = builder.xor(builder.fcmp_ordered("<", rest, zero), builder.fcmp_ordered("<", y, zero))
    return rest, builder.and_(other, builder.fcmp_ordered("!=", rest, zero))


def _remainder(builder: Any, x: Any, y: Any) -> Any:
    rest, other = _divided(builder, x, y)
    return builder.select(other, builder.fadd(rest, y), rest)


def _quotient(builder: Any, x: Any, y: Any) -> Any:
    rest, other = _divided(builder, x, y)
    one, zero = (ir.Constant(x.type, [value] * x.type.count) for value in (1.0, 0.0))
    found = builder.fdiv(builder.fsub(x, rest), y)
    found = builder.select(other, builder.fsub(found, one), found)
    none = builder.fcmp_ordered("==", y, zero)
    return builder.select(none, builder.fdiv(x, y), _intrinsic("rint")(builder, found))


def _fused(name: str) -> Any:
    return lambda builder, x, y: getattr(builder, name)(x, y, flags=("contract",))


def _compared(sign: str) -> Any:
    if sign == "!=":
        return lambda builder, x, y: builder.fcmp_unordered(sign, x, y)
    return lambda builder, x, y: builder.fcmp_ordered(sign, x, y)


for _name, _instruction in (("add", "fadd"), ("sub", "fsub"), ("mul", "fmul"), ("truediv", "fdiv")):
    _define(getattr(operator, _name), _fused(_instruction))
    _define(getattr(operator, f"i{_name}"), _fused(_instruction))
for _name, _sign in {"lt": "<", "le": "<=", "gt": ">", "ge": ">=", "eq": "==", "ne": "!="}.items():
    _define(getattr(operator, _name), _compared(_sign), kinds="ft")
_define(operator.mod, _remainder)
_define(operator.floordiv, _quotient)
_define(operator.and_, lambda builder, x, y: builder.and_(x, y), kinds="tt")
_define(operator.or_, lambda builder, x, y: builder.or_(x, y), kinds="tt")
_define(operator.neg, lambda builder, x: builder.fneg(x), 1)
_define(math.sqrt, _intrinsic("sqrt"), 1)
_define(abs, _intrinsic("fabs"), 1)
_define(math.log, _of_c("log"), 1)


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
    pack = next((kind for kind in (truth, yes, no) if isinstance(kind, Pack)), None)
    kind = _FLOATS[pack.lanes] if pack else types.float64
    truth = _TRUTHS[pack.lanes] if pack else types.boolean
    return kind(truth, kind, kind), lambda context, builder, kind, given: builder.select(*given)


@intrinsic
def opposite(typing: Any, truth: Any) -> Any:
    """Not."""
    return truth(truth), lambda context, builder, kind, given: builder.not_(*given)


@intrinsic
def bits(typing: Any, truth: Any) -> Any:
    """Truths as the bits of a number."""

    def made(context: Any, builder: Any, kind: Any, given: Any) -> Any:
        found = builder.bitcast(given[0], ir.IntType(getattr(truth, "lanes", 1)))
        return builder.zext(found, ir.IntType(64))

    return types.int64(truth), made


@intrinsic
def per_row(typing: Any, pointer: Any) -> Any:
    """To how many floats, or packs of runs, a row of a matrix is filled up."""
    count = 1 if isinstance(pointer, Packs) else ROW
    return types.int64(pointer), lambda *_: ir.Constant(ir.IntType(64), count)


def _rounding(name: str) -> Any:
    make = _intrinsic(name)

    @intrinsic
    def rounded(typing: Any, value: Any) -> Any:
        return value(value), lambda context, builder, kind, given: make(builder, *given)

    return rounded


# The nearest whole number, and others.
whole, floor, ceil, trunc = (_rounding(name) for name in ("rint", "floor", "ceil", "trunc"))
