"""A follower of hosts receives each event once, also when links break; the hosts are scripted."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable

import pytest
from dashboard_script import ScriptedHost
from memory_network import MemoryNetwork
from msgspec.structs import replace

from lfield.errors import AddressError
from lfield.net.transport import Link, LinkHandler, Transport
from lfield.operator.dashboard.event_stream.event_follower import (
    CHECK_INTERVAL,
    REQUEST_INTERVAL,
    SILENCE_TIMEOUT,
    EventFollower,
    FollowOptions,
)
from lfield.operator.dashboard.event_stream.stream_cursor import MAX_RETRY, StreamCursor
from lfield.simulate.jumping_loop import LoopClock, run_jumping
from lfield.wire.events import DeviceTelemetry, Event, LinkUp, StateEvent
from lfield.wire.messages import HandshakeRefused, Hello, Message
from lfield.wire.subscription_messages import EventAck, EventBatch, Subscribe

ADDRESS, NOWHERE = "alpha:8181", "beyond:8181"


class PlayedHost:
    """A host at ADDRESS that sends the events of the test, and records the messages it receives."""

    def __init__(self, network: MemoryNetwork, incarnation: int = 7) -> None:
        self.teller = ScriptedHost(incarnation)
        self.heard: list[Message] = []
        self.links: list[Link] = []
        self.history: list[Event] = []
        self.refuses = ""
        self.listener = network.listen("alpha", ADDRESS, self._called)
        self.beats = asyncio.create_task(self._beat())

    async def _beat(self) -> None:
        """A batch each second, also without events."""
        while True:
            await asyncio.sleep(1.0)
            self.happens()

    def _called(self, link: Link) -> PlayedHost:
        link.send(Hello("host", "alpha", self.teller.incarnation))
        return self

    def on_message(self, link: Link, message: Message) -> None:
        self.heard.append(message)
        if isinstance(message, Hello):
            link.accept_role(message.role)
        if isinstance(message, Subscribe):
            if link not in self.links:
                self.links.append(link)
            link.send(HandshakeRefused(self.refuses) if self.refuses else self._answer(message))

    def _answer(self, watch: Subscribe) -> EventBatch:
        life, latest = self.teller.incarnation, self.teller.number
        after = latest if watch.incarnation == 0 else watch.after if watch.incarnation == life else 0
        return EventBatch(life, 1, 0.0, 1.0, after, latest, self.history[after:])

    def on_closed(self, link: Link, error: object) -> None:
        if link in self.links:
            self.links.remove(link)

    def happens(self, *whats: StateEvent) -> None:
        """Send events immediately to each link."""
        batch = self.teller.batch(2.0, *whats)
        self.history += batch.events
        for link in self.links:
            link.send(batch)

    def all(self, kind: type[Message]) -> list[Message]:
        return [message for message in self.heard if isinstance(message, kind)]


class EventRecorder:
    """Records the batches and link changes."""

    def __init__(self) -> None:
        self.log: list[str] = []
        self.batches: list[EventBatch] = []
        self.took: list[float] = []

    def on_linked(self, host: str) -> None:
        self.log.append(f"{host} linked")

    def on_unlinked(self, host: str, why: str) -> None:
        self.log.append(why)

    def on_batch(self, host: str, batch: EventBatch, took: float | None) -> None:
        self.batches.append(batch)
        if took is not None:
            self.took.append(took)

    @property
    def peers(self) -> list[str]:
        return [event.what.peer for batch in self.batches for event in batch.events]


class Desk:
    """The transport of the follower; it does not resolve the address NOWHERE."""

    def __init__(self, transport: Transport) -> None:
        self._transport = transport

    async def connect(self, address: str, handler: LinkHandler, host="") -> Link:
        if address == NOWHERE:
            raise AddressError(address, "the name is not known")
        return await self._transport.connect(address, handler)


class Scene:
    """A network, the recorder, and the follower."""

    def __init__(self, since: int | None = None) -> None:
        self.network = MemoryNetwork(LoopClock(), on_pending=self._pending)
        self.recorder, self.address = EventRecorder(), ADDRESS
        self.follower = EventFollower(
            Desk(self.network.transport("desk")),  # type: ignore[arg-type]
            ["alpha"],
            self._reach,
            self.recorder,
            LoopClock(),
            FollowOptions(since=since, hint=lambda: "it may not run"),
        )

    async def _reach(self, host: str) -> str:
        return self.address

    def _pending(self) -> None:
        due = self.network.next_due()
        if due is not None:
            # A loop may wake one tick of its clock too early, without due timers.
            asyncio.get_running_loop().call_at(due + 1e-6, self._deliver)

    def _deliver(self) -> None:
        self.network.run()
        self._pending()


def played(scenario: Callable[[Scene], Awaitable[None]], since: int | None = None) -> EventRecorder:
    """Run a scenario while a follower runs."""

    async def main() -> EventRecorder:
        scene = Scene(since)
        following = asyncio.create_task(scene.follower.run())
        await asyncio.sleep(0)
        await scenario(scene)
        following.cancel()
        await asyncio.gather(following, return_exceptions=True)
        return scene.recorder

    return run_jumping(main())


def test_batches_are_forwarded_and_acknowledged() -> None:
    async def scenario(scene: Scene) -> None:
        host = PlayedHost(scene.network)
        await asyncio.sleep(1.0)
        host.happens(LinkUp("a"), LinkUp("b"))
        await asyncio.sleep(1.0)
        first, *others = [message.batch for message in host.all(EventAck)]
        assert first == 1
        assert others == list(range(1, len(others) + 1))

    recorder = played(scenario)
    assert recorder.peers == ["a", "b"]
    assert recorder.log[-1] == "alpha linked"
    assert len(recorder.took) == 1


def test_each_event_arrives_once_across_a_broken_link() -> None:
    async def scenario(scene: Scene) -> None:
        host = PlayedHost(scene.network)
        await asyncio.sleep(1.0)
        host.happens(LinkUp("a"))
        await asyncio.sleep(1.0)
        # Messages in transit are lost with the link.
        scene.network.latency = 0.5
        host.happens(LinkUp("b"))
        scene.network.cut("alpha", "desk")
        host.history += host.teller.batch(3.0, LinkUp("c")).events
        await asyncio.sleep(4.0)
        assert host.all(Subscribe)[-1] == Subscribe(7, 1, 0.0)

    recorder = played(scenario)
    assert recorder.peers == ["a", "b", "c"]
    assert "the connection was lost" in recorder.log[1]


def test_repeated_events_are_dropped_and_gaps_are_counted() -> None:
    cursor, host = StreamCursor(), ScriptedHost()
    first = host.batch(1.0, LinkUp("a"), LinkUp("b"))
    assert len(cursor.accept(first).events) == 2
    assert cursor.accept(first).events == []
    host.batch(2.0, LinkUp("c"))
    late = cursor.accept(host.batch(3.0, LinkUp("d")))
    assert (late.lost, [event.number for event in late.events]) == ({"state": 1}, [4])
    assert cursor.watch_request(7) == Subscribe(7, 4)


def test_missing_events_are_counted_once_by_their_numbers() -> None:
    cursor, host = StreamCursor(), ScriptedHost()
    cursor.accept(host.batch(1.0, LinkUp("a")))
    batch = host.batch(2.0, *(LinkUp(text) for text in "bcdef"))
    stored = replace(
        batch, events=[event for event in batch.events if event.number in (3, 6)], lost={"state": 3}
    )
    assert cursor.accept(stored).lost == {"state": 3}
    # The event arrives again, because it was in transit at the new subscription.
    again = cursor.accept(stored)
    assert (again.lost, again.events) == ({}, [])
    # Events missing at the end of a batch are counted only when another event follows.
    ends = replace(host.batch(3.0), after=9, latest=9, lost={"state": 3, "measured": 1})
    assert cursor.accept(ends).lost == {"state": 3, "measured": 1}


def test_telemetry_has_no_number_and_is_never_dropped_as_repeated() -> None:
    cursor, host = StreamCursor(telemetry=5.0), ScriptedHost()
    cursor.accept(host.batch(1.0, LinkUp("a")))
    for _ in range(2):
        assert len(cursor.accept(host.batch(2.0, DeviceTelemetry("one.fc", {}, 0.0))).events) == 1
    assert cursor.watch_request(7) == Subscribe(7, 1, 5.0)


def test_a_restarted_host_is_followed_from_its_first_event() -> None:
    async def scenario(scene: Scene) -> None:
        host = PlayedHost(scene.network)
        await asyncio.sleep(1.0)
        host.happens(LinkUp("a"), LinkUp("b"))
        await asyncio.sleep(1.0)
        host.listener.close()
        host.beats.cancel()
        scene.network.cut("alpha", "desk")
        await asyncio.sleep(20.0)
        host = PlayedHost(scene.network, 8)
        await asyncio.sleep(MAX_RETRY + 1.0)
        # The subscription names the known incarnation: another incarnation sends all its events.
        assert host.all(Subscribe) == [Subscribe(7, 2, 0.0)]
        host.happens(LinkUp("c"))
        await asyncio.sleep(1.0)

    recorder = played(scenario)
    assert recorder.peers == ["a", "b", "c"]
    assert {batch.incarnation for batch in recorder.batches} == {7, 8}
    assert all(batch.lost == {} for batch in recorder.batches)


@pytest.mark.parametrize(
    ("since", "asked"), [(None, Subscribe(0, 0)), (0, Subscribe(7, 0)), (12, Subscribe(7, 12))]
)
def test_the_first_subscription_names_its_start(since: int | None, asked: Subscribe) -> None:
    assert StreamCursor(since).watch_request(7) == asked


def test_a_host_that_starts_later_is_followed_from_its_first_event() -> None:
    async def scenario(scene: Scene) -> None:
        await asyncio.sleep(3.0)
        host = PlayedHost(scene.network)
        await asyncio.sleep(MAX_RETRY + 1.0)
        (request,) = host.all(Subscribe)
        assert request.incarnation not in (0, 7)
        assert request.after == 0

    recorder = played(scenario)
    assert "no program listens" in recorder.log[0]


def test_a_host_found_later_at_another_address_is_followed_from_its_first_event() -> None:
    async def scenario(scene: Scene) -> None:
        scene.address = NOWHERE
        await asyncio.sleep(3.0)
        host = PlayedHost(scene.network)
        host.happens(LinkUp("a"))
        scene.address = ADDRESS
        await asyncio.sleep(MAX_RETRY + 1.0)

    recorder = played(scenario)
    assert recorder.peers == ["a"]
    assert all(line.endswith("; it may not run") for line in recorder.log[:-1])


def test_a_host_that_hangs_is_disconnected_and_connected_again() -> None:
    async def scenario(scene: Scene) -> None:
        host = PlayedHost(scene.network)
        await asyncio.sleep(SILENCE_TIMEOUT * 5)
        assert len(host.all(Subscribe)) == 1
        host.beats.cancel()
        await asyncio.sleep(SILENCE_TIMEOUT + 2 * CHECK_INTERVAL)
        assert len(host.all(Subscribe)) >= 2

    recorder = played(scenario)
    assert any(line.startswith("nothing received for") for line in recorder.log)


def test_a_refusal_is_reported_and_retried_slowly() -> None:
    async def scenario(scene: Scene) -> None:
        host = PlayedHost(scene.network)
        host.refuses = "anna may do nothing"
        await asyncio.sleep(60.0)
        assert 10 < len(host.all(Subscribe)) < 20

    recorder = played(scenario)
    assert "alpha refused: anna may do nothing" in recorder.log
    assert "alpha linked" not in recorder.log


def test_a_host_is_subscribed_to_again_every_minute_against_clock_drift() -> None:
    async def scenario(scene: Scene) -> None:
        host = PlayedHost(scene.network)
        scene.network.latency = 0.1
        await asyncio.sleep(1.5)
        for text in "abcd":
            host.happens(LinkUp(text))
            await asyncio.sleep(REQUEST_INTERVAL)
        assert host.all(Subscribe)[1:] == [Subscribe(7, number, 0.0) for number in (1, 2, 3, 4)]

    recorder = played(scenario)
    assert recorder.peers == ["a", "b", "c", "d"]
    assert recorder.took == [pytest.approx(0.2, abs=0.01)] * 5
    assert all(batch.lost == {} for batch in recorder.batches)
