"""Syntax of Python, C++ and Java that the parser recognises, to suggest the equivalent in L.

Only text that is an error in L matches: every foreign word stays an ordinary name of L.
"""

from __future__ import annotations

import re

from lfield.lang import messages
from lfield.lang.parser.foreign.foreign_words import (
    CONTAINERS,
    FOREIGN_STATEMENTS,
    FOREIGN_SYMBOLS,
    FOREIGN_TYPE_HINTS,
    JOIN,
    METHOD_WORDS,
    NO_GENERICS,
    WORD_OPERATORS,
    WORD_PREFIXES,
    qualified_hint,
)
from lfield.lang.parser.foreign.python_blocks import skip_python_block
from lfield.lang.parser.token_stream import PRIMITIVES, SyntaxRecovery, TokenStream
from lfield.lang.scanner import Token, TokenKind
from lfield.lang.syntax import BAD_TYPE, BadStmt, Stmt, TypeName
from lfield.text.source_text import Span

_LITERALS = (TokenKind.NAME, TokenKind.INT, TokenKind.REAL, TokenKind.STRING)
_VALUE_WORDS = ("this", "true", "false", "null", "new")
SIZES = ("unsigned", "signed", "long", "short")
_POINTERS = ("*", "&", "?")
_CASTS = ("static_cast", "reinterpret_cast", "dynamic_cast", "const_cast")
_CONVERSIONS = "L converts with functions: i2f, f2i, i2s, f2s, b2s, s2i, s2f"
_MOVE_METHOD = "methods belong directly into a resource, a coordinator or a class: move it there"
_RANGE = "write for (int i = 0; i < {bound}; i += 1) {{ ... }}"
_EACH = "write the type of the elements: for ({type} {name} : {array}) {{ ... }}"
_EACH_TYPES = ("auto", "var", "let", "const")
#: `// 2` or `//=` behind an operand: a division of Python, not a comment.
_FLOOR_DIVISION = re.compile(r"\s*//(?:=|\s*[\d.]|\s*[\w.()]+\s*[;)])")


def is_operand_start(token: Token) -> bool:
    """Whether the token is a literal, a name or `this`: no operator and no bracket."""
    return token.kind in _LITERALS or token.text in _VALUE_WORDS


def touches(s: TokenStream, ahead: int) -> bool:
    """Whether no space separates the token `ahead` places after the current one from its predecessor."""
    return s.ahead(ahead).span.start == s.ahead(ahead - 1).span.end


# --- operators ------------------------------------------------------------------------------------------


def at_word_operator(s: TokenStream) -> bool:
    """Whether the token is a word such as `and` between two operands, or `**`."""
    if s.at("*"):
        return s.ahead(1).text == "*" and touches(s, 1)
    if not s.at_name() or s.current.text not in WORD_OPERATORS:
        return False
    following = s.ahead(1)
    return s.ahead(1).text == "in" if s.at("not") else is_operand_start(following) or following.text in "(!-["


def word_operator(s: TokenStream) -> tuple[Span, str]:
    """Report the operator here and skip it; its place and the operator of L, "" for none."""
    start, keyword = s.current.span, s.current.text
    power = "write x * x for an int, or pow(x, y), which returns a real"
    operator, instead = WORD_OPERATORS.get(keyword, ("", power))
    s.advance()
    if keyword == "*" or s.at("in") or (keyword == "is" and s.at("not")):
        keyword = "**" if keyword == "*" else f"{keyword} {s.current.text}"
        if keyword == "is not":
            operator, instead = "!=", "write !="
        s.advance()
    place = start.to(s.previous.span)
    if operator in ("==", "!=") and s.at("None"):
        instead += " null"
    s.report(messages.FOREIGN_OPERATOR, place, operator=keyword, instead=instead)
    return place, operator


def at_word_prefix(s: TokenStream) -> bool:
    """Whether the token is a word such as `not` before an operand, or a prefix of a string (`f"..."`)."""
    if not s.at_name():
        return False
    if s.ahead(1).kind is TokenKind.STRING and touches(s, 1):
        return True
    following = s.ahead(1)
    is_lambda = s.at("lambda") and following.text == ":"
    is_prefix = is_lambda or (s.current.text in WORD_PREFIXES and is_operand_start(following))
    return is_prefix and following.text not in s.end_words


