"""The kernels of studies for NVIDIA's cards, without one: interpreted, and assembled."""

from platform import machine

import numpy as np
import pytest
from card import CAPABILITIES, assembled, needs_libdevice
from numpy.testing import assert_allclose, assert_array_equal
from ptx import Program
from scipy.special import ndtri

import pgm
from pgm.comparison.tally import Tally
from pgm.kernels import philox
from pgm.kernels.machine.emitter.arena import Arena
from pgm.kernels.machine.emitter.card import Card, printed, thread
from pgm.kernels.machine.emitter.memory import Runs
from pgm.kernels.machine.emitter.module import Module
from pgm.kernels.machine.emitter.processor import llvm
from pgm.kernels.machine.studies import card, card_sums, draws, sums
from pgm.kernels.machine.studies.rows import Child, Form, Resident
from pgm.kernels.machine.studies.sums import Cells, Given
from pgm.kernels.machine.studies.transitions import COMPOSE, Part, Transition, composing

needs_libdevice()
LATE = (8, 0)


class Here:
    """Memory of this process as that of a card."""

    def __init__(self):
        self.held = {}

    def put(self, place, address, count):
        raise AssertionError("arrays stay where they are")


class OwnArena(Arena):
    """An arena whose pieces are arrays of this process."""

    def __init__(self):
        super().__init__()
        self.arrays = []

    def put(self, array):
        self.arrays.append(np.array(array, order="C"))
        return self.arrays[-1].ctypes.data

    def floats(self, count):
        return self.put(np.full(count, np.nan))


