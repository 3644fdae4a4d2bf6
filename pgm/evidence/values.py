"""The values of evidence that are no plain arrays."""

from __future__ import annotations

from collections.abc import Container, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, Never

import numpy as np
import numpy.typing as npt

from pgm.arguments import public, public_in_loops, unfit
from pgm.boundary import as_floats, as_tuple, is_number
from pgm.cpds import CPD
from pgm.display import InCode, Shown, Summary, as_numbers, brief, table
from pgm.errors import EvidenceError
from pgm.factors.scope import Scope, as_scope, described, is_alike, listed, require_order
from pgm.immutable import Immutable, unlocked
from pgm.kernels.arrays import Array, Mask
from pgm.variables import Discrete, Variable


@dataclass(frozen=True, eq=False, repr=False)
class Constant(InCode):
    """A value that is equal at all steps; made by `constant`."""

    value: Any

    def __repr__(self) -> str:
        return f"Constant(value={brief(self.value)})"


@dataclass(frozen=True, eq=False, repr=False)
class Soft(InCode):
    """Weights of the states of a discrete variable, or their logarithms; made by `soft`."""

    weights: Any
    log: bool = False

    def __repr__(self) -> str:
        return f"Soft(weights={brief(self.weights)}{', log=True' if self.log else ''})"


class Sightings(Shown, Immutable):
    """Measurements of one sensor at any steps, as `sightings` makes them."""

    __slots__ = ("_given", "step", "values")

    values: Any
    step: Any
    _given: Mapping[Variable, Any]

    def __init__(
        self, values: Any, step: Any = None, given: Mapping[Variable, Any] = MappingProxyType({})
    ) -> None:
        self._set(values=values, step=step, _given=dict(given))

    @property
    def given(self) -> Mapping[Variable, Any]:
        """The observed parents that differ from measurement to measurement."""
        return MappingProxyType(self._given)

    @property
    def _title(self) -> str:
        shape = getattr(self.values, "shape", None)
        values = brief(self.values) if shape is None else f"of shape {shape}"
        return f"Sightings({values}, given [{listed(self.given)}])"

    def _summary(self) -> Summary:
        values, step = as_numbers(self.values), as_numbers(self.step)
        if values is None or values.ndim < 2 or not values.size:
            return Summary(self._title)
        first = (0,) * (values.ndim - 2)
        rows = values[first]
        columns = [] if step is None or step.shape != rows.shape[:1] else [("step", step)]
        columns += [("value", rows), *((repr(v), given) for v, given in self.given.items())]
        which = [f"run {', '.join(map(str, first))}:"] if first else []
        return Summary(self._title, [*which, table(columns)])


_Unlocked = unlocked(Sightings)

# By variable: a plain array, a constant, or sightings; of a discrete one states, or soft weights.
Evidence = Mapping[Variable, Any]


@public
def constant(value: npt.ArrayLike) -> Constant:
    """Evidence that is equal at all steps.

    Parameters
    ----------
    value : array_like
        (..., d); leading axes are runs.

    Examples
    --------
    >>> constant([0.5, 0.0])
    Constant(value=[0.5, 0.0])
    """
    return Constant(value)


