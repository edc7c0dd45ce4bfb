"""Whatever comes in on the port, the host and its mission go on, and the log says what came."""

from __future__ import annotations

import socket
import struct

import pytest

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

BYTES = {
    "garbage": b"\xff\xfe\x00\x01" * 500,
    "zeros": bytes(5000),
    "a huge length": struct.pack("<IB", 0xFFFFFFFF, 1) + b"x" * 100,
    "a huge length, big-endian": struct.pack(">IB", 0x7FFFFFFF, 3) + b"x" * 100,
    "an HTTP request": b"GET / HTTP/1.1\r\nHost: alpha:8181\r\n\r\n",
    "a TLS hello": bytes.fromhex("16030100c6010000c20303") + bytes(190),
    "a pickle": b"\x80\x04\x95\x1c\x00\x00\x00\x00\x00\x00\x00\x8c\x05posix\x94\x8c\x06system\x94\x93\x94.",
}


@pytest.fixture(scope="module")
def alpha(shared_lfield):
    """A host that all these tests send to, and the maps of its team."""
    deployment = shared_lfield.mission(PROGRAM, DEPLOYMENT)
    maps = shared_lfield.maps(["alpha", "bravo"])
    host = shared_lfield.start("up", "--deploy", deployment, "--host", "alpha", *maps)
    host.address = host.wait_for(r"alpha is up on 127\.0\.0\.1:(\d+)")[1]
    host.deployment, host.maps = deployment, maps
    return host


def connect(host) -> socket.socket:
    return socket.create_connection(("127.0.0.1", int(host.address)), timeout=30.0)


def drain(sock: socket.socket) -> bytes:
    """What the host says until it closes."""
    said = b""
    try:
        while chunk := sock.recv(65536):
            said += chunk
    except ConnectionResetError:
        pass
    return said


def closed_links(host) -> int:
    return sum("closed a link from 127.0.0.1:" in line for line in host.err)


@pytest.mark.parametrize("name", BYTES)
def test_bad_bytes_close_one_link_and_are_told(alpha, name):
    with connect(alpha) as sock:
        port = sock.getsockname()[1]
        sock.sendall(BYTES[name])
        sock.shutdown(socket.SHUT_WR)
        assert b"alpha" in drain(sock), "the host's own greeting"
        line = alpha.wait_for(f"closed a link from 127.0.0.1:{port}: .+").string
    assert "Error" not in line
    assert alpha.popen.poll() is None


def test_a_frame_that_stops_in_the_middle(alpha):
    with connect(alpha) as sock:
        port = sock.getsockname()[1]
        own = sock.recv(65536)
        sock.sendall(own[: len(own) // 2])
        sock.shutdown(socket.SHUT_WR)
        drain(sock)
        alpha.wait_for(f"closed a link from 127.0.0.1:{port}: .* closed the link in the middle of a message")


def test_its_own_greeting_sent_back(alpha):
    with connect(alpha) as sock:
        port = sock.getsockname()[1]
        sock.sendall(sock.recv(65536))
        drain(sock)
        alpha.wait_for(f"closed a link from 127.0.0.1:{port}: greeting refused: alpha reached itself")


def test_half_a_frame_held_open_keeps_nobody_out_and_is_closed_in_the_end(alpha, shared_lfield):
    with connect(alpha) as sock:
        port = sock.getsockname()[1]
        sock.sendall(sock.recv(65536)[:7])
        ringer = shared_lfield(
            "up", "--deploy", alpha.deployment, "--host", "bravo", *alpha.maps, "--until-done"
        )
        assert ringer.popen.returncode == 0, ringer.said
        alpha.wait_for("^ring$")
        alpha.wait_for(f"closed a link from 127.0.0.1:{port}: it has not greeted within 10 s")
        drain(sock)
    assert alpha.popen.poll() is None
