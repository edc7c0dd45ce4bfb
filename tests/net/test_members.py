"""Links of members: processing time per turn of the loop, priority, and when a link is closed.

The links are real ones, without sockets between them; time is virtual.
"""

from __future__ import annotations

import asyncio
from itertools import cycle

import pytest
from msgspec.structs import replace
from test_reception import FLOOD, HostBench, run_tls

from lfield.errors import CpuBudgetExceeded
from lfield.net.connections.tls_link import MEMBER_PIECE
from lfield.net.link_owner import MAX_LINES, PERIOD, RateLimitedLog
from lfield.net.scheduling.cpu_budgets import BURST, CPU_SHARE, MAX_EXCESS_TIME
from lfield.net.scheduling.link_schedulers import CHARGE_UNIT, SLICE
from lfield.net.tls import TlsChannel
from lfield.testing.transport_kit import MAX_BLOCK, transfer
from lfield.wire.codec import COMPRESSED, encode, encode_transfer, limits
from lfield.wire.coordinator_messages import TransferAccepted
from lfield.wire.framing import FrameDecoder
from lfield.wire.messages import Backpressure, Hello, Ping
from lfield.wire.observer_messages import EmergencyStop

#: Processing time of a message in seconds, and many messages.
COST = 1e-4
PINGS = encode(Ping(1)) * 8000


def member(inn: HostBench, name: str, cost: float = COST):
    """A host after its Hello; each of its messages costs `cost` seconds."""
    made = inn.caller(name, host=True)
    made.say(encode(Hello("host", name, 7)))
    made.recorder.works = lambda: setattr(inn, "work", inn.work + cost)
    return made


async def flood(inn: HostBench, caller, seconds: float) -> None:
    """Send more whenever the link is read, for `seconds` or until it is closed."""
    end = inn.loop.time() + seconds
    while inn.loop.time() < end and not caller.wire.closing:
        if caller.wire.reads:
            caller.say(PINGS)
        await asyncio.sleep(0.001)


@pytest.fixture(scope="session")
def runner():
    return run_tls


async def test_member_messages_take_at_most_a_slice_of_each_turn_of_the_loop(inn, /):
    bravo, charlie = member(inn, "bravo"), member(inn, "charlie")
    before = inn.work
    # Both members are read in the same turn.
    bravo.say(PINGS)
    charlie.say(PINGS)
    assert SLICE <= inn.work - before <= SLICE + COST
    assert not bravo.wire.reads
    assert not charlie.wire.reads
    for _ in range(10):
        before = inn.work
        await asyncio.sleep(0)
        assert inn.work - before <= SLICE + COST
    assert min(bravo.heard, charlie.heard) > 0.4 * max(bravo.heard, charlie.heard)


async def test_a_stop_gets_through_the_floods_of_all_members_at_once(inn, /):
    flooding = [member(inn, f"host{number}") for number in range(8)]
    for caller in flooding:
        caller.say(PINGS)
    anna = inn.caller("anna")
    before = inn.work
    anna.say(encode(Hello("observer", "observer", 0)) + encode(EmergencyStop(bytes(16), "now")))
    assert anna.recorder.messages[-1] == EmergencyStop(bytes(16), "now")
    assert inn.work - before <= COST


async def test_a_member_within_its_budget_precedes_one_over_it(inn, /):
    bravo, charlie = member(inn, "bravo"), member(inn, "charlie")
    await asyncio.wait_for(flood(inn, bravo, 2.0), 5.0)
    before = inn.work
    charlie.say(encode(Ping(2)) * 20)
    assert charlie.heard == 21
    assert inn.work - before <= 20.5 * COST


async def test_a_flood_is_reported_once_limited_and_closed_after_five_seconds(inn, /):
    bravo, started = member(inn, "bravo"), inn.loop.time()
    await flood(inn, bravo, 20.0)
    elapsed = inn.loop.time() - started
    first, last = bravo.recorder.excesses
    assert (first.closes, last.closes) == (False, True)
    assert MAX_EXCESS_TIME <= elapsed <= MAX_EXCESS_TIME + 2.0
    assert inn.work <= BURST + CPU_SHARE * elapsed + 0.2
    assert bravo.link.closed
    bravo.link.connection_lost(None)
    (end,) = bravo.recorder.ends
    assert isinstance(end, CpuBudgetExceeded)
    inn.callers.remove(bravo)
    bravo.wire.free()


