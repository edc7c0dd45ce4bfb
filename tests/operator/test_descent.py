"""The descent after an emergency stop: reports of each device, and the verdict."""

from __future__ import annotations

import pytest
from scripted_snapshots import state_of

from lfield.errors import AddressError, NoListener
from lfield.operator.safe_state_progress import UNREACHABLE_TIMEOUT, SafeStateProgress
from lfield.operator.targets import HostRef
from lfield.wire.observer_messages import DeviceStatus, EmergencyStopResult, Status

ALPHA, BRAVO = HostRef("tour-1", "alpha"), HostRef("tour-1", "bravo")


def status(moving: str = "", *, latched: str = "stopped", silent: float | None = 0.1, name="fc") -> Status:
    """The snapshot of a host with one device."""
    device = DeviceStatus(name, {"height": 2.5}, silent, latched, moving)
    return Status("alpha", "", 1.0, b"", b"", [], [], [device], [], [])


def descent(problem: str = "") -> SafeStateProgress:
    """One device of one host, ten seconds before the deadline."""
    progress = SafeStateProgress(10.0, 100.0)
    progress.on_stopped(ALPHA, EmergencyStopResult({"fc": problem}))
    return progress


def look(made: SafeStateProgress, at: float, answer, place=ALPHA) -> list[str]:
    """One observation; returns the lines it gives."""
    made.set_time(at)
    made.on_host(place, state_of(answer))
    return [device.activity for device in made.changes()]


def wrong(made: SafeStateProgress) -> list[str]:
    return [sentence for _, sentence in made.verdicts()]


def test_a_device_is_observed_until_it_is_at_rest():
    progress = descent()
    assert look(progress, 100.5, status("descends, 5 m")) == ["descends, 5 m"]
    assert not progress.is_over
    assert look(progress, 102.0, status()) == ["at rest"]
    assert progress.is_over
    assert wrong(progress) == []


def test_reports_are_printed_on_change_and_at_most_once_per_second():
    progress = descent()
    assert look(progress, 100.5, status("5 m")) == ["5 m"]
    assert look(progress, 101.0, status("4 m")) == []
    assert look(progress, 101.5, status("3 m")) == ["3 m"]
    assert look(progress, 102.5, status("3 m")) == []
    assert look(progress, 103.0, status("2 m")) == ["2 m"]
    assert look(progress, 103.5, status()) == ["at rest"]
    assert look(progress, 109.0, status()) == []


def test_a_device_not_at_rest_in_time_is_a_failure():
    progress = descent()
    look(progress, 109.0, status("descends"))
    assert not progress.is_over
    look(progress, 110.0, status("descends"))
    assert progress.is_over
    assert wrong(progress) == ["NOT AT REST after 10 s; last seen 0 s ago: descends"]


def test_an_unconfirmed_device_passes_once_it_is_seen_at_rest():
    progress = descent("its safe state was not confirmed in 5 s")
    assert wrong(progress) == ["NOT CONFIRMED: its safe state was not confirmed in 5 s; last seen: never"]
    look(progress, 101.0, status())
    assert progress.is_over
    assert wrong(progress) == []


@pytest.mark.parametrize("moving", ["", "descends"])
def test_the_last_report_of_a_silent_device_is_not_its_state(moving):
    progress = descent()
    look(progress, 101.0, status("descends"))
    assert look(progress, 104.5, status(moving, silent=3.5)) == ["no longer reporting"]
    assert not progress.is_over
    look(progress, 110.0, status(moving, silent=9.0))
    assert wrong(progress) == ["NOT AT REST after 10 s: no longer reporting; last seen 9 s ago: descends"]


def test_telemetry_from_before_the_stop_does_not_count():
    progress = descent()
    assert look(progress, 100.0, status(silent=0.1)) == []
    assert look(progress, 100.5, status(silent=0.5)) == []
    assert not progress.is_over
    assert look(progress, 101.0, status(silent=0.2)) == ["at rest"]
    never_told = descent()
    assert look(never_told, 100.0, status(silent=None)) == ["at rest"]


def test_a_device_silent_before_the_stop_is_reported_with_its_last_telemetry():
    """Telemetry from before the stop does not prove rest, but it shows the last position of the device."""
    progress = descent("its safe state was not confirmed in 5 s")
    look(progress, 101.0, status("descends", silent=61.0))
    assert look(progress, 110.0, status("descends", silent=70.0)) == []
    (sentence,) = wrong(progress)
    assert sentence.endswith("; last seen 70 s ago: height 2.50"), sentence


