"""The driver against the fake: every instruction and each failure, in virtual time."""

from __future__ import annotations

import asyncio
import math

import pytest
from coroutine_tests import on_bench
from takeoff import up

from lfield.errors import DeviceError
from lfield_mavlink.contact.vehicle_state import SOURCES
from lfield_mavlink.link.dialect import Writer, dialect
from lfield_sim.autopilot.autopilot import Autopilot
from lfield_sim.mavlink.link.codec import PacketWriter as FakeWriter


def refusal(error) -> tuple[str, str]:
    return error.value.kind, error.value.reason


@on_bench("bench")
async def test_complete_flight(b, fc, /):
    assert b.values["armed"] is False
    assert b.values["landed"] is True
    await up(fc, 6.0)
    assert b.values["altitude"] == pytest.approx(6.0, abs=0.6)
    await fc.execute("goTo", [10.0, -4.0, -6.0])
    assert math.dist(b.values["position"], (10.0, -4.0, -6.0)) <= 0.5
    await fc.execute("yaw", [2.0])
    assert b.values["attitude"][2] == pytest.approx(2.0, abs=0.08)
    await fc.execute("land", [])
    await fc.execute("disarm", [])
    assert not b.autopilot.armed
    assert b.autopilot.vehicle.place[2] == 0.0
    assert 0.8 < b.values["battery"] < 1.0
    assert b.values["batteryVoltage"] > 14.0
    assert b.values["mode"] == "LAND"


def test_open_requests_streams_and_reports_the_failsafe(bench):
    b = bench()
    b.run(lambda fc: asyncio.sleep(3.0))
    declared = {quantity.name for quantity in b.driver.manifests["Mavlink"].device.telemetry}
    # ArduCopter reports nothing about a disabled fence, and it has no camera with MAVLink.
    camera = {"pictures", "recording", "storage", "lastPicture"}
    assert declared - {"winchLine", "fenceBreached"} - camera <= set(b.values)
    assert b.values["gcsFailsafe"] is True
    assert b.values["gpsFix"] == 3
    assert b.values["globalPosition"][:2] == pytest.approx([47.397742, 8.545594], abs=1e-6)


@on_bench("bench")
async def test_takeoff_while_disarmed_is_refused(b, fc, /):
    with pytest.raises(DeviceError) as error:
        await fc.execute("takeoff", [5.0])
    kind, reason = refusal(error)
    assert kind == "DeviceException"
    assert reason == "takeoff refused: the motors are off; call arm() first"


def test_long_refusal_reason_is_joined_from_its_chunks(bench):
    reason = "compass not calibrated, and the safety switch is on, and there is no logging"
    b = bench(refuse_arming=reason)

    async def mission(fc):
        with pytest.raises(DeviceError) as error:
            await fc.execute("arm", [])
        return refusal(error)

    assert b.run(mission)[1] == f"arm refused: FAILED (4), Arm: {reason}"


@on_bench("bench")
async def test_takeoff_while_flying_is_refused(b, fc, /):
    await up(fc)
    with pytest.raises(DeviceError) as error:
        await fc.execute("takeoff", [8.0])
    assert refusal(error)[1] == "takeoff refused: FAILED (4)"


@on_bench("bench")
async def test_disarming_in_the_air_is_refused(b, fc, /):
    await up(fc)
    with pytest.raises(DeviceError, match=r"disarm refused: FAILED \(4\)"):
        await fc.execute("disarm", [])
    assert b.autopilot.armed


@pytest.mark.parametrize(
    ("instruction", "arguments", "words"),
    [
        ("takeoff", [30.0], "above the limit of 20 m"),
        ("takeoff", [-1.0], "requires a height above 0"),
        ("takeoff", [math.nan], "finite"),
        ("goTo", [0.0, 0.0, -21.0], "above the limit of 20 m"),
        ("goTo", [40.0, 40.0, -5.0], "beyond the limit of 50 m"),
        ("goTo", [math.inf, 0.0, -5.0], "finite"),
        ("setVelocity", [4.0, 3.0, 0.0], "above the limit of 3 m/s"),
        ("setVelocity", [math.nan, 0.0, 0.0], "above the limit"),
        ("yaw", [math.nan], "finite"),
    ],
)
@on_bench("bench", limits={"altitude": 20.0, "radius": 50.0, "speed": 3.0})
async def test_argument_beyond_a_limit_is_refused_before_sending(b, fc, /, instruction, arguments, words):
    sent = len(b.sent)
    with pytest.raises(DeviceError, match=words):
        await fc.execute(instruction, arguments)
    assert len(b.sent) == sent


