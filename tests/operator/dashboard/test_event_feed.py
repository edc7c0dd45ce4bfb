"""The feed of `events` and `logs`: events in order, notices once, and the end of the feed."""

from __future__ import annotations

from dashboard_script import INCARNATION, ScriptedHost
from msgspec.structs import replace

from lfield.clock import ManualClock
from lfield.operator.dashboard.event_feed import HOLD_TIME, FeedNotice, TeamFeed
from lfield.wire.events import LinkUp, MigrationArrived, MigrationStarted


class Desk:
    """A feed of alpha and beta, whose clocks differ."""

    def __init__(self, *, telemetry: bool = False) -> None:
        self.clock = ManualClock()
        names = {"alpha": "run-1/alpha", "beta": "run-1/beta"}
        self.ears = TeamFeed(names, self.clock, telemetry=telemetry)
        self.hosts = {"alpha": ScriptedHost(), "beta": ScriptedHost(INCARNATION + 1, wall=5.0)}
        self.aside = {"alpha": -990.0, "beta": 70.0}

    def tell(self, host: str, *whats: object, took: float | None = 0.02, **more: object) -> None:
        up = self.clock.now + self.aside[host]
        self.ears.on_batch(host, self.hosts[host].batch(up, *whats, **more), took)  # type: ignore[arg-type]

    def said(self) -> list[str]:
        return [
            t.text if isinstance(t, FeedNotice) else f"{t.host} {t.event.kind}"
            for t in self.ears.drain_items()
        ]


def test_an_event_waits_for_a_possible_cause() -> None:
    desk = Desk()
    desk.tell("beta", MigrationArrived("boss", 1, 3, "alpha", 9))
    assert desk.said() == []
    desk.clock.advance(HOLD_TIME / 2)
    desk.tell("alpha", MigrationStarted("boss", 1, 3, "beta", "", "", 9))
    desk.clock.advance(HOLD_TIME * 2)
    assert desk.said() == ["run-1/alpha left", "run-1/beta came"]


def test_an_unreachable_host_is_reported_once_for_each_reason() -> None:
    desk = Desk()
    for reason in ("no program listens", "no program listens", "it was refused"):
        desk.ears.on_unlinked("beta", reason)
    desk.ears.on_linked("beta")
    desk.ears.on_linked("beta")
    assert desk.said() == [
        "unreachable: no program listens",
        "unreachable: it was refused",
        "reachable again",
    ]


def test_lost_events_and_a_restart_are_reported() -> None:
    desk = Desk()
    desk.tell("alpha", LinkUp("x"), lost={"state": 3, "measured": 1})
    desk.hosts["alpha"] = ScriptedHost(99)
    desk.tell("alpha", LinkUp("y"))
    assert desk.said()[:2] == [
        "events were lost: 3 of kind 'state', 1 of kind 'measured'",
        "restarted",
    ]


def test_telemetry_of_an_unreachable_time_is_reported_as_lost_without_a_count() -> None:
    desk = Desk(telemetry=True)
    text = "telemetry was lost while it was unreachable, unknown how much"
    desk.tell("alpha", LinkUp("x"))
    desk.ears.on_unlinked("alpha", "it was not read for 60 s")
    desk.ears.on_linked("alpha")
    desk.tell("alpha", LinkUp("y"))
    notices = [item for item in desk.ears.drain_items() if isinstance(item, FeedNotice)]
    assert notices[-1] == FeedNotice("run-1/alpha", text, {"telemetry": None})
    desk.ears.on_linked("alpha")
    desk.tell("alpha", LinkUp("z"))
    assert not [item for item in desk.ears.drain_items() if isinstance(item, FeedNotice)]


def test_without_telemetry_no_lost_telemetry_is_reported() -> None:
    desk = Desk()
    desk.tell("alpha", LinkUp("x"))
    desk.ears.on_unlinked("alpha", "it was not read for 60 s")
    desk.ears.on_linked("alpha")
    desk.tell("alpha", LinkUp("y"))
    assert all("telemetry" not in text for text in desk.said())


def test_feed_is_complete_when_each_host_has_sent_all_or_is_unreachable() -> None:
    desk = Desk()
    alpha = desk.hosts["alpha"]
    first, second = alpha.batch(1.0, LinkUp("a")), alpha.batch(1.0, LinkUp("b"))
    desk.ears.on_batch("alpha", replace(first, latest=2), 0.0)
    assert not desk.ears.is_complete
    desk.ears.on_unlinked("beta", "no program listens")
    assert not desk.ears.is_complete
    desk.ears.on_batch("alpha", second, None)
    assert desk.ears.is_complete
    assert desk.ears.unreached == {"run-1/beta": "no program listens"}


def test_a_host_that_ends_before_it_has_sent_all_is_named() -> None:
    desk = Desk()
    first = desk.hosts["alpha"].batch(1.0, LinkUp("a"))
    desk.ears.on_batch("alpha", replace(first, latest=9), 0.0)
    for host in ("alpha", "beta"):
        desk.ears.on_unlinked(host, "the connection was lost")
    assert desk.ears.is_complete
    lost = "the connection was lost"
    assert desk.ears.unreached == {"run-1/alpha": lost, "run-1/beta": lost}
