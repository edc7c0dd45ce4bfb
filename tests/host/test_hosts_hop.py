"""Coordinators between hosts: the behaviour of the program, and the number of messages."""

from __future__ import annotations

import asyncio

import pytest
from coroutine_tests import scenario

ECHO = """
resource Echo {
    string id;
    int served;
    init(string[] arg) { id = arg[0]; }
    portal say(string what) emit string {
        served = served + 1;
        write(id + " hears " + what + "\\n");
        return what + "!";
    }
}
"""

THERE_AND_BACK = (
    ECHO
    + """
coordinator Visitor {
    init(string[] arg) {
        Echo near = findEcho(arg[1]);
        Echo far = findEcho(arg[2]);
        near.say(far.say("a") + far.say("b"));
        print("made " + i2s(hops()) + " hops");
    }
}
"""
)
TWO_HOSTS = "//Echo:near@alpha\n//Echo:far@bravo\n//Visitor:visitor@alpha?near&far\n"


async def test_a_coordinator_hops_to_another_host_and_returns(team, /):
    alpha, bravo = await team.up(team.mission(THERE_AND_BACK, TWO_HOSTS))
    assert await team.ended("visitor") == "done"
    assert bravo.output == ["far hears a", "far hears b"]
    assert alpha.output == ["near hears a!b!"]
    assert "visitor: made 2 hops" in alpha.log
    assert team.network.sent["Transfer"] == 2


async def test_lived_includes_the_time_of_waiting_for_a_link(team, /):
    program = (
        ECHO
        + """
coordinator Visitor {
    init(string[] arg) {
        findEcho("far").say("at last");
        print("lived " + f2s(lived()));
    }
}
"""
    )

    mission = team.mission(program, TWO_HOSTS, without=("bravo",))
    (alpha,) = await team.up(mission, "alpha")
    await asyncio.sleep(5.0)
    (bravo,) = await team.up(mission, "bravo")
    assert await team.ended("visitor") == "done"
    (line,) = (line for line in (alpha.log + bravo.log).splitlines() if "lived" in line)
    assert 4.0 < float(line.split()[-1]) < 8.0


async def test_agents_on_one_host_need_no_messages(team, /):
    deployment = "//Echo:near@alpha\n//Echo:far@alpha\n//Visitor:visitor@alpha?near&far\n"
    (alpha,) = await team.up(team.mission(THERE_AND_BACK, deployment))
    assert await team.ended("visitor") == "done"
    assert "visitor: made 0 hops" in alpha.log
    assert not team.network.sent
    assert alpha.output == ["far hears a", "far hears b", "near hears a!b!"]


async def test_a_proxy_names_the_host_of_its_resource_from_any_host(team, /):
    program = (
        ECHO
        + """
coordinator Visitor {
    init(string[] arg) {
        Echo far = findEcho("far");
        print(far.agent() + " on " + far.host());
        far.say("a");
        print(far.host() + " and " + findEcho("near").host());
        print(far == findEcho()[1]);
    }
}
"""
    )

    alpha, bravo = await team.up(team.mission(program, TWO_HOSTS))
    assert await team.ended("visitor") == "done"
    assert "visitor: far on bravo" in alpha.log
    assert "visitor: bravo and alpha" in bravo.log
    assert "visitor: true" in bravo.log
    assert team.network.sent["Transfer"] == 1


AGREE = (
    ECHO
    + """
coordinator Agreement {
    init(string[] arg) {
        Echo[] all = findEcho();
        string seen = "";
        for (int i = 0; i < all.length(); i = i + 1) seen = seen + all[i].say("what");
        for (int i = 0; i < all.length(); i = i + 1) all[i].say("agreed");
    }
}
"""
)


@pytest.mark.parametrize("hosts", [2, 5, 16])
async def test_n_resources_agree_in_2n_hops(team, /, hosts):
    # The coordinator starts on another host: N hops to collect, N to inform (chapter IV).
    lines = [f"//Echo:e{n}@host{n}" for n in range(hosts)]

    mission = team.mission(AGREE, "\n".join([*lines, "//Agreement:agreement@home"]))
    everybody = await team.up(mission)
    assert await team.ended("agreement") == "done"
    assert team.network.sent["Transfer"] == 2 * hosts
    for running in everybody[:-1]:
        assert [line.split(" hears ")[1] for line in running.output] == ["what", "agreed"]


