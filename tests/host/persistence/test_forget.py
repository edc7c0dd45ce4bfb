"""`lfield forget`: a coordinator in doubt or parked ends as lost; one that is alive continues."""

from __future__ import annotations

import asyncio

import pytest
from scripted_snapshots import states_of

from lfield.errors import AddressError, CoordinatorAlive, UsageError
from lfield.host.process.mission_completion import wait_until_done
from lfield.operator.client import SNAPSHOT, ask_all, forget
from lfield.operator.coordinator_location import require_in_doubt
from lfield.operator.observer_link import send_request
from lfield.operator.team_model.host_model import host_states

PROGRAM = """
resource Post {
    int calls;
    init(string[] arg) { }
    portal stay(real seconds) { calls = calls + 1; write("arrived\\n"); sleep(seconds); }
}
coordinator Guest {
    init(string[] arg) { findPost(arg[1]).stay(1000.0); }
}
"""
DEPLOYMENT = "//Guest:guest@home?post\n//Post:post@away\n"
NAMES = {"home": "home", "away": "away"}


async def team_states(team, *hosts):
    addresses = {host: f"{host}:8181" for host in hosts}
    return host_states(await ask_all(team.network.transport("desk"), addresses, SNAPSHOT))


def records(running):
    return [(known.state, known.outcome) for known in running.host.mobility.known_states()]


async def test_forget_ends_a_coordinator_in_doubt(team, /):
    mission = team.mission(PROGRAM, DEPLOYMENT)
    (home,) = await team.up(mission, "home", keeps=True)
    away = team.make(mission, "away", keeps=True)
    # The transfer is received, and no answer is sent.
    away.host.on_transfer = lambda host, header, block: None
    await away.host.start()
    await team.until(lambda: records(home) == [("IN DOUBT", "")])
    require_in_doubt("guest", await team_states(team, "home", "away"), NAMES)
    answer = await send_request(team.network.transport("desk"), "home:8181", forget("guest"))
    assert answer.starts == [1]
    assert records(home) == [("EXITED", "lost")]
    await team.until(lambda: not home.holds("guest"))
    await team.until(lambda: records(away) == [("EXITED", "lost")])
    assert "guest declared lost: 'lfield forget'" in home.log
    assert (await send_request(team.network.transport("desk"), "home:8181", forget("guest"))).starts == []
    with pytest.raises(UsageError, match=r"guest has ended on home \(lost\): there is nothing to end"):
        require_in_doubt("guest", await team_states(team, "home", "away"), NAMES)


async def test_forget_refuses_a_live_coordinator_and_names_its_host(team, /):
    home, away = await team.up(team.mission(PROGRAM, DEPLOYMENT), keeps=True)
    await team.until(lambda: away.output and "PREPARED" not in str(home.host.mobility.known_states()))
    with pytest.raises(CoordinatorAlive, match=r"alive on away \(start 1\), in a portal: nothing"):
        require_in_doubt("guest", await team_states(team, "home", "away"), NAMES)
    with pytest.raises(UsageError, match=r"no reachable host has a.* coordinator geust"):
        require_in_doubt("geust", await team_states(team, "home", "away"), NAMES)
    # Forgetting a live coordinator: its shadow is discarded, and it continues.
    await send_request(team.network.transport("desk"), "home:8181", forget("guest"))
    await send_request(team.network.transport("desk"), "away:8181", forget("guest"))
    await asyncio.sleep(5.0)
    assert away.holds("guest")
    assert records(away) == [("RUN", "")]


async def test_forget_ends_a_coordinator_parked_for_another_program(team, /):
    _, away = await team.up(team.mission(PROGRAM, DEPLOYMENT), keeps=True)
    await team.until(lambda: away.output)
    await away.host.stop()
    other = team.mission(PROGRAM + "class Other { }\n", DEPLOYMENT)
    (again,) = await team.up(other, "away", keeps=True)
    assert len(again.host.status().journal.parked) == 1
    answers = {"away": again.host.status(), "home": AddressError("home:8181", "no listener")}
    require_in_doubt("guest", states_of(answers), NAMES)
    assert (await send_request(team.network.transport("desk"), "away:8181", forget("guest"))).starts == [1]
    assert again.host.status().journal.parked == []
    await again.host.stop()
    (again,) = await team.up(other, "away", keeps=True)
    assert again.host.status().journal.parked == []
    assert records(again) == [("EXITED", "lost")]


@pytest.mark.parametrize(
    ("others", "next_start"),
    [("//Post:other@home\n", 2), ("//Post:guest@home\n", 2), ("//Guest:other@home?post\n", 3)],
    ids=["no coordinator", "a resource of its name", "other coordinators"],
)
async def test_forget_ends_a_parked_coordinator_in_all_later_runs(team, /, others, next_start):
    """A new start of the coordinator's own mission is a new run."""
    first = team.mission(PROGRAM, DEPLOYMENT)
    home, away = await team.up(first, keeps=True)
    await team.until(lambda: away.output)
    await stopped(away, home)
    other = team.mission(PROGRAM, f"//Post:post@away\n{others}")
    home, away = await team.up(other, "home", "away", keeps=True)
    require_in_doubt("guest", await team_states(team, "home", "away"), NAMES)
    assert {host: (await send_forget(team, host)).starts for host in NAMES} == {"home": [1], "away": [1]}
    assert {host: (await send_forget(team, host)).starts for host in NAMES} == {"home": [], "away": []}
    assert [running.host.status().journal.parked for running in (home, away)] == [[], []]
    with pytest.raises(UsageError, match=r"guest has ended on \w+ \(lost\): there is nothing to end"):
        require_in_doubt("guest", await team_states(team, "home", "away"), NAMES)
    assert home.holds("guest") == ("Post:guest" in others)
    await stopped(away, home)
    _, away = await team.up(first, keeps=True)
    await team.until(lambda: away.output)
    starts = {known.generation: known.outcome or known.state for known in away.host.mobility.known_states()}
    assert starts == {1: "lost", next_start: "RUN"}
    assert "resumed from the journal" not in away.log


async def test_a_forgotten_parked_coordinator_does_not_delay_the_end_of_a_mission(team, /):
    """home only receives that guest was given up at away."""
    home, away = await team.up(team.mission(PROGRAM, DEPLOYMENT), keeps=True)
    await team.until(lambda: away.output)
    await stopped(away, home)
    short = PROGRAM.replace("1000.0", "1.0")
    mission = team.mission(short, DEPLOYMENT.replace("Guest:guest", "Guest:other"))
    home, away = await team.up(mission, keeps=True)
    assert (await send_forget(team, "away")).starts == [1]
    await team.until(lambda: ("EXITED", "lost") in records(home))
    (outcome,) = await wait_until_done(home.host, 15.0)
    assert (outcome.agent, outcome.outcome) == ("other", "done")


async def send_forget(team, host):
    return await send_request(team.network.transport("desk"), f"{host}:8181", forget("guest"))


async def stopped(*hosts):
    for running in hosts:
        await running.host.stop()
