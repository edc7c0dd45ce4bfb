"""Plan transfer with scripted vehicles of both autopilots, over good and bad channels."""

from __future__ import annotations

import asyncio
import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scripted_peer import Channel, run

from lfield.errors import DeviceError
from lfield_mavlink.link.dialect import dialect
from lfield_mavlink.services.plan_items import (
    HOME,
    Item,
    PlanKind,
    circle,
    coordinates,
    polygon,
    rally_points,
    waypoints,
)
from lfield_mavlink.services.plan_transfer import PlanTransfer

HERE = (47.397742, 8.545594)
TO_US = (255, dialect.MAV_COMP_ID_ONBOARD_COMPUTER)


class Vehicle:
    """The vehicle's side of the protocol; plans change item by item if `in_place`."""

    def __init__(self, *, ardupilot: bool, in_place: bool = False) -> None:
        self.ardupilot, self.in_place = ardupilot, in_place
        self.plans: dict[int, list[Item]] = {0: [HOME] if ardupilot else [], 1: [], 2: []}
        self.upload: tuple[int, int, list[Item]] | None = None
        self.channel: Channel | None = None
        self.result: int | None = None
        self.keeps = 10_000
        self.asks_again = False

    def __call__(self, message):
        name = message.get_type()
        handler = getattr(self, "on_" + name.lower(), None)
        return handler(message) if handler else []

    def request(self):
        kind, _, items = self.upload
        make = dialect.MAVLink_mission_request_int_message
        if self.ardupilot:
            make = dialect.MAVLink_mission_request_message
        upload = self.upload

        def again():
            if self.upload is upload and len(upload[2]) == len(items_before):
                self.channel.send_text([make(*TO_US, len(upload[2]), kind)])
                asyncio.get_running_loop().call_later(1.0, again)

        items_before = list(items)
        if self.asks_again:
            asyncio.get_running_loop().call_later(1.0, again)
        return make(*TO_US, len(items), kind)

    def ack(self, result, kind):
        return dialect.MAVLink_mission_ack_message(*TO_US, result, kind)

    def on_mission_count(self, message):
        if self.result is not None:
            return [self.ack(self.result, message.mission_type)]
        if message.count == 0:
            self.plans[message.mission_type] = []
            return [self.ack(0, message.mission_type)]
        self.upload = (message.mission_type, message.count, [])
        if self.in_place:
            del self.plans[message.mission_type][message.count :]
        return [self.request()]

    def on_mission_item_int(self, message):
        if self.upload is None or self.upload[0] != message.mission_type:
            return []
        kind, count, items = self.upload
        if message.seq != len(items):
            return [self.ack(13, kind)]
        items.append(Item.from_message(message))
        if self.in_place:
            self.plans[kind][message.seq : message.seq + 1] = [Item.from_message(message)]
        if len(items) < count:
            return [self.request()]
        self.plans[kind], self.upload = items[: self.keeps], None
        return [self.ack(0, kind)]

    def on_mission_request_list(self, message):
        if self.upload is not None:
            return [self.ack(14, message.mission_type)]
        count = len(self.plans[message.mission_type])
        return [dialect.MAVLink_mission_count_message(*TO_US, count, message.mission_type)]

    def on_mission_request_int(self, message):
        plan = self.plans[message.mission_type]
        if message.seq >= len(plan):
            return [self.ack(13, message.mission_type)]
        item = plan[message.seq]
        # ArduPilot returns the integer frames as the other frames.
        frame = item.frame - 3 if item.frame in (5, 6) and self.ardupilot else item.frame
        return [
            dialect.MAVLink_mission_item_int_message(
                *TO_US, message.seq, frame, item.command, 0, 1, *item.parameters,
                item.x, item.y, round(item.z, 2), message.mission_type,
            )
        ]  # fmt: skip

    def on_mission_ack(self, message):
        if message.type:
            self.upload = None
        return []

    def on_mission_clear_all(self, message):
        self.plans[message.mission_type] = []
        return [self.ack(0, message.mission_type)]


def joined(vehicle, **faults):
    channel = Channel(vehicle, **faults)
    vehicle.channel = channel
    return channel, PlanTransfer(channel, lambda: vehicle.ardupilot)


def route(count):
    values = []
    for number in range(count):
        values += [HERE[0] + number * 1e-4, HERE[1] - number * 1e-4, 10.0 + number]
    return waypoints(values, yaw=0.0)


def same(items, others):
    return len(items) == len(others) and all(a.matches(b) for a, b in zip(items, others, strict=True))


