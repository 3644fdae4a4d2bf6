"""A small discrete network as one table of all its states, in plain NumPy."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import numpy.typing as npt

import pgm

Array = npt.NDArray[np.float64]


def enumerate_states(
    network: pgm.BayesianNetwork, evidence: Mapping[pgm.Variable, str]
) -> tuple[dict[pgm.Variable, Array], float]:
    """Marginals of the variables without evidence, and the log-evidence, from the full joint.

    Its size is the product of all numbers of states: a check, nothing else.
    """
    axis = {variable: k for k, variable in enumerate(network.variables)}
    joint = np.ones(())
    for cpd in network.cpds:
        assert isinstance(cpd, pgm.TableCPD)
        places = [axis[variable] for variable in (*cpd.given, cpd.child)]
        shape = np.ones(len(axis), dtype=int)
        shape[places] = cpd.table.shape
        joint = joint * cpd.table.transpose(np.argsort(places)).reshape(shape)
    for variable, state in evidence.items():
        assert isinstance(variable, pgm.Discrete)
        joint = joint.take([variable.index(state)], axis=axis[variable])
    total = joint.sum()
    marginals = {
        variable: joint.sum(axis=tuple(k for k in axis.values() if k != place)) / total
        for variable, place in axis.items()
        if variable not in evidence
    }
    return marginals, float(np.log(total))
