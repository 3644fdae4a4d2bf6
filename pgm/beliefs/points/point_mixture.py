"""Beliefs of measurements of states that are known by point masses, particles or cells."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from functools import cached_property
from typing import Any, ClassVar, NamedTuple, Protocol

import numpy as np
import numpy.typing as npt

from pgm.arguments import public
from pgm.beliefs.points.belief import closed
from pgm.beliefs.points.cloud import Cloud
from pgm.beliefs.points.components import parts
from pgm.beliefs.points.laws import Drawing, GaussianLaw, Law, Some, States
from pgm.beliefs.points.mixture_law import MixtureLaw
from pgm.beliefs.points.particle_belief import ParticleBelief
from pgm.boundary import as_floats, as_generator, as_lengths
from pgm.cpds import ConditionalGaussian
from pgm.display import NoArray, Shown, Summary, axes, by_component, stacked
from pgm.errors import ModelError, Unanswered
from pgm.factors import Gaussian
from pgm.immutable import Immutable
from pgm.kernels.arrays import Array, Integers, deviation
from pgm.kernels.step import turns
from pgm.resources import require_memory
from pgm.variables import Variable


class Clouds(Protocol):
    """Clouds of point masses, each by its place, which may be made when they are asked for."""

    def __getitem__(self, place: int, /) -> Cloud:
        """The cloud at a place."""
        ...


class Measured(NamedTuple):
    """A sensor at some of its rows, each with the point masses of the states that it measures.

    law: The sensor's CPD with the values of its observed parents.
    rows: The row of these values, of each measurement.
    steps: The step of each measurement.
    clouds: Point masses, and for each measurement the place of its own among them.
    """

    law: Law
    rows: Integers
    steps: Integers
    clouds: Clouds
    places: Integers

    def each(self) -> Iterator[tuple[int, int, Cloud]]:
        """The row of each measurement, its step, and its point masses."""
        for row, step, place in zip(self.rows, self.steps, self.places, strict=True):
            yield int(row), int(step), self.clouds[int(place)]


def _blocks(cloud: Cloud, step: int) -> Iterator[tuple[slice, Some]]:
    """Blocks of a cloud's particles: where they stand, and the particles."""
    for block in cloud.blocks():
        at = slice(block.first, block.last)
        states = cloud.states[:, at]
        yield at, Some(step, states, states, None if cloud.runs == 1 else cloud.owner[at])


