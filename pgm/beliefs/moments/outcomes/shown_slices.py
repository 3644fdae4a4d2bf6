"""A Gaussian chain as a page shows it: beliefs, messages and potentials, in batched calls."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from pgm.beliefs.moments.passes.backward import Beliefs, Reverse, pairs
from pgm.beliefs.moments.passes.messages import first_potential
from pgm.errors import NumericalError
from pgm.kernels.arrays import Array, block, cut, quiet
from pgm.kernels.canonical import Canonical
from pgm.kernels.moments import Conditional
from pgm.posteriors.belief_kind import FILTERED, SMOOTHED
from pgm.posteriors.shown_slices import Room, ShownSlices, Sighted, held

if TYPE_CHECKING:
    from pgm.beliefs.moments.outcomes.outcome import ChainOutcome

# Entries of matrices of all runs together, up to which messages back and potentials are made.
_MOST = 20_000_000


class ShownMoments(ShownSlices):
    """Moments of a chain's slices, and the canonical forms that a page cannot compute from them."""

    reading: ClassVar[str] = "gaussian"

    def __init__(self, outcome: ChainOutcome, span: range, room: Room) -> None:
        self.outcome, plan, layout = outcome, outcome._planned, outcome.graph.layout
        self.rows, self.first, self.hidden = np.array(held(span)), held(span)[0], layout.slice
        self.words = {"singular": "no canonical form: singular"}
        if outcome.kind != SMOOTHED:
            self.words["back"] = f"not sent: the posterior is {outcome.kind}; smoothing sends it"
        size = layout.state_size + layout.slice_size
        self.fits = plan.runs * (outcome.graph.steps + 1) * size * size <= _MOST
        if not self.fits:
            self.words["large"] = "left out: the batch is too large; keep fewer runs to see it"
        self.sensors = {
            s.family.cpd: Sighted(
                s.family.step,
                s.values if s.taken is None else np.where(s.taken, s.values, np.nan),
                s.family.inputs,
            )
            for s in plan.sensors
        }

    def exact(self, name: str) -> bool:
        """Whether other numbers are computed from an array: from potentials none are."""
        return not name.startswith(("own.", "first."))

    @quiet()
    def arrays(self, run: tuple[int, ...]) -> dict[str, Array]:
        """Beliefs, messages ``there`` and ``back``, those ``before`` a step, and potentials."""
        place = int(np.ravel_multi_index(run, self.outcome._planned.lead)) if run else 0
        found = self._moments(place)
        if self.fits:
            found |= self._pairs(place) | self._information(place)
        return found

    def _moments(self, place: int) -> dict[str, Array]:
        """Beliefs and forward messages of a run, a row a step.

        From the moments the page makes canonical forms, with the log-evidence that each knows.
        """
        outcome, rows = self.outcome, self.rows
        forward = outcome._forward if self.fits else outcome._swept
        beliefs, windows = outcome._beliefs, outcome._windows
        states, steps = outcome.graph.layout.state_places, outcome.graph.steps
        passed = np.cumsum(forward.log_density[:, place])
        known = passed if windows is None else windows.log_evidence[:, place]
        found = {
            "mean": beliefs.mean[rows, place],
            "cov": beliefs.cov[rows, place],
            "weight": known[[outcome.kind.last(int(step), steps) for step in rows]],
            "there.weight": passed[rows],
        }
        if outcome.kind != FILTERED:
            found["there.mean"] = forward.mean[rows, place][:, states]
            found["there.cov"] = block(forward.cov[rows, place], states, states)
        return found

    def _pairs(self, place: int) -> dict[str, Array]:
        """The states before each step in its cluster's belief: moments, covariances with the slice.

        Their moments are left out after smoothing, when they are those of the slice before. NaN at
        step 0, and where joints were not kept.
        """
        outcome, rows, layout = self.outcome, self.rows, self.outcome.graph.layout
        front, size = layout.state_size, layout.slice_size
        mean = np.full((len(rows), front + size), np.nan)
        cov = np.full((len(rows), front + size, front + size), np.nan)
        later = rows > 0
        windows = outcome._windows
        if outcome._careful is None and (windows is None or windows.plain):
            if later.any():
                run = slice(place, place + 1)
                beliefs = Beliefs(outcome._beliefs.mean[:, run], outcome._beliefs.cov[:, run])
                states = Conditional(*(cut(part, run) for part in outcome._reverse.states))
                own = slice(int(rows[later][0]) - 1, int(rows[-1]))
                both = pairs(beliefs, Reverse(states, None), own)
                mean[later], cov[later] = both.mean[:, 0], both.cov[:, 0]
        else:
            for row in np.flatnonzero(later).tolist():
                try:
                    joint = outcome.joint(*(v.at(int(rows[row])) for v in layout.pair))
                except NumericalError:
                    continue
                mean[row] = joint.mean.reshape(-1, front + size)[place]
                cov[row] = joint.cov.reshape(-1, front + size, front + size)[place]
        found: dict[str, Array] = {"cross": cov[:, :front, front:]}
        if outcome.kind != SMOOTHED:
            found |= {"before.mean": mean[:, :front], "before.cov": cov[:, :front, :front]}
        return found

    def _information(self, place: int) -> dict[str, Array]:
        """Potentials, and the messages back to the steps: K, h and g of a run, a row a step."""
        found, outcome, rows = dict[str, Array](), self.outcome, self.rows

        def add(name: str, form: Canonical, which: Any) -> None:
            for part, array in zip("Khg", form, strict=True):
                found[f"{name}.{part}"] = array[which, place]

        add("own", outcome._potentials, rows[rows > 0] - 1)
        if not rows[0]:
            K, h, g = (part[None] for part in first_potential(outcome._plan, outcome._forward))
            add("first", (K, h, g), slice(None))
        if outcome.kind == SMOOTHED:
            add("back", outcome._backward_messages, rows)
        return found
