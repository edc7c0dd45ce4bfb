"""The fake acts like the recorded autopilots with the same inputs, except for the listed differences.

`python tests/sim/replay/replay.py ap-copter.c` prints the differences of a recording. See README.md.
`make test-more` plays all recordings, and so does that program without a name: run it after changing a fake.
"""

from __future__ import annotations

import fnmatch
from functools import cache

import pytest
import replay
from replay import load
from replay_table import TO_BE_MENDED, Verdict, matches, unbounded
from replay_trace import names


@cache
def verdict(name: str) -> Verdict:
    return replay.verdict(name, load())


@pytest.mark.few(2)
@pytest.mark.parametrize("name", names())
def test_fake_acts_like_the_recorded_autopilot(name):
    found = verdict(name)
    assert [f"{each.entry} {each.detail}" for each in found.unlisted] == []
    assert found.worse == [], "fix the fake, or record the difference with `replay.py --write`"
    assert found.stale == [], "listed but not found: remove it from differences.yaml"


@pytest.mark.few(0)
def test_entry_for_several_recordings_occurs_in_one_of_them():
    missing = [
        (trace, pattern)
        for trace, reasons in load().items()
        for listed in reasons.values()
        for pattern in listed
        if not any(matches(each, pattern) for name in _meant(trace) for each in verdict(name).found)
    ]
    assert missing == []


def test_entry_without_bounds_is_about_texts_only():
    assert unbounded(load()) == []


def _meant(trace: str) -> list[str]:
    return [name for name in names() if fnmatch.fnmatchcase(name, trace)]


def test_no_listed_difference_is_unexplained():
    assert [trace for trace, reasons in load().items() if TO_BE_MENDED in reasons] == []


def test_each_difference_has_a_reason_of_four_words():
    reasons = {reason for of_trace in load().values() for reason in of_trace if reason != TO_BE_MENDED}
    assert [reason for reason in reasons if len(reason.split()) < 4] == []


def test_all_recordings_are_present():
    assert len(names()) == 50
