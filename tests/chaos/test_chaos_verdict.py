"""The judge of real processes finds what it is there for."""

from __future__ import annotations

from verdict import Verdict


def verdict_of(*lines: str) -> Verdict:
    verdict = Verdict({"w0": 3})
    for line in lines:
        verdict.hear(line)
    return verdict


def test_a_call_that_may_have_been_made_is_no_breach():
    verdict = verdict_of("stamped w0 0", "stamped w0 1", "w0: perhaps 1", "w0: perhaps 2", "w0: walked 3")
    assert (verdict.complete, verdict.twice, verdict.skipped) == (True, [], [])


def test_what_was_served_twice_and_what_nobody_served_is_told():
    verdict = verdict_of("stamped w0 0", "stamped w0 0", "stamped w0 2")
    assert (verdict.complete, verdict.twice, verdict.skipped) == (False, [("w0", 0)], [("w0", 1)])
    verdict.hear("w0: walked 3")
    assert verdict.skipped == [("w0", 1)]
    assert verdict_of("w0: walked 3").skipped == [("w0", 0), ("w0", 1), ("w0", 2)]
