"""One row of a comparison: the beliefs of one state, with their scores."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any

import numpy as np

from pgm import consistency
from pgm.comparison.judgement import Judgement
from pgm.comparison.tally import Tally
from pgm.display import Listing, Shown, Summary, number
from pgm.errors import LinearisationError, NumericalError
from pgm.factors import Gaussian
from pgm.factors.scope import labels
from pgm.inference import Kind
from pgm.kernels import roots
from pgm.kernels.angles import difference
from pgm.kernels.arrays import Array, Mask
from pgm.variables import Variable

# The failures of a run that are a row with an error; others are of the whole call.
FAILURES = (LinearisationError, NumericalError)


@dataclass(frozen=True, eq=False, repr=False)
class Row(Shown):
    """The beliefs of one state, under one label and schedule, with their scores.

    What was not asked for, or could not be found, is NaN. Means over steps leave out the steps
    where a covariance of some run is singular or infinite, of the belief or of an oracle. Errors of
    scores against the truth are standard errors over runs, NaN of a single run.

    Attributes
    ----------
    lineariser, schedule : str
        The lineariser's name, or the label that was given in ``rows=``, and the schedule's; of
        beliefs that were given, their kind. An oracle's rows have its own name.
    state : Variable
    kind : Kind
        Which measurements the beliefs know.
    by_oracle : mapping of str to Judgement
        The judgement of each oracle that has beliefs of this kind: KL(N_p ‖ q) of the belief q from
        the Gaussian N_p of the oracle's mean and covariance. Of an oracle's row, its own is the
        KL(p ‖ N_p) of the oracle p from that Gaussian, NaN if its beliefs tell none by
        ``non_gaussianity()``, as draws, which have no density; that of another oracle tells how far
        the two disagree. Where p is a density, KL(p ‖ q) is the sum of both.
    rmse, rmse_error : mapping of str to float
        By component, in its units, over runs and steps; of angles, of wrapped errors.
    nees_by_step : ndarray
        (T+1,): the NEES, mean over runs.
    nees, nees_error, nees_expected : float
        Its mean over steps, its error, and what a right belief has: the number of components that
        are known.
    log_score, log_score_error : float
        The log-density of the truth, in nats, the mean over runs and steps; see
        `pgm.consistency.log_score`.
    log_evidence : float
        ln p(measurements), the mean over runs.
    log_evidence_kind : str
        ``exact``, ``linearised``, ``laplace``, ``merged``, ``grid``, and so on.
    seconds : float
        Duration of the one call, with work done once in a process, of an oracle that was run with
        several seeds of all of them; NaN of beliefs that came with another row's, or were given.
    converged : float
        The share of runs whose iterations have settled; NaN of a schedule without iterations.
    left_out : int
        The number of steps that KL, NEES and log-score leave out.
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
    by_oracle: Mapping[str, Judgement]
    nees_by_step: Array
    rmse: Mapping[str, float] = field(default_factory=dict)
    rmse_error: Mapping[str, float] = field(default_factory=dict)
    nees: float = np.nan
    nees_error: float = np.nan
    nees_expected: float = np.nan
    log_score: float = np.nan
    log_score_error: float = np.nan
    log_evidence: float = np.nan
    log_evidence_kind: str = ""
    seconds: float = np.nan
    converged: float = np.nan
    left_out: int = 0
    error: str = ""

    def __post_init__(self) -> None:
        self.nees_by_step.flags.writeable = False
        for name in _MAPPINGS:
            object.__setattr__(self, name, MappingProxyType(dict(getattr(self, name))))

    @property
    def _judgement(self) -> Judgement:
        """The first oracle's judgement; one of NaN without any."""
        return next(iter(self.by_oracle.values()), Judgement.none(len(self.nees_by_step)))

    @property
    def kl_by_step(self) -> Array:
        """(T+1,), in nats: the KL of the first oracle in `by_oracle`, the mean over runs."""
        return self._judgement.kl_by_step

    @property
    def kl_error_by_step(self) -> Array:
        """(T+1,): the Monte Carlo standard errors of `kl_by_step`; see `Judgement`."""
        return self._judgement.error_by_step

    @property
    def kl(self) -> float:
        """The mean over steps of `kl_by_step`, in nats."""
        return self._judgement.kl

    @property
    def kl_error(self) -> float:
        """The Monte Carlo standard error of `kl`: 0 of an oracle without draws, NaN if unknown."""
        return self._judgement.error

    @property
    def kl_most(self) -> float:
        """The largest of `kl_by_step`."""
        return self._judgement.kl_most

    @property
    def kl_step(self) -> int | None:
        """The step where the KL is largest; None without any."""
        return self._judgement.kl_step

    @property
    def weak(self) -> str:
        """Why the first oracle is too weak for this row, in words; empty where it is not."""
        return self._judgement.weak

    @property
    def _title(self) -> str:
        return f"Row({self.lineariser}, {self.schedule}, {self.state!r}, {self.kind})"

    def _summary(self) -> Summary:
        figures = [
            ("KL [nats]", self.kl),
            ("its standard error", self.kl_error),
            *((f"RMSE {label}", value) for label, value in self.rmse.items()),
            ("NEES", self.nees),
            ("NEES expected", self.nees_expected),
            ("log-score", self.log_score),
            ("log-evidence", self.log_evidence),
            ("seconds", self.seconds),
        ]
        rows = [(name, number(value)) for name, value in figures if not np.isnan(value)]
        parts: list[str | Listing] = [Listing(("", ""), rows)] if rows else []
        if self.weak:
            parts.append(f"? the oracle is too weak for it: {self.weak}")
        return Summary(self._title, [*parts, *([self.error] if self.error else [])])

    def __getstate__(self) -> dict[str, Any]:
        # Read-only views of mappings cannot be pickled.
        return self.__dict__ | {name: dict(getattr(self, name)) for name in _MAPPINGS}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self.__post_init__()


