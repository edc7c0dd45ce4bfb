"""A separate station id for each vehicle, and the autopilot's failsafe when this computer fails."""

from __future__ import annotations

import asyncio

import pytest
from coroutine_tests import on_bench
from takeoff import up

from lfield.errors import DeviceError
from lfield.testing.driver_bench import bind
from lfield_mavlink import PLUGIN
from lfield_mavlink.link.dialect import Reader, dialect, station_heartbeat
from lfield_mavlink.station_ids import check_stations, station_of
from lfield_sim.mavlink.link.codec import PacketWriter

#: QGroundControl, by default.
QGC = (255, 190)
#: Seconds of the vehicle's clock from the end of host and guard to the failsafe mode.
BOUNDS = {("ardupilot", "copter"): 3.0, ("ardupilot", "rover"): 4.0, ("px4", "copter"): 2.0}
BOUNDS |= {("px4", "rover"): 2.0}
SAFE = {
    ("ardupilot", "copter"): {"land": "LAND", "hold": "BRAKE", "return": "RTL"},
    ("ardupilot", "rover"): {"land": "HOLD", "hold": "HOLD", "return": "RTL"},
    ("px4", "copter"): {"land": "AUTO.LAND", "hold": "AUTO.LOITER", "return": "AUTO.RTL"},
    ("px4", "rover"): {"land": "AUTO.LAND", "hold": "AUTO.LOITER", "return": "AUTO.RTL"},
}


async def beats(b, system, component, kind=None):
    """Heartbeats of another station on another link of the vehicle, once per second."""
    packer = PacketWriter(system, component)
    kind = dialect.MAV_TYPE_GCS if kind is None else kind
    heartbeat = dialect.MAVLink_heartbeat_message(kind, dialect.MAV_AUTOPILOT_INVALID, 0, 0, 4, 3)
    while True:
        for fake in b.fakes.values():
            fake.receive("another link", packer.pack(heartbeat))
        await asyncio.sleep(1.0)


async def go(b, fc, way, flies):
    """Starts a motion; returns the task of its instruction."""
    down = -8.0 if flies else 0.0
    await fc.execute("arm", [])
    if flies:
        await fc.execute("takeoff", [8.0])
    if way == "goTo":
        return asyncio.create_task(fc.execute("goTo", [200.0, 0.0, down]))
    if way in ("hold", "pause"):
        if way == "pause":
            latitude, longitude, _ = b.values["globalPosition"]
            await fc.execute("uploadMission", [[latitude + 2e-3, longitude, -down]])
            await fc.execute("startMission", [])
            await asyncio.sleep(3.0)
            await fc.execute("pauseMission", [])
        else:
            flight = asyncio.create_task(fc.execute("goTo", [200.0, 0.0, down]))
            await asyncio.sleep(3.0)
            await fc.execute("hold", [])
            await asyncio.gather(flight, return_exceptions=True)
        await asyncio.sleep(4.0)
        return asyncio.create_task(asyncio.sleep(0.0))
    if way == "hover":
        await fc.execute("goTo", [3.0, 0.0, down])
        return asyncio.create_task(asyncio.sleep(0.0))
    if way == "orbit":
        return asyncio.create_task(fc.execute("orbit", [10.0, 0.0, down, 10.0, 2.0, 9.0]))

    async def on():
        while True:
            await fc.execute("setVelocity", [1.0, 0.0, 0.0])
            await asyncio.sleep(0.2)

    return asyncio.create_task(on())


@pytest.mark.few(2)
@pytest.mark.parametrize("station", [False, True], ids=["alone", "beside QGroundControl"])
@pytest.mark.parametrize("state", ["land", "hold", "return"])
@pytest.mark.parametrize("way", ["goTo", "velocity", "hover", "orbit"])
@pytest.mark.parametrize(("flavour", "kind"), BOUNDS)
def test_failsafe_acts_in_time_after_death_of_host_and_guard(bench, flavour, kind, way, state, station):
    if (flavour, kind) == ("px4", "rover") and way in ("orbit", "hover"):
        pytest.skip("it has no orbit, and stands in the mode for standing")
    b = bench(flavour=flavour, kind=kind, safe_state=state, waivers=("device_watchdog",))
    bound, mode = BOUNDS[flavour, kind], SAFE[flavour, kind][state]

    async def scenario(fc):
        other = asyncio.create_task(beats(b, *QGC)) if station else None
        under_way = await go(b, fc, way, kind == "copter")
        await asyncio.sleep(4.0)
        assert b.autopilot.mode == fc.profile.guided
        b.cut, died = True, b.autopilot.now
        under_way.cancel()
        while b.autopilot.mode != mode:
            assert b.autopilot.now - died < bound
            await asyncio.sleep(0.02)
        await asyncio.sleep(5.0)
        assert b.autopilot.mode in (mode, "AUTO.LOITER") or not b.autopilot.armed
        if other is not None:
            other.cancel()
        await asyncio.gather(under_way, return_exceptions=True)

    b.run(scenario)


