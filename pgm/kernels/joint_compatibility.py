r"""Joint compatibility: the candidates that the sightings of a step are of, decided together.

A *sighting* is one measurement by a sensor, of d components; its *candidates* are the things, such
as landmarks, that it may be of. A hypothesis pairs some sightings with a candidate each, no
candidate twice. The innovations of its pairings, stacked to ν with covariance S = H P Hᵀ + R, have
to lie within the gate: νᵀS⁻¹ν at most the χ² quantile with as many degrees of freedom as ν has
components. The hypothesis with the most pairings is taken; of several with as many, the likeliest
by Σ ln w + ln N(ν; 0, S).

The search conditions the belief on each pairing before it goes on to the next sighting, so that
squares νᵀS⁻¹ν and log-densities add up over the pairings. A branch of the search is abandoned if it
cannot reach as many pairings as the best hypothesis so far, or as many but no likelier ones, or if
its square would be beyond the gate even with the components of all further sightings (Neira &
Tardós, 2001). The search of a run looks at no more than `NODES`, 20,000, whole or partial
hypotheses.

P is the predicted covariance of the slice, the n components of all hidden variables of the step;
H is the slope of a linearised sensor over the slice, and R the covariance of its noise; w is the
prior probability of a candidate. A gate is given by the probability of its χ² quantile. Candidates
are numbered from 0, and `NOTHING`, −1, stands in place of one where a sighting is paired with none.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from pgm.kernels import mahalanobis, step
from pgm.kernels.arrays import LOG_2PI, Array, Integers, Mask, apply
from pgm.kernels.dense import Stack

# Hypotheses, whole ones and parts, that a step of a run may take to look at.
NODES = 20_000
NOTHING = -1


class Pairs(NamedTuple):
    """All pairs of one of a step's k sightings with a candidate, as linearised.

    `matrix`, `residual` and `noise` are H (..., d, n) over the slice, ν (..., d) and R (..., d, d),
    with leading axes (k, runs, candidates); a missing component has unit variance in R and zeros in
    H and ν. `size` (k, runs) counts a sighting's measured components; `compatible`
    (k, runs, candidates) marks pairs that are within the gate by themselves; `log_weight`
    (candidates,) is ln w.
    """

    matrix: Array
    residual: Array
    noise: Array
    size: Integers
    compatible: Mask
    log_weight: Array

    def at(self, place: tuple[Any, ...]) -> tuple[Array, Array, Array]:
        """H, ν and R of the pairs at a place along the leading axes."""
        return self.matrix[place], self.residual[place], self.noise[place]


class TooManyError(Exception):
    """Raised when the search of a run is not done after `NODES` hypotheses.

    The argument is the number of the run.
    """


def decide(pairs: Pairs, cov: Array, gate: float) -> Integers:
    """The best hypothesis of each run: the number of each sighting's candidate, (k, runs).

    It is `NOTHING` for a sighting that is paired with none. `cov` is P (runs, n, n), `gate` a
    probability. Raises TooManyError for a run with more than `NODES` hypotheses to look at.
    """
    every = int(pairs.size.sum(axis=0).max(initial=0))
    limits = np.concatenate([[0.0], mahalanobis.square_within(gate, np.arange(1, every + 1))])
    number = pairs.compatible.sum(axis=-1)
    chosen = np.where(number > 0, np.argmax(pairs.compatible, axis=-1), NOTHING)
    # Where no sighting has a choice, and no two have the same, the whole is looked at first.
    taken = chosen[..., None] == np.arange(pairs.compatible.shape[-1])
    plain = (number <= 1).all(axis=0) & (taken.sum(axis=0) <= 1).all(axis=-1)
    plain[plain] = _within(pairs, chosen, cov, limits, np.flatnonzero(plain))
    for run in np.flatnonzero(~plain).tolist():
        chosen[:, run] = _Search(pairs, cov[run], limits, run).best
    return chosen


def _within(pairs: Pairs, chosen: Integers, cov: Array, limits: Array, runs: Integers) -> Mask:
    """Whether the hypotheses of some runs lie within the gate, (len(runs),).

    `chosen` (k, all runs) are the sightings' candidates or `NOTHING`, `cov` P (all runs, n, n),
    `runs` the numbers of the runs to look at; limits[j] is the χ² quantile of j degrees of freedom.
    """
    spread, shift = cov[runs], np.zeros((runs.size, cov.shape[-1]))
    square, dof = np.zeros(runs.size), np.zeros(runs.size, dtype=np.intp)
    for k, own in enumerate(chosen[:, runs]):
        seen = own != NOTHING
        place = k, runs, np.where(seen, own, 0)
        matrix, residual, noise = pairs.at(place)
        H, left = matrix * seen[:, None, None], residual * seen[:, None]
        known = _Paired.of((H, left, noise), shift, spread)
        (shift, spread), square = known.after(shift, spread), square + known.square
        dof += np.where(seen, pairs.size[k, runs], 0)
    within: Mask = square <= limits[dof]
    return within


class _Paired(NamedTuple):
    """One pairing each by beliefs that have not taken it in, (..., n).

    `square` (...) is νᵀS⁻¹ν and `density` (...) ln N(ν; 0, S) + ½ d ln 2π, with the innovation ν
    given the pairings before; `matrix` H, `left` ν, `noise` R and `gain` P Hᵀ S⁻¹ are what
    `after` takes.
    """

    square: Array
    density: Array
    matrix: Array
    left: Array
    noise: Array
    gain: Array

    @classmethod
    def of(cls, parts: tuple[Array, Array, Array], shift: Array, cov: Array) -> _Paired:
        """The pairings of H (..., d, n), ν at the predicted mean (..., d), and R (..., d, d).

        Beliefs are N(shift, cov), counted from the predicted mean: `shift` is (..., n), `cov`
        (..., n, n).
        """
        matrix, residual, noise = parts
        left = residual - apply(matrix, shift)
        cross, spread = step.crossed(Stack(cov, True), Stack(matrix), Stack(noise, True))
        root = spread.root()
        found = step.innovation_by(Stack.column(left), root)
        gain: Array = step.gain(root, cross).array
        return cls(found.square, -0.5 * found.square - found.volume, matrix, left, noise, gain)

    def of_one(self, place: int) -> _Paired:
        """One of the pairings."""
        return _Paired(*(part[place] for part in self))

    def after(self, shift: Array, cov: Array) -> tuple[Array, Array]:
        """The beliefs that have taken the pairings in."""
        known = shift + apply(self.gain, self.left)
        parts = Stack(cov, True), Stack(self.gain), Stack(self.matrix), Stack(self.noise, True)
        return known, step.squares(*parts).array


class _Search:
    """The search for the best hypothesis of one run, by branch and bound.

    `best` (k,) has the result: each sighting's candidate, or `NOTHING`; `found` has the number of
    its pairings and its score, Σ ln w + ln N(ν; 0, S). `pairs` are those of all runs, `run` is the
    number of this one, and `cov` its P (n, n); limits[j] is the χ² quantile of j degrees of
    freedom. Depth i of the search decides about sighting order[i]: choices[i] are its compatible
    candidates; ahead[i] counts the components of the sightings from depth i on, and most[i] bounds
    the score that these sightings can still add.
    """

    def __init__(self, pairs: Pairs, cov: Array, limits: Array, run: int) -> None:
        self.pairs, self.run, self.limits, self.nodes = pairs, run, limits, 0
        compatible = pairs.compatible[:, run]
        number = compatible.sum(axis=-1)
        # Sightings with the fewest choices first.
        self.order = [k for k in np.argsort(number, kind="stable").tolist() if number[k]]
        self.choices = [np.flatnonzero(compatible[k]) for k in self.order]
        counts = [int(pairs.size[k, run]) for k in self.order]
        likeliest = []
        for k, some, count in zip(self.order, self.choices, counts, strict=True):
            # S is at least R: with ν = 0 and S = R no pairing is likelier.
            volume = np.linalg.slogdet(pairs.noise[k, run, some])[1] + count * LOG_2PI
            likeliest.append(float((pairs.log_weight[some] - 0.5 * volume).max()))
        self.counts = counts
        self.ahead = [sum(counts[k:]) for k in range(len(counts) + 1)]
        self.most = [sum(likeliest[k:]) for k in range(len(counts) + 1)]
        self.found: tuple[int, float] = (-1, -np.inf)
        self.best = np.full(len(compatible), NOTHING)
        self._descend(0, np.zeros(len(cov)), cov, None, 0.0, 0, 0.0, [])

    def _descend(
        self,
        depth: int,
        shift: Array,
        cov: Array,
        last: _Paired | None,
        square: float,
        dof: int,
        score: float,
        chosen: list[int],
    ) -> None:
        """Pair the sighting at this depth with each candidate left, likeliest first, or with none.

        Branch and bound (Neira & Tardós, 2001): a branch is abandoned if it cannot pair as many
        sightings as the best hypothesis so far, or as many but with no higher score, or if νᵀS⁻¹ν
        is beyond the gate for the components paired and all those ahead. After the last depth a
        better hypothesis within its gate becomes `best`.

        `chosen` has for each depth before this one the sighting's candidate, or `NOTHING`;
        `square`, `dof`, `score` are these pairings' νᵀS⁻¹ν, components measured, and Σ ln w +
        ln N(ν; 0, S). N(shift, cov) is the belief given all of them but `last`, counted from the
        predicted mean: branches that are abandoned need no other.
        """
        self.nodes += 1
        if self.nodes > NODES:
            raise TooManyError(self.run)
        number = depth - chosen.count(NOTHING)
        left = len(self.order) - depth
        if (number + left, score + self.most[depth]) <= self.found:
            return
        if not left:
            if square <= self.limits[dof]:
                self.found = number, score
                self.best[self.order] = chosen
            return
        k, count, pairs = self.order[depth], self.counts[depth], self.pairs
        some = np.array([c for c in self.choices[depth].tolist() if c not in chosen], dtype=np.intp)
        if last is not None:
            shift, cov = last.after(shift, cov)
        if some.size:
            known = _Paired.of(pairs.at((k, self.run, some)), shift, cov)
            weight = known.density + pairs.log_weight[some] - 0.5 * count * LOG_2PI
            for c in np.argsort(-weight, kind="stable").tolist():
                further = square + float(known.square[c])
                if further <= self.limits[dof + self.ahead[depth]]:
                    so_far = further, dof + count, score + float(weight[c])
                    with_it = [*chosen, int(some[c])]
                    self._descend(depth + 1, shift, cov, known.of_one(c), *so_far, with_it)
        self._descend(depth + 1, shift, cov, None, square, dof, score, [*chosen, NOTHING])
