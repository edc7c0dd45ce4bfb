"""Hosts with several addresses in order of preference: silent, closed, unknown, or of another host."""

from __future__ import annotations

import asyncio
import socket
from pathlib import Path

import pytest
from address_book import HOLE, listening, needs_ipv6, until

from lfield.authority.identity import ALL_RIGHTS
from lfield.errors import AddressError, HandshakeError, NoListener, UsageError
from lfield.net.connections import listener as listeners
from lfield.net.connections.resolver import PREFERENCE_TIME
from lfield.net.local_addresses import open_listening_socket, own_host, require_port_free
from lfield.net.tcp_transport import TcpTransport
from lfield.net.tls import TlsIdentity
from lfield.net.transport import is_number, split_addresses
from lfield.testing.keyring import Keyring
from lfield.testing.transport_kit import MAX_BLOCK, Recorder

TEAM, OTHER = Keyring(Path("unused")), Keyring(Path("unused"))
ANNA = TlsIdentity(TEAM.issue("person", "anna", *ALL_RIGHTS))


def served(host: str, team: Keyring = TEAM) -> TcpTransport:
    return TcpTransport(MAX_BLOCK, TlsIdentity(team.issue("host", host)))


def port_of(listener) -> str:
    return listener.address.rpartition(":")[2]


@pytest.mark.parametrize(
    ("address", "number"),
    [("10.0.0.1:1", True), ("10.0.0.1:1,[fd00::1]:2", True), ("10.0.0.1:1,alpha:1", False), ("a:x", False)],
)
def test_a_numeric_address_list_needs_no_lookup(address, number):
    assert is_number(address) is number
    assert ",".join(split_addresses(address)) == address


# Connecting


async def test_the_first_address_is_preferred():
    one, _ = await listening("127.0.0.2:0")
    port = port_of(one)
    two, _ = await listening(f"127.0.0.3:{port}")
    for order in (("127.0.0.2", "127.0.0.3"), ("127.0.0.3", "127.0.0.2")):
        link = await TcpTransport(MAX_BLOCK).connect(",".join(f"{each}:{port}" for each in order), Recorder())
        assert link.peer == f"{order[0]}:{port}"
        link.close()
    one.close()
    two.close()


@needs_ipv6
async def test_dead_silent_and_unknown_addresses_do_not_prevent_a_connection(name_table, hole):
    name_table.rows["gone"] = []
    there, _ = await listening(f"[::1]:{hole}")
    link = await TcpTransport(MAX_BLOCK).connect(
        f"gone:1,127.0.0.2:{hole},{HOLE}:{hole},[::1]:{hole}", Recorder()
    )
    assert link.peer == f"[::1]:{hole}"
    link.close()
    there.close()


async def test_a_silent_name_server_delays_no_other_address(name_table):
    name_table.rows["slow"] = ["127.0.0.3"]
    name_table.blocking.add("slow")
    there, _ = await listening("127.0.0.2:0")
    port, loop, transport = port_of(there), asyncio.get_running_loop(), TcpTransport(MAX_BLOCK)
    before = loop.time()
    link = await transport.connect(f"slow:{port},127.0.0.2:{port}", Recorder())
    assert link.peer == f"127.0.0.2:{port}"
    assert loop.time() - before >= PREFERENCE_TIME
    link.close()
    there.close()
    # Only the name is left: it is tried when the name server answers, also in parallel to a closed address.
    there, _ = await listening(f"127.0.0.3:{port}")
    late = asyncio.ensure_future(transport.connect(f"slow:{port},127.0.0.2:{port}", Recorder()))
    await asyncio.sleep(2 * PREFERENCE_TIME)
    assert not late.done()
    name_table.blocked.set()
    link = await late
    assert link.peer == f"127.0.0.3:{port}"
    link.close()
    there.close()


async def test_a_late_name_is_tried_beside_a_silent_address(name_table, hole):
    name_table.rows["slow"] = ["127.0.0.3"]
    name_table.blocking.add("slow")
    there, _ = await listening(f"127.0.0.3:{hole}")
    late = asyncio.ensure_future(TcpTransport(MAX_BLOCK).connect(f"{HOLE}:{hole},slow:{hole}", Recorder()))
    await asyncio.sleep(2 * PREFERENCE_TIME)
    name_table.blocked.set()
    link = await late
    assert link.peer == f"127.0.0.3:{hole}"
    link.close()
    there.close()


