"""The choice of machine code for the sweeps along a chain, and the reasons against it."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from importlib.util import find_spec
from typing import Any

import numpy as np

from pgm.arguments import public
from pgm.boundary import is_number, is_whole
from pgm.cpds import CPD, AffineCPD, ConditionalGaussian, NonlinearGaussianCPD
from pgm.display import InCode, Told, titled
from pgm.errors import ExecutorError, GraphError, ModelError, PgmError
from pgm.kernels import roots
from pgm.linearisers import (
    Cubature,
    FunctionTemplate,
    GaussHermite,
    Lineariser,
    StatisticalRegression,
    Taylor,
    Unscented,
)
from pgm.resources import optional


@public
@dataclass(frozen=True)
class Compiled(InCode):
    """Sweeps along a chain in machine code, the runs shared by threads, or on a card.

    On a card each run is a thread, in float64. Evidence is copied there with each sweep, and
    beliefs back, in parts of the runs where all do not fit into its memory; beliefs stay there if
    evidence lies there (`Posterior.on_card`), and a study's runs are drawn and summed there as
    well. What a card cannot do, and what a sweep leaves, is done as without one: functions
    that are called back, iterated smoothers' Gauss–Newton steps, mixtures, particles, twice the
    digits. It has not been run on a card yet: its code is tested by an interpreter, and assembled.

    Parameters
    ----------
    threads : int
        Threads of the processor, each with runs of its own, or of `Particles` with particles of its
        own; those of a `study` draw the runs and sum them as well.
    device : str, optional
        ``"cuda"`` for the first card of NVIDIA's, of compute capability 7.5 or later, by the extra
        ``sepset[gpu]``; of `compile`, `filter`, `smooth` and `study`, for dynamic networks.

    Raises
    ------
    ModelError
        If `threads` is no whole number from 1 on, or `device` is another one. Calls that are given
        it raise an ImportError without the extra, and an ExecutorError without a card or with too
        old a driver, or where one run alone does not fit into the card's memory.

    Examples
    --------
    >>> Compiled(threads=2)
    Compiled(threads=2)
    """

    threads: int = 1
    device: str | None = None

    def __repr__(self) -> str:
        device = "" if self.device is None else f", device={self.device!r}"
        return f"Compiled(threads={self.threads}{device})"

    def __post_init__(self) -> None:
        if self.device is not None and self.device != CUDA:
            raise ModelError(
                f"Compiled(device={self.device!r}): {CUDA!r} is known, or None for the processor"
            )
        if not is_whole(self.threads) or self.threads < 1:
            raise ModelError(
                f"Compiled(threads={self.threads!r}): threads must be a whole number from 1 on"
            )


@dataclass(frozen=True)
class Squared(Compiled):
    """Sweeps that keep the NIS of each sensor as well, as simulation studies ask."""


# Points of these rules are the same at all steps.
RULES = Unscented, Cubature, GaussHermite
# Components of a slice from which on these surely leave machine code; of packs some two fewer do.
_MANY = 9
# The most points of a rule: NumPy takes no longer where there are more.
POINTS = 128
# Angles and components without noise are told to kernels by the bits of a number.
MOST = 60
# Why a schedule leaves machine code.
CONTROL = "Levenberg–Marquardt (damping=) judges the windows of a lag"
# Why a CPD does whose sightings are one vector in sweeps that linearise going forward.
GROUPED = "its sightings are grouped, and gated, weighed or linearised again"
LONG = "step control, and windows of a lag, are compiled for slices of few components"
COMPILED = "compiled"
# The only device beside the processor.
CUDA = "cuda"
# Before the reason why machine code calls a function rather than having it itself.
CALLED = "called back: "
# None leaves it to the size of the work.
Choice = bool | Compiled | None


def as_choice(compiled: Any, what: str, *, card: bool = False) -> Choice:
    """A choice of machine code, for which there has to be llvmlite; `card` says if one may be due.

    A card that is asked for has to be there.
    """
    if not isinstance(compiled, bool | Compiled | None):
        raise ModelError(
            f"{what}: compiled={compiled!r}; True, False or a pgm.Compiled(...) was due"
        )
    if compiled:
        optional("llvmlite", f"{what.removesuffix(')')}, compiled=True)", "llvmlite")
    if is_for_card(compiled):
        if not card:
            raise ModelError(
                f"{what}: compiled={compiled!r}: a card sweeps the runs of a dynamic network, by "
                "filter, smooth, study or compile; leave out device="
            )
        _require_card(f"{what.removesuffix(')')}, compiled={compiled!r})")
    return compiled


def is_for_card(choice: Choice) -> bool:
    """Whether a choice asks for a card."""
    return isinstance(choice, Compiled) and choice.device is not None


def _require_card(what: str) -> None:
    """Refuse a card that is not there, or for which something is missing."""
    optional("cuda.bindings.driver", what, "sepset[gpu]")
    from pgm.kernels.machine.emitter.card import Card, libdevice
    from pgm.kernels.machine.emitter.driver import device

    try:
        libdevice()
        Card(device().capability)
    except (ImportError, OSError, ValueError) as error:
        kind = ImportError if isinstance(error, ImportError) else ExecutorError
        raise kind(f"{what}: {error}") from error


# Why compiled= is refused, and the remedy, of a network of tables, and of what goes in rounds.
_NO_USE: dict[str, tuple[type[PgmError], str]] = {
    "tables": (
        ModelError,
        "compiled= is for networks of Gaussian CPDs, and {of} has tables: leave it out",
    ),
    "rounds": (
        GraphError,
        "{of} is solved in rounds by NumPy: leave out compiled=, or the method, since machine code "
        "goes along the chain of slices, or over a tree of a network without time",
    ),
}


def without_machine_code(why: str, of: object) -> PgmError:
    """The error for `compiled=` where there is no machine code.

    `why` is ``"tables"`` or ``"rounds"``; `of` is the network, its graph, or the
    method.
    """
    error, text = _NO_USE[why]
    return error(text.format(of=titled(of)))


class Compilation(Told[CPD]):
    """For each CPD of a dynamic network ``"compiled"``, or why sweeps do not compile it.

    A chain is swept in machine code where all of its CPDs can be. A function that cannot be traced,
    and a lineariser other than `Taylor`, `Unscented`, `Cubature` and `GaussHermite`, is called back
    in the middle of it, for all runs at once: ``"called back: ..."`` says why. Of a schedule
    `under` tells, before there is a call; after it ``posterior.status.compilation`` tells of all:
    the schedule, the call's lineariser, noise by inputs that is singular, runs that are left since
    their readings are too sharp.

    Examples
    --------
    >>> from pgm.examples import walk
    >>> compilation = pgm.compile(walk, 10).compilation
    >>> print(list(compilation.values()))
    ['compiled', 'compiled', 'compiled']
    >>> compilation.under(pgm.Filtering(gate=0.99))
    'compiled'
    >>> compilation.under(pgm.FixedLag(5, iterations=3, damping=pgm.LevenbergMarquardt()))
    'left to NumPy: Levenberg–Marquardt (damping=) judges the windows of a lag'
    """

    __slots__ = ("_size",)

    def under(self, schedule: Any) -> str:
        """Whether sweeps of a schedule are compiled, or why some of them are not.

        Parameters
        ----------
        schedule : Filtering, FixedLag or Smoothing

        Returns
        -------
        str
            ``"compiled"``, with the CPDs that are called back; or ``"left to NumPy: ..."`` with the
            reasons, first the schedule's, then the CPDs'.
        """
        control = not is_number(getattr(schedule, "damping", 0.0))
        several = getattr(schedule, "iterations", 1) > 1
        lagging = bool(getattr(schedule, "lag", 0))
        why = [CONTROL] if control and several and lagging else []
        if several and (control or lagging) and self._size >= _MANY:
            why.append(LONG)
        # The windows of a lag, and the control of steps, do not wait for functions that are called.
        waits = not (several and (control or lagging))
        called = {cpd: words for cpd, words in self.items() if waits and words.startswith(CALLED)}
        why += [
            f"{cpd!r}: {words}"
            for cpd, words in self.items()
            if words != COMPILED and cpd not in called
        ]
        # A smoother, which may have a start, linearises all steps again.
        smooths = "start" in getattr(schedule, "takes", ())
        again = several and (control or lagging or smooths)
        if again or getattr(schedule, "gate", None) is not None:
            why += [f"{cpd!r}: {GROUPED}" for cpd in self if _is_grouped(cpd)]
        if why:
            return f"left to NumPy: {'; '.join(why)}"
        later = "; later linearisations by NumPy" if called and several and smooths else ""
        called_back = (f", {cpd.child.name} {words}" for cpd, words in called.items())
        return f"{COMPILED}{''.join(called_back)}{later}"

    def __init__(
        self, of: str, templates: Mapping[CPD, FunctionTemplate | None], sensors: Collection[CPD]
    ) -> None:
        found = {cpd: _told(cpd, each, cpd in sensors) for cpd, each in templates.items()}
        super().__init__(
            f"Compilation of {of}",
            found,
            "Levenberg–Marquardt of the windows of a lag leaves machine code as well: "
            "posterior.status.compilation tells of a call",
        )
        hidden = {cpd.child.template: cpd.child.dimension for cpd in found if cpd not in sensors}
        self._size = sum(hidden.values())


def _told(cpd: CPD, template: FunctionTemplate | None, sensor: bool) -> str:
    if find_spec("llvmlite") is None:
        return "llvmlite is not installed: pip install llvmlite"
    if not isinstance(cpd, ConditionalGaussian):
        return "it is not Gaussian"
    if cpd.noise is not None and cpd.noise.graduated:
        return "its noise is graduated"
    if sensor and isinstance(cpd.cov, np.ndarray) and roots.determined(roots.root(cpd.cov)).any():
        return "its noise is singular"
    size = cpd.child.dimension if template is None else max(cpd.child.dimension, template.size)
    if size > MOST:
        return f"it has more than {MOST} components"
    if isinstance(cpd, AffineCPD):
        return COMPILED
    assert template is not None
    whole = template.whole.traced()
    rule = cpd.lineariser if isinstance(cpd, NonlinearGaussianCPD) else None
    if _is_grouped(cpd) and cpd.noise is not None:
        return GROUPED
    why = None if rule is None else rule_told(rule, template)
    why = why or (whole if isinstance(whole, str) else None)
    return f"{CALLED}{why}" if why else COMPILED


def _is_grouped(cpd: CPD) -> bool:
    """Whether the errors of a step's sightings are correlated, by the CPD's own lineariser."""
    if not isinstance(cpd, NonlinearGaussianCPD) or cpd.lineariser is None:
        return False
    return cpd.grouped and type(cpd.lineariser) is not Taylor


def rule_told(rule: Lineariser, template: FunctionTemplate) -> str | None:
    """Why sweeps do not compile a lineariser for functions of a template."""
    if not template.size or type(rule) is Taylor:
        return None
    if type(rule) not in RULES or not isinstance(rule, StatisticalRegression):
        return f"it is linearised by {rule!r}"
    count = len(rule.points(template.size, template.child.name, 0).points)
    return f"{rule!r} has {count} points; up to {POINTS} are compiled" if count > POINTS else None
