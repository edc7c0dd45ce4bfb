"""All names of the same symbol, and their renaming."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from pathlib import Path

from lfield.editor.cursor import Cursor, cursor_at, cursor_at_token
from lfield.editor.program_model import ProgramModel
from lfield.editor.program_parts import file_offsets
from lfield.editor.symbols_in_text import TextSymbol, TextSymbols
from lfield.editor.text_places import TextPlace
from lfield.errors import UsageError
from lfield.lang import tree
from lfield.lang.capability_port import VERBS, parse_query_name
from lfield.lang.scanner import KEYWORDS, TokenKind

#: A parameter in the text of a query.
_PARAMETER = re.compile(r"\$([A-Za-z_]\w*)", re.ASCII)
_NAME = re.compile(r"[A-Za-z_]\w*", re.ASCII)


def symbol_at(model: ProgramModel, path: Path, offset: int) -> TextSymbol | None:
    """The symbol whose name is at an offset of a file, also after the `$` in a query."""
    cursor = cursor_at(model, path, offset)
    if cursor is None or cursor.token.kind is not TokenKind.STRING:
        return None if cursor is None else TextSymbols(model).at(cursor)
    at = offset - cursor.part.source.place.offset - cursor.token.span.start
    names = (
        match[1] for match in _PARAMETER.finditer(cursor.token.text) if match.start() < at <= match.end()
    )
    name, symbols = next(names, None), TextSymbols(model)
    return symbols.variable(cursor, name) if name is not None and _is_query(symbols, cursor) else None


def references(model: ProgramModel, symbol: TextSymbol) -> Iterator[TextPlace]:
    """The places of the name in all files of the program, the declaration included."""
    symbols = TextSymbols(model)
    texts = {symbol.name, *(f"{verb}{symbol.name}" for verb in VERBS if symbol.kind == "unit")}
    for path, file in model.files.items():
        for part in file.parts:
            if symbol.name not in part.source.text:
                continue
            for index, token in enumerate(part.tokens):
                if token.kind is TokenKind.STRING and f"${symbol.name}" in token.text:
                    yield from _in_query(symbols, path, cursor_at_token(part, index), symbol)
                if token.kind is TokenKind.NAME and token.text in texts:
                    found = symbols.at(cursor_at_token(part, index))
                    if found is not None and found.key == symbol.key:
                        start, end = file_offsets(token.span)
                        yield TextPlace(path, start + len(found.prefix), end)


def _in_query(symbols: TextSymbols, path: Path, cursor: Cursor, symbol: TextSymbol) -> Iterator[TextPlace]:
    """The places of a variable in the text of a query."""
    found = symbols.variable(cursor, symbol.name) if _is_query(symbols, cursor) else None
    if found is None or found.key != symbol.key:
        return
    start = file_offsets(cursor.token.span)[0]
    for match in _PARAMETER.finditer(cursor.token.text):
        if match[1] == symbol.name:
            yield TextPlace(path, start + match.start(1), start + match.end(1))


def _is_query(symbols: TextSymbols, cursor: Cursor) -> bool:
    """Whether a text is an argument of a query."""
    query = parse_query_name(cursor.called())
    return query is not None and symbols.program.capability(query[1]) is not None


def _refuse_query_constants(model: ProgramModel, symbol: TextSymbol) -> None:
    """Refuse to rename a variable whose name is in a constant: it is another variable in each query."""
    parameter = re.compile(rf"\${re.escape(symbol.name)}\b", re.ASCII)
    for part in model.parts():
        for constant in part.file.constants:
            if parameter.search(constant.value.span.text):
                raise UsageError(f"the constant {constant.name} has ${symbol.name} in it: rename it by hand")


def renamed_places(
    model: ProgramModel, symbol: TextSymbol, name: str, other_files: Mapping[Path, str]
) -> list[TextPlace]:
    """The places that a renaming changes. Raises UsageError if it could change the meaning of the program.

    `other_files` are the devices, capability and access files of the mission, which may name the symbol too.
    """
    if symbol.span is None or (isinstance(symbol.meaning, tree.Unit) and symbol.meaning.capability):
        raise UsageError(f"'{symbol.name}' is not declared in this program")
    if symbol.kind == "method" and symbol.name == "init":
        raise UsageError("init has a fixed name")
    if not _NAME.fullmatch(name) or name in KEYWORDS:
        raise UsageError(f"'{name}' is not a name of L")
    _refuse_conflict(model, symbol, name)
    if symbol.kind in ("local", "field", "constant"):
        _refuse_query_constants(model, symbol)
    found = list(references(model, symbol))
    folder = model.root.parent
    for place in found:
        if folder not in place.path.parents:
            raise UsageError(f"'{symbol.name}' is used in {place.path}, outside the folder of this program")
    for path, text in other_files.items() if symbol.kind != "local" else ():
        if re.search(rf"\b{re.escape(symbol.name)}\b", text):
            raise UsageError(f"{path.name} may name '{symbol.name}' too: rename it by hand")
    return found


def _is_written(model: ProgramModel, symbol: TextSymbol, name: str) -> bool:
    """Whether a part that uses a constant, an enum or a function has the name: a member may hide it."""
    if symbol.kind == "unit":
        return False
    using = (
        source_token
        for source_token in model.parts()
        if any(token.text == symbol.name for token in source_token.tokens)
    )
    return any(token.text == name for part in using for token in part.tokens)


def _refuse_conflict(model: ProgramModel, symbol: TextSymbol, name: str) -> None:
    """Refuse a name that has another meaning where the symbol is used."""
    symbols = TextSymbols(model)
    if symbol.kind in ("unit", "enum", "constant", "function"):
        declared = model.symbols.declaration(name) is not None
        is_in_use = declared or symbols.type_named(name) is not None or _is_written(model, symbol, name)
    elif symbol.kind == "member":
        is_in_use = name in model.symbols.enums[symbol.owner].members
    elif symbol.kind == "local":
        part = next(
            part for part in model.parts() if symbol.span is not None and part.source is symbol.span.source
        )
        is_in_use = any(token.kind is TokenKind.NAME and token.text == name for token in part.tokens)
    else:
        unit = model.symbols.units[symbol.owner]
        members = {field.name for field in unit.fields} | {method.name for method in unit.methods}
        is_in_use = name in members or any(
            token.text == name
            for part in model.parts()
            if any(unit.name == symbol.owner for unit in part.file.units)
            for token in part.tokens
        )
    if is_in_use:
        raise UsageError(f"the name '{name}' is in use there")
