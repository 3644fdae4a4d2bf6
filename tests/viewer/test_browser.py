"""Pages in a real browser: clicks are made, and the numbers read are those of the posterior."""

import re

import numpy as np
import pytest
from viewer import posteriors

import pgm

Keys = pytest.importorskip(
    "selenium.webdriver.common.keys", reason="selenium, which drives the browser, is not installed"
).Keys
PARTS = {"K": lambda form: form.K, "h": lambda form: form.h[:, None], "g": lambda form: [[form.g]]}


def require_shown(found, due):
    """Six digits as shown, all of them in the data."""
    shown, exact = map(np.array, found)
    due = np.asarray(due, dtype=float)
    assert shown.shape == due.shape
    np.testing.assert_allclose(exact, due, rtol=1e-8, atol=1e-9 * np.abs(due).max())
    unit = 10.0 ** (np.floor(np.log10(np.maximum(np.abs(due), 1e-300))) - 5)
    assert (np.abs(shown - due) <= 0.51 * unit + 1e-9 * np.abs(due).max()).all()


def require_form(browser, key, form, run=()):
    for part, of in PARTS.items():
        one = pgm.CanonicalForm(form.scope, form.K[run], form.h[run], form.g[run])
        require_shown(browser.numbers(key, part), of(one))


def require_moments(browser, key, gaussian):
    std = np.sqrt(np.diagonal(gaussian.cov))
    require_shown(browser.numbers(key, "mean"), np.stack([gaussian.mean, std], axis=-1))
    require_shown(browser.numbers(key, "cov"), gaussian.cov)


def require_table(browser, key, table):
    """The entries as shown, of large tables the 64 largest."""
    section = f'[data-factor="{key}"]'
    _, exact = browser.numbers(key, "values")
    scale = float(browser.one(f'{section} [data-part="scale"]').get_attribute("data-value"))
    entries = [int(row.get_attribute("data-entry")) for row in browser.all(f"{section} tbody tr")]
    assert len(entries) == min(table.values.size, 64)
    due = (table.values * np.exp(table.log_scale)).reshape(-1)
    np.testing.assert_allclose(np.ravel(exact) * np.exp(scale), due[entries], rtol=1e-9)
    assert set(due[entries]) >= set(np.sort(due)[-len(entries) :])


def pressed(browser, step):
    browser.slide("#step", step)
    assert browser.selected == f"cluster {step}"


def test_a_cluster_of_a_chain_shows_belief_potential_and_messages(look):
    posterior = posteriors.smoothed()
    page = look(posterior)
    page.click('[data-cluster="3"]')
    assert page.selected == "cluster 3"
    require_form(page, "belief", posterior.belief(3))
    require_moments(page, "belief", posterior.joint(*posterior.belief(3).scope))
    require_form(page, "potential", posterior.potential(3))
    require_form(page, "message-2-3", posterior.message(2, 3))
    require_form(page, "message-4-3", posterior.message(4, 3))
    require_moments(page, "message-2-3", posterior.message(2, 3).gaussian())
    assert "×2" in page.text('[data-cluster="3"]')
    assert page.text(".chips").count("z[3] = ") == 2
    assert page.all("#inspector .picture path.shape.belief")


@pytest.mark.parametrize("step", [0, 1, 20, posteriors.STEPS])
def test_every_step_is_reached_by_the_slider(look, step):
    posterior = posteriors.smoothed()
    page = look(posterior)
    pressed(page, step)
    require_form(page, "belief", posterior.belief(step))
    require_form(page, "potential", posterior.potential(step))
    assert page.all(f'[data-cluster="{step}"].selected')


def test_an_edge_shows_both_messages_and_their_product(look):
    posterior = posteriors.smoothed()
    page = look(posterior)
    page.click('[data-edge="2-3"] .plate')
    assert page.selected == "edge 2 to 3"
    require_form(page, "message-2-3", posterior.message(2, 3))
    require_form(page, "message-3-2", posterior.message(3, 2))
    require_moments(page, "sepset", posterior[posteriors.x.at(2)])
    page.click(".ends button")
    assert page.selected == "cluster 2"


