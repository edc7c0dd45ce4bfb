"""One trial: a host and its guard keep a device moving, one or both die, and what becomes of the device.

Trials go on side by side: each is a generator that yields while it waits (`together`).
"""

from __future__ import annotations

import os
import random
import signal
import time
from collections.abc import Generator, Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

from deaths.device_log import DeviceLog, Verdict, judge
from deaths.devices import Device
from harness.checkout import Checkout, Mission, sign
from harness.processes import Child, Processes

#: Seconds between two looks, from the start of a host until its device moves, and until a guard that is left
#: alone has ended.
POLL_INTERVAL, MOVES_WITHIN, ENDS_WITHIN = 0.02, 30.0, 20.0
#: Seconds from a death to the safe state and to rest, at most, and for which the rest is watched.
SAFE_WITHIN, REST_WITHIN, WATCHED = 15.0, 30.0, 0.3
#: Death comes at a random moment in so many seconds after the device was first seen to move.
EARLIEST, LATEST = 0.3, 1.8
#: So often a host is started whose device does not move, or had stopped before its death came; and how much
#: of what it said is kept.
STARTS, LAST_LINES = 10, 6
#: So many hosts start at a time: most of it is a second in which each measures how late it is.
STARTING = 5
_STATION = Path(__file__).with_name("station.py")
_PROGRAM = Path(__file__).with_name("moves.L").read_text(encoding="utf-8")


@dataclass(frozen=True)
class Death:
    """Who dies, and of which signal."""

    who: Sequence[str]
    number: signal.Signals

    def __str__(self) -> str:
        return f"{'both' if len(self.who) > 1 else self.who[0]} {self.number.name}"


DEATHS = tuple(
    Death(who, number)
    for who in (("host",), ("guard",), ("host", "guard"))
    for number in (signal.SIGKILL, signal.SIGSTOP)
)


@dataclass
class Outcome:
    """The outcome of a trial.

    `why` it failed, '' if it did not; `starts` of hosts until the device moved at the death; `before`: the
    output of hosts that did not keep it moving; `lines` of the device's log after the death.
    """

    device: str
    death: str
    way: str
    verdict: Verdict = field(default_factory=Verdict)
    why: str = ""
    starts: int = 0
    lines: Sequence[str] = ()
    before: list[str] = field(default_factory=list)


class Subject:
    """A fake of one device, and what is run on it, with each of some bounds of the host's silence (s)."""

    def __init__(
        self, checkout: Checkout, processes: Processes, device: Device, silences: Iterable[float]
    ) -> None:
        self.device, self._checkout = device, checkout
        folder = processes.folder()
        endpoint = checkout.fake(processes, *device.fake, "--log", str(folder / "device.log"))
        self.log = DeviceLog(folder / "device.log")
        if device.station:
            checkout.run(processes, str(_STATION), endpoint)
        # Bundles, so that no trial compiles.
        self._bundles = {
            (way, silence): self._build(processes, way, self.device.bindings % (endpoint, silence))
            for way in device.ways
            for silence in set(silences)
        }

    def _build(self, processes: Processes, way: str, bindings: str) -> list[str]:
        """The words that run the bundle of one way to move."""
        agents = [f"//{self.device.resource}:a@here?{way}"]
        mission = Mission(processes.folder(), _PROGRAM, agents, bindings)
        self._checkout.lfield(processes, "build", str(mission.deploy), merged=True).wait()
        bundle, memory = mission.deploy.with_suffix(".lfm"), self._checkout.keeping_nothing
        sign(bundle)
        return [str(bundle), "--host", "here", *memory, *mission.arguments[2:]]

    def start_host(self, processes: Processes, way: str, silence: float) -> Child:
        """A host that keeps the device moving."""
        return self._checkout.lfield(processes, "up", *self._bundles[way, silence], merged=True)


@dataclass
class Wave:
    """Trials that go on side by side. Hosts start a few at a time: a crowd makes each of them late.

    The hosts end with `processes` at the latest; each may be silent for `silence` seconds.
    """

    processes: Processes
    silence: float
    rng: random.Random
    starting: set[int] = field(default_factory=set)


