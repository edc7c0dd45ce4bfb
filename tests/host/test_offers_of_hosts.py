"""The offers of a host to its programs: of all hosts, without a message, and stale offers."""

from __future__ import annotations

import asyncio
from types import SimpleNamespace

import pytest

from lfield.capability.directory.directory_delta import Unavailability
from lfield.capability.registry_reader.registry_files import read_registry
from lfield.errors import ConstraintError
from lfield.host.team_directory import SAMPLE_EVERY
from lfield.manifest import Observation
from lfield.wire.messages import AgentUpdate, AttributeUpdate, DirectoryUpdate

#: A coordinator that has reserved nothing.
ASKER = SimpleNamespace(id="foreman")
CRANES = """
resource Crane {
    Mavlink fc;
    string id;
    init(string[] arg) { id = arg[0]; }
    portal hoist(real height) emit real {
        write(id + " hoists " + f2s(height, 1) + "\\n");
        return height;
    }
}
"""
CAPABILITIES = """
registry: 1
providers:
  Crane:
    attributes: {payload: 50.0}
    live: {battery: fc.battery, armed: fc.armed}
    serves: {Lift: {portals: {lift: hoist, lower: hoist}}}
agents:
  small: {payload: 1.0}
"""
IDLE = CRANES + "coordinator Foreman { init(string[] arg) { Lift[] who = findLift(); sleep(1000.0); } }"
TWO_HOSTS = "//Crane:near@alpha\n//Foreman:foreman@alpha\n//Crane:small@bravo\n//Crane:far@bravo\n"


class Devices:
    """The devices of one host, set by the test: their last values and troubles."""

    def __init__(self, running):
        self.values, self.troubles = {}, {}
        self.asked = 0
        self.clock = running.host.clock
        guards = running.host.guards
        guards.open = self.open
        guards.last = self.last
        guards.unavailability = self.troubles.get

    async def open(self, devices, recording):
        pass

    def last(self, device, quantity):
        self.asked += 1
        if (device, quantity) not in self.values:
            return None
        value, age = self.values[device, quantity]
        return Observation(value, self.clock.monotonic() - age)


async def two_hosts(team, program=IDLE, **options):
    """alpha and bravo with their devices, linked."""
    mission = team.mission(program, TWO_HOSTS, capabilities=CAPABILITIES, simulate=True)
    hosts = [team.make(mission, name, **options) for name in ("alpha", "bravo")]
    devices = [Devices(running) for running in hosts]
    for running in hosts:
        team.on_the_ground(running)
    await asyncio.gather(*(running.host.start() for running in hosts))
    await team.until(lambda: hosts[0].host.peers.incarnations and hosts[1].host.peers.incarnations)
    return (*hosts, *devices)


def known(running, agent):
    return next(entry for entry in running.host.status().directory if entry.agent == agent)


def offered(running, constraint=None):
    found = running.host.core.services.offers(ASKER, "Lift", constraint)
    return [offer.agent for offer in found]


async def test_live_values_come_from_their_hosts_and_are_sent_only_if_they_change(team, /):
    alpha, bravo, _, devices = await two_hosts(team)
    assert known(alpha, "far").unknown == {
        "battery": "fc has not reported battery", "armed": "fc has not reported armed",
    }  # fmt: skip
    devices.values["far.fc", "battery"] = (0.75, 0.1)
    await team.until(lambda: "battery" in known(alpha, "far").facts)
    assert known(alpha, "far").facts["battery"].value == 0.75
    assert 0.1 <= known(alpha, "far").facts["battery"].age <= 1.2
    sent = team.network.sent["DirectoryUpdate"]
    await asyncio.sleep(20.0)
    assert team.network.sent["DirectoryUpdate"] == sent
    # It has not changed for 20 s, and is still fresh: its host is linked and would have sent a change.
    assert known(alpha, "far").facts["battery"].age <= 1.2
    devices.values["far.fc", "battery"] = (0.752, 0.1)
    await asyncio.sleep(3.0)
    assert team.network.sent["DirectoryUpdate"] == sent
    devices.values["far.fc", "battery"] = (0.7, 0.1)
    await asyncio.sleep(3.0)
    assert team.network.sent["DirectoryUpdate"] == sent + 1
    assert known(alpha, "far").facts["battery"].value == 0.7
    assert offered(alpha, "battery >= 0.7") == offered(bravo, "battery >= 0.7") == ["far"]


async def test_changes_are_sent_at_a_bounded_rate(team, /):
    _, bravo, _, devices = await two_hosts(team)
    before = team.network.sent["DirectoryUpdate"]
    for step in range(500):
        devices.values["far.fc", "battery"] = (step / 500, 0.0)
        bravo.host.core.services.offers(ASKER, "Lift", None)
        await asyncio.sleep(0.02)
    assert team.network.sent["DirectoryUpdate"] - before <= 10.0 / SAMPLE_EVERY + 1