@on_bench("bench", limits={"speed": 2.0})
async def test_speed_limit_is_set_in_the_autopilot(b, fc, /):
    fastest = 0.0

    await up(fc)
    flight = asyncio.create_task(fc.execute("goTo", [20.0, 0.0, -5.0]))
    while not flight.done():
        await asyncio.sleep(0.1)
        fastest = max(fastest, b.values["velocity"][0])
    assert 1.8 < fastest <= 2.05


@pytest.mark.few(1)
@pytest.mark.parametrize("seed", range(8))
def test_flight_with_packet_loss_completes(bench, seed):
    # The system id seeds the losses.
    b = bench(faults=("loss=0.1",), systems=(seed + 1,))

    async def mission(fc):
        await up(fc)
        await fc.execute("goTo", [5.0, 0.0, -5.0])
        await fc.execute("land", [])

    b.run(mission)
    assert not b.autopilot.vehicle.airborne


@on_bench("bench")
async def test_link_loss_raises_within_three_seconds_and_recovers(b, fc, /):
    loop = asyncio.get_running_loop()
    await up(fc)
    flight = asyncio.create_task(fc.execute("goTo", [200.0, 0.0, -5.0]))
    await asyncio.sleep(2.0)
    b.cut, start = True, loop.time()
    with pytest.raises(DeviceError, match="the link is lost") as error:
        await flight
    assert error.value.kind == "DeviceTimeoutException"
    assert loop.time() - start <= 3.0
    await asyncio.sleep(1.0)
    b.cut = False
    await asyncio.sleep(3.0)
    with pytest.raises(DeviceError, match="the vehicle is in LAND, which this program did not select"):
        await fc.execute("goTo", [b.values["position"][0], 0.0, -5.0])
    await fc.execute("release", [])
    await fc.execute("goTo", [b.values["position"][0], 0.0, -5.0])
    assert "mavlink-link-back" in [note.code for note in b.notes]


@on_bench("bench", options={"connect": 2.0}, faults=("silence=true",), opened=False)
async def test_open_without_vehicle_times_out(b, fc, /):
    start = asyncio.get_running_loop().time()
    with pytest.raises(DeviceError, match=r"from system 1 at udp:127.0.0.1:1 within 2 s; nothing on link 0"):
        await fc.open()
    assert asyncio.get_running_loop().time() - start < 2.1


def test_open_names_the_systems_that_send_instead(bench):
    b = bench(systems=(1,), options={"connect": 2.0})
    b.bindings[0].options["system"] = 2
    camera = FakeWriter(1, 100)

    async def mission(fc):
        b.links[0].on_data(camera.pack(dialect.MAVLink_heartbeat_message(30, 8, 0, 0, 4, 3)))
        with pytest.raises(DeviceError) as error:
            await fc.open()
        return refusal(error)

    kind, reason = b.run(mission, opened=False)
    assert kind == "DeviceTimeoutException"
    assert reason.startswith("no heartbeat from system 2 at ")
    assert (
        "; received: system 1, component 1 (quadrotor, ArduPilot); system 1, component 100 (camera" in reason
    )


@on_bench("bench", options={"connect": 1.0}, faults=("silence=true",), opened=False)
async def test_open_reports_bytes_that_are_no_mavlink(b, fc, /):
    b.links[0].on_data(b"login: ")
    with pytest.raises(DeviceError, match=r"the 7 received bytes contain no heartbeat.*baud rate"):
        await fc.open()


