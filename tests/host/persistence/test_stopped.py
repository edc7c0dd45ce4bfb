"""An emergency stop outlasts a restart of its host until it is lifted. In virtual time."""

from __future__ import annotations

from pathlib import Path
from secrets import token_bytes

from lfield.authority.identity import ALL_RIGHTS, Identity
from lfield.journal.records import EmergencyStopFlag
from lfield.mission.loader import load_mission
from lfield.simulate.host_fleet import Fleet, FleetOptions
from lfield.wire.observer_messages import EmergencyStop, EmergencyStopResult, Pause, with_epoch

#: It climbs repeatedly, and releases its copter whenever it is permitted.
PROGRAM = """
resource Post {
    Mavlink fc;
    init(string[] arg) { }
    portal climb(real height) {
        try { fc.release(); fc.takeoff(height); print("climbs to " + f2s(height, 0)); }
        catch (DeviceException refused) { print("no: " + refused.message()); }
    }
}
coordinator Walker {
    init(string[] arg) {
        Post post = findPost()[0];
        for (int n = 2; n < 1000; n = n + 1) {
            try { post.climb(i2f(n)); }
            catch (RestartException told) { print("told"); }
            sleep(0.5);
        }
    }
}
"""
#: A loop flies, and only the portal releases.
LOOPS = """
resource Post {
    Mavlink fc;
    init(string[] arg) { }
    portal climb(real height) {
        try { fc.release(); } catch (DeviceException refused) { }
    }
    loop tick at 1.0 { print("tick"); }
    loop fly every 2.0 { fc.goTo(0, 0, -5.0 - random()); print("climbs"); }
}
coordinator Walker {
    init(string[] arg) {
        while (true) {
            try { sleep(0.5); findPost("p").climb(1); } catch (RestartException e) { }
        }
    }
}
"""
WHY = "the emergency stop was pressed: person on the field"
STILL = f"EMERGENCY STOP still active: {WHY}; end it with 'lfield estop --lift'"


class Person:
    """Sends and lifts the stop of the host of a fleet; `kept` is the reason on the disk at each answer."""

    def __init__(self, fleet: Fleet) -> None:
        self._fleet, self.identity = fleet, Identity("person", "anna", ALL_RIGHTS)
        self.answers: list[EmergencyStopResult] = []
        self.kept: list[str] = []

    def send(self, message: object) -> None:
        """Record the answer of the host."""
        assert isinstance(message, EmergencyStopResult)
        assert len(message.id) == 16
        self.answers.append(EmergencyStopResult(message.devices, message.trouble))
        self.kept.append(kept(self._fleet))

    def stop(self, *, lift: bool = False) -> None:
        self._say(EmergencyStop(token_bytes(16), WHY, lift))

    def pause(self) -> None:
        self._say(Pause(token_bytes(16)))

    def _say(self, message: EmergencyStop | Pause) -> None:
        life = self._fleet.runs["alpha"]
        order = with_epoch(message, life.core.orders.epochs)
        life.process.loop.enter(lambda: life.host.on_message("", order, self))  # type: ignore[arg-type]


def flying(folder: Path, program: str = PROGRAM, *, keeps: bool = True) -> tuple[Fleet, Person]:
    (folder / "mission.L").write_text(program)
    (folder / "mission.dL").write_text("//Post:p@alpha\n//Walker:walker@alpha\n")
    fleet = Fleet(load_mission(folder / "mission.dL", simulate=True), 1, options=FleetOptions(keeps=keeps))
    fleet.run(8.0)
    assert climbs(fleet, 0)
    return fleet, Person(fleet)


def kept(fleet: Fleet) -> str:
    return "".join(
        page.reason for page in fleet.disks["alpha"].records() if isinstance(page, EmergencyStopFlag)
    )


def latched(fleet: Fleet) -> str:
    (device,) = fleet.runs["alpha"].host.status().devices
    return device.latched


def is_logged(fleet: Fleet, words: str, since: int) -> bool:
    return any(words in text for _, _, text in fleet.log[since:])


def climbs(fleet: Fleet, since: int) -> bool:
    return is_logged(fleet, "climbs", since)


