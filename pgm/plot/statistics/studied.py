"""Statistics of a study over time, a curve a method."""

from typing import TypeVar

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes

from pgm.arguments import public
from pgm.comparison import Statistic, Study, StudyRow
from pgm.display import titled
from pgm.errors import ModelError
from pgm.factors.scope import labels, listed
from pgm.kernels.arrays import Array
from pgm.plot.drawing.axes import along, given_or_new, line, name_time, useful_legend
from pgm.plot.drawing.colours import INK, look_of
from pgm.variables import Variable

T = TypeVar("T")
_STATISTICS = ("rmse", "bias", "nees", "coverage", "nis", "kl")
# Standard errors to either side, within which 95 % of estimates are.
_WITHIN = 1.96


@public
def study(
    found: Study,
    *,
    statistic: str = "nees",
    state: Variable | None = None,
    component: str | None = None,
    sensor: Variable | None = None,
    times: npt.ArrayLike | None = None,
    ax: Axes | None = None,
) -> Axes:
    """Draw a statistic of a study over time, a curve a method, with the value of a right belief.

    A band about a curve is 1.96 of its standard errors over runs to either side. Steps at which no
    run has the statistic are left out.

    Parameters
    ----------
    found : Study
        The result of `pgm.study`.
    statistic : str
        ``"rmse"`` or ``"bias"``, of one component; ``"nees"``; ``"coverage"``; ``"nis"``, of one
        sensor; or ``"kl"``, of a study with an oracle.
    state : Variable, optional
        The state judged, if there are several.
    component : str, optional
        The component, if the state has several.
    sensor : Variable, optional
        The sensor, if there are several.
    times : array_like, optional
        (T+1,), for the horizontal axis; the steps themselves without.
    ax : matplotlib.axes.Axes, optional
        Where to draw; a new figure's without.

    Raises
    ------
    ModelError
        If it is no study, has no such statistic, state, component or sensor, or none is named of
        several.

    Examples
    --------
    >>> from pgm.examples import walk
    >>> methods = {"KF": pgm.Filtering(), "RTS": pgm.Smoothing()}
    >>> found = pgm.study(walk, steps=10, runs=200, methods=methods, seed=1)
    >>> ax = pgm.plot.study(found, statistic="rmse")
    >>> ax.get_ylabel()
    'RMSE of x'
    """
    if not isinstance(found, Study):
        raise ModelError(f"study draws what pgm.study returns, not {titled(found)}")
    if statistic not in _STATISTICS:
        raise ModelError(f"statistic= is one of {list(_STATISTICS)}, not {statistic!r}")
    state = _one("state", state, found.states)
    rows = [row for row in found.rows if row.state == state]
    for argument, given, of in (
        ("component", component, ("rmse", "bias")),
        ("sensor", sensor, ("nis",)),
    ):
        if given is not None and statistic not in of:
            raise ModelError(
                f"{argument}={given!r} is of statistic={' or '.join(map(repr, of))}, and "
                f"{statistic!r} is drawn: leave it out"
            )
    name, place = (
        statistic.upper() if statistic in ("rmse", "nees", "nis", "kl") else statistic,
        None,
    )
    if statistic in ("rmse", "bias"):
        known = labels((state,))
        component = _one("component", component, known)
        name, place = f"{name} of {component}", known.index(component)
    if statistic == "nis":
        sensor = _one("sensor", sensor, tuple(dict.fromkeys(z for row in rows for z in row.nis)))
        rows = [row for row in rows if sensor in row.nis]
        name = f"{name} of {sensor.name}"
    if statistic == "kl" and rows[0].kl is None:
        raise ModelError("the study has no oracle, and no KL; pgm.study(..., oracle=) gives it one")
    across, axis = along(np.arange(found.steps + 1), times)
    ax = given_or_new(ax)
    for row in rows:
        each = _statistic(row, statistic, sensor)
        _draw(ax, across, each, place, row.method)
    if not np.isnan(each.expected):
        ax.axhline(each.expected, color=INK, lw=0.8, zorder=1.5)
    name_time(ax, axis, name)
    useful_legend(ax)
    return ax


def _statistic(row: StudyRow, name: str, sensor: Variable | None) -> Statistic:
    found: Statistic = row.nis[sensor] if sensor and name == "nis" else getattr(row, name)
    return found


def _draw(
    ax: Axes, across: npt.NDArray[np.float64], each: Statistic, place: int | None, label: str
) -> None:
    def known(by_step: Array) -> Array:
        return by_step if place is None else by_step[:, place]

    values, error = known(each.by_step), _WITHIN * np.nan_to_num(known(each.error_by_step))
    there = ~np.isnan(values)
    across, values, error = across[there], values[there], error[there]
    look = look_of(ax, None)
    low, high = values - error, values + error
    ax.fill_between(across, low, high, color=look.colour, alpha=0.18, lw=0.0, zorder=1.8)
    line(ax, across, values, look, label, dots=not there[1:].all())


def _one(what: str, given: T | None, known: tuple[T, ...]) -> T:
    """The thing that is drawn: the one given, or the only one."""
    if given is None and len(known) == 1:
        return known[0]
    if given is None or given not in known:
        raise ModelError(
            f"the study has {what}s {listed(known)}; name one, {what}=..., not {given!r}"
        )
    return given
