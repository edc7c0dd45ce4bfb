"""The page of events has every kind with its fields, and the bounds are those of the code."""

import re
from pathlib import Path

import pytest

import lfield
from lfield.host.sight import budget, stream, watcher
from lfield.host.watching import watchers
from lfield.wire.events import KINDS, TELEMETRY
from lfield.wire.watching import MAX_RATE, WINDOW

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
def test_the_page_has_every_kind_with_its_fields(section, kinds):
    assert rows(section) == {kind: KINDS[kind].__struct_fields__ for kind in kinds}


def test_the_page_says_what_is_kept_apart():
    apart = PAGE.split("very often (")[1].split(")")[0]
    assert {KINDS[kind] for kind in re.findall(r"`(\w+)`", apart)} == stream.OFTEN


def told(allowance):
    """As the page says it."""
    return f"{allowance.burst:g} at once and {allowance.rate:g} a second"


def test_the_bounds_of_the_page_are_those_of_the_code():
    bounds = PAGE.split("## Bounds\n")[1]
    assert budget.HOPS == budget.PORTALS
    for bound in (
        f"| {stream.MOST_EVENTS}, and {stream.MOST_BYTES >> 20} MiB",
        f"| {stream.SELDOM_EVENTS}, and {stream.SELDOM_BYTES >> 20} MiB",
        f"| {WINDOW}, of {watcher.BATCH_BYTES >> 10} KiB",
        f"not read for {watcher.PATIENCE:g} s",
        f"one host | {watchers.MOST};",
        f"| prints | {told(budget.PRINTS)}; one longer than {budget.PIECE} characters",
        f"| hops, and portal calls, while watched | {told(budget.HOPS)} of each |",
        f"| hops while nobody watches | {told(budget.HOPS_UNWATCHED)} |",
        f"| instructions to devices | {told(budget.INSTRUCTIONS)} |",
    ):
        assert bound in bounds
    assert f"at most {MAX_RATE:g} times a second" in PAGE
    assert f"{1 / watcher.LEAST:g} times a second at most" in PAGE
    assert f"for {watchers.LINGER:g} s after the last" in PAGE
