"""Bayesian networks without time."""

from __future__ import annotations

from collections.abc import Iterable

from pgm.cpds import CPD
from pgm.errors import ModelError
from pgm.factors.scope import Scope
from pgm.immutable import Immutable
from pgm.networks import checks, declaration


class BayesianNetwork(Immutable):
    """A joint density as a product of CPDs, one for each variable.

    Its variables are all continuous (Gaussian CPDs, linear or not) or all `Discrete`
    (`TableCPD`).

    Parameters
    ----------
    cpds : iterable of CPD
        In any order. A continuous parent that is no CPD's child is an input: it must have
        evidence.

    Attributes
    ----------
    cpds : tuple of CPD
        Parents before children.
    variables : tuple of Variable
        All variables: the CPDs' children in their order, then the inputs.
    inputs : tuple of Variable
        Parents that no CPD explains.
    discrete : bool
        Whether the variables are discrete.

    Raises
    ------
    ModelError
        If a child has two CPDs, two variables share a name, the CPDs form a cycle, discrete and
        continuous variables are mixed, or a discrete parent has no CPD.

    Examples
    --------
    >>> from pgm import GaussianCPD, LinearGaussianCPD, variables
    >>> a, b = variables("a b")
    >>> BayesianNetwork([GaussianCPD(a, 0.0, 1.0), LinearGaussianCPD(b, given={a: 2.0}, cov=0.5)])
    BayesianNetwork(2 CPDs, continuous)
    """

    cpds: tuple[CPD, ...]
    variables: Scope
    inputs: Scope
    discrete: bool

    def __init__(self, cpds: Iterable[CPD]) -> None:
        found = checks.as_cpds(cpds, "a network")
        if not found:
            raise ModelError("a network needs at least one CPD")
        checks.one_name_each(v for cpd in found for v in cpd.scope)
        checks.one_cpd_each(found)
        kinds = {cpd.discrete for cpd in found}
        if len(kinds) > 1:
            odd = next(cpd for cpd in found if cpd.discrete != found[0].discrete)
            raise ModelError(
                f"{found[0]!r} and {odd!r}: a network is discrete or continuous; networks of both "
                "are not supported",
                cpd=odd,
            )
        declaration.runs(found)
        ordered = checks.in_order(found, lambda cpd: cpd.parents)
        children = tuple(cpd.child for cpd in ordered)
        explained = set(children)
        parents = dict.fromkeys(v for cpd in ordered for v in cpd.parents)
        inputs = tuple(v for v in parents if v not in explained)
        for cpd in ordered:
            if cpd.discrete and not explained.issuperset(cpd.parents):
                lost = next(v for v in cpd.parents if v not in explained)
                raise ModelError(
                    f"{cpd!r}: its parent {lost!r} has no CPD; add one", variable=lost, cpd=cpd
                )
        self._set(
            cpds=ordered,
            variables=(*children, *inputs),
            inputs=inputs,
            discrete=kinds.pop(),
        )

    @property
    def lead(self) -> tuple[int, ...]:
        """The axes of runs of the model itself, where a `GaussianCPD` differs by run."""
        return declaration.runs(self.cpds)

    def __repr__(self) -> str:
        kind = "discrete" if self.discrete else "continuous"
        return f"BayesianNetwork({len(self.cpds)} CPDs, {kind})"
