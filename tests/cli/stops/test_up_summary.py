"""The last line of `lfield up --all`: how the mission ended, where it failed, and the exit status."""

from __future__ import annotations

import pytest

from lfield import exit_status
from lfield.cli.run.up_all import summary


@pytest.mark.parametrize(
    ("statuses", "status", "line"),
    [
        ({"a": 0, "b": 0}, exit_status.DONE, "mission completed after 12 s, 4 hops; exit status 0"),
        (
            {"a": 0, "b": 1},
            exit_status.FAILED,
            "mission failed on b after 12 s, 4 hops; exit status 1: a coordinator died or is lost",
        ),
        (
            {"a": 3, "b": 1},
            exit_status.UNSAFE,
            "mission failed on a after 12 s, 4 hops; exit status 3: "
            "a device is not confirmed to be at rest in its safe state: look at it",
        ),
        (
            {"a": 0, "b": 0},
            exit_status.INTERRUPTED,
            "mission stopped after 12 s, 4 hops; exit status 130: interrupted",
        ),
    ],
)
def test_the_summary_names_the_end_and_the_place(statuses: dict[str, int], status: int, line: str) -> None:
    assert summary(statuses, status, 12.3, 4) == line
