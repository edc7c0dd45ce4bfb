"""Headless Chromium with access to this computer only, and the actions of a user."""

from __future__ import annotations

import json
import shutil
from base64 import b64encode
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from hashlib import sha256
from pathlib import Path
from typing import TypeVar
from urllib.parse import urlsplit

import pytest
from cryptography import x509
from cryptography.hazmat.primitives.serialization import Encoding, PublicFormat
from selenium.common.exceptions import StaleElementReferenceException, WebDriverException
from selenium.webdriver import Chrome, ChromeOptions
from selenium.webdriver.chrome.service import Service
from selenium.webdriver.common.by import By
from selenium.webdriver.remote.webelement import WebElement
from selenium.webdriver.support.wait import WebDriverWait

from lfield.authority.web_ca.web_keys import read_web_keys

T = TypeVar("T")
CHROMIUM, DRIVER = shutil.which("chromium"), shutil.which("chromedriver")
# : Seconds for anything that depends on the load of the machine.
TIMEOUT = 60.0

needs_browser = pytest.mark.skipif(
    not (CHROMIUM and DRIVER), reason="no browser: apt-get install chromium chromium-driver"
)

_OPTIONS = (
    *("--headless=new", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage", "--no-first-run"),
    # Requests of the browser itself, and an address without a listener for any other request of a page.
    *(
        "--disable-background-networking",
        "--disable-component-update",
        "--disable-sync",
        "--disable-domain-reliability",
    ),
    *("--proxy-server=127.0.0.1:9", "--proxy-bypass-list=127.0.0.1"),
    "--force-device-scale-factor=1",
)


def believing(keys: Path) -> list[str]:
    """Options that make a browser trust only the certificate of a page, by the folder of its keys."""
    info = x509.load_pem_x509_certificate(read_web_keys(keys).certificate).public_key()
    spki = info.public_bytes(Encoding.DER, PublicFormat.SubjectPublicKeyInfo)
    return [f"--ignore-certificate-errors-spki-list={b64encode(sha256(spki).digest()).decode()}"]


class Thing:
    """An element with a `data-testid`. It is looked up again for each action: the page may redraw it."""

    def __init__(self, browser: Browser, id: str) -> None:
        self._browser, self._id = browser, id

    def _do(self, deed: Callable[[WebElement], T]) -> T:
        return self._browser.evaluate(lambda: deed(self._browser.all(self._id)[0]))

    @property
    def text(self) -> str:
        return self._do(lambda found: found.text)

    def get_attribute(self, name: str) -> str | None:
        return self._do(lambda found: found.get_attribute(name))

    def is_enabled(self) -> bool:
        return self._do(lambda found: found.is_enabled())

    def is_displayed(self) -> bool:
        return self._do(lambda found: found.is_displayed())

    def click(self, within: str = "") -> None:
        """Click it, or an element within by a CSS selector."""
        self._do(lambda found: (found.find_element(By.CSS_SELECTOR, within) if within else found).click())

    def clear(self) -> None:
        self._do(lambda found: found.clear())

    def send_keys(self, *keys: str) -> None:
        self._do(lambda found: found.send_keys(*keys))

    def parts(self, css: str, told: Callable[[WebElement], T]) -> list[T]:
        """The results for all elements within by a CSS selector."""
        return self._do(lambda found: [told(part) for part in found.find_elements(By.CSS_SELECTOR, css)])


class Browser:
    """One window. Elements are found by their `data-testid`."""

    def __init__(self, *more: str) -> None:
        options = ChromeOptions()
        options.binary_location = CHROMIUM or ""
        for option in (*_OPTIONS, *more):
            options.add_argument(option)
        options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
        self.driver = Chrome(options=options, service=Service(DRIVER))
        self.driver.set_window_size(1440, 1000)

    def open(self, link: str) -> None:
        # The previous page is closed, and its requests and errors are dropped.
        self.driver.get("about:blank")
        _ = self.asked_hosts(), self.errors
        self.driver.get(link)
        self.wait(lambda: self.thing("state").text)

    def all(self, id: str) -> list[WebElement]:
        return self.driver.find_elements(By.CSS_SELECTOR, f'[data-testid="{id}"]')

    def thing(self, id: str) -> Thing:
        self.wait(lambda: self.all(id))
        return Thing(self, id)

    def confirm(self, order: str) -> None:
        """Press a button, and confirm the order."""
        self.thing(order).click()
        self.thing("yes").click()

    @contextmanager
    def phone(self, width: int, height: int) -> Iterator[None]:
        """Set the window size of a phone."""
        size = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": True}
        self.driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
        try:
            yield
        finally:
            self.driver.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})

    def evaluate(self, expression: Callable[[], T]) -> T:
        """The value of an expression, which is evaluated again if the page is redrawn."""
        found: list[T] = []
        self.wait(lambda: found.append(expression()) or True)
        return found[0]

    def text(self, id: str) -> str:
        return self.thing(id).text

    def wait(self, told: Callable[[], object]) -> None:
        """Until it is true; elements that the page redraws are looked up again."""
        ignored = (StaleElementReferenceException, IndexError)
        WebDriverWait(self.driver, TIMEOUT, 0.05, ignored).until(lambda _: told())

    def says(self, id: str, words: str) -> None:
        """Wait until the element contains these words."""
        try:
            self.wait(lambda: words in self.text(id))
        except WebDriverException:
            pytest.fail(f"{id} does not say {words!r} but {self.text(id)!r}")

    @property
    def errors(self) -> list[str]:
        """The errors on the page's console since the last call."""
        return [entry["message"] for entry in self.driver.get_log("browser") if entry["level"] == "SEVERE"]

    def asked_hosts(self) -> set[str]:
        """The hosts that pages have requested since the last call."""
        found = set()
        for entry in self.driver.get_log("performance"):
            message = json.loads(entry["message"])["message"]
            url = message["params"].get("request", {}).get("url") or message["params"].get("url", "")
            if message["method"] in ("Network.requestWillBeSent", "Network.webSocketCreated"):
                found.add(urlsplit(url).netloc)
        return found - {""}

    def close(self) -> None:
        self.driver.quit()
