"""The fake with random messages: it does not raise; its output and memory are bounded."""

from __future__ import annotations

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mavlink_client import ACCEPTED, ARM, GUIDED, MODE, ONCE, TAKEOFF, Client
from pymavlink.dialects.v20 import all as dialect

from lfield_sim.autopilot.autopilot import FLAVOURS
from lfield_sim.mavlink.mavlink_fake import HANDLERS
from lfield_sim.mavlink.telemetry.message_table import MESSAGES

numbers = st.floats(width=32)
flavours = st.sampled_from(sorted(FLAVOURS))
kinds = st.sampled_from(["copter", "rover"])
COMMANDS = (
    *(16, 20, 21, 22, 34, 115, 176, 177, 178, 179, 181, 183, 185, 187, 192, 203, 205, 211, 224, 246),
    *(300, 400, 510, 511, 512, 1000, 2000, 31337, 42600),
)
#: Maximum packets in answer to one message, and in one second of streams (100 Hz each at most).
ANSWERS, A_SECOND = 20, 4000
WIDTHS = {"uint8_t": 8, "int8_t": 8, "char": 8, "uint16_t": 16, "int16_t": 16, "uint32_t": 32, "int32_t": 32}


def build_every_message(c: Client) -> None:
    """Builds every message in the current state of the fake."""
    for kind in MESSAGES:
        c.fake._pack(c.fake.sender.build(kind))


def fly(c: Client) -> None:
    if c.autopilot.flavour.name == "ardupilot":
        c.command(MODE, 1, GUIDED if c.autopilot.flies else 15)
    c.command(ARM, 1)
    c.command(TAKEOFF, 0, 0, 0, 0, 0, 0, 5.0 if c.autopilot.flavour.name == "ardupilot" else math.nan)
    c.wait(3.0)


def value(field: str, length: int) -> st.SearchStrategy:
    """Any value of a message field."""
    if field == "char":
        return st.binary(max_size=length)
    if field in ("float", "double"):
        single = numbers
    elif field in ("uint64_t", "int64_t"):
        single = st.integers(0, (1 << 63) - 1)
    else:
        bits, signed = WIDTHS[field], not field.startswith("u")
        low = -(1 << bits - 1) if signed else 0
        single = st.integers(low, low + (1 << bits) - 1)
    return st.lists(single, min_size=length, max_size=length) if length else single


@st.composite
def messages(draw: st.DrawFn):
    """A message of a type that the fake handles, to it or to all, with any values."""
    c = Client()
    handled = {*HANDLERS, *(kind for service in c.fake.services for kind in service.handles)}
    made = dialect.mavlink_map[draw(st.sampled_from(sorted(handled)))]
    values = []
    for name in made.fieldnames:
        at = made.ordered_fieldnames.index(name)
        if name in ("target_system", "target_component"):
            values.append(draw(st.sampled_from([0, 1, 1, 1, 77])))
        elif name == "command":
            values.append(draw(st.sampled_from(COMMANDS)))
        else:
            kind = made.fieldtypes[made.fieldnames.index(name)]
            values.append(draw(value(kind, made.array_lengths[at])))
    return made(*values)


@settings(max_examples=60, deadline=None)
@given(st.lists(st.binary(max_size=80), max_size=5), flavours)
def test_malformed_bytes_do_not_break_the_fake(pieces, flavour):
    c = Client(flavour=flavour)
    for piece in pieces:
        assert len(c.fake.receive("c", piece)) <= ANSWERS
    assert c.command(ARM, 1) in (ACCEPTED, None)


@pytest.mark.few(0)
@settings(max_examples=50, deadline=None)
@given(st.lists(messages(), min_size=1, max_size=8), flavours, kinds, st.booleans())
def test_valid_messages_with_any_values_do_not_break_the_fake(several, flavour, kind, flying):
    c = Client(kind, flavour=flavour)
    if flying:
        fly(c)
    for message in several:
        packet = message.pack(c.out)
        assert len(c.fake.receive("c", packet)) <= ANSWERS
        assert sum(len(c.fake.advance(0.1)) for _ in range(5)) <= A_SECOND
    build_every_message(c)


