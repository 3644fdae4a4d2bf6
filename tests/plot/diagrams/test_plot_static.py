from itertools import combinations, pairwise

import matplotlib.pyplot as plt
import numpy as np
import pytest
from crossed import crossed
from matplotlib.colors import to_rgb
from matplotlib.patches import Ellipse, FancyArrowPatch

import pgm
import pgm.plot

ASIA = {
    "visit to Asia": [],
    "smoker": [],
    "tuberculosis": ["visit to Asia"],
    "lung cancer": ["smoker"],
    "bronchitis": ["smoker"],
    "either": ["tuberculosis", "lung cancer"],
    "X-ray": ["either"],
    "dyspnoea": ["either", "bronchitis"],
}


def gaussian(parents):
    """A network from the names of each variable's parents."""
    v = {name: pgm.Variable(name) for name in parents}
    return pgm.BayesianNetwork(
        pgm.LinearGaussianCPD(v[name], given={v[p]: 1.0 for p in given}, cov=1.0)
        if given
        else pgm.GaussianCPD(v[name], 0.0, 1.0)
        for name, given in parents.items()
    )


def discrete(parents):
    v = {name: pgm.Discrete(name, states=("no", "yes")) for name in parents}
    return pgm.BayesianNetwork(
        pgm.TableCPD(
            v[name], given=[v[p] for p in given], table=np.full((2,) * (len(given) + 1), 0.5)
        )
        for name, given in parents.items()
    )


def random(count, seed, most=2):
    rng = np.random.default_rng(seed)
    names = [f"v{k}" for k in range(count)]
    return {
        names[k]: rng.choice(
            names[max(0, k - 9) : k], size=min(k, int(rng.integers(0, most + 1))), replace=False
        ).tolist()
        for k in range(count)
    }


NETWORKS = {
    "asia": ASIA,
    "one": {"only": []},
    "apart": {f"v{k}": [] for k in range(12)},
    "chain": {f"v{k}": [f"v{k - 1}"] if k else [] for k in range(20)},
    "hub": {"class": [], **{f"f{k}": ["class"] for k in range(40)}},
    "sink": {**{f"f{k}": [] for k in range(20)}, "y": [f"f{k}" for k in range(20)]},
    "complete": {f"v{k}": [f"v{j}" for j in range(k)] for k in range(7)},
    "random": random(60, 0),
    "dense": random(40, 1, most=4),
}


def parts(ax):
    """Ellipses by label, and the points along each arrow's line."""
    at = {text.get_position(): text.get_text().replace("\n", " ") for text in ax.texts}
    nodes = {
        at[tuple(p.center)].replace("- ", "-"): p for p in ax.patches if isinstance(p, Ellipse)
    }
    lines = [p._path_original.vertices for p in ax.patches if isinstance(p, FancyArrowPatch)]
    return nodes, lines


def reach(path, ellipse):
    """How far points are from an ellipse's centre, in its half-axes."""
    half = 0.5 * np.array([ellipse.width, ellipse.height])
    return np.linalg.norm((path - np.array(ellipse.center)) / half, axis=-1)


def ends(line, nodes):
    """The nodes on whose borders a line begins and ends."""
    return tuple(
        min(nodes, key=lambda name: abs(reach(line[[k]], nodes[name])[0] - 1.0)) for k in (0, -1)
    )


@crossed(("name", "size"), list(NETWORKS), [None, (12.0, 2.5)])
def test_all_is_there_in_order_and_nothing_lies_on_anything(name, size):
    parents = NETWORKS[name]
    ax = None if size is None else plt.subplots(figsize=size)[1]
    ax = pgm.plot.network(gaussian(parents), ax=ax)
    nodes, lines = parts(ax)
    assert set(nodes) == set(parents)
    found = {ends(line, nodes) for line in lines}
    assert found == {(p, child) for child, given in parents.items() for p in given}
    assert len(lines) == len(found)

    for one, other in combinations(nodes.values(), 2):
        gap = np.abs(np.subtract(one.center, other.center))
        half = 0.5 * np.array([one.width + other.width, one.height + other.height])
        assert (gap > 1.02 * half).any()
    for line in lines:
        first, last = ends(line, nodes)
        for node, ellipse in nodes.items():
            nearest = reach(line, ellipse).min()
            assert nearest > (0.99 if node in (first, last) else 1.05)
    # Parents stand above all their children, or left of them.
    apart = np.array([np.subtract(nodes[c].center, nodes[p].center) for p, c in found])
    assert not found or (apart[:, 1] < 0).all() or (apart[:, 0] > 0).all()


@pytest.mark.parametrize("size", [None, (3.0, 3.0), (9.0, 2.5)])
@pytest.mark.parametrize("name", ["asia", "random"])
def test_labels_fit_their_ellipses_and_all_is_inside(name, size):
    ax = pgm.plot.network(
        discrete(NETWORKS[name]), ax=None if size is None else plt.subplots(figsize=size)[1]
    )
    ax.figure.dpi = 300
    ax.figure.canvas.draw()
    ellipses = {tuple(p.center): p for p in ax.patches if isinstance(p, Ellipse)}
    frame = ax.get_window_extent()
    for text in ax.texts:
        inner = text.get_window_extent()
        outer = ellipses[text.get_position()].get_window_extent()
        assert np.hypot(inner.width / outer.width, inner.height / outer.height) < 1.0
        assert frame.x0 <= outer.x0 <= outer.x1 <= frame.x1
        assert frame.y0 <= outer.y0 <= outer.y1 <= frame.y1
    if size is None:
        assert min(text.get_fontsize() for text in ax.texts) > 7.0


