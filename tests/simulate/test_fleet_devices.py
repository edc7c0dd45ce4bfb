"""Guards and devices of a simulated team: under crashes and hangs a device has one owner and comes to
rest."""

from __future__ import annotations

import random
from itertools import pairwise

import pytest

from lfield.devices.guard_process import MAX_UNANSWERED
from lfield.devices.scheduling_jitter import HEARTBEAT_INTERVAL
from lfield.mission.bindings import SIM_SILENCE
from lfield.mission.loader import load_mission
from lfield.mission.mission import Mission
from lfield.simulate.computers.simulated_computer import SimulatedProcess
from lfield.simulate.host_fleet import Fleet
from simulation_testing.fault_injection import FaultRates

PROGRAM = """
resource Post {
    Mavlink fc;
    init(string[] arg) { }
    portal visit(real seconds) {
        fc.release();
        fc.setVelocity(1.0, 0.0, 0.0);
        sleep(seconds);
    }
}
coordinator Walker {
    init(string[] arg) {
        Post[] all = findPost();
        int at = 0;
        while (true) {
            at = at + 1;
            try { all[at % all.length()].visit(0.3); } catch (Exception lost) { }
            sleep(0.2);
        }
    }
}
"""
HOSTS = ("alpha", "bravo", "carol")


@pytest.fixture(scope="module")
def mission(tmp_path_factory: pytest.TempPathFactory) -> Mission:
    folder = tmp_path_factory.mktemp("mission")
    lines = [f"//Post:{host[0]}@{host}" for host in HOSTS]
    (folder / "mission.L").write_text(PROGRAM)
    (folder / "mission.dL").write_text("\n".join([*lines, "//Walker:walker@alpha", ""]))
    return load_mission(folder / "mission.dL", simulate=True)


def guard_of(fleet: Fleet, host: str) -> SimulatedProcess:
    (guard,) = fleet.runs[host].process.children[-1:]
    return guard


def moves_at(fleet: Fleet, device: str, seconds: float = 20.0) -> None:
    """Run until a device moves."""
    for _ in range(int(seconds / 0.01)):
        fleet.run(0.01)
        if fleet.hardware[device].is_moving:
            return
    raise AssertionError(f"{device} never moved")


def rests_within(fleet: Fleet, device: str, seconds: float) -> bool:
    """Return true if a device comes to rest in time, and stays at rest for the same time."""
    fleet.run(seconds)
    rests = not fleet.hardware[device].is_moving
    fleet.run(seconds)
    return rests and not fleet.hardware[device].is_moving


def test_the_guard_of_a_killed_host_makes_its_device_safe(mission: Mission) -> None:
    fleet = Fleet(mission, 1)
    moves_at(fleet, "b.fc")
    fleet.crash("bravo")
    assert rests_within(fleet, "b.fc", 1.5)
    assert fleet.hardware["b.fc"].record[-1].what == "land"
    assert fleet.hardware["b.fc"].owners == []


def test_the_guard_of_a_suspended_host_makes_its_device_safe(mission: Mission) -> None:
    fleet = Fleet(mission, 2)
    moves_at(fleet, "b.fc")
    fleet.runs["bravo"].process.loop.freeze()
    assert rests_within(fleet, "b.fc", SIM_SILENCE + 1.0)


@pytest.mark.parametrize("how", ["kill", "freeze"])
def test_a_device_with_a_dead_guard_is_stopped_by_its_watchdog_then_by_the_next_guard(
    mission: Mission, how: str
) -> None:
    fleet = Fleet(mission, 3)
    moves_at(fleet, "b.fc")
    guard, device = guard_of(fleet, "bravo"), fleet.hardware["b.fc"]
    before = len(device.record)
    if how == "kill":
        guard.die(-9)
    else:
        guard.loop.freeze()
        assert rests_within(fleet, "b.fc", 2 * 0.5 + 0.1)
    fleet.run(MAX_UNANSWERED * HEARTBEAT_INTERVAL + 3.0)
    assert device.record[before].what == "land"
    assert "b.fc in safe state 'land': its guard died" in "".join(text for _, _, text in fleet.log)


def test_a_device_of_a_computer_without_power_is_stopped_by_its_watchdog(mission: Mission) -> None:
    fleet = Fleet(mission, 4)
    moves_at(fleet, "c.fc")
    fleet.power_off("carol")
    assert rests_within(fleet, "c.fc", 2 * 0.5 + 0.1)


@pytest.mark.few(1)
@pytest.mark.parametrize("seed", range(4))
def test_under_random_faults_a_device_has_one_owner_and_moves_only_for_it(
    mission: Mission, seed: int
) -> None:
    unowned: dict[str, float] = {}

    def watch(fleet: Fleet) -> None:
        for name, hardware in fleet.hardware.items():
            assert len(hardware.owners) <= 1, f"{name} has {len(hardware.owners)} owners"
            if hardware.owners or not hardware.is_moving:
                unowned.pop(name, None)
            else:
                since = unowned.setdefault(name, fleet.now)
                assert fleet.now - since < 1.01, f"{name} moves without an owner since {since:.3f} s"

    fleet = Fleet(mission, seed, watch)
    rates = FaultRates(cut=5.0, kill=10.0, stop=8.0, power=10.0, guard_kill=6.0, guard_stop=6.0)
    storm = rates.inject(fleet, random.Random(seed))
    fleet.run(60.0)
    assert {what.split()[0] for _, what in storm.faults} == {"cut", "kill", "stop", "power"}
    storm.end()
    fleet.run(20.0)
    owners = [command.owner for command in fleet.hardware["a.fc"].record]
    assert all(one <= other for one, other in pairwise(owners)), (
        "an earlier owner commanded after a later one"
    )