def test_a_pose_is_linked_to_its_cluster(look):
    page = look(posteriors.smoothed())
    pressed(page, 17)
    canvas = page.one("#trajectory canvas")
    x, y = (float(canvas.get_attribute(f"data-{axis}")) for axis in "xy")
    pressed(page, 2)
    page.click_at("#trajectory canvas", x, y)
    assert page.selected == "cluster 17"
    assert canvas.get_attribute("data-step") == "17"
    page.click('[data-cluster="18"]')
    assert canvas.get_attribute("data-step") == "18"
    for option in range(len(page.all("#trajectory option"))):
        page.pick("#trajectory select", option)
    assert "heading over time" in page.one("#trajectory canvas").get_attribute("aria-label")


def test_keys_do_what_the_help_says(look):
    page = look(posteriors.smoothed())
    page.press(Keys.ARROW_RIGHT, Keys.ARROW_RIGHT, Keys.ARROW_LEFT)
    assert page.selected == "cluster 1"
    page.press(Keys.PAGE_UP)
    assert page.selected == "cluster 11"
    page.press(Keys.END)
    assert page.selected == f"cluster {posteriors.STEPS}"
    page.press(Keys.HOME)
    assert page.selected == "cluster 0"
    wide = page.run(
        "return document.querySelector('[data-cluster] rect').getBoundingClientRect().width"
    )
    page.press("+")
    assert (
        page.run(
            "return document.querySelector('[data-cluster] rect').getBoundingClientRect().width"
        )
        > wide
    )
    page.press("-")
    page.press("?")
    assert page.one("dialog").get_attribute("open") is not None
    page.press(Keys.ESCAPE)
    assert page.one("dialog").get_attribute("open") is None
    page.press("/", "x[23]", Keys.ENTER)
    assert page.selected == "cluster 23"
    page.run("document.querySelector('.node.selected').focus()")
    page.press(Keys.ENTER)
    assert page.selected == "cluster 23"
    page.press(" ")
    page.wait("Number(document.body.dataset.selected.split(' ')[1]) >= 25")
    page.press(" ")
    assert page.one(".play").get_attribute("aria-pressed") == "false"


def test_a_key_between_the_closing_of_the_help_and_the_next_frame_counts(look):
    page = look(posteriors.smoothed())
    page.press("?")
    focused = page.run(
        "for (const key of ['Escape', '/'])"
        " document.activeElement.dispatchEvent(new KeyboardEvent('keydown', {key, bubbles: true}));"
        "return document.activeElement.type"
    )
    assert focused == "search"


def test_what_is_found_is_chosen(look):
    posterior = posteriors.tree()
    page = look(posterior)
    field = page.one("input[type=search]")
    field.send_keys("no such name")
    assert page.text("#found") == "nothing found"
    field.clear()
    field.send_keys("f")
    page.click("#found [role=option]")
    cluster = int(page.selected.split()[1])
    assert "f" in {v.name for v in posterior.graph.clusters[cluster].scope}
    # A variable that is observed is found too.
    field.send_keys(Keys.BACKSPACE, "e", Keys.ENTER)
    cluster = int(page.selected.split()[1])
    assert "e = yes" in page.text(".chips")


def test_a_filter_has_messages_one_way(look):
    posterior = posteriors.filtered()
    page = look(posterior)
    pressed(page, 9)
    require_form(page, "belief", posterior.belief(9))
    require_form(page, "message-8-9", posterior.message(8, 9))
    assert "not sent: the posterior is filtered" in page.text('[data-factor="message-10-9"]')
    seen = page.run(
        "return [...document.querySelectorAll('.arrow')]"
        ".filter((arrow) => getComputedStyle(arrow).visibility === 'visible')"
        ".map((arrow) => arrow.closest('.edge').dataset.edge)"
    )
    assert seen == ["8-9"]


