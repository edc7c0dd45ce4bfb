"""Parts of a vehicle alone, each with small stand-ins for its dependencies."""

from __future__ import annotations

import asyncio
import math
from types import SimpleNamespace
from typing import Any

import pytest

from lfield.clock import ManualClock
from lfield.driver import DeviceBinding
from lfield.errors import DeviceError
from lfield_mavlink.contact.components import Components
from lfield_mavlink.contact.exchange import CommandResult
from lfield_mavlink.contact.vehicle_state import VehicleState
from lfield_mavlink.limits import Limits
from lfield_mavlink.link.dialect import dialect
from lfield_mavlink.modes import ARDUPILOT, PROFILES, PX4
from lfield_mavlink.parts.fences import Fences, Rally
from lfield_mavlink.parts.maintenance import Maintenance
from lfield_mavlink.parts.motion_control import Motion
from lfield_mavlink.parts.storage import MAX_TEXT, Files, Settings
from lfield_mavlink.payload.camera import Camera
from lfield_mavlink.payload.state_reports import StateReports
from lfield_mavlink.services.plan_items import Item, PlanKind
from lfield_mavlink.setpoints.motion_orders import Circle
from lfield_mavlink.watchdog import Watchdog


def binding(**limits: float) -> DeviceBinding:
    return DeviceBinding(
        agent="a", field="fc", type="Mavlink", driver="mavlink", endpoint="x", safe_state="land",
        ttl=1.0, limits=limits, options={"tolerance": 0.5, "system": 1, "station": 0, "camera": 0},
    )  # fmt: skip


class StandIn:
    """The part of a Contact that parts use; commands are recorded, and accepted unless `refused`."""

    def assume_control(self) -> None:
        """Control is always assumed."""

    def __init__(self, autopilot: int = ARDUPILOT) -> None:
        self.clock, self.system, self.binding = ManualClock(), 1, binding()
        self.state = VehicleState("copter")
        self.profile = PROFILES[autopilot, "copter"]
        self.exchange = self
        self.components = Components(self.clock.monotonic)
        self.refused = False
        self.asked: list[tuple[Any, ...]] = []
        self.values: dict[str, Any] = {}
        self.notes: list[str] = []
        self.handlers: dict[int, Any] = {}

    def on(self, message_id, handler):
        self.handlers[message_id] = handler

    def publish(self, **values):
        self.values |= values

    def note(self, text):
        self.notes.append(text)

    def error(self, reason, *, timeout=False):
        return DeviceError("fc", reason, kind="DeviceTimeoutException" if timeout else "DeviceException")

    def send(self, message): ...

    def check_link(self): ...

    def check_identity(self): ...

    async def command(self, *arguments, once=False):
        """The method of Contact (first a name) and of its Exchange (first a number)."""
        self.asked.append(arguments)
        if self.refused:
            raise self.error(f"{arguments[0]} refused")
        return CommandResult(0, 1)

    async def achieve(self, what, state, *command, mode=""):
        await self.command(what, *command)


class Plans:
    """The plans of a vehicle, as a dictionary."""

    def __init__(self) -> None:
        self.held: dict[PlanKind, list[Item]] = {}

    async def upload(self, kind, items):
        self.held[kind] = list(items)

    async def download(self, kind):
        return self.held.get(kind, [])

    async def clear(self, kind):
        self.held.pop(kind, None)


class Parameters:
    """The parameters of a vehicle, as a dictionary; those in `stuck` keep their values."""

    def __init__(self, **values: float) -> None:
        self.values = values
        self.stuck: frozenset[str] = frozenset()

    async def read(self, name):
        return self.values.get(name)

    async def write(self, name, value):
        if name not in self.stuck:
            self.values[name] = value

    async def read_any(self, names):
        return next(((name, self.values[name]) for name in names if name in self.values), ("", None))

    async def read_all(self):
        return self.values

    def unknown(self, name):
        return DeviceError("fc", f"no answer about {name}")


def refused(work) -> str:
    with pytest.raises(DeviceError) as raised:
        asyncio.run(work)
    return raised.value.reason


def test_rally_points_are_stored_in_the_plans():
    plans = Plans()
    rally = Rally(StandIn(), plans)
    points = [47.4, 8.5, 10.0, 47.5, 8.6, 12.0]
    asyncio.run(rally.do_set_rally_points(points))
    assert len(plans.held[PlanKind.RALLY]) == 2
    assert asyncio.run(rally.do_rally_points()) == pytest.approx(points)
    assert refused(rally.do_set_rally_points([1.0, 2.0])).startswith("setRallyPoints: rally points need")
    asyncio.run(rally.do_clear_rally_points())
    assert asyncio.run(rally.do_rally_points()) == []


