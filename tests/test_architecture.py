"""The page and the picture of the architecture are of the package as it is.

Where a check fails it shows what was measured, for docs/architecture.md.
"""

import itertools
import re
import runpy
import sys
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import pgm
from pgm.beliefs.moments.passes import forward
from pgm.beliefs.moments.passes.backward import Beliefs, Reverse
from pgm.beliefs.moments.solvers.run import Solver
from pgm.posteriors.status import Status
from pgm.schedules import sweep
from tests.schedules.test_sweep_families import Tables
from tests.test_imports import LAYERS

ROOT = Path(__file__).parent.parent
PACKAGE = Path(pgm.__file__).parent
PAGE = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
CHAIN = "beliefs/moments/"
T = 12

x = pgm.Variable("x", components=("east", "north", "heading"), angles=("heading",))
u = pgm.Variable("u", components=("v", "turn"))
z = pgm.Variable("z", components=("range", "bearing"), angles=("bearing",))
EVIDENCE = {
    u: np.tile([1.0, 0.2], (T, 1)),
    z: pgm.sightings(np.tile([9.0, 0.4], (T + 1, 1)), step=np.arange(T + 1)),
}


def block(language, which=0):
    found = re.findall(rf"^```{language}\n(.*?)^```", PAGE, flags=re.MULTILINE | re.DOTALL)
    return found[which]


def model(called=lambda name: None):
    """A robot with Jacobians, whose functions tell that they are called."""

    def drive(x, u):
        called("drive")
        turn = x[..., 2] + u[..., 1]
        step = [u[..., 0] * np.cos(turn), u[..., 0] * np.sin(turn), u[..., 1]]
        return x + np.stack(step, axis=-1)

    def by_state(x, u):
        turn, out = x[..., 2] + u[..., 1], np.zeros((*x.shape, 3)) + np.eye(3)
        out[..., 0, 2], out[..., 1, 2] = -u[..., 0] * np.sin(turn), u[..., 0] * np.cos(turn)
        return out

    def sight(x):
        called("sight")
        away = [9.0, 4.0] - x[..., :2]
        bearing = np.arctan2(away[..., 1], away[..., 0]) - x[..., 2]
        return np.stack([np.hypot(away[..., 0], away[..., 1]), bearing], axis=-1)

    def of_sight(x):
        east, north = np.moveaxis([9.0, 4.0] - x[..., :2], -1, 0)
        square, out = east**2 + north**2, np.zeros((*x.shape[:-1], 2, 3))
        out[..., 0, 0], out[..., 0, 1] = -east / np.sqrt(square), -north / np.sqrt(square)
        out[..., 1, 0], out[..., 1, 1], out[..., 1, 2] = north / square, -east / square, -1.0
        return out

    return pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(x, np.zeros(3), 0.01 * np.eye(3))],
        [
            pgm.NonlinearGaussianCPD(
                x, (x.previous, u), drive, 0.01 * np.eye(3), jacobian={x.previous: by_state}
            )
        ],
        [pgm.NonlinearGaussianCPD(z, x, sight, 0.1 * np.eye(2), jacobian={x: of_sight})],
    )


def test_files_that_are_named_exist():
    named = set(re.findall(r"`([\w/]+(?:\.py|/))`", PAGE))
    assert {"kernels/gaussian.py", "schedules/sweep.py", "beliefs/gaussian/"} <= named
    for path in named:
        places = [ROOT / path, PACKAGE / path, PACKAGE / CHAIN / path]
        assert any(place.exists() for place in places), path


def test_names_of_code_exist():
    text = "\n".join(path.read_text(encoding="utf-8") for path in PACKAGE.rglob("*.py"))
    text += (ROOT / "tests" / "beliefs" / "moments" / "zoo.py").read_text(encoding="utf-8")
    words = set(re.findall(r"\w+", text))
    assert not set(re.findall(r"`(?:\w+\.)?([A-Za-z_]\w{2,})`", PAGE)) - words


