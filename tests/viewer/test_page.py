"""The text of pages: what they hold, what they leave out and say so, what is refused."""

import base64
import gzip
import hashlib
import html
import json
import re
from pathlib import Path

import numpy as np
import pytest
from viewer import posteriors

import pgm
from pgm.examples import rainy, wet
from pgm.viewer.assembly import embedded
from pgm.viewer.numbers import EXACT, FILE, SHOWN, Numbers, lower, rounded
from pgm.viewer.placing import HEIGHT, place
from pgm.viewer.view import _content


def written(posterior, tmp_path, **choice):
    return pgm.view(posterior, tmp_path / "page.html", **choice).read_text("utf-8")


def data_of(page):
    found = re.search(r'<script type="application/json" id="data">(.*?)</script>', page, re.S)
    return json.loads(found[1])


def numbers_of(page):
    packed = re.search(r'id="numbers">(.*?)</script>', page, re.S)[1]
    planes = np.frombuffer(gzip.decompress(base64.b64decode(packed)), np.uint8)
    return np.ascontiguousarray(planes.reshape(8, -1).T).view("<f8").reshape(-1)


def test_numbers_come_back_as_they_were_packed():
    rng = np.random.default_rng(0)
    rows = rng.standard_normal((5, 3)) * 10.0 ** rng.integers(-200, 200, (5, 3))
    rows[0] = [np.nan, np.inf, -np.inf]
    numbers = Numbers()
    numbers.flat(np.array([1.0, -2.0]))
    ref = numbers.add(rows)
    assert ref == {"at": 2, "rows": 5, "columns": 3}
    planes = np.frombuffer(gzip.decompress(base64.b64decode(numbers.text())), np.uint8)
    found = np.ascontiguousarray(planes.reshape(8, -1).T).view("<f8").reshape(-1)
    assert found[:2].tolist() == [1.0, -2.0]
    np.testing.assert_allclose(found[2:].reshape(3, 5).T, rows, rtol=2.0**-EXACT)


@pytest.mark.parametrize("bits", [EXACT, SHOWN])
def test_rounding_keeps_its_digits(bits):
    values = np.random.default_rng(1).standard_normal(1000) * 1e5
    found = rounded(values, bits)
    assert (np.abs(found - values) <= 2.0 ** -(bits + 1) * np.abs(values)).all()
    assert not (found.view(np.uint64) & np.uint64((1 << (52 - bits)) - 1)).any()
    assert rounded(np.array([np.nan, -np.inf, 0.0]), bits)[1] == -np.inf


def test_lower_triangles_go_row_by_row():
    assert lower(np.array([[1.0, 2.0], [2.0, 3.0]])).tolist() == [1.0, 2.0, 3.0]


@pytest.mark.parametrize("text", [*posteriors.HOSTILE, "{{script}}", "\u2028&amp;<", "</SCRIPT >"])
def test_data_ends_no_element(text):
    found = embedded({"name": text})
    assert not set("<>&") & set(found)
    assert json.loads(found)["name"] == text


@pytest.mark.parametrize("made", [posteriors.hostile, posteriors.hostile_states])
def test_a_page_has_three_scripts_whatever_users_wrote(made, tmp_path):
    page = written(made(), tmp_path)
    assert len(re.findall(r"<script", page, re.I)) == page.count("</script>") == 3
    assert "{{" not in re.sub(r'id="data">.*?</script>', "", page, flags=re.S)


def test_the_policy_names_the_script_and_the_style_and_nothing_else(tmp_path):
    page = written(posteriors.tree(), tmp_path)
    policy = re.search(r'Content-Security-Policy" content="(.*?)"', page)[1]
    for kind, start in (("script-src", "<script>"), ("style-src", "<style>")):
        text = page.split(start)[1].split(f"</{start[1:]}")[0]
        digest = base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()
        assert f"{kind} 'sha256-{digest}'" in policy
    assert policy.startswith("default-src 'none'")
    assert not re.search(r"https?:", page.replace("http://www.w3.org/2000/svg", ""))


