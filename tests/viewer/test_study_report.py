"""The page of a study: its tables and charts are the study's, and a browser draws them."""

import re

import numpy as np
import pytest
from viewer.test_page import data_of
from viewer.test_report import column, sections_of

import pgm
from pgm.examples import squares, walk, x, z


def lost():
    """Filters that follow x² to the wrong side, and fail where x is far out."""

    def slope(x):
        return np.where(x > 4.0, np.nan, 2.0 * x)[..., None]

    sensor = pgm.NonlinearGaussianCPD(z, x, lambda x: x**2, cov=0.1, jacobian={x: slope})
    methods = {"EKF": pgm.Taylor(), "UKF": pgm.Unscented()}
    model = squares.replace(observation=[sensor])
    return pgm.study(model, steps=4, runs=150, methods=methods, seed=1)


@pytest.fixture(scope="module")
def calm():
    methods = {"KF": pgm.Filtering(), "RTS": pgm.Smoothing()}
    return pgm.study(walk, steps=6, runs=400, methods=methods, seed=2)


def written(study, tmp_path):
    page = study.report(tmp_path / "study.html")
    assert page == tmp_path / "study.html"
    return page.read_text("utf-8")


def test_a_study_of_right_filters_has_nothing_to_look_at(calm, tmp_path):
    page = written(calm, tmp_path)
    found = sections_of(page)
    assert list(found) == ["Runs", "Errors of x", "Consistency of x", "Predicted readings"]
    assert {section["state"] for section in found.values()} == {"right"}
    assert found["Runs"]["told"] == "of 400 runs none diverged, none failed"
    assert [row[:2] for row in found["Errors of x"]["tables"][0]["rows"]] == [
        ["RMSE x", ""],
        ["bias x", "0"],
    ]
    nees = found["Consistency of x"]["tables"][0]["rows"][0]
    for row, cell in zip(calm.rows, nees[2:], strict=True):
        assert cell == f"{row.nees.value:.4g} ± {row.nees.error:.2g}"


def test_charts_have_the_figures_of_each_step(calm, tmp_path):
    page = written(calm, tmp_path)
    found = sections_of(page)
    (chart, bias) = found["Errors of x"]["charts"]
    assert (chart["right"], bias["right"]) == (None, 0.0)
    for row, series in zip(calm.rows, chart["series"], strict=True):
        assert series["name"] == row.method
        np.testing.assert_allclose(column(page, series["steps"]), np.arange(7))
        rmse, error = row.rmse.by_step[:, 0], 1.96 * row.rmse.error_by_step[:, 0]
        np.testing.assert_allclose(column(page, series["values"]), rmse, rtol=1e-8)
        np.testing.assert_allclose(column(page, series["low"]), rmse - error, rtol=1e-8)
        np.testing.assert_allclose(column(page, series["high"]), rmse + error, rtol=1e-8)
    (chart,) = found["Predicted readings"]["charts"]
    assert chart["right"] == 1.0
    np.testing.assert_allclose(column(page, chart["series"][0]["steps"]), np.arange(1, 7))


def test_lost_and_failed_runs_are_numbered(tmp_path):
    study = lost()
    row = study["EKF"]
    assert 0 < len(row.failed) < len(row.diverged) > 12
    found = sections_of(written(study, tmp_path))
    section = found["Runs"]
    assert section["state"] == "look"
    told = f"at most {len(row.diverged)} diverged by EKF, {len(row.failed)} failed by EKF"
    assert told in section["told"]
    line = section["tables"][0]["rows"][0]
    first = ", ".join(map(str, row.diverged[:12].tolist()))
    assert line[:3] == ["EKF", str(row.runs), f"{len(row.diverged)}: {first}, …"]
    assert line[3].partition(": ")[2].split(", ")[0] == str(row.failed[0])
    assert line[5] == str(row.worst)
    assert found["Consistency of x"]["told"].startswith("too sure: EKF")
    assert found["Errors of x"]["state"] == "look"


def test_a_state_without_covariance_is_not_judged(tmp_path):
    fixed = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(x, 0.0, cov=0.0)],
        [pgm.LinearGaussianCPD(x, {x.previous: 1.0}, cov=0.0)],
        [pgm.LinearGaussianCPD(z, {x: 1.0}, cov=1.0)],
    )
    study = pgm.study(fixed, steps=2, runs=4, methods={"KF": pgm.Taylor()}, seed=3)
    section = sections_of(written(study, tmp_path))["Consistency of x"]
    assert section["state"] == "unknown"
    one = pgm.study(walk, steps=2, runs=1, methods={"KF": pgm.Taylor()}, seed=3)
    assert data_of(written(one, tmp_path))["sections"]


@pytest.mark.filterwarnings("ignore::pgm.errors.ParticleWarning")
def test_kl_from_an_oracle_has_a_line_a_chart_and_its_marks(tmp_path):
    given = {"steps": 2, "runs": 6, "seed": 1, "repeats": 4}
    methods = {"KF": pgm.Filtering(), "PF": pgm.Particles(200, seed=1)}
    study = pgm.study(walk, methods=methods, oracle=pgm.Particles(30, seed=2), **given)
    page = written(study, tmp_path)
    section = sections_of(page)["Consistency of x"]
    line = section["tables"][0]["rows"][-1]
    kl = study["KF"].kl
    assert line[:2] == ["KL [nats]", ""]
    assert line[2].replace("−", "-") == f"{kl.value:.4g} ± {kl.error:.2g}"
    chart = section["charts"][-1]
    np.testing.assert_allclose(column(page, chart["series"][0]["values"]), kl.by_step, rtol=1e-8)
    told = [row.weak for row in study.rows if row.weak]
    assert told
    for why in told:
        assert any(why in words for words in section["words"])
    # A particle filter has no innovations.
    nis = sections_of(page)["Predicted readings"]["tables"][0]["rows"][0]
    assert nis[3] == "—"


def test_a_page_asks_for_nothing(calm, tmp_path):
    page = written(calm, tmp_path)
    assert not re.search(r"https?:", page.replace("http://www.w3.org/2000/svg", ""))
    assert len(page) < 200_000


def test_a_page_in_a_browser(browser, calm, tmp_path):
    browser.open(calm.report(tmp_path / "calm.html"))
    assert browser.complaints() == []
    assert len(browser.all("#glance tr")) == len(browser.all("#sections section")) == 4
    assert len(browser.all(".charts figure path.shape.series:not(.sample *)")) == 10
    assert len(browser.all(".charts figure .grid ~ svg path.band")) == 10
    assert "KF" in browser.text(".charts .legend")
    assert browser.run("return document.documentElement.scrollWidth <= window.innerWidth")
    browser.open(lost().report(tmp_path / "lost.html"))
    assert browser.all("#glance .look")
    b = pgm.Variable("<script>window.hacked=1</script>")
    model = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(b, 0.0, 1.0)],
        [pgm.LinearGaussianCPD(b, {b.previous: 1.0}, cov=1.0)],
        [pgm.LinearGaussianCPD(z, {b: 1.0}, cov=1.0)],
    )
    names = {"<img src=x onerror=window.hacked=1>": pgm.Taylor()}
    hostile = pgm.study(model, steps=2, runs=3, methods=names, seed=1)
    browser.open(hostile.report(tmp_path / "hostile.html"))
    assert browser.run("return window.hacked") is None
    assert browser.complaints() == []
