"""Two hosts with two paths, in virtual time: when the link moves to the other path, and when it does not."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable

import pytest
from virtual_paths import PathHost, PathNetwork

from lfield.net.health.path_choice import BETTER_FOR
from lfield.simulate.jumping_loop import run_jumping

Scenario = Callable[[PathNetwork, PathHost, PathHost], Awaitable[None]]


def play(scenario: Scenario) -> None:
    """Run the scenario of two hosts, linked over path one with a standby on path two."""

    async def main() -> None:
        network = PathNetwork()
        hosts = [PathHost(network, name) for name in ("alpha", "bravo")]
        for host in hosts:
            await host.open()
        await until(lambda: all(host.count("standby connection with") for host in hosts))
        assert [host.path for host in hosts] == ["one", "one"]
        try:
            await scenario(network, *hosts)
        finally:
            for host in hosts:
                host.peers.close()

    run_jumping(main())


@pytest.fixture(scope="session")
def runner():
    return play


async def until(done: Callable[[], bool]) -> None:
    async with asyncio.timeout(60.0):
        while not done():
            await asyncio.sleep(0.01)


def now() -> float:
    return asyncio.get_running_loop().time()


@pytest.mark.parametrize("senders", [(0,), (1,), (0, 1)])
def test_either_side_moves_the_link_when_its_data_is_not_acknowledged(senders):
    async def scenario(network, *hosts):
        network.paths["one"].alive = False
        start = now()
        for sender in senders:
            hosts[sender].send(7)
        await until(lambda: all(host.path == "two" for host in hosts))
        assert now() - start < 0.6
        assert all(host.count("unlinked") == 0 for host in hosts)
        assert 1 <= sum(host.count("no acknowledgement") for host in hosts) <= len(senders)

    play(scenario)


async def test_a_recovered_path_becomes_the_standby_and_is_used_again(network, alpha, bravo, /):
    one, two = network.paths["one"], network.paths["two"]
    one.alive = False
    alpha.send(7)
    await until(lambda: alpha.path == bravo.path == "two")
    await asyncio.sleep(20.0)
    assert alpha.count("standby connection with") == 1
    one.alive, back = True, now()
    await until(lambda: alpha.count("standby connection with") == 2)
    assert now() - back < 16.0
    two.alive = False
    bravo.send(7)
    await until(lambda: alpha.path == bravo.path == "one")
    assert alpha.count("unlinked") == bravo.count("unlinked") == 0


async def test_a_missing_standby_is_dialled_at_once_when_the_path_dies(network, alpha, bravo, /):
    one, two = network.paths["one"], network.paths["two"]
    two.alive = False
    # The keep-alive gets no answer.
    await until(lambda: len(alpha.transport.dialled) >= 3)
    await asyncio.sleep(10.0)
    two.alive = True
    one.alive = False
    start = now()
    alpha.send(7)
    await until(lambda: alpha.path == bravo.path == "two")
    # At most the rest of an attempt at the dead path.
    assert now() - start < 7.0


async def test_a_link_with_two_dead_paths_is_lost_and_restored(network, alpha, bravo, /):
    for path in network.paths.values():
        path.alive = False
    alpha.send(7)
    await until(lambda: alpha.path == bravo.path == "")
    for path in network.paths.values():
        path.alive = True
    await until(lambda: alpha.path == bravo.path != "")


async def test_an_idle_link_moves_to_a_much_better_path_after_a_while(network, alpha, bravo, /):
    network.paths["one"].delay, start = 0.2, now()
    await until(lambda: alpha.path == bravo.path == "two")
    assert BETTER_FOR <= now() - start < BETTER_FOR + 20.0
    assert alpha.count("unlinked") == bravo.count("unlinked") == 0
    assert alpha.count("the other path is better") == 1


async def test_a_slightly_better_path_is_not_used(network, alpha, bravo, /):
    network.paths["one"].delay = 0.019
    await asyncio.sleep(300.0)
    assert alpha.path == "one"
    assert alpha.count("moves") == bravo.count("moves") == 0


@pytest.mark.few(0)
async def test_a_healthy_link_and_its_standby_are_kept_for_an_hour(network, alpha, bravo, /):
    dialled = len(alpha.transport.dialled)
    await asyncio.sleep(3600.0)
    assert (alpha.path, len(alpha.transport.dialled), bravo.transport.dialled) == ("one", dialled, [])


async def test_a_closed_link_is_replaced_by_the_standby(network, alpha, bravo, /):
    alpha.peers.link_of("bravo").link.abort()
    start = now()
    await until(lambda: alpha.path == bravo.path == "two")
    assert now() - start < 0.2


async def test_an_unneeded_link_closes_its_standby(network, alpha, bravo, /):
    alpha.desired_hosts = bravo.desired_hosts = set
    await until(lambda: alpha.path == bravo.path == "")
    await asyncio.sleep(1.0)
    assert all(link.closed for link in network.links)
    count = len(alpha.transport.dialled)
    await asyncio.sleep(60.0)
    assert len(alpha.transport.dialled) == count
