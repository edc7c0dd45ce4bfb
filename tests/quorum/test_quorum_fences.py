"""Fences only rise, and two hosts with one hash know the same."""

from __future__ import annotations

from lfield.quorum.members import Fences
from lfield.wire.quorum import Barred


def test_they_only_rise() -> None:
    fences = Fences({"Tour": 5})
    assert not fences.raise_to("Tour", 5)
    assert not fences.raise_to("Tour", 4)
    assert fences.of("Tour") == 5
    assert fences.raise_to("Tour", 2**63 - 1)
    assert fences.bars("Tour", 2**63 - 2)
    assert not fences.bars("Tour", 2**63 - 1)


def test_nothing_is_barred_that_nobody_has_barred() -> None:
    assert not Fences({}).bars("Tour", 0)


def test_a_hash_tells_whether_two_know_the_same() -> None:
    one, other = Fences({"A": 1, "B": 2}), Fences({"B": 2})
    assert one.digest != other.digest
    other.raise_to("A", 1)
    assert one.digest == other.digest < 2**63
    assert one.all == other.all == [Barred("A", 1), Barred("B", 2)]
    other.raise_to("A", 2)
    assert one.digest != other.digest


def test_what_the_journal_has_kept_is_not_changed_behind_its_back() -> None:
    kept = {"A": 1}
    Fences(kept).raise_to("A", 2)
    assert kept == {"A": 1}
