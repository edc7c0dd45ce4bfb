"""`lfield watch --replay`: the page of recordings, its requests, and its refusals."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import urllib.error
import urllib.request
from collections.abc import Callable, Iterator
from http.cookiejar import CookieJar
from pathlib import Path

import pytest
from real_browser import Browser, needs_browser

pytestmark = pytest.mark.process

#: Requests until a move is executed, at most; each takes about a millisecond.
MOST_REQUESTS = 20_000


class ReplayPage:
    """A page that is served by a process of its own, and a client that has opened its link."""

    def __init__(self, *paths: Path) -> None:
        command = [sys.executable, "-m", "lfield", "watch", "--replay", *map(str, paths)]
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        assert self.process.stdout is not None
        lines = iter(self.process.stdout.readline, "")
        self.link = next(line for line in lines if line.startswith("open this link: ")).split()[-1]
        #: The number of moves that were requested.
        self.given = 0
        self.address = self.link.partition("/?")[0]
        self.opener = urllib.request.build_opener(urllib.request.HTTPCookieProcessor(CookieJar()))

    def open(self) -> str:
        with self.opener.open(self.link) as answer:
            return answer.read().decode()

    def look(self) -> dict:
        with self.opener.open(f"{self.address}/snapshot") as answer:
            return json.load(answer)

    def post(self, path: str, body: object) -> int:
        """The status of a POST."""
        headers = {"Content-Type": "application/json", "Origin": self.address}
        request = urllib.request.Request(f"{self.address}/{path}", json.dumps(body).encode(), headers)
        try:
            with self.opener.open(request) as answer:
                return answer.status
        except urllib.error.HTTPError as error:
            return error.code

    def moved(self, body: dict) -> dict:
        """The snapshot after a move."""
        assert self.post("replay", body) == 200
        self.given += 1
        for _ in range(MOST_REQUESTS):
            found = self.look()
            if found["replay"]["executed"] == self.given and found["replay"]["progress"] == 1.0:
                return found
        raise AssertionError("the move was not executed")

    def close(self) -> int:
        self.process.send_signal(signal.SIGINT)
        _, errors = self.process.communicate(timeout=60)
        assert "Traceback" not in errors
        return self.process.returncode


@pytest.fixture
def page_of() -> Iterator[Callable[..., ReplayPage]]:
    pages: list[ReplayPage] = []

    def start(*paths: Path) -> ReplayPage:
        pages.append(ReplayPage(*paths))
        return pages[-1]

    yield start
    for page in pages:
        if page.process.poll() is None:
            page.process.terminate()
            page.process.communicate(timeout=60)


def test_a_recording_is_moved_and_no_order_can_be_sent(records, page_of):
    page = page_of(records)
    assert page.post("replay", {"go": "hop"}) == 403
    assert '"recorded":true' in page.open().replace(" ", "")
    found = page.moved({"go": "time", "seconds": 2.5})
    (one, _) = found["team"]["vehicles"]
    assert (one["agent"], one["position"][0]) == ("one", 4.0)
    assert found["team"]["denied_orders"] == {}
    program = page.moved({"go": "hop"})["replay"]["coordinators"][0]
    assert (program["agent"], program["host"]) == ("boss", "bravo")
    assert page.post("replay", {"go": "stop"}) == 400
    assert page.post("order", {"action": "stop"}) in (404, 405)
    assert page.post("query", {"text": "Lift"}) in (404, 405)
    assert page.close() == 130


@pytest.mark.parametrize(
    "more", [("mission.dL",), ("--run", "x"), ("--map", "alpha=127.0.0.1:1"), ("--keys", ".")]
)
@pytest.mark.few(1)
def test_options_of_a_running_team_are_refused(records, more):
    command = [sys.executable, "-m", "lfield", "watch", *more, "--replay", str(records)]
    ran = subprocess.run(command, capture_output=True, text=True, timeout=60)
    assert ran.returncode == 64
    assert "--replay" in ran.stderr


@pytest.mark.few(0)
@needs_browser
@pytest.mark.browser
def test_buttons_move_the_map_the_line_and_the_variables(records, page_of):
    page = page_of(records)
    browser = Browser()
    try:
        browser.open(page.link)
        browser.thing("replay-hop").click()
        browser.says("host-bravo", "linked")
        browser.says("program-boss", "Boss.init")
        browser.says("variables-boss-0", "sum")
        browser.wait(lambda: browser.all("track-one"))
        assert not any(browser.all(name) for name in ("stop", "pause", "resume", "lift", "query", "plots"))
        clock = browser.text("replay-clock")
        browser.thing("replay-back-event").click()
        browser.wait(lambda: browser.text("replay-clock") != clock)
        browser.thing("replay-play").click()
        browser.says("replay-play", "Pause")
        assert browser.errors == []
    finally:
        browser.close()
