"""The thing that an open sighting of a growing map was taken for."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pgm.display import Listing, Shown, Summary, few, number
from pgm.factors.scope import Scope, listed, namesake
from pgm.immutable import Immutable
from pgm.kernels.arrays import Array
from pgm.posteriors.associations import NEW, SPURIOUS, as_candidate
from pgm.posteriors.by_sensor import EachSensor
from pgm.variables import Variable

_NAMES = {SPURIOUS: "spurious", NEW: "new"}


class Association(Shown, Immutable):
    """The variable of a growing map that one sighting was taken for, or none.

    Attributes
    ----------
    candidates : tuple of Variable
        The k candidates, as `pgm.unknown` lists them.
    probability : ndarray
        (k + 2,): the probability of each candidate, of a spurious sighting and of a new thing,
        given the map with all that the addition leaves no doubt of; with ``"joint"`` of the
        decision, 1 of what was taken. NaN where nothing was measured.
    candidate : int
        The index of the likeliest candidate, 0 to k − 1; −1 spurious, −2 new. −1 too where nothing
        was measured, and where all candidates were beyond the gate and nothing was declared
        spurious or new.
    variable : Variable or None
        The candidate that the sighting was taken for; None if for none: its CPD was not added then,
        and may be, given a landmark of its own.

    Examples
    --------
    >>> x, m, near, far = pgm.variables("x m near far")
    >>> z, w = pgm.variables("z w")
    >>> grown = pgm.GrowingMap().add(
    ...     [pgm.GaussianCPD(v, at, 1.0) for v, at in ((x, 0.0), (near, 2.0), (far, 20.0))]
    ... )
    >>> sees = [pgm.LinearGaussianCPD(v, given={m: 1.0, x: -1.0}, cov=1.0) for v in (z, w)]
    >>> either = pgm.unknown([near, far], gate=0.999, spurious=0.1, volume=50.0)
    >>> grown = grown.add(sees, {z: 3.0, w: 11.0, m: either})
    >>> grown.associations[z].variable, grown.associations[z].probability.round(2)
    (near, array([0.98, 0.  , 0.02, 0.  ]))
    >>> grown.associations[w].candidate
    -1
    """

    candidates: Scope
    probability: Array
    candidate: int

    def __init__(self, candidates: Scope, probability: Array) -> None:
        own = np.array(probability)
        own.flags.writeable = False
        self._set(candidates=candidates, probability=own, candidate=int(as_candidate(own)))

    @property
    def variable(self) -> Variable | None:
        """The candidate that the sighting was taken for, if for one."""
        return self.candidates[self.candidate] if self.candidate >= 0 else None

    @property
    def measured(self) -> bool:
        """Whether any component of the sighting was measured."""
        return not np.isnan(self.probability).any()

    @property
    def _title(self) -> str:
        taken = _NAMES.get(self.candidate, repr(self.variable)) if self.measured else "not measured"
        return f"Association({taken}, of {len(self.candidates):,} candidates)"

    def _summary(self) -> Summary:
        if not self.measured:
            return Summary(self._title)
        names = [*map(repr, self.candidates), _NAMES[SPURIOUS], _NAMES[NEW]]
        order = np.argsort(-self.probability, kind="stable").tolist()
        order = [k for k in order if self.probability[k] > 0.0]
        rows: list[Sequence[str] | None] = [
            None if k is None else [names[order[k]], number(float(self.probability[order[k]]), 3)]
            for k in few(len(order))
        ]
        return Summary(self._title, [Listing(("candidate", "probability"), rows, names=1)])


class BySighting(EachSensor[Association]):
    """The associations of the sightings of an addition that left a parent open."""

    def _absent(self, variable: Variable) -> str:
        return (
            f"the last addition has no open sighting {variable!r}; it has ({listed(self)})"
            f"{namesake(variable, self)}"
        )
