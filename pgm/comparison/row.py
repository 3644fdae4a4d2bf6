"""One row of a comparison: one run's beliefs of one state, with their scores."""

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np

from pgm import consistency
from pgm.display import Listing, Shown, Summary, number
from pgm.errors import LinearisationError, NumericalError
from pgm.factors import Gaussian
from pgm.factors.scope import labels
from pgm.inference import Kind
from pgm.kernels import roots
from pgm.kernels.arrays import Array, Mask
from pgm.variables import Variable

# The failures of a run that are a row with an error; others are of the whole call.
FAILURES = (LinearisationError, NumericalError)


@dataclass(frozen=True, eq=False, repr=False)
class Row(Shown):
    """The beliefs of one state by one lineariser under one schedule, with their scores.

    What was not asked for, or could not be found, is NaN. Means over steps leave out the steps
    where a covariance of some run is singular or infinite, of the belief or of the oracle.

    Attributes
    ----------
    lineariser, schedule : str
        Their names; the oracle's rows have its own in place of a lineariser's.
    state : Variable
    kind : Kind
        Which measurements the beliefs know.
    kl_by_step : ndarray
        (T+1,), in nats, the mean over runs: KL(N_p ‖ q) of the belief q from the Gaussian N_p of
        the oracle's mean and covariance; of the oracle's rows the KL(p ‖ N_p) of the oracle p from
        that Gaussian. Where p is a density, KL(p ‖ q) is the sum of both. NaN of an oracle's row
        if its beliefs tell no such KL, by ``non_gaussianity()``: draws have no density.
    rmse : mapping of str to float
        By component, in its units, over runs and steps; of angles, of wrapped errors.
    nees_by_step : ndarray
        (T+1,): the NEES, mean over runs.
    nees, nees_expected : float
        Its mean over steps, and what a right belief has: the number of components that are known.
    log_evidence : float
        ln p(measurements), the mean over runs.
    log_evidence_kind : str
        ``exact``, ``linearised``, ``laplace``, ``merged``, ``grid``, and so on.
    seconds : float
        Duration of the one call, with work done once in a process; NaN of beliefs that came with
        another row's, or were given.
    converged : float
        The share of runs whose iterations have settled; NaN of a schedule without iterations.
    left_out : int
        The number of steps that KL and NEES leave out.
    error : str
        Why the run failed, in words; empty if it did not.

    Examples
    --------
    >>> from pgm.examples import walk, x, z
    >>> found = pgm.compare(walk, {z: [[2.0], [3.0]]}, truth={x: [[0.0], [1.0], [2.0]]})
    >>> row = found["Taylor", "filter"]
    >>> row.log_evidence_kind, round(row.rmse["x"], 2)
    ('exact', 0.0)
    """

    lineariser: str
    schedule: str
    state: Variable
    kind: Kind
    kl_by_step: Array
    rmse: Mapping[str, float]
    nees_by_step: Array
    nees: float = np.nan
    nees_expected: float = np.nan
    log_evidence: float = np.nan
    log_evidence_kind: str = ""
    seconds: float = np.nan
    converged: float = np.nan
    left_out: int = 0
    error: str = ""

    def __post_init__(self) -> None:
        for name in ("kl_by_step", "nees_by_step"):
            getattr(self, name).flags.writeable = False
        object.__setattr__(self, "rmse", MappingProxyType(dict(self.rmse)))

    @property
    def kl(self) -> float:
        """The mean over steps of `kl_by_step`, in nats."""
        return mean_of_known(self.kl_by_step)

    @property
    def kl_most(self) -> float:
        """The largest of `kl_by_step`."""
        step = self.kl_step
        return np.nan if step is None else float(self.kl_by_step[step])

    @property
    def kl_step(self) -> int | None:
        """The step where the KL is largest; None without any."""
        known = ~np.isnan(self.kl_by_step)
        return int(np.nanargmax(self.kl_by_step)) if known.any() else None

    @property
    def _title(self) -> str:
        return f"Row({self.lineariser}, {self.schedule}, {self.state!r}, {self.kind})"

    def _summary(self) -> Summary:
        figures = [
            ("KL [nats]", self.kl),
            *((f"RMSE {label}", value) for label, value in self.rmse.items()),
            ("NEES", self.nees),
            ("NEES expected", self.nees_expected),
            ("log-evidence", self.log_evidence),
            ("seconds", self.seconds),
        ]
        rows = [(name, number(value)) for name, value in figures if not np.isnan(value)]
        parts: list[str | Listing] = [Listing(("", ""), rows)] if rows else []
        return Summary(self._title, [*parts, *([self.error] if self.error else [])])

    def __getstate__(self) -> dict[str, Any]:
        # Read-only views of mappings cannot be pickled.
        return self.__dict__ | {"rmse": dict(self.rmse)}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self.__post_init__()


