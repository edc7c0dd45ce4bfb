"""Connections that are not authenticated: which are accepted, and which are closed to make room."""

import random
from collections.abc import Callable
from functools import partial
from itertools import cycle

import pytest

from lfield.net.connection_limiter import ConnectionLimiter
from lfield.net.scheduling.handshake_scheduler import (
    AT_ONCE,
    CPU_SHARE,
    MAX_REMEMBERED,
    AddressTrust,
    CallerAddresses,
    HandshakeScheduler,
    source_of,
)


def test_all_connections_are_kept_below_the_limit():
    clients = ConnectionLimiter(3, random.Random(1))
    assert [clients.admit(n, "here") for n in range(3)] == [None] * 3
    clients.release(1)
    clients.release(1)
    clients.release("absent")
    assert clients.admit(3, "here") is None
    assert clients.admit(4, "here") in (0, 2, 3)


def test_a_flood_from_one_address_displaces_only_its_own_connections():
    clients = ConnectionLimiter(64, random.Random(1))
    clients.admit("peer", "there")
    pushed = [clients.admit(n, "here") for n in range(10_000)]
    assert "peer" not in pushed
    assert sum(evicted is not None for evicted in pushed) == 10_000 - 63
    assert clients.admit("next peer", "elsewhere") not in (None, "peer")


@pytest.mark.few(0)
def test_retries_at_the_address_of_a_flood_get_time_to_authenticate():
    """Thirty connections follow before the Hello of a peer is read: two of three attempts succeed."""
    clients, through = ConnectionLimiter(64, random.Random(1)), 0
    for attempt in range(300):
        peer = f"peer {attempt}"
        clients.admit(peer, "here")
        pushed = [clients.admit((attempt, n), "here") for n in range(30)]
        through += peer not in pushed
        clients.release(peer)
    assert 150 < through < 250


def test_the_last_free_place_displaces_one_connection_of_the_same_address():
    clients = ConnectionLimiter(3, random.Random(1))
    assert clients.admit("a", "field", last=True) is None
    assert clients.admit("b", "field", last=True) == "a"
    assert clients.admit("c", "field") is None
    assert clients.admit("d", "elsewhere", last=True) in ("b", "c")


# Handshakes: a flood, and one peer that authenticates, in virtual time

#: Processing time of a part of a handshake, and the time between its two parts: 50 ms over a network.
COST, TRIP = 7e-4, 0.05


class HandshakeHost:
    """A host that processes only handshakes. Two parts authenticate a peer."""

    def __init__(self, addresses: Callable[[], str], rate: float) -> None:
        self._next_address, self._rate = addresses, rate
        self._answered: set[object] = set()
        self._addresses: dict[object, str] = {}
        self.guests: ConnectionLimiter[object] = ConnectionLimiter(
            64, random.Random(1), lambda guest: guest in self._answered
        )
        self.handshakes: HandshakeScheduler[object] = HandshakeScheduler()
        self.now, self._came, self.busy = 0.0, 0, 0.0
        self.proven: list[object] = []
        #: When the second part of a peer's handshake arrives.
        self._coming: list[tuple[float, str]] = []

    def call(self, guest: object, address: str) -> None:
        self._addresses[guest] = address
        pushed = self.guests.admit(guest, address)
        if pushed is not None:
            self._close(pushed)
        self.handshakes.add(guest, address, is_answered=False)

    def is_connected(self, guest: object) -> bool:
        return guest in self._addresses

    def run(self, until: float) -> None:
        while self.now < until:
            while self._came < self.now * self._rate:
                self._came += 1
                self.call(self._came, self._next_address())
            for due in [due for due in self._coming if due[0] <= self.now]:
                self._coming.remove(due)
                if self.is_connected(due[1]):
                    self.handshakes.add(due[1], self._addresses[due[1]], is_answered=True)
            guest = self.handshakes.next(self.now)
            if guest is None:
                self.now += 1e-4
                continue
            self.now += COST
            self.busy += COST
            self.handshakes.charge(COST, self.now)
            self.handshakes.remove(guest)
            self._taken(guest)

    def _taken(self, guest: object) -> None:
        if guest not in self._answered:
            self._answered.add(guest)
            if isinstance(guest, str):
                self._coming.append((self.now + TRIP, guest))
            return
        self.guests.on_authenticated(guest, self._addresses[guest])
        self.handshakes.sources.on_proven(self._addresses.pop(guest))
        self.proven.append(guest)

    def _close(self, guest: object) -> None:
        self.handshakes.remove(guest)
        self.handshakes.sources.on_failed(self._addresses.pop(guest))


