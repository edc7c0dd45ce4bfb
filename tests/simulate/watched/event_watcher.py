"""A client that watches hosts of a fleet, and the team of most tests."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

from lfield.mission.loader import load_mission
from lfield.net.coding.traffic_kinds import TrafficBytes
from lfield.simulate.host_fleet import Fleet
from lfield.wire import events
from lfield.wire.codec import decode, encode
from lfield.wire.events import Event
from lfield.wire.framing import HEADER_SIZE
from lfield.wire.messages import Control, HandshakeRefused
from lfield.wire.observer_messages import EmergencyStop, Pause, with_epoch
from lfield.wire.subscription_messages import EventAck, EventBatch, Subscribe

PROGRAM = """
resource Post {
    Mavlink fc;
    init(string[] arg) { }
    portal climb(real height) { fc.takeoff(height); print("climbs"); write("to " + f2s(height, 0) + "\\n"); }
}
coordinator Walker {
    init(string[] arg) {
        Post[] posts = findPost();
        int n = 0;
        while (true) {
            posts[n % 2].climb(i2f(n + 2));
            print("at " + i2s(n));
            sleep(0.5);
            n = n + 1;
        }
    }
}
"""
TEAM = "//Post:p@alpha\n//Post:q@beta\n//Walker:walker@alpha\n"


@dataclass(eq=False)
class EventWatcher:
    """A client that watches one host of a fleet, by whole messages; `reads` tells whether it acknowledges."""

    fleet: Fleet
    host: str
    reads: bool = True
    identity: str = "the eye"
    batches: list[EventBatch] = field(default_factory=list)
    refused: str = ""
    others: list[Control] = field(default_factory=list)
    traffic: TrafficBytes = field(default_factory=TrafficBytes)

    def say(self, message: Control) -> None:
        life = self.fleet.runs.get(self.host)
        if life is not None:
            life.process.loop.enter(lambda: life.host.on_message("", message, self))  # type: ignore[arg-type]

    def order(self, message: EmergencyStop | Pause) -> None:
        """Send an order with the present epochs of the host."""
        self.say(with_epoch(message, self.fleet.runs[self.host].core.orders.epochs))

    def send(self, message: object) -> None:
        """The host's end of the link."""
        frame = encode(message)  # type: ignore[arg-type]
        message = decode(frame[HEADER_SIZE - 1], frame[HEADER_SIZE:])
        if isinstance(message, EventBatch):
            self.batches.append(message)
            if self.reads:
                self.fleet.later(0.001, partial(self.say, EventAck(message.batch)))
        elif isinstance(message, HandshakeRefused):
            self.refused = message.reason
        else:
            self.others.append(message)  # type: ignore[arg-type]

    def close(self) -> None:
        """The host's end of the link."""

    @property
    def events(self) -> list[Event]:
        return [event for batch in self.batches for event in batch.events]

    @property
    def states(self) -> list[Event]:
        return [event for event in self.events if event.kind not in events.TELEMETRY]

    def of(self, kind: type) -> list[Event]:
        return [event for event in self.events if isinstance(event.what, kind)]

    def by_number(self) -> dict[int, Event]:
        return {event.number: event for event in self.states}


def fleet_of(folder: Path, seconds: float, program: str = PROGRAM, team: str = TEAM, seed: int = 1) -> Fleet:
    """A team that has run for `seconds`."""
    (folder / "mission.L").write_text(program)
    (folder / "mission.dL").write_text(team)
    fleet = Fleet(load_mission(folder / "mission.dL", simulate=True), seed)
    fleet.run(seconds)
    return fleet


def watch(fleet: Fleet, host: str, message: Subscribe | None = None, **options: bool) -> EventWatcher:
    watcher = EventWatcher(fleet, host, **options)
    watcher.say(message or Subscribe())
    return watcher


def chain(watcher: EventWatcher, event: Event) -> list[str]:
    """The kinds of the causes of an event, the last one first."""
    known, kinds = watcher.by_number(), []
    while event.cause in known:
        event = known[event.cause]
        kinds.append(event.kind)
    return kinds
