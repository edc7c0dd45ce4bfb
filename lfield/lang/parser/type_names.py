"""Type names: `int`, `Server`, `string[]`."""

from __future__ import annotations

from lfield.lang import messages
from lfield.lang.parser.foreign.foreign_syntax import (
    SIZES,
    at_foreign_type,
    pointer,
    qualified,
    sized_name,
    type_arguments_end,
)
from lfield.lang.parser.foreign.foreign_words import FOREIGN_MODIFIERS
from lfield.lang.parser.token_stream import PRIMITIVES, TokenStream
from lfield.lang.syntax import BAD_TYPE, TypeName

#: The most `[]` of a type.
MAX_DIMENSIONS = 8
#: The words of types with arguments; before anything but `<` they are ordinary names.
GENERIC_TYPES = {"map": "a map", "future": "a future"}
#: The signs that may follow a name of a type, in L or in another language.
AFTER_TYPE = ("[", "<", "::", "*", "&", "?")


def at_declaration(s: TokenStream) -> bool:
    """Whether a declaration `T name` begins here, and not an expression."""
    if s.at(*PRIMITIVES, "void"):
        return True
    if at_generic(s, declared=True):
        return True
    next_is_name = s.ahead(1).kind == s.current.kind
    is_array = (s.ahead(1).text, s.ahead(2).text) == ("[", "]")
    is_sized = s.at(*SIZES) and s.ahead(1).text in PRIMITIVES
    return s.at_name() and (next_is_name or is_array or is_sized or at_foreign_type(s))


def element_name(s: TokenStream, use: str = "a type") -> TypeName:
    """The name of a type without its `[]`."""
    if s.at(*PRIMITIVES, "void"):
        token = s.advance()
    else:
        token = s.expect_name(use)
    named = TypeName(token.span, token.text)
    if token.text in GENERIC_TYPES and s.at("<") and type_arguments_end(s, 0):
        _arguments(s, named)
        return named
    qualified(s, named)
    s.types.add(named.name)
    return named


def at_generic(s: TokenStream, *, declared: bool = False) -> bool:
    """Whether `map<K, V>` or `future<T>` begins here; with `declared`, in front of a name or `[]`."""
    end = type_arguments_end(s, 1) if s.at(*GENERIC_TYPES) and s.ahead(1).text == "<" else 0
    if not end or not declared:
        return end > 0
    return s.ahead(end).kind == s.current.kind or (s.ahead(end).text, s.ahead(end + 1).text) == ("[", "]")


def _arguments(s: TokenStream, named: TypeName) -> None:
    """`<K, V>`. The result type of a future may be void."""
    use = GENERIC_TYPES[named.name]
    s.expect("<")
    with s.nested():
        is_result = named.name == "future"
        found = [result_type(s) if is_result else type_name(s, use)]
        while s.accept(","):
            found.append(type_name(s, use))
    s.close_angle()
    named.arguments = tuple(found)
    named.span = named.span.to(s.previous.span)


def type_name(s: TokenStream, use: str) -> TypeName:
    """A type for a variable, a field, ... (`use`, for the message); void is not allowed."""
    found = result_type(s)
    if found.name == "void":
        s.report(messages.VOID_VALUE_TYPE, found.span, what=use)
        found.name = BAD_TYPE
    return found


def result_type(s: TokenStream) -> TypeName:
    """A type or void."""
    found = element_name(s)
    brackets(s, found)
    pointer(s, found)
    if found.name == "void" and found.dimensions:
        s.report(messages.VOID_VALUE_TYPE, found.span, what="an array")
        found.name = BAD_TYPE
    return found


def brackets(s: TokenStream, found: TypeName) -> None:
    """The `[]` after a type name, counted into it."""
    while s.at("[") and s.ahead(1).text == "]":
        s.advance()
        found.dimensions += 1
        found.span = found.span.to(s.advance().span)
    if found.dimensions > MAX_DIMENSIONS:
        raise s.fail(messages.TOO_DEEP, hint="put the inner arrays into a class", limit=MAX_DIMENSIONS)


def parameter_modifier(s: TokenStream) -> None:
    """`const` and the like before the type of a parameter: reported, and skipped."""
    if not (s.at_name() and s.at(*FOREIGN_MODIFIERS)):
        return
    following = s.ahead(1)
    is_type = following.text in PRIMITIVES or (
        following.kind is s.current.kind and s.ahead(2).text not in (",", ")")
    )
    if is_type:
        token = s.advance()
        if s.ahead(1).text not in ("::", "<"):  # Otherwise the type is reported.
            s.report(messages.FOREIGN_KEYWORD, token.span, keyword=token.text, instead="leave it out")


def misplaced_brackets(s: TokenStream, declared: TypeName, name: str) -> None:
    """`int a[]`, a habit from C: reported, and read as `int[] a`."""
    if s.at("[") and s.ahead(1).text == "]":
        s.report(messages.ARRAY_STYLE, s.current.span.to(s.ahead(1).span), type=declared, name=name)
        brackets(s, declared)
    elif s.at("["):
        sized_name(s, declared, name)
