"""A model with the parts of it that are learnt: E step, M step, coordinates."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from pgm.beliefs.own.family import BeliefFamily
from pgm.cpds import CPD, ConditionalGaussian, MixtureCPD, RobustNoise, TableCPD
from pgm.display import titled
from pgm.errors import EvidenceError, ModelError
from pgm.evidence import Evidence, constant
from pgm.factors.scope import Scope, listed
from pgm.inference import Smoothing
from pgm.inference.dynamic import over_time
from pgm.kernels.arrays import Array
from pgm.learning.gaussian import GaussianStep
from pgm.learning.places import Place, by_place, place_of, replaced
from pgm.learning.steps import ParameterStep, TableStep
from pgm.learning.values import (
    PARTS,
    Coefficients,
    Covariance,
    DegreesOfFreedom,
    Fit,
    FitStatus,
    Learn,
    Offset,
    Parameter,
    Table,
)
from pgm.linearisers import TAYLOR, Lineariser
from pgm.networks import DynamicBayesianNetwork
from pgm.posteriors.expectations import PRIOR, ROLES, Expectations, Learnable
from pgm.posteriors.posterior import Posterior
from pgm.schedules.binding import bind_chain
from pgm.schedules.options import Call
from pgm.variables import Discrete, Variable

_AS_CASES = (
    "make its components states of a discrete variable, each with a case of a pgm.SwitchingCPD, of "
    "which everything can be"
)


@dataclass(frozen=True, eq=False)
class Point:
    """The values of everything that is learnt: the model, and constant parents."""

    model: Any
    parameters: dict[Variable, Array]


@dataclass(frozen=True, eq=False)
class Expected:
    """The posterior of each recording at a point, and the objective there.

    `expectations` have for each recording the function that gives those of some CPDs.
    """

    point: Point
    posteriors: list[Any]
    expectations: list[Callable[[Sequence[Learnable]], Expectations]]
    log_evidence: float
    log_prior: float

    @property
    def objective(self) -> float:
        """The logarithm of the evidence times the prior of tables."""
        return self.log_evidence + self.log_prior


class Learner:
    """The parts of a model that are learnt, as of `fit`, and the recordings, of steps T each."""

    # The parts of a model that have CPDs, by name.
    roles: tuple[str, ...] = ROLES
    # Whether all that is learnt was observed, so that one M step is the answer.
    closed = False

    def __init__(
        self,
        model: Any,
        recordings: Sequence[Evidence],
        learn: Learn,
        lineariser: Lineariser,
        schedule: Any,
        belief: BeliefFamily[Any] | None,
        steps: Sequence[int | None],
        *,
        single: bool,
    ) -> None:
        self.recordings, self.steps, self.single = recordings, steps, single
        self.lineariser, self.schedule, self.belief = lineariser, schedule, belief
        self.places: list[Place] = []
        self.blocks: list[Any] = []
        self.parameters: dict[Variable, ParameterStep] = {}
        for variable, value in learn.items():
            self._declare(model, variable, value)
        self.start = Point(model, {v: each.start for v, each in self.parameters.items()})
        self._require_told()

    def _require_told(self) -> None:
        """Refuse evidence that does not fit, or tells nothing of a CPD that is learnt."""
        model, told = self.start.model, set[CPD]()
        for evidence, steps in zip(self.evidence(self.start), self.steps, strict=True):
            bound = bind_chain(model, evidence, steps, identities=True)
            told.update(model.prior)
            told.update(model.transition if bound.steps else ())
            for reading in bound.readings:
                if reading.unknown is not None and reading.cpd.child in self._sensors:
                    raise EvidenceError(
                        f"sightings of {reading.cpd.child!r} leave open what was seen, and its CPD "
                        "is to be learnt; say what was seen, or learn from other sightings",
                        variable=reading.cpd.child,
                    )
                told.update([reading.cpd] if reading.taken.any() else ())
        for place in self.places:
            cpd = place.of(model).cpd
            if cpd not in told:
                raise EvidenceError(
                    f"nothing in the evidence tells of {cpd!r}, which is to be learnt: it has no "
                    "measurement, or there is no step",
                    variable=cpd.child,
                    cpd=cpd,
                )

    @property
    def by_equations(self) -> bool:
        """Whether parameters are at a fixed point of steps, since no likelihood is to be raised.

        So it is with a gate, which takes in other measurements at other parameters; of the
        covariance of a loss; and where covariances are by score.
        """
        return (
            getattr(self.schedule, "gate", None) is not None
            or self.by_score
            or any(noise and not noise.distribution for noise in self._noises)
        )

    @property
    def by_score(self) -> bool:
        """Whether a Gaussian noise is learnt beside measurements of Student-t noise, on a chain.

        It is learnt from covariances of beliefs that are by score, see `Weights.information`: by
        those in which measurements count with their weights it comes out too small.
        """
        model = self.start.model
        if not isinstance(model, DynamicBayesianNetwork) or model.discrete or self.belief:
            return False
        kinds = [getattr(cpd, "noise", None) for cpd in model.observation]
        return None in self._noises and any(noise and noise.distribution for noise in kinds)

    @property
    def _noises(self) -> list[RobustNoise | None]:
        """The kinds of the noises whose covariances are learnt, None for a Gaussian one."""
        blocks = zip(self.blocks, self._cpds(self.start), strict=True)
        return [cpd.noise for b, cpd in blocks if isinstance(b, GaussianStep) and b.noise]

    @property
    def _sensors(self) -> set[Variable]:
        """The sensors of which something is learnt."""
        used = {part.cpd.child for part in self._learnable(self.start)}
        for cpd in self.start.model.observation:
            used |= {cpd.child} if set(cpd.parents) & set(self.parameters) else set()
        return used

    def _declare(self, model: Any, variable: Any, learnt: Any) -> None:
        """Declare what is learnt by a variable: a parameter, or parts of its CPD."""
        parts = () if isinstance(learnt, Mapping) else _parts(variable, learnt)
        if Parameter in map(type, parts):
            self._declare_parameter(model, variable, parts)
            return
        place = self._place_of(model, variable)
        if any(each[:2] == place[:2] for each in self.places):
            raise ModelError(f"learn names the CPD of {variable!r} twice")
        for each, own in by_place(place, place.of(model).cpd, learnt):
            self.blocks.append(self._block(model, each.of(model).own, _parts(variable, own)))
            self.places.append(each)

    def _block(self, model: Any, cpd: CPD, parts: Sequence[Any]) -> Any:
        """The M step of parts of a CPD."""
        kinds = list(map(type, parts))
        if isinstance(cpd, TableCPD):
            self._require(cpd, kinds, (Table,))
            return TableStep(cpd, parts)
        if not isinstance(cpd, ConditionalGaussian):
            raise ModelError(
                f"{cpd!r} is of a kind of which nothing can be learnt"
                + f"; {_AS_CASES}" * isinstance(cpd, MixtureCPD),
                cpd=cpd,
            )
        self._require(cpd, kinds, (Covariance, Coefficients, Offset, DegreesOfFreedom))
        return GaussianStep(cpd, self._hidden(model, cpd), parts)

    def _place_of(self, model: Any, variable: Any) -> Place:
        """The place of the CPD that a variable names."""
        return place_of(model, variable)

    def _hidden(self, model: Any, cpd: Any) -> Scope:
        """The parents of a Gaussian CPD that beliefs are over."""
        return tuple(p for p in cpd.given if p.template in {*model.states, *model.controls})

    def _require(self, cpd: CPD, kinds: list[type], fit: tuple[type, ...]) -> None:
        for kind in kinds:
            if kind not in fit:
                raise ModelError(
                    f"{cpd!r} has no {kind.__name__} to learn; it has "
                    f"{', '.join(each.__name__ for each in fit)}",
                    cpd=cpd,
                )

    def _declare_parameter(self, model: Any, variable: Any, parts: Any) -> None:
        if len(parts) > 1:
            raise ModelError(f"learn of {variable!r}: a Parameter has no other parts")
        if isinstance(variable, Discrete) or variable not in model.inputs:
            raise ModelError(
                f"learn of {variable!r}: a Parameter is an input of Gaussian CPDs, a parent that "
                f"no CPD explains; those are [{listed(model.inputs)}]",
                variable=variable if isinstance(variable, Variable) else None,
            )
        for cpd in model.cpds:
            if variable in cpd.noise_given:
                raise ModelError(
                    f"{cpd!r}: its noise depends on {variable!r}, and a Parameter is learnt from "
                    "means alone",
                    variable=variable,
                    cpd=cpd,
                )
        for evidence in self.recordings:
            if variable in evidence:
                raise ModelError(
                    f"{variable!r} is to be learnt and has evidence; leave it out, its start is "
                    "pgm.learning.Parameter(start)",
                    variable=variable,
                )
        self.parameters[variable] = ParameterStep(variable, parts[0])

    def evidence(self, point: Point) -> list[dict[Variable, Any]]:
        """The recordings with the values of parameters put in."""
        found = {variable: constant(value) for variable, value in point.parameters.items()}
        return [{**evidence, **found} for evidence in self.recordings]

    def expected(self, point: Point) -> Expected:
        """The E step: one posterior a recording."""
        posteriors, expectations, total = self._solved(point)
        prior = sum(
            block.log_prior(cpd)
            for block, cpd in zip(self.blocks, self._cpds(point), strict=True)
            if isinstance(block, TableStep)
        )
        return Expected(point, posteriors, expectations, total, float(prior))

    def _solved(self, point: Point) -> tuple[list[Any], list[Any], float]:
        """The posteriors, the functions that give expectations, and the log-evidence of all."""
        posteriors, expectations = [], []
        schedule, lineariser = self.schedule, self.lineariser
        if point.model.discrete:  # nothing is linearised
            schedule, lineariser = Smoothing(), TAYLOR
        call = Call(schedule, lineariser)
        for evidence, steps in zip(self.evidence(point), self.steps, strict=True):
            # Whether smoothers have settled is told at the end of the search, once.
            family, asked = over_time(point.model, evidence, call, steps, belief=self.belief)
            outcome, expect = family.infer_to_learn(*asked, by_score=self.by_score)
            posteriors.append(Posterior(outcome))
            expectations.append(expect)
        return posteriors, expectations, float(sum(np.sum(p.log_evidence) for p in posteriors))

    def again(self, point: Point) -> list[Any]:
        """The functions that give expectations, where all that is learnt was observed."""
        raise NotImplementedError

    def results(self, point: Point, posteriors: list[Any]) -> list[Any]:
        """The posterior of each recording, as results show it."""
        return posteriors

    def _learnable(self, point: Point) -> list[Learnable]:
        """The CPDs that are learnt."""
        return [place.of(point.model) for place in self.places]

    def _cpds(self, point: Point) -> list[Any]:
        return [each.own for each in self._learnable(point)]

    def _with(self, point: Point, cpds: list[Any], parameters: dict[Variable, Array]) -> Point:
        model = replaced(point.model, zip(self.places, cpds, strict=True)) if cpds else point.model
        return Point(model, parameters)

    def improved(self, expected: Expected) -> tuple[Point, Array]:
        """The M step, and the gradient of the objective by the coordinates."""
        point, slopes = expected.point, [np.zeros(0)]
        learnable, new = self._learnable(point), []
        wanted = dict.fromkeys([*learnable, *self._of_parameters(point.model)])
        every = [expect(list(wanted)) for expect in expected.expectations]
        known = dict(point.parameters)
        for variable, step in self.parameters.items():
            beliefs = [
                belief
                for each in every
                for part, belief in each.families.items()
                if variable in part.own.given
            ]
            known[variable], slope = step.maximised(beliefs, known)
            slopes.append(slope)
        for block, part in zip(self.blocks, learnable, strict=True):
            cpd: Any = part.own
            if isinstance(block, TableStep):
                counts = np.sum([each.counts[part] for each in every], axis=0)
                slopes.append(block.gradient(cpd, counts))
                new.append(block.maximised(cpd, counts))
                continue
            beliefs = [each.families[part] for each in every if part in each.families]
            if cpd.noise is not None and any(belief.robust is None for belief in beliefs):
                raise ModelError(
                    f"{cpd!r} has robust noise, {cpd.noise!r}, of which nothing is learnt beside "
                    "discrete variables, where mixtures are the beliefs; learn it with Gaussian "
                    "noise, noise=None, or name it not in learn=",
                    cpd=cpd,
                )
            image, slope = block.improved(beliefs, point.parameters, known)
            slopes.append(slope)
            new.append(image)
        return self._with(point, new, known), np.concatenate(slopes)

    def _of_parameters(self, model: Any) -> Iterator[Learnable]:
        """The CPDs that parameters are parents of."""
        for role in self.roles:
            for number, cpd in enumerate(getattr(model, role)):
                for place, _ in by_place(Place(role, number), cpd, None):
                    part = place.of(model)
                    if any(variable in part.own.given for variable in self.parameters):
                        yield part

    def vanishing(self, expected: Expected) -> CPD | None:
        """A CPD whose noise has shrunk to the rounding of readings, or of beliefs, if any."""
        point = expected.point
        learnable = self._learnable(point)
        wanted = [
            part
            for block, part in zip(self.blocks, learnable, strict=True)
            if isinstance(block, GaussianStep) and block.noise
        ]
        every = [expect(wanted).families for expect in expected.expectations]
        for block, part in zip(self.blocks, learnable, strict=True):
            beliefs = [each[part] for each in every if part in each]
            searched = not self.closed
            if beliefs and block.vanishes(beliefs, point.parameters, searched=searched):
                return part.own
        return None

    def vector(self, point: Point) -> Array:
        """The coordinates of a point."""
        parts = [np.zeros(0), *(point.parameters[v] for v in self.parameters)]
        pairs = zip(self.blocks, self._cpds(point), strict=True)
        return np.concatenate([*parts, *(block.vector(cpd) for block, cpd in pairs)])

    def at(self, point: Point, vector: Array) -> Point:
        """The point with its coordinates replaced, as a line search asks for."""
        start, parameters, cpds = 0, {}, []
        for variable, step in self.parameters.items():
            parameters[variable] = step.clipped(vector[start : start + variable.dimension])
            start += variable.dimension
        for block, cpd in zip(self.blocks, self._cpds(point), strict=True):
            size = len(block.vector(cpd))
            part = vector[start : start + size]
            cpds.append(block.at(cpd, part))
            start += size
        return self._with(point, cpds, parameters)

    def fit(
        self, here: Expected, trace: list[float], priors: list[float], status: FitStatus
    ) -> Fit:
        """The result, with the log-evidence and the log-prior of each point on the way."""
        point = here.point
        evidence: Any = tuple(self.evidence(point))
        posteriors: Any = tuple(self.results(point, here.posteriors))
        if self.single:
            (evidence,), (posteriors,) = evidence, posteriors
        return Fit(point.model, self._named(point), evidence, trace, priors, posteriors, status)

    def _named(self, point: Point) -> dict[Variable, Any]:
        """The learnt parameters and CPDs, by the variables that the user named."""
        named: dict[Variable, Any] = dict(point.parameters)
        for place, part in zip(self.places, self._learnable(point), strict=True):
            child = part.cpd.child
            named[child.at(0) if place.role == PRIOR else child] = part.cpd
        return named


def _parts(variable: Any, learnt: Any) -> Sequence[Any]:
    """The parts that are learnt by a variable, each of another kind; anything else is refused."""
    parts = learnt if isinstance(learnt, tuple | list) else (learnt,)
    for part in parts:
        if not isinstance(part, PARTS):
            raise ModelError(
                f"learn of {variable!r}: takes a part of pgm.learning, "
                f"{', '.join(each.__name__ for each in PARTS)}, or a tuple of them; of a "
                f"SwitchingCPD also a mapping of states to these; found {titled(part)}"
            )
    kinds = list(map(type, parts))
    if not kinds or len(set(kinds)) < len(kinds):
        raise ModelError(
            f"learn of {variable!r}: takes one part or several, each kind once; found "
            f"{titled(parts)}"
        )
    return parts
