"""Beliefs that lie on a card, and how other libraries get at them there."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from pgm.display import Shown, Summary
from pgm.errors import EvidenceError
from pgm.factors.scope import listed
from pgm.immutable import Immutable
from pgm.kernels import dlpack
from pgm.kernels.arrays import Array, address
from pgm.kernels.machine.emitter.driver import Held
from pgm.posteriors.outcome import Outcome
from pgm.posteriors.posterior import Posterior
from pgm.resources import NUMBER
from pgm.variables import Variable


class CardArray(Shown, Immutable):
    """An array of float64 in the memory of a CUDA card, which lasts as long as anybody holds it.

    It has the CUDA array interface and DLPack: ``cupy.asarray(a)``, ``torch.as_tensor(a)`` and
    ``jax.numpy.from_dlpack(a)`` take it without a copy. They are not to write to it.

    Attributes
    ----------
    shape : tuple of int
    """

    __slots__ = ("_first", "_memory", "_strides", "shape")

    shape: tuple[int, ...]
    _memory: Held
    _first: int
    _strides: tuple[int, ...]

    def __init__(
        self, memory: Held, first: int, shape: tuple[int, ...], strides: tuple[int, ...]
    ) -> None:
        self._set(_memory=memory, _first=first, shape=shape, _strides=strides)

    @property
    def dtype(self) -> np.dtype[np.float64]:
        """The type of its numbers, float64."""
        return np.dtype(np.float64)

    @property
    def __cuda_array_interface__(self) -> dict[str, Any]:
        return {
            "shape": self.shape,
            "typestr": "<f8",
            "data": (self._memory.address + self._first, False),
            "strides": self._strides,
            "version": 3,
            "stream": None,  # all that fills it is done
        }

    def __dlpack_device__(self) -> tuple[int, int]:
        return dlpack.CUDA, 0

    def __dlpack__(
        self,
        *,
        stream: Any = None,
        max_version: tuple[int, int] | None = None,
        dl_device: tuple[int, int] | None = None,
        copy: bool | None = None,
    ) -> Any:
        if copy or dl_device not in (None, self.__dlpack_device__()):
            raise BufferError("the array is handed over as it lies on the card; .home() copies it")
        first = self._memory.address + self._first
        return dlpack.capsule(first, self.shape, self._strides, self.__dlpack_device__(), self)

    def home(self) -> Array:
        """A copy in this machine's memory, an array of NumPy's."""
        extent = sum(k * (n - 1) for k, n in zip(self._strides, self.shape, strict=True))
        room = np.empty(extent // NUMBER + 1)
        device = self._memory.device
        with device.current():
            device.get(self._memory.address + self._first, address(room), room.nbytes)
        return np.lib.stride_tricks.as_strided(room, self.shape, self._strides).copy()

    def _summary(self) -> Summary:
        return Summary(f"CardArray{self.shape}", ["of float64, on a card"])


class CardMoments(NamedTuple):
    """Means (..., T+1, d) and covariances (..., T+1, d, d) that lie on a card."""

    mean: CardArray
    cov: CardArray


class CardBeliefs(Shown, Immutable):
    """The beliefs of hidden variables that lie on a card, ``posterior.on_card[x].mean``."""

    __slots__ = ("_moments",)

    _moments: Mapping[Variable, CardMoments]

    def __init__(self, moments: Mapping[Variable, CardMoments]) -> None:
        self._set(_moments=dict(moments))

    def __getitem__(self, variable: Variable) -> CardMoments:
        found = self._moments.get(variable) if isinstance(variable, Variable) else None
        if found is None:
            raise EvidenceError(
                f"no belief of {variable!r} lies on the card; those of [{listed(self._moments)}] do"
            )
        return found

    def _summary(self) -> Summary:
        told = [
            f"{variable!r}: means {each.mean.shape}" for variable, each in self._moments.items()
        ]
        return Summary("CardBeliefs", told)


class PosteriorOnCard(Posterior[Any]):
    """A posterior whose beliefs lie on a card, and come home at the first look at anything else."""

    @classmethod
    def lying(
        cls, beliefs: CardBeliefs, log_evidence: Array, home: Callable[[], Outcome[Any]]
    ) -> PosteriorOnCard:
        """The posterior of beliefs there; `home` finds the outcome here."""
        found = object.__new__(cls)
        found.__dict__.update(_beliefs=beliefs, _log_evidence=log_evidence, _home=home)
        return found

    @cached_property
    def _outcome(self) -> Outcome[Any]:
        found: Outcome[Any] = self.__dict__["_home"]()
        return found

    def __reduce__(self) -> tuple[Any, ...]:
        """The posterior at home, which is copied and pickled as any other is."""
        return Posterior, (self._outcome, self._entered, self._verdict)

    @property
    def log_evidence(self) -> Array:
        """The log-evidence, which has come home."""
        found: Array | None = self.__dict__.get("_log_evidence")
        return super().log_evidence if found is None else found

    @property
    def on_card(self) -> CardBeliefs:
        """The beliefs that lie on the card."""
        found: CardBeliefs | None = self.__dict__.get("_beliefs")
        return super().on_card if found is None else found
