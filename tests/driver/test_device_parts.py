"""A device with parts: each instruction is implemented once, in the device or in one of its parts."""

from __future__ import annotations

import asyncio

import pytest

from lfield.clock import ManualClock
from lfield.driver import Device, DeviceBinding, DeviceError
from lfield.driver.device import check_methods
from lfield.driver.manifest_file import load_manifest
from lfield.errors import PluginError
from lfield.testing.kept_reports import KeptReports

MANIFEST = load_manifest(
    "lamp.yaml",
    b"""
driver: lamp
type: Lamp
meaning: a lamp that can be turned
safe_states: [off]
instructions:
  light: {parameters: {on: {type: boolean}}, effect: idempotent, blocking: true, cancel: never}
  turn: {parameters: {angle: {type: real}}, result: real, blocking: true, cancel: leave}
telemetry:
  angle: {type: real, max_age: 1.0}
""",
)


class Neck:
    def __init__(self, lamp: Device) -> None:
        self.lamp = lamp

    async def do_turn(self, angle: float) -> float:
        self.lamp.publish(angle=angle)
        return -angle


class Lamp(Device):
    def __init__(self, *parts) -> None:
        binding = DeviceBinding(
            agent="a", field="f", type="Lamp", driver="lamp", endpoint="x", safe_state="off"
        )
        self.reports, self.on = KeptReports(), False
        super().__init__(binding, MANIFEST, ManualClock(), self.reports)
        self.parts = [part(self) for part in parts]

    async def do_light(self, on: bool) -> None:
        self.on = on


def test_part_executes_an_instruction_of_the_device():
    lamp = Lamp(Neck)
    check_methods(Lamp, MANIFEST, lamp.parts)
    assert asyncio.run(lamp.execute("turn", [1])) == -1.0
    asyncio.run(lamp.execute("light", [True]))
    assert lamp.on
    assert lamp.reports.values == {"angle": 1.0}


@pytest.mark.parametrize("value", [1e9, -1e9, (1 << 63) - 1])
def test_number_above_the_largest_number_of_the_wire_is_refused(value):
    lamp = Lamp(Neck)
    lamp.largest = 1e6
    with pytest.raises(DeviceError, match=r"turn refused: a number is beyond 1e\+06"):
        asyncio.run(lamp.execute("turn", [value]))
    assert lamp.reports.values == {}


def test_missing_instruction_method_is_an_error():
    with pytest.raises(PluginError, match="Lamp needs 'async def do_turn' for 'turn'"):
        check_methods(Lamp, MANIFEST)


class Shade(Neck):
    async def do_release(self) -> None:
        pass


@pytest.mark.parametrize(
    ("parts", "words"),
    [
        ((Neck, Neck), "Neck and Neck both define do_turn: 'turn' must be implemented once"),
        ((Shade,), "Lamp and Shade both define do_release"),
    ],
)
def test_instruction_implemented_twice_is_an_error(parts, words):
    lamp = Lamp(*parts)
    with pytest.raises(PluginError, match=words):
        check_methods(Lamp, MANIFEST, lamp.parts)


def test_part_method_must_have_the_parameters_of_the_manifest():
    class Stiff:
        def __init__(self, lamp: Device) -> None:
            pass

        async def do_turn(self) -> None:
            pass

    lamp = Lamp(Stiff)
    with pytest.raises(PluginError, match=r"Stiff\.do_turn must take the 1 parameters of its manifest"):
        check_methods(Lamp, MANIFEST, lamp.parts)
