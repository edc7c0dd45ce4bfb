"""Instances of methods of the library that are texts of L: a private method of the unit that has the call."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from lfield.lang import syntax, tree
from lfield.lang.checker.scope import BodyContext
from lfield.lang.parser import parse_file
from lfield.lang.standard_library.instances import LibraryBody
from lfield.lang.types import BOOLEAN, INT, STRING, VOID, Type, array_of
from lfield.text.source_text import Diagnostics, Source

_PLAIN = {"int": INT, "boolean": BOOLEAN, "string": STRING, "void": VOID}


def text_call(
    body: BodyContext,
    raw: syntax.Call,
    name: str,
    text: str,
    types: Mapping[str, Type],
    arguments: Sequence[tree.Expr],
    result: Type,
) -> tree.Call:
    """The call of the method of that name in a text, in which names of types mean these `types`."""
    key = (body.unit, body.function, name, text, tuple(types.values()))
    instance = body.symbols.library.method(key, lambda: _instance(body, name, text, types))
    return tree.Call(raw.span, result, body.this(raw.span), instance, list(arguments))


def _instance(body: BodyContext, name: str, text: str, types: Mapping[str, Type]) -> LibraryBody:
    """The method of that name in the unit of the body; its own body is checked later."""
    source = body.symbols.library.source(text)
    written = next(method for method in _parsed(source) if method.name == name)
    kinds = {**_PLAIN, **types, **{f"{name}[]": array_of(kind) for name, kind in types.items()}}
    method = tree.Method(
        name,
        "method",
        body.unit,
        [tree.Local(p.name, kinds[str(p.type)], p.span) for p in written.parameters],
        kinds[str(written.result or "void")],
        public=False,
        synchronized=False,
        span=written.span,
        end=written.end,
    )
    body.unit.add_library_method(method)
    return LibraryBody(method, written, types, body.function)


def _parsed(source: Source) -> list[syntax.Method]:
    return parse_file(source, Diagnostics()).units[0].methods