class Trial:
    """One death. `start`, `die` and `end` are to be gone through in this order."""

    def __init__(self, subject: Subject, death: Death, way: str, wave: Wave) -> None:
        self._subject, self._death, self._way, self._wave = subject, death, way, wave
        self._guards: dict[int, str] = {}
        self._host: Child | None = None
        self._lines: list[str] = []
        self.outcome = Outcome(subject.device.name, str(death), way)

    # -- before ---------------------------------------------------------------------------------------

    def start(self) -> Iterator[None]:
        """Until the device moves."""
        while not self._gives_up():
            if (yield from self._moves_by_a_host()):
                return
            yield from self.end()

    def _gives_up(self) -> bool:
        if self.outcome.starts >= STARTS:
            self.outcome.why = f"no death could be tried on it: {self.outcome.before[-1]}"
        return bool(self.outcome.why)

    def _moves_by_a_host(self) -> Generator[None, None, bool]:
        """Start a host; whether it brought the device to move."""
        wave = self._wave
        while len(wave.starting) >= STARTING:
            yield
        self.outcome.starts += 1
        self._lines = []
        self._host = self._subject.start_host(wave.processes, self._way, wave.silence)
        start = time.monotonic()
        wave.starting.add(id(self))
        while not self._moves():
            stopped = any(line.startswith("stopped") for line in self._lines) or not _born(self._host.pid)
            if stopped or time.monotonic() > start + MOVES_WITHIN:
                self._complain()
                wave.starting.discard(id(self))
                return False
            if any(" listening " in line for line in self._lines):
                wave.starting.discard(id(self))
            yield
        wave.starting.discard(id(self))
        return True

    def _complain(self) -> None:
        """Keep why the device does not move: no death can be tried on it."""
        self._listen()
        self.outcome.before.append(" | ".join(self._lines[-LAST_LINES:]))

    def _moves(self) -> bool:
        """Whether the device moves as its program requires."""
        self._listen()
        now = self._subject.log.now
        moves = "moves" in self._lines and now["moving"] == "yes" and not self._subject.device.safe(now, now)
        return moves and self._host is not None and len(_children(self._host.pid)) == 1

    def _listen(self) -> None:
        self._subject.log.read()
        if self._host is not None:
            self._lines += self._host.lines()

    # -- the death ------------------------------------------------------------------------------------

    def die(self) -> Iterator[None]:
        """Until the device has been at rest for a while after the death, or had its time."""
        yield from self._until_the_moment()
        if self.outcome.why:
            return
        log, device = self._subject.log, self._subject.device
        start, verdict = log.forget(), Verdict()
        try:
            death = self._kill()
        except (ValueError, ProcessLookupError):
            self.outcome.why = f"somebody was dead before: {self._lines[-1]}"
            return
        while not _over(verdict, time.monotonic() - death):
            yield
            self._listen()
            verdict = judge(device, start, log.changes, death)
        self.outcome.verdict = verdict
        self.outcome.lines = [f"{change.at - death:.3f} {change}" for change in log.changes]
        if verdict.safe is None:
            self.outcome.why = f"not safe within {SAFE_WITHIN:g} s"
        elif "guard" in self._death.who and verdict.safe > device.bound:
            self.outcome.why = f"safe after {verdict.safe:.1f} s; {device.bound:g} s are its bound"
        elif verdict.rest is None:
            self.outcome.why = f"safe, but not at rest within {REST_WITHIN:g} s"

    def _until_the_moment(self) -> Iterator[None]:
        """A random while. A device that somebody has stopped meanwhile is made to move again."""
        while not self.outcome.why:
            moment = time.monotonic() + self._wave.rng.uniform(EARLIEST, LATEST)
            while time.monotonic() < moment:
                yield
            if self._moves():
                return
            self._complain()
            yield from self.end()
            yield from self.start()

    def _kill(self) -> float:
        """Send the signals; when, on CLOCK_MONOTONIC."""
        assert self._host is not None
        (guard,) = _children(self._host.pid)
        self._guards[guard] = _born(guard)
        victims = [{"host": self._host.pid, "guard": guard}[who] for who in self._death.who]
        self._wave.rng.shuffle(victims)
        death = time.monotonic()
        for victim in victims:
            os.kill(victim, self._death.number)
        return death

    # -- after ----------------------------------------------------------------------------------------

    def end(self) -> Iterator[None]:
        """Kill the host and whom we have stopped; wait for guards that end by themselves."""
        self.end_host()
        start = time.monotonic()
        while self._lives():
            if time.monotonic() > start + ENDS_WITHIN:
                self.kill_guards()
                self.outcome.why = self.outcome.why or f"its guard had not ended after {ENDS_WITHIN:g} s"
            yield

    def end_host(self) -> None:
        """Kill it, and the guard that we have stopped."""
        if self._host is None:
            return
        # First stopped: it must not start another guard while we look.
        os.kill(self._host.pid, signal.SIGSTOP)
        for pid in _children(self._host.pid):
            self._guards.setdefault(pid, _born(pid))
        self._listen()
        self._host.end()
        self._host = None
        for pid in self._lives():
            if _state(pid) == "T":
                os.kill(pid, signal.SIGKILL)

    def kill_guards(self) -> None:
        """Leave nobody behind."""
        for pid in self._lives():
            with suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)

    def _lives(self) -> list[int]:
        """Guards that have not ended."""
        return [pid for pid, born in self._guards.items() if born and _born(pid) == born]


def _over(verdict: Verdict, since: float) -> bool:
    if verdict.rest is not None:
        return since > verdict.rest + WATCHED
    return since > (SAFE_WITHIN if verdict.safe is None else REST_WITHIN)


def together(works: Iterable[Iterator[None]]) -> None:
    """Let all go on, side by side, until each has ended."""
    going = list(works)
    while going:
        going = [work for work in going if next(work, work) is None]
        time.sleep(POLL_INTERVAL)


def _children(pid: int) -> list[int]:
    try:
        return [int(word) for word in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]
    except OSError:
        return []


def _stat(pid: int) -> list[str]:
    """The fields of /proc/PID/stat behind the name: the state is the first, the start the twentieth."""
    try:
        return Path(f"/proc/{pid}/stat").read_text(encoding="ascii").rpartition(")")[2].split()
    except OSError:
        return []


def _state(pid: int) -> str:
    return (_stat(pid) or [""])[0]


def _born(pid: int) -> str:
    """The start time of a process, which distinguishes processes with the same id; '' if it has ended."""
    fields = _stat(pid)
    return "" if not fields or fields[0] in "ZX" else fields[19]