def seconds_to_authenticate(server: HandshakeHost, name: str, address: str) -> float:
    """The time that a peer needs that reconnects when it is closed, at most every 0.1 s."""
    started, attempt = server.now, 0
    while not any(isinstance(guest, str) and guest.startswith(name) for guest in server.proven):
        attempt += 1
        server.call(f"{name} {attempt}", address)
        while server.is_connected(f"{name} {attempt}") and server.now < started + 60.0:
            server.run(server.now + 0.1)
        assert server.now < started + 60.0
    return server.now - started


FLOODS = {
    "one address": lambda: "10.0.0.66",
    "40 addresses": partial(next, cycle([f"10.0.1.{number}" for number in range(40)])),
    "1000 addresses": partial(next, cycle([f"10.1.{n // 250}.{n % 250}" for n in range(1000)])),
}


@pytest.mark.few(0)
@pytest.mark.parametrize("flood", FLOODS)
@pytest.mark.parametrize("rate", [500, 3000])
def test_a_flood_of_handshakes_gets_its_share_and_delays_no_other_address(flood, rate):
    server = HandshakeHost(FLOODS[flood], rate)
    server.run(3.0)
    assert server.busy <= CPU_SHARE * server.now + AT_ONCE + 2 * COST
    # Two parts, each of which waits for a few others, and the round trip between them.
    assert seconds_to_authenticate(server, "stop", "10.9.9.9") <= TRIP + 0.1 + 0.05
    assert seconds_to_authenticate(server, "the same again", "10.9.9.9") <= TRIP + 0.1 + 0.05


@pytest.mark.parametrize("rate", [500, pytest.param(3000, marks=pytest.mark.few(0))])
def test_a_stop_from_the_address_of_a_flood_gets_its_turn(rate):
    server = HandshakeHost(FLOODS["one address"], rate)
    server.run(3.0)
    times = [seconds_to_authenticate(server, f"stop{number}", "10.0.0.66") for number in range(20)]
    assert sum(times) / len(times) <= 3.0


def test_the_source_is_an_address_without_port_or_an_ipv6_network():
    assert source_of("10.0.0.1:4711") == "10.0.0.1"
    assert source_of("[2001:db8::1]:1") == source_of("[2001:db8::ffff:2]:9") == "2001:db8::"
    assert source_of("[2001:db8:0:1::1]:1") != source_of("[2001:db8::1]:1")
    assert source_of("[fe80::1%eth0]:1") != source_of("[fe80::2%eth0]:1")
    assert source_of("a command on this computer") == "a command on this computer"


def test_the_number_of_remembered_addresses_is_bounded():
    sources = CallerAddresses()
    sources.on_proven("10.0.0.1")
    for number in range(3 * MAX_REMEMBERED):
        sources.on_failed(f"10.2.{number // 250}.{number % 250}")
    assert sources.trust("10.0.0.1") is AddressTrust.PROVEN
    sources.on_failed("10.0.0.1")
    assert sources.trust("10.0.0.1") is AddressTrust.PROVEN
    assert sources.trust("10.2.0.0") is AddressTrust.NEW
    assert sources.trust(f"10.2.{(3 * MAX_REMEMBERED - 1) // 250}.{(3 * MAX_REMEMBERED - 1) % 250}") is (
        AddressTrust.FAILED
    )
