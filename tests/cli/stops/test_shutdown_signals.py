"""The second stop request, which does not wait for the devices, with an injected clock."""

from __future__ import annotations

import pytest

from lfield.clock import ManualClock
from lfield.host.process.shutdown_signals import REPEAT_WINDOW, ShutdownSignals


@pytest.mark.parametrize(
    ("after", "is_repeatable", "second"),
    [
        (0.0, True, 0),
        (REPEAT_WINDOW - 0.01, True, 0),
        (REPEAT_WINDOW, True, 1),
        (60.0, True, 1),
        (60.0, False, 0),
    ],
)
def test_a_second_request_ends_the_wait_unless_it_follows_at_once(after, is_repeatable, second):
    clock, counted = ManualClock(), []
    signals = ShutdownSignals(clock, lambda: counted.append(clock.monotonic()))
    assert not signals.first_requested.is_set()
    signals.request()
    assert signals.first_requested.is_set()
    clock.advance(after)
    signals.request(is_repeatable=is_repeatable)
    assert len(counted) == second
