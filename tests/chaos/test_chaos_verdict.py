"""The verdict on real processes reports each type of breach."""

from __future__ import annotations

from call_verdict import CallVerdict

RECOVERED = "w0 was recovered on h1 from its departure for h2; this call may have begun"


def verdict_of(*lines: str) -> CallVerdict:
    verdict = CallVerdict({"w0": 3})
    for now, line in enumerate(lines):
        verdict.on_line(line, "h0", float(now))
    return verdict


def wrong(verdict: CallVerdict) -> tuple[object, ...]:
    return verdict.twice, verdict.outdated, verdict.skipped


def test_reported_possible_call_is_no_breach():
    verdict = verdict_of(
        "stamped w0 0 0",
        "stamped w0 0 1",
        "w0: perhaps 1 7 h0 restarted; this call may have begun",
        "w0: perhaps 2 8 h0 restarted; this call may have begun",
        "w0: walked 3",
    )
    assert (verdict.complete, *wrong(verdict)) == (True, [], [], [])


def test_calls_served_twice_and_skipped_calls_are_breaches():
    verdict = verdict_of("stamped w0 0 0", "stamped w0 0 0", "stamped w0 0 2")
    assert (verdict.complete, *wrong(verdict)) == (False, [("w0", 0)], [], [("w0", 1)])
    verdict.on_line("w0: walked 3")
    assert verdict.skipped == [("w0", 1)]
    assert verdict_of("w0: walked 3").skipped == [("w0", 0), ("w0", 1), ("w0", 2)]


def test_repeated_call_after_a_restart_is_a_breach():
    again = "w0: perhaps 0 7 h0 restarted; this call may have begun"
    assert verdict_of("stamped w0 0 0", "stamped w0 0 1", again, "stamped w0 7 1").twice == [("w0", 1)]


def test_call_behind_a_recovered_state_may_be_repeated_once():
    lines = ("stamped w0 0 0", "stamped w0 0 1", f"w0: perhaps 0 7 {RECOVERED}", "stamped w0 7 1")
    verdict = verdict_of(*lines)
    assert (verdict.repeated, verdict.recoveries, verdict.where) == (1, [1.0], {"w0": "h0"})
    assert wrong(verdict) == ([], [], [])
    assert verdict_of(*lines, "stamped w0 7 1").twice == [("w0", 1)]
    assert verdict_of(*lines, "stamped w0 7 0").twice == [("w0", 0)]


def test_call_of_a_walker_recovered_elsewhere_is_outdated():
    verdict = verdict_of("stamped w0 0 0", f"w0: perhaps 0 7 {RECOVERED}", "stamped w0 0 1")
    assert verdict.outdated == [("w0", 1)]
