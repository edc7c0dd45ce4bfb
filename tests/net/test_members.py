"""Links of members: what one turn of the loop takes of them, who comes first, when a link is closed.

The links are real ones. Between them are no sockets, and time jumps.
"""

from __future__ import annotations

import asyncio
from itertools import cycle

import pytest
from msgspec.structs import replace
from test_reception import FLOOD, Inn, run_tls

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

#: What a message costs a computer, in seconds, and many of them.
COST = 1e-4
PINGS = encode(Ping(1)) * 8000


def member(inn: Inn, name: str, cost: float = COST):
    """A host that has greeted, and for each of whose messages the computer works so long."""
    made = inn.caller(name, host=True)
    made.say(encode(Hello("host", name, 7)))
    made.hears.works = lambda: setattr(inn, "work", inn.work + cost)
    return made


async def floods(inn: Inn, caller, seconds: float) -> None:
    """Whenever the link is read there is more, for so long or until it is closed."""
    end = inn.loop.time() + seconds
    while inn.loop.time() < end and not caller.wire.closing:
        if caller.wire.reads:
            caller.say(PINGS)
        await asyncio.sleep(0.001)


@pytest.fixture(scope="session")
def runner():
    return run_tls


async def test_no_turn_of_the_loop_takes_messages_of_members_for_longer_than_a_slice(inn, /):
    bravo, charlie = member(inn, "bravo"), member(inn, "charlie")
    before = inn.work
    # Both in the same turn.
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
    assert anna.hears.messages[-1] == EmergencyStop(bytes(16), "now")
    assert inn.work - before <= COST


async def test_whose_messages_are_within_the_budget_comes_before_who_is_over_it(inn, /):
    bravo, charlie = member(inn, "bravo"), member(inn, "charlie")
    await asyncio.wait_for(floods(inn, bravo, 2.0), 5.0)
    before = inn.work
    charlie.say(encode(Ping(2)) * 20)
    assert charlie.heard == 21
    assert inn.work - before <= 20.5 * COST


async def test_a_flood_is_reported_once_held_to_its_ration_and_closed_after_five_seconds_over_budget(inn, /):
    bravo, began = member(inn, "bravo"), inn.loop.time()
    await floods(inn, bravo, 20.0)
    took = inn.loop.time() - began
    first, last = bravo.hears.excesses
    assert (first.closes, last.closes) == (False, True)
    assert MAX_EXCESS_TIME <= took <= MAX_EXCESS_TIME + 2.0
    assert inn.work <= BURST + CPU_SHARE * took + 0.2
    assert bravo.link.closed
    bravo.link.connection_lost(None)
    (end,) = bravo.hears.ends
    assert isinstance(end, CpuBudgetExceeded)
    inn.callers.remove(bravo)
    bravo.wire.free()


async def test_messages_that_arrive_alone_are_charged_in_units(inn, /):
    """Each costs less than a unit, and all of them more than the share of a member."""
    bravo, began = member(inn, "bravo", CHARGE_UNIT * 0.75), inn.loop.time()
    while not bravo.hears.excesses and inn.loop.time() - began < 30.0:
        bravo.say(encode(Ping(1)))
        await asyncio.sleep(0.01)
    assert not bravo.hears.excesses[0].closes
    took = inn.loop.time() - began
    used_up = BURST / (inn.work / took - CPU_SHARE)
    assert used_up <= took <= used_up + 2.0, "a probe shows that it does not wait for answers"


async def test_the_debt_outlives_the_link(inn, /):
    bravo = member(inn, "bravo")
    await floods(inn, bravo, 20.0)
    again = member(inn, "bravo")
    before, began = inn.work, inn.loop.time()
    await floods(inn, again, 1.0)
    assert inn.work - before <= CPU_SHARE * (inn.loop.time() - began) + 0.1
    assert not again.wire.closing


class Hops:
    """Transfers to the host, which answers each when it has worked for it."""

    def __init__(self, inn: Inn, caller, cost: float) -> None:
        self._inn, self._caller, self._cost, self._read = inn, caller, cost, caller.read
        self._frames = FrameDecoder(limits("host", 1 << 20))
        caller.hears.on_transfer = self._answer
        caller.hears.on_oversize = lambda link, header, size: self._answer(link, header, b"")

    def _answer(self, link, header, block) -> None:
        self._inn.work += self._cost
        link.send(TransferAccepted(header.agent, 1, 1))

    async def send(self, data: bytes) -> bool:
        """In reads of CHUNK bytes; whether the link is still open."""
        for at in range(0, len(data), CHUNK):
            await asyncio.sleep(1e-3)
            while not self._caller.wire.reads and not self._caller.wire.closing:
                await asyncio.sleep(1e-3)
            if self._caller.wire.closing:
                return False
            self._caller.say(data[at : at + CHUNK])
        return True

    async def answers(self, *agents: str) -> None:
        """Wait until the host has answered so many transfers."""
        missing = len(agents)
        while missing > 0:
            await asyncio.sleep(1e-3)
            assert not self._caller.wire.closing
            arrived = b"".join(self._caller._channel.receive(self._caller.wire.said[self._read :]))
            # Heartbeats and handshakes are never compressed.
            missing -= sum(kind == COMPRESSED for kind, _ in self._frames.feed(arrived))
            self._read = len(self._caller.wire.said)


