"""The kit against fakes of both autopilots, as `lfield kit mavlink` runs it."""

from __future__ import annotations

import json
import subprocess
import sys

import pytest

pytestmark = pytest.mark.process


def lfield(*words):
    return [sys.executable, "-m", "lfield", *words]


@pytest.fixture(params=[("ardupilot", "copter"), ("px4", "copter"), ("ardupilot", "rover")], ids="-".join)
def fake(request):
    flavour, kind = request.param
    command = lfield("sim", "mavlink", "--listen", "tcp:127.0.0.1:0", "--flavour", flavour, "--kind", kind)
    sim = subprocess.Popen(
        [*command, "--until-stdin-closes"], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    try:
        yield kind, sim.stdout.readline().split()[1]
    finally:
        sim.stdin.close()
        sim.wait(timeout=20)
        sim.stdout.close()


def test_no_check_fails(fake):
    kind, endpoint = fake
    limits = "limits={speed: 3, altitude: 20, radius: 50}"
    words = ["--endpoint", endpoint, "--set", "ttl=1.5", "--set", f"kind={kind}", "--set", limits]
    ended = subprocess.run(
        lfield("kit", "mavlink", *words, "--yes", "--json"), capture_output=True, text=True, timeout=110
    )
    findings = [json.loads(line) for line in ended.stdout.splitlines()]
    assert [f for f in findings if f["outcome"] == "failed"] == [], ended.stderr
    assert sum(f["outcome"] == "passed" for f in findings) >= 15
    assert ended.returncode == 0
