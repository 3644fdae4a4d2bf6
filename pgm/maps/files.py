"""Files of ROS's map_server: a YAML file of keys, and an image of grey values."""

from __future__ import annotations

import reprlib
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import numpy.typing as npt

from pgm.boundary import is_number
from pgm.errors import FileError
from pgm.kernels.arrays import Array

if TYPE_CHECKING:
    from PIL.Image import Image

_KEYS = ("image", "resolution", "origin", "negate", "occupied_thresh", "free_thresh")
_MODES = ("trinary", "scale", "raw")
_SUFFIXES = (".pgm", ".png")
# Thresholds of map_server, and grey values of its map_saver: the last one has p = .1961, which is
# not below the first threshold.
FREE, OCCUPIED = 0.196, 0.65
FREE_GREY, OCCUPIED_GREY, UNKNOWN_GREY = 254, 0, 205


class MapFile(NamedTuple):
    """The values of a map's files, not yet checked as a map.

    occupied: (rows, columns), row 0 at the lowest y.
    """

    occupied: Array
    resolution: float
    origin: Any
    free: float
    above: float


def read(path: str | PathLike[str]) -> MapFile:
    """The values of a YAML file and its image."""
    path = Path(path)
    keys = _keys(path)
    mode = keys.get("mode", "trinary")
    if mode not in _MODES:
        raise _wrong(path, "mode", mode, f"one of {', '.join(_MODES)}")
    low, high = _number(path, keys, "free_thresh"), _number(path, keys, "occupied_thresh")
    if not 0.0 <= low <= high <= 1.0:
        raise FileError(
            f"{path}: free_thresh is {low} and occupied_thresh {high}; 0 ≤ free_thresh ≤ "
            "occupied_thresh ≤ 1 was due",
            path=str(path),
        )
    if keys["negate"] not in (0, 1):
        raise _wrong(path, "negate", keys["negate"], "0 or 1")
    if not isinstance(keys["image"], str) or not keys["image"]:
        raise _wrong(path, "image", keys["image"], "the path of an image")
    grey, opaque = _grey(path, path.parent / keys["image"])
    occupied = _occupied(grey, opaque, mode, bool(keys["negate"]), low, high)
    return MapFile(occupied[::-1], _number(path, keys, "resolution"), keys["origin"], low, high)


def write(
    path: str | PathLike[str],
    grey: npt.NDArray[np.uint8],
    resolution: float,
    origin: Array,
    image: str,
) -> None:
    """Write grey values, row 0 at the lowest y, as a YAML file and an image beside it."""
    import yaml
    from PIL import Image

    path = Path(path)
    if image not in _SUFFIXES:
        raise FileError(f"image is {' or '.join(_SUFFIXES)}, not {image!r}", path=str(path))
    picture = path.with_suffix(image)
    if picture == path:
        raise FileError(f"{path} is to be the YAML file; give it another suffix", path=str(path))
    keys = {
        "image": picture.name,
        "mode": "trinary",
        "resolution": resolution,
        "origin": origin.tolist(),
        "negate": 0,
        "occupied_thresh": OCCUPIED,
        "free_thresh": FREE,
    }
    try:
        Image.fromarray(np.ascontiguousarray(grey[::-1])).save(picture)
        path.write_text(yaml.safe_dump(keys, sort_keys=False), encoding="utf-8")
    except OSError as error:
        why = error.strerror or error
        raise FileError(f"{path}: cannot be written: {why}", path=str(path)) from error


def _keys(path: Path) -> dict[str, Any]:
    import yaml

    try:
        found = yaml.safe_load(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise FileError(f"{path}: cannot be read: {error.strerror}", path=str(path)) from error
    except UnicodeDecodeError as error:
        raise FileError(
            f"{path}: is no text, but maybe the image itself", path=str(path)
        ) from error
    except (ValueError, RecursionError) as error:  # of dates and numbers that are none, or brackets
        raise FileError(f"{path}: no YAML of a map: {error}", path=str(path)) from error
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        line = None if mark is None else mark.line + 1
        where = "" if line is None else f", line {line}"
        problem = getattr(error, "problem", None) or error
        raise FileError(f"{path}{where}: no YAML: {problem}", path=str(path), line=line) from error
    if not isinstance(found, dict):
        raise FileError(f"{path}: has no keys; {', '.join(_KEYS)} were due", path=str(path))
    missing = [key for key in _KEYS if key not in found]
    if missing:
        raise FileError(f"{path}: has no {', '.join(missing)}; add what is due", path=str(path))
    return found


def _number(path: Path, keys: dict[str, Any], key: str) -> float:
    if not is_number(keys[key]):
        raise _wrong(path, key, keys[key], "a number")
    return float(keys[key])


def _wrong(path: Path, key: str, found: Any, due: str) -> FileError:
    # Shortened, as a few lines of YAML may stand for more than fits memory.
    return FileError(f"{path}: {key} is {reprlib.repr(found)}; {due} was due", path=str(path))


def _grey(owner: Path, path: Path) -> tuple[npt.NDArray[np.uint8], npt.NDArray[np.bool_]]:
    """Grey values, and which pixels are not transparent at all, first row at the top."""
    from PIL import Image

    try:
        with Image.open(path) as image:
            image.verify()  # against the checksums of a PNG, which loading does not look at
        with Image.open(path) as image:
            image.load()
            wide = image.mode in ("I", "F") or image.mode.startswith("I;")
            channels = None if wide else _channels(image)
    except Exception as error:
        # Of a missing file, one that is no image, one too large, and of many kinds, as damage is.
        why = getattr(error, "strerror", None) or f"it is no image, or a broken one ({error})"
        raise FileError(f"{owner}: image {path} cannot be read: {why}", path=str(owner)) from error
    if channels is None:
        raise FileError(
            f"{owner}: image {path} has more than eight bits a pixel; convert it to 8-bit grey",
            path=str(owner),
        )
    grey, opaque = channels[..., 0], channels[..., -1] == 255
    if (channels[..., :-1] != grey[..., None]).any():
        raise FileError(f"{owner}: image {path} is in colour; convert it to grey", path=str(owner))
    return grey, opaque


def _channels(image: Image) -> npt.NDArray[np.uint8]:
    return np.asarray(image.convert("LA" if image.mode in ("1", "L", "LA") else "RGBA"))


def _occupied(
    grey: npt.NDArray[np.uint8],
    opaque: npt.NDArray[np.bool_],
    mode: str,
    negate: bool,
    low: float,
    high: float,
) -> Array:
    value = grey.astype(np.float64)
    if mode == "raw":
        return np.where(value <= 100.0, value / 100.0, np.nan)
    chance = value / 255.0 if negate else (255.0 - value) / 255.0
    if mode == "trinary":
        between = np.full(chance.shape, np.nan)
    else:
        between = (chance - low) / (high - low) if high > low else np.full(chance.shape, 0.5)
    found = np.where(chance > high, 1.0, np.where(chance < low, 0.0, between))
    return np.where(opaque, found, np.nan) if mode == "scale" else found
