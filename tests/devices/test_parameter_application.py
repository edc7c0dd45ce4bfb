"""Parameter files for a device: refused or written as a whole, with a backup before and a check after."""

from __future__ import annotations

import asyncio

import pytest

from lfield.devices.device_setup import FoundDevice
from lfield.devices.parameter_application import check_permitted, plan_file, stored_values, write_file
from lfield.devices.parameter_backup import read_backup
from lfield.driver import DeviceBinding, DeviceError, SettingChange, SettingsComparison
from lfield.errors import DevicesError, MissionFileError, UsageError


class Lamp:
    """A device without parameter files."""

    binding = DeviceBinding(
        agent="a", field="l", type="Lamp", driver="lamp", endpoint="lamp", safe_state="off"
    )

    def found(self):
        return FoundDevice(self, "a lamp", [], "no 7")

    def check_idle(self):
        pass


class Store(Lamp):
    """A device with two settings; if `coupled`, writing LEVEL changes COLOUR."""

    def __init__(self, *refusals, coupled=False, writes=10):
        self.stored = {"LEVEL": 1.0, "COLOUR": 2.0}
        self.refusals, self.coupled, self.writes = refusals, coupled, writes

    async def write_setting(self, name, value):
        if self.writes == 0:
            raise DeviceError("l", "it is gone")
        self.writes -= 1
        self.stored[name] = value
        if self.coupled and name == "LEVEL":
            self.stored["COLOUR"] = 0.0

    async def stored_settings(self, names):
        return {name: self.stored[name] for name in names if name in self.stored}

    async def compare_settings(self, file, data):
        if data == b"gone":
            raise DeviceError("l", "it is gone")
        if data == b"broken":
            raise KeyError("HUE")
        changes = [SettingChange("COLOUR", 2.0, 6.0), SettingChange("LEVEL", 1.0, 5.0)]
        return SettingsComparison(changes, ["HUE"] * 20, ["AGE"], self.refusals, ["LEVEL"])


def plan(device, data=b""):
    return asyncio.run(plan_file(device.found(), "f.param", data))


def write(plan, folder):
    lines = []
    asyncio.run(write_file(plan, folder, "then", lines.append))
    return lines


def test_plan_lists_changed_unknown_and_kept_settings_and_the_restart():
    lines = list(plan(Store()).lines())
    assert lines[1:3] == ["    COLOUR from 2 to 6", "    LEVEL from 1 to 5"]
    assert "and 8 more" in lines[3]
    assert [line.rpartition(" ")[2] for line in lines[4:]] == ["AGE", "LEVEL"]


def test_parameters_are_written_after_a_backup(tmp_path):
    store = Store()
    lines = write(plan(store), tmp_path / "own")
    assert store.stored == {"LEVEL": 5.0, "COLOUR": 6.0}
    (entry,) = read_backup(tmp_path / "own" / "setup-1.json")
    assert [(change.name, change.was, change.now) for change in entry.changes] == [
        ("COLOUR", 2.0, 6.0),
        ("LEVEL", 1.0, 5.0),
    ]
    assert lines[1:] == ["a.l: COLOUR was 2 and is now 6", "a.l: LEVEL was 1 and is now 5"]
    assert asyncio.run(stored_values(store.found(), ["LEVEL"])) == {"LEVEL": 5.0}
    assert asyncio.run(stored_values(Lamp().found(), ["LEVEL"])) == {}


def test_value_changed_by_another_write_is_found(tmp_path):
    with pytest.raises(DevicesError, match=r"^a\.l: COLOUR is not 6 any more"):
        write(plan(Store(coupled=True)), tmp_path / "own")


def test_failed_write_leaves_a_backup(tmp_path):
    with pytest.raises(DevicesError, match="it is gone"):
        write(plan(Store(writes=1)), tmp_path / "own")
    assert len(read_backup(tmp_path / "own" / "setup-1.json")) == 1


def test_refused_plan_raises_and_prints_every_reason():
    lines = []
    with pytest.raises(MissionFileError):
        check_permitted(plan(Store("LEVEL is too high", "COLOUR is wrong")), lines.append)
    assert lines == ["a.l: LEVEL is too high", "a.l: COLOUR is wrong"]
    check_permitted(plan(Store()), lines.append)
    with pytest.raises(UsageError):
        plan(Lamp())
    with pytest.raises(DevicesError):
        plan(Store(), b"gone")
    with pytest.raises(DevicesError) as error:
        plan(Store(), b"broken")
    assert error.value.problems == ("a.l: the driver failed: KeyError('HUE')",)
