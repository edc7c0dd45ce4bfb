"""The status that a host reports on request."""

from __future__ import annotations

import asyncio

import pytest
from msgspec.structs import replace

from lfield.devices.device_guards import DeviceGuards
from lfield.errors import AddressError
from lfield.host.process.mission_completion import wait_until_done
from lfield.operator.client import SNAPSHOT, ask_all
from lfield.operator.observer_link import send_request
from lfield.wire.codec import decode, encode
from lfield.wire.coordinator_messages import Locate
from lfield.wire.fields import MAX_DURATION, MAX_NUMBERS, MAX_TEXT
from lfield.wire.framing import HEADER_SIZE
from lfield.wire.messages import Hello
from lfield.wire.observer_messages import LinkStatus
from lfield.wire.subscription_messages import EventBatch, Subscribe

PROGRAM = """
resource Post {
    init(string[] arg) { while (true) yield(); }
    portal stay(real seconds) { sleep(seconds); }
}
coordinator Guest {
    init(string[] arg) { findPost(arg[1]).stay(20.0); }
}
"""
DEPLOYMENT = "//Guest:guest@home?post\n//Post:post@away\n"


async def test_the_status_shows_agents_hops_portals_and_heap(team, /):
    mission = team.mission(PROGRAM, DEPLOYMENT)
    home, away = await team.up(mission)
    await team.until(lambda: away.holds("guest"))
    await asyncio.sleep(1.0)
    batch = await send_request(team.network.transport("desk"), "away:8181", SNAPSHOT)
    status = batch.snapshot
    assert status.host == "away"
    assert status.address == "away:8181"
    (link,) = status.links
    assert replace(link, kinds={}) == LinkStatus("home", None, 0.0)
    assert link.kinds.keys() == {"control", "hop"}
    assert status.up >= 1.0
    assert (status.program, status.deployment) == (mission.program.digest, mission.team.deployment)
    agents = {agent.id: agent for agent in status.agents}
    assert agents["guest"].type == "Guest"
    assert agents["guest"].kind == "coordinator"
    assert agents["guest"].hops == 1
    assert agents["post"].kind == "resource"
    assert (agents["post"].served, agents["post"].state) == (0, "sleeping")
    assert agents["guest"].state == "in a portal"
    assert 0 < agents["post"].heap < agents["post"].limit == 1 << 20
    (record,) = status.coordinators
    assert (record.agent, record.state, record.hops) == ("guest", "RUN", 1)
    assert home.host.status().coordinators[0].where == "away"
    assert await team.ended("guest") == "done"
    (post,) = away.host.status().agents
    assert (post.served, post.state) == (1, "parked")


async def test_the_status_is_valid_for_any_telemetry(team, /, monkeypatch):
    telemetry = {"one.fc": {"mode": "x" * 9999, "scan": (0.5,) * 9999, "n": 1, "on": True}, "two.fc": {}}
    contact = {"one.fc": -1e12}
    for name, value in {
        "telemetry": telemetry,
        "last_contact": contact,
        "latched": {"two.fc": "y" * 9999},
    }.items():
        monkeypatch.setattr(DeviceGuards, name, property(lambda self, value=value: value))

    (home,) = await team.up(team.mission(PROGRAM, DEPLOYMENT), "home")
    frame = encode(home.host._observers.subscriptions.snapshot_batch(directory=True))
    one, two = decode(frame[HEADER_SIZE - 1], frame[HEADER_SIZE:]).snapshot.devices
    assert (one.name, one.silent, one.latched) == ("one.fc", MAX_DURATION, "")
    assert (two.name, two.silent, len(two.latched)) == ("two.fc", None, MAX_TEXT)
    assert len(one.telemetry.pop("mode")) == MAX_TEXT
    assert one.telemetry == {"scan": [0.5] * MAX_NUMBERS, "n": 1, "on": True}


async def test_an_unreachable_host_is_shown(team, /):
    home, away = await team.up(team.mission(PROGRAM, DEPLOYMENT), unreachable_after=5.0)
    await team.until(lambda: away.holds("guest"))
    await away.host.stop()
    await asyncio.sleep(4.0)
    status = home.host.status()
    (link,) = status.links
    assert link.host == "away"
    assert link.away >= 3.0


async def test_a_coordinator_in_doubt_stays_frozen_and_is_reported(team, /):
    home, away = await team.up(team.mission(PROGRAM, DEPLOYMENT), "home"), None
    away = team.make(home[0].host.mission, "away")
    # The transfer is received, and no answer is sent.
    away.host.on_transfer = lambda host, header, block: None
    await away.host.start()
    await team.until(lambda: team.network.sent["Transfer"] == 1)
    await team.until(lambda: "guest in doubt: away has not confirmed within 10 s" in home[0].log)
    (record,) = home[0].host.status().coordinators
    assert (record.state, record.where) == ("IN DOUBT", "away")
    await away.host.stop()
    (outcome,) = await wait_until_done(home[0].host, 15.0)
    # It may have accepted the transfer, and may return: silence is no proof.
    assert outcome.outcome == "unheard"
    assert outcome.detail.startswith("it moved to away (transfer 1), and away has been unreachable for 1")