@public
def soft(weights: npt.ArrayLike, *, log: bool = False) -> Soft:
    """Soft (virtual, likelihood) evidence for a discrete variable.

    The belief is multiplied by the weights, as by an observed child with p(measurement | state)
    proportional to them.

    Parameters
    ----------
    weights : array_like
        (..., size), one for each state, non-negative and not all zero; leading axes are runs.
        They need not sum to one: marginals depend on their ratios alone, and a common factor
        enters the log-evidence.
    log : bool, optional
        Whether these are the weights' natural logarithms, of any size: no float holds e^−900, the
        likelihood of many readings. −∞ stands for a weight of zero. A state of weight e^−900 beside
        another of weight 1 remains possible: where other evidence excludes the rest, its
        probability is 1, and ln p(evidence) has the −900. Next to a likelier state its probability,
        which a table holds as a number, is 0 below about e^−745.

    Raises
    ------
    EvidenceError
        If `log` is not True or False. When the evidence is used: if there is not one weight for
        each state, a weight is negative or infinite, a logarithm is NaN or +∞, or all weights are
        zero.

    References
    ----------
    Pearl, Probabilistic Reasoning in Intelligent Systems, 1988, section 2.2.2.

    Examples
    --------
    >>> from pgm.examples import rain, rainy, wet
    >>> pgm.query(rainy, rain, {wet: pgm.soft([0.0, 1.0])})
    Table(rain: no 0.25, yes 0.75)
    >>> pgm.query(rainy, rain, {rain: pgm.soft([1.0, 4.0])})
    Table(rain: no 0.2, yes 0.8)
    >>> seen = pgm.infer(pgm.compile(rainy), {wet: pgm.soft([-901.0, -900.0], log=True)})
    >>> seen.log_evidence.round(4)
    np.float64(-900.3799)
    """
    if not isinstance(log, bool | np.bool_):
        raise EvidenceError(
            f"soft: log says whether the weights are logarithms, True or False; found {brief(log)}"
        )
    return Soft(weights, bool(log))


@public_in_loops
def sightings(
    values: npt.ArrayLike | None = None,
    step: npt.ArrayLike | None = None,
    given: Mapping[Variable, npt.ArrayLike | Constant] | None = None,
    *more: Never,
    **others: Never,
) -> Sightings:
    """Measurements of one sensor at any steps, any number of them at one step.

    Parameters
    ----------
    values : array_like
        (..., M, d); leading axes are runs; NaN is a component not taken, a row of NaN a measurement
        not taken. Left out where a model is to draw them (`DynamicBayesianNetwork.sample`).
    step : array_like of int
        (M,), in 0..T, in any order, repeats allowed, shared by all runs. Left out online, where
        measurements belong to the current step.
    given : mapping of Variable to array_like, optional
        The sensor's observed parents that differ from measurement to measurement, (..., M, d) each.

    Examples
    --------
    >>> m = Variable("m", components=("east", "north"))
    >>> seen = sightings([[2.0, 0.1], [3.0, -0.2]], step=[4, 4], given={m: [[0, 1], [5, 1]]})
    """
    if more or others:
        raise unfit(sightings, (values, step, given), more, others)
    if type(given) is not dict:  # which is looked for first, as it is quicker
        if not (given is None or isinstance(given, Mapping)):
            raise EvidenceError(
                f"sightings: given maps parents to their values, given={{m: landmarks}}; found "
                f"{type(given).__name__}"
            )
        given = dict(given or {})
    # In two thirds of the time of `Sightings(...)`.
    found: Sightings = _Unlocked()
    found.values, found.step, found._given = values, step, given.copy()
    found.__class__ = Sightings
    return found


# The ways of answering for what is not known.
LIKELIHOOD, SUM, JOINT = "likelihood", "sum", "joint"


