"""Stops, pauses and their confirmation on the page in a real browser; the team is scripted."""

from __future__ import annotations

import pytest
from real_browser import needs_browser

pytestmark = [needs_browser, pytest.mark.browser, pytest.mark.process, pytest.mark.long]


def test_stop_is_one_press_and_shows_confirmations(browser, page_of):
    page = page_of()
    page.do("stubborn wing")
    browser.open(page.link)
    page.line()
    browser.thing("stop").click()
    assert page.line() == "pressed stop"
    browser.says("confirmed-lead.fc", "safe")
    browser.says("unconfirmed-wing.fc", "NOT CONFIRMED: it has not answered")
    browser.says("latch-wing-fc", "not confirmed")
    browser.says("halt", "1 not confirmed")
    page.do("latch wing")
    browser.says("confirmed-wing.fc", "safe")
    browser.says("halt", "every device is safe, not yet at rest")
    browser.says("halt", "every device is safe and at rest")
    # The reports continue after the stop.
    browser.says("latch-lead-fc", "at rest")
    first = browser.text("place-lead")
    browser.wait(lambda: browser.text("place-lead") != first)


def test_a_stop_is_incomplete_while_a_host_has_not_answered(browser, page_of):
    page = page_of()
    page.do("hang bravo")
    browser.open(page.link)
    browser.thing("stop").click()
    browser.says("asked-bravo", "bravo has not answered yet")
    browser.says("confirmed-lead.fc", "safe, at rest")
    assert "Stopped: 1 not confirmed" in browser.text("halt")
    assert "every device" not in browser.text("halt")
    assert "bravo not answered yet" in browser.text("state")


@pytest.mark.few(0)
def test_lift_and_resume_ask_for_confirmation(browser, page):
    assert not browser.thing("lift").is_enabled()
    browser.thing("stop").click()
    assert page.line() == "pressed stop"
    browser.wait(lambda: browser.thing("lift").is_enabled())
    browser.thing("lift").click()
    browser.thing("no").click()
    browser.thing("pause").click()
    assert page.line() == "pressed pause", "an unconfirmed lift is carried out"
    browser.says("host-alpha", "paused")
    browser.confirm("resume")
    assert page.line() == "pressed resume"
    browser.confirm("lift")
    assert page.line() == "pressed lift"
    browser.wait(lambda: not browser.all("halt"))


@pytest.mark.few(0)
def test_a_dead_host_is_shown_with_its_last_state(browser, page):
    page.do("kill bravo")
    browser.says("host-bravo", "no program listens there")
    browser.wait(lambda: "old" in browser.thing("vehicle-wing").get_attribute("class"))
    browser.says("host-bravo", "last contact")
    place, age = browser.text("place-wing"), browser.text("vehicle-wing")
    browser.wait(lambda: browser.text("vehicle-wing") != age)
    assert browser.text("place-wing") == place
    assert "old" not in browser.thing("vehicle-lead").get_attribute("class")
    # The coordinator has the grey of its vehicle.
    greys = (
        "return [...document.querySelectorAll('.mind.old path, .marker.old .dart')]"
        ".map((each) => getComputedStyle(each).fill)"
    )
    requests_sent: list[list[str]] = []
    browser.wait(
        lambda: len(requests_sent.append(browser.driver.execute_script(greys)) or requests_sent[-1]) == 2
    )
    assert len(set(requests_sent[-1])) == 1
    browser.thing("stop").click()
    browser.says("unreached-bravo", "NOT REACHED: no program listens there")


@pytest.mark.few(0)
def test_a_stop_that_reaches_no_host_is_shown_while_it_holds(browser, page_of):
    page = page_of()
    page.do("kill alpha")
    page.do("kill bravo")
    browser.open(page.link)
    browser.says("host-bravo", "no program listens there")
    browser.thing("stop").click()
    for host in ("alpha", "bravo"):
        browser.says(f"unreached-{host}", f"{host} NOT REACHED: no program listens there")
    browser.says("halt", "Stop pressed: 2 not confirmed")
    browser.says("state", "STOP has NOT REACHED alpha, bravo")
    assert browser.all("latch-lead-fc") == [], "the vehicle is shown as stopped"
    browser.thing("pause").click()
    browser.says("order-pause", "alpha NOT REACHED")
    browser.confirm("resume")
    browser.says("order-resume", "bravo NOT REACHED")
    assert browser.all("order-pause") == []
    browser.confirm("lift")
    browser.says("order-lift", "alpha NOT REACHED")
    browser.wait(lambda: not browser.all("halt"))


@pytest.mark.few(0)
def test_the_last_state_of_a_dead_host_is_grey_after_a_lift(browser, page):
    browser.thing("stop").click()
    browser.says("halt", "every device is safe and at rest")
    page.do("kill bravo")
    browser.says("halt", "Stopped at alpha; unreachable: bravo")
    browser.says("before-bravo", "s ago, wing.fc safe")
    assert "old" in browser.thing("before-bravo").get_attribute("class")
    assert browser.all("confirmed-wing.fc") == []
    browser.says("latch-wing-fc", "was safe")
    assert "old" in browser.thing("latch-wing-fc").get_attribute("class")
    browser.says("state", "STOPPED")
    browser.confirm("lift")
    browser.says("order-lift", "bravo NOT REACHED")
    browser.says("order-lift", "done at alpha")
    browser.wait(lambda: "STOPPED" not in browser.text("state"))
    assert "alpha NOT REACHED" not in browser.text("halt")
    browser.says("halt", "No stop is active on the linked hosts")


@pytest.mark.few(0)
def test_a_press_is_shown_at_once_on_a_server_that_does_not_answer(browser, page):
    with page.suspended():
        browser.thing("stop").click()
        browser.says("asking-stop", "STOP pressed: waiting for the hosts")
        browser.says("trouble", "last known values")
        browser.says("failed", "STOP possibly not executed")
        assert browser.all("asking-stop") == []
        browser.thing("stop").click()
        browser.says("asking-stop", "STOP pressed: waiting for the hosts")
    assert page.line() == "pressed stop"
    browser.says("halt", "Stopped")
    browser.wait(lambda: not browser.all("failed") and not browser.all("asking-stop"))


@pytest.mark.few(0)
def test_a_stop_that_the_page_gave_up_is_executed_late_and_reported(browser, page):
    with page.suspended():
        browser.thing("stop").click()
        browser.says("failed", "STOP possibly not executed")
    assert page.line() == "pressed stop"
    browser.says("halt", "s late")
    browser.wait(lambda: not browser.all("failed"))


@pytest.mark.few(0)
@pytest.mark.parametrize("order", ["lift", "resume"])
def test_a_releasing_order_that_the_page_gave_up_is_not_executed(browser, page, order):
    browser.thing("stop").click()
    assert page.line() == "pressed stop"
    browser.wait(lambda: browser.thing("lift").is_enabled())
    with page.suspended():
        browser.confirm(order)
        browser.says("failed", "possibly not executed")
    browser.says("failed", "not executed: it did not reach the server in time; check the state")
    browser.says("halt", "Stopped")
    browser.confirm(order)
    assert page.line() == f"pressed {order}", "the first that is done"
    browser.wait(lambda: not browser.all("failed"))
