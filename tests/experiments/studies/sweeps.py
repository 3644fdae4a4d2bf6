"""Parts of studies that workers of tests import: quick ones, slow ones, and faulty ones."""

import os
import time
from typing import Literal

import numpy as np


def dice(runs, rng, *, sides: int = 6, name: Literal["a", "b"] = "a", seconds: float = 0.0):
    time.sleep(seconds + float(os.environ.get("SECONDS_A_PART", "0")))
    thrown = rng.integers(1, sides + 1, size=runs)
    normal = np.where(rng.random(runs) < 0.1, np.nan, rng.normal(sides, 1.0, runs))
    return {"thrown": thrown, "normal": normal, "even": thrown % 2 == 0}


def fails(runs, rng, *, at: int = 3):
    if runs > 2:
        raise ZeroDivisionError(f"no {at}")
    return {"x": rng.random(runs)}


def ends(runs, rng):
    if runs > 2:
        os._exit(1)
    return {"x": rng.random(runs)}


def other_draws(runs, rng):
    return {"x": np.random.default_rng().random(runs)}


def other_names(runs, rng, *, name: Literal["a", "b"] = "a"):
    return {name: rng.random(runs)}


def changing(runs, rng):
    return {"x" if runs < 3 else "y": rng.random(runs)}


def no_mapping(runs, rng):
    return rng.random(runs)


def short(runs, rng):
    return {"x": rng.random(runs + 1)}


def infinite(runs, rng):
    return {"x": np.full(runs, np.inf)}


def words(runs, rng):
    return {"x": ["a"] * runs}


def named_run(runs, rng):
    return {"run": np.arange(runs)}


def positional(runs, rng, sides):
    return {"x": rng.random(runs)}


def undeclared(runs, rng, *, sides):
    return {"x": rng.random(runs)}


def listed(runs, rng, *, sides=(1, 2)):
    return {"x": rng.random(runs)}


def kinds(runs, rng, *, word: str = "a", count: int = 1, size: float = 0.5, on=False):
    return {"x": rng.random(runs)}
