"""What `events` and `logs` hear: events in their order, notices once, and when all has been told."""

from __future__ import annotations

from dashboard_script import INCARNATION, ScriptedHost
from msgspec.structs import replace

from lfield.clock import ManualClock
from lfield.operator.dashboard.event_feed import HOLD_TIME, FeedNotice, TeamFeed
from lfield.wire.events import LinkUp, MigrationArrived, MigrationStarted


class Desk:
    """Somebody who listens to alpha and beta, whose clocks show other times."""

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


def test_an_event_waits_for_what_may_have_led_to_it() -> None:
    desk = Desk()
    desk.tell("beta", MigrationArrived("boss", 1, 3, "alpha", 9))
    assert desk.said() == []
    desk.clock.advance(HOLD_TIME / 2)
    desk.tell("alpha", MigrationStarted("boss", 1, 3, "beta", "", "", 9))
    desk.clock.advance(HOLD_TIME * 2)
    assert desk.said() == ["run-1/alpha left", "run-1/beta came"]


def test_a_host_that_is_not_heard_is_told_once_for_each_reason() -> None:
    desk = Desk()
    for why in ("nobody listens", "nobody listens", "it was refused"):
        desk.ears.on_unlinked("beta", why)
    desk.ears.on_linked("beta")
    desk.ears.on_linked("beta")
    assert desk.said() == ["unreachable: nobody listens", "unreachable: it was refused", "reachable again"]


def test_what_was_lost_and_another_life_are_told() -> None:
    desk = Desk()
    desk.tell("alpha", LinkUp("x"), lost={"state": 3, "measured": 1})
    desk.hosts["alpha"] = ScriptedHost(99)
    desk.tell("alpha", LinkUp("y"))
    assert desk.said()[:2] == [
        "events were lost: 3 of kind 'state', 1 of kind 'measured'",
        "restarted",
    ]


def test_telemetry_of_a_time_when_a_host_was_not_heard_is_told_to_be_lost_though_not_how_much() -> None:
    desk = Desk(telemetry=True)
    text = "telemetry was lost while it was unreachable, unknown how much"
    desk.tell("alpha", LinkUp("x"))
    desk.ears.on_unlinked("alpha", "it was not read for 60 s")
    desk.ears.on_linked("alpha")
    desk.tell("alpha", LinkUp("y"))
    notices = [told for told in desk.ears.drain_items() if isinstance(told, FeedNotice)]
    assert notices[-1] == FeedNotice("run-1/alpha", text, {"telemetry": None})
    desk.ears.on_linked("alpha")
    desk.tell("alpha", LinkUp("z"))
    assert not [told for told in desk.ears.drain_items() if isinstance(told, FeedNotice)]


def test_who_wants_no_telemetry_loses_none() -> None:
    desk = Desk()
    desk.tell("alpha", LinkUp("x"))
    desk.ears.on_unlinked("alpha", "it was not read for 60 s")
    desk.ears.on_linked("alpha")
    desk.tell("alpha", LinkUp("y"))
    assert all("telemetry" not in text for text in desk.said())


def test_all_is_told_when_each_host_has_told_what_it_had_or_is_not_heard() -> None:
    desk = Desk()
    alpha = desk.hosts["alpha"]
    first, second = alpha.batch(1.0, LinkUp("a")), alpha.batch(1.0, LinkUp("b"))
    desk.ears.on_batch("alpha", replace(first, latest=2), 0.0)
    assert not desk.ears.is_complete
    desk.ears.on_unlinked("beta", "nobody listens")
    assert not desk.ears.is_complete
    desk.ears.on_batch("alpha", second, None)
    assert desk.ears.is_complete
    assert desk.ears.unreached == ["run-1/beta"]


def test_a_host_that_goes_before_it_has_told_all_is_named() -> None:
    desk = Desk()
    first = desk.hosts["alpha"].batch(1.0, LinkUp("a"))
    desk.ears.on_batch("alpha", replace(first, latest=9), 0.0)
    for host in ("alpha", "beta"):
        desk.ears.on_unlinked(host, "the connection was lost")
    assert desk.ears.is_complete
    assert desk.ears.unreached == ["run-1/alpha", "run-1/beta"]
