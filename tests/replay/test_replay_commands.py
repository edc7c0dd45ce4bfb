"""`lfield replay`, `replay --program` and `test --from` on a team that was recorded in virtual time."""

from __future__ import annotations

import csv
import json
import re
import shutil
import socket
import subprocess
import sys
from contextlib import chdir, redirect_stderr, redirect_stdout
from io import BytesIO, StringIO
from pathlib import Path

import pytest
from flight_of_two import PROGRAM, record_flight, write_mission
from mcap.reader import make_reader
from msgspec.structs import replace

from lfield.cli.main import main
from lfield.host.inputs import DeviceAnswered
from lfield.host.recording.host_records import TurnRecord, decode_frame, encode_frame, header_of
from lfield.mission.loader import load_mission
from lfield.recording.segments import MAGIC, SegmentReader, frame
from lfield.replay import computation_limit
from lfield.replay.call_log import CallLog
from lfield.replay.program_replay import mission_with, run_program
from lfield.replay.recording_files import load_team
from lfield.replay.team_order import TeamOrder

ROOT = Path(__file__).parents[2]
#: Options for commands that would read from a terminal.
PLAIN = {"debug flight": ("-c", "where")}


# : Instructions without a call or a pause that another program may execute in these tests.
MOST = 20_000


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the mission and its recordings in `records`."""
    folder = tmp_path_factory.mktemp("recorded")
    record_flight(folder, 30.0)
    return folder


def lfield(*args: object, cwd: Path) -> subprocess.CompletedProcess[str]:
    """A command in this process."""
    words = [str(arg) for arg in args]
    with chdir(cwd), redirect_stdout(StringIO()) as out, redirect_stderr(StringIO()) as err:
        status = main(words)
    return subprocess.CompletedProcess(words, status, out.getvalue(), err.getvalue())


@pytest.mark.process
def test_a_recording_is_replayed_without_a_difference(recorded: Path) -> None:
    command = [sys.executable, "-m", "lfield", "replay", "records", "--json"]
    ran = subprocess.run(command, cwd=recorded, capture_output=True, text=True, timeout=60)
    found = json.loads(ran.stdout)
    assert ran.returncode == 0
    assert found["differences"] == 0
    assert found["first"] is None
    assert found["digests"] > 100
    assert {host["host"] for host in found["hosts"]} == {"alpha", "bravo"}
    assert found["missing"] == found["problems"] == []


@pytest.mark.few(0)
@pytest.mark.process
def test_another_program_is_compared_by_its_calls(recorded: Path, tmp_path: Path) -> None:
    same = write_mission(tmp_path, PROGRAM.replace("fc.arm();", 'print("a new line"); fc.arm();'))
    ran = lfield("test", "--from", recorded / "records", same, cwd=tmp_path)
    assert (ran.returncode, ran.stderr) == (0, "")
    other = write_mission(tmp_path, PROGRAM.replace("climb(3.0)", "climb(4.0)"))
    ran = lfield("replay", recorded / "records", "--program", other, "--json", cwd=tmp_path)
    found = json.loads(ran.stdout)
    assert ran.returncode == 1
    assert found["differences"] == 1
    first = found["first"]
    assert (first["agent"], first["call"]) == ("two", 2)
    assert first["recorded"]["call"] == "fc.takeoff(3)"
    assert first["replayed"]["call"] == "fc.takeoff(4)"
    assert first["replayed"]["place"] == "mission.L:7"
    ran = lfield("test", "--from", recorded / "records", cwd=tmp_path)
    assert ran.returncode == 1
    assert lfield("test", "--from", recorded / "records", "-x", cwd=tmp_path).returncode == 64


@pytest.mark.process
def test_a_program_that_does_not_compile_is_reported_with_its_line(recorded: Path, tmp_path: Path) -> None:
    wrong = write_mission(tmp_path, PROGRAM.replace("fc.arm()", "fc.arn()"))
    ran = lfield("replay", recorded / "records", "--program", wrong, cwd=tmp_path)
    assert ran.returncode == 65
    assert "mission.L:6:12: error[L305]" in ran.stderr
    assert "Traceback" not in ran.stderr


@pytest.mark.process
def test_missing_hosts_of_a_team_are_named(recorded: Path, tmp_path: Path) -> None:
    (alpha,) = (recorded / "records").glob("alpha-*")
    shutil.copytree(alpha, tmp_path / alpha.name)
    ran = lfield("replay", tmp_path, "--json", cwd=tmp_path)
    found = json.loads(ran.stdout)
    assert ran.returncode == 0
    assert found["missing"] == ["bravo"]
    assert found["digests"] > 50


@pytest.mark.few(0)
@pytest.mark.process
def test_a_changed_input_is_a_difference(recorded: Path, tmp_path: Path) -> None:
    """The first difference is named with its host, time and values."""
    copied = tmp_path / "records"
    shutil.copytree(recorded / "records", copied)
    (path,) = copied.glob("alpha-*/core-*.lfrec")
    path.write_bytes(with_another_input(path.read_bytes()))
    ran = lfield("replay", copied, "--json", cwd=tmp_path)
    found = json.loads(ran.stdout)
    assert ran.returncode == 1
    assert found["first"]["host"] == "alpha"
    assert found["first"]["recorded"] != found["first"]["replayed"]
    assert "first difference: " in lfield("replay", copied, cwd=tmp_path).stdout
    back = ["-c", "back event"] * 8
    ran = lfield("debug", copied, "-c", "end", *back, cwd=tmp_path)
    assert "the replay differs from the recording from turn" in ran.stdout
    tables = tmp_path / "tables"
    ran = lfield("export", copied, "--csv", tables, cwd=tmp_path)
    assert ran.returncode == 0
    assert "alpha: the recording cannot be replayed from turn" in ran.stderr
    with (tables / "events.csv").open(newline="") as table:
        assert {row["host"] for row in csv.DictReader(table)} == {"alpha", "bravo"}


def with_another_input(data: bytes) -> bytes:
    """A segment in which devices have answered with an error."""
    frames = list(SegmentReader(BytesIO(data)))
    for place, each in enumerate(frames):
        records = decode_frame(each)
        for at, record in enumerate(records):
            if isinstance(record, TurnRecord) and isinstance(record.entry, DeviceAnswered):
                entry = DeviceAnswered(record.entry.number, None, ("fc", "it failed", "DeviceException"))
                records[at] = replace(record, entry=entry)
        frames[place] = encode_frame(records, header_of(each))
    return MAGIC + b"".join(map(frame, frames))


@pytest.mark.process
@pytest.mark.parametrize("command", ["replay", "debug", "export", "watch"])
def test_another_bundle_is_refused(command: str, recorded: Path, tmp_path: Path) -> None:
    other = write_mission(tmp_path, PROGRAM.replace("climb(2.0)", "climb(2.5)"))
    built = lfield("build", other, "--sim", "-o", tmp_path / "other.lfm", cwd=tmp_path)
    assert built.returncode == 0
    options = {"debug": ["-c", "where"], "export": ["--csv", "tables"]}.get(command, [])
    bundle = tmp_path / "other.lfm"
    paths = ["--replay", recorded / "records"] if command == "watch" else [recorded / "records"]
    ran = lfield(command, *paths, "--bundle", bundle, *options, cwd=tmp_path)
    assert ran.returncode == 65
    assert "other.lfm is another bundle" in ran.stderr
    assert "Traceback" not in ran.stderr


@pytest.mark.process
@pytest.mark.few(0)
@pytest.mark.parametrize("seconds", ["0.001", "0.05", "1.0", "20.0"])
def test_a_pause_changes_no_call(seconds: str, recorded: Path, tmp_path: Path) -> None:
    for place in ('sum = sum + findPost("two")', "fc.takeoff(height);", 'print("climbed'):
        later = write_mission(tmp_path, PROGRAM.replace(place, f"sleep({seconds}); {place}"))
        ran = lfield("test", "--from", recorded / "records", later, cwd=tmp_path)
        assert (ran.returncode, ran.stderr) == (0, ""), ran.stdout
    fewer = write_mission(tmp_path, PROGRAM.replace("fc.takeoff(height);", f"sleep({seconds});"))
    assert lfield("test", "--from", recorded / "records", fewer, cwd=tmp_path).returncode == 1


@pytest.mark.process
@pytest.mark.parametrize("name", ["one", "two"])
def test_a_call_after_the_recorded_end_of_the_program_is_a_difference(
    name: str, recorded: Path, tmp_path: Path
) -> None:
    more = f'findPost("{name}").climb(5.0); print("climbed'
    later = write_mission(tmp_path, PROGRAM.replace('print("climbed', more))
    ran = lfield("replay", recorded / "records", "--program", later, "--json", cwd=tmp_path)
    found = json.loads(ran.stdout)
    assert ran.returncode == 1
    assert found["first"]["recorded"] is None
    assert found["first"]["replayed"]["call"] == f"{name}.climb"


def one_host(recorded: Path, folder: Path, host: str) -> Path:
    """A copy of the recording of one host."""
    (found,) = (recorded / "records").glob(f"{host}-*")
    shutil.copytree(found, folder / found.name)
    return folder / found.name


@pytest.mark.few(1)
@pytest.mark.process
@pytest.mark.parametrize("damage", ["no host", "a damaged record", "a missing host that calls"])
def test_the_same_calls_of_an_incomplete_recording_prove_nothing(
    damage: str, recorded: Path, tmp_path: Path
) -> None:
    mission = write_mission(tmp_path, PROGRAM)
    records = tmp_path / "records"
    one_host(recorded, records, "bravo" if damage == "a missing host that calls" else "alpha")
    if damage == "a damaged record":
        bravo = one_host(recorded, records, "bravo")
        path = bravo / "core-000001.lfrec"
        data = bytearray(path.read_bytes())
        data[len(data) // 4] ^= 1
        path.write_bytes(data)
    ran = lfield("test", "--from", records, mission, cwd=tmp_path)
    assert ran.returncode == 65
    assert "bravo" in ran.stderr or "alpha" in ran.stderr
    assert "the same" not in ran.stdout
    ran = lfield("replay", records, "--program", mission, "--json", cwd=tmp_path)
    found = json.loads(ran.stdout)
    assert ran.returncode == 65
    assert found["unknown"]
    assert found["differences"] == 0


@pytest.mark.few(0)
@pytest.mark.process
def test_other_calls_of_an_incomplete_recording_are_a_difference(recorded: Path, tmp_path: Path) -> None:
    other = write_mission(tmp_path, PROGRAM.replace("climb(3.0)", "climb(4.0)"))
    copied = tmp_path / "records"
    shutil.copytree(recorded / "records", copied)
    (path,) = copied.glob("alpha-*/core-*.lfrec")
    path.write_bytes(path.read_bytes()[:-20])
    ran = lfield("test", "--from", copied, other, cwd=tmp_path)
    assert ran.returncode == 1
    assert "incomplete" in ran.stderr
    same = write_mission(tmp_path, PROGRAM)
    ran = lfield("test", "--from", copied, same, cwd=tmp_path)
    assert ran.returncode == 0
    assert "which is incomplete" in ran.stdout


@pytest.mark.process
def test_a_recording_is_exported_to_mcap_and_csv(recorded: Path, tmp_path: Path) -> None:
    file, tables = tmp_path / "flight.mcap", tmp_path / "tables"
    ran = lfield("export", recorded / "records", "--mcap", file, "--csv", tables, cwd=tmp_path)
    assert (ran.returncode, ran.stderr) == (0, "")
    with file.open("rb") as stream:
        lines = [
            json.loads(message.data)["message"]
            for _, channel, message in make_reader(stream).iter_messages()
            if channel.topic == "/log"
        ]
    assert any("climbed 5.0" in line for line in lines)
    with (tables / "hops.csv").open(newline="") as table:
        hops = list(csv.DictReader(table))
    assert [(hop["agent"], hop["from"], hop["to"]) for hop in hops] == [("boss", "alpha", "bravo")]
    again = lfield("export", recorded / "records", "--mcap", file, cwd=tmp_path)
    assert again.returncode == 73
    assert lfield("export", recorded / "records", "--csv", tables, cwd=tmp_path).returncode == 73


@pytest.mark.few(0)
@pytest.mark.process
def test_a_failed_export_leaves_no_partial_file(recorded: Path, tmp_path: Path) -> None:
    code = (
        "import resource, sys; resource.setrlimit(resource.RLIMIT_FSIZE, (1000, 1000));"
        "from lfield.__main__ import main; sys.exit(main())"
    )
    command = [sys.executable, "-c", code, "export", str(recorded / "records"), "--csv", "tables"]
    ran = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=60)
    assert ran.returncode == 73
    assert not any((tmp_path / "tables").iterdir())
    (tmp_path / "used").mkdir()
    (tmp_path / "used" / "file").touch()
    ran = lfield("export", recorded / "records", "--mcap", "x.mcap", "--csv", "used", cwd=tmp_path)
    assert ran.returncode == 73
    assert not (tmp_path / "x.mcap").exists()


@pytest.mark.few(0)
@pytest.mark.process
def test_an_export_without_the_mcap_package_is_reported(recorded: Path, tmp_path: Path) -> None:
    code = "import sys; sys.modules['mcap'] = None; from lfield.__main__ import main; sys.exit(main())"
    command = [sys.executable, "-c", code, "export", str(recorded / "records"), "--mcap", "x.mcap"]
    ran = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=60)
    assert ran.returncode == 69
    assert not (tmp_path / "x.mcap").exists()


@pytest.mark.process
def test_a_debugger_at_a_port_in_use_is_reported(recorded: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as occupied:
        port = occupied.getsockname()[1]
        ran = lfield("debug", recorded / "records", "--dap", "--port", port, cwd=recorded)
    assert ran.returncode == 69
    assert f"127.0.0.1:{port}" in ran.stderr


@pytest.mark.process
def test_commands_of_the_page_after_a_bad_flight_run(recorded: Path, tmp_path: Path) -> None:
    """Run all commands of the page except the copies from robots and the web page, on this recording."""
    text = (ROOT / "lfield/docs/after-a-bad-flight.md").read_text(encoding="utf-8")
    shutil.copytree(recorded / "records", tmp_path / "flight")
    write_mission(tmp_path, PROGRAM)
    commands = re.findall(r"^\$ lfield (.*)$", text, re.MULTILINE)
    commands += re.findall(r"`lfield (test --from .*?)`", text)
    ran = {
        command: lfield(*command.split(), *PLAIN.get(command, ()), cwd=tmp_path)
        for command in commands
        if not command.startswith("watch")
    }
    assert len(ran) >= 5
    assert {command: made.returncode for command, made in ran.items()} == dict.fromkeys(ran, 0)
    moves = re.findall(r"^\(lfield\) (.*)$", text, re.MULTILINE)
    assert len(moves) >= 4
    names = {"lead.battery < 0.3": "one.battery < 2.0", "pilot": "boss"}
    for move in moves:
        for name, here in names.items():
            move = move.replace(name, here)
        made = lfield("debug", "flight", "-c", "hop boss", "-c", move, cwd=tmp_path)
        assert made.returncode == 0, made.stderr


def calls_of(recorded: Path, folder: Path, program: str) -> tuple[CallLog, CallLog]:
    """The calls of the recorded program, and of another one, with a low limit of computations."""
    recording = load_team([recorded / "records"])
    order = TeamOrder([part for each in recording.incarnations for part in each.parts])
    mission = mission_with(recording, load_mission(write_mission(folder, program), simulate=True))
    before = run_program(recording, order, recording.mission)
    return before, run_program(recording, order, mission, recorded=before)


@pytest.mark.few(2)
@pytest.mark.parametrize(
    ("replaced", "loop", "agent", "line"),
    [
        ("fc.takeoff(height);", "while (true) { }", "one", 7),
        ("fc.takeoff(height);", 'string s = ""; while (true) { s = "x" + i2s(1); }', "one", 7),
        ('sum = sum + findPost("two")', 'while (true) { } sum = sum + findPost("two")', "boss", 16),
        ('print("climbed', 'int n = 0; while (n >= 0) { n = n + 1; n = n - 1; } print("climbed', "boss", 17),
    ],
)
def test_an_endless_loop_is_a_difference_at_its_line(
    replaced: str, loop: str, agent: str, line: int, recorded: Path, tmp_path: Path, monkeypatch
) -> None:
    monkeypatch.setattr(computation_limit, "MAX_INSTRUCTIONS", MOST)
    before, now = calls_of(recorded, tmp_path, PROGRAM.replace(replaced, loop))
    found = before.first_difference(now)
    assert found is not None
    assert (found.agent, found.replayed.place) == (agent, f"mission.L:{line}")
    assert "computes on" in found.replayed.text
    assert now.count < before.count or agent == "boss"
    assert not now.may_follow(before)


def test_a_long_computation_that_ends_is_not_a_difference(
    recorded: Path, tmp_path: Path, monkeypatch
) -> None:
    monkeypatch.setattr(computation_limit, "MAX_INSTRUCTIONS", MOST)
    loop = "int n = 0; while (n < 2000) n = n + 1; fc.takeoff(height);"
    before, now = calls_of(recorded, tmp_path, PROGRAM.replace("fc.takeoff(height);", loop))
    assert before.first_difference(now) is None
    assert now.longest_computation < MOST