@on_bench("bench", options={"kind": "rover"}, opened=False)
async def test_vehicle_of_another_kind_is_refused(b, fc, /):
    with pytest.raises(DeviceError, match="is not a rover"):
        await fc.open()


@on_bench("bench", options={"autopilot": "px4"}, opened=False)
async def test_vehicle_with_another_autopilot_is_refused(b, fc, /):
    with pytest.raises(DeviceError, match="system 1 has ArduPilot, but the binding has px4"):
        await fc.open()


@on_bench("bench")
async def test_failsafe_ends_the_flight_and_keeps_control_until_release(b, fc, /):
    await up(fc)
    flight = asyncio.create_task(fc.execute("goTo", [100.0, 0.0, -5.0]))
    await asyncio.sleep(2.0)
    assert await fc.execute("foreignControl", []) == ""
    b.autopilot.go_home()
    with pytest.raises(DeviceError, match="goTo ended early: the vehicle went to RTL"):
        await flight
    with pytest.raises(
        DeviceError, match=r"a pilot or a failsafe controls the vehicle. release\(\) takes control again"
    ):
        await fc.execute("goTo", [0.0, 0.0, -5.0])
    await fc.make_safe()
    assert b.autopilot.mode == "RTL"
    assert "a pilot or a failsafe controls the vehicle" in await fc.execute("foreignControl", [])
    await fc.execute("release", [])
    assert await fc.execute("foreignControl", []) == ""
    await fc.execute("goTo", [0.0, 0.0, -5.0])
    await fc.make_safe()
    assert await fc.execute("foreignControl", []) == "", "its own safe state"


def test_accepted_command_without_effect_is_an_error(bench, monkeypatch):
    b = bench()
    monkeypatch.setattr(Autopilot, "arm", lambda self, force=False: 0)

    async def mission(fc):
        with pytest.raises(DeviceError, match="arm was accepted but did not happen within 5 s"):
            await fc.execute("arm", [])

    b.run(mission)


@on_bench("bench")
async def test_motion_without_progress_is_given_up(b, fc, /):
    await up(fc)
    b.autopilot.speed_control.own_speed = lambda: 0.0
    with pytest.raises(DeviceError, match="goTo failed: no progress for 10 s, 30"):
        await fc.execute("goTo", [30.0, 0.0, -5.0])
    # It does not start later when the obstruction is gone.
    place = b.autopilot.vehicle.place
    b.autopilot.speed_control.own_speed = lambda: 5.0
    await asyncio.sleep(3.0)
    assert b.autopilot.vehicle.place == pytest.approx(place, abs=0.2)


@pytest.mark.few(1)
@pytest.mark.parametrize("state", ["land", "hold", "return"])
@on_bench("bench", given="safe_state=state")
async def test_each_safe_state_in_the_air(b, fc, /, state):
    await up(fc)
    await fc.execute("setVelocity", [3.0, 0.0, 0.0])
    await asyncio.sleep(0.5)
    await fc.make_safe()
    assert b.autopilot.mode == {"land": "LAND", "hold": "BRAKE", "return": "RTL"}[state]
    await asyncio.sleep(60.0)
    assert b.autopilot.vehicle.airborne == (state == "hold")


@on_bench("bench")
async def test_safe_state_of_an_armed_copter_on_the_ground_disarms_it(b, fc, /):
    await fc.execute("arm", [])
    await fc.make_safe()
    assert not b.autopilot.armed


@pytest.mark.few(0)
@on_bench("bench")
async def test_positions_are_relative_to_the_current_home(b, fc, /):
    await up(fc)
    await fc.execute("goTo", [8.0, 3.0, -5.0])
    await fc.execute("land", [])
    await fc.execute("disarm", [])
    await up(fc)
    await asyncio.sleep(3.0)
    assert math.dist(b.values["position"], (0.0, 0.0, -5.0)) < 0.7
    await fc.execute("goTo", [2.0, 0.0, -5.0])
    north, east, _ = b.autopilot.vehicle.place
    assert math.dist((north, east), (10.0, 3.0)) < 1.2


