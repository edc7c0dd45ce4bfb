"""The raw syntax tree, before names are resolved.

The parser builds this tree, the checker converts it to the nodes of tree.py. An invalid piece of text is a
`Bad` node, which the checker does not report again.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from msgspec import Struct

from lfield.lang.tree import MethodKind, UnitKind, Usage
from lfield.text.source_text import Source, Span

#: The name of a type that could not be read; not a valid name of L.
BAD_TYPE = "?"


class TypeName(Struct, eq=False):
    """`Server`, `int[]`, `map<string, int>`: a name, the types in `<>`, and the number of `[]`."""

    span: Span
    name: str
    dimensions: int = 0
    arguments: tuple[TypeName, ...] = ()

    def __str__(self) -> str:
        arguments = f"<{', '.join(map(str, self.arguments))}>" if self.arguments else ""
        return self.name + arguments + "[]" * self.dimensions


# --- expressions --------------------------------------------------------------------------------------


class Expr(Struct, eq=False):
    """An expression; `height` is its nesting, which the parser limits. Links of a chain do not nest."""

    span: Span
    height: int


class Bad(Expr, eq=False):
    """An expression with a syntax error that is reported already."""


class Literal_(Expr, eq=False):
    """A number, text, true, false or null (None)."""

    value: bool | int | float | str | None


class Name(Expr, eq=False):
    """A bare name."""

    name: str


class This(Expr, eq=False):
    """`this`."""


class Unary(Expr, eq=False):
    """`!x` or `-x`."""

    operator: str
    operand: Expr


class Binary(Expr, eq=False):
    """Any operator with two sides; `sign` is the operator."""

    operator: str
    sign: Span
    left: Expr
    right: Expr


class Assign(Expr, eq=False):
    """`target = value` or `target += value`; `sign` is the operator."""

    operator: str
    sign: Span
    target: Expr
    value: Expr


class Member(Expr, eq=False):
    """`object.name`; `place` is the name."""

    object: Expr
    name: str
    place: Span


class Call(Expr, eq=False):
    """`function(arguments)`, where the function is a Name or a Member."""

    function: Name | Member
    arguments: list[Expr]


class Async(Expr, eq=False):
    """`async call`: the call begins, its value is a future; `keyword` is `async`."""

    keyword: Span
    call: Expr


class Index(Expr, eq=False):
    """`array[index]`."""

    array: Expr
    index: Expr


class New(Expr, eq=False):
    """`new Type(arguments)`."""

    type: TypeName
    arguments: list[Expr]


class NewArray(Expr, eq=False):
    """`new T[n][m][]`: `type` is the whole array type."""

    type: TypeName
    lengths: list[Expr]


class Elements(Expr, eq=False):
    """`new T[] {a, b}` with the whole array type, or `{a, b}` (None) where the type is known."""

    type: TypeName | None
    elements: list[Expr]


# --- statements ---------------------------------------------------------------------------------------


class Stmt(Struct, eq=False):
    """A statement."""

    span: Span


class BadStmt(Stmt, eq=False):
    """A statement with a syntax error: it may have declared anything."""


class Empty(Stmt, eq=False):
    """`;`."""


class BlockStmt(Stmt, eq=False):
    """`{ ... }`."""

    body: list[Stmt]


class Declare(Stmt, eq=False):
    """`T name;` or `T name = value;`; `place` is the name."""

    type: TypeName
    name: str
    place: Span
    value: Expr | None


class Evaluate(Stmt, eq=False):
    """An expression as a statement."""

    value: Expr


class If(Stmt, eq=False):
    """`if (condition) then else otherwise`."""

    condition: Expr
    then: Stmt
    otherwise: Stmt | None


class While(Stmt, eq=False):
    """`while (condition) body`."""

    condition: Expr
    body: Stmt


class For(Stmt, eq=False):
    """`for (start; condition; step) body`; each of the three may be left out."""

    start: Stmt | None
    condition: Expr | None
    step: Stmt | None
    body: Stmt


class Each(Stmt, eq=False):
    """`for (T name : array) body`; `place` is the name."""

    type: TypeName
    name: str
    place: Span
    array: Expr
    body: Stmt


class Break(Stmt, eq=False):
    """`break;`."""


class Continue(Stmt, eq=False):
    """`continue;`."""


class Return(Stmt, eq=False):
    """`return;` or `return value;`."""

    value: Expr | None


class Throw(Stmt, eq=False):
    """`throw value;`."""

    value: Expr


class Catch(Struct, eq=False):
    """`catch (T name) body`; `place` is the name."""

    type: TypeName
    name: str
    place: Span
    body: Stmt


class Try(Stmt, eq=False):
    """`try body catch ... finally last`."""

    body: Stmt
    catches: list[Catch]
    last: Stmt | None


class Together(Stmt, eq=False):
    """`together body`; `span` is the keyword."""

    body: Stmt


class Within(Stmt, eq=False):
    """`within (seconds) body`; `span` is the keyword."""

    seconds: Expr
    body: Stmt


class Reserve(Stmt, eq=False):
    """`reserve (target) body`; `span` is the keyword."""

    target: Expr
    body: Stmt


class WaitUntil(Stmt, eq=False):
    """`wait until (condition) within (seconds);`, without `within`: None; `span` is the keyword."""

    condition: Expr
    seconds: Expr | None


# --- declarations -------------------------------------------------------------------------------------


class ParameterDecl(Struct, eq=False):
    """`T name`."""

    type: TypeName
    name: str
    span: Span


class Field(Struct, eq=False):
    """A field with its initialiser, if it has one; `span` is its name."""

    type: TypeName
    name: str
    public: bool
    value: Expr | None
    span: Span


class LoopHead(Struct, eq=False):
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


class Unit(Struct, eq=False):
    """A class, resource or coordinator; `broken` when members may be missing; `span` is its name."""

    kind: UnitKind
    usage: Usage
    name: str
    span: Span
    fields: list[Field] = []
    methods: list[Method] = []
    broken: bool = False


class Constant(Struct, eq=False):
    """`const T NAME = value;` at the top level; `span` is the name."""

    type: TypeName
    name: str
    value: Expr
    span: Span


class EnumMember(Struct, eq=False):
    """A member of an enum; `span` is its name."""

    name: str
    span: Span


class Enumeration(Struct, eq=False):
    """`enum NAME { A, B }`; `span` is the name."""

    name: str
    members: list[EnumMember]
    span: Span


class Include(Struct, eq=False):
    """`include "path";` or, with `library`, `include <path>;`."""

    path: str
    library: bool
    span: Span


class ParsedFile(Struct, eq=False):
    """One parsed file; `broken` when declarations may be missing.

    `functions` are those of the top level. `types` are the names of types it mentions, `called` the names it
    calls without an object.
    """

    source: Source
    includes: list[Include] = []
    units: list[Unit] = []
    constants: list[Constant] = []
    enums: list[Enumeration] = []
    functions: list[Method] = []
    broken: bool = False
    types: set[str] = set()
    called: set[str] = set()
