"""Link quality by sequence numbers: lost, reordered and repeated packets, and restarts of the sender."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from lfield_mavlink.link.link_quality import LONGEST_GAP, WINDOW, SenderStats


def stats_of(sequences, step=0.01):
    stats, now = SenderStats(), 0.0
    for sequence in sequences:
        now += step
        stats.add(sequence % 256, now)
    return stats, now


def test_complete_sequence_has_quality_one():
    stats, now = stats_of(range(1000))
    assert stats.quality(now) == 1.0
    assert stats.lost == 0


def test_one_loss_in_four_gives_quality_three_quarters():
    stats, now = stats_of(number for number in range(10, 1010) if number % 4)
    assert stats.lost == pytest.approx(250, abs=1)
    assert stats.quality(now) == pytest.approx(0.75, abs=0.01)


def test_reordered_and_repeated_packets_are_not_lost():
    stats, now = stats_of([1, 2, 4, 3, 5, 5, 6, 8, 7, 7, 9])
    assert stats.lost == 0
    assert stats.quality(now) == 1.0


def test_restart_of_the_sender_is_no_loss():
    stats, _ = stats_of([*range(100), *range(180, 250)])
    assert stats.lost == 0


def test_quality_forgets_losses_outside_the_window():
    stats, now = stats_of([0, 30])
    assert stats.quality(now) < 0.1
    for sequence in range(31, 60):
        now += 1.0
        stats.add(sequence, now)
    assert stats.quality(now) == 1.0
    assert stats.lost == 29
    assert stats.quality(now + WINDOW + 1.0) == 0.0


@given(st.lists(st.integers(0, 255), max_size=500))
def test_any_sequence_gives_a_valid_quality_in_bounded_memory(sequences):
    stats, now = stats_of(sequences)
    assert 0.0 <= stats.quality(now) <= 1.0
    assert stats.lost >= 0
    assert len(stats._missing) <= LONGEST_GAP
    assert len(stats._recent) <= WINDOW / 0.1 + 2
