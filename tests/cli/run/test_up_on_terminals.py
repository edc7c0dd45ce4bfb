"""Program output on a terminal: control characters are escaped; in pipes and files they are unchanged."""

from __future__ import annotations

import os
import pty
import subprocess
import sys
import termios

import pytest

pytestmark = pytest.mark.process

PROGRAM = r"""
resource Painter {
    init(string[] arg) {
        write("\u{1b}[31mred\u{9b}2J\u{202e}\r");
        write("\n");
        print("\u{1b}[32mgreen");
    }
}
coordinator Boss { init(string[] arg) { sleep(0.1); } }
"""
DEPLOYMENT = "//Painter:painter@alpha\n//Boss:boss@alpha\n"
SHOWN = r"\u{1b}[31mred\u{9b}2J\u{202e}\r"


def on_a_terminal(lfield, *arguments: object) -> tuple[bytes, int]:
    """The output of a command on a terminal, and its status; stderr is a file."""
    terminal, end = pty.openpty()
    command = [sys.executable, "-P", "-m", "lfield", *map(str, arguments)]
    process = subprocess.Popen(
        command, stdout=end, stderr=subprocess.DEVNULL, cwd=lfield.folder, env=lfield.environment
    )
    os.close(end)
    out = b""
    try:
        while data := os.read(terminal, 1 << 16):
            out += data
    except OSError:  # Linux: the other end was closed.
        pass
    os.close(terminal)
    return out, process.wait(60)


@pytest.mark.few(0)
@pytest.mark.parametrize("options", [("--all",), ("--host", "alpha")])
def test_a_program_cannot_control_the_terminal(lfield, options):
    deployment = lfield.mission(PROGRAM, DEPLOYMENT)
    arguments = ("up", "--deploy", deployment, *options, "--until-done")
    out, status = on_a_terminal(lfield, *arguments)
    assert status == 0, out
    assert SHOWN in out.decode()
    assert not any(byte < 32 and byte not in b"\r\n\t" for byte in out)
    assert "\u009b" not in out.decode()
    piped = lfield(*arguments, status=0)
    assert "\x1b[31mred\x9b2J\u202e" in "\n".join(piped.out)


def test_a_bundle_cannot_control_the_terminal(lfield):
    """The endpoint of a device can be any path, and commands print it."""
    program = (
        "resource Arm { Mavlink fc; init(string[] arg) { } }\ncoordinator Boss { init(string[] arg) { } }"
    )
    lfield.mission(program, "//Arm:arm@alpha\n//Boss:boss@alpha\n")
    (lfield.folder / "mission.devices.yaml").write_text(
        'agents: {arm: {devices: {fc: {driver: mavlink, endpoint: "serial:/dev/tty\\e[31mX:57600", '
        "system: 1, kind: copter, safe_state: land, limits: {speed: 5.0}, waivers: [device_watchdog]}}}}"
    )
    lfield("build", "mission.dL", status=0)
    out, status = on_a_terminal(lfield, "inspect", "mission.lfm")
    assert (status, b"\x1b" in out) == (0, False)
    assert r"serial:/dev/tty\u{1b}[31mX:57600" in out.decode()


#: Makes the terminal of stdin the controlling terminal, so that Ctrl-C there is a signal.
CONTROLLED = (
    "import fcntl, os, sys, termios; os.setsid(); fcntl.ioctl(0, termios.TIOCSCTTY, 0); "
    "os.execv(sys.argv[1], sys.argv[1:])"
)


def echoes(terminal: int) -> bool:
    return bool(termios.tcgetattr(terminal)[3] & termios.ECHO)


@pytest.mark.few(0)
def test_typed_keys_do_not_move_the_live_table(lfield):
    """The echo of Ctrl-C and Enter would leave a line of the table in the log."""
    deployment = lfield.mission(
        'coordinator Boss { init(string[] arg) { print("begins"); sleep(1000.0); } }', "//Boss:boss@alpha\n"
    )
    terminal, end = pty.openpty()
    arguments = (
        sys.executable,
        "-P",
        "-m",
        "lfield",
        "up",
        "--deploy",
        str(deployment),
        "--all",
        "--until-done",
    )
    process = subprocess.Popen(
        [sys.executable, "-c", CONTROLLED, *arguments],
        **dict.fromkeys(("stdin", "stdout", "stderr"), end),
        cwd=lfield.folder,
        env=lfield.environment | {"TERM": "xterm"},
    )
    assert echoes(end)
    out = b""
    keys = iter([b"\r", b"\x03"])
    while b"mission stopped" not in out:
        out += os.read(terminal, 1 << 16)
        if b"boss: begins" in out and (key := next(keys, None)):
            assert not echoes(end)
            os.write(terminal, key)
    assert process.wait(60) == 130
    assert b"^C" not in out
    assert echoes(end)
    os.close(end)
    os.close(terminal)