async def test_a_thousand_queries_make_no_message_and_no_hop(team, /):
    program = CRANES + """
coordinator Foreman {
    init(string[] arg) {
        sleep(5.0);
        int all = 0;
        for (int i = 0; i < 1000; i = i + 1) {
            Lift[] who = findLift("payload >= 2.0");
            all = all + who.length();
        }
        string why = explainLift("payload >= 2.0");
        print(i2s(all) + " offers, " + i2s(hops()) + " hops; " + why);
        sleep(1000.0);
    }
}
"""  # fmt: skip

    alpha, *_ = await two_hosts(team, program)
    await asyncio.sleep(4.9)
    alpha.host.core.services.offers(ASKER, "Lift", None)
    before = team.network.sent.copy()
    sent = {}
    writes = alpha.host.core.services.log

    def log(agent, text):
        sent.update(team.network.sent - before)
        writes(agent, text)

    alpha.host.core.services.log = log
    await team.until(lambda: "2000 offers" in alpha.log)
    said = alpha.log.replace("1.0 <", "1 <")
    assert "2000 offers, 0 hops; there are 2 offers, by 2 agents\n    small: payload 1 < 2.0" in said
    assert not (sent.keys() - {"Ping", "Pong"})


async def test_an_unavailable_agent_is_not_offered_and_is_explained(team, /):
    alpha, bravo, near, far = await two_hosts(team)
    near.troubles["near.fc"] = Unavailability("fc: in its safe state hold: the host was silent")
    far.troubles["far.fc"] = Unavailability("fc: no message", asyncio.get_running_loop().time() - 3.0)
    assert sorted(offered(alpha)) == ["far", "small"]
    assert "near: fc: in its safe state hold: the host was silent" in alpha.host.core.services.explain(
        ASKER, "Lift", None
    )
    await asyncio.sleep(1.5)
    assert offered(alpha) == offered(bravo) == ["small"]
    alpha.host.step()
    assert "far: fc: no message for 4.5 s" in alpha.host.core.services.explain(ASKER, "Lift", None)
    team.network.partition("alpha", "bravo")
    await asyncio.sleep(12.0)
    alpha.host.step()
    assert offered(alpha) == []
    assert "small: unreachable for 12 s" in alpha.host.core.services.explain(ASKER, "Lift", None)
    del far.troubles["far.fc"]
    team.network.heal("alpha", "bravo")
    await asyncio.sleep(3.0)
    assert sorted(offered(alpha)) == ["far", "small"]


async def test_a_dead_resource_is_not_offered(team, /):
    program = IDLE.replace(
        "id = arg[0];", 'id = arg[0]; sleep(3.0); int[] no; if (id == "far") no = new int[-1];'
    )

    alpha, *_ = await two_hosts(team, program)
    await asyncio.sleep(1.0)
    assert "far" in offered(alpha)
    await asyncio.sleep(5.0)
    assert "far" not in offered(alpha)
    assert "far: died of " in alpha.host.core.services.explain(ASKER, "Lift", None)


async def test_a_reconnected_host_is_up_to_date_after_one_exchange(team, /):
    alpha, bravo, near, far = await two_hosts(team)
    team.network.partition("alpha", "bravo")
    await asyncio.sleep(5.0)
    far.values["far.fc", "battery"] = (0.5, 0.0)
    near.values["near.fc", "battery"] = (0.25, 0.0)
    await asyncio.sleep(5.0)
    team.network.heal("alpha", "bravo")
    before = team.network.sent["DirectoryUpdate"]
    await team.until(lambda: alpha.host.peers.incarnations and bravo.host.peers.incarnations)
    await asyncio.sleep(0.1)
    assert team.network.sent["DirectoryUpdate"] - before == 2
    assert known(alpha, "far").facts["battery"].value == 0.5
    assert known(bravo, "near").facts["battery"].value == 0.25


async def test_a_snapshot_has_attributes_of_agents_on_other_hosts_only_on_request(team, /):
    """Each host has those of all agents, so a large team would send them for each pair of hosts."""
    alpha, _, near, far = await two_hosts(team)
    near.values["near.fc", "battery"] = far.values["far.fc", "battery"] = (0.75, 0.1)
    await team.until(lambda: "battery" in known(alpha, "far").facts)
    subscriptions = alpha.host._observers.subscriptions
    full, brief = (subscriptions.snapshot_batch(directory=all_of).snapshot for all_of in (True, False))
    assert "battery" in {t.agent: t for t in full.directory}["far"].facts
    found = {t.agent: t for t in brief.directory}
    assert found.keys() == {t.agent for t in full.directory}
    assert "battery" in found["near"].facts
    assert (found["far"].refusal, found["far"].facts, found["far"].unknown) == ("", {}, {})


