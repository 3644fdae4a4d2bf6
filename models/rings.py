"""Four unknowns on a ring, each read together with its neighbours: the smallest loops there are.

The unknowns have independent priors, and only the readings couple them: with evidence on the
readings the posterior is a pairwise field on a four-cycle, or on something denser.
"""

from __future__ import annotations

import numpy as np

import pgm

SIZE = 4
spins = tuple(pgm.Discrete(f"x{k}", ("down", "up")) for k in range(1, SIZE + 1))
places = pgm.variables(f"x{k}" for k in range(1, SIZE + 1))

_UP = (0.3, 0.6, 0.45, 0.4)  # prior probabilities of the spins
_MEANS = (0.0, 1.0, -1.0, 2.0)  # and means of the places
_CYCLE = ((0, 1), (1, 2), (2, 3), (3, 0))
_DIAGONALS = ((0, 2), (1, 3))


def discrete_ring(
    coupling: float, *, diagonals: bool = False
) -> tuple[pgm.BayesianNetwork, dict[pgm.Variable, str]]:
    """Spins s = ±1, and readings that say of two of them that they are the same.

    P(same | s, s') = 1 / (1 + exp(−2 J s s')), so that the posterior is that of an Ising model,
    ∝ Π p(s) exp(J Σ s s').

    Parameters
    ----------
    coupling : float
        J; where it is negative, neighbours are likely to differ.
    diagonals : bool
        Whether spins across the ring are read together too.

    Returns
    -------
    network, evidence
        The evidence on the readings.
    """
    yes = 1.0 / (1.0 + np.exp(-2.0 * coupling))
    alike, unlike = (1.0 - yes, yes), (yes, 1.0 - yes)
    cpds = [pgm.TableCPD(s, table=(1.0 - up, up)) for s, up in zip(spins, _UP, strict=True)]
    evidence: dict[pgm.Variable, str] = {}
    for i, j in _CYCLE + (_DIAGONALS if diagonals else ()):
        reading = pgm.Discrete(f"z{i + 1}{j + 1}", ("other", "same"))
        table = [[alike, unlike], [unlike, alike]]
        cpds.append(pgm.TableCPD(reading, given=(spins[i], spins[j]), table=table))
        evidence[reading] = "same"
    return pgm.BayesianNetwork(cpds), evidence


def gaussian_ring(
    coupling: float, *, span: int = 2
) -> tuple[pgm.BayesianNetwork, dict[pgm.Variable, float]]:
    """Places with priors of variance 1, and readings of the sum of some that follow each other.

    Readings of two make a pairwise posterior that is a sum of non-negative squares: loopy messages
    converge at any coupling. Readings of three need not.

    Parameters
    ----------
    coupling : float
        The precision of a reading.
    span : int
        How many places a reading adds up.

    Returns
    -------
    network, evidence
        The evidence on the readings.
    """
    cpds: list[pgm.GaussianCPD | pgm.LinearGaussianCPD] = [
        pgm.GaussianCPD(x, mean, 1.0) for x, mean in zip(places, _MEANS, strict=True)
    ]
    evidence: dict[pgm.Variable, float] = {}
    for k, value in enumerate((1.0, 0.0, 2.0, -1.0)):
        following = [(k + step) % SIZE for step in range(span)]
        reading = pgm.Variable("z" + "".join(str(i + 1) for i in following))
        cpds.append(
            pgm.LinearGaussianCPD(
                reading, given={places[i]: 1.0 for i in following}, cov=1.0 / coupling
            )
        )
        evidence[reading] = value
    return pgm.BayesianNetwork(cpds), evidence
