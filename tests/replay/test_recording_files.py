"""Recordings in directories: which belong together, which parts are missing, and which cannot be used."""

from __future__ import annotations

import asyncio
import json
import os
import shutil
from dataclasses import replace
from types import SimpleNamespace

import pytest
from recorded_teams import (
    checkpoint_turns,
    checkpoints_of,
    recorded,
    run_into,
    run_recorded,
    walk_mission,
    write_folder,
)

from lfield import exit_status
from lfield.cli.main import main
from lfield.errors import BundleError, InputFileError, RecordingError
from lfield.host.process import host_process
from lfield.host.recording import flight_recorder, recording_session
from lfield.host.recording.core_snapshot import CoreSnapshots
from lfield.host.recording.flight_recorder import FlightRecorder
from lfield.host.recording.object_graph import walk
from lfield.host.recording.recording_target import RecordingDirectory, RecordingMemory
from lfield.mission import bundle
from lfield.mission.access.signed_bundle import BundleId
from lfield.mission.loader import load_mission
from lfield.recording import folders
from lfield.recording.folders import INCARNATIONS, create_folder, folders_in, segments_of
from lfield.recording.segments import MAGIC
from lfield.replay import recording_files
from lfield.replay.event_stream import event_stream
from lfield.replay.host_replay import HostReplay
from lfield.replay.recording_files import load_incarnation, load_team
from lfield.replay.team_check import check_part, check_team
from lfield.simulate.host_fleet import Fleet, FleetOptions


@pytest.fixture(scope="module")
def teams(tmp_path_factory):
    """Two runs of a mission."""
    mission = walk_mission(tmp_path_factory.mktemp("walk"))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(flight_recorder, "CHECKPOINT_INTERVAL", 0.6)
        return [run_recorded(mission, 2.5, seed) for seed in (1, 2)]


@pytest.fixture
def team(teams):
    return teams[0]


def both(parent, team, wall=1.8e9, **options):
    return [write_folder(parent, team, number, wall, **options) for number in range(2)]


def result_of(capsys, *arguments) -> dict:
    """The result that `lfield replay --json` prints."""
    status = main(["replay", "--json", *map(str, arguments)])
    found = json.loads(capsys.readouterr().out)
    assert "differences" in found, found
    assert status == (exit_status.FAILED if found["differences"] else exit_status.DONE)
    return found


def refused(capsys, *arguments) -> str:
    """The message of `lfield replay` for a recording that cannot be used."""
    status = main(["replay", *map(str, arguments)])
    assert status == exit_status.DATA
    return capsys.readouterr().err


def test_both_hosts_of_a_directory_are_replayed(team, tmp_path, capsys):
    both(tmp_path, team)
    found = result_of(capsys, tmp_path)
    assert found["differences"] == 0
    assert found["digests"] > 50
    assert found["missing"] == []
    assert {row["host"] for row in found["hosts"]} == {"north", "south"}


def test_the_directories_of_several_robots_are_searched(team, tmp_path):
    """The directories are copies of `recordings` of each robot; a folder copied twice is used once."""
    both(tmp_path / "north", team)
    for folder in (tmp_path / "north").iterdir():
        (tmp_path / "south").mkdir(exist_ok=True)
        shutil.copytree(folder, tmp_path / "south" / folder.name)
    (tmp_path / "tables").mkdir()
    found = load_team([tmp_path])
    assert [each.host for each in found.incarnations] == ["north", "south"]
    assert found.missing == ()
    assert load_team([tmp_path / "north", tmp_path / "south"]).others == ()


def test_missing_hosts_are_named(team, tmp_path, capsys):
    folder = write_folder(tmp_path, team, 0)
    found = result_of(capsys, folder)
    assert found["missing"] == ["south"]
    assert found["differences"] == 0


def test_without_its_first_file_a_replay_starts_at_the_checkpoint(team, tmp_path, capsys):
    places = checkpoints_of(team)
    folder = write_folder(tmp_path, team, 0, cuts=places[:2])
    full_result = result_of(capsys, folder)
    (folder / "core-000001.lfrec").unlink()
    found = result_of(capsys, folder)
    assert found["differences"] == 0
    assert 0 < found["digests"] < full_result["digests"]
    assert any("core-000002.lfrec" in problem for problem in found["problems"])