async def test_a_program_without_capabilities_causes_no_queries_and_messages(team, /):
    program = CRANES + "coordinator Foreman { init(string[] arg) { sleep(1000.0); } }"

    alpha, _, near, far = await two_hosts(team, program)
    near.values["near.fc", "battery"] = (0.5, 0.0)
    await asyncio.sleep(10.0)
    assert team.network.sent["DirectoryUpdate"] == 0
    assert near.asked == far.asked == 0
    # Their availability is still known.
    assert [(t.agent, t.refusal, t.facts) for t in alpha.host.status().directory] == [
        ("near", "", {}),
        ("small", "", {}),
        ("far", "", {}),
    ]
    assert near.asked == far.asked == 0


NAMES = sorted(read_registry().attributes)
ARMED, BATTERY = NAMES.index("armed"), NAMES.index("battery")


def far_report(*facts, agent=3, unknown=()):
    return [AgentUpdate(agent, "", None, list(facts), list(unknown))]


@pytest.mark.few(5)
@pytest.mark.parametrize(
    ("agents", "why"),
    [
        (far_report(agent=0), "bravo reports on agent 0, which is none of its"),
        (far_report(agent=1), "bravo reports on agent 1, which is none of its"),
        (far_report(agent=77), "bravo reports on agent 77, which is none of its"),
        (
            far_report(AttributeUpdate(999, 1.0, 0.0, True)),
            f"attribute 999 of far, and there are {len(NAMES)}",
        ),
        (far_report(unknown=[(999, "no")]), f"attribute 999 of far, and there are {len(NAMES)}"),
        (
            far_report(AttributeUpdate(ARMED, 1.0, 0.0, True)),
            "says 1.0 for armed of far, whose type is boolean",
        ),
        (
            far_report(AttributeUpdate(BATTERY, True, 0.0, True)),
            "says True for battery of far, whose type is real",
        ),
        (
            far_report(AttributeUpdate(BATTERY, "full", 0.0, True)),
            "says 'full' for battery of far, whose type is real",
        ),
        (
            far_report(AttributeUpdate(BATTERY, float("nan"), 0.0, True)),
            "says nan for battery of far, whose type is real",
        ),
        (
            far_report(AttributeUpdate(BATTERY, float("inf"), 0.0, True)),
            "says inf for battery of far, whose type is real",
        ),
    ],
)
async def test_an_invalid_report_is_ignored_and_logged_once(team, /, agents, why):
    alpha, bravo, _, far = await two_hosts(team)
    far.values["far.fc", "battery"] = (0.5, 0.0)
    await asyncio.sleep(2.0)
    before = known(alpha, "far")
    for sequence in (1000, 1001):
        bravo.host.peers.send("alpha", DirectoryUpdate(bravo.host.core.incarnation, 0, sequence, agents))
    await asyncio.sleep(0.5)
    assert alpha.log.count("status report ignored: ") == 1
    assert why in alpha.log
    assert known(alpha, "far").facts.keys() == before.facts.keys()
    assert alpha.host.peers.incarnations


STALE = (
    CRANES
    + """
coordinator Foreman {
    init(string[] arg) {
        sleep(3.0);
        Lift[] who = findLift("payload >= 2.0");
        print(who[0].agent() + " then " + who[1].agent());
        sleep(10.0);
        for (int i = 0; i < who.length(); i = i + 1) {
            try {
                real height = who[i].lift(1.5);
                print("lifted by " + who[i].agent());
                i = who.length();
            } catch (UnreachableResourceException e) {
                print("stale: " + e.source());
            }
        }
    }
}
"""
)


async def test_a_stale_offer_raises_an_exception_and_the_next_one_is_tried(team, /):
    deployment = "//Foreman:foreman@alpha\n//Crane:far@bravo\n//Crane:near@alpha\n//Crane:small@alpha\n"
    capabilities = CAPABILITIES + "  near: {payload: 2.0}\nranking: {weights: {hop: 0.0}}\n"

    mission = team.mission(STALE, deployment, capabilities=capabilities, simulate=True)
    alpha, bravo = (team.make(mission, name, unreachable_after=4.0) for name in ("alpha", "bravo"))
    for running in (alpha, bravo):
        Devices(running)
        team.on_the_ground(running)
    await asyncio.gather(alpha.host.start(), bravo.host.start())
    await team.until(lambda: "far then near" in alpha.log)
    await bravo.host.stop()
    assert await team.ended("foreman") == "done"
    assert "stale: far" in alpha.log
    assert "lifted by near" in alpha.log
    assert alpha.output == ["near hoists 1.5"]
    assert bravo.output == []


async def test_an_invalid_condition_is_an_error(team, /):
    alpha, *_ = await two_hosts(team)
    with pytest.raises(ConstraintError):
        alpha.host.core.services.offers(ASKER, "Lift", "paylod >= 2.0")
    with pytest.raises(ConstraintError):
        alpha.host.core.services.explain(ASKER, "Lift", "payload >=")
