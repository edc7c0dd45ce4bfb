"""The outcome of a story: what it covers, and that it depends on the seed alone."""

from __future__ import annotations

import pytest

from lfield.mobility.departures import Departures
from lfield.simulate.fleet import Book
from lfield.simulate.seeds import told


def test_another_log_line_changes_the_digest_of_a_story_and_not_its_outcome(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    before, write = told(3), Book.write
    monkeypatch.setattr(Book, "write", lambda self, text: write(self, f"in other words: {text}"))
    after = told(3)
    assert after.digest != before.digest
    assert after.outcome == before.outcome


def test_another_behaviour_changes_the_outcome(monkeypatch: pytest.MonkeyPatch) -> None:
    before = told(15)

    def resumes(self: Departures, copy):  # type: ignore[no-untyped-def]
        return self._resume(copy, "UnreachableResourceException", "it took too long")

    monkeypatch.setattr(Departures, "overdue", resumes)
    assert told(15).outcome != before.outcome


def test_a_story_of_orders_is_the_same_at_other_addresses_in_memory() -> None:
    """The tasks of the operator are cancelled in the order of their begin."""
    kept: list[object] = []
    outcomes = set()
    for _ in range(3):
        kept.append([object() for _ in range(1000)])
        outcomes.add(told(19).outcome)
    assert len(outcomes) == 1
