"""Files that are written whole or not at all."""

from __future__ import annotations

import os
import secrets
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def whole(path: str | os.PathLike[str], *, durable: bool = False) -> Iterator[Path]:
    """A path to write to, whose file takes the place of another once it is complete.

    It stands in the same folder and ends as the other does. Where writing fails, or is killed, the
    other file is as it was. What is no ordinary file, like a pipe or a device, is written directly.
    A ``durable`` file has reached the disk before it takes the other's place.

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
    # Machines that share a folder may have processes of one number.
    own = f"{os.getpid()}-{secrets.token_hex(4)}"
    beside = target.with_name(f".{target.stem}.{own}{target.suffix}")
    try:
        yield beside
        if target.exists():
            beside.chmod(target.stat().st_mode)
        if durable:
            _to_disk(beside)
        os.replace(beside, target)
        if durable and os.name == "posix":  # elsewhere folders cannot be opened
            _to_disk(target.parent)
    except BaseException:
        beside.unlink(missing_ok=True)
        raise


def _to_disk(path: Path) -> None:
    file = os.open(path, os.O_RDONLY if path.is_dir() else os.O_RDWR)
    try:
        os.fsync(file)
    finally:
        os.close(file)
