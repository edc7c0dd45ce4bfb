"""An event as a line of text, as JSON and as rows of a table."""

from __future__ import annotations

import json
import math

import pytest

from lfield.cli.views.event_view import COLUMNS, EventCsv, LogLineView, event_line, log_text
from lfield.client.event_json import event_json
from lfield.operator.dashboard.event_feed import FeedNotice
from lfield.operator.dashboard.timeline.event_timeline import Cause, DatedEvent
from lfield.wire.events import (
    DeviceLatched,
    DeviceTelemetry,
    Event,
    EventsDropped,
    LineLogged,
    LinkTelemetry,
    MigrationArrived,
    MigrationConfirmed,
    MigrationFailed,
    MigrationStarted,
    Printed,
)


def dated(what: object) -> DatedEvent:
    event = Event(4, 1.7e9 + 0.49, 9.0, 3, what, 10, 2)  # type: ignore[arg-type]
    return DatedEvent("alpha", 7, event, Cause("beta", 8, 2))


def log_of(view: LogLineView, what: object) -> list[str]:
    return [log_text(dated(what), line) for line in view.lines(dated(what))]


def test_control_characters_are_escaped_in_an_event_line() -> None:
    line = event_line(dated(DeviceLatched("one.fc", "land", "bad \x1b[2J\nreason")))
    assert "\x1b" not in line
    assert "\n" not in line
    assert line.endswith('device=one.fc  state=land  reason="bad \\u{1b}[2J\\nreason"  by=beta:2')


def test_event_json_has_the_event_its_time_and_its_cause() -> None:
    decoded = json.loads(event_json(dated(MigrationArrived("boss", 1, 4, "beta", 900))))
    assert decoded == {
        "host": "alpha",
        "incarnation": 7,
        "time": 1.7e9 + 0.5,
        "within": 0.01,
        "tick": 2,
        "caused_by": {"host": "beta", "incarnation": 8, "number": 2},
        "number": 4,
        "at": 1.7e9 + 0.49,
        "up": 9.0,
        "cause": 3,
        "kind": "came",
        "agent": "boss",
        "generation": 1,
        "sequence": 4,
        "of": "beta",
        "size": 900,
    }


def test_nan_and_infinity_are_null_in_json() -> None:
    decoded = json.loads(
        event_json(dated(DeviceTelemetry("one.fc", {"a": math.nan, "b": [math.inf, 1.0]}, 0.0)))
    )
    assert decoded["values"] == {"a": None, "b": [None, 1.0]}


def test_lost_events_are_a_json_object() -> None:
    decoded = json.loads(event_json(FeedNotice("alpha", "events were lost", {"state": 2})))
    assert decoded == {"host": "alpha", "kind": "lost", "lost": {"state": 2}, "reason": "events were lost"}
    uncounted = json.loads(event_json(FeedNotice("alpha", "telemetry was lost", {"telemetry": None})))
    assert uncounted["lost"] == {"telemetry": None}


@pytest.mark.parametrize(
    ("path", "words"),
    [
        (
            LinkTelemetry("beta", 0.2143, 0.048, 12_345, 1_400_000),
            "round_trip=214 ms loss=4.8 % sent=12.3 kB received=1.4 MB",
        ),
        (LinkTelemetry("beta", 0.0021, None, None, 9), "round_trip=2.1 ms received=9 B"),
        (LinkTelemetry("beta", 1.25, 0.0, 0, None), "round_trip=1.2 s loss=0.0 % sent=0 B"),
    ],
)
def test_link_figures_have_units_in_an_event_line(path: LinkTelemetry, words: str) -> None:
    assert " ".join(event_line(dated(path)).split()[3:]) == f"path peer=beta {words} by=beta:2"


@pytest.mark.parametrize(
    ("what", "rows"),
    [
        (MigrationStarted("boss", 1, 4, "beta", "two", "lift", 900), ["boss,,,1,4,alpha,beta,,900"]),
        (MigrationArrived("boss", 1, 4, "beta", 900), ["boss,,,1,4,beta,alpha,,900"]),
        (MigrationConfirmed("boss", 1, 4, "beta", 0.25), ["boss,,,1,4,alpha,beta,0.25,"]),
        (MigrationConfirmed("boss", 1, 4, "beta", None), ["boss,,,1,4,alpha,beta,,"]),
        (MigrationFailed("boss", 1, 4, "beta", "X", "y"), ["boss,,,1,4,alpha,beta,,"]),
        (
            DeviceTelemetry("one.fc", {"mode": 'a "b", c', "armed": True, "position": [1.0, 2.5]}, 0.0),
            [
                'one.fc,mode,"a ""b"", c",,,,,,',
                "one.fc,armed,true,,,,,,",
                "one.fc,position[0],1.0,,,,,,",
                "one.fc,position[1],2.5,,,,,,",
            ],
        ),
        (
            LinkTelemetry("beta", 0.25, None, 10, 20),
            ["beta,round_trip,0.25,,,,,,", "beta,sent,10,,,,,,", "beta,received,20,,,,,,"],
        ),
        (DeviceLatched("one.fc", "land", "x"), []),
    ],
)
def test_event_table_has_hops_and_telemetry(what: object, rows: list[str]) -> None:
    table = EventCsv()
    assert table.header() == ",".join(COLUMNS)
    head = "1700000000.500000,0.010000,alpha,4,"
    event = dated(what)
    assert list(table.rows(event)) == [f"{head}{event.event.kind},{row}" for row in rows]


def test_log_has_whole_lines_with_their_source() -> None:
    view = LogLineView()
    assert log_of(view, Printed("boss", "half", "out")) == []
    (full_line,) = log_of(view, Printed("boss", " a line\n", "out"))
    assert full_line.endswith(" alpha | boss: half a line")
    two = log_of(view, LineLogged("one\n  two\x07"))
    assert [line.partition(" | ")[2] for line in two] == ["one", "  two\\u{7}"]


def test_log_reports_dropped_lines() -> None:
    (line,) = log_of(LogLineView(), EventsDropped("printed", 4550))
    assert line.endswith(" alpha | 4550 lines left out: too frequent")
    assert log_of(LogLineView(), EventsDropped("left", 3)) == []


def test_control_characters_are_escaped_in_json_and_tables() -> None:
    orders = DeviceTelemetry("one.fc", {"mode": "\x9b2J\u202e"}, 0.0)
    assert "\\u009b2J\\u202e" in event_json(dated(orders))
    (row,) = EventCsv().rows(dated(orders))
    assert "\\u{9b}2J\\u{202e}" in row


def test_line_breaks_of_a_program_are_escaped_except_its_newline() -> None:
    text = "here\rbeta | lead: lands\x85beta | lead: \u2028safe\n"
    (line,) = log_of(LogLineView(), Printed("walker", text, "log"))
    assert line.endswith("| walker: here\\rbeta | lead: lands\\u{85}beta | lead: \\u{2028}safe")
