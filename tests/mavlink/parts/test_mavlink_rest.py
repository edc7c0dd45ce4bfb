"""Remaining motion of a vehicle in its safe state: on the fakes, and for given states."""

from __future__ import annotations

import asyncio
import math
import re

import pytest
from coroutine_tests import on_bench
from takeoff import up

from lfield.errors import DeviceError
from lfield_mavlink.modes import ARDUPILOT, PROFILES, PX4
from lfield_mavlink.parts.motion_control import Motion
from lfield_mavlink.parts.standstill import StandstillCheck

SINKS = re.compile(r"\d+\.\d m up, sinking at \d\.\d m/s")


async def watched(fc, seconds=120.0):
    """Every description until it is at rest, with numbers as #, and the time that took."""
    words, start = [], asyncio.get_running_loop().time()
    while text := fc.moving():
        now = asyncio.get_running_loop().time()
        assert now - start < seconds, text
        text = re.sub(r"\d+(\.\d+)?", "#", text)
        if words[-1:] != [text]:
            words.append(text)
        await asyncio.sleep(0.2)
    return words, asyncio.get_running_loop().time() - start


@pytest.mark.parametrize("flavour", ["ardupilot", "px4"])
@on_bench("bench", waivers=("device_watchdog",), given="flavour")
async def test_landing_copter_is_at_rest_with_motors_off(b, fc, /, flavour):
    assert fc.moving() == ""
    await up(fc)
    await fc.make_safe()
    await asyncio.sleep(2.0)
    assert SINKS.fullmatch(fc.moving()), fc.moving()
    words, _ = await watched(fc)
    assert words[-1] == "on the ground, motors on"
    assert not b.autopilot.armed


@pytest.mark.few(0)
@pytest.mark.parametrize("flavour", ["ardupilot", "px4"])
@on_bench("bench", safe_state="return", given="flavour")
async def test_returning_copter_is_described_until_rest(b, fc, /, flavour):
    await up(fc)
    await fc.execute("goTo", [30.0, 0.0, -5.0])
    await fc.make_safe()
    words, _ = await watched(fc)
    assert any("moving at # m/s, # m from home" in text for text in words)
    assert any("sinking" in text for text in words)
    assert not b.autopilot.armed


@pytest.mark.parametrize("flavour", ["ardupilot", "px4"])
@on_bench("bench", safe_state="hold", given="flavour")
async def test_copter_with_safe_state_hold_is_at_rest_in_a_hover(b, fc, /, flavour):
    await up(fc)
    for _ in range(8):
        await fc.execute("setVelocity", [3.0, 0.0, 0.0])
        await asyncio.sleep(0.2)
    await fc.make_safe()
    words, _ = await watched(fc, 10.0)
    assert words[0] == "# m up, moving at # m/s"
    assert b.autopilot.vehicle.airborne
    assert b.autopilot.armed


@on_bench("bench")
async def test_silent_flying_vehicle_is_not_at_rest(b, fc, /):
    await up(fc)
    await fc.make_safe()
    await asyncio.sleep(1.0)
    b.cut = True
    await asyncio.sleep(4.0)
    assert re.fullmatch(r"no message for [34]\.\d s, last seen 4\.\d m up, .*", fc.moving()), fc.moving()
    b.cut = False
    await watched(fc)


@on_bench("bench")
async def test_silent_disarmed_vehicle_is_not_at_rest(b, fc, /):
    await fc.make_safe()
    b.cut = True
    await asyncio.sleep(4.0)
    assert re.fullmatch(r"no message for \d\.\d s, last seen with its motors off", fc.moving())


@on_bench("bench")
async def test_pilot_takeover_during_landing_is_kept_until_disarmed(b, fc, /):
    await up(fc)
    await fc.make_safe()
    await asyncio.sleep(2.0)
    b.autopilot.command_mode("STABILIZE")
    await asyncio.sleep(2.0)
    assert re.match(r"flown by a pilot in STABILIZE, \d\.\d m up", fc.moving()), fc.moving()
    for _ in range(3):
        await fc.make_safe()
    assert b.autopilot.mode == "STABILIZE"
    assert sum("not commanded: the vehicle is in" in note for note in b.notes) == 1
    b.cut = True
    await asyncio.sleep(5.0)
    assert "no message for" in fc.moving()
    b.cut = False
    b.autopilot.disarm(force=True)
    await asyncio.sleep(2.0)
    assert fc.moving() == ""


