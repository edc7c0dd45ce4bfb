"""TCP, TLS and Unix sockets with the conformance kit, and the particular properties of each."""

import asyncio
import errno
import os
import pwd
import socket
import struct
import tempfile
from contextlib import suppress
from pathlib import Path

import pytest
from certificates import Team
from loop_bench import TIMEOUT, TcpBench

from lfield.authority.identity import ALL_RIGHTS
from lfield.errors import AddressError, HandshakeError, WireError
from lfield.net.health.tcp_options import MAX_NOT_SENT
from lfield.net.peer_credentials import caller_identity, listener_identity
from lfield.net.scheduling.send_queue import HIGH_WATER
from lfield.net.stream_link import MAX_OBSERVER_PENDING
from lfield.net.tcp_transport import describe
from lfield.net.tls import TlsIdentity
from lfield.net.transport import join_address, split_address
from lfield.testing.transport_kit import MAX_BLOCK, Pair, Recorder, TransportKit, transfer
from lfield.wire.codec import encode
from lfield.wire.messages import Hello, Ping


def new_loop(kind: str) -> asyncio.AbstractEventLoop:
    if kind == "asyncio":
        return asyncio.new_event_loop()
    return pytest.importorskip(kind, reason="uvloop is not installed").new_event_loop()


@pytest.fixture(params=["asyncio", "uvloop"])
def tcp(request):
    bench = TcpBench(new_loop(request.param))
    yield bench
    bench.close()


class TestTcp(TransportKit):
    @pytest.fixture
    def bench(self, tcp):
        return tcp


class TlsBench(TcpBench):
    """The same with authentication: one certificate is enough for two hosts of a test."""

    def __init__(self, loop: asyncio.AbstractEventLoop, **options) -> None:
        team = Team()
        super().__init__(loop, tls=TlsIdentity(team.host("alpha")), **options)


@pytest.fixture(params=["asyncio", "uvloop"])
def tls(request):
    bench = TlsBench(new_loop(request.param))
    yield bench
    bench.close()


class TestTls(TransportKit):
    @pytest.fixture
    def bench(self, tls):
        return tls


def test_later_links_resume_the_tls_session_even_after_an_abort(tls):
    pair, found = Pair(tls), []
    link, near = pair.link, pair.near
    for _ in range(3):
        far = pair.accepted[-1]
        link.send(Ping(1))
        far.link.send(Ping(2))
        tls.until(lambda near=near, far=far: bool(near.messages and far.messages))
        assert str(far.link.identity) == str(link.identity) == "host alpha"
        found += [end._channel.is_resumed for end in (link, far.link)]
        link.abort()
        tls.until(lambda near=near, far=far: bool(near.ends and far.ends))
        link, near = pair.connect()
    assert found == [False, False, True, True, True, True]


class UnixBench(TcpBench):
    """The same transport at Unix sockets, each with its own path."""

    def __init__(self, loop: asyncio.AbstractEventLoop, folder: Path) -> None:
        super().__init__(loop)
        self.folder = folder

    @property
    def address(self) -> str:
        return f"unix:{self.folder}/{len(self.listeners)}.sock"


@pytest.fixture(params=["asyncio", "uvloop"])
def unix(request):
    # Not pytest's folder: the path of a socket may have 107 bytes.
    with tempfile.TemporaryDirectory(prefix="lf-") as folder:
        bench = UnixBench(new_loop(request.param), Path(folder))
        yield bench
        bench.close()
        assert list(bench.folder.iterdir()) == []


class TestUnix(TransportKit):
    @pytest.fixture
    def bench(self, unix):
        return unix


# Unix sockets only


@pytest.mark.parametrize(("folder", "socket_mode"), [(0o700, 0o600), (0o750, 0o660)])
def test_the_permissions_of_the_folder_apply_to_the_socket(unix, folder, socket_mode):
    unix.folder.chmod(folder)
    pair = Pair(unix)
    (path,) = unix.folder.iterdir()
    assert path.lstat().st_mode & 0o777 == socket_mode
    assert pair.link.peer == pair.listener.address == f"unix:{path}"
    assert pair.far.link.peer == "a command on this computer"


