"""Exact posteriors of small networks, checked by something that knows no messages."""

from __future__ import annotations

import numpy as np

import pgm
from experiments.belief_propagation.enumeration import enumerate_states
from experiments.belief_propagation.loops import Case
from experiments.belief_propagation.mode import mode
from experiments.dense import Dense
from experiments.kinds import as_gaussian, as_table


def difference(case: Case) -> float:
    """The largest difference of the exact posterior from an independent answer.

    Of marginals and log-evidence from enumeration or from the dense joint; of a nonlinear network,
    of means, in standard deviations, from the most probable values.
    """
    if case.network.discrete:
        return _from_enumeration(case)
    if any(isinstance(cpd, pgm.NonlinearGaussianCPD) for cpd in case.network.cpds):
        return _from_mode(case)
    return _from_dense(case)


def _from_enumeration(case: Case) -> float:
    marginals, log_evidence = enumerate_states(case.network, case.evidence)
    worst = abs(float(case.exact.log_evidence) - log_evidence)
    for variable, due in marginals.items():
        ours = as_table(case.exact[variable]).probabilities
        worst = max(worst, float(np.abs(ours - due).max()))
    return worst


def _from_dense(case: Case) -> float:
    dense = Dense.of(case.network).given(case.evidence)
    worst = abs(float(case.exact.log_evidence) - dense.log_evidence)
    for variable in case.hidden:
        belief, (mean, cov) = as_gaussian(case.exact[variable]), dense.marginal(variable)
        worst = max(
            worst, *(float(np.abs(x).max()) for x in (belief.mean - mean, belief.cov - cov))
        )
    return worst


def _from_mode(case: Case) -> float:
    beliefs = {v: as_gaussian(case.exact[v]) for v in case.hidden}
    # From elsewhere, so that it does not find what it is given.
    start = {v: belief.mean + 0.5 * belief.std for v, belief in beliefs.items()}
    found = mode(case.network, case.evidence, start)
    return max(float(np.abs((b.mean - found[v]) / b.std).max()) for v, b in beliefs.items())