def turn(p, q, r):
    """The sign of the turn from p through q to r."""
    one, other = q - p, r - p
    return np.sign(one[..., 0] * other[..., 1] - one[..., 1] * other[..., 0])


def crossed(lines):
    """Pairs of lines that cross, by brute force over their pieces."""
    count = 0
    for one, other in combinations(lines, 2):
        a, b = one[:-1, None], one[1:, None]
        c, d = other[None, :-1], other[None, 1:]

        ahead = turn(a, b, c) * turn(a, b, d) < 0
        across = turn(c, d, a) * turn(c, d, b) < 0
        count += bool((ahead & across).any())
    return count


def test_planar_networks_have_no_crossings():
    tree = {f"v{k}": [f"v{(k - 1) // 3}"] if k else [] for k in range(30)}
    for parents in (ASIA, tree, NETWORKS["chain"]):
        assert crossed(parts(pgm.plot.network(gaussian(parents)))[1]) == 0


def test_inputs_and_evidence_are_shaded():
    x, u, z = pgm.variables("x u z")
    net = pgm.BayesianNetwork(
        [
            pgm.LinearGaussianCPD(x, given={u: 1.0}, cov=1.0),
            pgm.LinearGaussianCPD(z, given={x: 1.0}, cov=1.0),
        ]
    )
    for evidence, due in ((None, {"u"}), ([z], {"u", "z"}), ({z: 1.0, u: 2.0}, {"u", "z"})):
        nodes, _ = parts(pgm.plot.network(net, evidence=evidence))
        shaded = {name for name, p in nodes.items() if to_rgb(p.get_facecolor()) != (1, 1, 1)}
        assert shaded == due


def unrolled(steps):
    """What unrolling a robot with a sensor gives."""
    x, u, z = pgm.variables("x u z")
    linear = pgm.LinearGaussianCPD
    cpds = [pgm.GaussianCPD(x.at(0), 0.0, 1.0)]
    for t in range(1, steps + 1):
        cpds.append(linear(x.at(t), given={x.at(t - 1): 1.0, u.at(t): 1.0}, cov=1.0))
        cpds.append(linear(z.at(t), given={x.at(t): 1.0}, cov=1.0))
    return pgm.BayesianNetwork(cpds), z


def test_a_network_at_steps_runs_left_to_right_a_column_a_step():
    net, z = unrolled(6)
    ax = pgm.plot.network(net, evidence=[z])
    circles = {text.get_position(): text.get_text() for text in ax.texts}
    nodes = {circles[p.center]: p for p in ax.patches if isinstance(p, Ellipse)}
    assert set(nodes) == {repr(v) for v in net.variables}
    extent = [[nodes[repr(v)].center[0] for v in net.variables if v.step == t] for t in range(7)]
    assert all(max(one) < min(other) for one, other in pairwise(extent))
    assert len({nodes[f"x[{t}]"].center[1] for t in range(7)}) == 1
    shaded = {name for name, p in nodes.items() if to_rgb(p.get_facecolor()) != (1, 1, 1)}
    assert shaded == {f"{name}[{t}]" for name in "uz" for t in range(1, 7)}


def test_a_network_with_arrows_over_several_steps_or_back_stands_in_layers():
    x = pgm.Variable("x")
    linear = pgm.LinearGaussianCPD
    for second, third in ((1, 3), (2, 1)):
        net = pgm.BayesianNetwork(
            [
                pgm.GaussianCPD(x.at(0), 0.0, 1.0),
                linear(x.at(second), given={x.at(0): 1.0}, cov=1.0),
                linear(x.at(third), given={x.at(second): 1.0}, cov=1.0),
            ]
        )
        nodes, lines = parts(pgm.plot.network(net))
        assert {ends(line, nodes) for line in lines} == {
            ("x[0]", f"x[{second}]"),
            (f"x[{second}]", f"x[{third}]"),
        }


def test_what_does_not_fit_is_refused():
    net = gaussian(ASIA)
    with pytest.raises(pgm.ModelError, match="steps cut a DynamicBayesianNetwork"):
        pgm.plot.network(net, steps=2)
    stranger = pgm.Variable("weather")
    with pytest.raises(pgm.EvidenceError, match="names weather, which the network") as caught:
        pgm.plot.network(net, evidence=[stranger])
    assert caught.value.variable == stranger
    with pytest.raises(pgm.EvidenceError, match="names 'smoker'"):
        pgm.plot.network(net, evidence={"smoker": 1.0})
    assert not plt.get_fignums()


def test_a_network_at_one_step_stands_in_layers():
    v = {name: pgm.Variable(name).at(3) for name in ASIA if name.isalpha()}
    net = pgm.BayesianNetwork(
        [
            pgm.GaussianCPD(v["smoker"], 0.0, 1.0),
            pgm.LinearGaussianCPD(v["bronchitis"], given={v["smoker"]: 1.0}, cov=1.0),
        ]
    )
    nodes, lines = parts(pgm.plot.network(net))
    assert [ends(line, nodes) for line in lines] == [("smoker [3]", "bronchitis [3]")]


def test_a_picture_does_not_depend_on_the_hashes_of_names():
    def centres(letter):
        named = {
            letter + name[1:]: [letter + parent[1:] for parent in given]
            for name, given in NETWORKS["random"].items()
        }
        nodes, _ = parts(pgm.plot.network(gaussian(named)))
        return {name[1:]: ellipse.center for name, ellipse in nodes.items()}

    assert centres("b") == centres("d") == centres("p") == centres("q")