class PointMixture(Shown, NoArray, Immutable):
    r"""The belief of a measurement z of a state x that particles or cells x_i stand for.

    .. math:: p(z) = \sum_i w_i \, p(z \mid x_i)

    with the sensor's density p(z | x), and the probabilities or weights w_i of sum one. Moments are
    those of the whole sum,

    .. math:: \mu = \sum_i w_i h(x_i), \qquad
              P = \sum_i w_i \big(R_i + (h(x_i) - \mu)(h(x_i) - \mu)^\top\big),

    h being the mean of the measurement and R_i its covariance at a point. Robust noise counts with
    the `cov` of its CPD in these, and with its own density elsewhere. The mean of an angle is the
    circular one, wrapped to [−π, π), and its covariance that of wrapped differences.

    Attributes
    ----------
    variable : Variable
        The sensor's measurement, of d components.
    steps : ndarray of int or None
        The steps of the rows, which are the last of the leading axes; None where there is no such
        axis.
    lead : tuple of int
        The shape of the leading axes, (...): runs, then rows.
    mean, cov, std : ndarray
        (..., d), (..., d, d) and (..., d).
    effective : ndarray
        (...): the effective number of points, 1 / Σ w².
    pareto : ndarray or None
        (...): of particles from which a reading was removed, by dividing their weights by its
        likelihood, the Pareto shape k of the weights; None else. Above 0.7 a few particles decide,
        and a `ParticleWarning` was given. NaN where nothing was read.

    Examples
    --------
    >>> from pgm.examples import walk, x, z
    >>> grid = pgm.Grid({"x": (-8.0, 8.0, 160)})
    >>> posterior = pgm.filter(walk, {z: [[4.0]]}, steps=2, belief=grid)
    >>> ahead = posterior.predicted[z]
    >>> ahead.mean.ravel().round(2) + 0.0, ahead.std.ravel().round(2)
    (array([0., 2.]), array([2., 2.]))
    >>> ahead.log_density([[1.0], [1.0]]).round(3)
    array([-1.737, -1.737])

    References
    ----------
    Vehtari, Simpson, Gelman, Yao & Gabry, Pareto smoothed importance sampling, 2024.
    """

    variable: Variable
    steps: Integers | None
    lead: tuple[int, ...]
    pareto: Array | None
    _measured: Measured

    _arrays: ClassVar[str] = ".mean and .cov"

    def __init__(
        self,
        variable: Variable,
        measured: Measured,
        lead: tuple[int, ...],
        steps: Integers | None = None,
        pareto: Array | None = None,
    ) -> None:
        if steps is not None:
            steps.flags.writeable = False
        self._set(
            variable=variable,
            steps=steps,
            lead=lead,
            pareto=None if pareto is None else closed(pareto.reshape(lead)),
            _measured=measured,
        )

    @property
    def components(self) -> tuple[str, ...]:
        """The names of the d components."""
        return self.variable.components

    @property
    def angles(self) -> tuple[str, ...]:
        """The names of the components that are angles."""
        return self.variable.angles

    @property
    def mean(self) -> Array:
        """The means, (..., d).

        Raises
        ------
        EvidenceError
            If the moments of the sensor's CPD are not known, as those of a `SampledCPD` or a scan:
            then `sample` draws.
        """
        return self._moments[0]

    @property
    def cov(self) -> Array:
        """The covariances, (..., d, d), refused where `mean` is."""
        return self._moments[1]

    @cached_property
    def std(self) -> Array:
        """The standard deviations, (..., d), refused where `mean` is."""
        return closed(deviation(self.cov))

    @cached_property
    def effective(self) -> Array:
        """The effective number of points, (...)."""
        return self._by_lead([cloud.effective for *_, cloud in self._measured.each()])

    def gaussian(self) -> Gaussian:
        """The normal density with the belief's mean and covariance, with its axes and steps."""
        return Gaussian._make((self.variable,), self.mean, self.cov, self.steps)

    def log_density(self, values: npt.ArrayLike) -> Array:
        """The log-density ln p(z) of measurements, in nats, (...).

        Parameters
        ----------
        values : array_like
            (..., d): one measurement for each belief, or one for all; finite.

        Raises
        ------
        ModelError
            If the shape does not fit, or the sensor's CPD has no density.
        """
        due = (*self.lead, self.variable.dimension)
        found = as_floats(values, f"measurements of {self.variable!r}")
        try:
            wide = np.broadcast_to(found, due)
        except ValueError:
            raise ModelError(
                f"{self._title}: measurements of shape {found.shape}; {due} was due",
                variable=self.variable,
            ) from None
        wide = wide.reshape(self._runs, -1, due[-1])
        every = []
        for place, (row, step, cloud) in enumerate(self._measured.each()):
            each = cloud.log_weights.copy()
            for at, some in _blocks(cloud, step):
                child = wide[:1, place] if some.owner is None else wide[some.owner, place]
                each[at] += self._measured.law.log_density(row, some, child.T)
            every.append(cloud.log_total(each))
        return self._by_lead(every)

    @public
    def sample(self, size: int | tuple[int, ...] = (), *, rng: np.random.Generator | int) -> Array:
        """Draws of the measurement, noise included, (*size, ..., d).

        Parameters
        ----------
        size : int or tuple of int
            The number of draws of each belief, or the shape of an array of draws.
        rng : numpy.random.Generator or int
            The generator of draws, or its seed.

        Raises
        ------
        ModelError
            If `size` is no number of draws, `rng` is neither a generator nor a seed, or the
            sensor's CPD cannot be drawn from.
        """
        extra, generator = as_lengths(size, "of each belief"), as_generator(rng)
        count, dimension = math.prod(extra), self.variable.dimension
        require_memory(
            count * math.prod(self.lead) * dimension,
            f"{size} draws of {self._title}",
            "draw fewer at a time",
        )
        law, rows = self._measured.law, len(self._measured.rows)
        found = np.empty((rows, self._runs, count, dimension))
        for place, (row, step, cloud) in enumerate(self._measured.each()):
            for run in range(cloud.runs):
                own = cloud.of(run)
                total = np.cumsum(cloud.weights[own])
                level = generator.random(count) * total[-1]
                chosen = np.minimum(np.searchsorted(total, level, side="right"), len(total) - 1)
                states = cloud.states[:, own][:, chosen]
                owner = None if cloud.runs == 1 else np.full(count, run)
                drawing = Drawing([(slice(0, count), generator)])
                found[place, run] = law.draw(row, Some(step, states, states, owner), drawing).T
        drawn = np.moveaxis(found, (2, 1), (0, 1))
        return drawn.reshape(*extra, *self.lead, dimension)

    @cached_property
    def _moments(self) -> tuple[Array, Array]:
        """The means (..., d) and the covariances (..., d, d)."""
        size = self.variable.dimension
        means = np.empty((len(self._measured.rows), self._runs, size))
        covs = np.empty((*means.shape, size))
        for place, each in enumerate(self._measured.each()):
            means[place], covs[place] = self._of(*each)
        return self._by_lead(means), self._by_lead(covs)

    def _of(self, row: int, step: int, cloud: Cloud) -> tuple[Array, Array]:
        """The means (runs, d) and covariances (runs, d, d) of one measurement."""
        size = self.variable.dimension
        each, inside = np.empty((size, len(cloud.log_weights))), np.zeros((cloud.runs, size, size))
        for at, some in _blocks(cloud, step):
            each[:, at], cov = moments(self._measured.law, row, some)
            weights = cloud.weights[at]
            owner = np.zeros(some.size, dtype=np.intp) if some.owner is None else some.owner
            if len(cov) == 1:
                inside += np.bincount(owner, weights, cloud.runs)[:, None, None] * cov
            else:
                np.add.at(inside, owner, weights[:, None, None] * cov)
        points = Cloud(each, cloud.log_weights, cloud.starts)
        belief = ParticleBelief(parts([(self.variable, 0)]), [points], (cloud.runs,))
        return belief.mean, belief.cov + inside

    @property
    def _runs(self) -> int:
        """The number of runs."""
        return math.prod(self.lead) // max(len(self._measured.rows), 1)

    def _by_lead(self, each: npt.ArrayLike) -> Array:
        """Values (runs, ...) of each row as a read-only array (*lead, ...)."""
        wide = np.shape(each)[2:]
        found = np.reshape(each, (len(self._measured.rows), self._runs, *wide)).swapaxes(0, 1)
        return closed(np.ascontiguousarray(found).reshape((*self.lead, *wide)))

    @property
    def _title(self) -> str:
        return f"PointMixture({self.variable!r}{axes(self.lead, self.steps)})"

    def _summary(self) -> Summary:
        if not all(self.lead):
            return Summary(self._title)
        names = [f"{c} [rad]" if c in self.angles else c for c in self.components]
        try:
            mean, cov = self._moments
        except Unanswered as error:
            return Summary(self._title, [str(error)])
        if not self.lead:
            return Summary(self._title, [by_component(names, mean, cov)])
        listing = stacked(names, self.lead, self.steps, lambda at: (mean[at], cov[at]))
        return Summary(self._title, [listing])

    def __getstate__(self) -> dict[str, Any]:
        # What was computed is not part of the value.
        names = ("variable", "steps", "lead", "pareto", "_measured")
        return {name: getattr(self, name) for name in names}


