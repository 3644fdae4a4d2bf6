"""The wheeled robot's problems: what was declared, what was found, and what was drawn."""

import json
from contextlib import contextmanager

import numpy as np
import pytest
from matplotlib.collections import EllipseCollection
from numpy.testing import assert_allclose
from PIL import Image

import pgm
from experiments import differential_drive
from experiments.differential_drive import animation, page
from experiments.differential_drive.animation import EVERY
from experiments.differential_drive.errors import about_landmark
from experiments.differential_drive.figures import RINGS, drive_figure
from experiments.differential_drive.particles import follow
from experiments.differential_drive.problems import DT, NOISE, deviations, loop, problems
from experiments.differential_drive.results import held_noise, solve, spread
from experiments.record import Record
from models.networks import pose, wheels
from models.sensors import range_bearing
from pgm import consistency


@pytest.fixture(scope="module", params=[pytest.param("quick", marks=pytest.mark.slow)])
def done(tmp_path_factory):
    out = tmp_path_factory.mktemp("differential_drive")
    with pytest.MonkeyPatch.context() as patched:
        for name in ("2a", "2b"):  # pictures take long to draw
            patched.setitem(EVERY, name, 12)
        differential_drive.run(out=out, seed=0, **differential_drive.QUICK)
    return out, json.loads((out / "summary.json").read_text())


@pytest.fixture(scope="module")
def linear():
    """Problem 1 for 20 s, in 200 runs."""
    return solve(problems("deviation", 20)["1"], 200, np.random.default_rng(1))


