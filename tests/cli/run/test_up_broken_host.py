"""An internal error of the host while its vehicle flies: the host reports it and ends, the vehicle lands."""

from __future__ import annotations

import asyncio
import json
import os
import signal
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

from lfield import exit_status
from lfield.cli.run import up_all
from lfield.text import log_messages
from lfield.text.log_messages import json_line

EXAMPLES = Path(__file__).parents[3] / "examples"


PROGRAM = """
include <mavlink/copter.L>;
coordinator Pilot {
    init(string[] arg) {
        Copter copter = findCopter(arg[1]);
        copter.takeOff(3.0);
        print("in the air");
        while (true) sleep(1.0);
    }
}
"""
#: Loaded at the start of Python: the host's core fails soon after the line of the coordinator.
BROKEN = """
import lfield.host.core as core
import lfield.host.team.host_services as world
import os

going_on, air = core.HostCore.run, []

def run(self):
    if air:
        raise ZeroDivisionError("planted")
    return going_on(self)

say = world.HostServices.log

def log(self, agent, text):
    air.append(text)
    say(self, agent, text)

core.HostCore.run, world.HostServices.log = run, log
"""


@pytest.mark.few(0)
def test_a_host_with_an_internal_error_ends_with_70_and_its_copter_lands(lfield):
    deployment = lfield.mission(PROGRAM, "//Copter:lead@alpha\n//Pilot:pilot@alpha?lead\n", "silence: 2\n")
    lfield.write("broken/sitecustomize.py", BROKEN)
    path = {"PYTHONPATH": str(lfield.folder / "broken")}
    arguments = ("up", "--deploy", deployment, "--host", "alpha", "--sim", *lfield.maps(["alpha"]))
    host = lfield.start(*arguments, env=path)
    status = host.wait()
    assert status == 70, host.said
    assert "alpha stopped: bug in lfield: ZeroDivisionError: planted" in host.said
    assert "lead.fc in safe state 'land'" in host.said


@pytest.mark.few(0)
def test_guards_of_a_killed_host_log_json_lines_with_its_name(lfield):
    deployment = EXAMPLES / "01-first-flight" / "mission.dL"
    team = lfield.start("up", "--deploy", deployment, "--all", "--sim", "--until-done", "--json")
    team.wait_for("wing: at ")
    os.kill(lfield.child("bravo"), signal.SIGKILL)
    assert team.wait() == 3
    lines = [json.loads(line) for line in team.out]
    codes = {line["code"] for line in lines if line["host"] == "bravo"}
    assert "host-killed" in codes
    # The fake of the device ends with the host: the guard reports the lost link.
    assert codes & {"mavlink-link-lost", "endpoint-lost"}, codes
    assert ("device-safe" in codes) != ("device-unconfirmed" in codes)
    assert not any("wing.fc" in line for line in team.err)


@pytest.mark.parametrize("as_json", [False, True])
@pytest.mark.parametrize("is_confirmed", [True, False])
def test_a_confirmation_of_the_guard_replaces_the_line_of_the_launcher(
    as_json, is_confirmed, capsys, monkeypatch
):
    """The exit status is always that of an unsafe device: a device in its safe state may still move."""
    monkeypatch.setattr(up_all, "CONFIRMATION_TIMEOUT", 5.0 if is_confirmed else 0.0)
    device = SimpleNamespace(name="lead.fc", is_sensor=False)
    launcher = object.__new__(up_all._HostProcesses)
    launcher.args, launcher.view, launcher.width = SimpleNamespace(json=as_json), None, 5
    launcher.mission = SimpleNamespace(devices_of=lambda host: [device])
    launcher.confirmed, launcher.killed = {"alpha": {}}, {}
    safe = log_messages.DEVICE_SAFE.line(device="lead.fc", state="land", reason="the host is gone")

    async def killed() -> int:
        launcher.guard_reported = asyncio.Event()
        waiting = asyncio.create_task(launcher.signal_status(signal.SIGKILL, "alpha"))
        await asyncio.sleep(0)
        stderr = asyncio.StreamReader()
        stderr.feed_data(json_line(1.0, "alpha", safe).encode() if is_confirmed else b"a vendor library\n")
        stderr.feed_eof()
        await launcher.pass_on("alpha", stderr, sys.stderr)
        return await waiting

    assert asyncio.run(killed()) == exit_status.UNSAFE
    unconfirmed = "lead.fc safe state not confirmed: host killed (SIGKILL)"
    assert launcher.killed == {"alpha": f"alpha killed (SIGKILL); {safe if is_confirmed else unconfirmed}"}
    out, err = capsys.readouterr()
    if as_json:
        lines = [json.loads(line) for line in out.splitlines()]
        codes = ["host-killed", "device-safe" if is_confirmed else "device-unconfirmed"]
        assert [(line["host"], line["code"]) for line in lines] == [("alpha", code) for code in codes]
        assert err.splitlines() == ([] if is_confirmed else ["alpha | a vendor library"])
    else:
        assert out == ""
        assert err.splitlines()[-1] == f"alpha | {safe if is_confirmed else unconfirmed}"
