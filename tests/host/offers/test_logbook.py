"""The log of a host: lines as text and as JSON, and which errors are kept."""

from __future__ import annotations

import io
import json
import math

import pytest

from lfield.clock import SystemClock
from lfield.host.logbook import MAX_INCOMPLETE, JsonLogbook, Logbook
from lfield.text import log_messages
from lfield.text.log_messages import LogMessage, json_line


class StillClock(SystemClock):
    def time(self) -> float:
        return 12.5


def written(out: io.StringIO) -> list[dict[str, object]]:
    return [json.loads(line) for line in out.getvalue().splitlines()]


def test_each_output_line_of_a_program_is_an_object() -> None:
    out = io.StringIO()
    book = JsonLogbook("alpha", StillClock(), out)
    book.write("one\ntw", "boss")
    book.write("other\n", "arm")
    book.write("o\nrest", "boss")
    assert [line["text"] for line in written(out)] == ["boss: one", "arm: other", "boss: two"]
    assert written(out)[0] == {
        "time": 12.5,
        "host": "alpha",
        "code": "program-output",
        "level": "info",
        "text": "boss: one",
        "fields": {"agent": "boss", "text": "one"},
    }
    book.close()
    assert written(out)[3]["text"] == "boss: rest"
    book.write("x" * (MAX_INCOMPLETE + 1), "boss")
    assert len(written(out)) == 5


def test_a_log_line_has_the_values_of_its_template() -> None:
    message = LogMessage("tested", "{name} tested: {value:.1f} and {other}", "warning")
    line = message.line(name="a\x9b2J", value=1.25, other=None, bad=math.nan, count=3)
    assert json.loads(json_line(1.0, "alpha", line)) == {
        "time": 1.0,
        "host": "alpha",
        "code": "tested",
        "level": "warning",
        "text": "a\x9b2J tested: 1.2 and None",
        "fields": {"name": "a\x9b2J", "value": 1.25, "other": "None", "bad": "nan", "count": 3},
    }
    assert json_line(1.0, "alpha", line).isascii()


LISTENING = log_messages.HOST_LISTENING
LINKED = log_messages.LINKED
UNSTORED = log_messages.CRL_NOT_STORED
REOPENED = log_messages.ENDPOINT_REOPENED
COMPLETED = log_messages.MISSION_COMPLETED


@pytest.mark.parametrize(
    ("message", "values", "part"),
    [
        (LISTENING, {"host": "a", "address": "::1 7000", "journal": "stored"}, "a listening on ::1 7000"),
        (LISTENING, {"host": "a", "address": "", "journal": "none"}, "computer; state not saved"),
        (LISTENING, {"host": "a", "address": "", "journal": "simulation"}, "; no journal (simulation)"),
        (LINKED, {"host": "a", "restarted": True}, "established; it was restarted"),
        (LINKED, {"host": "a", "restarted": False}, "link to a established"),
        (UNSTORED, {"number": 2, "reason": "full", "holders": "a, b"}, "that it revokes (a, b); free"),
        (UNSTORED, {"number": 2, "reason": "full", "holders": ""}, "that it revokes; free"),
        (COMPLETED, {"seconds": 1.5, "hops": 1, "status": 0}, "1 hop; exit"),
        (COMPLETED, {"seconds": 1.5, "hops": 2, "status": 0}, "2 hops; exit"),
        (
            REOPENED,
            {"endpoint": "e", "address": "x", "attempts": 1, "seconds": 3.2},
            "link opened: e: x, after 1 attempt and 3 s",
        ),
        (
            REOPENED,
            {"endpoint": "e", "address": "x", "attempts": 2, "seconds": 3.2},
            "link opened: e: x, after 2 attempts and 3 s",
        ),
        (REOPENED, {"endpoint": "e", "address": "", "attempts": 2, "seconds": 3.2}, "link opened: e"),
    ],
)
def test_a_line_has_plain_values_beside_its_sentence(
    message: LogMessage, values: dict[str, object], part: str
) -> None:
    line = message.line(**values)
    assert line.as_data()["fields"] == values
    assert part in line


def test_a_device_report_names_its_device() -> None:
    coded = log_messages.SERIAL_LOST.line(reason="unplugged")
    line = log_messages.report_line("arm.servo", *log_messages.report_fields(coded))
    assert (line.code, line.template_values["device"]) == ("serial-lost", "arm.servo")


def test_the_newest_error_of_each_code_is_kept() -> None:
    out = io.StringIO()
    for book in (Logbook(out, out), JsonLogbook("alpha", StillClock(), out)):
        for agent in ("a", "b"):
            book.note(log_messages.AGENT_DIED.line(agent=agent, report="E"))
            book.note(log_messages.AGENT_LOST.line(agent=agent, reason="r"))
        book.note(log_messages.AGENT_DIED.line(agent="c", report="E"))
        book.note(log_messages.LINK_LOST.line(host="bravo"))
        assert list(book.errors.items()) == [
            ("agent-lost", "b lost: r"),
            ("agent-died", "c died of an uncaught E"),
        ]
