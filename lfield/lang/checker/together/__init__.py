"""`together` and `within`: which calls are begun at one time, where results go, how long it may take."""

from lfield.lang.checker.together.calls import begin_calls
from lfield.lang.checker.together.limits import limit, may_stand

__all__ = ["begin_calls", "limit", "may_stand"]