def test_frames_of_notebooks_are_small_and_say_what_is_cut():
    posterior = pgm.smooth(posteriors.robot(), posteriors.drive(400))
    frame = posterior._repr_html_()
    page = html.unescape(re.search(r'srcdoc="(.*?)" sandbox="allow-scripts"', frame, re.S)[1])
    assert data_of(page)["steps"] == {"first": 0, "last": 199, "end": 400, "base": 0}
    assert data_of(page)["notes"] == ["steps 0 to 199 of 0 to 400 are shown in this page"]
    assert len(frame) < 400_000


@pytest.mark.parametrize(
    "made",
    [
        posteriors.smoothed,
        posteriors.still,
        posteriors.days,
        posteriors.lattice,
        posteriors.tree,
        posteriors.modes,
        posteriors.balanced,
        posteriors.particles,
        posteriors.grid,
    ],
)
def test_every_posterior_shows_itself(made):
    assert made()._repr_html_().startswith("<iframe srcdoc=")


def test_clusters_of_modes_have_mixtures_and_no_messages(tmp_path):
    posterior = posteriors.modes()
    page = written(posterior, tmp_path)
    data, numbers = data_of(page), numbers_of(page)
    (cluster,) = (each for each in data["clusters"] if len(each["scope"]) == 2)
    assert data["words"]["messages"] == posterior._outcome.silent
    told = cluster["potential"] + [each for edge in data["edges"] for each in edge["there"]]
    assert {each["form"] for each in told} == {"none"}
    for run, given in enumerate(cluster["belief"]):
        names = [data["variables"][k]["name"] for k in cluster["scope"]]
        draws = [pgm.Variable(name) for name in names]
        mixture = posterior.joint(*draws)[run]
        assert cluster["observed"][0][1][run] == str([0.9, 0.7][run])
        each = given["gaussians"]
        weights = np.array([part["weight"] for part in each])
        means = np.array([numbers[part["at"] :][:2] for part in each])
        covs = np.array([numbers[part["at"] + 2 :][:3][[0, 1, 1, 2]] for part in each])
        mean = weights @ means
        squares = covs.reshape(-1, 2, 2) + means[:, :, None] * means[:, None, :]
        cov = np.tensordot(weights, squares, 1) - np.outer(mean, mean)
        shown = numbers[given["at"] :][:5]
        np.testing.assert_allclose(shown[:2], mean, atol=1e-8)
        np.testing.assert_allclose(shown[2:][[0, 1, 1, 2]], cov.ravel(), atol=1e-8)
        np.testing.assert_allclose(mixture.mean, mean, atol=1e-8)
        assert sorted(np.sign(means[:, 0])) == [-1, 1]


@pytest.mark.filterwarnings("ignore::pgm.ConvergenceWarning")  # two rounds, to be shown
def test_large_graphs_and_tables_are_cut_in_a_frame():
    posterior = posteriors.lattice(14, schedule=pgm.Flooding(iterations=2))
    frame = posterior._repr_html_()
    page = html.unescape(re.search(r'srcdoc="(.*?)" sandbox', frame, re.S)[1])
    data = data_of(page)
    assert len(data["clusters"]) == 150
    assert data["notes"] == [
        f"150 of {len(posterior.graph)} clusters are shown, the nearest to cluster 0"
    ]
    kept = {cluster["index"] for cluster in data["clusters"]}
    for cluster in data["clusters"]:
        others = set(posterior.graph.neighbours(cluster["index"]))
        assert set(cluster["cut"]) == others - kept


