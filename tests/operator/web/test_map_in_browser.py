"""The map of the page in a real browser: labels, tracks, drawings of files, backgrounds; its pure parts."""

from __future__ import annotations

import threading
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from itertools import combinations
from pathlib import Path

import pytest
from real_browser import needs_browser
from selenium.webdriver.common.by import By
from test_map_background import PICTURE, made

pytestmark = [needs_browser, pytest.mark.browser, pytest.mark.process, pytest.mark.long]

FILES = Path(__file__).parents[2] / "mavlink" / "files"
_RUN = """
const done = arguments[arguments.length - 1];
import("lfield-watch").then((m) => done((%s)(m, ...arguments)));
"""
_BOXES = """
const drawn = "[data-testid^=label-], .map .grid text, .map .marker .dart";
return [...document.querySelectorAll(drawn)].map((each) => {
  const { left, right, top, bottom } = each.getBoundingClientRect();
  return [each.dataset.testid ?? "", left, right, top, bottom];
});
"""


def run(browser, function, *arguments):
    """The result of a function of JavaScript that gets the modules of the page."""
    return browser.driver.execute_async_script(_RUN % function, *arguments)


def overlap(one, other):
    return one[1] < other[2] and other[1] < one[2] and one[3] < other[4] and other[3] < one[4]


@pytest.mark.few(0)
def test_map_geometry_and_label_placement(browser, page_of):
    page = page_of()
    browser.open(page.link)
    # A pixel of zoom 0 is 40,075 km / 256 at the equator; at 60 degrees it is half as wide.
    widths = run(
        browser, "({geometry: g}) => [g.metresPerPixel(0, 0), g.metresPerPixel(1, 60), g.metresPerPixel(3)]"
    )
    assert widths == pytest.approx([156543.03, 39135.76, 0.125], abs=0.01)
    assert run(browser, "({geometry: g}) => [0.03, 1, 7, 120].map(g.roundStep)") == pytest.approx(
        [0.05, 1, 10, 200]
    )
    assert run(browser, "({geometry: g}) => g.thinned([1,2,3,4,5,6,7], 4)") == [1, 3, 5, 7]
    heights = run(browser, "({words: w}) => [-0.04, 0, 0.06, -0.06, -12.349, null].map(w.metres)")
    assert heights == ["0.0 m", "0.0 m", "0.1 m", "-0.1 m", "-12.3 m", "–"]
    # Twelve labels at one point: all are placed, apart, in the map, and not on the obstacle.
    placed = run(
        browser,
        """({labels: l}) => {
          const size = { width: 60, height: 27, radius: 12, x: 200, y: 150 };
          const wanted = [...Array(12).keys()].map((n) => ({ key: `v${n}`, ...size }));
          const map = { x: 500, y: 300 };
          const first = l.placedLabels(wanted, [l.boxAround({ x: 240, y: 150, radius: 10 })], map);
          const again = l.placedLabels(wanted, [], map, { v0: 1, v1: 90 });
          const near = l.placedLabels(wanted.map((w) => ({ ...w, near: true })), [], map);
          return [first, again, near];
        }""",
    )
    first, again, near = placed
    boxes = [(key, p["left"], p["left"] + 60, p["top"], p["top"] + 27) for key, p in first.items()]
    assert len(boxes) == 12
    assert not any(overlap(one, other) for one, other in combinations(boxes, 2))
    assert all(
        left >= 0 and right <= 500 and top >= 0 and bottom <= 300 for _, left, right, top, bottom in boxes
    )
    assert not any(overlap(box, ("", 230, 250, 140, 160)) for box in boxes)
    assert (first["v11"]["line"] != "", first["v0"]["line"]) == (True, "")
    # A label stays in a free slot, but not in a far one while a near one is free.
    assert (again["v0"]["slot"], again["v1"]["slot"] < 8) == (1, True)
    assert 0 < len(near) < 12, "numbers of items are omitted rather than distant"
    # Of labels with fixed places, those under an obstacle or an earlier label are left out.
    process = run(
        browser,
        """({labels: l}) => {
          const at = (left) => ({ left, right: left + 20, top: 0, bottom: 10 });
          const labels = [0, 15, 40, 70].map((left) => ({ left, box: at(left) }));
          return l.separate(labels, [at(75)]).map((one) => one.left);
        }""",
    )
    assert process == [0, 40]


