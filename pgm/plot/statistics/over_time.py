"""Errors over time: one run against its deviations, many runs, and divergences."""

from collections.abc import Iterable, Sequence

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes

from pgm import consistency
from pgm.arguments import public
from pgm.errors import ModelError
from pgm.factors import Gaussian
from pgm.factors.scope import labels
from pgm.inference import Kind
from pgm.kernels.angles import difference
from pgm.plot.drawing.axes import (
    Unit,
    along,
    band,
    columns_of,
    given_or_new,
    line,
    name_time,
    unit_of,
    useful_legend,
    with_unit,
)
from pgm.plot.drawing.colours import INK, look_of
from pgm.plot.drawing.components import component_places, one_run, truth_columns


@public
def errors(
    belief: Gaussian,
    truth: npt.ArrayLike,
    *,
    components: Sequence[str] | None = None,
    sigma: float = 3.0,
    times: npt.ArrayLike | None = None,
    unit: Unit = None,
    label: str | Kind | None = None,
    colour: str | None = None,
    axes: Axes | Iterable[Axes] | None = None,
) -> tuple[Axes, ...]:
    r"""Plot each component's error over time within the band ±σ of its own deviation.

    .. math:: e_t = \mu_t - x_t, \qquad |e_t| \le \sigma \sqrt{P_t}

    Errors of angles are wrapped. Call it again with the same `axes` to compare beliefs: each
    takes the next colour.

    Parameters
    ----------
    belief : Gaussian
        Over steps, as ``posterior[x]``; of one run.
    truth : array_like
        (steps, k), columns in the order of the belief's components.
    components : sequence of str, optional
        Which components, by name; all without.
    sigma : float
        Half the width of the band, in standard deviations.
    times : array_like, optional
        (steps,), the time of each step, for the horizontal axis; the steps themselves without.
    label : str or Kind, optional
        In the legend, above the first axes.
    axes : matplotlib.axes.Axes or iterable of them, optional
        One a component; a column of new ones without.
    unit, colour
        See `trajectory`.

    Returns
    -------
    tuple of matplotlib.axes.Axes
        One a component.

    Raises
    ------
    ModelError
        If the belief has several runs, or an argument does not fit it.

    Examples
    --------
    >>> x = pgm.Variable("x")
    >>> belief = pgm.Gaussian(x, mean=[[2.0], [4.0]], cov=4.0, steps=[0, 1])
    >>> (ax,) = pgm.plot.errors(belief, truth=[[0.0], [0.0]], unit="m")
    >>> ax.get_ylabel()
    'x error [m]'
    """
    belief = one_run(belief)
    chosen = labels(belief.scope) if components is None else list(components)
    places = component_places(belief, components if components is not None else chosen)
    if not places:
        raise ModelError("no components to draw; name one or more, or leave components out")
    if not (np.isfinite(sigma) and sigma > 0.0):
        raise ModelError(f"sigma must be a number of standard deviations above 0, not {sigma!r}")
    true = truth_columns(belief, truth, places)
    mean, reach = belief.mean[:, places], sigma * belief.std[:, places]
    if true.shape != mean.shape:
        raise ModelError(
            f"the truth has {true.shape[:-1]} steps where the belief has {len(mean)}; give "
            "(steps, components), the truth at the belief's steps and of the same run"
        )
    error = difference(mean, true, belief.angles[places])
    steps = belief.steps
    if steps is None:
        steps = (belief.scope[0].step or 0) + np.arange(len(mean))
    across, name = along(steps, times)

    columns = columns_of(axes, len(places))
    look = look_of(columns[0], colour)
    own = dict(zip(labels(belief.scope), belief.units, strict=True))
    marker = "o" if len(mean) == 1 else None
    for k, ax in enumerate(columns):
        if not ax.lines:
            ax.axhline(0.0, color=INK, lw=0.8, zorder=1.0)
        within = f"±{sigma:g}σ" if label is None else f"{label} ±{sigma:g}σ"
        band(
            ax,
            across,
            -reach[:, k],
            reach[:, k],
            look.colour,
            within,
            dash=look.dash,
            inside=0.18,
            outline=0.4,
        )
        ax.plot(
            across,
            error[:, k],
            color=look.colour,
            ls=look.dash,
            lw=1.2,
            marker=marker,
            label="error" if label is None else str(label),
        )
        of = unit_of(chosen[k], unit, own)
        name_time(ax, name if ax is columns[-1] else "", with_unit(f"{chosen[k]} error", of))
    useful_legend(columns[0], above=True)
    return columns


