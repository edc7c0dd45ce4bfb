"""For any received bytes, the host and its mission continue, and the log reports them."""

from __future__ import annotations

import re
import socket
import ssl
import struct

import pytest

from lfield.wire.codec import decode, encode
from lfield.wire.framing import FrameDecoder
from lfield.wire.messages import Hello

pytestmark = pytest.mark.process

PROGRAM = """
resource Bell {
    init(string[] arg) { while (true) yield(); }
    portal ring() { write("ring\\n"); }
}
coordinator Ringer {
    init(string[] arg) { findBell(arg[1]).ring(); }
}
"""
DEPLOYMENT = "//Bell:bell@alpha\n//Ringer:tom@bravo?bell\n"

NOT_OURS = "the peer does not speak lfield"
NO_TLS = "received data is not TLS: the peer is not an lfield host, or an outdated one"
CASES = {
    "garbage": (b"\xff\xfe\x00\x01" * 500, f"{NOT_OURS}: a frame of kind 255"),
    "zeros": (bytes(5000), f"{NOT_OURS}: a frame of kind 0 and length 0"),
    "a huge length": (
        struct.pack("<IB", 0xFFFFFFFF, 1) + bytes(100),
        "a frame of kind 1 has 4294967294 bytes",
    ),
    "an HTTP request": (b"GET / HTTP/1.1\r\nHost: alpha:8181\r\n\r\n", f"{NOT_OURS}: a frame of kind 47"),
    "a pickle": (
        b"\x80\x04\x95\x1c" + bytes(7) + b"\x8c\x05posix\x94\x8c\x06system",
        f"{NOT_OURS}: a frame of kind",
    ),
}


@pytest.fixture(scope="module")
def alpha(shared_lfield):
    """A host that receives the bytes of all these tests, and the maps of its team."""
    deployment = shared_lfield.mission(PROGRAM, DEPLOYMENT)
    maps = shared_lfield.maps(["alpha", "bravo"])
    host = shared_lfield.start("up", "--deploy", deployment, "--host", "alpha", *maps)
    host.address = host.wait_for(r"alpha listening on 127\.0\.0\.1:(\d+)")[1]
    host.deployment, host.maps, host.keys = deployment, maps, shared_lfield.keys
    return host


def connect(host) -> socket.socket:
    """An unauthenticated connection."""
    return socket.create_connection(("127.0.0.1", int(host.address)), timeout=30.0)


def connect_as(host, name: str) -> socket.socket:
    """A TLS connection with valid keys, before the Hello."""
    keys = host.keys.folder / name
    kind = "person" if name == "me" else "host"
    context = ssl.create_default_context(cafile=keys / "authority.pem")
    context.check_hostname = False
    context.load_cert_chain(keys / f"{kind}.pem", keys / f"{kind}.key")
    return context.wrap_socket(connect(host))


def drain(sock: socket.socket) -> bytes:
    """The bytes of the host until it closes the connection."""
    received = b""
    try:
        while chunk := sock.recv(65536):
            received += chunk
    except (ConnectionResetError, ssl.SSLEOFError):
        pass
    return received


def frames(data: bytes) -> list:
    """Decode the messages in some bytes."""
    decoder = FrameDecoder(dict.fromkeys(range(8), 1 << 20))
    return [decode(kind, payload) for kind, payload in decoder.feed(data)]


def await_close_line(host, words: str) -> None:
    """Wait for the host's log line on a closed connection."""
    host.wait_for(f"^link from 127[.]0[.]0[.]1 closed: {re.escape(words)}")


@pytest.mark.few(2)
@pytest.mark.parametrize("name", CASES)
def test_an_unauthenticated_peer_with_bad_bytes_gets_no_reply(alpha, name):
    with connect(alpha) as sock:
        sock.sendall(CASES[name][0])
        assert drain(sock) == b""
    await_close_line(alpha, NO_TLS)
    assert alpha.popen.poll() is None


@pytest.mark.few(0)
def test_an_unauthenticated_tls_client_gets_no_data_of_the_host(alpha):
    with connect(alpha) as sock:
        sock.sendall(bytes.fromhex("16030100c6010000c20303") + bytes(192))
        assert b"alpha" not in drain(sock)
    await_close_line(alpha, "received data is not TLS 1.3, or was corrupted in transit")
    context = ssl.create_default_context()
    context.check_hostname, context.verify_mode = False, ssl.CERT_NONE
    with (
        context.wrap_socket(connect(alpha)) as sock,
        pytest.raises(ssl.SSLError, match="CERTIFICATE_REQUIRED"),
    ):
        sock.recv(1)
    await_close_line(alpha, "peer sent no certificate")


@pytest.mark.few(2)
@pytest.mark.parametrize("name", CASES)
def test_bad_bytes_of_a_host_close_one_link_and_are_logged(alpha, name):
    data, words = CASES[name]
    with connect_as(alpha, "bravo") as sock:
        sock.sendall(data)
        assert drain(sock) == b""
    await_close_line(alpha, words)
    assert alpha.popen.poll() is None


@pytest.mark.few(0)
def test_a_truncated_frame_is_logged(alpha):
    with connect_as(alpha, "bravo") as sock:
        hello = encode(Hello("observer", "observer", 0))
        sock.sendall(hello[: len(hello) // 2])
        sock.shutdown(socket.SHUT_WR)
        drain(sock)
    await_close_line(alpha, "peer closed the link in the middle of a message")


@pytest.mark.few(0)
def test_a_handshake_copied_from_another_host_is_refused(alpha):
    """The hashes of a Hello are known to all hosts; only the certificate proves the name."""
    with connect_as(alpha, "bravo") as sock:
        sock.sendall(encode(Hello("observer", "observer", 0)))
        # The next message of the host may be in the same bytes.
        hello = frames(sock.recv(65536))[0]
    assert hello.host == "alpha"
    for name, reason in (
        ("bravo", "host bravo calls itself alpha"),
        ("me", "operator may only send commands"),
    ):
        with connect_as(alpha, name) as sock:
            sock.sendall(encode(hello))
            received = frames(drain(sock))
        assert reason in received[-1].reason
        alpha.wait_for(f"^link from 127[.]0[.]0[.]1 closed: handshake refused: .*{reason}")


def test_a_repeated_error_of_a_peer_is_logged_once(alpha):
    for _ in range(3):
        with connect_as(alpha, "bravo") as sock:
            sock.sendall(b"SSH-2.0-robot\r\n")
            drain(sock)
    with connect_as(alpha, "bravo") as sock:
        sock.sendall(b"STOP" * 3)
        drain(sock)
    # The last error is logged last.
    await_close_line(alpha, f"{NOT_OURS}: a frame of kind 83")
    assert sum("a frame of kind 50" in line for line in alpha.err) == 1


@pytest.mark.few(0)
def test_a_half_open_handshake_blocks_no_peer_and_is_closed(alpha, shared_lfield):
    with connect(alpha) as sock:
        sock.sendall(bytes.fromhex("16030100c601"))
        ringer = shared_lfield(
            "up", "--deploy", alpha.deployment, "--host", "bravo", *alpha.maps, "--until-done"
        )
        assert ringer.popen.returncode == 0, ringer.said
        alpha.wait_for("^ring$")
        await_close_line(alpha, "it has not greeted within 10 s")
        assert drain(sock) == b""
    assert alpha.popen.poll() is None
