"""The mission on a host: only its own drivers are installed, and it has the vehicles of all hosts."""

from __future__ import annotations

from importlib.metadata import EntryPoint
from pathlib import Path

import pytest

from lfield.driver.driver_index import GROUP
from lfield.errors import PluginError
from lfield.mission import bundle
from lfield.mission.loader import load_mission
from lfield.mission.mission import with_installed_drivers

EXAMPLES = Path(__file__).parents[2] / "examples"


@pytest.mark.parametrize("example", ["02-equivalent-lift", "03-mixed-team", "05-two-carry-one"])
def test_a_host_without_a_driver_knows_the_vehicles_of_other_hosts(example):
    mission = load_mission(EXAMPLES / example / "mission.dL", simulate=True)
    hosts = mission.team.hosts
    vehicles = {host: mission.vehicles_of(host) for host in hosts}
    assert any(vehicles.values())
    for host in hosts:
        own = {device.driver for device in mission.devices_of(host)}
        entries = [EntryPoint(name, f"here.{name}:PLUGIN", GROUP) for name in own]
        found = with_installed_drivers(mission, host, entries)
        assert {each: found.vehicles_of(each) for each in hosts} == vehicles
        # A recording has the same vehicles.
        assert bundle.decode(bundle.encode(found)).team.hosts == hosts
        for name, driver in found.drivers.by_driver.items():
            assert driver.reference.startswith("here.") == (name in own)


def test_only_drivers_of_own_devices_must_be_installed():
    mission = load_mission(EXAMPLES / "05-two-carry-one" / "mission.dL", simulate=True)
    assert with_installed_drivers(mission, "yard", []).vehicles_of("alpha")
    with pytest.raises(PluginError):
        with_installed_drivers(mission, "alpha", [])
