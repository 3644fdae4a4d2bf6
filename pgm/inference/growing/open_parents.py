"""Parents that an addition leaves open: what their candidates, and their sensors, have to be."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import Any

from pgm.cpds import CPD
from pgm.errors import EvidenceError
from pgm.evidence import OneOf, UnknownVariable
from pgm.evidence.values import SUM
from pgm.factors.scope import described, is_alike, unknown_name
from pgm.variables import Variable


def open_parents(
    evidence: Mapping[Any, Any],
    cpds: Sequence[CPD],
    known: Collection[Variable],
    hidden: Collection[Variable],
) -> dict[Variable, UnknownVariable]:
    """The parents that evidence leaves open, with their candidates; what does not fit is refused.

    `cpds` are those of the addition; the map has the variables `hidden`, and `known` ones with
    evidence.
    """
    found = {
        parent: _candidates(parent, value, cpds, evidence, known, hidden)
        for parent, value in evidence.items()
        if isinstance(value, OneOf)
    }
    if found:
        _require_sensors(found, cpds, evidence)
    return found


def _candidates(
    parent: Variable,
    value: OneOf,
    cpds: Sequence[CPD],
    evidence: Mapping[Any, Any],
    known: Collection[Variable],
    hidden: Collection[Variable],
) -> UnknownVariable:
    """The candidates, hidden variables of the map, for a parent that is nothing else."""
    children = {cpd.child for cpd in cpds}
    new = children.difference(evidence)
    why = ""
    if parent in hidden:
        why = "it is a hidden variable of the map"
    elif parent in children:
        why = "it has a CPD"
    elif parent in known:
        why = "it has evidence since before"
    elif not any(parent in cpd.parents for cpd in cpds):
        why = "it is no parent of a CPD that is added"
    elif isinstance(value, UnknownVariable) and parent in value.candidates:
        why = "it is among its own candidates"
    if why:
        raise EvidenceError(
            f"evidence leaves {parent!r} open, but {why}; give {value!r} to a variable of its "
            "own, which stands in the sensors' CPDs where the candidates would",
            variable=parent,
        )
    if not isinstance(value, UnknownVariable):
        raise EvidenceError(
            f"evidence leaves {parent!r} open among {value.count} rows of values; the "
            "candidates of a growing map are its hidden variables: pgm.unknown([l0, l1, ...])",
            variable=parent,
        )
    if value.association == SUM:
        raise EvidenceError(
            f"evidence leaves {parent!r} open, to be summed out: a Gaussian belief would be a "
            'mixture; give association="likelihood" or "joint"',
            variable=parent,
        )
    first = value.candidates[0]
    if not is_alike(first, parent):
        raise EvidenceError(
            f"evidence leaves {parent!r} open, with {described(parent)}, among candidates with "
            f"{described(first)}; give the parent those of the candidates",
            variable=parent,
        )
    for candidate in value.candidates:
        if candidate in hidden or candidate in new:
            continue
        what = f"{candidate!r}, a candidate for {parent!r},"
        if candidate in known or candidate in evidence:
            why = "has evidence; candidates are hidden variables of the map"
        else:
            why = f"is a variable {unknown_name(candidate, [*hidden, *new], 'the map')}"
        raise EvidenceError(f"{what} {why}", variable=candidate)
    return value


def _require_sensors(
    opened: Mapping[Variable, UnknownVariable], cpds: Sequence[CPD], evidence: Mapping[Any, Any]
) -> None:
    """Refuse CPDs with open parents that are no sensors of one thing each."""
    needed = {parent: cpd for cpd in cpds for parent in cpd.parents}
    for cpd in cpds:
        own = [parent for parent in cpd.parents if parent in opened]
        if not own:
            continue
        parent = own[0]
        twice = [v for v in cpd.parents if v in opened[parent].candidates]
        if len(own) > 1:
            why = f"and {own[1]!r} too; candidates are for one parent of a CPD"
        elif parent in cpd.noise_given:
            why = "on which its noise depends; a noise can depend on known values alone"
        elif cpd.child not in evidence:
            why = f"and has no evidence for {cpd.child!r}, by which to tell candidates apart"
        elif cpd.child in needed:
            why = (
                f"and {needed[cpd.child]!r} depends on {cpd.child!r}, which is left out if it is "
                "of no candidate; add that once it is known"
            )
        elif twice:
            why = f"of which {twice[0]!r} is a candidate, and a parent already"
        else:
            continue
        raise EvidenceError(
            f"evidence leaves {parent!r} open in {cpd!r}, {why}", variable=parent, cpd=cpd
        )
