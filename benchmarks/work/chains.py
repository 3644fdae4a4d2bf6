"""Discrete dynamic networks of one state variable, whose symbols are read: hidden Markov models."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

import pgm

Array = npt.NDArray[np.float64]

SYMBOLS = 16
CONCENTRATION = 0.3  # of what the rows of tables are drawn with: a few states are likely
STEPS_OF_SHIFTS = {(0, 0): 0.2, (1, 0): 0.4, (0, 1): 0.1, (0, -1): 0.1, (1, 1): 0.1, (1, -1): 0.1}


@dataclass(frozen=True, eq=False)
class Chains:
    """Runs of T steps of one model, which reads a symbol at each but step 0.

    Attributes
    ----------
    network : DynamicBayesianNetwork
    readings : ndarray of int
        (runs, T).
    """

    network: pgm.DynamicBayesianNetwork
    readings: npt.NDArray[np.intp]

    @property
    def runs(self) -> int:
        """How many."""
        return len(self.readings)

    @property
    def steps(self) -> int:
        """T."""
        return int(self.readings.shape[1])

    @property
    def state(self) -> pgm.Discrete:
        """The hidden variable."""
        return _child(self.network.prior[0])

    @property
    def symbol(self) -> pgm.Discrete:
        """The variable that is read."""
        return _child(self.network.observation[0])

    @property
    def tables(self) -> tuple[Array, Array, Array]:
        """For the others, who begin at step 1: its distribution, p(x_t | x_{t−1}), p(z | x)."""
        prior, motion, sensor = (_table(cpd) for cpd in self.network.cpds)
        return prior @ motion, motion, sensor


def draw(states: int, steps: int, runs: int = 1, seed: int = 0) -> Chains:
    """Tables without any structure, and symbols drawn from them."""
    rng = np.random.default_rng(seed)
    prior, motion = _rows(rng, 1, states)[0], _rows(rng, states, states)
    return _drawn(states, prior, motion, steps, runs, rng)


def shifting(shape: tuple[int, int], steps: int, seed: int = 0) -> Chains:
    """Cells of a map on which something drifts, the edges of the first axis joined."""
    rng = np.random.default_rng(seed)
    states = shape[0] * shape[1]
    motion = pgm.shifts(shape, STEPS_OF_SHIFTS, edge=("wrap", "slide"))
    return _drawn(states, np.full(states, 1.0 / states), motion, steps, 1, rng)


def _drawn(
    states: int, prior: Array, motion: object, steps: int, runs: int, rng: np.random.Generator
) -> Chains:
    x, z = pgm.Discrete("state", states), pgm.Discrete("symbol", SYMBOLS)
    network = pgm.DynamicBayesianNetwork(
        prior=[pgm.TableCPD(x, table=prior)],
        transition=[pgm.TableCPD(x, given=x.previous, table=motion)],
        observation=[pgm.TableCPD(z, given=x, table=_rows(rng, states, SYMBOLS))],
    )
    drawn = network.sample(steps=steps, runs=(runs,), rng=rng)
    return Chains(network, drawn[z])


def _rows(rng: np.random.Generator, count: int, size: int) -> Array:
    """Distributions over a number of states."""
    return rng.dirichlet(np.full(size, CONCENTRATION), count)


def _child(cpd: object) -> pgm.Discrete:
    assert isinstance(cpd, pgm.TableCPD)
    return cpd.child


def _table(cpd: object) -> Array:
    assert isinstance(cpd, pgm.TableCPD)
    return np.array(cpd.table)
