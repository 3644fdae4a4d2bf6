"""Mixed Markov networks, drawn, and their sums over all states of dense Gaussians."""

from itertools import product

import numpy as np
from scipy.linalg import null_space

import pgm


class Line:
    """A linear function of several variables, M x + b, of which nobody knows that it is linear."""

    def __init__(self, matrix, offset):
        self.matrix, self.offset = matrix, offset

    def __call__(self, *parts):
        return np.concatenate(parts, axis=-1) @ self.matrix.T + self.offset


NUMBER = [], np.zeros((0, 0)), np.zeros(0)


def drawn(rng, proper=0.85, exact=0.0):
    """A network of tables, forms, residuals, CPDs, and CPDs that are chosen or mixed.

    Beside it a list of functions: what a factor is for given states, as summands, each of them
    terms (scope, K, h, g), or (scope, None, C, c) of δ(C x − c). As many CPDs have no noise as
    `exact` says.
    """
    states = [pgm.Discrete(f"s{k}", int(rng.integers(2, 4))) for k in range(rng.integers(1, 4))]
    count = int(rng.integers(1, 5))
    sizes = rng.integers(1, 3, size=count).tolist()
    every = [pgm.Variable(f"x{k}", tuple("ab"[:d]) if d > 1 else ()) for k, d in enumerate(sizes)]
    factors, terms = [], []

    def add(factor, of_states):
        factors.append(factor)
        terms.append(of_states)

    for _ in range(rng.integers(0, 5)):
        add(*_table(rng, _some(rng, states, 1, 2)))
    for _ in range(rng.integers(1, 6)):
        scope = _some(rng, every, 1, 3)
        match int(rng.integers(6)):
            case 0:
                size = _width(scope)
                root = rng.normal(size=(int(rng.integers(0, size + 1)), size))
                form = root.T @ root, root.T @ rng.normal(size=len(root)), rng.normal()
                add(pgm.CanonicalForm(scope, *form), _always((scope, *form)))
            case 1:
                rows = int(rng.integers(1, 3))
                line = Line(rng.normal(size=(rows, _width(scope))), rng.normal(size=rows))
                cov, value = _cov(rng, rows), rng.normal(size=rows)
                term = _residual(scope, line.matrix, line.offset - value, cov)
                add(pgm.NonlinearGaussianFactor(scope, line, cov, value=value), _always(term))
            case 2:
                cpd, term = _gaussian(rng, scope, exact)
                add(cpd, _always(term))
            case 3:
                scopes = [[scope[0], *_some(rng, scope[1:], 0, 2)] for _ in range(2)]
                cpds = [_gaussian(rng, each, exact) for each in scopes]
                weight = rng.uniform(0.1, 0.9)
                mixed = pgm.MixtureCPD([cpd for cpd, _ in cpds], [weight, 1.0 - weight])
                found = [
                    (term, (*NUMBER, np.log(w)))
                    for (_, term), w in zip(cpds, (weight, 1.0 - weight), strict=True)
                ]
                add(mixed, lambda at, found=found: found)
            case _:
                add(*_switching(rng, scope, _some(rng, states, 1, 2), exact))
    for v in every:
        if rng.random() < proper:
            size = v.dimension
            form = rng.uniform(0.1, 2.0) * np.eye(size), rng.normal(size=size), 0.3
            add(pgm.CanonicalForm(v, *form), _always(([v], *form)))
    if rng.random() < 0.4:
        level = rng.normal()
        table, form = pgm.Table((), 1.0, level), pgm.CanonicalForm((), *NUMBER[1:], level)
        add(table if rng.random() < 0.5 else form, _always((*NUMBER, level)))
    held = {v for factor in factors for v in factor.scope}
    for v in states:
        if v not in held:
            add(pgm.Table.vacuous(v), _always((*NUMBER, 0.0)))
    order = rng.permutation(len(factors))
    return pgm.MarkovNetwork([factors[k] for k in order]), [terms[k] for k in order]


def _always(term):
    return lambda at: [(term,)]


def _some(rng, variables, least, most):
    count = int(rng.integers(least, most + 1))
    count = min(count, len(variables))
    return [variables[k] for k in rng.permutation(len(variables))[:count]]


def _width(scope):
    return sum(v.dimension for v in scope)


def _cov(rng, size):
    root = rng.normal(size=(size, size))
    return root @ root.T + 0.1 * np.eye(size)


def _table(rng, scope):
    shape = [v.size for v in scope]
    values = rng.uniform(0.1, 2.0, size=shape)
    values = np.where(rng.random(shape) < 0.2, 0.0, values)
    values[(0,) * len(shape)] = 1.0
    level = rng.normal()
    if rng.random() < 0.3:
        values = values + 0.01
        values, level = values / values.sum(axis=-1, keepdims=True), 0.0
        factor = pgm.TableCPD(scope[-1], given=scope[:-1], table=values)
    else:
        factor = pgm.Table(scope, values, level)

    def of_states(at):
        value = values[tuple(at[v] for v in scope)]
        return [((*NUMBER, np.log(value) + level if value else -np.inf),)]

    return factor, of_states


def _residual(scope, matrix, offset, cov):
    weight = np.linalg.inv(cov)
    level = -0.5 * (offset @ weight @ offset + np.linalg.slogdet(2.0 * np.pi * cov)[1])
    return scope, matrix.T @ weight @ matrix, -matrix.T @ weight @ offset, level


