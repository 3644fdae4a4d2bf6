r"""The beliefs of a hidden Markov model's readings, each given all readings but its own.

.. math:: p(z_k \mid z_j, j \ne k) \propto \sum_x p(z_k \mid x) \, \alpha^-_t(x) \, \beta_t(x)
          \prod_{j \ne k} p(z_j \mid x)

with the predicted belief α⁻ of the reading's step t, the message β of later ones, and a product
over the other readings of the step. Nothing is divided by the reading's own likelihood, which may
be zero where the others allow a state.
"""

from __future__ import annotations

import numpy as np

from pgm.beliefs.markov.chain import TINY, StateChain
from pgm.beliefs.markov.impossible_runs import blank
from pgm.beliefs.markov.measurements import at_rows
from pgm.beliefs.markov.plan import SlicePlan, TableSlices
from pgm.factors import GaussianMixture, Table
from pgm.kernels.arrays import Array
from pgm.kernels.semirings import LOG_SUM_PRODUCT
from pgm.variables import Variable


def left_out(plan: SlicePlan, chain: StateChain) -> dict[Variable, Table | GaussianMixture]:
    """By sensor the beliefs of its readings in the order of the evidence, each left out.

    `chain` is that of the filtered beliefs. Where its numbers are too small for float64 once a
    reading is left out, logarithms take their place.
    """
    slices = chain.slices
    assert isinstance(slices, TableSlices)
    beliefs = _beliefs(chain, slices)
    if beliefs is None:
        inner = slices.within(LOG_SUM_PRODUCT)
        beliefs = _beliefs(StateChain(inner, LOG_SUM_PRODUCT).run(), inner)
    assert beliefs is not None
    found = {}
    for weights, each in zip(slices.weights, beliefs, strict=True):
        rows, variable = np.argsort(weights.reading.order), weights.cpd.child
        ordered = [blank(each[row], slices.lost, slices.steps) for row in rows]
        found[variable] = at_rows(plan, slices.bound, weights.reading, variable, rows, ordered)
    return found


def _beliefs(chain: StateChain, slices: TableSlices) -> list[list[Array]] | None:
    """By sensor and row the belief over the slice (*states, [runs]) without that reading.

    None if numbers may have lost a state to underflow.
    """
    semiring, message = chain.semiring, chain.unit()
    found: list[list[Array]] = [
        [np.empty(0)] * weights.reading.step.size for weights in slices.weights
    ]
    with np.errstate(under="ignore", invalid="ignore", divide="ignore"):
        for step in range(slices.steps, -1, -1):
            if step < slices.steps:
                message = chain.message(step, message)
            ahead = chain.predict(step, chain.known[step - 1]) if step else chain.start()
            joint = semiring.times(ahead, message)
            read = [(k, row) for k, each in enumerate(slices.weights) for row in each.at(step)]
            own = [slices.weights[k].row(row, semiring) for k, row in read]
            for place, (k, row) in enumerate(read):
                left = joint
                for other, weights in enumerate(own):
                    if other != place and weights is not None:
                        left = semiring.times(left, weights)
                total = chain.total(left)
                if semiring.linear and not (total > TINY).all():
                    return None
                found[k][row] = chain.numbers(semiring.over(left, total))
    return found