async def test_each_address_is_named_with_its_error(hole):
    transport = TcpTransport(MAX_BLOCK, connect_timeout=0.5)
    with pytest.raises(AddressError) as error:
        await transport.connect(f"127.0.0.2:{hole},{HOLE}:{hole}", Recorder())
    assert f"127.0.0.2:{hole}: " in error.value.reason
    assert f"{HOLE}:{hole}: no answer within 0.5 s" in error.value.reason
    # Each address once, in either order.
    with pytest.raises(AddressError) as error:
        await transport.connect(f"{HOLE}:{hole},127.0.0.2:{hole}", Recorder())
    assert error.value.reason.count("127.0.0.2") == error.value.reason.count(HOLE) == 1
    with pytest.raises(NoListener):
        await transport.connect(f"127.0.0.2:{hole},127.0.0.3:{hole}", Recorder())
    with pytest.raises(AddressError):
        await transport.connect(f"127.0.0.2:{hole},", Recorder())


async def test_an_address_of_another_host_does_not_prevent_a_connection():
    wrong, _ = await listening("127.0.0.2:0", served("bravo"))
    port = port_of(wrong)
    right, _ = await listening(f"127.0.0.3:{port}", served("alpha"))
    address = f"127.0.0.2:{port},127.0.0.3:{port}"
    caller = Recorder()
    link = await TcpTransport(MAX_BLOCK, ANNA).connect(address, caller, "alpha")
    assert (link.identity.name, link.peer) == ("alpha", f"127.0.0.3:{port}")
    assert caller.ends == []
    link.close()
    # Without an expected name, any host is accepted.
    link = await TcpTransport(MAX_BLOCK, ANNA).connect(address, Recorder())
    assert link.identity.name == "bravo"
    link.close()
    # At the last address, the handshake names the other host.
    link = await TcpTransport(MAX_BLOCK, ANNA).connect(f"127.0.0.2:{port}", Recorder(), "alpha")
    assert link.identity.name == "bravo"
    link.close()
    right.close()
    with pytest.raises(AddressError) as error:
        await TcpTransport(MAX_BLOCK, ANNA).connect(address, Recorder(), "alpha")
    assert "bravo" in error.value.reason
    wrong.close()


async def test_an_address_of_a_host_of_another_team_does_not_prevent_a_connection():
    wrong, _ = await listening("127.0.0.2:0", served("alpha", OTHER))
    port = port_of(wrong)
    right, _ = await listening(f"127.0.0.3:{port}", served("alpha"))
    address = f"127.0.0.2:{port},127.0.0.3:{port}"
    link = await TcpTransport(MAX_BLOCK, ANNA).connect(address, Recorder(), "alpha")
    assert link.peer == f"127.0.0.3:{port}"
    link.close()
    right.close()
    with pytest.raises((AddressError, HandshakeError)):
        await TcpTransport(MAX_BLOCK, ANNA).connect(address, Recorder(), "alpha")
    wrong.close()


# Listening


async def test_a_host_listens_at_its_own_addresses_only(name_table, monkeypatch):
    monkeypatch.setattr(listeners, "CHECK_EVERY", 0.02)

    name_table.rows["alpha"] = []
    transport, notes = TcpTransport(MAX_BLOCK), []
    transport.note = notes.append
    there, accepted = await listening("198.51.100.1:0,127.0.0.2:0,alpha:0,127.0.0.3:0", transport)
    first, second = there.address.split(",")
    port = first.rpartition(":")[2]
    assert (first, second) == (f"127.0.0.2:{port}", f"127.0.0.3:{port}")
    assert [note.code for note in notes] == ["listening-failed"]
    # An address that appears later is used then.
    name_table.rows["alpha"] = ["127.0.0.4"]
    await until(lambda: f"127.0.0.4:{port}" in there.address)
    # A name without an address closes nothing.
    name_table.rows["alpha"] = []
    queries = name_table.asked
    await until(lambda: name_table.asked > queries + 2)
    for each in (first, second, f"127.0.0.4:{port}"):
        link = await TcpTransport(MAX_BLOCK).connect(each, Recorder())
        link.close()
    await until(lambda: len(accepted) == 3)
    there.close()


async def test_a_host_without_a_local_address_cannot_listen():
    with pytest.raises(AddressError, match="not one of this machine"):
        await listening("198.51.100.1:0,198.51.100.2:0")


def test_the_port_must_be_free_at_each_local_address():
    with socket.create_server(("127.0.0.3", 0)) as occupied:
        port = occupied.getsockname()[1]
        with pytest.raises(AddressError):
            require_port_free(f"198.51.100.1:{port},127.0.0.2:{port},127.0.0.3:{port}")
        require_port_free(f"198.51.100.1:{port},127.0.0.2:{port}")


def test_the_listening_socket_uses_the_first_local_address():
    opened, address = open_listening_socket("198.51.100.1:0,127.0.0.3:0")
    with opened:
        assert address.startswith("127.0.0.3:")


def test_the_own_host_is_found_by_its_addresses():
    addresses = {"alpha": "198.51.100.1:1,198.51.100.2:1", "bravo": "198.51.100.3:1,127.0.0.2:1"}
    assert own_host(["alpha", "bravo"], addresses) == "bravo"
    with pytest.raises(UsageError):
        own_host(["alpha"], addresses)
