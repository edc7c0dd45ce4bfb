"""A person says that the host of a coordinator is gone for good: another host goes on from its shadow."""

from __future__ import annotations

import asyncio
import io

import pytest
from rich.console import Console

from lfield.cli.views.picture import picture
from lfield.errors import AddressError, CoordinatorAlive, UsageError
from lfield.mobility.generations import STRIDE
from lfield.operator.addressed import Place
from lfield.operator.ask import STATUS, ask_all, forget, recover
from lfield.operator.observing import ask
from lfield.operator.recover import believed
from lfield.operator.whereabouts import what_can_be_done
from lfield.wire.observing import Recover

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
NAMES = {Place("", host): host for host in HOSTS}


async def looked(team, *hosts):
    """What the hosts say; those that are not named do not answer."""
    answers = await ask_all(team.network.transport("desk"), {host: f"{host}:8181" for host in hosts}, STATUS)
    silent = {host: AddressError(f"{host}:8181", "nobody listens there") for host in HOSTS}
    return {Place("", host): {**silent, **answers}[host] for host in HOSTS}


def outcomes(running):
    return {known.generation: known.outcome or known.state for known in running.host.mobility.knowledge()}


async def with_guest_away(team):
    home, away = await team.up(team.mission(PROGRAM, DEPLOYMENT), keeps=True)
    await team.until(lambda: away.output)
    await team.until(lambda: outcomes(home) == {1: "MOVED"})
    return home, away


def test_the_home_goes_on_and_the_host_that_comes_back_does_not(fleet):
    async def story(team):
        home, away = await with_guest_away(team)
        await away.host.stop()
        answers = await looked(team, "home")
        assert list(what_can_be_done({place.host: answer for place, answer in answers.items()})) == [
            "guest: start away again; if that is gone for good, go on without it: lfield recover guest, "
            "or end it: lfield forget guest"
        ]
        belief = believed("guest", answers, NAMES)
        assert belief.place == Place("", "home")
        assert belief.lines[0] == (
            "guest, start 1: the newest copy is on home, as it left for away after 0 hops (transfer 1)"
        )
        assert "away does not answer" in belief.lines[1]
        answer = await ask(team.network.transport("desk"), "home:8181", recover(belief.word))
        assert answer.generation == STRIDE + 1 + home.host.core.here
        assert outcomes(home) == {1: "superseded", answer.generation: "RUN"}
        told = (
            "told: guest was recovered on home from where it left for away; this call may have begun, "
            "and what came after it is not known"
        )
        await team.until(lambda: told in home.log)
        pages = team.disks["home"].pages()
        running = [page.generation for page in pages if getattr(page, "state", "") == "RUN"]
        assert running == [answer.generation]
        (again,) = await team.up(away.host.mission, "away", keeps=True)
        await team.until(lambda: outcomes(again).get(1) == "superseded")
        assert not again.holds("guest")
        assert "goes on where it was kept" not in again.log
        assert home.holds("guest")

    fleet(story)


def test_one_that_is_alive_is_not_recovered_and_whoever_asks_is_told_where(fleet):
    async def story(team):
        _, away = await with_guest_away(team)
        with pytest.raises(
            CoordinatorAlive, match=r"guest is alive on away \(start 1\), in a portal: nothing was"
        ):
            believed("guest", await looked(team, *HOSTS), NAMES)
        everybody = await looked(team, *HOSTS)
        assert list(what_can_be_done({place.host: answer for place, answer in everybody.items()})) == []
        with pytest.raises(UsageError, match="no host that answers knows of a coordinator geust"):
            believed("geust", await looked(team, *HOSTS), NAMES)
        word = Recover("guest", 1, 1, 1)
        answer = await ask(team.network.transport("desk"), "away:8181", recover(word))
        assert (answer.generation, answer.reason) == (
            0,
            "away has nothing of guest to go on with, or it is alive there",
        )
        assert away.holds("guest")

    fleet(story)


def test_what_has_changed_since_the_person_was_told_is_not_gone_on_with(fleet):
    async def story(team):
        home, away = await with_guest_away(team)
        await away.host.stop()
        answer = await ask(team.network.transport("desk"), "home:8181", recover(Recover("guest", 1, 7, 1)))
        assert answer.reason == "what home has of guest has changed meanwhile; ask again"
        assert outcomes(home) == {1: "MOVED"}
        first = await ask(team.network.transport("desk"), "home:8181", recover(Recover("guest", 1, 1, 1)))
        again = await ask(team.network.transport("desk"), "home:8181", recover(Recover("guest", 1, 1, 1)))
        assert first.generation > 1
        assert "it is alive there" in again.reason

    fleet(story)


