"""Objects of L in Python."""

from __future__ import annotations

from collections.abc import Mapping

#: Depth to which nested objects are shown, and elements shown of each array.
SHOWN_DEPTH, SHOWN_ELEMENTS = 4, 10


class LObject:
    """An object of a class of the program: `LObject("Point", x=1.0, y=2.0)`, with fields as attributes.

    Immutable. Two objects are equal if their classes and fields are, including cycles. A field whose name is
    not a valid or free Python attribute is only in `fields`.
    """

    __slots__ = ("class_name", "fields")

    class_name: str
    fields: Mapping[str, object]

    def __init__(self, class_name: str, /, **fields: object) -> None:
        object.__setattr__(self, "class_name", class_name)
        object.__setattr__(self, "fields", fields)

    def __getattr__(self, name: str) -> object:
        # A copy operation accesses attributes before the object has fields.
        if name in LObject.__slots__ or name not in self.fields:
            raise AttributeError(name)
        return self.fields[name]

    def __setattr__(self, name: str, value: object) -> None:
        raise AttributeError(f"an LObject cannot be changed: create another {self.class_name}")

    def __delattr__(self, name: str) -> None:
        raise AttributeError(f"an LObject cannot be changed: create another {self.class_name}")

    def __eq__(self, other: object) -> bool:
        return _is_equal(self, other) if isinstance(other, LObject) else NotImplemented

    def __hash__(self) -> int:
        return hash((self.class_name, *self.fields))

    def __repr__(self) -> str:
        return _text(self, SHOWN_DEPTH)


def _text(value: object, depth: int) -> str:
    if isinstance(value, list):
        more = [] if depth and len(value) <= SHOWN_ELEMENTS else ["..."]
        first = value[:SHOWN_ELEMENTS] if depth else []
        return f"[{', '.join([*(_text(each, depth - 1) for each in first), *more])}]"
    if not isinstance(value, LObject):
        return repr(value)
    if not depth:
        return f"{value.class_name}(...)"
    fields = (f"{name}={_text(field, depth - 1)}" for name, field in value.fields.items())
    return f"{value.class_name}({', '.join(fields)})"


def _is_equal(first: object, second: object) -> bool:
    """Whether two values are equal. Pairs under comparison count as equal, because of cycles. The depth is
    not limited.
    """
    pairs, visited = [(first, second)], set[tuple[int, int]]()
    while pairs:
        left, right = pairs.pop()
        if left is right or (id(left), id(right)) in visited:
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
        visited.add((id(left), id(right)))
    return True
