"""The page in a real browser, as a user sees and operates it; the team is scripted."""

from __future__ import annotations

import pytest
from real_browser import needs_browser
from selenium.webdriver.common.action_chains import ActionChains
from selenium.webdriver.common.by import By
from selenium.webdriver.common.keys import Keys

from lfield.operator.web.page_sessions import NO_SESSION, OLD_LINK
from lfield.operator.web.page_snapshots import MAX_LOG_LINES
from lfield.vm.waits.operator_input import NO_READER
from lfield.wire.fields import MAX_INPUT

pytestmark = [needs_browser, pytest.mark.browser, pytest.mark.process, pytest.mark.long]


def test_two_copters_move_on_the_page(browser, shared_page):
    for agent in ("lead", "wing"):
        row, marker = (
            browser.text(f"place-{agent}"),
            browser.thing(f"marker-{agent}").get_attribute("transform"),
        )
        browser.wait(lambda agent=agent, row=row: browser.text(f"place-{agent}") != row)
        browser.wait(
            lambda agent=agent, marker=marker: (
                browser.thing(f"marker-{agent}").get_attribute("transform") != marker
            )
        )
    assert "GUIDED" in browser.text("vehicle-lead")
    browser.says("coordinator-pilot", "mission.L:")
    browser.says("coordinator-pilot", "waits for")
    browser.wait(lambda: browser.driver.find_elements(By.CSS_SELECTOR, ".sky path.hop"))
    assert browser.errors == []


@pytest.mark.few(0)
def test_an_input_line_is_entered_for_an_agent_that_waits(browser, page):
    def field(agent: str):
        return browser.driver.find_element(By.CSS_SELECTOR, f"[data-testid=type-{agent}]")

    assert not browser.driver.find_elements(By.CSS_SELECTOR, ".panel.input")
    page.do("read bravo wing tail")
    browser.says("input-wing", "wing at bravo waits for a line")
    field("wing").send_keys("take off")
    field("tail").send_keys(Keys.ENTER)
    assert page.line() == "entered bravo tail"
    browser.wait(lambda: not browser.driver.find_elements(By.CSS_SELECTOR, "[data-testid=input-tail]"))
    field("wing").send_keys("x" * MAX_INPUT + Keys.ENTER)
    assert page.line() == "entered bravo wing " + ("take off" + "x" * MAX_INPUT)[:MAX_INPUT]
    browser.wait(lambda: not browser.driver.find_elements(By.CSS_SELECTOR, ".panel.input"))
    page.do("read bravo wing")
    browser.says("input-wing", "waits for a line")
    assert not field("wing").get_attribute("value")
    assert browser.errors == []
    field("wing").send_keys("too late", Keys.ENTER)
    page.do("read bravo")
    browser.says("input-trouble", NO_READER.format(agent="wing"))


@pytest.mark.few(0)
def test_the_page_contacts_only_its_own_server(browser, page_of):
    page = page_of("--earth")
    browser.open(page.link)
    browser.thing("plots").click("summary")
    browser.wait(lambda: browser.thing("plot-height").parts("canvas", bool))
    assert browser.asked_hosts() == {page.address.removeprefix("http://")}
    assert browser.errors == []


def test_a_delayed_start_names_hosts_reasons_and_bundles(browser, shared_page):
    browser.says("host-alpha", "bundle 5cde09b1f2a37c44")
    reason = "alpha runs bundle 5cde09b1f2a37c44 and carol runs bundle 77aa0c31d5e8b902"
    shared_page.do(f"refuse carol {reason}")
    browser.says("host-alpha", "start waits for carol")
    browser.says("host-alpha", f"no link with carol: {reason}")
    assert browser.errors == []


@pytest.mark.few(0)
def test_stopped_and_paused_are_shown_together(browser, page):
    browser.thing("stop").click()
    browser.thing("pause").click()
    browser.says("state", "STOPPED · paused at alpha, bravo")


@pytest.mark.few(0)
def test_a_host_held_by_a_vote_is_named(browser, page):
    browser.says("state", "2 of 2 hosts linked")
    assert "vote" not in browser.text("state") + browser.text("host-alpha")
    page.do("vote alpha")
    browser.says("state", "held by a vote at alpha")
    browser.says("host-alpha", "held until the result of a vote")
    assert "vote" not in browser.text("host-bravo")


#: The number of pixels of each of these colours in a chart.
_COLOURS = """
const canvas = document.querySelector(`[data-testid=plot-${arguments[0]}] canvas`);
const data = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height).data;
const counts = arguments[1].map(() => 0);
for (let at = 0; at < data.length; at += 4) {
  if (data[at + 3] < 200) continue;
  const n = arguments[1].indexOf(`rgb(${data[at]}, ${data[at + 1]}, ${data[at + 2]})`);
  if (n >= 0) counts[n]++;
}
return counts;
"""