@pytest.mark.few(0)
def test_five_robots_close_together_have_five_separate_labels(browser, page_of):
    page = page_of("--count", 5, "--earth")
    for number in range(5):
        page.do(f"place copter{number + 1} 0 {number * 0.5}")
    browser.open(page.link)
    browser.wait(
        lambda: len(browser.driver.find_elements(By.CSS_SELECTOR, "[data-testid^=label-copter]")) == 5
    )
    boxes = browser.evaluate(lambda: browser.driver.execute_script(_BOXES))
    labels = [box for box in boxes if box[0].startswith("label-")]
    grid = [box for box in boxes if box[0].startswith("degrees-")]
    assert grid
    assert not [pair for pair in combinations([*labels, *grid], 2) if overlap(*pair)]
    assert {box[0] for box in labels} == {"label-pilot", *(f"label-copter{n + 1}" for n in range(5))}
    assert browser.errors == []


@pytest.mark.few(0)
def test_tracks_limits_and_files_are_drawn_with_a_legend(browser, page_of):
    page = page_of("--earth", "--draw", FILES / "north-field.plan", FILES / "north.kml")
    browser.open(page.link)
    browser.says("legend-area", "north.kml")
    browser.says("legend-way", "plan: north-field.plan")
    browser.says("legend-limit", "limit of lead, wing: 40.0 m from home, 10.0 m above home")
    browser.says("legend-inside", "stay inside")
    browser.says("legend-outside", "stay outside")
    assert "home" in browser.text("legend-home")
    assert len(browser.all("shape-way")), browser.errors
    track = browser.thing("track-lead").get_attribute("d")
    browser.wait(lambda: browser.thing("track-lead").get_attribute("d").count("L") > track.count("L"))
    # The limit of 40 m, in pixels by the scale of the map.
    scale = browser.driver.find_element(By.CSS_SELECTOR, ".leaflet-control-scale-line")
    metres = float(scale.text.split()[0]) * (1000 if "km" in scale.text else 1)
    width = float(scale.value_of_css_property("width").removesuffix("px"))
    assert float(browser.thing("shape-limit").get_attribute("r")) == pytest.approx(
        40 * width / metres, rel=0.06
    )
    # A second browser gets the whole track at once.
    first = browser.thing("track-lead").get_attribute("d").count("L")
    page.link = page.line()
    browser.open(page.link)
    browser.wait(lambda: browser.thing("track-lead").get_attribute("d").count("L") >= min(first, 100))
    assert browser.errors == []


@pytest.mark.few(0)
def test_a_background_from_a_file_is_drawn(browser, page_of, tmp_path):
    rows = [(zoom, x, y, PICTURE) for zoom in range(4) for x in range(1 << zoom) for y in range(1 << zoom)]
    page = page_of("--earth", "--tiles", made(tmp_path / "field.mbtiles", rows))
    browser.open(page.link)
    browser.wait(lambda: browser.thing("map").parts("img.leaflet-tile-loaded", bool))
    assert browser.asked_hosts() == {page.address.removeprefix("http://")}


class _TileServer(BaseHTTPRequestHandler):
    asked: list[tuple[str, str]] = []

    def do_GET(self):
        self.asked.append((self.path, self.headers.get("Referer", "")))
        self.send_response(200)
        self.send_header("Content-Type", "image/png")
        self.end_headers()
        self.wfile.write(PICTURE)

    def log_message(self, *_):
        """Print nothing."""


@pytest.mark.few(0)
def test_tiles_are_requested_only_from_the_named_server(browser, page_of):
    server = ThreadingHTTPServer(("127.0.0.1", 0), _TileServer)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    host = f"127.0.0.1:{server.server_port}"
    try:
        page = page_of("--earth", "--tiles", f"http://{host}/{{z}}/{{x}}/{{y}}.png")
        browser.open(page.link)
        browser.wait(lambda: browser.thing("map").parts("img.leaflet-tile-loaded", bool))
        assert host in browser.thing("map").text
        assert browser.asked_hosts() == {page.address.removeprefix("http://"), host}
        path, referer = _TileServer.asked[0]
        assert path.endswith(".png")
        assert referer == f"{page.address}/", "no token, no path"
        blocked = "localhost:9"
        run(browser, f"() => {{ new Image().src = 'http://{blocked}/x.png'; return 0 }}")
        browser.wait(lambda: any("Content Security Policy" in error for error in browser.errors))
    finally:
        server.shutdown()
        server.server_close()
