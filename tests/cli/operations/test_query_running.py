"""`lfield query` for a running team."""

from __future__ import annotations

import json

import pytest

pytestmark = pytest.mark.process

PROGRAM = """
resource Hoist {
    init(string[] arg) { write("ready\\n"); while (true) yield(); }
    portal lift(real height) emit real { return height; }
    portal lower(real height) emit real { return height; }
}
coordinator Boss {
    init(string[] arg) {
        Lift[] who = findLift("payload >= 2.0");
        print("offers: " + i2s(who.length()));
        while (true) sleep(1.0);
    }
}
"""
DEPLOYMENT = "//Hoist:arm1@alpha\n//Hoist:arm2@bravo\n//Boss:boss@alpha\n"
CAPABILITIES = """
registry: 1
providers: {Hoist: {attributes: {payload: 20.0}, serves: {Lift: {}}}}
agents: {arm2: {payload: 1.2}}
"""


@pytest.fixture(scope="module")
def mission(shared_lfield):
    """A team with a coordinator that has also queried."""
    shared_lfield.write("mission.capabilities.yaml", CAPABILITIES)
    deployment = shared_lfield.mission(PROGRAM, DEPLOYMENT)
    team = shared_lfield.start("up", "--deploy", deployment, "--all")
    # The coordinator may query before the other host is up.
    team.wait_for(r"bravo +\| ready")
    team.wait_for(r"boss: offers: 1")
    team.deployment = deployment
    return team


def test_the_running_team_answers(mission, here):
    output = here("query", "Lift where payload >= 2.0", "--deploy", mission.deployment, "--explain", status=0)
    assert output.out[0] == "from the running team: 2 of 2 hosts answered"
    assert output.out[4].split()[:4] == ["1", "arm1", "alpha", "direct"]
    assert "  arm2: payload 1.2 < 2.0" in output.out


def test_the_running_team_answers_as_json(mission, here):
    output = here("query", "Lift", "--deploy", mission.deployment, "--json", "--at", "bravo")
    document = json.loads("\n".join(output.out))
    assert (document["source"], document["answered"], document["silent"]) == ("team", ["alpha", "bravo"], {})
    assert {offer["agent"] for offer in document["capabilities"][0]["offers"]} == {"arm1", "arm2"}


@pytest.mark.few(0)
def test_a_silent_host_is_named(mission, lfield, here):
    (map_, place) = lfield.maps(["bravo"])
    output = here("query", "Lift", "--deploy", mission.deployment, map_, place, status=0)
    assert output.out[0] == "from the running team: 1 of 2 hosts answered"
    assert [line.partition(":")[0] for line in output.err] == ["bravo"]


@pytest.mark.few(0)
def test_without_a_running_team_the_files_answer(mission, lfield, here):
    maps = lfield.maps(["alpha", "bravo"])
    output = here("query", "Lift", "--deploy", mission.deployment, *maps, status=0)
    assert output.out[0] == "from the files: nothing is running, live attributes are unknown"
    assert output.err == []
