"""The last line of `lfield up --all`: the end of the mission, failures and their hosts, and the
exit status.
"""

from __future__ import annotations

import os

import pytest

from lfield import exit_status
from lfield.cli.run.run_summary import summary, total_hops
from lfield.host.process.run_result import RunResult, failure_reason, known_hops, read_result
from lfield.wire.coordinator_messages import CoordinatorState

UNSAFE = "a device is not confirmed to be at rest in its safe state: look at it"


@pytest.mark.parametrize(
    ("statuses", "reasons", "status", "line"),
    [
        ({"a": 0, "b": 0}, {}, 0, "mission completed after 12 s, 4 hops; exit status 0"),
        (
            {"a": 0, "b": 1},
            {},
            1,
            "mission failed on b after 12 s, 4 hops; exit status 1: a coordinator died or is lost",
        ),
        ({"a": 3, "b": 1}, {}, 3, f"mission failed on a after 12 s, 4 hops; exit status 3: {UNSAFE}"),
        ({"a": 0, "b": 0}, {}, 130, "mission stopped after 12 s, 4 hops; exit status 130: interrupted"),
        (
            {"a": 1, "b": 1},
            {"b": "pilot died"},
            1,
            "mission failed on b after 12 s, 4 hops; exit status 1: pilot died",
        ),
        (
            {"b": 3, "a": 1, "c": 1},
            {"a": "pilot lost", "b": "killed (SIGKILL)", "c": "pilot lost"},
            3,
            "mission failed on b after 12 s, 4 hops; exit status 3: killed (SIGKILL); a: pilot lost",
        ),
        (
            {"a": 1, "b": 1, "c": 1, "d": 0},
            {"a": "w", "b": "x", "c": "y", "d": "z"},
            1,
            "mission failed on a after 12 s, 4 hops; exit status 1: w; b: x; failures on 1 more hosts",
        ),
    ],
)
def test_the_summary_names_the_end_the_host_and_the_reason(
    statuses: dict[str, int], reasons: dict[str, str], status: int, line: str
) -> None:
    results = {host: RunResult({"p 1": 4}, reasons.get(host, "")) for host in statuses}
    assert summary(statuses, status, 12.3, results) == line


def test_hops_of_a_killed_host_are_those_known_to_other_hosts() -> None:
    assert (
        total_hops({"a": RunResult({"p 1": 3, "q 1": 2}), "b": RunResult(), "c": RunResult({"p 1": 2})}) == 5
    )


@pytest.mark.parametrize(
    ("state", "hops"),
    [
        (CoordinatorState("p", 1, 2, 3, "RUN"), 3),
        (CoordinatorState("p", 1, 2, 3, "MOVED", "b"), 4),
        (CoordinatorState("p", 1, 2, 3, "PREPARED", "b"), 3),
        (CoordinatorState("p", 1, 2, 3, "EXITED", "a", "done"), 3),
        (CoordinatorState("p", 1, 2, 3, "EXITED", "b", "done"), 3),
        (CoordinatorState("p", 1, 2, 3, "EXITED", "b", "lost"), 4),
        (CoordinatorState("p", 1, 0, 0, "EXITED", "b", "lost"), 0),
    ],
)
def test_a_departed_coordinator_has_one_more_hop(state: CoordinatorState, hops: int) -> None:
    assert known_hops([state]) == {"p 1": hops}


@pytest.mark.parametrize(
    ("status", "code"),
    [
        (exit_status.FAILED, "agent-died"),
        (exit_status.UNSAFE, "device-not-safe"),
        (exit_status.UNKNOWN_OUTCOME, "link-refused"),
        (exit_status.UNAVAILABLE, "link-refused"),
        (exit_status.INTERRUPTED, None),
        (exit_status.DONE, None),
    ],
)
def test_the_reason_is_the_error_that_explains_the_status(status: int, code: str | None) -> None:
    errors = {
        "agent-died": "p died\n  at x",
        "device-not-safe": "d NOT SAFE",
        "link-refused": "link",
        "traceback": "t",
    }
    assert failure_reason(status, errors) == (errors[code].partition("\n")[0] if code else "")


@pytest.mark.parametrize("hops", [{}, {"p 1": 7}, {f"agent-{number} 1": number for number in range(9000)}])
def test_a_result_is_sent_through_a_pipe(hops: dict[str, int]) -> None:
    reading, writing = os.pipe()
    RunResult(hops, "why").write(writing)
    assert read_result(reading) == RunResult(hops if len(hops) < 9000 else {}, "why")
    # The parent process has ended.
    RunResult(hops, "why").write(writing)
    os.close(writing)


def test_a_killed_host_has_no_result() -> None:
    reading, writing = os.pipe()
    assert read_result(reading) == RunResult()
    os.close(writing)
