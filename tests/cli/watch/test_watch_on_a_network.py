"""`lfield watch --listen`: its options, and the rights of a browser, those of the keys of `watch`."""

from __future__ import annotations

import http.client
import json
import ssl
import time
from collections.abc import Callable
from pathlib import Path
from urllib.parse import urlsplit

import pytest
from real_browser import Browser, believing, needs_browser

from lfield.authority.identity import ALL_RIGHTS, Right
from lfield.authority.web_ca.browser_ca import new_browser_ca
from lfield.authority.web_ca.web_keys import write_web_keys

ADDRESS, DAY, TIMEOUT = "127.0.0.2", 86400.0, 60.0
PROGRAM = "resource Bell { init(string[] arg) { } portal ring() { } }\n"
DEPLOYMENT = "//Bell:bell@alpha\n"


def page_in(folder: Path, *names: str, begins: float = 60.0, ends: float = DAY) -> bytes:
    """Write the keys of a page to a folder; returns the root that browsers must trust."""
    root = new_browser_ca(1.0, time.time() + 9 * DAY)
    keys = root.issue(names or (ADDRESS,), at=time.time() - begins, ends=time.time() + ends)
    write_web_keys(folder, keys.certificate, keys.key)
    return root.certificate


@pytest.mark.parametrize(
    ("line", "status", "words"),
    [
        (
            "--listen 127.0.0.2",
            64,
            "--listen needs --page-keys DIR: without TLS others on the network could press the buttons: "
            "'lfield keys ",
        ),
        ("--listen 127.0.0.2", 64, "'lfield keys page 127.0.0.2' makes them"),
        ("--page-keys page", 64, "--page-keys is for a page on a network: say where with --listen ADDRESS"),
        (
            "--listen 0.0.0.0 --page-keys page",
            64,
            "'0.0.0.0' is not an address or name for browsers",
        ),
        ("--listen [::] --page-keys page", 64, "'[::]' is not an address or name for browsers"),
        ("--listen a:b --page-keys page", 64, "'a:b' is not an address or name"),
        (
            "--listen 127.0.0.2 --page-keys none",
            65,
            "none has no keys of a page (page.crt, page.key): 'lfield ",
        ),
        (
            "--listen 127.0.0.3 --page-keys page",
            65,
            "is for 127.0.0.2 and ground.local, not for 127.0.0.3: 'lfield",
        ),
        ("--listen 127.0.0.2 --page-keys ended", 65, "UTC: 'lfield keys page 127.0.0.2' makes one"),
        ("--listen 127.0.0.2 --page-keys early", 65, "set the clock"),
        ("--listen 127.0.0.2 --page-keys open", 65, "it is secret, and others may read it: run 'chmod 600"),
        (
            "--listen 127.0.0.2 --page-keys link",
            65,
            "page.key cannot be used: it is a link; copy the file itself",
        ),
        ("--listen 127.0.0.2 --page-keys half", 65, "page.key is not there"),
    ],
)
def test_a_page_that_cannot_be_served_is_refused_with_a_remedy(
    here, lfield, line: str, status: int, words: str
) -> None:
    deployment, folder = lfield.mission(PROGRAM, DEPLOYMENT), lfield.folder
    for name in ("page", "open", "link", "half"):
        page_in(folder / name, ADDRESS, "ground.local")
    page_in(folder / "ended", begins=2 * DAY, ends=-DAY)
    page_in(folder / "early", begins=-DAY, ends=2 * DAY)
    (folder / "open" / "page.key").chmod(0o644)
    (folder / "link" / "page.key").unlink()
    (folder / "link" / "page.key").symlink_to(folder / "page" / "page.key")
    (folder / "half" / "page.key").unlink()
    result = here("watch", "--deploy", deployment, *line.split(), status=status)
    assert words in result.err[-1]


@pytest.mark.process
def test_the_command_printed_by_keys_page_serves_the_page(here, lfield, alone) -> None:
    deployment = lfield.mission(PROGRAM, DEPLOYMENT)
    here("keys", "init", "authority", status=0)
    result = here("keys", "page", ADDRESS, "--authority", "authority").out[1].split()[1:]
    page = lfield.start(*result[:-1], deployment, env=alone)
    link = page.wait_for(rf"open this link: (https://{ADDRESS}:\d+/\?token=\S+)")[1]
    status, _ = answer_of(link, (lfield.folder / "authority" / "browsers.crt").read_bytes())
    assert status == 303


def answer_of(link: str, root: bytes, **headers: str) -> tuple[int, str]:
    """The answer to a browser that trusts a root, and its cookie."""
    address = urlsplit(link)
    context = ssl.create_default_context(cadata=root.decode())
    connection = http.client.HTTPSConnection(
        address.hostname or "", address.port, context=context, timeout=TIMEOUT
    )
    try:
        connection.request("GET", f"{address.path}?{address.query}", headers=headers)
        answer = connection.getresponse()
        answer.read()
        return answer.status, answer.headers.get("set-cookie", "").partition(";")[0]
    finally:
        connection.close()


# --- rights -----------------------------------------------------------------------------------------------


