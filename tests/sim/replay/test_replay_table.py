"""The table detects a listed difference that grows, on invented differences without a flight."""

from __future__ import annotations

import pytest
import replay
from replay_table import TO_BE_MENDED, Difference, Figures, judge, once, renew, unbounded

WHY = "It brakes in another way than the fake."


def speed(fake: float, real: float = 8.1) -> Difference:
    return Difference("51.6 top speed", figures=Figures(real, fake, 0.3, "m/s"))


def verdict(difference: Difference, entry: str):
    return judge("a.c", [difference], {"a.c": {WHY: [entry]}})


@pytest.mark.parametrize("fake", [6.9, 6.65, 7.5, 8.3], ids=["as listed", "slack", "nearer", "agrees"])
def test_fake_between_recording_and_listed_value_passes(fake):
    found = verdict(speed(fake), "51.6 top speed (8.1 / 6.9 m/s)")
    assert (found.unlisted, found.worse, found.stale) == ([], [], [])


@pytest.mark.parametrize("fake", [6.5, -6.9, 8.5], ids=["further", "far", "other side"])
def test_fake_further_from_the_recording_is_worse(fake):
    found = verdict(speed(fake), "51.6 top speed (8.1 / 6.9 m/s)")
    assert found.worse == [f"51.6 top speed (8.1 / {fake:g} m/s), listed as 51.6 top speed (8.1 / 6.9 m/s)"]


def test_text_missing_more_often_is_worse():
    twice = Difference("text missing: Disarming motors", figures=Figures(3, 1, 0.0, "times"))
    assert verdict(twice, "text missing: Disarming motors (3 / 2 times)").worse
    assert not verdict(twice, "text missing: Disarming motors (3 / 1 times)").worse


def test_state_that_differs_for_longer_is_worse():
    state = "58.9 armed: True / False"
    parts = [Difference(state, "", Figures(None, seconds, 1.4)) for seconds in (3.0, 2.0)]
    (longer,) = once(parts)
    assert verdict(longer, f"{state} (3 s)").worse
    assert not verdict(longer, f"{state} (4.8 s)").worse
    assert not verdict(parts[0], f"{state} (4.8 s)").worse


def test_measured_difference_without_figures_is_refused():
    assert verdict(speed(6.9), "51.6 top speed").worse


def test_unlisted_and_stale_differences_are_reported():
    found = verdict(speed(6.9), "58.0 climb (1 / 3 m)")
    assert found.unlisted == [speed(6.9)]
    assert found.stale == ["58.0 climb (1 / 3 m)"]


def test_key_that_ends_like_figures_is_not_parsed_as_figures():
    words = Difference("8.0 command 246(3): DENIED / ACCEPTED (3 s)")
    assert verdict(words, words.key).unlisted == []


def test_unbounded_pattern_may_be_about_texts_only():
    found = judge("ap-copter.c", [speed(6.9)], {"ap-*": {WHY: ["51.6 top speed"]}})
    assert found.unlisted == []
    assert unbounded({"ap-*": {WHY: ["51.6 top speed", "text missing: *"]}}) == ["51.6 top speed"]
    assert unbounded({"a.c": {WHY: ["* top speed"]}}) == ["* top speed"]


def test_renew_writes_figures_removes_stale_and_keeps_reasons(tmp_path, monkeypatch):
    monkeypatch.setattr(replay, "TABLE", tmp_path / "differences.yaml")
    table = {"a.c": {WHY: ["51.6 top speed", "58.0 climb (1 / 3 m)"]}}
    new = Difference("60.0 way", figures=Figures(1.0, 9.0, 1.0, "m"))
    renew(table, "a.c", judge("a.c", [speed(6.912), new], table))
    replay.save(table)
    assert replay.load() == {
        "a.c": {WHY: ["51.6 top speed (8.1 / 6.91 m/s)"], TO_BE_MENDED: ["60.0 way (1 / 9 m)"]}
    }
    again = judge("a.c", [speed(6.912), new], replay.load())
    assert (again.unlisted, again.worse, again.stale) == ([], [], [])
