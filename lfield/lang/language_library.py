"""The library of L: names, parameter types, results, and the permitted callers.

The functions of the thesis (appendix J, table J.9) come first in each group, then the additional ones.
`operation` is the instruction of the machine that implements the function.
"""

from __future__ import annotations

from typing import Literal

from msgspec import Struct

from lfield.lang.types import (
    BOOLEAN,
    EXCEPTION,
    INT,
    REAL,
    STRING,
    VOID,
    ArrayType,
    FutureType,
    Type,
    array_of,
)

Scope = Literal["any", "resource", "coordinator"]


class LibraryFunction(Struct, frozen=True):
    """A library function; several may share a name and differ in parameter types."""

    name: str
    parameters: tuple[Type, ...]
    result: Type
    operation: str
    scope: Scope = "any"
    meaning: str = ""


#: The operation of functions that are in L (`lfield/lang/standard_library/sequencing.L`).
SEQUENCED = "sequencing"
#: The operation of a call that the compiler replaces by the corners in a map file.
AREA = "map_area"
#: The same for the strips that cover it.
STRIPS = "survey_strips"

FUNCTIONS: tuple[LibraryFunction, ...] = (
    LibraryFunction("write", (INT,), VOID, "write_int", "resource", "writes a number to standard output"),
    LibraryFunction("write", (REAL,), VOID, "write_float", "resource", "writes a number to standard output"),
    LibraryFunction("write", (STRING,), VOID, "write_str", "resource", "writes text to standard output"),
    LibraryFunction("write", (BOOLEAN,), VOID, "write_bool", "resource", "writes true or false"),
    LibraryFunction(
        "read",
        (REAL,),
        STRING,
        "read_line",
        "resource",
        "a line of the operator's input at its host, within this many seconds; TimeLimitException",
    ),
    LibraryFunction("print", (INT,), VOID, "print_int", "any", "a line in the log of the host it runs on"),
    LibraryFunction("print", (REAL,), VOID, "print_float", "any", "a line in the log of the host it runs on"),
    LibraryFunction("print", (STRING,), VOID, "print_str", "any", "a line in the log of the host it runs on"),
    LibraryFunction(
        "print", (BOOLEAN,), VOID, "print_bool", "any", "a line in the log of the host it runs on"
    ),
    LibraryFunction("yield", (), VOID, "yield", "any", "runs other threads"),
    LibraryFunction("sleep", (REAL,), VOID, "sleep", "any", "pauses this thread for seconds"),
    LibraryFunction("now", (), REAL, "now", "any", "seconds since 1970 on the clock of the host it runs on"),
    LibraryFunction(
        "lived", (), REAL, "lived", "coordinator", "seconds that this coordinator has lived, on all its hosts"
    ),
    LibraryFunction("hops", (), INT, "hops", "coordinator", "how often this coordinator has migrated"),
    LibraryFunction(
        "heartbeatInterval",
        (REAL,),
        VOID,
        "heartbeat_interval",
        "coordinator",
        "seconds without a sign of this coordinator until it is recovered, -1: never; ArithmeticException",
    ),
    LibraryFunction(
        "start",
        (STRING, REAL),
        VOID,
        SEQUENCED,
        "coordinator",
        "starts a startable coordinator within this many seconds; ReservedException if it runs",
    ),
    LibraryFunction(
        "stop",
        (STRING, REAL),
        VOID,
        SEQUENCED,
        "coordinator",
        "stops a startable coordinator if it runs, and waits for its end",
    ),
    LibraryFunction(
        "awaitEnd",
        (STRING, REAL),
        STRING,
        SEQUENCED,
        "coordinator",
        "waits for the end of a startable coordinator: done, stopped, or how it failed",
    ),
    LibraryFunction(
        "running", (STRING, REAL), BOOLEAN, SEQUENCED, "coordinator", "whether a startable coordinator runs"
    ),
    LibraryFunction(
        "mapArea",
        (STRING,),
        array_of(REAL),
        AREA,
        "any",
        "the only polygon of a KML or GeoJSON file: {latitude, longitude} in degrees of each corner; M302",
    ),
    LibraryFunction(
        "mapArea", (STRING, STRING), array_of(REAL), AREA, "any", "the polygon with this name; M302"
    ),
    LibraryFunction(
        "surveyStrips",
        (STRING, REAL, REAL),
        array_of(REAL),
        STRIPS,
        "any",
        "strips that cover the only polygon of a map file; spacing in m and heading in degrees, constants: "
        "{latitude, longitude} of start and end of each; M302, M303",
    ),
    LibraryFunction(
        "surveyStrips",
        (STRING, STRING, REAL, REAL),
        array_of(REAL),
        STRIPS,
        "any",
        "strips that cover the polygon with this name; M302, M303",
    ),
    LibraryFunction("s2i", (STRING,), INT, "s2i", "any", "text to int; ConversionException"),
    LibraryFunction("s2f", (STRING,), REAL, "s2f", "any", "text to real; ConversionException"),
    LibraryFunction("i2f", (INT,), REAL, "i2f", "any", "int to real"),
    LibraryFunction("f2i", (REAL,), INT, "f2i", "any", "real to int, towards zero; ConversionException"),
    LibraryFunction("i2s", (INT,), STRING, "i2s", "any", "int to text"),
    LibraryFunction(
        "f2s", (REAL,), STRING, "f2s", "any", "real to the shortest text that reads back the same"
    ),
    LibraryFunction(
        "f2s", (REAL, INT), STRING, "f2s_digits", "any", "real to text with this number of decimals (0-17)"
    ),
    LibraryFunction("b2s", (BOOLEAN,), STRING, "b2s", "any", "true or false as text"),
    LibraryFunction("abs", (INT,), INT, "abs_int", "any", "magnitude"),
    LibraryFunction("abs", (REAL,), REAL, "abs_float", "any", "magnitude"),
    LibraryFunction("min", (INT, INT), INT, "min_int", "any", "the smaller"),
    LibraryFunction("min", (REAL, REAL), REAL, "min_float", "any", "the smaller; NaN if one is"),
    LibraryFunction("max", (INT, INT), INT, "max_int", "any", "the larger"),
    LibraryFunction("max", (REAL, REAL), REAL, "max_float", "any", "the larger; NaN if one is"),
    LibraryFunction("sqrt", (REAL,), REAL, "sqrt", "any", "square root; ArithmeticException below 0"),
    LibraryFunction("sin", (REAL,), REAL, "sin", "any", "sine of radians"),
    LibraryFunction("cos", (REAL,), REAL, "cos", "any", "cosine of radians"),
    LibraryFunction("tan", (REAL,), REAL, "tan", "any", "tangent of radians"),
    LibraryFunction(
        "asin", (REAL,), REAL, "asin", "any", "angle in radians; ArithmeticException outside -1..1"
    ),
    LibraryFunction(
        "acos", (REAL,), REAL, "acos", "any", "angle in radians; ArithmeticException outside -1..1"
    ),
    LibraryFunction("atan2", (REAL, REAL), REAL, "atan2", "any", "angle of (y, x) in radians"),
    LibraryFunction("exp", (REAL,), REAL, "exp", "any", "e to the power"),
    LibraryFunction(
        "log", (REAL,), REAL, "log", "any", "natural logarithm; ArithmeticException at or below 0"
    ),
    LibraryFunction("pow", (REAL, REAL), REAL, "pow", "any", "power; ArithmeticException where undefined"),
    LibraryFunction("floor", (REAL,), REAL, "floor", "any", "the next whole number down"),
    LibraryFunction("ceil", (REAL,), REAL, "ceil", "any", "the next whole number up"),
    LibraryFunction(
        "round", (REAL,), REAL, "round", "any", "the nearest whole number, halves away from zero"
    ),
    LibraryFunction("random", (), REAL, "random", "any", "a number from 0 up to 1"),
    LibraryFunction(
        "random", (INT,), INT, "random_int", "any", "a number from 0 up to n-1; ArithmeticException"
    ),
)

