"""Fences only rise, and two hosts with one hash know the same."""

from __future__ import annotations

from lfield.replication.lease.quorum_members import FencingTokens
from lfield.wire.quorum_messages import FencedRecord


def test_they_only_rise() -> None:
    fences = FencingTokens({"Tour": 5})
    assert not fences.advance("Tour", 5)
    assert not fences.advance("Tour", 4)
    assert fences.token_of("Tour") == 5
    assert fences.advance("Tour", 2**63 - 1)
    assert fences.rejects("Tour", 2**63 - 2)
    assert not fences.rejects("Tour", 2**63 - 1)


def test_nothing_is_barred_that_nobody_has_barred() -> None:
    assert not FencingTokens({}).rejects("Tour", 0)


def test_a_hash_tells_whether_two_know_the_same() -> None:
    one, other = FencingTokens({"A": 1, "B": 2}), FencingTokens({"B": 2})
    assert one.digest != other.digest
    other.advance("A", 1)
    assert one.digest == other.digest < 2**63
    assert one.all == other.all == [FencedRecord("A", 1), FencedRecord("B", 2)]
    other.advance("A", 2)
    assert one.digest != other.digest


def test_what_the_journal_has_kept_is_not_changed_behind_its_back() -> None:
    kept = {"A": 1}
    FencingTokens(kept).advance("A", 2)
    assert kept == {"A": 1}
