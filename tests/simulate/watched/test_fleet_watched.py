"""The events of a watched host, in virtual time: hops with causes, latches, every line of its log."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from secrets import token_bytes

import pytest
from event_watcher import PROGRAM, chain, fleet_of, watch

from lfield.wire import events
from lfield.wire.observer_messages import EmergencyStop, Pause, Status
from lfield.wire.subscription_messages import WINDOW, EventAck, Subscribe


def test_a_hop_can_be_followed_from_cause_to_effect_over_two_hosts(tmp_path: Path) -> None:
    fleet = fleet_of(tmp_path, 8.0)
    alpha, beta = watch(fleet, "alpha"), watch(fleet, "beta")
    fleet.run(30.0)
    arrived = {
        (e.what.agent, e.what.generation, e.what.sequence): e for e in beta.of(events.MigrationArrived)
    }  # type: ignore[union-attr]
    left = alpha.of(events.MigrationStarted)
    assert len(left) > 3
    for event in left[:-1]:
        what = event.what
        assert isinstance(what, events.MigrationStarted)
        assert (what.to, what.resource, what.portal) == ("beta", "q", "climb")
        there = arrived[what.agent, what.generation, what.sequence].what
        assert isinstance(there, events.MigrationArrived)
        assert (there.of, there.size) == ("alpha", what.size)
        assert what.size > 100
    # The causes of the departure: it arrived, its portal began, commanded the copter, and ended.
    last = chain(alpha, left[-2])
    assert last[:6] == ["printed", "ended", "answered", "asked", "began", "came"]
    migrated = alpha.of(events.MigrationConfirmed)
    known = alpha.by_number()
    assert all(
        isinstance(known[event.cause].what, events.MigrationStarted)
        for event in migrated
        if event.cause in known
    )
    assert all(0.0 < event.what.seconds < 0.5 for event in migrated if event.cause in known)  # type: ignore[union-attr]


def test_portal_calls_and_instructions_have_names_and_durations(tmp_path: Path) -> None:
    fleet = fleet_of(tmp_path, 5.0)
    watcher = watch(fleet, "alpha")
    fleet.run(10.0)
    ended = [event.what for event in watcher.of(events.PortalCallEnded)]
    assert ended
    for what in ended:
        assert isinstance(what, events.PortalCallEnded)
        assert (what.agent, what.resource, what.portal, what.how) == ("walker", "p", "climb", "done")
        assert what.seconds > 0.0
    answered = [event.what for event in watcher.of(events.DeviceCallEnded)]
    assert {(w.agent, w.device, w.instruction, w.error) for w in answered} == {  # type: ignore[union-attr]
        ("p", "p.fc", "takeoff", "")
    }


def test_every_line_of_log_and_output_is_one_event_and_vice_versa(tmp_path: Path) -> None:
    fleet = fleet_of(tmp_path, 0.001)
    watcher = watch(fleet, "alpha", Subscribe(1))
    fleet.run(20.0)
    lines = "".join(text for _, host, text in fleet.log if host == "alpha").splitlines()
    told = []
    for event in watcher.states:
        what = event.what
        if isinstance(what, events.LineLogged):
            told.append(what.text)
        elif isinstance(what, events.Printed):
            told.append(f"{what.agent}: {what.text}" if what.on == "log" else what.text.rstrip("\n"))
    assert sorted(told) == sorted(lines)
    assert len(told) > 10


def test_events_are_numbered_without_a_gap_from_the_start(tmp_path: Path) -> None:
    fleet = fleet_of(tmp_path, 6.0)
    watcher = watch(fleet, "alpha", Subscribe(1, 0, 5.0))
    fleet.run(6.0)
    assert watcher.batches[0].snapshot is not None
    numbers = [event.number for event in watcher.states]
    assert numbers == list(range(1, len(numbers) + 1))
    assert any(isinstance(event.what, events.AgentStarted) for event in watcher.states)
    times = [event.up for event in watcher.states]
    assert times == sorted(times)


def test_an_emergency_stop_causes_the_latches_of_all_devices(tmp_path: Path) -> None:
    fleet = fleet_of(tmp_path, 8.0)
    watcher = watch(fleet, "alpha")
    fleet.run(1.0)
    watcher.order(EmergencyStop(token_bytes(16), "people on the field"))
    fleet.run(6.0)
    (stopped,) = watcher.of(events.EmergencyStopChanged)
    assert stopped.what == events.EmergencyStopChanged("the eye", "people on the field")
    (latched,) = watcher.of(events.DeviceLatched)
    assert latched.cause == stopped.number
    (confirmed,) = watcher.of(events.SafeStateConfirmed)
    assert confirmed.cause == latched.number
    assert chain(watcher, watcher.of(events.DeviceMoving)[-1])[-3:] == ["confirmed", "latched", "stopped"]
    assert watcher.of(events.DeviceMoving)[-1].what == events.DeviceMoving("p.fc", "")
    assert 0.0 <= latched.up - stopped.up < 0.2
    watcher.order(EmergencyStop(token_bytes(16), "", lift=True))
    fleet.run(0.5)
    assert watcher.of(events.EmergencyStopChanged)[-1].what == events.EmergencyStopChanged(
        "the eye", "", lifted=True
    )


def test_a_pause_and_its_end_are_reported_with_the_person(tmp_path: Path) -> None:
    fleet = fleet_of(tmp_path, 8.0)
    watcher = watch(fleet, "alpha")
    watcher.order(Pause(token_bytes(16)))
    fleet.run(6.0)
    watcher.order(Pause(token_bytes(16), lift=True))
    fleet.run(6.0)
    paused, resumed = watcher.of(events.PauseChanged)
    assert (paused.what, resumed.what) == (
        events.PauseChanged("the eye"),
        events.PauseChanged("the eye", lifted=True),
    )
    assert [e.cause for e in watcher.of(events.DeviceLatched)] == [paused.number]
    assert chain(watcher, watcher.of(events.DeviceReleased)[0])


def test_broken_links_and_restarted_hosts_are_reported(tmp_path: Path) -> None:
    fleet = fleet_of(tmp_path, 8.0)
    watcher = watch(fleet, "alpha")
    fleet.run(0.1)
    fleet.crash("beta")
    fleet.run(4.0)
    assert watcher.of(events.LinkDown)[-1].what == events.LinkDown("beta")
    fleet.boot("beta")
    fleet.run(6.0)
    assert watcher.of(events.LinkUp)[-1].what == events.LinkUp("beta", restarted=True)


def test_positions_of_agents_are_sent_at_the_requested_rate(tmp_path: Path) -> None:
    fleet = fleet_of(tmp_path, 8.0)
    often, seldom = (
        watch(fleet, "alpha", Subscribe(telemetry=5.0)),
        watch(fleet, "alpha", Subscribe(telemetry=1.0)),
    )
    fleet.run(10.0)
    standing = [event.what for event in often.of(events.AgentActivity)]
    walks = [what for what in standing if what.agent == "walker"]  # type: ignore[union-attr]
    lines = PROGRAM.splitlines()
    output = {(lines[w.line - 1].strip(), w.waits) for w in walks if w.line}  # type: ignore[union-attr]
    assert ("posts[n % 2].climb(i2f(n + 2));", "p.climb") in output
    assert ("sleep(0.5);", "") in output
    serving = {w.waits for w in standing if w.agent == "p"}  # type: ignore[union-attr]
    assert "p.fc.takeoff" in serving
    measured = often.of(events.DeviceTelemetry)
    assert 40 <= len(measured) <= 51
    assert {event.what.device for event in measured} == {"p.fc"}  # type: ignore[union-attr]
    assert 8 <= len(seldom.of(events.DeviceTelemetry)) <= 11
    gaps = [b.up - a.up for a, b in pairwise(measured)]
    assert min(gaps) > 0.15


def test_a_watcher_that_reconnects_continues_at_its_last_event(tmp_path: Path) -> None:
    fleet = fleet_of(tmp_path, 8.0)
    first = watch(fleet, "alpha")
    fleet.run(3.0)
    first.reads = False
    last = first.states[-1].number
    life = first.batches[0].incarnation
    fleet.run(20.0)
    second = watch(fleet, "alpha", Subscribe(life, last))
    fleet.run(2.0)
    assert second.batches[0].after == last
    assert second.batches[0].snapshot is None
    assert second.states[0].number == last + 1
    assert not any(batch.lost for batch in second.batches)


def test_a_restarted_host_sends_all_its_events_to_a_watcher_of_the_earlier_life(tmp_path: Path) -> None:
    fleet = fleet_of(tmp_path, 8.0)
    before = watch(fleet, "alpha")
    fleet.run(1.0)
    life = before.batches[0].incarnation
    fleet.crash("alpha")
    fleet.boot("alpha")
    fleet.run(8.0)
    watcher = watch(fleet, "alpha", Subscribe(life, 5000))
    fleet.run(1.0)
    assert watcher.batches[0].incarnation != life
    assert isinstance(watcher.batches[0].snapshot, Status)
    assert watcher.states[0].number == 1


@pytest.mark.few(0)
def test_a_watcher_that_stops_reading_gets_a_window_and_then_the_end(tmp_path: Path) -> None:
    fleet = fleet_of(tmp_path, 8.0)
    watcher = watch(fleet, "alpha", Subscribe(telemetry=10.0), reads=False)
    other = watch(fleet, "alpha", Subscribe(telemetry=10.0))
    fleet.run(50.0)
    assert len(watcher.batches) == WINDOW
    assert watcher.refused == ""
    fleet.run(20.0)
    assert watcher.refused == "what it watches was not read for 60 s"
    # A last message has the number of its lost events.
    assert len(watcher.batches) == WINDOW + 1
    assert watcher.batches[-1].lost.keys() == {"measured", "standing", "path"}
    assert len(other.batches) > 600
    assert not any("state" in batch.lost for batch in other.batches)


def test_a_slow_watcher_loses_only_telemetry_and_is_informed(tmp_path: Path) -> None:
    fleet = fleet_of(tmp_path, 8.0)
    watcher = watch(fleet, "alpha", Subscribe(telemetry=20.0), reads=False)
    for _ in range(20):
        fleet.run(2.0)
        watcher.say(EventAck(watcher.batches[-1].batch))
    watcher.reads = True
    fleet.run(2.0)
    lost = [kind for batch in watcher.batches for kind in batch.lost]
    assert {"measured"} <= set(lost) <= events.TELEMETRY
    numbers = [event.number for event in watcher.states]
    assert numbers == list(range(numbers[0], numbers[0] + len(numbers)))


def test_a_watcher_beyond_the_limit_is_refused(tmp_path: Path) -> None:
    fleet = fleet_of(tmp_path, 2.0)
    watchers = [watch(fleet, "alpha") for _ in range(17)]
    fleet.run(0.5)
    assert [watcher.refused for watcher in watchers] == [*[""] * 16, "16 others watch alpha already"]


def test_repeated_subscriptions_do_not_keep_a_host_busy(tmp_path: Path) -> None:
    fleet = fleet_of(tmp_path, 2.0)
    watcher = watch(fleet, "alpha")
    for _ in range(500):
        watcher.say(Subscribe())
    assert len(watcher.batches) == 1
    fleet.run(1.0)
    assert [batch.batch for batch in watcher.batches[:2]] == [1, 1]
    assert len(watcher.batches) < 25


def test_a_host_that_ends_reports_it_and_the_rest_of_its_devices(tmp_path: Path) -> None:
    fleet = fleet_of(tmp_path, 8.0)
    watcher = watch(fleet, "alpha")
    fleet.run(0.2)
    fleet.stop("alpha")
    fleet.run(30.0)
    (ending,) = watcher.of(events.HostStopping)
    (latched,) = watcher.of(events.DeviceLatched)
    assert latched.cause == ending.number
    assert watcher.of(events.DeviceMoving)[-1].what == events.DeviceMoving("p.fc", "")


def test_portal_calls_are_not_reported_without_a_watcher(tmp_path: Path) -> None:
    fleet = fleet_of(tmp_path, 10.0)
    core = fleet.runs["alpha"].core
    assert core.machine.hooks.observer is None
    watcher = watch(fleet, "alpha", Subscribe(1))
    fleet.run(5.0)
    assert core.machine.hooks.observer is not None
    started = watcher.of(events.PortalCallStarted)
    assert started
    assert min(event.up for event in started) > 9.0
    assert watcher.of(events.MigrationStarted)[0].up < 9.0


BUSY = """
resource Post { init(string[] arg) { } portal look() { } }
coordinator Walker {
    init(string[] arg) {
        Post[] posts = findPost();
        for (int n = 0; n < 12000; n = n + 1) { posts[0].look(); }
        for (int n = 0; n < 20000; n = n + 1) { print(i2s(n)); }
        sleep(10.0);
    }
}
"""


@pytest.mark.few(0)
def test_too_frequent_events_are_counted(tmp_path: Path) -> None:
    fleet = fleet_of(tmp_path, 0.001, BUSY, "//Post:p@alpha\n//Walker:walker@alpha\n")
    watcher = watch(fleet, "alpha", Subscribe(1))
    fleet.run(12.0)
    skipped: dict[str, int] = {}
    for event in watcher.of(events.EventsDropped):
        what = event.what
        assert isinstance(what, events.EventsDropped)
        skipped[what.skipped] = skipped.get(what.skipped, 0) + what.count
    assert len(watcher.of(events.PortalCallStarted)) + skipped["began"] == 12000
    assert len(watcher.of(events.PortalCallEnded)) == len(watcher.of(events.PortalCallStarted))
    assert len(watcher.of(events.Printed)) + skipped["printed"] == 20000
    assert not any(batch.lost for batch in watcher.batches)


def test_an_exception_of_a_portal_is_reported_with_its_end(tmp_path: Path) -> None:
    program = PROGRAM.replace("fc.takeoff(height);", "int none = 0; print(i2s(1 / none));")
    fleet = fleet_of(tmp_path, 0.001, program)
    watcher = watch(fleet, "alpha", Subscribe(1))
    fleet.run(6.0)
    (ended,) = watcher.of(events.PortalCallEnded)
    assert isinstance(ended.what, events.PortalCallEnded)
    assert (ended.what.how, ended.what.detail) == ("thrown", "ArithmeticException: division by zero")
    (finished,) = watcher.of(events.AgentFinished)
    assert isinstance(finished.what, events.AgentFinished)
    assert finished.what.how == "died"
    assert finished.what.detail.startswith("ArithmeticException")
    assert chain(watcher, finished)[:2] == ["ended", "began"]


@pytest.mark.few(1)
@pytest.mark.parametrize("seed", range(4))
def test_a_run_is_the_same_with_and_without_a_watcher(tmp_path: Path, seed: int) -> None:
    """A watcher does not change the actions of the team: no log line, and no time."""

    def logged(*, watched: bool) -> list[tuple[str, str]]:
        fleet = fleet_of(tmp_path, 2.0, seed=seed)
        if watched:
            watch(fleet, "alpha", Subscribe(telemetry=20.0))
        fleet.run(15.0)
        return [(host, text) for _, host, text in fleet.log]

    assert logged(watched=True) == logged(watched=False)
