"""Protocols for comparison with lfield on a poor radio: echoes over TCP, TLS, gRPC, Zenoh, QUIC and UDP.

    radio_peers.py serve NAME ADDRESS KEYS                        prints "ready"
    radio_peers.py ask NAME ADDRESS KEYS SIZE PAUSE [fresh]       prints "echo = SECONDS" for each echo

A client repeats a failed echo; `fresh` measures a new connection for each echo. KEYS is a folder with the
keys of a host, for protocols with TLS. Discovery by multicast is off in all libraries.
"""

from __future__ import annotations

import asyncio
import socket
import ssl
import struct
import sys
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from threading import Event, Thread
from typing import Any, Protocol

from lfield.authority.key_material import AUTHORITY, certificate_name, key_name

PORT = 9000
#: Seconds to wait for a new connection, and between two attempts.
TIMEOUT, BETWEEN = 30.0, 0.1
_LENGTH = struct.Struct("<I")


class Client(Protocol):
    """A connection or a connectionless equivalent."""

    def echo(self, data: bytes) -> bytes:
        """Send the bytes and return the echo. Raises OSError without an echo."""

    def rest(self, seconds: float) -> None:
        """Wait for `seconds`."""

    def close(self) -> None:
        """Close the connection."""


class TcpClient:
    """A TCP connection without delay of small packets; optionally TLS with certificates of both ends."""

    def __init__(self, address: str, keys: Path, *, tls: bool = False) -> None:
        self._socket = socket.create_connection((address, PORT), TIMEOUT)
        self._socket.settimeout(None)
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        if tls:
            self._socket = context(keys, ssl.PROTOCOL_TLS_CLIENT).wrap_socket(self._socket)
        self.rest = time.sleep

    def echo(self, data: bytes) -> bytes:
        """Send the bytes with a length prefix, and read the echo."""
        self._socket.sendall(_LENGTH.pack(len(data)) + data)
        return read_message(self._socket)

    def close(self) -> None:
        """Close the connection."""
        self._socket.close()


def read_message(connection: socket.socket) -> bytes:
    """Read one message. Raises ConnectionError at the end of the connection."""
    (left,) = _LENGTH.unpack(_read(connection, _LENGTH.size))
    return _read(connection, left)


def _read(connection: socket.socket, size: int) -> bytes:
    data = b""
    while len(data) < size:
        part = connection.recv(size - len(data))
        if not part:
            raise ConnectionResetError("the other end has closed the connection")
        data += part
    return data


def context(keys: Path, side: int) -> ssl.SSLContext:
    """A context for TLS 1.3 with certificates on both sides, without check of names."""
    made = ssl.SSLContext(side)
    made.minimum_version = ssl.TLSVersion.TLSv1_3
    made.check_hostname = False
    made.verify_mode = ssl.CERT_REQUIRED
    made.load_cert_chain(keys / certificate_name("host"), keys / key_name("host"))
    made.load_verify_locations(keys / AUTHORITY)
    return made


def serve_tcp(address: str, keys: Path, *, tls: bool = False) -> None:
    """Serve echoes with a thread for each connection."""
    secured = context(keys, ssl.PROTOCOL_TLS_SERVER) if tls else None

    def serve(connection: socket.socket) -> None:
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        try:
            used = secured.wrap_socket(connection, server_side=True) if secured else connection
            while True:
                data = read_message(used)
                used.sendall(_LENGTH.pack(len(data)) + data)
        except OSError:
            connection.close()

    with socket.create_server((address, PORT)) as server:
        _ready()
        while True:
            Thread(target=serve, args=(server.accept()[0],), daemon=True).start()


