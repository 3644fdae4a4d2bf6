"""Traced numbers, and arrays of them that NumPy's own functions take.

An array of traced numbers is an ndarray of objects: indexing, views, writes and whatever NumPy
builds of ufuncs are NumPy's own. Its ufuncs come here. Where NumPy casts a traced number to a
float, to write it in an array of floats, a *stand-in* is written, which is known again when
the array comes back; computing with one is found out by tracing again with other stand-ins.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import numpy as np

from pgm.tracing.graph import Graph
from pgm.tracing.operations import SCALAR

# NumPy's functions that are done here in another way than NumPy's (`functions.py`).
OWN: dict[Any, Callable[..., Any]] = {}
# Stand-ins that differ in size, sign and order, so that a comparison turns out in two ways.
STAND_INS = (1e-3, -1e100, 1e100, math.nan)


class Untraceable(Exception):
    """The reason why a function has no trace."""


class Recorder(Graph):
    """A graph that is being recorded, with the stand-ins that were given out."""

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
        """The number of an operation on earlier ones."""
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


class Node:
    """A traced number."""

    __slots__ = ("graph", "number")
    __array_priority__ = 1.0

    def __init__(self, graph: Recorder, number: int) -> None:
        self.graph, self.number = graph, number

    def __array_ufunc__(self, ufunc: np.ufunc, method: str, *inputs: Any, **options: Any) -> Any:
        """Apply one of NumPy's functions."""
        return _applied(ufunc, method, inputs, options)

    def __float__(self) -> float:
        return self.graph.stand_in(self.number)

    def __bool__(self) -> bool:
        raise self.graph.refuse("it branches on a value; np.where does not")

    def __index__(self) -> int:
        raise self.graph.refuse("it looks a value up, as an index")

    def __int__(self) -> int:
        raise self.graph.refuse("it makes an integer of a value")

    def __complex__(self) -> complex:
        raise self.graph.refuse("it makes a complex number of a value")

    def conjugate(self) -> Node:
        """The number itself, which is real."""
        return self

    def __getattr__(self, name: str) -> Any:
        # NumPy calls a method of each element of a plain array of objects, such as `sin`.
        if not name.startswith("_") and isinstance(getattr(np, name, None), np.ufunc):
            return lambda *others: scalar(name, self, *others)
        raise AttributeError(f"a traced number has no {name!r}")


def _operator(name: str, *, swapped: bool = False) -> Callable[..., Any]:
    def apply(self: Node, *others: Any) -> Any:
        operands = (*others, self) if swapped else (self, *others)
        arrays = any(isinstance(other, np.ndarray) for other in others)
        return getattr(np, name)(*operands) if arrays else scalar(name, *operands)

    return apply


def _pairs(text: str) -> Iterator[list[str]]:
    return (pair.split("=") for pair in text.split())


_BINARY = "add=add sub=subtract mul=multiply truediv=divide pow=power mod=remainder "
_BINARY += "floordiv=floor_divide and=logical_and or=logical_or xor=logical_xor"
_OTHERS = "lt=less le=less_equal gt=greater ge=greater_equal eq=equal ne=not_equal "
_OTHERS += "neg=negative pos=positive abs=absolute invert=invert floor=floor ceil=ceil trunc=trunc"
for _name, _own in _pairs(_BINARY):
    setattr(Node, f"__{_name}__", _operator(_own))
    setattr(Node, f"__r{_name}__", _operator(_own, swapped=True))
for _name, _own in _pairs(_OTHERS):
    setattr(Node, f"__{_name}__", _operator(_own))
Node.__hash__ = object.__hash__  # type: ignore[method-assign]


def scalar(name: str, *operands: Any) -> Any:
    """One of NumPy's functions, of single elements: traced numbers and constants."""
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
    elif all(truths) and name in ("add", "multiply"):
        name = {"add": "logical_or", "multiply": "logical_and"}[name]
    elif all(truths) and name in ("subtract", "negative"):
        raise g.refuse(f"it takes np.{name} of truth values")
    elif any(truths) and not (name == "where" and all(truths)):
        for i in range(1 if name == "where" else 0, len(numbers)):
            if truths[i]:
                numbers[i] = g.add("where", numbers[i], g.constant(1.0), g.constant(0.0))
    if name not in SCALAR:
        raise g.refuse(f"np.{name} is not traced")
    return Node(g, g.add(name, *numbers))


