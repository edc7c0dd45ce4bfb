"""Fencing tokens only increase, and two hosts with equal digests have equal tokens."""

from __future__ import annotations

from lfield.replication.lease.quorum_members import FencingTokens
from lfield.wire.quorum_messages import FencedRecord


def test_tokens_only_rise() -> None:
    fences = FencingTokens({"Tour": 5})
    assert not fences.advance("Tour", 5)
    assert not fences.advance("Tour", 4)
    assert fences.token_of("Tour") == 5
    assert fences.advance("Tour", 2**63 - 1)
    assert fences.rejects("Tour", 2**63 - 2)
    assert not fences.rejects("Tour", 2**63 - 1)


def test_without_tokens_nothing_is_fenced() -> None:
    assert not FencingTokens({}).rejects("Tour", 0)


def test_equal_digests_mean_equal_tokens() -> None:
    one, other = FencingTokens({"A": 1, "B": 2}), FencingTokens({"B": 2})
    assert one.digest != other.digest
    other.advance("A", 1)
    assert one.digest == other.digest < 2**63
    assert one.all == other.all == [FencedRecord("A", 1), FencedRecord("B", 2)]
    other.advance("A", 2)
    assert one.digest != other.digest


def test_the_records_of_the_journal_are_not_modified() -> None:
    stored = {"A": 1}
    FencingTokens(stored).advance("A", 2)
    assert stored == {"A": 1}