async def test_small_messages_are_charged_in_units(inn, /):
    """Each message costs less than a unit; together they exceed the share of a member."""
    bravo, started = member(inn, "bravo", CHARGE_UNIT * 0.75), inn.loop.time()
    while not bravo.recorder.excesses and inn.loop.time() - started < 30.0:
        bravo.say(encode(Ping(1)))
        await asyncio.sleep(0.01)
    assert not bravo.recorder.excesses[0].closes
    elapsed = inn.loop.time() - started
    used_up = BURST / (inn.work / elapsed - CPU_SHARE)
    assert used_up <= elapsed <= used_up + 2.0, "a probe shows that the member does not wait for answers"


async def test_an_exhausted_budget_outlives_the_link(inn, /):
    bravo = member(inn, "bravo")
    await flood(inn, bravo, 20.0)
    again = member(inn, "bravo")
    before, started = inn.work, inn.loop.time()
    await flood(inn, again, 1.0)
    assert inn.work - before <= CPU_SHARE * (inn.loop.time() - started) + 0.1
    assert not again.wire.closing


class Hops:
    """Transfers to the host, which answers each one after it has processed it."""

    def __init__(self, inn: HostBench, caller, cost: float) -> None:
        self._inn, self._caller, self._cost, self._read = inn, caller, cost, caller.read
        self._frames = FrameDecoder(limits("host", 1 << 20))
        caller.recorder.on_transfer = self._answer
        caller.recorder.on_oversize = lambda link, header, size: self._answer(link, header, b"")

    def _answer(self, link, header, block) -> None:
        self._inn.work += self._cost
        link.send(TransferAccepted(header.agent, 1, 1))

    async def send(self, data: bytes) -> bool:
        """Send in reads of CHUNK bytes; return whether the link is still open."""
        for at in range(0, len(data), CHUNK):
            await asyncio.sleep(1e-3)
            while not self._caller.wire.reads and not self._caller.wire.closing:
                await asyncio.sleep(1e-3)
            if self._caller.wire.closing:
                return False
            self._caller.say(data[at : at + CHUNK])
        return True

    async def answers(self, *agents: str) -> None:
        """Wait until the host has answered all of these transfers."""
        missing = len(agents)
        while missing > 0:
            await asyncio.sleep(1e-3)
            assert not self._caller.wire.closing
            arrived = b"".join(self._caller._channel.receive(self._caller.wire.said[self._read :]))
            # Heartbeats and handshakes are never compressed.
            missing -= sum(kind == COMPRESSED for kind, _ in self._frames.feed(arrived))
            self._read = len(self._caller.wire.said)


@pytest.mark.few(0)
async def test_successive_hops_are_neither_delayed_nor_closed(inn, /):
    """One coordinator whose block costs a slow computer a millisecond, as fast as possible."""
    bravo, block, started, count = member(inn, "bravo", 1e-3), b"block", inn.loop.time(), 0
    hop = encode_transfer(replace(transfer(len(block)), agent="tom"), block) + block
    hops = Hops(inn, bravo, 1e-3)
    while inn.loop.time() < started + 10.0:
        await hops.send(hop)
        await hops.answers("tom")
        count += 1
    assert count > 0.8 * 10.0 / 2e-3
    assert not bravo.wire.closing


#: A block that arrives in several reads of CHUNK bytes.
BLOCK, CHUNK = bytes(20 << 10), 8 << 10


def large(agent: str = "tom", size: int = 20 << 10) -> bytes:
    return encode_transfer(replace(transfer(size), agent=agent), BLOCK) + bytes(size)


@pytest.mark.few(0)
async def test_large_hops_that_wait_for_answers_are_not_closed(inn, /):
    """Several coordinators at once; each is sent again after its answer."""
    bravo, started, agents = member(inn, "bravo"), inn.loop.time(), ("tom", "ann", "eve")
    hops = Hops(inn, bravo, 0.02)
    while inn.loop.time() < started + 20.0:
        await hops.send(b"".join(map(large, agents)))
        await hops.answers(*agents)
        await asyncio.sleep(0.04)
    assert inn.work > 8 * CPU_SHARE * 20.0
    assert not bravo.wire.closing


@pytest.mark.parametrize("agents", [1, 3, 40])
async def test_endless_large_transfers_are_closed_after_five_seconds_over_budget(inn, /, agents):
    """Of one coordinator, and of several in turn."""
    bravo, started = member(inn, "bravo"), inn.loop.time()
    hops, stream = Hops(inn, bravo, 4e-3), b"".join(large(f"c{number}") for number in range(agents))
    while await hops.send(stream):
        assert inn.loop.time() < started + 20.0
    assert MAX_EXCESS_TIME <= inn.loop.time() - started <= MAX_EXCESS_TIME + 3.0