_ALIASES = dict(
    _pairs(
        "radians=deg2rad degrees=rad2deg float_power=power bitwise_and=logical_and fabs=absolute "
        "bitwise_or=logical_or bitwise_xor=logical_xor invert=logical_not conjugate=positive"
    )
)
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
    "deg2rad": lambda a: a * (np.pi / 180.0),
    "rad2deg": lambda a: a * (180.0 / np.pi),
    "isnan": lambda a: a != a,
    "isfinite": lambda a: a - a == 0.0,
    "isinf": lambda a: abs(a) == np.inf,
    "heaviside": lambda a, b: scalar(
        "where", scalar("equal", a, 0.0), b, 0.5 * (scalar("sign", a) + 1.0)
    ),
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
        own = OWN.get(func)
        if own is not None:
            return own(*args, **kwargs)
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

    def __bool__(self) -> bool:
        return bool(self.item())

    def astype(self, dtype: Any, *_: Any, **__: Any) -> Any:
        """A copy; traced numbers are floats."""
        if np.dtype(dtype) not in (np.dtype(float), np.dtype(object)):
            raise self._refuse(f"it makes {np.dtype(dtype).name} of values")
        return self.copy("K")

    def clip(self, min: Any = None, max: Any = None, out: Any = None, **_: Any) -> Any:
        """Values moved to within bounds."""
        found = self if min is None else np.maximum(self, min)
        return found if max is None else np.minimum(found, max)

    def _refuse(self, reason: str) -> Untraceable:
        for element in self.flat:
            if isinstance(element, Node):
                return element.graph.refuse(reason)
        return Untraceable(reason)


def bare(value: Any) -> Any:
    """A plain array, of objects where its elements are traced."""
    if isinstance(value, Node):
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
    """An array of objects, or a traced number, as a traced array; anything else as it is."""
    if type(value) is np.ndarray and value.dtype == object:
        return value.view(Traced)
    if isinstance(value, Node):
        return bare(value).view(Traced)
    if isinstance(value, list | tuple) and any(type(v) is np.ndarray for v in value):
        return type(value)(map(wrapped, value)) if type(value) in (list, tuple) else value
    return value


def elementwise(name: str, *operands: Any) -> Any:
    """One of NumPy's functions, of arrays that are broadcast against each other."""
    handler = np.frompyfunc(partial(scalar, name), len(operands), 1)
    return wrapped(handler(*map(bare, operands)))


def _applied(ufunc: np.ufunc, method: str, inputs: Any, options: dict[str, Any]) -> Any:
    arrays = [bare(value) for value in inputs]
    g = next(
        (e.graph for a in arrays if a.dtype == object for e in a.flat if isinstance(e, Node)), None
    )
    if g is not None and np.geterr() != g.errors and {"raise", "call"} & {*np.geterr().values()}:
        raise g.refuse("it makes NumPy raise errors")
    arrays = [_known(g, a) for a in arrays]
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
            raise (g or Recorder()).refuse("it takes where= without out=")
        return wrapped(result)
    if where is not True:
        result = bare(elementwise("where", where, result, out[0]))
    out[0][...] = wrapped(result)
    return out[0]


def _known(g: Recorder | None, array: Any) -> Any:
    """An array of floats with its stand-ins as traced numbers again."""
    if g is None or not g.cast or array.dtype.kind != "f":
        return array
    return traced_elements(g, array)


def traced_elements(g: Recorder, array: Any) -> Any:
    """An array of objects: each element a traced number."""
    numbered = np.frompyfunc(lambda value: Node(g, g.number(value)), 1, 1)
    return bare(numbered(bare(array).astype(object)))
