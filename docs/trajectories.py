"""The first picture of the README: ``python docs/trajectories.py`` draws it anew.

It is the picture of a drive of the experiment ``localisation``, with its settings.
"""

from __future__ import annotations

import inspect
import sys
from io import BytesIO
from pathlib import Path

from matplotlib.figure import Figure
from PIL import Image

ROOT = Path(__file__).parent.parent
PICTURE = ROOT / "docs" / "images" / "trajectories.png"
sys.path.insert(0, str(ROOT))  # the experiments belong to the checkout

from experiments import localisation


def draw() -> Figure:
    """The worst of the drives that the experiment simulates."""
    settings = inspect.signature(localisation.run).parameters
    seed, runs, steps = (settings[name].default for name in ("seed", "runs", "steps"))
    return localisation.worst_drive(*localisation.simulate(seed, runs, steps))


def save(path: Path = PICTURE) -> None:
    """Write the picture, twice as many dots as it is wide in the README, with few colours."""
    drawn = BytesIO()
    draw().savefig(drawn, dpi=200)
    Image.open(drawn).convert("RGB").quantize(64).save(path, optimize=True)


if __name__ == "__main__":
    save()
