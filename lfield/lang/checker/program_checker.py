"""The whole check: declarations first, then every body."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from msgspec.structs import replace

from lfield.lang import syntax, tree
from lfield.lang.capability_port import CapabilityTypes
from lfield.lang.checker.control_flow import check_flow
from lfield.lang.checker.declaration_pass import DeclaredUnit
from lfield.lang.checker.expressions import assigned
from lfield.lang.checker.library.future_calls import check_futures
from lfield.lang.checker.library.sequencing_calls import make_stoppable
from lfield.lang.checker.loops.loop_thread import check_loop
from lfield.lang.checker.scope import BodyContext, Scope
from lfield.lang.checker.statements import statements
from lfield.lang.checker.symbols import Function, Symbols
from lfield.lang.checker.together import mark_started_calls
from lfield.lang.checker.top_level.declared_program import declare_program
from lfield.lang.checker.top_level.purity import check_purity
from lfield.lang.tree import CheckedProgram
from lfield.manifest import DeviceManifest
from lfield.text.source_text import Diagnostics


def check_program(
    files: Sequence[syntax.ParsedFile],
    devices: Mapping[str, DeviceManifest],
    found: Diagnostics,
    *,
    complete: bool,
    capabilities: CapabilityTypes | None = None,
    generated: frozenset[str] = frozenset(),
) -> CheckedProgram:
    """The checked program of some parsed files; the compiler may use it only if there are no findings.

    `complete` is False when a file is missing. `generated` are the classes made from `capabilities`.
    """
    incomplete = not complete or any(file.broken for file in files)
    symbols = Symbols(
        devices,
        found,
        incomplete=incomplete,
        missing=not complete,
        capabilities=capabilities,
        generated=generated,
    )
    declared_program = declare_program(symbols, files)
    units = declared_program.units
    for declared in units:
        check_bodies(symbols, declared)
    for function in declared_program.functions:
        check_function(symbols, function)
    check_library(symbols)
    make_stoppable([declared.unit for declared in units])
    sources = [*(file.source for file in files), *symbols.library.sources.values()]
    all_units = [*(declared.unit for declared in units), *symbols.library.units]
    return CheckedProgram(all_units, sources, frozenset(symbols.growing), tuple(symbols.enums.values()))


def check_library(symbols: Symbols) -> None:
    """Check and fill the bodies of the methods of the library in L that the program uses."""
    # A function is reported where it is declared, not where it is used.
    silent = replace(symbols, found=Diagnostics(), _reported=set())
    for body in symbols.library.unchecked():
        with symbols.library.bound(body.parameters):
            reported = silent if body.function else symbols
            _check_body(reported, body.method, body.written, [], function=body.function)


def check_function(symbols: Symbols, function: Function) -> None:
    """Check a function of the top level; mistakes go to the findings of `symbols`."""
    before = len(symbols.found.found)
    _check_body(symbols, function.head, function.written, [], function=True)
    if len(symbols.found.found) == before:
        check_purity(symbols, function)


def check_bodies(symbols: Symbols, declared: DeclaredUnit) -> None:
    """Check and fill the bodies of a unit; mistakes go to the findings of `symbols`."""
    for method, written in declared.bodies:
        if written is not None and written.loop is not None:
            check_loop(symbols, method, written.loop)
        first = method.kind in ("init", "constructor")
        _check_body(symbols, method, written, declared.initialisers if first else [])


def _check_body(
    symbols: Symbols,
    method: tree.Method,
    written: syntax.Method | None,
    initialisers: list[tuple[tree.Field, syntax.Expr]],
    *,
    function: bool = False,
) -> None:
    """Fill the body of a method: the field initialisers (for init and constructors), then the written
    body.
    """
    before = len(symbols.found.found)
    body = BodyContext(symbols, method.unit, method, Scope(), function=function)
    method.body.extend(_initialise(body, field, raw) for field, raw in initialisers)
    if written is None:
        return
    body.enter_method({p.name: p for p in method.parameters})
    method.body.extend(statements(body, written.body))
    is_whole = len(symbols.found.found) == before and not (written.broken or symbols.incomplete)
    mark_started_calls(symbols, method.body, whole=is_whole)
    if symbols.has_futures and not symbols.library.parameters:
        check_futures(symbols, method.body)
    if len(symbols.found.found) == before and not written.broken:
        check_flow(symbols, method)


def _initialise(body: BodyContext, field: tree.Field, raw: syntax.Expr) -> tree.Stmt:
    """`field = value;`: the values of fields are set before any other statement."""
    value = assigned(body, raw, field.type)
    target = tree.FieldGet(field.span, field.type, body.this(field.span), field)
    return tree.Evaluate(raw.span, tree.Assign(raw.span, field.type, target, value))
