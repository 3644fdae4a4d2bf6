"""pgmpy on discrete networks."""

from __future__ import annotations

import logging
from importlib import import_module

import numpy as np

import pgm
from benchmarks.timing import Contender
from benchmarks.work.tables import Task


def marginals(task: Task) -> Contender:
    """New evidence, then all marginals, node by node."""
    inference = import_module("pgmpy.inference")
    logging.getLogger("pgmpy").setLevel(logging.ERROR)
    engine = inference.VariableElimination(pgm.to_pgmpy(task.network))
    evidence = {
        v.name: v.states[task.evidence[v]]
        for v in task.network.variables
        if isinstance(v, pgm.Discrete) and v in task.evidence
    }

    def call() -> list[np.ndarray]:
        found = []
        for variable in task.hidden:
            name = variable.name
            table = engine.query([name], evidence=evidence, show_progress=False)
            values = [table.get_value(**{name: state}) for state in variable.states]
            found.append(np.array(values))
        return found

    return Contender(call, 1)
