"""The robots' functions in JAX: those of `models`, of one state and one input (v, ω, m)."""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp

from benchmarks.work.robots import DT


def drive(x: Any, u: Any) -> Any:
    """An arc of constant speed and turn rate."""
    turn = u[1] * DT
    half = 0.5 * turn
    chord = u[0] * DT * jnp.sinc(half / jnp.pi)
    course = x[2] + half
    return x + jnp.array([chord * jnp.cos(course), chord * jnp.sin(course), turn])


def sight(x: Any, u: Any) -> Any:
    """Range and bearing, in the robot's frame: what lies ahead has no branch near."""
    east, north = u[2] - x[0], u[3] - x[1]
    cos, sin = jnp.cos(x[2]), jnp.sin(x[2])
    ahead, left = cos * east + sin * north, cos * north - sin * east
    return jnp.array([jnp.sqrt(east * east + north * north), jnp.arctan2(left, ahead)])
