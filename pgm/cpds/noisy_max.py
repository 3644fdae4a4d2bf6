"""Noisy-max and noisy-or: the largest of the contributions of independent causes."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from pgm.arguments import public
from pgm.boundary import as_floats, as_mapping, as_tuple, is_number
from pgm.cpds.causal_independence import CausalIndependence
from pgm.display import Listing, few, number
from pgm.errors import ModelError
from pgm.factors.scope import listed
from pgm.kernels.arrays import Array, Integers, frozen
from pgm.variables import Discrete, Variable


@public
class NoisyMax(CausalIndependence):
    r"""A graded child that is the largest of the contributions of independent causes.

    .. math:: p(y \le s \mid x) = p_0(y_0 \le s) \prod_i p_i(y_i \le s \mid x_i)

    Each cause alone brings the child to some grade with some probability, and the worst of them
    counts. `CausalIndependence` tells the rest; of a child of two states it is a `NoisyOr`.

    Parameters
    ----------
    child : Discrete
        Its states are grades, from the lowest to the highest, unless `order` says otherwise.
    given : Discrete or sequence of Discrete
        The causes.
    contributions : sequence of array_like
        Of each cause, (its size, size of the child): what it alone does. The last axis, in the
        order of the child's states, sums to one; a cause that is absent does nothing where its row
        is one at the lowest grade.
    leak : array_like, optional
        (size of the child,): the contribution of all other causes; none if not given.
    order : sequence of str, optional
        The child's states from the lowest to the highest.

    Raises
    ------
    ModelError
        See `CausalIndependence`; and if `order` does not name each state once.

    References
    ----------
    Díez (1993), Parameter adjustment in Bayes networks: the generalized noisy OR-gate. Henrion
    (1989), Some practical issues in constructing belief networks.

    Examples
    --------
    >>> flu, cold = (pgm.Discrete(name, states=("no", "yes")) for name in ("flu", "cold"))
    >>> fever = pgm.Discrete("fever", states=("none", "slight", "high"))
    >>> cpd = NoisyMax(
    ...     fever, (flu, cold), [[[1, 0, 0], [0.1, 0.3, 0.6]], [[1, 0, 0], [0.5, 0.4, 0.1]]]
    ... )
    >>> cpd.table[1, 1].round(3)
    array([0.05, 0.31, 0.64])
    """

    def __init__(
        self,
        child: Variable,
        given: Variable | Iterable[Variable],
        contributions: Sequence[npt.ArrayLike],
        leak: npt.ArrayLike | None = None,
        *,
        order: Sequence[str] | None = None,
    ) -> None:
        self._set_causes(child, given)
        grades = self._grades(order)
        self._set_contributions(contributions, leak, _larger(grades))

    def _grades(self, order: Any) -> Integers:
        """The states from the lowest to the highest, as indices."""
        if order is None:
            return np.arange(self.child.size)
        found = [self.child.index(state) for state in as_tuple(order) or (order,)]
        if sorted(found) != list(range(self.child.size)):
            raise ModelError(
                f"{self!r}: order names the states of {self.child!r}, each once, from the lowest "
                f"to the highest; found {order!r}, of {self.child.states}",
                variable=self.child,
                cpd=self,
            )
        return np.array(found)


# First states by whose names a variable is declared with what is present before what is absent.
PRESENT = {"yes", "y", "true", "t", "on", "present", "1", "positive", "pos", "active"}


@public
class NoisyOr(NoisyMax):
    r"""A child of two states that any of its causes turns on, each with a probability of its own.

    .. math:: p(\text{off} \mid x) = (1 - \ell) \prod_{i \text{ on}} (1 - p_i)

    Thirty causes take thirty numbers, and as few operations (see `CausalIndependence`).

    Parameters
    ----------
    child : Discrete
        Of two states, the last of which is *on*, as of ``states=("no", "yes")``.
    given : Discrete or sequence of Discrete
        The causes; of those of two states the last one is on.
    probabilities : sequence of float or array_like
        Of each cause p, with which it alone turns the child on; or one for each of its states, (its
        size,), which causes of more than two states need.
    leak : float
        ℓ, the probability that the child is on without any cause.
    present : mapping of Discrete to str, optional
        The state that is on, of those variables of which it is the first: ``{rain: "yes"}`` of
        ``states=("yes", "no")``. A variable whose first state has such a name is refused without.

    Attributes
    ----------
    probabilities : tuple of ndarray
        Of each cause those by state.

    Raises
    ------
    ModelError
        If the child has not two states, a probability is not between 0 and 1, or it is not clear
        which state is on.

    References
    ----------
    Pearl (1988), Probabilistic Reasoning in Intelligent Systems, section 4.3.2. Shwe and others
    (1991), Probabilistic diagnosis using a reformulation of the INTERNIST-1/QMR knowledge base.

    Examples
    --------
    >>> names = ("flu", "cold", "fever")
    >>> flu, cold, fever = (pgm.Discrete(name, states=("no", "yes")) for name in names)
    >>> cpd = NoisyOr(fever, (flu, cold), [0.9, 0.5], leak=0.01)
    >>> cpd
    NoisyOr(fever | flu, cold)
    >>> cpd.table[..., 1].round(4)
    array([[0.01  , 0.505 ],
           [0.901 , 0.9505]])
    """

    probabilities: tuple[Array, ...]

    def __init__(
        self,
        child: Variable,
        given: Variable | Iterable[Variable],
        probabilities: Sequence[npt.ArrayLike],
        leak: float = 0.0,
        *,
        present: Mapping[Variable, str] | None = None,
    ) -> None:
        self._set_causes(child, given)
        if self.child.size != 2:
            raise ModelError(
                f"{self!r}: {child!r} has {self.child.size} states, and a noisy-or is of two; a "
                "child of more grades takes pgm.NoisyMax",
                variable=child,
                cpd=self,
            )
        named = as_mapping(present or {}, f"{self!r}: present", ModelError, cpd=self)
        for variable in named:
            if variable not in self.scope:
                raise ModelError(
                    f"{self!r}: present names {variable!r}, which is none of its variables "
                    f"({listed(self.scope)})",
                    cpd=self,
                )
        each = self._each(probabilities, "probabilities")
        found = [
            self._by_state(cause, own, named) for cause, own in zip(self.given, each, strict=True)
        ]
        if not is_number(leak) or not 0.0 <= leak <= 1.0:
            raise ModelError(f"{self!r}: leak is a probability, from 0 to 1; found {leak!r}")
        on = self._on(self.child, named)
        self._set(probabilities=tuple(map(frozen, found)))
        self._set_contributions(
            [_either(own, on) for own in found],
            _either(np.array(float(leak)), on),
            _larger(np.array([1 - on, on])),
        )

    def _by_state(self, cause: Discrete, given: Any, named: Mapping[Any, Any]) -> Array:
        """The probabilities with which the states of a cause turn the child on, (size,)."""
        found = as_floats(given, f"{self!r}: the probability of {cause!r}", cpd=self)
        if not ((found >= 0.0) & (found <= 1.0)).all():
            raise ModelError(
                f"{self!r}: probabilities are from 0 to 1; found {given!r} of {cause!r}",
                variable=cause,
                cpd=self,
            )
        if found.shape == (cause.size,):
            return found.copy()
        if found.shape != () or cause.size != 2:
            due = "a probability, or " * (cause.size == 2) + "one of each of its states"
            raise ModelError(
                f"{self!r}: {cause!r} takes {due}, ({', '.join(cause.states)}); found {given!r}",
                variable=cause,
                cpd=self,
            )
        return np.where(np.arange(2) == self._on(cause, named), found, 0.0)

    def _on(self, variable: Discrete, named: Mapping[Any, Any]) -> int:
        """The index of the state of a variable of two that is on."""
        if variable in named:
            return variable.index(named[variable])
        first = variable.states[0]
        if first.lower() in PRESENT:
            raise ModelError(
                f"{self!r}: the last state of a variable is on, which of {variable!r} is "
                f"{variable.states[1]!r}; declare it with {first!r} last, or say which is on, "
                f"present={{{variable.name}: {first!r}}}",
                variable=variable,
                cpd=self,
            )
        return 1

    def _parts(self) -> Sequence[str | Listing]:
        rows = [
            (f"{cause!r} {state}", number(p))
            for cause, own in zip(self.given, self.probabilities, strict=True)
            for state, p in zip(cause.states, own.tolist(), strict=True)
            if p or cause.size > 2
        ]
        on = int(self.operation[0, 1])
        assert self.leak is not None
        rows.append(("leak", number(float(self.leak[on]))))
        shown = [None if k is None else rows[k] for k in few(len(rows))]
        return [Listing(("cause", f"{self.child!r} {self.child.states[on]}"), shown)]


def _larger(grades: Integers) -> Integers:
    """The larger of two states, of states that are given from the lowest to the highest."""
    rank = np.argsort(grades)
    return np.asarray(grades[np.maximum(rank[:, None], rank[None, :])])


def _either(probability: Array, on: int) -> Array:
    """The distribution, over two states, of the one that is on with a probability."""
    table = np.stack([1.0 - probability, probability], axis=-1)
    return table if on else table[..., ::-1]