def test_a_file_deleted_by_the_recorder_meanwhile_is_missing(team, tmp_path, monkeypatch):
    folder = write_folder(tmp_path, team, 0, cuts=checkpoints_of(team)[:2])
    files = segments_of(folder, "core")
    files[0].unlink()
    monkeypatch.setattr(recording_files, "segments_of", lambda *given: files)
    found = load_incarnation(folder)
    assert len(found.losses) == 2
    assert not found.parts[0].is_from_start


def test_hosts_without_their_first_files_belong_to_one_run(teams, tmp_path, capsys):
    for number in range(2):
        for at, team in enumerate(teams):
            cuts = checkpoints_of(team, number)[1:3]
            folder = write_folder(tmp_path, team, number, 1.8e9 + 1e3 * at, cuts=cuts)
            (folder / "core-000001.lfrec").unlink()
    found = load_team([tmp_path])
    assert [each.host for each in found.incarnations] == ["north", "south"]
    assert found.missing == ()
    assert len(found.others) == 2
    assert len({each.run for each in found.incarnations}) == 1


def sized_folder(parent, number, wall, size, limit=1000):
    """The folder of a start, with so many bytes."""
    folder = create_folder(parent, "north", number, wall, limit)
    (folder / "core-000001.lfrec").write_bytes(bytes(size))
    return folder


def test_a_host_that_restarts_repeatedly_does_not_replace_its_flight(tmp_path):
    flight = sized_folder(tmp_path, 1, 1.8e9, 1000)
    starts = [sized_folder(tmp_path, 2 + number, 1.8e9 + 1 + number, 10) for number in range(100)]
    assert [each.path for each in folders_in(tmp_path)] == [flight, *starts]


def test_recordings_of_a_host_have_a_limit(tmp_path, monkeypatch):
    starts = [sized_folder(tmp_path, 1 + number, 1.8e9 + number, 900) for number in range(20)]
    assert [each.path for each in folders_in(tmp_path)] == starts[-INCARNATIONS:]
    monkeypatch.setattr(folders, "MAX_INCARNATIONS", 3)
    newest = sized_folder(tmp_path, 21, 1.8e9 + 20, 0)
    assert [each.path for each in folders_in(tmp_path)] == [*starts[-2:], newest]


def test_a_lower_limit_does_not_delete_earlier_flights(tmp_path):
    starts = [sized_folder(tmp_path, 1 + number, 1.8e9 + number, 900) for number in range(3)]
    newest = sized_folder(tmp_path, 4, 1.8e9 + 3, 0, limit=10)
    assert [each.path for each in folders_in(tmp_path)] == [*starts, newest]


def test_a_start_with_a_wrong_clock_is_not_the_oldest(teams, tmp_path):
    (tmp_path / "north-99999999T999999-12345678").mkdir()
    (tmp_path / "south-20990101T000000-12345678").mkdir()
    write_folder(tmp_path, teams[0], 0, 1.8e9)
    newest = write_folder(tmp_path, teams[1], 0, 0.0)
    assert [each.folder for each in load_team([tmp_path]).incarnations] == [newest]


def test_a_missing_file_in_the_middle_leaves_two_parts(team, tmp_path, capsys):
    places = checkpoints_of(team)
    folder = write_folder(tmp_path, team, 0, cuts=places[:2])
    (folder / "core-000002.lfrec").unlink()
    found = result_of(capsys, folder)
    assert found["differences"] == 0
    assert len(found["hosts"]) == 2
    assert any("missing" in problem for problem in found["problems"])


def test_a_damaged_file_in_the_middle_leaves_the_other_turns(team, tmp_path, capsys):
    places = checkpoints_of(team)
    folder = write_folder(tmp_path, team, 0, cuts=places[:2])
    path = folder / "core-000002.lfrec"
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(data)
    found = result_of(capsys, folder)
    assert found["differences"] == 0
    assert len(found["hosts"]) == 2
    assert any("core-000002.lfrec" in problem for problem in found["problems"])


