"""Fans: the readings of a sensor over time, and what was expected of them and of those to come."""

import math
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from scipy.stats import norm

from pgm.arguments import public
from pgm.errors import EvidenceError, ModelError
from pgm.factors import Gaussian
from pgm.factors.scope import labels
from pgm.kernels.angles import nearest_branch
from pgm.kernels.arrays import Array, Integers
from pgm.plot.beliefs.strip import strip
from pgm.plot.drawing.axes import (
    Unit,
    along,
    columns_of,
    name_time,
    unit_of,
    useful_legend,
    with_unit,
)
from pgm.plot.drawing.colours import INK, MUTED, look_of
from pgm.plot.drawing.components import as_gaussian, component_places, one_run
from pgm.posteriors.posterior import Posterior, require_variable
from pgm.variables import Discrete, Variable

# The shades of the widest band and of the narrowest one, were this of no width.
_PALE, _DEEP = 0.16, 0.8


@public
def forecast(
    posterior: Posterior[Any],
    sensor: Variable,
    *,
    components: Sequence[str] | None = None,
    confidence: float | Sequence[float] = (0.5, 0.8, 0.95),
    run: int | tuple[int, ...] | None = None,
    times: npt.ArrayLike | None = None,
    unit: Unit = None,
    colour: str | None = None,
    axes: Axes | Iterable[Axes] | None = None,
) -> tuple[Axes, ...]:
    """Plot a sensor's readings in the fan of what was expected: one step ahead, then beyond them.

    The bands hold 50, 80 and 95 % of ``posterior.predicted[sensor]``, whose mean is the line: up to
    the last reading, which a dotted line marks, each step knows the readings before it, and later
    steps know them all. About so many readings should lie in each band. Where a flat prior leaves
    all open there is no band. Angles go on beyond half a turn, the readings along with the line. Of
    mixtures, particles and grids the bands are those of the Gaussian of their mean and covariance.

    Of a discrete sensor there is a strip instead: a row for each state, the darker the more
    probable, and dots where readings were; hollow ones are soft readings, at their likeliest state.

    Parameters
    ----------
    posterior : Posterior
        Of a dynamic network, by any schedule; ``pgm.filter(model, {z: zs}, steps=40)`` goes on
        where the readings `zs` end.
    sensor : Variable
        The measurement z.
    components : sequence of str, optional
        Which components, by name; all without. Not of a discrete sensor.
    confidence : float or sequence of float
        The probability of each band.
    run : int or tuple of int, optional
        Which of several runs.
    times : array_like, optional
        The time of each row of ``posterior.predicted[sensor]``, for the horizontal axis; steps
        without.
    unit : str or mapping of str, optional
        The unit of components that have none of their own; see `trajectory`.
    colour : str, optional
        Of the fan; the next of a palette without.
    axes : matplotlib.axes.Axes or iterable of them, optional
        One a component, and one of a discrete sensor; a column of new ones without.

    Returns
    -------
    tuple of matplotlib.axes.Axes
        One a component; of a discrete sensor one.

    Raises
    ------
    ModelError
        If there are several runs, or several sightings at a step, or an argument does not fit.
    EvidenceError
        If the posterior has no beliefs of this measurement (see `Posterior.predicted`), or `sensor`
        is no variable.

    Examples
    --------
    >>> from pgm.examples import walk, z
    >>> posterior = pgm.filter(walk, {z: [[1.0], [0.5], [2.0]]}, steps=8)
    >>> (ax,) = pgm.plot.forecast(posterior, z, unit="m")
    >>> ax.get_ylabel()
    'z [m]'
    """
    bands = _probabilities(confidence)
    if isinstance(sensor, Discrete) and sensor.step is None:
        if components is not None or unit is not None:
            raise ModelError(
                f"{sensor!r} is discrete, and has neither components nor units: leave these out",
                variable=sensor,
            )
        drawn = strip(posterior, sensor, run=run, times=times, colour=colour, axes=axes)
        return (drawn,)
    belief, read, values = _of(posterior, sensor, run)
    chosen = labels(belief.scope) if components is None else list(components)
    places = component_places(belief, components if components is not None else chosen)
    if not places:
        raise ModelError("no components to draw; name one or more, or leave components out")
    steps: Any = belief.steps
    across, name = along(steps, times)
    columns = columns_of(axes, len(places))
    own = dict(zip(labels(belief.scope), belief.units, strict=True))
    look = look_of(columns[0], colour)
    for place, component, ax in zip(places, chosen, columns, strict=True):
        std = np.where(np.isfinite(belief.std[:, place]), belief.std[:, place], np.nan)
        mean = np.where(np.isnan(std), np.nan, belief.mean[:, place])
        there = np.flatnonzero(~np.isnan(values[:, place]))
        at, seen = np.searchsorted(steps, read[there]), values[there, place]
        if component in sensor.angles:
            mean, seen = _without_jumps(mean, at, seen)
        for probability in bands[::-1]:
            reach = norm.ppf(0.5 + 0.5 * probability) * std
            depth = _PALE + (_DEEP - _PALE) * (1.0 - probability / bands[-1])
            # No shade through which a wider band is seen: the legend has the same.
            shade = 1.0 + depth * (np.array(to_rgb(look.colour)) - 1.0)
            within = f"{100.0 * probability:.4g} %"
            ax.fill_between(
                across, mean - reach, mean + reach, color=shade, lw=0, zorder=1.0, label=within
            )
        ax.plot(across, mean, color=look.colour, ls=look.dash, lw=1.4, zorder=2.0, label="expected")
        ax.plot(across[at], seen, "o", ms=3.2, color=INK, zorder=3.0, label="reading")
        if there.size and at.max() < len(across) - 1:
            ax.axvline(
                across[at.max()], color=MUTED, ls=":", lw=1.2, zorder=1.5, label="last reading"
            )
        said = f"{sensor.name} {component}" if sensor.dimension > 1 else sensor.name
        of = unit_of(component, unit, own)
        name_time(ax, name if ax is columns[-1] else "", with_unit(said, of))
        ax.margins(x=0.01)
    useful_legend(columns[0], above=True)
    return columns


