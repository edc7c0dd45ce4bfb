"""The types of L (DESIGN section 4): values, references, and two that only the checker sees."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Type:
    """A type without parts: boolean, int, real, string, void, and the two of the checker."""

    name: str

    def __str__(self) -> str:
        return self.name


@dataclass(frozen=True, slots=True)
class ArrayType(Type):
    """`T[]`; write `array_of(T)`, which makes the name."""

    element: Type


@dataclass(frozen=True, slots=True)
class ClassType(Type):
    """An object of a class, or of a built-in exception class."""


@dataclass(frozen=True, slots=True)
class ResourceType(Type):
    """A proxy for a resource somewhere in the team."""


@dataclass(frozen=True, slots=True)
class DeviceType(Type):
    """A piece of hardware, named by a resource's field; never a value that can be copied."""


BOOLEAN = Type("boolean")
INT = Type("int")
REAL = Type("real")
STRING = Type("string")
VOID = Type("void")
NULL = Type("null")
#: The type of an expression that already has an error; it fits everywhere, so one mistake is told once.
UNKNOWN = Type("unknown")
#: `Exception`: what `catch (Exception e)` binds; every object fits it, only throw and three methods take it.
EXCEPTION = ClassType("Exception")

#: The built-in exception classes (appendix I names the first two), besides `Exception` itself.
BUILTIN_EXCEPTIONS = (
    "UnreachableResourceException",
    "RestartException",
    "UnknownResourceException",
    "NullException",
    "IndexException",
    "ArithmeticException",
    "ConversionException",
    "LimitException",
    "DeviceException",
    "DeviceTimeoutException",
    "ConstraintException",
)


def array_of(element: Type) -> ArrayType:
    """`element[]`."""
    return ArrayType(f"{element.name}[]", element)


def is_reference(kind: Type) -> bool:
    """Whether values of the type are references into the block (null is one of them)."""
    return kind not in (BOOLEAN, INT, REAL, VOID)


def is_numeric(kind: Type) -> bool:
    """int or real."""
    return kind in (INT, REAL)
