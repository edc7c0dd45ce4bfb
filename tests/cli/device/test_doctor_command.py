"""`lfield doctor --deploy`: the answer of each endpoint, and the remedy for each silent one."""

from __future__ import annotations

import json

import pytest

from lfield.operator.diagnostics import DIAGNOSES

pytestmark = pytest.mark.process

PROGRAM = """
resource Copter { Mavlink fc; init(string[] arg) { while (true) yield(); } }
coordinator Nobody { init(string[] arg) { } }
"""
DEPLOYMENT = "//Copter:lead@alpha\n//Copter:wing@bravo\n//Nobody:one@alpha\n"


@pytest.fixture
def deployment(lfield):
    """Two copters on one link; only the first one answers."""
    arguments = ("--listen", "udp:127.0.0.1:0", "--set-up", "--until-stdin-closes")
    fake = lfield.start("sim", "mavlink", *arguments, stdin=True)
    endpoint = fake.wait_for(r"^ready (\S+)")[1]
    copter = f"driver: mavlink, endpoint: '{endpoint}', waivers: [device_watchdog]"
    devices = (
        f"silence: 2.0\nagents:\n  lead: {{devices: {{fc: {{{copter}, system: 1}}}}}}\n"
        f"  wing: {{devices: {{fc: {{{copter}, system: 9, connect: 3.0}}}}}}\n"
    )
    return lfield.mission(PROGRAM, DEPLOYMENT, devices)


def test_endpoints_are_reported_with_their_remedy(deployment, here):
    doctor = here("doctor", "--deploy", deployment, status=69)
    (found,) = [line for line in doctor.out if "lead.fc" in line]
    assert found.startswith("ok      lead.fc: ArduPilot copter, system 1 at udp:127.0.0.1:")
    (problem,) = [number for number, line in enumerate(doctor.out) if "wing.fc" in line]
    assert doctor.out[problem].startswith("PROBLEM wing.fc: ")
    assert "system 9" in doctor.out[problem]
    assert doctor.out[problem + 1] == "        -> check power, cable, endpoint and ids"


@pytest.mark.few(0)
def test_a_host_option_limits_the_report_to_its_devices(lfield, deployment):
    doctor = lfield("doctor", "--deploy", deployment, "--host", "alpha", status=0)
    assert any("ok      lead.fc" in line for line in doctor.out)
    assert not any("wing.fc" in line for line in doctor.out)
    unknown = lfield("doctor", "--deploy", deployment, "--host", "zulu")
    assert lfield.status(unknown) in (64, 65), unknown.said
    assert "zulu" in unknown.err[-1]


@pytest.mark.few(0)
def test_each_finding_as_json_has_its_code(lfield, deployment):
    doctor = lfield("doctor", "--deploy", deployment, "--json")
    assert (lfield.status(doctor), doctor.err) == (69, [])
    found = [json.loads(line) for line in doctor.out]
    assert all(each.keys() == {"code", "state", "message", "hint", "details"} for each in found)
    assert {each["code"] for each in found} <= DIAGNOSES.keys()
    endpoints = [(each["state"], each["hint"]) for each in found if each["code"] == "endpoint"]
    assert endpoints == [("ok", None), ("problem", "check power, cable, endpoint and ids")]


def test_without_a_deployment_only_this_computer_is_examined(lfield):
    doctor = lfield("doctor")
    assert any(line.startswith("ok      Python 3.") for line in doctor.out)
    assert any(line.startswith("ok      driver mavlink: Mavlink") for line in doctor.out)
    assert any("clock" in line for line in doctor.out)
