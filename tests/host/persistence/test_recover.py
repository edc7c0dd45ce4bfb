"""`lfield recover`: the host of a coordinator is permanently lost, and another host continues from its
shadow."""

from __future__ import annotations

import asyncio
import io

import pytest
from rich.console import Console

from lfield.cli.views.team_status_view import team_tables
from lfield.errors import AddressError, CoordinatorAlive, UsageError
from lfield.operator.client import SNAPSHOT, ask_all, forget, recover
from lfield.operator.coordinator_location import doubt_advice
from lfield.operator.observer_link import send_request
from lfield.operator.recovery_candidates import best_candidate
from lfield.operator.targets import HostRef
from lfield.operator.team_model.host_model import host_states
from lfield.replication.transfer.generations import GENERATION_STRIDE
from lfield.wire.observer_messages import RecoverRequest

PROGRAM = """
resource Post {
    int calls;
    init(string[] arg) { }
    portal stay(real seconds) { calls = calls + 1; write("arrived\\n"); sleep(seconds); }
}
coordinator Guest {
    init(string[] arg) {
        try { findPost(arg[1]).stay(1000.0); }
        catch (RestartException again) { print("told: " + again.message()); sleep(1000.0); }
    }
}
"""
DEPLOYMENT = "//Guest:guest@home?post\n//Post:post@away\n"
HOSTS = ("home", "away")
NAMES = {HostRef("", host): host for host in HOSTS}


async def team_states(team, *hosts):
    """The states of the hosts; those that are not named do not answer."""
    answers = await ask_all(
        team.network.transport("desk"), {host: f"{host}:8181" for host in hosts}, SNAPSHOT
    )
    silent = {host: AddressError(f"{host}:8181", "no listener") for host in HOSTS}
    return host_states({HostRef("", host): {**silent, **answers}[host] for host in HOSTS})


def outcomes(running):
    return {known.generation: known.outcome or known.state for known in running.host.mobility.known_states()}


async def with_guest_away(team):
    home, away = await team.up(team.mission(PROGRAM, DEPLOYMENT), keeps=True)
    await team.until(lambda: away.output)
    await team.until(lambda: outcomes(home) == {1: "MOVED"})
    return home, away


async def test_the_home_continues_and_the_returned_host_does_not(team, /):
    home, away = await with_guest_away(team)
    await away.host.stop()
    answers = await team_states(team, "home")
    assert list(doubt_advice({place.host: answer for place, answer in answers.items()})) == [
        "guest: start away again; if it is permanently lost, continue without it: lfield recover guest, "
        "or end it: lfield forget guest"
    ]
    estimate = best_candidate("guest", answers, NAMES)
    assert estimate.host_ref == HostRef("", "home")
    assert estimate.lines[0] == (
        "guest, start 1: the newest copy is on home, as it left for away after 0 hops (transfer 1)"
    )
    assert "away does not answer" in estimate.lines[1]
    answer = await send_request(team.network.transport("desk"), "home:8181", recover(estimate.request))
    assert answer.generation == GENERATION_STRIDE + 1 + home.host.core.own_number
    assert outcomes(home) == {1: "superseded", answer.generation: "RUN"}
    expected = (
        "told: guest was recovered on home from its departure for away; this call may have begun, "
        "and later actions are unknown"
    )
    await team.until(lambda: expected in home.log)
    pages = team.disks["home"].records()
    running = [page.generation for page in pages if getattr(page, "state", "") == "RUN"]
    assert running == [answer.generation]
    (again,) = await team.up(away.host.mission, "away", keeps=True)
    await team.until(lambda: outcomes(again).get(1) == "superseded")
    assert not again.holds("guest")
    assert "resumed from the journal" not in again.log
    assert home.holds("guest")


async def test_a_live_coordinator_is_not_recovered_and_its_host_is_named(team, /):
    _, away = await with_guest_away(team)
    with pytest.raises(
        CoordinatorAlive, match=r"guest is alive on away \(start 1\), in a portal: nothing was"
    ):
        best_candidate("guest", await team_states(team, *HOSTS), NAMES)
    states = await team_states(team, *HOSTS)
    assert list(doubt_advice({place.host: answer for place, answer in states.items()})) == []
    with pytest.raises(UsageError, match=r"no reachable host has a.* coordinator geust"):
        best_candidate("geust", await team_states(team, *HOSTS), NAMES)
    request = RecoverRequest("guest", 1, 1, 1)
    answer = await send_request(team.network.transport("desk"), "away:8181", recover(request))
    assert (answer.generation, answer.reason) == (
        0,
        "away has no copy of guest to resume, or it is alive there",
    )
    assert away.holds("guest")


async def test_a_copy_that_changed_since_the_query_is_not_recovered(team, /):
    home, away = await with_guest_away(team)
    await away.host.stop()
    answer = await send_request(
        team.network.transport("desk"), "home:8181", recover(RecoverRequest("guest", 1, 7, 1))
    )
    assert answer.reason == "the copy of guest on home has changed meanwhile; repeat the command"
    assert outcomes(home) == {1: "MOVED"}
    first = await send_request(
        team.network.transport("desk"), "home:8181", recover(RecoverRequest("guest", 1, 1, 1))
    )
    again = await send_request(
        team.network.transport("desk"), "home:8181", recover(RecoverRequest("guest", 1, 1, 1))
    )
    assert first.generation > 1
    assert "it is alive there" in again.reason


