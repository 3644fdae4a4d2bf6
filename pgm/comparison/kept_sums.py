"""The file of a study: the sums of the blocks that are done, with which a killed study goes on."""

from __future__ import annotations

import hashlib
import io
import json
import os
from collections.abc import Callable, Mapping
from pathlib import Path
from time import monotonic
from typing import Any

import numpy as np
import numpy.typing as npt

from pgm.comparison.sums import Sums
from pgm.comparison.tally import Tally
from pgm.errors import FileError, ModelError
from pgm.io.sources import whole
from pgm.variables import Variable

# Seconds of work that a killed study loses at most, beside the block under way.
_APART = 1.0
_KIND = "study of pgm, 1"
_ANEW = "delete it, or name another file, and the study begins anew"

Members = dict[str, npt.NDArray[Any]]


class KeptSums:
    """The sums of the first blocks of a study, in a file of NumPy's format npz.

    The file is replaced by one that was written whole, and has a digest of all that it holds.

    description: The arguments of the study by their names, as they are told where a file has
        others; of what has no short words a digest, in brackets.
    variables: Those that the sums are of.
    machine_code: Whether the study runs in machine code where it may choose; of a file that is
        there, whether it did.
    blocks: How many blocks are done.
    """

    def __init__(
        self,
        path: str | os.PathLike[str],
        description: Mapping[str, str],
        variables: tuple[Variable, ...],
        *,
        machine_code: bool,
    ) -> None:
        if not isinstance(path, str | os.PathLike):
            raise ModelError(f"file= is the path of a file, as 'study.npz', not {path!r}")
        self.path = Path(path)
        self.machine_code = machine_code
        self.blocks = 0
        self._description = dict(description)
        self._variables = variables
        self._first: dict[str, Sums] = {}
        self._sums: dict[str, Sums] = {}
        self._written = (-1, monotonic())
        if self.path.exists():
            self._read()

    def begun(self, work: Callable[[int], Mapping[str, Sums]]) -> dict[str, Sums]:
        """The sums of the blocks that are done, after the first of them was done again.

        What digests of the arguments do not tell shows in its digits, such as another processor.

        Raises
        ------
        FileError
            If the first block has other figures now, or nothing can be written.
        """
        self.end()  # before any work, whose results there must be a place for
        if self.blocks:
            now, due = (_members(each, self._variables) for each in (work(0), self._first))
            if _digest(now) != _digest(due):
                raise self._fault(
                    "the first block has other figures now: something that functions read, the "
                    "processor or versions of libraries are not as they were; go on where it was "
                    f"begun, or {_ANEW}"
                )
        return dict(self._sums)

    def add(self, sums: Mapping[str, Sums]) -> None:
        """Keep the sums after one block more; they are written if the last time is long ago."""
        self._first = self._first or dict(sums)
        self._sums = dict(sums)
        self.blocks += 1
        if monotonic() - self._written[1] >= _APART:
            self._write()

    def end(self) -> None:
        """Write what is not yet in the file."""
        if self._written[0] < self.blocks:
            self._write()

    def require_at_most(self, runs: int, block: int) -> None:
        """Refuse a file that has more runs than a study, in blocks of so many."""
        if self.blocks * block > runs:
            raise self._fault(
                f"it has {self.blocks * block:,} runs, and {runs:,} are asked for; ask for as many "
                "or more, or name another file"
            )

    def _write(self) -> None:
        members: Members = {
            "kind": np.array(_KIND),
            "description": np.array(json.dumps(self._description)),
            "methods": np.array(json.dumps(sorted(self._sums))),
            "blocks": np.array(self.blocks),
            "machine_code": np.array(self.machine_code),
        }
        for part, sums in (("first", self._first), ("all", self._sums)):
            members |= {f"{part}/{k}": v for k, v in _members(sums, self._variables).items()}
        content = io.BytesIO()
        np.savez(content, allow_pickle=False, **members, digest=np.array(_digest(members)))
        try:
            with whole(self.path, durable=True) as beside:
                beside.write_bytes(content.getvalue())
        except OSError as error:
            raise self._fault(
                f"the study cannot be kept there ({error.strerror or error}); make its folder, or "
                "room, or name another file"
            ) from error
        self._written = self.blocks, monotonic()

    def _read(self) -> None:
        try:
            with np.load(io.BytesIO(self.path.read_bytes()), allow_pickle=False) as file:
                members = dict(file)
            if str(members["kind"]) != _KIND:
                raise ValueError(f"its kind is {members['kind']}")
            if str(members.pop("digest")) != _digest(members):
                raise ValueError("its digest is another")
        except Exception as error:  # NumPy and zipfile raise many kinds where an archive is damaged
            raise self._fault(
                f"it is no file of a study, or damaged ({type(error).__name__}: {error}); {_ANEW}"
            ) from error
        there = json.loads(str(members["description"]))
        if there != self._description:
            raise self._fault(
                f"it is of another study: {_differences(there, self._description)}; give the "
                "arguments that it was begun with, or name another file"
            )
        self.blocks, self.machine_code = int(members["blocks"]), bool(members["machine_code"])
        self._written = self.blocks, monotonic()
        names = json.loads(str(members["methods"]))
        self._first, self._sums = (
            _of_members(f"{part}/", members, names, self._variables) for part in ("first", "all")
        )

    def _fault(self, message: str) -> FileError:
        return FileError(f"{self.path}: {message}", path=str(self.path))


