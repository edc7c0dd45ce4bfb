"""The whole check: declarations first, then every body."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from lfield.lang import syntax, tree
from lfield.lang.capability_port import CapabilityTypes
from lfield.lang.checker.control_flow import check_flow
from lfield.lang.checker.declaration_pass import DeclaredUnit, declare_units
from lfield.lang.checker.expressions import assigned
from lfield.lang.checker.library.sequencing_calls import make_stoppable
from lfield.lang.checker.scope import BodyContext, Scope
from lfield.lang.checker.statements import statements
from lfield.lang.checker.symbols import Symbols
from lfield.lang.checker.together import mark_started_calls
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
    symbols = Symbols(devices, found, incomplete=incomplete, capabilities=capabilities, generated=generated)
    units = declare_units(symbols, [unit for file in files for unit in file.units])
    for declared in units:
        check_bodies(symbols, declared)
    check_library(symbols)
    make_stoppable([declared.unit for declared in units])
    sources = [*(file.source for file in files), *symbols.library.sources.values()]
    all_units = [*(declared.unit for declared in units), *symbols.library.units]
    return CheckedProgram(all_units, sources, frozenset(symbols.growing))


def check_library(symbols: Symbols) -> None:
    """Check and fill the bodies of what the program uses of the library in L."""
    for body in symbols.library.unchecked():
        with symbols.library.bound(body.parameters):
            _check_body(symbols, body.method, body.written, [])


def check_bodies(symbols: Symbols, declared: DeclaredUnit) -> None:
    """Check and fill the bodies of a unit; mistakes go to the findings of `symbols`."""
    for method, written in declared.bodies:
        first = method.kind in ("init", "constructor")
        _check_body(symbols, method, written, declared.initialisers if first else [])


def _check_body(
    symbols: Symbols,
    method: tree.Method,
    written: syntax.Method | None,
    initialisers: list[tuple[tree.Field, syntax.Expr]],
) -> None:
    """Fill the body of a method: the field initialisers (for init and constructors), then what is written."""
    before = len(symbols.found.found)
    body = BodyContext(symbols, method.unit, method, Scope())
    method.body.extend(_initialise(body, field, raw) for field, raw in initialisers)
    if written is None:
        return
    body.enter_method({p.name: p for p in method.parameters})
    method.body.extend(statements(body, written.body))
    is_whole = len(symbols.found.found) == before and not (written.broken or symbols.incomplete)
    mark_started_calls(symbols, method.body, whole=is_whole)
    if len(symbols.found.found) == before and not written.broken:
        check_flow(symbols, method)


def _initialise(body: BodyContext, field: tree.Field, raw: syntax.Expr) -> tree.Stmt:
    """`field = value;`: the values of fields are set before anything else happens."""
    given = assigned(body, raw, field.type)
    target = tree.FieldGet(field.span, field.type, body.this(field.span), field)
    return tree.Evaluate(raw.span, tree.Assign(raw.span, field.type, target, given))
