"""Checks that questions about networks of tables have in common."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TypeVar

from pgm.clustergraph import ClusterGraph
from pgm.cpds.causal_independence import CausalIndependence
from pgm.errors import EvidenceError, GraphError
from pgm.factors.scope import namesake
from pgm.posteriors.posterior import require_variable
from pgm.variables import Discrete, Variable

T = TypeVar("T")


def require_mapping(evidence: Any, what: str = "evidence") -> None:
    """Raise an EvidenceError unless evidence, which the error calls `what`, is a mapping."""
    if not isinstance(evidence, Mapping):
        records = "; of a table of records pgm.records(table, network) makes it"
        raise EvidenceError(
            f"{what} maps variables to states; found {type(evidence).__name__}"
            f"{records if what == 'evidence' else ''}"
        )


def found_of(found: Mapping[Discrete, T], variable: Variable, lacking: str) -> T:
    """The value of a variable in a result; `lacking` leads over to the variables that it has."""
    if not isinstance(variable, Discrete) or variable not in found:
        require_variable(variable)
        raise EvidenceError(
            f"{variable!r} {lacking} {list(found)}{namesake(variable, found)}", variable=variable
        )
    return found[variable]


def require_whole_tables(graph: ClusterGraph, what: str, why: str) -> None:
    """Raise a GraphError if CPDs of independent causes are in factors, over intermediate variables.

    `what` begins the error's text, and `why` tells how the answer would be wrong.
    """
    if graph._factorised is graph.network:
        return
    cpd = next(f for f in graph.network.factors if isinstance(f, CausalIndependence))
    raise GraphError(
        f"{what} for {cpd!r}, whose causes are combined one after another: {why}. Where its table "
        f"fits, pgm.TableCPD({cpd.child!r}, given=..., table=cpd.table) is the same CPD"
    )
