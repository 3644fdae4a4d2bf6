"""pgmpy on discrete networks."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from importlib import import_module

import numpy as np

import pgm
from benchmarks.timing import Contender
from benchmarks.work.tables import Task


def marginals(tasks: Sequence[Task]) -> Contender:
    """Each set of evidence of one network, then all marginals, node by node."""
    inference = import_module("pgmpy.inference")
    logging.getLogger("pgmpy").setLevel(logging.ERROR)
    engine = inference.VariableElimination(pgm.to_pgmpy(tasks[0].network))
    asked = [(_named(task), task.hidden) for task in tasks]

    def call() -> list[np.ndarray]:
        found = []
        for evidence, hidden in asked:
            for variable in hidden:
                table = engine.query([variable.name], evidence=evidence, show_progress=False)
                own = table.state_names[variable.name]
                found.append(table.values[[own.index(state) for state in variable.states]])
        return found

    return Contender(call, len(tasks))


def _named(task: Task) -> dict[str, str]:
    """The evidence: the names of states by those of variables."""
    return {
        v.name: v.states[index] for v, index in task.evidence.items() if isinstance(v, pgm.Discrete)
    }
