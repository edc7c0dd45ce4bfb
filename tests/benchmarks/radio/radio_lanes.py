"""Processes that print how long something took, each on a radio of its own, watched together."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from emulator.cells import CELLS
from emulator.radio import Radio
from harness.processes import Child, ChildError
from radio.radio_team import DESK

#: Seconds between two looks at what processes have printed, without a sample before a lane has failed.
POLL_INTERVAL, PATIENCE = 0.005, 240.0


@dataclass
class Lane:
    """A process that prints `KEY = SECONDS`, and its radio."""

    radio: Radio
    child: Child
    key: str
    #: Seconds of each sample since `start`, and when it came (monotonic, s).
    samples: list[float] = field(default_factory=list)
    times: list[float] = field(default_factory=list)
    #: The last other line.
    said: str = ""
    _skip: int = 0

    def start(self, cell: str, skip: int = 0) -> None:
        """Set the radio and measure from here, without the next samples: the cell was another in them."""
        self.radio.set(CELLS[cell])
        self.read_output()
        self.samples.clear()
        self.times.clear()
        self._skip = 1 + skip

    def read_output(self) -> None:
        """Take what the process has printed. Raises ChildError for a line `error: ...`."""
        for line in self.child.lines():
            key, equals, value = line.partition(" = ")
            if equals and key == self.key:
                self._sample(float(value))
            elif line.startswith("error: "):
                raise ChildError(line.removeprefix("error: "))
            else:
                self.said = line
                self.on_line(line)

    def on_line(self, line: str) -> None:
        """Something else was printed."""

    def _sample(self, seconds: float) -> None:
        if self._skip:
            self._skip -= 1
            return
        self.samples.append(seconds)
        self.times.append(time.monotonic())


@dataclass
class StopLane(Lane):
    """A desk that stops and lifts (radio_desk.py), and what each stop has sent to it and from it, in bytes.

    What its links send by themselves is measured in the rest before, and subtracted.
    """

    sizes: list[float] = field(default_factory=list)
    #: Bytes per second of the desk's links at rest.
    idle: list[float] = field(default_factory=list)
    #: Lines that say why a stop was pressed again.
    again: list[str] = field(default_factory=list)
    _since: float = 0.0

    def start(self, cell: str, skip: int = 0) -> None:
        super().start(cell, skip)
        for kept in (self.sizes, self.idle, self.again):
            kept.clear()

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


def watch(lanes: Sequence[Lane], done: Callable[[], bool], patience: float = PATIENCE) -> None:
    """Look at lanes until it is done. Raises ChildError when one of them has no sample for too long."""
    counts, last = [-1] * len(lanes), [0.0] * len(lanes)
    while not done():
        now = time.monotonic()
        for n, lane in enumerate(lanes):
            lane.read_output()
            if len(lane.samples) != counts[n]:
                counts[n], last[n] = len(lane.samples), now
            elif now - last[n] > patience:
                raise ChildError(f"no sample within {patience:g} s; the last line was: {lane.said}")
        time.sleep(POLL_INTERVAL)


def collect(lanes: Sequence[Lane], cell: str, count: int, skip: int = 0) -> list[float]:
    """So many samples of a cell: of every lane the same number, lest slow ones be left out at the end."""
    each = -(-count // len(lanes))
    for lane in lanes:
        lane.start(cell, skip)
    watch(lanes, lambda: all(len(lane.samples) >= each for lane in lanes))
    return [sample for lane in lanes for sample in lane.samples[:each]]


def outages(lanes: Sequence[Lane], robot: str, seconds: float) -> list[float]:
    """Cut a robot of each lane off: seconds from the path's return until something was completed."""
    returns = [lane.radio.cut(seconds, robot) for lane in lanes]
    pairs = list(zip(lanes, returns, strict=True))
    watch(lanes, lambda: all(_after(lane, back) for lane, back in pairs), PATIENCE + seconds)
    return [_after(lane, back)[0] - back for lane, back in pairs]


def address_changes(lanes: Sequence[Lane], robot: str, address: str, within: float) -> list[float]:
    """Give a robot of each lane another address: seconds until something was completed, `within` at most.

    In the end each has its first address again, and something was completed with that.
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
    # What was complete before is not taken for what comes after.
    lane.read_output()
    return time.monotonic()


def _after(lane: Lane, moment: float) -> list[float]:
    return [at for at in lane.times if at > moment]
