"""The seven-variable network and its clusters."""

from models import seven_nodes as s


def test_the_factorisation():
    due = {s.a: (), s.b: (), s.c: (), s.d: (s.a,), s.e: (s.b, s.d), s.f: (s.b, s.c), s.g: (s.f,)}
    assert {cpd.child: cpd.given for cpd in s.seven_nodes().cpds} == due


def test_the_clusters():
    graph = s.seven_nodes_clusters()
    graph.check()
    assert [set(cluster.scope) for cluster in graph] == [
        {s.a, s.d},
        {s.b, s.d, s.e},
        {s.b, s.c, s.f},
        {s.f, s.g},
    ]
    assert dict(graph.sepsets) == {(0, 1): (s.d,), (1, 2): (s.b,), (2, 3): (s.f,)}
    assert graph.is_tree
    assert [len(cluster.cpds) for cluster in graph] == [2, 2, 2, 1]


def test_the_sepsets_separate():
    net = s.seven_nodes()
    for (i, j), sepset in s.SEPSETS.items():
        left = {v for k in range(1, i + 1) for v in s.CLUSTERS[k]} - set(sepset)
        right = {v for k in range(j, 5) for v in s.CLUSTERS[k]} - set(sepset)
        assert net.separated(left, right, given=sepset)
