"""Types of a program for the verifier: the values that may be stored in each place."""

from __future__ import annotations

from functools import cached_property

from lfield.bytecode.program import (
    ANY,
    ARRAYS,
    BOOLEAN,
    BUILTIN_PARENTS,
    INT,
    NULL,
    OBJECT,
    PROXY,
    REAL,
    REFERENCES,
    STRING,
    ClassRecord,
    Core,
    FieldRecord,
    TypeRecord,
)

#: Kinds of values that a slot, a field or an element of an array may hold.
_VALUES = frozenset({BOOLEAN, INT, REAL, STRING, ANY, OBJECT, PROXY}) | ARRAYS


def scope_of(record: ClassRecord) -> str:
    """The scope of a class's code: "resource", "coordinator", or "global" for neither (chapter IV)."""
    return record.usage if record.kind == "class" else record.kind


class TypeTable:
    """Queries on the types of a program, by type index."""

    def __init__(self, core: Core) -> None:
        self._core = core
        self._records = core.types
        self._classes = core.classes

    def has(self, index: int) -> bool:
        return 0 <= index < len(self._records)

    def record(self, index: int) -> TypeRecord:
        return self._records[index]

    def kind(self, index: int) -> int:
        return self._records[index].kind

    def is_array(self, index: int) -> bool:
        """Whether values of the type are arrays, which may grow or not."""
        return self._records[index].kind in ARRAYS

    def element(self, index: int) -> int:
        """The type of the elements of an array type."""
        return self._core.element(index)

    @cached_property
    def created_arrays(self) -> dict[int, int]:
        """By element type, the type of the arrays that the machine creates."""
        return self._core.created_arrays()

    def is_created_array(self, index: int) -> bool:
        """Whether the machine creates arrays of the type."""
        return self.is_array(index) and self.created_arrays[self.element(index)] == index

    def fields(self, index: int) -> tuple[FieldRecord, ...]:
        """The fields of the objects of a type; () for other types."""
        record = self._records[index]
        return self._classes[record.of].fields if record.kind == OBJECT else ()

    def is_reference(self, index: int) -> bool:
        """Whether values of the type are references."""
        return self._records[index].kind in REFERENCES

    def is_object(self, index: int) -> bool:
        """Whether values of the type are objects of a class, not agents: they can be thrown and copied."""
        record = self._records[index]
        return record.kind == OBJECT and self._classes[record.of].kind == "class"

    def is_value(self, index: int) -> bool:
        """Whether variables may have the type: agents exist only in slot 0, devices not at all."""
        kind = self._records[index].kind
        return kind in _VALUES and (kind != OBJECT or self.is_object(index))

    def fits(self, actual: int, expected: int) -> bool:
        """Whether a value of one type may be stored where another is expected.

        Ints and members of enums fit each other. Null fits every reference, an object of a class fits ANY and
        the class's parent; otherwise the types must be equal.
        """
        if actual == expected:
            return True
        if actual == NULL:
            return self.is_reference(expected)
        if self._records[actual].kind == INT:
            # A member of an enum is an int.
            return self._records[expected].kind == INT
        if not self.is_object(actual):
            return False
        return expected == ANY or (self.is_object(expected) and self._parent(actual) == self._name(expected))

    def _name(self, index: int) -> str:
        return self._classes[self._records[index].of].name

    def _parent(self, index: int) -> str:
        return BUILTIN_PARENTS.get(self._name(index), "")
