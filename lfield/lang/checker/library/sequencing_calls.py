"""Calls that start, stop and await other coordinators (decision 105): methods in L around instructions.

The instructions are methods of text that only the library can call.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import cache
from pathlib import Path

from lfield.lang import messages, syntax, tree
from lfield.lang.checker.scope import BodyContext
from lfield.lang.deployment import Deployment
from lfield.lang.parser import parse_file
from lfield.lang.standard_library import instances
from lfield.lang.standard_library.instances import LibraryBody
from lfield.lang.tree_traversal import all_statements, descendants, statement_expressions
from lfield.lang.types import BOOLEAN, INT, REAL, STRING, VOID, Type
from lfield.text.source_text import Diagnostic, Diagnostics, Span
from lfield.text.suggestions import did_you_mean, listed

#: The functions, with their results.
SEQUENCING: dict[str, Type] = {"start": VOID, "stop": VOID, "awaitEnd": STRING, "running": BOOLEAN}
#: The methods of text in the library, with their instructions and results.
_HEADS: dict[str, tuple[str, Type]] = {
    "begin": ("seq_start", VOID),
    "halt": ("seq_stop", VOID),
    "end": ("seq_end", STRING),
    "alive": ("seq_alive", BOOLEAN),
}
#: A binding without types: any binding marks that a method of the library is checked.
_BOUND = {"": VOID}
_TEXT = Path(instances.__file__).with_name("sequencing.L")
#: Seconds, longer than any mission: the limit around an `init`, which a stop ends.
_NEVER = 1e9


@cache
def _text() -> str:
    return _TEXT.read_text(encoding="utf-8")


def sequencing_call(
    body: BodyContext, raw: syntax.Call, name: str, arguments: Sequence[tree.Expr]
) -> tree.Expr:
    """The call of the instance of a method; one for each unit."""
    instance = body.symbols.library.method((body.unit, name, "sequencing"), lambda: _instance(body, name))
    return tree.Call(raw.span, SEQUENCING[name], body.this(raw.span), instance, list(arguments))


def head_call(
    body: BodyContext, raw: syntax.Call, name: str, owner: tree.Expr, arguments: Sequence[tree.Expr]
) -> tree.Expr | None:
    """The instruction behind a method of text that only the library has; None elsewhere."""
    if name not in _HEADS or owner.type != STRING or body.symbols.library.parameters != _BOUND:
        return None
    operation, result = _HEADS[name]
    return tree.LibraryCall(raw.span, result, operation, [owner, *arguments])


def _instance(body: BodyContext, name: str) -> LibraryBody:
    source = body.symbols.library.source(_text())
    written = next(
        portal for portal in parse_file(source, Diagnostics()).units[0].methods if portal.name == name
    )
    kinds = {"string": STRING, "real": REAL, "int": INT}
    method = tree.Method(
        name,
        "method",
        body.unit,
        [tree.Local(p.name, kinds[str(p.type)], p.span) for p in written.parameters],
        SEQUENCING[name],
        public=False,
        synchronized=False,
        span=written.span,
        end=written.end,
    )
    body.unit.add_library_method(method)
    return LibraryBody(method, written, _BOUND)


def make_stoppable(units: Sequence[tree.Unit]) -> None:
    """Put a limit around the `init` of each coordinator, if the program stops any.

    A stop ends that limit, so a coordinator ends as in a `within`: no catch prevents it, each finally runs.
    """
    library = (method for unit in units for method in unit.library_methods)
    if not any(method.name == "stop" and method.result == VOID for method in library):
        return
    for unit in units:
        for method in unit.methods:
            if unit.kind == "coordinator" and method.kind == "init":
                limit = tree.Literal_(method.span, REAL, _NEVER)
                method.body[:] = [tree.Within(method.span, limit, list(method.body))]


def sequencing_findings(units: Sequence[tree.Unit], deployment: Deployment) -> Iterator[Diagnostic]:
    """An error for each constant id that is not that of a startable coordinator."""
    startable = [agent.id for agent in deployment.agents if agent.startable]
    types = {unit.name for unit in units if unit.kind == "coordinator"}
    coordinators = [agent.id for agent in deployment.agents if agent.type in types]
    for name, span, id in sorted(_constant_ids(units), key=lambda found: found[1].start):
        if id in startable:
            continue
        if id in coordinators:
            yield messages.NOT_STARTABLE.at(span, id=id)
            continue
        hint = did_you_mean(id, startable)
        known = f"{name} takes the id of a startable coordinator: {listed(startable)}" if startable else None
        yield messages.UNKNOWN_STARTABLE.at(span, hint=hint or known, id=id, function=name)


def _constant_ids(units: Sequence[tree.Unit]) -> Iterator[tuple[str, Span, str]]:
    """The function, the place and the id of each call with a constant id."""
    for unit in units:
        library = set(unit.library_methods)
        for method in unit.methods:
            for statement in all_statements(method.body):
                for expr in statement_expressions(statement):
                    for node in descendants(expr):
                        if not (isinstance(node, tree.Call) and node.method in library):
                            continue
                        name, first = node.method.name, next(iter(node.arguments), None)
                        if name in SEQUENCING and isinstance(first, tree.Literal_):
                            yield name, first.span, str(first.value)
