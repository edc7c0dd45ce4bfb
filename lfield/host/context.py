"""Data that the parts of a host share: mission and identity; the protocol between core and part. Pure."""

from __future__ import annotations

import random
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

from msgspec import Struct

from lfield.clock import Clock
from lfield.host.effects import Effect, Environment, WriteLog
from lfield.host.events.event_recorder import EventRecorder
from lfield.journal.records import FenceRecord, Record, RecordKey
from lfield.mission.mission import Mission
from lfield.mission.team import Team
from lfield.replication.membership.overlay import Overlay
from lfield.text.log_messages import LogLine
from lfield.vm.engine_interface import Engines
from lfield.vm.turns.run_limit import RunLimit
from lfield.wire.messages import Control, Hello


@dataclass(frozen=True)
class HostContext:
    """The environment of one host's core.

    `incarnation` identifies this run of the host. `unreachable_after` is in seconds. `journal_id` identifies
    the journal, 0 without one; `records` are its contents, `times` the Unix times at which they were written.
    `random_bytes(n)` returns n random bytes; without that function `rng` generates them. `stopwatch` measures
    the seconds for which programs run, by default by `clock`; `run_limit` limits one run. A part appends
    effects for the shell to `effects`.

    `clock` stands still during a turn of the core, so that a replay needs one time for each turn.
    `fresh_time` is the real time, for coordinators that depart: their own clocks include the turn.
    """

    mission: Mission
    name: str
    incarnation: int
    clock: Clock
    environment: Environment
    rng: random.Random
    unreachable_after: float
    overlay: Overlay
    recorder: EventRecorder
    journal_id: int = 0
    records: Iterable[Record] = ()
    times: Mapping[RecordKey, float] = field(default_factory=dict)
    engines: Engines | None = None
    random_bytes: Callable[[int], bytes] | None = None
    stopwatch: Callable[[], float] | None = None
    run_limit: RunLimit | None = None
    fresh_time: Callable[[], float] | None = None
    effects: list[Effect] = field(default_factory=list)

    @property
    def team(self) -> Team:
        """The agents and hosts of the mission."""
        return self.mission.team

    @cached_property
    def own_number(self) -> int:
        """The number of this host in the team."""
        return self.team.number(self.name)

    @cached_property
    def leased_agents(self) -> frozenset[str]:
        """The coordinators that run under leases on this host: none without a journal."""
        return frozenset(self.mission.fenced) if self.has_journal else frozenset()

    @cached_property
    def restored_fences(self) -> dict[str, int]:
        """The fencing tokens in the journal: by coordinator, the first generation that may run."""
        return {record.agent: record.generation for record in self.records if isinstance(record, FenceRecord)}

    @property
    def has_journal(self) -> bool:
        return bool(self.journal_id)

    @cached_property
    def greeting(self) -> Hello:
        """The Hello of this host, without coordinators and epochs."""
        mission = self.mission
        return Hello(
            "host",
            self.name,
            self.incarnation,
            mission.program.digest,
            self.team.deployment,
            mission.max_block,
            [],
            mission.registry.digest if mission.registry is not None else b"",
            mission.access.digest,
            mission.world,
            self.journal_id,
            str(mission.recovery) if mission.fenced else "",
            str(mission.bindings.frames.origin or ""),
            mission.bindings.reservations.lease if mission.program.has_reserves else 0.0,
            bundle=mission.release.shared,
            built=mission.release.digest if mission.release.is_from_files else b"",
        )

    def log(self, line: LogLine) -> None:
        """Write a line to the log."""
        self.effects.append(WriteLog(line))


class LinkOpened(Struct, frozen=True):
    """A link with a host opened: `hello` is its Hello."""

    hello: Hello


class LinkClosed(Struct, frozen=True):
    """The last link with a host closed."""

    host: str


class WriteFailed(Struct, frozen=True):
    """Writing the journal failed; the write is retried."""

    reason: str


#: The events that the core passes to parts.
HostEvent = LinkOpened | LinkClosed | WriteFailed

#: Handles a message; the first argument is the host that sent it.
MessageHandler = Callable[[str, Any], None]
EventHandler = Callable[[Any], None]


class Part:
    """A part of a host's core. A part overrides only the members that it needs.

    Other parts that it uses are passed to its constructor. Only the core creates parts.
    """

    #: The messages that this part handles; no two parts handle the same type.
    handles: Mapping[type[Control], MessageHandler] = {}
    #: The events that this part handles, in the order of the core's list of parts.
    observes: Mapping[type[HostEvent], EventHandler] = {}
    #: The time when `on_tick` is due, in seconds of the host's clock; None for never.
    due: float | None = None
    #: Whether `on_tick` is called in each turn of the host, also before `due`.
    is_polled: bool = False

    def on_tick(self, now: float) -> None:
        """The time `due` has come, or the part `is_polled`."""
