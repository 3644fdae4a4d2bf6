"""The result of learning: the model, the parameters, the way there."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any

import numpy as np

from pgm.display import Listing, Shown, Summary, few, number
from pgm.immutable import Immutable
from pgm.kernels.arrays import Array
from pgm.networks import DynamicBayesianNetwork
from pgm.variables import Variable

# Log-evidences that are shown.
FEW = 8


class FitStatus(Shown, Immutable):
    """The course of a search for the likeliest parameters.

    Attributes
    ----------
    iterations : int
        Points that the search moved to.
    e_steps : int
        Smoothers that were run of each recording, at points that were refused too.
    accepted, refused : int
        Accelerated steps that raised the log-evidence, and others, replaced by a plain one.
    halved : int
        How often a plain step, which did not raise the log-evidence, was halved. Exact models have
        none, but for rounding.
    converged : bool
        Whether the last step was within the tolerance, or rounding alone was left.
    stopped : str
        Why the search ended.

    Examples
    --------
    >>> from pgm.examples import walk, z
    >>> found = pgm.fit(walk, {z: [[4.0], [2.0]]}, learn={z: pgm.learning.Covariance("diagonal")})
    >>> found.status.converged
    True
    """

    iterations: int
    e_steps: int
    accepted: int
    refused: int
    halved: int
    converged: bool
    stopped: str

    def __init__(
        self,
        iterations: int,
        e_steps: int,
        accepted: int,
        refused: int,
        halved: int,
        converged: bool,
        stopped: str,
    ) -> None:
        self._set(
            iterations=iterations,
            e_steps=e_steps,
            accepted=accepted,
            refused=refused,
            halved=halved,
            converged=converged,
            stopped=stopped,
        )

    @property
    def _title(self) -> str:
        went = "converged" if self.converged else "not converged"
        return f"FitStatus({self.iterations} iterations, {self.e_steps} E steps, {went})"

    def _summary(self) -> Summary:
        lines: list[str | Listing] = [
            f"accelerated steps: {self.accepted} accepted, {self.refused} refused"
        ]
        if self.halved:
            lines.append(f"steps halved: {self.halved}")
        return Summary(self._title, [*lines, f"stopped: {self.stopped}"])


class Fit(Shown, Immutable):
    """A model with the likeliest parameters that were found.

    Attributes
    ----------
    model : DynamicBayesianNetwork
        The model that was given, with what was learnt.
    parameters : mapping of Variable
        By the variables that were named: the CPD that was learnt, or the value, (d,), of a
        `Parameter`.
    evidence : Evidence, or tuple of Evidence
        With the values of parameters put in.
    log_evidence : ndarray
        (iterations + 1,): of all recordings and runs together, from the start on. It never falls.
    posterior : ChainPosterior or StatePosterior, or tuple of these
        Of each recording, smoothed with the model.
    status : FitStatus

    Examples
    --------
    >>> from pgm.examples import walk, z
    >>> found = pgm.fit(walk, {z: [[4.0], [2.0]]}, learn={z: pgm.learning.Covariance("diagonal")})
    >>> found.model.observation[0].cov.round(2)
    array([[5.43]])
    >>> bool(found.log_evidence[-1] > found.log_evidence[0])
    True
    """

    model: DynamicBayesianNetwork
    parameters: Mapping[Variable, Any]
    evidence: Any
    log_evidence: Array
    posterior: Any
    status: FitStatus

    def __init__(
        self,
        model: DynamicBayesianNetwork,
        parameters: Mapping[Variable, Any],
        evidence: Any,
        log_evidence: Sequence[float],
        posterior: Any,
        status: FitStatus,
    ) -> None:
        trace = np.array(log_evidence)
        trace.flags.writeable = False
        self._set(
            model=model,
            parameters=MappingProxyType(dict(parameters)),
            evidence=evidence,
            log_evidence=trace,
            posterior=posterior,
            status=status,
        )

    @property
    def _title(self) -> str:
        first, last = self.log_evidence[[0, -1]]
        return f"Fit(log-evidence {number(first)} to {number(last)}, {self.status._title})"

    def _summary(self) -> Summary:
        trace = self.log_evidence
        shown = ["..." if k is None else number(trace[k]) for k in few(len(trace), FEW)]
        parts: list[str | Listing] = [f"log-evidence: {', '.join(shown)}"]
        parts += self.status._summary().parts
        for variable, value in self.parameters.items():
            if isinstance(value, np.ndarray):
                parts.append(f"{variable!r}: {', '.join(map(number, value))}")
            else:
                parts.append(f"{variable!r}: {value._title}")
                parts.extend(value._parts())
        return Summary(self._title, parts)
