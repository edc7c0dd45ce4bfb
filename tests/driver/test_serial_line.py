"""A serial line on a pseudo-terminal: frames, answers, timeouts, one owner, disconnection."""

from __future__ import annotations

import asyncio
import gc
import grp
import os
import pty
import sys
import tty

import pytest
from hex_log import parse_hex_line

from lfield.clock import ManualClock
from lfield.driver import DeviceError, WireLog
from lfield.driver.recording.wire_formats import HEX_HEADER
from lfield.driver.serial import Lines, SerialLine, SerialPort, parse_serial_endpoint
from lfield.recording.ring_writer import RingWriter


class SerialDevice:
    """The device end of a pseudo-terminal, with a symbolic link to the other end as its port."""

    def __init__(self, path) -> None:
        self.path, self.notes, self.frames = path, [], []
        self.plug()

    def plug(self) -> None:
        self.master, self.slave = pty.openpty()
        tty.setraw(self.master)
        tty.setraw(self.slave)
        self.path.symlink_to(os.ttyname(self.slave))

    def unplug(self) -> None:
        self.path.unlink()
        os.close(self.slave)
        os.close(self.master)

    def line(self, wire_log: WireLog | None = None) -> SerialLine:
        return SerialLine(
            f"serial:{self.path}:57600",
            Lines(),
            on_frame=self.frames.append,
            note=self.notes.append,
            wire_log=wire_log,
        )


@pytest.fixture
def device(tmp_path):
    device = SerialDevice(tmp_path / "tty")
    yield device
    if device.path.is_symlink():
        device.unplug()


async def until(condition) -> None:
    async with asyncio.timeout(60):
        while not condition():
            await asyncio.sleep(0.002)


async def test_frames_are_delivered_and_answers_are_returned_to_the_caller(device):
    line = device.line()
    line.open()
    os.write(device.master, b"hel")
    os.write(device.master, b"lo\n")
    await until(lambda: device.frames == [b"hello"])
    request = asyncio.create_task(line.ask(b"?\n", lambda frame: frame.startswith(b"="), within=10.0))
    assert await asyncio.to_thread(os.read, device.master, 9) == b"?\n"
    os.write(device.master, b"unasked\n=4\n")
    assert await request == b"=4"
    assert device.frames == [b"hello", b"unasked"]
    with pytest.raises(DeviceError, match=r"no answer within 0.01 s, 2 times") as error:
        await line.ask(b"?\n", within=0.01, tries=2)
    assert error.value.kind == "DeviceTimeoutException"
    line.close()


async def test_sent_and_received_bytes_are_logged(device, tmp_path):
    log = WireLog(ManualClock(1_609_459_200.5))
    log.start(lambda suffix, header: RingWriter(tmp_path, "wire", suffix, 1 << 20, pytest.fail, header))
    line = device.line(log)
    line.open()
    line.send(b"?\n")
    os.write(device.master, b"=\n")
    await until(lambda: device.frames == [b"="])
    line.close()
    log.close()
    header, *lines = (tmp_path / "wire-000001.hex.log").read_text().splitlines(keepends=True)
    assert header.encode() == HEX_HEADER
    assert lines[0] == "1609459200.500000 > 3F 0A\n"
    found = [parse_hex_line(line) for line in lines[1:]]
    assert {(time, is_sent) for time, is_sent, _ in found} == {(1_609_459_200.5, False)}
    assert b"".join(data for *_, data in found) == b"=\n"


async def test_unplugged_port_fails_requests_and_is_reopened(device):
    line = device.line()
    line.open()
    request = asyncio.create_task(line.ask(b"?\n", within=60.0))
    await asyncio.sleep(0)
    device.unplug()
    with pytest.raises(DeviceError, match="is gone"):
        await request
    with pytest.raises(DeviceError, match="is gone"):
        line.send(b"x")
    device.plug()
    await until(lambda: len(device.notes) == 2)
    assert device.notes[1] == f"link opened: serial port {device.path}"
    os.write(device.master, b"again\n")
    await until(lambda: device.frames == [b"again"])
    line.close()
    with pytest.raises(DeviceError, match="the port is closed"):
        line.send(b"x")


