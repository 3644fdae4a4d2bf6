"""A headless Chromium that looks at pages, where there is one."""

import json
import re
import shutil

import pytest

import pgm

WHY = "selenium, which drives the browser, is not installed"
OPTIONS = (
    "--headless=new",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--hide-scrollbars",
    "--window-size=1600,1000",
)


class Browser:
    """Chromium with a page, its clicks and the numbers that it shows."""

    def __init__(self, driver):
        self.driver = driver

    def open(self, page):
        self.driver.get("about:blank")
        self.driver.get_log("browser")
        self.driver.get_log("performance")
        self.driver.get(page.as_uri())
        self.wait("document.body.dataset.ready")

    def wait(self, condition):
        from selenium.webdriver.support.ui import WebDriverWait

        WebDriverWait(self.driver, 20, 0.02).until(
            lambda driver: driver.execute_script(f"return Boolean({condition})")
        )

    def run(self, script, *given):
        return self.driver.execute_script(script, *given)

    def all(self, selector):
        return self.driver.find_elements("css selector", selector)

    def one(self, selector):
        return self.driver.find_element("css selector", selector)

    def click(self, selector):
        self.one(selector).click()

    def press(self, *keys):
        from selenium.webdriver.common.action_chains import ActionChains

        ActionChains(self.driver).send_keys(*keys).perform()

    def click_at(self, selector, x, y):
        from selenium.webdriver.common.action_chains import ActionChains

        box = self.one(selector).rect
        dx, dy = round(x - box["width"] / 2), round(y - box["height"] / 2)
        ActionChains(self.driver).move_to_element_with_offset(
            self.one(selector), dx, dy
        ).click().perform()

    def slide(self, selector, value):
        self.run(
            "const s = document.querySelector(arguments[0]); s.value = arguments[1];"
            "s.dispatchEvent(new Event('input', {bubbles: true}))",
            selector,
            value,
        )

    def pick(self, selector, option):
        """Choose an option by its place."""
        from selenium.webdriver.support.ui import Select

        Select(self.one(selector)).select_by_index(option)

    @property
    def selected(self):
        return self.run("return document.body.dataset.selected")

    def text(self, selector):
        return self.run("return document.querySelector(arguments[0]).textContent", selector)

    def numbers(self, key, part):
        """The rows of a table of a factor: what is shown, and all digits."""
        rows = self.run(
            "return [...document.querySelectorAll(arguments[0])].map((row) =>"
            " [...row.querySelectorAll('td[data-value]')].map((td) =>"
            " [td.textContent, Number(td.dataset.value)]))",
            f'[data-factor="{key}"] [data-part="{part}"] tbody tr',
        )
        shown = [[as_number(text) for text, _ in row] for row in rows]
        return shown, [[value for _, value in row] for row in rows]

    def complaints(self):
        return [entry["message"] for entry in self.driver.get_log("browser")]

    def requests(self):
        """The addresses that were asked for."""
        found = []
        for entry in self.driver.get_log("performance"):
            message = json.loads(entry["message"])["message"]
            if message["method"] == "Network.requestWillBeSent":
                found.append(message["params"]["request"]["url"])
        return found


def as_number(text):
    """The number of a text: a true minus, and spaces that align it."""
    return float(re.sub(r"[\u2007\u2008]", "", text).replace("−", "-").replace("∞", "inf"))


@pytest.fixture(scope="session")
def browser(tmp_path_factory):
    webdriver = pytest.importorskip("selenium.webdriver", reason=WHY)
    from selenium.webdriver.chrome.service import Service

    chromium, driver = shutil.which("chromium"), shutil.which("chromedriver")
    if not (chromium and driver):
        pytest.skip("no chromium and chromedriver here: apt-get install chromium chromium-driver")
    options = webdriver.ChromeOptions()
    options.binary_location = chromium
    for option in (*OPTIONS, f"--user-data-dir={tmp_path_factory.mktemp('profile')}"):
        options.add_argument(option)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
    found = webdriver.Chrome(options=options, service=Service(driver))
    yield Browser(found)
    found.quit()


@pytest.fixture
def look(browser, tmp_path):
    """Open the page of a posterior; afterwards nothing may have been complained of or asked for."""

    def opened(posterior, **choice):
        browser.open(pgm.view(posterior, tmp_path / "page.html", **choice))
        return browser

    yield opened
    assert browser.complaints() == []
    # The browser's own pages may still be on their way.
    asked = {url.partition(":")[0] for url in browser.requests()}
    assert asked <= {"file", "data", "blob", "chrome", "about"}