def test_one_that_is_kept_for_another_mission_is_named(fleet):
    async def story(team):
        _, away = await with_guest_away(team)
        await away.host.stop()
        other = team.mission(PROGRAM + "class Other { }\n", DEPLOYMENT)
        await team.up(other, "away", keeps=True)
        answers = await looked(team, "away")
        with pytest.raises(CoordinatorAlive, match="away keeps guest for another mission"):
            believed("guest", answers, NAMES)
        hints = list(what_can_be_done({place.host: answer for place, answer in answers.items()}))
        assert hints == ["guest: start its own mission again, or end it: lfield forget guest"]

    fleet(story)


def test_a_shadow_that_is_of_another_mission_is_gone_on_with_in_that_mission(fleet):
    async def story(team):
        for running in await with_guest_away(team):
            await running.host.stop()
        await team.up(team.mission(PROGRAM, "//Post:other@home\n"), "home", keeps=True)
        answers = await looked(team, "home")
        with pytest.raises(UsageError, match=r"guest is of another mission .* home keeps a copy: start that"):
            believed("guest", answers, NAMES)
        assert (await ask(team.network.transport("desk"), "home:8181", forget("guest"))).starts == [1]
        with pytest.raises(UsageError, match=r"guest has ended on home \(lost\): there is nothing to go on"):
            believed("guest", await looked(team, "home"), NAMES)

    fleet(story)


@pytest.mark.parametrize(
    "request_", [recover(Recover("guest", 1, 1, 1)), forget("guest")], ids=["recover", "forget"]
)
def test_the_answer_waits_for_the_disk(fleet, request_):
    async def story(team):
        home, away = await with_guest_away(team)
        await away.host.stop()
        team.disks["home"].broken = True
        asked = asyncio.create_task(ask(team.network.transport("desk"), "home:8181", request_))
        await asyncio.sleep(3.0)
        assert not asked.done()
        assert "told: guest was recovered" not in home.log
        team.disks["home"].broken = False
        await asked

    fleet(story)


TRIP = PROGRAM.replace("findPost(arg[1]).stay(1000.0)", "FIRST; findPost(arg[2]).stay(1000.0)").replace(
    "FIRST", "findPost(arg[1]).stay(0.1)"
)
LONGER = "//Guest:guest@home?post&last\n//Post:post@away\n//Post:last@far\n"


def test_what_cannot_be_read_is_told_and_a_person_may_go_on_from_an_older_copy(fleet):
    async def story(team):
        home, away, far = await team.up(team.mission(TRIP, LONGER), keeps=True)
        await team.until(lambda: far.output)
        await team.until(lambda: outcomes(away) == {1: "MOVED"})
        await far.host.stop()
        names = {Place("", host): host for host in ("home", "away", "far")}
        desk = team.network.transport("desk")

        async def told():
            answers = await ask_all(desk, {host: f"{host}:8181" for host in ("home", "away")}, STATUS)
            return {Place("", host): answer for host, answer in answers.items()}

        belief = believed("guest", await told(), names)
        assert belief.place == Place("", "away")
        copy = away.host.mobility.newest("guest")
        copy.block = bytes(len(copy.block))
        answer = await ask(desk, "away:8181", recover(belief.word))
        assert (answer.generation, answer.reason) == (
            0,
            "what away has kept of guest cannot be read; ask again: another host may have an older copy",
        )
        out = io.StringIO()
        Console(file=out, width=200).print(
            picture({place.host: answer for place, answer in (await told()).items()})
        )
        assert "in doubt: what was kept of it here cannot be read" in out.getvalue()
        belief = believed("guest", await told(), names)
        assert belief.place == Place("", "home")
        assert belief.lines[1] == (
            "  away has a newer one, of after 1 hop, that cannot be read: what guest did in between may be "
            "done again"
        )
        answer = await ask(desk, "home:8181", recover(belief.word))
        assert outcomes(home) == {1: "superseded", answer.generation: "RUN"}
        await team.until(lambda: outcomes(away)[1] == "superseded")
        assert not away.host.mobility.newest("guest")

    fleet(story)


def test_when_nothing_can_be_read_a_person_is_told_where_it_is(fleet):
    async def story(team):
        home, away = await with_guest_away(team)
        await away.host.stop()
        copy = home.host.mobility.newest("guest")
        copy.block = bytes(len(copy.block))
        await ask(team.network.transport("desk"), "home:8181", recover(Recover("guest", 1, 1, 1)))
        answers = await looked(team, "home")
        with pytest.raises(UsageError, match="what home has kept of guest cannot be read: there is nothing"):
            believed("guest", answers, NAMES)
        assert list(what_can_be_done({place.host: answer for place, answer in answers.items()})) == [
            "guest: start away again; if that is gone for good, end it: lfield forget guest"
        ]

    fleet(story)