@pytest.mark.parametrize("role", ["go_home", "brake"])
@on_bench("bench")
async def test_failsafe_mode_in_the_safe_state_is_watched_until_rest(b, fc, /, role):
    """No pilot controls it: without heartbeats of the driver another failsafe would follow."""
    await up(fc)
    await fc.make_safe()
    await asyncio.sleep(2.0)
    b.autopilot.go_home() if role == "go_home" else b.autopilot.command_mode("BRAKE")
    await asyncio.sleep(2.0)
    mode = "RTL" if role == "go_home" else "BRAKE"
    assert fc.moving().endswith(f", in {mode}"), fc.moving()
    if role == "go_home":
        await watched(fc)
        assert not b.autopilot.armed


@on_bench("bench")
async def test_failsafe_from_before_the_stop_is_watched_until_rest(b, fc, /):
    await up(fc)
    b.autopilot.go_home()
    await asyncio.sleep(1.5)
    await fc.make_safe()
    assert any("not commanded: the vehicle is in" in note for note in b.notes)
    assert "in RTL" in fc.moving()
    await watched(fc)


@on_bench("bench", safe_state="hold")
async def test_vehicle_taken_out_of_its_safe_state_is_not_at_rest(b, fc, /):
    await up(fc)
    await fc.make_safe()
    await watched(fc)
    b.autopilot.command_mode("GUIDED")
    await asyncio.sleep(2.0)
    assert re.fullmatch(r"\d\.\d m up, in GUIDED", fc.moving()), fc.moving()


@on_bench("bench", kind="rover", safe_state="hold")
async def test_rover_is_at_rest_when_it_stands(b, fc, /):
    await fc.execute("arm", [])
    for _ in range(8):
        await fc.execute("setVelocity", [2.0, 0.0, 0.0])
        await asyncio.sleep(0.2)
    await fc.make_safe()
    words, seconds = await watched(fc, 10.0)
    assert words == ["motors on, moving at # m/s"]
    assert seconds > 0.0
    assert b.autopilot.armed


@on_bench("bench", kind="rover", safe_state="return")
async def test_returning_rover_is_at_rest_only_at_home(b, fc, /):
    await fc.execute("arm", [])
    await fc.execute("goTo", [15.0, 0.0, 0.0])
    await fc.make_safe()
    assert fc.moving(), "it has just started to drive"
    await watched(fc)
    assert math.hypot(*b.autopilot.vehicle.place[:2]) < 6.0


# -- descriptions of states that the fakes do not have --------------------------------------------------


class Known:
    """The known state of a vehicle, as StandstillCheck and Motion read it."""

    def __init__(self, stack, kind, mode, safe_state="land", **known):
        self.profile, self.kind = PROFILES[stack, kind], kind
        self.silence = 0.1
        self.state = self.binding = self.clock = self
        self.safe_state, self.mode = safe_state, mode
        self.armed, self.heartbeat_at, self.landed, self.type = True, 0.0, False, 2
        self.armed_at = 0.0
        self.position, self.height, self.speeds, self.speeds_at = None, None, None, 0.0
        self.now = 0.0
        for name, value in known.items():
            setattr(self, name, value)

    def monotonic(self):
        return self.now

    def option(self, name):
        return 0.5

    def send(self, message):
        pass

    def on(self, message_id, handler):
        pass

    def moving(self, ours=True):
        motion = Motion(self, None)
        if ours:
            motion.claim(self.mode)
        return StandstillCheck(self, motion).description()


