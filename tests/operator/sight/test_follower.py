"""Who follows hosts hears all that happens once, whatever becomes of links; hosts are played by a script."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable

import pytest
from msgspec.structs import replace
from sight_script import Teller

from lfield.errors import AddressError
from lfield.net.transport import Link, LinkHandler, Transport
from lfield.operator.sight.following.cursor import LATEST, Cursor
from lfield.operator.sight.following.follower import ASKED_EVERY, LOOK, SILENT, Follower
from lfield.simulate.network import MemoryNetwork
from lfield.simulate.time import LoopClock, run_jumping
from lfield.wire.events import Event, Linked, Measured, State
from lfield.wire.messages import Hello, Message, Refuse
from lfield.wire.watching import Events, Seen, Watch

ADDRESS, NOWHERE = "alpha:8181", "beyond:8181"


class PlayedHost:
    """A host at ADDRESS that sends what the test says, and keeps what it was sent."""

    def __init__(self, network: MemoryNetwork, incarnation: int = 7) -> None:
        self.teller = Teller(incarnation)
        self.heard: list[Message] = []
        self.links: list[Link] = []
        self.history: list[Event] = []
        self.refuses = ""
        self.listener = network.listen("alpha", ADDRESS, self._called)
        self.beats = asyncio.create_task(self._beat())

    async def _beat(self) -> None:
        """A batch every second, though nothing happens."""
        while True:
            await asyncio.sleep(1.0)
            self.happens()

    def _called(self, link: Link) -> PlayedHost:
        link.send(Hello("host", "alpha", self.teller.incarnation))
        return self

    def on_message(self, link: Link, message: Message) -> None:
        self.heard.append(message)
        if isinstance(message, Hello):
            link.greeted(message.role)
        if isinstance(message, Watch):
            if link not in self.links:
                self.links.append(link)
            link.send(Refuse(self.refuses) if self.refuses else self._answer(message))

    def _answer(self, watch: Watch) -> Events:
        life, latest = self.teller.incarnation, self.teller.number
        after = latest if watch.incarnation == 0 else watch.after if watch.incarnation == life else 0
        return Events(life, 1, 0.0, 1.0, after, latest, self.history[after:])

    def on_closed(self, link: Link, error: object) -> None:
        if link in self.links:
            self.links.remove(link)

    def happens(self, *whats: State) -> None:
        """Told at once to whoever has a link."""
        batch = self.teller.batch(2.0, *whats)
        self.history += batch.events
        for link in self.links:
            link.send(batch)

    def all(self, kind: type[Message]) -> list[Message]:
        return [message for message in self.heard if isinstance(message, kind)]


class Ears:
    """A hearer that keeps what it hears."""

    def __init__(self) -> None:
        self.log: list[str] = []
        self.batches: list[Events] = []
        self.took: list[float] = []

    def linked(self, host: str) -> None:
        self.log.append(f"{host} linked")

    def unlinked(self, host: str, why: str) -> None:
        self.log.append(why)

    def told(self, host: str, batch: Events, took: float | None) -> None:
        self.batches.append(batch)
        if took is not None:
            self.took.append(took)

    @property
    def peers(self) -> list[str]:
        return [event.what.peer for batch in self.batches for event in batch.events]


class Desk:
    """A transport of whoever follows: there is an address whose name nobody knows."""

    def __init__(self, transport: Transport) -> None:
        self._transport = transport

    async def connect(self, address: str, handler: LinkHandler) -> Link:
        if address == NOWHERE:
            raise AddressError(address, "the name is not known")
        return await self._transport.connect(address, handler)


class Scene:
    """A network, who listens on it, and who follows."""

    def __init__(self, since: int | None = None) -> None:
        self.network = MemoryNetwork(LoopClock(), on_pending=self._pending)
        self.ears, self.address = Ears(), ADDRESS
        self.follower = Follower(
            Desk(self.network.transport("desk")),  # type: ignore[arg-type]
            ["alpha"],
            self._reach,
            self.ears,
            LoopClock(),
            since=since,
            hint=lambda: "it may not run",
        )

    async def _reach(self, host: str) -> str:
        return self.address

    def _pending(self) -> None:
        due = self.network.next_due()
        if due is not None:
            # A loop may wake a tick of its clock too early, and then nothing would be due.
            asyncio.get_running_loop().call_at(due + 1e-6, self._deliver)

    def _deliver(self) -> None:
        self.network.run()
        self._pending()


def played(story: Callable[[Scene], Awaitable[None]], since: int | None = None) -> Ears:
    """Play a story while somebody follows."""

    async def main() -> Ears:
        scene = Scene(since)
        following = asyncio.create_task(scene.follower.run())
        await asyncio.sleep(0)
        await story(scene)
        following.cancel()
        await asyncio.gather(following, return_exceptions=True)
        return scene.ears

    return run_jumping(main())


def test_batches_are_handed_on_and_acknowledged() -> None:
    async def story(scene: Scene) -> None:
        host = PlayedHost(scene.network)
        await asyncio.sleep(1.0)
        host.happens(Linked("a"), Linked("b"))
        await asyncio.sleep(1.0)
        first, *others = [seen.batch for seen in host.all(Seen)]
        assert first == 1
        assert others == list(range(1, len(others) + 1))

    ears = played(story)
    assert ears.peers == ["a", "b"]
    assert ears.log[-1] == "alpha linked"
    assert len(ears.took) == 1


def test_a_cut_loses_nothing_and_tells_nothing_twice() -> None:
    async def story(scene: Scene) -> None:
        host = PlayedHost(scene.network)
        await asyncio.sleep(1.0)
        host.happens(Linked("a"))
        await asyncio.sleep(1.0)
        # What is under way is lost with the link.
        scene.network.latency = 0.5
        host.happens(Linked("b"))
        scene.network.cut("alpha", "desk")
        host.history += host.teller.batch(3.0, Linked("c")).events
        await asyncio.sleep(4.0)
        assert host.all(Watch)[-1] == Watch(7, 1, 0.0)

    ears = played(story)
    assert ears.peers == ["a", "b", "c"]
    assert "the connection was lost" in ears.log[1]


def test_what_was_heard_before_is_left_out_and_gaps_are_told() -> None:
    cursor, host = Cursor(), Teller()
    first = host.batch(1.0, Linked("a"), Linked("b"))
    assert len(cursor.took(first).events) == 2
    assert cursor.took(first).events == []
    host.batch(2.0, Linked("c"))
    late = cursor.took(host.batch(3.0, Linked("d")))
    assert (late.lost, [event.number for event in late.events]) == ({"state": 1}, [4])
    assert cursor.watch(7) == Watch(7, 4)


def test_what_is_missing_is_counted_by_its_numbers_and_once() -> None:
    cursor, host = Cursor(), Teller()
    cursor.took(host.batch(1.0, Linked("a")))
    told = host.batch(2.0, *(Linked(text) for text in "bcdef"))
    kept = replace(told, events=[event for event in told.events if event.number in (3, 6)], lost={"state": 3})
    assert cursor.took(kept).lost == {"state": 3}
    # It comes again, since it was on its way when the host was asked anew.
    again = cursor.took(kept)
    assert (again.lost, again.events) == ({}, [])
    # Of what is at the end of a batch the number says nothing until something follows.
    ends = replace(host.batch(3.0), after=9, latest=9, lost={"state": 3, "measured": 1})
    assert cursor.took(ends).lost == {"state": 3, "measured": 1}


def test_telemetry_has_no_number_of_its_own_and_is_never_left_out() -> None:
    cursor, host = Cursor(telemetry=5.0), Teller()
    cursor.took(host.batch(1.0, Linked("a")))
    for _ in range(2):
        assert len(cursor.took(host.batch(2.0, Measured("one.fc", {}, 0.0))).events) == 1
    assert cursor.watch(7) == Watch(7, 1, 5.0)


def test_another_life_is_followed_from_its_beginning() -> None:
    async def story(scene: Scene) -> None:
        host = PlayedHost(scene.network)
        await asyncio.sleep(1.0)
        host.happens(Linked("a"), Linked("b"))
        await asyncio.sleep(1.0)
        host.listener.close()
        host.beats.cancel()
        scene.network.cut("alpha", "desk")
        await asyncio.sleep(20.0)
        host = PlayedHost(scene.network, 8)
        await asyncio.sleep(LATEST + 1.0)
        # Asked with the life that was known: whoever is another one tells all that there is of it.
        assert host.all(Watch) == [Watch(7, 2, 0.0)]
        host.happens(Linked("c"))
        await asyncio.sleep(1.0)

    ears = played(story)
    assert ears.peers == ["a", "b", "c"]
    assert {batch.incarnation for batch in ears.batches} == {7, 8}
    assert all(batch.lost == {} for batch in ears.batches)


@pytest.mark.parametrize(("since", "asked"), [(None, Watch(0, 0)), (0, Watch(7, 0)), (12, Watch(7, 12))])
def test_whoever_begins_says_from_where(since: int | None, asked: Watch) -> None:
    assert Cursor(since).watch(7) == asked


def test_a_host_that_was_not_there_yet_is_followed_from_its_beginning() -> None:
    async def story(scene: Scene) -> None:
        await asyncio.sleep(3.0)
        host = PlayedHost(scene.network)
        await asyncio.sleep(LATEST + 1.0)
        (asked,) = host.all(Watch)
        assert asked.incarnation not in (0, 7)
        assert asked.after == 0

    ears = played(story)
    assert "nobody listens" in ears.log[0] or "nobody" in ears.log[0]


def test_a_host_that_is_found_elsewhere_later_is_followed_from_its_beginning() -> None:
    async def story(scene: Scene) -> None:
        scene.address = NOWHERE
        await asyncio.sleep(3.0)
        host = PlayedHost(scene.network)
        host.happens(Linked("a"))
        scene.address = ADDRESS
        await asyncio.sleep(LATEST + 1.0)

    ears = played(story)
    assert ears.peers == ["a"]
    assert all(line.endswith("; it may not run") for line in ears.log[:-1])


def test_a_host_that_hangs_is_given_up_and_called_again() -> None:
    async def story(scene: Scene) -> None:
        host = PlayedHost(scene.network)
        await asyncio.sleep(SILENT * 5)
        assert len(host.all(Watch)) == 1
        host.beats.cancel()
        await asyncio.sleep(SILENT + 2 * LOOK)
        assert len(host.all(Watch)) >= 2

    ears = played(story)
    assert any(line.startswith("nothing was heard of it for") for line in ears.log)


def test_a_refusal_is_told_and_tried_again_slowly() -> None:
    async def story(scene: Scene) -> None:
        host = PlayedHost(scene.network)
        host.refuses = "anna may do nothing"
        await asyncio.sleep(60.0)
        assert 10 < len(host.all(Watch)) < 20

    ears = played(story)
    assert "alpha refused: anna may do nothing" in ears.log
    assert "alpha linked" not in ears.log


def test_a_host_is_asked_anew_every_minute_since_clocks_drift() -> None:
    async def story(scene: Scene) -> None:
        host = PlayedHost(scene.network)
        scene.network.latency = 0.1
        await asyncio.sleep(1.5)
        for text in "abcd":
            host.happens(Linked(text))
            await asyncio.sleep(ASKED_EVERY)
        assert host.all(Watch)[1:] == [Watch(7, number, 0.0) for number in (1, 2, 3, 4)]

    ears = played(story)
    assert ears.peers == ["a", "b", "c", "d"]
    assert ears.took == [pytest.approx(0.2, abs=0.01)] * 5
    assert all(batch.lost == {} for batch in ears.batches)
