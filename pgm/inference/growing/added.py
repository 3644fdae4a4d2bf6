"""CPDs and evidence that are added to a growing map: checked, with their factors."""

from __future__ import annotations

from collections.abc import Hashable, Iterable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from pgm.boundary import as_mapping
from pgm.cpds import CPD, AffineCPD, ConditionalGaussian, GaussianCPD, NonlinearGaussianCPD
from pgm.errors import EvidenceError, ModelError
from pgm.evidence import UnknownVariable, bind_values
from pgm.evidence.values import require_whole
from pgm.factors.scope import as_value, listed, one_name_each
from pgm.inference.growing.factors import Factor, Given, predicted, probe, whitened
from pgm.inference.growing.means import Means
from pgm.inference.growing.open_parents import open_parents
from pgm.inference.growing.registers import Register
from pgm.inference.growing.vectors import Vector
from pgm.kernels.arrays import Array, Mask, frozen
from pgm.linearisers import Lineariser, Taylor
from pgm.networks import checks
from pgm.schedules.starting_points import Start
from pgm.variables import Variable


class Contents(NamedTuple):
    """The CPDs and evidence of a map, in stores that are shared with the maps before."""

    numbers: Register[Variable, int]
    names: Register[str, Variable]
    known: Register[Variable, Array]
    evidence: Register[Variable, Array]
    plates: Register[Hashable, Given]
    children: Register[Variable, None]
    cpds: Vector[CPD]
    variables: Vector[Variable]

    @classmethod
    def empty(cls) -> Contents:
        """The contents of a map without variables."""
        made: list[Register[Any, Any]] = [Register() for _ in range(6)]
        return cls(*made, Vector(), Vector())  # type: ignore[call-arg, arg-type]

    def __reduce__(self) -> tuple[Any, ...]:
        # Keys of plates are of objects of this process.
        plates = list(self.plates.values())
        return _restored, (plates, self._replace(plates=Register())._asdict())


def _restored(plates: Sequence[Given], others: Mapping[str, Any]) -> Contents:
    found = Contents(**others)
    return found._replace(plates=found.plates.extended({each.key: each for each in plates}))


