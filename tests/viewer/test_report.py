"""Reports: sections by the numbers of a textbook, what is left out, the page in a browser."""

import json
import re

import numpy as np
import pytest
from viewer import posteriors
from viewer.test_page import data_of, numbers_of

import pgm


def written(posterior, tmp_path, truth=None):
    page = posterior.report(tmp_path / "report.html", truth=truth)
    assert page == tmp_path / "report.html"
    return page.read_text("utf-8")


def sections_of(page):
    return {section["title"]: section for section in data_of(page)["sections"]}


def row_of(section, table=0):
    sheet = section["tables"][table]
    return dict(zip(sheet["heads"], sheet["rows"][0], strict=True))


def column(page, ref):
    return numbers_of(page)[ref["at"] :][: ref["rows"]]


def misled():
    """A drive of which some ranges are 6 m too long."""
    due = posteriors.drive(60)
    seen = due[posteriors.z]
    values = np.array(seen.values)
    values[15:30, 0] += 6.0
    sightings = pgm.sightings(values, step=seen.step, given=seen.given)
    return pgm.filter(
        posteriors.robot(), {posteriors.u: due[posteriors.u], posteriors.z: sightings}
    )


def test_innovations_and_errors_are_those_of_a_textbook(tmp_path):
    """A scalar walk, filtered in ten lines: its NIS and NEES, and their χ² bands."""
    from scipy.stats import chi2

    a, b = pgm.variables("a b")
    model = pgm.DynamicBayesianNetwork(
        prior=[pgm.GaussianCPD(a, 0.0, 1.0)],
        transition=[pgm.LinearGaussianCPD(a, given={a.previous: 1.0}, cov=0.5)],
        observation=[pgm.LinearGaussianCPD(b, given={a: 1.0}, cov=0.3)],
    )
    drawn = model.sample(steps=30, rng=4)
    page = written(pgm.filter(model, drawn.evidence), tmp_path, drawn)
    mean, var, nis, nees = 0.0, 1.0, [], [drawn[a][0, 0] ** 2]
    for true, read in zip(drawn[a][1:, 0], drawn[b][:, 0], strict=True):
        var += 0.5
        off, total = read - mean, var + 0.3
        nis.append(off**2 / total)
        mean, var = mean + var / total * off, var * 0.3 / total
        nees.append((true - mean) ** 2 / var)
    found = sections_of(page)
    sensors, truth = found["Sensors, by their innovations"], found["Against the truth"]
    np.testing.assert_allclose(column(page, sensors["curves"][0]["values"]), nis, rtol=1e-8)
    np.testing.assert_allclose(column(page, sensors["curves"][0]["steps"]), np.arange(1, 31))
    np.testing.assert_allclose(column(page, truth["curves"][0]["values"]), nees, rtol=1e-8)
    np.testing.assert_allclose(
        column(page, truth["curves"][0]["high"]), chi2.ppf(0.995, 1), rtol=1e-8
    )
    row = row_of(sensors)
    assert float(row["NIS a component"]) == pytest.approx(np.mean(nis), rel=5e-3)
    low, high = (float(end) for end in row["band, 99 %"].split(" to "))
    assert (low, high) == pytest.approx(chi2.ppf([0.005, 0.995], 30) / 30, rel=5e-3)
    row = row_of(truth)
    assert float(row["NEES a component"]) == pytest.approx(np.mean(nees), rel=5e-3)
    inside = np.mean(np.array(nees) < chi2.ppf(0.95, 1))
    assert row["in 95 % regions"] == f"{100 * inside:.0f} %"


def test_lost_stretches_and_the_sensor_outside_its_band(tmp_path):
    posterior = misled()
    (stretch,) = posterior.lost.stretches
    page = written(posterior, tmp_path)
    found = sections_of(page)
    assert found["Lost stretches"]["state"] == "look"
    assert row_of(found["Lost stretches"])["steps"] == f"{stretch.first}..{stretch.last}"
    sensors = found["Sensors, by their innovations"]
    assert sensors["state"] == "look"
    assert "1 above the band" in sensors["told"]
    assert sensors["curves"][0]["marked"] == [[stretch.first, stretch.last]]
    assert data_of(page)["chain"]["runs"][0]["lost"] == [[stretch.first, stretch.last]]
    assert found["Against the truth"]["state"] == "unknown"


def test_a_schedule_that_has_not_settled_is_to_be_looked_at(tmp_path):
    posterior = posteriors.smoothed()
    page = written(posterior, tmp_path)
    section = sections_of(page)["Convergence"]
    assert (section["state"], section["told"][:28]) == ("look", "not converged in 3 iteration")
    np.testing.assert_allclose(
        column(page, section["curves"][0]["values"]), posterior.status.residuals, rtol=1e-8
    )
    settled = pgm.smooth(posteriors.robot(), posteriors.drive(), iterations=30)
    assert sections_of(written(settled, tmp_path))["Convergence"]["state"] == "right"
    once = sections_of(written(posteriors.filtered(), tmp_path))["Convergence"]
    assert (once["state"], once["curves"]) == ("unknown", [])


