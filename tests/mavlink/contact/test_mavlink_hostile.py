"""Devices with false, late, foreign or malformed messages."""

from __future__ import annotations

import asyncio
import math
import struct

import pytest
from coroutine_tests import on_bench
from hypothesis import given, settings
from hypothesis import strategies as st
from takeoff import up

from lfield.clock import ManualClock
from lfield.driver import DeviceBinding
from lfield.errors import DeviceError
from lfield_mavlink import PLUGIN
from lfield_mavlink.geodesy import Place
from lfield_mavlink.link.dialect import Reader, dialect
from lfield_mavlink.vehicle import MavlinkVehicle
from lfield_sim.mavlink.link.codec import PacketWriter

MANIFEST = PLUGIN.read_manifests()["Mavlink"]
MESSAGES = sorted(dialect.mavlink_map)


class StoredReports:
    """Stores the values that a driver reports."""

    def __init__(self) -> None:
        self.values: dict = {}

    def publish(self, device, values):
        self.values.update(values)

    def heard(self, device): ...

    def note(self, device, text): ...


def vehicle(kind="copter"):
    options = {option.name: option.default for option in MANIFEST.options} | {"system": 1, "kind": kind}
    binding = DeviceBinding(
        agent="a", field="fc", type="Mavlink", driver="mavlink", endpoint="udp:127.0.0.1:1",
        safe_state="land", options=options,
    )  # fmt: skip
    reports = StoredReports()
    return MavlinkVehicle(binding, MANIFEST, ManualClock(), reports, lambda message: None), reports


def packet(kind, payload):
    """A MAVLink 2 packet of system 1 with this payload, cut or padded to the length of its type."""
    message = dialect.mavlink_map[kind]
    payload = payload[: message.unpacker.size].ljust(message.unpacker.size, b"\0")
    payload = payload.rstrip(b"\0") or b"\0"
    body = struct.pack("<BBBBBBHB", len(payload), 0, 0, 0, 1, 1, kind & 0xFFFF, kind >> 16) + payload
    crc = dialect.x25crc(body)
    crc.accumulate(bytes([message.crc_extra]))
    return b"\xfd" + body + struct.pack("<H", crc.crc)


FLOATS = [struct.pack("<f", x) for x in (math.nan, math.inf, -math.inf, 3.4e38, 1e-40)]
hostile_words = st.sampled_from([b"\xff" * 4, b"\0" * 4, b"\x7f\xff\xff\xff", b"\xff\xff\xff\x7f", *FLOATS])
payloads = st.one_of(st.binary(max_size=255), st.lists(hostile_words, max_size=64).map(b"".join))


@settings(max_examples=150, deadline=None)
@given(
    st.sampled_from(["copter", "rover", "plane"]),
    st.lists(st.tuples(st.sampled_from(MESSAGES), payloads), max_size=12),
)
def test_any_message_content_is_survived_and_publishes_finite_values(kind, messages):
    fc, reports = vehicle(kind)
    reader = Reader()
    heartbeat = packet(0, struct.pack("<IBBBBB", 4, 2, 3, 129, 4, 3))
    count = 0
    for data in [heartbeat, *(packet(*message) for message in messages)]:
        for message in reader.feed(data):
            fc.on_message(message)
            count += 1
    assert count == len(messages) + 1
    for value in reports.values.values():
        numbers = value if isinstance(value, list) else [value]
        assert all(isinstance(x, str) or math.isfinite(x) for x in numbers)
    position = fc.state.position
    assert position is None or all(map(math.isfinite, position))


@given(st.floats(-89.0, 89.0), st.floats(-180.0, 180.0), st.floats(-2e3, 2e3), st.floats(-2e3, 2e3))
def test_shifted_position_and_displacement_are_inverse(latitude, longitude, north, east):
    here = Place(latitude, longitude, 100.0)
    there = here.shifted((north, east, -5.0))
    assert here.vector_to(there) == pytest.approx((north, east, -5.0), abs=1e-3)
    assert abs(there.longitude) <= 180.0


@pytest.mark.parametrize("scaled", [(0, 0, 5), (900_000_001, 0, 0), (1, 1_800_000_001, 0), (-(2**31), 5, 0)])
def test_impossible_coordinates_give_no_position(scaled):
    assert Place.scaled(*scaled) is None


def ack(number, result, **fields):
    return dialect.MAVLink_command_ack_message(int(number), result, **fields)


