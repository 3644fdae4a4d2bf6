"""Mixed networks, drawn, and their posterior by a dense Gaussian for each configuration."""

from itertools import product

import numpy as np

import pgm


def drawn(seed, exact=0.0, most=4, components=2, zeros=0.3):
    """A network of some discrete and some continuous variables in a random order of parents."""
    rng = np.random.default_rng(seed)
    switches = [
        pgm.Discrete(f"d{k}", int(rng.integers(2, 4))) for k in range(rng.integers(1, most))
    ]
    cpds = []
    for k, variable in enumerate(switches):
        given = _some(rng, switches[:k], 2)
        table = rng.dirichlet(np.ones(variable.size), size=[v.size for v in given])
        table = np.where(rng.random(table.shape) < zeros, 0.0, table)
        table[..., 0] += table.sum(axis=-1) == 0.0
        cpds.append(pgm.TableCPD(variable, given, table=table / table.sum(axis=-1, keepdims=True)))
    known = []
    for k in range(rng.integers(1, 6)):
        size = int(rng.integers(1, components + 1))
        child = pgm.Variable(f"x{k}", tuple("abc"[:size]))
        chosen_by = _some(rng, switches, 2)
        parents = _some(rng, known, 2)
        if chosen_by and rng.random() < 0.8:
            cases = {}
            for case in product(*(range(v.size) for v in chosen_by)):
                own = _some(rng, parents, 2) if rng.random() < 0.3 else parents
                cases[case] = _gaussian(rng, child, own, exact)
            cpds.append(pgm.SwitchingCPD(child, chosen_by, cases))
        else:
            cpds.append(_gaussian(rng, child, parents, exact))
        known.append(child)
    order = rng.permutation(len(cpds))
    return pgm.BayesianNetwork([cpds[k] for k in order]), rng


def _some(rng, variables, most):
    count = min(len(variables), int(rng.integers(0, most + 1)))
    return [variables[k] for k in rng.choice(len(variables), count, replace=False)] if count else []


def _gaussian(rng, child, parents, exact):
    size = child.dimension
    root = rng.normal(size=(size, size)) + np.eye(size)
    cov = np.zeros((size, size)) if rng.random() < exact else root @ root.T
    if not parents:
        return pgm.GaussianCPD(child, rng.normal(size=size), cov)
    matrices = {p: rng.normal(size=(size, p.dimension)) for p in parents}
    return pgm.LinearGaussianCPD(child, matrices, cov, offset=rng.normal(size=size))


def observed(network, rng, share=0.4):
    """Evidence on some variables, as they were drawn together."""
    values = network.sample((), rng=rng)
    found = {}
    for variable in network.variables:
        if rng.random() < share:
            value = values[variable]
            found[variable] = int(value) if isinstance(variable, pgm.Discrete) else value
    return found


def enumerated(network, evidence):
    """ln p(evidence), and by variable its probabilities, or the mixture's mean and covariance.

    The densities of evidence that a configuration makes certain are left out, and configurations
    that make less of it certain than others do. ln p is None where evidence repeats evidence.
    """
    switches = [v for v in network.variables if isinstance(v, pgm.Discrete)]
    others = [v for v in network.variables if not isinstance(v, pgm.Discrete)]
    found = []
    for case in product(*(range(v.size) for v in switches)):
        states = dict(zip(switches, case, strict=True))
        if any(evidence.get(v, k) != k for v, k in states.items()):
            continue
        prior = 1.0
        for cpd in network.cpds:
            if cpd.discrete:
                prior *= cpd.table[(*(states[v] for v in cpd.given), states[cpd.child])]
        if prior > 0.0:
            found.append((states, np.log(prior), *_dense(network, states, others, evidence)))
    most = max(certain for _, _, log, certain, *_ in found if np.isfinite(log))
    logs = np.array([a + log if certain == most else -np.inf for _, a, log, certain, *_ in found])
    total = np.logaddexp.reduce(logs)
    plain = all(plain for *_, plain in found)
    weights = np.exp(logs - total)
    tables = {
        v: np.array([weights[[s[v] == k for s, *_ in found]].sum() for k in range(v.size)])
        for v in switches
        if v not in evidence
    }
    beliefs = {}
    for variable in others:
        if variable not in evidence:
            means = np.array([mean[variable] for *_, mean, _, _ in found])
            covs = np.array([cov[variable, variable] for *_, cov, _ in found])
            mean = weights @ means
            away = means - mean
            cov = np.einsum("k,kij->ij", weights, covs) + (weights[:, None] * away).T @ away
            beliefs[variable] = mean, cov
    return total if plain else None, tables, beliefs


def _dense(network, states, others, evidence):
    """Log-density, certain dimensions, means and covariances of one configuration.

    And whether it is no more than single components that are certain, which leave no doubt of which
    density that of the others is.
    """
    start, size = {}, 0
    for variable in others:
        start[variable] = slice(size, size + variable.dimension)
        size += variable.dimension
    mean, cov = np.zeros(size), np.zeros((size, size))
    for cpd in network.cpds:
        if cpd.discrete:
            continue
        if isinstance(cpd, pgm.SwitchingCPD):
            cpd = cpd.cases[tuple(states[v] for v in cpd.switches)]
        F = np.zeros((cpd.child.dimension, size))
        for parent in cpd.given:
            F[:, start[parent]] = cpd.matrices[parent]
        own = start[cpd.child]
        mean[own] = cpd.offset + F @ mean
        cov[own] = F @ cov
        cov[:, own] = cov[own].T
        cov[own, own] = F @ cov @ F.T + cpd.cov
    seen = [v for v in others if v in evidence]
    places = np.concatenate([np.arange(size)[start[v]] for v in seen] or [[]]).astype(int)
    away = np.concatenate([np.atleast_1d(evidence[v]) for v in seen] or [[]]) - mean[places]
    values, vectors = np.linalg.eigh(cov[np.ix_(places, places)])
    kept = values > 1e-11 * max(values.max(initial=0.0), 1e-300)
    inside = vectors[:, kept].T @ away
    if (np.abs(vectors[:, ~kept].T @ away) > 1e-6).any():
        log = -np.inf
    else:
        log = -0.5 * (inside**2 / values[kept] + np.log(2 * np.pi * values[kept])).sum()
    inverse = vectors[:, kept] / values[kept] @ vectors[:, kept].T
    gain = cov[:, places] @ inverse
    mean, cov = mean + gain @ away, cov - gain @ cov[places]
    means = {v: mean[start[v]] for v in others}
    covs = {(v, w): cov[start[v], start[w]] for v in others for w in others}
    plain = bool(((np.abs(vectors[:, ~kept]) > 1e-9).sum(axis=0) == 1).all())
    # Nor does a dense covariance keep the digits of what is all but certain.
    plain = plain and bool((values[kept] > 1e-7 * values.max(initial=0.0)).all())
    return log, int((~kept).sum()), means, covs, plain
