"""Traced numbers, and arrays of them that NumPy's functions accept.

An array of traced numbers is an ndarray of objects: indexing, views, writes and whatever NumPy
builds of ufuncs are NumPy's own. Its ufuncs come here. Where NumPy casts a traced number to a
float, to write it in an array of floats, a *stand-in* is written, which is known again when
the array comes back; computing with one is found out by tracing again with other stand-ins.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import Any

import numpy as np
from numpy.lib.mixins import NDArrayOperatorsMixin

from pgm.tracing.graph import Graph
from pgm.tracing.operations import SCALAR

# Stand-ins that differ in size, sign and order, so that a comparison turns out in two ways.
STAND_INS = (1e-3, -1e100, 1e100, math.nan)


class Untraceable(Exception):
    """The reason why a function has no trace."""


class Recorder(Graph):
    """A graph during recording, with the stand-ins handed to the user's function."""

    def __init__(self, limit: float = np.inf, kind: int = 0) -> None:
        super().__init__()
        self.limit, self.kind = limit, kind
        self.refusal: str | None = None
        self.errors = np.geterr()
        self._numbers: dict[bytes, int] = {}

    def refuse(self, reason: str) -> Untraceable:
        """The error of a function without a trace; where a user's code catches it, too."""
        self.refusal = self.refusal or reason
        return Untraceable(reason)

    def add(self, name: str, *operands: int) -> int:
        """Add an operation on earlier nodes; returns its node number."""
        if len(self.operations) > self.limit:
            raise self.refuse(f"it has more than {self.limit} operations on single numbers")
        return super().add(name, *operands)

    def number(self, value: Any) -> int:
        """The number of an element of an array: traced, a stand-in, or a constant."""
        if isinstance(value, Node):
            if value.graph is not self:
                raise self.refuse("it holds numbers of an earlier call")
            return value.number
        if isinstance(value, float) and self._numbers:
            found = self._numbers.get(struct.pack("d", value))
            if found is not None:
                return found
        if isinstance(value, bool | np.bool_ | int | float | np.integer | np.floating):
            return self.constant(value if isinstance(value, bool | np.bool_) else float(value))
        if value is None:
            raise self.refuse("it returns cells of an array that were never written")
        raise self.refuse(f"it computes with {type(value).__name__}, which is no real number")

    def stand_in(self, number: int) -> float:
        """A float that stands for a traced number in arrays of floats."""
        size = STAND_INS[self.kind]
        found = size * (1.0 + (number + 1) * 0.6180339887498949 % 1.0)
        if math.isnan(size):  # its payload survives copies
            found = struct.unpack("<d", struct.pack("<Q", 0x7FF8_5A00_0000_0001 + number))[0]
        self._numbers[struct.pack("d", found)] = number
        return found

    @property
    def cast(self) -> bool:
        """Whether any stand-in was given out."""
        return bool(self._numbers)


class Node(NDArrayOperatorsMixin):
    """A traced number, a node of the graph."""

    __slots__ = ("graph", "number")
    __hash__ = object.__hash__

    def __init__(self, graph: Recorder, number: int) -> None:
        self.graph, self.number = graph, number

    def __array_ufunc__(self, ufunc: np.ufunc, method: str, *inputs: Any, **options: Any) -> Any:
        """Apply one of NumPy's functions, which operators are made of."""
        arrays = any(isinstance(each, (np.ndarray, list, tuple)) for each in inputs)
        if arrays or options or method != "__call__":
            return _applied(ufunc, method, inputs, options)
        return scalar(ufunc.__name__, *inputs)

    def __float__(self) -> float:
        return self.graph.stand_in(self.number)

    def __bool__(self) -> bool:
        raise self.graph.refuse("it branches on a value; np.where does not")

    def __index__(self) -> int:
        raise self.graph.refuse("it looks a value up, as an index")

    def __int__(self) -> int:
        raise self.graph.refuse("it makes an integer of a value")

    def apply(self, name: str) -> Any:
        """The function of NumPy's that has this name."""
        return scalar(name, self)

    @staticmethod
    def choose(truth: Any, a: Any, b: Any) -> Any:
        """The number a where a truth holds, b elsewhere."""
        return scalar("where", truth, a, b)

    def __getattr__(self, name: str) -> Any:
        # NumPy calls a method of each element of a plain array of objects, such as `sin`.
        if not name.startswith("_") and isinstance(getattr(np, name, None), np.ufunc):
            return lambda *others: scalar(name, self, *others)
        raise AttributeError(f"a traced number has no {name!r}")


for _name in ("floor", "ceil", "trunc"):  # which NumPy calls in Python's way
    setattr(Node, f"__{_name}__", lambda self, name=_name: scalar(name, self))


