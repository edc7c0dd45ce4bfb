"""Vehicles without a live coordinator enter the safe state of their bindings, others do not. Virtual time."""

from __future__ import annotations

import pytest
from msgspec import structs

from lfield.driver.binding import OrphanPolicy
from lfield.mission.loader import load_mission
from lfield.mission.mission import Mission
from lfield.simulate.host_fleet import Fleet

PROGRAM = """
resource Post {
    Mavlink fc;
    init(string[] arg) { }
    portal go() { fc.goTo(1.0, 0.0, -5.0); }
    portal rest() { }
}
coordinator Pilot {
    init(string[] arg) {
        Post[] all = findPost();
        all[0].go();
        all[1].rest();
        all[2].rest();
        sleep(60.0);
        print("over");
    }
}
"""
AFTER = 20.0


@pytest.fixture(scope="module")
def mission(tmp_path_factory: pytest.TempPathFactory) -> Mission:
    folder = tmp_path_factory.mktemp("mission")
    (folder / "mission.L").write_text(PROGRAM)
    posts = "".join(f"//Post:{host[0]}@{host}\n" for host in ("alpha", "bravo", "carol"))
    (folder / "mission.dL").write_text(f"{posts}//Pilot:pilot@alpha\n")
    mission = load_mission(folder / "mission.dL", simulate=True)
    bound = {
        agent: {
            name: structs.replace(d, without_policy=OrphanPolicy(AFTER, "hold")) for name, d in of.items()
        }
        for agent, of in mission.bindings.devices.items()
    }
    return mission.with_bindings(structs.replace(mission.bindings, devices=bound))


def on_its_way(fleet: Fleet) -> None:
    """Run until the pilot, which has used the vehicle of alpha, is on carol."""
    fleet.run(10.0)
    assert "pilot" in fleet.runs["carol"].core.machine.agents
    assert fleet.hardware["a.fc"].record[-1].what == "goTo"


def became(fleet: Fleet, device: str) -> list[tuple[float, str]]:
    return [(command.at, command.what) for command in fleet.hardware[device].record if command.what != "goTo"]


def latched(fleet: Fleet, host: str) -> dict[str, str]:
    return dict(fleet.runs[host].host.guards.latched)


@pytest.mark.few(0)
def test_a_vehicle_waits_its_time_for_a_coordinator_that_died_two_hosts_away(mission: Mission) -> None:
    """The intermediate host, bravo, is alive. No other vehicle has been used."""
    fleet = Fleet(mission, 1)
    on_its_way(fleet)
    fleet.crash("carol")
    fleet.run(AFTER - 7.0)
    assert became(fleet, "a.fc") == []
    fleet.run(15.0)
    assert [what for _, what in became(fleet, "a.fc")] == ["hold"]
    reason = "no coordinator that used it (pilot, last known at carol) has been confirmed alive for 20 s"
    assert latched(fleet, "alpha") == {"a.fc": reason}
    assert latched(fleet, "bravo") == {}
    assert f"a.fc in safe state 'hold': {reason}" in "".join(text for _, _, text in fleet.log)


def test_a_cut_link_to_a_live_coordinator_has_no_effect_and_its_end_has(mission: Mission) -> None:
    fleet = Fleet(mission, 2)
    on_its_way(fleet)
    fleet.cut("alpha", "carol")
    while "over" not in "".join(text for _, _, text in fleet.log):
        fleet.run(1.0)
    assert fleet.now > 60.0
    assert became(fleet, "a.fc") == []
    over = fleet.now
    fleet.run(AFTER + 10.0)
    ((when, what),) = became(fleet, "a.fc")
    assert what == "hold"
    assert AFTER - 6.0 < when - over < AFTER + 5.0


@pytest.mark.few(0)
def test_a_restarted_guard_restores_that_safe_state(mission: Mission) -> None:
    fleet = Fleet(mission, 3)
    on_its_way(fleet)
    fleet.crash("carol")
    fleet.run(AFTER + 10.0)
    fleet.runs["alpha"].process.children[-1].die(-9)
    fleet.run(5.0)
    assert became(fleet, "a.fc")[-1][1] == "hold"
