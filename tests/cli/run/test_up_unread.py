"""Unread output (Ctrl-S, a stuck ssh, `| sleep 1000`) blocks no host: the vehicle flies, the host answers."""

from __future__ import annotations

import fcntl
import os
import re
import signal
import struct
import termios
import time

import pytest

pytestmark = pytest.mark.process

#: A flying copter, and a program whose output exceeds a pipe on both streams.
PROGRAM = """
resource Copter {
    Mavlink fc;
    init(string[] arg) {
        fc.arm();
        fc.takeoff(2.0);
        int i = 0;
        string much = "...";
        while (much.length() < 500) much = much + much;
        while (true) {
            i = i + 1;
            write("out " + i2s(i) + much + " end\\n");
            print("log " + i2s(i) + much + " end");
            if (i % 40 == 0) sleep(0.01);
        }
    }
}
coordinator Nobody { init(string[] arg) { sleep(1000.0); } }
"""
DEPLOYMENT = "//Copter:lead@alpha\n//Nobody:one@alpha\n"
DEVICES = """
silence: 2.0
agents:
  lead:
    devices:
      fc: {driver: mavlink, endpoint: 'udp:127.0.0.1:14550', waivers: [device_watchdog], system: 1}
"""


@pytest.fixture
def unread():
    """Both ends of a pipe for stdout and stderr of the writer."""
    reading, writing = os.pipe()
    yield reading, writing
    for descriptor in (reading, writing):
        os.close(descriptor)


def filled(reading: int) -> None:
    """Wait until the pipe is full and more output was written."""
    end, before = time.monotonic() + 60, -1
    while (now := waiting(reading)) < 30000 or now != before:
        assert time.monotonic() < end, f"only {now} bytes received"
        before = now
        time.sleep(1.0)
    time.sleep(1.0)


def waiting(reading: int) -> int:
    return struct.unpack("i", fcntl.ioctl(reading, termios.FIONREAD, b"\0" * 4))[0]


def read_some(reading: int) -> list[bytes]:
    """The complete lines of the pipe, until one reports missing lines."""
    lines, end = [b""], time.monotonic() + 60
    while not any(b" missing" in line for line in lines[-1000:-1]):
        assert time.monotonic() < end, lines[-3:]
        first, *rest = os.read(reading, 1 << 16).split(b"\n")
        lines[-1] += first
        lines += rest
    return lines[:-1]


@pytest.mark.few(0)
@pytest.mark.parametrize("everything", [False, True], ids=["host", "all"])
def test_a_host_with_unread_output_continues_to_fly_and_answers(lfield, alone, unread, everything):
    reading, writing = unread
    deployment = lfield.mission(PROGRAM, DEPLOYMENT, DEVICES)
    maps = [] if everything else lfield.maps(["alpha"])
    arguments = ("--deploy", deployment, *maps)
    which = ("--all",) if everything else ("--host", "alpha")
    team = lfield.start("up", *arguments, *which, "--sim", stdout=writing, stderr=writing, env=alone)
    filled(reading)

    result = lfield("ps", *arguments, env=alone, status=0)
    assert "safe state" not in result.said

    pressed = lfield(
        "estop", *arguments, "--no-wait", "--reason", "the output is not read", env=alone, status=0
    )
    assert pressed.out == ["alpha: lead.fc: safe"]

    lines = read_some(reading)
    assert any(re.search(rb"[1-9][0-9]* line\(s\) (of program output )?missing", line) for line in lines)
    lines_with_text = [line for line in lines if b"..." in line and b"missing" not in line]
    assert all(line.endswith(b" end") for line in lines_with_text), "a line is incomplete"

    filled(reading)
    before = time.monotonic()
    team.signal(signal.SIGTERM)
    assert team.wait() == (130 if everything else 0)
    assert time.monotonic() - before < 60
    assert lfield.left() == []