@on_bench("bench")
async def test_ardupilot_mission_ends_after_death_of_host_and_guard(b, fc, /):
    other = asyncio.create_task(beats(b, *QGC))
    await up(fc, 8.0)
    latitude, longitude, _ = b.values["globalPosition"]
    await fc.execute("uploadMission", [[latitude + 2e-3, longitude, 8.0]])
    await fc.execute("startMission", [])
    await asyncio.sleep(4.0)
    b.cut, died = True, b.autopilot.now
    while b.autopilot.mode != "LAND":
        assert b.autopilot.now - died < 3.0
        await asyncio.sleep(0.02)
    other.cancel()


@pytest.mark.few(2)
@pytest.mark.parametrize("way", ["hold", "pause"])
@pytest.mark.parametrize("state", ["land", "return"])
@on_bench("bench", given="safe_state=state")
async def test_failsafe_acts_in_time_in_an_ardupilot_hold(b, fc, /, way, state):
    """In BRAKE its failsafe would not act: with FS_OPTIONS bit 4, the default, BRAKE is a pilot mode."""
    await go(b, fc, way, flies=True)
    assert b.autopilot.mode == "GUIDED"
    assert b.autopilot.parameters["FS_OPTIONS"] == 24
    place = b.autopilot.vehicle.place
    await asyncio.sleep(3.0)
    assert b.autopilot.vehicle.place == pytest.approx(place, abs=0.3)
    b.cut, died = True, b.autopilot.now
    while b.autopilot.mode != SAFE["ardupilot", "copter"][state]:
        assert b.autopilot.now - died < BOUNDS["ardupilot", "copter"]
        await asyncio.sleep(0.02)


@on_bench("bench")
async def test_pilot_mode_continues_without_the_station(b, fc, /):
    await go(b, fc, "hold", flies=True)
    b.autopilot.command("POSHOLD")
    await asyncio.sleep(2.0)
    b.cut = True
    await asyncio.sleep(6.0)
    assert b.autopilot.mode == "POSHOLD"
    assert b.autopilot.critical, "it has detected the loss"


@pytest.mark.few(2)
@pytest.mark.parametrize(("flavour", "kind"), BOUNDS)
@on_bench("bench", waivers=("device_watchdog",), given="flavour kind")
async def test_restarted_guard_does_not_delay_the_failsafe(b, fc, /, flavour, kind):
    """A restarted guard needs time to start, and sends heartbeats only after the safe state."""
    bound, mode = BOUNDS[flavour, kind], SAFE[flavour, kind]["land"]

    other = asyncio.create_task(beats(b, *QGC))
    under_way = await go(b, fc, "goTo", kind == "copter")
    await asyncio.sleep(4.0)
    b.cut, died = True, b.autopilot.now
    under_way.cancel()
    await asyncio.gather(under_way, return_exceptions=True)
    await asyncio.sleep(0.8)
    again = fc.__class__(fc.binding, fc.manifest, fc.clock, b.driver.reports, lambda message: None)
    assert not again.may_send_heartbeat
    for armed in (True, False):
        again.state.heartbeat_at, again.state.armed = 1.0, armed
        assert again.may_send_heartbeat is not armed
    while b.autopilot.mode != mode:
        assert b.autopilot.now - died < bound
        await asyncio.sleep(0.02)
    other.cancel()


def test_armed_vehicle_gets_heartbeats_only_after_the_safe_state(bench):
    b = bench(safe_state="hold")
    b.autopilot.armed = True
    b.autopilot.vehicle.place = (0.0, 0.0, -8.0)
    b.autopilot.enter("GUIDED")
    reader = Reader()

    def heartbeats():
        sent = [m.get_msgId() for data in b.sent for m in reader.feed(data)]
        b.sent.clear()
        return sent.count(dialect.MAVLINK_MSG_ID_HEARTBEAT)

    async def scenario(fc):
        await asyncio.sleep(1.0)
        assert heartbeats() == 0
        fc.guard_restarted(False)
        await asyncio.sleep(0.5)
        assert heartbeats() == 0
        await fc.make_safe()
        await asyncio.sleep(1.0)
        assert heartbeats() >= 4

    b.run(scenario)


@pytest.mark.parametrize("flavour", ["ardupilot", "px4"])
@on_bench("bench", given="flavour")
async def test_fakes_continue_a_mission_beside_another_station(b, fc, /, flavour):
    """As measured: therefore a separate station id and setpoints are needed."""
    other = asyncio.create_task(beats(b, *QGC))
    await up(fc, 8.0)
    latitude, longitude, _ = b.values["globalPosition"]
    await fc.execute("uploadMission", [[latitude + 2e-3, longitude, 8.0]])
    await fc.execute("startMission", [])
    b.autopilot.parameters["MAV_GCS_SYSID"] = 255
    b.cut, mode = True, b.autopilot.mode
    await asyncio.sleep(15.0)
    assert b.autopilot.mode == mode
    assert b.autopilot.vehicle.place[0] > 30.0
    other.cancel()


