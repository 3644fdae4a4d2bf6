"""The record of an experiment: a summary in numbers, figures, and a table."""

from __future__ import annotations

import json
import platform
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from importlib import metadata
from pathlib import Path
from tempfile import TemporaryFile
from typing import Annotated, Any, TypeVar

import typer
from matplotlib import rcParams
from matplotlib.figure import Figure
from rich.console import Console
from rich.markup import escape
from rich.progress import track
from rich.table import Table

from experiments.best import best_cells
from pgm.errors import PgmError
from pgm.io.sources import whole

Out = Annotated[Path | None, typer.Option(help="Folder for results; results/NAME without.")]
Seed = Annotated[int, typer.Option(min=0, help="Seed of everything that is drawn.")]

SUMMARY = "summary.json"
DPI = 150  # of figures as PNG
Item = TypeVar("Item")

_console = Console()
# A table as wide as a terminal would lose what does not fit.
_wide = Console(width=sys.maxsize)


class FolderError(OSError):
    """A folder for results cannot be made, or nothing can be written there."""


def refusal(error: BaseException) -> str:
    """An error in a line; empty where it is none that a user can do something about."""
    advice = "; ask for fewer runs or steps" if isinstance(error, MemoryError) else ""
    foreseen = isinstance(error, PgmError | OSError | MemoryError)
    return f"{type(error).__name__}: {error}{advice}".replace("\n", " ") if foreseen else ""


class Record:
    """The results of one run of an experiment, written below one folder.

    Parameters
    ----------
    name : str
        The experiment's.
    out : Path or None
        The folder; ``results/NAME`` without.
    settings : Any
        Everything that the run depends on, the seed among it.

    Raises
    ------
    FolderError
        If nothing can be written into the folder.
    """

    def __init__(self, name: str, out: Path | None, **settings: Any) -> None:
        self.name = name
        self.folder = folder(out or Path("results") / name)
        self.settings = settings
        self._page: list[dict[str, Any]] = []

    def figure(self, figure: Figure, name: str, caption: str) -> None:
        """Write a figure as PNG and PDF; the caption stands below it in the report.

        A caption says what is drawn, in which units, of which confidence ellipses and bands are,
        and what there is to see.
        """
        # One layout is enough for both, and is slow to find.
        figure.draw_without_rendering()
        figure.set_layout_engine("none")
        drawn = figure.get_tightbbox().padded(rcParams["savefig.pad_inches"])
        for ending in ("png", "pdf"):
            with self.file(f"{name}.{ending}") as path:
                figure.savefig(path, dpi=DPI, bbox_inches=drawn)
        self.picture(f"{name}.png", caption)

    @contextmanager
    def file(self, name: str) -> Iterator[Path]:
        """Write a file into the folder, whole or not at all.

        Before the first of them the summary of an earlier run goes, since it is of other files.

        Raises
        ------
        FolderError
            If it cannot be written.
        """
        with writing(self.folder), whole(self.folder / name) as path:
            yield path
            if name != SUMMARY:
                (self.folder / SUMMARY).unlink(missing_ok=True)

    def picture(self, file: str, caption: str) -> None:
        """Show a file that was written into the folder, an animation for one, in the report."""
        self._page.append({"figure": file, "caption": caption})

    def table(
        self,
        title: str,
        columns: Sequence[str],
        rows: Iterable[Sequence[object]],
        *,
        about: str = "",
        best: Mapping[str, float] | None = None,
        within: Sequence[str] = (),
        folded: bool = False,
    ) -> None:
        """Print a table, numbers to four digits, and keep it for the report.

        Parameters
        ----------
        title : str
        columns : sequence of str
            Their heads, with units.
        rows : iterable of sequences
        about : str
            The columns in words, so that the table can be read by itself; printed below it.
        best : mapping of str to float, optional
            The value that a column's numbers are best nearest to: -inf where the lowest is best,
            inf where the highest is. The report marks the best.
        within : sequence of str
            Columns whose cells divide the rows into groups, each of which has its own best.
        folded : bool
            Whether the report folds the table, a supporting one, under its title.
        """
        cells = [[_shown(value) for value in row] for row in rows]
        self._page.append(
            {
                "table": title,
                "columns": list(columns),
                "rows": cells,
                "about": about,
                "best": best_cells(columns, cells, best or {}, within),
                "within": [name or "name" for name in within],
                "folded": folded,
            }
        )
        table(title, columns, cells)
        if about:
            note(about, style="dim")

    def note(self, text: str) -> None:
        """Print a line, word for word, and keep it for the report."""
        self._page.append({"note": text})
        note(text)

    def summary(self, **values: Any) -> Path:
        """Write summary.json: settings, versions, all results, and the page for the report."""
        content = {
            "experiment": self.name,
            "settings": self.settings,
            "versions": versions(),
            **values,
            "page": self._page,
        }
        text = json.dumps(content, indent=2, default=_plain) + "\n"
        with self.file(SUMMARY) as path:
            path.write_text(text, encoding="utf-8")
        note(f"{self.folder}/", style="dim")
        return self.folder / SUMMARY


def folder(path: Path) -> Path:
    """Make a folder for results, and see that files can be written there.

    Raises
    ------
    FolderError
        If not.
    """
    with writing(path):
        path.mkdir(parents=True, exist_ok=True)
        with TemporaryFile(dir=path):
            return path


@contextmanager
def writing(path: Path) -> Iterator[None]:
    """Tell of a folder that files cannot be written into.

    Raises
    ------
    FolderError
    """
    try:
        yield
    except OSError as error:
        raise FolderError(
            f"results cannot be written into {path} ({error.strerror or error}); "
            "name another folder with --out"
        ) from error


def versions() -> dict[str, str]:
    """Versions of Python and of the packages that results depend on."""
    packages = ("sepset", "numpy", "scipy", "networkx", "matplotlib")
    return {"python": platform.python_version()} | {p: metadata.version(p) for p in packages}


def table(title: str, columns: Sequence[str], rows: Iterable[Sequence[object]]) -> None:
    """Print a table; numbers to four digits."""
    shown = Table(title=escape(title), title_justify="left")
    for k, column in enumerate(columns):
        shown.add_column(escape(column), justify="left" if k == 0 else "right", no_wrap=True)
    for row in rows:
        shown.add_row(*(escape(_shown(value)) for value in row))
    _wide.print(shown)


def note(text: str, style: str = "") -> None:
    """Print a line, word for word."""
    _console.print(text, style=style, markup=False, highlight=False, soft_wrap=True)


def progress(items: Sequence[Item], what: str) -> Iterator[Item]:
    """Go through items with a progress bar on a terminal, quietly elsewhere."""
    yield from track(
        items, what, console=_console, transient=True, disable=not _console.is_terminal
    )


def _shown(value: object) -> str:
    """A number to four digits, anything else as it prints."""
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def _plain(value: Any) -> Any:
    """NumPy's numbers and arrays as JSON's."""
    if hasattr(value, "tolist"):
        return value.tolist()
    return str(value)
