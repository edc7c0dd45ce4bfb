"""Connections on loopback: names whose addresses change, silent addresses, listeners that follow their
name."""

from __future__ import annotations

import asyncio
import itertools
import socket

import pytest
from address_book import HOLE, listening, needs_ipv6, until

from lfield.address_race import ATTEMPT_DELAY, LONGEST_PAUSE, retry_pause
from lfield.errors import AddressError, NoListener
from lfield.net.connections import listener as listeners
from lfield.net.connections import resolver
from lfield.net.connections.dialler import REPORT_AFTER, Dialler
from lfield.net.connections.resolver import MAX_LOOKUPS, ResolvedAddress, resolve
from lfield.net.link_owner import RefusedHosts
from lfield.net.local_addresses import open_listening_socket, require_port_free
from lfield.net.peer_credentials import socket_address
from lfield.net.tcp_transport import TcpTransport
from lfield.net.transport import is_lasting
from lfield.simulate.jumping_loop import LoopClock, run_jumping
from lfield.testing.transport_kit import MAX_BLOCK, Recorder

# Names


async def test_a_name_is_resolved_at_each_attempt(name_table):
    name_table.rows["bravo"] = ["127.0.0.2"]
    transport = TcpTransport(MAX_BLOCK)
    one, _ = await listening("127.0.0.2:0")
    port = one.address.rpartition(":")[2]
    two, _ = await listening(f"127.0.0.3:{port}")
    first = await transport.connect(f"bravo:{port}", Recorder())
    assert first.peer == f"127.0.0.2:{port}"
    name_table.rows["bravo"] = ["127.0.0.3"]
    second = await transport.connect(f"bravo:{port}", Recorder())
    assert second.peer == f"127.0.0.3:{port}"
    for opened in (first, second, one, two):
        opened.close()


async def test_a_hanging_lookup_blocks_neither_the_loop_nor_other_lookups(name_table):
    name_table.rows |= {"dead": ["127.0.0.2"], "bravo": ["127.0.0.3"]}
    name_table.blocking.add("dead")
    hanging = [asyncio.ensure_future(resolve("dead", 1)) for _ in range(MAX_LOOKUPS)]
    await until(lambda: name_table.asked == MAX_LOOKUPS)
    with pytest.raises(socket.gaierror):
        await resolve("dead", 1)
    (found,) = await resolve("bravo", 7)
    assert found.address == ("127.0.0.3", 7)
    # The name server answers again: new lookups do not wait for the old ones.
    hanging.pop().cancel()
    name_table.blocked.set()
    await asyncio.gather(*hanging)
    await until(lambda: not resolver._running)
    assert await resolve("dead", 1)


async def test_a_numeric_address_is_not_resolved(name_table):
    name_table.rows["127.0.0.1"] = ["127.0.0.7"]
    (found,) = await resolve("127.0.0.1", 9)
    assert found == ResolvedAddress(socket.AF_INET, ("127.0.0.1", 9))


async def test_an_unknown_zone_is_named_in_the_error():
    with pytest.raises(AddressError, match="no such network interface"):
        await TcpTransport(MAX_BLOCK).connect("[fe80::1%nowhere]:9", Recorder())


@pytest.mark.parametrize(
    ("host", "lasting"),
    [("127.0.0.1", True), ("fd00::1", True), ("fe80::1%eth0", False), ("bravo", False), ("::", True)],
)
def test_numeric_addresses_without_a_zone_are_lasting(host, lasting):
    assert is_lasting(host) is lasting


@pytest.mark.parametrize(
    ("name", "text"),
    [
        (("10.0.0.1", 9), "10.0.0.1:9"),
        (("fd00::1", 9, 0, 0), "[fd00::1]:9"),
        (("::ffff:10.0.0.1", 9, 0, 0), "10.0.0.1:9"),
        (("fe80::1", 9, 0, socket.if_nametoindex("lo")), "[fe80::1%lo]:9"),
        (("fe80::1%lo", 9, 0, 1), "[fe80::1%lo]:9"),
        (("fe80::1", 9, 0, 99999), "[fe80::1%99999]:9"),
    ],
)
def test_a_socket_address_is_written_in_the_form_that_is_accepted(name, text):
    assert socket_address(name) == text


# Attempts


async def test_a_silent_address_does_not_delay_the_next_one(name_table, hole):
    name_table.rows["bravo"] = [HOLE, "127.0.0.3"]
    there, _ = await listening(f"127.0.0.3:{hole}")
    loop, transport = asyncio.get_running_loop(), TcpTransport(MAX_BLOCK)
    started = loop.time()
    link = await transport.connect(f"bravo:{hole}", Recorder())
    assert link.peer == f"127.0.0.3:{hole}"
    assert loop.time() - started >= ATTEMPT_DELAY
    link.close()
    there.close()


@needs_ipv6
async def test_a_name_with_both_families_is_reached_over_either(name_table):
    name_table.rows["bravo"] = ["::1", "127.0.0.1"]
    for address in ("127.0.0.1:0", "[::1]:0"):
        there, _ = await listening(address)
        port = there.address.rpartition(":")[2]
        link = await TcpTransport(MAX_BLOCK).connect(f"bravo:{port}", Recorder())
        assert link.peer == there.address
        link.close()
        there.close()


# Listeners