def test_a_fixed_lag_and_a_window_of_steps(look):
    posterior = pgm.infer(
        pgm.compile(posteriors.robot(), steps=posteriors.STEPS),
        posteriors.drive(),
        schedule=pgm.FixedLag(3),
    )
    page = look(posterior, steps=(10, 20))
    assert "steps 10 to 20 of 0 to 40" in page.text("#notes")
    for step in (10, 15, 20):
        page.slide("#step", step)
        require_form(page, "belief", posterior.belief(step))
        require_form(page, "potential", posterior.potential(step))
        require_form(page, f"message-{step - 1}-{step}", posterior.message(step - 1, step))


def test_singular_factors_have_moments_and_say_so(look):
    posterior = posteriors.still()
    page = look(posterior)
    pressed(page, 2)
    require_moments(
        page, "belief", posterior.joint(*(v.at(2) for v in posterior.graph.layout.pair))
    )
    assert "no canonical form: singular" in page.text('[data-factor="belief"]')
    assert "no canonical form: singular" in page.text('[data-factor="potential"]')
    require_form(page, "message-1-2", posterior.message(1, 2))


def test_a_chain_of_tables(look):
    posterior = posteriors.days()
    page = look(posterior)
    for step in (0, 4, 8):
        page.slide("#step", step)
        require_table(page, "belief", posterior.belief(step))
        require_table(page, "potential", posterior.potential(step))
        for other in posterior.graph.neighbours(step):
            require_table(page, f"message-{other}-{step}", posterior.message(other, step))
    assert page.text(".chips").endswith("umbrella[8] = yes")
    shown = page.run(
        "return [...document.querySelectorAll('.bars .number')].map((n) => Number(n.textContent))"
    )
    np.testing.assert_allclose(shown, posterior[posteriors.weather.at(8)].values, atol=5e-5)


def test_a_chain_of_several_tables_with_a_control(look):
    posterior = posteriors.factorial()
    page = look(posterior)
    for step in (0, 1, 5):
        page.slide("#step", step)
        require_table(page, "belief", posterior.belief(step))
        require_table(page, "potential", posterior.potential(step))
        for other in posterior.graph.neighbours(step):
            require_table(page, f"message-{other}-{step}", posterior.message(other, step))


def test_a_chain_of_several_states_with_a_control(look):
    posterior = posteriors.driven()
    page = look(posterior)
    for step in (0, 1, 2, 8):
        page.slide("#step", step)
        require_form(page, "belief", posterior.belief(step))
        require_form(page, "potential", posterior.potential(step))
        for other in posterior.graph.neighbours(step):
            require_form(page, f"message-{other}-{step}", posterior.message(other, step))
    page.slide("#step", 2)
    assert "z[2] = not taken" in page.text(".chips")


@pytest.mark.parametrize("schedule", [pgm.Filtering(), pgm.FixedLag(2)])
def test_chains_of_tables_by_other_schedules(look, schedule):
    posterior = posteriors.days(schedule)
    page = look(posterior)
    page.slide("#step", 5)
    require_table(page, "belief", posterior.belief(5))
    assert "not sent" in page.text('[data-factor="message-6-5"]')


def test_a_tree_of_tables(look):
    posterior = posteriors.tree()
    page = look(posterior)
    for k in range(len(posterior.graph)):
        page.press("/", f"c{k}", Keys.ENTER)
        assert page.selected == f"cluster {k}"
        require_table(page, "belief", posterior.belief(k))
        require_table(page, "potential", posterior.potential(k))
        for j in posterior.graph.neighbours(k):
            require_table(page, f"message-{j}-{k}", posterior.message(j, k))


def test_a_balanced_tree(look):
    posterior = posteriors.balanced()
    page = look(posterior)
    root = posterior.graph.root
    page.click(f'[data-cluster="{root}"]')
    require_form(page, "belief", posterior.belief(root))
    for j in posterior.graph.neighbours(root):
        require_form(
            page,
            f"message-{j}-{root}",
            posterior.message(j, root).rearrange(
                posterior.graph.sepsets[min(j, root), max(j, root)]
            ),
        )


