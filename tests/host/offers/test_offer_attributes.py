"""The attributes of an offer and their sources: type, binding, devices, portals."""

from __future__ import annotations

import asyncio
import re
from types import SimpleNamespace

import pytest

from lfield.errors import BindingError, ProgramError
from lfield.manifest import Observation

HOISTS = """
resource Hoist {
    Mavlink fc;
    real raised;
    boolean broken;
    int asked;
    init(string[] arg) { raised = 1500.0; }
    portal lift(real height) emit real {
        raised = raised + 1000.0 * height;
        broken = height > 8.0;
        return height;
    }
    portal lower(real height) emit real { raised = raised - 1000.0 * height; return height; }
    portal level() emit real {
        if (broken) throw new DeviceException("the rope is torn");
        return raised;
    }
    portal place() emit real[] { real[] at = {1.0, 2.0, -3.0}; return at; }
    portal count() emit int { asked = asked + 1; return asked; }
    portal rise() emit real { fc.takeoff(1.0); return raised; }
    portal slow() emit real { sleep(1000.0); return 1.0; }
}
"""
CAPABILITIES = """
registry: 1
attributes:
  level: {type: real, unit: m, live: true, max_age: 6.0}
  slowness: {type: real, live: true, max_age: 6.0}
providers:
  Hoist:
    nominal: {payload: 2.0, speed: 0.5, mass: 9.0}
    attributes: {chassis: fixed, tools: [hook]}
    live:
      battery: fc.battery
      speed: fc.groundSpeed
      level: {from: level(), unit: mm, every: 2.0}
      east: "place()[1]"
      slowness: slow()
    serves: {Lift: {nominal: {reach: 0.5}}}
agents: {far: {mass: 3.0}}
"""
BINDINGS = (
    "agents: {near: {attributes: {payload: 1200 g, tools: [winch, sling]}}, far: {attributes: {mass: 8}}}"
)
TEAM = "//Hoist:near@alpha\n//Foreman:foreman@bravo\n//Hoist:far@bravo\n"
#: A coordinator that has reserved nothing.
CALLER = SimpleNamespace(id="foreman")
IDLE = "coordinator Foreman { init(string[] arg) { Lift[] who = findLift(); sleep(1000.0); } }"


class Telemetry:
    """The telemetry of the devices of a host, set by the test."""

    def __init__(self, running):
        self.values = {}
        self.clock = running.host.clock
        guards = running.host.guards
        guards.open, guards.last, guards.unavailability = self.open, self.last, {}.get

    async def open(self, devices, recording):
        pass

    def last(self, device, quantity):
        value = self.values.get((device, quantity))
        return None if value is None else Observation(value, self.clock.monotonic() - 0.25)


async def start_hoists(team, program=IDLE, capabilities=CAPABILITIES):
    """alpha and bravo, linked, and the telemetry of alpha."""
    mission = team.mission(HOISTS + program, TEAM, BINDINGS, capabilities=capabilities, simulate=True)
    alpha, bravo = (team.make(mission, name) for name in ("alpha", "bravo"))
    telemetry, _ = Telemetry(alpha), Telemetry(bravo)
    for running in (alpha, bravo):
        team.on_the_ground(running)
    await asyncio.gather(alpha.host.start(), bravo.host.start())
    await team.until(lambda: alpha.host.peers.incarnations and bravo.host.peers.incarnations)
    await asyncio.sleep(4.0)
    return alpha, bravo, telemetry


def facts_of(running, agent, condition=None):
    """The attributes of an agent's offer, as the coordinator sees it: texts or numbers, and sources."""
    found = running.host.core.services.offers(CALLER, "Lift", condition)
    offer = next(offer for offer in found if offer.agent == agent)
    values = zip(offer.names, offer.texts, offer.numbers, offer.sources, strict=True)
    return {name: (number if text is None else text, source) for name, text, number, source in values}


async def test_every_attribute_of_an_offer_has_its_source(team, /):
    alpha, bravo, telemetry = await start_hoists(team)
    telemetry.values["near.fc", "battery"], telemetry.values["near.fc", "groundSpeed"] = 0.75, 4.0
    await asyncio.sleep(2.0)
    for host in (alpha, bravo):
        near, far = facts_of(host, "near"), facts_of(host, "far")
        assert near["payload"] == (1.2, "stated")
        assert near["tools"] == ("sling, winch", "stated")
        assert near["chassis"] == ("fixed", "stated")
        assert near["reach"] == (0.5, "nominal")
        assert near["mass"] == (9.0, "nominal")
        assert near["speed"] == (4.0, "reported by the device")
        assert near["battery"] == (0.75, "measured")
        # Without telemetry the nominal value counts; the mission's registry precedes the binding.
        assert far["speed"] == (0.5, "nominal")
        assert far["mass"] == (3.0, "stated")


async def test_a_query_portal_provides_an_attribute(team, /):
    alpha, bravo, _ = await start_hoists(team)
    for host in (alpha, bravo):
        near = facts_of(host, "near", "level > 1.4")
        assert near["level"] == (1.5, "measured")
        assert near["east"] == (2.0, "measured")
        assert "slowness" not in near
        reason = host.host.core.services.explain(CALLER, "Lift", "slowness > 0.0")
        assert "near: near has not reported slow()" in reason


