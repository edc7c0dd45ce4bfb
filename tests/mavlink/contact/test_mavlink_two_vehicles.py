"""Two vehicles with one system id, a vehicle whose address changes, and one that is replaced."""

from __future__ import annotations

import asyncio

import pytest
from coroutine_tests import on_bench
from takeoff import up

from lfield.errors import DeviceError
from lfield_mavlink.link.dialect import Reader, dialect
from lfield_sim.autopilot.autopilot import FLAVOURS, Autopilot
from lfield_sim.mavlink.mavlink_fake import STEP, MavlinkFake

FIRST, SECOND = "10.0.0.5:14555", "10.0.0.6:14555"
PORT = "udpin:0.0.0.0:14550"
BOARD = 0x3F21


class Twin:
    """A second vehicle with the same system id, on a link of the bench, active while `there`."""

    def __init__(self, bench, flavour="ardupilot", *, board=BOARD + 1, link=0, address=SECOND):
        self.bench, self.link, self.address = bench, link, address
        self.fake = MavlinkFake(Autopilot(FLAVOURS[flavour]["copter"], board=board), system=1)
        self.there = True

    async def live(self):
        while True:
            await asyncio.sleep(STEP)
            link = self.bench.links[self.link]
            for packet in self.fake.advance(STEP) if self.there else ():
                link.sender(self.address)
                link.on_data(packet)

    def receive(self, data):
        for packet in self.fake.receive("link", data) if self.there else ():
            link = self.bench.links[self.link]
            link.sender(self.address)
            link.on_data(packet)


def with_twin(bench, twin):
    """The bench with both vehicles: each receives packets to its address and broadcast packets."""
    bench._fakes = [*bench._fakes, twin.live]

    def passes(link, packet):
        link.sender(FIRST if link.number == twin.link else "")
        link.on_data(packet)

    bench.filter = passes
    return bench


def both_receive(bench, twin):
    """One link with one remote end, such as a router: both receive every packet."""
    bench._fakes = [*bench._fakes, twin.live]

    def join():
        link = bench.links[twin.link]
        send = link.send

        def to_both(data):
            send(data)
            asyncio.get_running_loop().call_soon(twin.receive, data)

        link.send = to_both

    return join


def commands(packets, number):
    reader = Reader()
    found = [message for data in packets for message in reader.feed(data)]
    return [each for each in found if each.get_msgId() == 76 and each.command == number]


BOTH = pytest.mark.parametrize("flavour", ["ardupilot", "px4"])


@BOTH
def test_arming_is_refused_for_two_vehicles_on_one_port(bench, flavour):
    b = bench(flavour=flavour, endpoint=PORT, board=BOARD)
    twin = Twin(b, flavour)
    with_twin(b, twin)

    async def mission(fc):
        with pytest.raises(DeviceError, match="arm refused: two vehicles send as system 1") as error:
            await fc.execute("arm", [])
        assert FIRST in error.value.reason
        assert SECOND in error.value.reason
        assert FIRST in await fc.execute("whyNotReady", [])
        assert not await fc.execute("isReady", [])
        assert not commands(b.sent, dialect.MAV_CMD_COMPONENT_ARM_DISARM)
        twin.there = False
        await asyncio.sleep(6.0)
        await fc.execute("waitReady", [30.0])
        await fc.execute("arm", [])

    b.run(mission)
    assert sum(SECOND in note and "ignored" in note for note in b.notes) == 1


@pytest.mark.few(1)
@BOTH
def test_second_vehicle_is_ignored_while_the_first_flies(bench, flavour):
    b = bench(flavour=flavour, endpoint=PORT, board=BOARD)
    twin = Twin(b, flavour)
    twin.there = False
    with_twin(b, twin)

    async def mission(fc):
        await up(fc)
        twin.there = True
        twin.fake.autopilot.vehicle.place = (700.0, 0.0, 0.0)
        b.links[0].sent_to.clear()
        await fc.execute("goTo", [20.0, 0.0, -5.0])
        # The other vehicle is disarmed and far away: its telemetry is not published.
        assert b.values["armed"]
        assert b.values["position"] == pytest.approx([20.0, 0.0, -5.0], abs=0.6)
        await fc.execute("land", [])
        assert {address for address, _ in b.links[0].sent_to} == {FIRST}

    b.run(mission)
    assert sum(SECOND in note and "ignored" in note for note in b.notes) == 1


