"""Starts are counted: by what is on record here and what the others know, by no clock, and on disk first."""

from __future__ import annotations

import asyncio
import os
import stat
from pathlib import Path

import pytest

from lfield.errors import OutputFileError
from lfield.simulate.time import LoopClock
from lfield.text.record import FileRecord, record_file

PROGRAM = """
resource Post {
    init(string[] arg) { }
    portal stay(real seconds) { write("arrived\\n"); sleep(seconds); }
}
coordinator Guest {
    init(string[] arg) { findPost(arg[1]).stay(20.0); }
}
"""
DEPLOYMENT = "//Guest:guest@home?post\n//Post:post@away\n"
TWO_GUESTS = DEPLOYMENT + "//Guest:other@home?post\n"


def start_of(running, agent: str = "guest") -> int:
    return max(known.generation for known in running.host.mobility.knowledge() if known.agent == agent)


class SetBack(LoopClock):
    """A wall clock that was 3 s further on before the computer was started."""

    def time(self) -> float:
        return super().time() - 3.0


def test_a_clock_set_back_between_two_starts_changes_no_order(fleet):
    async def story(team):
        mission = team.mission(PROGRAM, DEPLOYMENT)
        home, away = await team.up(mission)
        await team.until(lambda: away.output)
        first = start_of(home)
        # Nobody who can be reached knows of the first, so a second one is started, at once.
        team.network.partition("home", "away")
        await home.host.stop()
        again = team.make(mission, "home")
        again.host.clock = SetBack()
        await again.host.start()
        assert start_of(again) == first + 1
        team.network.heal("home", "away")
        await team.until(lambda: "guest stopped: an earlier start of guest is alive on away" in again.log)
        assert away.holds("guest")
        assert not again.holds("guest")

    fleet(story)


def test_what_another_host_knows_counts_when_the_record_is_behind(fleet):
    async def story(team):
        mission = team.mission(PROGRAM, DEPLOYMENT)
        team.make(mission, "home")
        team.records["home"].starts = 41
        home, away = await team.up(mission)
        await team.until(lambda: away.output)
        assert start_of(home) == 42
        assert team.records["home"].starts == 42
        await home.host.stop()
        team.records["home"].starts = 7
        await away.host.stop()
        (away,) = await team.up(mission, "away")
        (home,) = await team.up(mission, "home")
        assert start_of(home) == 8
        await home.host.stop()
        team.records["home"].starts = 3
        (home,) = await team.up(mission, "home")
        assert "guest is alive on another host: not started again" in home.log
        # The number is taken all the same, and no other host knows one as high.
        assert team.records["home"].starts == 9

    fleet(story)


def test_without_a_record_a_host_waits_until_it_has_heard_all(fleet):
    async def story(team):
        mission = team.mission(PROGRAM, TWO_GUESTS)
        home = team.make(mission, "home")
        team.records["home"].starts = None
        await home.host.start()
        await asyncio.sleep(30.0)
        why = (
            "guest and other are not started before away was heard: this host has no record of earlier "
            "starts; `--first-start` says that there was none"
        )
        assert home.log.count(why) == 1
        assert not home.holds("guest")
        assert team.records["home"].starts is None
        await team.up(mission, "away")
        await team.until(lambda: home.host.mobility.knowledge())
        assert start_of(home) == start_of(home, "other") == 1
        assert team.records["home"].starts == 1

    fleet(story)


def test_somebody_may_say_that_there_was_no_earlier_start(fleet):
    async def story(team):
        mission = team.mission(PROGRAM, DEPLOYMENT)
        home = team.make(mission, "home", first_start=True)
        team.records["home"].starts = None
        await home.host.start()
        assert start_of(home) == 1
        assert team.records["home"].starts == 1

    fleet(story)


def test_where_no_record_is_kept_all_hosts_are_heard_first(fleet):
    """Fakes, and `up --all`."""

    async def story(team):
        mission = team.mission(PROGRAM, DEPLOYMENT)
        (home,) = await team.up(mission, "home", record=None)
        await asyncio.sleep(5.0)
        assert not home.holds("guest")
        await team.up(mission, "away")
        await team.until(lambda: home.host.mobility.knowledge())
        assert start_of(home) == 1

    fleet(story)