class UdpClient:
    """Datagrams with retransmission after the time-out of RFC 6298, which doubles up to one second.

    Each answer names its copy of the request, so that each gives a round trip.
    """

    LEAST, MOST = 0.02, 1.0
    _HEAD = struct.Struct("<IId")

    def __init__(self, address: str, keys: Path) -> None:
        self._socket, self._to = socket.socket(type=socket.SOCK_DGRAM), (address, PORT)
        self._number, self._smooth, self._varies = 0, 0.0, 0.0
        self.rest = time.sleep

    def echo(self, data: bytes) -> bytes:
        """Send the bytes repeatedly until an answer arrives."""
        self._number += 1
        after = min(self.MOST, max(self.LEAST, self._smooth + 4 * self._varies)) if self._smooth else 0.5
        body = data[self._HEAD.size :]
        for copy in range(1 << 16):
            self._socket.sendto(self._HEAD.pack(self._number, copy, time.monotonic()) + body, self._to)
            end = time.monotonic() + after
            while (left := end - time.monotonic()) > 0:
                self._socket.settimeout(left)
                try:
                    answer = self._socket.recv(1 << 16)
                except TimeoutError:
                    break
                number, _, sent = self._HEAD.unpack_from(answer)
                self._measured(time.monotonic() - sent)
                if number == self._number:
                    return answer
            after = min(self.MOST, 2 * after)
        raise TimeoutError

    def close(self) -> None:
        """Close the socket; there is no connection to close."""
        self._socket.close()

    def _measured(self, trip: float) -> None:
        if self._smooth:
            self._varies += (abs(trip - self._smooth) - self._varies) / 4
            self._smooth += (trip - self._smooth) / 8
        else:
            self._smooth, self._varies = trip, trip / 2


def serve_udp(address: str, keys: Path) -> None:
    """Return every datagram."""
    server = socket.socket(type=socket.SOCK_DGRAM)
    server.bind((address, PORT))
    _ready()
    while True:
        server.sendto(*server.recvfrom(1 << 16))


class GrpcClient:
    """A generic method of bytes, without protocol buffers."""

    def __init__(self, address: str, keys: Path) -> None:
        import grpc  # type: ignore[import-untyped]  # has no types

        self._channel = grpc.insecure_channel(f"{address}:{PORT}")
        self._call, self._failed = self._channel.unary_unary("/bench.Echo/echo"), grpc.RpcError
        self.rest, self.close = time.sleep, self._channel.close

    def echo(self, data: bytes) -> bytes:
        """Make one call, which waits for a connection."""
        try:
            return bytes(self._call(data, wait_for_ready=True))
        except self._failed as error:
            raise OSError(str(error)) from error


def serve_grpc(address: str, keys: Path) -> None:
    """Serve echoes with one thread for the one client."""
    import grpc

    handlers = {"echo": grpc.unary_unary_rpc_method_handler(lambda data, context: data)}
    server = grpc.server(ThreadPoolExecutor(1))
    server.add_generic_rpc_handlers((grpc.method_handlers_generic_handler("bench.Echo", handlers),))
    server.add_insecure_port(f"{address}:{PORT}")
    server.start()
    _ready()
    server.wait_for_termination()


def _zenoh(role: str, address: str) -> Any:
    """A session of two peers over TCP without discovery."""
    import zenoh

    config = zenoh.Config()
    config.insert_json5("mode", '"peer"')
    for scouting in ("multicast", "gossip"):
        config.insert_json5(f"scouting/{scouting}/enabled", "false")
    config.insert_json5("listen/endpoints", "[]")
    config.insert_json5(f"{role}/endpoints", f'["tcp/{address}:{PORT}"]')
    return zenoh.open(config)


class ZenohClient:
    """Queries of one queryable."""

    def __init__(self, address: str, keys: Path) -> None:
        self._session = _zenoh("connect", address)
        self.rest, self.close = time.sleep, self._session.close

    def echo(self, data: bytes) -> bytes:
        """Send one query; returns its answer."""
        for reply in self._session.get("bench/echo", payload=data, timeout=60.0):
            if reply.ok is not None:
                return bytes(reply.ok.payload)
        raise OSError("the query has no answer")


def serve_zenoh(address: str, keys: Path) -> None:
    """Serve a queryable."""
    session = _zenoh("listen", address)
    echo = session.declare_queryable("bench/echo", lambda query: query.reply("bench/echo", query.payload))
    _ready()
    Event().wait()
    echo.undeclare()


