"""Special results of doubles."""

from __future__ import annotations

import math

from lfield.bytecode.program import BUILTIN_CLASSES
from lfield.errors import DoubleError
from lfield.text.suggestions import did_you_mean, listed


class Throws(Exception):
    """Raised by a double: throws the built-in L exception of this kind to the caller of the portal.

    Raises DoubleError when L has no such exception, or the message is not a text.
    """

    def __init__(self, kind: str, message: str = "") -> None:
        if not isinstance(kind, str) or not isinstance(message, str):
            raise DoubleError(
                f"Throws({kind!r}, {message!r}): give the name of a built-in exception of L, and a text"
            )
        if kind not in BUILTIN_CLASSES:
            hint = did_you_mean(kind, BUILTIN_CLASSES)
            raise DoubleError(
                f"a double cannot throw '{kind}', which is not a built-in exception of L; "
                + (hint or f"use one of {listed(BUILTIN_CLASSES)}")
            )
        self.kind, self.message = kind, message
        super().__init__(f"{kind}: {message}")


class After:
    """Returned by a double: the portal returns this value after so many seconds of virtual time.

    If the value is a `Throws`, the portal throws that exception. Raises DoubleError for an invalid time.
    """

    __slots__ = ("seconds", "value")

    def __init__(self, seconds: float, value: object = None) -> None:
        if not isinstance(seconds, int | float) or not math.isfinite(seconds) or seconds < 0:
            raise DoubleError(
                f"After({seconds!r}, ...) is not a time: give seconds of at least 0, and then the value"
            )
        self.seconds, self.value = float(seconds), value

    def __repr__(self) -> str:
        return f"After({self.seconds:g}, {self.value!r})"
