"""The stock resource types compile against the manifest, and so does a mission that includes them."""

from __future__ import annotations

import pytest
from coroutine_tests import on_bench

from lfield.driver.device import check_methods
from lfield.lang.frontend import check_file, check_text
from lfield_mavlink import PLUGIN
from lfield_mavlink.contact.vehicle_state import SOURCES

MANIFESTS = PLUGIN.read_manifests()
DEVICES = {name: manifest.device for name, manifest in MANIFESTS.items()}

MISSION = """
include <mavlink/copter.L>;
include <mavlink/rover.L>;

coordinator Fetch {
    init(string[] arg) {
        Copter copter = findCopter("alpha");
        Rover rover = findRover("bravo");
        rover.start();
        copter.takeOff(5.0);
        real[] at = copter.position();
        rover.goTo(at[0], at[1]);
        copter.winch(3.0, 0.5);
        copter.release();
        copter.move(1.0, 0.0, 0.0, 2.0);
        copter.flyTo(1.0, 2.0, -3.0);
        copter.flyToGlobal(47.4, 8.5, 10.0);
        real gone = copter.climb(2.0) - copter.descend(1.0);
        copter.lookAt(at[0], at[1], at[2]);
        copter.payOut(3.0, 0.5);
        copter.windIn(3.0, 0.5);
        rover.driveTo(at[0], at[1]);
        rover.driveToGlobal(47.4, 8.5);
        rover.drive(1.0, 0.0, 2.0);
        rover.payOut(3.0, 0.5);
        rover.windIn(3.0, 0.5);
        copter.land();
        print(copter.mode() + f2s(rover.battery(), 2));
    }
}
"""


@pytest.mark.parametrize("name", ["copter", "rover"])
def test_stock_resource_compiles_without_diagnostics(name):
    path = PLUGIN.source(f"{name}.L")
    assert path is not None
    checked = check_file(path, devices=DEVICES)
    assert [d.render() for d in checked.diagnostics] == []


def test_mission_that_includes_the_stock_resources_compiles():
    def find(path: str):
        return PLUGIN.source(path.removeprefix("mavlink/"))

    checked = check_text(MISSION, devices=DEVICES, find_include=find)
    assert [d.render() for d in checked.diagnostics] == []


@on_bench("bench", opened=False)
async def test_every_instruction_of_the_manifest_has_a_method(b, fc, /):
    check_methods(type(fc), MANIFESTS["Mavlink"], fc.parts)


def test_every_requested_telemetry_message_has_a_rate():
    rates = {quantity.name: quantity.rate for quantity in DEVICES["Mavlink"].telemetry}
    assert all(max(rates[name] for name in names) > 0.0 for names in SOURCES.values())
