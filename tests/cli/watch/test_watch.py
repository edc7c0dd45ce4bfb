"""`lfield watch` on a flying team in a real browser: its use by an operator, and its refusals."""

from __future__ import annotations

import os
import signal
import sqlite3
import time
from collections.abc import Iterator

import pytest
from real_browser import Browser, needs_browser

pytestmark = pytest.mark.process

# : Two copters in circles, and a coordinator that migrates between them.
PROGRAM = """
resource Copter {
    Mavlink fc;
    init(string[] arg) { }
    portal up() { fc.arm(); fc.takeoff(3.0); }
    portal fly(real north, real east) { fc.goTo(north, east, -3.0); }
}
coordinator Pair {
    init(string[] arg) {
        Copter lead = findCopter("lead");
        Copter wing = findCopter("wing");
        together { lead.up(); wing.up(); }
        print("both fly");
        while (true) {
            together { lead.fly(20.0, 5.0); wing.fly(-20.0, -5.0); }
            together { lead.fly(5.0, 20.0); wing.fly(-5.0, -20.0); }
        }
    }
}
"""
DEPLOYMENT = "//Copter:lead@alpha\n//Copter:wing@bravo\n//Pair:pilot@alpha\n"


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    made = Browser()
    yield made
    made.close()


@pytest.fixture
def team(lfield, alone):
    """The processes of a flying team and of its page."""
    deployment = lfield.mission(PROGRAM, DEPLOYMENT)
    lfield.start("up", "--deploy", deployment, "--all", "--sim", env=alone).wait_for("both fly")
    page = lfield.start("watch", "--deploy", deployment, env=alone)
    return page.wait_for(r"http://127\.0\.0\.1:\d+/\?token=\S+")[0], page


@pytest.mark.few(0)
@needs_browser
@pytest.mark.browser
def test_two_copters_move_and_stop_and_a_host_dies(browser, lfield, team):
    link, page = team
    browser.open(link)
    for agent in ("lead", "wing"):
        browser.wait(lambda agent=agent: "GUIDED" in browser.text(f"vehicle-{agent}"))
        place = browser.text(f"place-{agent}")
        browser.wait(lambda agent=agent, place=place: browser.text(f"place-{agent}") != place)
    browser.says("coordinator-pilot", "mission.L:")
    browser.says("coordinator-pilot", "→")
    browser.says("state", "2 of 2 hosts linked")
    # Printed before the first request of the page.
    browser.says("log", "both fly")

    browser.thing("stop").click()
    browser.says("confirmed-lead.fc", "safe")
    browser.says("confirmed-wing.fc", "safe")
    browser.says("halt", "every device is safe and at rest")
    browser.says("latch-lead-fc", "at rest")
    browser.says("log", "on the page of lfield watch")

    os.kill(lfield.child("bravo"), signal.SIGKILL)
    browser.says("host-bravo", "last contact")
    browser.wait(lambda: "old" in browser.thing("vehicle-wing").get_attribute("class"))
    assert "old" not in browser.thing("vehicle-lead").get_attribute("class")
    browser.says("host-alpha", "no contact with bravo")
    browser.says("before-bravo", "wing.fc safe")
    browser.thing("lift").click()
    browser.thing("yes").click()
    browser.says("order-lift", "bravo NOT REACHED")
    browser.says("halt", "No stop is active on the linked hosts")
    browser.says("state", "1 of 2 hosts linked")
    assert "STOP" not in browser.text("state")
    assert browser.asked_hosts() == {link.removeprefix("http://").partition("/")[0]}
    assert browser.errors == []

    page.signal(signal.SIGINT)
    assert page.wait() == 130, page.said
    assert page.err == []
    browser.says("trouble", "No connection to the server of this page; last known values: ")


@pytest.mark.few(0)
@needs_browser
@pytest.mark.browser
def test_a_query_on_the_page_is_answered_as_by_the_command(browser, team):
    link, _ = team
    browser.open(link)
    browser.thing("query").send_keys("Lift where payload >= 2.0\n")
    browser.says("answer", "no agent can")
    browser.thing("query").clear()
    browser.thing("query").send_keys("Lift where payloud >= 2.0\n")
    browser.says("answer", "payloud")


def other_file(folder):
    sqlite3.connect(folder / "birds.db").execute("create table birds (name)").connection.close()
    return folder / "birds.db"


def test_an_invalid_background_is_refused_with_a_sentence(here, lfield):
    deployment = lfield.mission(PROGRAM, DEPLOYMENT)
    for file in (lfield.folder / "missing.mbtiles", deployment, other_file(lfield.folder)):
        result = here("watch", "--deploy", deployment, "--tiles", file, status=66)
        assert f"cannot read {file}: " in result.err[-1]


@pytest.mark.parametrize("port", ["0", "65536", "-1", "http"])
def test_an_invalid_port_is_refused(here, lfield, port):
    result = here("watch", "--deploy", lfield.mission(PROGRAM, DEPLOYMENT), f"--port={port}", status=64)
    assert "a port is a number from 1 to 65535" in result.err[-1]


def test_a_port_in_use_is_refused(here, lfield):
    import socket

    with socket.create_server(("127.0.0.1", 0)) as other:
        port = other.getsockname()[1]
        result = here("watch", "--deploy", lfield.mission(PROGRAM, DEPLOYMENT), "--port", port)
    assert result.status == 69
    assert "the port is in use; stop the program that has it" in result.err[-1]


def test_without_nicegui_the_sentence_names_the_package(here, lfield, monkeypatch):
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    result = here("watch", "--deploy", lfield.mission(PROGRAM, DEPLOYMENT), status=69)
    assert "pip install 'lfield[watch]'" in result.err[-1]


@pytest.mark.few(0)
def test_a_page_waits_for_a_team_that_does_not_run(lfield, alone):
    page = lfield.start("watch", "--deploy", lfield.mission(PROGRAM, DEPLOYMENT), env=alone)
    page.wait_for("open this link: ")
    page.wait_for(
        ".*mission.dL is not running on this computer: the page waits for alpha at .* and bravo at "
    )
    page.signal(signal.SIGINT)
    assert page.wait() == 130, page.said


@pytest.mark.few(0)
@needs_browser
@pytest.mark.browser
def test_a_second_ctrl_c_after_a_browser_ends_the_page(browser, lfield, alone):
    page = lfield.start("watch", "--deploy", lfield.mission(PROGRAM, DEPLOYMENT), env=alone)
    browser.open(page.wait_for(r"http://127\.0\.0\.1:\d+/\?token=\S+")[0])
    browser.thing("stop").click()
    for host in ("alpha", "bravo"):
        browser.says(f"unreached-{host}", "NOT REACHED")
    for _ in range(2):
        page.signal(signal.SIGINT)
        time.sleep(0.05)
    assert page.wait() == 130, page.said
    assert page.err == []