def test_of_a_large_table_the_largest_entries_are_kept(tmp_path):
    parents = [pgm.Discrete(f"p{k}", states=2) for k in range(12)]
    child = pgm.Discrete("c", states=2)
    rng = np.random.default_rng(0)
    table = rng.dirichlet([1.0, 1.0], (2,) * 12)
    cpds = [pgm.TableCPD(p, table=[0.4, 0.6]) for p in parents]
    net = pgm.BayesianNetwork([*cpds, pgm.TableCPD(child, given=parents, table=table)])
    posterior = pgm.infer(pgm.compile(net), {})
    page = written(posterior, tmp_path)
    belief = data_of(page)["clusters"][0]["belief"][0]
    assert (belief["form"], belief["entries"], belief["count"]) == ("largest", 8192, 64)
    numbers, at = numbers_of(page), belief["at"]
    flat = posterior.belief(0).values.reshape(-1)
    places = numbers[at : at + 64].astype(int)
    np.testing.assert_allclose(numbers[at + 64 : at + 128], flat[places], rtol=1e-12)
    assert set(places) == set(np.argsort(flat)[-64:])
    names = [data_of(page)["variables"][k]["name"] for k in belief["scope"]]
    start = at + 129
    for name in names:
        v = next(v for v in net.variables if v.name == name)
        np.testing.assert_allclose(numbers[start : start + 2], posterior[v].values, rtol=1e-12)
        start += 2


def test_a_drive_of_ten_thousand_steps_is_below_five_megabytes(tmp_path):
    posterior = pgm.smooth(posteriors.robot(), posteriors.drive(10_000))
    page = pgm.view(posterior, tmp_path / "page.html")
    assert page.stat().st_size < 5_000_000
    data, numbers = data_of(text := page.read_text("utf-8")), numbers_of(text)
    ref = data["runs"][0]["arrays"]["back.K"]
    own = numbers[ref["at"] :].reshape(-1)[: ref["rows"] * ref["columns"]]
    found = own.reshape(ref["columns"], ref["rows"])[:, 5_000]
    np.testing.assert_allclose(found, lower(posterior.message(5_001, 5_000).K), rtol=1e-12)


@pytest.mark.parametrize(
    ("choice", "word"),
    [
        ({"run": (12,)}, r"there is no run \(12,\)"),
        ({"run": "first"}, "there is no run"),
        ({"run": (0, 1)}, "there is no run"),
        ({"run": [(k,) for k in range(9)]}, "holds 8 runs, not 9"),
        ({"steps": (0, 41)}, "the chain has the steps 0 to 40"),
        ({"steps": 3}, "are two steps"),
    ],
)
def test_choices_that_do_not_exist_are_refused(choice, word, tmp_path):
    with pytest.raises(pgm.GraphError, match=word):
        pgm.view(posteriors.batch(), tmp_path / "page.html", **choice)
    assert not (tmp_path / "page.html").exists()


def test_what_is_no_chain_has_no_steps(tmp_path):
    with pytest.raises(pgm.GraphError, match="this graph has no steps"):
        pgm.view(posteriors.tree(), tmp_path / "page.html", steps=(0, 1))
    with pytest.raises(pgm.GraphError, match="view shows a posterior"):
        pgm.view(posteriors.tree().graph, tmp_path / "page.html")


def test_more_steps_than_a_page_holds_are_refused(tmp_path):
    a, b = pgm.variables("a b")
    model = pgm.DynamicBayesianNetwork(
        prior=[pgm.GaussianCPD(a, 0.0, 1.0)],
        transition=[pgm.LinearGaussianCPD(a, given={a.previous: 1.0}, cov=0.1)],
        observation=[pgm.LinearGaussianCPD(b, given={a: 1.0}, cov=0.5)],
    )
    posterior = pgm.filter(model, {b: np.zeros((20_001, 1))})
    with pytest.raises(pgm.GraphError, match=r"give steps=\(first, last\)"):
        pgm.view(posterior, tmp_path / "page.html")
    page = pgm.view(posterior, tmp_path / "page.html", steps=(19_000, 20_001))
    assert data_of(page.read_text("utf-8"))["steps"]["base"] == 18_999


@pytest.mark.parametrize("made", [posteriors.lattice, posteriors.tree, posteriors.balanced])
def test_no_cluster_lies_on_another(made):
    graph = made().graph
    edges = list(graph.sepsets)
    letters = dict.fromkeys(range(len(graph)), 16) | dict.fromkeys(edges, 6)
    at = place(range(len(graph)), edges, letters, graph)
    x, y, width = (np.array(at[name]) for name in ("x", "y", "width"))
    beside = np.abs(x[:, None] - x) >= 0.5 * (width[:, None] + width)
    above = np.abs(y[:, None] - y) >= HEIGHT
    assert (beside | above | np.eye(len(graph), dtype=bool)).all()