@pytest.mark.skipif(os.geteuid() != 0, reason="only root may give files to any group")
def test_the_group_of_the_folder_may_connect(unix):
    """Not the group of the listening user, who may have several."""
    os.chown(unix.folder, -1, 4999)
    unix.folder.chmod(0o750)
    Pair(unix)
    (path,) = unix.folder.iterdir()
    assert (path.lstat().st_gid, path.lstat().st_mode & 0o777) == (4999, 0o660)


def test_an_invalid_socket_path_is_refused(unix):
    for address, text in [("unix:here", "unix:/PATH"), (f"unix:/{'x' * 200}", "AF_UNIX path too long")]:
        with pytest.raises(AddressError, match=text):
            unix.wait(unix.listen(address, lambda link: Recorder()))


@pytest.mark.parametrize(
    ("user", "groups", "rights"),
    [
        (1000, (), ["command", "observe", "operate", "stop"]),
        (0, (), ["command", "observe", "operate", "stop"]),
        (1001, (1001, 700), ["observe", "stop"]),
        (1001, (1001,), []),
    ],
)
def test_the_rights_of_a_local_user(user, groups, rights):
    identity = caller_identity(user, groups, 1000, 700)
    assert (identity.kind, sorted(identity.may)) == ("local", rights)
    assert caller_identity(user, groups, 1000, None).may == (identity.may if user != 1001 else frozenset())


@pytest.mark.parametrize("groups", [(1001,), (1001, 700)])
@pytest.mark.parametrize("user", [0, 1000, 1001])
def test_a_command_trusts_the_hosts_of_its_own_user_root_and_group(user, groups):
    believed = user in (0, 1000) or 700 in groups
    assert (listener_identity(user, groups, 1000, 700).may == ALL_RIGHTS) == believed
    assert (
        listener_identity(user, groups, 0, 700).may
        == listener_identity(user, groups, 0, None).may
        == ALL_RIGHTS
    )
    assert (listener_identity(user, groups, 1000, None).may == ALL_RIGHTS) == (user != 1001)


def test_the_kernel_identifies_both_ends_of_a_unix_socket(unix):
    pair = Pair(unix)
    for link in (pair.link, pair.far.link):
        assert (link.identity.kind, link.identity.may) == ("local", ALL_RIGHTS)
        assert link.identity.name == pwd.getpwuid(os.geteuid()).pw_name


# TLS only


def test_the_dialling_end_knows_its_peer_after_connect(tls):
    pair = Pair(tls)
    assert str(pair.link.identity) == "host alpha"
    pair.link.send(Ping(1))
    tls.until(lambda: pair.far.messages)
    assert str(pair.far.link.identity) == "host alpha"


class Counted:
    """A transport of asyncio that counts the writes."""

    def __init__(self, transport) -> None:
        self._transport, self.writes = transport, 0

    def write(self, data) -> None:
        self.writes += 1
        self._transport.write(data)

    def __getattr__(self, name: str):
        return getattr(self._transport, name)


def test_a_hop_in_tls_is_one_write(tls):
    pair = Pair(tls)
    counted = pair.link._transport = Counted(pair.link._transport)
    for number, size in enumerate((0, 1000, 3000), 1):
        pair.link.send_transfer(transfer(size, number), bytes(size))
        assert counted.writes == number
    tls.until(lambda: len(pair.far.messages) == 3)


def test_hosts_of_two_authorities_get_no_link():
    loop = new_loop("asyncio")
    server, other_server = TlsBench(loop), TlsBench(loop)
    called, near = Recorder(), Recorder()
    listener = server.wait(server.listen("127.0.0.1:0", lambda _: called))
    with pytest.raises(HandshakeError, match="peer certificate rejected: not signed by the CA of this team"):
        other_server.wait(other_server.connect(listener.address, near))
    server.until(lambda: called.ends)
    assert "peer rejected the certificate of this host" in str(called.ends[0])
    assert near.ends == near.messages == called.messages == []
    listener.close()
    loop.close()


