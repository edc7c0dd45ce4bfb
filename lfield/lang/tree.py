"""The checked tree: the output of the front end for the compiler.

Every name is resolved to its declaration, every expression has its type, every conversion is a node,
every overload is selected. Short forms (`for`, `+=`, field initialisers, implicit `this`, constructors) are
expanded, so the compiler handles a single form of each construct. Nodes are compared by identity.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Literal

from msgspec import Struct, field

from lfield.lang.types import Type
from lfield.manifest import DeviceManifest, Instruction
from lfield.text.source_text import Source, Span

UnitKind = Literal["class", "resource", "coordinator"]
Usage = Literal["global", "resource", "coordinator"]
#: A loop is its body; the method of its thread has the kind `ticks`.
MethodKind = Literal["method", "constructor", "init", "portal", "loop", "ticks"]


# --- declarations -------------------------------------------------------------------------------------


class Local(Struct, eq=False):
    """A parameter or local variable. Starts as 0, false or null. One without a name is the checker's own."""

    name: str
    type: Type
    span: Span


class Field(Struct, eq=False):
    """A field; `index` counts from 0 within its unit. A DeviceType names the device type."""

    name: str
    type: Type
    index: int
    public: bool
    span: Span


class Method(Struct, eq=False):
    """A method, constructor, init or portal. `unit` owns it; `body` ends at `end` (the closing brace)."""

    name: str
    kind: MethodKind
    unit: Unit
    parameters: list[Local]
    result: Type
    public: bool
    synchronized: bool
    span: Span
    end: Span
    body: list[Stmt] = field(default_factory=list)

    @property
    def signature(self) -> str:
        """`fib(string, int)`: the name with the parameter types, as overloading and errors see it."""
        return f"{self.name}({', '.join(str(p.type) for p in self.parameters)})"


class ResourceLoop(Struct, eq=False):
    """A loop of a resource: its body, the method of its thread, and its fields, which have no name in L.

    `running`: the body runs now; `engaged`: the loop suppresses loops of lower priority.
    """

    body: Method
    ticks: Method
    priority: int | None
    running: Field
    engaged: Field
    overruns: Field

    @property
    def controls(self) -> bool:
        """Whether only loops command the devices while its body runs: portals have priority 0."""
        return self.priority is not None and self.priority > 0


class Unit(Struct, eq=False):
    """A class (always with a constructor; offers are of a `capability`), resource or coordinator.

    Objects of a class that is `thrown` become exceptions somewhere. A `function` of the top level is checked
    in a unit of its own, which is not in the program.
    """

    name: str
    kind: UnitKind
    usage: Usage
    span: Span
    fields: list[Field] = field(default_factory=list)
    methods: list[Method] = field(default_factory=list)
    capability: bool = False
    thrown: bool = False
    function: bool = False
    library_methods: list[Method] = field(default_factory=list)
    loops: list[ResourceLoop] = field(default_factory=list)
    _fields: dict[str, Field] = field(default_factory=dict)
    _methods: dict[tuple[str, MethodKind], list[Method]] = field(default_factory=dict)

    def add_field(self, field: Field) -> None:
        """Add a field whose name no other one has."""
        self.fields.append(field)
        self._fields[field.name] = field

    def add_method(self, method: Method) -> None:
        self.methods.append(method)
        self._methods.setdefault((method.name, method.kind), []).append(method)

    def add_library_method(self, method: Method) -> None:
        """Add a method of the library for arrays, which has no name in L."""
        self.library_methods.append(method)

    def add_hidden_field(self, name: str, kind: Type, span: Span) -> Field:
        """Add a field that a program cannot name: its name is not one of L."""
        field = Field(name, kind, len(self.fields), public=False, span=span)
        self.fields.append(field)
        return field

    def add_loop(self, loop: ResourceLoop) -> None:
        """Add a loop; those with the highest priority come first."""
        self.loops.append(loop)
        self.loops.sort(key=lambda loop: -math.inf if loop.priority is None else loop.priority, reverse=True)
        self.library_methods = [
            *(method for method in self.library_methods if method.kind != "ticks"),
            *(loop.ticks for loop in self.loops),
        ]

    def loop(self, name: str) -> ResourceLoop | None:
        """The loop of that name."""
        return next((loop for loop in self.loops if loop.body.name == name), None)

    def dismantle(self) -> None:
        """Remove the methods of a unit that is not used any longer: its memory has no cycles then."""
        for method in (*self.methods, *self.library_methods):
            method.body.clear()
        for methods in (self.methods, self.library_methods, self.loops, self._methods):
            methods.clear()

    def mark_thrown(self) -> None:
        """Record that objects of this class become exceptions."""
        self.thrown = True

    @property
    def named_fields(self) -> list[Field]:
        """The fields without the hidden ones."""
        return list(self._fields.values())

    def field(self, name: str) -> Field | None:
        return self._fields.get(name)

    def overloads(self, name: str, kind: MethodKind) -> Sequence[Method]:
        """The methods of that name and kind, in source order."""
        return self._methods.get((name, kind), ())