async def test_a_host_that_does_not_answer_gives_an_error_among_the_answers(team, /):
    await team.up(team.mission(PROGRAM, DEPLOYMENT), "home")
    transport = team.network.transport("desk")
    answers = await ask_all(transport, {"home": "home:8181", "away": "away:8181"}, SNAPSHOT)
    assert answers["home"].snapshot.host == "home"
    assert isinstance(answers["away"], AddressError)


async def test_hosts_locate_coordinators_of_each_other_and_exchange_no_snapshots(team, /):
    mission = team.mission(PROGRAM, DEPLOYMENT)
    home, away = await team.up(mission, "home", "away")
    await team.until(lambda: away.holds("guest"))
    await asyncio.sleep(1.0)
    away.host.peers.send("home", Subscribe(once=True))
    away.host.peers.send("home", Locate())
    await team.until(lambda: "home" in away.host.core.locator.answers)
    await asyncio.sleep(1.0)
    assert team.network.sent["Subscribe"] == 1
    assert team.network.sent["EventBatch"] == 0
    assert away.host.core.locator.answers["home"] == home.host.status().coordinators
    assert away.host.core.locator.answers["home"] != []


async def test_many_requests_of_one_client_get_few_answers(team, /):
    (home,) = await team.up(team.mission("resource R { init(string[] arg) { } }", "//R:r@home\n"))
    answers = []

    class Asker:
        def on_message(self, link, message):
            answers.append(message)
            if isinstance(message, Hello):
                link.accept_role("host")
                for _ in range(1000):
                    link.send(Subscribe(once=True))

        def on_closed(self, link, error):
            pass

    link = await team.network.transport("desk").connect("home:8181", Asker())
    link.send(Hello("observer", "observer", 0))
    await asyncio.sleep(1.0)
    assert 1 <= sum(isinstance(answer, EventBatch) for answer in answers) <= 3
    assert home.host.status().host == "home"


async def test_a_request_without_an_answer_ends_with_an_error(team, /):
    class Silent:
        def on_message(self, link, message):
            pass

        def on_closed(self, link, error):
            pass

    class Closing(Silent):
        def on_message(self, link, message):
            link.close()

    transport = team.network.transport("desk")
    await transport.listen("silent:1", lambda link: Silent())
    await transport.listen("closing:1", lambda link: Closing())
    with pytest.raises(AddressError, match="no answer within 2 s"):
        await send_request(transport, "silent:1", SNAPSHOT)
    with pytest.raises(AddressError, match="without an answer"):
        await send_request(transport, "closing:1", SNAPSHOT)


async def test_an_observer_that_disconnects_leaves_no_log_line(team, /):
    contact = []

    class Watching:
        def on_message(self, link, message):
            if isinstance(message, Hello):
                link.accept_role(message.role)
                link.send(Subscribe())
            else:
                contact.append(message)

        def on_closed(self, link, error):
            contact.append(error)

    (home,) = await team.up(team.mission(PROGRAM, DEPLOYMENT), "home")
    link = await team.network.transport("desk").connect("home:8181", Watching())
    link.send(Hello("observer", "observer", 0))
    await team.until(lambda: contact)
    assert isinstance(contact[0], EventBatch)
    team.network.cut("desk", "home")
    await team.until(lambda: len(contact) > 1)
    await asyncio.sleep(3.0)
    assert "link from " not in home.log


async def test_a_client_without_a_hello_is_disconnected(team, /):
    closed = []

    class Idle:
        def on_message(self, link, message):
            pass

        def on_closed(self, link, error):
            closed.append(error)

    (home,) = await team.up(team.mission(PROGRAM, DEPLOYMENT), "home")
    await team.network.transport("desk").connect("home:8181", Idle())
    await team.until(lambda: closed)
    assert "link from desk closed: it has not greeted within 10 s" in home.log


@pytest.mark.parametrize("lost_after", [1.0, 15.0])
async def test_a_host_that_has_not_started_yet_is_waited_for_like_in_portal_calls(team, /, lost_after):
    (away,) = await team.up(team.mission(PROGRAM, DEPLOYMENT), "away")
    started = asyncio.get_running_loop().time()
    (outcome,) = await wait_until_done(away.host, lost_after)
    assert outcome.outcome == "unheard"
    assert outcome.detail.startswith("it starts on home, and home has been unreachable for ")
    assert asyncio.get_running_loop().time() - started >= max(10.0, lost_after) - 1.5
