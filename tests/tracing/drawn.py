"""Functions as users write them, drawn: a body, of copies, decisions and tables, in a wrapper.

A drawn function maps a state (..., n) and a control (..., m), which is known, to n numbers. Its
constants come from a holder, which can change them.
"""

from __future__ import annotations

import contextvars
import functools
import os
import sys
import types
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

Function = Callable[..., Any]


class Drawn(NamedTuple):
    """A drawn function of (x, u), how it was composed, and what changes its constants."""

    function: Function
    name: str
    change: Callable[[], None]


# ---------------------------------------------------------------- copies of an argument


def _zeros(v):
    held = np.zeros(v.shape)
    held[...] = v
    return held


def _empty(v):
    held = np.empty(v.shape)
    for i in range(v.shape[-1]):
        held[..., i] = v[..., i]
    return held


def _like(v):
    held = np.zeros_like(v)
    held[...] = v
    return held


def _wide(v):
    held = np.full((*v.shape[:-1], v.shape[-1] + 1), 0.7)
    held[..., 1:] = v
    return held[..., 1:]


def _through(v):
    held = np.empty_like(v, dtype=float)
    np.add(v, 0.0, out=held)
    return held


def _copyto(v):
    held = np.zeros(v.shape)
    np.copyto(held, v)
    return held


def _flat(v):
    return np.fromiter((float(each) for each in v.flat), float, v.size).reshape(v.shape)


COPIES: dict[str, Function] = {
    "itself": lambda v: v,
    "asarray": lambda v: np.asarray(v, dtype=float),
    "array": lambda v: np.array(v, float),
    "astype": lambda v: v.astype(float),
    "astype of an array": lambda v: np.asarray(v).astype(np.float64),
    "copy": lambda v: v.copy(),
    "contiguous": lambda v: np.ascontiguousarray(v, dtype=float),
    "zeros": _zeros,
    "empty": _empty,
    "like": _like,
    "wide": _wide,
    "out": _through,
    "copyto": _copyto,
    "list": lambda v: np.array(v.tolist(), dtype=float),
    "flat": _flat,
    "bytes": lambda v: np.frombuffer(np.ascontiguousarray(v).tobytes()).reshape(v.shape),
    "single precision": lambda v: np.asarray(v, dtype=np.float32).astype(float),
    "sum": lambda v: np.asarray(v, dtype=float) + np.zeros(v.shape),
    "where": lambda v: np.where(np.ones(v.shape, dtype=bool), np.asarray(v, float), 0.0),
    "rounded": lambda v: np.round(np.asarray(v, dtype=float), 6),
    "text": lambda v: np.array([float(f"{each}") for each in np.ravel(v)]).reshape(v.shape),
}

# ------------------------------------- decisions by c, a level k and another; values a and b


def _masked(c, k, a, b):
    found, other = np.asarray(a + 0.0 * c), np.asarray(b + 0.0 * c)
    found[c > k] = other[c > k]
    return found


def _putmask(c, k, a, b):
    found = np.array(a + 0.0 * c, dtype=float)
    np.putmask(found, c > k, b + 0.0 * c)
    return found


def _cases(c, k, a, b):
    return np.piecewise(np.asarray(c, float), [c < k, c >= k], [1.0, 2.0]) * a + b


def _by_dict(c, k, a, b):
    known = {0: 0.5, 1: 1.0, 2: -0.5, 3: 0.2}
    gain = np.vectorize(lambda each: known.get(int(each), 0.1), otypes=[float])(c)
    return gain * a + b


def _int_table(c, k, a, b):
    place = np.clip(np.asarray(c, dtype=float), 0, 3).astype(int)
    return np.array([0.4, 0.9, -0.3, 0.1])[place] * a + b


def _taken(c, k, a, b):
    return np.take([0.4, 0.9, -0.3, 0.1], np.rint(c).astype(int), mode="clip") * a + b


def _branch(c, k, a, b):
    if np.ndim(c) == 0:
        return a if c > k else b
    return np.where(c > k, a, b)


def _tried(c, k, a, b):
    try:
        return a if bool(c > k) else b
    except Exception:
        return np.where(c > k, a, b)


