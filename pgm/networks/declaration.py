"""Checks of a dynamic network's prior, transition and observation."""

from __future__ import annotations

from collections.abc import Iterable

from pgm.cpds import CPD, ConditionalGaussian
from pgm.errors import ModelError
from pgm.networks.checks import as_cpds
from pgm.variables import Variable


def as_gaussian(cpds: CPD | Iterable[CPD], where: str) -> tuple[ConditionalGaussian, ...]:
    """The CPDs of a dynamic network as a tuple; refuses anything but Gaussian ones."""
    result = []
    for cpd in as_cpds(cpds, where):
        if not isinstance(cpd, ConditionalGaussian):
            raise ModelError(
                f"{where} holds {cpd!r}; dynamic networks are of Gaussian CPDs, and a discrete "
                "one is a BayesianNetwork",
                variable=cpd.child,
                cpd=cpd,
            )
        result.append(cpd)
    return tuple(result)


def check_templates(cpds: Iterable[CPD]) -> None:
    """Refuse variables at single steps, and ones more than one step back."""
    for cpd in cpds:
        for variable in cpd.scope:
            if variable.step is not None:
                raise ModelError(
                    f"{cpd!r}: a dynamic network is declared for {variable.template!r} and "
                    f"{variable.template.previous!r}, not for the single step of {variable!r}",
                    variable=variable,
                    cpd=cpd,
                )
            if variable.lag > 1:
                raise ModelError(
                    f"{cpd!r}: {variable!r} is more than one step back; carry it along as a "
                    "state of its own (LinearGaussianCPD(older, given={x.previous: 1.0}, cov=0))",
                    variable=variable,
                    cpd=cpd,
                )


def check_states(
    prior: Iterable[CPD], transition: Iterable[CPD], states: set[Variable], hidden: set[Variable]
) -> None:
    """Refuse a state that lacks its prior or its transition."""
    for cpd in prior:
        if cpd.child not in hidden:
            raise ModelError(
                f"state {cpd.child!r} has a prior but no transition; add a CPD of it given "
                f"{cpd.child.previous!r} (cov=0 for a static unknown)",
                variable=cpd.child,
                cpd=cpd,
            )
    for cpd in transition:
        for parent in cpd.parents:
            if parent.lag and parent.template not in states:
                raise ModelError(
                    f"{cpd!r} needs {parent!r}, but {parent.template!r} has no prior; add a CPD "
                    "of it to the prior",
                    variable=parent.template,
                    cpd=cpd,
                )


def check_parents(
    prior: Iterable[CPD],
    transition: Iterable[CPD],
    observation: Iterable[CPD],
    states: set[Variable],
    hidden: set[Variable],
    sensors: set[Variable],
) -> None:
    """Refuse a parent that stands where it cannot."""

    def refuse(cpd: CPD, parent: Variable, why: str) -> None:
        raise ModelError(f"{cpd!r}: {parent!r} {why}", variable=parent, cpd=cpd)

    for cpd in prior:
        for parent in cpd.parents:
            if parent not in states:
                refuse(cpd, parent, "cannot be a parent in the prior; only other states can")
    for cpd in observation:
        for parent in cpd.parents:
            if parent.lag:
                refuse(
                    cpd,
                    parent,
                    "cannot be a sensor's parent; carry it along as a state of this step "
                    "(LinearGaussianCPD(older, given={x.previous: 1.0}, cov=0))",
                )
    for cpd in (*prior, *transition, *observation):
        for parent in cpd.parents:
            if parent.template in sensors:
                refuse(
                    cpd,
                    parent,
                    "is a sensor's reading, which cannot be a parent; add a "
                    "state that both depend on",
                )
        for parent in cpd.noise_given:
            if parent.template in hidden:
                refuse(
                    cpd,
                    parent,
                    "is hidden, so the noise cannot depend on it; noise may depend on inputs alone",
                )