def word_prefix(s: TokenStream) -> Token:
    """Report the word here and skip it, or raise SyntaxRecovery."""
    token = s.advance()
    if s.current.kind is TokenKind.STRING and token.text not in WORD_PREFIXES:
        instead = JOIN if token.text in ("f", "F", "fr", "rf") else f"leave the {token.text} out"
        s.report(messages.FOREIGN_KEYWORD, token.span, keyword=f'{token.text}"..."', instead=instead)
        return token
    s.report(messages.FOREIGN_KEYWORD, token.span, keyword=token.text, instead=WORD_PREFIXES[token.text])
    if token.text == "lambda":
        raise SyntaxRecovery
    return token


def std_member(s: TokenStream) -> SyntaxRecovery:
    """Report `std::cout` and other names with `::` in an expression; raise the returned exception."""
    sign, names = s.current.span, [s.previous.text]
    while s.at("::") and s.ahead(1).text.isidentifier():
        s.advance()
        names.append(s.advance().text)
    s.report(messages.FOREIGN_OPERATOR, sign, operator="::", instead=qualified_hint(names))
    return SyntaxRecovery()


def foreign_init(s: TokenStream, module: str) -> SyntaxRecovery:
    """Report `rclpy.init()`; raise the returned exception."""
    keyword = f"{module}.init"
    return s.fail(messages.FOREIGN_KEYWORD, keyword=keyword, instead=qualified_hint([module, "init"]))


def at_walrus(s: TokenStream) -> bool:
    """Whether the tokens are `:=`."""
    return s.at(":") and s.ahead(1).text == "=" and touches(s, 1)


def walrus(s: TokenStream) -> SyntaxRecovery:
    """Report `:=`; raise the returned exception."""
    return s.fail(messages.FOREIGN_OPERATOR, operator=":=", instead="write =")


def lacks_operator(s: TokenStream) -> bool:
    """Whether a string and another operand have no operator between them, as in `"a" n`."""
    is_operand = is_operand_start(s.current) and not s.first_on_line()
    return is_operand and TokenKind.STRING in (s.previous.kind, s.current.kind) and s.previous.text != "("


def semicolon_hint(s: TokenStream) -> str | None:
    """The hint for a missing `;` that fits the tokens around it; None for the usual hint."""
    previous, token = s.previous, s.current
    if s.at(",") and not s.first_on_line():
        return "one statement assigns one variable: write a statement for each"
    if previous.kind is token.kind is TokenKind.STRING and previous.span.end == token.span.start:
        return 'a string is in double quotes on one line; a line break in it is written \\n: "a\\nb"'
    if lacks_operator(s):
        return JOIN
    if s.at(":") and not s.first_on_line():
        name, type = s.previous.text, s.ahead(1).text
        is_typed = previous.kind is TokenKind.NAME and (type in PRIMITIVES or type.isidentifier())
        is_typed = is_typed and s.ahead(1).span.line == token.span.line
        return f"the type comes first: {type} {name};" if is_typed else FOREIGN_SYMBOLS[":"]
    if at_floor_division(s):
        return "// begins a comment; / divides whole numbers if both sides are int"
    return None


def at_floor_division(s: TokenStream) -> bool:
    """Whether `// 2;` or `//= 2;` follows the previous token: read as a comment, intended as a division."""
    place = s.previous.span
    line = place.source.line_text(place.line)
    return _FLOOR_DIVISION.match(line, place.column - 1 + place.end - place.start) is not None


# --- types ----------------------------------------------------------------------------------------------


def type_arguments_end(s: TokenStream, at: int) -> int:
    """The index after `<...>` at an index ahead, if it contains only types; else 0."""
    depth, start = 0, at
    while True:
        token = s.ahead(at)
        depth += {"<": 1, ">": -1, ">>": -2}.get(token.text, 0)
        is_type = token.kind in (TokenKind.NAME, TokenKind.INT) or token.text in (*PRIMITIVES, "void")
        if not (is_type or token.text in ("<", ">", ">>", ",", "::", "[", "]", "*", "&")) or at - start > 40:
            return 0
        at += 1
        if depth <= 0:
            return at


def at_foreign_type(s: TokenStream) -> bool:
    """Whether `std::vector<int> name`, `List<int> name` or `Foo& name` begins at the name here."""
    at = 1
    if s.ahead(at).text not in ("<", "::", *_POINTERS):
        return False
    while s.ahead(at).text == "::" and s.ahead(at + 1).text.isidentifier():
        at += 2
    if s.ahead(at).text == "<" and not (at := type_arguments_end(s, at)):
        return False
    if s.ahead(at).text in _POINTERS:
        at += 1
        if s.ahead(at + 1).text not in ("=", ";", ":"):
            return False
    return s.ahead(at).kind is TokenKind.NAME