DECISIONS: dict[str, Function] = {
    "none": lambda c, k, a, b: a + 0.1 * b,
    "where >": lambda c, k, a, b: np.where(c > k, a, b),
    "where ==": lambda c, k, a, b: np.where(c == 2, a, b),
    "between": lambda c, k, a, b: np.where((c > 0.5) & (c < 2.5), a, b),
    "isclose": lambda c, k, a, b: np.where(np.isclose(c, 2.0), a, b),
    "select": lambda c, k, a, b: np.select([c == 1, c == 2], [a, b], 0.3 * a),
    "masks": _masked,
    "putmask": _putmask,
    "truths": lambda c, k, a, b: (c > k) * a + (c <= k) * b,
    "not": lambda c, k, a, b: ~(c > k) * a + np.logical_not(c <= k) * b,
    "piecewise": _cases,
    "clip": lambda c, k, a, b: np.clip(c, 0.0, 2.0) * a + b,
    "sign": lambda c, k, a, b: np.sign(c - k) * a + b,
    "heaviside": lambda c, k, a, b: np.heaviside(c - k, 0.5) * a + b,
    "interp": lambda c, k, a, b: np.interp(c, [0.0, 1.0, 2.0], [0.5, 1.0, 0.2]) * a + b,
    "take": _taken,
    "table by int": _int_table,
    "dict by int": _by_dict,
    "searchsorted": lambda c, k, a, b: (
        np.array([0.3, 0.8, -0.4])[np.searchsorted([0.5, 1.5], np.asarray(c, float))] * a + b
    ),
    "digitize": lambda c, k, a, b: np.digitize(np.asarray(c, float), [0.5, 1.5]) * 0.4 * a + b,
    "choose": lambda c, k, a, b: np.choose(np.asarray(c > k, dtype=int), [a, b]),
    "floor": lambda c, k, a, b: np.floor(c + 0.25) * 0.3 * a + b,
    "isin": lambda c, k, a, b: np.where(np.isin(np.asarray(c, float), [0, 2]), a, b),
    "any": lambda c, k, a, b: np.where((np.stack([c, c - 1], -1) == 1).any(axis=-1), a, b),
    "argmax": lambda c, k, a, b: np.where(
        np.argmax(np.stack([np.asarray(c, float), k + 0.0 * c], -1), -1) == 0, a, b
    ),
    "if": _branch,
    "try": _tried,
    "minimum": lambda c, k, a, b: np.minimum(c, 2.0) * a + np.maximum(c, k) * 0.2 * b,
    "nan": lambda c, k, a, b: np.where(np.isnan(np.where(c > k, np.nan, c)), a, b),
    "power": lambda c, k, a, b: np.power(0.5, np.asarray(c, float)) * a + b,
    "count": lambda c, k, a, b: (np.stack([c, c + 1], -1) > k).sum(axis=-1) * 0.4 * a + b,
    "bits": lambda c, k, a, b: np.where(np.asarray(c, float).astype(int) & 1, a, b),
}

# Those that tracing can follow.
TRACED = (
    "none", "where >", "where ==", "between", "select", "masks", "truths", "clip", "sign",
    "heaviside", "floor", "any", "minimum", "nan", "power", "count",
)  # fmt: skip
# Those that jump, or turn, where c is a whole number.
AT_NUMBERS = ("where ==", "isclose", "select", "isin", "any")

# ------------------------------------------------------------- outputs made of components


def _out_zeros(parts):
    parts = np.broadcast_arrays(*parts)
    out = np.zeros((*parts[0].shape, len(parts)))
    for i, part in enumerate(parts):
        out[..., i] = part
    return out


def _out_empty(parts):
    parts = np.broadcast_arrays(*parts)
    out = np.empty((len(parts), *parts[0].shape))
    for i, part in enumerate(parts):
        out[i] = part
    return np.moveaxis(out, 0, -1)


def _out_like(parts):
    parts = np.broadcast_arrays(*parts)
    out = np.empty_like(np.stack(parts, -1))
    for i, part in enumerate(parts):
        out[..., i] = part
    return out


def _out_added(parts):
    parts = np.broadcast_arrays(*parts)
    out = np.zeros((*parts[0].shape, len(parts)))
    for i, part in enumerate(parts):
        out[..., i] += part
    return out


class _Kept:
    """The same memory at each call, as of programs that save allocations."""

    def __init__(self):
        self.memory = {}

    def __call__(self, parts):
        parts = np.broadcast_arrays(*parts)
        shape = (*parts[0].shape, len(parts))
        out = self.memory.setdefault(shape, np.empty(shape))
        for i, part in enumerate(parts):
            out[..., i] = part
        return out


def _out_fortran(parts):
    parts = np.broadcast_arrays(*parts)
    return np.asfortranarray(np.stack(parts, -1))


OUTPUTS: dict[str, Function] = {
    "stack": lambda parts: np.stack(np.broadcast_arrays(*parts), axis=-1),
    "zeros": _out_zeros,
    "empty": _out_empty,
    "like": _out_like,
    "added": _out_added,
    "kept": _Kept(),
    "fortran": _out_fortran,
    "moveaxis": lambda parts: np.moveaxis(np.array(np.broadcast_arrays(*parts)), 0, -1),
    "float": lambda parts: np.moveaxis(np.array(np.broadcast_arrays(*parts), float), 0, -1),
    "concatenate": lambda parts: np.concatenate(
        [part[..., None] for part in np.broadcast_arrays(*parts)], axis=-1
    ),
    "insert": lambda parts: np.insert(np.stack(np.broadcast_arrays(*parts), -1), 0, 0.0, axis=-1)[
        ..., 1:
    ],
    "masked": lambda parts: np.ma.asarray(np.stack(np.broadcast_arrays(*parts), -1)),
}

