"""Textbook twins: random discrete networks, and every answer from the table of all assignments."""

import numpy as np

import pgm


def network(seed, count=8, largest=4, parents=3, zeros=0.0, deterministic=0.0, before=None):
    """Draw a network, some of whose columns have zeros or are certain; parents are recent ones."""
    rng = np.random.default_rng(seed)
    variables = [pgm.Discrete(f"v{k}", int(rng.integers(1, largest + 1))) for k in range(count)]
    cpds = []
    for k, child in enumerate(variables):
        pool = np.arange(max(0, k - (before or k)), k)
        chosen = rng.choice(pool, min(pool.size, int(rng.integers(0, parents + 1))), replace=False)
        given = tuple(variables[j] for j in chosen)
        table = rng.dirichlet(np.ones(child.size), [v.size for v in given])
        table = np.where(rng.random(table.shape) < zeros, 0.0, table)
        certain = np.eye(child.size)[rng.integers(0, child.size, table.shape[:-1])]
        lost = (table.sum(axis=-1) == 0.0) | (rng.random(table.shape[:-1]) < deterministic)
        table = np.where(lost[..., None], certain, table)
        table = table / table.sum(axis=-1, keepdims=True)
        cpds.append(pgm.TableCPD(child, given, table=table))
    return pgm.BayesianNetwork([cpds[k] for k in rng.permutation(count)])


class Enumeration:
    """The probabilities of all assignments, with evidence put in."""

    def __init__(self, net, states=None, weights=None):
        self.variables = list(net.variables)
        self.table = np.ones([v.size for v in self.variables])
        for cpd in net.cpds:
            self._times((*cpd.given, cpd.child), cpd.table)
        for variable, state in (states or {}).items():
            self._times((variable,), np.eye(variable.size)[variable.index(state)])
        for variable, given in (weights or {}).items():
            self._times((variable,), np.asarray(given, dtype=float))

    def _times(self, scope, factor):
        self.table = np.einsum(
            self.table,
            range(self.table.ndim),
            factor,
            [self.variables.index(v) for v in scope],
            range(self.table.ndim),
        )

    @property
    def evidence(self):
        return self.table.sum()

    def unnormalised(self, *wanted):
        axes = [self.variables.index(v) for v in wanted]
        return np.einsum(self.table, range(self.table.ndim), axes)

    def marginal(self, *wanted):
        return self.unnormalised(*wanted) / self.evidence

    def value(self, assignment):
        return self.table[tuple(v.index(assignment[v]) for v in self.variables)]
