"""What one host decides: its machine, the coordinators that leave and come, and what it knows of its team.

Events in, effects out. It has no loop, socket, process, disk, clock or dice of its own: the shell (host.py)
calls a method for each event, then `run`, and carries out what `take` gives. A simulator does the same.
"""

from __future__ import annotations

import random
from collections.abc import Callable, Iterable, Mapping
from typing import Protocol

from lfield.clock import Clock
from lfield.errors import DeviceError
from lfield.host.directory import TeamDirectory
from lfield.host.effects import CHANGED, Call, Complain, Effect, Nearby, Reach, Say
from lfield.host.inits import Inits
from lfield.host.offers import Offers
from lfield.host.orders.executed import Executed
from lfield.host.sight.hops import Hops
from lfield.host.sight.programs import Programs
from lfield.host.sight.teller import Teller
from lfield.host.team import words
from lfield.host.team.absent import Absent, SignsOfLife
from lfield.host.team.beginning import Beginning
from lfield.host.team.begun import BegunPages
from lfield.host.team.commands import Commands
from lfield.host.team.coordinators import Coordinators
from lfield.host.team.leases import Leases
from lfield.host.team.policy import Policies
from lfield.host.team.reserving import Reserving
from lfield.host.team.world import HostWorld
from lfield.journal.pages import Key, Page
from lfield.manifest import DeviceValue
from lfield.mission.mission import Mission
from lfield.mobility import effects as mobile
from lfield.mobility.core import MobilityMessage
from lfield.mobility.fates import Fate
from lfield.mobility.hearsay import Hearsay
from lfield.mobility.neighbours import Neighbourhood
from lfield.mobility.relays import Relays
from lfield.vm.agent import Agent
from lfield.vm.contract import Engines
from lfield.vm.machine import Machine
from lfield.wire.coordinators import Ended, EndedAck, Known, Transfer
from lfield.wire.messages import Control, Heard, Hello, Pong, Relayed, Report, Room
from lfield.wire.observing import Recover, Recovered, Status
from lfield.wire.quorum import QuorumMessage
from lfield.wire.reservations import ReservationMessage


class Timed(Protocol):
    """A part of a host that has something to do at a time."""

    @property
    def due(self) -> float | None:
        """When, in seconds of the host's clock; None for never."""


