"""One trial: a host and its guard keep a device moving, one or both fail, and the device's log is judged.

Trials run in parallel: each is a generator that yields while it waits (`run_in_parallel`).
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

#: Seconds between two polls, from the start of a host until its device moves, and until a guard without a
#: host has ended.
POLL_INTERVAL, MOVES_WITHIN, ENDS_WITHIN = 0.02, 30.0, 20.0
#: The most seconds from a failure to the safe state and to rest, and seconds for which the rest is observed.
SAFE_WITHIN, REST_WITHIN, WATCHED = 15.0, 30.0, 0.3
#: The failure occurs at a random time between these seconds after the first movement of the device.
EARLIEST, LATEST = 0.3, 1.8
#: Starts of a host whose device does not move or stops before the failure; recorded lines of its output.
STARTS, LAST_LINES = 10, 6
#: Hosts that start at a time: a start is mostly one second in which the host measures its scheduling delay.
STARTING = 5
_STATION = Path(__file__).with_name("station.py")
_PROGRAM = Path(__file__).with_name("moves.L").read_text(encoding="utf-8")


@dataclass(frozen=True)
class Death:
    """The processes that fail, and the signal."""

    targets: Sequence[str]
    number: signal.Signals

    def __str__(self) -> str:
        return f"{'both' if len(self.targets) > 1 else self.targets[0]} {self.number.name}"


DEATHS = tuple(
    Death(targets, number)
    for targets in (("host",), ("guard",), ("host", "guard"))
    for number in (signal.SIGKILL, signal.SIGSTOP)
)


@dataclass
class Outcome:
    """The outcome of a trial.

    `why` is the reason of a failed trial, or ''. `starts` counts host starts until the device moved at the
    failure. `before` has the output of hosts that did not keep it moving, `lines` the device's log after the
    failure.
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
    """A fake of one device, and a bundle for each way to move and each bound of the host's silence (s)."""

    def __init__(
        self, checkout: Checkout, processes: Processes, device: Device, silences: Iterable[float]
    ) -> None:
        self.device, self._checkout = device, checkout
        folder = processes.folder()
        endpoint = checkout.fake(processes, *device.fake, "--log", str(folder / "device.log"))
        self.log = DeviceLog(folder / "device.log")
        if device.station:
            checkout.run(processes, str(_STATION), endpoint)
        # Built once, so that no trial compiles.
        self._bundles = {
            (way, silence): self._build(processes, way, self.device.bindings % (endpoint, silence))
            for way in device.ways
            for silence in set(silences)
        }

    def _build(self, processes: Processes, way: str, bindings: str) -> list[str]:
        """Build the bundle of one way to move; returns the arguments that run it."""
        agents = [f"//{self.device.resource}:a@here?{way}"]
        mission = Mission(processes.folder(), _PROGRAM, agents, bindings)
        self._checkout.lfield(processes, "build", str(mission.deploy), merged=True).wait()
        bundle, memory = mission.deploy.with_suffix(".lfm"), self._checkout.keeping_nothing
        sign(bundle)
        return [str(bundle), "--host", "here", *memory, *mission.arguments[2:]]

    def start_host(self, processes: Processes, way: str, silence: float) -> Child:
        """Start a host that keeps the device moving."""
        return self._checkout.lfield(processes, "up", *self._bundles[way, silence], merged=True)


@dataclass
class Wave:
    """Trials that run in parallel. Few hosts start at a time, because simultaneous starts delay one another.

    The hosts end with `processes` at the latest; each may be silent for `silence` seconds.
    """

    processes: Processes
    silence: float
    rng: random.Random
    starting: set[int] = field(default_factory=set)


