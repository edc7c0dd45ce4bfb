"""Writing what devices must keep: kept before it is written, and put back the last first."""

from __future__ import annotations

import asyncio
from concurrent.futures import ThreadPoolExecutor
from contextlib import asynccontextmanager

import pytest

from lfield.clock import ManualClock
from lfield.devices import back
from lfield.devices.back import look_back, put_back
from lfield.devices.kept import Change, Entry, Kept
from lfield.devices.setup import Found, set_up
from lfield.driver import DeviceBinding, DeviceError, Setting
from lfield.driver.known import KnownDrivers
from lfield.errors import DevicesError, InputFileError


class Lamp:
    """A device that keeps a colour and a level; after `writes` of them it is gone."""

    def __init__(self, name="lamp", writes=10, in_use=False, serial="no 7"):
        self.binding = DeviceBinding(
            agent=name, field="l", type="Lamp", driver="lamp", endpoint=name, safe_state="off"
        )
        self.kept = {"LEVEL": 1.0, "COLOUR": 2.0}
        self.wanted = {"LEVEL": 5.0, "COLOUR": 6.0}
        self.writes, self.in_use, self.serial = writes, in_use, serial

    def found(self):
        kept = [Setting(name, self.kept[name], self.wanted[name], "it is seen") for name in self.kept]
        return Found(self, "a lamp", kept, self.serial)

    def check_idle(self):
        if self.in_use:
            raise DeviceError("l", "nothing was written: it shines")

    async def write_setting(self, name, value):
        if self.writes == 0:
            raise DeviceError("l", "it is gone")
        self.writes -= 1
        self.kept[name] = value

    async def check_settings(self):
        pass


@pytest.fixture
def kept(tmp_path):
    return Kept(tmp_path / "own" / "setup.json")


@pytest.fixture
def restore(kept, monkeypatch):
    """Puts everything back on lamps; what could not be."""

    def run(*lamps, meanwhile=lambda: None):
        @asynccontextmanager
        async def reached(drivers, bindings, clock, tell):
            found = [lamp.found() for lamp in lamps if lamp.binding in bindings]
            if not found:
                raise DevicesError(["not there"])
            yield found

        async def look_and_put_back():
            known, clock = KnownDrivers({}), ManualClock()
            steps, problems = await look_back(kept.entries(), known, clock, print)
            meanwhile()
            return problems + await put_back(steps, kept, known, clock, print)

        monkeypatch.setattr(back, "reached", reached)
        return asyncio.run(look_and_put_back())

    return run


def test_what_was_there_is_kept_before_the_first_write(kept, restore):
    lamp, other = Lamp(writes=1), Lamp("other")
    with pytest.raises(DevicesError, match=r"^lamp\.l: it is gone$"):
        asyncio.run(set_up([lamp.found(), other.found()], kept, "now", print))
    # Only one of two was written, and the other device all the same.
    assert lamp.kept == {"LEVEL": 5.0, "COLOUR": 2.0}
    assert other.kept == other.wanted
    assert [entry.changes[1] for entry in kept.entries()] == [Change("COLOUR", 2.0, 6.0)] * 2
    lamp.writes = 10
    assert restore(lamp, other) == []
    assert lamp.kept == other.kept == {"LEVEL": 1.0, "COLOUR": 2.0}
    assert kept.entries() == []
    assert not kept.path.exists()


def test_the_last_is_put_back_first_and_what_is_not_there_stays_kept(kept, restore):
    lamp = Lamp()
    asyncio.run(set_up([lamp.found()], kept, "one", print))
    lamp.wanted = {"LEVEL": 8.0, "COLOUR": 6.0}
    asyncio.run(set_up([lamp.found()], kept, "two", print))
    assert restore() == ["not there", "not there"]
    assert [entry.when for entry in kept.entries()] == ["one", "two"]
    assert restore(lamp) == []
    assert lamp.kept == {"LEVEL": 1.0, "COLOUR": 2.0}


