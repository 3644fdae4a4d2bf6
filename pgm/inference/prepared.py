"""Inference that is prepared once, for evidence of one form, and then run with other values."""

from __future__ import annotations

from typing import Any, Generic

from pgm.arguments import public
from pgm.compile import DynamicGraph
from pgm.display import InCode, titled
from pgm.errors import EvidenceError, GraphError
from pgm.evidence import Evidence, Form
from pgm.inference.families import answered, family_of
from pgm.linearisers import TAYLOR, Lineariser
from pgm.posteriors.associations import is_open
from pgm.posteriors.outcome import B
from pgm.posteriors.posterior import Posterior
from pgm.schedules.argument_checks import require_lineariser
from pgm.schedules.binding import bind_chain
from pgm.schedules.convergence import told
from pgm.schedules.options import Call, require_over_time
from pgm.schedules.schedule import Schedule


@public
def prepare(
    graph: DynamicGraph,
    evidence: Evidence,
    *,
    schedule: Schedule | None = None,
    lineariser: Lineariser = TAYLOR,
) -> Prepared[Any]:
    """Prepare inference on a graph for evidence of one form, to be run with many values.

    A run does what `infer` does, without what does not depend on values: names, lengths and steps
    are checked here, once. It pays where there are many short calls, such as of windows of a log.

    Parameters
    ----------
    graph : DynamicGraph
        From `compile`, of a dynamic network whose CPDs are Gaussian.
    evidence : mapping of Variable
        As of `infer`; of its values nothing is kept.
    schedule : Filtering, FixedLag or Smoothing, optional
        `Smoothing()` if not given.
    lineariser : Lineariser, optional
        For every nonlinear CPD that has none of its own; `Taylor()` if not given.

    Returns
    -------
    Prepared
        ``run(evidence)`` is the posterior.

    Raises
    ------
    EvidenceError
        If the evidence does not fit the model, or leaves open what was seen (`unknown`).
    GraphError
        If the graph is not of a dynamic network, or one of tables.
    ModelError
        If the schedule has no use for an option.

    Examples
    --------
    >>> from pgm.examples import walk, x, z
    >>> graph = pgm.compile(walk, steps=1)
    >>> run = pgm.prepare(graph, {z: [[0.0]]}, schedule=pgm.Filtering())
    >>> run({z: [[4.0]]})[x].mean.ravel()
    array([0., 2.])
    >>> run({z: [[8.0]]})[x].mean.ravel()
    array([0., 4.])
    """
    if not isinstance(graph, DynamicGraph) or graph.model.discrete:
        raise GraphError(
            "prepare takes a graph of a dynamic network with Gaussian CPDs "
            f"(pgm.compile(model, steps)), not {titled(graph)}; pgm.infer takes any"
        )
    require_lineariser(lineariser)
    compiled = graph.layout.compiled
    call = Call(schedule, lineariser, compiled=compiled or None)
    require_over_time(call, graph, family_of(graph.model))
    bound = bind_chain(graph.model, evidence, graph.steps, identities=True, compiled=compiled)
    if is_open(bound):
        raise EvidenceError(
            "sightings of unknown things (pgm.unknown) are associated anew in each call, for which "
            "nothing can be prepared: use pgm.infer"
        )
    return Prepared(graph, call, Form.of(evidence, bound))


@public
class Prepared(InCode, Generic[B]):
    """Inference on a graph, prepared for evidence of one form; made by `prepare`.

    ``run(evidence)`` returns what ``pgm.infer(graph, evidence, ...)`` does, for evidence of the
    same variables and shapes, with sightings at the same steps. Components may be missing (NaN)
    in one run and not in another. Threads may run it at the same time.

    Attributes
    ----------
    graph : DynamicGraph
    schedule : Schedule or None

    Examples
    --------
    >>> from pgm.examples import walk, x, z
    >>> run = pgm.prepare(pgm.compile(walk, steps=2), {z: np.zeros((2, 1))})
    >>> run({z: [[4.0], [5.0]]})[x].mean.ravel()
    array([1.375, 2.75 , 3.5  ])
    >>> run({z: [[4.0], [np.nan]]})[x].mean.ravel()
    array([1., 2., 2.])
    """

    def __init__(self, graph: DynamicGraph, call: Call, form: Form) -> None:
        self.graph, self.schedule = graph, call.schedule
        self._call, self._form = call, form

    def __repr__(self) -> str:
        return f"Prepared({titled(self.graph)}, {self.schedule!r})"

    def __call__(self, evidence: Evidence) -> Posterior[B]:
        """The posterior given other values.

        Parameters
        ----------
        evidence : mapping of Variable
            Of the form that was prepared for.

        Returns
        -------
        Posterior

        Warns
        -----
        ConvergenceWarning, PrecisionWarning
            As `infer`.

        Raises
        ------
        EvidenceError
            If the evidence is of another form, by the variable, its shape and that prepared for.
        PgmError
            For the same reasons as `infer`.
        """
        family = family_of(self.graph.model)
        outcome = family.infer(self.graph, self._form.bind(evidence), self._call)
        return told(answered(family, outcome), self.schedule)
