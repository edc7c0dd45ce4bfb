"""Local names, and the context in which a body is checked."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager

from msgspec import Struct, field

from lfield.lang import messages, syntax
from lfield.lang.checker.symbols import Symbols
from lfield.lang.tree import Expr, Field, Local, Method, This, Unit
from lfield.lang.types import UNKNOWN, ClassType, Type
from lfield.text.message_tables import FindingKind
from lfield.text.source_text import Span


class Scope(Struct):
    """The locals of one block and of the enclosing ones.

    `uncertain` after a statement with a syntax error: it may have declared any name, so unknown names are no
    longer reported.
    """

    outer: Scope | None = None
    locals: dict[str, Local] = field(default_factory=dict)
    uncertain: bool = False

    def chain(self) -> Iterator[Scope]:
        """The scope and those around it, from the inside."""
        scope: Scope | None = self
        while scope is not None:
            yield scope
            scope = scope.outer

    def mark_uncertain(self) -> None:
        """Record that a statement of this block could not be read."""
        self.uncertain = True

    def find(self, name: str) -> Local | None:
        """The local of that name, the innermost first."""
        return next((scope.locals[name] for scope in self.chain() if name in scope.locals), None)

    def names(self) -> list[str]:
        """All names that can be used here."""
        return [name for scope in self.chain() for name in scope.locals]

    def is_uncertain(self) -> bool:
        """Whether this block or one around it holds a statement that could not be read."""
        return any(scope.uncertain for scope in self.chain())


class BodyContext(Struct):
    """The context of an expression or statement: program, unit, method, locals, loops."""

    symbols: Symbols
    unit: Unit
    method: Method
    scope: Scope
    loops: int = 0
    #: Whether the body is that of a function of the top level, which sees no member of the unit.
    function: bool = False
    #: The number of loops that enclose the innermost `finally`; None without a `finally`.
    last: int | None = None
    #: Expressions that are checked already, before those which begin with them (tree_traversal.py).
    checked: dict[syntax.Expr, Expr] = field(default_factory=dict)

    def report(self, message: FindingKind, span: Span, *, hint: str | None = None, **values: object) -> None:
        """Add a finding."""
        self.symbols.report(message, span, hint=hint, **values)

    def this(self, span: Span) -> This:
        """The type of `this`. That of a resource or coordinator is not a value."""
        name = self.unit.name
        return This(span, ClassType(name) if self.unit.kind == "class" else Type(name))

    def field(self, name: str) -> Field | None:
        """The unit's own field of that name."""
        return None if self.function else self.unit.field(name)

    def methods(self, name: str) -> Sequence[Method]:
        """The unit's own methods of that name, without portals, constructors and init."""
        return () if self.function else self.unit.overloads(name, "method")

    def is_broken(self) -> bool:
        """Whether the unit lacks members that could not be read."""
        return self.unit.name in self.symbols.broken_units

    def declare(self, name: str, kind: Type, span: Span) -> Local:
        """Declare a local in the innermost scope; a name that a local already has is reported."""
        local = Local(name, kind, span)
        earlier = self.scope.find(name)
        if earlier is not None and kind is not UNKNOWN:
            self.report(messages.DUPLICATE_LOCAL, span, name=name, line=earlier.span.line)
        self.scope.locals[name] = local
        return local

    def enter_method(self, parameters: dict[str, Local]) -> None:
        """Begin the written body of a method, behind the field initialisers."""
        self.scope = Scope(None, parameters)

    @contextmanager
    def loop(self) -> Iterator[None]:
        """Enter the body of a loop for the time of the context."""
        self.loops += 1
        yield
        self.loops -= 1

    @contextmanager
    def finally_clause(self) -> Iterator[None]:
        """Enter the code of a `finally` for the time of the context."""
        around, self.last = self.last, self.loops
        yield
        self.last = around

    def enter(self) -> None:
        """Open a block."""
        self.scope = Scope(self.scope)

    def leave(self) -> None:
        """Close the innermost block."""
        assert self.scope.outer is not None
        self.scope = self.scope.outer


def function_unit(name: str, span: Span) -> Unit:
    """A unit without members for the function of that name."""
    return Unit(name, "class", "global", span, function=True)


def constant_context(symbols: Symbols, name: str, span: Span) -> BodyContext:
    """The context for the value of a constant: only other declarations of the top level are known."""
    unit = function_unit(name, span)
    method = Method(name, "method", unit, [], UNKNOWN, False, False, span, span)
    return BodyContext(symbols, unit, method, Scope(), function=True)