@pytest.mark.parametrize("ardupilot", [True, False])
def test_mission_is_uploaded_and_downloaded(ardupilot):
    vehicle = Vehicle(ardupilot=ardupilot)
    channel, transfer = joined(vehicle)

    async def scenario():
        await transfer.upload(PlanKind.MISSION, route(5))
        return await transfer.download(PlanKind.MISSION)

    found = run(scenario(), 10.0)
    assert same(found, route(5))
    assert len(vehicle.plans[0]) == (6 if ardupilot else 5)
    assert coordinates(found, found[0].command)[:3] == pytest.approx([*HERE, 10.0])
    # Read back after the upload, then read: two downloads, each ended with an acknowledgement.
    assert channel.kinds().count("MISSION_REQUEST_LIST") == 2
    assert channel.kinds().count("MISSION_ACK") == 2


@pytest.mark.parametrize("ardupilot", [True, False])
def test_clear_removes_each_plan(ardupilot):
    vehicle = Vehicle(ardupilot=ardupilot)
    channel, transfer = joined(vehicle)

    async def scenario():
        for kind in PlanKind:
            await transfer.upload(kind, route(2))
            await transfer.clear(kind)
        return [await transfer.download(kind) for kind in PlanKind]

    assert run(scenario(), 20.0) == [[], [], []]
    # A mission of ArduPilot is cleared by the upload of home alone.
    assert channel.kinds().count("MISSION_CLEAR_ALL") == (2 if ardupilot else 3)


def test_mission_fence_and_rally_points_are_separate():
    vehicle = Vehicle(ardupilot=False)
    _, transfer = joined(vehicle)
    fence = circle(*HERE, 50.0, inside=True)

    async def scenario():
        await transfer.upload(PlanKind.MISSION, route(2))
        await transfer.upload(PlanKind.FENCE, fence)
        await transfer.upload(PlanKind.RALLY, rally_points([*HERE, 20.0]))
        await transfer.clear(PlanKind.RALLY)

    run(scenario(), 20.0)
    assert same(vehicle.plans[0], route(2))
    assert same(vehicle.plans[1], fence)
    assert vehicle.plans[2] == []


def test_upload_stored_incompletely_is_an_error():
    vehicle = Vehicle(ardupilot=True)
    vehicle.keeps = 3
    _, transfer = joined(vehicle)
    with pytest.raises(DeviceError, match="mission could not be uploaded in 3 attempts: it has 3 items"):
        run(transfer.upload(PlanKind.MISSION, route(5)), 60.0)


@pytest.mark.parametrize(
    ("result", "words"), [(4, r"NO_SPACE \(4\)"), (14, r"DENIED \(14\)"), (77, "unknown result")]
)
def test_refused_upload_names_the_mission_result(result, words):
    vehicle = Vehicle(ardupilot=False)
    vehicle.result = result
    _, transfer = joined(vehicle)
    with pytest.raises(DeviceError, match=f"refuses the mission: .*{words}"):
        run(transfer.upload(PlanKind.MISSION, route(2)), 5.0)


def test_mission_refused_during_upload_is_removed_on_ardupilot():
    vehicle = Vehicle(ardupilot=True, in_place=True)
    _, transfer = joined(vehicle)
    run(transfer.upload(PlanKind.MISSION, route(2)), 20.0)
    takes = vehicle.on_mission_item_int

    def refuses(message):
        if message.seq < 2:
            return takes(message)
        vehicle.upload = None
        return [vehicle.ack(dialect.MAV_MISSION_UNSUPPORTED, 0)]

    vehicle.on_mission_item_int = refuses
    with pytest.raises(DeviceError, match=r"refuses the mission: UNSUPPORTED \(3\)"):
        run(transfer.upload(PlanKind.MISSION, route(4)), 20.0)
    assert run(transfer.download(PlanKind.MISSION), 5.0) == []


def test_silent_vehicle_is_an_error_within_five_seconds():
    transfer = PlanTransfer(Channel(lambda message: []), lambda: True)
    for work in (
        lambda: transfer.upload(PlanKind.MISSION, route(2)),
        lambda: transfer.download(PlanKind.FENCE),
        lambda: transfer.clear(PlanKind.RALLY),
    ):
        with pytest.raises(DeviceError, match="did not answer") as raised:
            run(work(), 5.1)
        assert raised.value.kind == "DeviceTimeoutException"


def test_lost_link_ends_a_transfer_at_once():
    vehicle = Vehicle(ardupilot=True)
    channel, transfer = joined(vehicle)
    vehicle.on_mission_item_int = lambda message: []

    def lost():
        if asyncio.get_running_loop().time() > 1003.0:
            raise DeviceError("fc", "the link is lost", kind="DeviceTimeoutException")

    channel.check_link = lost
    with pytest.raises(DeviceError, match="the link is lost"):
        run(transfer.upload(PlanKind.MISSION, route(2)), 3.2)


