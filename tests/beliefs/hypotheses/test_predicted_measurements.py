"""Beliefs of a switching chain's measurements, against the sum over all paths of modes."""

import pickle
from itertools import product

import numpy as np
import pytest
from numpy.testing import assert_allclose

import pgm

mode, said = pgm.Discrete("mode", 2), pgm.Discrete("said", 2)
x, z, w = pgm.variables("x z w")
FIRST, MOVE, READ = (
    np.array([0.6, 0.4]),
    np.array([[0.8, 0.2], [0.3, 0.7]]),
    [[0.9, 0.1], [0.4, 0.6]],
)
SLOPES, NOISES, SCALES = (1.0, 0.5), (0.1, 2.0), (0.2, 1.5)
MODEL = pgm.DynamicBayesianNetwork(
    [pgm.TableCPD(mode, table=FIRST), pgm.GaussianCPD(x, 1.0, 1.0)],
    [
        pgm.TableCPD(mode, mode.previous, table=MOVE),
        pgm.SwitchingCPD(
            x,
            mode,
            {k: pgm.LinearGaussianCPD(x, {x.previous: SLOPES[k]}, NOISES[k]) for k in (0, 1)},
        ),
    ],
    [
        pgm.LinearGaussianCPD(z, {x: 2.0}, 0.25),
        pgm.SwitchingCPD(
            w, mode, {k: pgm.LinearGaussianCPD(w, {x: 1.0}, SCALES[k], offset=k) for k in (0, 1)}
        ),
        pgm.TableCPD(said, mode, table=READ),
    ],
)
ZS, STEPS = np.array([0.5, 3.0]), 4


def paths(read):
    """Weights, modes and moments of x at a last step by path, with the readings `read` of z."""
    for modes in product((0, 1), repeat=STEPS + 1):
        weight, mean, cov = FIRST[modes[0]], 1.0, 1.0
        before = []
        for t in range(STEPS + 1):
            if t:
                weight *= MOVE[modes[t - 1], modes[t]]
                mean, cov = SLOPES[modes[t]] * mean, SLOPES[modes[t]] ** 2 * cov + NOISES[modes[t]]
            before.append((weight, modes[t], mean, cov))
            if 1 <= t <= len(read):
                spread = 4.0 * cov + 0.25
                off = read[t - 1] - 2.0 * mean
                weight *= np.exp(-0.5 * off**2 / spread) / np.sqrt(2 * np.pi * spread)
                mean, cov = mean + 2.0 * cov / spread * off, cov - 4.0 * cov**2 / spread
        yield before, (weight, modes, mean, cov)


def moments(weights, means, covs):
    weights = np.array(weights) / np.sum(weights)
    mean = weights @ means
    return mean, weights @ (np.array(covs) + (np.array(means) - mean) ** 2)


@pytest.mark.parametrize("how", [pgm.filter, pgm.smooth])
def test_predictions_equal_the_sum_over_paths(how):
    found = how(MODEL, {z: ZS[:, None]}, steps=STEPS, belief=pgm.Gaussians(64)).predicted
    for t in range(1, STEPS + 1):
        # Each path counts once for each of its later modes, whose probabilities sum to one.
        before = [path[t] for path, _ in paths(ZS)]
        weights, modes, means, covs = map(np.array, zip(*before, strict=True))
        mean, cov = moments(weights, 2.0 * means, 4.0 * covs + 0.25)
        at = found[z.at(t)]
        assert_allclose((at.mean[0], at.cov[0, 0]), (mean, cov), rtol=1e-9)
        mean, cov = moments(weights, means + modes, covs + np.array(SCALES)[modes])
        assert_allclose(found[w].mean[t, 0], mean, rtol=1e-9)
        assert_allclose(found[w].cov[t, 0, 0], cov, rtol=1e-9)
        share = np.bincount(modes, weights) / weights.sum()
        assert_allclose(found[mode].probabilities[t], share, rtol=1e-9)
        assert_allclose(found[said].probabilities[t], share @ READ, rtol=1e-9)
        assert_allclose(found[x].mean[t, 0], moments(weights, means, covs)[0], rtol=1e-9)