def test_the_protocol_is_that_of_the_sweeps():
    rng = np.random.default_rng(0)
    prior, motions, likelihoods = rng.random(3), rng.random((T, 3, 3)), rng.random((T + 1, 1, 3))
    page, due = (Tables(prior, motions, likelihoods) for _ in range(2))
    names = {"family": page, "record": page, "reverse": page, "T": T}
    exec(compile(block("python"), "architecture.md", "exec"), names)
    sweep.forward(due, T, due)
    *_, (_, last) = sweep.backward(due, T, due.known[-1])
    for name in ("predicted", "known", "log_densities"):
        assert_array_equal(getattr(page, name), getattr(due, name))
    assert_array_equal(names["belief"], last)


class Odd(Solver):
    def solve(self, plan, start, room):
        return None


def test_a_chains_schedule_of_ones_own_is_that_of_the_page():
    names = {"Solver": Solver, "Reverse": Reverse, "Beliefs": Beliefs, "forward": forward}
    names |= {"pgm": pgm, "np": np, "Status": Status, "dataclass": dataclass, "ClassVar": ClassVar}
    exec(compile(block("python", 1), "architecture.md", "exec"), names)
    graph = pgm.compile(model(), steps=T)
    found, due = (
        pgm.infer(graph, EVIDENCE, schedule=schedule)
        for schedule in (names["OneBack"](), pgm.FixedLag(1))
    )
    assert found.kind == due.kind
    # BLAS may round the two ways differently.
    assert_allclose(found[x].mean, due[x].mean, rtol=1e-12, atol=1e-12)
    assert_allclose(found[x].cov, due[x].cov, rtol=1e-12, atol=1e-14)
    flat = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(x, np.zeros(3), np.inf)], model().transition, model().observation
    )
    compared = pgm.compare(
        model(), EVIDENCE, schedules=[names["OneBack"]()], linearisers=[pgm.Taylor()], oracle=due
    )
    assert compared.rows[0].kl < 1e-12
    many = {v: np.stack([each] * 2000) for v, each in EVIDENCE.items() if v == u}
    many[z] = pgm.sightings(np.tile([9.0, 0.4], (2000, T + 1, 1)), step=np.arange(T + 1))
    for option in ({"keep": x}, {"executor": ThreadPoolExecutor(2)}):
        shared = pgm.infer(graph, many, schedule=names["OneBack"](), **option)
        assert_allclose(shared[x].mean[-1], due[x].mean, rtol=1e-9)
    for solver, text in ((7, "its solver is 7; a class"), (Odd, "returned an outcome None")):
        other = type("Other", (pgm.Filtering,), {"solver": solver})
        with pytest.raises(pgm.ModelError, match=text):
            pgm.infer(graph, EVIDENCE, schedule=other())
    unkind = type("Unkind", (pgm.Filtering,), {"solver": names["OneBackSolver"]})
    with pytest.raises(pgm.ModelError, match="where one of the kind filtered was due"):
        pgm.infer(graph, EVIDENCE, schedule=unkind())
    with pytest.raises(pgm.ModelError, match="a solver, of which particles would know nothing"):
        pgm.infer(graph, EVIDENCE, schedule=names["OneBack"](), belief=pgm.Particles(9))
    with pytest.raises(pgm.ModelError, match="a solver, of which an online filter would know"):
        pgm.OnlineFilter(model(), schedule=names["OneBack"]())
    with pytest.raises(pgm.NumericalError, match="in float64 alone, which has too few digits"):
        pgm.infer(pgm.compile(flat, steps=T), EVIDENCE, schedule=names["OneBack"]())


def frames():
    """The package's frames above the caller's caller, outermost first.

    Without those that tell of arguments that do not fit, before a public call.
    """
    found, frame = [], sys._getframe(2)
    while frame is not None:
        path = Path(frame.f_code.co_filename)
        named = path.name != "arguments.py" and not frame.f_code.co_name.startswith("<")
        if PACKAGE in path.parents and named:
            found.append((frame.f_code.co_qualname, path.relative_to(PACKAGE).as_posix()))
        frame = frame.f_back
    return found[::-1]


def between(call):
    """By function, the frames of its last call."""
    found = {}
    call(model(lambda name: found.update({name: frames()})))
    return found


