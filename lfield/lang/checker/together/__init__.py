"""Checks of `together`, `within` and `reserve`: concurrent calls, targets of results, time limits."""

from lfield.lang.checker.together.block_rules import (
    check_coordinator_block,
    check_reserve_operand,
    check_within_seconds,
)
from lfield.lang.checker.together.started_calls import mark_started_calls

__all__ = ["check_coordinator_block", "check_reserve_operand", "check_within_seconds", "mark_started_calls"]
