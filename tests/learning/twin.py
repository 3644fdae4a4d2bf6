"""A textbook twin: dense posteriors of linear-Gaussian chains, and expected log-densities."""

import numpy as np

import pgm

X = pgm.Variable("x", ("a", "b"))
Z = pgm.Variable("z", ("p", "q"))
U = pgm.Variable("u", ("s",))


def drawn(rng, size):
    """A covariance."""
    root = rng.normal(size=(size, size))
    return root @ root.T / size + 0.3 * np.eye(size)


def linear(rng):
    """A chain with an input, all of it drawn."""
    moves = 0.5 * rng.normal(size=(2, 2))
    return pgm.DynamicBayesianNetwork(
        prior=[pgm.GaussianCPD(X, rng.normal(size=2), drawn(rng, 2))],
        transition=[
            pgm.LinearGaussianCPD(
                X,
                {X.previous: moves, U: rng.normal(size=(2, 1))},
                offset=rng.normal(size=2),
                cov=drawn(rng, 2),
            )
        ],
        observation=[
            pgm.LinearGaussianCPD(
                Z, {X: rng.normal(size=(2, 2))}, offset=rng.normal(size=2), cov=drawn(rng, 2)
            )
        ],
    )


def dense(model, controls, readings):
    """Mean (T+1, 2) and covariance (T+1, 2, T+1, 2) of the states given readings at 1..T.

    Of the joint over everything, by the formula for conditioning; NaN is not measured. Returns the
    log-evidence too.
    """
    prior, moves, sees = model.prior[0], model.transition[0], model.observation[0]
    steps, size = len(controls), 2
    mean = np.zeros((steps + 1) * size)
    # x = G w + mean, w the prior's deviation and the noises.
    weights = np.zeros((mean.size, mean.size))
    noise = np.zeros_like(weights)
    mean[:size] = prior.mean
    weights[:size, :size] = np.eye(size)
    noise[:size, :size] = prior.cov
    F, B = moves.matrices[X.previous], moves.matrices[U]
    for t in range(1, steps + 1):
        now, before = slice(t * size, (t + 1) * size), slice((t - 1) * size, t * size)
        mean[now] = F @ mean[before] + B @ controls[t - 1] + moves.offset
        weights[now] = F @ weights[before]
        weights[now, now] = np.eye(size)
        noise[now, now] = moves.cov
    cov = weights @ noise @ weights.T
    H = np.kron(np.eye(steps + 1)[1:], sees.matrices[X])
    offset, R = np.tile(sees.offset, steps), np.kron(np.eye(steps), sees.cov)
    flat = np.asarray(readings).ravel()
    seen = ~np.isnan(flat)
    H, offset, R, flat = H[seen], offset[seen], R[np.ix_(seen, seen)], flat[seen]
    S = H @ cov @ H.T + R
    left = flat - H @ mean - offset
    gain = cov @ H.T @ np.linalg.inv(S)
    log_evidence = -0.5 * (left @ np.linalg.solve(S, left) + np.linalg.slogdet(2 * np.pi * S)[1])
    mean, cov = mean + gain @ left, cov - gain @ H @ cov
    shape = (steps + 1, size)
    return mean.reshape(shape), cov.reshape(*shape, *shape), log_evidence


def expected_log_density(mean, cov, child, matrix, offset, noise):
    """Σ_t E ln N(y_t; A w_t + b, Q) of Gaussian (w, y) in turn; complex numbers are carried."""
    total = 0.0
    size = len(noise)
    line = np.concatenate([-matrix, np.eye(size)], axis=1)
    for m, P in zip(mean, cov, strict=True):
        r = line @ m - offset
        second = np.outer(r, r) + line @ P @ line.T
        total = total - 0.5 * (
            np.trace(np.linalg.solve(noise, second))
            + np.log(np.linalg.det(noise))
            + size * np.log(2 * np.pi)
        )
    return total
