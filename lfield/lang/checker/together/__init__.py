"""Checks of `together`, `within`, `reserve` and `wait until`: calls, targets of results, time limits."""

from lfield.lang.checker.together.block_rules import (
    check_coordinator_block,
    check_reserve_operand,
    check_wait_place,
    check_wait_seconds,
    check_within_seconds,
)
from lfield.lang.checker.together.started_calls import mark_started_calls

__all__ = [
    "check_coordinator_block",
    "check_reserve_operand",
    "check_wait_place",
    "check_wait_seconds",
    "check_within_seconds",
    "mark_started_calls",
]
