"""Hosts that must not talk: both say why, in one sentence."""

from __future__ import annotations

import asyncio

PROGRAM = """
resource Echo {
    init(string[] arg) { }
    portal say() { write("here\\n"); }
}
coordinator Caller {
    init(string[] arg) { findEcho(arg[1]).say(); }
}
"""
DEPLOYMENT = "//Caller:tom@alpha?echo\n//Echo:echo@bravo\n"


def _told(running, words):
    return [line for line in running.log.splitlines() if words in line]


async def _stays_refused(team, alpha, bravo, words):
    await team.until(lambda: _told(alpha, words) and _told(bravo, words))
    assert len(_told(alpha, words)) == 1
    await asyncio.sleep(5.0)
    assert len(_told(alpha, words)) == 1, "told once, however often it is tried"
    assert bravo.output == []


def test_hosts_of_two_programs(fleet):
    async def story(team):
        (bravo,) = await team.up(team.mission(PROGRAM.replace("here", "there"), DEPLOYMENT), "bravo")
        (alpha,) = await team.up(team.mission(PROGRAM, DEPLOYMENT), "alpha")
        await _stays_refused(team, alpha, bravo, "start both from the same program file")
        assert "cannot talk to bravo" in alpha.log

    fleet(story)


def test_hosts_of_two_deployments(fleet):
    async def story(team):
        (bravo,) = await team.up(team.mission(PROGRAM, DEPLOYMENT + "//Echo:more@alpha\n"), "bravo")
        (alpha,) = await team.up(team.mission(PROGRAM, DEPLOYMENT), "alpha")
        await _stays_refused(team, alpha, bravo, "start both from the same .dL file")

    fleet(story)


def test_a_wrong_address_leads_to_another_host(fleet):
    async def story(team):
        mission = team.mission(PROGRAM, DEPLOYMENT + "//Echo:third@carol\n")
        (carol,) = await team.up(mission, "carol", address="bravo:8181")
        (alpha,) = await team.up(mission, "alpha", unreachable_after=3.0)
        await team.until(lambda: _told(alpha, "carol answered at the address of bravo"))
        assert _told(carol, "correct the address or the --map")
        assert await team.ended("tom") == "died"

    fleet(story)


def test_a_second_host_with_the_same_name_is_refused_and_the_first_goes_on(fleet):
    async def story(team):
        mission = team.mission(PROGRAM.replace("findEcho", "sleep(30.0); findEcho"), DEPLOYMENT)
        alpha, bravo = await team.up(mission)
        (second,) = await team.up(mission, "alpha", address="elsewhere:8181")
        words = "bravo already has a link to another alpha"
        await team.until(lambda: _told(second, words) and _told(bravo, words))
        assert await team.ended("tom") == "done"
        assert bravo.output.count("here") == 1
        assert not _told(alpha, words)

    fleet(story)


class EagerTransport:
    """Hands out what has come on a new link before its caller gets its turn, as TCP may."""

    def __init__(self, network, machine):
        self.network, self.machine = network, machine

    async def listen(self, address, on_link):
        return self.network.listen(self.machine, address, on_link)

    async def connect(self, address, handler):
        link = self.network.connect(self.machine, address, handler)
        self.network.run()
        return link


def test_a_greeting_that_is_read_before_the_caller_gets_its_turn(fleet):
    async def story(team):
        mission = team.mission(PROGRAM, DEPLOYMENT)
        (bravo,) = await team.up(mission, "bravo")
        alpha = team.make(mission, "alpha")
        alpha.host.peers._transport = EagerTransport(team.network, "alpha")
        await alpha.host.start()
        assert await team.ended("tom") == "done"
        assert bravo.output == ["here"]
        assert "closed a link" not in alpha.log + bravo.log
        assert team.network.sent["Hello"] == 2

    fleet(story)
