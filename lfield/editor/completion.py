"""Completions for a position in a program."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

from msgspec import Struct

from lfield.editor.cursor import Cursor, cursor_at
from lfield.editor.program_model import ProgramModel
from lfield.editor.symbol_text import hover_text, signature
from lfield.editor.symbols_in_text import TextSymbol, TextSymbols
from lfield.lang import tree
from lfield.lang.capability_port import VERBS
from lfield.lang.checker.symbols import BUILTIN_TYPES
from lfield.lang.language_library import FUNCTIONS
from lfield.lang.parser.loop_members import LOOP_WORDS

_STATEMENTS = (
    *("if", "else", "while", "for", "break", "continue", "return", "try", "catch", "finally", "throw"),
    *("new", "this", "true", "false", "null", "together", "within", "reserve"),
    *("async", "wait until"),
)
_MEMBERS = ("portal", "public", "private", "init", "synchronized", "emit", *LOOP_WORDS)
_UNITS = ("resource", "coordinator", "class", "include", "const", "enum")
#: The text of the line before the position, in an include of a driver's file.
_INCLUDE = re.compile(r"\binclude\s*<[\w./-]*$")
_NAME_END = re.compile(r"\w*$")
_NEW = re.compile(r"\bnew$")


class CompletionProposal(Struct, frozen=True):
    """A text that can be inserted; `kind` is that of the symbol, or `keyword` or `file`."""

    text: str
    kind: str
    detail: str = ""
    documentation: str = ""


def completions(model: ProgramModel, path: Path, offset: int) -> list[CompletionProposal]:
    """The proposals at an offset of a file, without those that the part of a name there excludes."""
    file = model.files.get(path)
    if file is None:
        return []
    before = file.text[:offset]
    line = before.rpartition("\n")[2]
    if _INCLUDE.search(line):
        return [CompletionProposal(path_text, "file") for path_text in model.environment.include_paths]
    if "//" in line.replace('"//', ""):
        return []
    found = _NAME_END.search(line)
    typed = found.group() if found else ""
    cursor = cursor_at(model, path, offset - len(typed))
    if cursor is None:
        return []
    if not typed:
        # The token before the position.
        cursor = _before(cursor, offset)
    symbols = TextSymbols(model)
    proposals = {
        proposal.text: proposal
        for proposal in _proposals(symbols, cursor, before[: len(before) - len(typed)])
    }
    return list(proposals.values())


def _before(cursor: Cursor, offset: int) -> Cursor:
    """The cursor moved after the last token that ends at the offset."""
    place = cursor.part.source.place.offset
    index = cursor.index
    while index < len(cursor.tokens) - 1 and cursor.tokens[index].span.start + place < offset:
        index += 1
    return cursor.moved(index)


def _proposals(symbols: TextSymbols, cursor: Cursor, before: str) -> Iterator[CompletionProposal]:
    text = before.rstrip()
    if text.endswith("."):
        if cursor.text(-1) != ".":
            return
        yield from map(_proposal, symbols.members(cursor))
    elif _NEW.search(text[-4:]):
        yield from _types(symbols, classes_only=True)
    elif cursor.unit is None and cursor.method is None:
        yield from (CompletionProposal(keyword, "keyword") for keyword in _UNITS)
    elif cursor.method is None:
        yield from (CompletionProposal(keyword, "keyword") for keyword in (*_MEMBERS, *_UNITS))
        yield from _types(symbols)
    else:
        yield from _in_method(symbols, cursor)
        yield from _types(symbols)
        yield from (CompletionProposal(keyword, "keyword") for keyword in (*_STATEMENTS, *_MEMBERS))


def _in_method(symbols: TextSymbols, cursor: Cursor) -> Iterator[CompletionProposal]:
    """Variables, own members, queries, library functions."""
    for local in cursor.locals().values():
        variable = symbols.local(local)
        yield CompletionProposal(variable.name, "local", f"{variable.type} {variable.name}")
    yield from map(_proposal, symbols.top_level.all())
    unit = symbols.unit(cursor)
    if unit is None:
        yield from _functions_of_library("global")
        return
    yield from (_proposal(symbols.of_field(unit, field)) for field in unit.named_fields)
    yield from (
        _proposal(symbols.of_method(method)) for method in unit.methods if method.kind in ("method", "loop")
    )
    if unit.usage == "coordinator":
        yield from _queries(symbols)
    yield from _functions_of_library(unit.usage)


def _functions_of_library(usage: str) -> Iterator[CompletionProposal]:
    """The library functions that code of a usage may call."""
    for function in FUNCTIONS:
        if function.scope in ("any", usage):
            types = ", ".join(map(str, function.parameters))
            detail = f"{function.result} {function.name}({types})"
            yield CompletionProposal(function.name, "library", detail, function.meaning)


def _queries(symbols: TextSymbols) -> Iterator[CompletionProposal]:
    program = symbols.program
    for name in program.resource_names():
        yield CompletionProposal(f"find{name}", "method", f"{name} find{name}(string id)")
    for name in program.capability_names():
        yield from (CompletionProposal(f"{verb}{name}", "method", f"capability {name}") for verb in VERBS)


def _types(symbols: TextSymbols, *, classes_only: bool = False) -> Iterator[CompletionProposal]:
    program = symbols.program
    for unit in program.units.values():
        is_map = unit in program.library.units
        if not is_map and (unit.kind == "class" or not classes_only):
            yield _proposal(symbols.of_unit(unit))
    yield from (CompletionProposal(name, "builtin") for name in BUILTIN_TYPES)
    if not classes_only:
        top_level = symbols.top_level
        yield from (_proposal(symbol) for symbol in top_level.all() if symbol.kind == "enum")
        yield from (
            CompletionProposal(name, "device", device.meaning) for name, device in program.devices.items()
        )


def _proposal(symbol: TextSymbol) -> CompletionProposal:
    is_declared = isinstance(symbol.meaning, tree.Unit) and symbol.meaning.kind != "class"
    text = hover_text(symbol)
    return CompletionProposal(
        symbol.name, "resource" if is_declared else symbol.kind, signature(symbol), text
    )
