"""Link quality by sequence numbers: lost, overtaken and repeated packets, senders that start again."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from lfield_mavlink.link.link_quality import LONGEST_GAP, WINDOW, SenderStats


def heard(sequences, step=0.01):
    stats, now = SenderStats(), 0.0
    for sequence in sequences:
        now += step
        stats.add(sequence % 256, now)
    return stats, now


def test_all_of_them():
    stats, now = heard(range(1000))
    assert stats.quality(now) == 1.0
    assert stats.lost == 0


def test_every_fourth_is_lost():
    stats, now = heard(number for number in range(10, 1010) if number % 4)
    assert stats.lost == pytest.approx(250, abs=1)
    assert stats.quality(now) == pytest.approx(0.75, abs=0.01)


def test_overtaken_packets_are_not_lost_and_repeated_ones_do_not_count():
    stats, now = heard([1, 2, 4, 3, 5, 5, 6, 8, 7, 7, 9])
    assert stats.lost == 0
    assert stats.quality(now) == 1.0


def test_a_sender_that_starts_again_has_lost_nothing():
    stats, _ = heard([*range(100), *range(180, 250)])
    assert stats.lost == 0


def test_what_was_long_ago_is_forgotten():
    stats, now = heard([0, 30])
    assert stats.quality(now) < 0.1
    for sequence in range(31, 60):
        now += 1.0
        stats.add(sequence, now)
    assert stats.quality(now) == 1.0
    assert stats.lost == 29
    assert stats.quality(now + WINDOW + 1.0) == 0.0


@given(st.lists(st.integers(0, 255), max_size=500))
def test_any_sequence_gives_a_share_and_bounded_memory(sequences):
    stats, now = heard(sequences)
    assert 0.0 <= stats.quality(now) <= 1.0
    assert stats.lost >= 0
    assert len(stats._missing) <= LONGEST_GAP
    assert len(stats._recent) <= WINDOW / 0.1 + 2
