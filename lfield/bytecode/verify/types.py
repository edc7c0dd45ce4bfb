"""What the verifier knows of types: which values fit where."""

from __future__ import annotations

from lfield.bytecode.program import (
    ANY,
    ARRAY,
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
_VALUES = frozenset({BOOLEAN, INT, REAL, STRING, ANY, ARRAY, OBJECT, PROXY})


def scope_of(record: ClassRecord) -> str:
    """The scope code of a class runs in: "resource", "coordinator", or "global" for neither (chapter IV)."""
    return record.usage if record.kind == "class" else record.kind


class TypeTable:
    """Questions about the types of a program, asked by type index."""

    def __init__(self, core: Core) -> None:
        self._records = core.types
        self._classes = core.classes

    def has(self, index: int) -> bool:
        """Whether there is a type of that index."""
        return 0 <= index < len(self._records)

    def record(self, index: int) -> TypeRecord:
        """The record of a type."""
        return self._records[index]

    def kind(self, index: int) -> int:
        """The kind of a type."""
        return self._records[index].kind

    def fields(self, index: int) -> tuple[FieldRecord, ...]:
        """The fields of the objects of a type; () when it is no type of objects."""
        record = self._records[index]
        return self._classes[record.of].fields if record.kind == OBJECT else ()

    def is_reference(self, index: int) -> bool:
        """Whether values of the type are references."""
        return self._records[index].kind in REFERENCES

    def is_object(self, index: int) -> bool:
        """Whether values of the type are objects of a class, not agents: what can be thrown and copied."""
        record = self._records[index]
        return record.kind == OBJECT and self._classes[record.of].kind == "class"

    def is_value(self, index: int) -> bool:
        """Whether variables may have the type: agents are known by slot 0 only, devices not at all."""
        kind = self._records[index].kind
        return kind in _VALUES and (kind != OBJECT or self.is_object(index))

    def fits(self, given: int, wanted: int) -> bool:
        """Whether a value of one type may be put where another is wanted.

        Null fits every reference, an object of a class fits ANY and what that class is a kind of, otherwise
        the types are equal.
        """
        if given == wanted:
            return True
        if given == NULL:
            return self.is_reference(wanted)
        if not self.is_object(given):
            return False
        return wanted == ANY or (self.is_object(wanted) and self._parent(given) == self._name(wanted))

    def _name(self, index: int) -> str:
        return self._classes[self._records[index].of].name

    def _parent(self, index: int) -> str:
        return BUILTIN_PARENTS.get(self._name(index), "")