def test_the_kalman_filter_is_the_textbook_s(linear):
    """The axes are independent: a scalar filter each, its readings scaled by 1 and by 2."""
    std, row = deviations("deviation"), 3
    filtered = linear.posteriors["exact"].filtered[linear.problem.state]
    readings = linear.evidence[linear.problem.reading].values[row]
    for axis, (w, r, scale) in enumerate(
        [(std["w_x"], std["r_x"], 1.0), (std["w_y"], std["r_y"], 2.0)]
    ):
        mean = var = 0.0
        for t in range(1, 161):
            mean, var = mean + 0.01 / 8, var + w**2 / 8
            if t % 8 == 0:
                gain = var * scale / (scale**2 * var + r**2)
                mean += gain * (readings[t // 8 - 1, axis] - scale * mean)
                var *= 1.0 - gain * scale
            assert filtered.mean[row, t, axis] == pytest.approx(mean, abs=1e-12)
            assert filtered.cov[row, t, axis, axis] == pytest.approx(var, abs=1e-14)


def test_a_deviation_is_the_square_root_of_a_variance():
    assert deviations("deviation") == NOISE
    assert {k: v**2 for k, v in deviations("variance").items()} == pytest.approx(NOISE)


def test_white_noise_grows_with_the_root_of_the_step():
    """After a second, unmeasured, the variances are w² · 1 s, not w² / 8."""
    for problem in problems("deviation", 2).values():
        belief = pgm.filter(problem.network, problem.sample(2, np.random.default_rng(0))[1])
        cov = belief.predicted[problem.state].cov[0, 8]
        assert not belief.predicted[problem.state].cov[0, 0].any()
        added = np.diagonal(cov)[:2] - [0.1**2, 0.15**2]
        # In problem 2 the heading's noise adds a little, across the way of 2 m.
        assert_allclose(added, 0.0, atol=1e-12 if problem.name == "1" else (2.0 * 0.01) ** 2)


def test_the_loop_is_a_circle_about_the_landmark():
    problem = problems("deviation", 48)["2b"]
    drive, x = problem.network.transition[0].function, np.array([[0.0, 0.0, -np.pi / 4]])
    distance, bearing = [], []
    for u in loop(360):
        x = drive(x, u[None])
        r, beta = range_bearing(x, np.array([[10.0, 10.0]]))[0]
        distance.append(r)
        bearing.append(beta)
    assert_allclose(distance, np.sqrt(200.0), rtol=1e-9)
    assert_allclose(bearing, np.pi / 2, atol=1e-9)
    assert 2 * np.pi < x[0, 2] + np.pi / 4 < 2.1 * np.pi  # once round, in 45 s


def test_ten_seconds_of_slow_wheels_are_a_tenth_of_a_metre_on_both_axes():
    problem = problems("deviation", 100)["1"]
    belief = pgm.filter(problem.network, {wheels: problem.controls})[problem.state]
    assert_allclose(belief.mean[80], [0.1, 0.1], rtol=1e-12)
    assert_allclose(belief.mean[-1], [1.0, 1.0], rtol=1e-12)
    assert not belief.cov[0].any()


def test_the_linear_problem_is_consistent(linear):
    low, high = consistency.mean_band(2, 200)
    for values in linear.nees().values():
        assert ((low < values) & (values < high)).mean() > 0.95
    for kind in ("filter", "smoother"):
        assert linear.numbers()["exact"][kind]["inside"] > 0.95


def test_noise_taken_for_held_is_found_out(linear):
    """Its covariance is 8 times too small between readings: a NEES far above its band."""
    held, right = held_noise(linear, "deviation"), linear.numbers()["exact"]["filter"]
    assert held["nees"] > 3.0 * right["nees"]
    assert held["inside"] < 0.1
    assert held["rmse"] > right["rmse"]


def test_particles_tend_to_the_kalman_filter(linear):
    """With 3000 of them the means agree within their own sampling error, a run's worth of them."""
    readings = linear.evidence[linear.problem.reading].values[:4]
    kalman = linear.posteriors["exact"].filtered[linear.problem.state].mean[:4]
    away = {}
    for count in (100, 3000):
        means = follow(linear.problem, readings, pgm.Particles(count, seed=2)).mean
        away[count] = np.sqrt(np.mean((means - kalman) ** 2))
    assert away[3000] < 0.01
    assert 3.0 < away[100] / away[3000] < 10.0  # √30 = 5.5


def test_particles_are_worse_than_the_kalman_filter(done):
    found = done[1]["particles"]
    rmse = [each["rmse"] for each in found["particles"].values()]
    assert list(found["particles"]) == ["30", "100", "300"]
    assert rmse[0] > rmse[1] > rmse[2]
    assert rmse[1] > found["kalman"]
    for count in ("30", "100"):
        each = found["particles"][count]
        assert each["excess"] > 3.0 * each["excess_se"] > 0.0
        assert each["worse"] > 0.5
    # The excess of 300 is a third of that of 100, hardly above what 200 short drives can tell.
    many = found["particles"]["300"]
    assert abs(many["excess"]) < 0.5 * found["particles"]["100"]["excess"]
    assert many["excess"] > -3.0 * many["excess_se"]


def test_smoothers_beat_filters(done):
    """Where readings tell the whole state."""
    for problems_found in done[1]["results"].values():
        for name in ("1", "2a"):
            for both in problems_found[name].values():
                assert both["smoother"]["rmse"] < both["filter"]["rmse"]


def test_problem_2_s_estimators_agree_at_mild_noise(done):
    found = done[1]["results"]["deviation"]
    for name in ("2a", "2b"):
        taylor, unscented = (found[name][rule]["filter"] for rule in ("Taylor", "Unscented"))
        assert taylor["rmse"] == pytest.approx(unscented["rmse"], rel=0.02)
        assert 2.0 < unscented["nees"] < 4.0
        assert unscented["inside"] > 0.8


@pytest.mark.parametrize("meaning", ["deviation", "variance"])
def test_the_circle_about_the_landmark_is_not_seen(meaning, done):
    """Along it the deviation grows all the time; towards the landmark readings hold it."""
    each = spread(solve(problems(meaning, 30)["2b"], 10, np.random.default_rng(0)))
    assert each["second"] == list(range(1, 31))
    tangential, radial = np.array(each["tangential"]), np.array(each["radial"])
    assert (np.diff(tangential) > 0.0).all()
    assert tangential[-1] > 4.0 * radial[-1]
    assert radial[-1] < 1.3 * radial[5]
    assert done[1]["about_landmark"][meaning]["second"] == [1, 2, 3, 4]


def test_deviations_about_the_landmark():
    """North-west of it, the way there is south-east: (1, −1)/√2."""
    cov = np.zeros((3, 3))
    cov[:2, :2] = [[5.0, -4.0], [-4.0, 5.0]]  # 9 along (1, −1)/√2, 1 along (1, 1)/√2
    radial, tangential = about_landmark(pgm.Gaussian(pose, [7.0, 13.0, 0.3], cov))
    assert (float(radial), float(tangential)) == pytest.approx((3.0, 1.0))


@pytest.mark.parametrize("name", ["1", "2b"])
def test_two_seconds_have_an_ellipse_at_every_motion_and_at_every_reading(name):
    problem = problems("deviation", 6)[name]
    drive = solve(problem, 2, np.random.default_rng(0)).drive()
    assert _ellipses(drive_figure(drive)) == [[6], [17, 3], [], []]
    assert (problem.steps, len(problem.measured)) == (48, 6)
    assert_allclose(problem.measured * DT, np.arange(1, 7))


def test_a_long_drive_has_few_ellipses():
    """At 800 motions and 100 readings none could be told from another."""
    problem = problems("deviation", 100)["1"]
    drive = solve(problem, 2, np.random.default_rng(0)).drive()
    assert (problem.steps, len(problem.measured)) == (800, 100)
    assert _ellipses(drive_figure(drive)) == [[RINGS], [17, 3], [], []]


def test_errors_stand_in_the_filters_band():
    drive = solve(problems("deviation", 6)["2b"], 2, np.random.default_rng(0)).drive()
    _, _, *below = drive_figure(drive).axes
    for k, ax in enumerate(below):
        filtered, smoothed = (line.get_ydata() for line in ax.lines[:2])
        assert_allclose(filtered, drive.filtered.mean[:, k] - drive.truth[:, k])
        assert_allclose(smoothed, drive.smoothed.mean[:, k] - drive.truth[:, k])
        band = ax.collections[0].get_paths()[0].vertices[:, 1]
        assert band.max() == pytest.approx(1.96 * drive.filtered.std[:, k].max(), rel=1e-3)
        assert ax.get_ylabel().endswith("[m]")


def _ellipses(figure):
    return [
        [len(c.get_offsets()) for c in ax.collections if isinstance(c, EllipseCollection)]
        for ax in figure.axes
    ]


def test_pictures_have_whole_titles_and_particles_beside_the_kalman_filter(monkeypatch, tmp_path):
    solved = solve(problems("deviation", 5)["2b"], 2, np.random.default_rng(0))
    drive, cloud = solved.drive(1), solved.cloud(50, 1)
    seen = []

    class Looking:
        """In place of a writer: what is in a picture, and whether its texts are inside."""

        def __init__(self, fps):
            pass

        @contextmanager
        def saving(self, figure, path, dpi):
            self.figure = figure
            yield

        def grab_frame(self):
            self.figure.canvas.draw()
            whole = self.figure.bbox
            for ax in self.figure.axes:
                box = ax.title.get_window_extent()
                assert ax.get_title()
                assert whole.y0 <= box.y0 < box.y1 <= whole.y1
                assert whole.x0 <= box.x0 < box.x1 <= whole.x1
            seen.append({line.get_label(): line for line in self.figure.axes[1].lines})

    monkeypatch.setattr(animation, "GifWriter", Looking)
    assert animation.animate(drive, cloud, tmp_path / "a.gif") == len(seen)
    last, step = seen[-1], EVERY["2b"] * (len(seen) - 1)
    assert_allclose(last["50 particles"].get_xydata(), cloud.states[step, :, :2])
    assert_allclose(last["particles' mean"].get_xydata(), cloud.mean[: step + 1, :2])
    assert_allclose(last["Kalman filter"].get_xydata(), drive.filtered.mean[: step + 1, :2])


def test_a_cloud_of_particles_is_the_belief_of_its_drive(linear):
    """With 3000 of them within their sampling error, as equally weighted draws."""
    cloud, drive = linear.cloud(3000, 5), linear.drive(5)
    off = np.abs(cloud.states.mean(axis=1) - drive.filtered.mean)
    assert (off <= 0.3 * drive.filtered.std).all()
    assert cloud.states.shape == (161, 3000, 2)
    assert np.abs(cloud.mean - drive.filtered.mean).max() < 0.03


@pytest.mark.parametrize("name", ["1", "2a", "2b"])
def test_pictures_are_by_turns_of_a_motion_and_of_a_reading(name):
    problem = problems("deviation", 100)[name]
    steps = np.arange(0, problem.steps + 1, EVERY[name])
    assert steps[-1] == problem.steps
    assert 40 < len(steps) < 100
    assert list(np.isin(steps[1:], problem.measured)) == [False, True] * (len(steps) // 2)
    assert set(steps[1::2] % 8) == {4}


def test_every_problem_has_an_animation_that_says_what_it_skips(done):
    out, summary = done
    assert summary["pictures"] == {"problem_1.gif": 2, "problem_2a.gif": 3, "problem_2b.gif": 3}
    captions = {part["figure"]: part["caption"] for part in summary["page"] if "figure" in part}
    for name, skipped in (
        ("1", "every 20 motions (2.5 s), which skips the 19"),
        ("2a", "every 12 motions (1.5 s), which skips the 11"),
    ):
        assert skipped in captions[f"problem_{name}.gif"]
    for file, count in summary["pictures"].items():
        with Image.open(out / file) as picture:
            assert picture.format == "GIF"
            assert picture.n_frames == count
            first = np.asarray(picture.convert("RGB"), dtype=int)
            picture.seek(count - 1)
            assert np.abs(np.asarray(picture.convert("RGB"), dtype=int) - first).max() > 100
        # At full length 41 to 97 pictures, and at most 1.5 MB.
        assert (out / file).stat().st_size < 15_000 * count + 60_000


def test_the_page_shows_everything(done):
    out, summary = done
    files = [part["figure"] for part in summary["page"] if "figure" in part]
    assert files == [
        "problem_1.png",
        "problem_2a.png",
        "problem_2b.png",
        "nees.png",
        "problem_1.gif",
        "problem_2a.gif",
        "problem_2b.gif",
    ]
    assert all((out / file).stat().st_size > 1000 for file in files)
    text = " ".join(part["note"] for part in summary["page"] if "note" in part)
    assert all(f"{name} {value:g}" in text for name, value in NOISE.items())
    assert "√T" in text
    held, right = summary["held_noise"], summary["results"]["deviation"]["1"]["exact"]["filter"]
    assert f"a NEES of {held['nees']:.1f} where {right['nees']:.2f} is right" in text
    assert f"of {held['rmse']:.3f} m in place of {right['rmse']:.3f} m" in text
    for n in ("2", "3"):
        assert "{:.2f} to {:.2f} in problem".format(*summary["bands"][n]) in text
    assert summary["settings"]["table"] == NOISE


def test_the_tables_have_the_numbers_of_the_summary(done):
    summary = done[1]
    tables = [part for part in summary["page"] if "table" in part]
    for (meaning, problems_found), table in zip(
        summary["results"].items(), tables[:2], strict=True
    ):
        assert f"read as {meaning}s" in table["table"]
        rows = {tuple(row[:3]): row[3:] for row in table["rows"]}
        assert len(rows) == len(table["rows"]) == 10
        for (problem, rule, kind), cells in rows.items():
            each = problems_found[problem][rule][kind]
            assert cells == [
                f"{each['rmse']:.3f}",
                f"{each['rmse_heading']:.3f}" if problem != "1" else "",
                f"{each['nees']:.2f}",
                f"{each['nees_last']:.2f}",
                f"{each['inside']:.0%}",
            ]
    particles = summary["particles"]
    kalman, *others = tables[2]["rows"]
    assert kalman == ["Kalman", f"{particles['kalman']:.4f}", "", "", ""]
    assert [row[0] for row in others] == list(particles["particles"])
    for count, *cells in others:
        each = particles["particles"][count]
        assert cells == [
            f"{each['rmse']:.4f}",
            f"{each['excess']:.2e}",
            f"{each['excess_se']:.1e}",
            f"{each['worse']:.0%}",
        ]


def notes(record):
    found = json.loads(record.summary().read_text())["page"]
    return " ".join(part["note"] for part in found if "note" in part)


def test_findings_quote_the_right_numbers(tmp_path):
    """Hand-made, all different: of variances and problem 2b, but for problem 1's as drawn."""
    numbers = iter(range(10, 1000))
    keys = ("rmse", "rmse_heading", "nees", "nees_last", "inside")
    found = {
        meaning: {
            problem: {
                rule: {
                    kind: {key: float(next(numbers)) for key in keys}
                    for kind in ("filter", "smoother")
                }
                for rule in (("exact",) if problem == "1" else ("Taylor", "Unscented"))
            }
            for problem in ("1", "2a", "2b")
        }
        for meaning in ("deviation", "variance")
    }
    around = {
        "deviation": {"radial": [1.0, 2.0], "tangential": [3.0, 4.0]},
        "variance": {"radial": [5.0, 6.0], "tangential": [7.0, 8.0]},
    }
    record = Record("findings", tmp_path, seed=0)
    page.note_findings(record, found, "deviation", {"nees": 0.5, "rmse": 0.25}, around)
    text = notes(record)
    right = found["deviation"]["1"]["exact"]["filter"]
    taylor, unscented = (found["variance"]["2b"][rule] for rule in ("Taylor", "Unscented"))
    for quoted in (
        f"a NEES of 0.5 where {right['nees']:.2f} is right",
        f"of 0.250 m in place of {right['rmse']:.3f} m",
        "4.00 m along the circle and 2.00 m towards the landmark, with deviations",
        "8.00 m along the circle and 6.00 m towards the landmark, with variances",
        f"{taylor['filter']['nees_last']:.1f} with Taylor",
        f"{unscented['filter']['nees_last']:.1f} with the unscented rule",
        f"{taylor['filter']['nees']:.1f} and {unscented['filter']['nees']:.1f} for filters",
        f"{taylor['smoother']['nees']:.1f} and {unscented['smoother']['nees']:.1f} for smoothers",
    ):
        assert quoted in text


@pytest.mark.parametrize(
    ("excess", "says"),
    [
        ((0.3, 0.3), "above 0 by more than two of them with 30, 100 particles."),
        ((0.3, 0.1), "above 0 by more than two of them with 30 particles."),
        ((-0.1, 0.1), "within two of them of 0."),
        (
            (-0.3, 0.3),
            "above 0 by more than two of them with 100 particles, "
            "below 0 by more than two of them with 30 particles.",
        ),
    ],
)
def test_the_note_on_particles_says_what_was_found(excess, says, tmp_path):
    found = {
        count: {"rmse": 1.0, "excess": value, "excess_se": 0.1, "worse": 0.5}
        for count, value in zip(("30", "100"), excess, strict=True)
    }
    record = Record("particles", tmp_path, seed=0)
    page.tabulate_particles(record, {"kalman": 1.0, "drives": 9, "particles": found})
    assert notes(record).endswith(f"here it is {says}")
