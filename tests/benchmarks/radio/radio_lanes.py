"""Lanes: processes that print measured seconds, each on its own radio, polled together."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from emulator.cells import CELLS
from emulator.radio import Radio
from harness.processes import Child, ChildError
from radio.radio_team import DESK

#: Seconds between two polls of the processes' output; seconds without a sample after which a lane has failed.
POLL_INTERVAL, TIMEOUT = 0.005, 240.0


@dataclass
class Lane:
    """A process that prints `KEY = SECONDS`, and its radio."""

    radio: Radio
    child: Child
    key: str
    #: Seconds of each sample since `start`, and its monotonic time of arrival (s).
    samples: list[float] = field(default_factory=list)
    times: list[float] = field(default_factory=list)
    #: The last line that is not a sample.
    last_line: str = ""
    _skip: int = 0

    def start(self, cell: str, skip: int = 0) -> None:
        """Set the radio and restart the measurement. Skips the next samples, which began in another cell."""
        self.radio.set(CELLS[cell])
        self.read_output()
        self.samples.clear()
        self.times.clear()
        self._skip = 1 + skip

    def read_output(self) -> None:
        """Read the output of the process. Raises ChildError for a line `error: ...`."""
        for line in self.child.lines():
            key, equals, value = line.partition(" = ")
            if equals and key == self.key:
                self._sample(float(value))
            elif line.startswith("error: "):
                raise ChildError(line.removeprefix("error: "))
            else:
                self.last_line = line
                self.on_line(line)

    def on_line(self, line: str) -> None:
        """Handle a line that is not a sample."""

    def _sample(self, seconds: float) -> None:
        if self._skip:
            self._skip -= 1
            return
        self.samples.append(seconds)
        self.times.append(time.monotonic())


@dataclass
class StopLane(Lane):
    """A desk that stops and lifts (radio_desk.py), and the bytes to and from it for each stop.

    The idle traffic of its links is measured in the pause before, and subtracted.
    """

    sizes: list[float] = field(default_factory=list)
    #: Bytes per second of the desk's links at rest.
    idle: list[float] = field(default_factory=list)
    #: Lines with the reason for a repeated stop.
    again: list[str] = field(default_factory=list)
    _since: float = 0.0

    def start(self, cell: str, skip: int = 0) -> None:
        super().start(cell, skip)
        for samples in (self.sizes, self.idle, self.again):
            samples.clear()

    def on_line(self, line: str) -> None:
        if line.startswith("again: "):
            self.again.append(line)
        if line not in ("lifted", "stopping", "lifting"):
            return
        flows = self.radio.counts().items()
        sent = sum(count.bytes for flow, count in flows if DESK in (flow.source, flow.to))
        now = time.monotonic()
        took, self._since = now - self._since, now
        self.radio.reset()
        if line == "stopping":
            self.idle.append(sent / took)
        elif line == "lifting" and self.idle:
            self.sizes.append(max(0.0, sent - self.idle[-1] * took))


def watch(lanes: Sequence[Lane], done: Callable[[], bool], timeout: float = TIMEOUT) -> None:
    """Poll lanes until `done`. Raises ChildError for a lane without a sample for `timeout` seconds."""
    counts, last = [-1] * len(lanes), [0.0] * len(lanes)
    while not done():
        now = time.monotonic()
        for n, lane in enumerate(lanes):
            lane.read_output()
            if len(lane.samples) != counts[n]:
                counts[n], last[n] = len(lane.samples), now
            elif now - last[n] > timeout:
                raise ChildError(f"no sample within {timeout:g} s; the last line was: {lane.last_line}")
        time.sleep(POLL_INTERVAL)


def collect(lanes: Sequence[Lane], cell: str, count: int, skip: int = 0) -> list[float]:
    """Collect `count` samples of a cell, the same number from every lane, also from slow ones."""
    each = -(-count // len(lanes))
    for lane in lanes:
        lane.start(cell, skip)
    watch(lanes, lambda: all(len(lane.samples) >= each for lane in lanes))
    return [sample for lane in lanes for sample in lane.samples[:each]]


def outages(lanes: Sequence[Lane], robot: str, seconds: float) -> list[float]:
    """Cut off a robot of each lane; returns seconds from the path's return until the next sample."""
    returns = [lane.radio.cut(seconds, robot) for lane in lanes]
    pairs = list(zip(lanes, returns, strict=True))
    watch(lanes, lambda: all(_after(lane, back) for lane, back in pairs), TIMEOUT + seconds)
    return [_after(lane, back)[0] - back for lane, back in pairs]


def address_changes(lanes: Sequence[Lane], robot: str, address: str, within: float) -> list[float]:
    """Change the address of a robot of each lane; returns seconds until the next sample, at most `within`.

    At the end each robot has its first address again, and a sample was completed with it.
    """
    homes = [lane.radio[robot].address for lane in lanes]
    moved = [(lane, _move(lane, robot, address)) for lane in lanes]
    end = time.monotonic() + within
    watch(lanes, lambda: time.monotonic() > end or all(_after(lane, at) for lane, at in moved))
    delays = [min([after - at for after in _after(lane, at)[:1]] + [within]) for lane, at in moved]
    back = [(lane, _move(lane, robot, home)) for lane, home in zip(lanes, homes, strict=True)]
    watch(lanes, lambda: all(_after(lane, at) for lane, at in back))
    return delays


def _move(lane: Lane, robot: str, address: str) -> float:
    lane.radio[robot].move(address)
    # Read earlier samples, which must not count for the new address.
    lane.read_output()
    return time.monotonic()


def _after(lane: Lane, moment: float) -> list[float]:
    return [at for at in lane.times if at > moment]
