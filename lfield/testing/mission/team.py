"""A team under test: the mission of a deployment, in one process, on virtual time.

What runs are hosts, machines, guards and drivers of a robot, against the fakes of `lfield up --sim`, by their
wire protocols. Only what is below is a model: computers, network, cables, disks, clocks. A seed is one run.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import cast

from lfield.authority.identity import ALL, Identity
from lfield.errors import MissionTestError, Stuck
from lfield.mission.load import load_mission
from lfield.net.transport import Link
from lfield.simulate.fleet import Fleet, Life
from lfield.testing.mission import asked
from lfield.testing.mission.calls import Calls, PortalCall
from lfield.testing.mission.doubles import Doubles
from lfield.testing.mission.fakes import FakeDevice, Fakes
from lfield.testing.mission.fence import Fence
from lfield.testing.mission.patience import Held, Patience
from lfield.testing.mission.picture import Mark
from lfield.testing.mission.standing import standing
from lfield.testing.mission.watching import Hop, Hops, Line, Lines, Point, Tracks
from lfield.wire.observing import Pause, named

#: Seconds of virtual time after which what has not come is not waited for any more.
AT_MOST = 3600.0
#: Seconds for resources to say something when all coordinators have ended.
AFTERWARDS = 120.0
#: Seconds between two looks for what is waited for.
LOOK = 0.02
#: The time of day when a team begins, in seconds since 1970, as well as computers know it that hear of one.
DAY = (1.8e9, 1.8e9 + 0.5)
#: Metres that are a move.
MOVED = 0.5
#: Seconds of real time that a mission's time may stand still, and the making of a team take.
PATIENCE = 120.0
#: So many lines are shown of a host that has ended.
LAST_WORDS = 5


class _Desk:
    # Whoever gives commands in a test; answers are ignored.
    peer, who, send = "the test", Identity("person", "the test", ALL), staticmethod(lambda message: None)


class Team:
    """The team of the deployment `path`; see the module. Close it when it is done with.

    `doubles` answer for resources: by agent, an object with a method for each portal. `fakes` are faults from
    the beginning: by device, as in `{"scout.fc": ["battery=0.3"]}`. Without `keeps` hosts keep no journals.
    Raises LfieldError, a MissionTestError for what a test may not ask.
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
        doubles = asked.doubles(doubles)
        self._fakes = Fakes(asked.wrong(fakes), self._mark)
        #: How coordinators ended, with the start that did: hosts that are gone tell it no more.
        self._outcomes: dict[str, tuple[int, str]] = {}
        #: What the test has done to the team, for its picture; the hosts that it has ended.
        self.marks, self._away = list[Mark](), set[str]()
        self._calls, self._hops = Calls(lambda: self.now), Hops(lambda: self.now)
        #: Words that somebody shall say, and how much of the log was looked at for them.
        self._awaited, self._read = "", 0
        self._runs = self._is_closed = False
        self._fence = Fence()
        try:
            with self._running(), self._patiently():
                mission = self.mission = load_mission(path, simulate=True, doubled=doubles)
                self._doubles = Doubles(mission, doubles)
                self._raise_caught()
                self._lines = Lines(mission.program, lambda after, event: self._fleet.later(after, event))
                self._fleet = Fleet(
                    mission,
                    asked.seed(seed),
                    watch=self._watch,
                    unreachable_after=mission.bindings.unreachable_after,
                    keeps=keeps,
                    born=self._born,
                    plug=self._fakes.plug,
                )
                self._watch(self._fleet)
        except BaseException:
            self._fence.down()
            raise
        for machine in self._fleet.machines.values():
            machine.set_day(DAY)
        self._tracks = Tracks(self._fakes.devices, lambda: self.now, self._fleet.later)

    def _born(self, name: str, life: Life) -> None:
        machine = life.core.machine
        self._calls.watch(machine)
        self._doubles.watch(life)
        self._hops.watch(life)
        self._lines.watch(life)

    # --- time -----------------------------------------------------------------------------------------

    @property
    def now(self) -> float:
        """Seconds since the team began."""
        return self._fleet.now

    def run(
        self,
        seconds: float | None = None,
        *,
        until: str | Callable[[], bool] | None = None,
        until_done: bool = False,
        at_most: float = AT_MOST,
    ) -> None:
        """Let time go on: for so many seconds, until a line has these words, until something is true, or
        until every coordinator has ended.

        Raises Stuck when that has not come after `at_most` seconds, or cannot come any more, or when time
        stands still for PATIENCE seconds of real time; and what went wrong in a double, or wanted to touch
        this computer. Raises MissionTestError for what is no end, and where time goes on already.
        """
        asked.one_end(seconds, until, until_done=until_done)
        at_most = asked.seconds(at_most, "run(at_most=...)")
        with self._running(), self._patiently():
            if until_done:
                waited = "the coordinators have not ended"
                self._wait(lambda: self._have_ended, at_most, waited)
            elif callable(until):
                self._wait(until, at_most, "what the test waits for has not come")
            elif until is not None:
                self._awaited, self._read = until, len(self._fleet.log)
                self._wait(lambda: not self._awaited, at_most, f"nobody has said {until!r}")
            else:
                self._fleet.run(asked.seconds(seconds, "run(...)"))

    def _wait(self, come: Callable[[], bool], at_most: float, why: str) -> None:
        began, end, over = self.now, self.now + at_most, False
        while not come():
            if self.now >= end:
                took = f"{self.now - began:.0f} s of the mission" + (", which has ended" if over else "")
                raise Stuck(f"{why} after {took}", self._standing())
            self._fleet.run(LOOK)
            if self._awaited and not over and self._have_ended:
                over, end = True, min(end, self.now + AFTERWARDS)
            if gone := self._fleet.computers.keys() - self._fleet.lives.keys() - self._away:
                name = min(gone)
                raise Stuck(f"{why}, and {name} has ended by itself", self._last_words(name))

    @contextmanager
    def _patiently(self) -> Iterator[None]:
        """What is not the test's own may run within: it touches nothing real, and has an end."""
        try:
            with self._fence.running(), Patience(PATIENCE, self._instant) as self._patience:
                yield
        except Held:
            raise self._held() from None
        except Exception:
            # What was tried is told, whatever they made of it, and once, however often.
            self._raise_caught()
            raise

    def _instant(self) -> float:
        """Seconds of the mission; below 0 before there is one."""
        return self._fleet.now if hasattr(self, "_fleet") else -1.0

    def _held(self) -> Stuck:
        at = self._instant()
        when = "before the mission has begun" if at < 0.0 else f"at {at:.3f} s of the mission"
        by = f", held by {self._patience.holder}" if self._patience.holder else ""
        took = f"time has stood still for {PATIENCE:g} s of real time"
        return Stuck(f"{when} {took}{by}", [] if at < 0.0 else self._standing())

    @contextmanager
    def _running(self) -> Iterator[None]:
        """The mission runs, once at a time, and ends no process but its own."""
        self._be_open()
        if self._runs:
            raise MissionTestError(
                "time goes on already: a double, an action or a condition cannot run the team; "
                "a double that takes its time returns After(seconds, value)"
            )
        self._runs = True
        try:
            yield
        except SystemExit as error:
            raise MissionTestError(
                f"something under test wants to end Python by sys.exit({error.code!r}); let it raise an "
                "error of its own, or return"
            ) from error
        finally:
            self._runs = False

    def _watch(self, fleet: Fleet) -> None:
        """Something has happened: raise what went wrong with it, and stop at a line that is waited for."""
        if self._awaited and any(self._awaited in text for _, _, text in fleet.log[self._read :]):
            self._awaited = ""
            fleet.timeline.pause()
        self._read = len(fleet.log)
        self._doubles.take_turns()
        if self._patience.over:
            raise self._held()
        self._raise_caught()
        for trouble in (*self._doubles.trouble, *self._fakes.trouble):
            raise trouble
        if fleet.failed:
            raise Stuck("a host has ended because of a bug in lfield", self._last_words())

    def _raise_caught(self) -> None:
        """What was tried with what is real, the first of it."""
        caught, self._fence.caught = self._fence.caught, []
        for error in caught:
            raise error

    def _standing(self) -> list[str]:
        return standing(self._fleet, self.ended, self.hops)

    def _last_words(self, host: str = "") -> list[str]:
        said = [line for line in self.log if host in ("", line.host)]
        return [f"{line.host} said: {line.text}" for line in said[-LAST_WORDS:]]

    # --- what was seen --------------------------------------------------------------------------------

    @property
    def log(self) -> list[Line]:
        """Every line that programs and hosts have written, in order."""
        return [
            Line(at, host, line) for at, host, text in self._fleet.log for line in text.splitlines() if line
        ]

    def said(self, text: str, host: str = "") -> int:
        """How many lines have these words, of one host or of all."""
        return sum(text in line.text and host in ("", line.host) for line in self.log)

    @property
    def calls(self) -> list[PortalCall]:
        """Every portal call that has begun, in that order."""
        return self._calls.record

    @property
    def hops(self) -> list[Hop]:
        """Every hop of every coordinator, in order."""
        return self._hops.record

    @property
    def tracks(self) -> dict[str, list[Point]]:
        """Where each device was, every tenth of a second, by its fake's own truth."""
        return self._tracks.record

    @property
    def has_moved(self) -> bool:
        """Whether any device was at two places."""
        return any(math.dist(points[0][1:], p[1:]) > MOVED for points in self.tracks.values() for p in points)

    @property
    def ended(self) -> dict[str, str]:
        """How coordinators ended that did: `done`, `died`, `lost`."""
        self._learn()
        return {agent: outcome for agent, (_, outcome) in self._outcomes.items() if outcome}

    def _learn(self) -> None:
        """How coordinators ended, of the hosts that are there to tell it."""
        found = self._outcomes
        for life in self._fleet.lives.values():
            for known in life.core.mobility.knowledge():
                over = known.outcome if known.state == "EXITED" and known.outcome != "superseded" else ""
                found[known.agent] = max(found.get(known.agent, (0, "")), (known.generation, over))

    @property
    def _have_ended(self) -> bool:
        """Whether all coordinators have."""
        members = self.mission.team.members
        return set(self.ended) >= {member.id for member in members if member.kind == "coordinator"}

    # --- what a test does -----------------------------------------------------------------------------

    def fake(self, device: str) -> FakeDevice:
        """The fake of a device, by its name. Raises MissionTestError."""
        self._be_open()
        if device not in self._fakes.devices:
            known = ", ".join(sorted(self._fakes.devices)) or "none"
            raise MissionTestError(f"there is no device '{device}' with a fake here; there are: {known}")
        return self._fakes.devices[device]

    def at(self, seconds: float, action: Callable[[], None]) -> None:
        """Do something at a moment, in seconds since the team began; now, if that is past.

        Raises MissionTestError.
        """
        self._be_open()
        call = f"at({seconds!r}, ...)"
        self._fleet.timeline.at(asked.seconds(seconds, call), asked.action(action, call))

    def when(self, line: str, action: Callable[[], None]) -> None:
        """Do something, once, as soon as anybody comes to `mission.L:42`. Raises MissionTestError."""
        self._be_open()
        self._lines.when(asked.line(line), asked.action(action, f"when({line!r}, ...)"))

    def cut(self, one: str, other: str) -> None:
        """Break what connects two hosts, and let nothing through until `heal`."""
        self._fleet.cut(*self._two(one, other))
        self._mark(f"{one} and {other} are cut off")

    def heal(self, one: str, other: str) -> None:
        """Let everything through again."""
        self._fleet.heal(*self._two(one, other))
        self._mark(f"{one} and {other} hear each other again")

    def crash(self, host: str) -> None:
        """Kill the process of a host, as by SIGKILL; its guards live on for as long as they need."""
        self._away.add(self._host(host))
        if host in self._fleet.lives:
            self._fleet.crash(host)
            self._mark(f"{host} is killed")

    def power_off(self, host: str) -> None:
        """The computer of a host is gone with all that runs there; its hardware is not."""
        self._away.add(self._host(host))
        self._fleet.power_off(host)
        self._mark(f"{host} is switched off")

    def boot(self, host: str) -> None:
        """Start a host again, and its computer if that is off."""
        self._away.discard(self._host(host))
        if host not in self._fleet.lives:
            self._fleet.boot(host)
            self._mark(f"{host} is started again")

    def stop(self, *hosts: str) -> None:
        """Tell hosts, or all, to end in order, as by SIGTERM: their devices come to rest first."""
        self._be_open()
        for host in hosts or tuple(self._fleet.lives):
            self._away.add(self._host(host))
            if host in self._fleet.lives:
                self._fleet.stop(host)

    def pause(self) -> None:
        """As `lfield pause`: no program runs, and devices come to rest, until `resume`."""
        self._pause(lift=False)
        self._mark("the mission is paused")

    def resume(self) -> None:
        """Let all go on."""
        self._pause(lift=True)
        self._mark("the mission goes on")

    def _pause(self, *, lift: bool) -> None:
        self._be_open()
        order = Pause(len(self.marks).to_bytes(16), lift)
        for life in self._fleet.lives.values():
            word = named(order, life.core.orders.epochs)
            life.process.loop.enter(partial(life.host.received, "", word, cast(Link, _Desk)))

    def close(self) -> None:
        """End all that runs, at once; what was recorded can still be read.

        Raises MissionTestError within a run, and what has touched this computer and nobody has been told of.
        """
        if self._runs:
            raise MissionTestError("time goes on: a double, an action or a condition cannot close the team")
        self._learn()
        self._is_closed = True
        try:
            self._fleet.close()
        finally:
            self._fence.down()
        self._raise_caught()

    def _be_open(self) -> None:
        if self._is_closed:
            raise MissionTestError(
                "this team is closed, and only tells what it has recorded: open another one"
            )

    def _mark(self, words: str, device: str = "") -> None:
        self._be_open()
        self.marks.append(Mark(self.now, device, words))

    def _two(self, one: str, other: str) -> tuple[str, str]:
        if one == other:
            raise MissionTestError(f"nothing lies between {one} and itself; name two hosts")
        return self._host(one), self._host(other)

    def _host(self, name: str) -> str:
        self._be_open()
        if not isinstance(name, str) or name not in self._fleet.computers:
            known = ", ".join(self._fleet.computers)
            raise MissionTestError(f"there is no host {name!r}; there are: {known}")
        return name