@on_bench("bench", kind="rover")
async def test_rover_drives_holds_and_refuses_takeoff(b, fc, /):
    await fc.execute("arm", [])
    await fc.execute("goTo", [6.0, 6.0, 0.0])
    with pytest.raises(DeviceError, match="takeoff refused: a rover does not fly"):
        await fc.execute("takeoff", [3.0])
    await fc.execute("hold", [])
    assert math.dist(b.autopilot.vehicle.place[:2], (6.0, 6.0)) < 1.0
    assert b.autopilot.mode == "HOLD"


@on_bench("bench", limits={"radius": 50.0, "altitude": 20.0})
async def test_global_goals_are_checked_against_the_limits(b, fc, /):
    await up(fc)
    latitude, longitude, _ = b.values["globalPosition"]
    await fc.execute("goToGlobal", [latitude, longitude + 1e-4, 6.0])
    assert b.values["position"] == pytest.approx([0.0, 7.53, -6.0], abs=0.6)
    for goal, text in (
        ([latitude + 1e-3, longitude, 6.0], "beyond the limit of 50 m"),
        ([latitude, longitude, 21.0], "above the limit of 20 m"),
        ([math.nan, longitude, 6.0], "requires a latitude"),
        ([latitude, 181.0, 6.0], "requires a latitude"),
        ([latitude, longitude, math.nan], "finite"),
    ):
        with pytest.raises(DeviceError, match=text):
            await fc.execute("goToGlobal", goal)


@pytest.mark.few(0)
@on_bench("bench")
async def test_return_home_lands_at_home(b, fc, /):
    await up(fc)
    await fc.execute("goTo", [20.0, 0.0, -5.0])
    await fc.execute("returnHome", [])
    assert b.values["landed"]
    assert math.hypot(*b.autopilot.vehicle.place[:2]) < 1.0


@on_bench("bench", limits={"radius": 30.0, "speed": 4.0})
async def test_orbit_completes_a_circle_and_holds(b, fc, /):
    quarters = set()

    await up(fc)
    flight = asyncio.create_task(fc.execute("orbit", [5.0, 0.0, -6.0, 8.0, 3.0, -1.0]))
    courses = []
    while not flight.done():
        await asyncio.sleep(0.2)
        north, east, _ = b.values["position"]
        quarters.add((north > 5.0, east > 0.0))
        courses.append(math.hypot(north - 5.0, east))
    await flight
    assert b.values["mode"] == "BRAKE"
    assert max(courses) < 10.5
    for arguments, text in (
        ([28.0, 0.0, -6.0, 8.0, 3.0, 1.0], "beyond the limit of 30 m"),
        ([0.0, 0.0, -6.0, 8.0, 5.0, 1.0], "above the limit of 4 m/s"),
        ([0.0, 0.0, -6.0, 0.0, 3.0, 1.0], "requires a radius"),
        ([0.0, 0.0, -6.0, 8.0, 3.0, 0.0], "turns other than 0"),
    ):
        with pytest.raises(DeviceError, match=text):
            await fc.execute("orbit", arguments)
    assert len(quarters) == 4


@on_bench("bench", limits={"speed": 4.0})
async def test_set_speed_persists_over_mode_changes(b, fc, /):
    await up(fc)
    await fc.execute("setSpeed", [1.5])
    await fc.execute("hold", [])
    flight = asyncio.create_task(fc.execute("goTo", [10.0, 0.0, -5.0]))
    fastest = 0.0
    while not flight.done():
        await asyncio.sleep(0.1)
        fastest = max(fastest, b.values["groundSpeed"])
    assert 1.3 < fastest <= 1.55
    for speed in (4.5, 0.0, math.nan):
        with pytest.raises(DeviceError, match="setSpeed"):
            await fc.execute("setSpeed", [speed])


@on_bench("bench")
async def test_yaw_rate_turns_in_place(b, fc, /):
    await up(fc)
    before = b.values["heading"]
    for _ in range(5):
        await fc.execute("setYawRate", [0.5])
        await asyncio.sleep(0.2)
    assert b.values["heading"] - before == pytest.approx(0.5, abs=0.2)
    assert b.values["groundSpeed"] < 0.1