def test_runs_and_measurements_that_were_not_taken():
    runs = np.stack([ZS, ZS + 1.0])[..., None]
    many = pgm.filter(MODEL, {z: runs}, steps=STEPS, belief=pgm.Gaussians(64))
    one = pgm.filter(MODEL, {z: runs[1]}, steps=STEPS, belief=pgm.Gaussians(64))
    for v in (z, w):
        assert_allclose(many.predicted[v].mean[1], one.predicted[v].mean, rtol=1e-9)
        assert_allclose(many.predicted[v].cov[1], one.predicted[v].cov, rtol=1e-9)
    last = one[z.at(STEPS)]
    assert_allclose(last.mean, one.predicted[z.at(STEPS)].mean, rtol=1e-9)
    assert_allclose(last.cov, one.predicted[z.at(STEPS)].cov, rtol=1e-9)
    assert_allclose(one[said].probabilities, one[mode].probabilities @ READ)
    with pytest.raises(pgm.EvidenceError, match=r"z\[2\] has evidence there"):
        one[z.at(2)]


class Enumerated:
    """The chain by all paths of modes, each a dense Gaussian of states and readings.

    `read` has the values of z, w and said by variable and step. A sensor of two `parts`, y, has
    them with the probabilities `shares`, drawn apart for each reading.
    """

    parts, shares = ((1.0, 0.0, 0.3), (0.5, 1.0, 4.0)), (0.75, 0.25)

    def __init__(self, read):
        self.read = read

    def hypotheses(self, asked):
        """Log-weight given what was read, and the moments of what is asked, [(variable, step)]."""
        lag = np.arange(STEPS + 1)
        read = {key: value for key, value in self.read.items() if key[0] != said}
        mixed = [key for key in [*read, *asked] if key[0] == y]
        for modes in product((0, 1), repeat=STEPS + 1):
            log = np.log(FIRST[modes[0]])
            slope, noise = np.eye(STEPS + 1), np.eye(STEPS + 1)
            for t in range(1, STEPS + 1):
                log += np.log(MOVE[modes[t - 1], modes[t]])
                slope[t] = SLOPES[modes[t]] * slope[t - 1] + (lag == t)
                noise[t, t] = NOISES[modes[t]]
            for (v, t), value in self.read.items():
                log += np.log(READ[modes[t]][value]) if v == said else 0.0
            mean, cov = slope[:, 0], slope @ noise @ slope.T
            for chosen in product((0, 1), repeat=len(mixed)):
                own = dict(zip(mixed, chosen, strict=True))
                laws = {key: self.law(key, modes[key[1]], own.get(key)) for key in [*read, *asked]}
                level = log + sum(np.log(self.shares[k]) for k in chosen)
                yield self.given(level, mean, cov, laws, read, asked)

    def law(self, key, now, part):
        v, _ = key
        if v == y:
            return self.parts[part]
        return (2.0, 0.0, 0.25) if v == z else (1.0, float(now), SCALES[now])

    @staticmethod
    def given(log, mean, cov, laws, read, asked):
        def stacked(keys):
            rows = np.zeros((len(keys), STEPS + 1))
            for k, key in enumerate(keys):
                rows[k, key[1]] = laws[key][0]
            shift = np.array([laws[key][1] for key in keys])
            return rows, rows @ mean + shift, np.diag([laws[key][2] for key in keys])

        a, at, own = stacked(list(asked))
        whole = a @ cov @ a.T + own
        if read:
            b, expected, noise = stacked(list(read))
            spread = b @ cov @ b.T + noise
            away = np.array(list(read.values())) - expected
            gain = np.linalg.solve(spread, b @ cov @ a.T).T
            log -= 0.5 * (away @ np.linalg.solve(spread, away) + np.linalg.slogdet(spread)[1])
            log -= 0.5 * len(away) * np.log(2 * np.pi)
            at, whole = at + gain @ away, whole - gain @ b @ cov @ a.T
        return log, at, whole

    def of(self, *asked):
        """The moments of the mixture of some measurements, [(variable, step)]."""
        logs, means, covs = map(np.array, zip(*self.hypotheses(asked), strict=True))
        weights = np.exp(logs - logs.max())
        weights /= weights.sum()
        mean = weights @ means
        apart = means - mean
        return mean, np.einsum("k,kij->ij", weights, covs) + (weights * apart.T) @ apart