def scalar(name: str, *operands: Any) -> Any:
    """A NumPy function applied to single elements: traced numbers and constants."""
    name = _ALIASES.get(name, name)
    g = next((each.graph for each in operands if isinstance(each, Node)), None)
    if g is None:
        with np.errstate(all="ignore"):
            return np.asarray(getattr(np, name)(*operands)).item()
    if name in _COMPOSED:
        return _COMPOSED[name](*operands)
    numbers = [g.number(each) for each in operands]
    exponent = g.value(numbers[1]) if name == "power" else None
    if exponent in _POWERS:
        return _POWERS[exponent](operands[0])
    truths = [g.is_boolean(k) for k in numbers]
    if name in _TRUTHS:  # NumPy takes any number but zero for true
        pairs = zip(numbers, truths, strict=True)
        numbers = [k if t else g.add("not_equal", k, g.constant(0.0)) for k, t in pairs]
        name = _TRUTHS[name]
    elif all(truths) and name in ("subtract", "negative"):
        raise g.refuse(f"it takes np.{name} of truth values")
    elif all(truths):
        name = {"add": "logical_or", "multiply": "logical_and"}.get(name, name)
    else:
        for i, truth in enumerate(truths):
            if truth and (name, i) != ("where", 0):
                numbers[i] = g.add("where", numbers[i], g.constant(1.0), g.constant(0.0))
    if name not in SCALAR and name != "fma":
        raise g.refuse(f"np.{name} is not traced")
    return Node(g, g.add(name, *numbers))


_ALIASES = {
    "bitwise_and": "logical_and",
    "bitwise_or": "logical_or",
    "bitwise_xor": "logical_xor",
    "invert": "logical_not",
    "conjugate": "positive",
    "fabs": "absolute",
    "float_power": "power",
    "deg2rad": "radians",
    "rad2deg": "degrees",
}
_TRUTHS = {name: name for name in ("logical_and", "logical_or", "logical_not")}
_TRUTHS["logical_xor"] = "not_equal"
_POWERS: dict[Any, Callable[[Any], Any]] = {
    2.0: lambda a: a * a,
    1.0: lambda a: a,
    0.5: lambda a: a.sqrt(),
    -1.0: lambda a: 1.0 / a,
}
# Functions that are made of others.
_COMPOSED: dict[str, Callable[..., Any]] = {
    "positive": lambda a: a,
    "square": lambda a: a * a,
    "reciprocal": lambda a: 1.0 / a,
    "clip": lambda a, low, high: scalar("minimum", scalar("maximum", a, low), high),
    "radians": lambda a: a * (np.pi / 180.0),
    "degrees": lambda a: a * (180.0 / np.pi),
    "isnan": lambda a: a != a,
    "isfinite": lambda a: a - a == 0.0,
    "isinf": lambda a: abs(a) == np.inf,
    "heaviside": lambda a, b: scalar("where", a == 0.0, b, 0.5 * (scalar("sign", a) + 1.0)),
    "fmax": lambda a, b: _numeric(a, b, "maximum"),
    "fmin": lambda a, b: _numeric(a, b, "minimum"),
}


def _numeric(a: Any, b: Any, name: str) -> Any:
    """The larger or smaller number, where one is a NaN the other."""
    unless = scalar("where", scalar("not_equal", b, b), a, scalar(name, a, b))
    return scalar("where", scalar("not_equal", a, a), b, unless)


class Traced(np.ndarray[Any, Any]):
    """An array of traced numbers and constants."""

    def __array_ufunc__(self, ufunc: np.ufunc, method: str, *inputs: Any, **options: Any) -> Any:
        """Apply one of NumPy's functions, element by element."""
        return _applied(ufunc, method, inputs, options)

    def __array_function__(
        self, func: Callable[..., Any], types: Any, args: Any, kwargs: Any
    ) -> Any:
        """Apply a function that NumPy makes of others, or one of our own in its place."""
        kwargs.pop("dtype", None)  # traced numbers are floats
        if func in _OWN:
            return _OWN[func](*args, **kwargs)
        return wrapped(super().__array_function__(func, types, args, kwargs))

    def __getitem__(self, key: Any) -> Any:
        return wrapped(super().__getitem__(key))

    def __setitem__(self, key: Any, value: Any) -> None:
        value = bare(value)
        if isinstance(key, np.ndarray) and key.dtype == object and key.shape == self.shape:
            key, value = ..., bare(elementwise("where", key, value, self))  # a mask
        bare(self)[key] = value.item() if value.ndim == 0 else value

    def __iter__(self) -> Iterator[Any]:
        return (self[k] for k in range(len(self)))

    def fused(self, a: Any, b: Any) -> Any:
        """The numbers a b − x of numbers x, rounded once: where x is a b, the rounding of it."""
        return elementwise("fma", a, b, -self)

    def astype(self, dtype: Any, *_: Any, **__: Any) -> Any:
        """A copy; traced numbers are floats."""
        if np.dtype(dtype) not in (np.dtype(float), np.dtype(object)):
            raise _refused(self, f"it makes {np.dtype(dtype).name} of values")
        return self.copy("K")