async def test_request_that_loses_the_port_fails_once(device):
    line, unhandled = device.line(), []
    asyncio.get_running_loop().set_exception_handler(lambda loop, context: unhandled.append(context))
    line.open()
    device.unplug()
    # `ask` writes before the loop can read the end of the port.
    with pytest.raises(DeviceError, match="is gone"):
        await line.ask(b"?\n", within=60.0)
    gc.collect()
    assert (len(device.notes), unhandled) == (1, [])
    line.close()


async def test_port_opens_if_the_latency_timer_is_not_readable(device, tmp_path, monkeypatch):
    monkeypatch.setattr("lfield.driver.serial.serial_port._LATENCY", str(tmp_path / "timer-{}"))
    # A file that can be neither written nor read, also by root.
    (tmp_path / f"timer-{os.path.basename(os.ttyname(device.slave))}").mkdir()
    line = device.line()
    line.open()
    os.write(device.master, b"hello\n")
    await until(lambda: device.frames == [b"hello"])
    line.close()


async def test_serial_port_has_one_owner(device):
    line, second = device.line(), device.line()
    line.open()
    with pytest.raises(DeviceError, match="is in use by another program; a serial port has one owner"):
        second.open()
    line.close()
    second.open()
    second.close()


@pytest.mark.parametrize("endpoint", ["serial:/dev/x", "serial::9600", "tcp:a:1", "serial:/dev/x:0", ""])
def test_invalid_serial_endpoint_is_refused(endpoint):
    with pytest.raises(DeviceError, match="is not a serial endpoint; write serial:PATH:BAUD"):
        parse_serial_endpoint(endpoint)


def test_relative_port_path_is_refused():
    with pytest.raises(DeviceError, match=r"write serial:/dev/ttyACM0:57600$"):
        parse_serial_endpoint("serial:ttyACM0:57600")


@pytest.mark.parametrize(
    ("path", "words"),
    [
        (
            "/dev/nothing-there",
            r"No such file or directory; is the device connected\?$",
        ),
        ("/dev/null", "it is not a serial port$"),
    ],
)
def test_port_that_cannot_be_opened_is_reported(path, words):
    async def opened():
        SerialPort(path, 9600, None).open()

    with pytest.raises(DeviceError, match=f"cannot open serial:{path}:9600: {words}"):
        asyncio.run(opened())


def test_permission_error_names_the_group_the_command_and_the_login(tmp_path, monkeypatch):
    path = tmp_path / "ttyUSB0"
    path.touch()
    group = grp.getgrgid(path.stat().st_gid).gr_name

    def refused(*_args, **_options):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr("lfield.driver.serial.serial_port._pyserial", lambda: refused)

    async def opened():
        SerialPort(str(path), 9600, None).open()

    with pytest.raises(DeviceError) as error:
        asyncio.run(opened())
    assert "no permission" in error.value.reason
    assert f"sudo usermod -aG {group} $USER" in error.value.reason
    assert "log in again" in error.value.reason


def test_missing_pyserial_names_the_extra(monkeypatch):
    monkeypatch.setitem(sys.modules, "serial", None)
    with pytest.raises(DeviceError, match=r"needs pyserial: pip install 'lfield\[serial\]'"):
        SerialPort("/dev/null", 9600, None).open()


async def test_each_reason_for_a_failed_reopen_is_logged_once(device, monkeypatch):
    """The port has the same name as before, as in `/dev/serial/by-id`, but another program uses it."""
    monkeypatch.setattr("lfield.driver.serial.serial_port.REOPEN_INTERVAL", 0.01)
    line, second = device.line(), device.line()
    line.open()
    device.unplug()
    await until(lambda: any("is gone" in note for note in device.notes))
    await until(lambda: any("No such file" in note for note in device.notes))
    device.plug()
    second.open()
    await until(lambda: any("in use by another program" in note for note in device.notes))
    second.close()
    await until(lambda: device.notes[-1] == f"link opened: serial port {device.path}")
    os.write(device.master, b"hello\n")
    await until(lambda: device.frames == [b"hello"])
    line.close()
    assert sum("No such file" in note for note in device.notes) == 1
    assert sum("in use" in note for note in device.notes) == 1