def _differences(there: Mapping[str, str], here: Mapping[str, str]) -> str:
    """The arguments that differ, in words."""

    def words(name: str) -> str:
        was, now = (each.get(name, "none") for each in (there, here))
        if was.partition(" [")[0] == now.partition(" [")[0]:  # but for their digests
            return f"the {name} has other numbers or functions"
        return f"{name} {was}, here {now}"

    return "; ".join(words(name) for name in {**there, **here} if there.get(name) != here.get(name))


def _digest(members: Members) -> str:
    digest = hashlib.sha256()
    for name in sorted(members):
        array = members[name]
        digest.update(repr((name, array.dtype.str, array.shape)).encode())
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()


def _members(sums: Mapping[str, Sums], variables: tuple[Variable, ...]) -> Members:
    """The sums as arrays: by method, of those sorted by name, and by statistic and variable."""
    found: Members = {}
    for place, name in enumerate(sorted(sums)):
        each = sums[name]
        found[f"{place}/runs"] = np.array([each.runs, each.unsettled])
        found[f"{place}/diverged"] = each.diverged
        found[f"{place}/failed"] = each.failed
        found[f"{place}/doubtful"] = each.doubtful
        for variable, (nees, run) in each.worst.items():
            found[f"{place}/worst/{variables.index(variable)}"] = np.array([nees, run])
        for (statistic, variable), tally in each.tallies.items():
            for field, value in tally._asdict().items():
                of = f"{place}/tallies/{statistic}/{variables.index(variable)}/{field}"
                found[of] = np.asarray(value)
    return found


def _of_members(
    part: str, members: Members, names: list[str], variables: tuple[Variable, ...]
) -> dict[str, Sums]:
    found = {}
    for place, name in enumerate(names):
        before = f"{part}{place}/"
        own = {k.removeprefix(before): v for k, v in members.items() if k.startswith(before)}
        tallies: dict[tuple[str, Variable], dict[str, Any]] = {}
        worst = {}
        for key, value in own.items():
            match key.split("/"):
                case ["tallies", statistic, k, field]:
                    tally = tallies.setdefault((statistic, variables[int(k)]), {})
                    tally[field] = value if value.ndim else value.item()
                case ["worst", k]:
                    worst[variables[int(k)]] = float(value[0]), int(value[1])
        runs, unsettled = (int(each) for each in own["runs"])
        found[name] = Sums(
            {key: Tally(**fields) for key, fields in tallies.items()},
            runs,
            own["diverged"],
            own["failed"],
            unsettled,
            worst,
            own["doubtful"],
        )
    return found
