"""The numbers that are shown are those of the arrays, and no more of them are computed."""

import numpy as np
import pytest
from display.every_value import HEARD, PLACE, RAIN, WET, U, X, Z, house, robot

import pgm

MODEL, ASKED = robot()
DRAWN = MODEL.sample(ASKED, rng=1)
BATCH = MODEL.sample(ASKED, runs=(5, 4), rng=2)


def pairs(line):
    """The means and deviations of a line."""
    words = line.split()
    places = [k for k, word in enumerate(words) if word == "±"]
    return np.array([[float(words[k - 1]), float(words[k + 1])] for k in places])


def check(lines, mean, std, where=lambda line: int(line.split()[0])):
    """Rows with a ± are means and deviations at the places that they tell."""
    found = [line for line in lines if "±" in line]
    assert found
    for line in found:
        at = where(line)
        shown = pairs(line)
        assert np.all(np.abs(shown[:, 0] - mean[at]) <= 0.0051 * std[at])
        np.testing.assert_allclose(shown[:, 1], std[at], rtol=0.051)
    return len(found)


def test_a_gaussian_over_steps_and_its_posterior():
    found = pgm.smooth(MODEL, DRAWN.evidence)
    belief = found[X]
    assert check(repr(belief).splitlines()[2:], belief.mean, belief.std) == 11
    lines = repr(found).splitlines()
    assert check(lines, belief.mean, belief.std) == 11
    assert float(lines[1].split()[1]) == pytest.approx(float(found.log_evidence), rel=1e-5)


def test_runs_are_shown_by_their_place():
    found = pgm.filter(MODEL, BATCH.evidence)
    belief = found[X]

    def where(line):
        outer, inner, step = line.replace(",", "").split()[:3]
        return int(outer), int(inner), int(step)

    for value in (found, belief):
        assert check(repr(value).splitlines(), belief.mean, belief.std, where) == 8
    lines = repr(found).splitlines()
    assert lines[3].split() == ["run", "step", "x:", "east", "north", "heading", "[rad]"]
    low, high = map(float, lines[1].replace("to", "").split()[1:3])
    np.testing.assert_allclose(
        [low, high], [found.log_evidence.min(), found.log_evidence.max()], 1e-3
    )


def test_a_gaussian_by_component():
    cov = np.array([[4.0, 1.2, 0.0], [1.2, 0.09, 0.0], [0.0, 0.0, 1e-6]])
    cov[0, 1] = cov[1, 0] = 0.3
    belief = pgm.Gaussian(X, [1.0, -20.0, 3.0], cov)
    title, heads, *rows = repr(belief).splitlines()
    assert title == "Gaussian(x)"
    assert heads.split() == ["mean", "±", "deviation", "correlations"]
    assert [row.split()[0] for row in rows] == ["east", "north", "heading"]
    for k, row in enumerate(rows):
        mean, std = pairs(row)[0]
        assert abs(mean - belief.mean[k]) <= 0.0051 * belief.std[k]
        assert std == pytest.approx(belief.std[k], rel=0.0051)
    assert float(rows[1].split()[-1]) == pytest.approx(0.3 / (2.0 * 0.3), abs=0.0051)


def test_a_canonical_form():
    form = pgm.CanonicalForm(X, np.diag([4.0, 250.0, 1e-3]), [1.0, -2.5, 1e7], -12.25)
    title, scale, heads, *rows = repr(form).splitlines()
    assert (title, scale.strip()) == ("CanonicalForm(x)", "g = -12.25")
    assert heads.split() == ["h", "K:", "east", "north", "heading", "[rad]"]
    numbers = np.array([row.replace("[rad]", "").split()[1:] for row in rows], dtype=float)
    np.testing.assert_allclose(numbers[:, 0], form.h, rtol=5e-4)
    np.testing.assert_allclose(numbers[:, 1:], form.K, rtol=5e-4)


def test_an_affine_gaussian():
    made = pgm.AffineGaussian([[1.0, 0.5]], [3.0], [[0.25]])
    lines = repr(made).splitlines()
    assert lines[3].split() == ["y0", "3", "1", "0.5"]
    assert lines[5].split() == ["y0", "0.25"]


def test_tables_by_the_names_of_states():
    table = pgm.Table((RAIN, WET), [[0.72, 0.08], [0.04, 0.16]])
    lines = [line.split() for line in repr(table).splitlines()]
    assert lines[1:] == [
        ["rain", "wet:", "no", "yes"],
        ["no", "0.72", "0.08"],
        ["yes", "0.04", "0.16"],
    ]
    assert "<td" in table._repr_html_()