@pytest.mark.parametrize(
    ("known", "words"),
    [
        # An unknown state is not rest, unless the motors are off.
        (Known(ARDUPILOT, "copter", "LAND", landed=None), "motors on, at an unknown speed"),
        (Known(ARDUPILOT, "copter", "LAND", landed=None, armed=False), ""),
        (Known(ARDUPILOT, "copter", "LAND"), "in the air, at an unknown speed"),
        (
            Known(ARDUPILOT, "copter", "LAND", landed=None, height=0.02, speeds=(0.0, 0.0)),
            "0.0 m up",
        ),
        (
            Known(PX4, "copter", "AUTO.LAND", height=-1.2, speeds=(0.1, -0.65)),
            "0.0 m up, sinking at 0.7 m/s",
        ),
        (
            Known(ARDUPILOT, "copter", "BRAKE", "hold", height=8.0, speeds=(0.0, 0.0), now=3.5),
            "8.0 m up, at an unknown speed",
        ),
        (Known(ARDUPILOT, "copter", "BRAKE", "hold", height=8.0, speeds=(0.3, 0.1)), ""),
        (Known(ARDUPILOT, "copter", "BRAKE", "hold", landed=True, speeds=(0, 0)), "on the ground, motors on"),
        (Known(PX4, "copter", "TERMINATION", height=3.0, speeds=(0, -5.0)),
         "3.0 m up, sinking at 5.0 m/s, in TERMINATION"),
        # A fixed wing is at rest when it circles at its target.
        (
            Known(ARDUPILOT, "plane", "RTL", "return", type=1, height=80.0, speeds=(18.0, 0.2),
                  position=(400.0, 300.0, -80.0)),
            "80.0 m up, climbing at 0.2 m/s, moving at 18.0 m/s, 500 m from home",
        ),
        (
            Known(ARDUPILOT, "plane", "RTL", "return", type=1, height=80.0, speeds=(18.0, 0.0),
                  position=(40.0, 30.0, -80.0)),
            "",
        ),
        # A VTOL descends at home, and so does a plane of PX4.
        (
            Known(ARDUPILOT, "plane", "RTL", "return", type=22, height=80.0, speeds=(18.0, 0.0),
                  position=(40.0, 30.0, -80.0)),
            "80.0 m up, moving at 18.0 m/s, 50 m from home",
        ),
        (
            Known(PX4, "plane", "AUTO.RTL", "return", type=1, height=80.0, speeds=(18.0, 0.0),
                  position=(40.0, 30.0, -80.0)),
            "80.0 m up, moving at 18.0 m/s, 50 m from home",
        ),
        (Known(ARDUPILOT, "plane", "LOITER", "hold", type=1, height=80.0, speeds=(18.0, 0.0)), ""),
        # Ground and water.
        (Known(ARDUPILOT, "rover", "HOLD", landed=True, type=10, speeds=(0.7, 0.0)),
         "motors on, moving at 0.7 m/s"),
        (Known(ARDUPILOT, "rover", "HOLD", landed=True, type=11, speeds=(0.7, 0.0)), ""),
        (Known(ARDUPILOT, "rover", "HOLD", landed=True, type=10), "motors on, at an unknown speed"),
        (Known(ARDUPILOT, "submarine", "SURFACE", landed=True, height=-4.2, speeds=(0.0, 0.3)),
         "4.2 m deep, climbing at 0.3 m/s"),
        (Known(ARDUPILOT, "submarine", "SURFACE", landed=True, height=-0.2, speeds=(0.1, 0.0)), ""),
        (Known(ARDUPILOT, "submarine", "POSHOLD", "hold", landed=True, height=-4.2, speeds=(0.1, 0.0)), ""),
    ],
)  # fmt: skip
def test_description_of_the_remaining_motion(known, words):
    assert known.moving() == words


def test_vehicle_without_any_message_is_described():
    known = Known(ARDUPILOT, "copter", "", heartbeat_at=None, silence=math.inf, armed=False)
    assert known.moving() == "no message yet"


@pytest.mark.parametrize("mode", ["LOITER", "STABILIZE", "AUTO", "mode 77"])
def test_mode_of_a_pilot_is_described(mode):
    known = Known(ARDUPILOT, "copter", mode, height=9.0, speeds=(0.0, 0.0))
    assert known.moving(ours=False) == f"flown by a pilot in {mode}, 9.0 m up"
    known.armed = False
    assert known.moving(ours=False) == ""


def test_rover_steered_by_a_pilot_is_described():
    known = Known(ARDUPILOT, "rover", "MANUAL", landed=True, type=10, speeds=(1.5, 0.0))
    assert known.moving(ours=False) == "steered by a pilot in MANUAL, motors on, moving at 1.5 m/s"


# -- control of a landing -------------------------------------------------------------------------------


@pytest.mark.parametrize("order", [("goTo", [20.0, 0.0, -5.0]), ("setVelocity", [1.0, 0.0, 0.0])])
@on_bench("bench", flavour="px4", safe_state="hold")
async def test_refused_order_during_a_px4_landing_keeps_control(b, fc, /, order):
    """Otherwise the next safe state would be left to a pilot, although there is none."""
    await up(fc)
    landing = asyncio.create_task(fc.execute("land", []))
    await asyncio.sleep(2.0)
    landing.cancel()
    stream = b.driver.devices["a1.fc"].motion.stream
    stream.start = stream.follow = lambda *_: None
    with pytest.raises(DeviceError):
        await fc.execute(*order)
    assert b.autopilot.mode == "AUTO.LAND"
    await fc.make_safe()
    assert b.autopilot.mode == "AUTO.LOITER"
    assert not any("not commanded: the vehicle is in" in note for note in b.notes)