class Added(NamedTuple):
    """CPDs that are added, checked, parents first, with their hidden children.

    `opened` are the parents that the evidence leaves open, each with its candidates.
    """

    cpds: Sequence[ConditionalGaussian]
    evidence: Mapping[Variable, Any]
    known: Mapping[Variable, Array]
    taken: Mapping[Variable, Mask | None]
    given: Sequence[Given]
    hidden: Sequence[Variable]
    before: Contents
    opened: Mapping[Variable, UnknownVariable]

    @classmethod
    def checked(
        cls, contents: Contents, cpds: CPD | Iterable[CPD], evidence: Mapping[Any, Any]
    ) -> Added:
        """The CPDs to add, checked against those of a map; one that does not fit is refused."""
        found = checks.as_cpds(cpds, "what is added to a growing map")
        checks.one_cpd_each(found)
        checks.no_step_before(found)
        for cpd in found:
            _require_kind(cpd)
            _require_new(contents, cpd)
        scope = dict.fromkeys(v for cpd in found for v in cpd.scope)
        met = (contents.names.get(v.name) for v in scope)
        one_name_each([*(v for v in met if v is not None), *scope])
        children = {cpd.child for cpd in found}
        opened = open_parents(evidence, found, contents.known, contents.numbers)
        if opened:
            evidence = {v: value for v, value in evidence.items() if v not in opened}
        for variable in evidence:
            _require_open(contents, variable)
        needed = []
        for cpd in found:
            for parent in cpd.parents:
                if parent in evidence or parent in contents.known or parent in opened:
                    continue
                hidden = parent in children or parent in contents.numbers
                if not hidden or parent in cpd.noise_given:
                    needed.append(parent)
        bound = bind_values(found, evidence, needed=needed)
        if bound.lead:
            raise EvidenceError(
                f"a growing map is of one run; evidence has the axes of runs {bound.lead}"
            )
        values = {v: row[0] for v, row in bound.values.items()}
        every = _Both(contents.known, values)
        ordered = checks.in_order(found, lambda cpd: cpd.parents)
        own = [cpd for cpd in ordered if isinstance(cpd, ConditionalGaussian)]
        taken = {v: mask[0] for v, mask in bound.taken.items()}
        given = [Given.of(cpd, every, values.get(cpd.child)) for cpd in own]
        for parent, unknown in opened.items():
            for cpd in own:
                if parent in cpd.given and cpd.child in taken:
                    require_whole(cpd, (parent, unknown), taken[cpd.child])
        hidden_children = [cpd.child for cpd in own if cpd.child not in values]
        return cls(own, evidence, values, taken, given, hidden_children, contents, opened)

    @property
    def named(self) -> Added:
        """The CPDs whose parents are all known by name."""
        if not self.opened:
            return self
        named = [each for each in self.given if self.opened.keys().isdisjoint(each.parents)]
        return self.part(named, self.before)

    def sightings(self, parent: Variable) -> list[Given]:
        """The CPDs of which the evidence leaves a parent open."""
        return [each for each in self.given if parent in each.parents]

    def part(self, given: Sequence[Given], before: Contents) -> Added:
        """Some of the CPDs, or copies of them, with their evidence, to be added to a map."""
        cpds = [each.cpd for each in given]
        scope = {v for cpd in cpds for v in cpd.scope if v not in before.known}
        return Added(
            cpds,
            {v: value for v, value in self.evidence.items() if v in scope},
            {v: value for v, value in self.known.items() if v in scope},
            self.taken,
            given,
            [v for v in self.hidden if v in scope and v not in before.numbers],
            before,
            {},
        )

    @property
    def every(self) -> Mapping[Variable, Array]:
        """All values that are known."""
        return _Both(self.before.known, self.known)

    def starts(self, means: Means, start: Start | None, lineariser: Lineariser) -> list[Array]:
        """The points of the new hidden variables."""
        told = as_mapping(start, "start")
        for variable in told:
            if variable not in self.hidden:
                raise EvidenceError(
                    f"start has {variable!r}, which is no new hidden variable; "
                    + (f"it takes {listed(self.hidden)}" if self.hidden else "there is none"),
                    variable=variable if isinstance(variable, Variable) else None,
                )
        found: dict[Variable, Array] = {}
        numbers = self.before.numbers
        for each in self.given:
            cpd, child = each.cpd, each.cpd.child
            if each.key not in self.before.plates:
                probe(each, self.every, lineariser)
            if each.reading is not None:
                continue
            if child in told:
                found[child] = _start(child, told[child])
            elif isinstance(cpd, GaussianCPD):
                found[child] = np.array(cpd.mean)
            else:
                at = [found[v] if v in found else means.of(numbers[v]) for v in each.parents]
                parents = np.concatenate([np.zeros(0), *at])
                found[child] = predicted(each, parents, self.every, lineariser)
        return [found[variable] for variable in self.hidden]

    def factors(self, contents: Contents, new: Mapping[Variable, int]) -> list[Factor]:
        """The factors over hidden variables, but for those that say nothing."""
        alike: dict[Hashable, list[Given]] = {}
        for each in self.given:
            if not (each.flat or (each.reading is not None and not each.parents)):
                alike.setdefault(each.key, []).append(each)
        found = []
        for own in alike.values():
            white = whitened(own, [self.taken.get(each.cpd.child) for each in own], self.every)
            for each, root in zip(own, white, strict=True):
                if root.any():
                    scope = each.parents if each.reading is not None else each.cpd.scope
                    if each.reading is None:
                        scope = (each.cpd.child, *each.parents)
                    numbers = (new[v] if v in new else contents.numbers[v] for v in scope)
                    found.append(Factor(each, tuple(numbers), root))
        return found

    def contents(self, before: Contents, new: Mapping[Variable, int]) -> Contents:
        """The contents of the map with these CPDs."""
        scope = dict.fromkeys(v for cpd in self.cpds for v in cpd.scope)
        names = {v.name: v for v in scope if v.name not in before.names}
        plates = {g.key: g for g in reversed(self.given) if g.key not in before.plates}
        kept = {v: frozen(np.array(_as_given(value))) for v, value in self.evidence.items()}
        return Contents(
            before.numbers.extended(new),
            before.names.extended(names),
            before.known.extended(self.known),
            before.evidence.extended(kept),
            before.plates.extended(plates),
            before.children.extended({cpd.child: None for cpd in self.cpds}),
            before.cpds.extended(self.cpds),
            before.variables.extended(new),
        )


