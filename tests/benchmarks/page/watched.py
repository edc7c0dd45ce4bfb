"""The cost of the page of `lfield watch` on the operator's computer, and the display delay of a latch."""

from __future__ import annotations

import http.client
import json
import time
from pathlib import Path
from urllib.parse import urlsplit

from harness.checkout import Checkout
from harness.figure import Figure, Opener
from harness.number_text import BYTES, PERCENT, SECONDS
from harness.paced import Round
from harness.processes import Child, Processes
from harness.samples import Contender
from machine.small import processor_seconds

#: Numbers of vehicles, each with telemetry at 5 Hz.
TEAMS = (2, 10, 50, 100)
#: Seconds of each round, and between two requests of a browser.
MEASURED, ASKED_EVERY = 10.0, 0.2
PROCESSOR, MEMORY, LATCH, ANSWER = "processor", "resident", "from a latch to the page", "an answer"

_PAGE, _HOSTS = (str(Path(__file__).with_name(f"watched_{name}.py")) for name in ("page", "hosts"))


class Browser:
    """A client that sends the requests of a browser to the server of a page."""

    def __init__(self, link: str) -> None:
        address = urlsplit(link)
        self._connection = http.client.HTTPConnection(address.netloc, timeout=10)
        self._connection.request("GET", f"{address.path}?{address.query}")
        answer = self._connection.getresponse()
        answer.read()
        self._headers = {"Cookie": (answer.getheader("Set-Cookie") or "").partition(";")[0]}
        self._line = 0
        self.size = 0

    def request(self) -> dict[str, bool]:
        """Request the page's data; returns for each device whether it is latched."""
        self._connection.request("GET", f"/snapshot?after={self._line}", headers=self._headers)
        answer = self._connection.getresponse().read()
        self.size = len(answer)
        data = json.loads(answer)
        self._line = data["log"][-1]["serial"] if data["log"] else self._line
        return {d["name"]: bool(d["latched"]) for v in data["team"]["vehicles"] for d in v["devices"]}


def watched(count: int) -> Opener:
    """Measure the page of `count` vehicles in one browser."""

    def opener(checkout: Checkout, _: Processes) -> Contender:
        return lambda: measure(checkout, count)

    return opener


def measure(checkout: Checkout, count: int) -> Round:
    """Serve a page for some seconds to a browser with its usual request rate."""
    with Processes() as processes:
        where = str(processes.folder()), str(count)
        hosts = checkout.run(processes, _HOSTS, *where)
        hosts.line()
        child = checkout.run(processes, _PAGE, *where)
        browser = Browser(child.line())
        child.line()
        folder = Path(f"/proc/{child.pid}")
        for _ in range(10):
            assert len(browser.request()) == count
            time.sleep(ASKED_EVERY)
        before, start = processor_seconds(folder), time.monotonic()
        answers = []
        while time.monotonic() - start < MEASURED:
            answers.append((browser.request(), time.monotonic()))
            time.sleep(max(0.0, ASKED_EVERY - (time.monotonic() - answers[-1][1])))
        spent, elapsed = processor_seconds(folder) - before, time.monotonic() - start
        memory = (folder / "smaps_rollup").read_text(encoding="ascii")
        (resident,) = (
            float(line.split()[1]) * 1024 for line in memory.splitlines() if line.startswith("Rss:")
        )
        return {
            PROCESSOR: [100 * spent / elapsed],
            MEMORY: [resident],
            ANSWER: [browser.size / 1000],
            LATCH: delays(hosts, answers, start, MEASURED),
        }


def delays(
    child: Child, answers: list[tuple[dict[str, bool], float]], start: float, seconds: float
) -> list[float]:
    """The seconds of each latch in that time until an answer of the page has it."""
    found = []
    while True:
        device, latched, at = child.line().split()
        if float(at) > start + seconds - 1.0:
            return found
        label = (
            moment for page, moment in answers if moment > float(at) and page[device] == bool(int(latched))
        )
        if float(at) > start:
            found.append(next(label) - float(at))


FIGURE = Figure(
    "The page of lfield watch with telemetry of each vehicle at 5 Hz",
    {f"{count} vehicles": watched(count) for count in TEAMS},
    rounds=3,
    units={PROCESSOR: PERCENT, MEMORY: BYTES, LATCH: SECONDS, ANSWER: "kB"},
    sizes={f"{count} vehicles": count for count in TEAMS},
    targets={"50 vehicles: processor": "20.00 %"},
    notes=(
        "the server process of the page, one browser with 5 requests a second; percent of one core",
        "every vehicle has a host of its own, and each host a link over a Unix socket",
    ),
)
