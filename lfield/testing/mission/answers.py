"""What a double may answer beside a plain value, and objects of L as Python has them."""

from __future__ import annotations

import math
from collections.abc import Mapping

from lfield.bytecode.program import BUILTIN_CLASSES
from lfield.errors import DoubleError
from lfield.text.suggest import did_you_mean, listed

#: So deep an object shows its fields, which may be objects again, and so many of the elements of each array.
SHOWN_DEPTH, SHOWN_ELEMENTS = 4, 10


class LObject:
    """An object of a class of the program: `LObject("Point", x=1.0, y=2.0)`, whose fields are attributes.

    It cannot be changed. Two are equal when class and fields are, also where they lead back to themselves.
    A field that has the name of a Python attribute, or no name for one, is in `fields`.
    """

    __slots__ = ("class_name", "fields")

    class_name: str
    fields: Mapping[str, object]

    def __init__(self, class_name: str, /, **fields: object) -> None:
        object.__setattr__(self, "class_name", class_name)
        object.__setattr__(self, "fields", fields)

    def __getattr__(self, name: str) -> object:
        # Whoever copies an object asks it for names before it has fields.
        if name in LObject.__slots__ or name not in self.fields:
            raise AttributeError(name)
        return self.fields[name]

    def __setattr__(self, name: str, value: object) -> None:
        raise AttributeError(f"an LObject cannot be changed: make another {self.class_name}")

    def __delattr__(self, name: str) -> None:
        raise AttributeError(f"an LObject cannot be changed: make another {self.class_name}")

    def __eq__(self, other: object) -> bool:
        return _same(self, other) if isinstance(other, LObject) else NotImplemented

    def __hash__(self) -> int:
        return hash((self.class_name, *self.fields))

    def __repr__(self) -> str:
        return _shown(self, SHOWN_DEPTH)


def _shown(value: object, depth: int) -> str:
    if isinstance(value, list):
        more = [] if depth and len(value) <= SHOWN_ELEMENTS else ["..."]
        first = value[:SHOWN_ELEMENTS] if depth else []
        return f"[{', '.join([*(_shown(each, depth - 1) for each in first), *more])}]"
    if not isinstance(value, LObject):
        return repr(value)
    if not depth:
        return f"{value.class_name}(...)"
    fields = (f"{name}={_shown(field, depth - 1)}" for name, field in value.fields.items())
    return f"{value.class_name}({', '.join(fields)})"


def _same(one: object, other: object) -> bool:
    """Whether two values are equal. What is being compared already is taken for equal: of two circles that
    is found in one round, and no depth is too deep."""
    pairs, seen = [(one, other)], set[tuple[int, int]]()
    while pairs:
        left, right = pairs.pop()
        if left is right or (id(left), id(right)) in seen:
            continue
        if isinstance(left, LObject) and isinstance(right, LObject):
            if left.class_name != right.class_name or left.fields.keys() != right.fields.keys():
                return False
            pairs += [(value, right.fields[name]) for name, value in left.fields.items()]
        elif isinstance(left, list | tuple) and isinstance(right, list | tuple):
            if len(left) != len(right):
                return False
            pairs += zip(left, right, strict=True)
        elif left != right:
            return False
        seen.add((id(left), id(right)))
    return True


class Throws(Exception):
    """Raised by a double: the built-in exception of L of this kind is thrown to whoever called the portal.

    Raises DoubleError when L has no such exception, or the message is no text.
    """

    def __init__(self, kind: str, message: str = "") -> None:
        if not isinstance(kind, str) or not isinstance(message, str):
            raise DoubleError(
                f"Throws({kind!r}, {message!r}): give the name of a built-in exception of L, and a text"
            )
        if kind not in BUILTIN_CLASSES:
            hint = did_you_mean(kind, BUILTIN_CLASSES)
            raise DoubleError(
                f"a double cannot throw '{kind}', which is no built-in exception of L; "
                + (hint or f"take one of {listed(BUILTIN_CLASSES)}")
            )
        self.kind, self.message = kind, message
        super().__init__(f"{kind}: {message}")


class After:
    """Returned by a double: the portal gives this value after so many seconds of virtual time.

    With a `Throws` in the place of the value it throws that then. Raises DoubleError for no such time.
    """

    __slots__ = ("seconds", "value")

    def __init__(self, seconds: float, value: object = None) -> None:
        if not isinstance(seconds, int | float) or not math.isfinite(seconds) or seconds < 0:
            raise DoubleError(
                f"After({seconds!r}, ...) is no time to wait: give seconds from 0 on, and then the value"
            )
        self.seconds, self.value = float(seconds), value

    def __repr__(self) -> str:
        return f"After({self.seconds:g}, {self.value!r})"