class OneOf(InCode, Immutable):
    """One of some candidates for an unknown parent, or none; made by `unknown`.

    `count` is k, the number of candidates, and `dimension` that of their components; `log_shares`
    (k + 2,) are the logarithms of the prior probabilities of each, of a spurious sighting, and of a
    new thing.
    """

    count: int
    dimension: int
    log_shares: Array
    volume: float | None
    gate: float | None
    association: str | None

    def __init__(
        self,
        count: int,
        weights: Any,
        spurious: float,
        new: float,
        volume: float | None,
        gate: float | None,
        association: str | None,
    ) -> None:
        shares = np.ones(count)
        if weights is not None:
            shares = np.array(as_floats(weights, "unknown: weights", EvidenceError))
            fine = shares.shape == (count,) and np.isfinite(shares).all()
            if not fine or (shares < 0.0).any() or not shares.any():
                raise EvidenceError(
                    f"unknown: weights are {count} numbers, one for each candidate, not "
                    f"negative and not all zero; found {weights!r}"
                )
        for name, share in (("spurious", spurious), ("new", new)):
            if not is_number(share) or not 0.0 <= share < 1.0:
                raise EvidenceError(f"unknown: {name} is a probability below 1, not {share!r}")
        if spurious + new >= 1.0:
            raise EvidenceError(
                f"unknown: spurious and new are probabilities whose sum is below 1, not "
                f"{spurious!r} and {new!r}"
            )
        if volume is not None and (not is_number(volume) or not 0.0 < volume < np.inf):
            raise EvidenceError(f"unknown: volume is a positive number, not {volume!r}")
        if (volume is None) == bool(spurious + new > 0.0):
            raise EvidenceError(
                "unknown: spurious and new sightings are uniform over a volume= of measurements "
                "(the product of their components' ranges), which is given with them, and with "
                f"nothing else; found spurious={spurious!r}, new={new!r}, volume={volume!r}"
            )
        if gate is not None and (not is_number(gate) or not 0.0 < gate < 1.0):
            raise EvidenceError(f"unknown: gate is a probability between 0 and 1, not {gate!r}")
        if association not in (None, LIKELIHOOD, SUM, JOINT):
            raise EvidenceError(
                f'unknown: association is "{LIKELIHOOD}", "{JOINT}" or "{SUM}", not {association!r}'
            )
        if association == JOINT and gate is None:
            raise EvidenceError(
                'unknown: association="joint" takes as many pairs as lie within a gate together: '
                "give gate=0.99 or so"
            )
        shares = shares / shares.max()  # whose sum is of ordinary size
        with np.errstate(divide="ignore"):
            known = np.log(shares / shares.sum()) + np.log1p(-(spurious + new))
            others = np.log([spurious, new])
        self._set(
            count=count,
            log_shares=np.concatenate([known, others]),
            volume=None if volume is None else float(volume),
            gate=None if gate is None else float(gate),
            association=association,
        )

    @property
    def is_summed(self) -> bool:
        """Whether candidates are summed over, as they are unless something else is said."""
        return self.association in (None, SUM)

    @property
    def log_outliers(self) -> Array:
        """The log-densities of spurious and of new sightings, each with its probability, (2,)."""
        volume = 1.0 if self.volume is None else self.volume
        found: Array = self.log_shares[-2:] - np.log(volume)
        return found

    def __repr__(self) -> str:
        how = "" if self.association is None else f", by {self.association}"
        return f"unknown(one of {self.count:,}{how})"


class Unknown(OneOf):
    """Candidates that are values of the parent, (k, d)."""

    candidates: Array

    def __init__(self, candidates: Any, *shares: Any) -> None:
        values = np.array(as_floats(candidates, "unknown: candidates", EvidenceError))
        if values.ndim != 2 or not len(values) or not np.isfinite(values).all():
            raise EvidenceError(
                "unknown: candidates are one or more rows of finite numbers, (k, d); found "
                + (
                    "some that are not finite"
                    if values.ndim == 2 and len(values)
                    else f"shape {values.shape}"
                )
            )
        super().__init__(len(values), *shares)
        values.flags.writeable = False
        self._set(candidates=values, dimension=values.shape[1])


class UnknownVariable(OneOf):
    """Candidates that are hidden variables, of which the parent is one: landmarks of a map."""

    candidates: Scope

    def __init__(self, candidates: Scope, *shares: Any) -> None:
        for variable in candidates:
            first = candidates[0]
            if isinstance(variable, Discrete):
                raise EvidenceError(
                    f"unknown: {variable!r} is discrete; candidates are continuous variables",
                    variable=variable,
                )
            if not is_alike(variable, first):
                raise EvidenceError(
                    f"unknown: candidates are variables of one kind; {first!r} has "
                    f"{described(first)}, {variable!r} has {described(variable)}",
                    variable=variable,
                )
        super().__init__(len(candidates), *shares)
        self._set(candidates=candidates, dimension=candidates[0].dimension)