def test_fence_types_are_enabled_additionally():
    plans, parameters = Plans(), Parameters(FENCE_TYPE=3.0, FENCE_ENABLE=0.0)
    fences = Fences(StandIn(), plans, parameters)
    asyncio.run(fences.do_set_fence_circle(47.4, 8.5, 100.0))
    asyncio.run(fences.do_exclude_circle(47.4, 8.5, 10.0))
    assert parameters.values == {"FENCE_TYPE": 7, "FENCE_ENABLE": 1}
    assert [line.split()[:2] for line in asyncio.run(fences.do_fence()).splitlines()] == [
        ["inside", "circle"],
        ["outside", "circle"],
    ]
    asyncio.run(fences.do_clear_fence())
    assert (parameters.values["FENCE_ENABLE"], plans.held) == (0, {})


def test_disabled_fence_is_not_breached():
    vehicle = StandIn()
    vehicle.state.autopilot = ARDUPILOT
    Fences(vehicle, Plans(), Parameters())
    vehicle.handlers[dialect.MAVLINK_MSG_ID_FENCE_STATUS](SimpleNamespace(breach_status=1))
    assert vehicle.values == {"fenceBreached": True}
    vehicle.handlers[dialect.MAVLINK_MSG_ID_SYS_STATUS](SimpleNamespace(onboard_control_sensors_enabled=0))
    assert vehicle.values == {"fenceBreached": False}


def test_protected_parameter_cannot_be_set():
    parameters = Parameters(FS_GCS_ENABLE=5.0, WPNAV_SPEED=500.0)
    settings = Settings(StandIn(), parameters, lambda name: name == "FS_GCS_ENABLE")
    assert refused(settings.do_set_parameter("FS_GCS_ENABLE", 0.0)).startswith("setParameter refused")
    asyncio.run(settings.do_set_parameter("WPNAV_SPEED", 250.0))
    assert asyncio.run(settings.do_parameters()) == "FS_GCS_ENABLE 5\nWPNAV_SPEED 250"
    assert refused(settings.do_parameter("NONE")) == "no answer about NONE"


def test_file_that_is_no_text_or_too_long_is_refused():
    class Card:
        async def read(self, path, most):
            assert most == MAX_TEXT
            return b"\xff"

    files = Files(StandIn(), Card())
    assert refused(files.do_read_file("/a")) == "readFile: /a contains 1 bytes that are not text (UTF-8)"
    assert "exceed the limit" in refused(files.do_write_file("/a", "x" * (MAX_TEXT + 1)))


def test_watchdog_reports_present_and_required_settings():
    parameters = Parameters(
        FS_GCS_ENABLE=0.0, FS_GCS_TIMEOUT=5.0, SYSID_MYGCS=1.0, GUID_TIMEOUT=3.0, FS_OPTIONS=1.0
    )
    vehicle = StandIn()
    watchdog = Watchdog(vehicle, parameters)
    assert asyncio.run(watchdog.seconds(2.0)) == 2.0
    settings = asyncio.run(watchdog.settings())
    assert {s.name: (s.present, s.wanted) for s in settings} == {
        "FS_GCS_ENABLE": (0, 5), "FS_GCS_TIMEOUT": (5, 2), "SYSID_MYGCS": (1, 128), "GUID_TIMEOUT": (3, 2),
        "FS_OPTIONS": (1, 9),
    }  # fmt: skip
    assert vehicle.values == {"gcsFailsafe": False}
    parameters.values |= {setting.name: setting.wanted for setting in settings}
    assert all(setting.is_right for setting in asyncio.run(watchdog.settings()))
    assert vehicle.values == {"gcsFailsafe": True}
    del parameters.values["FS_GCS_TIMEOUT"]
    assert refused(watchdog.settings()).startswith("it does not report FS_GCS_TIMEOUT")


def test_camera_trigger_falls_back_to_the_older_command():
    class Old(StandIn):
        async def command(self, *arguments, once=False, optional=False, component=""):
            await super().command(*arguments, once=once)
            return not optional

    vehicle = Old()
    asyncio.run(Camera(vehicle, StateReports(vehicle)).do_trigger_camera())
    numbers = [number for _, number, *_ in vehicle.asked]
    assert numbers == [dialect.MAV_CMD_IMAGE_START_CAPTURE, dialect.MAV_CMD_DO_DIGICAM_CONTROL]