_MAPPINGS = ("by_oracle", "rmse", "rmse_error")


@dataclass(frozen=True, eq=False)
class Name:
    """The key of a row: lineariser or label, schedule, state, and kind of belief."""

    lineariser: str
    schedule: str
    state: Variable
    kind: Kind


def scored(
    name: Name,
    belief: Gaussian,
    truth: Array | None,
    kept: Mask,
    judgements: Mapping[str, Judgement],
    **rest: Any,
) -> Row:
    """The row of a belief over steps, judged by oracles already, and scored against the truth.

    belief: (*runs, T+1, d).
    truth: (*runs, T+1, d), NaN where it is not known, or one for all runs.
    kept: (T+1,): the steps whose NEES and log-score count.
    **rest: Other attributes of the row.
    """
    nees = np.full(kept.size, np.nan)
    if truth is not None:
        rest |= _rmse(name.state, consistency.error(belief, truth))
        if kept.any():
            own, known = belief[..., kept], truth[..., kept, :]
            average = consistency.anees(own, known)
            nees[kept] = average.value
            overall = average.overall()
            score = consistency.log_score(own, known)
            squares = consistency.nees(own, known)
            mean, error = over_runs(score)
            rest |= {
                "nees": float(overall.value),
                "nees_error": over_runs(squares)[1],
                "nees_expected": float(overall.expected),
                "log_score": mean,
                "log_score_error": error,
            }
    judged = truth is not None or bool(judgements)
    rest["left_out"] = int((~kept).sum()) if judged else 0
    return Row(**vars(name), by_oracle=judgements, nees_by_step=nees, **rest)


def of_track(name: Name, values: Array, truth: Array | None, **rest: Any) -> Row:
    """The row of values without covariances, (*runs, T+1, d), NaN where none is known."""
    scores: dict[str, Any] = {}
    if truth is not None:
        errors = difference(values, np.broadcast_to(truth, values.shape), name.state.angle_mask)
        scores = _rmse(name.state, errors)
    none = np.full(values.shape[-2], np.nan)
    return Row(**vars(name), by_oracle={}, nees_by_step=none, **scores, **rest)


def failed(name: Name, steps: int, truth: Array | None, error: Exception, **rest: Any) -> Row:
    """The row of a run that failed.

    steps: T + 1.
    **rest: Other attributes of the row.
    """
    components = labels((name.state,)) if truth is not None else ()
    return Row(
        **vars(name),
        by_oracle={},
        rmse=dict.fromkeys(components, np.nan),
        nees_by_step=np.full(steps, np.nan),
        error=f"{type(error).__name__}: {error}",
        **rest,
    )


def proper(belief: Gaussian) -> Mask:
    """The steps, (T+1,), at which the covariances of all runs are regular and finite."""
    lower = roots.root(belief.cov)
    regular = (np.diagonal(lower, axis1=-2, axis2=-1) > 0.0).all(axis=-1)
    return np.asarray(regular.reshape(-1, regular.shape[-1]).all(axis=0))


def over_runs(values: Array) -> tuple[float, float]:
    """The mean of values (*runs, T+1) that are not NaN, and its standard error over runs."""
    mean, error = Tally.of(values.reshape(-1, values.shape[-1])).over_all()
    return float(mean), float(error)


def _rmse(state: Variable, errors: Array) -> dict[str, dict[str, float]]:
    """The root mean square error of each component, and its error; NaN where never known."""
    rmse, error = {}, {}
    for label, each in zip(labels((state,)), np.moveaxis(errors, -1, 0), strict=True):
        square, spread = over_runs(each**2)
        rmse[label] = float(np.sqrt(square))
        error[label] = spread / (2.0 * rmse[label]) if rmse[label] > 0.0 else spread
    return {"rmse": rmse, "rmse_error": error}