async def test_a_hop_after_hop_is_neither_held_for_long_nor_closed(inn, /):
    """One coordinator whose block costs a slow computer a millisecond, as fast as it can."""
    bravo, block, began, count = member(inn, "bravo", 1e-3), b"block", inn.loop.time(), 0
    hop = encode_transfer(replace(transfer(len(block)), agent="tom"), block) + block
    hops = Hops(inn, bravo, 1e-3)
    while inn.loop.time() < began + 10.0:
        await hops.send(hop)
        await hops.answers("tom")
        count += 1
    assert count > 0.8 * 10.0 / 2e-3
    assert not bravo.wire.closing


#: A block that comes in several reads of CHUNK bytes.
BLOCK, CHUNK = bytes(20 << 10), 8 << 10


def large(agent: str = "tom", size: int = 20 << 10) -> bytes:
    return encode_transfer(replace(transfer(size), agent=agent), BLOCK) + bytes(size)


async def test_large_hops_that_wait_for_answers_are_not_closed(inn, /):
    """Several coordinators at once, each of which is sent again when its answer has come."""
    bravo, began, agents = member(inn, "bravo"), inn.loop.time(), ("tom", "ann", "eve")
    hops = Hops(inn, bravo, 0.02)
    while inn.loop.time() < began + 20.0:
        await hops.send(b"".join(map(large, agents)))
        await hops.answers(*agents)
        await asyncio.sleep(0.04)
    assert inn.work > 8 * CPU_SHARE * 20.0
    assert not bravo.wire.closing


@pytest.mark.parametrize("agents", [1, 3, 40])
async def test_large_transfers_without_end_are_closed_after_five_seconds_over_budget(inn, /, agents):
    """Of one coordinator, and of several in turn."""
    bravo, began = member(inn, "bravo"), inn.loop.time()
    hops, stream = Hops(inn, bravo, 4e-3), b"".join(large(f"c{number}") for number in range(agents))
    while await hops.send(stream):
        assert inn.loop.time() < began + 20.0
    assert MAX_EXCESS_TIME <= inn.loop.time() - began <= MAX_EXCESS_TIME + 3.0


@pytest.mark.parametrize("times", [4, 100], ids=["many", "one that never ends"])
async def test_blocks_that_are_too_long_without_end_are_closed_after_five_seconds_over_budget(
    inn, /, monkeypatch, times
):
    bravo, began, size = member(inn, "bravo"), inn.loop.time(), times * MAX_BLOCK
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
            assert inn.loop.time() < began + 20.0
        if bravo.wire.closing:
            break
    assert MAX_EXCESS_TIME <= inn.loop.time() - began <= MAX_EXCESS_TIME + 3.0


async def test_long_messages_count_for_more(inn, /):
    """A few of a megabyte each cost as much as thousands of short ones."""
    bravo = member(inn, "bravo", 0.02)
    long = encode(Backpressure("x" * 1900)) * 3
    began = inn.loop.time()
    while inn.loop.time() < began + 20.0 and not bravo.wire.closing:
        if bravo.wire.reads:
            bravo.say(long * 40)
        await asyncio.sleep(1e-3)
    assert bravo.wire.closing


async def test_what_comes_with_a_greeting_is_rationed(inn, /):
    bravo = inn.caller("bravo", host=True)
    bravo.hears.works = lambda: setattr(inn, "work", inn.work + COST)
    bravo.say(encode(Hello("host", "bravo", 7)) + PINGS)
    assert bravo.heard <= 2 + SLICE / COST


async def test_records_without_a_message_are_taken_in_pieces(inn, /, monkeypatch):
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


async def test_who_goes_while_it_waits_or_is_held_is_forgotten(inn, /):
    bravo, charlie = member(inn, "bravo"), member(inn, "charlie")
    await floods(inn, bravo, 3.0)
    charlie.say(PINGS)
    for caller in (bravo, charlie):
        caller.link.connection_lost(None)
        had = caller.heard
        await asyncio.sleep(2.0)
        assert caller.heard == had
        inn.callers.remove(caller)
        caller.wire.free()


@pytest.mark.parametrize("who", ["anna", "bravo"])
async def test_an_observer_is_no_member_whoever_it_is(inn, /, who):
    caller = inn.caller(who, host=who == "bravo")
    caller.say(encode(Hello("observer", who, 0)) + FLOOD)
    await asyncio.sleep(8.0)
    assert caller.hears.excesses == []
    assert not caller.wire.closing


def test_ever_new_names_fill_no_log():
    lines, now = [], [0.0]
    complaints = RateLimitedLog(lines.append, lambda: now[0])
    for number in range(10_000):
        now[0] = number * 0.001
        complaints.write(f"bravo sent c{number} or asked for it in an earlier life of alpha")
        complaints.write("a caller is refused")
    assert len(lines) == MAX_LINES + 1
    assert lines[1] == "a caller is refused"
    assert lines[-1] == "log lines about invalid messages of peers suppressed for 60 s: too many"
    # What else is wrong later is said, and how much was not.
    now[0] = PERIOD
    complaints.write("the certificate of bravo has ended")
    assert lines[MAX_LINES + 1 :] == [
        f"{10_000 - (MAX_LINES - 1)} log lines about invalid messages of peers suppressed",
        "the certificate of bravo has ended",
    ]
    complaints.write("the certificate of bravo has ended")
    assert len(lines) == MAX_LINES + 3
