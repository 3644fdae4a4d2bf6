"""Pictures of the guide's pages; ``python docs/page_pictures.py`` takes them, with Chromium."""

from __future__ import annotations

import contextlib
import os
import shutil
import sys
import tempfile
from io import BytesIO
from pathlib import Path
from typing import NamedTuple

import matplotlib
import matplotlib.pyplot as plt
from PIL import Image
from selenium import webdriver
from selenium.webdriver.chrome.service import Service
from selenium.webdriver.common.action_chains import ActionChains
from selenium.webdriver.common.keys import Keys
from selenium.webdriver.support.ui import WebDriverWait

sys.path[:0] = [str(Path(__file__).parent), str(Path(__file__).parent.parent)]

from building import programs


class Shot(NamedTuple):
    """A picture of the guide, the chapter whose program writes the page, and the keys pressed."""

    picture: str
    chapter: str
    page: str
    size: str = "1440,900"
    keys: tuple[str, ...] = ()


SHOTS = (
    Shot("viewer", "viewer", "run.html", keys=(Keys.PAGE_UP, Keys.RIGHT, Keys.RIGHT)),
    Shot("report", "trust", "report.html", "1140,860"),
)
# Pages that begin with one of the figures that they draw, and its place among these.
FIGURES = {
    "guide/robot_loop": -1,
    "tutorials/gps_gyro_odometry": 1,
    "tutorials/two_robots": -1,
    "tutorials/unknown_landmarks": -1,
    "tutorials/many_landmarks": -1,
}
OPTIONS = ("--headless=new", "--no-sandbox", "--disable-gpu", "--hide-scrollbars")


def taken(shot: Shot) -> bytes:
    """The page that a chapter's program writes, as Chromium shows it."""
    options = webdriver.ChromeOptions()
    options.binary_location = str(shutil.which("chromium"))
    for option in (*OPTIONS, f"--window-size={shot.size}"):
        options.add_argument(option)
    with tempfile.TemporaryDirectory() as place, contextlib.chdir(place):
        os.symlink(programs.DOCS, Path(place) / "docs")
        list(programs.run(programs.DOCS / "guide" / f"{shot.chapter}.md"))
        driver = webdriver.Chrome(options=options, service=Service(shutil.which("chromedriver")))
        try:
            driver.get(Path(shot.page).resolve().as_uri())
            WebDriverWait(driver, 20).until(
                lambda found: found.execute_script("return document.body.dataset.ready")
            )
            ActionChains(driver).send_keys(*shot.keys).pause(1).perform()
            return driver.get_screenshot_as_png()
        finally:
            driver.quit()


def drawn(name: str, place: int) -> bytes:
    """A figure that the programs of a page draw, by its place among them."""
    plt.close("all")
    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
        list(programs.run(programs.DOCS / f"{name}.md"))
    buffer = BytesIO()
    plt.figure(plt.get_fignums()[place]).savefig(buffer, dpi=90, bbox_inches="tight")
    return buffer.getvalue()


def save(name: str, picture: bytes) -> None:
    """Write a picture with few colours."""
    found = Image.open(BytesIO(picture)).convert("RGB")
    path = programs.DOCS / "images" / f"{name}.png"
    found.quantize(256, Image.Quantize.MEDIANCUT).save(path, optimize=True)


if __name__ == "__main__":
    matplotlib.use("Agg")
    for page, place in FIGURES.items():
        save(page.rpartition("/")[2], drawn(page, place))
    for each in SHOTS:
        save(each.picture, taken(each))
