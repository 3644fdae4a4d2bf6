"""A linear Gaussian network of seven scalars, with a cluster graph made by hand.

    a → d → e ← b → f ← c,  f → g

The structure, its clusters and their numbers 1 to 4 are those of the 2018 report
(sections 5.3 to 5.5, figures 5.3 to 5.5, equations 5.5, 5.11 and 5.12). The numbers in the CPDs are
of this project, for the report gives none; where the factor p(b) goes, which clusters 2 and 3 could
both hold, is left to `pgm.ClusterGraph`.
"""

import pgm

a, b, c, d, e, f, g = pgm.variables("a b c d e f g")

# Of the report, whose numbers start at 1: cluster k of the report is k − 1 of the graph.
CLUSTERS = {1: (a, d), 2: (b, d, e), 3: (b, c, f), 4: (f, g)}
SEPSETS = {(1, 2): (d,), (2, 3): (b,), (3, 4): (f,)}


def seven_nodes() -> pgm.BayesianNetwork:
    """The network.

    p(a) p(b) p(c) p(d | a) p(e | b, d) p(f | b, c) p(g | f)
    """
    return pgm.BayesianNetwork(
        [
            pgm.GaussianCPD(a, mean=1.0, cov=1.0),
            pgm.GaussianCPD(b, mean=-0.5, cov=2.0),
            pgm.GaussianCPD(c, mean=2.0, cov=0.5),
            pgm.LinearGaussianCPD(d, given={a: 0.8}, offset=-0.2, cov=0.4),
            pgm.LinearGaussianCPD(e, given={b: 1.0, d: -0.5}, offset=0.3, cov=0.5),
            pgm.LinearGaussianCPD(f, given={b: 0.7, c: 1.2}, cov=0.3),
            pgm.LinearGaussianCPD(g, given={f: -1.5}, offset=1.0, cov=0.6),
        ]
    )


def seven_nodes_clusters() -> pgm.ClusterGraph:
    """The cluster graph, a chain: {a, d} – d – {b, d, e} – b – {b, c, f} – f – {f, g}.

    The report's message δ₂,₃ is ``posterior.message(1, 2)``, and δ₃,₄ ``posterior.message(2, 3)``.
    """
    return pgm.ClusterGraph(
        seven_nodes(),
        CLUSTERS.values(),
        sepsets={(i - 1, j - 1): members for (i, j), members in SEPSETS.items()},
    )