def test_endless_item_requests_are_an_error():
    def ask_again(message):
        if message.get_type() not in ("MISSION_COUNT", "MISSION_ITEM_INT"):
            return []
        return [dialect.MAVLink_mission_request_int_message(*TO_US, 0, 0)]

    channel = Channel(ask_again)
    with pytest.raises(DeviceError, match="requested 1 of 3 items only"):
        run(PlanTransfer(channel, lambda: False).upload(PlanKind.MISSION, route(3)), 60.0)


def test_download_with_an_absurd_count_is_an_error():
    channel = Channel(lambda m: [dialect.MAVLink_mission_count_message(*TO_US, 65535, 0)])
    with pytest.raises(DeviceError, match="65535 items"):
        run(PlanTransfer(channel, lambda: False).download(PlanKind.MISSION), 5.0)


def test_cancelled_upload_is_ended_and_the_next_works():
    vehicle = Vehicle(ardupilot=True)
    channel, transfer = joined(vehicle)

    async def scenario():
        task = asyncio.get_running_loop().create_task(transfer.upload(PlanKind.MISSION, route(50)))
        await asyncio.sleep(0.1)
        assert vehicle.upload is not None
        task.cancel()
        with pytest.raises(asyncio.CancelledError):
            await task
        await asyncio.sleep(0.1)
        assert vehicle.upload is None
        await transfer.upload(PlanKind.MISSION, route(3))

    run(scenario(), 20.0)
    assert dialect.MAV_MISSION_OPERATION_CANCELLED in [
        message.type for message in channel.sent if message.get_type() == "MISSION_ACK"
    ]
    assert len(vehicle.plans[0]) == 4


def test_repeated_packets_do_not_multiply_the_upload():
    vehicle = Vehicle(ardupilot=False)
    channel, transfer = joined(vehicle, seed=1, repeat=0.3)
    run(transfer.upload(PlanKind.MISSION, route(40)), 300.0)
    assert same(vehicle.plans[0], route(40))
    assert channel.kinds().count("MISSION_ITEM_INT") < 200


@settings(max_examples=60, deadline=None)
@given(
    seed=st.integers(0, 2**32),
    ardupilot=st.booleans(),
    in_place=st.booleans(),
    loss=st.floats(0.0, 0.5),
    repeat=st.floats(0.0, 0.5),
    overtake=st.floats(0.0, 0.5),
    count=st.integers(1, 12),
)
def test_upload_over_any_channel_is_identical_or_an_error(
    seed, ardupilot, in_place, loss, repeat, overtake, count
):
    vehicle = Vehicle(ardupilot=ardupilot, in_place=in_place)
    vehicle.asks_again = True
    _, transfer = joined(vehicle, seed=seed, loss=loss, repeat=repeat, overtake=overtake)

    async def scenario():
        try:
            await transfer.upload(PlanKind.MISSION, route(count))
        except DeviceError:
            return None
        return list(vehicle.plans[0])

    held = run(scenario(), 600.0)
    if held is not None:
        assert same(held[1 if ardupilot else 0 :], route(count))


@given(
    st.lists(
        st.tuples(st.floats(-90, 90), st.floats(-180, 180), st.floats(-1e4, 1e4)), min_size=1, max_size=20
    )
)
def test_waypoints_are_converted_and_restored(places):
    values = [number for place in places for number in place]
    back = coordinates(waypoints(values, yaw=math.nan), dialect.MAV_CMD_NAV_WAYPOINT)
    assert back == pytest.approx(values, abs=1e-7)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: waypoints([1.0, 2.0], yaw=0.0), "which 2 numbers are not"),
        (lambda: waypoints([], yaw=0.0), "0 numbers"),
        (lambda: waypoints([91.0, 0.0, 1.0], yaw=0.0), "is not a position in degrees"),
        (lambda: waypoints([math.nan, 0.0, 1.0], yaw=0.0), "is not a position in degrees"),
        (lambda: waypoints([1.0, 0.0, math.inf], yaw=0.0), "finite"),
        (lambda: rally_points([1.0, 181.0, 1.0]), "is not a position in degrees"),
        (lambda: circle(1.0, 1.0, 0.0, inside=True), "radius above 0"),
        (lambda: circle(1.0, 1.0, math.nan, inside=True), "radius above 0"),
        (lambda: polygon([1.0, 1.0, 2.0, 2.0], inside=True), "3 to 255 corners, not 2"),
        (lambda: coordinates([HOME], HOME.command), r"which is not \{"),
        (lambda: coordinates(circle(1.0, 1.0, 9.0, inside=True), 16), r"NAV_FENCE_CIRCLE_INCLUSION \(5003\)"),
    ],
)
def test_invalid_plan_values_are_refused(make, words):
    with pytest.raises(ValueError, match=words):
        make()
