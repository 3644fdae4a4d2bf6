"""The growth model: one state, a bimodal motion, and a sensor of its cube or its square."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

import pgm
from experiments.iterated.case import Case

Array = npt.NDArray[np.float64]

state = pgm.Variable("x")
reading = pgm.Variable("z")
clock = pgm.Variable("k")

POWERS = {"cubic": 3, "square": 2}
LINEARISERS: dict[str, pgm.Lineariser] = {
    # One component: w₀ = 1/3, all weights the same for means and covariances.
    "Unscented": pgm.Unscented(alpha=1.0, beta=0.0, kappa=0.5),
    "Taylor": pgm.Taylor(),
}
# A run whose errors have a root mean square above this follows another branch; the noise has 1.
LOST = 2.0


@dataclass(frozen=True)
class Reading:
    """How a description of the case in words may be read.

    Attributes
    ----------
    title : str
    steps : int
        Motions; there is one state more.
    first : int
        The first step with a reading, from 0.
    counted : int
        The first step whose error counts.
    phase : int
        k in the first motion's 8 cos 1.2k.
    """

    title: str
    steps: int = 50
    first: int = 1
    counted: int = 1
    phase: int = 1


MAIN = Reading("50 steps after the first state")
OTHERS = (
    Reading("50 states, all read", steps=49, first=0, counted=0),
    Reading("first state's error counted", counted=0),
    Reading("8 cos 1.2(k − 1)", phase=0),
    Reading("8 cos 1.2(k + 1)", phase=2),
)


def network(power: int) -> pgm.DynamicBayesianNetwork:
    """The growth model.

        x' = 0.9 x + 10 x / (1 + x²) + 8 cos 1.2k + w,  z = x^power / 20 + v,

    w and v ~ N(0, 1), the first state ~ N(5, 4).

    References
    ----------
    García-Fernández, Svensson & Särkkä, Iterated posterior linearization smoother, 2017,
    section V.
    """
    return pgm.DynamicBayesianNetwork(
        prior=[pgm.GaussianCPD(state, mean=5.0, cov=4.0)],
        transition=[
            pgm.NonlinearGaussianCPD(
                state,
                given=(state.previous, clock),
                function=_grow,
                cov=1.0,
                jacobian={state.previous: _grow_by_state},
            )
        ],
        observation=[
            pgm.NonlinearGaussianCPD(
                reading,
                given=(state,),
                function=lambda x: x**power / 20.0,
                cov=1.0,
                jacobian={state: lambda x: (power * x ** (power - 1) / 20.0)[..., None]},
            )
        ],
    )


def simulate(sensor: str, runs: int, seed: int, how: Reading = MAIN) -> Case:
    """Draw runs of the growth model with a sensor of `POWERS`."""
    model = network(POWERS[sensor])
    inputs = {
        clock: how.phase + np.arange(float(how.steps))[:, None],
        reading: pgm.sightings(step=np.arange(how.first, how.steps + 1)),
    }
    sample = model.sample(inputs, runs=runs, rng=seed)
    truth = sample[state]
    return Case(model, sample.evidence, state, truth, components=1, first=how.counted, lost=LOST)


def _grow(x: Array, k: Array) -> Array:
    grown: Array = 0.9 * x + 10.0 * x / (1.0 + x**2) + 8.0 * np.cos(1.2 * k)
    return grown


def _grow_by_state(x: Array, k: Array) -> Array:
    slope: Array = 0.9 + 10.0 * (1.0 - x**2) / (1.0 + x**2) ** 2
    return slope[..., None]