@dataclass(frozen=True, eq=False)
class Name:
    """The key of a row: lineariser, schedule, state, and kind of belief."""

    lineariser: str
    schedule: str
    state: Variable
    kind: Kind


def judge(
    name: Name,
    belief: Gaussian,
    oracle: Gaussian | None,
    truth: Array | None,
    *,
    own: Array | None = None,
    **rest: Any,
) -> Row:
    """The row of a belief over steps.

    belief: (*runs, T+1, d).
    oracle: The same.
    truth: (*runs, T+1, d), NaN where it is not known, or one for all runs.
    own: (T+1,): the KL of an oracle's own row, in place of that from another one.
    **rest: Other attributes of the row.
    """
    kept = proper(belief)
    if oracle is not None:
        kept &= proper(oracle)
    kl, nees = np.full(kept.size, np.nan), np.full(kept.size, np.nan)
    rmse = {} if truth is None else _rmse(belief, truth)
    if own is not None:
        kl[kept] = own[kept]
    if oracle is not None and kept.any():
        found = consistency.kl(oracle[..., kept], belief[..., kept])
        kl[kept] = found.reshape(-1, found.shape[-1]).mean(axis=0)
    if truth is not None and kept.any():
        average = consistency.anees(belief[..., kept], truth[..., kept, :])
        overall = average.overall()
        nees[kept] = average.value
        rest |= {"nees": float(overall.value), "nees_expected": float(overall.expected)}
    judged = truth is not None or oracle is not None or own is not None
    rest["left_out"] = int((~kept).sum()) if judged else 0
    return Row(**vars(name), kl_by_step=kl, rmse=rmse, nees_by_step=nees, **rest)


def failed(name: Name, steps: int, truth: Array | None, error: Exception, **rest: Any) -> Row:
    """The row of a run that failed.

    steps: T + 1.
    **rest: Other attributes of the row.
    """
    none = np.full(steps, np.nan)
    components = labels((name.state,)) if truth is not None else ()
    return Row(
        **vars(name),
        kl_by_step=none,
        rmse=dict.fromkeys(components, np.nan),
        nees_by_step=none.copy(),
        error=f"{type(error).__name__}: {error}",
        **rest,
    )


def proper(belief: Gaussian) -> Mask:
    """The steps, (T+1,), at which the covariances of all runs are regular and finite."""
    lower = roots.root(belief.cov)
    regular = (np.diagonal(lower, axis1=-2, axis2=-1) > 0.0).all(axis=-1)
    return np.asarray(regular.reshape(-1, regular.shape[-1]).all(axis=0))


def mean_of_known(values: Array) -> float:
    """The mean of the entries that are not NaN; NaN if there are none."""
    known = values[~np.isnan(values)]
    return float(known.mean()) if known.size else np.nan


def _rmse(belief: Gaussian, truth: Array) -> dict[str, float]:
    """The root mean square error of each component; NaN where its truth is never known."""
    errors = np.moveaxis(consistency.error(belief, truth), -1, 0)
    return {
        label: float(np.sqrt(mean_of_known(error**2)))
        for label, error in zip(labels(belief.scope), errors, strict=True)
    }
