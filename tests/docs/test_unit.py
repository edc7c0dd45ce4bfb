"""The unit of deploy restarts what goes on by itself, and nothing else."""

from __future__ import annotations

import shlex
from configparser import RawConfigParser

from document_blocks import ROOT
from document_checks import understand

from lfield import exit_status
from lfield.driver.binding import longest_rest
from lfield.mission.loader import load_mission

#: A host that ended so may find it mended at the next start, or goes on from what it has kept.
AGAIN = {exit_status.UNAVAILABLE, exit_status.SOFTWARE, exit_status.INPUT_OUTPUT}


def unit() -> RawConfigParser:
    # Lists are written in several lines of one key.
    read = RawConfigParser(strict=False)
    read.optionxform = str  # type: ignore[assignment, method-assign]
    read.read(ROOT / "deploy/lfield@.service")
    return read


def test_only_what_a_restart_may_mend_is_restarted():
    service = unit()["Service"]
    assert service["Restart"] == "on-failure"
    every = {value for name, value in vars(exit_status).items() if name.isupper() and isinstance(value, int)}
    kept_down = {int(word) for word in service["RestartPreventExitStatus"].split()}
    assert kept_down == every - AGAIN - {exit_status.DONE}


def test_restarts_that_do_not_help_come_to_an_end():
    """Each takes a start at least, which is a second, and the pause between two."""
    section = unit()["Unit"]
    pauses = int(section["StartLimitBurst"]) * (1.0 + float(unit()["Service"]["RestartSec"]))
    assert pauses < float(section["StartLimitIntervalSec"])


def test_the_journals_have_a_folder_and_the_devices_time_to_come_to_rest():
    service = unit()["Service"]
    assert service["StateDirectory"] == "lfield"
    mission = load_mission(
        ROOT / "deploy/two-copters/mission.dL", program=ROOT / "examples/01-first-flight/mission.L"
    )
    assert float(service["TimeoutStopSec"]) > longest_rest(mission.bindings.all)


def test_the_command_of_the_unit_is_one():
    lines = (ROOT / "deploy/lfield.env").read_text(encoding="utf-8").splitlines()
    given = dict(line.split("=", 1) for line in lines if line and not line.startswith("#"))
    command = shlex.split(unit()["Service"]["ExecStart"])
    words = [given["LFIELD_MISSION"] if word == "${LFIELD_MISSION}" else word for word in command[1:]]
    where = words.index("$LFIELD_OPTIONS")
    words[where : where + 1] = given["LFIELD_OPTIONS"].split()
    understand(" ".join(words).replace("%i", "alpha"))
