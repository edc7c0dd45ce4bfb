"""The hold of a vote without a result and an operator's pause, with real processes: they are independent."""

from __future__ import annotations

import argparse
import asyncio

import pytest
from robots import told

from lfield.cli.fleet.desk import open_desk
from lfield.operator.fleet.activation import new_ballot
from lfield.wire.service_messages import BallotState, Proposal

pytestmark = pytest.mark.process

PROGRAM = """
resource Post { init(string[] arg) { } portal visit() { TEXT } }
coordinator Walker { init(string[] arg) { sleep(1000.0); findPost(arg[1]).visit(); } }
"""
TEAM = "//Post:post@alpha\n//Post:other@bravo\n//Walker:tom@carol?post\n"


def vote_of_alpha(digest: str) -> BallotState:
    """Propose to all; the operator's program ends after the vote of alpha."""
    desk = open_desk(argparse.Namespace(inventory=None, keys=None))

    async def propose() -> BallotState:
        links = desk.links(["alpha"])
        try:
            ballot = new_ballot(bytes.fromhex(digest), desk.hosts, desk.user)
            return await links.ask("alpha", Proposal(ballot), BallotState, 60.0, 60.0)
        finally:
            links.close()

    return asyncio.run(propose())


@pytest.mark.few(0)
def test_a_resume_does_not_end_the_hold_and_the_end_of_the_hold_no_pause(lfield, here, robots) -> None:
    team = robots("alpha", "bravo", "carol")
    team.up()
    lfield.mission(PROGRAM.replace("TEXT", 'write("2");'), TEAM, name="second")
    second = told(here("push", "second.dL", "--stage", "--json"))["bundle"]
    lfield.mission(PROGRAM.replace("TEXT", 'write("1");'), TEAM, name="first")
    assert told(here("push", "first.dL", "--json"))["outcome"] == "activated"
    here("start", status=0)
    team.kill("bravo")

    def reason() -> str:
        return str(told(here("status", "alpha", "--json"))["alpha"]["run"]["reason"])

    assert vote_of_alpha(second).outcome == "open"
    assert "held" in reason()
    # Both survive a restart of the service.
    team.kill("alpha")
    team.up("alpha")
    here("pause", "first.dL", status=0)
    here("resume", "first.dL", status=69)
    assert ("held" in reason(), "paused" in reason()) == (True, False)
    here("pause", "first.dL", status=0)
    here("rollback", "--lost", "bravo", status=0)
    while "held" in reason():
        pass
    assert "paused" in reason()
    here("resume", "first.dL", status=0)
    assert reason() == ""