class QuicClient:
    """A connection of aioquic with a stream for each echo."""

    def __init__(self, address: str, keys: Path) -> None:
        from aioquic.asyncio import connect
        from aioquic.quic.configuration import QuicConfiguration

        configuration = QuicConfiguration(is_client=True, alpn_protocols=["echo"], idle_timeout=600.0)
        configuration.verify_mode = ssl.CERT_NONE
        self._runner = asyncio.Runner()
        self._connecting = connect(address, PORT, configuration=configuration)
        self._protocol = self._runner.run(self._connecting.__aenter__())

    def echo(self, data: bytes) -> bytes:
        """Send the bytes on a new stream and read the echo."""

        async def one() -> bytes:
            reader, writer = await self._protocol.create_stream()
            writer.write(data)
            writer.write_eof()
            return bytes(await reader.read())

        try:
            return self._runner.run(one())
        except ConnectionError:
            raise
        except Exception as error:
            raise OSError(str(error)) from error

    def rest(self, seconds: float) -> None:
        """Wait while the timers of the connection run."""
        self._runner.run(asyncio.sleep(seconds))

    def close(self) -> None:
        """Close the connection without waiting for the other end."""
        self._protocol.close()
        self._runner.run(asyncio.sleep(0))
        self._runner.close()


def serve_quic(address: str, keys: Path) -> None:
    """Serve an echo on every stream."""
    from aioquic.asyncio import serve
    from aioquic.quic.configuration import QuicConfiguration

    configuration = QuicConfiguration(is_client=False, alpn_protocols=["echo"], idle_timeout=600.0)
    configuration.load_cert_chain(keys / certificate_name("host"), keys / key_name("host"))
    echoes = set[asyncio.Task[None]]()

    async def one(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        writer.write(await reader.read())
        writer.write_eof()

    def opened(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        task = asyncio.get_running_loop().create_task(one(reader, writer))
        echoes.add(task)
        task.add_done_callback(echoes.discard)

    async def run() -> None:
        await serve(address, PORT, configuration=configuration, stream_handler=opened)
        _ready()
        await asyncio.Event().wait()

    asyncio.run(run())


def _tls_client(address: str, keys: Path) -> Client:
    return TcpClient(address, keys, tls=True)


def _serve_tls(address: str, keys: Path) -> None:
    serve_tcp(address, keys, tls=True)


SERVERS: dict[str, Callable[[str, Path], None]] = {
    "TCP": serve_tcp,
    "TLS": _serve_tls,
    "UDP": serve_udp,
    "gRPC": serve_grpc,
    "Zenoh": serve_zenoh,
    "QUIC": serve_quic,
}
CLIENTS: dict[str, Callable[[str, Path], Client]] = {
    "TCP": TcpClient,
    "TLS": _tls_client,
    "UDP": UdpClient,
    "gRPC": GrpcClient,
    "Zenoh": ZenohClient,
    "QUIC": QuicClient,
}


def ask(name: str, address: str, keys: Path, size: int, pause: float, fresh: bool) -> None:
    """Send echoes until killed, and print the seconds of each."""
    data = bytes(size)
    client: Client | None = None
    while True:
        start = time.monotonic()
        while True:
            try:
                client = client or CLIENTS[name](address, keys)
                client.echo(data)
                break
            except OSError:
                if client is not None:
                    client.close()
                client = None
                time.sleep(BETWEEN)
        print(f"echo = {time.monotonic() - start:.6f}", flush=True)
        client.rest(pause)
        if fresh:
            client.close()
            client = None


def _ready() -> None:
    print("ready", flush=True)


if __name__ == "__main__":
    what, called, where, of_host, *more = sys.argv[1:]
    try:
        if what == "serve":
            SERVERS[called](where, Path(of_host))
        else:
            ask(called, where, Path(of_host), int(more[0]), float(more[1]), "fresh" in more)
    except ModuleNotFoundError as error:
        sys.exit(f"{error.name} is not installed here: 'make bench' installs deploy/locks/bench.txt in .venv")