def moments(law: Law, row: int, some: Some) -> tuple[States, Array]:
    """The means (d, m) of a child at particles, and its covariances (m or 1, d, d) there.

    Those of a mixture are of the sum of its parts. A CPD of which they are not known is refused in
    words.
    """
    if isinstance(law, MixtureLaw):
        each = [moments(part, row, some) for part in law.parts]
        return _mixed(law, each, some.size)
    if not isinstance(law.cpd, ConditionalGaussian):
        raise Unanswered(
            f"{law.cpd!r} does not tell the moments of its child, and neither has this belief any: "
            "belief.sample(1000, rng=0) draws from it, and belief.log_density(values) weighs",
            variable=law.cpd.child,
        )
    if not isinstance(law, GaussianLaw):  # of robust noise, which counts with its `cov`
        law = GaussianLaw(law.cpd, law.inputs, law.places, law.dtype, law.first_run)
    root = law.root(row, some.step)
    cov = root.lower @ root.lower.swapaxes(-1, -2)
    if len(cov) > 1:
        cov = cov[root.of(some)]
    mean = law.mean(row, some)
    return np.broadcast_to(mean, (len(mean), some.size)), cov


def _mixed(
    law: MixtureLaw, each: Sequence[tuple[States, Array]], count: int
) -> tuple[States, Array]:
    """The moments of a mixture at particles, from those of its parts, as of `moments`."""
    weights = law.cpd.weights
    middle = each[int(weights.argmax())][0]
    away = np.stack([mean - middle for mean, _ in each])
    for k in np.flatnonzero(law.cpd.child.angle_mask):
        away[:, k] -= turns(away[:, k])
    shift = np.einsum("k,kim->im", weights, away)
    apart = np.stack([part - shift for part in away])
    cov = np.einsum("k,kim,kjm->mij", weights, apart, apart)
    for weight, (_, own) in zip(weights, each, strict=True):
        cov += weight * own
    return middle + shift, cov
