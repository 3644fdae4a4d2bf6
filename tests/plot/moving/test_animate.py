"""`pgm.plot.animate`: a run in pictures, whose paths, ellipses, clusters and messages are right."""

import io
import math

import matplotlib.pyplot as plt
import numpy as np
import pytest
from matplotlib.animation import FFMpegWriter
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from PIL import Image

import pgm
import pgm.plot
from pgm import ModelError
from pgm.inference import Kind
from pgm.plot.diagrams.canvas import LEGIBLE
from pgm.plot.moving.movies import BlittedCanvas
from pgm.plot.moving.panels import FILTERED, REVISED, Chain, Frame, Paths, frames
from tests.plot.diagrams.zoo import hub

x = pgm.Variable("x", components=("east", "north"))
y = pgm.Variable("y", components=("east", "north"))
bias = pgm.Variable("bias")
T = 8
MODEL = pgm.DynamicBayesianNetwork(
    [pgm.GaussianCPD(x, [0.0, 0.0], np.diag([0.4, 0.1]))],
    [pgm.LinearGaussianCPD(x, {x.previous: 1.0}, offset=[1.0, 0.2], cov=0.2 * np.eye(2))],
    [pgm.LinearGaussianCPD(y, {x: 1.0}, cov=np.diag([0.1, 0.4]))],
)
DRAWN = MODEL.sample({}, steps=T, rng=0)
SMOOTHED = pgm.smooth(MODEL, DRAWN.evidence)
FILTERED_ALONE = pgm.filter(MODEL, DRAWN.evidence)
RUNS = pgm.smooth(MODEL, MODEL.sample({}, steps=T, runs=3, rng=0).evidence)
SMALL = {"figsize": (4.0, 3.5), "dpi": 50}
SUBSCRIPTS = str.maketrans("₀₁₂₃₄₅₆₇₈₉", "0123456789")


def test_a_filter_goes_forward_and_a_smoother_comes_back():
    assert frames(Kind(0), 2, None) == [Frame(k, False, k, (0, -1)) for k in range(3)]
    back = frames(Kind(math.inf), 2, None)
    assert [(f.step, f.back) for f in back] == [
        (0, False), (1, False), (2, False), (2, True), (1, True), (0, True),
    ]  # fmt: skip
    assert [f.filtered for f in back] == [0, 1, 2, 2, 2, 2]
    assert [f.revised for f in back[3:]] == [(2, 2), (1, 2), (0, 2)]
    assert all(f.revised[0] > f.revised[1] for f in back[:3])


def test_a_fixed_lag_follows_the_filter():
    revised = [f.revised[1] for f in frames(Kind(2), 4, None)]
    assert revised == [-2, -1, 0, 1, 4]  # at the end no measurement is to come


def test_long_passes_skip_steps_and_end_at_the_last():
    shown = frames(Kind(math.inf), 10_007, None)
    assert len(shown) <= 2 * 101 + 1
    assert [shown[0].step, shown[-1].step] == [0, 0]
    assert max(f.step for f in shown) == 10_007
    assert [f.step for f in frames(Kind(0), 7, 3)] == [0, 3, 6, 7]


def chain_at(frame, most=5, graph=SMOOTHED.graph, both=True, wide=8):
    """The names of the clusters and of the messages shown, and the cluster that is lit."""
    ax = plt.subplots(figsize=(wide, 1.5))[1]
    chain = Chain(ax, graph, most, (FILTERED, REVISED), both)
    chain.show(frame)
    clusters = [text.get_text().split("\n")[0].translate(SUBSCRIPTS) for text in chain._texts]
    widths = [oval.get_linewidth() for oval in chain._ovals]
    flows = [flow for slot in chain._flows for flow in slot]
    sent = {
        flow.text.get_text().translate(SUBSCRIPTS) for flow in flows if flow.arrow.get_visible()
    }
    return clusters, clusters[int(np.argmax(widths))], sent, chain


def test_the_cluster_at_work_is_lit_and_messages_flow():
    clusters, lit, sent, chain = chain_at(Frame(4, False, 4, (0, -1)))
    assert clusters == ["C2", "C3", "C4", "C5", "C6"]
    assert lit == "C4"
    assert sent == {"δ2,3", "δ3,4"}
    faces = [oval.get_facecolor()[:3] for oval in chain._ovals]
    assert faces[0] == faces[1] != faces[2]
    assert faces[3] == faces[4] == to_rgb("white")
    clusters, lit, sent, _ = chain_at(Frame(1, True, T, (1, T)))
    assert clusters == ["C0", "C1", "C2", "C3", "C4"]
    assert lit == "C1"
    assert sent == {"δ0,1", "δ1,2", "δ2,3", "δ3,4", "δ2,1", "δ3,2", "δ4,3"}