@pytest.mark.few(0)
@BOTH
@pytest.mark.parametrize("later", [False, True])
def test_second_vehicle_does_not_replace_one_silent_in_flight(bench, flavour, later):
    """The second vehicle sends at the same time, or is switched on during the silence of the first one."""
    b = bench(flavour=flavour, endpoint=PORT, board=BOARD)
    twin = Twin(b, flavour)
    twin.there = False
    with_twin(b, twin)
    passes, silent = b.filter, False
    b.filter = lambda link, packet: None if silent else passes(link, packet)

    async def mission(fc):
        nonlocal silent
        b.links[0].send_to = lambda data, address: (
            b.links[0].send(data) if address == FIRST else twin.receive(data)
        )
        await up(fc)
        twin.there = not later
        await asyncio.sleep(2.0)
        silent = True
        await asyncio.sleep(2.0)
        twin.there = True
        await asyncio.sleep(6.0)
        with pytest.raises(DeviceError, match="two vehicles") as error:
            await fc.execute("hold", [])
        assert SECOND in error.value.reason
        silent = False
        await b.until(lambda: fc.silence < 1.0)
        await fc.make_safe()
        await b.until(lambda: not b.values["armed"])
        assert not b.autopilot.armed

    b.run(mission)
    assert any(SECOND in note and "ignored" in note for note in b.notes)


@pytest.mark.few(2)
@BOTH
@pytest.mark.parametrize("head_start", [0.0, 0.5, 30.0])
def test_arming_is_refused_for_two_vehicles_behind_a_router(bench, flavour, head_start):
    b = bench(flavour=flavour, board=BOARD)
    twin = Twin(b, flavour, address="")
    twin.fake.autopilot.parameters.update(b.autopilot.parameters)
    twin.fake.autopilot.apply_parameters()
    join = both_receive(b, twin)

    async def mission(fc):
        join()
        if head_start:
            twin.fake.advance(head_start)
        await asyncio.sleep(2.0)
        with pytest.raises(DeviceError, match="arm refused: two vehicles send as system 1, both over udp:"):
            await fc.execute("arm", [])
        assert not b.autopilot.armed
        assert not twin.fake.autopilot.armed
        twin.there = False
        await asyncio.sleep(6.0)
        await fc.execute("arm", [])

    b.run(mission)
    assert [note.code for note in b.notes].count("mavlink-two-vehicles-mixed") == 1


@pytest.mark.few(0)
@pytest.mark.parametrize(("flavour", "head_start"), [("ardupilot", 0.0), ("ardupilot", 30.0), ("px4", 0.0)])
def test_second_vehicle_behind_a_router_does_not_end_a_flight(bench, flavour, head_start):
    b = bench(flavour=flavour, board=BOARD)
    twin = Twin(b, flavour, address="")
    twin.there = False
    join = both_receive(b, twin)

    async def mission(fc):
        join()
        await up(fc)
        twin.fake.advance(head_start or STEP)
        twin.fake.autopilot.vehicle.place = (700.0, 0.0, 0.0)
        twin.there = True
        await fc.execute("goTo", [40.0, 0.0, -5.0])
        assert b.values["position"] == pytest.approx([40.0, 0.0, -5.0], abs=0.6)
        for _ in range(50):
            await asyncio.sleep(0.1)
            assert b.values["armed"]
        await fc.make_safe()
        await b.until(lambda: not b.values["armed"])
        assert not b.autopilot.armed

    b.run(mission)
    assert [note.code for note in b.notes].count("mavlink-two-vehicles-mixed") == 1


@on_bench("bench", board=BOARD)
async def test_vehicle_with_a_changed_board_is_not_armed(b, fc, /):
    await asyncio.sleep(1.0)
    b.autopilot.board = BOARD + 1
    with pytest.raises(DeviceError, match="another vehicle answers: its board is"):
        await fc.execute("arm", [])
    assert not commands(b.sent, dialect.MAV_CMD_COMPONENT_ARM_DISARM)


@pytest.mark.parametrize("same", [False, True])
def test_board_ids_over_two_links_show_one_vehicle_or_two(bench, same):
    b = bench(links=2, board=BOARD)
    twin = Twin(b, board=BOARD if same else BOARD + 1, link=1, address="")

    def passes(link, packet):
        if link.number == 0:
            link.on_data(packet)

    with_twin(b, twin)
    b.filter = passes

    async def mission(fc):
        second = b.links[1]
        send, second.send = second.send, lambda data: (send(data), twin.receive(data))
        await asyncio.sleep(2.0)
        if same:
            await fc.execute("arm", [])
            return
        with pytest.raises(DeviceError, match="two vehicles send as system 1") as error:
            await fc.execute("arm", [])
        assert "udp:127.0.0.1:1 and udp:127.0.0.1:2" in error.value.reason

    b.run(mission)