def test_states_over_time():
    model, evidence = house()
    found = pgm.smooth(model, evidence)
    lines = repr(found).splitlines()
    assert lines[3].split() == ["step", "place:", *PLACE.states]
    for line in lines[4:]:
        step, *chances = line.split()
        if step != "...":
            due = found[PLACE].probabilities[int(step)]
            np.testing.assert_allclose(np.array(chances, dtype=float), due, atol=5.1e-4)


def test_a_sample_s_first_and_last_values():
    lines = [line.split("  ") for line in repr(DRAWN).splitlines()[2:]]
    for (_, *cells), variable in zip(lines, (X, Z), strict=True):
        name, shape, first, last = (cell.strip() for cell in cells if cell.strip())
        assert (name, shape) == (variable.name, str(DRAWN[variable].shape))
        for text, due in ((first, DRAWN[variable][0]), (last, DRAWN[variable][-1])):
            np.testing.assert_allclose(np.array(text.split(", "), dtype=float), due, rtol=6e-4)


def test_innovations_and_averages():
    found = pgm.filter(MODEL, DRAWN.evidence)
    seen = found.innovations[Z]
    std = np.sqrt(np.diagonal(seen.cov, axis1=-2, axis2=-1))
    assert check(repr(seen).splitlines()[2:], seen.residual, std) == 11
    mean = np.nansum(seen.nis) / seen.dof.sum()
    assert float(repr(seen).splitlines()[1].split()[1]) == pytest.approx(mean, rel=1e-3)
    average = pgm.consistency.anees(found[X], DRAWN[X])
    rows = [line.split() for line in repr(average).splitlines()[3:]]
    for place, value, low, high, *_ in (row for row in rows if len(row) > 1):
        at = int(place.strip("[]"))
        due = [average.value[at], average.low[at], average.high[at]]
        np.testing.assert_allclose(
            [float(value), float(low), float(high)], due, rtol=2e-3, atol=6e-4
        )
    one = average.overall()
    assert repr(one).startswith(f"Average({float(one.value):.4g}, band ")


class Asked:
    """A posterior that counts the variables it is asked for."""

    def __init__(self, found):
        self.found, self.asked = found, []
        self.log_evidence, self.log_evidence_kind = found.log_evidence, found.log_evidence_kind
        self.graph, self.status = found.graph, found.status

    def __getitem__(self, variable):
        self.asked.append(variable)
        return self.found[variable]


def test_only_the_beliefs_shown_are_computed():
    from pgm.posteriors.summaries import over_time

    long = {U: np.tile([1.0, 0.1, 0.5], (3000, 1))}
    for found, variable in (
        (pgm.filter(MODEL, long), X),
        (pgm.smooth(house()[0], {HEARD: np.zeros(3000, dtype=int)}), PLACE),
    ):
        asked = Asked(found)
        text = over_time("title", asked, (variable,), (), 3000).text()
        assert len(text.splitlines()) <= 20
        assert [v.step for v in asked.asked] == [*range(6), *range(2996, 3001)]


def test_each_variable_of_a_chain_shows_its_last_step():
    """A map is known best at the end."""
    x, *marks = pgm.variables("x m1 m2 m3 m4 m5")
    still = [pgm.LinearGaussianCPD(m, given={m.previous: 1.0}, cov=0) for m in (x, *marks)]
    model = pgm.DynamicBayesianNetwork(
        prior=[pgm.GaussianCPD(m, 0.0, cov=1.0) for m in (x, *marks)], transition=still
    )
    lines = repr(pgm.filter(model, {}, steps=30)).splitlines()
    assert len(lines) == 20
    assert [line.split()[0] for line in lines[3:7]] == ["step", "0", "...", "30"]
    assert sum(line.split()[0] == "30" for line in lines) == 4


def test_a_graph_shows_the_clusters_and_their_neighbours():
    """However many variables a cluster has."""
    x, *others = pgm.variables(["x", *(f"reading_of_sensor_{k}" for k in range(6))])
    model = pgm.DynamicBayesianNetwork(
        prior=[pgm.GaussianCPD(x, 0.0, cov=1.0)],
        transition=[pgm.LinearGaussianCPD(x, given={x.previous: 1.0}, cov=1.0)],
        observation=[pgm.LinearGaussianCPD(z, given={x: 1.0}, cov=1.0) for z in others],
    )
    title, heads, *rows = repr(pgm.compile(model, steps=5)).splitlines()
    assert title.startswith("SliceGraph")
    assert heads.split() == ["cluster", "variables", "joined", "to"]
    assert rows[2].endswith("1 by x[1]; 3 by x[2]")


def test_a_correlation_that_rounds_to_zero_has_no_sign():
    belief = pgm.Gaussian(X, [0.0, 0.0, 0.0], [[1, -1e-3, 0], [-1e-3, 1, 0.5], [0, 0.5, 1]])
    assert repr(belief).splitlines()[3].split()[-1] == "0.00"
