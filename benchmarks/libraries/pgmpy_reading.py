"""pgmpy on files of networks."""

from __future__ import annotations

import gzip
from importlib import import_module
from pathlib import Path
from typing import Any

from benchmarks.timing import Contender


def reading(path: Path) -> Contender:
    """From a gzipped BIF file, which it is given as text, to a network."""
    reader = import_module("pgmpy.readwrite").BIFReader

    def call() -> Any:
        text = gzip.decompress(path.read_bytes()).decode()
        return reader(string=text).get_model()

    return Contender(call, 1)
