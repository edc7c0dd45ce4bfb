"""Echo servers of RPC libraries, for comparison with a remote portal call.

`python rpc.py NAME KEYS` serves one of them on a free loopback port and prints the port; `CLIENTS[NAME]`
connects to it. Each runs in its fastest common setting: no compression, no delay of small packets, raw
bytes. `KEYS` is a folder with the keys of a host, for servers with TLS.
"""

from __future__ import annotations

import socket
import struct
import sys
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path

from lfield.authority.key_material import AUTHORITY, certificate_name, key_name

#: Sends bytes and returns the echo.
Echo = Callable[[bytes], bytes]

_LENGTH = struct.Struct("<I")
_GRPC_METHOD = "/bench.Echo/echo"
_PYRO_NAME = "echo"
HOST_CERTIFICATE, HOST_KEY = certificate_name("host"), key_name("host")


# --- plain TCP ----------------------------------------------------------------------------------------


def _receive(connection: socket.socket) -> bytes:
    """Receive one message with a length prefix; b'' at the end of the connection."""
    (left,) = _LENGTH.unpack(connection.recv(_LENGTH.size, socket.MSG_WAITALL) or _LENGTH.pack(0))
    return connection.recv(left, socket.MSG_WAITALL) if left else b""


def _send(connection: socket.socket, data: bytes) -> None:
    connection.sendall(_LENGTH.pack(len(data)) + data)


def serve_tcp(keys: Path) -> None:
    """Serve with blocking sockets, the minimum of work."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        _say_port(server.getsockname()[1])
        connection, _ = server.accept()
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        while data := _receive(connection):
            _send(connection, data)


def connect_tcp(port: int, keys: Path) -> Echo:
    """A client of `serve_tcp`."""
    connection = socket.create_connection(("127.0.0.1", port))
    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)

    def echo(data: bytes) -> bytes:
        _send(connection, data)
        return _receive(connection)

    return echo


# --- Pyro5 --------------------------------------------------------------------------------------------


def serve_pyro5(keys: Path) -> None:
    """Serve with Pyro5: the multiplexing server, and the serializer that passes bytes unchanged."""
    import Pyro5.api  # type: ignore[import-untyped]  # has no types

    Pyro5.config.SOCK_NODELAY, Pyro5.config.SERVERTYPE = True, "multiplex"

    @Pyro5.api.expose
    class Server:
        def echo(self, data: bytes) -> bytes:
            return data

    daemon = Pyro5.api.Daemon(host="127.0.0.1", port=0)
    daemon.register(Server(), _PYRO_NAME)
    _say_port(daemon.sock.getsockname()[1])
    daemon.requestLoop()


def connect_pyro5(port: int, keys: Path) -> Echo:
    """A client of `serve_pyro5`."""
    import Pyro5.api

    Pyro5.config.SOCK_NODELAY, Pyro5.config.SERIALIZER = True, "marshal"
    proxy = Pyro5.api.Proxy(f"PYRO:{_PYRO_NAME}@127.0.0.1:{port}")
    return lambda data: bytes(proxy.echo(data))


# --- RPyC ---------------------------------------------------------------------------------------------


def serve_rpyc(keys: Path, *, in_tls: bool = False) -> None:
    """Serve with RPyC; one thread for the one client."""
    import rpyc  # type: ignore[import-untyped]  # has no types
    from rpyc.core.channel import Channel  # type: ignore[import-untyped]  # has no types
    from rpyc.utils.authenticators import SSLAuthenticator  # type: ignore[import-untyped]  # has no types
    from rpyc.utils.server import OneShotServer  # type: ignore[import-untyped]  # has no types

    Channel.COMPRESSION_THRESHOLD = sys.maxsize

    class Service(rpyc.Service):  # type: ignore[misc]  # has no types
        def exposed_echo(self, data: bytes) -> bytes:
            return data

    lock = SSLAuthenticator(keys / HOST_KEY, keys / HOST_CERTIFICATE, keys / AUTHORITY) if in_tls else None
    server = OneShotServer(Service, hostname="127.0.0.1", port=0, authenticator=lock)
    # Accepted connections inherit the option.
    server.listener.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    _say_port(server.port)
    server.start()


def connect_rpyc(port: int, keys: Path, *, in_tls: bool = False) -> Echo:
    """A client of `serve_rpyc`; in TLS both ends have certificates, as hosts do."""
    import rpyc
    from rpyc.core.channel import Channel

    Channel.COMPRESSION_THRESHOLD = sys.maxsize
    stream = rpyc.SocketStream
    proof = {
        "keyfile": keys / HOST_KEY,
        "certfile": keys / HOST_CERTIFICATE,
        "ca_certs": keys / AUTHORITY,
        "check_hostname": False,
    }
    made = stream.ssl_connect("127.0.0.1", port, proof, nodelay=True) if in_tls else None
    connection = rpyc.connect_stream(made or stream.connect("127.0.0.1", port, nodelay=True))
    remote = connection.root.echo
    # The connection closes when its last reference is dropped.
    return lambda data: bytes(remote(data)) if not connection.closed else b""


# --- gRPC ---------------------------------------------------------------------------------------------


def serve_grpc(keys: Path) -> None:
    """Serve with a generic handler of bytes, without protocol buffers."""
    import grpc  # type: ignore[import-untyped]  # has no types

    handlers = {"echo": grpc.unary_unary_rpc_method_handler(lambda data, context: data)}
    server = grpc.server(ThreadPoolExecutor(1))
    server.add_generic_rpc_handlers((grpc.method_handlers_generic_handler("bench.Echo", handlers),))
    port = server.add_insecure_port("127.0.0.1:0")
    server.start()
    _say_port(port)
    server.wait_for_termination()


def connect_grpc(port: int, keys: Path) -> Echo:
    """A client of `serve_grpc`."""
    import grpc

    call = grpc.insecure_channel(f"127.0.0.1:{port}").unary_unary(_GRPC_METHOD)
    return lambda data: bytes(call(data))


SERVERS: dict[str, Callable[[Path], None]] = {
    "TCP": serve_tcp,
    "Pyro5": serve_pyro5,
    "RPyC": serve_rpyc,
    "RPyC in TLS": partial(serve_rpyc, in_tls=True),
    "gRPC": serve_grpc,
}
CLIENTS: dict[str, Callable[[int, Path], Echo]] = {
    "TCP": connect_tcp,
    "Pyro5": connect_pyro5,
    "RPyC": connect_rpyc,
    "RPyC in TLS": partial(connect_rpyc, in_tls=True),
    "gRPC": connect_grpc,
}


def _say_port(port: int) -> None:
    print(port, flush=True)


if __name__ == "__main__":
    SERVERS[sys.argv[1]](Path(sys.argv[2]))