def started_again(fleet: Fleet) -> int:
    fleet.crash("alpha")
    started = len(fleet.log)
    fleet.boot("alpha")
    fleet.run(10.0)
    return started


def test_a_restarted_host_holds_its_devices_until_the_stop_is_lifted(tmp_path: Path) -> None:
    fleet, person = flying(tmp_path)
    person.stop()
    fleet.run(5.0)
    assert (person.answers, person.kept) == ([EmergencyStopResult({"p.fc": ""})], [WHY])
    for _ in range(2):
        started = started_again(fleet)
        assert is_logged(fleet, STILL, started)
        assert latched(fleet) == WHY
        assert is_logged(fleet, f"{WHY}; 'lfield estop --lift' must come first", started)
        assert not climbs(fleet, started)
    person.stop(lift=True)
    lifted = len(fleet.log)
    fleet.run(10.0)
    assert (person.answers[-1], person.kept[-1]) == (EmergencyStopResult({"p.fc": ""}), "")
    assert climbs(fleet, lifted)
    started = started_again(fleet)
    assert not is_logged(fleet, "EMERGENCY", started)
    assert climbs(fleet, started)


def test_a_stop_is_executed_at_once_and_confirmed_when_it_is_stored(tmp_path: Path) -> None:
    fleet, person = flying(tmp_path)
    fleet.disks["alpha"].sync = 1.5
    person.stop()
    fleet.run(1.0)
    assert latched(fleet) == WHY
    assert not person.answers
    fleet.run(4.0)
    assert person.kept == [WHY]


def test_a_stop_holds_when_the_disk_fails_and_the_failure_is_reported(tmp_path: Path) -> None:
    fleet, person = flying(tmp_path)
    fleet.disks["alpha"].broken = True
    person.stop()
    fleet.run(8.0)
    assert latched(fleet) == WHY
    (answer,) = person.answers
    assert answer.devices == {"p.fc": ""}
    assert answer.trouble == (
        "emergency stop not stored: cannot use the journal of a simulation: its disk fails; after a restart "
        "this host would not restore it"
    )
    assert is_logged(fleet, answer.trouble, 0)
    person.stop(lift=True)
    fleet.run(4.0)
    assert person.answers[-1].trouble.startswith("end of the emergency stop not stored: ")
    assert person.answers[-1].trouble.endswith("; after a restart this host would hold its devices again")
    fleet.disks["alpha"].broken = False
    person.stop()
    fleet.run(8.0)
    assert person.answers[-1].trouble == ""
    assert person.kept[-1] == WHY


def test_a_host_without_a_journal_drops_the_stop_at_a_restart(tmp_path: Path) -> None:
    fleet, person = flying(tmp_path, keeps=False)
    person.stop()
    fleet.run(5.0)
    assert person.answers == [EmergencyStopResult({"p.fc": ""})]
    started = started_again(fleet)
    assert latched(fleet) == ""
    assert not is_logged(fleet, "EMERGENCY", started)


def test_a_paused_host_without_a_journal_does_not_spin(tmp_path: Path) -> None:
    fleet, person = flying(tmp_path, keeps=False)
    person.pause()
    fleet.run(5.0)
    turns, core = 0, fleet.runs["alpha"].core
    run = core.run

    def counted() -> float | None:
        nonlocal turns
        turns += 1
        assert turns < 10_000, "the core runs without a pause"
        return run()

    core.run = counted  # type: ignore[method-assign]
    fleet.run(5.0)
    assert latched(fleet) == "the mission is paused"


def test_loops_run_during_a_stop_move_nothing_and_fly_again_after_the_release(tmp_path: Path) -> None:
    fleet, person = flying(tmp_path, LOOPS)
    person.stop()
    for _ in range(2):
        started = len(fleet.log)
        fleet.run(15.0)
        assert sum("p: tick" in text for _, _, text in fleet.log[started:]) >= 9
        assert is_logged(
            fleet, f"loop fly of p failed: DeviceException: fc: held in its safe state: {WHY}", started
        )
        assert not climbs(fleet, started)
        started = started_again(fleet)  # The stop is in the journal; loops begin again.
        assert not climbs(fleet, started)
    person.stop(lift=True)
    started = len(fleet.log)
    fleet.run(6.0)
    assert climbs(fleet, started)
