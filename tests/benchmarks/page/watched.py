"""The cost of the page of `lfield watch` for the operator's computer, and its delay in showing a latch."""

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

#: How many vehicles, each told of 5 times a second.
TEAMS = (2, 10, 50, 100)
#: Seconds of each round, and how often a browser asks.
MEASURED, ASKED_EVERY = 10.0, 0.2
PROCESSOR, MEMORY, LATCH, LOOK = "processor", "resident", "from a latch to the page", "a look"

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

    def look(self) -> dict[str, bool]:
        """Which devices are latched as the page shows it."""
        self._connection.request("GET", f"/look?after={self._line}", headers=self._headers)
        said = self._connection.getresponse().read()
        self.size = len(said)
        told = json.loads(said)
        self._line = told["log"][-1]["serial"] if told["log"] else self._line
        return {d["name"]: bool(d["latched"]) for v in told["look"]["vehicles"] for d in v["devices"]}


def watched(count: int) -> Opener:
    """The page of so many vehicles, in one browser."""

    def opener(checkout: Checkout, _: Processes) -> Contender:
        return lambda: measure(checkout, count)

    return opener


def measure(checkout: Checkout, count: int) -> Round:
    """A page for some seconds, from which a browser asks for a look as often as it does."""
    with Processes() as processes:
        where = str(processes.folder()), str(count)
        hosts = checkout.run(processes, _HOSTS, *where)
        hosts.line()
        child = checkout.run(processes, _PAGE, *where)
        browser = Browser(child.line())
        child.line()
        folder = Path(f"/proc/{child.pid}")
        for _ in range(10):
            assert len(browser.look()) == count
            time.sleep(ASKED_EVERY)
        before, start = processor_seconds(folder), time.monotonic()
        looks = []
        while time.monotonic() - start < MEASURED:
            looks.append((browser.look(), time.monotonic()))
            time.sleep(max(0.0, ASKED_EVERY - (time.monotonic() - looks[-1][1])))
        spent, took = processor_seconds(folder) - before, time.monotonic() - start
        memory = (folder / "smaps_rollup").read_text(encoding="ascii")
        (resident,) = (
            float(line.split()[1]) * 1024 for line in memory.splitlines() if line.startswith("Rss:")
        )
        return {
            PROCESSOR: [100 * spent / took],
            MEMORY: [resident],
            LOOK: [browser.size / 1000],
            LATCH: delays(hosts, looks, start, MEASURED),
        }


def delays(
    child: Child, looks: list[tuple[dict[str, bool], float]], start: float, seconds: float
) -> list[float]:
    """For each latch of that time how long it took until a look had it."""
    found = []
    while True:
        device, latched, at = child.line().split()
        if float(at) > start + seconds - 1.0:
            return found
        shown = (seen for told, seen in looks if seen > float(at) and told[device] == bool(int(latched)))
        if float(at) > start:
            found.append(next(shown) - float(at))


FIGURE = Figure(
    "The page of lfield watch, each vehicle told of 5 times a second",
    {f"{count} vehicles": watched(count) for count in TEAMS},
    rounds=3,
    units={PROCESSOR: PERCENT, MEMORY: BYTES, LATCH: SECONDS, LOOK: "kB"},
    sizes={f"{count} vehicles": count for count in TEAMS},
    targets={"50 vehicles: processor": "20.00 %"},
    notes=(
        "the process that serves it, one browser that asks 5 times a second; of one core",
        "every vehicle has a host of its own, and each host a link over a Unix socket",
    ),
)