@needs_ipv6
async def test_the_unspecified_ipv6_address_accepts_both_families():
    there, accepted = await listening("[::]:0")
    port = there.address.rpartition(":")[2]
    links = [await TcpTransport(MAX_BLOCK).connect(f"{a}:{port}", Recorder()) for a in ("127.0.0.1", "[::1]")]
    await until(lambda: len(accepted) == 2)
    for opened in (*links, there):
        opened.close()


def test_a_port_taken_between_bind_and_listen_is_reported_and_closed(runner, monkeypatch):
    bind, bound = listeners.bound_socket, []
    with socket.socket() as rival:
        rival.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        rival.bind(("127.0.0.1", 0))

        def bound_and_taken(at, port):
            bound.append(bind(at, port))
            rival.listen()
            return bound[-1]

        monkeypatch.setattr(listeners, "bound_socket", bound_and_taken)

        async def scenario():
            with pytest.raises(AddressError, match="the port is in use"):
                await listening(f"127.0.0.1:{rival.getsockname()[1]}")

        runner(scenario)
    assert [made.fileno() for made in bound] == [-1]


async def test_a_listener_follows_its_name_and_retries_a_failed_address(name_table, monkeypatch):
    monkeypatch.setattr(listeners, "CHECK_EVERY", 0.02)

    name_table.rows["alpha"] = ["127.0.0.2"]
    transport, notes = TcpTransport(MAX_BLOCK), []
    transport.note = notes.append
    there, accepted = await listening("alpha:0", transport)
    port = int(there.address.rpartition(":")[2])
    # Another process uses the port for a while.
    with socket.create_server(("127.0.0.3", port)):
        name_table.rows["alpha"] = ["127.0.0.3"]
        await until(lambda: any("not listening on 127.0.0.3" in note for note in notes))
        assert there.address == f"127.0.0.2:{port}"
    await until(lambda: there.address == f"127.0.0.3:{port}")
    assert sum("not listening on" in note for note in notes) == 1
    link = await TcpTransport(MAX_BLOCK).connect(f"127.0.0.3:{port}", Recorder())
    await until(lambda: len(accepted) == 1)
    with pytest.raises(NoListener):
        await TcpTransport(MAX_BLOCK).connect(f"127.0.0.2:{port}", Recorder())
    # A name without an address for a while changes nothing.
    name_table.rows["alpha"] = []
    queries = name_table.asked
    await until(lambda: name_table.asked > queries + 2)
    assert there.address == f"127.0.0.3:{port}"
    link.close()
    there.close()
    await until(lambda: not resolver._running)


async def test_a_listener_uses_only_the_local_addresses_of_its_name(name_table):
    name_table.rows["alpha"] = ["192.0.2.1", "127.0.0.2"]
    there, _ = await listening("alpha:0")
    assert there.address.startswith("127.0.0.2:")
    there.close()
    name_table.rows["alpha"] = ["192.0.2.1"]
    with pytest.raises(AddressError, match="not one of this machine"):
        await listening("alpha:0")
    await until(lambda: not resolver._running)


@needs_ipv6
@pytest.mark.parametrize("address", ["[::1]:0", "127.0.0.1:0", "[::]:0"])
def test_a_port_is_reserved_in_each_address_family(address):
    reserved, text = open_listening_socket(address)
    with reserved:
        with pytest.raises(AddressError) as error:
            require_port_free(text)
        assert "in use" in error.value.reason
    require_port_free(text)


# Repeated connection attempts


class Caller:
    """Needs a link with bravo, which is unreachable."""

    def __init__(self, errors: list[Exception]) -> None:
        self.errors, self.calls, self.notes, self.barred = errors, [], [], 0.0
        self.refusals = RefusedHosts(["bravo"])

    def needs_link(self, host):
        return True

    def link_of(self, host):
        return None

    def now(self):
        return 0.0

    def ban_remaining(self, host):
        left, self.barred = self.barred, 0.0
        return left

    def on_dialled(self, host):
        pass

    async def connect(self, address, handler, host=""):
        now = asyncio.get_running_loop().time()
        self.calls.append(now)
        raise self.errors[len(self.calls) % len(self.errors)]


def test_retries_back_off_and_each_failure_is_reported_once():
    errors = [AddressError("b:1", "no answer"), AddressError("b:1", "no way")]

    async def scenario():
        caller = Caller(errors)
        dialler = Dialler(caller, caller, LoopClock(), "bravo", "b:1", caller.notes.append)
        await asyncio.sleep(REPORT_AFTER - 0.1)
        assert caller.notes == []
        await asyncio.sleep(600.0)
        dialler.cancel()
        start = caller.calls[0]
        for before, after in itertools.pairwise(caller.calls):
            assert after - before <= retry_pause(after - start) + 1e-6
        assert caller.calls[-1] - caller.calls[-2] == pytest.approx(LONGEST_PAUSE)
        assert len(caller.notes) == 2
        assert {"no answer" in note for note in caller.notes} == {True, False}
        assert all("bravo unreachable at b:1" in note for note in caller.notes)

    run_jumping(scenario())


def test_a_banned_host_is_not_dialled_until_the_ban_ends():
    async def scenario():
        caller = Caller([AddressError("b:1", "no answer")])
        caller.barred, started = 8.0, asyncio.get_running_loop().time()
        dialler = Dialler(caller, caller, LoopClock(), "bravo", "b:1", caller.notes.append)
        await asyncio.sleep(9.0)
        dialler.cancel()
        assert caller.calls[0] == pytest.approx(started + 8.0)

    run_jumping(scenario())