def test_an_unauthenticated_peer_gets_no_reply(tls):
    called = Recorder()
    listener = tls.wait(tls.tcp.listen("127.0.0.1:0", lambda _: called))
    for data in (b"", b"GET / HTTP/1.1\r\n\r\n", encode(Hello("observer", "me", 0))):
        called.ends.clear()
        with socket.create_connection(split_address(listener.address)) as raw:
            raw.sendall(data)
            raw.shutdown(socket.SHUT_WR)
            tls.until(lambda: called.ends)
            raw.settimeout(TIMEOUT)
            with suppress(ConnectionResetError):
                assert raw.recv(1) == b""
    assert called.messages == []
    listener.close()


def test_a_peer_that_never_answers_is_given_up():
    bench = TlsBench(new_loop("asyncio"), connect_timeout=0.1)
    near = Recorder()
    with socket.create_server(("127.0.0.1", 0)) as deaf:
        address = join_address(*deaf.getsockname())
        with pytest.raises(AddressError, match="no answer within"):
            bench.wait(bench.connect(address, near))
    bench.wait(asyncio.sleep(0))
    assert near.ends == []
    bench.close()


def test_a_peer_that_closes_in_the_handshake_gives_no_link():
    bench = TlsBench(new_loop("asyncio"))

    async def hangs_up(reader, writer):
        await reader.read(1)
        writer.close()

    server = bench.wait(asyncio.start_server(hangs_up, "127.0.0.1", 0))
    near = Recorder()
    with pytest.raises(AddressError, match=r"closed the connection|was lost"):
        bench.wait(bench.connect(join_address(*server.sockets[0].getsockname()), near))
    assert near.ends == []
    server.close()
    bench.wait(server.wait_closed())
    bench.close()


def test_a_dial_that_is_cancelled_in_the_handshake_closes_its_connection():
    bench = TlsBench(new_loop("asyncio"))

    async def cancelled_dial():
        received, ended = asyncio.Event(), asyncio.Event()

        async def silent(reader, writer):
            await reader.read(1)
            received.set()
            await reader.read()
            ended.set()
            writer.close()

        server = await asyncio.start_server(silent, "127.0.0.1", 0)
        address = join_address(*server.sockets[0].getsockname())
        dial = asyncio.ensure_future(bench.connect(address, Recorder()))
        await received.wait()
        dial.cancel()
        async with asyncio.timeout(TIMEOUT):
            await ended.wait()
        server.close()

    bench.wait(cancelled_dial())
    bench.close()


# TCP only


def test_listeners_and_links_report_their_addresses(tcp):
    pair = Pair(tcp)
    assert pair.listener.address.startswith("127.0.0.1:")
    assert pair.link.peer == pair.listener.address
    assert pair.far.link.peer.startswith("127.0.0.1:")


def test_a_link_whose_peer_does_not_read_is_closed():
    bench = TcpBench(new_loop("asyncio"), max_pending=1000)
    deaf = socket.create_server(("127.0.0.1", 0))
    near = Recorder()
    link = bench.wait(bench.connect(join_address(*deaf.getsockname()), near))
    while not link.closed:
        link.send_transfer(transfer(MAX_BLOCK), bytes(MAX_BLOCK))
    assert near.ends == [], "no callback inside send"
    bench.until(lambda: bool(near.ends))
    deaf.close()
    bench.close()
    assert isinstance(near.ends[0], WireError)
    assert "does not read" in str(near.ends[0])