@pytest.mark.parametrize("times", [4, 100], ids=["many", "one endless"])
async def test_endless_oversized_blocks_are_closed_after_five_seconds_over_budget(inn, /, monkeypatch, times):
    bravo, started, size = member(inn, "bravo"), inn.loop.time(), times * MAX_BLOCK
    hops, feed = Hops(inn, bravo, 0.0), TlsChannel.receive
    monkeypatch.setattr(
        TlsChannel,
        "receive",
        lambda self, data: (setattr(inn, "work", inn.work + 4e-3), feed(self, data))[1],
    )
    for agent in cycle(("tom", "ann", "eve")):
        await hops.send(encode_transfer(replace(transfer(size), agent=agent), bytes(size)))
        for _ in range(times):
            if not await hops.send(bytes(MAX_BLOCK)):
                break
            assert inn.loop.time() < started + 20.0
        if bravo.wire.closing:
            break
    assert MAX_EXCESS_TIME <= inn.loop.time() - started <= MAX_EXCESS_TIME + 3.0


async def test_long_messages_have_more_weight(inn, /):
    """A few messages of a megabyte cost as much as thousands of short ones."""
    bravo = member(inn, "bravo", 0.02)
    long = encode(Backpressure("x" * 1900)) * 3
    started = inn.loop.time()
    while inn.loop.time() < started + 20.0 and not bravo.wire.closing:
        if bravo.wire.reads:
            bravo.say(long * 40)
        await asyncio.sleep(1e-3)
    assert bravo.wire.closing


async def test_messages_after_the_hello_in_one_read_are_limited(inn, /):
    bravo = inn.caller("bravo", host=True)
    bravo.recorder.works = lambda: setattr(inn, "work", inn.work + COST)
    bravo.say(encode(Hello("host", "bravo", 7)) + PINGS)
    assert bravo.heard <= 2 + SLICE / COST


async def test_records_without_a_message_are_processed_in_pieces(inn, /, monkeypatch):
    bravo, fed = member(inn, "bravo"), []
    feed = TlsChannel.receive
    monkeypatch.setattr(
        TlsChannel, "receive", lambda self, data: (fed.append(len(data)), feed(self, data))[1]
    )
    bravo.say(PINGS, record=16 << 10)
    while not bravo.wire.reads:
        await asyncio.sleep(0.1)
    assert len(fed) > 1
    assert max(fed) <= MEMBER_PIECE


async def test_a_closed_link_is_removed_while_it_waits_or_is_held(inn, /):
    bravo, charlie = member(inn, "bravo"), member(inn, "charlie")
    await flood(inn, bravo, 3.0)
    charlie.say(PINGS)
    for caller in (bravo, charlie):
        caller.link.connection_lost(None)
        had = caller.heard
        await asyncio.sleep(2.0)
        assert caller.heard == had
        inn.callers.remove(caller)
        caller.wire.free()


@pytest.mark.parametrize("who", ["anna", "bravo"])
async def test_an_observer_is_never_treated_as_a_member(inn, /, who):
    caller = inn.caller(who, host=who == "bravo")
    caller.say(encode(Hello("observer", who, 0)) + FLOOD)
    await asyncio.sleep(8.0)
    assert caller.recorder.excesses == []
    assert not caller.wire.closing


def test_messages_with_always_new_names_do_not_fill_the_log():
    lines, now = [], [0.0]
    complaints = RateLimitedLog(lines.append, lambda: now[0])
    for number in range(10_000):
        now[0] = number * 0.001
        complaints.write(f"bravo sent c{number} or asked for it in an earlier life of alpha")
        complaints.write("a caller is refused")
    assert len(lines) == MAX_LINES + 1
    assert lines[1] == "a caller is refused"
    assert lines[-1] == "log lines about invalid messages of peers suppressed for 60 s: too many"
    # Later messages are written again, with the number of suppressed ones.
    now[0] = PERIOD
    complaints.write("the certificate of bravo has ended")
    assert lines[MAX_LINES + 1 :] == [
        f"{10_000 - (MAX_LINES - 1)} log lines about invalid messages of peers suppressed",
        "the certificate of bravo has ended",
    ]
    complaints.write("the certificate of bravo has ended")
    assert len(lines) == MAX_LINES + 3