class HostCore:
    """One host of a mission, without the world around it.

    `incarnation` tells this life from the next; `unreachable_after` is in seconds. `memory` is the identity
    of the host's journal, 0 without one, `pages` what that has kept, `times` when; `draw` gives random bytes.
    """

    def __init__(
        self,
        mission: Mission,
        name: str,
        incarnation: int,
        clock: Clock,
        nearby: Nearby,
        dice: random.Random,
        unreachable_after: float,
        neighbours: Neighbourhood,
        memory: int = 0,
        pages: Iterable[Page] = (),
        times: Mapping[Key, float] | None = None,
        engines: Engines | None = None,
        teller: Teller | None = None,
        draw: Callable[[int], bytes] | None = None,
    ) -> None:
        self.mission, self.team, self.name, self.incarnation = mission, mission.team, name, incarnation
        self.here = self.team.number(name)
        self._clock, self._memory, self._reserves = clock, memory, mission.program.has_reserves
        self._effects: list[Effect] = []
        self.teller = teller = teller or Teller(clock)
        self.world = HostWorld(self.team, self._out, self._reach, teller)
        everybody, fenced = self.team.members, mission.fenced
        self.machine = machine = Machine(
            mission.program, everybody, self.here, incarnation, self.world, clock, dice, fenced, engines
        )
        self.programs, machine.attached.rules = Programs(machine, clock.monotonic), mission.calls
        self.orders = Executed(draw or dice.randbytes, Executed.kept(pages))
        own = self._hello([])
        self._hops = hops = Hops(teller, machine, name, self.team)
        self._relays = relays = Relays[Effect](self.team.hosts, name, incarnation, clock, self._out)
        self.coordinators = team = Coordinators(
            mission, own, machine, clock, relays.send, unreachable_after, pages, times or {}, hops
        )
        self.directory = TeamDirectory(mission, name, incarnation, machine, nearby, clock)
        self.leases = leases = Leases(mission, own, team, machine, clock, self._out, pages, dice)
        team.barred, self.mobility = leases.quorum.fences.bars, team.mobility
        self._begun = BegunPages(own.mission, team, leases, machine, clock, pages, keeps=bool(memory))
        self.hearsay = Hearsay(self.team.hosts, self.here, incarnation, clock.monotonic(), neighbours)
        relays.join(self.hearsay, team.mobility, team.carry_out)
        self.reserving = Reserving(
            mission, own, team, leases, machine, clock, self._out, self.hearsay.is_linked, pages
        )
        self.directory.reserved = self.reserving.by
        self._inits, self._policies = Inits(machine.opening, self._say), Policies(mission.devices_of(name))
        self.commands = Commands(machine, nearby, leases, self._policies, clock, self._out, teller)
        self._absent = Absent(nearby, self.hearsay, clock, unreachable_after, self.mobility, self._out)
        machine.attached.signs = SignsOfLife(self._absent, self.team.hosts)
        offers = Offers(self.directory, mission)
        self.world.join(team, leases, self._begun, self.reserving, self.commands, offers, self._absent)
        #: When the coordinators of this host begin, and what a new start of them waits for.
        self.startup = startup = Beginning(
            mission, name, team, leases, clock, self._out, nearby, self.hearsay, teller, kept=bool(memory)
        )
        self._timed: list[Timed] = [team, relays, self.directory, self.hearsay, self._policies, self._inits]
        self._timed += [startup, leases] if leases.fenced else [startup]
        self._timed += [self.reserving] if self._reserves else []

    def take(self) -> list[Effect]:
        """What is to be done, in this order; each effect is given once."""
        effects, self._effects = self._effects, []
        if self._memory:
            effects += self.coordinators.batch()
        return effects

    def _out(self, effect: Effect) -> None:
        self._effects.append(effect)

    def hello(self) -> Hello:
        """What this host says of itself now."""
        return self._hello(self.coordinators.greeting())

    def _reach(self, host: str) -> None:
        """A link to this host is needed, if there is none."""
        if not self.hearsay.is_linked(host):
            self._effects.append(Reach(host))

    def _hello(self, coordinators: list[Known]) -> Hello:
        return Hello(
            "host",
            self.name,
            self.incarnation,
            self.mission.program.digest,
            self.team.deployment,
            self.mission.max_block,
            coordinators,
            self.mission.registry.digest if self.mission.registry is not None else b"",
            self.mission.access.digest,
            self.mission.world,
            self._memory,
            str(self.mission.recovery) if self.mission.fenced else "",
            str(self.mission.bindings.frames.origin or ""),
            self.mission.bindings.reservations.lease if self.mission.program.has_reserves else 0.0,
            bundle=self.mission.release.shared,
            built=self.mission.release.digest if self.mission.release.of_files else b"",
            epochs=self.orders.epochs,
        )

    def run(self) -> float | None:
        """Do what is due and let the machine run; to be called after every event, and when its time is up.

        Returns the seconds until it is to be called again (0: at once), None for only after an event.
        """
        now = self._clock.monotonic()
        if now >= self.teller.due:
            self.teller.fill(now)
        self.coordinators.tick(now)
        if self.directory.due is not None and now >= self.directory.due:
            self._effects += self.directory.tick(now)
        if self.hearsay.due is not None and now >= self.hearsay.due:
            self._effects += [mobile.Send(host, news) for host, news in self.hearsay.tell(now)]
        self._relays.tick(now)
        is_leased = self.leases.fenced and self.leases.tick(now)
        if is_leased or ((due := self.startup.due) is not None and now >= due):
            self.startup.look()
        if self._policies.due is not None and now >= self._policies.due:
            self._effects += self._policies.look(self.name, self.mobility.knowledge(), self.hearsay, now)
        self._begun.look()
        if self._reserves:
            self.reserving.look()
        pause = None if self.coordinators.halted or self.coordinators.paused else self.programs.run()
        self._inits.look(now)
        # A portal that has ended may be what somebody waits for who wants to reserve its resource.
        if self._reserves and self.reserving.look():
            pause = 0.0
        if pause == 0.0:
            return pause
        for part in self._timed:
            if (due := part.due) is not None and (pause is None or due - now < pause):
                pause = max(0.0, due - now)
        return pause

    # --- life -----------------------------------------------------------------------------------------

    def start_resources(self, *, first: bool = False) -> None:
        """The devices are open: start the resources, and take in what came meanwhile; `first` as below."""
        for member in self.team.on(self.here):
            if member.kind == "resource":
                self.teller.started(member.id, 0)
                self.machine.start(member, self.mission.bindings.limits(member.id), 0)
        self._begun.restore()
        self.reserving.restore()
        self.directory.open()
        self.coordinators.open()
        self.leases.begin(first=first)

    def start_coordinators(self, *, first: bool = False) -> None:
        """The other hosts had time to say what they know: go on with the coordinators that the journal has,
        and start those of this host that are nowhere.

        `first`: somebody says that there was no earlier start. Else a host that has none on record must hear
        all others first.
        """
        self.leases.wake()
        came = set(self.machine.agents)
        self.coordinators.wake()
        self._relays.arm()
        for name in self.machine.agents.keys() - came:
            self.teller.started(name, self.machine.agents[name].generation, kept=True)
        self._begun.woken()
        for known in self.mobility.knowledge():
            # What is barred has no place where it may be.
            if known.state in ("PREPARED", "IN DOUBT") and known.where:
                self._hops.is_away(known)
                self._reach(known.where)
        self.startup.begin(first=first)

    def halt(self) -> None:
        """The host is stopping: no agent runs any more, and no coordinator is taken in.

        What is under way between hosts goes on, and so does what this host tells of itself.
        """
        self.coordinators.park()

    @property
    def has_coordinators(self) -> bool:
        """Whether any start here, or were here when this host was last up."""
        return bool(self.startup.own or self.coordinators.recovery.copies)

    def waits(self, agent: Agent) -> str:
        """What a coordinator waits for besides its own work, in a few words; '' for nothing."""
        if not agent.frozen:
            return self._inits.waits(agent)
        if self.leases.is_waiting(agent):
            return "waits for a majority"
        reserves = self.reserving.waits(agent)
        return reserves or words.waits(self.coordinators, self.machine, self.team.hosts, agent)

    def not_kept(self, why: str) -> None:
        """The disk takes nothing: what waits for it goes on waiting, and is tried again."""
        self.coordinators.not_kept(why)
        self._begun.not_kept()
        self.reserving.not_kept(why)

    def room(self, trouble: str) -> None:
        """Why the journal should take in nothing more, or '': whoever would send something is told."""
        self._say(f"no coordinator is taken in: {trouble}" if trouble else "coordinators are taken in again")
        self.coordinators.full = trouble
        self._tell_room()

    def _tell_room(self) -> None:
        self._effects += [mobile.Send(host, self.coordinators.room) for host in self.hearsay.links]

    def pause(self, *, on: bool, order: bytes = b"") -> None:
        """A person pauses the mission on this host, or lets it go on."""
        words.pause(self.coordinators, self.machine, self._clock.monotonic(), on=on, order=order)
        self.reserving.postpone()
        self._tell_room()
        self.startup.look()

    def stop(self, reason: str, order: bytes = b"") -> None:
        """Somebody has pressed the emergency stop, for that reason, or has lifted it ('')."""
        words.stop(self.coordinators, reason, order)

    def kept(self, number: int) -> None:
        """All pages up to those of that batch are on the disk."""
        self.coordinators.kept(number)
        self._begun.kept(number)
        self.reserving.kept(number)
        self.startup.kept(number)

    def reaped(self, host: str) -> None:
        """A host of this team has ended for good: whoever started it says so."""
        if host in self.team.hosts and host != self.name:
            self.hearsay.gone.add(host)
            self.startup.heard(host)
            self.startup.look()
            self._effects.append(CHANGED)

    def wanted(self) -> set[str]:
        """The hosts to have links with now: the neighbours, and whoever is waited for."""
        waited = self.mobility.wanted() | self.leases.wanted | self.reserving.wanted
        waited.update(self.startup.wanted, self.hearsay.wanted(self._clock.monotonic()))
        return waited - {self.name}

    def told(self, host: str, status: Status) -> None:
        """A host that was asked says how it is, and what it knows of coordinators."""
        self._policies.told(host, status.coordinators, self._clock.monotonic())
        self.coordinators.carry_out(self.mobility.told(host, status.coordinators))
        self.startup.on_status(host, status)

    def refused(self, host: str, reason: str, bundle: bytes) -> None:
        """No link with a host can be made, for that reason; '' when that is over."""
        self.teller.refused(host, reason)
        self.startup.on_refused(host, reason, bundle)

    def forget(self, agent: str) -> list[int]:
        """A person says that this coordinator is lost; the starts of it that end here."""
        return words.forget(self.coordinators, agent)

    def recover(self, word: Recover) -> Recovered:
        """A person says that whoever held a coordinator is gone for good: this host goes on with it."""
        return words.recover(self.coordinators, self.leases, self.name, self.here, word)

    def pass_on(self, found: Iterable[Fate]) -> None:
        """This host is about to go: whoever can be reached is told of all endings, and of what it found."""
        self.coordinators.carry_out(self.mobility.pass_on(found))

    # --- events of links ------------------------------------------------------------------------------

    def linked(self, hello: Hello) -> None:
        """A host can be talked to."""
        restarted = self.hearsay.linked(hello.host, hello.incarnation)
        if restarted or hello.host in self.hearsay.near:
            self._say(f"linked with {hello.host}{', which was restarted' if restarted else ''}")
        self.teller.linked(hello.host, restarted=restarted)
        self.startup.heard(hello.host, hello.coordinators)
        self._effects += self.directory.linked(hello)
        if self.coordinators.room.trouble:
            self._effects.append(mobile.Send(hello.host, self.coordinators.room))
        self.coordinators.carry_out(self.mobility.linked(hello))
        self.reserving.linked()
        self._relays.arm()
        self.startup.look()
        self._effects.append(CHANGED)

    def unlinked(self, host: str, *, quietly: bool = False) -> None:
        """A host cannot be talked to any more; `quietly`: this one had no use for the link."""
        self.teller.unlinked(host, lost=not quietly)
        if not quietly:
            self._say(f"lost the link with {host}")
        self.mobility.unlinked(host)
        self.directory.unlinked(host)
        self.hearsay.unlinked(host, self._clock.monotonic())
        self._relays.arm()
        self.startup.unlinked(host)
        self.startup.look()
        self._effects.append(CHANGED)

    def arrived(self, host: str, header: Transfer, block: memoryview) -> None:
        """A coordinator came: it runs before its sender gets an answer."""
        self._hops.arrives(host, header)
        transit = self._absent.transit(host) if self.machine.program.has_limits else 0.0
        self.coordinators.arrived(host, header, block, transit)

    def too_large(self, host: str, header: Transfer, size: int) -> None:
        """A coordinator came whose block was not even read."""
        self.coordinators.carry_out(self.mobility.oversize(host, header, size))

    def received(self, host: str, message: Control) -> None:
        """A host has answered, asks, tells of an ending or of its agents."""
        if isinstance(message, Report):
            if complaint := self.directory.received(host, message):
                self._effects.append(Complain(complaint))
        elif isinstance(message, Pong):
            self.coordinators.carry_out(self.mobility.answered(host))
        elif isinstance(message, Room):
            self.coordinators.carry_out(self.mobility.room(host, message.trouble))
        elif isinstance(message, Heard):
            self.hearsay.told(host, message, self._clock.monotonic())
        elif isinstance(message, Relayed):
            self._relays.received(host, message)
        elif isinstance(message, QuorumMessage):
            self.leases.received(host, message)
        elif isinstance(message, ReservationMessage):
            self.reserving.received(message)
        elif isinstance(message, MobilityMessage):
            self.coordinators.carry_out(self.mobility.receive(host, message, self._clock.monotonic()))
            if isinstance(message, Ended | EndedAck):
                self._effects.append(CHANGED)

    def answered(self, asked: Call, value: DeviceValue | DeviceError) -> None:
        """What became of a call of a device."""
        self.commands.answered(asked, value)

    def _say(self, text: str) -> None:
        self._effects.append(Say(text))
