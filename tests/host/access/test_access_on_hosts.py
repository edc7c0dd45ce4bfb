"""Access rules on real hosts: hidden offers, refused calls, and hosts with other rules."""

from __future__ import annotations

import asyncio
from types import SimpleNamespace

import pytest

CRANES = """
resource Crane {
    string id;
    init(string[] arg) { id = arg[0]; }
    portal hoist(real height) emit real { print(id + " hoists"); return height; }
    portal sink(real height) emit real { print(id + " sinks"); return height; }
}
"""
CAPABILITIES = """
registry: 1
providers:
  Crane:
    attributes: {payload: 50.0}
    serves: {Lift: {portals: {lift: hoist, lower: sink}}}
"""
TWO_HOSTS = "//Crane:near@alpha\n//Foreman:foreman@alpha\n//Crane:far@bravo\n//Foreman:guest@bravo?idle\n"
IDLE = CRANES + "coordinator Foreman { init(string[] arg) { Lift[] who = findLift(); sleep(1000.0); } }"
RULES = """\
coordinators:
  guest:
    Crane: [hoist]
    near: all
"""
FOREMAN, GUEST = SimpleNamespace(id="foreman"), SimpleNamespace(id="guest")


async def up(team, program: str, access: str = RULES, **options):
    """alpha and bravo with the rules, linked."""
    mission = team.mission(program, TWO_HOSTS, capabilities=CAPABILITIES, access=access)
    hosts = [team.make(mission, name, **options) for name in ("alpha", "bravo")]
    await asyncio.gather(*(running.host.start() for running in hosts))
    await team.until(lambda: hosts[0].host.peers.incarnations and hosts[1].host.peers.incarnations)
    return hosts


async def test_a_forbidden_agent_is_not_offered_and_is_explained(team, /):
    alpha, _ = await up(team, IDLE)
    world = alpha.host.core.services
    for _ in range(2):
        # One host answers both in turn: each receives its own offers.
        assert [found.agent for found in world.offers(FOREMAN, "Lift", None)] == ["near", "far"]
        assert [found.agent for found in world.offers(GUEST, "Lift", None)] == ["near"]
    assert world.teams(GUEST, "Lift", None, 2) == []
    assert world.explain(GUEST, "Lift", None) == (
        "there is 1 offer, by 1 agent\n"
        "far: guest may not call far.sink(): mission.access.yaml:3 allows hoist() of far only"
    )
    assert "may not" not in world.explain(FOREMAN, "Lift", None)
    # An observer calls no portals, so it sees all agents.
    assert [entry.refusal for entry in alpha.host.status().directory] == ["", ""]


CALLS = """
coordinator Foreman {
    init(string[] arg) {
        Crane[] all = findCrane();
        if (arg.length() == 2) { sleep(1000.0); }
        try { all[1].sink(1.0); } catch (AccessException e) { print(e.source() + ": " + e.message()); }
        try { together { all[0].sink(1.0); all[1].sink(2.0); } }
        catch (AccessException e) { print("together: " + e.source()); }
        all[1].hoist(1.0);
        print("through, " + i2s(hops()));
        sleep(1000.0);
    }
}
"""


@pytest.mark.parametrize("keeps", [False, True])
async def test_a_forbidden_call_begins_on_no_host(team, /, keeps):
    hosts = await up(team, CRANES + CALLS, RULES.replace("guest:", "foreman:"), keeps=keeps)
    log = lambda: "".join(running.log for running in hosts)  # noqa: E731
    await team.until(lambda: "through" in log())
    refused = "foreman may not call far.sink(): mission.access.yaml:3 allows hoist() of far only"
    assert f"far: {refused}" in log()
    assert "together: far" in log()
    assert log().count("near sinks") == log().count("far hoists") == 1
    assert "far sinks" not in log()


async def test_an_uncaught_refusal_ends_its_coordinator_with_the_rule_in_its_report(team, /):
    program = CRANES + 'coordinator Foreman { init(string[] arg) { findCrane("far").sink(1.0); } }'

    hosts = await up(team, program)
    await team.until(lambda: "guest died" in hosts[1].log)
    assert "AccessException: guest may not call far.sink(): mission.access.yaml:3" in hosts[1].log
    assert hosts[1].log.count("far sinks") == 1


@pytest.mark.parametrize("theirs", ["", RULES.replace("[hoist]", "all")])
async def test_hosts_with_different_access_rules_do_not_link(team, /, theirs):
    other = team.mission(IDLE, TWO_HOSTS, capabilities=CAPABILITIES, access=theirs)
    mission = team.mission(IDLE, TWO_HOSTS, capabilities=CAPABILITIES, access=RULES)
    (bravo,) = await team.up(other, "bravo")
    (alpha,) = await team.up(mission, "alpha")
    text = "start both from the same .access.yaml file, or from one bundle"
    await team.until(lambda: text in alpha.log and text in bravo.log)
    digest = other.access.digest.hex()[:12] or "(none)"
    assert f"bravo has access rules {digest};" in alpha.log.replace(" and alpha", ";")