y = pgm.Variable("y")
MIXED = MODEL.replace(
    observation=[
        *MODEL.observation,
        pgm.MixtureCPD(
            [
                pgm.LinearGaussianCPD(y, {x: slope}, noise, offset=shift)
                for slope, shift, noise in Enumerated.parts
            ],
            Enumerated.shares,
        ),
    ]
)
EVIDENCE = {
    z: [[0.5], [3.0], [1.0]],
    w: [[1.0], [np.nan], [2.0], [-0.5]],
    said: [0, 1, -1, 1],
}
KNOWN = {(z, 1): 0.5, (z, 2): 3.0, (z, 3): 1.0, (w, 1): 1.0, (w, 3): 2.0, (w, 4): -0.5}
KNOWN |= {(said, 1): 0, (said, 2): 1, (said, 4): 1}
MANY = pgm.Gaussians(64)


def without(*keys):
    return {key: value for key, value in KNOWN.items() if key not in keys}


def test_readings_left_out_equal_the_sum_over_paths():
    posterior = pgm.smooth(MODEL, EVIDENCE, steps=STEPS, belief=MANY)
    found = posterior.left_out
    assert list(found) == [z, w, said]
    for v, t in KNOWN:
        if v == said:
            continue
        mean, cov = Enumerated(without((v, t))).of((v, t))
        assert_allclose(found[v].mean[t - 1], mean, rtol=1e-8)
        assert_allclose(found[v].cov[t - 1], cov, rtol=1e-8)
    assert list(found[z].steps) == [1, 2, 3]
    for t in (1, 2, 4):
        levels = []
        for state in (0, 1):
            each = Enumerated(without((said, t)) | {(said, t): state}).hypotheses([(z, 1)])
            levels.append(np.logaddexp.reduce([log for log, *_ in each]))
        share = np.exp(levels - np.logaddexp(*levels))
        assert_allclose(found[said].probabilities[t - 1], share, rtol=1e-8)
    # A posterior whose pass forward was asked for can be pickled.
    again = pickle.loads(pickle.dumps(posterior)).left_out
    assert_allclose(again[z].mean, found[z].mean, rtol=1e-12)


def test_measurements_that_hidden_modes_choose():
    """Those that were not taken, of a smoother and of a filter; not of a fixed lag."""
    smoothed, filtered = (
        how(MODEL, EVIDENCE, steps=STEPS, belief=MANY) for how in (pgm.smooth, pgm.filter)
    )
    mean, cov = Enumerated(KNOWN).of((w, 2))
    assert_allclose(smoothed[w.at(2)].mean, mean, rtol=1e-8)
    assert_allclose(smoothed[w.at(2)].cov, cov, rtol=1e-8)
    mean, cov = Enumerated({k: v for k, v in KNOWN.items() if k[1] <= 2}).of((w, 2))
    assert_allclose(filtered[w.at(2)].mean, mean, rtol=1e-8)
    assert_allclose(filtered[w.at(2)].cov, cov, rtol=1e-8)
    lagged = pgm.smooth(MODEL, EVIDENCE, steps=STEPS, belief=MANY, lag=1)
    with pytest.raises(pgm.EvidenceError, match=r"hidden variables choose its CPD.*fixed lag"):
        lagged[w.at(2)]
    with pytest.raises(pgm.EvidenceError, match=r"take pgm\.smooth"):
        lagged.left_out  # noqa: B018


def test_left_out_in_runs_and_parcels(monkeypatch):
    monkeypatch.setattr("pgm.beliefs.hypotheses.left_out._RUNS", 4)
    runs = {v: np.stack([values, values]) for v, values in EVIDENCE.items()}
    runs[z][1] += 0.5
    found = pgm.smooth(MODEL, runs, steps=STEPS, belief=MANY).left_out
    alone = pgm.smooth(MODEL, EVIDENCE | {z: runs[z][1]}, steps=STEPS, belief=MANY).left_out
    for v in (z, w):
        assert_allclose(found[v].mean[1], alone[v].mean, rtol=1e-9)
        assert_allclose(found[v].cov[1], alone[v].cov, rtol=1e-9)
    assert_allclose(found[said].probabilities[1], alone[said].probabilities, rtol=1e-9)


