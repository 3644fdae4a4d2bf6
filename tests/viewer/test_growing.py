"""The page of a growing map: its cliques, what was touched, and the numbers of its factors."""

import html
import re

import numpy as np
import pytest
from viewer import posteriors
from viewer.test_page import data_of, numbers_of, written

import pgm
from pgm.viewer import growing
from pgm.viewer.numbers import CELL, Limits, Numbers, lower


def chain(count, names=None, every=20):
    """Scalars in a row, each added with its motion and a reading of it."""
    x = [pgm.Variable(name) for name in names or [f"x{k}" for k in range(count)]]
    grown = pgm.GrowingMap(tolerance=0.0, every=every).add(pgm.GaussianCPD(x[0], 0.0, 1.0))
    for k in range(1, count):
        z = pgm.Variable(f"z{k}")
        bent = pgm.NonlinearGaussianCPD(z, given=x[k], function=np.sinh, cov=0.1)
        step = pgm.LinearGaussianCPD(x[k], {x[k - 1]: 1.0}, cov=1.0)
        grown = grown.add([step, bent], {z: np.sinh(0.2 * k % 3)})
    return grown


def test_a_page_has_the_cliques_and_what_was_touched(tmp_path):
    grown = chain(120)
    data = data_of(written(grown, tmp_path))
    tree = grown.cliques
    assert data["graph"] == "growing map"
    assert len(data["clusters"]) == len(tree) > 3
    assert [c["index"] for c in data["clusters"] if c["touched"]] == sorted(tree.touched)
    assert data["touched"]["cliques"] == len(tree.touched) < len(tree)
    names = [v["name"] for v in data["variables"]]
    for cluster in data["clusters"]:
        k = cluster["index"]
        assert [names[v] for v in cluster["pivots"]] == [repr(v) for v in tree.pivots[k]]
        assert [names[v] for v in cluster["scope"]] == [repr(v) for v in tree.scope(k)]
        observed = {name: value for name, (value,) in cluster["observed"]}
        for cpd in tree.clusters[k].cpds:
            if isinstance(cpd, pgm.NonlinearGaussianCPD):
                shown = f"{grown.evidence[cpd.child]:.6g}"
                assert observed[repr(cpd.child)] == shown
    assert grown.relinearised
    told = {repr(v) for v in grown.relinearised}
    assert {v["name"] for v in data["variables"] if v["anew"]} == told
    assert set(data["touched"]["anew"]) == told
    assert {tuple(edge["ends"]) for edge in data["edges"]} == set(tree.sepsets)
    assert data["notes"] == []
    # From the root on.
    assert data["places"]["towards"][0] is None
    assert data["places"]["towards"][1] == 0


def test_the_numbers_are_those_of_the_tree(tmp_path):
    grown = chain(60)
    text = written(grown, tmp_path)
    data, numbers, tree = data_of(text), numbers_of(text), grown.cliques

    def canonical(found, size):
        half = size * (size + 1) // 2
        own = numbers[found["at"] :]
        return own[:half], own[half : half + size]

    for cluster in data["clusters"]:
        k = cluster["index"]
        due, joint = tree.potential(k), grown.joint(*tree.scope(k))
        K, h = canonical(cluster["potential"][0], len(joint.mean))
        np.testing.assert_allclose(K, lower(due.K), rtol=1e-12, atol=1e-300)
        np.testing.assert_allclose(h, due.h, rtol=1e-12, atol=1e-300)
        belief = cluster["belief"][0]
        mean = numbers[belief["at"] :][: len(joint.mean)]
        np.testing.assert_allclose(mean, joint.mean, rtol=1e-12)
    for edge in data["edges"]:
        i, j = edge["ends"]
        for part, message in (("there", tree.message(i, j)), ("back", tree.message(j, i))):
            K, _ = canonical(edge[part][0], len(message.h))
            np.testing.assert_allclose(K, lower(message.K), rtol=1e-12, atol=1e-300)


def test_large_maps_show_what_was_touched_and_then_the_nearest():
    grown = chain(400)
    tree = grown.cliques
    few = Limits(1, 1, len(tree.touched) + 2, 1, 1, False, False)
    page = growing.page(grown, Numbers(), few)
    shown = [cluster["index"] for cluster in page["clusters"]]
    assert shown == list(range(len(tree.touched) + 2))
    assert all(c["touched"] for c in page["clusters"][:-2])
    assert not any(c["touched"] for c in page["clusters"][-2:])
    assert page["cut"].startswith(f"{len(shown)} of {len(tree)} cliques are shown: those that")
    assert sum(len(c["cut"]) for c in page["clusters"]) > 0
    whole = growing.page(grown, Numbers(), CELL)
    assert whole["cut"] is None or len(whole["clusters"]) == CELL.clusters


def test_frames_of_notebooks_hold_fewer():
    grown = chain(1500, every=2000)  # what is linearised anew is joined in larger cliques
    frame = pgm.viewer.html(grown)
    page = html.unescape(re.search(r'srcdoc="(.*?)" sandbox="allow-scripts"', frame, re.S)[1])
    data = data_of(page)
    assert len(data["clusters"]) == CELL.clusters < len(grown.cliques)
    assert data["notes"][0].startswith(f"{CELL.clusters} of {len(grown.cliques):,} cliques are")


def test_what_users_wrote_is_escaped(tmp_path):
    page = written(chain(3, posteriors.HOSTILE), tmp_path)
    assert page.count("</script>") == 3
    names = {variable["name"] for variable in data_of(page)["variables"]}
    assert names == set(posteriors.HOSTILE)


def test_what_a_map_does_not_have_is_refused(tmp_path):
    grown, path = chain(3), tmp_path / "page.html"
    with pytest.raises(pgm.GraphError, match=r"run=0: a growing map has no run"):
        pgm.view(grown, path, run=0)
    with pytest.raises(pgm.GraphError, match=r"steps=\(0, 1\): a growing map has no steps"):
        pgm.view(grown, path, steps=(0, 1))
    with pytest.raises(pgm.GraphError, match="no hidden variable yet"):
        pgm.view(pgm.GrowingMap(), path)
    assert not path.exists()


def test_the_browser_shows_what_was_touched(look):
    grown = chain(60)
    tree, browser = grown.cliques, look(grown)
    assert "touched by the last addition" in browser.text("#graph-box .key")
    facts = browser.text("#facts")
    assert f"{len(tree.touched)} touched" in facts
    assert f"{len(grown.relinearised)} variable" in facts
    marked = browser.run(
        "return [...document.querySelectorAll('#graph .touched')].map((n) => n.dataset.cluster)"
    )
    assert sorted(map(int, marked)) == sorted(tree.touched)
    assert "0 touched" in browser.text('[data-cluster="0"]')
    role = browser.text("#inspector .role")
    assert role.startswith("eliminates ")
    assert role.endswith("; touched by the last addition")
    # The page's own product of potential and messages is the belief.
    _, exact = browser.numbers("belief", "mean")
    due = grown.joint(*tree.scope(0))
    np.testing.assert_allclose([row[0] for row in exact], due.mean, rtol=1e-9)
    K = np.array(browser.numbers("belief", "K")[1])
    np.testing.assert_allclose(np.linalg.inv(K), due.cov, rtol=1e-6, atol=1e-12)