def online(robot):
    filter_ = pgm.OnlineFilter(robot)
    belief = filter_.initial()
    for _ in range(2):
        belief = filter_.predict(belief, {u: [1.0, 0.2]})
        belief = filter_.update(belief, {z: [9.0, 0.4]})


def test_a_value_passes_the_frames_shown():
    rows = re.findall(r"^ *([\w.]+) +([\w/]+\.py)|^  (or)$", block("text"), flags=re.MULTILINE)
    shown = [(name, path) for name, path, _ in rows]
    (middle,) = [k for k, row in enumerate(rows) if row[2]]
    start = next(k for k, (name, _) in enumerate(shown) if name == "MomentChain.predict")
    end = next(k for k, (name, _) in enumerate(shown) if name == "Family.line")
    found = between(lambda robot: pgm.filter(robot, EVIDENCE))
    assert found["drive"] == shown[:middle] + shown[end:]
    assert found["sight"] == shown[:start] + shown[middle + 1 :]
    (due,) = re.findall(r"(\d+) frames lie between", PAGE)
    assert [len(each) - 1 for each in found.values()] == [int(due)] * 2
    counted = re.findall(r"online (\d+) between `predict` and the motion,\s(\d+)", PAGE)
    found = between(online)
    assert [(str(len(found["drive"]) - 1), str(len(found["sight"]) - 1))] == counted


def test_the_files_shown_are_those_that_run(monkeypatch):
    called, looking, forward = Counter(), [False], sweep.forward

    def swept(*arguments):
        looking[0] = True
        forward(*arguments)
        looking[0] = False

    def look(frame, event, _):
        if event == "call" and looking[0]:
            called[frame.f_code] += 1

    robot = model()
    pgm.filter(robot, EVIDENCE)
    monkeypatch.setattr(sweep, "forward", swept)
    before = sys.getprofile()
    sys.setprofile(look)
    try:
        pgm.filter(robot, EVIDENCE)
    finally:
        sys.setprofile(before)
    running = set()
    for code, times in called.items():
        path = Path(code.co_filename)
        if times < T and code is not forward.__code__:
            continue  # what the first step prepares for all
        if code.co_filename == "<string>":  # as `written` compiles them
            running.add("kernels/written.py")
        elif PACKAGE in path.parents:
            running.add(path.relative_to(PACKAGE).as_posix())
    table = PAGE.partition("| part | files |")[2].partition("\n\n")[0]
    shown = {
        path if (PACKAGE / path).exists() else CHAIN + path
        for path in re.findall(r"`([\w/]+\.py)`", table)
    }
    assert shown == running
    (told,) = re.findall(r"executes code of (\d+) files", PAGE)
    assert int(told) == len(running)


def test_the_picture_has_the_layers_and_nothing_overlaps(tmp_path):
    script = runpy.run_path(str(ROOT / "docs" / "architecture.py"))
    layers = [set(layer.names.split(", ")) for layer in script["LAYERS"]]
    assert [*layers[:-2], layers[-2] | layers[-1]] == LAYERS[::-1]
    figure = script["draw"]()
    figure.canvas.draw()
    (ax,) = figure.axes
    boxes = [p.get_window_extent() for p in ax.patches if p.get_label() == "station"]
    texts = [text.get_window_extent() for text in ax.texts if text.get_text()]
    assert len(boxes) == len(script["STATIONS"])
    inside = [text for text in texts if any(_holds(box, text) for box in boxes)]
    assert len(inside) == len(boxes)
    for a, b in itertools.combinations(texts, 2):
        assert not a.overlaps(b)
    for box in boxes:
        assert not any(box.overlaps(text) for text in texts if not _holds(box, text))
        assert _holds(figure.bbox, box)
    assert all(_holds(figure.bbox, text) for text in texts)
    script["save"](tmp_path / "drawn.png")
    drawn = (tmp_path / "drawn.png").read_bytes()
    kept = (ROOT / "docs" / "images" / "architecture.png").read_bytes()
    assert len(kept) < 80_000
    assert len(drawn) == pytest.approx(len(kept), rel=0.2)


def _holds(box, text):
    return box.x0 <= text.x0 and text.x1 <= box.x1 and box.y0 <= text.y0 and text.y1 <= box.y1
