"""A new start while vehicles are off the ground, or their state is unknown. Whole hosts, in virtual time."""

from __future__ import annotations

from pathlib import Path

import pytest
from test_fleet_starts import count_logged, event, mission, started, status

from lfield.host.inputs import StartOrdered
from lfield.mission.loader import load_mission
from lfield.mission.mission import Mission
from lfield.simulate import hardware
from lfield.simulate.host_fleet import Fleet, FleetOptions

FLIES = """
resource Post {
    Mavlink fc;
    init(string[] arg) { }
    portal work(real seconds) emit int { sleep(seconds); return 1; }
}
coordinator Boss {
    init(string[] arg) { print("begins"); findPost("two").work(0.1); print("ends"); }
}
"""


@pytest.mark.parametrize("keeps", [True, False])
def test_a_restart_while_a_vehicle_is_off_the_ground_starts_no_coordinator(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, keeps: bool
) -> None:
    (tmp_path / "mission.L").write_text(FLIES)
    (tmp_path / "mission.dL").write_text("//Boss:boss@alpha\n//Post:two@bravo\n")
    fleet = Fleet(load_mission(tmp_path / "mission.dL", simulate=True), 1, options=FleetOptions(keeps=keeps))
    fleet.run(5.0)
    assert count_logged(fleet, "boss: begins") == count_logged(fleet, "boss: ends") == 1
    # The coordinator has ended and its vehicle still flies.
    monkeypatch.setitem(hardware.VALUES, "boolean", False)  # type: ignore[arg-type]  # it is a dict
    fleet.run(1.0)
    fleet.stop("alpha")
    fleet.run(2.0)
    fleet.boot("alpha")
    fleet.run(5.0)
    assert count_logged(fleet, "boss: begins") == 1
    assert count_logged(fleet, "boss not started: two.fc of bravo is off the ground", "alpha") == 1
    # The landed vehicle does not take off again without a command.
    monkeypatch.setitem(hardware.VALUES, "boolean", True)  # type: ignore[arg-type]
    fleet.run(30.0)
    assert count_logged(fleet, "boss: begins") == 1
    event(fleet, StartOrdered([]))
    fleet.run(1.0)
    assert count_logged(fleet, "boss: begins") == 2


def flying_team(folder: Path, team: str, without: str = "") -> Mission:
    return mission(folder, without, team=team, text=FLIES)


@pytest.mark.parametrize(("without", "order"), [("", ["alpha", "bravo"]), ("bravo", ["bravo", "alpha"])])
def test_a_start_waits_until_vehicles_of_linked_hosts_report_ground_contact(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, without: str, order: list[str]
) -> None:
    """A host is linked before it has opened its devices, and a host that is left out may be linked."""
    fleet = Fleet(flying_team(tmp_path, "//Boss:boss@alpha\n//Post:two@bravo\n", without), 1)
    fleet.run(5.0)
    assert count_logged(fleet, "boss: begins") == 1
    monkeypatch.setitem(hardware.VALUES, "boolean", False)  # type: ignore[arg-type]  # it is a dict
    fleet.run(1.0)
    fleet.stop("alpha")
    fleet.stop("bravo")
    fleet.run(5.0)
    for name in order:
        fleet.boot(name)
        fleet.run(1.0)
    fleet.run(10.0)
    assert count_logged(fleet, "boss: begins") == 1
    start = status(fleet, "alpha").start
    assert start is not None
    assert start.held == "two.fc of bravo is off the ground: land first"


def test_a_vehicle_without_a_report_prevents_the_start_until_its_host_is_left_out(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(hardware.VALUES, "boolean", None)  # type: ignore[arg-type]
    fleet = Fleet(flying_team(tmp_path, "//Boss:boss@alpha\n//Post:two@bravo\n"), 1)
    fleet.run(20.0)
    assert not started(fleet)
    start = status(fleet, "alpha").start
    assert start is not None
    assert (start.hosts, start.held) == (["bravo"], "")
    reason = "boss not started: waiting for bravo (two.fc has not reported whether it is on the ground)"
    assert count_logged(fleet, reason, "alpha") >= 1
    event(fleet, StartOrdered(["bravo"]))
    fleet.run(2.0)
    assert started(fleet)
