"""The test whether an online belief is lost, as it stands between steps and within one.

A belief is *lost* if it is wrong by more than its covariance says. A *watch* is the state of the
test for that (`pgm.posteriors.lost`) before a step, with the test's numbers (`Read`) of the
measurements that the step has taken so far. A sighting is one of these measurements.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from pgm.beliefs.moments.steps.gate import Asked
from pgm.kernels.arrays import Array
from pgm.kernels.machine.sweeps import lost as machine
from pgm.posteriors.associations import Found
from pgm.posteriors.lost import PageTest, Read
from pgm.schedules.gates import gate_of


class Watch(NamedTuple):
    """The test whether a belief is lost: its state before a step, and the step's numbers so far.

    `before` is that state. `read` has the numbers of the step's updates so far, None before the
    first. `opened` has, apart, the numbers of sightings of unknown identity, since a window that is
    settled again replaces all of `read`.
    """

    before: PageTest
    read: Read | None = None
    opened: Read | None = None

    @classmethod
    def of(cls, numbers: Array) -> Watch:
        """The watch of one run from the numbers of compiled steps."""
        one, whole = numbers[:, None], numbers.astype(np.intp)[:, None]
        stretch = whole[machine.FIRST], whole[machine.DECLARED], whole[machine.WHY]
        level, onset = one[machine.LEVEL : machine.ONSET], whole[machine.ONSET : machine.LOST]
        before = PageTest(level, onset, one[machine.LOST] != 0.0, *stretch)
        read = opened = None
        if numbers[machine.NIS : machine.ODDS].any():
            dof, rejected, judged = whole[machine.DOF : machine.ODDS]
            read = Read(one[machine.NIS], dof, rejected, judged)
        if numbers[machine.ODDS]:
            nothing = np.zeros(1, dtype=np.intp)
            opened = Read(np.zeros(1), nothing, nothing, nothing, odds=one[machine.ODDS])
        return cls(before, read, opened)

    def numbers(self, step: int) -> Array:
        """The numbers from which compiled steps of one run go on, at the step of that number."""
        read, odds = np.zeros(machine.ODDS - machine.NIS), np.zeros(1)
        if self.read is not None:
            read = np.concatenate(self.read[: len(read)])
        if self.opened is not None:
            odds = np.ravel(self.opened.odds)
        before = [np.ravel(each) for each in self.before]
        return np.concatenate([*before, read, odds, [step]]).astype(np.float64)

    @classmethod
    def start(cls, lead: tuple[int, ...]) -> Watch:
        """The watch at the prior, before any measurement; `lead` is the shape of the runs' axes."""
        return cls(PageTest.start(math.prod(lead)))

    def test(self, step: int) -> PageTest:
        """The state of the test after the step of number `step`, by its measurements so far."""
        parts = [each for each in (self.read, self.opened) if each is not None]
        if not parts:
            return self.before
        read = parts[0] if len(parts) == 1 else parts[0].and_(parts[1])
        return self.before.over(len(read.nis)).on(step, read.weights)

    def on(self, step: int) -> Watch:
        """The watch at the next step, `step` being the number of this one."""
        return Watch(self.test(step))

    def and_(self, read: Read) -> Watch:
        """The watch after a further update of the step, whose numbers are `read`."""
        return self._replace(read=read if self.read is None else self.read.and_(read))

    def told(self, associations: Found, gate: Asked | None) -> Watch:
        """The watch after counting the `associations` of the step's sightings, by sensor.

        Of a sensor with a gate only sightings taken for no candidate count here: the gate counts
        the others. `gate` is the probability of all sensors' gates, or a mapping from sensors to
        theirs; None for no gate.
        """
        found = self.opened
        for variable, each in associations.items():
            strange, opened = each.judged(gated=gate_of(gate, variable) is not None)
            read = Read.of_open(strange.sum(axis=0), opened.sum(axis=0), each.outliers)
            found = read if found is None else found.and_(read)
        return self._replace(opened=found)
