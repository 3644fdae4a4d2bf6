"""Files that are written whole or not at all."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def whole(path: str | os.PathLike[str]) -> Iterator[Path]:
    """A path to write to, whose file takes the place of another once it is complete.

    It stands in the same folder and ends as the other does. Where writing fails, or is killed, the
    other file is as it was. What is no ordinary file, like a pipe or a device, is written directly.

    Examples
    --------
    >>> with whole("summary.json") as path:  # doctest: +SKIP
    ...     path.write_text("{}")
    """
    # Of a link its target is replaced.
    target = Path(os.path.realpath(path))
    if target.exists() and not target.is_file():
        yield target
        return
    beside = target.with_name(f".{target.stem}.{os.getpid()}{target.suffix}")
    try:
        yield beside
        if target.exists():
            beside.chmod(target.stat().st_mode)
        os.replace(beside, target)
    except BaseException:
        beside.unlink(missing_ok=True)
        raise
