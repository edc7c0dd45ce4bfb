"""Settings of devices: old values are saved first, and are restored only to the same device."""

from __future__ import annotations

import asyncio
from concurrent.futures import ThreadPoolExecutor

import pytest

from lfield.devices.device_setup import FoundDevice, write_settings
from lfield.devices.parameter_backup import (
    BackupEntry,
    ParameterChange,
    newest_backup,
    read_backup,
    write_backup,
)
from lfield.devices.parameter_restore import apply_restore, plan_restore
from lfield.driver import DeviceBinding, DeviceError, Setting
from lfield.errors import DevicesError, InputFileError


class Lamp:
    """A device with a colour and a level; it fails after `writes` writes."""

    def __init__(self, name="lamp", writes=10, in_use=False, serial="no 7"):
        self.binding = DeviceBinding(
            agent=name, field="l", type="Lamp", driver="lamp", endpoint=name, safe_state="off"
        )
        self.stored = {"LEVEL": 1.0, "COLOUR": 2.0}
        self.wanted = {"LEVEL": 5.0, "COLOUR": 6.0}
        self.writes, self.in_use, self.serial = writes, in_use, serial

    def found(self):
        stored = [Setting(name, self.stored[name], self.wanted[name], "it is seen") for name in self.stored]
        return FoundDevice(self, "a lamp", stored, self.serial)

    def check_idle(self):
        if self.in_use:
            raise DeviceError("l", "nothing was written: it shines")

    async def write_setting(self, name, value):
        if self.writes == 0:
            raise DeviceError("l", "it is gone")
        self.writes -= 1
        self.stored[name] = value

    async def check_settings(self):
        pass


OLD = {"LEVEL": 1.0, "COLOUR": 2.0}


@pytest.fixture
def folder(tmp_path):
    return tmp_path / "own"


def set_up(folder, *lamps):
    asyncio.run(write_settings([lamp.found() for lamp in lamps], folder, "then", print))
    return read_backup(newest_backup(folder))


def restore(entry, lamp):
    """Restore a backup. Return the names of the written settings, and the problems."""
    plan = plan_restore(entry, lamp.found())
    return [change.name for change in plan.writes], asyncio.run(apply_restore(plan, print))


def test_old_values_are_saved_before_the_first_write(folder):
    lamp, other = Lamp(writes=1), Lamp("other")
    with pytest.raises(DevicesError, match=r"^lamp\.l: it is gone$"):
        set_up(folder, lamp, other)
    # Only one of the two settings was written; the other device was set up.
    assert lamp.stored == {"LEVEL": 5.0, "COLOUR": 2.0}
    assert other.stored == other.wanted
    entries = read_backup(folder / "setup-1.json")
    assert [entry.changes[1] for entry in entries] == [ParameterChange("COLOUR", 2.0, 6.0)] * 2
    lamp.writes = 10
    assert [restore(*pair) for pair in zip(entries, (lamp, other), strict=True)] == [
        (["LEVEL"], []), (["LEVEL", "COLOUR"], [])
    ]  # fmt: skip
    assert lamp.stored == other.stored == OLD
    assert restore(entries[0], lamp) == ([], [])


def test_concurrent_backups_never_overwrite_each_other(folder):
    def add(name):
        return [write_backup(folder, [BackupEntry(name, name, [], Lamp(name).binding)]) for _ in range(3)]

    with ThreadPoolExecutor() as pool:
        paths = [path for added in pool.map(add, "abcdefgh") for path in added]
    assert len(set(paths)) == 24
    assert sorted(read_backup(path)[0].identity for path in paths) == sorted("abcdefgh" * 3)
    assert newest_backup(folder) == folder / "setup-24.json"


@pytest.mark.parametrize("serial", ["no 8", ""])
def test_settings_are_not_restored_to_another_device(folder, serial):
    first, other = Lamp(), Lamp(serial=serial)
    (entry,) = set_up(folder, first)
    other.stored = dict(first.stored)
    writes, (problem,) = restore(entry, other)
    assert writes == []
    assert problem.startswith(f"lamp.l: a lamp{serial and ', '}{serial} is now at lamp, not a lamp, no 7")
    assert other.stored == first.stored


def test_setting_changed_since_the_backup_is_not_restored(folder):
    lamp = Lamp(serial="")
    (entry,) = set_up(folder, lamp)
    lamp.stored["LEVEL"] = 9.0
    writes, (problem,) = restore(entry, lamp)
    assert writes == ["COLOUR"]
    assert problem.startswith("lamp.l: LEVEL is 9, ")
    assert lamp.stored == {"LEVEL": 9.0, "COLOUR": 2.0}


def test_failed_write_of_a_restore_is_reported(folder):
    lamp = Lamp()
    (entry,) = set_up(folder, lamp)
    lamp.writes = 1
    assert restore(entry, lamp) == (["LEVEL", "COLOUR"], ["lamp.l: it is gone"])


def test_failed_driver_during_a_restore_is_reported(folder, monkeypatch):
    lamp = Lamp()
    (entry,) = set_up(folder, lamp)

    async def fail(name, value):
        raise KeyError(name)

    monkeypatch.setattr(lamp, "write_setting", fail)
    assert restore(entry, lamp)[1] == ["lamp.l: the driver failed: KeyError('LEVEL')"]


def test_no_setting_is_written_while_a_device_is_in_use(folder):
    lamp, shining = Lamp(), Lamp("shining", in_use=True)
    with pytest.raises(DevicesError, match=r"shining\.l: nothing was written: it shines"):
        set_up(folder, lamp, shining)
    assert lamp.stored == OLD
    assert newest_backup(folder) is None
    shining.in_use = False
    (entry,) = set_up(folder, shining)
    shining.in_use = True
    assert restore(entry, shining)[1] == ["shining.l: nothing was written: it shines"]
    assert shining.stored == shining.wanted


@pytest.mark.parametrize("text", ["", "{}", '{"version": 1, "entries": []}', "[" * 10000])
def test_invalid_backup_file_is_reported_and_not_overwritten(folder, text):
    folder.mkdir(mode=0o700)
    path = folder / "setup-1.json"
    path.write_text(text)
    with pytest.raises(InputFileError, match=r"setup-1\.json"):
        read_backup(path)
    assert write_backup(folder, []) == folder / "setup-2.json"
