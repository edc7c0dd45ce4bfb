"""The table of instructions (appendix J, extended): encoder, verifier, disassembler, engines and the
reference page are derived from it.

An instruction is a quad: an opcode and three 32-bit operands. Opcodes have the numbers in appendix B, if it
has any. An operand is one of

    D   destination: a slot of the activation record          S   source: a slot, or a constant
    V   source: a slot                                         L   label: an instruction of this method
    C   class    T   type    M   method    F   field    K   string constant    I   device call

A source operand >= 0 is a slot; below 0 it is constant number `-1 - operand`. Slot 0 is the object the
method runs on (the thesis' `^0`), then come the parameters.

**Groups.** The parameter stack of the thesis exists only during one group: `push ... push, head, pop`,
where the head is the one instruction with arguments on the stack (`call`, `pcall`, `find`, a library or a
device instruction) and `pop` fetches its result, if it has one. The verifier rejects jumps into a group and
other instructions inside it. So a thread is suspended only at the first instruction of a group, where the
parameter stack is empty, and the block needs no space for it.
"""

from __future__ import annotations

from typing import Literal

from msgspec import Struct

Role = Literal["D", "S", "V", "L", "C", "T", "M", "F", "K", "I"]

#: Kinds of types of an operand. `same` requires equal types of operands of one instruction; `ref` is any
#: reference; `any` depends on the instruction's other operands (the field, the element, the result).
Kind = Literal["boolean", "int", "real", "string", "object", "array", "ref", "same", "any", ""]


class Operand(Struct, frozen=True):
    """One operand: its encoding, and the type of its value."""

    role: Role
    kind: Kind = ""


class Opcode(Struct, frozen=True):
    """One row of the table.

    `argument_kinds` are the kinds that a head pops from the parameter stack, in the order of the pushes,
    or None when the instruction is not a head; `result_kind` is the kind of its result ('' for none).
    `leaves_engine` is true when the instruction leaves the engine, because it has an external effect.
    """

    code: int
    name: str
    operands: tuple[Operand, ...]
    description: str
    argument_kinds: tuple[Kind, ...] | None = None
    result_kind: Kind = ""
    leaves_engine: bool = False


def _quad(code: int, name: str, operands: str, sentence: str) -> Opcode:
    parsed = (operand.partition(":") for operand in operands.split())
    return Opcode(code, name, tuple(Operand(role, kind) for role, _, kind in parsed), sentence)  # type: ignore[arg-type]  # literals of the table; a test checks them


def _head(code: int, name: str, types: str, sentence: str, operands: str = "", exits: bool = False) -> Opcode:
    arguments, _, result = types.partition("->")
    plain = _quad(code, name, operands, sentence)
    kinds = tuple(arguments.split())
    return Opcode(code, name, plain.operands, sentence, kinds, result.strip(), exits)  # type: ignore[arg-type]  # as above


def _family(first: int, suffix: str, kind: str) -> tuple[Opcode, ...]:
    """The six comparisons of one kind of value, as in table J.8."""
    operands = f"D:boolean S:{kind} S:{kind}"
    phrases = (
        ("eq", "equal to"),
        ("sle", "less than or equal to"),
        ("sge", "greater than or equal to"),
        ("sne", "not equal to"),
        ("slt", "less than"),
        ("sgt", "greater than"),
    )
    return tuple(
        _quad(first + i, name + suffix, operands, f"Sets 1 to whether {kind} 2 is {phrase} {kind} 3.")
        for i, (name, phrase) in enumerate(phrases)
    )