def test_the_newest_of_several_runs_is_used(teams, tmp_path, capsys):
    old, new = teams
    both(tmp_path, old)
    newer = both(tmp_path, new, 1.9e9)
    loaded = load_team([tmp_path])
    # The clocks of simulated computers are arbitrary: names of folders have the order of the starts.
    assert {each.folder for each in loaded.incarnations} == set(newer)
    assert len(loaded.others) == 2
    assert result_of(capsys, tmp_path)["differences"] == 0


def test_a_recording_of_another_bundle_is_refused(team, tmp_path, capsys):
    folder = write_folder(tmp_path, team)
    other = replace(team.mission, name="other")
    (folder / "mission.lfm").write_bytes(bundle.encode(other))
    assert "--bundle" in refused(capsys, folder)


def test_another_named_bundle_differs_or_is_refused(team, tmp_path, capsys):
    folder = write_folder(tmp_path, team)
    (folder / "mission.lfm").unlink()
    assert "--bundle" in refused(capsys, folder)
    path = tmp_path / "named.lfm"
    path.write_bytes(bundle.encode(team.mission))
    assert result_of(capsys, folder, "--bundle", path)["differences"] == 0
    path.write_bytes(b"LF")
    refused(capsys, folder, "--bundle", path)


@pytest.mark.parametrize(("change", "text"), [(1, "a newer lfield"), (-1, "the lfield that recorded it")])
def test_a_file_of_another_format_is_refused(change, text, team, tmp_path, capsys):
    folder = write_folder(tmp_path, team)
    path = folder / "core-000001.lfrec"
    data = path.read_bytes()
    path.write_bytes(MAGIC[:-1] + bytes([MAGIC[-1] + change]) + data[len(MAGIC) :])
    assert text in refused(capsys, folder)
    assert main(["debug", str(folder), "-c", "where"]) == exit_status.DATA
    assert main(["export", str(folder), "--csv", str(tmp_path / "tables")]) == exit_status.DATA


@pytest.mark.parametrize("name", ["nothing", "empty", "an empty file", "text", "a pipe", "a folder"])
def test_an_input_that_is_not_a_recording_is_refused(name, tmp_path, capsys):
    path = tmp_path / "place"
    if name != "nothing":
        path.mkdir()
    if name in ("an empty file", "text"):
        (path / "core-000001.lfrec").write_bytes(b"" if name == "an empty file" else b"hello " * 100)
    if name == "a pipe":
        os.mkfifo(path / "core-000001.lfrec")
    if name == "a folder":
        (path / "core-000001.lfrec").mkdir()
    with pytest.raises((RecordingError, InputFileError)):
        load_team([path])
    assert main(["replay", str(path)]) in (exit_status.DATA, exit_status.NO_INPUT)
    assert "Traceback" not in capsys.readouterr().err


def test_one_unusable_folder_does_not_hide_the_others(team, tmp_path, capsys):
    first, second = both(tmp_path, team)
    (second / "core-000001.lfrec").write_bytes(b"")
    found = result_of(capsys, tmp_path)
    assert found["missing"] == ["south"]
    assert any(second.name in problem for problem in found["problems"])
    shutil.rmtree(first)
    refused(capsys, tmp_path)


def test_a_wall_clock_jump_of_years_changes_nothing(tmp_path):
    memory = RecordingMemory()
    fleet = Fleet(walk_mission(tmp_path), 3, options=FleetOptions(record=memory))
    fleet.run(1.0)
    for number, machine in enumerate(fleet.machines.values()):
        machine.clock.ahead += 3e8 if number else -3e8
    fleet.run(1.0)
    team = recorded(fleet.mission, memory)
    fleet.close()
    both(tmp_path / "recordings", team)
    loaded = load_team([tmp_path / "recordings"])
    assert len(loaded.incarnations) == 2
    assert check_team(loaded).differences == 0
    times = [item.time for item in event_stream(loaded)]
    assert times == sorted(times)
    for each in loaded.incarnations:
        own = [item.time for item in event_stream(loaded) if item.host == each.host]
        assert len(own) > 5
        assert max(own) - min(own) < 3.0


def test_the_recorded_bundle_is_signed_only_if_it_was_the_signed_one(tmp_path):
    mission = walk_mission(tmp_path)
    (unsigned, *_) = run_recorded(mission, 0.5).bundles
    digest = bundle.contents(unsigned).digest
    for release in (BundleId(digest, b"signature"), BundleId(bytes(32), b"signature")):
        team = run_recorded(replace(mission, release=release), 0.5)
        found = bundle.contents(team.bundles[0])
        assert found.digest == digest
        assert found.signature == (b"signature" if release.digest == digest else b"")