async def test_a_failing_portal_makes_its_attribute_unknown_until_it_recovers(team, /):
    program = """
coordinator Foreman {
    init(string[] arg) {
        Lift near = findLift("agent == \\"near\\"")[0];
        sleep(5.0);
        near.lift(9.0);
        sleep(10.0);
        near.lift(0.5);
        sleep(1000.0);
    }
}
"""

    alpha, _, _ = await start_hoists(team, program)
    await team.until(lambda: "rope" in alpha.host.core.services.explain(CALLER, "Lift", "level > 0.0"))
    reason = alpha.host.core.services.explain(CALLER, "Lift", "level > 0.0")
    assert "near: level() throws DeviceException: the rope is torn" in reason
    await team.until(lambda: facts_of(alpha, "near").get("level") == (11.0, "measured"))


async def test_attribute_queries_do_not_count_as_served_calls(team, /):
    alpha, _, _ = await start_hoists(team)
    await asyncio.sleep(20.0)
    near = alpha.host.machine.agents["near"]
    assert near.served == 0
    # A portal that never answers is called once.
    assert len(alpha.host.machine._scheduler.resource_queries) == 1


async def test_the_age_of_a_value_grows_after_the_query(team, /):
    program = """
coordinator Foreman {
    init(string[] arg) {
        sleep(10.0);
        Lift near = findLift("agent == \\"near\\"")[0];
        real first = near.age("level");
        sleep(7.0);
        print("older by " + f2s(near.age("level") - first, 1) + " and " + f2s(near.age("payload"), 1));
        print("it was " + near.source("level") + ", " + near.source("mass"));
        near.lift(1.0);
        print("no younger: " + b2s(near.age("level") >= 7.0));
        sleep(1000.0);
    }
}
"""

    alpha, bravo, _ = await start_hoists(team, program)
    await team.until(lambda: "no younger" in alpha.log)
    assert "older by 7.0 and 0.0" in bravo.log
    assert re.search(r"it was measured \d\.\d s ago, nominal", bravo.log)
    assert "no younger: true" in alpha.log


@pytest.mark.parametrize(
    ("source", "code", "told"),
    [
        ("lift()", "C178", "resource Hoist has no portal lift() without parameters"),
        ("heigth()", "C178", "resource Hoist has no portal heigth() without parameters"),
        ("count()", "C179", "Hoist.count() has side effects"),
        ("rise()", "C179", "Hoist.rise() has side effects"),
        ("place()", "C174", "'level' is real, and place() is real[]"),
        ("{from: level(), every: 9}", "C107", "'level' is polled every 9 s, but its 'max_age' is 6 s"),
        ("{from: level(), every: 0.1}", "Y113", "'every' must be from 1 to 3600, not 0.1"),
    ],
)
async def test_an_unsuitable_portal_for_an_attribute_is_refused(team, /, source, code, told):
    capabilities = CAPABILITIES.replace("{from: level(), unit: mm, every: 2.0}", source)
    with pytest.raises(ProgramError) as error:
        team.mission(HOISTS + IDLE, TEAM, capabilities=capabilities, simulate=True)
    output = "\n".join(d.render() for d in error.value.diagnostics)
    assert code in output, output
    assert told in output, output


@pytest.mark.parametrize(
    ("stated", "told"),
    [
        ("payloda: 1.0", "there is no attribute 'payloda'"),
        ("payload: heavy", "'payload' is a number in kg, not the text 'heavy'"),
        ("payload: 3 m", "'m' cannot be converted to 'kg'"),
        ("tools: [spoon]", "'spoon' is not a value of 'tools'"),
    ],
)
async def test_a_wrong_attribute_in_a_binding_is_reported_at_its_place(team, /, stated, told):
    bindings = f"agents: {{near: {{attributes: {{{stated}}}}}}}"
    with pytest.raises(BindingError) as error:
        team.mission(HOISTS + IDLE, TEAM, bindings, capabilities=CAPABILITIES, simulate=True)
    assert told in str(error.value), str(error.value)
    assert "mission.devices.yaml:1:" in str(error.value)


async def test_an_attribute_stated_in_two_files_gives_a_warning(team, /):
    mission = team.mission(HOISTS + IDLE, TEAM, BINDINGS, capabilities=CAPABILITIES, simulate=True)
    assert [w for w in mission.warnings if "stated" in w] == [
        "mass of far is stated in the devices file and in the mission's registry, which counts"
    ]


async def test_a_place_stated_by_frame_and_attribute_gives_a_warning(team, /):
    pose = "frame: {north: 4, east: 2}"
    bindings = f"agents: {{near: {{{pose}}}, far: {{{pose}, attributes: {{north: 5.0}}}}}}"
    capabilities = CAPABILITIES.replace('      east: "place()[1]"\n', "")
    mission = team.mission(HOISTS + IDLE, TEAM, bindings, capabilities=capabilities, simulate=True)
    assert [w for w in mission.warnings if "stated" in w] == [
        "north of far is stated in the devices file and by its frame there, which counts"
    ]
    assert mission.stated.agents["far"]["north"] == 4.0
