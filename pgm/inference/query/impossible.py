"""Evidence of probability zero: where it contradicts the tables of a query, for a message."""

from __future__ import annotations

import numpy as np

from pgm.errors import EvidenceError
from pgm.factors.axes import States
from pgm.factors.runs import in_run
from pgm.factors.scope import listed, names
from pgm.inference.discrete.evidence import some_runs
from pgm.inference.discrete.impossible import ADVICE
from pgm.inference.query.elimination import Tables
from pgm.inference.query.plan import EliminationPlan
from pgm.kernels.arrays import Array
from pgm.kernels.semirings import LOG_SUM_PRODUCT
from pgm.variables import Discrete


def require_possible(plan: EliminationPlan, probabilities: Array) -> None:
    """Refuse evidence of probability zero, where probabilities (sizes..., runs or 1) are NaN.

    Raises
    ------
    EvidenceError
        Naming the first run, and the variables whose evidence has no common states.
    """
    lost = np.isnan(probabilities).any(axis=tuple(range(probabilities.ndim - 1)))
    if not lost.any():
        return
    first = int(lost.argmax())
    involved, scope = _contradiction(plan, first)
    where = in_run(lost.reshape(plan.requisite.evidence.lead))
    raise EvidenceError(
        f"the evidence has probability zero{where}: that for {names(involved)} contradicts itself, "
        f"for all states of ({listed(scope)}) are impossible given it. {ADVICE}",
        variable=involved[0],
    )


def _contradiction(plan: EliminationPlan, run: int) -> tuple[list[Discrete], States]:
    """The evidence that the first product of zeros is made of, and that product's variables."""
    evidence = some_runs(plan.requisite.evidence, slice(run, run + 1))
    tables = Tables(plan, evidence, LOG_SUM_PRODUCT)
    first, cpds = len(plan.scopes), plan.requisite.cpds
    for lost, step in enumerate(plan.steps, first):  # noqa: B007, used after the loop
        tables.do(step)
        if (tables.last == -np.inf).all():
            break
    waiting, members = [lost], set[Discrete]()
    while waiting:
        factor = waiting.pop()
        if factor >= first:
            waiting += plan.steps[factor - first].factors
        elif factor < len(cpds):
            members.update((*cpds[factor].given, cpds[factor].child))
        else:
            members.add(plan.weighted[factor - len(cpds)])
    shown = [v for v, s in evidence.states.items() if np.min(s) >= 0 and v in members]
    soft = [v for v in evidence.weights if v in members]
    return shown + soft, tuple(plan.order[k] for k in step.scope)
