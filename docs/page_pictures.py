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


def save(shot: Shot) -> None:
    """Write a picture with few colours."""
    picture = Image.open(BytesIO(taken(shot))).convert("RGB")
    path = programs.DOCS / "images" / f"{shot.picture}.png"
    picture.quantize(256, Image.Quantize.MEDIANCUT).save(path, optimize=True)


def last_frame() -> None:
    """Copy the last picture that the program of a robot's loop draws."""
    with tempfile.TemporaryDirectory() as place, contextlib.chdir(place):
        list(programs.run(programs.DOCS / "guide" / "robot_loop.md"))
        frame = max(Path("frames").glob("*.png"))
        Image.open(frame).convert("RGB").save(programs.DOCS / "images" / "robot_loop.png")


if __name__ == "__main__":
    matplotlib.use("Agg")
    last_frame()
    for each in SHOTS:
        save(each)