# --------------------------------------------------------------- wrappers of (p) -> (x, u)


class _Robot:
    def __init__(self, body, get):
        self.body, self.get, self.last, self.calls = body, get, None, 0

    def __call__(self, x, u):
        self.last, self.calls = x, self.calls + 1
        return self.body(x, u, self.get())

    def move(self, x, u):
        return self(x, u)

    @property
    def motion(self):
        return lambda x, u: self(x, u)


def _logged(body, get):
    def logged(function):
        seen = []

        @functools.wraps(function)
        def inner(*args, **more):
            seen.append(len(args))
            return function(*args, **more)

        return inner

    @logged
    def moved(x, u):
        return body(x, u, get())

    return moved


def _helped(body, get):
    @functools.lru_cache(maxsize=8)
    def helper(*p):
        return tuple(1.0 * each for each in p)

    return lambda x, u: body(x, u, helper(*get()))


def _quiet(body, get):
    def moved(x, u):
        with np.errstate(all="ignore"):
            return body(x, u, get())

    return moved


def _caught(body, get):
    def moved(x, u):
        try:
            return body(np.asarray(x, dtype=float), np.asarray(u, dtype=float), get())
        except Exception:
            return body(x, u, get())

    return moved


def _executed(body, get):
    space = {"body": body, "get": get}
    exec("def moved(x, u):\n    return body(x, u, get())", space)
    return space["moved"]


def _each(body, get):
    """Row by row, as of functions that were written for one vector."""

    def moved(x, u):
        if x.ndim == 1:
            return body(x, u, get())
        wide = np.broadcast_to(u, (*x.shape[:-1], u.shape[-1]))
        return np.stack([moved(a, b) for a, b in zip(x, wide, strict=True)])

    return moved


WRAPPERS: dict[str, Function] = {
    "closure": lambda body, get: lambda x, u: body(x, u, get()),
    "callable": _Robot,
    "method": lambda body, get: _Robot(body, get).move,
    "property": lambda body, get: _Robot(body, get).motion,
    "partial": lambda body, get: functools.partial(
        lambda own, source, x, u: own(x, u, source()), body, get
    ),
    "wraps": _logged,
    "lru_cache": _helped,
    "vectorize": lambda body, get: np.vectorize(
        lambda x, u: body(x, u, get()), signature="(n),(m)->(n)"
    ),
    "errstate": _quiet,
    "try": _caught,
    "exec": _executed,
    "rows": _each,
    "apply": lambda body, get: lambda x, u: _joined(body, get, x, u),
}


def _joined(body, get, x, u):
    n = x.shape[-1]
    both = np.concatenate([x, np.broadcast_to(u, (*x.shape[:-1], u.shape[-1]))], axis=-1)
    return np.apply_along_axis(lambda row: body(row[:n], row[n:], get()), -1, both)


# -------------------------------------------- holders of constants: (get, change), of (old, new)


def _listed(old, new):
    known = list(old)
    return lambda: known, lambda: known.__setitem__(slice(None), new)


def _array(old, new):
    known = np.array(old)
    return lambda: known, lambda: known.__setitem__(slice(None), new)


def _dict(old, new):
    known = {"p": old}
    return lambda: known["p"], lambda: known.update(p=new)


def _attribute(old, new):
    known = types.SimpleNamespace(p=old)
    return lambda: known.p, lambda: setattr(known, "p", new)


def _class(old, new):
    known = type("Known", (), {"p": old})
    made = known()
    return lambda: made.p, lambda: setattr(known, "p", new)


def _default(old, new):
    def get(p=old):
        return p

    return get, lambda: setattr(get, "__defaults__", (new,))


def _keyword(old, new):
    def get(*, p=old):
        return p

    return get, lambda: get.__kwdefaults__.update(p=new)


def _cell(old, new):
    def get():
        return old

    return get, lambda: setattr(get.__closure__[0], "cell_contents", new)


def _code(old, new):
    def get():
        return old

    def other():
        return new

    def change():
        get.__closure__[0].cell_contents = new
        get.__code__ = other.__code__.replace(co_freevars=get.__code__.co_freevars)

    return get, change


def _partial(old, new):
    get = functools.partial(lambda *, p: p, p=old)
    return get, lambda: get.keywords.update(p=new)