class Trial:
    """One process failure. Run `start`, `run_failure` and `end` in this order."""

    def __init__(self, subject: Subject, death: Death, way: str, wave: Wave) -> None:
        self._subject, self._death, self._way, self._wave = subject, death, way, wave
        self._guards: dict[int, str] = {}
        self._host: Child | None = None
        self._lines: list[str] = []
        self.outcome = Outcome(subject.device.name, str(death), way)

    # -- before the failure ---------------------------------------------------------------------------

    def start(self) -> Iterator[None]:
        """Start hosts until the device moves."""
        while not self._is_abandoned():
            if (yield from self._start_until_moving()):
                return
            yield from self.end()

    def _is_abandoned(self) -> bool:
        if self.outcome.starts >= STARTS:
            self.outcome.why = f"device did not move: {self.outcome.before[-1]}"
        return bool(self.outcome.why)

    def _start_until_moving(self) -> Generator[None, None, bool]:
        """Start a host; returns true once the device moves."""
        wave = self._wave
        while len(wave.starting) >= STARTING:
            yield
        self.outcome.starts += 1
        self._lines = []
        self._host = self._subject.start_host(wave.processes, self._way, wave.silence)
        start = time.monotonic()
        wave.starting.add(id(self))
        while not self._is_moving():
            stopped = any(line.startswith("stopped") for line in self._lines) or not _start_time(
                self._host.pid
            )
            if stopped or time.monotonic() > start + MOVES_WITHIN:
                self._record_output()
                wave.starting.discard(id(self))
                return False
            if any(" listening " in line for line in self._lines):
                wave.starting.discard(id(self))
            yield
        wave.starting.discard(id(self))
        return True

    def _record_output(self) -> None:
        """Record the output of a host whose device does not move."""
        self._read_logs()
        self.outcome.before.append(" | ".join(self._lines[-LAST_LINES:]))

    def _is_moving(self) -> bool:
        """Return true if the device moves as its program requires."""
        self._read_logs()
        now = self._subject.log.now
        moves = "moves" in self._lines and now["moving"] == "yes" and not self._subject.device.safe(now, now)
        return moves and self._host is not None and len(_children(self._host.pid)) == 1

    def _read_logs(self) -> None:
        self._subject.log.read()
        if self._host is not None:
            self._lines += self._host.lines()

    # -- the failure ----------------------------------------------------------------------------------

    def run_failure(self) -> Iterator[None]:
        """Signal the processes, then read the log until the device has been at rest or is too late."""
        yield from self._wait_for_random_time()
        if self.outcome.why:
            return
        log, device = self._subject.log, self._subject.device
        start, verdict = log.mark_start(), Verdict()
        try:
            death = self._kill()
        except (ValueError, ProcessLookupError):
            self.outcome.why = f"a process ended before the signal: {self._lines[-1]}"
            return
        while not _is_finished(verdict, time.monotonic() - death):
            yield
            self._read_logs()
            verdict = judge(device, start, log.changes, death)
        self.outcome.verdict = verdict
        self.outcome.lines = [f"{change.at - death:.3f} {change}" for change in log.changes]
        if verdict.safe is None:
            self.outcome.why = f"not safe within {SAFE_WITHIN:g} s"
        elif "guard" in self._death.targets and verdict.safe > device.bound:
            self.outcome.why = f"safe after {verdict.safe:.1f} s; the bound is {device.bound:g} s"
        elif verdict.rest is None:
            self.outcome.why = f"safe, but not at rest within {REST_WITHIN:g} s"

    def _wait_for_random_time(self) -> Iterator[None]:
        """Wait for a random time. A device that has stopped meanwhile is moved again by a new host."""
        while not self.outcome.why:
            moment = time.monotonic() + self._wave.rng.uniform(EARLIEST, LATEST)
            while time.monotonic() < moment:
                yield
            if self._is_moving():
                return
            self._record_output()
            yield from self.end()
            yield from self.start()

    def _kill(self) -> float:
        """Send the signals; returns their time on CLOCK_MONOTONIC."""
        assert self._host is not None
        (guard,) = _children(self._host.pid)
        self._guards[guard] = _start_time(guard)
        pids = {"host": self._host.pid, "guard": guard}
        victims = [pids[target] for target in self._death.targets]
        self._wave.rng.shuffle(victims)
        death = time.monotonic()
        for victim in victims:
            os.kill(victim, self._death.number)
        return death

    # -- after the failure ----------------------------------------------------------------------------

    def end(self) -> Iterator[None]:
        """Kill the host and the stopped guard; wait until the other guards have ended."""
        self.end_host()
        start = time.monotonic()
        while self._running_guards():
            if time.monotonic() > start + ENDS_WITHIN:
                self.kill_guards()
                self.outcome.why = self.outcome.why or f"guard still running after {ENDS_WITHIN:g} s"
            yield

    def end_host(self) -> None:
        """Kill the host and the stopped guard."""
        if self._host is None:
            return
        # A stopped host cannot start another guard while its children are listed.
        os.kill(self._host.pid, signal.SIGSTOP)
        for pid in _children(self._host.pid):
            self._guards.setdefault(pid, _start_time(pid))
        self._read_logs()
        self._host.end()
        self._host = None
        for pid in self._running_guards():
            if _state(pid) == "T":
                os.kill(pid, signal.SIGKILL)

    def kill_guards(self) -> None:
        """Kill the guards that still run."""
        for pid in self._running_guards():
            with suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)

    def _running_guards(self) -> list[int]:
        """The guards that have not ended."""
        return [pid for pid, started in self._guards.items() if started and _start_time(pid) == started]


def _is_finished(verdict: Verdict, since: float) -> bool:
    if verdict.rest is not None:
        return since > verdict.rest + WATCHED
    return since > (SAFE_WITHIN if verdict.safe is None else REST_WITHIN)


def run_in_parallel(works: Iterable[Iterator[None]]) -> None:
    """Run all generators in turns until each has ended."""
    running = list(works)
    while running:
        running = [work for work in running if next(work, work) is None]
        time.sleep(POLL_INTERVAL)


def _children(pid: int) -> list[int]:
    try:
        return [int(word) for word in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]
    except OSError:
        return []


def _stat(pid: int) -> list[str]:
    """The fields of /proc/PID/stat after the name: the state is the first, the start time the twentieth."""
    try:
        return Path(f"/proc/{pid}/stat").read_text(encoding="ascii").rpartition(")")[2].split()
    except OSError:
        return []


def _state(pid: int) -> str:
    return (_stat(pid) or [""])[0]


def _start_time(pid: int) -> str:
    """The start time of a process, which distinguishes processes with the same id; '' if it has ended."""
    fields = _stat(pid)
    return "" if not fields or fields[0] in "ZX" else fields[19]
