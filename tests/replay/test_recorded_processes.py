"""Recordings of real processes: a killed host, a folder that cannot be used, modes of files."""

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

from lfield.replay.recording_files import load_team

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
DEPLOYMENT = "//Post:north@north\n//Post:south@south\n//Walker:walker@north\n"
#: A killed process loses at most so many seconds.
MAX_LOSS = 1.0


def start(folder: Path, rounds: int, *options: str) -> subprocess.Popen[str]:
    (folder / "mission.L").write_text(WALKER.replace("//rounds", str(rounds)))
    (folder / "mission.dL").write_text(DEPLOYMENT)
    command = [sys.executable, "-m", "lfield", "up", "mission.dL", "--all", *options]
    return subprocess.Popen(command, cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)


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
    ran = subprocess.run(
        [sys.executable, "-m", "lfield", "replay", "records", "--json"],
        cwd=tmp_path, capture_output=True, text=True, timeout=60,
    )  # fmt: skip
    found = json.loads(ran.stdout)
    assert (ran.returncode, found["differences"]) == (0, 0)
    assert found["digests"] > 20
    assert any("did not end in order" in problem for problem in found["problems"])


def test_a_mission_goes_on_without_the_folder_of_its_recording(tmp_path: Path) -> None:
    (tmp_path / "records").write_text("no folder")
    running = start(tmp_path, 20, "--record", "records", "--until-done")
    output, _ = running.communicate(timeout=60)
    assert running.returncode == 0, output
    assert len(re.findall(r"the recording of (north|south) ended: ", output)) == 2
