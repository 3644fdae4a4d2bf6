"""The number of steps, T, that evidence tells, and what to do where it tells another, or none."""

from __future__ import annotations

import math
import warnings
from collections.abc import Collection, Mapping
from dataclasses import dataclass

import numpy as np

from pgm.boundary import as_wholes, is_whole
from pgm.cpds import CPD, by_step
from pgm.errors import EvidenceError, EvidenceWarning, levels_to_user
from pgm.evidence.rows import Rows, due
from pgm.evidence.values import Evidence, Sightings
from pgm.kernels.arrays import Integers
from pgm.variables import Discrete, Variable


@dataclass(frozen=True, eq=False)
class Lengths:
    """The plain arrays of evidence, (..., T, d) each, among which T must be one number.

    arrays: By variable; of a discrete one the last axis is added.
    sensors: The variables that are measured; all others are inputs.
    evidence: As the user gave it.
    changing: A CPD whose numbers change from step to step, by which T is told; None if none do.
    """

    arrays: Mapping[Variable, Rows]
    sensors: Collection[Variable]
    evidence: Evidence
    changing: CPD | None = None

    def steps(self, asked: int | None, unexplained: tuple[Variable, CPD] | None) -> int:
        """The number of steps, T.

        asked: T, where the caller knows it; arrays of sensors may then be shorter.
        unexplained: An input of the transition without evidence, and its CPD.
        """
        if asked is not None and (not is_whole(asked) or asked < 0):
            raise EvidenceError(f"steps must be a whole number, 0 or more, not {asked!r}")
        lengths = {variable: array.shape[-2] for variable, array in self.arrays.items()}
        explicit = asked is not None
        if asked is not None:
            by_step.require_last(self.changing, int(asked), EvidenceError)
        elif self.changing is not None:
            asked = self.changing.steps
        if asked is not None:
            for variable, length in lengths.items():
                # The last steps of a sensor may be without readings; an input must be known.
                forecast = explicit and length < asked and self._measured(variable)
                if length != asked and (not forecast or self._runs(variable) == asked):
                    raise self._other_than_asked(variable, int(asked), explicit=explicit)
            return int(asked)
        if not lengths:
            raise self._untold(unexplained)
        if len(set(lengths.values())) > 1:
            raise self._disagreement(lengths)
        return int(next(iter(lengths.values())))

    def warn_of_columns(self, steps: int) -> None:
        """Warn where T is 1 and there are many runs: that is how a list of columns is read."""
        if steps != 1:
            return
        for variable in self.arrays:
            if count := self._runs(variable):
                message = (
                    f"evidence for {variable!r} is of {count} runs with one step each, by its "
                    f"shape {self._shape(variable)}; {self._reshaped(variable, count)}. Where "
                    "runs are meant, say so by steps=1"
                )
                warnings.warn(message, EvidenceWarning, stacklevel=levels_to_user())
                return

    def warn_of_step_behind(self, steps: int) -> None:
        """Warn where plain inputs go one step beyond the sightings of a sensor seen at each step.

        Inputs have T rows, and the last step with a sighting is k = T − 1, up to which some sensor
        has one at each step 1..k: inputs stamped 0..k, say, of which k lead to step k. There is no
        warning where sightings are at some steps only, as those of a slow sensor are, whose last
        one tells nothing of the number of steps.
        """
        if any(self._measured(variable) for variable in self.arrays):
            return
        try:
            sighted = self._sighted()
        except EvidenceError:  # raised again where the sensor is known
            return
        last = steps - 1
        if last < 1 or max((int(step.max()) for step in sighted if step.size), default=0) != last:
            return
        if not any(np.isin(np.arange(1, steps), step).all() for step in sighted if step.ndim == 1):
            return
        variable = next(iter(self.arrays))
        message = (
            f"{variable!r} has {_rows(steps)}, so steps 1..{steps}, and the last sighting is at "
            f"step {last}: beliefs of step {steps} are a forecast. If {last} steps are meant, "
            f"{self._advice(variable, last)}. If the forecast is meant, say so by steps={steps}"
        )
        warnings.warn(message, EvidenceWarning, stacklevel=levels_to_user())

    def _other_than_asked(self, variable: Variable, steps: int, *, explicit: bool) -> EvidenceError:
        length = self.arrays[variable].shape[-2]
        due = f"steps {_span(steps)} are asked for"
        if not explicit and self.changing is not None:
            due = f"{self.changing!r} has numbers of its own at each of the steps {_span(steps)}"
        return EvidenceError(
            f"evidence for {variable!r} has {_rows(length)}, of steps {_span(length)}, where "
            f"{due}; {self._advice(variable, steps)}",
            variable=variable,
            cpd=None if explicit else self.changing,
        )

    def _disagreement(self, lengths: Mapping[Variable, int]) -> EvidenceError:
        one, *rest = lengths
        other = next(variable for variable in rest if lengths[variable] != lengths[one])
        short, long = sorted((one, other), key=lengths.__getitem__)
        # Of a control and a sensor, one that is a row longer counts a step that the other does not.
        longer = lengths[long] == lengths[short] + 1 and self._measured(one) != self._measured(
            other
        )
        off, due_length = (long, lengths[short]) if longer else (short, lengths[long])
        return EvidenceError(
            f"plain arrays must agree about the number of steps: {one!r} has "
            f"{_rows(lengths[one])}, {other!r} has {_rows(lengths[other])}. For {due_length} "
            f"steps, {self._advice(off, due_length)}",
            variable=off,
        )

    def _untold(self, unexplained: tuple[Variable, CPD] | None) -> EvidenceError:
        if unexplained is not None:
            variable, cpd = unexplained
            return EvidenceError(
                f"no evidence for {variable!r}, a parent in {cpd!r} that no CPD explains, and no "
                f"plain array tells the number of steps; give {variable!r} its values, "
                f"{due(variable)}, which tell it, or a pgm.constant and steps=, the last step, T",
                variable=variable,
                cpd=cpd,
            )
        last = self._last_sighting()
        seen = "" if last is None else f": {last}, where the last sighting is, or a later one"
        return EvidenceError(
            "no plain array tells the number of steps; give steps=, the last step, T" + seen
        )

    def _last_sighting(self) -> int | None:
        return max((int(step.max()) for step in self._sighted() if step.size), default=None)

    def _sighted(self) -> list[Integers]:
        """The steps of the sightings of each sensor, in any order."""
        given = [v.step for v in self.evidence.values() if isinstance(v, Sightings)]
        return [as_wholes(step, "step", EvidenceError) for step in given if step is not None]

    def _advice(self, variable: Variable, steps: int) -> str:
        """Advice for an array without a row for each of the steps 1..T."""
        length = self.arrays[variable].shape[-2]
        if self._runs(variable) == steps and length == 1:
            return self._reshaped(variable, steps)
        row = "" if isinstance(variable, Discrete) else ", :"
        if self._measured(variable):
            stood = f"values, step=np.arange(1, {length + 1})"
            if length < steps:
                blank = "−1" if isinstance(variable, Discrete) else "NaN"
                return (
                    f"give it {_rows(steps - length)} more, of {blank}, where nothing was "
                    f"measured, or say when its own were: pgm.sightings({stood}); if they are the "
                    f"first, steps={steps} says so"
                )
            if length == steps + 1:
                return (
                    f"give pgm.sightings(values, step=np.arange({length})) if step 0 was measured, "
                    f"too, since a plain array of {variable!r} begins at step 1; else leave a row "
                    f"of it out, values[..., :{steps}{row}]"
                )
            return f"leave the others out, values[..., :{steps}{row}], or give steps={length}"
        if length == 1:
            return f"give pgm.constant(value) where {variable!r} is equal at all of them"
        if length == steps + 1:
            return (
                f"leave a row of {variable!r} out: row k of an input is of step k + 1, and drives "
                "step k to step k + 1. Where yours is stamped with the step that it leads from, "
                f"leave out the last, values[..., :-1{row}]; with that which it leads to, the "
                f"first, values[..., 1:{row}]"
            )
        if length < steps:
            return f"give {variable!r} {_rows(steps - length)} more: an input must be known"
        return f"leave the others out, values[..., :{steps}{row}], or give steps={length}"

    def _reshaped(self, variable: Variable, count: int) -> str:
        width = self.arrays[variable].shape[-1]
        due_shape = "-1" if self._is_of_states(variable) else f"(-1, {width})"
        return f"{count} steps of one run are np.reshape(values, {due_shape})"

    def _runs(self, variable: Variable) -> int:
        """The number of runs of an array with one step; 0 where it has several, or one run."""
        shape = self.arrays[variable].shape
        count = math.prod(shape[:-2])
        return count if shape[-2] == 1 and count > 1 else 0

    def _shape(self, variable: Variable) -> tuple[int, ...]:
        """The shape that the user gave: states have no axis of components."""
        shape = self.arrays[variable].shape
        return shape[:-1] if self._is_of_states(variable) else shape

    def _is_of_states(self, variable: Variable) -> bool:
        return isinstance(variable, Discrete) and self.arrays[variable].dtype.kind != "f"

    def _measured(self, variable: Variable) -> bool:
        return variable in self.sensors


def _rows(count: int) -> str:
    return f"{count} row{'s' * (count != 1)}"


def _span(steps: int) -> str:
    return "1..0 (none)" if not steps else f"1..{steps}" if steps > 1 else "1"