def test_a_window_ends_where_the_chain_does():
    assert chain_at(Frame(T, False, T, (0, -1)), 3)[0] == ["C6", "C7", "C8"]
    every = [f"C{k}" for k in range(T + 1)]
    assert chain_at(Frame(0, False, 0, (0, -1)), 40, wide=16)[0] == every
    assert chain_at(Frame(5, False, 5, (0, -1)), 1)[0] == ["C5"]


def test_texts_of_the_chain_lie_in_their_shapes_and_all_in_the_axes():
    for most, frame in ((5, Frame(4, True, T, (4, T))), (3, Frame(T, False, T, (0, -1)))):
        *_, chain = chain_at(frame, most)
        figure = chain._ovals[0].figure
        figure.canvas.draw()
        for oval, text in zip(chain._ovals, chain._texts, strict=True):
            box = text.get_window_extent()
            outer = oval.get_window_extent()
            centre = 0.5 * (outer.p0 + outer.p1)
            for corner in box.corners():
                away = 2.0 * (corner - centre) / (outer.width, outer.height)
                assert np.hypot(*away) < 1.02
        for artist in chain.artists:
            if artist.get_visible():
                box = artist.get_window_extent()
                assert figure.bbox.x0 <= box.x0 <= box.x1 <= figure.bbox.x1
                assert figure.bbox.y0 <= box.y0 <= box.y1 <= figure.bbox.y1


@pytest.mark.parametrize("landmarks", [1, 5, 12])
def test_letters_of_the_chain_are_legible_however_many_variables_a_cluster_has(landmarks):
    graph = pgm.compile(hub(landmarks), steps=30)
    clusters, lit, _, chain = chain_at(Frame(14, True, 30, (14, 30)), graph=graph)
    assert lit == "C14"
    assert len(clusters) >= 3
    flows = [flow.text for slot in chain._flows for flow in slot]
    texts = [*chain._texts, *chain._plates, *flows]
    assert min(text.get_fontsize() for text in texts) >= LEGIBLE
    assert ("\n" in chain._texts[0].get_text()) == (landmarks != 5)  # twelve stand on one line


def paths(kind, ax, truth=None):
    beliefs = SMOOTHED.filtered[x], SMOOTHED[x]
    return Paths(ax, beliefs, kind, ("east", "north"), truth, None, 0.9)


def on_ellipse(points, belief, step):
    away = points - belief.mean[step]
    return (away @ np.linalg.inv(belief.cov[step]) * away).sum(axis=-1)


def test_the_newest_ellipse_is_that_of_the_belief_at_work():
    drawn = paths(Kind(math.inf), plt.subplots()[1])
    level = -2.0 * np.log(1.0 - 0.9)
    drawn.show(Frame(3, False, 3, (4, 3)))
    (ring,) = drawn._filtered._newest.get_paths()
    assert on_ellipse(ring.vertices[:-1], SMOOTHED.filtered[x], 3) == pytest.approx(level)
    assert len(drawn._filtered._past.get_paths()) == 3
    assert len(drawn._filtered._line.get_xdata()) == 4
    assert not drawn._revised._newest.get_paths()
    drawn.show(Frame(3, True, T, (3, T)))
    (ring,) = drawn._revised._newest.get_paths()
    assert on_ellipse(ring.vertices[:-1], SMOOTHED[x], 3) == pytest.approx(level)
    assert drawn._revised._line.get_xydata() == pytest.approx(SMOOTHED[x].mean[3:])
    assert not drawn._filtered._newest.get_paths()
    assert len(drawn._filtered._past.get_paths()) == 3  # those that are not revised
    assert len(drawn._filtered._line.get_xdata()) == T + 1


def test_everything_is_within_the_limits_at_one_scale():
    ax = plt.subplots(figsize=(7, 3))[1]
    truth = DRAWN[x]
    drawn = paths(Kind(math.inf), ax, truth)
    everything = np.concatenate([drawn._filtered.rings, drawn._revised.rings]).reshape(-1, 2)
    low, high = np.transpose([ax.get_xlim(), ax.get_ylim()])
    for points in (everything, truth):
        assert (points > low).all()
        assert (points < high).all()
    units = (high - low) / (ax.bbox.width, ax.bbox.height)
    assert units[0] == pytest.approx(units[1])