class Enumeration(Struct, eq=False):
    """An enum: the names of its members in their order; `spans` are the names in the declaration."""

    name: str
    members: tuple[str, ...]
    span: Span
    spans: tuple[Span, ...] = ()


class Constant(Struct, eq=False):
    """A constant of the top level; an enum's member is its number. UNKNOWN while its value is not known."""

    name: str
    type: Type
    value: bool | int | float | str | None
    span: Span


class CheckedProgram(Struct, eq=False):
    """A whole program without errors. `units` in source order; `sources` are all files it was read from.

    `growing` are the types of arrays that it makes longer or shorter.
    """

    units: list[Unit]
    sources: list[Source]
    growing: frozenset[Type] = frozenset()
    enums: tuple[Enumeration, ...] = ()


# --- expressions --------------------------------------------------------------------------------------


class Expr(Struct, eq=False):
    """An expression with a value. `type` may be VOID for calls."""

    span: Span
    type: Type


class EnumName(Expr, eq=False):
    """The name of an enum, before a member or a method. Only in the checker."""

    enum: Enumeration


class Literal_(Expr, eq=False):
    """A constant: bool, int, float, str, or None for null. A member of an enum is its number."""

    value: bool | int | float | str | None


class This(Expr, eq=False):
    """The object, resource or coordinator the method runs in."""


class LocalGet(Expr, eq=False):
    """The value of a local or parameter."""

    local: Local


class FieldGet(Expr, eq=False):
    """A field of an object; `object` may be null at run time."""

    object: Expr
    field: Field


class Element(Expr, eq=False):
    """`array[index]`."""

    array: Expr
    index: Expr


class Assign(Expr, eq=False):
    """`target = value`; its own value is the value assigned. Both types are equal."""

    target: LocalGet | FieldGet | Element
    value: Expr


#: Operators of Binary: both sides have the same type already.
BinaryOp = Literal["+", "-", "*", "/", "%", "==", "!=", "<", "<=", ">", ">="]


class Binary(Expr, eq=False):
    """Arithmetic, `+` on strings, comparison. References have `==`/`!=` only, the right may be a null."""

    op: BinaryOp
    left: Expr
    right: Expr


class Logical(Expr, eq=False):
    """`&&` or `||`; the right side runs only when it is needed."""

    op: Literal["&&", "||"]
    left: Expr
    right: Expr


class Not(Expr, eq=False):
    """`!operand`."""

    operand: Expr


class Negate(Expr, eq=False):
    """`-operand`, int or real."""

    operand: Expr


class ToReal(Expr, eq=False):
    """An int widened to real, the only implicit conversion."""

    operand: Expr


class Relabel(Expr, eq=False):
    """A member of an enum as its number, or the other way round: the value stays as it is."""

    operand: Expr


class New(Expr, eq=False):
    """`new C(args)`. For a built-in exception class, `constructor` is None and args are () or (message)."""

    constructor: Method | None
    arguments: list[Expr]


class NewArray(Expr, eq=False):
    """`new T[n]`, `new T[n][m]`: one array per length given, the rest null. `type` is the whole ArrayType."""

    lengths: list[Expr]


class Call(Expr, eq=False):
    """A method of an object of the program (`This` when called on itself)."""

    object: Expr
    method: Method
    arguments: list[Expr]


