"""Orders to stop and pause have ids and name epochs, also over links; the journal keeps the last id."""

from __future__ import annotations

from pathlib import Path

import pytest

from lfield.authority.identity import ALL_RIGHTS, Identity
from lfield.journal.records import EmergencyStopFlag, PauseFlag
from lfield.mission.loader import load_mission
from lfield.simulate.host_fleet import Fleet, FleetOptions
from lfield.wire.observer_messages import EmergencyStop, EmergencyStopResult, OrderChallenge, Pause
from lfield.wire.order_messages import Epochs

PROGRAM = """
resource Post {
    Mavlink fc;
    init(string[] arg) { }
    portal rest() { sleep(0.1); }
}
coordinator Walker {
    init(string[] arg) {
        Post post = findPost()[0];
        for (int n = 0; n < 1000; n = n + 1) { post.rest(); }
    }
}
"""
A, B, C = b"a" * 16, b"b" * 16, b"c" * 16


class Desk:
    """Sends orders to the host of a fleet, unchanged."""

    def __init__(self, folder: Path) -> None:
        (folder / "mission.L").write_text(PROGRAM)
        (folder / "mission.dL").write_text("//Post:p@alpha\n//Walker:walker@alpha\n")
        self.fleet = Fleet(
            load_mission(folder / "mission.dL", simulate=True), 1, options=FleetOptions(keeps=True)
        )
        self.identity = Identity("person", "anna", ALL_RIGHTS)
        self.answers: list[EmergencyStopResult | OrderChallenge] = []
        self.fleet.run(3.0)

    def send(self, message: object) -> None:
        """Record the answer of the host."""
        assert isinstance(message, EmergencyStopResult | OrderChallenge)
        self.answers.append(message)

    @property
    def epochs(self) -> Epochs:
        return self.fleet.runs["alpha"].core.orders.epochs

    def say(self, message: EmergencyStop | Pause) -> EmergencyStopResult | OrderChallenge:
        life = self.fleet.runs["alpha"]
        life.process.loop.enter(lambda: life.host.on_message("", message, self))  # type: ignore[arg-type]
        self.fleet.run(6.0)
        return self.answers[-1]

    def stop(self, id: bytes, epoch: bytes) -> EmergencyStopResult | OrderChallenge:
        return self.say(EmergencyStop(id, "fog", epoch=epoch))

    def lift(self, id: bytes, epoch: bytes) -> EmergencyStopResult | OrderChallenge:
        return self.say(EmergencyStop(id, "", lift=True, epoch=epoch))

    @property
    def stopped(self) -> str:
        return self.fleet.runs["alpha"].host.status().stopped

    def presses(self) -> int:
        return sum("EMERGENCY STOP by anna" in text for _, _, text in self.fleet.log)

    def kept(self) -> set[bytes]:
        pages = self.fleet.disks["alpha"].records()
        return {page.order for page in pages if isinstance(page, EmergencyStopFlag | PauseFlag)}


@pytest.fixture
def desk(tmp_path: Path) -> Desk:
    return Desk(tmp_path)


def test_a_repeated_order_is_executed_once_and_confirmed_again(desk: Desk) -> None:
    first = desk.stop(A, desk.epochs.hold)
    assert first == EmergencyStopResult({"p.fc": ""}, "", A, desk.epochs)
    assert desk.stop(A, bytes(8)) == first
    assert desk.presses() == 1
    assert desk.kept() == {A}


def test_a_copy_of_a_stop_after_its_lift_does_nothing_and_reports_it(desk: Desk) -> None:
    before = desk.epochs.hold
    desk.stop(A, before)
    desk.lift(B, desk.epochs.end)
    copy = desk.stop(A, before)
    assert isinstance(copy, EmergencyStopResult)
    assert copy.trouble == "this emergency stop was carried out, and a later order has ended it"
    assert desk.stopped == ""
    assert desk.stop(C, before) == OrderChallenge(C, desk.epochs)
    assert (desk.stopped, desk.presses()) == ("", 1)
    assert isinstance(desk.stop(C, desk.epochs.hold), EmergencyStopResult)
    assert desk.stopped == "fog"


def test_a_lift_given_before_a_stop_or_a_pause_does_not_end_it(desk: Desk) -> None:
    desk.stop(A, desk.epochs.hold)
    epoch = desk.epochs.end
    desk.say(Pause(B, epoch=desk.epochs.hold))
    refused = desk.lift(C, epoch)
    assert isinstance(refused, EmergencyStopResult)
    assert refused.trouble.startswith("a newer emergency stop arrived before this order")
    assert refused.devices == {"p.fc": refused.trouble}
    assert desk.stopped == "fog"
    assert desk.lift(C, bytes(8)) == OrderChallenge(C, desk.epochs)
    assert desk.lift(C, desk.epochs.end) == EmergencyStopResult({"p.fc": ""}, "", C, desk.epochs)
    assert desk.stopped == ""
    assert desk.fleet.runs["alpha"].host.status().paused


def test_a_repeated_lift_is_confirmed_and_ends_no_newer_stop(desk: Desk) -> None:
    desk.stop(A, desk.epochs.hold)
    epoch = desk.epochs.end
    assert desk.lift(B, epoch) == desk.lift(B, epoch) == EmergencyStopResult({"p.fc": ""}, "", B, desk.epochs)
    desk.stop(C, desk.epochs.hold)
    again = desk.lift(B, epoch)
    assert isinstance(again, EmergencyStopResult)
    assert again.devices == {"p.fc": "fog"}
    assert desk.stopped == "fog"


def test_after_a_restart_the_last_order_is_known_and_old_epochs_are_not(desk: Desk) -> None:
    before = desk.epochs
    desk.stop(A, before.hold)
    desk.fleet.crash("alpha")
    desk.fleet.boot("alpha")
    desk.fleet.run(5.0)
    assert not {desk.epochs.hold, desk.epochs.end} & {before.hold, before.end}
    assert desk.stop(A, before.hold) == EmergencyStopResult({"p.fc": ""}, "", A, desk.epochs)
    assert desk.stop(B, before.hold) == OrderChallenge(B, desk.epochs)
    assert desk.presses() == 1
    assert desk.stopped == "fog"


def test_a_pause_follows_the_same_rules(desk: Desk) -> None:
    before = desk.epochs
    assert isinstance(desk.say(Pause(A, epoch=before.hold)), EmergencyStopResult)
    assert isinstance(desk.say(Pause(A, epoch=before.hold)), EmergencyStopResult)
    refused = desk.say(Pause(B, lift=True, epoch=before.end))
    assert isinstance(refused, EmergencyStopResult)
    assert refused.trouble.startswith("a newer pause arrived")
    desk.say(Pause(B, lift=True, epoch=desk.epochs.end))
    assert not desk.fleet.runs["alpha"].host.status().paused
    assert desk.say(Pause(C, epoch=before.hold)) == OrderChallenge(C, desk.epochs)
    assert desk.kept() == {B}
