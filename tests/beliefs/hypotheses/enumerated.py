"""Switching linear models, drawn, and their posteriors by the sum over all sequences of modes."""

from __future__ import annotations

from itertools import pairwise, product
from typing import NamedTuple

import numpy as np

import pgm


class Switching(NamedTuple):
    """A drawn model of a mode s and a state x, z = H_s x + c_s + noise, x = F_s x' + b_s + noise.

    `table` is p(s | s'), `first` p(s_0); arrays of numbers have a row for each mode.
    """

    model: pgm.DynamicBayesianNetwork
    mode: pgm.Discrete
    x: pgm.Variable
    z: pgm.Variable
    first: np.ndarray
    table: np.ndarray
    f: np.ndarray
    b: np.ndarray
    q: np.ndarray
    h: np.ndarray
    c: np.ndarray
    r: np.ndarray

    def drawn(self, rng, steps):
        """Measurements of the steps 1 to T."""
        x = rng.standard_normal(self.f.shape[-1])
        s = rng.choice(len(self.first), p=self.first)
        found = []
        for _ in range(steps):
            s = rng.choice(len(self.first), p=self.table[s])
            x = self.f[s] @ x + self.b[s] + rng.multivariate_normal(0 * x, self.q[s])
            noise = rng.multivariate_normal(np.zeros(len(self.c[s])), self.r[s])
            found.append(self.h[s] @ x + self.c[s] + noise)
        return np.array(found)

    def enumerated(self, values):
        """Log-evidence, p(s_t), means and covariances of x_t, given all measurements (T, d)."""
        steps, n = len(values), self.f.shape[-1]
        logs, modes, means, covs = [], [], [], []
        for path in product(range(len(self.first)), repeat=steps + 1):
            weight = self.first[path[0]]
            weight *= np.prod([self.table[a, b] for a, b in pairwise(path)])
            if weight == 0.0:
                continue
            # x_0..x_T as rows over the independent sources x_0, w_1..w_T.
            rows, mean = [np.eye(n, n * (steps + 1))], [np.zeros(n)]
            noise = [np.eye(n)]
            for t, s in enumerate(path[1:], 1):
                own = self.f[s] @ rows[-1]
                own[:, n * t : n * (t + 1)] = np.eye(n)
                rows.append(own)
                mean.append(self.f[s] @ mean[-1] + self.b[s])
                noise.append(self.q[s])
            spread = np.zeros((n * (steps + 1),) * 2)
            for t, each in enumerate(noise):
                spread[n * t : n * (t + 1), n * t : n * (t + 1)] = each
            whole = np.concatenate(rows)
            cov, mu = whole @ spread @ whole.T, np.concatenate(mean)
            d = values.shape[1]
            h = np.zeros((d * steps, n * (steps + 1)))
            r = np.zeros((d * steps, d * steps))
            c = np.zeros(d * steps)
            for t, s in enumerate(path[1:], 1):
                at = slice(d * (t - 1), d * t)
                h[at, n * t : n * (t + 1)] = self.h[s]
                r[at, at], c[at] = self.r[s], self.c[s]
            seen = np.isfinite(values.ravel())
            h, r, c = h[seen], r[np.ix_(seen, seen)], c[seen]
            residual = values.ravel()[seen] - h @ mu - c
            total = h @ cov @ h.T + r
            gain = np.linalg.solve(total, h @ cov).T
            density = -0.5 * (
                residual @ np.linalg.solve(total, residual)
                + np.linalg.slogdet(2 * np.pi * total)[1]
            )
            logs.append(np.log(weight) + density)
            modes.append(path)
            means.append((mu + gain @ residual).reshape(steps + 1, n))
            after = cov - gain @ h @ cov
            covs.append([after[n * t : n * (t + 1), n * t : n * (t + 1)] for t in range(steps + 1)])
        logs = np.array(logs)
        total = np.logaddexp.reduce(logs)
        share = np.exp(logs - total)
        modes, means, covs = np.array(modes), np.array(means), np.array(covs)
        p = np.array(
            [
                [share[modes[:, t] == k].sum() for k in range(len(self.first))]
                for t in range(steps + 1)
            ]
        )
        mean = np.einsum("p,pti->ti", share, means)
        away = means - mean
        cov = np.einsum("p,ptij->tij", share, covs)
        cov += np.einsum("p,pti,ptj->tij", share, away, away)
        return total, p, mean, cov


def spread(rng, n):
    """A drawn covariance."""
    root = 0.5 * rng.standard_normal((n, n))
    return root @ root.T + 0.1 * np.eye(n)


def drawn(rng, modes=2, n=2, d=1, *, zeros=False):
    """A drawn switching model, whose modes differ in all their numbers; some paths have zeros."""
    f = np.array([0.5 * rng.standard_normal((n, n)) + 0.5 * np.eye(n) for _ in range(modes)])
    b = rng.standard_normal((modes, n))
    q = np.array([spread(rng, n) for _ in range(modes)])
    h = np.array([rng.standard_normal((d, n)) for _ in range(modes)])
    c = rng.standard_normal((modes, d))
    r = np.array([spread(rng, d) for _ in range(modes)])
    table, first = rng.dirichlet(np.ones(modes), modes), rng.dirichlet(np.ones(modes))
    if zeros:
        table[0] = np.eye(modes)[-1]
    mode = pgm.Discrete("mode", states=tuple(f"s{k}" for k in range(modes)))
    x = pgm.Variable("x", components=tuple(f"x{k}" for k in range(n)))
    z = pgm.Variable("z", components=tuple(f"z{k}" for k in range(d)))
    motion = {
        k: pgm.LinearGaussianCPD(x, {x.previous: f[k]}, offset=b[k], cov=q[k]) for k in range(modes)
    }
    sensor = {k: pgm.LinearGaussianCPD(z, {x: h[k]}, offset=c[k], cov=r[k]) for k in range(modes)}
    model = pgm.DynamicBayesianNetwork(
        prior=[pgm.TableCPD(mode, table=first), pgm.GaussianCPD(x, np.zeros(n), np.eye(n))],
        transition=[
            pgm.TableCPD(mode, given=mode.previous, table=table),
            pgm.SwitchingCPD(x, given=mode, cases=motion),
        ],
        observation=[pgm.SwitchingCPD(z, given=mode, cases=sensor)],
    )
    return Switching(model, mode, x, z, first, table, f, b, q, h, c, r)
