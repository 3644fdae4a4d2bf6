"""A study: a grid of settings, and a number of runs of each, cut into parts."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from functools import cached_property
from numbers import Integral
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from experiments.studies.errors import StudyError
from experiments.studies.settings import Setting, Value, declared, gridded
from experiments.studies.task import Columns, Task
from pgm.errors import PgmError
from pgm.progress import Progress, counted, reporting

if TYPE_CHECKING:
    from experiments.studies.table import Table

# Runs of a part: enough for work to outweigh calls, few enough for arrays to stay in the cache.
PART_SIZE = 2000
# Runs of the trial that each setting has before work starts.
TRIED = 2


class Part(NamedTuple):
    """A part by its number, and that of its setting."""

    setting: int
    part: int


@dataclass(frozen=True, eq=False)
class Study:
    """A grid of settings, and a number of runs of each, cut into parts.

    Part p of setting s draws from ``SeedSequence(seed, spawn_key=(s, p))``: its figures depend on
    neither workers nor their order, nor on how often the study was interrupted.

    Parameters
    ----------
    function : callable
        ``function(runs, rng, *, setting=default, ...)`` returns figures by name, an array (runs,)
        each; NaN where a run has none. Runs must be independent. It stands in a module that
        workers can import too.
    over : mapping of str to sequence
        Values by setting; the study has all of their combinations, the last setting's values
        changing fastest. Settings that are not named have their defaults.
    runs : int
        Of each combination.
    seed : int
    part_size : int
        Runs of a part; the last part has what is left.

    Raises
    ------
    StudyError
        If one of them is of a wrong kind, or a setting is not known.

    Examples
    --------
    >>> from experiments import nonlinear_measurement
    >>> study = Study(nonlinear_measurement.sweep, {"rule": ["Taylor", "Cubature"]}, runs=5000)
    >>> study.parts, study.settings[1]["rule"]
    (6, 'Cubature')
    """

    function: Callable[..., Mapping[str, Any]]
    over: Mapping[str, Sequence[Any]] = field(default_factory=dict)
    runs: int = field(kw_only=True)
    seed: int = field(default=0, kw_only=True)
    part_size: int = field(default=PART_SIZE, kw_only=True)

    def __post_init__(self) -> None:
        for name, least in (("runs", 1), ("part_size", 1), ("seed", 0)):
            value = getattr(self, name)
            if not isinstance(value, Integral) or isinstance(value, bool) or value < least:
                raise StudyError(f"{name}= is a whole number, {least} or more; found {value!r}")
            object.__setattr__(self, name, int(value))
        if not isinstance(self.over, Mapping):
            raise StudyError(f"over= is a mapping of settings to values; found {self.over!r}")
        known = self.known  # refuses functions of another form
        object.__setattr__(self, "over", gridded(self.name, known, self.over))

    @property
    def known(self) -> dict[str, Setting]:
        """All settings of the function."""
        return declared(self.function)

    @property
    def name(self) -> str:
        """The function's module and name."""
        return f"{self.function.__module__}.{self.function.__qualname__}"

    @property
    def fixed(self) -> dict[str, Value]:
        """The settings that the grid leaves at their defaults."""
        return {
            each.name: each.default for each in self.known.values() if each.name not in self.over
        }

    @cached_property
    def settings(self) -> tuple[dict[str, Value], ...]:
        """The combinations, each with all settings."""
        fixed = self.fixed
        return tuple(
            dict(zip(self.over, values, strict=True)) | fixed
            for values in itertools.product(*self.over.values())
        )

    @property
    def parts(self) -> int:
        """Parts in all."""
        return len(self.settings) * self.parts_of_setting

    @property
    def parts_of_setting(self) -> int:
        """Parts of each setting."""
        return -(-self.runs // self.part_size)

    def each(self) -> Iterator[Part]:
        """All parts, in their order."""
        for setting in range(len(self.settings)):
            for part in range(self.parts_of_setting):
                yield Part(setting, part)

    def size(self, part: int) -> int:
        """Runs of a part."""
        return min(self.part_size, self.runs - part * self.part_size)

    def part(self, setting: int, part: int) -> Columns:
        """The figures of a part, worked out here.

        Raises
        ------
        StudyError
            If figures are not as they should be.
        """
        return self.task(Part(setting, part)).figures()

    def task(self, part: Part) -> Task:
        """The work of a part."""
        return self._task(self.size(part.part), part)

    def _task(self, runs: int, key: tuple[int, ...]) -> Task:
        return Task(
            self.function, self.settings[key[0]], runs, self.seed, tuple(key), self.called(*key)
        )

    def trial(self) -> dict[str, str]:
        """Try two runs of each setting, and tell the figures that they have, by name and type.

        Raises
        ------
        StudyError
            If a setting fails, or has other figures than the first.
        """
        found: dict[str, str] = {}
        for k, setting in enumerate(self.settings):
            try:
                columns = self._task(min(TRIED, self.runs), (k,)).figures()
            except Exception as error:
                if isinstance(error, StudyError) or not isinstance(error, PgmError):
                    raise
                raise StudyError(f"{self.called(k)} fails: {error}") from error
            kinds = {name: str(values.dtype) for name, values in columns.items()}
            if found and kinds != found:
                raise StudyError(
                    f"{self.called(k)} has the figures {kinds}, and {self.called(0)} {found}; all "
                    "settings have the same"
                )
            found = kinds
            clash = sorted({"run", *setting} & set(kinds))
            if clash:
                raise StudyError(f"{self.name}: the figure {clash[0]} has the name of a column")
        return found

    def called(self, setting: int, part: int | None = None) -> str:
        """A setting, or a part of it, in words."""
        chosen = self.settings[setting]
        said = [f"{name}={chosen[name]}" for name in self.over or chosen]
        if part is not None:
            said.append(f"part {part} of {self.parts_of_setting}")
        return f"{self.name} ({', '.join(said)})"

    def run(
        self,
        folder: str | Path,
        *,
        scheduler: Any = None,
        workers: int = 2,
        progress: Progress = True,
    ) -> int:
        """Work out the parts that a folder lacks.

        It may be killed at any time, and called again; several calls may share a folder.

        Parameters
        ----------
        folder : str or Path
        scheduler : str or distributed.Client, optional
            The address of a Dask scheduler, whose workers import what the function needs, or a
            client of one; a cluster on this machine without.
        workers : int
            Processes of that cluster on this machine.
        progress : bool or callable
            A bar on terminals, with an estimate of the rest; False for none, or a function
            that is called with the numbers of parts done and in all.

        Returns
        -------
        int
            The parts that were missing.

        Raises
        ------
        StudyError
            If the folder holds something else, something there is damaged, or a part fails.
        """
        from experiments.studies.carrier import carried
        from experiments.studies.folder import Folder

        place = Folder.begin(Path(folder), self)
        missing = place.missing()
        if missing:
            results = carried(self, place, missing, scheduler, workers)
            with reporting(progress), closing(results):
                for _ in counted(results, self.name, len(missing)):
                    pass
        place.tidy()
        return len(missing)

    def table(self, folder: str | Path) -> Table:
        """Means, standard errors and quantiles of the parts that a folder has.

        Raises
        ------
        StudyError
            If the folder is of something else, or something there is damaged.
        """
        from experiments.studies.folder import Folder
        from experiments.studies.table import table

        return table(self, Folder.open(Path(folder), self))
