"""What `events` and `logs` hear: events in their order, notices once, and when all has been told."""

from __future__ import annotations

from msgspec.structs import replace
from sight_script import LIFE, Teller

from lfield.clock import ManualClock
from lfield.operator.sight.listening import HOLD, Listening, Notice
from lfield.wire.events import Came, Left, Linked


class Desk:
    """Somebody who listens to alpha and beta, whose clocks show other times."""

    def __init__(self, *, telemetry: bool = False) -> None:
        self.clock = ManualClock()
        names = {"alpha": "run-1/alpha", "beta": "run-1/beta"}
        self.ears = Listening(names, self.clock, telemetry=telemetry)
        self.hosts = {"alpha": Teller(), "beta": Teller(LIFE + 1, wall=5.0)}
        self.aside = {"alpha": -990.0, "beta": 70.0}

    def tell(self, host: str, *whats: object, took: float | None = 0.02, **more: object) -> None:
        up = self.clock.now + self.aside[host]
        self.ears.told(host, self.hosts[host].batch(up, *whats, **more), took)  # type: ignore[arg-type]

    def said(self) -> list[str]:
        return [t.text if isinstance(t, Notice) else f"{t.host} {t.event.kind}" for t in self.ears.given()]


def test_an_event_waits_for_what_may_have_led_to_it() -> None:
    desk = Desk()
    desk.tell("beta", Came("boss", 1, 3, "alpha", 9))
    assert desk.said() == []
    desk.clock.advance(HOLD / 2)
    desk.tell("alpha", Left("boss", 1, 3, "beta", "", "", 9))
    desk.clock.advance(HOLD * 2)
    assert desk.said() == ["run-1/alpha left", "run-1/beta came"]


def test_a_host_that_is_not_heard_is_told_once_for_each_reason() -> None:
    desk = Desk()
    for why in ("nobody listens", "nobody listens", "it was refused"):
        desk.ears.unlinked("beta", why)
    desk.ears.linked("beta")
    desk.ears.linked("beta")
    assert desk.said() == ["not heard: nobody listens", "not heard: it was refused", "it is heard again"]


def test_what_was_lost_and_another_life_are_told() -> None:
    desk = Desk()
    desk.tell("alpha", Linked("x"), lost={"state": 3, "measured": 1})
    desk.hosts["alpha"] = Teller(99)
    desk.tell("alpha", Linked("y"))
    assert desk.said()[:2] == [
        "events were lost: 3 of kind 'state', 1 of kind 'measured'",
        "it was started again",
    ]


def test_telemetry_of_a_time_when_a_host_was_not_heard_is_told_to_be_lost_though_not_how_much() -> None:
    desk = Desk(telemetry=True)
    text = "telemetry was lost while it was not heard, nobody knows how much"
    desk.tell("alpha", Linked("x"))
    desk.ears.unlinked("alpha", "it was not read for 60 s")
    desk.ears.linked("alpha")
    desk.tell("alpha", Linked("y"))
    notices = [told for told in desk.ears.given() if isinstance(told, Notice)]
    assert notices[-1] == Notice("run-1/alpha", text, {"telemetry": None})
    desk.ears.linked("alpha")
    desk.tell("alpha", Linked("z"))
    assert not [told for told in desk.ears.given() if isinstance(told, Notice)]


def test_who_wants_no_telemetry_loses_none() -> None:
    desk = Desk()
    desk.tell("alpha", Linked("x"))
    desk.ears.unlinked("alpha", "it was not read for 60 s")
    desk.ears.linked("alpha")
    desk.tell("alpha", Linked("y"))
    assert all("telemetry" not in text for text in desk.said())


def test_all_is_told_when_each_host_has_told_what_it_had_or_is_not_heard() -> None:
    desk = Desk()
    alpha = desk.hosts["alpha"]
    first, second = alpha.batch(1.0, Linked("a")), alpha.batch(1.0, Linked("b"))
    desk.ears.told("alpha", replace(first, latest=2), 0.0)
    assert not desk.ears.is_complete
    desk.ears.unlinked("beta", "nobody listens")
    assert not desk.ears.is_complete
    desk.ears.told("alpha", second, None)
    assert desk.ears.is_complete
    assert desk.ears.unheard == ["run-1/beta"]


def test_a_host_that_goes_before_it_has_told_all_is_named() -> None:
    desk = Desk()
    first = desk.hosts["alpha"].batch(1.0, Linked("a"))
    desk.ears.told("alpha", replace(first, latest=9), 0.0)
    for host in ("alpha", "beta"):
        desk.ears.unlinked(host, "the connection was lost")
    assert desk.ears.is_complete
    assert desk.ears.unheard == ["run-1/alpha", "run-1/beta"]
