"""Filtering in a robot's loop, one step at a time, with beliefs of any family."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from pgm.arguments import public
from pgm.beliefs.own.family import BeliefFamily
from pgm.compile.machine import Choice
from pgm.display import InCode, titled
from pgm.errors import ModelError
from pgm.immutable import Immutable
from pgm.inference.families import family_of
from pgm.linearisers import TAYLOR, Lineariser
from pgm.networks import DynamicBayesianNetwork
from pgm.posteriors.online_belief import OnlineBelief
from pgm.schedules import step_evidence
from pgm.schedules.gates import Gate
from pgm.schedules.late import replayed, require_step
from pgm.schedules.options import asked_online, require
from pgm.schedules.schedule import Filtering, FixedLag
from pgm.variables import Variable


def _general(belief: object, values: object) -> None:
    """The machine code of a family that has none."""


_GENERAL = (_general, _general)


@public
class OnlineFilter(InCode, Immutable):
    """A Kalman filter for a robot's loop, one step at a time; immutable, and so are its beliefs.

    It predicts and updates as `filter` does: of a linear model it is the Kalman filter, with
    `Taylor` the extended, with `Unscented` the unscented Kalman filter; with a lag a fixed-lag
    Rauch–Tung–Striebel smoother besides. Beliefs belong to the filter's own model: pickle the two
    together.

    Parameters
    ----------
    model : DynamicBayesianNetwork
        The prior of the states, their motion and the sensors, as CPDs. Of a model of tables
        ``belief[x]`` are tables.
    lineariser : Lineariser, optional
        The rule for nonlinear CPDs that have none of their own; by default `Taylor`.
    schedule : Filtering or FixedLag, optional
        How often a step's measurements are linearised; once if not given. With a `FixedLag`,
        ``belief.lagged`` is the belief a lag before, given everything so far; with two or more
        iterations each update linearises the last steps again, until they settle.
    lag : int, optional
        In place of a schedule, as ``schedule=FixedLag(lag)``. Readings may then come late by so
        many steps: see `update`.
    gate : float or mapping of Variable to float, optional
        The probability within which measurements are taken in, by the χ² quantile of their νᵀS⁻¹ν,
        if no schedule is given, which has its own; ``belief.rejected[z]`` has the decisions.
    watch : bool
        Whether ``belief.lost`` is to tell if a belief is probably wrong, as `Lost` does.
    belief : Grid, Particles, or another BeliefFamily, optional
        What beliefs are in place of Gaussians or tables. What it has no use for of the other
        arguments it refuses.
    compiled : bool or Compiled, optional
        Whether steps are made in machine code, by LLVM; see the notes. If not given, those of
        linear models are, once there are so many that it pays.

    Raises
    ------
    ModelError
        If an argument is of a wrong kind, or two of them exclude each other.
    ImportError
        If steps are to be compiled where llvmlite is missing.

    Notes
    -----
    With ``compiled=True`` the model's functions are recorded as they are when the filter is made;
    see `renewed` for later changes. Some steps are made without machine code, with equal results:
    those of many runs, of a lag with iterations, of Levenberg–Marquardt, in twice the digits, with
    noise that depends on inputs or is graduated, with numbers that change from step to step, or
    with functions that make floats of their input. Machine code runs in one thread. If `compiled`
    is not given, steps of linear models are made in it after the first 1,000 of a kind for each
    four components of a slice, which take as long as its making; those of others are not, since a
    function that is recorded may change unseen.

    Examples
    --------
    >>> from pgm.examples import walk, x, z
    >>> robot = pgm.OnlineFilter(walk)
    >>> belief = robot.predict(robot.initial())
    >>> belief = robot.update(belief, {z: [4.0]})
    >>> belief[x].mean, belief[x].cov
    (array([2.]), array([[1.]]))
    >>> pgm.OnlineFilter(walk, schedule=pgm.FixedLag(5, 3), compiled=True).compilation
    'not compiled: the last steps are linearised again at each update'
    """

    model: DynamicBayesianNetwork
    belief: BeliefFamily[Any] | None
    # Of the family: its `initial`, `predict` and `update`.
    _steps: Any
    _predict: Any
    _update: Any
    # Machine code of updates and of predictions, which is asked first: each function of Python's in
    # between would take a third of its time. With None for an answer it leaves the step.
    _quick: Sequence[Callable[[Any, Any], Any]]

    def __init__(
        self,
        model: DynamicBayesianNetwork,
        lineariser: Lineariser = TAYLOR,
        schedule: Filtering | FixedLag | None = None,
        lag: int | None = None,
        *,
        gate: Gate = None,
        watch: bool = False,
        belief: BeliefFamily[Any] | None = None,
        compiled: Choice = None,
    ) -> None:
        if belief is None and not isinstance(model, DynamicBayesianNetwork):
            raise ModelError(f"a dynamic network was due, not {titled(model)}")
        family = family_of(model, belief)
        options: dict[str, Any] = {"lineariser": lineariser, "schedule": schedule, "lag": lag}
        options |= {"gate": gate, "watch": watch, "compiled": compiled}
        require(asked_online(options), model, family)
        steps = family.online(model, {n: v for n, v in options.items() if n in family.takes})
        # The options by which the steps are made, as attributes: a class with a __getattr__ looks
        # up all of its attributes slowly, and a step takes microseconds.
        self._set(model=model, belief=belief, _steps=steps, **steps.options)
        quick = getattr(steps, "quick", _GENERAL)
        self._set(_quick=quick, _predict=steps.predict, _update=steps.update)

    def __reduce__(self) -> tuple[Any, ...]:
        # What was prepared is not part of the value. All that is stands in the arguments, which are
        # copied with the filter: a belief beside it is of the same copies.
        return _made, (type(self), self.model, self.belief, dict(self._steps.options))

    def __repr__(self) -> str:
        return repr(self._steps)

    @property
    def compilation(self) -> str:
        """Whether steps are made in machine code, or why not, in words.

        For a compiled filter it tells how many of the steps so far NumPy made, and why.
        """
        return str(getattr(self._steps, "compilation", "by NumPy"))

    def renewed(self) -> OnlineFilter:
        """The same filter, made anew, so that changes to the model's functions take effect.

        Functions are read again together with all that they refer to. A belief of this filter can
        be given to the new one.

        Examples
        --------
        >>> from pgm.examples import walk
        >>> robot = pgm.OnlineFilter(walk)
        >>> belief = robot.initial()
        >>> robot = robot.renewed()
        >>> robot.predict(belief).step
        1
        """
        make, arguments = self.__reduce__()
        found: OnlineFilter = make(*arguments)
        return found

    def initial(self) -> OnlineBelief:
        """The prior belief, at step 0, with the model's leading axes of runs."""
        return self._steps.initial()  # type: ignore[no-any-return]

    def predict(
        self, belief: OnlineBelief, inputs: Mapping[Variable, Any] | None = None
    ) -> OnlineBelief:
        """The belief one step later.

        Parameters
        ----------
        belief : OnlineBelief
            Of this filter.
        inputs : mapping of Variable to array_like
            Values (..., d) of the transition's inputs, of discrete ones names or indices; may be
            left out if it has none.

        Returns
        -------
        OnlineBelief

        Raises
        ------
        EvidenceError
            If an input is missing or of a wrong shape, or a variable given is no input.
        ModelError
            If the belief is not this filter's, a function returns a wrong shape, or a CPD has
            numbers of its own at each step, and none of this one.
        LinearisationError, NumericalError
            If a linearisation, or the belief, has no finite value.
        """
        found = self._quick[1](belief, inputs)
        if found is None:
            return self._predict(belief, inputs)  # type: ignore[no-any-return]
        return found  # type: ignore[no-any-return]

    def update(
        self,
        belief: OnlineBelief,
        readings: Mapping[Variable, Any],
        *,
        step: int | None = None,
    ) -> OnlineBelief:
        """The belief given measurements of its step; a further update goes on from the first.

        Measurements that come late are taken at their own step, as its last update, and the steps
        since then are made again: the result is that of a filter that had them in time.

        Parameters
        ----------
        belief : OnlineBelief
            Of this filter.
        readings : mapping of Variable
            For a sensor any number of measurements, ``pgm.sightings(values, given=...)`` without
            steps, or one measurement (..., d); for inputs that the sensors need, values (..., d).
        step : int, optional
            The step of the measurements, if they come late: at most so many steps before the
            belief's as the filter's lag. The belief's own if left out.

        Returns
        -------
        OnlineBelief
            At the step of `belief`, late measurements or not.

        Raises
        ------
        EvidenceError
            If a measurement does not fit its sensor, or comes too late.
        ModelError, LinearisationError
            See `predict`.
        NumericalError
            If a measurement contradicts an exact model, or the belief has no finite value.

        Warns
        -----
        ConvergenceWarning
            If two or more iterations were asked for and end before they settle.

        Examples
        --------
        >>> from pgm.examples import walk, x, z
        >>> robot = pgm.OnlineFilter(walk, lag=20)
        >>> belief = robot.predict(robot.predict(robot.initial()))
        >>> belief = robot.update(belief, {z: [4.0]}, step=belief.step - 1)
        >>> belief.step, belief[x].mean, belief[x].cov
        (2, array([2.]), array([[2.]]))
        """
        if step is not None:
            return self._late(belief, readings, step)
        found = self._quick[0](belief, readings)
        if found is None:
            return self._update(belief, readings)  # type: ignore[no-any-return]
        return found  # type: ignore[no-any-return]

    def _late(
        self, belief: OnlineBelief, readings: Mapping[Variable, Any], step: int
    ) -> OnlineBelief:
        """The belief given measurements of a step before its own, or of its own."""
        own: Any = belief
        log = getattr(self._steps, "log", _no_log)(own)
        late = require_step(own, step, log)
        if not late:
            return self.update(belief, readings)
        given = step_evidence.mapping(readings, "update", "sensors to measurements")
        assert log is not None
        return replayed(self.predict, self.update, log, given, late)  # type: ignore[no-any-return]


def _no_log(belief: object) -> None:
    """The steps behind a belief of a filter that keeps none."""


def _made(
    kind: type[OnlineFilter],
    model: DynamicBayesianNetwork,
    belief: BeliefFamily[Any] | None,
    options: Mapping[str, Any],
) -> OnlineFilter:
    """A filter of a class, a subclass of a user's own too, by its options."""
    return kind(model, belief=belief, **options)