def bare(value: Any) -> Any:
    """A plain array, of objects where its elements are traced."""
    if isinstance(value, Node):  # in which NumPy would look for an array
        found = np.empty((), dtype=object)
        found[()] = value
        return found
    found = np.asarray(value)
    if found.dtype == object and any(isinstance(each, np.ndarray) for each in found.flat):
        # NumPy keeps arrays without axes as elements of a list's.
        alone = np.empty(found.shape, dtype=object)
        alone.ravel()[:] = [e.item() if isinstance(e, np.ndarray) else e for e in found.flat]
        return alone
    return found


def wrapped(value: Any) -> Any:
    """An object array or traced number as a traced array; any other value unchanged."""
    if isinstance(value, Node):
        value = bare(value)
    if type(value) is np.ndarray and value.dtype == object:
        return value.view(Traced)
    if type(value) in (list, tuple):
        return type(value)(map(wrapped, value))
    return value


def elementwise(name: str, *operands: Any) -> Any:
    """A NumPy function applied elementwise, with broadcasting."""
    handler = np.frompyfunc(partial(scalar, name), len(operands), 1)
    return wrapped(handler(*map(bare, operands)))


def traced_elements(g: Recorder, array: Any) -> Any:
    """An array of objects: each element a traced number, stand-ins as well."""
    numbered = np.frompyfunc(lambda value: Node(g, g.number(value)), 1, 1)
    return bare(numbered(bare(array).astype(object)))


def _recorder(*arrays: Any) -> Recorder | None:
    objects = (array for array in arrays if array.dtype == object)
    return next((e.graph for a in objects for e in a.flat if isinstance(e, Node)), None)


def _refused(array: Any, reason: str) -> Untraceable:
    return (_recorder(array) or Recorder()).refuse(reason)


def _applied(ufunc: np.ufunc, method: str, inputs: Any, options: dict[str, Any]) -> Any:
    arrays = [bare(value) for value in inputs]
    g = _recorder(*arrays)
    if g is not None and np.geterr() != g.errors and {"raise", "call"} & {*np.geterr().values()}:
        raise g.refuse("it makes NumPy raise errors")
    if g is not None and g.cast:
        arrays = [traced_elements(g, a) if a.dtype.kind == "f" else a for a in arrays]
    out, where = options.pop("out", None), options.pop("where", True)
    for ignored in ("dtype", "casting", "order", "subok"):
        options.pop(ignored, None)
    if ufunc.signature is not None:  # matmul and its like know objects
        result = bare(ufunc(*arrays, **options))
    else:
        identity = {} if ufunc.identity is None else {"identity": ufunc.identity}
        handler = np.frompyfunc(partial(scalar, ufunc.__name__), ufunc.nin, 1, **identity)
        if method == "reduce" and ufunc is np.add:  # truth values are counted
            arrays[0] = bare(elementwise("multiply", arrays[0], 1.0))
        if method != "__call__" and where is not True:
            options["where"], where = where, True
        result = bare(getattr(handler, method)(*arrays, **options))
    if out is None:
        if where is not True:
            raise _refused(result, "it takes where= without out=")
        return wrapped(result)
    if where is not True:
        result = bare(elementwise("where", where, result, out[0]))
    out[0][...] = wrapped(result)
    return out[0]


def _where(condition: Any, *values: Any) -> Any:
    if not values:
        raise _refused(bare(condition), "it looks for places of values")
    return elementwise("where", condition, *values)


def _select(conditions: Sequence[Any], choices: Sequence[Any], default: Any = 0.0) -> Any:
    for condition, choice in zip(reversed(conditions), reversed(choices), strict=True):
        default = elementwise("where", condition, choice, default)
    return default


def _nan_to_num(
    x: Any, copy: bool = True, nan: float = 0.0, posinf: Any = None, neginf: Any = None
) -> Any:
    big = np.finfo(float).max
    found = elementwise("where", np.isnan(x), nan, x)
    found = elementwise("where", np.equal(x, np.inf), big if posinf is None else posinf, found)
    return elementwise("where", np.equal(x, -np.inf), -big if neginf is None else neginf, found)


# NumPy's own of these know floats alone.
_OWN: dict[Any, Callable[..., Any]] = {
    np.where: _where,
    np.select: _select,
    np.nan_to_num: _nan_to_num,
}
