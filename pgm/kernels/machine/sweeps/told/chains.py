"""Chains, and the sweeps along them: forward, back, in windows, and at beliefs over all steps."""

from __future__ import annotations

from dataclasses import dataclass

from pgm.kernels.machine.sweeps.told.rows import Motion
from pgm.kernels.machine.sweeps.told.sensors import Sensor
from pgm.kernels.machine.sweeps.told.table import Array


@dataclass(frozen=True, kw_only=True)
class Forward:
    """A forward sweep: the slices of a chain predicted, and given the measurements of their steps.

    Attributes
    ----------
    size : int
        The components of a slice.
    states : tuple of int
        The places of the states in a slice, which alone act on the next one.
    single : bool
        Whether one CPD makes all of a slice of all of the one before.
    begin, predicted, known : tuple of Array
        Means and covariances: of the belief to begin with, before each step's measurements, if that
        is kept, and given them.
    density : Array
        The log-densities of each step's measurements.
    iterated, controlled : bool
        Whether measurements are linearised again, and whether a cost judges where.
    anchor : tuple of Array
        Means and deviations by step, and weights, of an anchor; empty if there is none.
    asked : Array or None
        For what a sweep waits whose functions are called, (`ASKED`,): see `told.WHAT`.
    thinned : int
        One of so many packs of runs keeps its predicted beliefs, beside those of the next such.
    squares : tuple of Array
        The normalised innovation squared of each sensor, by itself, at each step; empty if they are
        not kept.
    """

    size: int
    states: tuple[int, ...]
    single: bool
    motions: tuple[Motion, ...]
    sensors: tuple[Sensor, ...]
    begin: tuple[Array, Array]
    predicted: tuple[Array, ...]
    known: tuple[Array, Array]
    density: Array
    iterated: bool
    controlled: bool = False
    anchor: tuple[Array, ...] = ()
    asked: Array | None = None
    thinned: int = 1
    squares: tuple[Array, ...] = ()

    @property
    def alone(self) -> Sensor | None:
        """The sensor of robust noise of which a step has one sighting, or none, weighed by itself.

        Nothing else moves a belief within a step, and no gate asks for the square of a weight 1.
        """
        if len(self.sensors) != 1 or self.anchor:
            return None
        (sensor,) = self.sensors
        loss = sensor.loss
        lone = loss is not None and loss.lone and not loss.found
        return sensor if lone and sensor.gate is None else None


@dataclass(frozen=True, kw_only=True)
class Backward:
    """A sweep back: transitions reversed, and the last belief sent through the reversed ones.

    Attributes
    ----------
    size, states
        As of `Forward`.
    known, predicted, motion : tuple of Array
        What a forward sweep has left, and the transition's matrix and noise.
    reversed : tuple of Array
        The gain, offset and covariance of p(states | next slice); empty if they are not wanted.
    smoothed : tuple of Array
        The moments given all measurements; empty if they are not wanted.
    controls : tuple of Array
        The gain, offset and covariance of p(slice | its states); empty without controls.
    """

    size: int
    states: tuple[int, ...]
    known: tuple[Array, Array]
    predicted: tuple[Array, Array]
    motion: tuple[Array, Array]
    reversed: tuple[Array, ...] = ()
    smoothed: tuple[Array, ...] = ()
    controls: tuple[Array, ...] = ()


@dataclass(frozen=True, kw_only=True)
class Mixture:
    """A forward sweep of a mixture of K Gaussians, one of each memory, merged at every step.

    Each Gaussian, or mixture of all of them, is a *pair* with each of S regimes. Hypotheses are
    runs: the pair of Gaussian k and regime s of the user's run r is at (k S + s) R + r of arrays of
    pairs, and Gaussian k at k R + r.

    Attributes
    ----------
    ahead : Forward
        The chain of the pairs; its arrays of beliefs have the one row of the step at hand.
    own_runs : int
        The place in the table of R, the number of the user's runs.
    memories : tuple of int
        Of each regime its memory.
    mixed : bool
        Whether Gaussians are mixed for each regime before they are predicted.
    onward : Array
        Ln p(regime | memory) by step, (memories · S,), of the user's runs.
    likelihood : Array
        Ln p(discrete measurements | regime) by step, (S,), of the user's runs; at step 0 with the
        logarithm of the regime's prior probability.
    pairs : Array
        The log-weights of pairs, of the step at hand.
    logs, mean, cov : Array
        By step the log-weights of the Gaussians, and their moments.
    regimes : Array
        By step the log-probabilities of the regimes, regime s of run r at s R + r.
    density : Array
        By step the log-density of the measurements, of the user's runs.
    """

    ahead: Forward
    own_runs: int
    memories: tuple[int, ...]
    mixed: bool
    onward: Array
    likelihood: Array
    pairs: Array
    logs: Array
    mean: Array
    cov: Array
    regimes: Array
    density: Array

    @property
    def sensors(self) -> tuple[Sensor, ...]:
        """The sensors of the chain."""
        return self.ahead.sensors

    @property
    def numbers(self) -> tuple[int, ...]:
        """The places of numbers in the table."""
        return (self.own_runs,)


@dataclass(frozen=True, kw_only=True)
class Windows:
    """The windows of a fixed lag that slide along a chain.

    Attributes
    ----------
    ahead : Forward
        The chain as each step is linearised first; its arrays of beliefs but `begin` are not used.
    predicted, known, density, smoothed : tuple of Array, or Array
        By step, means and covariances, and log-densities, of the last window of it.
    newest, log_evidence : tuple of Array, and Array
        The last beliefs of the window that ends at a step, and ln p of all measurements up to it.
    point : tuple of Array
        By row of a window, where CPDs are linearised: means, covariances and those of pairs of the
        states and the next slice, so far as CPDs need them.
    joint : Array or None
        The covariances of pairs that are found.
    """

    ahead: Forward
    predicted: tuple[Array, Array]
    known: tuple[Array, Array]
    density: Array
    smoothed: tuple[Array, Array]
    newest: tuple[Array, Array]
    log_evidence: Array
    point: tuple[Array, ...]
    joint: Array | None = None

    @property
    def sensors(self) -> tuple[Sensor, ...]:
        """The sensors of the chain."""
        return self.ahead.sensors


@dataclass(frozen=True, kw_only=True)
class Linearised:
    """A chain that is linearised at beliefs over all steps, or the costs of their means.

    Attributes
    ----------
    states, motions, sensors
        As of `Forward`.
    point : tuple of Array
        Means of the slices, their covariances, and those of pairs of the states and the next slice,
        so far as CPDs need them.
    cost : Array or None
        Where the cost of each run is put, without the prior's; None linearises.
    """

    states: tuple[int, ...]
    motions: tuple[Motion, ...]
    sensors: tuple[Sensor, ...]
    point: tuple[Array, ...]
    cost: Array | None = None
