"""The choice of machine code for the sweeps along a chain, and the reasons against it."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from importlib.util import find_spec
from typing import Any

import numpy as np

from pgm.arguments import public
from pgm.boundary import is_whole
from pgm.cpds import CPD, AffineCPD, ConditionalGaussian, NonlinearGaussianCPD
from pgm.display import InCode, Told
from pgm.errors import ModelError
from pgm.kernels import roots
from pgm.linearisers import Cubature, FunctionTemplate, GaussHermite, Taylor, Unscented
from pgm.resources import optional


@public
@dataclass(frozen=True)
class Compiled(InCode):
    """Sweeps along a chain in machine code, the runs shared by threads.

    Parameters
    ----------
    threads : int
        Threads, each with runs of its own.

    Raises
    ------
    ModelError
        If that is no whole number from 1 on.

    Examples
    --------
    >>> Compiled(threads=2)
    Compiled(threads=2)
    """

    threads: int = 1

    def __post_init__(self) -> None:
        if not is_whole(self.threads) or self.threads < 1:
            raise ModelError(
                f"Compiled(threads={self.threads!r}): threads must be a whole number from 1 on"
            )


# Points of these rules are the same at all steps.
RULES = Unscented, Cubature, GaussHermite
# None leaves it to the size of the work.
Choice = bool | Compiled | None


def as_choice(compiled: Any, what: str) -> Choice:
    """A choice of machine code, for which there has to be Numba."""
    if not isinstance(compiled, bool | Compiled | None):
        raise ModelError(
            f"{what}: compiled={compiled!r}; True, False or a pgm.Compiled(...) was due"
        )
    if compiled:
        optional("numba", f"{what.removesuffix(')')}, compiled=True)", "sepset[fast]")
    return compiled


class Compilation(Told[CPD]):
    """Of each CPD of a dynamic network ``"compiled"``, or why sweeps do not compile it.

    A chain is swept in machine code where all of its CPDs can be. `Taylor`, `Unscented`, `Cubature`
    and `GaussHermite` are compiled. Only a call can tell of gates, of its own lineariser, of noise
    by inputs that is singular, and of runs that are left, since their readings are too sharp.

    Examples
    --------
    >>> from pgm.examples import walk
    >>> print(list(pgm.compile(walk, 10).compilation.values()))
    ['compiled', 'compiled', 'compiled']
    """

    __slots__ = ()

    def __init__(
        self, of: str, templates: Mapping[CPD, FunctionTemplate | None], sensors: Collection[CPD]
    ) -> None:
        found = {cpd: _told(cpd, each, cpd in sensors) for cpd, each in templates.items()}
        super().__init__(f"Compilation of {of}", found)


def _told(cpd: CPD, template: FunctionTemplate | None, sensor: bool) -> str:
    if find_spec("numba") is None:
        return "Numba is not installed: pip install sepset[fast]"
    if not isinstance(cpd, ConditionalGaussian):
        return "it is not Gaussian"
    if cpd.noise is not None:
        return "its noise is robust"
    if sensor and isinstance(cpd.cov, np.ndarray) and roots.determined(roots.root(cpd.cov)).any():
        return "its noise is singular"
    if isinstance(cpd, AffineCPD):
        return "compiled"
    if isinstance(cpd, NonlinearGaussianCPD) and cpd.grouped:
        return "its sightings are grouped, where a step has several"
    rule = cpd.lineariser if isinstance(cpd, NonlinearGaussianCPD) else None
    if rule is not None and type(rule) not in (Taylor, *RULES):
        return f"it is linearised by {rule!r}"
    assert template is not None
    whole = template.whole.traced()
    return whole if isinstance(whole, str) else "compiled"
