"""`together`, `within`, `reserve`: which calls are begun at one time, where results go, for how long."""

from lfield.lang.checker.together.block_rules import (
    check_coordinator_block,
    check_reserve_operand,
    check_within_seconds,
)
from lfield.lang.checker.together.started_calls import mark_started_calls

__all__ = ["check_coordinator_block", "check_reserve_operand", "check_within_seconds", "mark_started_calls"]
