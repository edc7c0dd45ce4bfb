"""Hybrid timestamps order events only: no certificate, lease, time limit or timer reads them."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[2]
#: The hybrid clock, and the functions that make or read timestamps.
NAMES = {"hybrid_clock", "_hybrid_clock", "HybridClock", "timestamp_of", "milliseconds_of", "counter_of"}
#: The fields of messages and events with timestamps.
FIELDS = {"stamp", "ahead", "tick"}
WORDS = (*NAMES, *(f".{name}" for name in FIELDS))
#: The permitted files, each with its use.
ALLOWED = {
    "host/core.py": "greetings, and timestamps of messages that arrive",
    "host/events/event_log.py": "stores the timestamps of events",
    "host/events/event_recorder.py": "gives events their timestamps",
    "host/events/migration_events.py": "gives the steps of a hop their timestamps",
    "host/host.py": "lends the clock to the heartbeats of links",
    "host/migration/delayed_acks.py": "timestamps of acknowledgements",
    "host/migration/effect_executor.py": "timestamps of transfers and their answers",
    "host/recording/core_snapshot.py": "leaves the clock out of snapshots",
    "host/recording/flight_recorder.py": "records the state of the clock",
    "host/recording/recording_session.py": "records the state of the clock",
    "host/subscriptions/subscription_server.py": "timestamps of telemetry",
    "host/team/coordinators.py": "timestamps of transfers that arrive",
    "hybrid_clock.py": "the clock itself",
    "net/health/link_monitor.py": "heartbeats carry timestamps",
    "net/link_manager.py": "passes the clock on to the heartbeats",
    "net/link_owner.py": "the type of forwarded timestamps",
    "operator/team_model/log_buffer.py": "the order of log lines",
    "operator/team_model/team_view.py": "the order of log lines",
    "operator/dashboard/timeline/event_timeline.py": "the order of events",
    "client/event_json.py": "shows the timestamp",
    "replay/host_replay.py": "restores the recorded state of the clock",
    "wire/events.py": "the timestamp of an event",
}


def uses(text: str) -> Iterator[str]:
    """The timestamp names that a module reads."""
    if not any(word in text for word in WORDS):
        return
    for node in ast.walk(ast.parse(text)):
        match node:
            case ast.Name(id=name) | ast.Attribute(attr=name) | ast.alias(name=name) if name in NAMES:
                yield name
            case ast.Attribute(value=ast.Name(id=owner) | ast.Attribute(attr=owner), attr=name):
                if name in FIELDS and (owner == "event" or name == "stamp"):
                    yield name


def test_only_permitted_files_read_timestamps() -> None:
    product = ROOT / "lfield"
    found = {
        path.relative_to(product).as_posix(): sorted(set(uses(path.read_text(encoding="utf-8"))))
        for path in sorted(product.rglob("*.py"))
    }
    readers = {path: names for path, names in found.items() if names}
    assert {path: names for path, names in readers.items() if path not in ALLOWED} == {}
    assert sorted(ALLOWED) == sorted(readers)


def test_use_of_a_timestamp_is_found() -> None:
    text = "lease = header.stamp\nlimit = self.recorder.hybrid_clock.last\n"
    assert sorted(uses(text)) == ["hybrid_clock", "stamp"]
