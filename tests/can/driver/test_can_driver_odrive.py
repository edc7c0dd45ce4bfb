"""ODrive axes through the driver, in virtual time, with a minimal axis; the fake is more exact."""

from __future__ import annotations

import asyncio
import math
import struct

import pytest
from coroutine_tests import on_bench
from hypothesis import given
from hypothesis import strategies as st

from lfield.errors import DeviceError
from lfield_can.bus.frames import Frame

OPTIONS = {"protocol": "odrive", "node": 3}
WAIVED = ["device_watchdog", "no_homing"]
STEP = 0.01


class Axis:
    """Position, velocity and torque control without inertia."""

    def __init__(self, bus) -> None:
        self.bus, self.state, self.errors = bus, 1, 0
        bus.device = self.on_frame
        self.mode = (0, 0)
        self.position = self.velocity = self.torque = self.goal = self.rate = 0.0
        self.speed = 1.0
        self.stuck = self.silent = self.refuses = False
        self.commands: list[int] = []
        self.homing: asyncio.TimerHandle | None = None

    def say(self, command: int, layout: str, *values) -> None:
        if not self.silent:
            self.bus.say(3 << 5 | command, struct.pack(layout, *values))

    def on_frame(self, frame: Frame) -> None:
        command = frame.id & 0x1F
        self.commands.append(command)
        if command == 0x07 and not self.refuses:
            self.state = struct.unpack("<I", frame.data)[0]
            if self.homing is not None:
                self.homing.cancel()
            if self.state == 11:
                self.homing = asyncio.get_running_loop().call_later(1.0, self.homed)
        elif command == 0x0B:
            self.mode = struct.unpack("<II", frame.data)
        elif command == 0x0C:
            self.goal = struct.unpack("<fhh", frame.data)[0]
        elif command == 0x0D:
            self.rate = struct.unpack("<ff", frame.data)[0]
        elif command == 0x0E:
            self.torque = struct.unpack("<f", frame.data)[0]
        elif command == 0x11:
            self.speed = struct.unpack("<f", frame.data)[0]
        elif command == 0x18:
            self.errors = 0

    def homed(self) -> None:
        self.state, self.position = 1, 0.0

    async def live(self) -> None:
        tick = 0
        while True:
            await asyncio.sleep(STEP)
            self.velocity = self.wanted() if self.state == 8 and not self.stuck else 0.0
            self.position += self.velocity * STEP
            self.say(0x09, "<ff", self.position, self.velocity)
            if tick % 10 == 0:
                self.say(0x01, "<IBBBB", self.errors, self.state, 0, 0, 0)
                self.say(0x17, "<ff", 24.0, 1.0)
                self.say(0x15, "<ff", 35.0, 40.0)
            tick += 1

    def wanted(self) -> float:
        if self.mode[0] == 2:
            return self.rate
        if self.mode[0] == 3:
            return max(-self.speed, min(self.speed, (self.goal - self.position) / STEP))
        return 0.0


@pytest.fixture
def rig(bench, binding, bus):
    def make(**given):
        given = {"waivers": WAIVED, "limits": {"speed": 20.0}, **given}
        axis = Axis(bus)
        bound = binding("CanAxis", **{**given, "options": {**OPTIONS, **given.get("options", {})}})
        b = bench(bound, bus=bus, fakes=[axis.live])
        b.axis = axis
        return b

    return make


@on_bench("rig", options={"gear": 10.0, "reversed": True})
async def test_odrive_is_identified_enabled_and_moved_through_its_gear(b, axis, /):
    await axis.execute("enable", [])
    assert b.axis.mode == (2, 1)
    await axis.execute("moveTo", [math.pi, 2.0])
    assert b.axis.position == pytest.approx(
        -5.0, abs=0.02
    )  # half a turn, against the motor's direction, through 10:1
    assert b.values["position"] == pytest.approx(math.pi, abs=0.01)
    assert b.axis.speed == pytest.approx(2.0 / math.tau * 10)
    await axis.execute("disable", [])
    assert b.values["state"] == "idle"
    assert (b.values["voltage"], b.values["temperature"]) == (24.0, 35.0)


@on_bench("rig", waivers=["no_homing"], opened=False)
async def test_odrive_without_the_watchdog_waiver_is_refused(b, axis, /):
    with pytest.raises(DeviceError, match=r"no watchdog in the device.*waivers: \[device_watchdog\]"):
        await axis.open()