#: Functions that lfield 0.4 lacks: a method of this name is allowed, and takes precedence in its unit.
YIELDING = frozenset({"read", "start", "stop", "awaitEnd", "running"})

#: Methods of strings: `s.length()`. The receiver is the first argument of the operation.
STRING_METHODS: tuple[LibraryFunction, ...] = (
    LibraryFunction("length", (), INT, "str_len", meaning="number of characters"),
    LibraryFunction(
        "substring", (INT, INT), STRING, "substring", meaning="characters from..to-1; IndexException"
    ),
    LibraryFunction("indexOf", (STRING,), INT, "index_of", meaning="where it first occurs, or -1"),
)

#: Methods of every exception object, built-in or caught as `Exception`.
EXCEPTION_METHODS: tuple[LibraryFunction, ...] = (
    LibraryFunction("message", (), STRING, "exc_message", meaning="what went wrong, one sentence"),
    LibraryFunction("type", (), STRING, "exc_type", meaning="the name of the class that was thrown"),
    LibraryFunction(
        "source",
        (),
        STRING,
        "exc_source",
        meaning="the agent, or the device (of an agent, as in bob.fc), that it is about, or ''",
    ),
    LibraryFunction(
        "others", (), array_of(EXCEPTION), "exc_others", meaning="what other calls of a together threw"
    ),
)

#: Methods of every proxy, executed on the host of the coordinator. A portal of that name takes precedence.
PROXY_METHODS: tuple[LibraryFunction, ...] = (
    LibraryFunction("agent", (), STRING, "agent", "coordinator", "the id of the resource"),
    LibraryFunction("host", (), STRING, "host", "coordinator", "the name of its host"),
)

#: Methods of a loop of the same resource: fields of the resource.
LOOP_METHODS: tuple[LibraryFunction, ...] = (
    LibraryFunction("running", (), BOOLEAN, "", "resource", "whether the body of the loop runs now"),
    LibraryFunction(
        "overruns", (), INT, "", "resource", "how often the body of the loop ended after its next tick"
    ),
)