def _probabilities(confidence: float | Sequence[float]) -> list[float]:
    """The probabilities of bands, rising; others are a ModelError."""
    found = np.sort(np.atleast_1d(np.asarray(confidence, dtype=float)))
    if found.ndim != 1 or not found.size or not ((found > 0.0) & (found < 1.0)).all():
        raise ModelError(f"confidence is a probability, or some, between 0 and 1: {confidence!r}")
    return [float(each) for each in found]


def _without_jumps(mean: Array, at: Integers, seen: Array) -> tuple[Array, Array]:
    """Expected angles (N,) without jumps of a turn, and the readings `seen` at their rows `at`.

    A mean is NaN where nothing was known; a reading there is drawn near the next that is known.
    """
    known = np.flatnonzero(~np.isnan(mean))
    if not known.size:
        return mean, seen
    whole = mean.copy()
    whole[known] = np.unwrap(mean[known])
    near = whole[known[np.searchsorted(known, at).clip(max=known.size - 1)]]
    return whole, nearest_branch(seen[:, None], near[:, None], np.array([True]))[:, 0]


def _of(
    posterior: Posterior[Any], sensor: Variable, run: int | tuple[int, ...] | None
) -> tuple[Gaussian, Integers, Array]:
    """The beliefs of a sensor by step, of one run, its steps with readings, and these, (M, d)."""
    if require_variable(sensor).step is not None:
        raise ModelError(
            f"{sensor!r} is of one step, and a fan is of all: give {sensor.template!r}"
        )
    found = as_gaussian(posterior.predicted[sensor])
    if found.steps is None:
        raise EvidenceError(f"{sensor!r} has no steps", variable=sensor)
    step, values = posterior._readings_of(sensor)
    lead = found.mean.shape[:-2]
    if run is None and math.prod(lead) != 1:
        raise ModelError(
            f"the posterior has the leading axes {lead}, of runs; choose one, as with run="
            f"{0 if len(lead) == 1 else (0,) * len(lead)}",
            variable=sensor,
        )
    if run is not None:
        place = (run,) if isinstance(run, int) else run
        found, values = found.run(*place), values[place]
    belief = one_run(found)
    order = np.argsort(np.asarray(found.steps), kind="stable")
    belief = belief[order]
    assert belief.steps is not None
    if (np.diff(belief.steps) < 1).any():
        raise ModelError(
            f"{sensor!r} has several sightings at a step, each of other parents: a fan is of one "
            "reading a step",
            variable=sensor,
        )
    return belief, step, values.reshape(len(step), sensor.dimension)
