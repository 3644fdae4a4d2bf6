"""A part of a study on a card: its arrays there, and its sums by blocks."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from pgm.beliefs.moments.solvers.laid import Few, Laid, Lying
from pgm.beliefs.moments.solvers.resident import ResidentChain
from pgm.comparison.drawn_runs import DrawnRuns
from pgm.comparison.packed_tallies import Key
from pgm.compile import DynamicGraph
from pgm.consistency.regions import chi_squared
from pgm.kernels.arrays import Array, Integers, Mask
from pgm.kernels.machine.emitter.arena import Arena
from pgm.kernels.machine.emitter.driver import Device
from pgm.kernels.machine.studies import card as kernels
from pgm.kernels.machine.studies.card_sums import TOLD, Summed, summing
from pgm.kernels.machine.studies.sums import LANES, Cells
from pgm.networks.card_draws import CardDraws
from pgm.resources import NUMBER
from pgm.variables import Variable


class Asked(NamedTuple):
    """The subject of a study: its runs and graph, the states that are judged, and the confidence.

    The confidence is that of regions whose coverage is counted.
    """

    drawn: DrawnRuns
    graph: DynamicGraph
    states: tuple[Variable, ...]
    confidence: float


class Forms(NamedTuple):
    """The statistics of a method: those that are summed, and those that are known beforehand.

    states: By state the place of its first cell.
    cells: By statistic its cells.
    constants: By statistic its value by step, as of `PackedTallies`.
    """

    states: Mapping[Variable, int]
    cells: Mapping[Key, int | slice]
    constants: Mapping[Key, Array]

    @classmethod
    def of(
        cls, states: Sequence[Variable], read: Sequence[Variable], dof: Mapping[Variable, Integers]
    ) -> Forms:
        """The forms of judged states, of sensors `read`, and of all sensors with evidence.

        `dof` are the degrees of freedom of sensors by step.
        """
        places, place = dict[Variable, int](), 0
        cells: dict[Key, int | slice] = {}
        for state in states:
            size, places[state] = state.dimension, place
            cells["error", state] = slice(place, place + size)
            cells["square", state] = slice(place + size, place + 2 * size)
            cells["nees", state], cells["held", state] = place + 2 * size, place + 2 * size + 1
            place += 2 * size + 2
        cells |= {("nis", sensor): k for k, sensor in enumerate(read, place)}
        known = {z: np.where(each > 0, each, np.nan) for z, each in dof.items()}
        constants: dict[Key, Array] = {("dof", z): each for z, each in known.items()}
        constants |= {
            ("nis", z): np.full(len(e), np.nan) for z, e in known.items() if z not in read
        }
        return cls(places, cells, constants)


class Added(NamedTuple):
    """The sums of a method over a block, of those of its runs that are `fine`.

    unsettled: How many of these have not settled in their iterations.
    known, mean, spread: (steps, cells); as of `studies.sums.Moments`.
    pairs: (cells, 6); as of `studies.card.Summed`.
    most, last: By state and run, (states, runs).
    forms: Of which statistics they are.
    """

    fine: Mask
    unsettled: int
    known: Array
    mean: Array
    spread: Array
    pairs: Array
    most: Array
    last: Array
    forms: Forms


class Part:
    """A part of a study, of so many blocks of runs, whose arrays lie on a card.

    Those of runs are in the `loose` arena, where methods have the same memory, one after another.
    In arenas without a card all is laid out that takes memory.
    """

    def __init__(
        self,
        asked: Asked,
        draws: CardDraws,
        chains: Mapping[str, ResidentChain],
        arenas: tuple[Arena, Arena],
        blocks: int,
    ) -> None:
        self._asked, (self._fixed, self._loose) = asked, arenas
        drawn, loose = asked.drawn, self._loose
        self._of = Lying(min(blocks * drawn.block, drawn.runs), blocks, drawn.block)
        self._draws = draws.lie(self._fixed, loose, self._of.stride)
        size = asked.graph.layout.slice_size
        longest = [rows * width for rows, width in draws.rows.values()]
        self._few = Few(loose, self._of, max([*longest, (drawn.steps + 1) * size * size]))
        self._counts = loose.floats(self._of.stride)
        self._methods: dict[str, _Method] = {}
        for name, chain in chains.items():
            with loose.scratch():
                self._methods[name] = self._method(chain)

    def _method(self, chain: ResidentChain) -> _Method:
        asked, of, loose = self._asked, self._of, self._loose
        laid = chain.lie(self._fixed, loose, self._draws.cells, of)
        steps, layout = asked.drawn.steps + 1, asked.graph.layout
        judges, cells, size = list[tuple[kernels.Judging, int]](), list[Cells](), layout.slice_size
        for state in asked.states:
            places = np.arange(size)[layout.places[state]].tolist()
            form = kernels.Judging(tuple(places), size, tuple(state.angle_mask.tolist()))
            out = loose.floats(steps * form.cells * of.stride)
            limit = np.array([chi_squared(asked.confidence, state.dimension)], dtype=np.float64)
            given = steps, of.stride, *laid.belief, self._draws.cells[state], out, limit
            judges.append((form, kernels.table(self._fixed, *given)))
            down = form.cells * of.stride
            cells += [Cells(out + NUMBER * k * of.stride, 1, down, 1) for k in range(form.cells)]
        sums = self._sums(chain, [*cells, *laid.squares.values()], list(laid.squares))
        return _Method(laid, judges, sums)

    def _sums(
        self, chain: ResidentChain, cells: Sequence[Cells], read: Sequence[Variable]
    ) -> _Sums:
        """Room for the sums of cells, of states and then of sensors that were read."""
        loose, of, steps = self._loose, self._of, self._asked.drawn.steps + 1
        width, dof = len(cells), chain.dof()
        forms = Forms.of(self._asked.states, read, dof)
        whole, due = np.zeros(width), np.ones((width, steps))
        for state in self._asked.states:
            for name in ("nees", "held"):
                whole[forms.cells[name, state]] = 1.0
        for sensor in read:
            due[forms.cells["nis", sensor]] = dof[sensor] > 0
        known, mean, spread = (loose.floats(of.kept * steps * width) for _ in range(3))
        total, number, most, last = (loose.floats(width * of.stride) for _ in range(4))
        apart = of.kept * steps * width * LANES
        given = Summed(
            steps,
            of.stride,
            of.apart,
            width,
            np.array([(each.address, each.down) for each in cells], dtype=np.int64),
            due,
            whole,
            self._counts,
            loose.floats(TOLD * apart),
            apart,
            known,
            mean,
            spread,
            total,
            number,
            most,
            last,
            loose.floats(of.kept * width * 6),
        )
        return _Sums(given, kernels.table(self._fixed, *given), forms)

    def sums(self, own: Device, first: int) -> dict[int, dict[str, Added]]:
        """The sums of methods over each block, of the part that begins with a run.

        There are none where some draw is not finite.
        """
        drawn, few = self._asked.drawn, self._few
        runs = min(self._of.stride, drawn.runs - first)
        firsts = range(first, first + runs, drawn.block)
        if not self._draws.draw(own, first, runs):
            return {}
        self._draws.require_right(
            lambda cells, rows, width: few.of(own, cells, rows, (width,))[:, : len(firsts)]
        )
        found: dict[int, dict[str, Added]] = {each: {} for each in firsts}
        for name, (chain, judges, sums) in self._methods.items():
            fine = chain.sweep(own, runs)
            unsettled = chain.unsettled(runs)
            chain.judge(own, few, fine)
            for form, head in judges:
                kernel = kernels.loaded(kernels.judging, kernels.JUDGE, own, form)
                own.launch(kernel, runs, (head, 0, runs), kernels.KINDS)
            for block, each in zip(firsts, self._added(own, sums, fine, unsettled), strict=True):
                found[block][name] = each
        return found

    def _added(self, own: Device, sums: _Sums, fine: Mask, unsettled: Mask) -> Iterator[Added]:
        """The sums over each block, of the runs that are fine."""
        s, loose, runs = sums.given, self._loose, len(fine)
        blocks, width, kinds = -(-runs // s.block), s.width, kernels.KINDS
        loose.renew(s.counts, fine.astype(np.float64))
        for name, given, end in s.launches(runs):
            kernel = kernels.loaded(summing, name, own, name)
            own.launch(kernel, end, (sums.table, given, end), kinds)
        shape = blocks, s.steps, width
        known, mean, spread = (loose.get(each, shape) for each in (s.known, s.mean, s.spread))
        pairs = loose.get(s.pairs, (blocks, width, 6))
        nees = [place + 2 * state.dimension for state, place in sums.forms.states.items()]
        most, last = (
            np.array([loose.get(place + NUMBER * s.stride * k, (runs,)) for k in nees])
            for place in (s.most, s.last)
        )
        for k in range(blocks):
            rows = slice(k * s.block, min((k + 1) * s.block, runs))
            yield Added(
                fine[rows],
                int(np.count_nonzero(fine[rows] & unsettled[rows])),
                known[k],
                mean[k],
                spread[k],
                pairs[k],
                most[:, rows],
                last[:, rows],
                sums.forms,
            )


class _Method(NamedTuple):
    """A method on a card: its chain, the states that are judged, with their tables, and sums."""

    chain: Laid
    judges: Sequence[tuple[kernels.Judging, int]]
    sums: _Sums


class _Sums(NamedTuple):
    """Where the sums of a method lie, the address of their table, and of what they are."""

    given: Summed
    table: int
    forms: Forms
