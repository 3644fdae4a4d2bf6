"""The laws of CPDs by their kind; the law of a mixture is made from the laws of its parts.

A law is a CPD with the values of its observed parents, which have a row for each step of the
transition, or for each measurement of a sensor. The m particles at which it is evaluated are given
as `some`: their states at a step and at the step before, and their runs. `Drawing` holds the
generators of these particles' random numbers.

The CPDs that a mixture mixes are its *parts*. *Components* are always those of the CPD's child, d
in number. A component has *noise of its own* unless it is a function of the parents and of the
child's other components, as under a singular noise covariance.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from pgm.beliefs.points.laws import Drawing, GaussianLaw, Law, Some, States
from pgm.cpds import CPD, ConditionalGaussian, MixtureCPD
from pgm.cpds.mixture import chosen, log_mixed
from pgm.errors import ModelError
from pgm.kernels.arrays import Array, Integers, Mask
from pgm.schedules.argument_checks import require_density
from pgm.variables import Variable


@dataclass(frozen=True, eq=False)
class MixtureLaw(Law):
    """The law of a mixture CPD; `parts` are the laws of the CPDs that it mixes, in their order."""

    cpd: MixtureCPD
    parts: tuple[Law, ...]

    def draw(self, row: int, some: Some, drawing: Drawing) -> States:
        """Draws of the child at particles, (d, m), each from a part drawn by the parts' weights."""
        which = np.empty(some.size, dtype=np.intp)
        for place, rng in drawing.pieces:
            which[place] = chosen(self.cpd.weights, (place.stop - place.start,), rng)
        found = np.empty((self.cpd.child.dimension, some.size), dtype=self.dtype)
        for k, part in enumerate(self.parts):
            own = which == k
            if own.any():
                found[:, own] = part.draw(row, some.chosen(own), drawing.chosen(own))
        return found

    def log_density(self, row: int, some: Some, child: States, taken: Mask | None = None) -> Array:
        """The log-densities (m,) of a child (d, m), or (d, 1) for all: ln Σ_k w_k p_k.

        w_k is the mixture's weight of part k, p_k the density by its law. Parts of which the
        child's components with noise of their own differ in number are refused by a ModelError.

        taken: The mask (d,) of the components that were measured; None if all were.
        """
        self.open(row, some.step)
        terms = (part.log_density(row, some, child, taken) for part in self.parts)
        return log_mixed(self.cpd.weights, terms)

    def open(self, row: int, step: int) -> Integers:
        """The number of the child's components with noise of their own, at a row, (runs or 1,).

        Parts with different numbers of such components have no density in common, and are refused
        by a ModelError. `step` is that of the row, for texts of errors.
        """
        first, *others = (part.open(row, step) for part in self.parts)
        if any((other != first).any() for other in others):
            raise ModelError(
                f"{self.cpd!r} has parts without noise in a component and others with, at step "
                f"{step}: they have no density in common, which particles are weighed by here; "
                "give each some noise, or none",
                variable=self.cpd.child,
                cpd=self.cpd,
                step=step,
            )
        return first

    def require_noise(self, steps: Integers) -> None:
        """Refuse, by a ModelError, a sensor with a part that has singular noise at one of its rows.

        `steps` are those of all its rows, (rows,), for the text of the error.
        """
        for part in self.parts:
            part.require_noise(steps)


def law(
    cpd: CPD,
    inputs: Mapping[Variable, Any],
    places: Mapping[Variable, slice],
    dtype: Any,
    first_run: int,
    weighed: bool = True,
) -> Law:
    """The law of a CPD with its inputs, of the class that its kind asks for.

    It is a `GaussianLaw` of Gaussian noise, a `MixtureLaw` of a mixture, and otherwise, robust
    noise included, a plain `Law`. Robust noise whose density has an infinite integral is refused by
    a ModelError, where particles are `weighed` by densities.

    inputs: By observed parent, its values (rows, runs or 1, d).
    places: By hidden variable, where its components stand on the first axis of arrays of states,
        (components, m).
    dtype: The type of the states, float64 or float32.
    first_run: The user's number of the first run here, from which texts of errors count.
    """
    rows = {v: np.asarray(a, dtype=dtype) for v, a in inputs.items()}
    about = rows, places, dtype, first_run
    if weighed and isinstance(cpd, ConditionalGaussian):
        require_density([cpd], "particles")
    if isinstance(cpd, ConditionalGaussian) and cpd.noise is None:
        return GaussianLaw(cpd, *about)
    if isinstance(cpd, MixtureCPD):
        return MixtureLaw(cpd, *about, tuple(law(part, *about, weighed) for part in cpd.parts))
    return Law(cpd, *about)