@on_bench("bench")
async def test_late_acknowledgement_does_not_answer_the_next_command(b, fc, /):
    await up(fc, 4.0)
    # An acceptance of a command that is not pending; a takeoff in the air is refused.
    b.links[0].on_data(PacketWriter(1, 1).pack(ack(dialect.MAV_CMD_NAV_TAKEOFF, 0)))
    await asyncio.sleep(0.1)
    with pytest.raises(DeviceError, match="takeoff refused: FAILED"):
        await fc.execute("takeoff", [5.0])


def test_acknowledgement_from_another_system_is_ignored(bench):
    b = bench()
    deliver = b.filter
    other = PacketWriter(7, 1)

    def from_another(link, data):
        if data[7] == dialect.MAVLINK_MSG_ID_COMMAND_ACK:
            reader = Reader()
            data = other.pack(next(iter(reader.feed(data))))
        deliver(link, data)

    async def mission(fc):
        b.filter = from_another
        with pytest.raises(DeviceError, match="did not answer") as error:
            await fc.execute("closeGripper", [])
        assert error.value.kind == "DeviceTimeoutException"

    b.run(mission)


def test_lost_acknowledgement_repeats_the_command(bench):
    b = bench()
    deliver, lost = b.filter, set()

    def lose_the_first(link, data):
        number = bytes(data[10:12])
        if data[7] == dialect.MAVLINK_MSG_ID_COMMAND_ACK and number not in lost:
            lost.add(number)
            return
        deliver(link, data)

    async def mission(fc):
        b.filter = lose_the_first
        await fc.execute("arm", [])
        # The second copy of a takeoff is refused, since the first one is flying.
        await fc.execute("takeoff", [5.0])
        await fc.execute("land", [])

    b.run(mission)
    assert len(lost) >= 3


@pytest.mark.few(2)
@pytest.mark.parametrize("fault", ["corrupt=0.1", "duplicate=0.5", "reorder=0.3", "delay=0.2"])
def test_flight_over_a_bad_radio_completes(bench, fault):
    b = bench(faults=(fault,))

    async def mission(fc):
        await up(fc)
        await fc.execute("goTo", [5.0, 0.0, -5.0])
        await fc.execute("land", [])

    b.run(mission)
    assert not b.autopilot.vehicle.airborne


def test_change_of_vehicle_type_is_reported_and_arming_refused(bench):
    b = bench()
    heartbeat = dialect.MAVLink_heartbeat_message(10, 3, 81, 15, 4, 3)
    deliver = b.filter

    async def mission(fc):
        b.cut = True
        await asyncio.sleep(5.0)
        b.cut = False
        b.filter = lambda link, data: None if data[7] == 0 else deliver(link, data)
        for _ in range(8):
            b.links[0].on_data(PacketWriter(1, 1).pack(heartbeat))
            await asyncio.sleep(0.5)
        with pytest.raises(DeviceError, match="is not a copter"):
            await fc.execute("arm", [])

    b.run(mission)
    assert any("is not a copter (MAV_TYPE 10)" in note for note in b.notes)


@on_bench("bench")
async def test_vehicle_does_not_move_after_a_link_loss(b, fc, /):
    await up(fc)
    await fc.execute("setVelocity", [2.0, 0.0, 0.0])
    b.cut = True
    before = len(b.sent)
    await asyncio.sleep(8.0)
    b.cut = False
    await asyncio.sleep(3.0)
    kinds = {data[7] for data in b.sent[before:]}
    assert dialect.MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED not in kinds
    assert math.hypot(*b.values["velocity"][:2]) < 0.1


@on_bench("bench")
async def test_late_mode_acknowledgement_does_not_confirm_the_safe_state(b, fc, /):
    lost = []

    await up(fc, 4.0)
    link = b.links[0]
    send = link.send

    def lose_the_first(data):
        if data[7] == dialect.MAVLINK_MSG_ID_COMMAND_LONG and not lost:
            lost.append(data)
            # The packet is lost, and the answer to an earlier change of mode arrives now.
            late = PacketWriter(1, 1).pack(ack(dialect.MAV_CMD_DO_SET_MODE, 0))
            asyncio.get_running_loop().call_soon(link.on_data, late)
            return
        send(data)

    link.send = lose_the_first
    start = asyncio.get_running_loop().time()
    await fc.make_safe()
    assert asyncio.get_running_loop().time() - start < 1.5
    assert b.autopilot.mode == "LAND"
    assert lost