@on_bench(
    "rig", limits={"speed": 5.0, "torque": 2.0, "current": 10.0}, options={"lowest": -1.0, "highest": 4.0}
)
async def test_odrive_limits_are_checked_before_a_frame_is_sent(b, axis, /):
    await axis.execute("enable", [])
    sent = len(b.bus.sent)
    for call, text in (
        (("moveTo", [5.0, 1.0]), "outside -1 to 4 rad"),
        (("moveTo", [math.nan, 1.0]), "finite"),
        (("moveTo", [1.0, 6.0]), "6 rad/s is above the limit of 5 rad/s"),
        (("moveTo", [1.0, -1.0]), "speed above 0"),
        (("setPosition", [-1.5]), "outside -1 to 4 rad"),
        (("setVelocity", [-5.1]), "above the limit of 5 rad/s"),
        (("setVelocity", [math.inf]), "finite"),
        (("setTorque", [2.1]), "above the limit of 2 N m"),
    ):
        with pytest.raises(DeviceError, match=text):
            await axis.execute(*call)
    assert len(b.bus.sent) == sent
    b.axis.position = 5.0 / math.tau
    await asyncio.sleep(0.1)
    with pytest.raises(DeviceError, match="farther out of its bounds"):
        await axis.execute("setVelocity", [1.0])
    await axis.execute("setVelocity", [-1.0])
    limits = [frame.data for frame in b.bus.sent if frame.id & 0x1F == 0x0F]
    assert struct.unpack("<ff", limits[0]) == pytest.approx((5.0 / math.tau, 10.0))


@on_bench("rig", options={"lowest": -1.0, "highest": 2.0})
async def test_velocity_that_leaves_the_bounds_is_stopped(b, axis, /):
    await axis.execute("enable", [])
    await axis.execute("setVelocity", [2.0])
    await asyncio.sleep(3.0)
    assert b.values["position"] < 2.5
    assert b.axis.rate == 0.0
    await axis.execute("setVelocity", [-2.0])
    await asyncio.sleep(0.5)
    assert b.values["position"] < 2.0
    assert b.notes.count("stopped: the axis moved out of its bounds") == 1


@on_bench("rig")
async def test_disabled_axis_refuses_motion(b, axis, /):
    with pytest.raises(DeviceError, match=r"not enabled \(idle\); call enable\(\) first"):
        await axis.execute("setVelocity", [1.0])
    assert 0x0D not in b.axis.commands


@on_bench("rig")
async def test_setpoint_is_sent_once_with_its_value_before_its_mode(b, axis, /):
    await axis.execute("enable", [])
    b.axis.commands.clear()
    await axis.execute("setTorque", [0.5])
    await asyncio.sleep(1.0)
    assert b.axis.commands == [0x0E, 0x0B]
    assert b.axis.torque == pytest.approx(0.5)
    await axis.execute("setVelocity", [math.tau])
    await asyncio.sleep(1.0)
    assert b.axis.commands == [0x0E, 0x0B, 0x0D, 0x0B]
    assert b.values["velocity"] == pytest.approx(math.tau)


@pytest.mark.parametrize("state", ["brake", "torque_hold", "torque_off"])
@on_bench("rig", given="safe_state=state")
async def test_odrive_safe_state_is_confirmed(b, axis, /, state):
    await axis.execute("enable", [])
    await axis.execute("setVelocity", [6.0])
    await asyncio.sleep(0.5)
    await axis.make_safe()
    at = b.axis.position
    await asyncio.sleep(1.0)
    assert abs(b.axis.position - at) < 0.02
    assert (b.axis.state, b.axis.mode[0]) == {
        "brake": (8, 2),
        "torque_hold": (8, 3),
        "torque_off": (1, 2),
    }[state]


@on_bench("rig", safe_state="torque_hold")
async def test_held_axis_moved_by_another_master_is_held_again(b, axis, /):
    await axis.execute("enable", [])
    await axis.make_safe()
    await asyncio.sleep(0.1)
    before = b.axis.position
    b.axis.mode, b.axis.rate = (2, 1), 3.0  # set by another sender on the bus
    await asyncio.sleep(0.5)
    assert "turning" in axis.moving()
    await axis.make_safe()
    assert axis.moving() == ""
    await asyncio.sleep(0.1)
    assert b.axis.mode[0] == 3
    # The position at the stop, not the one before.
    assert b.axis.position - before > 1.0
    assert b.axis.goal == pytest.approx(b.axis.position, abs=0.02)


@on_bench("rig")
async def test_lost_safe_state_command_is_sent_again(b, axis, /):
    await axis.execute("enable", [])
    await axis.execute("setVelocity", [6.0])
    await asyncio.sleep(0.2)
    b.bus.device = lambda frame: None
    asyncio.get_running_loop().call_later(0.5, setattr, b.bus, "device", b.axis.on_frame)
    await axis.make_safe()
    assert b.axis.rate == 0.0


@on_bench("rig")
async def test_odrive_errors_are_described_in_the_fault(b, axis, /):
    await axis.execute("enable", [])
    b.axis.errors, b.axis.state = 1 << 12 | 1 << 29, 1
    await asyncio.sleep(0.3)
    assert b.values["fault"] == "over-current of the motor, unknown error 0x20000000"
    with pytest.raises(DeviceError, match=r"over-current of the motor.*resetFault\(\) clears it"):
        await axis.execute("setVelocity", [1.0])
    await axis.execute("resetFault", [])
    assert b.values["fault"] == ""


@on_bench("rig")
async def test_state_change_without_confirmation_is_an_error(b, axis, /):
    b.axis.refuses = True
    with pytest.raises(DeviceError, match=r"did not enter 'closed loop' within 1 s \(it is idle"):
        await axis.execute("enable", [])