@public
def unknown(
    candidates: Any,
    *,
    weights: Any = None,
    spurious: float = 0.0,
    new: float = 0.0,
    volume: float | None = None,
    gate: float | None = None,
    association: str | None = None,
) -> OneOf:
    r"""A sighting's parent that is not known: one of some candidates, or none.

    ``pgm.sightings(values, step=..., given={m: pgm.unknown(landmarks)})``. The density of each
    sighting z is, of a robot at x,

    .. math:: \sum_k w_k (1 - s - n) \, p(z \mid x, m_k) + \frac{s + n}{V}

    with ``association="sum"``, the default, where what was seen is summed out; with
    ``"likelihood"`` it is the largest of these terms. Beliefs of Gaussians that sum are mixtures of
    `Gaussians`, of one unless ``belief=`` asks for more: each candidate is a hypothesis, tried
    sighting by sighting. ``posterior.associations`` tells how probable each is.

    ``"likelihood"`` gives each sighting its likeliest candidate, by ln w_k + ln N(z; ẑ_k, S_k) at
    the predicted belief of the step, given also what of its measurements leaves nothing open; S_k
    is the innovation's covariance. The network is then inferred as if that had been known; sensors
    are taken in one after the other, in the order of the network, and two sightings of a step may
    have the same candidate. It is faster, and too sure of itself where candidates are close.

    An `OnlineFilter` does not know of open sightings beforehand: give it
    ``belief=pgm.Gaussians(1)`` to sum, or an `association` to decide.

    With ``"joint"``, and mixtures of `Gaussians`, the sum is over assignments of a sensor's
    sightings at a step that give no candidate twice, and the log-evidence is that of the readings
    and of this. Of ordinary beliefs of Gaussians the sightings of a sensor at a step are associated
    together, no candidate being given twice: as many as can be whose innovations, stacked, lie
    within the gate together, and of several such sets the likeliest, by Σ ln w_k + ln N(ν; 0, S):
    those of a robot whose heading is off are all turned alike. The others are spurious or new;
    ``probability`` is then of the decision, 1 of what was taken.

    Parameters
    ----------
    candidates : array_like, or sequence of Variable
        (k, d): the values that the parent may have. Or hidden variables, as targets and landmarks
        are, one of which stands where the parent does: of a dynamic network, whose beliefs are then
        mixtures of `Gaussians`, or of a `GrowingMap`; see `GrowingMap.add`.
    weights : array_like, optional
        w_k, (k,), relative to each other; equal, if not given.
    spurious, new : float
        s and n, the prior probabilities of sightings of nothing, and of what is no candidate.
    volume : float
        V, over which such sightings are uniform: the product of the ranges of the measurement's
        components, in its units; 188 m rad of ranges up to 30 m all round. Due with `spurious` or
        `new`.
    gate : float, optional
        A probability, such as 0.999, within whose χ² quantile, with as many degrees of freedom as
        components were measured, the squared Mahalanobis distance of a candidate's innovation has
        to lie; of grids and particles that of the residual, at each point. A sighting without a
        candidate is spurious or new, whichever was likelier; where neither is declared Gaussian
        beliefs leave it out of the density, and to point masses it is impossible.
    association : str, optional
        ``"sum"``, ``"likelihood"`` or ``"joint"``. Without it filters, smoothers, grids and
        particles sum; a `GrowingMap`, which does not, takes the likeliest.

    References
    ----------
    Thrun, Burgard & Fox, Probabilistic Robotics, 2005, sections 7.5 and 7.6; Bar-Shalom & Fortmann,
    Tracking and Data Association, 1988; Neira & Tardós, Data association in stochastic mapping
    using the joint compatibility test, 2001.

    Examples
    --------
    >>> unknown([[0.0, 1.0], [5.0, 1.0]], spurious=0.1, volume=60.0, gate=0.999)
    unknown(one of 2)
    """
    shares = weights, spurious, new, volume, gate, association
    if isinstance(candidates, Variable):
        raise EvidenceError(
            f"unknown: candidates are several variables, [{candidates!r}, ...]; found one alone, "
            f"{candidates!r}: give it as the parent, or in a list",
            variable=candidates,
        )
    if isinstance(candidates, np.ndarray) and candidates.dtype != object:
        return Unknown(candidates, *shares)
    several = as_tuple(candidates)
    if several is None or not any(isinstance(each, Variable) for each in several):
        return Unknown(candidates if several is None else several, *shares)
    odd = [each for each in several if not isinstance(each, Variable)]
    if odd:
        raise EvidenceError(
            "unknown: candidates are variables, or values of the parent (k, d), and not both; "
            f"found {odd[0]!r} beside variables"
        )
    what = "unknown: the list of candidates"
    require_order(candidates, what)
    return UnknownVariable(as_scope(several, what), *shares)