def test_a_device_in_use_is_not_at_rest():
    """The host was restarted, or another operator has lifted the stop and released the device."""
    progress = descent()
    assert look(progress, 101.0, status(latched="")) == ["NOT in its safe state"]
    assert not progress.is_over
    look(progress, 102.0, status())
    look(progress, 103.0, status("takes off", latched=""))
    assert not progress.is_over


def test_a_host_that_ends_before_its_devices_are_at_rest_is_a_failure():
    progress = descent()
    look(progress, 101.0, status("descends"))
    assert look(progress, 102.0, NoListener("10.0.0.1:1")) == ["its host has ended"]
    assert progress.is_over
    assert progress.host_refs == set()
    assert wrong(progress) == ["NOT SEEN AT REST: its host has ended before; last seen 1 s ago: descends"]


def test_a_host_that_ends_after_its_devices_are_at_rest_passes():
    progress = descent()
    progress.on_stopped(BRAVO, EmergencyStopResult({"fc": ""}))
    look(progress, 101.0, status())
    assert not progress.is_over
    assert look(progress, 102.0, NoListener("10.0.0.1:1")) == []
    look(progress, 103.0, status(), BRAVO)
    assert progress.is_over
    assert wrong(progress) == []


def test_a_host_without_an_answer_is_asked_again():
    progress = descent()
    look(progress, 101.0, status("descends"))
    late = AddressError("10.0.0.1:1", "no answer within 2 s")
    assert look(progress, 103.0, late) == [f"its host does not answer: {late}"]
    assert progress.host_refs == {ALPHA}
    assert look(progress, 103.0, late) == []
    look(progress, 110.0, late)
    assert wrong(progress) == [
        "NOT AT REST after 10 s: its host does not answer: cannot use 10.0.0.1:1: no answer within 2 s; "
        "last seen 9 s ago: descends"
    ]
    look(progress, 110.5, status())
    assert wrong(progress) == []


def test_a_host_confirmed_by_relay_is_not_waited_for_until_the_deadline():
    """The host has confirmed the safe state through another host, and no connection to it can be made."""
    progress = SafeStateProgress(120.0, 100.0)
    progress.on_stopped(ALPHA, EmergencyStopResult({"fc": ""}))
    progress.on_stopped(BRAVO, EmergencyStopResult({"fc": ""}))
    late = AddressError("10.0.0.1:1", "no answer within 2 s")
    look(progress, 102.0, late)
    look(progress, 102.0, status(), BRAVO)
    assert not progress.is_over
    look(progress, 100.0 + UNREACHABLE_TIMEOUT, late)
    assert progress.is_over
    assert wrong(progress) == [
        f"NOT SEEN AT REST: it has confirmed its safe state, but its host does not answer: {late}"
    ]


def test_an_unreachable_host_is_asked_while_others_descend():
    progress = SafeStateProgress(120.0, 100.0)
    for place in (ALPHA, BRAVO):
        progress.on_stopped(place, EmergencyStopResult({"fc": ""}))
    look(progress, 111.0, AddressError("10.0.0.1:1", "no answer within 2 s"))
    look(progress, 111.0, status("descends"), BRAVO)
    assert not progress.is_over
    assert progress.host_refs == {ALPHA, BRAVO}
    look(progress, 115.0, status())
    look(progress, 115.0, status(), BRAVO)
    assert progress.is_over
    assert wrong(progress) == []


def test_a_host_that_has_answered_once_is_waited_for_until_the_deadline():
    progress = SafeStateProgress(120.0, 100.0)
    progress.on_stopped(ALPHA, EmergencyStopResult({"fc": ""}))
    look(progress, 101.0, status("descends"))
    look(progress, 150.0, AddressError("10.0.0.1:1", "no answer within 2 s"))
    assert not progress.is_over


def test_a_device_missing_in_the_snapshot_is_not_at_rest():
    progress = descent()
    look(progress, 110.0, status(name="other"))
    assert wrong(progress) == ["NOT AT REST after 10 s; last seen: never"]


def test_hosts_without_devices_are_not_waited_for():
    progress = SafeStateProgress(10.0, 100.0)
    progress.on_stopped(ALPHA, EmergencyStopResult({}))
    assert progress.is_over
    assert progress.host_refs == set()
    assert wrong(progress) == []