#: Methods of tickets, in the library only: result and operation.
TICKET_METHODS: dict[str, tuple[Type, str]] = {
    "wait": (INT, "next"),
    "ended": (BOOLEAN, "ended"),
    "cancel": (VOID, "cancel"),
    "thrown": (EXCEPTION, "failure"),
}
#: `a.length()` of any array.
ARRAY_LENGTH = "array_len"
#: The operations that make an array longer or shorter.
GROWTH = frozenset({"append", "insert", "remove", "remove_last"})

_T, _K, _V = Type("T"), Type("K"), Type("V")
#: The methods of arrays and maps that are in L (`lfield/lang/standard_library`), for the page of L.
LIBRARY_OF_ARRAYS: tuple[LibraryFunction, ...] = (
    LibraryFunction("contains", (_T,), BOOLEAN, "", meaning="whether one element is equal (`==`)"),
    LibraryFunction("indexOf", (_T,), INT, "", meaning="the first index of an equal element, or -1"),
    LibraryFunction(
        "slice", (INT, INT), array_of(_T), "", meaning="a new array of elements from..to-1; IndexException"
    ),
    LibraryFunction("sort", (), VOID, "", meaning="sorts int, real (NaN last) or string, from the smallest"),
    LibraryFunction(
        "sort", (Type("method"),), VOID, "", meaning="sorts by a method of this unit: a key or a comparison"
    ),
)
LIBRARY_OF_MAPS: tuple[LibraryFunction, ...] = (
    LibraryFunction("length", (), INT, "", meaning="number of keys"),
    LibraryFunction("contains", (_K,), BOOLEAN, "", meaning="whether the map has the key"),
    LibraryFunction("remove", (_K,), _V, "", meaning="removes a key, returns its value; IndexException"),
    LibraryFunction("keys", (), array_of(_K), "", meaning="the keys in the order of their insertion"),
    LibraryFunction("values", (), array_of(_V), "", meaning="the values in the order of their keys"),
)
_E = Type("E")
#: The methods of a member of an enum, and those of the enum itself; `name` and `of` are texts of L.
ENUM_VALUE_METHODS: tuple[LibraryFunction, ...] = (
    LibraryFunction("name", (), STRING, "", meaning="the name of the member"),
    LibraryFunction("ordinal", (), INT, "", meaning="its place in the declaration, from 0"),
)
ENUM_METHODS: tuple[LibraryFunction, ...] = (
    LibraryFunction("values", (), array_of(_E), "", meaning="a new array of all members, in their order"),
    LibraryFunction("of", (STRING,), _E, "", meaning="the member of that name; ConversionException"),
)
#: The methods of futures, and of arrays of futures, for the page of L.
LIBRARY_OF_FUTURES: tuple[LibraryFunction, ...] = (
    LibraryFunction("await", (), _T, "", "coordinator", "waits for the call: its result, or what it threw"),
    LibraryFunction("await", (REAL,), _T, "", "coordinator", "the same, at most seconds; TimeLimitException"),
    LibraryFunction("done", (), BOOLEAN, "", "coordinator", "whether the call has ended; goes to its host"),
    LibraryFunction("cancel", (), VOID, "", "coordinator", "cancels the call and waits until it has ended"),
)
RACES: tuple[LibraryFunction, ...] = (
    LibraryFunction("race", (), INT, "", "coordinator", "the first that returns; cancels the others"),
    LibraryFunction(
        "race",
        (Type("method"),),
        INT,
        "",
        "coordinator",
        "the first whose result a method of this unit accepts, or -1; cancels the others",
    ),
    LibraryFunction(
        "next",
        (),
        INT,
        "",
        "coordinator",
        "the first that has ended; the others continue; -1 if all are null",
    ),
)
ARRAY_LIBRARY = tuple(dict.fromkeys(f.name for f in LIBRARY_OF_ARRAYS))


def library_of_array(array: ArrayType) -> tuple[LibraryFunction, ...]:
    """The methods of an array that are in L."""
    return (*LIBRARY_OF_ARRAYS, *(RACES if isinstance(array.element, FutureType) else ()))


def array_methods(array: ArrayType) -> tuple[LibraryFunction, ...]:
    """The methods of an array that are instructions; the others are in ARRAY_LIBRARY."""
    element = array.element
    return (
        LibraryFunction("length", (), INT, ARRAY_LENGTH, meaning="number of elements"),
        LibraryFunction("append", (element,), VOID, "append", meaning="adds an element at the end"),
        LibraryFunction(
            "insert",
            (INT, element),
            VOID,
            "insert",
            meaning="adds an element before this index; IndexException",
        ),
        LibraryFunction(
            "remove", (INT,), element, "remove", meaning="removes and returns the element; IndexException"
        ),
        LibraryFunction(
            "pop", (), element, "remove_last", meaning="removes and returns the last element; IndexException"
        ),
    )