def test_digits_that_rounding_leaves(tmp_path):
    a, b = pgm.variables("a b")
    model = pgm.DynamicBayesianNetwork(
        prior=[pgm.GaussianCPD(a, 0.0, 1e16)],
        transition=[pgm.LinearGaussianCPD(a, given={a.previous: 1.0}, cov=1e-8)],
        observation=[pgm.LinearGaussianCPD(b, given={a: 1.0}, cov=1e-4)],
    )
    posterior = pgm.smooth(model, {b: np.full((5, 1), 1e7)})
    section = sections_of(written(posterior, tmp_path))["Numerical digits"]
    assert posterior.status.digits is not None
    assert f"leaves {float(posterior.status.digits):.1f} decimal digits" in section["told"]


LOST, LINES = "Lost stretches", "Linearisation"
SENSORS = "Sensors, by their innovations"


def kept():
    return pgm.smooth(posteriors.robot(), posteriors.drive(), keep=[posteriors.x])


def estimated():
    """The estimate of a short drive: a mixture of modes, of which innovations are not told."""
    return pgm.estimate(posteriors.robot(), posteriors.drive(4))


@pytest.mark.parametrize(
    ("made", "known", "unknown"),
    [
        (posteriors.days, ["Convergence"], [LOST, SENSORS]),
        (posteriors.tree, ["Convergence"], [SENSORS]),
        (posteriors.lattice, ["Convergence", "Numerical digits"], [LINES, SENSORS]),
        *(
            (
                made,
                [*first, "Figures of the beliefs"],
                ["Convergence", "Numerical digits", LOST, LINES, SENSORS],
            )
            for made, first in (
                (posteriors.particles, []),
                (posteriors.grid, []),
                (estimated, ["Verdict"]),
            )
        ),
        (kept, ["Convergence", "Numerical digits"], [LOST, LINES, SENSORS]),
    ],
)
def test_what_a_family_has_no_answer_to_is_said(made, known, unknown, tmp_path):
    posterior = made()
    page = written(posterior, tmp_path)
    found = sections_of(page)
    assert list(found) == [*known, *unknown, "Against the truth"]
    for title in unknown:
        assert found[title]["state"] == "unknown"
        assert found[title]["told"].startswith("not known: ")
    with pytest.raises(pgm.EvidenceError) as refused:
        _ = posterior.innovations
    assert found[SENSORS]["told"] == f"not known: {refused.value}"
    assert (data_of(page)["chain"] is None) == (made in (posteriors.tree, posteriors.lattice))


def test_where_no_line_is_right_is_to_be_looked_at(tmp_path):
    """As a summary says it; of an iterated smoother lines are right, of a linear model none."""
    from pgm.examples import squares, walk, z

    once = pgm.filter(squares, {z: [[9.0], [4.0]]})
    section = sections_of(written(once, tmp_path))[LINES]
    assert section["state"] == "look"
    assert section["told"] == (
        "linearised where no line is right: z at 2 of 2; smooth with iterations=, or try "
        "pgm.estimate"
    )
    assert section["told"] in " ".join(repr(once).split())
    row = row_of(section)
    assert (row["CPD of"], row["known"], row["above 0.5"]) == ("z", "2", "2")
    assert float(row["most"]) == pytest.approx(once.nonlinearity[z].max(), rel=5e-3)
    settled = pgm.smooth(squares, {z: [[9.0], [4.0]]}, iterations=20)
    assert sections_of(written(settled, tmp_path))[LINES]["state"] == "right"
    linear = sections_of(written(pgm.filter(walk, {z: [[9.0]]}), tmp_path))[LINES]
    assert (linear["state"], linear["told"]) == ("right", "nothing was linearised")


def test_states_are_judged_by_the_probability_of_the_true_ones(tmp_path):
    states = [0, 1, 1, 1, 2, -1, 2, 0, 0]
    posterior = posteriors.days()
    page = written(posterior, tmp_path, {posteriors.weather: states})
    own = [posterior[posteriors.weather].values[k, s] for k, s in enumerate(states) if s >= 0]
    row = row_of(sections_of(page)["Against the truth"])
    assert row["known"] == "8"
    assert float(row["probability of the true state"]) == pytest.approx(np.mean(own), rel=5e-3)
    assert float(row["−ln of it, mean"]) == pytest.approx(-np.log(own).mean(), rel=5e-3)


def test_errors_without_a_scale_are_told_in_words(tmp_path):
    """A static state that is known exactly has no NEES."""
    a, b = pgm.variables("a b")
    model = pgm.DynamicBayesianNetwork(
        prior=[pgm.GaussianCPD(a, 0.0, 0.0)],
        transition=[pgm.LinearGaussianCPD(a, given={a.previous: 1.0}, cov=0.0)],
        observation=[pgm.LinearGaussianCPD(b, given={a: 1.0}, cov=0.5)],
    )
    posterior = pgm.smooth(model, {b: np.zeros((4, 1))})
    section = sections_of(written(posterior, tmp_path, {a: np.zeros((5, 1))}))["Against the truth"]
    assert section["state"] == "unknown"
    assert "an error has no scale" in section["words"][0]