def test_what_was_kept_of_one_is_not_put_back_to_another_in_its_place(kept, restore):
    mine, other = Lamp(), Lamp(serial="no 8")
    other.kept = {"LEVEL": 9.0, "COLOUR": 2.0}
    asyncio.run(set_up([mine.found()], kept, "one", print))
    asyncio.run(set_up([other.found()], kept, "two", print))
    stays = "lamp.l: at lamp is a lamp, no 8 now, and not a lamp, no 7: what that had before stays kept"
    assert restore(other) == [stays]
    assert other.kept == {"LEVEL": 9.0, "COLOUR": 2.0}
    assert [entry.when for entry in kept.entries()] == ["one"]
    # One that says nothing of itself today is not taken for it either.
    other.serial = ""
    assert restore(other) == [stays.replace(", no 8 now", " now")]
    assert restore(mine) == []
    assert mine.kept == {"LEVEL": 1.0, "COLOUR": 2.0}
    assert kept.entries() == []


def test_of_one_without_a_number_what_does_not_fit_stays_kept(kept, restore):
    mine, other = Lamp(serial=""), Lamp(serial="")
    other.kept = {"LEVEL": 9.0, "COLOUR": 2.0}
    asyncio.run(set_up([mine.found()], kept, "one", print))
    asyncio.run(set_up([other.found()], kept, "two", print))
    assert restore(other) == [
        "lamp.l: LEVEL is 9: left alone; what was set up had 1 before; it may be another device, "
        "and it stays kept"
    ]
    assert other.kept == {"LEVEL": 9.0, "COLOUR": 2.0}
    # Also where nothing is to be written: the other one may have had the same.
    other.kept = {"LEVEL": 1.0, "COLOUR": 2.0}
    assert restore(other) == ["lamp.l: whether it is the device of one cannot be known: that stays kept"]
    assert [entry.when for entry in kept.entries()] == ["one"]
    assert restore(mine) == []
    assert mine.kept == {"LEVEL": 1.0, "COLOUR": 2.0}
    assert kept.entries() == []


def test_what_was_never_written_needs_no_yes_and_is_kept_no_more(kept, restore):
    lamp = Lamp(writes=0)
    with pytest.raises(DevicesError):
        asyncio.run(set_up([lamp.found()], kept, "one", print))
    assert restore(lamp) == []
    assert lamp.kept == {"LEVEL": 1.0, "COLOUR": 2.0}
    assert kept.entries() == []


def test_what_has_changed_since_it_was_looked_at_is_not_written(kept, restore):
    lamp, other = Lamp(), Lamp(serial="no 8")
    asyncio.run(set_up([lamp.found()], kept, "one", print))
    other.kept = dict(lamp.kept)
    changed = restore(lamp, meanwhile=lambda: lamp.kept.update(LEVEL=3.0))
    assert changed == ["lamp.l: it has changed since it was looked at: nothing was written"]
    assert lamp.kept == {"LEVEL": 3.0, "COLOUR": 6.0}
    (stays,) = restore(lamp, meanwhile=lambda: setattr(lamp, "serial", "no 8"))[1:]
    assert stays.startswith("lamp.l: at lamp is a lamp, no 8 now")
    assert [entry.when for entry in kept.entries()] == ["one"]


def test_nothing_is_kept_or_written_while_one_of_them_is_in_use(kept):
    lamp, shining = Lamp(), Lamp("shining", in_use=True)
    with pytest.raises(DevicesError, match=r"shining\.l: nothing was written: it shines"):
        asyncio.run(set_up([lamp.found(), shining.found()], kept, "now", print))
    assert lamp.kept == {"LEVEL": 1.0, "COLOUR": 2.0}
    assert not kept.path.exists()


def test_several_at_a_time_lose_no_entry(kept):
    def add_and_remove(name):
        for number in range(5):
            mine = Entry(str(number), name, [], Lamp(name).binding)
            Kept(kept.path).add([mine])
            if number % 2:
                Kept(kept.path).remove(mine)

    with ThreadPoolExecutor() as together:
        list(together.map(add_and_remove, "abcdefgh"))
    assert sorted(entry.identity + entry.when for entry in kept.entries()) == [
        name + when for name in "abcdefgh" for when in "024"
    ]


@pytest.mark.parametrize("text", ["", "{}", '{"version": 2, "entries": []}', "[" * 10000])
def test_a_file_that_cannot_be_read_is_not_overwritten(kept, text):
    kept.path.parent.mkdir(mode=0o700)
    kept.path.write_text(text)
    with pytest.raises(InputFileError, match=r"setup\.json"):
        asyncio.run(set_up([Lamp().found()], kept, "now", print))
    assert kept.path.read_text() == text
