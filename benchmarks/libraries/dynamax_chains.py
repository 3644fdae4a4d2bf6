"""dynamax's smoothers of hidden Markov models, jitted, in float64, without sums over pairs.

Their own jit takes the flag that leaves those out for a number to be traced: they are jitted here.
"""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from dynamax.hidden_markov_model import inference

import benchmarks.libraries.float64  # noqa: F401
from benchmarks.timing import Contender, compiled
from benchmarks.work.chains import Array, Chains

SMOOTHERS = {
    "two_filter": inference.hmm_two_filter_smoother.__wrapped__,
    "smoother": inference.hmm_smoother.__wrapped__,
}


def smoothing(kind: str, work: Chains) -> Contender:
    """One run: (T, states); tables are constants of what is compiled, which suits it best."""
    first, motion, by_symbol = _tables(work)
    smoother = SMOOTHERS[kind]

    def run(readings: Any) -> Any:
        logs = by_symbol[readings]
        return smoother(first, motion, logs, compute_trans_probs=False).smoothed_probs

    jitted = jax.jit(run)
    return compiled(lambda: _found(jitted(work.readings[0])), work.steps)


def called(work: Chains) -> Contender:
    """The two-filter smoother given the tables with each call, as the library's own jit is."""
    tables, smoother = _tables(work), SMOOTHERS["two_filter"]

    def run(first: Any, motion: Any, by_symbol: Any, readings: Any) -> Any:
        logs = by_symbol[readings]
        return smoother(first, motion, logs, compute_trans_probs=False).smoothed_probs

    jitted = jax.jit(run)
    return compiled(lambda: _found(jitted(*tables, work.readings[0])), work.steps)


def _tables(work: Chains) -> tuple[Any, Any, Any]:
    """The first distribution, p(x_t | x_{t−1}), and ln p(z | x) by symbol."""
    first, motion, sensor = (jnp.asarray(each) for each in work.tables)
    return first, motion, jnp.log(sensor).T


def _found(values: Any) -> Array:
    return np.asarray(values)