def _gaussian(rng, scope, exact):
    child, *parents = scope
    own = child.dimension
    matrices = {p: rng.normal(size=(own, p.dimension)) for p in parents}
    offset, cov = rng.normal(size=own), _cov(rng, own)
    matrix = np.hstack([np.eye(own), *(-m for m in matrices.values())])
    term = _residual(scope, matrix, -offset, cov)
    if rng.random() < exact:
        cov, term = np.zeros((own, own)), (scope, None, matrix, offset)
    if not parents:
        return pgm.GaussianCPD(child, offset, cov), term
    if exact or rng.random() < 0.5:  # where all on which others depend is linear
        return pgm.LinearGaussianCPD(child, matrices, offset=offset, cov=cov), term
    line = Line(np.hstack(list(matrices.values())), offset)
    return pgm.NonlinearGaussianCPD(child, parents, line, cov=cov), term


def _switching(rng, scope, switches, exact):
    cases, found = {}, {}
    for case in product(*(range(v.size) for v in switches)):
        own = [scope[0], *(scope[1:] if rng.random() < 0.7 else _some(rng, scope[1:], 0, 2))]
        cases[case], found[case] = _gaussian(rng, own, exact)
    cpd = pgm.SwitchingCPD(scope[0], switches, cases)
    return cpd, lambda at: [(found[tuple(at[v] for v in switches)],)]


def enumerated(network, terms, evidence):
    """ln Z, tables, and moments by variable; or None, and the least eigenvalue of a summand.

    It is relative to the largest, of all summands that are not zero: zero where relations without
    noise repeat one another. No sum is −inf.
    """
    states = [v for v in network.variables if isinstance(v, pgm.Discrete)]
    others = [v for v in network.variables if not isinstance(v, pgm.Discrete)]
    hidden = [v for v in others if v not in evidence]
    logs, means, covs, at = [], [], [], []
    least = np.inf
    for case in product(*(range(v.size) for v in states)):
        here = dict(zip(states, case, strict=True))
        if any(evidence.get(v, k) != k for v, k in here.items()):
            continue
        for summand in product(*(of_states(here) for of_states in terms)):
            each = [term for factor in summand for term in factor]
            if any(K is not None and g == -np.inf for _, K, _, g in each):
                continue
            mean, cov, log, own = _dense(each, others, hidden, evidence)
            if log == -np.inf:  # relations that contradict one another
                continue
            least = min(least, own)
            logs.append(log)
            means.append(mean)
            covs.append(cov)
            at.append(here)
    if not logs:
        return -np.inf, None, None, least
    if least < 1e-6:
        return None, None, None, least
    total = np.logaddexp.reduce(logs)
    weights = np.exp(np.array(logs) - total)
    tables = {
        v: np.array([weights[[here[v] == k for here in at]].sum() for k in range(v.size)])
        for v in states
        if v not in evidence
    }
    mean = weights @ np.array(means)
    away = np.array(means) - mean
    cov = np.einsum("k,kij->ij", weights, covs) + (weights[:, None] * away).T @ away
    return total, tables, (hidden, mean, cov), least


def _dense(each, others, hidden, evidence):
    """The mean, covariance and log-integral of a product of terms, and its least eigenvalue.

    Relations C x = c leave x = x₀ + N t, the columns of N orthonormal: δ(C x − c) has the integral
    over t, times |C Cᵀ|^(−1/2).
    """
    ends = np.cumsum([0, *(v.dimension for v in others)])
    places = {v: np.arange(ends[k], ends[k + 1]) for k, v in enumerate(others)}

    def components(scope):
        return np.concatenate([np.zeros(0, int), *(places[v] for v in scope)])

    K, h, g = np.zeros((ends[-1], ends[-1])), np.zeros(ends[-1]), 0.0
    rows, due = [np.zeros((0, ends[-1]))], [np.zeros(0)]
    for scope, matrix, slope, level in each:
        at = components(scope)
        if matrix is None:
            rows.append(np.zeros((len(level), ends[-1])))
            rows[-1][:, at] = slope
            due.append(level)
            continue
        K[np.ix_(at, at)] += matrix
        h[at] += slope
        g += level
    known = [v for v in others if v in evidence]
    seen = components(known)
    value = np.concatenate([np.zeros(0), *(evidence[v] for v in known)])
    g += h[seen] @ value - 0.5 * value @ K[np.ix_(seen, seen)] @ value
    h = h - K[:, seen] @ value
    at = components(hidden)
    C = np.concatenate(rows)
    c = np.concatenate(due) - C[:, seen] @ value
    K, h, C = K[np.ix_(at, at)], h[at], C[:, at]
    middle, basis = np.zeros(at.size), np.eye(at.size)
    if len(C):
        middle = np.linalg.pinv(C) @ c
        singular = np.linalg.svd(C, compute_uv=False)
        if len(C) > at.size or singular[-1] < 1e-6:
            same = np.abs(C @ middle - c).max() < 1e-6
            return middle, K, 0.0 if same else -np.inf, 0.0
        basis = null_space(C)
        g += h @ middle - 0.5 * middle @ K @ middle - np.log(singular).sum()
        h, K = basis.T @ (h - K @ middle), basis.T @ K @ basis
    if not h.size:
        return middle, basis @ K @ basis.T, g, np.inf
    values = np.linalg.eigvalsh(K)
    own = values.min() / max(values.max(), 1.0)
    if own < 1e-6:
        return middle, K, g, own
    cov = np.linalg.inv(K)
    cov = 0.5 * (cov + cov.T)
    log = g + 0.5 * h @ cov @ h + 0.5 * np.linalg.slogdet(2.0 * np.pi * cov)[1]
    return middle + basis @ cov @ h, basis @ cov @ basis.T, log, own
