"""Arbitrary bytes at both endpoints and arbitrary frames into every device: no exception, no growth."""

from __future__ import annotations

import math

from can_fake_bench import Bench
from hypothesis import given, settings
from hypothesis import strategies as st
from test_can_fake_dbc import GRIPPER

from lfield_sim.can.adapters import slcan, socketcand
from lfield_sim.can.adapters.slcan import SlcanProtocol
from lfield_sim.can.adapters.socketcand import SocketcandProtocol
from lfield_sim.can.can_bus import FD_LENGTHS, CanFrame

CHUNKS = st.lists(st.binary(max_size=400), max_size=20)
SLCAN = st.lists(
    st.one_of(
        st.binary(max_size=40), st.from_regex(rb"[OCLSYVNFtTrRdDbBsMm][0-9A-F]{0,20}\r", fullmatch=True)
    ),
    max_size=20,
)
SOCKETCAND = st.lists(
    st.one_of(
        st.binary(max_size=40),
        st.sampled_from([b"< open can0 >", b"< rawmode >", b"< echo >"]),
        st.from_regex(rb"< send [0-9A-Fx+_-]{1,9} [0-9A]{1,2}( [0-9A-Fa-f]{1,3}){0,9} >", fullmatch=True),
    ),
    max_size=20,
)

#: Frames that the devices process, and others.
IDENTIFIERS = st.one_of(
    st.integers(0, 0x7FF),
    st.sampled_from([0, 0x80, 0x205, 0x305, 0x405, 0x505, 0x605, 0x701, 0x100, 0x101]),
    st.integers(0x60, 0x7F),
)
FRAMES = st.builds(
    CanFrame,
    IDENTIFIERS,
    st.one_of(st.binary(max_size=8), st.sampled_from(FD_LENGTHS).map(bytes)),
    extended=st.booleans(),
    remote=st.booleans(),
    fd=st.booleans(),
)


@given(st.one_of(CHUNKS, SOCKETCAND))
def test_any_bytes_at_the_socketcand_endpoint(chunks):
    protocol, buffer = SocketcandProtocol(), bytearray()
    for chunk in chunks:
        buffer += chunk
        while (text := socketcand.next_command(buffer)) is not None:
            answer, frame = protocol.command(text)
            assert isinstance(answer, bytes)
            assert frame is None or len(frame.data) <= 8
        assert len(buffer) <= socketcand.LONGEST


@given(st.one_of(CHUNKS, SLCAN))
def test_any_bytes_at_the_slcan_endpoint(chunks):
    protocol, buffer = SlcanProtocol(), bytearray()
    for chunk in chunks:
        buffer += chunk
        while (text := slcan.next_command(buffer)) is not None:
            answer, frame = protocol.command(text)
            assert not answer or answer[-1:] in (b"\r", b"\a")
            assert frame is None or SlcanProtocol.encode(frame)
        assert len(buffer) <= slcan.LONGEST


@settings(max_examples=80, deadline=None)
@given(st.lists(st.tuples(FRAMES, st.sampled_from([0.0, 0.005, 0.05])), max_size=40))
def test_any_frames_into_every_device(script):
    bench = Bench("cia402:5", "odrive:3", f"dbc:{GRIPPER}")
    bench.fault("nonsense=0.1")
    bench.send(0, b"\x01\x00")
    for frame, pause in script:
        bench.world.bus.send(bench.port, frame, bench.now)
        bench.wait(pause)
    received = bench.wait(0.1)
    assert len(received) < 500
    drive, axis, _ = bench.devices
    assert all(math.isfinite(value) for value in (drive.axis.drive.position, axis.axis.position))
    for frame in bench.received:
        assert SlcanProtocol.encode(frame)
        assert len(frame.data) <= 8


@settings(max_examples=50, deadline=None)
@given(
    st.lists(
        st.tuples(st.integers(0, 0xFFFF), st.integers(0, 9), st.binary(min_size=4, max_size=4)), max_size=30
    )
)
def test_any_value_in_any_object_of_a_moving_drive(writes):
    bench = Bench("cia402:5")
    drive = bench.devices[0]
    keys = sorted(drive.node.objects.entries)
    bench.send(0, b"\x01\x00")
    for number, kind, data in writes:
        index, subindex = keys[number % len(keys)]
        size = drive.node.objects.entries[index, subindex].type[1:]
        unused = {"8": 3, "16": 2}.get(size, 0)
        head = bytes([0x23 | unused << 2, index & 0xFF, index >> 8, subindex])
        bench.send(0x605, head + data)
        if kind < 6:
            word = (0x06, 0x07, 0x0F, 0x1F, 0x0B, 0x80)[kind]
            bench.send(0x605, bytes([0x2B, 0x40, 0x60, 0, word, 0, 0, 0]))
        bench.wait(0.02)
    assert math.isfinite(drive.axis.drive.position)
    assert abs(drive.motor.speed) <= drive.motor.data.max_speed
