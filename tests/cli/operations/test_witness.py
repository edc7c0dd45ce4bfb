"""A host without agents is a member of a team of real processes."""

from __future__ import annotations

import json

import pytest

pytestmark = pytest.mark.process

PROGRAM = """
resource Post { init(string[] arg) { } portal stay() { write("stays\\n"); sleep(1000.0); } }
coordinator Guest { init(string[] arg) { heartbeatInterval(5); findPost("post").stay(); } }
"""
DEPLOYMENT = "//Guest:tom@alpha\n//Post:post@bravo\n//@ground\n"


def test_a_witness_runs_and_is_shown(lfield, here):
    deployment = lfield.mission(PROGRAM, DEPLOYMENT)
    checked = here("check", deployment)
    assert (checked.status, checked.err) == (0, [])
    team = lfield.start("up", "--deploy", deployment, "--all")
    team.wait_for(r"bravo +\| stays")
    # The coordinator does not need this host, so it may migrate before these links are established.
    for host in ("alpha", "bravo"):
        team.wait_for(rf"ground +\| link to {host} established")
    output = here("ps", "--deploy", deployment, status=0)
    assert any(line.split() == ["ground", "-", "up,", "no", "agents"] for line in output.out), output.said
    hosts = json.loads("\n".join(here("ps", "--deploy", deployment, "--json").out))
    assert (hosts["ground"]["agents"], hosts["ground"]["linked"]) == ([], ["alpha", "bravo"])


def test_a_bundle_has_its_witness(lfield, here):
    deployment = lfield.mission(PROGRAM, DEPLOYMENT)
    here("build", deployment, status=0)
    output = here("inspect", "mission.lfm")
    assert any(
        line.startswith("host ground at ground:") and line.endswith(", a witness") for line in output.out
    )
    assert "recovery of tom by a lease of 2 s among alpha, bravo and ground" in output.out
