"""The whole check: declarations first, then every body."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from lfield.lang import syntax
from lfield.lang.capabilities import Capabilities
from lfield.lang.checker.declarations import Declared, declare
from lfield.lang.checker.statements import check_body
from lfield.lang.checker.symbols import Symbols
from lfield.lang.tree import CheckedProgram
from lfield.manifest import DeviceManifest
from lfield.text.source import Diagnostics


def check(
    files: Sequence[syntax.File],
    devices: Mapping[str, DeviceManifest],
    found: Diagnostics,
    *,
    complete: bool,
    capabilities: Capabilities | None = None,
    generated: frozenset[str] = frozenset(),
) -> CheckedProgram:
    """The checked program of some parsed files; it is meant for the compiler only when nothing was found.

    `complete` is False when a file is missing. Its `devices` are those the program names, so that installing
    another driver does not change the program. `generated` are the classes made from `capabilities`.
    """
    incomplete = not complete or any(file.broken for file in files)
    symbols = Symbols(devices, found, incomplete=incomplete, capabilities=capabilities, generated=generated)
    units = declare(symbols, [unit for file in files for unit in file.units])
    for declared in units:
        _bodies(symbols, declared)
    sources = [file.source for file in files]
    return CheckedProgram([declared.unit for declared in units], sources, symbols.used_devices)


def _bodies(symbols: Symbols, declared: Declared) -> None:
    for method, written in declared.bodies:
        first = method.kind in ("init", "constructor")
        check_body(symbols, method, written, declared.initialisers if first else [])
