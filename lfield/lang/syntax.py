"""The raw syntax tree, before names are resolved.

The parser builds it, the checker turns it into tree.py. Where a piece of text made no sense there is a
`Bad` node, which the checker does not report again.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from lfield.lang.tree import MethodKind, UnitKind, Usage
from lfield.text.source_text import Source, Span

#: The name of a type that could not be read; not a valid name of L.
BAD_TYPE = "?"


@dataclass(slots=True, eq=False)
class TypeName:
    """`Server`, `int[]`, `map<string, int>`: a name, the types in `<>`, and how many `[]` follow."""

    span: Span
    name: str
    dimensions: int = 0
    arguments: tuple[TypeName, ...] = ()

    def __str__(self) -> str:
        arguments = f"<{', '.join(map(str, self.arguments))}>" if self.arguments else ""
        return self.name + arguments + "[]" * self.dimensions


# --- expressions --------------------------------------------------------------------------------------


@dataclass(slots=True, eq=False)
class Expr:
    """An expression; `height` is how deep it nests, which the parser limits. Links of a chain do not nest."""

    span: Span
    height: int


@dataclass(slots=True, eq=False)
class Bad(Expr):
    """An expression with a syntax error that is reported already."""


@dataclass(slots=True, eq=False)
class Literal_(Expr):
    """A number, text, true, false or null (None)."""

    value: bool | int | float | str | None


@dataclass(slots=True, eq=False)
class Name(Expr):
    """A bare name."""

    name: str


@dataclass(slots=True, eq=False)
class This(Expr):
    """`this`."""


@dataclass(slots=True, eq=False)
class Unary(Expr):
    """`!x` or `-x`."""

    operator: str
    operand: Expr


@dataclass(slots=True, eq=False)
class Binary(Expr):
    """Any operator with two sides; `sign` is the operator."""

    operator: str
    sign: Span
    left: Expr
    right: Expr


@dataclass(slots=True, eq=False)
class Assign(Expr):
    """`target = value` or `target += value`; `sign` is the operator."""

    operator: str
    sign: Span
    target: Expr
    value: Expr


@dataclass(slots=True, eq=False)
class Member(Expr):
    """`object.name`; `place` is the name."""

    object: Expr
    name: str
    place: Span


@dataclass(slots=True, eq=False)
class Call(Expr):
    """`function(arguments)`, where the function is a Name or a Member."""

    function: Name | Member
    arguments: list[Expr]


@dataclass(slots=True, eq=False)
class Async(Expr):
    """`async call`: the call begins, its value is a future; `keyword` is `async`."""

    keyword: Span
    call: Expr


@dataclass(slots=True, eq=False)
class Index(Expr):
    """`array[index]`."""

    array: Expr
    index: Expr


@dataclass(slots=True, eq=False)
class New(Expr):
    """`new Type(arguments)`."""

    type: TypeName
    arguments: list[Expr]


@dataclass(slots=True, eq=False)
class NewArray(Expr):
    """`new T[n][m][]`: `type` is the whole array type."""

    type: TypeName
    lengths: list[Expr]


@dataclass(slots=True, eq=False)
class Elements(Expr):
    """`new T[] {a, b}` with the whole array type, or `{a, b}` (None) where the type is known."""

    type: TypeName | None
    elements: list[Expr]


# --- statements ---------------------------------------------------------------------------------------


@dataclass(slots=True, eq=False)
class Stmt:
    """A statement."""

    span: Span


@dataclass(slots=True, eq=False)
class BadStmt(Stmt):
    """A statement with a syntax error: it may have declared anything."""


@dataclass(slots=True, eq=False)
class Empty(Stmt):
    """`;`."""


@dataclass(slots=True, eq=False)
class BlockStmt(Stmt):
    """`{ ... }`."""

    body: list[Stmt]


@dataclass(slots=True, eq=False)
class Declare(Stmt):
    """`T name;` or `T name = value;`; `place` is the name."""

    type: TypeName
    name: str
    place: Span
    value: Expr | None


@dataclass(slots=True, eq=False)
class Evaluate(Stmt):
    """An expression as a statement."""

    value: Expr


@dataclass(slots=True, eq=False)
class If(Stmt):
    """`if (condition) then else otherwise`."""

    condition: Expr
    then: Stmt
    otherwise: Stmt | None


@dataclass(slots=True, eq=False)
class While(Stmt):
    """`while (condition) body`."""

    condition: Expr
    body: Stmt


@dataclass(slots=True, eq=False)
class For(Stmt):
    """`for (start; condition; step) body`; each of the three may be left out."""

    start: Stmt | None
    condition: Expr | None
    step: Stmt | None
    body: Stmt


@dataclass(slots=True, eq=False)
class Each(Stmt):
    """`for (T name : array) body`; `place` is the name."""

    type: TypeName
    name: str
    place: Span
    array: Expr
    body: Stmt


@dataclass(slots=True, eq=False)
class Break(Stmt):
    """`break;`."""


@dataclass(slots=True, eq=False)
class Continue(Stmt):
    """`continue;`."""


@dataclass(slots=True, eq=False)
class Return(Stmt):
    """`return;` or `return value;`."""

    value: Expr | None


@dataclass(slots=True, eq=False)
class Throw(Stmt):
    """`throw value;`."""

    value: Expr


@dataclass(slots=True, eq=False)
class Catch:
    """`catch (T name) body`; `place` is the name."""

    type: TypeName
    name: str
    place: Span
    body: Stmt


@dataclass(slots=True, eq=False)
class Try(Stmt):
    """`try body catch ... finally last`."""

    body: Stmt
    catches: list[Catch]
    last: Stmt | None


@dataclass(slots=True, eq=False)
class Together(Stmt):
    """`together body`; `span` is the keyword."""

    body: Stmt


@dataclass(slots=True, eq=False)
class Within(Stmt):
    """`within (seconds) body`; `span` is the keyword."""

    seconds: Expr
    body: Stmt


@dataclass(slots=True, eq=False)
class Reserve(Stmt):
    """`reserve (target) body`; `span` is the keyword."""

    target: Expr
    body: Stmt


@dataclass(slots=True, eq=False)
class WaitUntil(Stmt):
    """`wait until (condition) within (seconds);`, without `within`: None; `span` is the keyword."""

    condition: Expr
    seconds: Expr | None


# --- declarations -------------------------------------------------------------------------------------


@dataclass(slots=True, eq=False)
class ParameterDecl:
    """`T name`."""

    type: TypeName
    name: str
    span: Span


@dataclass(slots=True, eq=False)
class Field:
    """A field with its initialiser, if it has one; `span` is its name."""

    type: TypeName
    name: str
    public: bool
    value: Expr | None
    span: Span


@dataclass(slots=True, eq=False)
class LoopHead:
    """The clauses of a loop. `rate` is in hertz, or with `every` a period in seconds.

    `place` is the number behind `priority`.
    """

    rate: Expr
    every: bool
    priority: int | None = None
    place: Span | None = None
    condition: Expr | None = None


@dataclass(slots=True, eq=False)
class Method:
    """A method, constructor, init, portal or loop. `result` is None where none is written; `span` is its
    name."""

    kind: MethodKind
    name: str
    parameters: list[ParameterDecl]
    result: TypeName | None
    public: bool
    synchronized: bool
    span: Span
    body: list[Stmt] = field(default_factory=list)
    end: Span = field(init=False)
    broken: bool = False
    loop: LoopHead | None = None

    def __post_init__(self) -> None:
        self.end = self.span


@dataclass(slots=True, eq=False)
class Unit:
    """A class, resource or coordinator; `broken` when members may be missing; `span` is its name."""

    kind: UnitKind
    usage: Usage
    name: str
    span: Span
    fields: list[Field] = field(default_factory=list)
    methods: list[Method] = field(default_factory=list)
    broken: bool = False


@dataclass(slots=True, eq=False)
class Constant:
    """`const T NAME = value;` at the top level; `span` is the name."""

    type: TypeName
    name: str
    value: Expr
    span: Span


@dataclass(slots=True, eq=False)
class EnumMember:
    """A member of an enum; `span` is its name."""

    name: str
    span: Span


@dataclass(slots=True, eq=False)
class Enumeration:
    """`enum NAME { A, B }`; `span` is the name."""

    name: str
    members: list[EnumMember]
    span: Span


@dataclass(slots=True, eq=False)
class Include:
    """`include "path";` or, with `library`, `include <path>;`."""

    path: str
    library: bool
    span: Span


@dataclass(slots=True, eq=False)
class ParsedFile:
    """One parsed file; `broken` when declarations may be missing.

    `functions` are those of the top level. `types` are the names of types it mentions, `called` the names it
    calls without an object.
    """

    source: Source
    includes: list[Include] = field(default_factory=list)
    units: list[Unit] = field(default_factory=list)
    constants: list[Constant] = field(default_factory=list)
    enums: list[Enumeration] = field(default_factory=list)
    functions: list[Method] = field(default_factory=list)
    broken: bool = False
    types: set[str] = field(default_factory=set)
    called: set[str] = field(default_factory=set)