def test_truths_of_which_parts_are_known(tmp_path):
    """A recording's truth has places and no heading; of a network without time it has evidence."""
    drawn, posterior = posteriors.simulated()
    true = np.array(drawn[posteriors.x])
    true[:, 2] = np.nan
    row = row_of(
        sections_of(written(posterior, tmp_path, {posteriors.x: true}))["Against the truth"]
    )
    off = posterior[posteriors.x].mean[:, :2] - true[:, :2]
    rms = np.sqrt(np.mean(off**2, axis=0))
    assert row["RMSE"] == f"east {rms[0]:.3g}, north {rms[1]:.3g}"
    a, b = pgm.variables("a b")
    net = pgm.BayesianNetwork(
        [pgm.GaussianCPD(a, 0.0, 1.0), pgm.LinearGaussianCPD(b, {a: 1.0}, cov=1.0)]
    )
    drawn = net.sample(50, rng=0)
    section = sections_of(written(pgm.infer(pgm.compile(net), {b: drawn[b]}), tmp_path, drawn))[
        "Against the truth"
    ]
    assert [row[0] for row in section["tables"][0]["rows"]] == ["a"]
    nees = (drawn[a] - 0.5 * drawn[b]) ** 2 / 0.5
    assert float(row_of(section)["NEES a component"]) == pytest.approx(nees.mean(), rel=5e-3)
    assert "observed" not in " ".join(section["words"])


def test_the_verdict_of_an_estimate_stands_first(tmp_path):
    """Of a product of two unknowns from few starts, which do not agree; and of an exact answer."""
    a, b, y = pgm.variables("a b y")
    product = pgm.NonlinearGaussianCPD(y, (a, b), lambda a, b: a * b, cov=0.1)
    net = pgm.BayesianNetwork([pgm.GaussianCPD(a, 0.0, 1.0), pgm.GaussianCPD(b, 0.0, 1.0), product])
    posterior = pgm.estimate(net, {y: [[0.7], [0.2]]})
    page = written(posterior, tmp_path, {a: [1.0]})
    section = data_of(page)["sections"][0]
    assert section["title"] == "Verdict"
    assert section["told"] == posterior.verdict.headline
    assert section["state"] == ("right" if posterior.verdict.vouched.all() else "look")
    assert section["words"][-1].startswith("cost: ")
    assert data_of(page)["chain"] is None
    linear = net.replace(pgm.LinearGaussianCPD(y, {a: 1.0, b: 1.0}, cov=0.1))
    exact = sections_of(written(pgm.estimate(linear, {y: [0.7]}), tmp_path))["Verdict"]
    assert (exact["state"], exact["told"]) == ("right", "vouched for: exact")
    assert "Verdict" not in sections_of(written(posteriors.batch(), tmp_path))


def test_a_truth_that_does_not_fit_leaves_no_page(tmp_path):
    with pytest.raises(pgm.GraphError, match="was due"):
        written(posteriors.filtered(), tmp_path, {posteriors.x: np.zeros((3, 3))})
    assert not list(tmp_path.iterdir())


def test_a_page_asks_for_nothing_and_is_small(tmp_path):
    posterior = pgm.smooth(posteriors.robot(), posteriors.drive(2_000))
    page = written(posterior, tmp_path)
    assert not re.search(r"https?:", page.replace("http://www.w3.org/2000/svg", ""))
    assert len(page) < 600_000
    assert len(re.findall("<script", page)) == 3
    assert set(data_of(page)["chain"]["runs"][0]["arrays"]) == {"mean", "cov", "there.mean"}
    json.dumps(data_of(page), allow_nan=False)


def test_a_report_in_a_browser(browser, tmp_path):
    drawn, posterior = posteriors.simulated()
    browser.open(posterior.report(tmp_path / "report.html", truth=drawn))
    assert browser.complaints() == []
    rows = browser.run(
        "return [...document.querySelectorAll('#glance tr')].map((r) => r.innerText)"
    )
    assert len(rows) == len(browser.all("#sections section")) == 6
    assert "never lost" in rows[2]
    assert browser.all("#sections figure path.value")
    assert "truth" in browser.text("#path .legend")
    assert "lost" not in browser.text("#path .legend")
    browser.pick("#path select", 1)
    assert "over time" in browser.one("#path canvas").get_attribute("aria-label")
    assert browser.run("return document.documentElement.scrollWidth <= window.innerWidth")
    browser.open(misled().report(tmp_path / "report.html"))
    assert browser.all("#sections rect.lost")
    assert "lost" in browser.text("#path .legend")
    assert len(browser.all("#glance .look")) == 2
    browser.open(posteriors.batch().report(tmp_path / "report.html"))
    browser.pick("#run", 3)
    browser.open(posteriors.hostile().report(tmp_path / "report.html"))
    assert browser.run("return window.hacked") is None
    assert browser.complaints() == []
