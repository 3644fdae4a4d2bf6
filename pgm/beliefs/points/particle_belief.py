"""Particle beliefs and the figures read from them: means, covariances, draws and histograms.

A *cloud* has the particles of all runs, one run after another, with their weights. Its states are
an array (rows, particles), with a row for each component of its variables. A belief has

- `_clouds`: a cloud for each of its steps, or a single one if it is of one step;
- `_parts`: the components that it is over, which may be some of the rows only, each with its row;
- `_runs`: the shape of the user's axes of runs, which are one axis in a cloud.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from pgm.arguments import public
from pgm.beliefs.points.belief import PointMassBelief, closed
from pgm.beliefs.points.cloud import Cloud
from pgm.beliefs.points.components import Part
from pgm.display import Summary, axes
from pgm.errors import ModelError
from pgm.factors.scope import listed, places_of
from pgm.kernels.angles import TURN, wrap
from pgm.kernels.arrays import Array, Integers
from pgm.kernels.step import turns
from pgm.posteriors.summaries import moments_of, spread


class ParticleBelief(PointMassBelief):
    r"""A belief as weighted draws.

    .. math:: p(x) = \sum_i w_i \, δ(x - x_i)

    - x_i: the n particles, `states`, of d components;
    - w_i: their weights, `weights`, of sum one.

    Leading axes, (...), are separate beliefs: of runs, and, unless `steps` is None, of steps in
    time. Means and covariances are those of the point masses. For an angle they are computed from
    the particles' differences to its circular mean μ°, wrapped to [−π, π); μ° is the direction of
    Σ w_i (cos x_i, sin x_i).

    Attributes
    ----------
    components : tuple of str
        The names of the d components, in the order of the last axis.
    steps : ndarray of int or None
        The steps that the last leading axis stands for; None where no axis is of steps.
    lead : tuple of int
        The shape of the leading axes, (...): runs, then steps.

    Examples
    --------
    >>> from pgm.examples import walk, x, z
    >>> belief = pgm.filter(walk, {z: [[4.0]]}, belief=pgm.Particles(10_000, seed=0))[x][1]
    >>> belief.mean.round(1), belief.std.round(1)
    (array([2.]), array([1.]))
    >>> belief.states.shape, belief.sample(5, rng=0).shape
    ((10000, 1), (5, 1))
    >>> belief.marginal("x").number
    array(10000)
    """

    _parts: tuple[Part, ...]
    _clouds: tuple[Cloud, ...]
    _runs: tuple[int, ...]

    def __init__(
        self,
        each: Sequence[Part],
        clouds: Sequence[Cloud],
        runs: tuple[int, ...],
        steps: Integers | None = None,
    ) -> None:
        if steps is not None:
            steps.flags.writeable = False
        self._set(
            components=tuple(part.label for part in each),
            steps=steps,
            lead=runs if steps is None else (*runs, len(clouds)),
            _parts=tuple(each),
            _clouds=tuple(clouds),
            _runs=runs,
        )

    @cached_property
    def number(self) -> Integers:
        """The number of particles of each belief, (...)."""
        return self._stacked([cloud.counts for cloud in self._clouds])

    @cached_property
    def effective(self) -> Array:
        """The effective number of particles of each belief, 1 / Σ w², (...)."""
        return self._stacked([cloud.effective for cloud in self._clouds])

    @cached_property
    def states(self) -> npt.NDArray[Any]:
        """The particles, (..., n, d); a ModelError is raised if beliefs differ in n."""
        self._require_equal("states")
        rows = self._rows
        each = [cloud.states[rows].reshape(len(rows), cloud.runs, -1) for cloud in self._clouds]
        return self._stacked([points.transpose(1, 2, 0) for points in each], 0, len(rows))

    @cached_property
    def weights(self) -> Array:
        """The weights, (..., n), of sum one; a ModelError is raised if beliefs differ in n."""
        self._require_equal("weights")
        return self._stacked([cloud.weights.reshape(cloud.runs, -1) for cloud in self._clouds], 0)

    def _mean(self) -> Array:
        """The weighted means, (..., d)."""
        return self._stacked([mean for mean, _ in self._moments], len(self._parts))

    def _cov(self) -> Array:
        """The weighted covariances, (..., d, d)."""
        wide = len(self._parts)
        return self._stacked([cov for _, cov in self._moments], wide, wide)

    def _over(self, places: tuple[int, ...]) -> ParticleBelief:
        """The belief over the components at the indices `places`, in that order."""
        each = [self._parts[k] for k in places]
        return ParticleBelief(each, self._clouds, self._runs, self.steps)

    @public
    def histogram(
        self,
        *components: str,
        bins: Any = 50,
        range: Any = None,
    ) -> tuple[Array, tuple[Array, ...]]:
        """The probabilities that a belief without leading axes gives to bins of its components.

        Parameters
        ----------
        *components : str
            The names of the components, one for each axis of the histogram.
        bins : int or sequence
            See `numpy.histogramdd`: the number of bins along each axis, or their edges.
        range : sequence of (float, float), optional
            The ends of each axis; by default those of the particles, or, of an angle, −π and π
            where `bins` is a number. Angles are wrapped to [−π, π) in any case.

        Returns
        -------
        (ndarray, tuple of ndarray)
            The probabilities, with an axis of bins for each component; their sum is one less the
            probability outside of the range. And for each axis the edges of its bins.

        Raises
        ------
        ModelError
            If the belief has leading axes, it has no such component, or NumPy refuses the bins.
        """
        self._require_one("a histogram")
        places = list(places_of(self._parts, components, "a histogram"))
        points = self.states[:, places].astype(np.float64)
        angles = [k for k, place in enumerate(places) if self._parts[place].angle]
        for k in angles:
            points[:, k] = wrap(points[:, k])
        try:
            if range is None and angles and np.ndim(bins) == 0:
                low, high = points.min(axis=0), points.max(axis=0)
                range = [
                    (-np.pi, np.pi) if k in angles else (low[k], high[k])
                    for k in np.arange(len(places))
                ]
            found, edges = np.histogramdd(points, bins=bins, range=range, weights=self.weights)
        except (ValueError, TypeError) as error:
            raise ModelError(f"a histogram of {listed(components)}: {error}") from error
        return found, tuple(edges)

    def _drawn(self, count: int, rng: np.random.Generator) -> Array:
        """Draws with replacement by the weights, (count, *lead, d)."""
        rows = self._rows
        found = np.empty((len(self._clouds), math.prod(self._runs), count, len(rows)))
        for step, cloud in enumerate(self._clouds):
            for run in np.arange(cloud.runs).tolist():
                place = cloud.of(run)
                total = np.cumsum(cloud.weights[place])
                level = rng.random(count) * total[-1]
                chosen = np.minimum(np.searchsorted(total, level, side="right"), len(total) - 1)
                found[step, run] = cloud.states[rows][:, place][:, chosen].T
        return np.moveaxis(self._by_lead(found), -2, 0)

    def _at(self, index: Any, chosen: Integers) -> ParticleBelief:
        """The belief at the user's `index` of the leading axes.

        chosen: The beliefs that the index takes, as places in the flattened leading axes, in the
            shape of the result's leading axes.

        An index may choose steps, and the same runs at each of them. One that chooses other runs at
        one step than at another, or no belief at all, is refused by a ModelError.
        """
        if not self._clouds and chosen.ndim:  # of no steps, as of a control without a step 1
            return ParticleBelief(self._parts, (), chosen.shape[:-1], self.steps)
        if not chosen.size:
            raise ModelError(f"a belief with the leading axes {self.lead} has none at {index!r}")
        run, step = np.divmod(chosen, len(self._clouds))
        whole = len(self._runs) == chosen.ndim - 1
        if self.steps is None or not chosen.ndim or (len(np.unique(step)) == 1 and not whole):
            clouds = [self._gathered(int(step.flat[0]), run.reshape(-1))]
            return ParticleBelief(self._parts, clouds, chosen.shape)
        each = step.reshape(-1, step.shape[-1])
        own = run.reshape(-1, run.shape[-1])
        if not (each == each[0]).all() or not (own == own[:, :1]).all():
            raise ModelError("a belief is indexed by runs and then steps, not by pairs of them")
        clouds = [self._gathered(int(s), own[:, 0]) for s in each[0]]
        return ParticleBelief(self._parts, clouds, chosen.shape[:-1], self.steps[each[0]])

    def _gathered(self, place: int, runs: Integers) -> Cloud:
        """The cloud of the runs numbered `runs`, at the belief's step `place`, counted from 0."""
        cloud = self._clouds[place]
        if len(runs) == cloud.runs and (runs == np.arange(cloud.runs)).all():
            return cloud
        chosen = [cloud.run(int(run)) for run in runs]
        starts = np.concatenate([[0], np.cumsum([len(each.log_weights) for each in chosen])])
        return Cloud(
            np.concatenate([each.states for each in chosen], axis=1),
            np.concatenate([each.log_weights for each in chosen]),
            starts,
        )

    @property
    def _rows(self) -> list[int]:
        """The row of each of the belief's components in the states of its clouds."""
        return [part.row for part in self._parts]

    @cached_property
    def _moments(self) -> list[tuple[Array, Array]]:
        """The means (runs, d) and covariances (runs, d, d) of each step's cloud."""
        return [self._moments_of(cloud) for cloud in self._clouds]

    def _moments_of(self, cloud: Cloud) -> tuple[Array, Array]:
        """The weighted means (runs, d) and covariances (runs, d, d) of a cloud's particles.

        An angle's mean is its circular mean μ° plus the weighted mean of the particles' differences
        from μ°, each wrapped; the sum is wrapped, too.
        """
        weights, count = cloud.weights, len(self._parts)
        mean, apart = np.empty((count, cloud.runs)), np.empty((count, len(weights)))
        for k, part in enumerate(self._parts):
            values = cloud.states[part.row].astype(np.float64, copy=False)
            # Counted from a place nearby, so that large coordinates cost no digits.
            about = values[cloud.starts[:-1]]
            offset = np.subtract(values, cloud.spread(about), out=apart[k])
            if part.angle:
                offset -= turns(offset)
                # Within a quarter of a turn no two are so far apart that the middle matters.
                if max(offset.max(), -offset.min()) > 0.25 * TURN:
                    sine, cosine = cloud.summed(
                        weights * np.stack([np.sin(values), np.cos(values)])
                    )
                    about = np.arctan2(sine, cosine)
                    np.subtract(values, cloud.spread(about), out=offset)
                    offset -= turns(offset)
            shift = cloud.summed(weights * offset)
            mean[k] = about + shift
            if part.angle:
                mean[k] = wrap(mean[k])
            offset -= cloud.spread(shift)
        cov = np.empty((count, count, cloud.runs))
        for i in range(count):
            weighted = weights * apart[i]
            for j in range(i, count):
                cov[i, j] = cov[j, i] = cloud.summed(weighted * apart[j])
        return mean.T, cov.transpose(2, 0, 1)

    def _stacked(self, each: Sequence[npt.NDArray[Any]], *wide: int) -> npt.NDArray[Any]:
        """Arrays (runs, ...), one a cloud, as (*lead, ...), of no clouds (*lead, *wide)."""
        if not each:
            return closed(np.zeros((*self.lead, *wide)))
        return self._by_lead(np.stack(each, axis=0))

    def _by_lead(self, values: npt.NDArray[Any]) -> npt.NDArray[Any]:
        """Values (steps, runs, ...) as a read-only array (*lead, ...).

        Where the belief has no axis of steps, that of the values is of length one.
        """
        values = values.swapaxes(0, 1)
        return closed(np.ascontiguousarray(values).reshape((*self.lead, *values.shape[2:])))

    def _require_equal(self, what: str) -> None:
        """Refuse beliefs whose numbers of particles differ, by a ModelError.

        what: The name of the array that was asked for, "states" or "weights", for the error's text.
        """
        counts = {int(count) for cloud in self._clouds for count in cloud.counts}
        if len(counts) > 1:
            raise ModelError(
                f"the number of particles differs, from {min(counts):,} to {max(counts):,}, so "
                f"that their {what} make no array: index a run and a step first, as belief[3]"
            )

    def _require_one(self, what: str) -> None:
        """Refuse, by a ModelError, a belief that has leading axes.

        what: What was asked for, such as "a histogram", for the error's text.
        """
        if self.lead:
            raise ModelError(
                f"{what} is of one belief, and this one has the leading axes {self.lead}: index a "
                "run and a step first, as belief[3]"
            )

    @property
    def _title(self) -> str:
        lead, counts = axes(self.lead, self.steps), self.number
        if not counts.size:
            return f"ParticleBelief({listed(self.components)}{lead})"
        least, most = int(counts.min()), int(counts.max())
        count = f"{most:,}" if least == most else f"{least:,} to {most:,}"
        return f"ParticleBelief({listed(self.components)}: {count} particles{lead})"

    def _summary(self) -> Summary:
        if not self.number.size:
            return Summary(self._title)
        effective = f"effective {spread(self.effective, 4)}"
        return Summary(self._title, [effective, moments_of(self)])
