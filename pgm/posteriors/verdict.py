"""The verdict of an estimate: whether it can be vouched for, and what it took."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from pgm.display import NoArray, Shown, Summary, number
from pgm.factors.arrays import lead_index
from pgm.immutable import Immutable
from pgm.kernels.arrays import Array, Integers, Mask, frozen

# What `within` bounds, by the number that stands for it.
KINDS = "", "density", "moments", "exact"
# The effective draws that estimates need, and the shape of their weights' tail.
ENOUGH, HEAVY = 100.0, 0.7


class Verdict(Shown, Immutable, NoArray):
    """The verdict on an estimate: a bound on its error, and what was tried, of each run, (*runs).

    Attributes
    ----------
    vouched : ndarray of bool
        Whether the answer can be vouched for: starts agree on the modes, enough draws count, and
        the answer is `within` a tenth of a nat, half of this if it is of `recombined` trajectories.
    within : ndarray
        A bound [nats] on the divergence of the worst marginal from the exact one, which holds with
        a probability of 95 %, but for modes that nothing has found: of up to 1 % of the mass, and
        more where a posterior has very many, or very narrow ones. NaN where nothing was found out.
    of : ndarray of str
        What is within that bound: the ``"density"`` of each belief, whose moments may be further
        off where it has long tails, the ``"moments"``, its mean and covariance, or ``"exact"``;
        empty where it is not vouched for.
    starts, settled, modes : ndarray of int
        How many iterations were started, how many of them settled, and at how many modes.
    resumed : ndarray of int
        How often one that had not settled went on from where it had stopped.
    agreed : ndarray of bool
        Whether nine in ten starts settled, or stopped too far below the best mode to matter, and
        modes that one start alone has found have no more than .005 of the mass.
    draws : ndarray of int
        How many draws were weighed, by all rules that were tried.
    effective : ndarray
        How many equally weighted draws they are worth; 100 or more can be used.
    pareto_k : ndarray
        The shape of the tail of their weights; below 0.7 they can be used.
    recombined : ndarray of bool
        Whether draws are of each step alone, and the answer that of trajectories recombined from
        them. Then effective numbers and tails are those of the step at which the fewest count.
    tried_otherwise : ndarray of int
        How many of the starts were by another rule, which takes means of nonlinear functions over a
        belief, not their slopes: it is tried where draws do not vouch for the modes.
    otherwise : ndarray of bool
        Whether the answer has the modes of that rule.
    unlikely : ndarray of bool
        Whether the measurements do not fit what was found: all noises together are larger than the
        model has them once in a million. Where starts settled at one point the model is probably
        wrong, or readings are outliers; the answer may be vouched for all the same, as that model's
        own. Where they settled at several, there may also be another mode, with nearly all of the
        mass, and nothing is vouched for.
    reason : str
        Why no draws were weighed; empty where they were.

    Examples
    --------
    >>> from pgm.examples import walk, z
    >>> verdict = pgm.estimate(walk, {z: [[4.0]]}).verdict
    >>> bool(verdict.vouched), str(verdict.of)
    (True, 'exact')
    """

    vouched: Mask
    within: Array
    of: npt.NDArray[np.str_]
    starts: Integers
    settled: Integers
    resumed: Integers
    modes: Integers
    agreed: Mask
    draws: Integers
    effective: Array
    pareto_k: Array
    recombined: Mask
    tried_otherwise: Integers
    otherwise: Mask
    unlikely: Mask
    reason: str

    def __init__(self, lead: tuple[int, ...], reason: str = "", **found: Any) -> None:
        arrays = {name: frozen(np.asarray(value).reshape(lead)) for name, value in found.items()}
        self._set(reason=reason, **arrays)

    @classmethod
    def exact(cls, lead: tuple[int, ...]) -> Verdict:
        """The verdict on exact beliefs."""
        return cls._without_draws(lead, True, 0.0, KINDS[3])

    @classmethod
    def unknown(cls, lead: tuple[int, ...], reason: str) -> Verdict:
        """The verdict on beliefs that cannot be judged, for a reason."""
        return cls._without_draws(lead, False, np.nan, KINDS[0], reason)

    @classmethod
    def _without_draws(
        cls, lead: tuple[int, ...], vouched: bool, within: float, of: str, reason: str = ""
    ) -> Verdict:
        counts = "starts", "settled", "resumed", "modes", "draws", "tried_otherwise"
        none = dict.fromkeys(counts, np.zeros(lead, np.intp))
        figures = dict.fromkeys(("effective", "pareto_k"), np.full(lead, np.nan))
        return cls(
            lead,
            reason,
            vouched=np.full(lead, vouched),
            within=np.full(lead, within),
            of=np.full(lead, of),
            agreed=np.full(lead, vouched),
            recombined=np.full(lead, False),
            otherwise=np.full(lead, False),
            unlikely=np.full(lead, False),
            **none,
            **figures,
        )

    def __getitem__(self, runs: Any) -> Verdict:
        """The verdict on some runs, by their places along the axes of runs."""
        found = {name: getattr(self, name) for name in _FIGURES}
        for axis, item in reversed(list(enumerate(lead_index(runs, self.vouched.shape, self)))):
            at = (slice(None),) * axis + (item,)
            found = {name: each[at] for name, each in found.items()}
        return Verdict(np.shape(found["vouched"]), self.reason, **found)

    __iter__ = None  # else Python would go through places until one is refused

    @property
    def headline(self) -> str:
        """A line on whether, and within how much, the answer is vouched for."""
        count, runs = int(self.vouched.sum()), self.vouched.size
        if not count:
            return f"NOT vouched for{' in any run' * (self.vouched.ndim > 0)}: {self._why}"
        where = f" in {count} of {runs} runs" if self.vouched.ndim else ""
        rest = f"; not in the others: {self._why}" if count < runs else ""
        kinds = sorted(set(self.of[self.vouched].tolist()))
        if kinds == [KINDS[3]]:
            return f"vouched for{where}: exact"
        worst = number(float(self.within[self.vouched].max()), 2)
        of = " or ".join(kinds)
        return (
            f"vouched for{where}: the {of} of every belief within {worst} nats{self._misfit}{rest}"
        )

    @property
    def _misfit(self) -> str:
        """That measurements do not fit the model, of runs that are vouched for."""
        runs = self.unlikely & self.vouched
        if not runs.any():
            return ""
        return f", by a model that the measurements do not fit{_where(runs)}"

    @property
    def _why(self) -> str:
        """Why runs are not vouched for, with how many of them."""
        if self.reason:
            return self.reason
        left = ~self.vouched
        reasons = []
        for name, mask in (
            ("starts do not agree on the modes", ~self.agreed),
            ("measurements fit none of the modes", self.unlikely),
            ("too few draws count", ~(self.effective > ENOUGH)),
            ("the weights of draws have a heavy tail", ~(self.pareto_k < HEAVY)),
            ("the bound is too wide", np.ones_like(left)),
        ):
            here = left & mask
            left = left & ~mask
            if here.any():
                reasons.append(name + (f" ({here.sum()})" if here.ndim else ""))
        return ", ".join(reasons)

    @property
    def _moments(self) -> str:
        """The draws that moments are of, or why they are of none."""
        used = (self.effective > ENOUGH) & (self.pareto_k < 1.0)
        left = "as iterations found them, since too few draws count, or their tail is too heavy"
        if not used.any():
            return left
        source = "draws"
        if self.recombined.any():
            source = f"trajectories recombined from draws of each step{_where(self.recombined)}"
        if used.all():
            return f"with moments of the {source}"
        return f"with moments of the {source}{_where(used)}, in the others {left}"

    @property
    def _tried(self) -> str:
        """The starts by another rule."""
        tried = self.tried_otherwise
        if not tried.any():
            return ""
        return f"; {tried.max()} of the starts by a rule that takes means{_where(tried > 0)}"

    @property
    def _further(self) -> str:
        """The starts that went on."""
        return f"{_span(self.resumed)} more of starts that went on, " if self.resumed.any() else ""

    @property
    def _rule(self) -> str:
        """The rule of the modes that were chosen."""
        other = self.otherwise
        return f", by the rule that takes means{_where(other)}," if other.any() else ","

    @property
    def _title(self) -> str:
        return f"Verdict({self.headline})"

    def _summary(self) -> Summary:
        if not self.draws.any():
            return Summary(self._title)
        mixture = "one Gaussian" if self.modes.max() == 1 else f"{_span(self.modes)} Gaussians"
        lines = [
            f"tried: {_span(self.starts)} starts, {_span(self.settled)} of which settled, at "
            f"{_span(self.modes)} mode{'s' * bool(self.modes.max() > 1)}{self._tried}",
            f"chosen: {mixture}{self._rule} {self._moments}",
            f"judged by: {_span(self.draws)} draws, worth {_span(self.effective)}, of tail "
            f"{_span(self.pareto_k)} (to be below {HEAVY})",
            f"cost: {_span(self.starts)} iterated answers in "
            f"{'two batches' if self.tried_otherwise.any() else 'one batch'}, {self._further}"
            f"{_span(self.draws)} draws",
        ]
        return Summary(self._title, lines)


# The attributes that have a value for each run.
_FIGURES = tuple(name for name in Verdict.__annotations__ if name != "reason")


def _where(runs: Mask) -> str:
    """In how many of all runs, where these are some, in words."""
    count = int(runs.sum())
    return f" (in {count} of {runs.size} runs)" if count < runs.size else ""


def _span(values: Any) -> str:
    """Values in words: one, or the least to the largest, but for those that are not known."""
    low, high = (number(float(end(values)), 3) for end in (np.nanmin, np.nanmax))
    return low if low == high else f"{low} to {high}"
