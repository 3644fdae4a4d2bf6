"""The folder of a study: `study.json`, which says what it is of, and a Parquet file a part.

A file is written beside and renamed once it is on the disk, so that a part is there whole or not at
all. Its metadata say which study and part it is of; its bytes depend on nothing else.
"""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from experiments.studies.code import differences, own_source, versions
from experiments.studies.errors import StudyError, require_packages
from experiments.studies.study import Part, Study
from experiments.studies.task import Columns
from pgm.io.sources import whole

MANIFEST, PARTS = "study.json", "parts"
_NAME = re.compile(r"(\d{4,})-(\d{6,})\.parquet")
# Names of the metadata of a part's file.
_STUDY, _PART = b"study", b"part"


@dataclass(frozen=True, eq=False)
class Folder:
    """The folder of a study.

    Attributes
    ----------
    path : Path
    study : Study
    figures : dict of str to str
        Types of NumPy, by figure.
    digest : str
        Of study and versions.
    """

    path: Path
    study: Study
    figures: dict[str, str]
    digest: str

    @classmethod
    def begin(cls, path: Path, study: Study) -> Folder:
        """Open a study's folder; a new one once each of its settings was tried.

        Raises
        ------
        StudyError
            If the folder holds something else, or a setting fails.
        """
        require_packages()
        manifest = path / MANIFEST
        if not manifest.exists():
            if path.exists() and not (path.is_dir() and all(map(_begun, path.iterdir()))):
                raise StudyError(
                    f"{path} holds something else, and no {MANIFEST}; name a new folder"
                )
            content = json.dumps(_described(study) | {"figures": study.trial()}, indent=2) + "\n"
            with _writing(path):
                path.mkdir(parents=True, exist_ok=True)
                with whole(manifest, durable=True) as beside:
                    beside.write_text(content, encoding="utf-8")
        folder = cls.open(path, study)
        with _writing(path):
            (path / PARTS).mkdir(exist_ok=True)
        return folder

    @classmethod
    def open(cls, path: Path, study: Study) -> Folder:
        """Open the folder of a study that was begun.

        Raises
        ------
        StudyError
            If there is none, or it is of something else.
        """
        require_packages()
        manifest = path / MANIFEST
        try:
            found = json.loads(manifest.read_text(encoding="utf-8"))
            figures, there = dict(found.pop("figures")), dict(found["versions"])
        except FileNotFoundError:
            raise StudyError(f"{path} has no {MANIFEST}: no study was begun there") from None
        except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
            raise StudyError(
                f"{manifest} cannot be read ({error}); name a new folder, or put the file back"
            ) from error
        due = json.loads(json.dumps(_described(study)))
        other = [name for name in due if name != "versions" and found.get(name) != due[name]]
        if other:
            differ = "; ".join(f"{n} {found.get(n)!r}, here {due[n]!r}" for n in other)
            raise StudyError(
                f"{path} holds another study: {differ}; name a new folder, or ask for that study"
            )
        if differ := differences(due["versions"], there):
            raise StudyError(
                f"{path} was begun with other versions: {differ}; go on with those, or begin "
                "anew in a new folder"
            )
        text = json.dumps(due | {"figures": figures}, sort_keys=True)
        return cls(path, study, figures, hashlib.sha256(text.encode()).hexdigest())

    def file(self, part: Part) -> Path:
        """The file of a part."""
        return self.path / PARTS / f"{part.setting:04}-{part.part:06}.parquet"

    def missing(self) -> list[Part]:
        """The parts that are not there, in their order; those that are have whole files.

        Raises
        ------
        StudyError
            If a file is damaged, or of something else.
        """
        found = set()
        for file in sorted((self.path / PARTS).iterdir()):
            if file.name.startswith("."):  # beside a part, of one that writes or was killed
                continue
            match = _NAME.fullmatch(file.name)
            part = Part(int(match[1]), int(match[2])) if match else None
            if part is None or file != self.file(part) or not self._holds(part):
                raise StudyError(f"{file} is no part of the study; move it elsewhere")
            with self._reading(part) as parquet:
                self._check(part, parquet)
            found.add(part)
        return [part for part in self.study.each() if part not in found]

    def keep(self, part: Part, columns: Columns) -> None:
        """Write the figures of a part; where they are there already, see that they are the same.

        Raises
        ------
        StudyError
            If they are others, or cannot be written.
        """
        import pyarrow as pa
        import pyarrow.parquet as pq

        kinds = {name: str(values.dtype) for name, values in columns.items()}
        called = self.study.called(*part)
        if kinds != self.figures:
            raise StudyError(f"{called} has the figures {kinds}; its study has {self.figures}")
        size = self.study.size(part.part)
        first = part.part * self.study.part_size
        setting = self.study.settings[part.setting]
        table = pa.table(
            {
                **{name: np.full(size, setting[name]) for name in self.study.over},
                "run": np.arange(first, first + size),
                **columns,
            }
        ).replace_schema_metadata({_STUDY: self.digest, _PART: f"{part.setting}-{part.part}"})
        target = self.file(part)
        with _writing(self.path):
            if target.exists():
                self._same(part, columns)
                return
            try:
                with whole(target, durable=True) as beside:
                    pq.write_table(table, beside, compression="zstd", write_page_checksum=True)
            except FileNotFoundError:  # tidied away by one that found the study complete
                if not target.exists():
                    raise

    def read(self, part: Part, names: Sequence[str]) -> Columns:
        """Figures of a part.

        Raises
        ------
        StudyError
            If its file is damaged, or of something else.
        """
        with self._reading(part) as parquet:
            self._check(part, parquet)
            table = parquet.read(columns=list(names))
            return {name: table.column(name).to_numpy() for name in names}

    def tidy(self) -> None:
        """Remove files that killed processes left beside, once all parts are there."""
        for file in (self.path / PARTS).glob(".*.parquet"):
            file.unlink(missing_ok=True)

    def _holds(self, part: Part) -> bool:
        study = self.study
        return part.setting < len(study.settings) and part.part < study.parts_of_setting

    def _same(self, part: Part, columns: Columns) -> None:
        there = self.read(part, list(columns))
        for name, values in columns.items():
            if values.tobytes() != there[name].tobytes():
                raise StudyError(
                    f"{self.study.called(*part)} was worked out twice, with other figures "
                    f"({name}): its function draws from something other than rng, or machines "
                    "differ; nothing was replaced"
                )

    def _check(self, part: Part, parquet: Any) -> None:
        meta = parquet.metadata
        own = meta.metadata or {}
        if own.get(_STUDY) != self.digest.encode() or own.get(_PART) != b"%d-%d" % part:
            raise StudyError(f"{self.file(part)} is of another study or part; move it elsewhere")
        if meta.num_rows != self.study.size(part.part):
            raise ValueError(f"{meta.num_rows} runs")

    @contextmanager
    def _reading(self, part: Part) -> Iterator[Any]:
        import pyarrow as pa
        import pyarrow.parquet as pq

        file = self.file(part)
        try:
            with pq.ParquetFile(file, page_checksum_verification=True) as parquet:
                yield parquet
        except StudyError:
            raise
        except (pa.ArrowException, OSError, ValueError, KeyError) as error:
            raise StudyError(
                f"{file} is damaged ({type(error).__name__}: {error}); delete it and run the study "
                "again, which works out this part alone"
            ) from error


def _begun(file: Path) -> bool:
    """Whether one that was killed left a file beside the manifest."""
    stem, dot, ending = MANIFEST.partition(".")
    return file.name.startswith(f".{stem}.") and file.name.endswith(dot + ending)


def _described(study: Study) -> dict[str, Any]:
    return {
        "study": study.name,
        "over": dict(study.over),
        "fixed": study.fixed,
        "runs": study.runs,
        "part_size": study.part_size,
        "seed": study.seed,
        "versions": versions(study.function.__module__) | own_source(study.function),
    }


@contextmanager
def _writing(path: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise StudyError(
            f"{path} cannot be written into ({error.strerror or error}); parts that are there are "
            "kept: run the study again once it can, or name another folder"
        ) from error