@pytest.mark.parametrize("method", [pgm.LTRIP(), pgm.Bethe()])
def test_iterations_of_a_graph_with_loops(look, method):
    posterior = posteriors.lattice(method=method)
    page = look(posterior)
    assert len(page.all("[data-cluster]")) == len(posterior.graph)
    edges = list(posterior.graph.sepsets)
    for iteration in (1, 5, posterior.status.iterations):
        page.slide("#iteration", iteration)
        found = {
            tuple(map(int, name.split("-"))): float(value)
            for name, value in page.run(
                "return [...document.querySelectorAll('[data-edge]')]"
                ".map((edge) => [edge.dataset.edge, edge.dataset.residual])"
            )
        }
        due = dict(zip(edges, posterior.status.edge_residuals[iteration - 1], strict=True))
        np.testing.assert_allclose([found[e] for e in edges], [due[e] for e in edges], rtol=1e-8)
    assert "those after the last iteration" in page.text(".iterations")
    i, j = edges[0]
    page.click(f'[data-cluster="{i}"]')
    require_form(page, "belief", posterior.belief(i))
    require_form(page, f"message-{j}-{i}", posterior.message(j, i))
    # Arrow keys go to the neighbour that lies there.
    page.press(Keys.ARROW_RIGHT, Keys.ARROW_DOWN, Keys.ARROW_LEFT, Keys.ARROW_UP)
    assert page.selected.startswith("cluster ")


def test_residuals_of_an_iterated_smoother(look):
    posterior = posteriors.smoothed()
    page = look(posterior)
    residuals = posterior.status.residuals
    page.slide("#iteration", 1)
    assert f"1 of {len(residuals)}" in page.text("output")
    assert float(page.text("output").split()[-1].replace("−", "-")) == pytest.approx(
        residuals[0], rel=1e-5
    )
    assert "not converged" in page.text(".iterations")


def test_runs_of_a_batch_are_chosen(look):
    posterior = posteriors.batch()
    page = look(posterior)
    assert "8 of 12 runs" in page.text("#notes")
    pressed(page, 6)
    for run in (0, 7):
        page.pick("#run", run)
        require_form(page, "belief", posterior.belief(6), (run,))
        require_form(page, "message-7-6", posterior.message(7, 6), (run,))
    page = look(posterior, run=(11,))
    pressed(page, 6)
    require_form(page, "potential", posterior.potential(6), (11,))


@pytest.mark.parametrize("made", [posteriors.hostile, posteriors.hostile_states])
def test_what_users_wrote_is_text(look, made):
    page = look(made())
    words = page.run("return document.body.textContent")
    assert page.run("return window.hacked") is None
    assert len(page.all("script")) == 3
    assert not page.all("img")
    assert posteriors.HOSTILE[0][:20] in words
    label = page.run("return document.querySelector('.node').getAttribute('aria-label')")
    assert "<script>" in label or "{{numbers}}" in label


@pytest.mark.parametrize(
    ("made", "why"),
    [(posteriors.particles, "particles are drawn"), (posteriors.grid, "keeps no messages")],
)
def test_beliefs_without_messages_say_why(look, made, why):
    posterior = made()
    page = look(posterior)
    page.slide("#step", 3)
    belief = posterior[posteriors.x]
    mean, cov = belief.mean[3], belief.cov[3]
    std = np.sqrt(np.diagonal(cov))
    require_shown(page.numbers("belief", "mean"), np.stack([mean, std], axis=-1))
    assert why in page.text('[data-factor="message-2-3"]')


def test_marginals_that_alone_were_kept(look):
    posterior = pgm.smooth(posteriors.robot(), posteriors.drive(), keep=[posteriors.x])
    page = look(posterior)
    page.slide("#step", 3)
    gaussian = posterior[posteriors.x.at(3)]
    require_moments(page, "belief", gaussian)
    assert "keep=" in page.text('[data-factor="potential"]')


