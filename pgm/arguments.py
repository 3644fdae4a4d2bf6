"""Calls that do not fit a public signature, and the argument that was meant."""

from __future__ import annotations

import difflib
import inspect
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import wraps
from typing import Any, TypeVar

T = TypeVar("T", bound=Callable[..., Any])

# By an argument's name here, what it is called elsewhere: in other libraries, and in equations.
ELSEWHERE = {
    "cov": (
        *("std", "stddev", "sigma", "sd", "deviation", "deviations", "scale"),
        *("var", "variance", "variances", "noise", "noise_cov", "Q", "R", "P", "P0", "S"),
    ),
    "mean": ("mu", "loc", "x0", "m0", "value"),
    "offset": ("bias", "intercept", "b", "c", "d"),
    "given": ("parents", "parent", "F", "H", "A", "B", "C", "G", "matrix", "matrices", "weights"),
    "function": ("f", "h", "g", "fn", "fun", "func", "hx", "fx"),
    "jacobian": ("jac", "gradient", "derivative", "derivatives", "HJacobian"),
    "table": ("values", "probabilities", "probs", "cpt", "cpd", "p"),
    "iterations": (
        *("max_iterations", "max_iter", "maxiter", "max_iters", "n_iter", "n_iterations"),
        *("num_iterations", "niter", "iters", "max_steps"),
    ),
    "tolerance": ("rtol", "atol", "xtol", "ftol", "eps", "epsilon"),
    "lineariser": ("rule", "approximation", "sigma_points", "points"),
    "schedule": ("algorithm", "order"),
    "steps": ("T", "n_steps", "num_steps", "horizon", "length", "timesteps", "n_timesteps"),
    "lag": ("window", "delay"),
    "gate": ("threshold", "gating"),
    "rng": ("seed", "random_state", "generator", "key"),
    "seed": ("rng", "random_state", "random_seed", "generator"),
    "n": ("size", "samples", "count", "number", "n_samples", "num_samples", "n_particles"),
    "runs": ("n", "size", "samples", "n_samples", "num_samples"),
    "size": ("n", "samples", "count", "n_samples", "num_samples", "shape"),
    "samples": ("n", "size", "count", "n_samples", "num_samples"),
    "components": ("dim", "dims", "names", "dimension", "labels", "size"),
    "angles": ("circular", "wrap", "wrapped", "periodic"),
    "states": ("card", "cardinality", "state_names", "n_states", "outcomes", "values"),
    "prior": ("initial", "init", "start"),
    "transition": ("dynamics", "motion", "process", "control"),
    "observation": ("sensor", "sensors", "measurement", "measurements", "emission"),
    "evidence": ("data", "observations", "measurements", "observed"),
    "compiled": ("jit", "numba", "fast"),
    "progress": ("verbose", "show_progress", "progress_bar"),
    "executor": ("n_jobs", "workers", "pool", "parallel", "processes"),
    "confidence": ("level", "alpha", "probability"),
}
# Names of deviations, whose squares are due.
_DEVIATIONS = {"std", "stddev", "sigma", "sd", "deviation", "deviations", "scale"}


def public(thing: T) -> T:
    """Mark a function or class that users call: a call that does not fit it is told in words.

    It stays a `TypeError`, as Python's, which says in addition what was meant or what there is.
    """
    if not isinstance(thing, type):
        return _explained(thing)
    if "__new__" in vars(thing):
        thing.__new__ = staticmethod(_explained(thing.__new__))  # type: ignore[assignment]
    if "__init__" in vars(thing):
        thing.__init__ = _explained(thing.__init__)  # type: ignore[misc]
    return thing


def public_in_loops(function: T) -> T:
    """Mark a public function of a robot's loop, which looks itself for calls that do not fit.

    The frame that `public` adds takes a quarter of a microsecond, as long as such a function does
    by itself. Its parameters all have defaults, and others that are given come as ``*more: Never,
    **others: Never``, which are no part of its signature: it then raises `unfit`.
    """
    signature = inspect.signature(function)
    parameters = signature.parameters.values()
    own = [p for p in parameters if p.kind not in (p.VAR_POSITIONAL, p.VAR_KEYWORD)]
    function.__signature__ = signature.replace(parameters=own)  # type: ignore[attr-defined]
    return function


def unfit(
    function: Callable[..., Any],
    values: Sequence[Any],
    more: Sequence[Any],
    others: Mapping[str, Any],
) -> TypeError:
    """The error of a call of a function of a loop, by its parameters' values and what is left."""
    named = zip(inspect.signature(function).parameters.values(), values, strict=True)
    given = {} if more else {p.name: value for p, value in named if value is not p.default}
    return TypeError(misfit(function, (*values, *more) if more else (), {**given, **others}))


def _explained(function: T) -> T:
    @wraps(function)
    def call(*args: Any, **kwargs: Any) -> Any:
        try:
            return function(*args, **kwargs)
        except TypeError:
            fault = misfit(function, args, kwargs)
            if fault is None:  # it is of something within
                raise
        raise TypeError(fault)

    return call  # type: ignore[return-value]


def misfit(
    function: Callable[..., Any], args: Sequence[Any], kwargs: Mapping[str, Any]
) -> str | None:
    """Why arguments do not fit a signature, and what does; None where they do."""
    signature = inspect.signature(function)
    try:
        signature.bind(*args, **kwargs)
    except TypeError as error:
        told = str(error)
    else:
        return None
    name = function.__qualname__.removesuffix(".__init__").removesuffix(".__new__")
    made = name != function.__qualname__  # whose first argument is the value or class itself
    if made and args:  # the class that was called, which may have its `__init__` from another
        name = (args[0] if isinstance(args[0], type) else type(args[0])).__name__
    parameters = list(signature.parameters.values())[made:]
    args = args[made:]
    by_place = [p.name for p in parameters if p.kind is p.POSITIONAL_OR_KEYWORD]
    named = [*by_place, *(p.name for p in parameters if p.kind is p.KEYWORD_ONLY)]
    left = [each for each in named if each not in kwargs and each not in by_place[: len(args)]]
    for stranger in kwargs:
        if stranger not in named:
            return f"{name} has no argument {stranger}=; {_advice(stranger, left)}"
    if len(args) > len(by_place):
        return (
            f"{name} takes {len(by_place)} arguments by place ({', '.join(by_place)}), and "
            f"{len(args)} were given"
            + (f"; give the others by name: {_listed(left)}" if left else "")
        )
    lacking = [p.name for p in parameters if p.name in left and p.default is p.empty]
    return f"{name} lacks {_listed(lacking)}" if lacking else f"{name}: {told}"


def _advice(stranger: str, left: Sequence[str]) -> str:
    meant = _meant(stranger, left)
    if meant is None:
        return f"it takes {_listed(left)}" if left else "it takes no more than was given"
    squares = "; it takes variances, the squares of deviations"
    return f"did you mean {meant}=?" + squares * (meant == "cov" and stranger in _DEVIATIONS)


def _meant(stranger: str, names: Sequence[str]) -> str | None:
    """The argument that a name is likeliest to stand for, if any."""
    for name in names:
        if stranger in ELSEWHERE.get(name, ()):
            return name
    for name in names:
        if len(stranger) > 1 and (name.startswith(stranger) or stranger.startswith(f"{name}_")):
            return name
    found = difflib.get_close_matches(stranger.lower(), names, n=1)
    return found[0] if found else None


def _listed(names: Iterable[str]) -> str:
    return ", ".join(f"{name}=" for name in names)
