"""Recordings of real processes: a killed host, an unusable folder, file modes."""

from __future__ import annotations

import json
import os
import re
import signal
import stat
import subprocess
import sys
import time
from pathlib import Path

import pytest

from lfield.recording.folders import CORE_SHARE
from lfield.replay.recording_files import load_team
from lfield.replay.team_check import check_guards, check_team
from lfield.testing.driver_bench import running_fake

pytestmark = pytest.mark.process

WALKER = """
resource Post {
    init(string[] arg) { }
    portal visit(int number) emit int { return number + 1; }
}
coordinator Walker {
    init(string[] arg) {
        int number = 0;
        while (number < //rounds) {
            number = findPost("north").visit(number);
            number = findPost("south").visit(number);
            if (number % 20 == 0) print("at " + i2s(number));
            sleep(0.02);
        }
    }
}
"""
#: A coordinator with 8 kB of new random numbers in each hop, which compression does not make small.
CARRIER = """
resource Post {
    init(string[] arg) { }
    portal visit() { }
}
coordinator Walker {
    init(string[] arg) {
        int[] load = new int[1000];
        int word = 12345;
        for (int hop = 0; hop < 400; hop = hop + 1) {
            for (int i = 0; i < load.length(); i = i + 1) {
                word = word * 16807 % 2147483647;
                load[i] = word;
            }
            if (hop % 2 == 0) findPost("south").visit(); else findPost("north").visit();
        }
        print(load[0]);
    }
}
"""
AXIS = """
resource Winch {
    CanAxis axis;
    init(string[] arg) { }
    portal start() {
        axis.enable();
        print("enabled");
    }
}
coordinator Boss {
    init(string[] arg) { findWinch("winch").start(); }
}
"""
DEPLOYMENT = "//Post:north@north\n//Post:south@south\n//Walker:walker@north\n"
#: The most seconds that a killed process loses.
MAX_LOSS = 1.0


def start(folder: Path, rounds: int, *options: str, program: str = WALKER) -> subprocess.Popen[str]:
    (folder / "mission.L").write_text(program.replace("//rounds", str(rounds)))
    (folder / "mission.dL").write_text(DEPLOYMENT)
    command = [sys.executable, "-m", "lfield", "up", "mission.dL", "--all", *options]
    return subprocess.Popen(command, cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)


def run(*arguments: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "lfield", *arguments]
    return subprocess.run(command, cwd=cwd, capture_output=True, text=True, timeout=60)


def host_process(parent: int, host: str) -> int:
    """The process of a host, by its command line."""
    for children in Path(f"/proc/{parent}/task/{parent}/children").read_text().split():
        arguments = Path(f"/proc/{children}/cmdline").read_bytes().split(b"\0")
        if f"--host={host}".encode() in arguments:
            return int(children)
    raise AssertionError(f"{host} does not run")


def test_a_killed_host_loses_at_most_a_second(tmp_path: Path) -> None:
    running = start(tmp_path, 1_000_000, "--record", "records")
    assert running.stdout is not None
    for line in running.stdout:
        if re.search(r"at 40$", line.rstrip()):
            break
    killed = host_process(running.pid, "south")
    at = time.time()
    os.kill(killed, signal.SIGKILL)
    running.send_signal(signal.SIGINT)
    running.communicate(timeout=60)
    team = load_team([tmp_path / "records"])
    ends = {}
    for each in team.incarnations:
        part = each.parts[-1]
        ends[each.host] = part.start.wall + part.ended_at - part.start.at
        for path in (each.folder, *each.folder.iterdir()):
            assert not stat.S_IMODE(path.stat().st_mode) & (stat.S_IRWXG | stat.S_IRWXO), path
            if path.is_file():
                assert b"PRIVATE KEY" not in path.read_bytes()
    assert at - MAX_LOSS <= ends["south"] <= at + 0.1
    ran = run("replay", "records", "--json", cwd=tmp_path)
    found = json.loads(ran.stdout)
    assert (ran.returncode, found["differences"]) == (0, 0)
    assert found["digests"] > 20
    assert any("did not end in order" in problem for problem in found["problems"])


@pytest.mark.few(0)
def test_a_mission_continues_without_the_folder_of_its_recording(tmp_path: Path) -> None:
    (tmp_path / "records").write_text("no folder")
    running = start(tmp_path, 20, "--record", "records", "--until-done")
    output, _ = running.communicate(timeout=60)
    assert running.returncode == 0, output
    assert len(re.findall(r"the recording of (north|south) ended: ", output)) == 2


@pytest.mark.few(0)
def test_a_recording_stays_within_its_limit_and_the_rest_is_replayed(tmp_path: Path) -> None:
    running = start(
        tmp_path, 0, "--record", "records", "--record-limit", "1", "--until-done", program=CARRIER
    )
    output, _ = running.communicate(timeout=60)
    assert running.returncode == 0, output
    team = load_team([tmp_path / "records"])
    assert len(team.incarnations) == 2
    for each in team.incarnations:
        files = sorted(each.folder.glob("core-*.lfrec"))
        assert files[0].name != "core-000001.lfrec"
        assert sum(path.stat().st_size for path in files) <= CORE_SHARE * (1 << 20)
        assert not each.parts[0].is_from_start
    found = check_team(team)
    assert (found.differences, found.first) == (0, None)
    assert found.digests > 20


@pytest.mark.few(0)
@pytest.mark.parametrize("options", [(), ("--no-record",)])
def test_on_hardware_a_recording_is_the_default(tmp_path: Path, options: tuple[str, ...]) -> None:
    """The device is simulated, but lfield does not detect it: the driver reaches it over a real bus."""
    (tmp_path / "mission.L").write_text(AXIS)
    (tmp_path / "mission.dL").write_text("//Winch:winch@here\n//Boss:boss@here\n")
    arguments = ("up", "mission.dL", "--all", "--state", "state", "--until-done", *options)
    with running_fake("can", "--device", "odrive:3") as fake:
        (tmp_path / "mission.devices.yaml").write_text(
            "agents: {winch: {devices: {axis: {driver: can, protocol: odrive, node: 3, "
            f'endpoint: "{fake.endpoint}", waivers: [no_homing, device_watchdog]}}}}}}}}\n'
        )
        ran = run(*arguments, cwd=tmp_path)
    assert ran.returncode == 0, ran.stdout + ran.stderr
    assert "enabled" in ran.stderr
    records = tmp_path / "state/recordings"
    assert records.exists() is not bool(options)
    if options:
        return
    team = load_team([records])
    (results, problems) = check_guards(team)
    assert ([each.differences for each in results], problems) == ([0], [])
    assert check_team(team).differences == 0
    (folder,) = (each.folder for each in team.incarnations)
    assert list(folder.glob("guard-winch.axis/wire-*.candump.log"))