def launched(text, name, given, threads=4):
    """Run a kernel in as many threads as it has numbers, or some more."""
    table, first, last = given
    count = last - first if name == card.DRAW else last
    Program(text).launch(f"pgm_{name}", [table, first, last], -(-count // threads), threads)


@pytest.mark.parametrize("count", [1, 4, 5])
def test_uniform_numbers_are_numpys_bit_for_bit(count):
    code = Module(target=Card(LATE)).function("uniform", card.KINDS)
    given, first = Given(code, code.arguments[0]), code.arguments[1]
    key, out, blocks = (given.whole(), given.whole()), given.address(), -(-count // philox.BLOCK)
    words, run = code.room(blocks * philox.BLOCK), thread(code)
    draws.fill(
        code, words.address, blocks, key, (first + run, code.whole(7), code.whole(2), code.whole(0))
    )
    for i in range(count):
        value = draws.uniform(code, words.address + i)
        code.memory(out).store(run * count + i, value)
    source, start, found = philox.Philox(2**70 + 1), 10**12, np.zeros((3, count))
    table = np.array([*source.key.view(np.int64), found.ctypes.data], dtype=np.int64)
    text = printed(code.module, ["uniform"])
    Program(text).launch("pgm_uniform", [table.ctypes.data, start, start + 3], 1, 3)
    for run in range(3):
        counter = np.array([(start + run) * blocks, 7, 2, 0], dtype=np.uint64)
        words = np.random.Philox(key=source.key, counter=counter).random_raw(count)
        assert_array_equal(found[run], philox.uniforms(words))


def white(count, runs, first, variable, seed=3):
    """Standard normal numbers (count, runs) of row 5, as the kernel draws them."""
    arena, source = OwnArena(), philox.Philox(seed)
    found, total = np.zeros((count, runs)), np.zeros(runs)
    place = Cells(found.ctypes.data, 1, count * runs, runs)
    out = Resident(place, count, Runs.BESIDE, np.zeros(1, dtype=np.int64))
    child = Child(None, (), (), np.zeros(count), np.eye(count), None, out)
    drawn = card.Drawn(child, variable, np.array([5]))
    forms = card.Drawing((child.form,), (), ())
    table = card.table(arena, *source.key.view(np.int64), total.ctypes.data, *drawn.numbers)
    launched(card.drawing(forms, LATE), card.DRAW, (table, first, first + runs))
    assert_allclose(total, found.sum(axis=0), rtol=1e-14)
    return found


def test_normal_numbers_are_the_processors_but_for_a_last_place():
    """In the middle, where no logarithm is due, bit for bit, if it rounds a x + b once as well."""
    count, runs, first = 5, 40, 900
    found, source = white(count, runs, first, 2), philox.Philox(3)
    given = source, first, runs, np.array([5]), 2, 0, count
    uniform = draws.numbers(*given, normal=False)[0].T
    processor = draws.numbers(*given, normal=True)[0].T
    middle = np.abs(uniform - 0.5) <= 0.425
    assert 150 < middle.sum() < 190
    if machine() in ("arm64", "aarch64") or llvm().get_host_cpu_features().get("fma"):
        assert_array_equal(found[middle], processor[middle])
    np.testing.assert_array_max_ulp(found, processor, 2)
    assert_allclose(found, ndtri(uniform), rtol=2e-15)


def summed(values, block, counts, due=None, whole=None):
    """The sums of values (runs, steps, cells), as the kernels add them."""
    runs, steps, width = values.shape
    arena, blocks, lying = OwnArena(), -(-runs // block), np.ascontiguousarray(values.T)
    size = steps * runs * 8
    cells = [(lying.ctypes.data + k * size, runs) for k in range(width)]
    shapes = [(blocks, steps, width)] * 3 + [(width, runs)] * 4 + [(blocks, width, 6)]
    out, apart = [np.full(shape, np.nan) for shape in shapes], blocks * steps * width * sums.LANES
    counts = np.asarray(counts, dtype=float)
    given = card_sums.Summed(
        steps,
        runs,
        block,
        width,
        np.array(cells, dtype=np.int64),
        np.ones((width, steps)) if due is None else due,
        np.zeros(width) if whole is None else whole,
        counts.ctypes.data,
        arena.floats(card_sums.TOLD * apart),
        apart,
        *(each.ctypes.data for each in out),
    )
    table = card.table(arena, *given)
    for name, first, last in given.launches(runs):
        launched(card_sums.summing(name, LATE), name, (table, first, last))
    return out


def test_sums_have_the_bits_of_the_processor():
    values = np.random.default_rng(3).normal(size=(13, 3, 1)) + 5.0
    values[3, 1] = values[12, 0] = values[:, 2] = np.nan
    known, mean, spread, total, number, most, last, pairs = summed(values, 13, np.ones(13))
    moments = sums.of_values(values[..., 0])
    for one, two in zip((known[0], mean[0], spread[0], total, number), moments, strict=True):
        assert_array_equal(one, two)
    plain = Tally.of(values)
    assert_allclose(pairs[0, 0, 1:3], plain.centre[:, 0], rtol=1e-14)
    scatter = plain.scatter[..., 0]
    assert_allclose(pairs[0, 0, 3:], [scatter[0, 0], scatter[0, 1], scatter[1, 1]], rtol=1e-13)
    assert_array_equal(most[0], np.nanmax(values[..., 0], axis=1))
    assert_array_equal(last[0, 3], values[3, 0, 0])


def test_blocks_are_summed_by_themselves_and_some_runs_not_at_all():
    values = np.random.default_rng(4).normal(size=(10, 2, 2))
    counts = np.ones(10, dtype=bool)
    counts[[1, 9]] = False
    due = np.array([[1.0, 1.0], [0.0, 1.0]])
    known, mean, spread, *_, pairs = summed(values, 4, counts, due)
    every = np.where(due.T == 1.0, values, np.nan)
    for k, rows in enumerate((slice(0, 4), slice(4, 8), slice(8, 10))):
        plain = Tally.of(every[rows][counts[rows]])
        for one, two in zip((known[k], mean[k], spread[k]), plain[:3], strict=True):
            assert_allclose(one, two, rtol=1e-14, atol=1e-15)
        assert_array_equal(pairs[k, :, 0], plain.runs)
        assert_allclose(pairs[k, :, 1:3].T, plain.centre, rtol=1e-14, atol=1e-15)


def test_a_step_at_which_one_run_has_no_value_has_none():
    values = np.random.default_rng(5).normal(size=(6, 3, 2))
    values[4, 1] = np.nan
    known, mean, _, total, number, most, last, _ = summed(
        values, 3, [1, 1, 1, 1, 1, 1], whole=np.array([1.0, 0.0])
    )
    assert_array_equal(known[:, 1], [[3.0, 3.0], [0.0, 2.0]])
    assert mean[1, 1, 0] == 0.0
    assert_array_equal(number, [[3.0] * 3 + [2.0] * 3, [3.0] * 4 + [2.0, 3.0]])
    assert_allclose(total[0, 3:], values[3:, [0, 2], 0].sum(axis=1), rtol=1e-14)
    assert_array_equal(most[0, 3:], values[3:, [0, 2], 0].max(axis=1))
    assert_array_equal(last[:, 3:], values[3:, 2].T)
    nothing = summed(np.full((2, 1, 1), np.nan), 2, [1, 1])
    assert np.isneginf(nothing[5]).all()
    assert np.isnan(nothing[6]).all()


def test_beliefs_are_judged_as_numpy_does():
    """Of a part of a slice, with an angle, and a covariance that is singular."""
    rng = np.random.default_rng(6)
    steps, runs, size, places = 2, 3, 3, (0, 2)
    root = rng.normal(size=(runs, steps, size, size))
    cov = root @ root.swapaxes(-1, -2)
    mean, truth = rng.normal(size=(2, runs, steps, size)) * 4.0
    cov[1, 1] = np.diag([1.0, 1.0, 0.0])
    lying = [
        np.ascontiguousarray(each.reshape(runs, -1).T) for each in (mean, cov, truth[..., places])
    ]
    widths = size, size**2, len(places)
    cells = [
        Cells(each.ctypes.data, 1, width * runs, runs)
        for each, width in zip(lying, widths, strict=True)
    ]
    form = card.Judging(places, size, (False, True))
    found, limit = np.zeros((steps, form.cells, runs)), np.array([3.0])
    table = card.table(OwnArena(), steps, runs, *cells, found.ctypes.data, limit)
    launched(card.judging(form, LATE), card.JUDGE, (table, 0, runs))
    place = pgm.Variable("place", components=("a", "b"), angles=("b",))
    belief = pgm.Gaussian(place, mean[..., places], cov[..., places, :][..., places])
    errors = pgm.consistency.error(belief, truth[..., places])
    due = np.einsum("rti,rtij,rtj->rt", errors, np.linalg.pinv(belief.cov), errors)
    due[1, 1] = np.nan
    held = np.where(np.isnan(due), np.nan, due <= 3.0)
    rows = np.moveaxis(found, 1, -1).swapaxes(0, 1)
    assert_allclose(rows[..., :2], errors, rtol=1e-14, atol=1e-14)
    assert_allclose(rows[..., 2:4], errors**2, rtol=1e-14, atol=1e-14)
    assert_allclose(rows[..., 4], due, rtol=1e-11)
    assert_array_equal(rows[..., 5], held)


def test_transitions_of_several_cpds_are_composed():
    """Of three CPDs, the second on what the first has made, by the inverse of a joint matrix."""
    rng, runs, steps = np.random.default_rng(8), 2, 2
    shapes = ((0, 1), 2, 2), ((2, 3), 4, 1), ((4, 1, 2), 5, 2)
    laws, cells, parts = [], [], []
    for k, (parents, child, height) in enumerate(shapes):
        own = 1 if k == 1 else runs  # one that all runs share
        law = rng.normal(size=(own, steps, height, len(parents)))
        root = rng.normal(size=(own, steps, height, height))
        kind = Runs.SAME if own == 1 else Runs.BESIDE
        parts.append(Part(parents, child, height, kind, kind))
        laws.append((law, root @ root.swapaxes(-1, -2)))
        for each in laws[-1]:
            lying, width = np.ascontiguousarray(each.reshape(own, -1).T), each[0, 0].size
            cells.append((lying, Cells(lying.ctypes.data, own > 1, width * own, own)))
    out = [np.zeros((steps, width, runs)) for width in (5 * 2, 5 * 5)]
    cells += [(each, Cells(each.ctypes.data, 1, len(each[0]) * runs, runs)) for each in out]
    form = Transition(2, tuple(parts))
    table = card.table(OwnArena(), steps, *(place for _, place in cells))
    launched(composing(form, LATE), COMPOSE, (table, 0, runs))
    for run, step in np.ndindex(runs, steps):
        # x = A x + e of all components, with the states as e: (I − A)⁻¹.
        within, spread = np.zeros((7, 7)), np.zeros((7, 7))
        for (parents, child, height), (law, noise) in zip(shapes, laws, strict=True):
            own = slice(child, child + height)
            within[own, parents] = law[run % len(law), step]
            spread[own, own] = noise[run % len(noise), step]
        total = np.linalg.inv(np.eye(7) - within)
        matrix, cov = (each[step, :, run] for each in out)
        assert_allclose(matrix.reshape(5, 2), total[2:, :2], rtol=1e-13, atol=1e-13)
        assert_allclose(cov.reshape(5, 5), (total @ spread @ total.T)[2:, 2:], atol=1e-12)


def test_a_few_runs_are_picked():
    values, out = np.arange(24.0).reshape(4, 6), np.zeros((4, 2))
    table = card.table(OwnArena(), values.ctypes.data, 6, 2, 4, out.ctypes.data)
    launched(card.picking(LATE), card.PICK, (table, 0, 4))
    assert_array_equal(out, values[:, ::4])


AFFINE = Form(None, ((2, Runs.BESIDE), (1, Runs.SAME)), 2, None, Runs.BESIDE)
KERNELS = {
    card.DRAW: lambda at: card.drawing(card.Drawing((AFFINE,), (AFFINE,), (AFFINE,)), at),
    card.JUDGE: lambda at: card.judging(card.Judging((0, 2, 3), 4, (False, True, False)), at),
    card.PICK: card.picking,
}
NAMES = card_sums.BY_LANE, card_sums.OFF, card_sums.BY_STEP, card_sums.BY_RUN, card_sums.BY_BLOCK
KERNELS |= {name: lambda at, name=name: card_sums.summing(name, at) for name in NAMES}
PARTS = [Part(parents, k, 1, Runs.SAME, Runs.BESIDE) for k, parents in enumerate(((0,), (0, 1)), 1)]
KERNELS[COMPOSE] = lambda at: composing(Transition(1, tuple(PARTS)), at)


@pytest.mark.parametrize("capability", CAPABILITIES, ids=str)
@pytest.mark.parametrize("name", KERNELS)
def test_nvidias_assembler_takes_them(name, capability, tmp_path):
    text = KERNELS[name](capability)
    told, length = assembled(text, capability, tmp_path)
    assert f"pgm_{name}" in text
    assert not told
    assert length > 1000


def test_an_arena_ends():
    arena = Arena(Here(), 4096, 1024)
    assert arena.floats(3) == 4096
    assert arena.floats(40) == 4096 + 256
    with arena.scratch():
        assert arena.floats(1) == 4096 + 768
    with pytest.raises(MemoryError, match="1024 bytes has no room for 64 floats"):
        arena.floats(64)
    endless = Arena()
    with endless.scratch():
        endless.put(np.zeros(2000))
    endless.floats(1)
    assert endless.most == 16128