def test_the_package_holds_what_the_page_is_made_of():
    from importlib.resources import files

    from pgm.viewer.assembly import REPORT, VIEWER

    folder = files("pgm.viewer")
    there = {each.name for each in folder.joinpath("script").iterdir()}
    assert there == {f"{name}.js" for page in (VIEWER, REPORT) for name in page.modules}
    for page in (VIEWER, REPORT):
        for name in (page.html, *page.styles):
            assert folder.joinpath(name).is_file()


def test_the_script_is_its_modules_in_order():
    from importlib.resources import files

    from pgm.viewer.scripts import REPORTING, VIEWING, script

    for names in (VIEWING, REPORTING):
        folder, whole, end = files("pgm.viewer").joinpath("script"), script(names), 0
        for name in names:
            end = whole.index(folder.joinpath(f"{name}.js").read_text("utf-8"), end) + 1


def test_pages_ask_an_outcome_and_read_no_family():
    """Neither a module of a family, nor what its outcome keeps for itself."""
    for path in Path(pgm.viewer.__file__).parent.glob("*.py"):
        source = path.read_text(encoding="utf-8")
        assert "pgm.beliefs" not in source, path
        assert not re.search(
            r"\b(posterior|outcome|shown)\._(?!outcome\b|told\b|title\b)", source
        ), path


def test_a_page_has_the_log_evidence_of_its_posterior():
    posterior = posteriors.batch()
    data, _ = _content(posterior, [(2,), (5,)], None, FILE)
    assert [each["log_evidence"] for each in data["runs"]] == posterior.log_evidence[
        [2, 5]
    ].tolist()


def test_what_was_entered_in_a_network_without_time():
    a, b = pgm.variables("a b")
    net = pgm.BayesianNetwork(
        [pgm.GaussianCPD(a, 0.0, 1.0), pgm.LinearGaussianCPD(b, {a: 1.0}, cov=1.0)]
    )
    numbers = pgm.infer(pgm.compile(net), {b: [[1.0], [2.0]]})._outcome
    assert [numbers.entered(run)[b].tolist() for run in (0, 1)] == [[1.0], [2.0]]
    assert [numbers.scope(cluster) for cluster in numbers.graph.clusters] == [(a,)]
    tables = pgm.infer(pgm.compile(rainy), {wet: np.array([1, -1])})._outcome
    assert [tables.entered(run) for run in (0, 1)] == [{wet: "yes"}, {wet: None}]
    over_time = posteriors.balanced()._outcome
    assert over_time.entered(0) == {}
    for cluster in over_time.graph.clusters:
        assert over_time.scope(cluster) == over_time.belief(cluster).scope


def switching():
    """A drift that is calm or wild, its control, and readings that may be of nothing."""
    mode = pgm.Discrete("mode", states=("calm", "wild"))
    x, h, z = pgm.variables("x h z")
    cases = {
        k: pgm.LinearGaussianCPD(x, {x.previous: 1.0, h: 0.5}, cov=cov)
        for k, cov in enumerate((0.1, 4.0))
    }
    model = pgm.DynamicBayesianNetwork(
        [pgm.TableCPD(mode, table=[0.5, 0.5]), pgm.GaussianCPD(x, 0.0, 1.0)],
        [
            pgm.TableCPD(mode, mode.previous, table=[[0.9, 0.1], [0.3, 0.7]]),
            pgm.GaussianCPD(h, 0.0, 1.0),
            pgm.SwitchingCPD(x, mode, cases),
        ],
        [pgm.LinearGaussianCPD(z, {x: 1.0}, cov=0.3)],
    )
    return model, mode, x, h, z