def test_an_endless_ellipse_does_not_hide_the_path():
    open_ended = MODEL.replace(prior=[pgm.GaussianCPD(x, [0.0, 0.0], 1e8 * np.eye(2))])
    found = pgm.smooth(open_ended, DRAWN.evidence)
    ax = plt.subplots()[1]
    cov = found.filtered[x].cov.copy()
    cov[0] = np.diag([np.inf, 1.0])
    first = type(found[x])._make((x,), found.filtered[x].mean, cov, found[x].steps)
    drawn = Paths(ax, (first, found[x]), Kind(0), ("east", "north"), None, None, 0.95)
    drawn.show(Frame(0, False, 0, (0, -1)))
    assert np.ptp(ax.get_xlim()) < 100.0


def test_what_is_blitted_is_what_is_drawn():
    """At each picture, and once a writer has changed the size of the figure."""

    def figure_with(canvas):
        figure = Figure(figsize=(5.01, 4.01), dpi=100)
        above, below = figure.add_axes((0.1, 0.4, 0.8, 0.5)), figure.add_axes((0, 0, 1, 0.3))
        run = paths(Kind(math.inf), above)
        chain = Chain(below, SMOOTHED.graph, 5, (FILTERED, REVISED), True)
        canvas(figure, [*run.artists, *chain.artists])

        def saved(frame):
            run.show(frame)
            chain.show(frame)
            into = io.BytesIO()
            figure.savefig(into, format="rgba", dpi=100)
            return np.frombuffer(into.getvalue(), np.uint8).astype(int)

        return figure, saved

    figure, blitted = figure_with(BlittedCanvas)
    for number, frame in enumerate(frames(Kind(math.inf), T, 4)):
        other, whole = figure_with(lambda figure, _: FigureCanvasAgg(figure))
        if number >= 2:
            for each in (figure, other):
                each.set_size_inches(5.0, 4.0)
        # Only the frame of the axes, which is drawn before what changes, not after it, may differ.
        assert (np.abs(blitted(frame) - whole(frame)) > 8).mean() < 0.002


def test_a_smoother_is_written_with_all_its_pictures(tmp_path):
    path = pgm.plot.animate(
        SMOOTHED, tmp_path / "run.gif", truth=DRAWN[x], landmarks=[[1.0, 2.0]], rate=4.0, **SMALL
    )
    assert path == tmp_path / "run.gif"
    with Image.open(path) as picture:
        assert picture.n_frames == 2 * (T + 1)
        assert picture.size == (200, 175)
        durations, pictures = [], []
        for k in range(picture.n_frames):
            picture.seek(k)
            durations.append(picture.info["duration"])
            pictures.append(np.asarray(picture.convert("RGB")).astype(int))
    assert durations == [1000 if k in (T, 2 * T + 1) else 250 for k in range(2 * T + 2)]
    # Vermilion, of the smoother, grows on the way back; in the first pass the legend alone has it.
    red = [np.count_nonzero(np.abs(p - [213, 94, 0]).sum(axis=2) < 30) for p in pictures]
    assert red[: T + 1] == [red[0]] * (T + 1)
    assert red[T + 1] > red[T]
    assert red[-1] > red[T + 1]


def test_a_filter_has_the_forward_pass_alone(tmp_path):
    path = pgm.plot.animate(FILTERED_ALONE, tmp_path / "run.gif", every=2, **SMALL)
    with Image.open(path) as picture:
        assert picture.n_frames == T // 2 + 1


def test_particles_fixed_lags_and_chosen_runs_are_drawn(tmp_path):
    cloud = pgm.smooth(MODEL, DRAWN.evidence, belief=pgm.Particles(300, seed=0))
    lagged = pgm.smooth(MODEL, DRAWN.evidence, lag=2)
    for posterior, given in (
        (cloud, {}),
        (lagged, {}),
        (RUNS, {"run": 2}),
        (RUNS, {"run": (-1,), "components": ("north", "east")}),
    ):
        path = pgm.plot.animate(posterior, tmp_path / "a.gif", every=4, **SMALL, **given)
        assert path.stat().st_size > 1000


def test_no_figure_is_left_open(tmp_path):
    before = plt.get_fignums()
    pgm.plot.animate(FILTERED_ALONE, tmp_path / "run.gif", every=8, **SMALL)
    assert plt.get_fignums() == before