@public
def rmse(
    belief: Gaussian,
    truth: npt.ArrayLike,
    *,
    components: Sequence[str] = (),
    percentiles: tuple[float, float] = (5.0, 95.0),
    times: npt.ArrayLike | None = None,
    unit: Unit = None,
    label: str | Kind | None = None,
    colour: str | None = None,
    ax: Axes | None = None,
) -> Axes:
    """Draw the RMSE over runs at each step, over a band of percentiles of single runs' errors.

    The line is what a few bad runs can rule; the band is what they cannot. Call it again with
    the same `ax` to compare beliefs: each takes the next colour.

    Parameters
    ----------
    belief : Gaussian
        Over steps, as ``posterior[x]``.
    truth : array_like
        (*runs, steps, n).
    components : sequence of str
        Over which the error's length is taken; all without.
    percentiles : pair of float
        The lower and upper edge of the band, in percent.
    times : array_like, optional
        (steps,), for the horizontal axis; the steps themselves without.
    unit, label, colour, ax
        See `trajectory`.

    Raises
    ------
    ModelError
        If the belief is over no steps, or an argument does not fit it.

    Examples
    --------
    >>> x = pgm.Variable("x")
    >>> belief = pgm.Gaussian(x, mean=[[2.0], [4.0]], cov=4.0, steps=[0, 1])
    >>> ax = pgm.plot.rmse(belief, truth=[[0.0], [0.0]], label="belief", unit="m")
    >>> ax.lines[0].get_ydata()
    array([2., 4.])
    """
    found = consistency.rmse_over_time(belief, truth, components, percentiles=percentiles)
    across, name = along(found.steps, times)
    ax = given_or_new(ax)
    look = look_of(ax, colour)
    label = str(label or "RMSE")
    if found.runs > 1:
        band(
            ax,
            across,
            found.low,
            found.high,
            look.colour,
            _between(label, percentiles),
            dash=look.dash,
        )
    line(ax, across, found.rms, look, label)
    # From zero, and still scaled to the next belief, which may be larger.
    ax.update_datalim(np.zeros((1, 2)), updatex=False)
    ax.lines[-1].sticky_edges.y.append(0.0)
    ax.autoscale_view()
    own = dict(zip(labels(belief.scope), belief.units, strict=True))
    units = [unit_of(one, unit, own) for one in components or own]
    text = f"error in {', '.join(components)}" if components else "error"
    name_time(ax, name, with_unit(text, *units))
    useful_legend(ax)
    return ax


@public
def kl(
    p: Gaussian,
    q: Gaussian,
    *,
    percentiles: tuple[float, float] = (5.0, 95.0),
    times: npt.ArrayLike | None = None,
    label: str | Kind | None = None,
    colour: str | None = None,
    ax: Axes | None = None,
) -> Axes:
    """Draw KL(p ‖ q) at each step on a logarithmic axis: its median, and percentiles, over runs.

    Call it again with the same `ax` to compare several q with one p: each takes the next colour.
    What is zero, which has no logarithm, is left out.

    Parameters
    ----------
    p, q : Gaussian
        Over steps, as ``posterior[x]``; p is the one to be right.
    percentiles : pair of float
        The lower and upper edge of the band, in percent.
    times : array_like, optional
        (steps,), for the horizontal axis; the steps themselves without.
    label, colour, ax
        See `trajectory`.

    Raises
    ------
    ModelError
        If the beliefs are over no steps, or not of the same variables.
    NumericalError
        If a covariance is singular.

    Examples
    --------
    >>> x = pgm.Variable("x")
    >>> p, q = (pgm.Gaussian(x, [[k], [2.0 * k]], 1.0, steps=[0, 1]) for k in (0.0, 1.0))
    >>> ax = pgm.plot.kl(p, q)
    >>> ax.lines[0].get_ydata()
    array([0.5, 2. ])
    """
    divergence = consistency.kl(p, q)
    found = consistency.over_time(divergence, p.steps, percentiles)
    across, name = along(found.steps, times)
    ax = given_or_new(ax)
    ax.set_yscale("log")
    look = look_of(ax, colour)
    label = str(label or "KL")
    low, median, high = (
        np.where(part > 0.0, part, np.nan) for part in (found.low, found.median, found.high)
    )
    if found.runs > 1:
        band(ax, across, low, high, look.colour, _between(label, percentiles), dash=look.dash)
    line(ax, across, median, look, label if found.runs == 1 else f"{label}, median")
    name_time(ax, name, "KL divergence [nats]")
    useful_legend(ax)
    return ax


def _between(label: str, percentiles: tuple[float, float]) -> str:
    return f"{label}, {percentiles[0]:g} to {percentiles[1]:g} % of runs"
