"""Whatever comes in on the port, the host and its mission go on, and the log says what came."""

from __future__ import annotations

import re
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

NOT_OURS = "the peer does not speak lfield"
CASES = {
    "garbage": (b"\xff\xfe\x00\x01" * 500, f"{NOT_OURS}: a frame of kind 255"),
    "zeros": (bytes(5000), f"{NOT_OURS}: a frame of kind 0 and length 0"),
    "a huge length": (
        struct.pack("<IB", 0xFFFFFFFF, 1) + bytes(100),
        "a frame of kind 1 has 4294967294 bytes",
    ),
    "an HTTP request": (b"GET / HTTP/1.1\r\nHost: alpha:8181\r\n\r\n", f"{NOT_OURS}: a frame of kind 47"),
    "a TLS hello": (bytes.fromhex("16030100c6010000c20303") + bytes(190), f"{NOT_OURS}: a frame of kind 198"),
    "a pickle": (
        b"\x80\x04\x95\x1c" + bytes(7) + b"\x8c\x05posix\x94\x8c\x06system",
        f"{NOT_OURS}: a frame of kind",
    ),
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


def told(host, words: str) -> None:
    """Wait for the host's sentence on a caller it has shown out."""
    host.wait_for(f"^closed a link from 127[.]0[.]0[.]1: {re.escape(words)}")


@pytest.mark.parametrize("name", CASES)
def test_bad_bytes_close_one_link_and_are_told(alpha, name):
    data, words = CASES[name]
    with connect(alpha) as sock:
        sock.sendall(data)
        assert b"alpha" in drain(sock), "the host's own greeting"
    told(alpha, words)
    assert alpha.popen.poll() is None


def test_a_frame_that_stops_in_the_middle(alpha):
    with connect(alpha) as sock:
        near = "{}:{}".format(*sock.getsockname())
        own = sock.recv(65536)
        sock.sendall(own[: len(own) // 2])
        sock.shutdown(socket.SHUT_WR)
        drain(sock)
    told(alpha, f"{near} closed the link in the middle of a message")


def test_its_own_greeting_sent_back(alpha):
    with connect(alpha) as sock:
        sock.sendall(sock.recv(65536))
        drain(sock)
    told(alpha, "greeting refused: alpha reached itself")


def test_who_tries_again_and_again_is_told_once(alpha):
    for _ in range(3):
        with connect(alpha) as sock:
            sock.sendall(b"SSH-2.0-robot\r\n")
            drain(sock)
    with connect(alpha) as sock:
        sock.sendall(b"STOP" * 3)
        drain(sock)
    # What came last is told last.
    told(alpha, f"{NOT_OURS}: a frame of kind 83")
    assert sum("a frame of kind 50" in line for line in alpha.err) == 1


def test_half_a_frame_held_open_keeps_nobody_out_and_is_closed_in_the_end(alpha, shared_lfield):
    with connect(alpha) as sock:
        sock.sendall(sock.recv(65536)[:7])
        ringer = shared_lfield(
            "up", "--deploy", alpha.deployment, "--host", "bravo", *alpha.maps, "--until-done"
        )
        assert ringer.popen.returncode == 0, ringer.said
        alpha.wait_for("^ring$")
        told(alpha, "it has not greeted within 10 s")
        drain(sock)
    assert alpha.popen.poll() is None