@pytest.mark.parametrize(("role", "most"), [("observer", MAX_OBSERVER_PENDING), ("host", 5 << 20)])
def test_the_queue_limit_of_observers_is_lower(tcp, role, most):
    pair = Pair(tcp, role=role)
    pair.link._transport.pause_reading()
    while not pair.far.link.closed:
        pair.far.link.send_transfer(transfer(MAX_BLOCK), bytes(MAX_BLOCK))
    tcp.until(lambda: bool(pair.far.ends))
    assert f"does not read: over {most} bytes queued" in str(pair.far.ends[0])
    pair.link.abort()


def test_an_observer_that_sends_without_end_is_read_slowly(tcp):
    """The host keeps the messages of a hundred seconds, and processes emergency stops meanwhile."""
    pair = Pair(tcp)
    pair.far.link.accept_role("observer")
    for number in range(20_000):
        pair.link.send(Ping(number))
    tcp.until(lambda: pair.far.messages)
    tcp.wait(asyncio.sleep(0.3))
    assert 0 < len(pair.far.messages) < 20_000
    # A link that is closed meanwhile is not read, and its timer raises nothing.
    pair.far.link.close()


def test_a_connection_reset_before_it_is_accepted_is_dropped(tcp):
    """As from a port scanner that resets its connections: the listener finds no address."""
    broken, called = [], []
    tcp.loop.set_exception_handler(lambda _, context: broken.append(context))

    def on_link(link):
        called.append(Recorder())
        return called[-1]

    listener = tcp.wait(tcp.tcp.listen("127.0.0.1:0", on_link))
    for _ in range(100):
        with socket.create_connection(split_address(listener.address)) as raw:
            raw.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
    tcp.until(lambda: len(called) == 100 and all(one.ends for one in called))
    assert broken == []
    listener.close()


def test_a_reset_connection_is_reported_as_lost(tcp):
    pair = Pair(tcp)
    raw = pair.far.link._transport.get_extra_info("socket")
    raw.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, b"\x01\0\0\0\0\0\0\0")
    pair.far.link._transport.abort()
    tcp.until(lambda: bool(pair.near.ends))
    assert isinstance(pair.near.ends[0], AddressError)
    assert "the connection was lost" in str(pair.near.ends[0])


@pytest.mark.parametrize(
    ("address", "words"),
    [
        ("192.0.2.1:0", "not one of this machine"),
        ("x" * 70 + ".invalid:8181", "the name is not known"),
    ],
)
def test_a_foreign_or_unknown_address_cannot_be_listened_at(tcp, address, words):
    with pytest.raises(AddressError, match=words):
        tcp.wait(tcp.listen(address, lambda link: Recorder()))


def test_socket_errors_are_described_in_words():
    assert "name is not known" in describe(socket.gaierror(-2, "Name or service not known"))
    assert "above 1023" in describe(PermissionError(errno.EACCES, "Permission denied"))
    assert describe(OSError(errno.EIO, "")) == "Input/output error"
    assert describe(OSError("Multiple exceptions")) == "Multiple exceptions"


def test_small_writes_are_not_delayed_on_tcp(tcp):
    pair = Pair(tcp)
    for link in (pair.link, pair.far.link):
        sock = link._transport.get_extra_info("socket")
        assert sock.getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY) != 0


def test_the_kernel_queues_few_unsent_bytes(tls):
    """A stop order waits behind these bytes: the option is read at both ends, with both loops."""
    pair = Pair(tls)
    for link in (pair.link, pair.far.link):
        sock = link._transport.get_extra_info("socket")
        assert sock.getsockopt(socket.IPPROTO_TCP, socket.TCP_NOTSENT_LOWAT) == MAX_NOT_SENT == 4096
        assert link._transport.get_write_buffer_limits()[1] == HIGH_WATER


# Addresses


@pytest.mark.parametrize(
    ("text", "host", "port"),
    [("robot", "robot", 8181), ("robot:9", "robot", 9), ("[::1]", "::1", 8181), ("[::1]:70", "::1", 70)],
)
def test_addresses_are_split_and_joined(text, host, port):
    assert split_address(text) == (host, port)
    assert split_address(join_address(host, port)) == (host, port)
