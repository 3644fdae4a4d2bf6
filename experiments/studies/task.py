"""The work of one part: a function, its settings, and a seed of its own."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from experiments.studies.errors import StudyError
from experiments.studies.settings import Value

Columns = dict[str, npt.NDArray[Any]]

# Figures are numbers, stored as these by the kind of their type.
STORED = {"b": np.bool_, "i": np.int64, "u": np.int64, "f": np.float64}


class Task(NamedTuple):
    """All that a worker needs for a part: no more, since it travels with each.

    Attributes
    ----------
    function : callable
    settings : dict of str
    runs, seed : int
    key : tuple of int
        Of the seed; of a part, this itself.
    called : str
        The part in words, for errors.
    """

    function: Callable[..., Mapping[str, Any]]
    settings: dict[str, Value]
    runs: int
    seed: int
    key: tuple[int, ...]
    called: str

    def figures(self) -> Columns:
        """The figures of the runs.

        Raises
        ------
        StudyError
            If they are not as they should be.
        """
        rng = np.random.default_rng(np.random.SeedSequence(self.seed, spawn_key=self.key))
        found = self.function(self.runs, rng, **self.settings)
        if not isinstance(found, Mapping) or not found:
            raise StudyError(
                f"{self.called} returned {type(found).__name__}; it returns figures by name"
            )
        return {str(name): self._checked(str(name), given) for name, given in found.items()}

    def _checked(self, name: str, given: Any) -> npt.NDArray[Any]:
        values = np.asarray(given)
        if values.shape != (self.runs,) or values.dtype.kind not in STORED:
            raise StudyError(
                f"{self.called}: figure {name!r} has the shape {values.shape} and type "
                f"{values.dtype}; of {self.runs} runs ({self.runs},) numbers are due"
            )
        if values.dtype.kind == "f" and np.isinf(values).any():
            run = int(np.argmax(np.isinf(values)))
            raise StudyError(
                f"{self.called}: figure {name!r} is infinite in run {run}; where a run has no such "
                "figure it is NaN, which is counted"
            )
        return values.astype(STORED[values.dtype.kind])