def test_a_mixture_has_its_gaussians_and_the_tables_of_its_modes(tmp_path):
    model, mode, x, _h, z = switching()
    values = np.array([[[0.1], [3.0], [3.2]], [[0.0], [0.5], [-2.0]]])
    posterior = pgm.smooth(model, {z: values}, belief=pgm.Gaussians(3))
    page = written(posterior, tmp_path)
    data, numbers = data_of(page), numbers_of(page)
    assert [each["name"] for each in data["discrete"]] == ["mode"]
    assert data["discrete"][0]["states"] == ["calm", "wild"]
    for run, row in enumerate(data["runs"]):

        def of(name, row=row):
            ref = row["arrays"][name]
            own = numbers[ref["at"] : ref["at"] + ref["rows"] * ref["columns"]]
            return own.reshape(ref["columns"], ref["rows"]).T

        np.testing.assert_allclose(of("states.0"), posterior[mode].probabilities[run], atol=1e-8)
        weights = of("weights")
        own = posterior[x].weights[run]
        np.testing.assert_allclose(np.sort(weights), np.sort(own), atol=1e-8)
        assert (np.diff(weights.sum(axis=0)) <= 1e-8).all()  # the heaviest first
        place = [v["name"] for v in data["variables"]].index("x")
        mean = sum(weights[:, [k]] * of(f"gaussian.{k}.mean") for k in range(3))
        np.testing.assert_allclose(mean[:, place], posterior[x].mean[run][:, 0], atol=1e-8)
        assert np.isnan(of("gaussian.0.mean")[0, 1 - place])  # a control begins at step 1
    whole = written(posterior, tmp_path, run=1, steps=(2, 3))
    assert data_of(whole)["runs"][0]["arrays"]["states.0"]["rows"] == 2


def test_a_single_gaussian_has_no_weights(tmp_path):
    model, _, _, _, z = switching()
    still = model.replace(
        transition=[
            pgm.TableCPD(model.transition[0].child, table=[0.9, 0.1]),
            *model.transition[1:],
        ]
    )
    data = data_of(written(pgm.filter(still, {z: [[0.1]]}), tmp_path))
    assert "weights" not in data["runs"][0]["arrays"]
    assert "states.0" in data["runs"][0]["arrays"]


def test_evidence_moves_beliefs_by_their_divergence_from_the_prior(tmp_path):
    """By the dense joint of a lattice, on a tree and round loops."""
    for method in (pgm.JunctionTree(), pgm.Bethe()):
        posterior = posteriors.lattice(3, method=method)
        names = [v.name for v in posterior.graph.network.variables]
        cov = np.zeros((9, 9))
        for k, cpd in enumerate(posterior.graph.network.cpds):
            weights = np.zeros(9)
            weights[[names.index(v.name) for v in cpd.parents]] = 0.45
            cov[k, :k] = cov[:k, k] = weights[:k] @ cov[:k, :k]
            cov[k, k] = 1.0 + weights[:k] @ cov[:k, :k] @ weights[:k]
        gain = cov[:, 8] / cov[8, 8]
        prior, mean = np.diag(cov)[:8], 2.0 * gain[:8]
        ratio = 1.0 - gain[:8] * cov[:8, 8] / prior
        due = 0.5 * (ratio - 1.0 - np.log(ratio) + mean**2 / prior)
        found = data_of(written(posterior, tmp_path))["runs"][0]["moved"]
        assert found.keys() == set(names[:8])
        values = [found[name] for name in names[:8]]
        # Round loops beliefs have the right means and other variances.
        np.testing.assert_allclose(values, due, rtol=1e-9 if method == pgm.JunctionTree() else 0.3)


def test_the_readings_of_a_step_move_its_prediction(tmp_path):
    """By a Kalman filter of scalars; the start is known exactly, so no reading moves it."""
    x, z = pgm.variables("x z")
    model = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(x, 1.0, 0.0)],
        [pgm.LinearGaussianCPD(x, {x.previous: 0.9}, cov=0.3)],
        [pgm.LinearGaussianCPD(z, {x: 2.0}, cov=0.5)],
    )
    zs = np.array([[1.5], [np.nan], [0.2]])
    mean, var, due = 1.0, 0.0, [np.nan]
    for (read,) in zs:
        mean, var = 0.9 * mean, 0.81 * var + 0.3
        before, prior = mean, var
        if not np.isnan(read):
            gain = 2.0 * var / (4.0 * var + 0.5)
            mean, var = mean + gain * (read - 2.0 * mean), (1.0 - 2.0 * gain) * var
        ratio = var / prior
        due.append(0.5 * (ratio - 1.0 - np.log(ratio) + (mean - before) ** 2 / prior))
    for call in (pgm.filter, pgm.smooth):
        page = written(call(model, {z: zs}), tmp_path)
        (ref,) = data_of(page)["runs"][0]["moved"].values()
        found = numbers_of(page)[ref["at"] :][: ref["rows"]]
        np.testing.assert_allclose(found, due, rtol=1e-6, atol=1e-12)


