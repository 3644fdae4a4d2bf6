"""pgmpy on discrete networks."""

from __future__ import annotations

import logging

import numpy as np
from pgmpy.inference import VariableElimination

import pgm
from benchmarks.timing import Contender
from benchmarks.work.tables import Task


def marginals(task: Task) -> Contender:
    """New evidence, then all marginals, node by node."""
    logging.getLogger("pgmpy").setLevel(logging.ERROR)
    engine = VariableElimination(pgm.to_pgmpy(task.network))
    evidence = {
        v.name: v.states[index] for v, index in task.evidence.items() if isinstance(v, pgm.Discrete)
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