def test_flight_continues_after_a_change_of_address(bench):
    b = bench(endpoint=PORT, board=BOARD)
    address = [FIRST]

    def passes(link, packet):
        link.sender(address[0])
        link.on_data(packet)

    b.filter = passes

    async def mission(fc):
        await up(fc)
        flight = asyncio.ensure_future(fc.execute("goTo", [60.0, 0.0, -5.0]))
        await asyncio.sleep(3.0)
        address[0] = SECOND
        await flight
        assert {to for to, _ in b.links[0].sent_to[-3:]} == {SECOND}

    b.run(mission)
    assert any(note.startswith(f"address changed to {PORT} from {SECOND}, from") for note in b.notes)
    assert any("same vehicle as before" in note for note in b.notes)
    assert not any("two vehicles" in note for note in b.notes)


def cut_and_replace_board(b, board):
    """Interrupts the link and replaces the board."""
    b.cut = True
    b.autopilot.board = board


@pytest.mark.parametrize("board", [BOARD + 1, 0])
@BOTH
@on_bench("bench", board=BOARD, given="flavour")
async def test_replaced_vehicle_after_a_link_loss_gets_no_command(b, fc, /, flavour, board):
    cut_and_replace_board(b, board)
    await asyncio.sleep(5.0)
    b.sent.clear()
    b.cut = False
    await b.until(lambda: fc.silence < 1.0)
    for name, values in (("arm", []), ("setMode", [fc.profile.hold]), ("hold", []), ("land", [])):
        with pytest.raises(DeviceError, match="another vehicle answers: its board is"):
            await fc.execute(name, values)
    with pytest.raises(DeviceError, match="another vehicle answers: its board is"):
        await fc.make_safe()
    assert not commands(b.sent, dialect.MAV_CMD_COMPONENT_ARM_DISARM)
    assert not commands(b.sent, dialect.MAV_CMD_DO_SET_MODE)
    await asyncio.sleep(3.0)
    b.autopilot.board = BOARD
    await b.until(lambda: any("same vehicle as before" in note for note in b.notes))
    await fc.execute("arm", [])
    assert sum("another vehicle answers" in note for note in b.notes) == 1


@on_bench("bench", board=0)
async def test_board_without_an_id_is_compared_by_type_and_firmware(b, fc, /):
    cut_and_replace_board(b, 0)
    await asyncio.sleep(5.0)
    b.cut = False
    await asyncio.sleep(3.0)
    await fc.execute("arm", [])
    assert any("it has no unique id (uid 0); its autopilot, type and firmware" in n for n in b.notes)


@on_bench("bench", board=BOARD)
async def test_vehicle_without_confirmed_board_after_a_loss_gets_no_command(b, fc, /):
    def mute(link, packet):
        if not any(m.get_type() == "AUTOPILOT_VERSION" for m in Reader().feed(packet)):
            link.on_data(packet)

    b.cut = True
    await asyncio.sleep(5.0)
    b.filter, b.cut = mute, False
    await b.until(lambda: fc.silence < 1.0)
    with pytest.raises(DeviceError, match=r"its unique id is not confirmed since .* s of silence") as error:
        await fc.execute("arm", [])
    assert error.value.kind == "DeviceTimeoutException"
    assert not commands(b.sent, dialect.MAV_CMD_COMPONENT_ARM_DISARM)


@pytest.mark.few(2)
@pytest.mark.parametrize(
    ("kind", "autopilot"),
    [(6, 8), (18, 8), (18, 3), (6, 3), (2, 8), (0, 8), (34, 0), (27, 3), (42, 12), (5, 3), (2, 0), (0, 0)],
)
def test_heartbeats_of_a_non_autopilot_are_ignored_and_reported(bench, kind, autopilot):
    b = bench(endpoint=PORT, board=BOARD)
    station = dialect.MAVLink(None, srcSystem=1, srcComponent=1)

    async def beats():
        while True:
            await asyncio.sleep(0.21)
            b.links[0].sender(SECOND)
            b.links[0].on_data(dialect.MAVLink_heartbeat_message(kind, autopilot, 0, 0, 4, 3).pack(station))
            b.links[0].sender(FIRST)

    b._fakes = [*b._fakes, beats]

    async def mission(fc):
        await up(fc)
        assert b.values["armed"]
        await fc.execute("land", [])

    b.run(mission)
    reports = [note for note in b.notes if "heartbeats of a" in note]
    assert len(reports) == 1
    assert f"MAV_TYPE {kind}, MAV_AUTOPILOT {autopilot}" in reports[0]
    assert SECOND in reports[0]
    assert reports[0].startswith("ignoring ")


def test_open_fails_where_only_a_ground_station_sends(bench):
    b = bench(endpoint=PORT)
    station = dialect.MAVLink(None, srcSystem=1, srcComponent=1)
    b.filter = lambda link, packet: link.on_data(
        dialect.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3).pack(station)
    )
    with pytest.raises(DeviceError, match=r"no heartbeat .*received: system 1, component 1 \(gcs\)"):
        b.run(lambda fc: asyncio.sleep(0.0))
