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
    made = SafeStateProgress(10.0, 100.0)
    made.on_stopped(ALPHA, EmergencyStopResult({"fc": problem}))
    return made


def look(made: SafeStateProgress, at: float, answer, place=ALPHA) -> list[str]:
    """One observation; returns the lines it gives."""
    made.set_time(at)
    made.on_host(place, state_of(answer))
    return [device.activity for device in made.changes()]


def wrong(made: SafeStateProgress) -> list[str]:
    return [sentence for _, sentence in made.verdicts()]


def test_a_device_is_observed_until_it_is_at_rest():
    made = descent()
    assert look(made, 100.5, status("descends, 5 m")) == ["descends, 5 m"]
    assert not made.is_over
    assert look(made, 102.0, status()) == ["at rest"]
    assert made.is_over
    assert wrong(made) == []


def test_reports_are_printed_on_change_and_at_most_once_per_second():
    made = descent()
    assert look(made, 100.5, status("5 m")) == ["5 m"]
    assert look(made, 101.0, status("4 m")) == []
    assert look(made, 101.5, status("3 m")) == ["3 m"]
    assert look(made, 102.5, status("3 m")) == []
    assert look(made, 103.0, status("2 m")) == ["2 m"]
    assert look(made, 103.5, status()) == ["at rest"]
    assert look(made, 109.0, status()) == []


def test_a_device_not_at_rest_in_time_is_a_failure():
    made = descent()
    look(made, 109.0, status("descends"))
    assert not made.is_over
    look(made, 110.0, status("descends"))
    assert made.is_over
    assert wrong(made) == ["NOT AT REST after 10 s; last seen 0 s ago: descends"]


def test_an_unconfirmed_device_passes_once_it_is_seen_at_rest():
    made = descent("its safe state was not confirmed in 5 s")
    assert wrong(made) == ["NOT CONFIRMED: its safe state was not confirmed in 5 s; last seen: never"]
    look(made, 101.0, status())
    assert made.is_over
    assert wrong(made) == []


@pytest.mark.parametrize("moving", ["", "descends"])
def test_the_last_report_of_a_silent_device_is_not_its_state(moving):
    made = descent()
    look(made, 101.0, status("descends"))
    assert look(made, 104.5, status(moving, silent=3.5)) == ["no longer reporting"]
    assert not made.is_over
    look(made, 110.0, status(moving, silent=9.0))
    assert wrong(made) == ["NOT AT REST after 10 s: no longer reporting; last seen 9 s ago: descends"]


def test_telemetry_from_before_the_stop_does_not_count():
    made = descent()
    assert look(made, 100.0, status(silent=0.1)) == []
    assert look(made, 100.5, status(silent=0.5)) == []
    assert not made.is_over
    assert look(made, 101.0, status(silent=0.2)) == ["at rest"]
    never_told = descent()
    assert look(never_told, 100.0, status(silent=None)) == ["at rest"]


def test_a_device_silent_before_the_stop_is_reported_with_its_last_telemetry():
    """Telemetry from before the stop does not prove rest, but it shows the last position of the device."""
    made = descent("its safe state was not confirmed in 5 s")
    look(made, 101.0, status("descends", silent=61.0))
    assert look(made, 110.0, status("descends", silent=70.0)) == []
    (sentence,) = wrong(made)
    assert sentence.endswith("; last seen 70 s ago: height 2.50"), sentence


def test_a_device_in_use_is_not_at_rest():
    """The host was restarted, or another operator has lifted the stop and released the device."""
    made = descent()
    assert look(made, 101.0, status(latched="")) == ["NOT in its safe state"]
    assert not made.is_over
    look(made, 102.0, status())
    look(made, 103.0, status("takes off", latched=""))
    assert not made.is_over


def test_a_host_that_ends_before_its_devices_are_at_rest_is_a_failure():
    made = descent()
    look(made, 101.0, status("descends"))
    assert look(made, 102.0, NoListener("10.0.0.1:1")) == ["its host has ended"]
    assert made.is_over
    assert made.host_refs == set()
    assert wrong(made) == ["NOT SEEN AT REST: its host has ended before; last seen 1 s ago: descends"]


def test_a_host_that_ends_after_its_devices_are_at_rest_passes():
    made = descent()
    made.on_stopped(BRAVO, EmergencyStopResult({"fc": ""}))
    look(made, 101.0, status())
    assert not made.is_over
    assert look(made, 102.0, NoListener("10.0.0.1:1")) == []
    look(made, 103.0, status(), BRAVO)
    assert made.is_over
    assert wrong(made) == []


def test_a_host_without_an_answer_is_asked_again():
    made = descent()
    look(made, 101.0, status("descends"))
    late = AddressError("10.0.0.1:1", "no answer within 2 s")
    assert look(made, 103.0, late) == [f"its host does not answer: {late}"]
    assert made.host_refs == {ALPHA}
    assert look(made, 103.0, late) == []
    look(made, 110.0, late)
    assert wrong(made) == [
        "NOT AT REST after 10 s: its host does not answer: cannot use 10.0.0.1:1: no answer within 2 s; "
        "last seen 9 s ago: descends"
    ]
    look(made, 110.5, status())
    assert wrong(made) == []


def test_a_host_confirmed_by_relay_is_not_waited_for_until_the_deadline():
    """The host has confirmed the safe state through another host, and no connection to it can be made."""
    made = SafeStateProgress(120.0, 100.0)
    made.on_stopped(ALPHA, EmergencyStopResult({"fc": ""}))
    made.on_stopped(BRAVO, EmergencyStopResult({"fc": ""}))
    late = AddressError("10.0.0.1:1", "no answer within 2 s")
    look(made, 102.0, late)
    look(made, 102.0, status(), BRAVO)
    assert not made.is_over
    look(made, 100.0 + UNREACHABLE_TIMEOUT, late)
    assert made.is_over
    assert wrong(made) == [
        f"NOT SEEN AT REST: it has confirmed its safe state, but its host does not answer: {late}"
    ]


def test_an_unreachable_host_is_asked_while_others_descend():
    made = SafeStateProgress(120.0, 100.0)
    for place in (ALPHA, BRAVO):
        made.on_stopped(place, EmergencyStopResult({"fc": ""}))
    look(made, 111.0, AddressError("10.0.0.1:1", "no answer within 2 s"))
    look(made, 111.0, status("descends"), BRAVO)
    assert not made.is_over
    assert made.host_refs == {ALPHA, BRAVO}
    look(made, 115.0, status())
    look(made, 115.0, status(), BRAVO)
    assert made.is_over
    assert wrong(made) == []


def test_a_host_that_has_answered_once_is_waited_for_until_the_deadline():
    made = SafeStateProgress(120.0, 100.0)
    made.on_stopped(ALPHA, EmergencyStopResult({"fc": ""}))
    look(made, 101.0, status("descends"))
    look(made, 150.0, AddressError("10.0.0.1:1", "no answer within 2 s"))
    assert not made.is_over


def test_a_device_missing_in_the_snapshot_is_not_at_rest():
    made = descent()
    look(made, 110.0, status(name="other"))
    assert wrong(made) == ["NOT AT REST after 10 s; last seen: never"]


def test_hosts_without_devices_are_not_waited_for():
    made = SafeStateProgress(10.0, 100.0)
    made.on_stopped(ALPHA, EmergencyStopResult({}))
    assert made.is_over
    assert made.host_refs == set()
    assert wrong(made) == []