def test_a_mixture_of_cpds_as_a_sensor():
    asked = EVIDENCE | {y: [[0.2], [np.nan], [3.0]]}
    known = KNOWN | {(y, 1): 0.2, (y, 3): 3.0}
    found = pgm.smooth(MIXED, asked, steps=STEPS, belief=pgm.Gaussians(160))
    for t in (1, 3, 4):
        mean, cov = Enumerated({k: v for k, v in known.items() if k[1] < t}).of((y, t))
        at = found.predicted[y.at(t)]
        assert_allclose(at.mean, mean, rtol=1e-8)
        assert_allclose(at.cov, cov, rtol=1e-8)
    mean, cov = Enumerated(known).of((y, 2))
    assert_allclose(found[y.at(2)].mean, mean, rtol=1e-8)
    less = {k: v for k, v in known.items() if k != (y, 3)}
    mean, cov = Enumerated(less).of((y, 3))
    assert_allclose(found.left_out[y].mean[2], mean, rtol=1e-8)
    assert_allclose(found.left_out[y].cov[2], cov, rtol=1e-8)


def test_innovations_of_the_mixture_in_a_loop_and_of_a_recording():
    two = pgm.sightings([[0.2], [3.0]])
    loop = pgm.OnlineFilter(MIXED, belief=MANY)
    belief = loop.update(loop.predict(loop.initial()), {z: [0.5], w: [1.0]})
    assert not loop.initial().innovations
    ahead = loop.predict(belief)
    known = {(z, 1): 0.5, (w, 1): 1.0}
    for v in (z, w, y):
        mean, cov = Enumerated(known).of((v, 2))
        assert_allclose(ahead.predicted[v].mean, mean, rtol=1e-8)
        assert_allclose(ahead.predicted[v].cov, cov, rtol=1e-8)
    assert_allclose(ahead.predicted[said].probabilities, ahead[mode].probabilities @ READ)
    belief = loop.update(ahead, {w: [-0.5], y: two})
    mean, cov = Enumerated(known).of((w, 2))
    found = belief.innovations[w]
    assert_allclose((found.residual, found.cov), (-0.5 - mean[0], cov[0, 0]), rtol=1e-8)
    assert_allclose(found.nis, (0.5 + mean[0]) ** 2 / cov[0, 0], rtol=1e-8)
    # Two sightings of one step, each of a component of its own.
    law = Enumerated(known)
    mean, cov = law.of((y, 2))
    mean, whole = np.repeat(mean, 2), np.full((2, 2), np.nan)
    _, state = Enumerated(known).of((z, 2))
    slope = sum(s * p[0] for s, p in zip(law.shares, law.parts, strict=True))
    whole[:] = slope**2 * (state[0, 0] - 0.25) / 4.0
    np.fill_diagonal(whole, cov[0, 0])
    away = np.array([0.2, 3.0]) - mean
    found = belief.innovations[y]
    assert_allclose(found.residual[:, 0], away, rtol=1e-8)
    assert_allclose(found.cov[:, 0, 0], cov[0, 0], rtol=1e-8)
    assert_allclose(found.nis, away @ np.linalg.solve(whole, away), rtol=1e-8)
    assert found.dof == 2
    for each in (found, pickle.loads(pickle.dumps(found))):
        with pytest.raises(pgm.EvidenceError, match="mixture of Gaussians has no gain"):
            each.gain[x]
    recorded = pgm.smooth(MODEL, EVIDENCE, steps=STEPS, belief=MANY).innovations
    assert list(recorded) == [z, w]
    for v, t in ((z, 2), (w, 3)):
        mean, cov = Enumerated({k: u for k, u in KNOWN.items() if k[1] < t}).of((v, t))
        away = KNOWN[v, t] - mean[0]
        assert_allclose(recorded[v].residual[t - 1, 0], away, rtol=1e-8)
        assert_allclose(recorded[v].cov[t - 1, 0, 0], cov[0, 0], rtol=1e-8)
        assert_allclose(recorded[v].nis[t], away**2 / cov[0, 0], rtol=1e-8)
    assert np.isnan(recorded[w].nis[2])
    assert recorded[w].dof[2] == 0


def test_a_prior_in_pieces_keeps_no_pass_for_forecasts():
    squared = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(x, 0.0, 4.0)],
        [pgm.LinearGaussianCPD(x, {x.previous: 1.0}, 0.1)],
        [pgm.NonlinearGaussianCPD(z, x, np.square, 0.5)],
    )
    found = pgm.filter(squared, {z: [[1.0], [1.2]]}, belief=pgm.Gaussians(8, starts=16))
    for ask in (lambda: found.predicted, lambda: found.innovations, lambda: found[z.at(0)]):
        with pytest.raises(pgm.EvidenceError, match=r"cut into pieces \(starts=\).*leave these"):
            ask()