@on_bench("bench")
async def test_mode_is_set_by_name_and_unknown_mode_refused(b, fc, /):
    await fc.execute("setMode", ["alt_hold"])
    assert b.values["mode"] == "ALT_HOLD"
    with pytest.raises(DeviceError, match="ArduPilot has no mode 'HOVER'; it has ACRO, ALT_HOLD"):
        await fc.execute("setMode", ["HOVER"])


@on_bench("bench", limits={"radius": 12.0, "altitude": 6.0, "speed": 5.0})
async def test_velocity_that_leads_beyond_the_limits_is_refused(b, fc, /):
    await up(fc)
    await fc.execute("goTo", [11.0, 0.0, -5.0])
    with pytest.raises(DeviceError, match="leads beyond the limit of 12 m"):
        await fc.execute("setVelocity", [4.0, 0.0, 0.0])
    with pytest.raises(DeviceError, match="leads above the limit of 6 m"):
        await fc.execute("setVelocity", [0.0, 0.0, -4.0])
    await fc.execute("setVelocity", [-2.0, 0.0, 0.0])


@on_bench("bench")
async def test_velocity_setpoint_is_sent_once_to_ardupilot(b, fc, /):
    await up(fc)
    before = len(b.sent)
    await fc.execute("setVelocity", [1.0, 0.0, 0.0])
    await asyncio.sleep(3.0)
    assert sum(data[7] == 84 for data in b.sent[before:]) == 1


@on_bench("bench")
async def test_cancelled_call_does_not_block_the_next_call(b, fc, /):
    await fc.execute("arm", [])
    for delay in (0.0, 0.01, 0.03, 0.1, 0.4):
        climb = asyncio.create_task(fc.execute("takeoff", [5.0]))
        await asyncio.sleep(delay)
        climb.cancel()
        with pytest.raises(asyncio.CancelledError):
            await climb
    await fc.execute("goTo", [5.0, 0.0, -5.0])
    assert fc._expected == {}
    assert fc.exchange._pending == {}


@on_bench("bench")
async def test_stopped_streams_are_requested_again(b, fc, /):
    # Another ground station has stopped them.
    for kind in SOURCES:
        stop = dialect.MAVLink_command_long_message(1, 1, 511, 0, kind, -1, 0, 0, 0, 0, 0)
        b.fakes[1].receive("another", Writer().pack(stop, 255))
    b.values.clear()
    await asyncio.sleep(6.0)
    assert {"position", "attitude", "battery"} <= set(b.values)


def test_autopilot_without_message_intervals_gets_stream_requests(bench, monkeypatch):
    monkeypatch.setattr("lfield_mavlink.link.dialect.dialect.MAV_CMD_SET_MESSAGE_INTERVAL", 31011)
    b = bench()
    b.run(lambda fc: asyncio.sleep(2.0))
    assert {"position", "globalPosition", "attitude", "groundSpeed", "battery"} <= set(b.values)


FENCED = {"FENCE_ENABLE": 1, "FENCE_TYPE": 3, "FENCE_RADIUS": 80.0, "FENCE_ALT_MAX": 30.0}


@pytest.mark.few(1)
@pytest.mark.parametrize(
    ("options", "parameters", "expected"),
    [
        ({}, {}, ("multirotor", 10.0, 1.0e6, 1.0e6)),
        ({}, FENCED, ("multirotor", 10.0, 80.0, 30.0)),
        ({"limits": {"speed": 4.0}}, {}, ("multirotor", 4.0, 1.0e6, 1.0e6)),
    ],
)
def test_chassis_speed_limit_and_fence_are_published(bench, options, parameters, expected):
    b = bench(**options)

    async def mission(fc):
        for name, value in parameters.items():
            await fc.execute("setParameter", [name, float(value)])
        await asyncio.sleep(40.0)

    b.run(mission)
    names = ("chassis", "speedLimit", "fenceRadius", "fenceHeight")
    assert tuple(b.values[name] for name in names) == expected
