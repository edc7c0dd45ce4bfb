"""Event logs of a host, and a watcher of each."""

from __future__ import annotations

from lfield.host.events.event_log import EventLog, EventRing
from lfield.host.events.event_subscription import EventSubscription
from lfield.wire.events import DeviceTelemetry, LineLogged
from lfield.wire.observer_messages import Status
from lfield.wire.subscription_messages import Subscribe

LIFE = 77
STATUS = Status("a", "a:1", 0.5, b"h" * 32, b"h" * 32, [], [], [], [], [])


def append_lines(stream, count, text="x"):
    for _ in range(count):
        stream.append(LineLogged(text), 1.7e9, 1.0)


def small(most_events, most_bytes=4 << 20):
    """A log that keeps few frequent events."""
    return EventLog(EventRing(most_events, most_bytes))


def watched(stream, watch=None, up=0.0):
    return EventSubscription(stream, LIFE, watch or Subscribe(LIFE), up)


def batch_of(watcher, up):
    return watcher.next_batch(1.7e9 + up, up, lambda: STATUS)


def sample(**values):
    """Telemetry of devices, each a number."""
    return {name: (value, DeviceTelemetry(name, {"v": value}, 0.1)) for name, value in values.items()}


def numbers(batch):
    return [event.number for event in batch.events]


def states(batches):
    return [number for batch in batches for number in numbers(batch)]