def test_the_frame_of_a_notebook_comes_to_life(browser, tmp_path):
    page = tmp_path / "cell.html"
    page.write_text(
        f"<!doctype html><meta charset=utf-8>{posteriors.smoothed()._repr_html_()}", "utf-8"
    )
    browser.driver.get(page.as_uri())
    browser.driver.switch_to.frame(browser.one("iframe"))
    browser.wait("document.body.dataset.ready")
    browser.slide("#step", 3)
    require_form(browser, "belief", posteriors.smoothed().belief(3))
    browser.driver.switch_to.default_content()


def test_the_policy_lets_nothing_out(browser, tmp_path):
    browser.open(pgm.view(posteriors.tree(), tmp_path / "page.html"))
    refused = browser.run(
        "return fetch('https://example.org/').then(() => 'sent').catch((error) => String(error))"
    )
    assert "sent" not in refused
    assert any("Content Security Policy" in message for message in browser.complaints())


@pytest.mark.parametrize("width", [800, 1600])
def test_the_page_does_not_run_over_its_window(look, browser, width):
    browser.driver.execute_cdp_cmd(
        "Emulation.setDeviceMetricsOverride",
        {"width": width, "height": 900, "deviceScaleFactor": 1, "mobile": False},
    )
    try:
        page = look(posteriors.smoothed())
        assert page.run("return document.documentElement.scrollWidth") <= width
    finally:
        browser.driver.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})


LETTERS = """
    const zoom = document.querySelector('#graph > g').getCTM().a;
    return [...document.querySelectorAll('#graph text')]
        .filter((text) => text.textContent && getComputedStyle(text.parentNode).display !== 'none')
        .map((text) => [zoom * parseFloat(getComputedStyle(text).fontSize), text.textContent])
"""


@pytest.mark.parametrize(
    ("made", "named"),
    [
        (lambda: posteriors.lattice(5, method=pgm.Bethe()), True),
        (lambda: posteriors.branches(400), False),
    ],
)
def test_names_are_readable_or_left_out_and_the_one_under_the_cursor_is_told(look, made, named):
    from selenium.webdriver.common.action_chains import ActionChains

    posterior = made()
    page = look(posterior)
    letters = page.run(LETTERS)
    assert bool(letters) == named
    assert all(size >= 8.4 for size, _ in letters)
    assert page.run("return document.querySelector('#tip').hidden")
    cluster = posterior.graph.clusters[7]
    ActionChains(page.driver).move_to_element(page.one('[data-cluster="7"]')).perform()
    told = page.text("#tip")
    assert told.startswith("cluster 7: ")
    assert all(repr(v) in told for v in posterior.belief(7).scope), cluster
    assert not page.run("return document.querySelector('#tip').hidden")


def test_names_come_back_where_they_fit(look):
    page = look(posteriors.branches(400))
    page.press("/", "c7", Keys.ENTER)  # which goes near
    sizes = [size for size, _ in page.run(LETTERS)]
    assert sizes
    assert min(sizes) >= 8.4


def test_what_evidence_moved_is_coloured_and_told(look):
    posterior = posteriors.tree()
    page = look(posterior)
    fills = page.run(
        "return [...document.querySelectorAll('[data-cluster]')].map((node) =>"
        " getComputedStyle(node.querySelector('rect')).fill)"
    )
    assert len(set(fills)) > 1  # one is selected
    assert page.all(".node.evidence")
    before = pgm.infer(posterior.graph, {})
    told = page.one('[data-cluster="1"]').get_attribute("aria-label")
    name, nats = re.search(r"evidence moved (\w+) by ([0-9.]+) nats", told).groups()
    found = {
        v.name: float(np.sum(posterior[v].values * np.log(posterior[v].values / before[v].values)))
        for v in posterior.belief(1).scope
    }
    assert name == max(found, key=found.get)
    assert float(nats) == pytest.approx(found[name], rel=6e-3)
    assert "moved by" in page.text("#keys")
    page = look(pgm.infer(posterior.graph, {}))
    assert not page.all(".node.moved")
    assert page.text("#facts").count("evidence) 0 exact") == 1
    page = look(posteriors.filtered())
    shares = {
        step: page.run(
            f"return document.querySelector('[data-cluster=\"{step}\"]')"
            ".style.getPropertyValue('--share')"
        )
        for step in (2, 3)
    }
    assert shares == {2: "0%", 3: "100%"}  # of which the latter reads landmarks
    assert "moved by the readings of the step" in page.text("#keys")


