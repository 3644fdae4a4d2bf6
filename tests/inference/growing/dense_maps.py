"""Networks that grow, drawn, and the belief of all of their rows at once."""

import numpy as np

import pgm
from models import motion

POSE = {"components": ("east", "north", "heading"), "angles": ("heading",)}
MOTION = {"components": ("forward", "left", "turn"), "angles": ("turn",)}


def edge(name, one, other, cov=(0.01, 0.01, 0.001)):
    """A measurement of one pose seen from another."""
    return pgm.NonlinearGaussianCPD(
        pgm.Variable(name, **MOTION),
        given=(one, other),
        function=motion.relative,
        cov=cov,
        jacobian={one: motion.relative_by_state, other: motion.relative_by_other},
    )


def free(variable):
    return pgm.GaussianCPD(variable, np.zeros(variable.dimension), np.inf)


def rings(seed, count, closures=0.4):
    """Poses on rings, one at a time: CPDs, evidence and start; the first is held."""
    rng = np.random.default_rng(seed)
    turn = rng.uniform(0.5, 0.9)
    truth = np.array(
        [[5 * np.sin(k * turn), 5 * np.cos(k * turn), -k * turn] for k in range(count)]
    )
    poses = [pgm.Variable(f"x{k}", **POSE) for k in range(count)]

    def told(i, j):
        exact = motion.relative(truth[i][None], truth[j][None])[0]
        return exact + rng.normal(size=3) * [0.1, 0.1, 0.03]

    steps = [([free(poses[0])], {poses[0]: truth[0]}, {})]
    for k in range(1, count):
        ends = [k - 1, *(j for j in range(k - 1) if rng.random() < closures / (1 + 0.2 * (k - j)))]
        cpds, evidence = [free(poses[k])], {}
        for j in ends:
            one, other = (j, k) if rng.random() < 0.7 else (k, j)
            cpds.append(edge(f"z{one}_{other}", poses[one], poses[other]))
            evidence[cpds[-1].child] = told(one, other)
        start = truth[k] + rng.normal(size=3) * [0.3, 0.3, 0.1]
        steps.append((cpds, evidence, {poses[k]: start}))
    return steps


def linear(seed, count):
    """Linear CPDs of variables of one to three components, some of each at once."""
    rng = np.random.default_rng(seed)
    steps, known = [], []
    for k in range(count):
        cpds, evidence = [], {}
        for i in range(rng.integers(1, 4)):
            size = int(rng.integers(1, 4))
            new = pgm.Variable(f"v{k}_{i}", tuple("abc"[:size]))
            few = min(len(known), int(rng.integers(0, 3)))
            parents = [known[j] for j in rng.choice(len(known), few, replace=False)] if few else []
            root = rng.normal(size=(size, size)) + 2 * np.eye(size)
            if parents:
                given = {p: rng.normal(size=(size, p.dimension)) for p in parents}
                offset = rng.normal(size=size)
                cpds.append(pgm.LinearGaussianCPD(new, given, root @ root.T, offset=offset))
            else:
                cpds.append(pgm.GaussianCPD(new, rng.normal(size=size), root @ root.T))
            if rng.random() < 0.3 and known:
                evidence[new] = rng.normal(size=size)
            else:
                known.append(new)
        steps.append((cpds, evidence, {}))
    return steps


def dense(cpds, evidence, points):
    """Means by variable, the covariance of all of them, and where each stands in it."""
    place, size = {}, 0
    for variable in points:
        place[variable] = slice(size, size + variable.dimension)
        size += variable.dimension
    rows, right = [np.zeros((0, size))], [np.zeros(0)]
    values = {**{v: np.atleast_1d(value) for v, value in evidence.items()}, **points}
    for cpd in cpds:
        child, wrapped = cpd.child, cpd.child in evidence
        at = [values[v] for v in cpd.given]
        if isinstance(cpd, pgm.NonlinearGaussianCPD):
            slopes = {v: cpd.jacobian[v](*(a[None] for a in at))[0] for v in cpd.given}
            mean, wrapped = cpd.function(*(a[None] for a in at))[0], True
        elif isinstance(cpd, pgm.GaussianCPD):
            slopes, mean = {}, cpd.mean
        else:
            slopes = cpd.matrices
            mean = cpd.offset + sum(slopes[v] @ a for v, a in zip(cpd.given, at, strict=True))
        away = values[child] - mean
        if wrapped:
            turns = np.round(away / (2 * np.pi)) * 2 * np.pi
            away = np.where(child.angle_mask, away - turns, away)
        matrix = np.zeros((child.dimension, size))
        if child in place:
            matrix[:, place[child]] = np.eye(child.dimension)
        for parent, slope in slopes.items():
            if parent in place:
                matrix[:, place[parent]] -= slope
        seen = np.isfinite(np.diagonal(cpd.cov)) & ~np.isnan(away)
        if seen.any():
            root = np.linalg.cholesky(cpd.cov[np.ix_(seen, seen)])
            rows.append(np.linalg.solve(root, matrix[seen]))
            right.append(np.linalg.solve(root, -away[seen]))
    whole = np.concatenate(rows)
    move = np.linalg.lstsq(whole, np.concatenate(right), rcond=None)[0]
    means = {v: points[v] + move[place[v]] for v in points}
    return means, np.linalg.inv(whole.T @ whole), place