def test_invalid_raw_command_is_refused_before_sending():
    vehicle = StandIn()
    upkeep = Maintenance(vehicle, renew=lambda: asyncio.sleep(0))
    for number, values in ((dialect.MAV_CMD_NAV_LAND, []), (70000, []), (512, [math.nan]), (512, [0.0] * 8)):
        refused(upkeep.do_command(number, values))
    assert vehicle.asked == []
    assert asyncio.run(upkeep.do_command(512, [148.0])) == 0
    assert vehicle.asked == [(512, 148.0)]


def test_refused_mode_change_keeps_control():
    vehicle = StandIn()
    motion = Motion(vehicle, Parameters())
    vehicle.state.armed = True
    asyncio.run(motion.set_mode("BRAKE"))
    vehicle.state.mode, vehicle.refused = "BRAKE", True
    assert (
        refused(motion.enter("startMission", "AUTO", dialect.MAV_CMD_MISSION_START)) == "startMission refused"
    )
    motion.start_motion("land")
    vehicle.state.mode = "LOITER"
    with pytest.raises(
        DeviceError, match="land refused: the vehicle is in LOITER, which this program did not"
    ):
        motion.start_motion("land")


def test_target_speed_is_the_last_set_speed_or_the_limit():
    vehicle = StandIn(PX4)
    motion = Motion(vehicle, Parameters())
    asyncio.run(motion.speed.apply_target())
    assert vehicle.asked == []
    vehicle.binding = binding(speed=5.0)
    assert motion.speed.target == 5.0
    asyncio.run(motion.speed.set(2.0))
    assert vehicle.asked == [], "PX4 would not keep it before a motion"
    asyncio.run(motion.speed.apply_target())
    assert vehicle.asked == [("speed", dialect.MAV_CMD_DO_CHANGE_SPEED, 1.0, 2.0, -1.0)]


def farthest(centre, radius):
    return Circle(centre, radius, 1.0, True).farthest


@pytest.mark.parametrize(
    ("check", "words"),
    [
        (lambda limits: limits.check_goal("goTo", (0.0, math.nan, 0.0)), "goTo requires finite numbers"),
        (lambda limits: limits.check_goal("goTo", (0.0, 0.0, -31.0)), "31 m is above the limit of 30 m"),
        (lambda limits: limits.check_goal("goTo", (60.0, 60.0, 0.0)), "84.9 m from home is beyond the limit"),
        (lambda limits: limits.check_goal("orbit", farthest((60.0, 0.0, -5.0), 30.0)), "90.0 m from home is"),
        (lambda limits: limits.check_goal("orbit", farthest((0.0, 0.0, -5.0), 81.0)), "81.0 m from home is"),
        (lambda limits: limits.check_speed("setSpeed", 5.1), "setSpeed of 5.1 m/s is above the limit of 5"),
        (lambda limits: limits.check_velocity((79.5, 0.0, 0.0), (1.0, 0.0, 0.0)), "beyond the limit of 80 m"),
        (
            lambda limits: limits.check_velocity((0.0, 0.0, -29.5), (0.0, 0.0, -1.0)),
            "above the limit of 30 m",
        ),
        # With a TTL of 1 s and 4 m for braking.
        (lambda limits: limits.check_velocity((72.1, 0.0, 0.0), (4.0, 0.0, 0.0)), "beyond the limit of 80 m"),
        (
            lambda limits: limits.check_return("returnHome", 31.0, "RTL_ALT"),
            r"31 m \(RTL_ALT\), above the limit",
        ),
    ],
)
def test_value_beyond_a_limit_is_refused(check, words):
    limits = Limits(binding(altitude=30.0, radius=80.0, speed=5.0), StandIn().error)
    with pytest.raises(DeviceError, match=words):
        check(limits)
    check_all_allowed(limits)


def check_all_allowed(limits: Limits) -> None:
    assert limits.bound_places
    limits.check_goal("goTo", (80.0, 0.0, -30.0))
    limits.check_goal("orbit", farthest((50.0, 0.0, -5.0), 30.0))
    limits.check_speed("setSpeed", 5.0)
    limits.check_return("returnHome", 30.0, "RTL_ALT")
    limits.check_velocity((71.9, 0.0, 0.0), (4.0, 0.0, 0.0))
    # A vehicle that is already outside may come back.
    limits.check_velocity((90.0, 0.0, -40.0), (-1.0, 0.0, 1.0))
    limits.check_velocity(None, (99.0, 0.0, 0.0))


def test_without_limits_only_invalid_numbers_are_refused():
    limits = Limits(binding(), StandIn().error)
    assert not limits.bound_places
    limits.check_goal("goTo", (1e6, 0.0, -1e6))
    limits.check_speed("setSpeed", 1e3)
    with pytest.raises(DeviceError, match="above the limit"):
        limits.check_speed("setSpeed", math.nan)