@on_bench("rig", waivers=["device_watchdog"])
async def test_odrive_homing_is_required_before_positioning(b, axis, /):
    await axis.execute("enable", [])
    with pytest.raises(DeviceError, match="has not been homed"):
        await axis.execute("moveTo", [1.0, 1.0])
    await axis.execute("home", [])
    await axis.execute("enable", [])
    await axis.execute("moveTo", [1.0, 1.0])
    assert b.values["referenced"]


@on_bench("rig")
async def test_odrive_halt_stops_in_closed_loop(b, axis, /):
    await axis.execute("enable", [])
    travel = asyncio.ensure_future(axis.execute("moveTo", [20.0, 2.0]))
    await b.until(lambda: b.values["position"] > 1.0)
    travel.cancel()
    await axis.execute("halt", [])
    stood = b.axis.position
    await asyncio.sleep(1.0)
    assert b.axis.position == pytest.approx(stood, abs=0.01)
    assert (b.axis.state, b.values["enabled"]) == (8, True)
    await axis.execute("moveTo", [0.0, 10.0])


@pytest.mark.parametrize("after", [0.0, 0.3], ids=["before_the_first_heartbeat", "under_way"])
@on_bench("rig")
async def test_odrive_halt_ends_homing(b, axis, /, after):
    await axis.execute("enable", [])
    homing = asyncio.ensure_future(axis.execute("home", []))
    await b.until(lambda: b.axis.state == 11)
    await asyncio.sleep(after)
    homing.cancel()
    await axis.execute("halt", [])
    assert b.axis.state == 8
    assert not b.values["referenced"]


@pytest.mark.parametrize("state", ["brake", "torque_hold"])
@on_bench("rig", given="safe_state=state")
async def test_odrive_safe_state_ends_homing(b, axis, /, state):
    await axis.execute("enable", [])
    homing = asyncio.ensure_future(axis.execute("home", []))
    await b.until(lambda: b.values["state"] == "homing")
    homing.cancel()
    await axis.make_safe()
    assert b.axis.state == 8
    await asyncio.sleep(2.0)
    assert (b.axis.state, b.axis.velocity) == (8, 0.0)


@on_bench("rig")
async def test_silent_odrive_fails_the_motion_and_returns_stopped(b, axis, /):
    await axis.execute("enable", [])
    await axis.execute("setVelocity", [1.0])
    b.axis.silent = True
    start = asyncio.get_running_loop().time()
    with pytest.raises(DeviceError, match="no message for") as error:
        await axis.execute("moveTo", [10.0, 1.0])
    assert error.value.kind == "DeviceTimeoutException"
    assert (b.values["online"], b.values["enabled"]) == (False, False), "values at the time of the exception"
    assert asyncio.get_running_loop().time() - start < 3.0
    await asyncio.sleep(5.0)
    assert b.axis.position > 0.5  # it has no watchdog; its binding waives it
    assert b.values["online"] is False
    b.axis.silent = False
    await asyncio.sleep(1.0)
    assert b.axis.rate == 0.0
    assert [note.code for note in b.notes if note.startswith("link ")] == ["can-silent", "can-responding"]


@on_bench("rig")
async def test_full_send_buffer_is_an_exception(b, axis, /):
    await axis.execute("enable", [])
    b.bus.full = True
    with pytest.raises(DeviceError, match="a frame could not be sent: its buffer is full"):
        await axis.execute("setVelocity", [1.0])


@on_bench("rig")
async def test_frames_of_other_ids_and_masters_change_no_value(b, axis, /):
    await axis.execute("enable", [])
    before = dict(b.values)
    b.bus.say(3 << 5 | 0x0C, bytes(8))
    b.bus.say(4 << 5 | 0x01, struct.pack("<IB", 1, 1))
    assert b.values == before
    assert axis.malformed == 0


@on_bench("rig")
async def test_malformed_odrive_frames_are_dropped_and_counted(b, axis, /):
    before = dict(b.values)
    for data in (b"", b"\1", struct.pack("<ff", math.nan, 0.0), struct.pack("<ff", 0.0, math.inf)):
        b.bus.say(3 << 5 | 0x09, data)
    assert axis.malformed == 4
    assert b.values == before


@given(st.lists(st.tuples(st.integers(0, 31), st.binary(max_size=64)), max_size=20))
def test_odrive_axis_survives_any_frames(bench, binding, frames):
    b = bench(binding("CanAxis", options=OPTIONS, waivers=WAIVED))

    async def mission(axis):
        for command, data in frames:
            b.bus.say(3 << 5 | command, data)
        return axis

    b.run(mission, opened=False)


@pytest.mark.parametrize(
    ("given_options", "limits", "words"),
    [({"node": 64}, {}, "node id is 0 to 63"), ({}, {"current": 5.0}, "only together with 'speed'")],
)
def test_invalid_odrive_option_is_refused(rig, given_options, limits, words):
    async def mission(axis):
        raise AssertionError("the device must not be opened")

    with pytest.raises(DeviceError, match=words):
        rig(options=given_options, limits=limits).run(mission)