def _method(old, new):
    known = types.SimpleNamespace(get=lambda: old)
    return lambda: known.get(), lambda: setattr(known, "get", lambda: new)


def _swapped(old, new):
    first, second = type("A", (), {"p": old}), type("B", (), {"p": new})
    made = first()
    return lambda: made.p, lambda: setattr(made, "__class__", second)


def _module(old, new):
    module = types.ModuleType("pgm_drawn_settings")
    module.p = old
    sys.modules[module.__name__] = module

    def get():
        return sys.modules["pgm_drawn_settings"].p if alone() else module.p

    def alone():
        return sys.modules["pgm_drawn_settings"] is module

    return get, lambda: setattr(module, "p", new)


def _context(old, new):
    known = contextvars.ContextVar("known", default=old)
    return known.get, lambda: known.set(new) and None


def _environment(old, new):
    name = f"PGM_DRAWN_{id(old)}"
    os.environ[name] = repr([float(each) for each in old])

    def get():
        return [float(each) for each in os.environ[name][1:-1].split(",")]

    return get, lambda: os.environ.__setitem__(name, repr([float(each) for each in new]))


def _cached(old, new):
    known = [old]

    @functools.cache
    def get():
        return known[0]

    def change():
        known[0] = new
        get.cache_clear()

    return get, change


HOLDERS = {
    each.__name__[1:]: each
    for each in (
        _listed, _array, _dict, _attribute, _class, _default, _keyword, _cell, _code, _partial,
        _method, _swapped, _module, _context, _environment, _cached,
    )
}  # fmt: skip

# -------------------------------------------------------------------------------- bodies

BODIES: dict[str, Function] = {
    "gain": lambda x, c, p: (p[0] * x, p[1] * x),
    "sine": lambda x, c, p: (p[0] * np.sin(x), p[1] * x + p[2] * np.cos(p[0] * x)),
    "tanh": lambda x, c, p: (x + p[0] * np.tanh(x), p[1] * x / (1.0 + x * x)),
    "control": lambda x, c, p: (p[0] * x + p[2] * c, p[1] * x * np.cos(c)),
    "drag": lambda x, c, p: (x - 0.1 * p[0] * x * np.abs(x), p[1] * np.exp(-x * x)),
    "norm": lambda x, c, p: (p[0] * np.hypot(x, 1.0), p[1] * np.arctan2(x, 1.0 + c * c)),
}


def draw(rng: np.random.Generator, n: int, m: int) -> Drawn:
    """A function of (..., n) and (..., m), how it was drawn, and what changes its constants."""

    def pick(known):
        name = list(known)[rng.integers(len(known))]
        return name, known[name]

    read_u, copy_u = pick(COPIES) if rng.random() < 0.6 else ("itself", COPIES["itself"])
    read_x, copy_x = pick(COPIES) if rng.random() < 0.2 else ("itself", COPIES["itself"])
    decides, decision = pick(DECISIONS)
    if decides not in TRACED and rng.random() < 0.6:
        decides, decision = pick({name: DECISIONS[name] for name in TRACED})
    (wraps, wrapper), (holds, holder), (bodies, body) = pick(WRAPPERS), pick(HOLDERS), pick(BODIES)
    if wraps in ("vectorize", "rows", "apply") and rng.random() < 0.6:
        wraps, wrapper = "closure", WRAPPERS["closure"]
    writes, output = pick(OUTPUTS)
    if writes == "kept":
        if wraps == "rows":  # whose rows would all be the last
            writes, output = "zeros", OUTPUTS["zeros"]
        else:
            output = _Kept()
    old = rng.uniform(0.4, 0.9, 3) * rng.choice([-1, 1], 3)
    new = rng.uniform(0.4, 0.9, 3) * rng.choice([-1, 1], 3)
    by_state = rng.random() < 0.15 and decides not in AT_NUMBERS  # it decides by the state
    level = float(rng.choice([0.37, 1.37]))
    old, new = np.r_[old, level], np.r_[new, level if rng.random() < 0.5 else 2.0 - level]
    which = rng.integers(n)

    def whole(x, u, p):
        v, held = copy_u(u), copy_x(x)
        c = held[..., which] if by_state else v[..., 0]
        first, second = body(held[..., 0], v[..., -1], p)
        parts = [2.0 * np.tanh(0.5 * decision(c, p[3], first, second))]
        parts += [p[1] * held[..., i] + 0.1 * np.sin(x[..., i - 1]) for i in range(1, n)]
        return output(parts)

    get, change = holder(old, new)
    name = f"{bodies} x:{read_x} u:{read_u} {decides}{' by state' * by_state}"
    name += f" -> {writes}; {wraps}, {holds}"
    return Drawn(wrapper(whole, get), name, change)
