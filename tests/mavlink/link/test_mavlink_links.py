"""Several links and several vehicles: which link receives and sends which packets."""

from __future__ import annotations

import asyncio
import re

import pytest
from coroutine_tests import on_bench
from takeoff import up

from lfield.errors import DeviceError
from lfield_mavlink.link.dialect import Reader, dialect
from lfield_mavlink.link.links import LinkUses, split_endpoint
from lfield_mavlink.link.ports import REMEMBERED, Route


def commands(link, number):
    reader = Reader()
    found = [m for data in link.sent for m in reader.feed(data)]
    return [m for m in found if m.get_msgId() == 76 and m.command == number]


def test_endpoint_list_is_split_into_links():
    both = "udpin:0.0.0.0:1, payload=udpin:0.0.0.0:1, payload=tcp:10.0.0.9:2"
    assert (len(split_endpoint(both)), LinkUses.parse(both)) == (2, ([0], [0, 1]))
    assert split_endpoint("udp:127.0.0.1:14550, serial:/dev/ttyUSB0:57600") == [
        "udp:127.0.0.1:14550",
        "serial:/dev/ttyUSB0:57600",
    ]


def test_route_stays_on_a_link_while_it_receives_packets():
    route = Route(range(3))
    assert route.links(0.0) == (0, 1, 2)
    assert route.on_packet(1, b"a", 0.0)
    assert route.links(0.1) == (1,)
    assert route.on_packet(2, b"b", 1.4)
    assert route.links(1.45) == (1,)
    assert route.links(1.6) == (2,)
    assert route.links(3.0) == (0, 1, 2)


def test_repeated_packet_is_distinguished_from_a_new_one():
    route = Route(range(2))
    assert route.on_packet(0, b"a", 0.0)
    assert not route.on_packet(1, b"a", 0.0)
    assert route.on_packet(0, b"a", 5.0)
    for number in range(2 * REMEMBERED):
        assert route.on_packet(1, b"%d" % number, 6.0)
    assert len(route._packets) <= REMEMBERED


@on_bench("bench", links=2)
async def test_flight_continues_when_either_of_two_links_fails(b, fc, /):
    await up(fc)
    flight = asyncio.create_task(fc.execute("goTo", [40.0, 0.0, -5.0]))
    await asyncio.sleep(2.0)
    b.links[0].cut = True
    await asyncio.sleep(4.0)
    b.links[0].cut, b.links[1].cut = False, True
    await flight
    assert [note for note in b.notes if "lost" in note] == []


def test_command_is_sent_on_one_link_and_heartbeat_on_both(bench):
    b = bench(links=2)

    async def mission(fc):
        for link in b.links:
            link.sent.clear()
        await fc.execute("arm", [])
        await asyncio.sleep(1.0)

    b.run(mission)
    arming = [commands(link, dialect.MAV_CMD_COMPONENT_ARM_DISARM) for link in b.links]
    assert sorted(map(len, arming)) == [0, 1]
    for link in b.links:
        assert sum(data[7] == dialect.MAVLINK_MSG_ID_HEARTBEAT for data in link.sent) >= 4


@on_bench("bench", links=2)
async def test_status_text_on_two_links_is_reported_once(b, fc, /):
    b.autopilot.refuse_arming = "compass not calibrated"
    with pytest.raises(DeviceError) as error:
        await fc.execute("arm", [])
    assert error.value.reason == "arm refused: FAILED (4), Arm: compass not calibrated"
    assert b.notes.count("autopilot: Arm: compass not calibrated") == 1


def test_link_that_fails_to_open_is_reported_and_retried(bench):
    b = bench(links=2)
    b.refused = {1}

    async def mission(fc):
        await asyncio.sleep(3.5)
        b.links[1].refused = False
        await asyncio.sleep(2.0)
        b.links[0].cut = True
        await asyncio.sleep(5.0)
        await fc.execute("arm", [])

    b.run(mission)
    notes = [note for note in b.notes if "open" in note]
    assert notes[0] == "link not opened: cannot open link 1; continuing with the other links"
    assert re.fullmatch(r"link opened: \S+, after [4-6] attempts", notes[1])
    assert len(notes) == 2


def test_open_fails_when_no_link_opens(bench):
    b = bench(links=2)
    b.refused = {0, 1}
    with pytest.raises(DeviceError, match="cannot open link 0"):
        b.run(lambda fc: asyncio.sleep(0.0))


@on_bench("bench", systems=(1, 2))
async def test_two_vehicles_on_one_link_fly_at_the_same_time(b, one, two, /):
    async def fly(fc, height, north):
        await up(fc, height)
        await fc.execute("goTo", [north, 0.0, -height])

    await asyncio.gather(fly(one, 4.0, 10.0), fly(two, 7.0, -10.0))
    assert b.reported["a1.fc"]["position"] == pytest.approx([10.0, 0.0, -4.0], abs=0.6)
    assert b.reported["a2.fc"]["position"] == pytest.approx([-10.0, 0.0, -7.0], abs=0.6)


@on_bench("bench", systems=(1, 2))
async def test_lost_vehicle_does_not_delay_the_other(b, one, two, /):
    b.faults.apply(["silence@2=true"])
    await asyncio.sleep(3.5)
    with pytest.raises(DeviceError, match="the link is lost"):
        await two.execute("arm", [])
    await one.execute("arm", [])
    await one.execute("takeoff", [4.0])
    assert b.notes.count("link lost: no message received") == 1


def test_two_devices_with_one_system_id_are_refused(bench):
    b = bench(systems=(1, 2))
    b.bindings[1].options["system"] = 1
    with pytest.raises(DeviceError, match="two devices are system 1"):
        b.run(lambda *_: asyncio.sleep(0.0))