async def test_a_portal_call_waits_for_a_host_that_has_not_started(team, /):
    mission = team.mission(THERE_AND_BACK, TWO_HOSTS, without=("bravo",))
    (alpha,) = await team.up(mission, "alpha")
    await asyncio.sleep(5.0)
    assert alpha.holds("visitor")
    assert alpha.output == []
    (bravo,) = await team.up(mission, "bravo")
    assert await team.ended("visitor") == "done"
    assert bravo.output == ["far hears a", "far hears b"]


async def test_hosts_may_start_in_the_other_order(team, /):
    mission = team.mission(THERE_AND_BACK, TWO_HOSTS)
    await team.up(mission, "bravo")
    await asyncio.sleep(5.0)
    (alpha,) = await team.up(mission, "alpha")
    assert await team.ended("visitor") == "done"
    assert alpha.output == ["near hears a!b!"]


async def test_a_coordinator_that_arrives_while_a_host_starts_finds_its_resources(team, /):
    mission = team.mission(THERE_AND_BACK, TWO_HOSTS)
    bravo = team.make(mission, "bravo")
    opened = asyncio.Event()

    async def open_slowly(devices, recording):
        await opened.wait()

    bravo.host.guards.open = open_slowly
    starting = asyncio.create_task(bravo.host.start())
    (alpha,) = await team.up(mission, "alpha")
    await team.until(lambda: team.network.sent["Transfer"] == 1)
    await asyncio.sleep(1.0)
    assert alpha.output == bravo.output == []
    opened.set()
    await starting
    assert await team.ended("visitor") == "done"
    assert bravo.output == ["far hears a", "far hears b"]


CAUTIOUS = (
    ECHO
    + """
coordinator Cautious {
    init(string[] arg) {
        Echo near = findEcho(arg[1]);
        Echo far = findEcho(arg[2]);
        real before = now();
        try {
            far.say("a");
            near.say("reached");
        } catch (UnreachableResourceException e) {
            near.say("after " + f2s(now() - before, 0) + " s: " + e.message());
        }
    }
}
"""
)


@pytest.mark.parametrize("bound", [2.0, 30.0])
async def test_an_unreachable_host_raises_an_exception_after_the_bound(team, /, bound):
    mission = team.mission(CAUTIOUS, TWO_HOSTS.replace("Visitor", "Cautious"), without=("bravo",))
    (alpha,) = await team.up(mission, "alpha", unreachable_after=bound)
    assert await team.ended("visitor") == "done"
    assert alpha.output == [
        f"near hears after {bound:.0f} s: bravo could not be reached within {bound:g} s; is it up?"
    ]


async def test_an_uncaught_unreachable_host_names_the_statement_and_the_hosts_visited(team, /):
    (alpha,) = await team.up(
        team.mission(THERE_AND_BACK, TWO_HOSTS, without=("bravo",)), "alpha", unreachable_after=1.0
    )
    assert await team.ended("visitor") == "died"
    assert "visitor died of an uncaught UnreachableResourceException: bravo could not be" in alpha.log
    line = 1 + THERE_AND_BACK.splitlines().index('        near.say(far.say("a") + far.say("b"));')
    assert f"at Visitor.init (mission.L:{line})" in alpha.log
    assert "hosts visited: alpha\n" in alpha.log


SHUTTLE = (
    ECHO
    + """
coordinator Shuttle {
    init(string[] arg) {
        Echo near = findEcho(arg[1]);
        Echo far = findEcho(arg[2]);
        for (int i = 0; i < 6; i = i + 1) {
            try {
                far.say(i2s(i));
            } catch (RestartException e) {
                print(e.message().substring(0, e.message().indexOf(":")));
                far.say(i2s(i));
            }
            near.say(i2s(i));
            sleep(10.0);
        }
    }
}
"""
)