def test_a_host_that_was_reaped_is_not_waited_for(fleet):
    async def story(team):
        mission = team.mission(PROGRAM, DEPLOYMENT)
        (home,) = await team.up(mission, "home", record=None)
        await asyncio.sleep(5.0)
        home.host.reaped("nobody we know")
        home.host.reaped("away")
        await team.until(lambda: home.holds("guest"))

    fleet(story)


class Full:
    """A disk that takes nothing."""

    def read(self) -> int | None:
        return 4

    async def write(self, generation: int) -> None:
        raise OutputFileError("/state/starts.json", "No space left on device")


def test_a_start_that_cannot_be_put_on_record_is_not_made(fleet):
    async def story(team):
        mission = team.mission(PROGRAM, DEPLOYMENT + "//Post:here@home\n")
        (home,) = await team.up(mission, "home", record=Full())
        await asyncio.sleep(5.0)
        assert "not started: guest; its start cannot be put on record: " in home.log
        assert "No space left on device" in home.log
        assert not home.holds("guest")
        # The resources are served all the same.
        assert home.holds("here")
        assert home.host.failure is None

    fleet(story)


# The file


def read(path: Path) -> tuple[int | None, list[str]]:
    told: list[str] = []
    return FileRecord(path, told.append).read(), told


def write(path: Path, generation: int) -> None:
    asyncio.run(FileRecord(path, lambda text: None).write(generation))


def test_the_file_keeps_the_number_and_is_of_its_user_alone(tmp_path):
    path = record_file(tmp_path / "state", "mission", "10.0.0.1")
    assert read(path) == (None, [])
    for number in (1, 2**61):
        write(path, number)
        assert read(path) == (number, [])
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    assert stat.S_IMODE(path.parent.stat().st_mode) == 0o700
    assert os.listdir(path.parent) == ["starts.json"]


def test_it_is_on_the_disk_before_it_counts(tmp_path, monkeypatch):
    synced = []
    monkeypatch.setattr(
        os, "fsync", lambda descriptor: synced.append(stat.S_IFMT(os.fstat(descriptor).st_mode))
    )
    write(tmp_path / "starts.json", 5)
    assert synced == [stat.S_IFREG, stat.S_IFDIR]


DAMAGED = [b"", b"{}", b"\xff", b"[" * 4000, b'{"starts":-1,"check":0}', b"x" * 9999]


@pytest.mark.parametrize("data", [*DAMAGED, "a digit"], ids=range(len(DAMAGED) + 1))
def test_a_damaged_file_is_moved_aside_and_counts_as_none(tmp_path, data):
    path = tmp_path / "starts.json"
    write(path, 1234)
    path.write_bytes(path.read_bytes().replace(b"1234", b"1235") if data == "a digit" else data)
    damaged = path.read_bytes()
    found, (told,) = read(path)
    assert found is None
    assert told.startswith(f"the record of earlier starts in {path} cannot be believed (")
    assert told.endswith("it is now starts.json.damaged")
    assert path.with_name("starts.json.damaged").read_bytes() == damaged
    assert read(path) == (None, [])


def test_every_deployment_and_host_has_a_place_of_its_own(tmp_path, monkeypatch):
    names = [("a", "b@c"), ("a@b", "c"), ("..", ".."), ("a/b", "c"), ("a", "b/c")]
    paths = {record_file(tmp_path, *name) for name in names}
    assert len(paths) == len(names)
    assert {path.parent.parent for path in paths} == {tmp_path}
    monkeypatch.setenv("XDG_STATE_HOME", "/home/me/state")
    assert record_file(None, "m", "h") == Path("/home/me/state/lfield/m@h/starts.json")
    monkeypatch.setenv("STATE_DIRECTORY", "/var/lib/lfield:/var/lib/other")
    assert record_file(None, "m", "h") == Path("/var/lib/lfield/m@h/starts.json")
    monkeypatch.delenv("STATE_DIRECTORY")
    monkeypatch.delenv("XDG_STATE_HOME")
    monkeypatch.setenv("HOME", "/home/me")
    assert record_file(None, "m", "h") == Path("/home/me/.local/state/lfield/m@h/starts.json")