@pytest.mark.skipif(not FFMpegWriter.isAvailable(), reason="the program ffmpeg is not here")
def test_an_mp4_is_written_where_ffmpeg_is(tmp_path):
    # A film has even numbers of pixels; the size asked for has not.
    path = pgm.plot.animate(SMOOTHED, tmp_path / "run.mp4", every=4, figsize=(4.02, 3.51), dpi=50)
    assert path.read_bytes()[4:8] == b"ftyp"


def test_an_mp4_without_ffmpeg_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(FFMpegWriter, "isAvailable", classmethod(lambda cls: False))
    with pytest.raises(ModelError, match=r"'run\.mp4' needs the program ffmpeg.*write a \.gif"):
        pgm.plot.animate(SMOOTHED, tmp_path / "run.mp4")
    assert not list(tmp_path.iterdir())


GRID = pgm.filter(
    MODEL, {}, steps=2, belief=pgm.Grid({"east": (-4.0, 9.0, 13), "north": (-4.0, 8.0, 12)})
)


@pytest.mark.parametrize(
    ("posterior", "name", "given", "told"),
    [
        (SMOOTHED[x], "a.gif", {}, "not a Gaussian; beliefs of cells.*animate_beliefs"),
        (GRID, "a.gif", {}, r"not Posterior\(.*cells.*; beliefs of cells"),
        (SMOOTHED, "a.avi", {}, r"'a\.avi' is no moving picture.*ends in \.gif"),
        (SMOOTHED, "a.gif", {"rate": 0}, "rate is a number of pictures a second"),
        (SMOOTHED, "a.gif", {"clusters": 0}, "clusters is a whole number, 1 or more, not 0"),
        (SMOOTHED, "a.gif", {"every": 1.5}, "every is a whole number, 1 or more, not 1.5"),
        (SMOOTHED, "a.gif", {"variable": y}, r"variable=y is no state; the model has \[x\]"),
        (SMOOTHED, "a.gif", {"confidence": 95}, "a confidence lies between 0 and 1"),
        (SMOOTHED, "a.gif", {"components": ("east", "up")}, "no single component 'up'"),
        (
            SMOOTHED,
            "a.gif",
            {"truth": DRAWN[x][:3]},
            r"the truth has 3 rows; one for each of the 9",
        ),
        (SMOOTHED, "a.gif", {"truth": [1.0]}, "the truth has shape"),
        (SMOOTHED, "a.gif", {"landmarks": [1.0]}, r"landmarks have shape \(1,\)"),
        (RUNS, "a.gif", {}, r"leading axes \(3,\), of runs; choose one, as with run=0"),
        (RUNS, "a.gif", {"run": 3}, r"run=3 is none of the runs, whose axes are \(3,\)"),
        (SMOOTHED, "a.gif", {"run": 0}, r"run=0 is none of the runs, whose axes are \(\)"),
    ],
)
def test_what_does_not_fit_is_refused(posterior, name, given, told, tmp_path):
    with pytest.raises(ModelError, match=told):
        pgm.plot.animate(posterior, tmp_path / name, **given)
    assert not list(tmp_path.iterdir())


def test_a_tree_and_a_state_of_one_component_are_refused(tmp_path):
    graph = pgm.compile(MODEL, steps=T, method=pgm.Balanced())
    tree = pgm.infer(graph, DRAWN.evidence)
    with pytest.raises(ModelError, match=r"balanced tree.*leave method=pgm\.Balanced\(\) out"):
        pgm.plot.animate(tree, tmp_path / "a.gif")
    walk = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(bias, 0.0, 1.0)],
        [pgm.LinearGaussianCPD(bias, {bias.previous: 1.0}, cov=1.0)],
    )
    with pytest.raises(ModelError, match=r"\[bias\] have one each: draw these with pgm\.plot\.err"):
        pgm.plot.animate(pgm.filter(walk, {}, steps=2), tmp_path / "a.gif")


@pytest.mark.parametrize("steps", [0, 1])
def test_ellipses_of_hardly_any_path_lie_within_the_plane(steps):
    posterior = pgm.smooth(MODEL, MODEL.sample({}, steps=steps, rng=0).evidence)
    ax = Figure().add_subplot()
    both = posterior[x], posterior[x]
    rings = Paths(ax, both, posterior.kind, x.components, None, None, 0.95)._filtered.rings
    smallest = rings[np.ptp(rings, axis=1).max(axis=1).argmin()]
    for limits, along in zip((ax.get_xlim(), ax.get_ylim()), smallest.T, strict=True):
        assert limits[0] < along.min() < along.max() < limits[1]
