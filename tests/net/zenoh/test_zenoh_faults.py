"""Zenoh with faults: killed, corrupting and missing routers, a stopped peer, a missing package."""

import asyncio
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from certificates import Team
from fabric import Router, ZenohBench, free_endpoint, running_router
from loop_bench import TIMEOUT
from lying_router import ChangingRelay, Injector

from lfield.errors import AddressError, HandshakeError, MissingZenoh, NoListener, WireError, ZenohUnreachable
from lfield.net.tcp_transport import TcpTransport
from lfield.net.tls import TlsIdentity
from lfield.net.zenoh.config import NETWORK, ZenohConfig
from lfield.net.zenoh.host_transport import HostTransport
from lfield.net.zenoh.packets import Kind
from lfield.testing.transport_kit import MAX_BLOCK, Pair, Recorder, transfer
from lfield.wire.messages import Ping

pytest.importorskip("zenoh", reason="eclipse-zenoh is not installed")
pytestmark = pytest.mark.process
router = pytest.fixture(running_router)


@pytest.fixture
def team():
    return Team()


def bench_at(endpoint: str, *, far: str = "", **options) -> ZenohBench:
    return ZenohBench(ZenohConfig((endpoint,)), ZenohConfig((far or endpoint,)), **options)


@pytest.fixture
def tls_bench(router, team):
    bench = bench_at(router.endpoint, tls=TlsIdentity(team.host("alpha")))
    yield bench
    bench.close()


# Killed routers