@settings(max_examples=35, deadline=None)
@given(messages(), st.integers(0, 300), st.integers(0, 255))
def test_mutated_packets_do_not_raise(message, spot, byte):
    c = Client()
    packet = bytearray(message.pack(c.out))
    packet[spot % len(packet)] = byte
    c.fake.receive("c", bytes(packet))
    c.fake.receive("c", bytes(packet[: spot % len(packet)]))
    c.wait(0.1)


@settings(max_examples=60, deadline=None)
@given(
    st.sampled_from(COMMANDS),
    st.lists(numbers, min_size=4, max_size=4),
    st.lists(st.integers(-(1 << 31), (1 << 31) - 1), min_size=2, max_size=2),
    numbers,
    st.integers(0, 21),
    flavours,
    st.booleans(),
)
def test_commands_with_any_values_do_not_break_the_fake(
    number, values, coordinates, z, frame, flavour, flying
):
    c = Client(flavour=flavour)
    if flying:
        fly(c)
    c.command(number, *values, *map(float, coordinates), z)
    c.command_int(number, *values, x=coordinates[0], y=coordinates[1], z=z, frame=frame)
    c.wait(2.0)
    build_every_message(c)


@pytest.mark.few(0)
@settings(max_examples=35, deadline=None)
@given(st.lists(numbers, min_size=6, max_size=6), st.integers(0, 0xFFFF), st.integers(0, 12), flavours)
def test_setpoints_with_any_values_do_not_break_the_fake(values, mask, frame, flavour):
    c = Client(flavour=flavour)
    fly(c)
    c.target(mask, values[:3], values[3:], frame)
    if flavour == "px4":
        c.command(MODE, 1, 6)
    c.target(mask, values[:3], values[3:], frame)
    c.wait(2.0)
    build_every_message(c)


@pytest.mark.few(0)
@settings(max_examples=35, deadline=None)
@given(st.data(), numbers, st.binary(max_size=16), flavours, kinds)
def test_parameters_with_any_values_do_not_break_the_fake(data, number, other, flavour, kind):
    c = Client(kind, flavour=flavour)
    name = data.draw(st.sampled_from(sorted(c.autopilot.kind.parameters)))
    c.autopilot.parameters[name] = number
    c.autopilot.apply_parameters()
    c.send(dialect.MAVLink_param_set_message(1, 1, other, number, 9))
    c.heartbeat()
    fly(c)
    c.command(20)
    c.wait(2.0)
    build_every_message(c)


def test_messages_can_be_built_during_an_impact():
    c = Client()
    c.up(5.0)
    c.autopilot.vehicle.place = (0.0, 0.0, -150.0)
    c.fault("motor_failure=true")
    hardest = 0.0
    while c.autopilot.vehicle.airborne:
        c.fake.advance(0.02)
        build_every_message(c)
        hardest = max(hardest, *map(abs, c.autopilot.vehicle.acceleration))
    assert hardest > 1000.0


def test_many_peers_use_bounded_memory():
    c = Client()
    for number in range(1000):
        c.fake.receive(number, b"\xfd\x09")
    assert len(c.fake._readers) == 16


def test_stream_of_incomplete_packets_uses_bounded_memory():
    c = Client()
    packet = dialect.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3).pack(c.out)
    c.fake.receive("c", packet[:5])
    for _ in range(2000):
        c.fake.receive("c", packet[5:] + packet[:5])
    assert len(c.fake._readers._readers["c"]._parser.buf) < 10_000


def test_undelivered_packets_and_texts_are_bounded():
    c = Client(faults=["delay=60"])
    for _ in range(300):
        c.command(MODE, 1, 99)
    c.command(511, 30, 10_000)
    for _ in range(30):
        c.fake.advance(10.0)
    assert len(c.fake.wire._late) <= 10_000
    for _ in range(1000):
        c.autopilot.say("again")
    assert len(c.autopilot.pop_texts()) <= 101
    assert c.command(ONCE, 0) is None, "it is delayed"