async def test_a_broken_link_is_restored(team, /):
    alpha, bravo = await team.up(
        team.mission(SHUTTLE, TWO_HOSTS.replace("Visitor", "Shuttle")), unreachable_after=20.0
    )
    await team.until(lambda: len(alpha.output) == 2)
    team.network.partition("alpha", "bravo")
    await team.until(lambda: "link to bravo lost" in alpha.log)
    await asyncio.sleep(12.0)
    assert len(bravo.output) == 2
    team.network.heal("alpha", "bravo")
    assert await team.ended("visitor") == "done"
    assert bravo.output == [f"far hears {i}" for i in range(6)]
    assert team.network.sent["Transfer"] == 12, "six hops in each direction"


async def test_a_restarted_host_is_reached_again(team, /):
    mission = team.mission(SHUTTLE, TWO_HOSTS.replace("Visitor", "Shuttle"))
    alpha, bravo = await team.up(mission, unreachable_after=20.0)
    await team.until(lambda: len(alpha.output) == 2)
    await bravo.host.stop()
    await asyncio.sleep(12.0)
    (again,) = await team.up(mission, "bravo")
    assert await team.ended("visitor") == "done"
    # The call that reported it has not begun.
    assert again.log.count("visitor: far has restarted since this proxy last called it") == 1
    assert again.output == [f"far hears {i}" for i in range(2, 6)]


LOADED = (
    ECHO
    + """
coordinator Loaded {
    int[] load;
    init(string[] arg) {
        Echo near = findEcho(arg[1]);
        Echo far = findEcho(arg[2]);
        load = new int[10000];
        try {
            far.say("a");
        } catch (LimitException e) {
            near.say(e.message());
        }
        load = null;
        near.say(far.say("lighter"));
    }
}
"""
)


async def test_a_block_over_the_heap_limit_of_the_other_host_is_not_sent(team, /):
    deployment = TWO_HOSTS.replace("Visitor", "Loaded")
    small = "agents: {visitor: {heap: 64 KiB}}\n"
    (bravo,) = await team.up(team.mission(LOADED, deployment, small), "bravo")
    (alpha,) = await team.up(team.mission(LOADED, deployment, "agents: {}\n"), "alpha")
    assert await team.ended("visitor") == "done"
    assert alpha.output[0].endswith(" bytes and bravo takes at most 65536")
    assert bravo.output == ["far hears lighter"]
    assert team.network.sent["Transfer"] == 2


@scenario("fleet", max_block=65536)
async def test_a_block_over_the_frame_limit_is_refused_before_it_is_read(team, /):
    alpha, bravo = await team.up(team.mission(LOADED, TWO_HOSTS.replace("Visitor", "Loaded")))
    admitted = []
    bravo.host.machine.admit = lambda *given: admitted.append(given)
    await team.until(lambda: alpha.output)
    assert admitted == []
    assert alpha.output[0].startswith("near hears visitor has 8")
    assert alpha.output[0].endswith(" bytes and bravo takes at most 1048576")


FAULTY = """
resource Divider {
    init(string[] arg) { }
    portal part(int whole, int of) emit int {
        return share(whole, of);
    }
    private int share(int whole, int of) {
        return whole / of;
    }
}
coordinator Careless {
    Divider divider;
    init(string[] arg) {
        divider = findDivider(arg[1]);
        divide(1);
        divide(0);
    }
    private void divide(int by) {
        print(i2s(divider.part(8, by)));
    }
}
"""


async def test_an_uncaught_exception_shows_the_stack_of_both_agents_and_the_hosts_visited(team, /):
    deployment = "//Careless:tom@alpha?divider\n//Divider:divider@bravo\n"
    alpha, bravo = await team.up(team.mission(FAULTY, deployment))
    assert await team.ended("tom") == "died"
    lines = bravo.log.splitlines()
    start = next(i for i, line in enumerate(lines) if "died" in line)
    assert lines[start].startswith("tom died of an uncaught ArithmeticException")
    lines_after = lines[start + 1 :]
    stack = [
        "    at Divider.share (mission.L:8) in divider",
        "    at Divider.part (mission.L:5) in divider",
        "    at Careless.divide (mission.L:19)",
        "    at Careless.init (mission.L:16)",
    ]
    places = [lines_after.index(line) for line in stack]
    assert places == sorted(places)
    assert "    hosts visited: alpha → bravo" in lines_after
    assert bravo.holds("divider"), "the resource continues"
    await team.until(lambda: alpha.host.mobility.known_states()[0].outcome == "died")
