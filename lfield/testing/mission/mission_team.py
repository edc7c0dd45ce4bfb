"""A team under test: the mission of a deployment, in one process, on virtual time.

Hosts, VMs, guards and drivers are real, and use the simulated devices of `lfield up --sim` by their wire
protocols. Computers, network, cables, disks and clocks are models. A seed determines a run.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import MappingProxyType

from lfield.errors import MissionTestError, Stuck
from lfield.mission.loader import load_mission
from lfield.simulate.host_fleet import Fleet, FleetOptions, HostRun
from lfield.testing.mission import argument_checks
from lfield.testing.mission.call_record import CallRecorder, RecordedCall
from lfield.testing.mission.io_guard import IoGuard
from lfield.testing.mission.mission_fakes import FakeDevice, MissionFakes
from lfield.testing.mission.recorders import Hop, HopRecorder, Line, LineStops, Point, TrackRecorder
from lfield.testing.mission.resource_doubles import ResourceDoubles
from lfield.testing.mission.stuck_report import stuck_report
from lfield.testing.mission.stuck_watchdog import StuckInterrupt, StuckWatchdog
from lfield.testing.mission.track_picture import Mark
from lfield.testing.mission_operator import MissionOperator

#: Default limit of a wait, in seconds of virtual time.
DEFAULT_AT_MOST = 3600.0
#: Seconds for resources to write output after all coordinators have ended.
SETTLE_TIME = 120.0
#: Seconds between two checks of a condition.
POLL_INTERVAL = 0.02
#: The time of day when a team starts, in seconds since 1970, with the uncertainty of computers that know it.
DAY = (1.8e9, 1.8e9 + 0.5)
#: Metres that count as a move.
MOVED = 0.5
#: Seconds of real time for which virtual time may not advance, and for the creation of a team.
PATIENCE = 120.0
#: Lines shown of a host that has ended.
LAST_LINES = 5


class MissionTeam:
    """The team of the deployment `path`; see the module. Close it at the end.

    `doubles` replace resources: by agent, an object with a method for each portal. `fakes` are initial faults
    by device, as in `{"scout.fc": ["battery=0.3"]}`. Without `keeps` hosts have no journals. Raises
    LfieldError, and MissionTestError for invalid arguments.
    """

    def __init__(
        self,
        path: Path,
        *,
        seed: int = 0,
        doubles: Mapping[str, object] = MappingProxyType({}),
        fakes: Mapping[str, Sequence[str]] = MappingProxyType({}),
        keeps: bool = True,
    ) -> None:
        doubles = argument_checks.doubles(doubles)
        self._fakes = MissionFakes(argument_checks.initial_faults(fakes), self._mark)
        #: The ends of coordinators, with the epoch that ended, since hosts that are gone cannot report them.
        self._outcomes: dict[str, tuple[int, str]] = {}
        #: The test's interventions, for its picture; the hosts that it has ended.
        self.marks, self._ended_hosts = list[Mark](), set[str]()
        self._calls, self._hops = CallRecorder(lambda: self.now), HopRecorder(lambda: self.now)
        #: The awaited text, and how much of the log was searched for it.
        self._awaited, self._read = "", 0
        self._runs = self._is_closed = False
        self._guard = IoGuard()
        try:
            with self._running(), self._guarded():
                mission = self.mission = load_mission(path, simulate=True, doubled=doubles)
                self._doubles = ResourceDoubles(mission, doubles)
                self._raise_caught()
                self._lines = LineStops(mission.program, lambda after, event: self._fleet.later(after, event))
                self._fleet = Fleet(
                    mission,
                    argument_checks.seed(seed),
                    watch=self._watch,
                    on_start=self._on_host_start,
                    plug=self._fakes.plug,
                    options=FleetOptions(mission.bindings.unreachable_after, keeps=keeps, time_of_day=DAY[0]),
                )
                self._watch(self._fleet)
                self._operator = MissionOperator(self._fleet, mission.reading_hosts)
        except BaseException:
            self._guard.remove()
            raise
        for machine in self._fleet.machines.values():
            machine.set_day(DAY)
        self._tracks = TrackRecorder(self._fakes.devices, lambda: self.now, self._fleet.later)

    def _on_host_start(self, name: str, run: HostRun) -> None:
        machine = run.core.machine
        self._calls.observe(machine)
        self._doubles.attach(run)
        self._hops.observe(run)
        self._lines.attach(run)

    # --- time -----------------------------------------------------------------------------------------

    @property
    def now(self) -> float:
        """Seconds since the team started."""
        return self._fleet.now

    def run(
        self,
        seconds: float | None = None,
        *,
        until: str | Callable[[], bool] | None = None,
        until_done: bool = False,
        at_most: float = DEFAULT_AT_MOST,
    ) -> None:
        """Advances time for some seconds, or until a log line, a condition, or the end of all coordinators.

        Raises Stuck after `at_most` seconds, when the end cannot happen any more, or when time does not
        advance for PATIENCE seconds; also failures of doubles and real I/O, and MissionTestError.
        """
        argument_checks.check_one_end(seconds, until, until_done=until_done)
        at_most = argument_checks.seconds(at_most, "run(at_most=...)")
        with self._running(), self._guarded():
            if until_done:
                self._wait(lambda: self._have_ended, at_most, "the coordinators have not ended")
            elif callable(until):
                self._wait(until, at_most, "the condition has not become true")
            elif until is not None:
                self._awaited, self._read = until, len(self._fleet.log)
                self._wait(lambda: not self._awaited, at_most, f"no log line contains {until!r}")
            else:
                self._fleet.run(argument_checks.seconds(seconds, "run(...)"))

    def _wait(self, is_met: Callable[[], bool], at_most: float, reason: str) -> None:
        started_at, end, over = self.now, self.now + at_most, False
        while not is_met():
            if self.now >= end:
                duration = f"{self.now - started_at:.0f} s of the mission" + (
                    ", which has ended" if over else ""
                )
                raise Stuck(f"{reason} after {duration}", self._stuck_lines())
            self._fleet.run(POLL_INTERVAL)
            if self._awaited and not over and self._have_ended:
                over, end = True, min(end, self.now + SETTLE_TIME)
            if ended_hosts := self._fleet.computers.keys() - self._fleet.runs.keys() - self._ended_hosts:
                name = min(ended_hosts)
                raise Stuck(f"{reason}, and {name} has ended by itself", self._last_lines(name))

    @contextmanager
    def _guarded(self) -> Iterator[None]:
        """Runs code other than the test's, without real I/O and with a time limit."""
        try:
            with self._guard.running(), StuckWatchdog(PATIENCE, self._instant) as self._patience:
                yield
        except StuckInterrupt:
            raise self._stuck_error() from None
        except Exception:
            # Attempts at real I/O are reported even if they were caught, once each.
            self._raise_caught()
            raise

    def _instant(self) -> float:
        """Seconds of the mission; below 0 before its start."""
        return self._fleet.now if hasattr(self, "_fleet") else -1.0

    def _stuck_error(self) -> Stuck:
        at = self._instant()
        when = "before the mission has started" if at < 0.0 else f"at {at:.3f} s of the mission"
        by = f", held by {self._patience.holder}" if self._patience.holder else ""
        duration = f"time has not advanced for {PATIENCE:g} s of real time"
        return Stuck(f"{when} {duration}{by}", [] if at < 0.0 else self._stuck_lines())

    @contextmanager
    def _running(self) -> Iterator[None]:
        """Runs the mission, not nested; sys.exit is an error."""
        self._be_open()
        if self._runs:
            raise MissionTestError(
                "the team is running already: a double, an action or a condition cannot run it; a slow "
                "double returns After(seconds, value)"
            )
        self._runs = True
        try:
            yield
        except SystemExit as error:
            raise MissionTestError(
                f"code under test called sys.exit({error.code!r}); raise an exception, or return"
            ) from error
        finally:
            self._runs = False

    def _watch(self, fleet: Fleet) -> None:
        """Called after each event: raises failures, and stops at an awaited line."""
        if self._awaited and any(self._awaited in text for _, _, text in fleet.log[self._read :]):
            self._awaited = ""
            fleet.timeline.pause()
        self._read = len(fleet.log)
        self._doubles.release_monitors()
        if self._patience.has_expired:
            raise self._stuck_error()
        self._raise_caught()
        for failure in (*self._doubles.failures, *self._fakes.failures):
            raise failure
        if fleet.failed:
            raise Stuck("a host has ended because of a bug in lfield", self._last_lines())

    def _raise_caught(self) -> None:
        """Raises the first attempt at real I/O."""
        for error in self._guard.drain_caught():
            raise error

    def _stuck_lines(self) -> list[str]:
        return stuck_report(self._fleet, self.ended, self.hops)

    def _last_lines(self, host: str = "") -> list[str]:
        lines = [line for line in self.log if host in ("", line.host)]
        return [f"{line.host} logged: {line.text}" for line in lines[-LAST_LINES:]]

    # --- recorded data --------------------------------------------------------------------------------

    @property
    def log(self) -> list[Line]:
        """All lines written by programs and hosts, in order."""
        return [
            Line(at, host, line) for at, host, text in self._fleet.log for line in text.splitlines() if line
        ]

    def said(self, text: str, host: str = "") -> int:
        """Counts lines that contain a text, of one host or of all."""
        return sum(text in line.text and host in ("", line.host) for line in self.log)

    @property
    def calls(self) -> list[RecordedCall]:
        """Every portal call that has started, in order."""
        return self._calls.record

    @property
    def hops(self) -> list[Hop]:
        """Every hop of every coordinator, in order."""
        return self._hops.record

    @property
    def tracks(self) -> dict[str, list[Point]]:
        """The true position of each device, every tenth of a second."""
        return self._tracks.record

    @property
    def has_moved(self) -> bool:
        """Whether any device has moved."""
        return any(math.dist(points[0][1:], p[1:]) > MOVED for points in self.tracks.values() for p in points)

    @property
    def ended(self) -> dict[str, str]:
        """The ends of coordinators: `done`, `died`, `lost`."""
        self._learn()
        return {agent: outcome for agent, (_, outcome) in self._outcomes.items() if outcome}

    def _learn(self) -> None:
        """Collects the ends of coordinators from running hosts."""
        found = self._outcomes
        for run in self._fleet.runs.values():
            for known in run.core.mobility.known_states():
                over = known.outcome if known.state == "EXITED" and known.outcome != "superseded" else ""
                found[known.agent] = max(found.get(known.agent, (0, "")), (known.generation, over))

    @property
    def _have_ended(self) -> bool:
        """Whether all coordinators have ended, but for startable ones that were not started."""
        ended, team = self.ended, self.mission.team
        started = {agent for agent in team.startable if agent in self._outcomes}
        return set(ended) >= {*started, *(member.id for member in team.initial_coordinators)}

    # --- interventions --------------------------------------------------------------------------------

    def fake(self, device: str) -> FakeDevice:
        """The simulation of a device, by its name. Raises MissionTestError."""
        self._be_open()
        if device not in self._fakes.devices:
            known = ", ".join(sorted(self._fakes.devices)) or "none"
            raise MissionTestError(f"there is no simulated device '{device}' here; there are: {known}")
        return self._fakes.devices[device]

    def at(self, seconds: float, action: Callable[[], None]) -> None:
        """Runs an action at a time in seconds since the team started; immediately if that is past.

        Raises MissionTestError.
        """
        self._be_open()
        call = f"at({seconds!r}, ...)"
        self._fleet.timeline.at(argument_checks.seconds(seconds, call), argument_checks.action(action, call))

    def when(self, line: str, action: Callable[[], None]) -> None:
        """Runs an action once when any agent reaches `mission.L:42`. Raises MissionTestError."""
        self._be_open()
        self._lines.when(argument_checks.line(line), argument_checks.action(action, f"when({line!r}, ...)"))

    def cut(self, one: str, other: str) -> None:
        """Breaks the connections of two hosts until `heal`."""
        self._fleet.cut(*self._host_pair(one, other))
        self._mark(f"{one} and {other} are disconnected")

    def heal(self, one: str, other: str) -> None:
        """Restores the connection of two hosts."""
        self._fleet.heal(*self._host_pair(one, other))
        self._mark(f"{one} and {other} are connected again")

    def crash(self, host: str) -> None:
        """Kills the process of a host; its guards live on until their devices are safe."""
        self._ended_hosts.add(self._host(host))
        if host in self._fleet.runs:
            self._fleet.crash(host)
            self._mark(f"{host} is killed")

    def power_off(self, host: str) -> None:
        """Switches off the computer of a host with all its processes; not its hardware."""
        self._ended_hosts.add(self._host(host))
        self._fleet.power_off(host)
        self._mark(f"{host} is switched off")

    def boot(self, host: str) -> None:
        """Starts a host again, and its computer if that is off."""
        self._ended_hosts.discard(self._host(host))
        if host not in self._fleet.runs:
            self._fleet.boot(host)
            self._mark(f"{host} is restarted")

    def stop(self, *hosts: str) -> None:
        """Stops hosts, or all, as by SIGTERM: their devices come to rest first."""
        self._be_open()
        for host in hosts or tuple(self._fleet.runs):
            self._ended_hosts.add(self._host(host))
            if host in self._fleet.runs:
                self._fleet.stop(host)

    def pause(self) -> None:
        """Pauses as `lfield pause`: no program runs, and devices come to rest, until `resume`."""
        self._pause(lift=False)
        self._mark("the mission is paused")

    def resume(self) -> None:
        """Resumes all programs."""
        self._pause(lift=True)
        self._mark("the mission is resumed")

    def _pause(self, *, lift: bool) -> None:
        self._be_open()
        self._operator.pause(lift=lift)

    def type_line(self, host: str, text: str) -> None:
        """Enters a line of input for `read` where a host runs; kept until a resource reads it."""
        self._operator.type_line(self._host(host), text)

    def close(self) -> None:
        """Ends all processes immediately; recorded data remains.

        Raises MissionTestError within a run, and for unreported real I/O.
        """
        if self._runs:
            raise MissionTestError("the team is running: a double, an action or a condition cannot close it")
        self._learn()
        self._is_closed = True
        try:
            self._fleet.close()
        finally:
            self._guard.remove()
        self._raise_caught()

    def _be_open(self) -> None:
        if self._is_closed:
            raise MissionTestError(
                "this team is closed; only its recorded data is available: open another one"
            )

    def _mark(self, text: str, device: str = "") -> None:
        self._be_open()
        self.marks.append(Mark(self.now, device, text))

    def _host_pair(self, one: str, other: str) -> tuple[str, str]:
        if one == other:
            raise MissionTestError(f"{one} is given twice; name two hosts")
        return self._host(one), self._host(other)

    def _host(self, name: str) -> str:
        self._be_open()
        if not isinstance(name, str) or name not in self._fleet.computers:
            known = ", ".join(self._fleet.computers)
            raise MissionTestError(f"there is no host {name!r}; there are: {known}")
        return name