@pytest.mark.few(0)
def test_an_agent_has_one_colour_in_all_plots(browser, page_of):
    page = page_of()
    page.do("low lead")
    browser.open(page.link)
    browser.thing("plots").click("summary")
    browser.says("key-hops", "pilot")

    def inks(key):
        values = browser.thing(key).parts("i", lambda ink: ink.value_of_css_property("background-color"))
        return [colour.replace("rgba", "rgb").replace(", 1)", ")") for colour in values]

    assert browser.text("key-vehicles").split() == ["Vehicles:", "leadwing"]
    colours = [*inks("key-vehicles"), *inks("key-hops")]
    assert len(set(colours)) == 3

    def drawn(plot):
        return [count > 20 for count in browser.driver.execute_script(_COLOURS, plot, colours)]

    browser.wait(lambda: drawn("battery") == [True, True, False])
    assert drawn("height") == [False, True, False], "lead tells no height"
    assert drawn("hops") == [False, False, True]


@pytest.mark.few(0)
def test_a_denied_button_shows_the_reason(browser, page_of):
    page = page_of()
    page.do("bar lift your keys let you stop, not operate: ask for --may operate")
    page.do("bar resume your keys let you stop, not operate: ask for --may operate")
    browser.open(page.link)
    browser.wait(lambda: not browser.thing("resume").is_enabled())
    assert browser.thing("stop").is_enabled()
    assert "--may operate" in browser.thing("resume").get_attribute("title")
    browser.says("barred-lift", "your keys let you stop, not operate")


@pytest.mark.few(0)
def test_on_a_phone_the_page_is_one_column_and_stop_stays_visible(browser, page_of):
    page = page_of("--count", 6)
    with browser.phone(390, 844):
        browser.open(page.link)
        browser.thing("vehicle-copter6")
        assert browser.driver.execute_script("return document.documentElement.scrollWidth") <= 390
        for place in ("0", "document.body.scrollHeight"):
            browser.driver.execute_script(f"window.scrollTo(0, {place})")
            box = browser.driver.execute_script(
                "return document.querySelector('[data-testid=stop]').getBoundingClientRect().toJSON()"
            )
            assert box["bottom"] <= 844
            assert box["top"] > 700
            assert box["width"] > 300
        browser.says("place-copter6", ",")
        browser.thing("stop").click()
        browser.says("halt", "Stopped")


def test_the_page_is_operable_by_keyboard_alone(browser, page):

    def press(*keys: str) -> str:
        """The focused element after these keys."""
        ActionChains(browser.driver).send_keys(*keys).perform()
        return browser.evaluate(
            lambda: browser.driver.switch_to.active_element.get_attribute("data-testid") or ""
        )

    assert press(Keys.TAB) == "stop", "it comes first"
    press(Keys.ENTER)
    assert page.line() == "pressed stop"
    browser.wait(lambda: browser.thing("lift").is_enabled())
    assert press(Keys.TAB) == "pause"
    assert press(Keys.TAB) == "resume"
    assert press(Keys.TAB) == "lift"
    assert press(Keys.ENTER) == "no", "the focus is on an element without effect"
    press(Keys.ESCAPE)
    browser.wait(lambda: not browser.thing("no").is_displayed())
    assert press(Keys.ENTER, Keys.TAB) == "yes"
    press(Keys.ENTER)
    assert page.line() == "pressed lift"
    observed = [press(Keys.TAB) for _ in range(24)]
    assert "query" in observed
    assert "stop" in observed, "the focus returns to the first element"


def test_an_invalid_query_is_answered_with_its_mistakes(browser, shared_page):
    browser.thing("query").send_keys("Lift whree payload", Keys.ENTER)
    browser.says("answer", 'nobody knows what "Lift whree payload" is')


@pytest.mark.few(0)
def test_an_answer_ages_and_offers_of_a_dead_host_are_grey(browser, page):
    browser.thing("query").send_keys("Lift", Keys.ENTER)
    browser.says("answer", "Lift, asked 0.")
    browser.says("answer", "Lift, asked 1.")
    assert "old" not in (browser.thing("offer-wing").get_attribute("class") or "")
    page.do("kill bravo")
    browser.says("offer-wing", "bravo unreachable now")
    assert "old" in browser.thing("offer-wing").get_attribute("class")
    assert "old" not in (browser.thing("offer-lead").get_attribute("class") or "")


@pytest.mark.few(0)
def test_with_an_origin_positions_are_in_degrees(browser, page_of):
    page = page_of("--earth")
    page.do("place lead 0 0")
    browser.open(page.link)
    browser.says("place-lead", "47.400000°, 8.500000°")
    assert "m north" in browser.thing("place-lead").get_attribute("title")
    labels = ".sky .grid text"
    browser.wait(lambda: browser.driver.find_elements(By.CSS_SELECTOR, labels))
    values = browser.evaluate(
        lambda: [label.text for label in browser.driver.find_elements(By.CSS_SELECTOR, labels)]
    )
    assert any(text.startswith("47.4") and text.endswith("° N") for text in values), values
    assert any(text.startswith("8.5") and text.endswith("° E") for text in values), values