def test_what_has_no_prior_is_not_coloured(tmp_path):
    """Inputs have no distribution, and a flat Markov network has none without evidence."""
    a, b = pgm.variables("a b")
    net = pgm.BayesianNetwork([pgm.LinearGaussianCPD(b, {a: 1.0}, cov=1.0)])
    page = written(pgm.infer(pgm.compile(net), {a: 1.0}), tmp_path)
    assert data_of(page)["runs"][0]["moved"] == {}
    assert data_of(written(posteriors.balanced(), tmp_path))["runs"][0]["moved"] == {}


def test_truths_of_a_page(tmp_path):
    drawn, posterior = posteriors.simulated()
    page = written(posterior, tmp_path, truth=drawn, steps=(10, 20))
    (ref,) = data_of(page)["runs"][0]["truth"].values()
    found = numbers_of(page)[ref["at"] :][: ref["rows"] * ref["columns"]]
    np.testing.assert_allclose(
        found.reshape(ref["columns"], ref["rows"]).T, drawn[posteriors.x][9:21], rtol=1e-8
    )
    (a, *_), tree = posteriors.tree().graph.network.variables, posteriors.tree()
    for given in ("yes", 1):
        assert data_of(written(tree, tmp_path, truth={a: given}))["runs"][0]["truth"] == {"a": [1]}
    assert data_of(written(tree, tmp_path, truth={a: -1}))["runs"][0]["truth"] == {"a": [None]}
    balanced = posteriors.balanced()
    p = balanced.graph.layout.states[0]
    true = np.arange(18.0).reshape(9, 2)
    found = data_of(written(balanced, tmp_path, truth={p: true}))["runs"][0]["truth"]
    assert found == {f"p[{t}]": true[t].tolist() for t in range(9)}


def test_a_hidden_control_is_true_from_its_first_step(tmp_path):
    posterior = posteriors.driven()
    push = next(v for v in posterior.graph.layout.slice if v.name == "push")
    page = written(posterior, tmp_path, truth={push: np.arange(1.0, 9.0)[:, None]})
    ref = data_of(page)["runs"][0]["truth"]["push"]
    found = numbers_of(page)[ref["at"] :][: ref["rows"]]
    np.testing.assert_array_equal(found, [np.nan, *range(1, 9)])


@pytest.mark.parametrize(
    ("truth", "word"),
    [
        (lambda x, w: {x: np.zeros((41, 2))}, r"shape \(41, 2\); \(41, 3\) was due"),
        (lambda x, w: {x: np.zeros((40, 3))}, r"shape \(40, 3\); \(41, 3\) was due"),
        (lambda x, w: {x: (np.arange(41.0) * 40 % 360)[:, None] * np.ones(3)}, "degrees"),
        (lambda x, w: {w: ["sun"] * 41}, "which the network does not have"),
        (lambda x, w: {"x": np.zeros((41, 3))}, "use the variable itself"),
        (lambda x, w: np.zeros((41, 3)), "truth= maps variables to their true values"),
    ],
)
def test_truths_that_do_not_fit_are_refused(truth, word, tmp_path):
    with pytest.raises(pgm.PgmError, match=word):
        written(posteriors.smoothed(), tmp_path, truth=truth(posteriors.x, posteriors.weather))
    assert not (tmp_path / "page.html").exists()


def test_a_true_state_is_one_of_its_states(tmp_path):
    with pytest.raises(pgm.ModelError, match="has no state 'snow'"):
        written(posteriors.days(), tmp_path, truth={posteriors.weather: ["snow"] * 9})