class _Both(Mapping[Variable, Array]):
    """The values of a register, and more of them."""

    def __init__(self, before: Register[Variable, Array], more: Mapping[Variable, Array]) -> None:
        self.before, self.more = before, more

    def __getitem__(self, key: Variable) -> Array:
        return self.more[key] if key in self.more else self.before[key]

    def __contains__(self, key: object) -> bool:
        return key in self.more or key in self.before

    def __iter__(self) -> Iterator[Variable]:
        return iter([*self.before, *self.more])

    def __len__(self) -> int:
        return len(self.before) + len(self.more)


def _as_given(value: Any) -> npt.ArrayLike:
    found: npt.ArrayLike = getattr(value, "value", value)
    return found


def _start(variable: Variable, value: npt.ArrayLike) -> Array:
    found = as_value(variable, value, "start")
    if found.ndim > 1:
        raise EvidenceError(
            f"start for {variable!r} has shape {found.shape}; a growing map is of one run, and "
            f"({variable.dimension},) was due",
            variable=variable,
        )
    return np.array(found)


def _require_kind(cpd: CPD) -> None:
    """Refuse a CPD that has no rows of Gaussian noise."""
    if cpd.discrete or not isinstance(cpd, AffineCPD | NonlinearGaussianCPD):
        why = "a growing map takes Gaussian CPDs alone"
    elif cpd.noise is not None:
        why = (
            f"a growing map has no use for its robust noise, {cpd.noise!r}: add it with Gaussian "
            "noise, or infer the network when all is there"
        )
    elif isinstance(cpd, NonlinearGaussianCPD) and not isinstance(cpd.lineariser, Taylor | None):
        why = f"a growing map linearises at means, by pgm.Taylor(), not by {cpd.lineariser!r}"
    elif cpd._lead():
        why = f"it has the axes of runs {cpd._lead()}, and a growing map is of one run"
    else:
        return
    raise ModelError(f"{cpd!r}: {why}", variable=cpd.child, cpd=cpd)


def _require_new(contents: Contents, cpd: CPD) -> None:
    """Refuse a CPD whose child is there."""
    child = cpd.child
    if child in contents.children:
        raise ModelError(
            f"{cpd!r}: {child!r} was added before, with its CPD; what is read of it now is a "
            "measurement with a name of its own, given it",
            variable=child,
            cpd=cpd,
        )
    if child in contents.known:
        raise ModelError(
            f"{cpd!r}: {child!r} has evidence since before, as a parent; a CPD of it comes with "
            "its evidence or before",
            variable=child,
            cpd=cpd,
        )


def _require_open(contents: Contents, variable: Variable) -> None:
    """Refuse evidence of a variable that is hidden, or has some."""
    if variable in contents.numbers:
        raise EvidenceError(
            f"evidence for {variable!r}, which was added without: it stays hidden; add a "
            f"measurement of it, LinearGaussianCPD(reading, given={{{variable.name}: 1.0}}, "
            "cov=...)",
            variable=variable,
        )
    if variable in contents.known:
        raise EvidenceError(
            f"evidence for {variable!r}, which has some since before; it is kept", variable=variable
        )
