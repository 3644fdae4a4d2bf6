"""The most probable assignments of discrete variables, as results."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
import numpy.typing as npt

from pgm.display import LEFT_OUT, Listing, Shown, Summary, few
from pgm.immutable import Immutable
from pgm.inference.query.asked import found_of
from pgm.kernels.arrays import Array, Integers, Mask
from pgm.posteriors.status import Status
from pgm.posteriors.summaries import spread
from pgm.variables import Discrete, Variable

# How many variables a repr lists.
LISTED = 10


@dataclass(frozen=True, eq=False, repr=False)
class MostProbable(Shown, Immutable):
    """The most probable assignment of discrete variables, given evidence.

    Attributes
    ----------
    assignment : mapping of Discrete
        The name of each variable's state, also of variables with evidence; or, if some variables
        were asked for, of those, in their order. Where the evidence has axes of runs, the indices
        of the states, (*runs), whose names `states` gives. For a dynamic network of steps 0 to T,
        the indices of each hidden variable's states by step, (*runs, T+1); for a control, which has
        no step 0, (*runs, T).
    log_probability : ndarray
        (*runs): ln p(assignment, evidence), natural logarithms.
    exact : ndarray of bool
        (*runs): whether it is known that no other assignment is more probable. It is not known of a
        path of modes where others were left out, or CPDs linearised, nor of messages round loops,
        nor of some variables whose search was given up.
    bound : ndarray
        (*runs): no assignment's ln p is above that, which is `log_probability` itself, but for
        rounding, where `exact`. Infinity where nothing is known, of paths of modes and messages
        round loops.
    status : Status or None
        Of max-product by a schedule, how many rounds were sent, whether each run converged to a
        fixed point, and the residuals, as of `infer`; else None.

    Examples
    --------
    >>> from pgm.examples import rain, still, wet
    >>> graph = pgm.compile(still, steps=2)
    >>> found = pgm.most_probable(graph, {wet: [1, 1]})
    >>> found.assignment[rain]
    array([1, 1, 1])
    >>> found.states(rain).tolist()
    ['yes', 'yes', 'yes']
    """

    assignment: Mapping[Discrete, str | Integers]
    log_probability: Array
    exact: Mask
    bound: Array
    status: Status | None = None

    def states(self, variable: Variable) -> str | npt.NDArray[np.str_]:
        """The name of a variable's most probable state.

        Parameters
        ----------
        variable : Discrete

        Returns
        -------
        str or ndarray of str
            The name; an array of names where `assignment` has an array of indices, in its shape.

        Raises
        ------
        EvidenceError
            If the assignment does not have the variable.
        """
        lacking = "is not in the assignment; its variables are"
        found = found_of(self.assignment, variable, lacking)
        assert isinstance(variable, Discrete)
        return found if isinstance(found, str) else np.array(variable.states)[found]

    @property
    def _title(self) -> str:
        lead = self.log_probability.shape
        if lead:
            count = len(self.assignment)
            return f"MostProbable({count} variable{'s' * (count != 1)}, runs {lead}{self._vouched})"
        if self._over_time:
            steps = max(np.shape(state)[-1] for state in self.assignment.values())
            return (
                f"MostProbable({len(self.assignment)} variables over {steps} steps; "
                f"ln p {self.log_probability:.6g})"
            )
        shown = [f"{v!r} {state}" for v, state in list(self.assignment.items())[:LISTED]]
        if len(self.assignment) > LISTED:
            shown.append(f"... {len(self.assignment)} variables")
        level = f"ln p {self.log_probability:.6g}{self._vouched}"
        return f"MostProbable({', '.join(shown)}; {level})"

    @property
    def _vouched(self) -> str:
        """The bound or status of an assignment that may not be the most probable one, in words."""
        if self.exact.all():
            return ""
        if self.status is None:
            return f", at most {self.bound.max():.6g}"
        settled = "settled" if self.status.converged.all() else "not settled"
        return f"; messages {settled}, no optimum is vouched for"

    @property
    def _over_time(self) -> bool:
        """Whether any state is an array of indices: over steps, or over the user's axes of runs."""
        return any(not isinstance(state, str) for state in self.assignment.values())

    def _summary(self) -> Summary:
        lead = self.log_probability.shape
        if not self._over_time or not self.log_probability.size:
            return Summary(self._title)
        rows = []
        for variable, found in list(self.assignment.items())[:LISTED]:
            path = np.asarray(found)[(0,) * len(lead)]
            shown = few(path.size, LISTED)
            names = [LEFT_OUT if k is None else variable.states[int(path.flat[k])] for k in shown]
            rows.append((repr(variable), ", ".join(names)))
        parts: list[str | Listing] = [Listing(("", "run 0" * bool(lead)), rows, names=2, cell=80)]
        if lead:
            parts.append(f"ln p {spread(self.log_probability)}")
        left = len(self.assignment) - len(rows)
        return Summary(self._title, parts + [f"... {left} more"] * (left > 0))


def best(assignment: dict[Discrete, str | Integers], log_probability: Array) -> MostProbable:
    """Assignments that are known to be the most probable ones."""
    exact = known(np.ones(log_probability.shape, dtype=bool))
    return MostProbable(MappingProxyType(assignment), log_probability, exact, log_probability)


def known(exact: Mask) -> Mask:
    """Whether assignments are the most probable ones, as a result has it."""
    exact.flags.writeable = False
    return exact


def named(
    states: Mapping[Discrete, Integers], lead: tuple[int, ...]
) -> dict[Discrete, str | Integers]:
    """States by variable, (runs,), by their names, or as indices (*runs) where there are runs."""
    found: dict[Discrete, str | Integers] = {}
    for variable, own in states.items():
        if lead:
            by_run = own.reshape(lead)
            by_run.flags.writeable = False
            found[variable] = by_run
        else:
            found[variable] = variable.states[own[0]]
    return found