async def test_a_coordinator_kept_for_another_mission_is_named(team, /):
    _, away = await with_guest_away(team)
    await away.host.stop()
    other = team.mission(PROGRAM + "class Other { }\n", DEPLOYMENT)
    await team.up(other, "away", keeps=True)
    answers = await team_states(team, "away")
    with pytest.raises(CoordinatorAlive, match="away keeps guest for another mission"):
        best_candidate("guest", answers, NAMES)
    hints = list(doubt_advice({place.host: answer for place, answer in answers.items()}))
    assert hints == ["guest: start its own mission again, or end it: lfield forget guest"]


async def test_a_shadow_of_another_mission_can_only_be_recovered_there(team, /):
    for running in await with_guest_away(team):
        await running.host.stop()
    await team.up(team.mission(PROGRAM, "//Post:other@home\n"), "home", keeps=True)
    answers = await team_states(team, "home")
    with pytest.raises(UsageError, match=r"guest is of another mission .* home keeps a copy: start that"):
        best_candidate("guest", answers, NAMES)
    assert (await send_request(team.network.transport("desk"), "home:8181", forget("guest"))).starts == [1]
    with pytest.raises(UsageError, match=r"guest has ended on home \(lost\): it cannot be recovered"):
        best_candidate("guest", await team_states(team, "home"), NAMES)


@pytest.mark.parametrize(
    "request_", [recover(RecoverRequest("guest", 1, 1, 1)), forget("guest")], ids=["recover", "forget"]
)
async def test_the_answer_waits_for_the_disk(team, /, request_):
    home, away = await with_guest_away(team)
    await away.host.stop()
    team.disks["home"].broken = True
    task = asyncio.create_task(send_request(team.network.transport("desk"), "home:8181", request_))
    await asyncio.sleep(3.0)
    assert not task.done()
    assert "told: guest was recovered" not in home.log
    team.disks["home"].broken = False
    await task


TRIP = PROGRAM.replace("findPost(arg[1]).stay(1000.0)", "FIRST; findPost(arg[2]).stay(1000.0)").replace(
    "FIRST", "findPost(arg[1]).stay(0.1)"
)
LONGER = "//Guest:guest@home?post&last\n//Post:post@away\n//Post:last@far\n"


async def test_an_unreadable_copy_is_reported_and_an_older_one_can_be_recovered(team, /):
    home, away, far = await team.up(team.mission(TRIP, LONGER), keeps=True)
    await team.until(lambda: far.output)
    await team.until(lambda: outcomes(away) == {1: "MOVED"})
    await far.host.stop()
    names = {HostRef("", host): host for host in ("home", "away", "far")}
    desk = team.network.transport("desk")

    async def reached_states():
        answers = await ask_all(desk, {host: f"{host}:8181" for host in ("home", "away")}, SNAPSHOT)
        return host_states({HostRef("", host): answer for host, answer in answers.items()})

    estimate = best_candidate("guest", await reached_states(), names)
    assert estimate.host_ref == HostRef("", "away")
    copy = away.host.mobility.newest_copy("guest")
    copy.block = bytes(len(copy.block))
    answer = await send_request(desk, "away:8181", recover(estimate.request))
    assert (answer.generation, answer.reason) == (
        0,
        "the copy of guest on away cannot be read; repeat the command: another host may have an older copy",
    )
    out = io.StringIO()
    Console(file=out, width=200).print(
        team_tables({place.host: answer for place, answer in (await reached_states()).items()})
    )
    assert "in doubt: its stored copy here cannot be read" in out.getvalue()
    estimate = best_candidate("guest", await reached_states(), names)
    assert estimate.host_ref == HostRef("", "home")
    assert estimate.lines[1] == (
        "  away has a newer one, of after 1 hop, that cannot be read: what guest did in between may be "
        "done again"
    )
    answer = await send_request(desk, "home:8181", recover(estimate.request))
    assert outcomes(home) == {1: "superseded", answer.generation: "RUN"}
    await team.until(lambda: outcomes(away)[1] == "superseded")
    assert not away.host.mobility.newest_copy("guest")


async def test_without_a_readable_copy_the_host_with_the_copy_is_named(team, /):
    home, away = await with_guest_away(team)
    await away.host.stop()
    copy = home.host.mobility.newest_copy("guest")
    copy.block = bytes(len(copy.block))
    await send_request(team.network.transport("desk"), "home:8181", recover(RecoverRequest("guest", 1, 1, 1)))
    answers = await team_states(team, "home")
    with pytest.raises(UsageError, match="the copy of guest on home cannot be read: it cannot"):
        best_candidate("guest", answers, NAMES)
    assert list(doubt_advice({place.host: answer for place, answer in answers.items()})) == [
        "guest: start away again; if it is permanently lost, end it: lfield forget guest"
    ]
