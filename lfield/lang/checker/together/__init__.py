"""`together`, `within`, `reserve`: which calls are begun at one time, where results go, for how long."""

from lfield.lang.checker.together.calls import begin_calls
from lfield.lang.checker.together.limits import limit, may_stand, reserved

__all__ = ["begin_calls", "limit", "may_stand", "reserved"]