# -- ids ------------------------------------------------------------------------------------------------


def bound(system, station=0, agent=""):
    options = {"system": system, "station": station}
    return bind(PLUGIN, agent=agent or f"a{system}", field="fc", endpoint="udp:127.0.0.1:1", options=options)


def test_default_station_ids_are_unique_and_unused_by_vehicles():
    stations = {system: station_of(bound(system)) for system in range(1, 255)}
    assert len(set(stations.values())) == 254
    assert all(station not in (system, 255, 0) for system, station in stations.items())
    assert (stations[1], stations[2], stations[254]) == (128, 129, 127)
    assert station_of(bound(1, 77)) == 77


@pytest.mark.parametrize(
    ("bindings", "words"),
    [
        ([bound(1), bound(128)], "its station has the system id 128, which belongs to a128.fc"),
        ([bound(3, 3)], "its station has the system id 3, which belongs to itself"),
        ([bound(128), bound(1)], "its station has the system id 1, which belongs to a1.fc"),
        ([bound(1, 200), bound(2, 200)], "system id 200, as has that of a1.fc"),
        ([bound(1), bound(2, 128)], "system id 128, as has that of a1.fc"),
    ],
)
def test_colliding_station_ids_are_refused(bindings, words):
    with pytest.raises(DeviceError, match=words) as refused:
        check_stations(bindings)
    assert "choose another by 'station: ID'" in refused.value.reason
    check_stations([bound(1), bound(2), bound(3, 77)])


def test_open_refuses_colliding_station_ids(bench):
    b = bench(systems=(1, 128))
    with pytest.raises(DeviceError, match="its station has the system id 128"):
        b.run(lambda *devices: asyncio.sleep(0.1))


@on_bench("bench", systems=(1, 2))
async def test_each_vehicle_of_a_link_has_its_own_station(b, one, two, /):
    for fc in (one, two):
        await up(fc)
    reader = Reader()
    sent = {(m.get_srcSystem(), getattr(m, "target_system", 0)) for data in b.sent for m in reader.feed(data)}
    assert sent == {(128, 0), (128, 1), (129, 0), (129, 2)}


@pytest.mark.parametrize(
    ("component", "kind"), [(190, dialect.MAV_TYPE_GCS), (1, dialect.MAV_TYPE_QUADROTOR), (191, 6)]
)
@on_bench("bench")
async def test_foreign_sender_with_the_station_id_blocks_arming(b, fc, /, component, kind):
    packer = PacketWriter(128, component)
    heartbeat = dialect.MAVLink_heartbeat_message(kind, dialect.MAV_AUTOPILOT_INVALID, 0, 0, 4, 3)
    b.links[0].on_data(packer.pack(heartbeat))
    with pytest.raises(DeviceError, match=f"arm refused: system 128, component {component} on its links"):
        await fc.execute("arm", [])
    assert not b.autopilot.armed
    assert len([note for note in b.notes if "has the id of its station" in note]) == 1


@on_bench("bench")
async def test_echo_and_other_stations_do_not_block_arming(b, fc, /):
    for packer, heartbeat in (
        (PacketWriter(128, 191), station_heartbeat(1)),
        (PacketWriter(*QGC), dialect.MAVLink_heartbeat_message(dialect.MAV_TYPE_GCS, 8, 0, 0, 4, 3)),
    ):
        b.links[0].on_data(packer.pack(heartbeat))
    await fc.execute("arm", [])


@on_bench("bench")
async def test_another_station_id_in_the_autopilot_blocks_arming(b, fc, /):
    b.autopilot.parameters.update(MAV_GCS_SYSID=255.0, MAV_GCS_SYSID_HI=255.0)
    with pytest.raises(DeviceError, match="MAV_GCS_SYSID is 255 and must be 128, and 1 more"):
        await fc.execute("arm", [])


def test_fake_accepts_a_range_of_station_ids(bench):
    b = bench()
    failsafes, parameters = b.autopilot.failsafes, b.autopilot.parameters
    for first, last, counting in ((128, 0, {128}), (200, 202, {200, 201, 202}), (200, 100, {200})):
        parameters.update(MAV_GCS_SYSID=first, MAV_GCS_SYSID_HI=last)
        counted = set()
        for system in range(1, 256):
            failsafes.gcs_contact_at = None
            failsafes.heartbeat(system, station=True)
            counted |= {system} if failsafes.gcs_contact_at is not None else set()
        assert counted == counting
