"""The log of CAN frames: candump lines that python-can reads."""

from __future__ import annotations

import asyncio

import can
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lfield.clock import ManualClock
from lfield.driver.recording import WireLog
from lfield.driver.recording.wire_formats import candump_line, channel_name
from lfield.recording.ring_writer import RingWriter
from lfield_can.bus.can_bus import Bus
from lfield_can.bus.endpoint import parse_endpoint
from lfield_can.bus.frames import Frame

NOW = 1_609_459_200.123456


def log_in(folder):
    log = WireLog(ManualClock(NOW))
    log.start(lambda suffix, header: RingWriter(folder, "wire-a", suffix, 1 << 20, pytest.fail, header))
    return log


async def test_bus_logs_sent_and_received_frames(tmp_path):
    received = []

    log = log_in(tmp_path)
    bus = Bus("virtual:wire", received.append, pytest.fail, log)
    await bus.open()
    with can.Bus("wire", interface="virtual") as other:
        await bus.send(Frame(0x123, b"\xde\xad\xbe\xef"))
        bus.post(Frame(0x1FFF_FF01, b"", extended=True))
        other.send(can.Message(arbitration_id=0x7, data=[1], is_extended_id=False))
        async with asyncio.timeout(60):
            while not received:
                await asyncio.sleep(0.001)
    await bus.close()
    log.close()
    (path,) = tmp_path.iterdir()
    assert path.name == "wire-a-000001.candump.log"
    assert path.stat().st_mode & 0o777 == 0o600
    assert path.read_text() == (
        "(1609459200.123456) wire 123#DEADBEEF T\n"
        "(1609459200.123456) wire 1FFFFF01# T\n"
        "(1609459200.123456) wire 007#01 R\n"
    )
    with can.LogReader(path) as reader:
        found = [(m.arbitration_id, bytes(m.data), m.is_extended_id, m.is_rx, m.channel) for m in reader]
    assert found == [
        (0x123, b"\xde\xad\xbe\xef", False, False, "wire"),
        (0x1FFFFF01, b"", True, False, "wire"),
        (0x7, b"\x01", False, True, "wire"),
    ]


@settings(deadline=None, max_examples=50)
@given(
    st.lists(
        st.tuples(st.integers(0, 0x7FF), st.binary(max_size=8), st.booleans(), st.booleans(), st.booleans())
    )
)
def test_every_logged_frame_is_read_by_python_can(tmp_path_factory, frames):
    path = tmp_path_factory.mktemp("can") / "wire.candump.log"
    lines = [
        candump_line(NOW, "can0", identifier, data, extended=extended, fd=fd, is_sent=is_sent)
        for identifier, data, extended, fd, is_sent in frames
    ]
    path.write_bytes(b"".join(lines))
    with can.LogReader(path) as reader:
        found = [(m.arbitration_id, bytes(m.data), m.is_extended_id, m.is_fd, not m.is_rx) for m in reader]
    assert found == frames


def test_logged_error_frame_is_read_as_one(tmp_path):
    log = log_in(tmp_path)
    log.log_can_error("can0", 0x4, b"\0\x02\0\0\0\0\0\0")
    log.close()
    (path,) = tmp_path.iterdir()
    with can.LogReader(path) as reader:
        assert [message.is_error_frame for message in reader] == [True]


@pytest.mark.parametrize(
    ("endpoint", "name"),
    [
        ("socketcan:can1", "can1"),
        ("slcan:/dev/ttyACM0@115200?bitrate=500000", "ttyACM0"),
        ("socketcand:127.0.0.1:29536/vcan0", "vcan0"),
        ("virtual:0", "can0"),
    ],
)
def test_channel_name_of_an_endpoint(endpoint, name):
    assert parse_endpoint(endpoint).channel == name


@pytest.mark.parametrize(
    ("channel", "name"),
    [
        ("", "can0"),
        ("a b", "a_b"),
        ("pilot:hunter2@10.0.0.7:5000", "10.0.0.7_5000"),
        ("ws://u:p@host/x", "x"),
    ],
)
def test_channel_name_is_one_word_without_a_password(channel, name):
    assert channel_name(channel) == name