class Browsing:
    """A person's browser on the page of a `lfield watch` that has their keys."""

    def __init__(self, link: str, root: bytes) -> None:
        self._address, self._root = urlsplit(link), root
        _, self._cookie = answer_of(link, root)
        self.origin = f"https://{self._address.netloc}"

    def asks(self, path: str, says: object = None) -> tuple[int, str]:
        context = ssl.create_default_context(cadata=self._root.decode())
        connection = http.client.HTTPSConnection(
            self._address.hostname or "", self._address.port, context=context, timeout=TIMEOUT
        )
        try:
            body = None if says is None else json.dumps(says)
            headers = {"Cookie": self._cookie, "Origin": self.origin}
            connection.request("GET" if says is None else "POST", path, body, headers)
            answer = connection.getresponse()
            return answer.status, answer.read().decode()
        finally:
            connection.close()

    def look(self) -> dict:
        return json.loads(self.asks("/snapshot")[1])["team"]

    def until(self, told: Callable[[dict], bool]) -> dict:
        """Poll the page until it shows a condition."""
        end = time.monotonic() + TIMEOUT
        while not told(state := self.look()):
            assert time.monotonic() < end, state
            time.sleep(0.1)
        return state

    def presses(self, action: str) -> tuple[int, str]:
        return self.asks("/order", {"action": action, "pressed": json.loads(self.asks("/snapshot")[1])["at"]})


@pytest.fixture
def team(lfield, alone):
    """A host that requires keys; `begin(name, *may)` is the page of an operator with keys, and its root."""
    deployment = lfield.mission(PROGRAM, DEPLOYMENT)
    lfield.write("mission.access.yaml", "people: {maria: [observe]}\n")
    maps = lfield.maps(["alpha"])
    host = lfield.start("up", "--deploy", deployment, *maps, "--first-start", "--host", "alpha", env=alone)
    host.wait_for("alpha")

    def begin(name: str, *may: Right) -> tuple[str, bytes]:
        lfield.keys.put(name, lfield.keys.issue("person", name, *may))
        root = page_in(lfield.folder / "page")
        # The environment of another computer, without the socket of the host.
        (lfield.folder / "away").mkdir(mode=0o700, exist_ok=True)
        away = {"XDG_RUNTIME_DIR": f"{lfield.folder}/away"}
        arguments = (
            "watch",
            "--deploy",
            deployment,
            *maps,
            "--keys",
            lfield.keys.folder / name,
            "--listen",
            ADDRESS,
        )
        page = lfield.start(*arguments, "--page-keys", lfield.folder / "page", env=away)
        return page.wait_for(r"open this link: (https://\S+)")[1], root

    return begin


def linked(look: dict) -> bool:
    return all(host["linked"] for host in look["hosts"])


@pytest.mark.few(0)
@pytest.mark.process
def test_an_operator_with_only_observe_sees_the_page_and_gives_no_order(team) -> None:
    page = Browsing(*team("anna", Right.OBSERVE))
    state = page.until(linked)
    assert set(state["denied_orders"]) == {"stop", "lift", "pause", "resume"}
    for order, reason in state["denied_orders"].items():
        assert "anna may observe, and this takes the right to" in reason
        assert page.presses(order) == (403, reason)
    state = page.until(linked)
    assert (state["is_stopped"], state["paused"]) == (False, [])


@pytest.mark.few(0)
@pytest.mark.process
def test_access_rules_of_a_mission_leave_the_stop_button(team) -> None:
    page = Browsing(*team("maria", *ALL_RIGHTS))
    look = page.until(linked)
    assert set(look["denied_orders"]) == {"lift", "resume"}
    reason = "maria may not operate in this mission: mission.access.yaml:1 limits maria to: observe"
    assert set(look["denied_orders"].values()) == {reason}
    assert page.presses("stop")[0] == 200
    page.until(lambda look: look["is_stopped"])
    assert page.presses("lift") == (403, reason)
    assert page.until(linked)["is_stopped"]


@pytest.mark.few(0)
@pytest.mark.process
def test_an_operator_without_a_rule_lifts_their_own_stop(team) -> None:
    page = Browsing(*team("otto", Right.OPERATE, Right.STOP, Right.OBSERVE))
    assert page.until(linked)["denied_orders"] == {}
    assert page.presses("stop")[0] == 200
    page.until(lambda look: look["is_stopped"])
    assert page.presses("lift")[0] == 200
    page.until(lambda look: not look["is_stopped"])


@pytest.mark.few(0)
@needs_browser
@pytest.mark.process
@pytest.mark.browser
def test_without_the_right_stop_is_disabled_with_the_reason(team, lfield) -> None:
    link, _ = team("anna", Right.OBSERVE)
    browser = Browser(*believing(lfield.folder / "page"), f"--proxy-bypass-list={ADDRESS}")
    try:
        browser.open(link)
        browser.says("state", "1 of 1 hosts linked")
        browser.wait(lambda: not browser.thing("stop").is_enabled())
        browser.says("barred-stop", "anna may observe, and this takes the right to stop")
        assert "--may observe,stop" in browser.thing("stop").get_attribute("title")
        for button in ("pause", "resume", "lift"):
            assert not browser.thing(button).is_enabled()
        # A request that bypasses the page's own button is refused by its server.
        press = """
            const [done] = arguments;
            const answer = fetch("order", {method: "POST", body: '{"action": "stop"}'});
            answer.then(async (said) => done(said.status + " " + await said.text()));
        """
        browser.driver.set_script_timeout(TIMEOUT)
        assert browser.driver.execute_async_script(press).startswith("403 anna may observe, and this takes")
        assert "STOPPED" not in browser.text("state")
    finally:
        browser.close()
