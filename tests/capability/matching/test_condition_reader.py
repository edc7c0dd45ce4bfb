"""Conditions are read as L reads expressions: the two readers agree on every text."""

from __future__ import annotations

from dataclasses import fields

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from lfield.capability import condition, condition_reader
from lfield.lang import syntax
from lfield.lang.parser import expressions
from lfield.lang.parser.stream import GiveUp, Recover, TokenStream
from lfield.lang.scanner import KEYWORDS, scan
from lfield.text.source import Diagnostics, Source


def of_the_language(text: str) -> syntax.Expr | None:
    """The tree that L's parser makes of a whole text, None where it finds a mistake."""
    found = Diagnostics()
    stream = TokenStream(scan(Source("", text), found), found)
    try:
        tree = expressions.expression(stream)
    except (Recover, GiveUp):
        return None
    return None if found.found or not stream.at_end() or assigns(tree) else tree


def assigns(tree: object) -> bool:
    """Whether there is an assignment in it: that is an expression of L, and no condition."""
    if isinstance(tree, syntax.Assign):
        return True
    if isinstance(tree, list | tuple):
        return any(map(assigns, tree))
    return isinstance(tree, syntax.Expr) and any(assigns(getattr(tree, f.name)) for f in fields(tree))


def shape(tree: syntax.Expr | condition.Expr) -> object:
    """What a tree says, with its places, whichever reader made it."""
    place = tree.span.start, tree.span.end
    match tree:
        case syntax.Literal_(value=value) | condition.Literal_(value=value):
            # NaN cannot be written; 1 and 1.0 and true are three things.
            return place, type(value), value
        case syntax.Name(name=name) | condition.Name(name=name):
            return place, name
        case syntax.Unary() | condition.Unary():
            return place, tree.operator, shape(tree.operand)
        case syntax.Binary() | condition.Binary():
            return place, tree.operator, tree.sign.start, shape(tree.left), shape(tree.right)
        case syntax.Member() | condition.Member():
            return place, shape(tree.object), tree.name, tree.place.start
        case syntax.Call() | condition.Call():
            return place, shape(tree.function), [shape(argument) for argument in tree.arguments]
        case _:
            return place, "has no meaning"


def test_both_readers_have_the_same_reserved_words() -> None:
    assert condition_reader.RESERVED_WORDS == KEYWORDS


_ATOMS = [
    "catch",
    "a.emit",
    "init(1)",
    "payload",
    "a.b",
    "2",
    "2.0",
    ".5e3",
    "1e999",
    "9223372036854775808",
    "007",
    "true",
    "null",
    "this",
]
_ATOMS += [
    '"text"',
    '"\\n\\u{41}"',
    '"\\q"',
    '"open',
    "'one'",
    "new T(1)",
    "f()",
    "max(a, b.c)",
    "a[0]",
    "x.y(z)",
]
_SIGNS = [
    "&&",
    "||",
    "==",
    "!=",
    "<",
    "<=",
    ">",
    ">=",
    "+",
    "-",
    "*",
    "/",
    "%",
    "!",
    "(",
    ")",
    ",",
    ".",
    "[",
    "]",
]
_SIGNS += ["=", "?", ":", "&", "++", "===", "=>", "// rest", "/* in */", "/* open", ";", "§", "and"]
_TEXTS = st.lists(st.sampled_from(_ATOMS + _SIGNS), min_size=1, max_size=12).map(" ".join)


@given(_TEXTS | st.text(max_size=30))
@example("payload >= 2.0 && environment == terrestrial")
@example("-9223372036854775808 < - 1 - -1")
@example("a - b - c * d / e % f")
@example('"=" == "?"')
@example("(((a)))")
@example("min(1,2).x")
def test_both_readers_agree(text: str) -> None:
    tree, mistakes = condition_reader.parse(text)
    theirs = of_the_language(text)
    if "new" in text:
        # L reads on where a condition has no meaning any more.
        return
    assert (tree is None) == (theirs is None) == bool(mistakes), mistakes
    if tree is not None and theirs is not None:
        assert shape(tree) == shape(theirs)


@pytest.mark.parametrize(
    ("text", "message", "hint"),
    [
        ('note == "open', "this text is not closed", 'close it with "'),
        ("note == 'one'", "text stands in straight double quotes", ""),
        ("payload > 2kg", "'2kg' is not a number", "write 12 or 1.5 or 1e3"),
        ("payload & ready", "a condition has no operator &", "write &&"),
        ("payload > 1e999", "the number 1e999 does not fit into 64 bits", ""),
        ("(payload > 1", "missing ) after this", "it closes the ("),
        ('note == "\\q"', "\\q is not an escape", r"the escapes are \n \t \r \0 \" \\ and \u{...}"),
        ("payload > § 1", "the character '§' has no meaning here", "text stands in double quotes"),
        ("payload > /* 1", "this comment is never closed", "close it with */"),
        ("payload. > 1", "expected the name of a member, found '>'", ""),
        ("2(1)", "only a name can be called", "write name(...)"),
    ],
)
def test_what_is_no_expression(text: str, message: str, hint: str) -> None:
    tree, (mistake,) = condition_reader.parse(text)
    assert tree is None
    assert (mistake.message, mistake.hint) == (message, hint)
