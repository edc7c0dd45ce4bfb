"""What comes late of what was pressed: refused where it lets vehicles move, told where it stops them."""

from __future__ import annotations

import pytest

from lfield.operator.web.button_orders import MAX_DELAY, NOT_SHOWN_YET, refusal, stop_reason
from lfield.wire.order_messages import OrderKind

PRESSED = 5000.0


@pytest.mark.parametrize("order", ["lift", "resume"])
def test_what_releases_is_refused_when_it_is_late(order: OrderKind) -> None:
    assert refusal(order, PRESSED, PRESSED + MAX_DELAY) == ""
    assert "it arrived 31 s after the press" in refusal(order, PRESSED, PRESSED + 31.0)


@pytest.mark.parametrize("pressed", [None, True, "5000", [], PRESSED + MAX_DELAY + 1.0, 10**400])
def test_what_does_not_say_when_it_was_pressed_releases_nothing(pressed: object) -> None:
    assert refusal("lift", pressed, PRESSED) == NOT_SHOWN_YET
    assert refusal("stop", pressed, PRESSED) == ""
    assert stop_reason("why", pressed, PRESSED) == "why"


@pytest.mark.parametrize("order", ["stop", "pause"])
def test_what_makes_safer_is_never_too_late(order: OrderKind) -> None:
    assert refusal(order, PRESSED, PRESSED + 3600.0) == ""


def test_a_stop_says_that_it_was_late() -> None:
    assert stop_reason("on the page", PRESSED, PRESSED + 0.2) == "on the page"
    assert stop_reason("on the page", PRESSED, PRESSED + 31.2) == "on the page; it arrived 31 s late"
