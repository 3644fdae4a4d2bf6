"""`pgm.plot.comparison`: curves of the rows, and its errors."""

import matplotlib.pyplot as plt
import numpy as np
import pytest
from numpy.testing import assert_array_equal

import pgm
import pgm.plot
from pgm import ModelError

T = 6
a, z = pgm.Variable("a"), pgm.Variable("z")
MODEL = pgm.DynamicBayesianNetwork(
    [pgm.GaussianCPD(a, [0.5], 1.0)],
    [pgm.LinearGaussianCPD(a, {a.previous: 1.0}, cov=0.2)],
    [pgm.NonlinearGaussianCPD(z, a, lambda a: np.sqrt(4.0 + a), cov=0.5)],
)
EVIDENCE = {z: pgm.sightings(np.full((T + 1, 1), 2.2), step=np.arange(T + 1))}


@pytest.fixture(scope="module")
def found():
    return pgm.compare(
        MODEL,
        EVIDENCE,
        linearisers={"Taylor": pgm.Taylor(), "far": pgm.Unscented(alpha=10.0)},
        oracle=pgm.Grid({"a": (-3.99, 8.0, 120)}),
        truth={a: np.full((T + 1, 1), 0.8)},
        steps=T,
    )


def test_each_row_is_a_curve(found):
    ax = pgm.plot.comparison(found)
    curves = {line.get_label(): line for line in ax.lines}
    assert list(curves) == [
        "Taylor, filter",
        "Taylor, smoother",
        "far, filter (failed)",
        "far, smoother (failed)",
        "oracle: Grid, filtered,\nfrom its own Gaussian",
        "oracle: Grid, smoothed,\nfrom its own Gaussian",
    ]
    for word in ("filter", "smoother"):
        drawn = curves[f"Taylor, {word}"]
        assert_array_equal(drawn.get_ydata(), found["Taylor", word].kl_by_step)
    same = curves["Taylor, filter"].get_color()
    assert curves["Taylor, smoother"].get_color() == same != curves["far, filter (failed)"]
    assert curves["Taylor, filter"].get_linestyle() != curves["Taylor, smoother"].get_linestyle()
    assert (ax.get_xlabel(), ax.get_yscale()) == ("step", "log")
    assert "nats" in ax.get_ylabel()
    plt.close(ax.figure)


def test_one_schedule_s_nees(found):
    _, ax = plt.subplots()
    times = 0.5 * np.arange(T + 1)
    assert pgm.plot.comparison(found, statistic="nees", schedule="filter", times=times, ax=ax) is ax
    drawn = ax.lines[0]
    assert drawn.get_label() == "Taylor"
    assert_array_equal(drawn.get_ydata(), found["Taylor", "filter"].nees_by_step)
    assert_array_equal(drawn.get_xdata(), times)
    assert_array_equal(ax.lines[-1].get_ydata(), [1.0, 1.0])
    plt.close(ax.figure)


def test_errors_are_bands_and_weak_rows_are_marked():
    smoothed = pgm.smooth(MODEL, EVIDENCE, steps=T)
    rows = {
        "same": smoothed,
        "cubature": pgm.smooth(MODEL, EVIDENCE, lineariser=pgm.Cubature(), steps=T),
    }
    audit = pgm.audit(smoothed, samples=200, rng=0)
    grid = pgm.Grid({"a": (-3.99, 8.0, 120)})
    found = pgm.compare(MODEL, EVIDENCE, rows=rows, oracle=[audit, grid], steps=T)
    ax = pgm.plot.comparison(found)
    assert len(ax.collections) == 2
    low, high = (f(ax.collections[0].get_paths()[0].vertices[:, 1]) for f in (np.min, np.max))
    row = found["same"]
    assert high == pytest.approx(np.max(row.kl_by_step + 1.96 * row.kl_error_by_step))
    assert low > 0.0
    weak = pgm.compare(MODEL, EVIDENCE, rows=rows, oracle=pgm.Particles(30), steps=T)
    names = [line.get_label() for line in pgm.plot.comparison(weak).lines]
    assert names == ["same ?", "cubature ?"]
    ax = pgm.plot.comparison(found, oracle="Grid")
    assert not ax.collections
    assert_array_equal(ax.lines[0].get_ydata(), found["same"].by_oracle["Grid"].kl_by_step)
    assert [line.get_label() for line in ax.lines][2:] == [
        "oracle: Grid, smoothed,\nfrom its own Gaussian"
    ]
    with pytest.raises(ModelError, match=r"no oracle 'Other'; it has \['Audit', 'Grid'\]"):
        pgm.plot.comparison(found, oracle="Other")


@pytest.mark.parametrize(
    ("given", "told"),
    [
        ({"statistic": "rmse"}, r"statistic= is one of \['kl', 'nees'\], not 'rmse'"),
        ({"schedule": "lag"}, r"no rows of state=a, schedule='lag'.*\['filter', 'smoother'\]"),
        ({"state": z}, "no rows of state=z"),
    ],
)
def test_what_is_not_there_is_refused(found, given, told):
    with pytest.raises(ModelError, match=told):
        pgm.plot.comparison(found, **given)


def test_what_was_not_asked_for_is_not_drawn(found):
    bare = pgm.compare(MODEL, EVIDENCE, linearisers=[pgm.Taylor()], steps=T)
    with pytest.raises(ModelError, match=r"no row has a kl: give pgm\.compare an oracle="):
        pgm.plot.comparison(bare)
    with pytest.raises(ModelError, match=r"no row has a nees: give pgm\.compare a truth="):
        pgm.plot.comparison(bare, statistic="nees")
    with pytest.raises(ModelError, match="not a tuple"):
        pgm.plot.comparison(found.rows)