def test_truth_stands_beside_beliefs(look):
    drawn, posterior = posteriors.simulated()
    page = look(posterior, truth=drawn)
    pressed(page, 5)
    _, exact = page.numbers("belief", "mean")
    gaussian = posterior.joint(posteriors.x.at(4), posteriors.x.at(5))
    true = drawn[posteriors.x][4:6].reshape(-1)
    np.testing.assert_allclose(np.array(exact)[:, 2], true, rtol=1e-8)
    off = gaussian.mean - true
    off[[2, 5]] = (off[[2, 5]] + np.pi) % (2 * np.pi) - np.pi
    np.testing.assert_allclose(np.array(exact)[:, 3], off / gaussian.std, rtol=1e-6, atol=1e-8)
    assert len(page.all("#inspector path.truth")) == 3  # a cross of each step, and the legend
    assert "truth" in page.text("#trajectory .legend")
    weather = posteriors.weather
    states = ["sun", "rain", "rain", "rain", "fog", "fog", "fog", "sun", "sun"]
    page = look(posteriors.days(), truth={weather: states})
    page.slide("#step", 4)
    assert page.text(".bars .true") == "fog (truth)"
    assert "truth: weather[3] = rain, weather[4] = fog" in page.text('[data-factor="belief"]')


def test_states_that_are_no_place_open_over_time(look):
    options = "return [...document.querySelectorAll('#trajectory option')].map((o) => o.text)"
    page = look(posteriors.driven())
    assert page.run(options)[0] == "x place over time"
    assert page.run(options)[-1] == "x: place, speed"
    assert "over time" in page.one("#trajectory canvas").get_attribute("aria-label")
    page = look(posteriors.smoothed())
    assert page.run(options)[0] == "x: east, north"


def line(prior=1.0, cov=1.0, reading=1.0, measured=1.0, steps=4):
    a, b = pgm.variables("a b")
    model = pgm.DynamicBayesianNetwork(
        prior=[pgm.GaussianCPD(a, 0.0, prior)],
        transition=[pgm.LinearGaussianCPD(a, given={a.previous: 1.0}, cov=cov)],
        observation=[pgm.LinearGaussianCPD(b, given={a: 1.0}, cov=reading)],
    )
    return a, pgm.smooth(model, {b: np.full((steps, 1), measured)})


@pytest.mark.parametrize(
    "given",
    [
        {"steps": 0},
        {"prior": 0.0, "cov": 0.0},
        {"reading": 0.0},
        {"prior": np.inf, "measured": np.nan},
        {"prior": 1e200, "cov": 1e200, "reading": 1e200},
        {"prior": 1e-200, "cov": 1e-200, "reading": 1e-200, "measured": 1e-100},
    ],
    ids=repr,
)
def test_certain_unknown_and_far_numbers_are_drawn(look, given):
    a, posterior = line(**given)
    page = look(posterior)
    page.press("/", "c0", Keys.ENTER)
    if given.get("prior") == np.inf:
        assert page.numbers("belief", "mean")[0] == [[0.0, np.inf]]
        assert "nothing to draw" in page.text("figure")
        return
    require_moments(page, "belief", posterior[a.at(0)])
    marks = page.run(
        "return [...document.querySelectorAll('.picture .grid text')].map((t) => t.textContent)"
    )[:-1]
    numbers = [float(mark.replace("−", "-")) for mark in marks]
    assert len(set(numbers)) == len(numbers) > 2
    mean, std = posterior[a.at(0)].mean[0], posterior[a.at(0)].std[0]
    assert min(numbers) <= mean + 2 * std
    assert max(numbers) >= mean - 2 * std
