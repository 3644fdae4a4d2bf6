"""The blocks of a study on a card: runs are drawn, swept and summed there; sums alone come home.

As many blocks as the card's memory holds, up to some, are worked on together: that is a *part*.
Sums are those of blocks, each added in the order of the processor, so that how many are together is
no matter. Runs of which a sweep tells that they need care are done again by themselves, by the
processor; so is whatever a card cannot do, block by block.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from functools import reduce
from typing import Any

import numpy as np

from pgm.beliefs.moments.solvers.laid import Left
from pgm.beliefs.moments.solvers.resident import ResidentChain
from pgm.comparison.card_part import Added, Asked, Part
from pgm.comparison.drawn_runs import DrawnRuns, of_runs
from pgm.comparison.packed_tallies import PackedTallies
from pgm.comparison.study_methods import Method
from pgm.comparison.sums import NONE, Sums
from pgm.comparison.tally import Tally
from pgm.consistency.regions import chi_squared
from pgm.display import count
from pgm.errors import ExecutorError
from pgm.evidence import Sightings, bind, sightings
from pgm.kernels.machine.emitter.arena import Arena
from pgm.kernels.machine.emitter.driver import Device, device
from pgm.kernels.machine.studies.beliefs import LARGEST
from pgm.networks import Sample, compiled_draws
from pgm.networks.card_draws import CardDraws
from pgm.resources import NUMBER, gibibytes
from pgm.variables import Variable

# The most blocks of a part: with 2¹⁷ runs all processors of a card are at work.
MOST = 128
# The share of a card's free memory that is taken.
_SHARE = 0.9
# If more than this share of a block's runs need care, all are done by the processor.
_MANY = 1 / 8

# The sums of methods over the block that begins with a run, as they are without this file.
Plain = Callable[[int, Mapping[str, Method]], Mapping[str, Sums]]
# The sums of a method over a sample whose first run has this number, by the processor.
Aside = Callable[[Method, Sample, int], Iterator[Sums]]


class CardBlocks:
    """The work on the blocks of a study, by a card; see `blocks.Work`.

    The blocks of a part are worked on when its first is asked for, and wait for their turn.

    sure: The confidence of regions that a right belief's truth is surely in.
    """

    def __init__(
        self,
        asked: Asked,
        methods: Mapping[str, Method],
        sure: float,
        plain: Plain,
        aside: Aside,
    ) -> None:
        self._asked, self._methods = asked, methods
        self._sure = {v: float(chi_squared(sure, v.dimension)) for v in asked.states}
        self._plain, self._aside = plain, aside
        self._left, self._careful = dict[str, str](), dict[str, int]()
        self._found: dict[int, dict[str, Sums]] = {}
        self._stack, self._part = ExitStack(), list[Part]()
        self._chains: dict[str, ResidentChain] = {}
        self._draws: CardDraws | None = None
        try:
            self._draws = _draws(asked)
        except (Left, compiled_draws.Left) as error:
            self._leave_all(error)
        else:
            self._make_chains()

    def _make_chains(self) -> None:
        drawn = self._asked.drawn
        # Of each block of a part one run comes home, to be judged; a plan of several is due.
        evidence = _evidence(drawn, max(min(len(drawn.blocks), MOST), 2))
        for name, method in self._methods.items():
            try:
                if method.belief is not None:
                    raise Left("it is a family of beliefs")
                chain = ResidentChain(self._asked.graph, method.call, evidence, drawn.block)
                self._chains[name] = chain
            except Left as error:
                self._left[name] = str(error)

    def _leave_all(self, error: Exception) -> None:
        """Leave all methods to the processor."""
        self._left |= {name: self._left.get(name, str(error)) for name in self._methods}
        self._chains = {}

    @contextmanager
    def held(self) -> Iterator[CardBlocks]:
        """A context in which memory of the card is held."""
        with self._stack:
            yield self

    @property
    def words(self) -> str:
        """How methods were worked on, for a user."""
        there = [name for name in self._methods if name not in self._left]
        told = []
        for name in there:
            careful = self._careful.get(name, 0)
            own = f" but for {count(careful, 'run')}, which had to be done with care"
            told.append(name + own * bool(careful))
        words = [f"drawn, swept and summed on a card: {', '.join(told)}"] if there else []
        words += [
            f"{name} drawn and summed by the processor: {w}" for name, w in self._left.items()
        ]
        return "; ".join(words)

    def __call__(self, first: int, /) -> Mapping[str, Sums]:
        """The sums of each method over the block that begins with a run."""
        if first not in self._found:
            self._found = {}
            if self._chains:
                try:
                    self._found = self._by_card(first)
                except (Left, compiled_draws.Left) as error:
                    # A trace is wrong, which the processor makes anew, or does without.
                    self._leave_all(error)
                except OSError as error:
                    raise ExecutorError(f"the card of the study has failed: {error}") from error
        found = self._found.pop(first, {})
        rest = {name: each for name, each in self._methods.items() if name not in found}
        found |= self._plain(first, rest) if rest else {}
        return {name: found[name] for name in self._methods}

    def _by_card(self, first: int) -> dict[int, dict[str, Sums]]:
        """The sums over all blocks of the part that begins with a run, so far as there are any."""
        own = device()
        with own.current():
            if not self._part:
                self._part.append(self._laid(own))
            added = self._part[0].sums(own, first)
        found: dict[int, dict[str, Sums]] = {}
        for block, methods in added.items():
            found[block] = {}
            for name, each in methods.items():
                sums = self._whole(name, block, each)
                if sums is not None:
                    found[block][name] = sums
        return found

    def _laid(self, own: Device) -> Part:
        """All that lies on the card, for a part of as many blocks as there is room for."""
        assert self._draws is not None
        drawn, given = self._asked.drawn, (self._asked, self._draws, self._chains)
        blocks, free = min(len(drawn.blocks), MOST), int(own.free() * _SHARE)
        while True:
            sizes = Arena(), Arena()
            Part(*given, sizes, blocks)
            due = sum(each.most for each in sizes)
            if due <= free:
                break
            if blocks == 1:
                what, there = gibibytes(due / NUMBER), gibibytes(free / NUMBER)
                raise Left(f"{count(drawn.block, 'run')} take {what} of its memory, of {there}")
            blocks = max(min(blocks - 1, blocks * free // due), 1)
        fixed, loose = (
            Arena(own, self._stack.enter_context(_room(own, each.most)), each.most)
            for each in sizes
        )
        return Part(*given, (fixed, loose), blocks)

    def _whole(self, name: str, first: int, added: Added) -> Sums | None:
        """The sums over a block, with those of its runs that need care; None leaves all of it."""
        careful = np.flatnonzero(~added.fine)
        if len(careful) > _MANY * len(added.fine):
            self._careful[name] = self._careful.get(name, 0) + len(added.fine)
            return None
        sums = sums_of(added, first, self._sure)
        if self._methods[name].iterates:
            sums = sums._replace(unsettled=added.unsettled)
        if not len(careful):
            return sums
        sample = self._asked.drawn.sample(first)
        parts = [sums]
        for k in careful.tolist():
            one = of_runs(sample, slice(k, k + 1))
            parts += self._aside(self._methods[name], one, first + k)
        for state in self._asked.states:
            nees = [each.tallies["nees", state].known > 0.0 for each in parts if each.runs]
            if any((each != nees[0]).any() for each in nees):
                return None  # as at a step at which one covariance is singular there is no NEES
        self._careful[name] = self._careful.get(name, 0) + len(careful)
        found = reduce(Sums.joined, parts)
        return found._replace(diverged=np.sort(found.diverged), failed=np.sort(found.failed))


def sums_of(added: Added, first: int, sure: Mapping[Variable, float]) -> Sums:
    """The sums over the fine runs of the block that begins with a run.

    Runs whose last NEES is more than what is `sure`, by state, have diverged.
    """
    worst: dict[Variable, tuple[float, int]] = {}
    fine, lost = added.fine, np.zeros(len(added.fine), dtype=bool)
    for k, state in enumerate(added.forms.states):
        most = np.where(fine, added.most[k], -np.inf)
        place = int(most.argmax())
        worst[state] = float(most[place]), first + place
        lost |= fine & (added.last[k] > sure[state])
    runs, total, number, xx, xn, nn = added.pairs.T
    whole = Tally(
        added.known,
        added.mean,
        added.spread,
        float(runs[0]),
        np.array([total, number]),
        np.array([[xx, xn], [xn, nn]]),
    )
    tallies = PackedTallies(whole, added.forms.cells, added.forms.constants)
    return Sums(tallies, int(runs[0]), first + np.flatnonzero(lost), NONE, 0, worst)


def _draws(asked: Asked) -> CardDraws:
    """The draws of a study by a card; a `Left` says why there are none."""
    drawn = asked.drawn
    if not drawn.counted:
        raise Left("each run is drawn by a generator of its own")
    for state in asked.states:
        if state.dimension > LARGEST:
            raise Left(f"{state!r} has more than {LARGEST} components")
    model, inputs = drawn.model, drawn.inputs
    bound = bind(model.transition, model.observation, inputs, drawn.steps, (1,), drawing=True)
    return CardDraws(model, bound, drawn.seed)


def _evidence(drawn: DrawnRuns, runs: int) -> dict[Variable, Any]:
    """Evidence of so many runs whose readings are of no matter, as `DrawnRuns.sample` has it."""
    model, inputs = drawn.model, drawn.inputs
    bound = bind(model.transition, model.observation, inputs, drawn.steps, (1,), drawing=True)
    found: dict[Variable, Any] = dict(inputs)
    for reading in bound.readings:
        child, asked = reading.cpd.child, inputs.get(reading.cpd.child)
        values = np.zeros((runs, len(reading.step), child.dimension))
        found[child] = (
            sightings(values, asked.step, asked.given) if isinstance(asked, Sightings) else values
        )
    return found


@contextmanager
def _room(own: Device, size: int) -> Iterator[int]:
    """Memory of a card, which is taken and given back with that card in use."""
    with ExitStack() as stack:
        with own.current():
            place = stack.enter_context(own.room(size))
        try:
            yield place
        finally:
            with own.current():
                stack.close()
