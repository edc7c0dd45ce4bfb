"""The page of events has every kind with its fields, and the bounds of the code."""

import re
from pathlib import Path

import pytest

import lfield
from lfield.host.events import event_log, event_rate_limit, event_subscription
from lfield.host.subscriptions import subscription_server
from lfield.wire.events import KINDS, TELEMETRY
from lfield.wire.subscription_messages import MAX_RATE, WINDOW

PAGE = Path(lfield.__file__).parent.joinpath("docs", "events.md").read_text(encoding="utf-8")


def rows(section):
    """The kinds of a section, each with its fields."""
    body = PAGE.split(f"### {section}\n")[1].split("\n#")[0]
    return {
        kind: tuple(fields.split(", "))
        for kind, fields in re.findall(r"^\| `(\w+)` \| ([\w, ]+) \|", body, re.MULTILINE)
    }


@pytest.mark.parametrize(
    ("section", "kinds"), [("States", KINDS.keys() - TELEMETRY), ("Telemetry", TELEMETRY)]
)
def test_event_page_has_every_kind_with_its_fields(section, kinds):
    assert rows(section) == {kind: KINDS[kind].__struct_fields__ for kind in kinds}


def test_event_page_names_the_frequent_kinds():
    frequent = PAGE.split("very often (")[1].split(")")[0]
    assert {KINDS[kind] for kind in re.findall(r"`(\w+)`", frequent)} == event_log.FREQUENT


def limit(allowance):
    """The text of a bound on the page."""
    return f"{allowance.burst:g} at once and {allowance.rate:g} a second"


def test_bounds_of_the_event_page_equal_the_code():
    bounds = PAGE.split("## Bounds\n")[1]
    assert event_rate_limit.MIGRATIONS == event_rate_limit.PORTALS
    for bound in (
        f"| {event_log.MAX_FREQUENT_EVENTS}, and {event_log.MAX_FREQUENT_BYTES >> 20} MiB",
        f"| {event_log.RARE_EVENTS}, and {event_log.RARE_BYTES >> 20} MiB",
        f"| {WINDOW}, of {event_subscription.BATCH_BYTES >> 10} KiB",
        f"not read for {event_subscription.READ_TIMEOUT:g} s",
        f"one host | {subscription_server.MAX_SUBSCRIPTIONS};",
        f"| prints | {limit(event_rate_limit.PRINTS)}; one longer than {event_rate_limit.PIECE} characters",
        f"| hops, and portal calls, while watched | {limit(event_rate_limit.MIGRATIONS)} of each |",
        f"| hops without subscribers | {limit(event_rate_limit.MIGRATIONS_UNOBSERVED)} |",
        f"| instructions to devices | {limit(event_rate_limit.INSTRUCTIONS)} |",
    ):
        assert bound in bounds
    assert f"at most {MAX_RATE:g} times a second" in PAGE
    assert f"{1 / event_subscription.MIN_INTERVAL:g} times a second at most" in PAGE
    assert f"for {subscription_server.LINGER:g} s after the last" in PAGE
