"""Kernels on the disk, each in one file behind a checksum: a file that is not whole is made anew.

Numba finds the folder, beside the package or in a user's cache, and says what a kernel depends on.
Its own files would be unpickled, and their machine code run, whatever has become of them.
"""

from __future__ import annotations

import logging
import pickle
from contextlib import suppress
from functools import cache
from hashlib import sha256
from pathlib import Path
from secrets import token_hex
from typing import Any
from zlib import crc32

import numba
from numba.core.caching import FunctionCache, NullCache
from numba.core.serialize import dumps

_LOG = logging.getLogger("pgm")
_SEAL = sha256().digest_size


class Store(FunctionCache):  # type: ignore[misc]
    """The machine code of one kernel on the disk; reading and writing it never fail.

    Whatever is wrong with a file, or with the folder, the kernel is compiled as if there were none,
    and written again where that can be.
    """

    def __init__(self, function: Any, name: str) -> None:
        super().__init__(function)
        about = numba.__version__, self._impl.locator.get_source_stamp()
        self._cache_file = _Files(Path(self.cache_path), f"{function.__module__}.{name}", about)

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """The kernel for a signature; None where it is to be compiled, which is told of."""
        found = None
        with suppress(Exception):  # of many kinds, as the damage is
            found = super().load_overload(sig, target_context)
        if found is None:
            tell(f"once on this machine: it is kept in {self.cache_path}")
        return found

    def save_overload(self, sig: Any, data: Any) -> None:
        """Write the kernel, where the folder takes it."""
        with suppress(OSError):
            super().save_overload(sig, data)


class Unkept(NullCache):  # type: ignore[misc]
    """No folder can be written to: each process compiles its kernels, which is told of."""

    def load_overload(self, sig: Any, target_context: Any) -> None:
        """Nothing."""
        tell("in each process anew: no folder to keep it in can be written to (NUMBA_CACHE_DIR)")


class _Files:
    """The files of a kernel, one for each signature and processor: a seal, then a pickle.

    The seal is the SHA-256 of the pickle and of all that the machine code depends on: the versions
    of Numba and of the source, the signature, the processor, and what the kernel closes over.
    """

    def __init__(self, folder: Path, name: str, about: tuple[Any, ...]) -> None:
        self.folder, self.name, self.about = folder, name, about

    def load(self, key: tuple[Any, ...]) -> Any:
        """The contents of the file, None where there is none that is whole."""
        sealed = self.path(key).read_bytes()
        seal, data = sealed[:_SEAL], sealed[_SEAL:]
        return pickle.loads(data) if seal == self.seal(key, data) else None

    def save(self, key: tuple[Any, ...], contents: Any) -> None:
        """Write the file, which other processes find whole or not at all."""
        data, path = dumps(contents), self.path(key)
        beside = path.with_name(f"{path.name}.{token_hex(8)}")
        try:
            beside.write_bytes(self.seal(key, data) + data)
            beside.replace(path)
        except BaseException:
            beside.unlink(missing_ok=True)
            raise

    def path(self, key: tuple[Any, ...]) -> Path:
        """The path of the file. An older source's is the same, and is written over."""
        signature, processor, _ = key
        return self.folder / f"{self.name}.{crc32(repr((signature, processor)).encode()):08x}.nbc"

    def seal(self, key: tuple[Any, ...], data: bytes) -> bytes:
        """The checksum of a pickle, and of its dependences."""
        return sha256(repr((self.about, key)).encode() + data).digest()


@cache
def tell(where: str) -> None:
    """Log, once in a process, that the kernels are being compiled, which takes long.

    It is a record of the logger ``pgm``, at the level of warnings: a script that has set up no
    logging sees it as a line of its standard error, and no filter of warnings makes an error of it.
    """
    _LOG.warning(
        "compiling the sweeps to machine code, which takes some ten seconds to half a minute, %s; "
        "compiled=False does without",
        where,
    )
