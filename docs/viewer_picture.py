"""The viewer's picture on its page; ``python docs/viewer_picture.py`` takes it, with Chromium."""

from __future__ import annotations

import contextlib
import os
import shutil
import sys
import tempfile
from io import BytesIO
from pathlib import Path

import matplotlib
from PIL import Image
from selenium import webdriver
from selenium.webdriver.chrome.service import Service
from selenium.webdriver.common.action_chains import ActionChains
from selenium.webdriver.common.keys import Keys
from selenium.webdriver.support.ui import WebDriverWait

sys.path[:0] = [str(Path(__file__).parent), str(Path(__file__).parent.parent)]

from building import programs

PICTURE = programs.DOCS / "images" / "viewer.png"


def taken() -> bytes:
    """The page that the guide's program writes, some steps on, as Chromium shows it."""
    options = webdriver.ChromeOptions()
    options.binary_location = str(shutil.which("chromium"))
    for option in ("--headless=new", "--no-sandbox", "--disable-gpu", "--window-size=1440,900"):
        options.add_argument(option)
    with tempfile.TemporaryDirectory() as place, contextlib.chdir(place):
        os.symlink(programs.DOCS, Path(place) / "docs")
        list(programs.run(programs.DOCS / "guide" / "viewer.md"))
        driver = webdriver.Chrome(options=options, service=Service(shutil.which("chromedriver")))
        try:
            driver.get(Path("run.html").resolve().as_uri())
            WebDriverWait(driver, 20).until(
                lambda found: found.execute_script("return document.body.dataset.ready")
            )
            ActionChains(driver).send_keys(Keys.PAGE_UP, Keys.RIGHT, Keys.RIGHT).pause(1).perform()
            return driver.get_screenshot_as_png()
        finally:
            driver.quit()


def save(path: Path = PICTURE) -> None:
    """Write the picture with few colours."""
    picture = Image.open(BytesIO(taken())).convert("RGB")
    picture.quantize(128, Image.Quantize.MAXCOVERAGE).save(path, optimize=True)


if __name__ == "__main__":
    matplotlib.use("Agg")
    save()