def test_a_router_restart_in_mid_hop_loses_no_transfer(router, tls_bench):
    """Packets in flight are lost with the router; the stream repeats them."""
    pair = Pair(tls_bench)
    router.kill()
    for number in range(20):
        pair.link.send_transfer(transfer(MAX_BLOCK // 4, number), bytes([number]) * (MAX_BLOCK // 4))
    router.start()
    tls_bench.until(lambda: len(pair.far.messages) == 20 or bool(pair.near.ends))
    found = [header.sequence for header, _ in pair.far.messages]
    assert found == list(range(len(found)))
    assert len(found) == 20 or isinstance(pair.near.ends[0], AddressError)


def test_a_dead_router_ends_the_links_and_a_restarted_one_carries_new_ones(router, tls_bench):
    pair = Pair(tls_bench)
    router.kill()
    pair.link.send(Ping(1))
    tls_bench.until(lambda: bool(pair.near.ends and pair.far.ends))
    for end in (pair.near.ends[0], pair.far.ends[0]):
        assert isinstance(end, AddressError)
    with pytest.raises(ZenohUnreachable):
        tls_bench.wait(tls_bench.connect(pair.listener.address, Recorder()))
    router.start()
    near = connected_again(tls_bench, pair)
    near.send(Ping(2))
    tls_bench.until(lambda: pair.accepted[-1].messages == [Ping(2)])


def test_data_stays_unacknowledged_while_the_router_is_dead(router, tls_bench):
    pair = Pair(tls_bench)
    tls_bench.until(lambda: not pair.link.delivery().is_pending)
    router.kill()
    pair.link.send(Ping(1))
    tls_bench.until(lambda: pair.link.delivery().is_pending)
    assert pair.link.delivery().acked > 0
    router.start()
    tls_bench.until(lambda: pair.far.messages == [Ping(1)] or bool(pair.near.ends))


def connected_again(bench: ZenohBench, pair: Pair):
    """A link to the same listener, as soon as possible: the sessions reconnect themselves."""

    async def attempts():
        async with asyncio.timeout(TIMEOUT):
            while True:
                try:
                    return await bench.connect(pair.listener.address, Recorder())
                except AddressError:
                    await asyncio.sleep(0.1)

    link = bench.wait(attempts())
    link.accept_role("host")
    return link


def test_a_missing_router_is_reported_and_used_when_it_starts(team):
    endpoint = free_endpoint()
    bench = bench_at(endpoint, timeout=0.5, tls=TlsIdentity(team.host("alpha")))
    called = []

    def on_link(link):
        called.append(Recorder())
        link.accept_role("host")
        return called[-1]

    listener = bench.wait(bench.listen("zenoh:alpha:0", on_link))
    assert [note.code for note in bench.notes] == ["zenoh-unreachable"]
    with pytest.raises(ZenohUnreachable) as error:
        bench.wait(bench.connect(listener.address, Recorder()))
    assert error.value.code == "zenoh-unreachable"
    assert endpoint in error.value.reason
    router = Router(endpoint=endpoint)
    pair = Pair.__new__(Pair)
    pair.listener, pair.accepted = listener, called
    link = connected_again(bench, pair)
    link.send(Ping(3))
    bench.until(lambda: called and called[-1].messages == [Ping(3)])
    bench.close()
    router.kill()


# A stopped process


@pytest.mark.few(0)
def test_a_stopped_peer_blocks_no_other_link_and_its_link_is_closed(router):
    bench = bench_at(router.endpoint)
    command = [sys.executable, str(Path(__file__).with_name("stopped_peer.py")), router.endpoint]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as peer:
        near, other = Recorder(), Pair(bench)
        link = bench.wait(bench.connect(peer.stdout.readline().strip(), near))
        link.accept_role("host")
        os.kill(peer.pid, signal.SIGSTOP)
        longest = 0.0
        for number in range(4):
            start = time.thread_time()
            link.send_transfer(transfer(MAX_BLOCK, number), bytes(MAX_BLOCK))
            longest = max(longest, time.thread_time() - start)
        # The other link over the same session continues.
        for token in range(100):
            other.link.send(Ping(token))
        bench.until(lambda: len(other.far.messages) == 100)
        assert near.ends == []
        bench.until(lambda: bool(near.ends))
        assert isinstance(near.ends[0], AddressError)
        assert other.near.ends == []
        peer.kill()
    bench.close()


@pytest.mark.few(0)
def test_a_killed_peer_is_noticed_before_the_silence_limit(router):
    bench = bench_at(router.endpoint)
    command = [sys.executable, str(Path(__file__).with_name("stopped_peer.py")), router.endpoint]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as peer:
        near, address = Recorder(), peer.stdout.readline().strip()
        bench.wait(bench.connect(address, near))
        peer.kill()
        bench.until(lambda: bool(near.ends))
        with pytest.raises(NoListener):
            bench.wait(bench.connect(address, Recorder()))
    bench.close()


# A router that changes data


def test_a_changed_byte_closes_the_link(router, team):
    bench = bench_at(router.endpoint, tls=TlsIdentity(team.host("alpha")))
    relay = ChangingRelay(router.endpoint)
    bench.wait(relay.open())
    bench.near.close()
    lied = bench_at(relay.endpoint, far=router.endpoint, tls=TlsIdentity(team.host("alpha")))
    lied.loop.close()
    lied.loop = bench.loop
    pair = Pair(lied)
    relay.is_lying = True
    pair.link.send_transfer(transfer(1 << 18), bytes(1 << 18))
    lied.until(lambda: bool(pair.far.ends and pair.near.ends))
    assert relay.changed
    assert pair.far.messages == []
    assert isinstance(pair.far.ends[0], WireError | HandshakeError | AddressError)
    lied.wait(relay.close())
    lied.close()


def test_injected_data_closes_the_link_and_is_never_delivered(router, tls_bench):
    pair, injector = Pair(tls_bench), Injector(router.endpoint)
    tls_bench.until(lambda: _ping(pair) and len(injector.packets) == 2)
    tls_bench.wait(asyncio.sleep(0.2))
    injector.inject(Kind.DATA, b"\x17\x03\x03\x00\x20" + bytes(32))
    tls_bench.until(lambda: bool(pair.far.ends or pair.near.ends))
    tls_bench.until(lambda: bool(pair.far.ends and pair.near.ends))
    assert all(isinstance(message, Ping) for message in pair.far.messages + pair.near.messages)
    injector.close()


def _ping(pair: Pair) -> bool:
    """Send packets from both ends, so that the injector learns their keys."""
    pair.link.send(Ping(2))
    pair.far.link.send(Ping(2))
    return True


def test_a_participant_without_keys_of_the_team_gets_no_link(router, team):
    """A fabric is open to others: TLS rejects a peer that uses the name of a host."""
    bench = bench_at(router.endpoint, tls=TlsIdentity(team.host("alpha")))
    foreign_host = bench_at(router.endpoint, tls=TlsIdentity(Team().host("alpha")))
    foreign_host.loop.close()
    foreign_host.loop = bench.loop
    called = Recorder()
    listener = foreign_host.wait(foreign_host.listen("zenoh:alpha:0", lambda link: called))
    near = Recorder()
    with pytest.raises(HandshakeError):
        bench.wait(bench.connect(listener.address, near))
    bench.until(lambda: bool(called.ends))
    assert near.messages == called.messages == []
    foreign_host.near.close()
    foreign_host.far.close()
    bench.close()


# Configuration


@pytest.mark.parametrize(
    ("key", "value", "reason"),
    [("foo/bar", "1", "unknown key"), ("transport/link/tls/root_ca_certificate", "5", "expected a string")],
)
def test_a_setting_that_zenoh_rejects_is_named(team, key, value, reason):
    bench = ZenohBench(config := ZenohConfig((free_endpoint(),), settings=((key, value),)), config)
    with pytest.raises(AddressError) as raised:
        bench.wait(bench.connect("zenoh:alpha:8181", Recorder()))
    assert f": {key}: " in raised.value.reason
    assert reason in raised.value.reason
    bench.close()


def test_a_missing_package_is_reported_with_its_code(monkeypatch):
    monkeypatch.setitem(sys.modules, "zenoh", None)
    monkeypatch.delitem(sys.modules, "lfield.net.zenoh.session", raising=False)
    bench = bench_at("tcp/127.0.0.1:1")
    with pytest.raises(MissingZenoh) as error:
        bench.wait(bench.near.connect("zenoh:alpha", Recorder()))
    assert (error.value.code, "lfield[zenoh]" in str(error.value)) == ("zenoh-missing", True)
    bench.loop.close()


def test_a_process_uses_tcp_and_zenoh_together(router, team):
    """Of several addresses, the first that answers is used, on either network."""
    NETWORK.configure(ZenohConfig((router.endpoint,)))
    loop = asyncio.new_event_loop()
    own = TcpTransport(MAX_BLOCK, TlsIdentity(team.host("alpha")))
    transport, caller = HostTransport(own), HostTransport(own)
    accepted = []

    def on_link(link):
        accepted.append(Recorder())
        return accepted[-1]

    listener = loop.run_until_complete(transport.listen("127.0.0.1:0,zenoh:alpha:0", on_link))
    tcp, fabric = listener.address.split(",")
    for address in (tcp, fabric, f"127.0.0.1:1,{fabric}", f"{fabric},{tcp}"):
        link = loop.run_until_complete(caller.connect(address, Recorder(), "alpha"))
        assert str(link.identity) == "host alpha"
        assert link.peer == (fabric if address != tcp else tcp)
        link.abort()
    with pytest.raises(AddressError) as error:
        loop.run_until_complete(caller.connect("127.0.0.1:1,zenoh:bravo", Recorder()))
    assert "127.0.0.1:1" in error.value.reason
    assert "zenoh:bravo" in error.value.reason
    listener.close()
    transport.close()
    caller.close()
    loop.run_until_complete(asyncio.sleep(0))
    loop.close()
    NETWORK.configure(None)
    with pytest.raises(AddressError):
        asyncio.run(HostTransport(own).connect(fabric, Recorder()))