def at_cast(s: TokenStream) -> bool:
    """Whether `static_cast<int>(` begins at the name here."""
    end = type_arguments_end(s, 1) if s.ahead(1).text == "<" else 0
    if not end or s.ahead(end).text != "(":
        return False
    return not any(s.ahead(n).text == "," for n in range(1, end)) or any(
        s.ahead(n).text in PRIMITIVES for n in range(1, end)
    )


def cast(s: TokenStream) -> SyntaxRecovery:
    """Report `static_cast<int>(...)` or another call with type arguments; raise the returned exception."""
    name = s.current
    instead = _CONVERSIONS if name.text in _CASTS else CONTAINERS.get(name.text, NO_GENERICS)
    s.report(messages.FOREIGN_KEYWORD, name.span, keyword=f"{name.text}<...>", instead=instead)
    return SyntaxRecovery()


def qualified(s: TokenStream, named: TypeName) -> None:
    """Report the `unsigned`, `::` and `<...>` around the name of a type, and skip them."""
    if named.name in SIZES and s.at(*PRIMITIVES, *SIZES):
        s.report(messages.FOREIGN_KEYWORD, named.span, keyword=named.name, instead="in L it is called int")
        while s.at(*PRIMITIVES, *SIZES):
            s.advance()
        named.name = BAD_TYPE
    elif s.at("::"):
        sign, names = s.current.span, [named.name]
        while s.accept("::") and (s.at_name() or s.at(*PRIMITIVES)):
            names.append(s.advance().text)
            _skip_arguments(s)
        s.report(messages.FOREIGN_OPERATOR, sign, operator="::", instead=qualified_hint(names))
        named.name = BAD_TYPE
    elif s.at("<") and type_arguments_end(s, 0):
        instead = CONTAINERS.get(named.name, NO_GENERICS)
        _skip_arguments(s)
        text = named.span.to(s.previous.span).text
        s.report(messages.FOREIGN_KEYWORD, named.span, keyword=text, instead=instead)
        named.name = BAD_TYPE


def _skip_arguments(s: TokenStream) -> None:
    for _ in range(type_arguments_end(s, 0) if s.at("<") else 0):
        s.advance()


def pointer(s: TokenStream, named: TypeName) -> None:
    """Report the `*`, `&` or `?` between a type and a name, and skip it."""
    if not s.at(*_POINTERS) or s.ahead(1).kind is not TokenKind.NAME:
        return
    sign = s.advance()
    if named.name not in (BAD_TYPE, *FOREIGN_TYPE_HINTS):
        instead = f"leave the {sign.text} out: variables of classes and arrays are references and may be null"
        text = f"{named.name}{sign.text}"
        s.report(messages.FOREIGN_KEYWORD, sign.span, keyword=text, instead=instead)


def sized_name(s: TokenStream, declared: TypeName, name: str) -> None:
    """`int a[3]` of C: reported, and skipped."""
    opening = s.current.span
    while not (s.at_end() or s.at("]", ";", "{", "}")):
        s.advance()
    s.accept("]")
    place = opening.to(s.previous.span)
    size = place.text.strip("[] ")
    hint = f"write {declared}[] {name} = new {declared}[{size}];"
    s.report(messages.ARRAY_STYLE, place, hint=hint, type=declared, name=name)


def local_method(s: TokenStream, declared: TypeName, name: str) -> SyntaxRecovery:
    """Report `int f() { ... }` or `Foo f(1);` inside a method; raise the returned exception."""
    if declared.name == BAD_TYPE and declared.span.text != "void":
        return SyntaxRecovery()  # The type is reported.
    is_class = declared.name not in (*PRIMITIVES, "void", BAD_TYPE) and not declared.dimensions
    instead = f"write {declared} {name} = new {declared}(...);" if is_class else _MOVE_METHOD
    text = f"{declared.span.text} {name}(...)"
    s.report(messages.FOREIGN_KEYWORD, declared.span, keyword=text, instead=instead)
    s.accept("(")
    s.skip_parentheses(1)
    return SyntaxRecovery()


# --- statements -----------------------------------------------------------------------------------------


def _each_name(s: TokenStream) -> int:
    """The number of tokens before the variable of `for (const auto& x : array)` or `for x in array`."""
    at = 1 if s.at("(") else 0
    while s.ahead(at).text in _EACH_TYPES and s.ahead(at + 1).text not in ("in", "of", ":", "="):
        at += 1
        while s.ahead(at).text in _POINTERS:
            at += 1
    return at