TABLE: tuple[Opcode, ...] = (
    # J.1 jumps
    _quad(10, "bnz", "L V:boolean", "Branches to the label when the variable is true."),
    _quad(11, "jmp", "L", "Branches to the label."),
    _quad(12, "bz", "L V:boolean", "Branches to the label when the variable is false."),
    # J.2 moves; the relative and indexed addressing modes of table J.11 have their own instructions
    _quad(100, "move", "D:same S:same", "Moves 2 to 1."),
    _quad(101, "getf", "D:any V:object F", "Moves a field of object 2 to 1 (relative addressing)."),
    _quad(102, "putf", "V:object F S:any", "Moves 3 to a field of object 1 (relative addressing)."),
    _quad(103, "gete", "D:any V:array S:int", "Moves element 3 of array 2 to 1 (indexed addressing)."),
    _quad(104, "pute", "V:array S:int S:any", "Moves 3 to element 2 of array 1 (indexed addressing)."),
    _quad(105, "lds", "D:string K", "Puts a new copy of a string constant on the heap and into 1."),
    # J.3 subroutines
    _head(200, "call", "", "Calls a method with the object and arguments pushed.", "M"),
    _head(202, "pcall", "", "Calls a portal; first moves the coordinator to its resource.", "M", True),
    _quad(210, "frame", "M", "Starts a method: its activation record has the method's slots."),
    _quad(220, "return", "S:any", "Leaves the method with a result."),
    _quad(221, "rtn", "", "Leaves the method without a result."),
    # J.4 memory
    _quad(
        300,
        "new",
        "D:object C",
        "Allocates an object of a class with fields 0, false and null, and stores its reference in 1.",
    ),
    _quad(
        301,
        "newarray",
        "D:array T S:int",
        "Allocates an array of type 2 with 3 elements, and stores its reference in 1.",
    ),
    # J.5 parameter stack
    _quad(400, "push", "S:any", "Pushes an argument."),
    _quad(401, "pop", "D:any", "Pops the result; follows the head that returns it."),
    # J.7 arithmetic
    _quad(500, "addi", "D:int S:int S:int", "Adds 3 to 2; ArithmeticException beyond 64 bits."),
    _quad(501, "addf", "D:real S:real S:real", "Adds 3 to 2."),
    _quad(502, "subi", "D:int S:int S:int", "Subtracts 3 from 2; ArithmeticException beyond 64 bits."),
    _quad(503, "subf", "D:real S:real S:real", "Subtracts 3 from 2."),
    _quad(504, "muli", "D:int S:int S:int", "Multiplies 2 by 3; ArithmeticException beyond 64 bits."),
    _quad(505, "mulf", "D:real S:real S:real", "Multiplies 2 by 3."),
    _quad(506, "divi", "D:int S:int S:int", "Divides 2 by 3 towards zero; ArithmeticException on 0."),
    _quad(507, "divf", "D:real S:real S:real", "Divides 2 by 3; ArithmeticException on 0."),
    _quad(508, "mod", "D:int S:int S:int", "Remainder of 2 by 3, signed as 2; ArithmeticException on 0."),
    _quad(509, "modf", "D:real S:real S:real", "Remainder of 2 by 3, signed as 2; ArithmeticException on 0."),
    _quad(510, "negi", "D:int S:int", "Negates 2; ArithmeticException beyond 64 bits."),
    _quad(511, "negf", "D:real S:real", "Negates 2."),
    # J.6 logic
    _quad(600, "and", "D:boolean S:boolean S:boolean", "Sets 1 to whether 2 and 3 are both true."),
    _quad(601, "or", "D:boolean S:boolean S:boolean", "Sets 1 to whether 2 or 3 is true."),
    _quad(602, "not", "D:boolean S:boolean", "Sets 1 to whether 2 is false."),
    # J.8 comparisons
    *_family(700, "i", "int"),
    *_family(710, "f", "real"),
    *_family(720, "s", "string"),
    _quad(730, "eqb", "D:boolean S:boolean S:boolean", "Sets 1 to whether boolean 2 is equal to boolean 3."),
    _quad(
        731, "sneb", "D:boolean S:boolean S:boolean", "Sets 1 to whether boolean 2 differs from boolean 3."
    ),
    _quad(
        740,
        "eqr",
        "D:boolean S:ref S:ref",
        "Sets 1 to whether 2 and 3 are the same object (of proxies: the same agent), or both null.",
    ),
    _quad(741, "sner", "D:boolean S:ref S:ref", "Sets 1 to whether 2 and 3 are different objects or agents."),
    _quad(750, "eqnull", "D:boolean S:ref", "Sets 1 to whether reference 2 is null."),
    # J.9 library: output
    _head(800, "write_int", "int", "Writes an int to standard output.", exits=True),
    _head(801, "write_float", "real", "Writes a real to standard output.", exits=True),
    _head(802, "write_str", "string", "Writes a string to standard output.", exits=True),
    _head(803, "write_bool", "boolean", "Writes true or false to standard output.", exits=True),
    _head(810, "print_int", "int", "Writes an int as a line of the host's log.", exits=True),
    _head(811, "print_float", "real", "Writes a real as a line of the host's log.", exits=True),
    _head(812, "print_str", "string", "Writes a string as a line of the host's log.", exits=True),
    _head(813, "print_bool", "boolean", "Writes true or false as a line of the host's log.", exits=True),
    # library: arrays and strings
    _head(820, "array_len", "array->int", "The number of elements of an array."),
    _head(821, "str_concat", "string string->string", "The concatenation of both strings."),
    _head(822, "str_len", "string->int", "The number of characters of a string."),
    _head(
        823, "substring", "string int int->string", "Characters from 2 to before 3; IndexException outside."
    ),
    _head(824, "index_of", "string string->int", "The index of the second string in the first, or -1."),
    _head(825, "str_hash", "string->int", "A number from 0 up to 2^62 - 1 that equal strings share."),
    # library: arrays that grow; the type is that of the array
    _head(826, "append", "array any", "Adds an element at the end of an array; LimitException.", "T"),
    _head(
        827,
        "insert",
        "array int any",
        "Adds an element before element 2 of an array, or at its end; IndexException, LimitException.",
        "T",
    ),
    _head(828, "remove", "array int->any", "Removes element 2 of an array; IndexException.", "T"),
    _head(829, "remove_last", "array->any", "Removes the last element of an array; IndexException.", "T"),
    # library: conversions
    _head(830, "i2f", "int->real", "int to real."),
    _head(831, "f2i", "real->int", "real to int, towards zero; ConversionException outside 64 bits."),
    _head(832, "s2i", "string->int", "A decimal number as int; ConversionException for other text."),
    _head(833, "s2f", "string->real", "A decimal number as real; ConversionException for other text."),
    _head(834, "i2s", "int->string", "int to text."),
    _head(835, "f2s", "real->string", "real to the shortest text that reads back the same."),
    _head(
        836, "f2s_digits", "real int->string", "real to text with 2 decimals; ArithmeticException beyond 17."
    ),
    _head(837, "b2s", "boolean->string", "true or false as text."),
    # library: time and threads
    _head(840, "yield", "", "Lets other threads run.", exits=True),
    _head(841, "sleep", "real", "Pauses the thread for a time in seconds.", exits=True),
    _head(842, "now", "->real", "Seconds since 1970-01-01 UTC on the clock of the host.", exits=True),
    _head(847, "lived", "->real", "Age of the coordinator in seconds, over all its hosts.", exits=True),
    _head(843, "hops", "->int", "The number of migrations of this coordinator."),
    _head(844, "random", "->real", "A random number from 0 up to 1.", exits=True),
    _head(845, "random_int", "int->int", "A random int from 0 up to n-1; ArithmeticException.", exits=True),
    _head(
        846,
        "heartbeat_interval",
        "real",
        "Sets how long this coordinator's shadows wait for a heartbeat, in seconds, -1: without limit; "
        "ArithmeticException.",
    ),
    # library: maths
    _head(850, "abs_int", "int->int", "Magnitude; ArithmeticException beyond 64 bits."),
    _head(851, "abs_float", "real->real", "Magnitude."),
    _head(852, "min_int", "int int->int", "The smaller."),
    _head(853, "min_float", "real real->real", "The smaller; NaN if one is."),
    _head(854, "max_int", "int int->int", "The larger."),
    _head(855, "max_float", "real real->real", "The larger; NaN if one is."),
    _head(856, "sqrt", "real->real", "Square root; ArithmeticException below 0."),
    _head(857, "sin", "real->real", "Sine of radians."),
    _head(858, "cos", "real->real", "Cosine of radians."),
    _head(859, "tan", "real->real", "Tangent of radians."),
    _head(860, "asin", "real->real", "Angle in radians; ArithmeticException outside -1..1."),
    _head(861, "acos", "real->real", "Angle in radians; ArithmeticException outside -1..1."),
    _head(862, "atan2", "real real->real", "Angle of (y, x) in radians."),
    _head(863, "exp", "real->real", "e to the power; ArithmeticException when too large."),
    _head(864, "log", "real->real", "Natural logarithm; ArithmeticException at or below 0."),
    _head(865, "pow", "real real->real", "1 to the power of 2; ArithmeticException where undefined."),
    _head(866, "floor", "real->real", "The next whole number down."),
    _head(867, "ceil", "real->real", "The next whole number up."),
    _head(868, "round", "real->real", "The nearest whole number, halves away from zero."),
    # exceptions (chapter V; not implemented in the prototype)
    _head(870, "exc_message", "ref->string", "The message of an exception object."),
    _head(871, "exc_type", "ref->string", "The name of the class of an exception object."),
    _head(872, "exc_source", "ref->string", "The agent or device that an exception object names, or ''."),
    _head(
        873,
        "exc_others",
        "ref->ref",
        "Suppressed exceptions of other calls of a `together`, or an empty array.",
    ),
    # J.10 find
    _head(1300, "find", "string->ref", "A proxy by id; UnknownResourceException.", "C", True),
    _head(1301, "findall", "->ref", "An array of proxies for all resources of a type.", "C", True),
    _head(
        1302,
        "offers",
        "string->ref",
        "An array of the offers of a capability that satisfy the condition (null: any), best first; "
        "ConstraintException.",
        "C",
        True,
    ),
    _head(
        1303,
        "explain",
        "string->string",
        "Why other agents do not offer a capability with that condition (null: none); ConstraintException.",
        "C",
        True,
    ),
    _head(1304, "agent", "ref->string", "The id of the agent of a proxy.", exits=True),
    _head(1305, "host", "ref->string", "The name of the host of the agent of a proxy.", exits=True),
    _head(
        1310,
        "teams",
        "string int->ref",
        "An array of arrays of 2 offers of a capability that have no agent in common, best first; "
        "ConstraintException.",
        "C",
        True,
    ),
    _quad(1400, "throw", "V:ref", "Throws an object; NullException when it is null."),
    _quad(
        1401,
        "noreturn",
        "",
        "Throws MissingReturnException: a method with a result has ended without return.",
    ),
    _head(
        1500,
        "device",
        "",
        "An instruction of a device of this resource, or of a device that is pushed first.",
        "I",
        True,
    ),
    # parallel work and time limits
    _head(
        1600,
        "gather",
        "->ref",
        "A new sentinel ticket for the calls of a `together`.",
        exits=True,
    ),
    _head(
        1601,
        "begin",
        "",
        "Collects a portal call: pushed are sentinel, array and index of its target (null: none), proxy, "
        "arguments.",
        "M",
        True,
    ),
    _head(1602, "start", "ref", "Starts all collected calls: one visit to each host.", exits=True),
    _head(
        1603,
        "fetch",
        "ref",
        "Starts the remaining calls, waits for all, and stores their results in their targets, or throws the "
        "exception of the first that failed.",
        exits=True,
    ),
    _head(
        1604,
        "leave",
        "ref ref",
        "Cancels pending calls and waits for them; 2 is the thrown exception, or null.",
        exits=True,
    ),
    _head(
        1605,
        "limit",
        "real->int",
        "The end of a time in seconds on the agent's clock; ArithmeticException for NaN.",
        exits=True,
    ),
    _head(
        1606,
        "settle",
        "",
        "Collects the result of a completed call: pushed are sentinel, array of type 1 (null: none) and "
        "index of its target, value.",
        "T",
        True,
    ),
    # reservations
    _head(
        1700,
        "hold",
        "ref->ref",
        "The resources of a proxy, an offer or an array of them, as an array of ints: for each its "
        "number in the team, and 0.",
        exits=True,
    ),
    _head(
        1701,
        "take",
        "array",
        "Migrates to the hosts of these resources and reserves each: replaces 0 by the reservation's number; "
        "ReservedException.",
        exits=True,
    ),
    _head(
        1702,
        "drop",
        "array",
        "Releases these resources without waiting: replaces the numbers by 0.",
        exits=True,
    ),
    # loops of resources
    _head(
        1870,
        "tick",
        "int int->int",
        "Ends a tick of a loop and waits for the next one: 1 is the time of this tick (-1: none), 2 the "
        "period, the result the time of the next one, in ns of the resource; ArithmeticException.",
        exits=True,
    ),
    _head(
        1871,
        "suppress",
        "",
        "Suppresses the body of another loop: CancelledException at its next pause and acting device "
        "instructions, until its tick ends.",
        "M",
        True,
    ),
    _head(
        1872,
        "control",
        "",
        "Until its tick ends only loops of this resource command its devices; DeviceException for others.",
        exits=True,
    ),
    _head(1873, "tick_failed", "ref", "Reports the exception that has ended a tick of a loop.", exits=True),
    # sequencing: each moves the coordinator to the home of the named coordinator, which decides
    _head(
        1851,
        "seq_start",
        "string int",
        "Starts a coordinator; 2 identifies the request. ReservedException when it runs.",
        exits=True,
    ),
    _head(1852, "seq_stop", "string", "Orders the end of a coordinator, if it runs.", exits=True),
    _head(1853, "seq_end", "string->string", "Waits for the end of a coordinator: how it ended.", exits=True),
    _head(1854, "seq_alive", "string->boolean", "Whether a coordinator runs.", exits=True),
    # the operator's input
    _head(
        1850,
        "read_line",
        "real->string",
        "A line of the operator's input at this host, within a time in seconds; TimeLimitException.",
        exits=True,
    ),
    # calls that are started now and fetched later: the ticket of a future is a sentinel with one call
    _head(1830, "launch", "ref", "Starts the call of a ticket: goes to its host.", exits=True),
    _head(
        1831,
        "next",
        "ref->int",
        "Waits until a call of a ticket, or of an array of futures, has ended, and fetches its result: its "
        "index, or -1 if there is none.",
        exits=True,
    ),
    _head(
        1832,
        "ended",
        "ref->boolean",
        "Goes to the host of the call of a ticket, and fetches its result if it has ended.",
        exits=True,
    ),
    _head(
        1833,
        "cancel",
        "ref",
        "Cancels the calls of a ticket, or of an array of futures, waits until they have ended, and fetches "
        "their results.",
        exits=True,
    ),
    _head(
        1834,
        "failure",
        "ref->ref",
        "The exception of the first fetched call of a ticket, or of an array of futures, that has failed, "
        "with those of the others suppressed; null without one.",
        exits=True,
    ),
    # waiting in a monitor
    _head(
        1840,
        "wait_limit",
        "real->int",
        "The end of a wait of so many seconds on the clock of the host, in ns; ArithmeticException for NaN.",
        exits=True,
    ),
    _head(
        1841,
        "wait_leave",
        "int boolean->int",
        "Leaves the monitor, however often it was entered, and returns how often; TimeLimitException after "
        "the end 1 (0: none). 2: the awaited condition reads a clock or a device.",
        exits=True,
    ),
    _head(
        1842,
        "wait_enter",
        "int int",
        "Waits until another thread has left the monitor, at most to the end 2, and enters it 1 times.",
        exits=True,
    ),
)

BY_CODE: dict[int, Opcode] = {row.code: row for row in TABLE}
BY_NAME: dict[str, Opcode] = {row.name: row for row in TABLE}

#: The instructions that visit the home of another coordinator, with their functions in L.
SEQUENCING = {"seq_start": "start", "seq_stop": "stop", "seq_end": "awaitEnd", "seq_alive": "running"}