@pytest.fixture
def started(tmp_path, monkeypatch):
    """A function that starts the process of a host, and returns its mission, its recorder and its log."""
    environment = SimpleNamespace(mission=None, options=None, log=[])

    class Started(Exception):
        pass

    def host(mission, name, transport, logbook, options):
        environment.mission, environment.options = mission, options
        raise Started

    identity = SimpleNamespace(address="", tls=None, admission=None, orders=None)
    monkeypatch.setattr(host_process, "Host", host)
    monkeypatch.setattr(host_process, "_identity", lambda mission, *rest: (identity, mission))
    monkeypatch.setattr(host_process.Logbook, "note", lambda book, line: environment.log.append(line.code))

    def start(record):
        with pytest.raises(Started):
            asyncio.run(host_process.run_host(walk_mission(tmp_path), "north", record=record))
        return environment.mission, environment.options.record, environment.log

    return start


def test_a_host_process_runs_a_mission_from_files_in_the_form_of_a_replay(started):
    """Otherwise no checkpoint of `lfield up --deploy` can be restored: its objects have other numbers."""
    memory = RecordingMemory()
    (plain, _, _), (run, record, log) = started(None), started(memory)
    decoded = bundle.decode(bundle.encode(plain))
    sizes = [len(walk(each, {}, ())) for each in (plain, run, decoded)]
    assert sizes[0] != sizes[1] == sizes[2]
    assert run.release == plain.release
    assert record is memory
    assert log == []


def test_a_mission_with_an_unreadable_bundle_starts_without_a_recording(started, monkeypatch):
    def fail(data):
        raise BundleError("it is damaged")

    monkeypatch.setattr(recording_session, "decode", fail)
    _, record, log = started(RecordingMemory())
    assert record is None
    assert log == ["host-recording-ended"]


def test_a_simulated_recording_is_replayed_from_its_checkpoints(tmp_path, monkeypatch):
    monkeypatch.setattr(flight_recorder, "CHECKPOINT_INTERVAL", 0.6)
    run_into(tmp_path / "records", walk_mission(tmp_path), 3.0)
    loaded = load_team([tmp_path / "records"])
    found = [
        check_part(part, HostReplay(part, loaded.mission, turn=turn))
        for each in loaded.incarnations
        for part in each.parts
        for turn in checkpoint_turns(part)
    ]
    assert len(found) > 4
    assert not any(each.differences for each in found)


def test_a_checkpoint_accepts_replaced_methods_but_no_new_functions(tmp_path):
    fleet = Fleet(walk_mission(tmp_path), 1, options=FleetOptions(record=RecordingMemory()))
    core = fleet.runs["north"].host.core
    snapshots = CoreSnapshots(core)
    run = core.run
    core.run = lambda: run()
    assert snapshots.capture()
    core.observer = lambda: None
    with pytest.raises(RecordingError, match=r"HostCore\.observer"):
        snapshots.capture()
    fleet.close()


def test_turns_are_written_although_no_turn_follows(tmp_path, monkeypatch):
    """A killed host must not lose more than a second, also if it was idle."""
    (tmp_path / "mission.L").write_text("resource Post { init(string[] arg) { } }")
    (tmp_path / "mission.dL").write_text("//Post:one@north\n")
    turns: list[float] = []
    end_turn = FlightRecorder.end_turn

    def counted(flight, *given, **named):
        end_turn(flight, *given, **named)
        turns.append(fleet.now)

    monkeypatch.setattr(FlightRecorder, "end_turn", counted)
    monkeypatch.setattr(RecordingMemory, "flush_interval", RecordingDirectory.flush_interval)
    memory = RecordingMemory()
    fleet = Fleet(load_mission(tmp_path / "mission.dL"), 1, options=FleetOptions(record=memory))
    fleet.run(30.0)
    while not turns or fleet.now < turns[-1] + 0.5:
        fleet.run(0.1)
    (recording,) = recorded(fleet.mission, memory).recordings()
    assert recording.turns == len(turns) > 0
    fleet.close()