def opened(
    cpd: CPD, given: Mapping[Variable, Any], allowed: bool, hidden: Container[Variable] = ()
) -> tuple[Mapping[Variable, Any], tuple[Variable, OneOf] | None]:
    """The given parents of sightings, and the parent with candidates.

    `hidden` are the variables that may be candidates themselves.
    """
    for variable, each in given.items():
        if isinstance(each, UnknownVariable):
            strange = next((v for v in each.candidates if v not in hidden), None)
            if strange is not None:
                raise variables_left_open(variable, each, f"sightings of {cpd.child!r}", cpd=cpd)
    found = [(v, value) for v, value in given.items() if isinstance(value, OneOf)]
    if not found:
        return given, None
    variable, value = found[0]
    what, why = f"sightings of {cpd.child!r} leave {variable!r} open", ""
    if not allowed:
        why = "filters, smoothers and online filters of dynamic networks alone do that"
    elif len(found) > 1:
        why = f"and {found[1][0]!r} too; candidates are for one parent"
    elif isinstance(variable, Discrete) or isinstance(cpd.child, Discrete):
        why = "which is for variables that are not discrete"
    elif value.dimension != variable.dimension:
        why = f"with candidates of {value.dimension} components; it has {variable.dimension}"
    elif isinstance(value, UnknownVariable) and not is_alike(variable, value.candidates[0]):
        first = value.candidates[0]
        why = f"which has {described(variable)}; its candidate {first!r} has {described(first)}"
    if why:
        raise EvidenceError(f"{what}: {why}", variable=variable, cpd=cpd)
    return {v: each for v, each in given.items() if v != variable}, found[0]


def variables_left_open(
    variable: Variable, value: UnknownVariable, where: str, **about: Any
) -> EvidenceError:
    """The error of candidates that are variables, where these are not hidden, or not taken."""
    return EvidenceError(
        f"{where}: {variable!r} is left open among variables ({listed(value.candidates)}), which "
        "are candidates in a pgm.GrowingMap, and, where they are hidden in a dynamic network, for "
        "Gaussian beliefs of pgm.filter, pgm.smooth and pgm.infer; elsewhere give the values that "
        f"the parent may have, pgm.unknown(values) of shape (k, {variable.dimension})",
        variable=variable,
        **about,
    )


def require_whole(cpd: CPD, unknown: tuple[Variable, OneOf] | None, taken: Mask) -> None:
    """Refuse open sightings that are measured in part, where some may be of no candidate."""
    if unknown is None or unknown[1].volume is None:
        return
    if (taken.any(axis=-1) != taken.all(axis=-1)).any():
        raise EvidenceError(
            f"sightings of {cpd.child!r} leave {unknown[0]!r} open and have components that are "
            "NaN, whose share of the volume= of spurious and new sightings is not known: give "
            "all components or none, or neither spurious= nor new=",
            variable=cpd.child,
            cpd=cpd,
        )
