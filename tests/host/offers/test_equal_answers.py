"""A query has the same answer for a program on a host and for `lfield query --at` that host."""

from __future__ import annotations

import asyncio
from types import SimpleNamespace

import pytest
from msgspec import msgpack

from lfield.capability.condition_compiler import compile_query
from lfield.capability.matching.explanation import render_refusals
from lfield.capability.matching.matcher import Matcher
from lfield.capability.model import ANY_OFFER
from lfield.host.offer_queries import to_vm_offer
from lfield.manifest import Observation
from lfield.operator.team_query import read_context, roster_from_files, roster_from_hosts
from lfield.wire.observer_messages import Status

PROGRAM = """
resource Hoist {
    Mavlink fc;
    init(string[] arg) { while (true) yield(); }
    portal lift(real height) emit real { return height; }
    portal lower(real height) emit real { return height; }
}
resource Winch {
    init(string[] arg) { while (true) yield(); }
    portal unwind(real height) { }
}
coordinator Foreman { init(string[] arg) { Lift[] who = findLift(); sleep(1000.0); } }
"""
CAPABILITIES = """
registry: 1
attributes: {note: {type: text, live: true, max_age: 5.0}}
providers:
  Hoist:
    nominal: {payload: 2.0}
    live: {battery: fc.battery, north: "fc.position[0]", east: "fc.position[1]", note: fc.mode}
    serves: {Lift: {}}
agents: {three: {payload: 5.0}}
"""
BINDINGS = "agents: {two: {attributes: {payload: 3 kg, tools: [sling]}}}"
TEAM = "//Hoist:one@a\n//Hoist:two@b\n//Hoist:three@b\n//Winch:drum@c\n//Foreman:foreman@a\n"
#: A coordinator that has reserved nothing.
CALLER = SimpleNamespace(id="foreman")
CONDITIONS = [
    None,
    "payload >= 2.5",
    "battery > 0.5 && tools == sling",
    "battery >= 0.0 order by battery desc",
    "north > 0 || payload > 4",
]


class Telemetry:
    """The telemetry of the devices of a host, at irregular times."""

    def __init__(self, running, number):
        self.clock, self.number, self.values = running.host.clock, number, {}
        guards = running.host.guards
        guards.open, guards.last, guards.unavailability = self.open, self.last, {}.get

    async def open(self, devices, recording):
        pass

    def last(self, device, quantity):
        value = self.values.get(quantity)
        age = (self.number + len(device) + len(quantity)) / 7.0
        return None if value is None else Observation(value, self.clock.monotonic() - age)


@pytest.mark.few(2)
@pytest.mark.parametrize("condition", CONDITIONS)
async def test_a_query_from_outside_equals_that_of_the_program(team, /, condition):
    mission = team.mission(PROGRAM, TEAM, BINDINGS, capabilities=CAPABILITIES, simulate=True)
    hosts = {name: team.make(mission, name) for name in "abc"}
    devices = [Telemetry(running, number) for number, running in enumerate(hosts.values())]
    await asyncio.gather(*(running.host.start() for running in hosts.values()))
    await asyncio.sleep(3.3)
    devices[0].values = {"battery": 1 / 3, "position": [1.0, 2.0, 3.0], "mode": "x" * 1000}
    devices[1].values = {"battery": 2 / 3, "position": [5.0, -2.0, 0.0]}
    await asyncio.sleep(3.1)
    devices[1].values["battery"] = 0.9
    await asyncio.sleep(1.7)
    files = read_context(team.folder / "mission.dL", mission.team)
    registry, ways = files.registry, files.realisations
    numbers = {member.id: member.number for member in mission.team.members}
    for name, running in hosts.items():
        status = msgpack.decode(msgpack.encode(running.host.status()), type=Status)
        directory = {name: {one.agent: one for one in status.directory}}
        matcher = Matcher(
            registry, roster_from_hosts(registry, mission.team.deployed, directory, (), name), ways
        )
        query = compile_query(condition or "true", registry.attributes)
        outside = matcher.find("Lift", query)
        inside = running.host.core.services.offers(CALLER, "Lift", condition or "true")
        found = [to_vm_offer(offer, numbers, outside.count) for offer in outside.offers]
        assert [facts_of(offer) for offer in found] == [facts_of(offer) for offer in inside]
        assert [offer.score for offer in found] == [offer.score for offer in inside]
        reason = render_refusals(matcher.explain("Lift", query.condition))
        assert reason in running.host.core.services.explain(CALLER, "Lift", condition or "true")
    assert inside or condition == "battery > 0.5 && tools == sling"


PLACED = """
resource Hoist {
    init(string[] arg) { }
    portal lift(real height) emit real { return height; }
    portal lower(real height) emit real { return height; }
}
coordinator Foreman {
    init(string[] arg) { sleep(2.0); Lift[] all = findLift(); reserve (all[0]) { sleep(1000.0); } }
}
"""
PLACES = """
hosts:
  a: {frame: {north: 0, east: 0}}
  b: {frame: {north: 40, east: 0}}
  desk: {frame: {north: 100, east: 0}}
agents: {three: {frame: {north: 90, east: 0}}}
"""


@pytest.mark.parametrize(
    ("at", "nearest"), [("desk", ["three", "two", "one"]), ("a", ["one", "two", "three"])]
)
async def test_places_and_reservations_give_the_same_answer_inside_and_outside(team, /, at, nearest):
    """No agent is at the desk, so its pose comes from the devices file; the best offer is reserved."""
    placed = "//Hoist:one@a\n//Hoist:two@b\n//Hoist:three@b\n//Foreman:foreman@desk\n"
    capabilities = "registry: 1\nproviders: {Hoist: {serves: {Lift: {}}}}\n"
    mission = team.mission(PLACED, placed, PLACES, capabilities=capabilities, simulate=True)
    files = read_context(team.folder / "mission.dL", mission.team)
    registry, pose, deployed = files.registry, files.frames.place(at), mission.team.deployed

    def asked(roster):
        matcher = Matcher(registry, roster, files.realisations)
        return matcher.find("Lift", ANY_OFFER).offers, render_refusals(
            matcher.explain("Lift", ANY_OFFER.condition)
        )

    offers, _ = asked(roster_from_files(registry, deployed, at, files.stated, pose))
    assert [offer.agent for offer in offers] == nearest
    hosts = {name: team.make(mission, name) for name in ("a", "b", "desk")}
    await asyncio.gather(*(running.host.start() for running in hosts.values()))
    await asyncio.sleep(6.0)
    world = hosts[at].host.core.services
    status = msgpack.decode(msgpack.encode(hosts[at].host.status()), type=Status)
    directory = {at: {one.agent: one for one in status.directory}}
    offers, reason = asked(roster_from_hosts(registry, deployed, directory, (), at, pose))
    inside = world.offers(SimpleNamespace(id="other"), "Lift", None)
    assert [(o.agent, o.score) for o in offers] == [(o.agent, o.score) for o in inside]
    assert [offer.agent for offer in offers] == [agent for agent in nearest if agent != "three"]
    assert reason.startswith("three: reserved by foreman for ")
    assert [offer.agent for offer in world.offers(CALLER, "Lift", None)] == nearest
    teams = world.teams(SimpleNamespace(id="other"), "Lift", None, 3)
    assert (teams, len(world.teams(CALLER, "Lift", None, 3))) == ([], 1)


def facts_of(offer):
    numbers, ages = map(str, offer.numbers), map(str, offer.ages)
    values = zip(offer.names, map(str, offer.texts), numbers, ages, offer.sources, strict=True)
    return offer.agent, offer.host, offer.kind, sorted(values)
