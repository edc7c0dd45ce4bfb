"""The types of L: values, references, and two that only the checker sees."""

from __future__ import annotations

from msgspec import Struct


class Type(Struct, frozen=True):
    """A type without parts: boolean, int, real, string, void, and the two of the checker."""

    name: str

    def __str__(self) -> str:
        return self.name


class ArrayType(Type, frozen=True):
    """`T[]`; write `array_of(T)`, which makes the name."""

    element: Type


class ClassType(Type, frozen=True):
    """An object of a class, or of a built-in exception class."""


class MapType(ClassType, frozen=True):
    """`map<K, V>`; write `map_of(K, V)`. Its class is of the library (standard_library/map.L)."""

    key: Type
    value: Type


class EnumType(Type, frozen=True):
    """A member of an enum of the program, represented by its number from 0."""


class FutureType(ClassType, frozen=True):
    """`future<T>`; write `future_of(T)`. Its class is of the library (standard_library/future.L)."""

    value: Type


class ResourceType(Type, frozen=True):
    """A proxy for a resource somewhere in the team."""


class DeviceType(Type, frozen=True):
    """A piece of hardware, named by a resource's field; never a value that can be copied."""


BOOLEAN = Type("boolean")
INT = Type("int")
REAL = Type("real")
STRING = Type("string")
VOID = Type("void")
NULL = Type("null")
#: The type of an expression that already has an error; it fits everywhere, so one mistake is reported once.
UNKNOWN = Type("unknown")
#: The type of the tickets of portal calls: in the library, and in what the compiler makes.
TICKET = Type("ticket")
#: The types whose classes are of the library: only their public methods are visible.
LIBRARY_CLASSES = (MapType, FutureType)
#: `Exception`: the type in `catch (Exception e)`; every object fits it, only throw and three methods take it.
EXCEPTION = ClassType("Exception")
#: The type of the name of a loop; no value has it.
LOOP = Type("loop")

#: The built-in exception classes (appendix I names the first two), besides `Exception` itself, and the base
#: of each: a catch of the base catches both. All failures of hardware have one base class; the others have no
#: common remedy for one handler.
BUILTIN_EXCEPTIONS = {
    "UnreachableResourceException": "Exception",
    "RestartException": "Exception",
    "UnknownResourceException": "Exception",
    "NullException": "Exception",
    "IndexException": "Exception",
    "ArithmeticException": "Exception",
    "ConversionException": "Exception",
    "LimitException": "Exception",
    "DeviceException": "Exception",
    "DeviceTimeoutException": "DeviceException",
    "ConstraintException": "Exception",
    "MissingReturnException": "Exception",
    "CancelledException": "Exception",
    "TimeLimitException": "Exception",
    "ReservedException": "Exception",
    "ReservationLostException": "Exception",
    "AccessException": "Exception",
}


def array_of(element: Type) -> ArrayType:
    """`element[]`."""
    return ArrayType(f"{element.name}[]", element)


def map_of(key: Type, value: Type) -> MapType:
    """`map<key, value>`."""
    return MapType(f"map<{key.name}, {value.name}>", key, value)


def future_of(value: Type) -> FutureType:
    """`future<value>`."""
    return FutureType(f"future<{value.name}>", value)


def is_reference(kind: Type) -> bool:
    """Whether values of the type are references into the block (null is one of them)."""
    return kind not in (BOOLEAN, INT, REAL, VOID) and not isinstance(kind, EnumType)


def distance(actual: Type, expected: Type) -> int | None:
    """The distance from a class to a base class: 0 for itself; None if it is not a base class.

    Every class is a kind of `Exception`, since its objects can be thrown.
    """
    steps = 0
    while actual != expected:
        if not isinstance(actual, ClassType) or actual == EXCEPTION:
            return None
        actual = ClassType(BUILTIN_EXCEPTIONS.get(actual.name, EXCEPTION.name))
        steps += 1
    return steps


def is_numeric(kind: Type) -> bool:
    """int or real."""
    return kind in (INT, REAL)
