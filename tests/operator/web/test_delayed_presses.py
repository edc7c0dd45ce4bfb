"""Button presses while the server was stopped, from a browser that has cancelled them since."""

from __future__ import annotations

import http.client
import json
import os
import re
import signal
import time
from contextlib import closing
from urllib.parse import urlsplit

import pytest

from lfield.clock import SystemClock
from lfield.operator.web.button_orders import MAX_DELAY

pytestmark = pytest.mark.process


class Client:
    """A browser's requests at a page: each press on a separate connection."""

    def __init__(self, page) -> None:
        link = urlsplit(page.link)
        self.address, self.cookie = link.netloc, ""
        with closing(self.asks("GET", f"/?{link.query}")) as response:
            self.cookie = response.getresponse().headers["set-cookie"].partition(";")[0]
        page.line()

    def asks(self, method: str, path: str, **says: object) -> http.client.HTTPConnection:
        connection = http.client.HTTPConnection(self.address, timeout=60.0)
        headers = {"Cookie": self.cookie, "Origin": f"http://{self.address}"}
        connection.request(method, path, json.dumps(says) if says else None, headers)
        return connection

    def presses(self, action: str, pressed: float | None) -> tuple[int, str]:
        with closing(self.asks("POST", "/order", action=action, pressed=pressed)) as response:
            answer = response.getresponse()
            return answer.status, answer.read().decode()

    @property
    def look(self) -> dict[str, object]:
        with closing(self.asks("GET", "/snapshot")) as response:
            return json.loads(response.getresponse().read())


@pytest.fixture
def page(page_of):
    return page_of()


@pytest.mark.few(0)
def test_a_press_is_dated_by_the_clock_of_the_snapshots(page) -> None:
    client = Client(page)
    at = client.look["at"]
    assert abs(at - SystemClock().monotonic()) < 60.0
    assert client.presses("resume", at - 2 * MAX_DELAY)[0] == 409
    status, refusal = client.presses("lift", at - 31.0)
    assert status == 409
    assert "after the press, which is too late; check the state, and press it again" in refusal
    assert client.presses("lift", None)[0] == 409
    assert client.presses("pause", at - 31.0)[0] == 200
    assert page.line() == "pressed pause"
    assert client.presses("stop", at - 31.0)[0] == 200
    assert page.line() == "pressed stop"
    while not (reason := client.look["team"]["stop"]["reason"]):
        pass
    assert float(re.search(r"it arrived ([\d.]+)", reason)[1]) >= 31.0
    assert client.presses("lift", client.look["at"])[0] == 200
    assert page.line() == "pressed lift"


def test_a_stop_of_a_browser_that_gave_up_is_executed_and_a_lift_is_not(page) -> None:
    client = Client(page)
    at = client.look["at"]
    os.kill(page.process.pid, signal.SIGSTOP)
    try:
        for action in ("lift", "stop", "resume"):
            client.asks("POST", "/order", action=action, pressed=at - MAX_DELAY).close()
        # All requests have arrived: this computer is the other end.
        time.sleep(0.1)
    finally:
        os.kill(page.process.pid, signal.SIGCONT)
    assert page.line() == "pressed stop"
    assert client.presses("pause", None)[0] == 200
    assert page.line() == "pressed pause", "nothing else was done meanwhile"