class PortalCall(Expr, eq=False):
    """A portal of a resource, through its proxy: the one place where a coordinator may travel."""

    proxy: Expr
    portal: Method
    arguments: list[Expr]


class Async(Expr, eq=False):
    """`async call`: the call of a portal, or of an offer, begins; the value is a new future."""

    call: PortalCall | Call
    constructor: Method


class Find(Expr, eq=False):
    """`findR(id)` gives a proxy, `findR()` (id None) all of them as an array."""

    resource: Unit
    id: Expr | None


class Query(Expr, eq=False):
    """`findC(constraint)`: offers; `teamsC(constraint, size)`: teams of them; `explainC`: the reasons
    against others.
    """

    capability: Unit
    constraint: Expr | None
    verb: Literal["find", "explain", "teams"]
    size: Expr | None = None


class LibraryCall(Expr, eq=False):
    """A function of the library (lang/language_library.py); `operation` names the instruction it becomes."""

    operation: str
    arguments: list[Expr]


class LoopCall(LibraryCall, eq=False):
    """An instruction of the thread of a loop; `other` is the method of another loop's thread."""

    other: Method | None = None


class LoopName(Expr, eq=False):
    """The name of a loop, whose `running()` and `overruns()` can be called."""

    loop: ResourceLoop


class DeviceCall(Expr, eq=False):
    """An instruction of a device: `fc.takeoff(10.0)`. Arguments have exactly the manifest's types."""

    #: A field of the resource itself, or the expression for a device that was passed to an object.
    device: Field | Expr
    manifest: DeviceManifest
    instruction: Instruction
    arguments: list[Expr]


class Elements(Expr, eq=False):
    """A new array of these values, `new T[] {a, b}`; `type` is the whole ArrayType."""

    elements: list[Expr]


# --- statements ---------------------------------------------------------------------------------------


class Stmt(Struct, eq=False):
    """A step of a body."""

    span: Span


class Evaluate(Stmt, eq=False):
    """An expression for its effect; the value is dropped."""

    value: Expr


class Declare(Stmt, eq=False):
    """Declares a local, which is set to 0, false or null without a value (again, in a loop)."""

    local: Local
    value: Expr | None


class If(Stmt, eq=False):
    """`if (condition) then else otherwise`."""

    condition: Expr
    then: list[Stmt]
    otherwise: list[Stmt]


class Loop(Stmt, eq=False):
    """`while`, and `for` with its step: `step` also runs after `continue`."""

    condition: Expr
    body: list[Stmt]
    step: list[Stmt]


class Break(Stmt, eq=False):
    """Leave the innermost loop."""


class Continue(Stmt, eq=False):
    """Go to the step of the innermost loop."""


class Return(Stmt, eq=False):
    """Leave the method; `value` has exactly the result type."""

    value: Expr | None


class Throw(Stmt, eq=False):
    """Throw an object; null throws NullException."""

    value: Expr


class Catch(Struct, eq=False):
    """`catch (C e) ...`: `local.type` is the class caught; EXCEPTION takes any."""

    local: Local
    body: list[Stmt]


class Try(Stmt, eq=False):
    """A body and its catches, tried in order; `last` runs whenever L leaves them, None without `finally`."""

    body: list[Stmt]
    catches: list[Catch]
    last: list[Stmt] | None = None


class Together(Stmt, eq=False):
    """A body whose `StartCall`s run concurrently; it ends when all of them have returned."""

    body: list[Stmt]


class StartCall(Stmt, eq=False):
    """A portal call of the innermost `together` around it, or the call of an offer.

    `target` takes the result when the block ends: a local or an element of an array; None drops it.
    """

    call: PortalCall | Call
    target: LocalGet | Element | None


class Within(Stmt, eq=False):
    """A body with a time limit in seconds."""

    seconds: Expr
    body: list[Stmt]


class Reserve(Stmt, eq=False):
    """A body during which `target` (a proxy, an offer, or an array of them) serves no other coordinator."""

    target: Expr
    body: list[Stmt]


class WaitUntil(Stmt, eq=False):
    """Leave the monitor until the condition holds, at most `seconds` (None: without limit)."""

    condition: Expr
    seconds: Expr | None


class BlockStmt(Stmt, eq=False):
    """Statements with a scope of their own."""

    body: list[Stmt]