@pytest.mark.few(0)
def test_coordinators_are_visible_below_their_vehicles_on_a_phone(browser, page_of):
    page = page_of()
    page.do("place lead -50 0")
    page.do("place wing 50 20")
    with browser.phone(360, 740):
        browser.open(page.link)
        low = """
const place = document.querySelector("[data-testid=marker-lead]").getCTM().f;
return document.querySelector(".map").clientHeight - place;
"""
        for north in range(-52, -90, -2):
            before = browser.text("place-lead")
            page.do(f"place lead {north} 0")
            browser.wait(lambda before=before: browser.text("place-lead") != before)
            # The diamond is 27 pixels below, and half of it is 6.
            assert browser.driver.execute_script(low) >= 33


def test_printed_text_is_shown_and_never_executed(browser, shared_page):
    shared_page.do("say alpha <img src=x onerror=document.title='run'> {{ 6 * 7 }}")
    browser.says("log", "<img src=x onerror=document.title='run'> {{ 6 * 7 }}")
    assert browser.driver.title == "first-flight"


@pytest.mark.few(0)
def test_a_vehicle_without_a_position_is_only_in_the_table(browser, page_of):
    page = page_of()
    page.do("unplace wing")
    browser.open(page.link)
    browser.says("place-wing", "no position")
    browser.thing("marker-lead")
    assert browser.all("marker-wing") == []


@pytest.mark.few(0)
def test_a_link_opens_one_browser_and_the_next_link_is_printed(browser, page_of):
    page = page_of()
    # Another program on 127.0.0.1 has left malformed cookies in this browser.
    browser.driver.get(page.address)
    for cookie in ("a[]=b", 'x={"a":1}', "theme=dark mode", "alone"):
        browser.driver.execute_script("document.cookie = arguments[0]", cookie)
    browser.open(page.link)
    assert "token" not in browser.driver.current_url
    second = page.line()
    assert second != page.link
    browser.driver.delete_all_cookies()
    browser.driver.get(page.link)
    assert OLD_LINK in browser.driver.page_source
    browser.driver.get(page.address)
    assert NO_SESSION in browser.driver.page_source
    browser.open(second)


@pytest.mark.few(0)
def test_two_pages_watch_at_once(browser, page):
    first = browser.driver.current_window_handle
    browser.driver.switch_to.new_window("tab")
    try:
        browser.open(page.address)
        browser.thing("stop").click()
        browser.says("halt", "Stopped")
    finally:
        browser.driver.close()
        browser.driver.switch_to.window(first)
    browser.says("halt", "Stopped")


@pytest.mark.few(0)
def test_a_page_without_its_server_shows_it(browser, page):
    page.close()
    browser.says("trouble", "last known values")
    browser.says("state", "updated")
    browser.thing("stop").click()
    browser.says("failed", "lfield estop")


@pytest.mark.few(0)
def test_a_suspended_page_catches_up(browser, page):
    page.do("say alpha before it sleeps")
    browser.says("log", "before it sleeps")
    browser.driver.execute_cdp_cmd("Page.setWebLifecycleState", {"state": "frozen"})
    page.do("kill bravo")
    page.do("count alpha 1100")
    # Only then, so that a page that resumes in between misses no events.
    assert page.line() == "counted"
    browser.driver.execute_cdp_cmd("Page.setWebLifecycleState", {"state": "active"})
    browser.says("log", "line 1099")
    browser.says("host-bravo", "no program listens there")
    assert len(browser.thing("log").parts("time", bool)) == MAX_LOG_LINES
    browser.says("log-gap", "missing here")
    browser.wait(lambda: "updated" not in browser.text("state"))


@pytest.mark.few(0)
def test_automatic_reload_of_the_page_is_off(browser, page):
    """A page that cannot reach its server must stay: it has the last known state, and STOP."""
    browser.wait(lambda: browser.driver.execute_script("return !window.socket.connected"))
    place = browser.text("place-lead")
    browser.wait(lambda: browser.text("place-lead") != place)
    assert not browser.driver.execute_script("return window.socket.active")


REDRAWN = """data:text/html,<p data-testid=state>here</p><script>
    setInterval(() => { document.body.innerHTML = '<p data-testid=state class=new>here</p>' }, 30)
</script>"""


@pytest.mark.few(0)
def test_elements_that_a_page_redraws_continuously_are_read(browser):
    """Test the helpers of these tests."""
    browser.driver.get(REDRAWN)
    browser.wait(lambda: browser.thing("state").get_attribute("class"))
    values = {(browser.text("state"), browser.thing("state").get_attribute("class")) for _ in range(10)}
    assert values == {("here", "new")}
