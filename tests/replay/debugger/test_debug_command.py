"""`lfield debug` on a deployment in virtual time, and on recordings in files."""

from __future__ import annotations

import io
import shutil
import socket
import sys
from pathlib import Path

import pytest
from debugger_recordings import EXAMPLES

from lfield import exit_status
from lfield.cli.main import main
from lfield.host.recording.recording_target import RecordingDirectory
from lfield.mission.loader import load_mission
from lfield.simulate.host_fleet import Fleet, FleetOptions

SERVER = str(EXAMPLES / "10-client-server" / "mission.dL")


def test_a_deployment_runs_in_virtual_time_and_is_debugged(capsys):
    status = main(["debug", SERVER, "--seconds", "5", "-c", "portal", "-c", "stack", "-c", "back portal"])
    assert status == exit_status.DONE
    assert "> 0" in capsys.readouterr().out


def test_commands_are_read_from_stdin_and_a_mistake_does_not_end_the_session(capsys, monkeypatch):
    monkeypatch.setattr(sys, "stdin", io.StringIO("dance\nportal\nwhere\nquit\nnever read\n"))
    assert main(["debug", SERVER, "--seconds", "5"]) == exit_status.DONE
    printed = capsys.readouterr()
    assert "dance" in printed.err
    assert "never" not in printed.err


@pytest.mark.parametrize(
    ("arguments", "status"),
    [
        ([], exit_status.USAGE),
        (["x", "--port", "1"], exit_status.USAGE),
        ([SERVER, "y"], exit_status.USAGE),
        ([SERVER, "--seconds", "1", "-c", "dance"], exit_status.USAGE),
        (["missing"], exit_status.NO_INPUT),
        (["missing.dL"], exit_status.NO_INPUT),
    ],
)
def test_bad_arguments_have_their_exit_statuses(arguments, status, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(["debug", *arguments]) == status


def test_an_empty_directory_is_refused_as_recording(tmp_path):
    assert main(["debug", str(tmp_path)]) == exit_status.DATA


def test_a_port_in_use_has_the_status_unavailable():
    with socket.create_server(("127.0.0.1", 0)) as other:
        assert main(["debug", "--dap", "--port", str(other.getsockname()[1])]) == exit_status.UNAVAILABLE


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Recordings of two hosts in files."""
    folder = tmp_path_factory.mktemp("recorded")
    mission = load_mission(Path(SERVER))
    fleet = Fleet(mission, options=FleetOptions(record=RecordingDirectory(folder, 1 << 20)))
    fleet.run(4.0)
    for name in list(fleet.runs):
        fleet.stop(name)
    fleet.run(2.0)
    fleet.close()
    return folder


def test_recordings_in_files_are_debugged(recorded, capsys):
    assert main(["debug", str(recorded), "-c", "end", "-c", "back hop", "-c", "where"]) == exit_status.DONE
    printed = capsys.readouterr()
    assert "input received" in printed.out
    assert not printed.err


def test_missing_hosts_are_named_and_a_cut_file_is_debugged(recorded, tmp_path, capsys):
    folders = sorted(path for path in recorded.iterdir() if path.is_dir())
    recording = tmp_path / folders[0].name
    shutil.copytree(folders[0], recording)
    file = next(recording.glob("core-*.lfrec"))
    file.write_bytes(file.read_bytes()[: file.stat().st_size * 2 // 3])
    assert main(["debug", str(recording), "-c", "end", "-c", "back step", "-c", "where"]) == exit_status.DONE
    error = capsys.readouterr().err
    assert "no recording of" in error
    assert file.name in error
