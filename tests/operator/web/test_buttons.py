"""Late button presses: refused if they release vehicles, reported if they stop them."""

from __future__ import annotations

import pytest

from lfield.operator.web.button_orders import MAX_DELAY, NOT_SHOWN_YET, refusal, stop_reason
from lfield.wire.order_messages import OrderKind

PRESSED = 5000.0


@pytest.mark.parametrize("order", ["lift", "resume"])
def test_a_late_releasing_order_is_refused(order: OrderKind) -> None:
    assert refusal(order, PRESSED, PRESSED + MAX_DELAY) == ""
    assert "it arrived 31 s after the press" in refusal(order, PRESSED, PRESSED + 31.0)


@pytest.mark.parametrize("pressed", [None, True, "5000", [], PRESSED + MAX_DELAY + 1.0, 10**400])
def test_a_releasing_order_without_a_valid_time_is_refused(pressed: object) -> None:
    assert refusal("lift", pressed, PRESSED) == NOT_SHOWN_YET
    assert refusal("stop", pressed, PRESSED) == ""
    assert stop_reason("why", pressed, PRESSED) == "why"


@pytest.mark.parametrize("order", ["stop", "pause"])
def test_a_late_stop_or_pause_is_accepted(order: OrderKind) -> None:
    assert refusal(order, PRESSED, PRESSED + 3600.0) == ""


def test_a_late_stop_reports_its_delay() -> None:
    assert stop_reason("on the page", PRESSED, PRESSED + 0.2) == "on the page"
    assert stop_reason("on the page", PRESSED, PRESSED + 31.2) == "on the page; it arrived 31 s late"
