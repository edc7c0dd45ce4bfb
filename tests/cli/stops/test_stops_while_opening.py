"""Hosts that end while they open their devices: commanded devices are named, devices only queried are not."""

from __future__ import annotations

import signal
import time

import pytest
from copter_flight import PROGRAM, copter, devices

pytestmark = pytest.mark.process


def bound_nowhere(lfield, port: int, lead: str = "") -> tuple[object, ...]:
    """The arguments of `up` for two copters: one at `lead`, one at an endpoint without an answer."""
    program = PROGRAM.replace("fc.arm(); fc.takeoff(3.0);", "")
    endpoints = f"udp:127.0.0.1:{port}"
    bound = devices({"lead": lead, "wing": endpoints} if lead else {"wing": endpoints}, 2.0)
    agents = ["//Copter:wing@alpha", *(["//Copter:lead@alpha"] if lead else [])]
    deployment = lfield.mission(program, "".join(f"{agent}\n" for agent in agents), bound)
    return ("up", "--deploy", deployment, *lfield.maps(["alpha"]), "--host", "alpha")


@pytest.mark.few(0)
def test_a_device_that_was_only_queried_is_not_reported_unsafe(lfield, alone):
    (port,) = lfield.ports.take(1)
    host = lfield.start(*bound_nowhere(lfield, port), env=alone)
    while not lfield.guards():
        time.sleep(0.02)
    host.signal(signal.SIGTERM)
    assert host.wait() == 0, host.said
    assert "NOT SAFE" not in host.said


@pytest.mark.few(0)
def test_a_team_with_a_missing_port_ends_with_69_and_names_it(lfield, alone):
    """The other hosts are stopped while they wait for their devices: no device was commanded."""
    ports = lfield.ports.take(2)
    endpoints = {f"copter{n}": f"udp:127.0.0.1:{port}" for n, port in enumerate(ports)}
    bound = devices({"lead": "serial:/none:57600", **endpoints}, 2.0)
    agents = "".join(f"//Copter:{name}@{name}\n" for name in ("lead", *endpoints))
    program = PROGRAM.replace("fc.arm(); fc.takeoff(3.0);", "")
    deployment = lfield.mission(program, agents, bound)
    team = lfield("up", deployment, "--all", "--until-done", env=alone, status=69)
    assert "lead.fc: cannot open serial:/none" in team.said
    assert "NOT SAFE" not in team.said


@pytest.mark.few(0)
def test_a_device_silent_while_another_cannot_be_opened_is_named(lfield, alone):
    endpoint = copter(lfield, alone)
    (port,) = lfield.ports.take(1)
    host = lfield.start(*bound_nowhere(lfield, port, endpoint), env=alone)
    host.wait_for("lead.fc link opened: ArduPilot copter")
    lfield("sim", "fault", "mavlink", "silence=true", env=alone, status=0)
    assert host.wait() == 3, host.said
    assert any(line.startswith("lead.fc NOT SAFE: ") for line in host.err), host.said
    assert "no heartbeat from system 1" in host.said
