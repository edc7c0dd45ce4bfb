"""The rate of a path is measured on normal traffic, and events and telemetry use a share of it."""

from __future__ import annotations

import random

import pytest

from lfield.host.events.event_log import EventLog
from lfield.host.events.event_subscription import MIN_INTERVAL, EventSubscription
from lfield.host.events.path_rate import FAST_RATE, MAX_PAUSE, MIN_BATCH, OVERHEAD, SHARE, PathRate
from lfield.wire.subscription_messages import Subscribe

#: Bytes per second of a channel of 57.6 kbit/s.
RADIO = 7200.0


def measured(rate: float, round_trip: float, jitter: float = 0.0, loss: float = 0.0) -> PathRate:
    """Batches of 40 to 400 bytes, some of which are lost and repeated after 0.4 s."""
    path, rng = PathRate(), random.Random(1)
    for _ in range(200):
        size = rng.choice((40, 120, 250, 400))
        repeated = 0.4 if rng.random() < loss else 0.0
        path.add(size, round_trip + size / rate + rng.uniform(0.0, jitter) + repeated)
    return path


@pytest.mark.parametrize("loss", [0.0, 0.2])
def test_the_rate_of_a_slow_channel_is_found_despite_losses(loss):
    path = measured(RADIO, 0.1, jitter=0.002, loss=loss)
    assert path.rate == pytest.approx(RADIO, rel=0.3)
    assert path.pause(200) == pytest.approx((200 + OVERHEAD) / (SHARE * RADIO), rel=0.3)


def test_a_fast_path_is_not_limited():
    for path in (measured(10 * FAST_RATE, 0.001), measured(10 * FAST_RATE, 0.05, jitter=0.0002), PathRate()):
        assert (path.rate, path.pause(50_000)) == (None, 0.0)


def test_a_batch_on_a_slow_path_is_limited_by_the_longest_pause():
    path = measured(RADIO, 0.2)
    limit = path.batch_limit(1 << 16)
    assert limit == pytest.approx(SHARE * RADIO * MAX_PAUSE, rel=0.2)
    assert measured(40.0, 1.0).batch_limit(1 << 16) == MIN_BATCH
    assert PathRate().batch_limit(1 << 16) == 1 << 16


def test_the_pause_has_an_upper_limit():
    assert measured(40.0, 1.0).pause(1000) == MAX_PAUSE


def test_a_subscription_keeps_to_its_share_of_a_measured_path():
    log = EventLog()
    watcher = EventSubscription(log, 7, Subscribe(7), 0.0)
    up, sent, position = 0.0, [], 0
    for number in range(60):
        up = max(up, watcher.due)
        assert watcher.next_batch(1.7e9, up, lambda: None) is not None
        size = 60 + 150 * (number % 2)
        watcher.on_sending(position)
        position += size
        sent.append((up, size))
        watcher.on_ack(number + 1, up + 0.1 + size / RADIO, position)
        up = max(up + MIN_INTERVAL, watcher.next_batch_at)
    (started, _), (ended, _) = sent[20], sent[-1]
    carried = sum(size + OVERHEAD for _, size in sent[20:-1])
    assert carried / (ended - started) <= 1.1 * SHARE * RADIO
