"""Posteriors as data sets of xarray: the marginals of all hidden variables, by name."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from pgm.compile import DynamicGraph
from pgm.factors import Table
from pgm.factors.listing import run_names
from pgm.factors.scope import dimension, distinct_labels, units
from pgm.kernels.arrays import Array
from pgm.posteriors.outcome import marginal
from pgm.resources import FRAMES, optional, require_memory
from pgm.variables import Variable


class Labelled:
    """Base of posteriors, which can return their marginals as a data set of xarray."""

    def to_xarray(self: Any) -> Any:
        """The marginals of all hidden variables as a data set of xarray.

        For continuous variables it has ``mean`` and ``std``, with the dimensions of runs (``run``,
        or ``run_0``, ``run_1``, ...), ``step``, where there is time, and ``component``, and
        ``cov``, with ``other_component`` last. The components of all variables are along
        ``component``, by name; a name that several variables use is preceded by the variable's, and
        ``variable`` has the variable of each component, ``unit`` its unit, where any is known. The
        covariance of two variables is NaN: ``posterior.joint`` has it. A hidden control, which has
        no value at step 0, is NaN there.

        For discrete variables it has the probabilities of each, under its name, with its states
        along a last dimension ``<name>_state``.

        ``log_evidence`` has the dimensions of runs. Attributes are ``kind``, where there is time,
        and ``log_evidence_kind``. An `ImportError` says how to install xarray where it is missing.

        Examples
        --------
        >>> from pgm.examples import drive
        >>> found = pgm.filter(drive, {}, steps=4).to_xarray()
        >>> float(found.cov.sel(step=4, component="north", other_component="north"))
        5.0
        """
        xarray = optional("xarray", f"{type(self).__name__}.to_xarray()", FRAMES)
        runs = run_names(np.ndim(self.log_evidence))
        marginals = {variable: marginal(self, variable) for variable in self._hidden}
        steps = self.graph.steps if isinstance(self.graph, DynamicGraph) else None
        coords = {} if steps is None else {"step": np.arange(steps + 1)}
        dims = [*runs, *coords]
        tables = {v: belief for v, belief in marginals.items() if isinstance(belief, Table)}
        data, more = _tables(tables, dims, steps)
        if len(tables) < len(marginals) or not tables:
            lead = (*np.shape(self.log_evidence), *map(len, coords.values()))
            others = {v: belief for v, belief in marginals.items() if v not in tables}
            moments, named = _moments(others, dims, lead, steps)
            data, more = data | moments, more | named
        data["log_evidence"] = (runs, np.asarray(self.log_evidence))
        attributes = {"log_evidence_kind": self.log_evidence_kind}
        if steps is not None:
            attributes = {"kind": str(self.kind), **attributes}
        return xarray.Dataset(data, {**coords, **more}, attributes)


# Arrays of a data set by name, each with its dimensions.
Arrays = dict[str, tuple[list[str], Any]]


def _tables(
    marginals: Mapping[Variable, Any], dims: list[str], steps: int | None
) -> tuple[Arrays, dict[str, Any]]:
    """The probabilities of discrete variables, and the coordinates of the data set.

    `marginals` has the table of each variable. The first result has, by the variable's name, the
    names of the dimensions and the array; the second has the names of the variable's states as the
    coordinate ``<name>_state``. `dims` are the leading dimensions, runs and steps; `steps` is T,
    None without time.
    """
    data: Arrays = {}
    states: dict[str, Any] = {}
    for variable, table in marginals.items():
        own = f"{variable!r}_state"
        data[repr(variable)] = ([*dims, own], _at_all_steps(table.values, -2, steps))
        states[own] = list(table.scope[0].states)
    return data, states


def _moments(
    marginals: Mapping[Variable, Any], dims: list[str], lead: tuple[int, ...], steps: int | None
) -> tuple[Arrays, dict[str, Any]]:
    """The moments of continuous variables, and the coordinates of the data set.

    `marginals` has the Gaussian of each variable. The first result has ``mean``, ``std`` and
    ``cov`` over the components of all variables, each as the names of its dimensions and the array;
    the second has the names of the components and of their variables. `dims` are the leading
    dimensions, runs and steps; `steps` is T, None without time. Covariances between two variables
    are NaN.
    """
    each = [_at_all_steps(belief.mean, -2, steps) for belief in marginals.values()]
    size = dimension(marginals)
    require_memory(
        math.prod(lead) * size * size,
        f"the covariances of {size} components as one array",
        "take posterior[x] of the variables that are wanted",
    )
    mean = np.concatenate([np.empty((*lead, 0)), *each], axis=-1)
    cov, first = np.full((*lead, size, size), np.nan), 0
    for variable, belief in marginals.items():
        own = slice(first, first := first + variable.dimension)
        cov[..., own, own] = _at_all_steps(belief.cov, -3, steps)
    labels = list(distinct_labels(marginals))
    owners = [repr(variable) for variable in marginals for _ in variable.components]
    data: Arrays = {
        "mean": ([*dims, "component"], mean),
        "std": ([*dims, "component"], np.sqrt(np.einsum("...ii->...i", cov))),
        "cov": ([*dims, "component", "other_component"], cov),
    }
    named = {"component": labels, "other_component": labels, "variable": ("component", owners)}
    if any(known := units(marginals)):
        named["unit"] = ("component", list(known))
    return data, named


def _at_all_steps(values: Any, axis: int, steps: int | None) -> Array:
    """A variable's values at all steps 0..T, with NaN at step 0 if the variable begins at step 1.

    `axis` is the axis of steps, as a negative number. T is `steps`; it is None without time, and
    the values then stay as they are.
    """
    if steps is None or values.shape[axis] == steps + 1:
        return np.asarray(values)
    before = [(0, 0)] * values.ndim
    before[axis] = (1, 0)
    return np.pad(values, before, constant_values=np.nan)