def at_foreign_each(s: TokenStream) -> bool:
    """Whether `x in ...`, `(x in ...`, `(x : ...` or `(auto x : ...` follows the `for`."""
    at = _each_name(s)
    return s.ahead(at).kind is TokenKind.NAME and s.ahead(at + 1).text in ("in", "of", ",", ":")


def foreign_each(s: TokenStream) -> None:
    """Report the head of a `for` of Python or C++, and skip it."""
    first = s.ahead(1 if s.at("(") else 0)
    at = _each_name(s)
    name = s.ahead(at)
    while s.ahead(at).text not in ("in", "of", ":", "{", ";", ")") and s.ahead(at).kind is not TokenKind.END:
        at += 1
    sign, array = s.ahead(at), s.ahead(at + 1)
    if array.text in ("range", "enumerate", "len") or s.ahead(at + 2).text == "(":
        bound = s.ahead(at + 3).text if s.ahead(at + 4).text == ")" and array.text == "range" else "n"
        instead = _RANGE.format(bound=bound)
    else:
        instead = each_hint(name.text, array.text if array.kind is TokenKind.NAME else "array")
    if first is not name and first.text in _EACH_TYPES:
        s.report(messages.FOREIGN_KEYWORD, first.span, keyword=first.text, instead=instead)
    elif sign.text == ":":
        s.report(messages.EXPECTED_SYMBOL, sign.span, hint=instead, what="';'", found=sign)
    else:
        s.report(messages.FOREIGN_KEYWORD, sign.span, keyword=sign.text, instead=instead)
    if s.accept("("):
        s.skip_parentheses(1)
    while not (s.at_end() or s.at("{", "}", ";", ":") or s.first_on_line()):
        s.advance()


def each_hint(name: str = "x", array: str = "array", type: str = "int") -> str:
    """The loop of L over an array."""
    return _EACH.format(type=type, name=name, array=array)


def at_except(s: TokenStream) -> bool:
    """Whether an `except` of Python follows a block."""
    return s.at("except") and s.at_name() and s.ahead(1).text not in ("=", ".", "[", ";", "+=", "-=")


def skip_except(s: TokenStream) -> None:
    """Report an `except` and skip its head."""
    token = s.current
    s.report(messages.FOREIGN_KEYWORD, token.span, keyword=token.text, instead=FOREIGN_STATEMENTS[token.text])
    while not (s.at_end() or s.at("{", "}", ";", ":")):
        s.advance()


def block_ahead(s: TokenStream) -> int:
    """The number of tokens before the `{` of `word {` or `word (...) {`; 0 for neither."""
    ahead, depth, braces, semicolons = 1, 0, 0, 0
    while depth > 0 or s.ahead(ahead).text == "(":
        token = s.ahead(ahead)
        depth += {"(": 1, ")": -1}.get(token.text, 0)
        braces += {"{": 1, "}": -1}.get(token.text, 0)
        semicolons += token.text == ";"
        # Braces contain the elements of an array; the head of a `for` has two semicolons.
        if token.kind is TokenKind.END or braces < 0 or semicolons > (2 if braces == 0 else 0):
            return 0
        ahead += 1
    return ahead if s.ahead(ahead).text == "{" else 0


def at_foreign_statement(s: TokenStream) -> bool:
    """Whether the word here is used as in its own language, and not as a name of this program."""
    following = s.ahead(1)
    if following.text in ("(", "{"):
        return block_ahead(s) > 0
    if following.text == ":":
        return s.ahead(2).text != "="
    if s.at("pass"):
        ends_line = following.span.line > s.current.span.line and following.kind is not TokenKind.SYMBOL
        return following.text in (";", "}") or ends_line
    return following.kind is TokenKind.KEYWORD or following.text == "!" or is_operand_start(following)


def foreign_statement(s: TokenStream, keyword: str) -> Stmt:
    """A statement of another language: reported; its block, if it has one, is skipped."""
    head = s.current.span
    if s.ahead(1).text in METHOD_WORDS:
        keyword = s.ahead(1).text
    s.report(messages.FOREIGN_KEYWORD, head, keyword=keyword, instead=FOREIGN_STATEMENTS[keyword])
    if keyword == "pass":
        s.advance()
        s.accept(";")
        return BadStmt(head)
    depth = 0
    while not s.at_end() and not s.at(";", "{", "}") and not (s.at(":") and depth == 0):
        depth += {"(": 1, "[": 1, ")": -1, "]": -1}.get(s.advance().text, 0)
    if s.at(":"):
        skip_python_block(s, head)
    elif s.at("{"):
        s.skip_braces()
        if keyword == "do" and s.at("while"):
            s.skip_statement()
    else:
        s.accept(";")
    return BadStmt(head)
