"""The errors of studies."""

from __future__ import annotations

from importlib.util import find_spec

from pgm.errors import PgmError

PACKAGES = ("pyarrow", "distributed")


class StudyError(PgmError, ValueError):
    """A study that cannot be begun, or cannot go on; finished parts are kept."""


def require_packages() -> None:
    """Refuse where a package of studies is missing.

    Raises
    ------
    StudyError
    """
    missing = [name for name in PACKAGES if find_spec(name) is None]
    if missing:
        raise StudyError(
            f"studies need {' and '.join(missing)}, not installed here: pip install '.[studies]'"
        )
