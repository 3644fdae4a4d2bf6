"""Page's tests whether a belief is lost (`cusum`), in a sweep and from step to step online.

A sweep over all steps tells of each run whether the belief was ever lost. Online, the state of the
tests before a step stands behind the belief's numbers; then, of the measurements of the step so
far, their NIS, its degrees of freedom, how many sightings gates have rejected and judged, and the
log-likelihood ratio of sightings of unknown identity; and the number of the step.
"""

from __future__ import annotations

from pgm.kernels import cusum
from pgm.kernels.machine.emitter.memory import Memory
from pgm.kernels.machine.emitter.numbers import Number
from pgm.kernels.machine.sweeps.reading import Counts, Taken
from pgm.kernels.machine.sweeps.writer import Writer

LEVEL, ONSET, LOST, FIRST, DECLARED, WHY = 0, 2, 4, 5, 6, 7
NIS, DOF, REJECTED, JUDGED, ODDS, STEP, SIZE = range(8, 15)


class Tests:
    """Both tests in a sweep over all steps, which tells whether the belief of a run is ever lost.

    Rejections are counted if some sensor of the sweep has a gate.
    """

    def __init__(self, w: Writer, *, gated: bool) -> None:
        self._levels = [w.code.varying(0.0) for _ in range(1 + gated)]
        self._lost = w.code.varying(False)

    @property
    def lost(self) -> Number:
        """Whether a sum has reached h."""
        return self._lost.get()

    def take(self, counts: Counts) -> None:
        """Add the measurements of a step."""
        nis, dof, rejected, judged = counts
        ratios = cusum.expected(nis, dof), cusum.rejections(rejected, judged, 0.0)
        for level, ratio in zip(self._levels, ratios, strict=False):
            level.set(cusum.summed(level.get(), ratio))
            self._lost.set(self.lost | (level.get() >= cusum.HIGH))


def on(known: Memory, later: Memory) -> None:
    """Write the tests at the next step, before its measurements.

    A step without any adds nothing to the sums.
    """
    ratios = (
        cusum.expected(known.load(NIS), known.load(DOF)),
        cusum.rejections(*map(known.load, (REJECTED, JUDGED, ODDS))),
    )
    step = known.load(STEP)
    level, onset = zip(
        *(
            cusum.raised(known.load(LEVEL + k), known.load(ONSET + k), step, ratio)
            for k, ratio in enumerate(ratios)
        ),
        strict=True,
    )
    last = map(known.load, (FIRST, DECLARED, WHY))
    found = cusum.ruled(cusum.Sums(level, onset, known.load(LOST) != 0.0, *last), step)
    numbers = *found.level, *found.onset, found.lost.number(), *found[3:]
    for place, number in enumerate((*numbers, *[0.0] * (STEP - NIS), step + 1.0)):
        later.store(place, number)


def read(known: Memory, later: Memory, found: Taken) -> None:
    """Write the tests after an update of their step."""
    numbers = list(map(known.load, range(SIZE)))
    for k, more in zip((NIS, DOF, REJECTED, JUDGED), found.counts, strict=True):
        numbers[k] = numbers[k] + more
    for place, number in enumerate(numbers):
        later.store(place, number)
