"""Errors before the start of any guard, bindings of fakes, and stops of all guards."""

from __future__ import annotations

import asyncio
from types import SimpleNamespace

import msgspec
import pytest

from lfield.clock import ManualClock
from lfield.devices.device_guards import DeviceGuards
from lfield.devices.fake_processes import fault_options
from lfield.devices.latched_devices import LatchedDevices
from lfield.driver.binding import DeviceBinding
from lfield.driver.plugins import Plugins
from lfield.errors import DevicesError
from lfield.mission.bindings_file import read_bindings
from lfield.simulate.jumping_loop import run_jumping

SERVO = DeviceBinding(
    agent="arm", field="wrist", type="Dynamixel", driver="dynamixel", endpoint="serial:/dev/ttyUSB0:57600",
    safe_state="torque_hold", options={"id": 1},
)  # fmt: skip


@pytest.fixture
def plugins() -> Plugins:
    found = Plugins()
    for name in ("can", "dynamixel", "mavlink"):
        found.add(f"lfield_{name}:PLUGIN")
    return found


def test_two_drivers_for_one_port_are_refused(plugins):
    vehicle = DeviceBinding(
        agent="car", field="fc", type="Mavlink", driver="mavlink", endpoint=SERVO.endpoint, safe_state="hold"
    )
    with pytest.raises(DevicesError) as error:
        asyncio.run(DeviceGuards(plugins, ManualClock(), print).open([SERVO, vehicle]))
    assert error.value.problems == (
        "arm.wrist and car.fc are both at serial:/dev/ttyUSB0:57600, with the drivers 'dynamixel' and "
        "'mavlink': a port can have only one driver",
    )


def test_fault_options_of_a_fake_have_the_name_of_the_device():
    binding = msgspec.structs.replace(SERVO, sim=["obstacle=-0.1", "unplug@2=true"])
    assert fault_options([binding]) == ["--fault", "obstacle@arm.wrist=-0.1", "--fault", "unplug@2=true"]


def test_devices_file_sets_the_faults_of_a_fake(plugins, tmp_path):
    path = tmp_path / "m.devices.yaml"
    path.write_text('agents:\n  arm: {devices: {wrist: {driver: dynamixel, sim: ["hot=true"]}}}\n')
    bound = read_bindings(path, {"arm": {"wrist": "Dynamixel"}}, plugins, simulate=True)
    assert bound.devices["arm"]["wrist"].sim == ["hot=true"]


def test_unknown_waiver_is_an_error(plugins, tmp_path):
    path = tmp_path / "m.devices.yaml"
    device = "{driver: dynamixel, endpoint: 'serial:/dev/x:1', waivers: [care]}"
    path.write_text(f"agents: {{arm: {{devices: {{wrist: {device}}}}}}}\n")
    with pytest.raises(Exception, match="unknown waiver 'care'"):
        read_bindings(path, {"arm": {"wrist": "Dynamixel"}}, plugins)


def test_path_option_is_relative_to_the_devices_file(plugins, tmp_path):
    (tmp_path / "keys").mkdir()
    (tmp_path / "keys" / "secret").write_text("00" * 32)
    path = tmp_path / "m.devices.yaml"
    text = "agents: {car: {devices: {fc: {driver: mavlink, endpoint: 'tcp:127.0.0.1:1', signing_key: %s}}}}\n"
    path.write_text(text % "keys/secret")
    needed = {"car": {"fc": "Mavlink"}}
    bound = read_bindings(path, needed, plugins).devices["car"]["fc"]
    assert bound.option("signing_key") == str((tmp_path / "keys" / "secret").resolve())
    path.write_text(text % "keys/lost")
    with pytest.raises(Exception, match=r"there is no file .*keys/lost"):
        read_bindings(path, needed, plugins)


def test_wrong_device_type_of_a_driver_is_refused(plugins, tmp_path):
    path = tmp_path / "m.devices.yaml"
    device = "{driver: dynamixel, type: Dynamixel, endpoint: 'serial:/dev/x:1'}"
    path.write_text(f"agents: {{arm: {{devices: {{joints: {device}}}}}}}\n")
    with pytest.raises(Exception, match="'type' must be one of DynamixelGroup"):
        read_bindings(path, {"arm": {"joints": "DynamixelGroup"}}, plugins)


class LateGuard:
    """A guard whose device confirms its safe state some seconds after the first stop."""

    actuated_devices = ("arm.wrist",)

    def __init__(self, seconds: float, *, lost: float | None = None) -> None:
        self.snapshots = SimpleNamespace(
            silent_since=lambda name: lost, describe=lambda name: "last contact 9.0 s ago"
        )
        self.latched_devices = LatchedDevices({}, ManualClock(), print, None)
        self._seconds = seconds

    def inhibit(self, reason: str) -> None:
        if reason == "first":
            asyncio.get_running_loop().call_later(self._seconds, self._confirm)

    def _confirm(self) -> None:
        self.latched_devices.confirmed.update(self.actuated_devices)
        self.latched_devices.on_change()


def guards_with(guard: LateGuard, plugins) -> DeviceGuards:
    guards = DeviceGuards(plugins, ManualClock(), print)
    guards._guards = [guard]
    guard.latched_devices.set_event_handlers(guards.on_event, guards.on_lock_out, guards._on_latch_change)
    return guards


def test_two_emergency_stops_both_return_the_result(plugins):
    async def scenario() -> float:
        guards, loop = guards_with(LateGuard(2.0), plugins), asyncio.get_running_loop()
        start = loop.time()
        first, second = (
            asyncio.ensure_future(guards.emergency_stop(reason)) for reason in ("first", "second")
        )
        assert await first == await second == {"arm.wrist": ""}
        return loop.time() - start

    assert run_jumping(scenario()) == pytest.approx(2.0)


def test_a_cancelled_wait_for_safe_states_leaves_no_data(plugins):
    async def scenario() -> list[object]:
        guards = guards_with(LateGuard(2.0), plugins)
        stop = asyncio.ensure_future(guards.emergency_stop("first"))
        await asyncio.sleep(1.0)
        stop.cancel()
        await asyncio.wait([stop])
        return guards._stopping

    assert run_jumping(scenario()) == []


def test_silent_device_is_not_reported_safe(plugins):
    async def scenario() -> dict[str, str]:
        return await guards_with(LateGuard(0.1, lost=3.0), plugins).emergency_stop("first")

    assert run_jumping(scenario()) == {
        "arm.wrist": "it was in its safe state before, but no longer responds; last contact 9.0 s ago"
    }
