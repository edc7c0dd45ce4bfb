"""Units and their members (appendix A; members may come in any order)."""

from __future__ import annotations

from lfield.lang import messages
from lfield.lang.parser.expressions import expression
from lfield.lang.parser.foreign.foreign_syntax import at_walrus, walrus
from lfield.lang.parser.foreign.foreign_words import (
    FOREIGN_MODIFIERS,
    FOREIGN_STATEMENTS,
    METHOD_ENDS,
    METHOD_WORDS,
)
from lfield.lang.parser.foreign.python_blocks import report_colon, skip_python_block
from lfield.lang.parser.local_variables import initial_value
from lfield.lang.parser.loop_members import at_loop, loop_member
from lfield.lang.parser.portal_heads import at_misplaced_portal, misplaced_portal, misplaced_result
from lfield.lang.parser.statements import block
from lfield.lang.parser.token_stream import (
    PRIMITIVES,
    UNIT_KEYWORDS,
    SyntaxRecovery,
    TokenStream,
    UnclosedBrace,
)
from lfield.lang.parser.type_names import (
    AFTER_TYPE,
    misplaced_brackets,
    parameter_modifier,
    result_type,
    type_name,
)
from lfield.lang.scanner import Token, TokenKind
from lfield.lang.syntax import BAD_TYPE, Field, Method, ParameterDecl, TypeName, Unit
from lfield.lang.tree import MethodKind, UnitKind, Usage
from lfield.text.source_text import Span
from lfield.text.suggestions import closest

_USAGES: dict[str, Usage] = {"resource": "resource", "coordinator": "coordinator"}
_NESTED_UNITS = ("struct", "enum", "interface", "template", "typedef", "import", "from", "using", "namespace")
_MODIFIERS = ("public", "private", "synchronized")


def unit(s: TokenStream, kind: UnitKind) -> Unit:
    """A resource, coordinator or class; the stream is at its name."""
    name = s.expect_name(f"the name of the {kind}")
    usage: Usage = _usage(s, kind) if kind == "class" else _USAGES[kind]
    unit = Unit(kind, usage, name.text, name.span)
    if s.at("(", ":", "<") or (s.at_name() and s.at("extends", "implements")):
        _inheritance(s, kind, name.text)
    s.expect("{")
    members(s, unit, name.span)
    return unit


def _inheritance(s: TokenStream, kind: UnitKind, name: str) -> None:
    """Report `extends B`, `(B)`, `: public B` or `<T>` behind the name of a unit; skip it."""
    sign = s.current
    keyword = sign.text if sign.kind is TokenKind.NAME else f"{kind} {name}{sign.text}"
    instead = "L has no inheritance: put an object of the other class into a field"
    if s.at("<"):
        instead = "there are no generic types: write a class for each element type"
    elif s.at(":") and (s.ahead(1).span.line > sign.span.line or s.ahead(1).kind is TokenKind.END):
        instead = f"the members of a unit are in braces: {kind} {name} {{ ... }}"
    s.report(messages.FOREIGN_KEYWORD, sign.span, keyword=keyword, instead=instead)
    while not s.at_end() and not s.at("{", "}", ";", *UNIT_KEYWORDS):
        s.advance()
    if not s.at("{"):
        raise SyntaxRecovery


def members(s: TokenStream, owner: Unit, opening: Span) -> None:
    """The members of a unit up to its `}`, added to it; `opening` is reported when that is missing."""
    while not s.accept("}"):
        if s.at_end() or (s.at(*UNIT_KEYWORDS) and s.first_on_line()):
            s.report(messages.UNCLOSED_BRACE, s.suspect or opening)
            owner.broken = True
            return
        s.set_suspect(None)

        def parse() -> None:
            _member(s, owner)

        try:
            owner.broken |= not s.attempt(parse, s.skip_member)
        except UnclosedBrace:
            owner.broken = True
            if s.at_end() or s.at(*UNIT_KEYWORDS):
                return


def _usage(s: TokenStream, kind: UnitKind) -> Usage:
    """`resource specific`, `coordinator specific` or nothing."""
    if not s.at(*_USAGES):
        return "global"
    usage = _USAGES[s.advance().text]
    if not (s.at_name() and s.at("specific")):
        raise s.fail(messages.EXPECTED_SYMBOL, what="'specific'", found=s.current)
    s.advance()
    return usage


class _Modifiers:
    """The words before a member, each with its place."""

    def __init__(self) -> None:
        self.tokens: dict[str, Token] = {}
        self.portal = False
        self.foreign = False

    @property
    def public(self) -> bool:
        return "public" in self.tokens

    @property
    def synchronized(self) -> bool:
        return "synchronized" in self.tokens

    @property
    def missing(self) -> bool:
        """Whether public or private is missing and no word of another language is used."""
        return self.access is None and not self.foreign

    @property
    def access(self) -> Token | None:
        return self.tokens.get("public") or self.tokens.get("private")


def _modifiers(s: TokenStream) -> _Modifiers:
    modifiers = _Modifiers()
    while not modifiers.portal:
        # After public or private the word may be any type: `private Report observe()` is not a portal.
        keyword = (_respelt(s) if modifiers.access is None else None) or s.current.text
        if s.at("public", "private", "protected") and s.ahead(1).text == ":":
            instead = f"write {keyword} before each method, and before each field of a class"
            s.report(messages.FOREIGN_KEYWORD, s.advance().span, keyword=f"{keyword}:", instead=instead)
            s.advance()
            modifiers.foreign = True
        elif keyword in _MODIFIERS:
            modifiers.tokens[keyword] = s.advance()
        elif keyword == "portal":
            s.advance()
            modifiers.portal = True
        elif s.at_name() and s.at(*FOREIGN_MODIFIERS) and s.ahead(1).text not in ("(", "=", ";"):
            span = s.advance().span
            if not modifiers.foreign and s.current.text not in METHOD_WORDS:  # One report is enough.
                s.report(messages.FOREIGN_KEYWORD, span, keyword=keyword, instead=FOREIGN_MODIFIERS[keyword])
            modifiers.foreign = True
        else:
            break
    return modifiers


def _respelt(s: TokenStream) -> str | None:
    """Report `pubic` in `pubic int x;` and return the intended keyword; None if no member follows."""
    following = s.ahead(2).text
    if not (
        s.at_name() and s.ahead(1).text.isidentifier() and (following.isidentifier() or following == "(")
    ):
        return None
    if s.at(*_NESTED_UNITS, *METHOD_WORDS):
        return None
    # A capital letter begins the name of a type: `Report observe()` is not a misspelt portal.
    close = closest(s.current.text, (*_MODIFIERS, "portal")) if s.current.text[0].islower() else None
    if close is not None:
        s.report(messages.MISSPELT_KEYWORD, s.current.span, keyword=s.current.text, close=close)
    return close


def function(s: TokenStream, found: list[Method]) -> None:
    """`real square(real x) { ... }` at the top level, added to `found`; the stream is at its type."""
    declared = result_type(s)
    name = s.expect_name("the name of the function")
    holder = Unit("class", "global", name.text, name.span)
    method = _method(s, "method", name, _Modifiers(), declared)
    found.append(method)
    try:
        _body(s, holder, method)
    except UnclosedBrace:
        method.broken = True


def _member(s: TokenStream, owner: Unit) -> None:
    if s.accept(";"):
        return
    modifiers = _modifiers(s)
    if modifiers.portal:
        return _portal(s, owner, modifiers)
    if s.at("init"):
        return _init(s, owner, modifiers)
    if at_loop(s):
        for token in modifiers.tokens.values():
            _unwanted(s, token, "a loop", "")
        return loop_member(s, owner)
    if at_misplaced_portal(s):
        result = misplaced_portal(s, "synchronized " if modifiers.synchronized else "")
        return _named_portal(s, owner, modifiers, result, modifiers.synchronized)
    _foreign_member(s)
    if s.at_name() and s.ahead(1).text == "(":
        return _without_result(s, owner, modifiers)
    if not (s.at_name() or s.at("boolean", "int", "real", "string", "void")):
        raise s.fail(messages.EXPECTED_MEMBER, found=s.current)
    if s.at_name() and not (s.ahead(1).text.isidentifier() or s.ahead(1).text in AFTER_TYPE):
        raise s.fail(messages.EXPECTED_MEMBER, found=s.current)
    declared = result_type(s)
    name = s.expect_name("a name")
    if s.at("("):
        method = _method(s, "method", name, modifiers, declared)
        if modifiers.missing:
            text = f"{declared} {name.text}(...)"
            s.report(messages.MISSING_MODIFIER, declared.span, what="a method", text=text)
        _body(s, owner, method)
    else:
        _field(s, owner, modifiers, declared, name)


def _foreign_member(s: TokenStream) -> None:
    """Fail at a member in the syntax of another language."""
    keyword, following = s.current.text, s.ahead(1)
    if s.at("~"):
        raise s.fail(
            messages.EXPECTED_MEMBER, hint="objects are freed by themselves; leave it out", found=s.current
        )
    if not s.at_name():
        return
    if s.at("pass") and (following.text in (";", "}") or following.span.line > s.current.span.line):
        raise s.fail(messages.FOREIGN_KEYWORD, keyword=keyword, instead=FOREIGN_STATEMENTS[keyword])
    if following.text == ":" and s.ahead(2).text.isidentifier():
        hint = f"the type comes first: {s.ahead(2).text} {keyword};"
        raise s.fail(messages.EXPECTED_MEMBER, hint=hint, found=s.current)
    is_method = keyword in METHOD_WORDS and following.kind is TokenKind.NAME and s.ahead(2).text == "("
    if is_method or (
        keyword in _NESTED_UNITS and (following.kind is TokenKind.NAME or following.text == "<")
    ):
        instead = FOREIGN_STATEMENTS.get(keyword, "write class Name { ... } at the top level")
        raise s.fail(messages.FOREIGN_KEYWORD, keyword=keyword, instead=instead)


def _field(s: TokenStream, owner: Unit, modifiers: _Modifiers, declared: TypeName, name: Token) -> None:
    if declared.name == "void":
        s.report(messages.VOID_VALUE_TYPE, declared.span, what="a field")
        declared.name = BAD_TYPE
    access = modifiers.access
    if owner.kind == "class" and modifiers.missing:
        text = f"{declared} {name.text};"
        s.report(messages.MISSING_MODIFIER, declared.span, what="a field of a class", text=text)
    elif owner.kind != "class" and access is not None:
        description = f"a field of a {owner.kind}"
        _unwanted(s, access, description, ": only its own methods reach it anyway")
    if modifiers.synchronized:
        _unwanted(s, modifiers.tokens["synchronized"], "a field", "")
    misplaced_brackets(s, declared, name.text)
    field = Field(declared, name.text, modifiers.public, None, name.span)
    owner.fields.append(field)
    field.value = initial_value(s, declared)
    if at_walrus(s):
        raise walrus(s)
    if s.at(","):
        raise s.fail(messages.ONE_VARIABLE)
    s.semicolon()


def _portal(s: TokenStream, owner: Unit, modifiers: _Modifiers) -> None:
    for keyword, token in modifiers.tokens.items():
        place = ", or write portal synchronized" if keyword == "synchronized" else ": every portal is public"
        _unwanted(s, token, "a portal", place)
    synchronized = s.accept("synchronized")
    _named_portal(s, owner, modifiers, misplaced_result(s), synchronized)


def _named_portal(
    s: TokenStream, owner: Unit, modifiers: _Modifiers, result: TypeName | None, synchronized: bool
) -> None:
    """A portal; the stream is at its name."""
    name = s.expect_name("the name of the portal")
    method = _method(s, "portal", name, modifiers, result)
    method.synchronized = synchronized
    if s.accept("emit"):
        method.result = type_name(s, "an emit")
    _body(s, owner, method)


def _foreign_ending(s: TokenStream, method: Method) -> None:
    """`-> real`, `: real`, `throws X`, `const` behind the parameters: reported, and skipped."""
    token = s.current
    if s.at(":") and s.ahead(1).span.line > token.span.line:
        report_colon(s)
        skip_python_block(s, token.span)
        raise SyntaxRecovery
    if s.at("->", ":") or (s.at_name() and s.at("returns")):
        s.advance()
        result = result_type(s) if s.at_name() or s.at("void", *PRIMITIVES) else None
        hint = f"the type precedes the name: private {result or 'int'} {method.name}(...)"
        if method.kind == "portal":
            hint = f"write portal {method.name}(...) emit {result or 'int'}"
            method.result = result if result is not None and result.name != "void" else None
        s.report(messages.EXPECTED_SYMBOL, token.span, hint=hint, what="'{'", found=token)
        return
    while s.at_name() and s.at(*METHOD_ENDS):
        token = s.advance()
        s.report(messages.FOREIGN_KEYWORD, token.span, keyword=token.text, instead=METHOD_ENDS[token.text])
        while not (s.at_end() or s.at("{", "}", ";", *METHOD_ENDS)):
            s.advance()


def _init(s: TokenStream, owner: Unit, modifiers: _Modifiers) -> None:
    for token in modifiers.tokens.values():
        _unwanted(s, token, "init", ": only the machine calls it")
    _body(s, owner, _method(s, "init", s.advance(), modifiers, None))


def _without_result(s: TokenStream, owner: Unit, modifiers: _Modifiers) -> None:
    """A constructor, or a method whose result type was forgotten."""
    name = s.advance()
    if owner.kind != "class" or name.text != owner.name:
        close = closest(name.text, ("init",)) if owner.kind != "class" else None
        hint = f"did you mean '{close}'?" if close else None
        if owner.kind != "class" and name.text in (owner.name, "__init__"):
            hint = f"a {owner.kind} starts in init: init(string[] arg) {{ ... }}"
        s.report(messages.CONSTRUCTOR_NAME, name.span, hint=hint, name=name.text)
        method = _method(s, "method", name, modifiers, TypeName(name.span, BAD_TYPE))
        _body(s, owner, method)
        return
    if modifiers.missing:
        s.report(messages.MISSING_MODIFIER, name.span, what="a constructor", text=f"{name.text}(...)")
    if modifiers.synchronized:
        _unwanted(
            s, modifiers.tokens["synchronized"], "a constructor", ": no other thread has the object yet"
        )
    _body(s, owner, _method(s, "constructor", name, modifiers, None))


def _unwanted(s: TokenStream, token: Token, description: str, reason: str) -> None:
    s.report(messages.UNWANTED_MODIFIER, token.span, what=description, keyword=token.text, reason=reason)


def _method(
    s: TokenStream, kind: MethodKind, name: Token, modifiers: _Modifiers, result: TypeName | None
) -> Method:
    """A method without its body; the stream is at the parameters."""
    parameters = _parameters(s)
    public = modifiers.public or kind in ("init", "portal")
    return Method(kind, name.text, parameters, result, public, modifiers.synchronized, name.span)


def _parameters(s: TokenStream) -> list[ParameterDecl]:
    opening = s.expect("(")
    found: list[ParameterDecl] = []
    if not s.at(")"):
        found.append(_parameter(s))
        while s.accept(","):
            found.append(_parameter(s))
    s.close(")", opening)
    return found


def _parameter(s: TokenStream) -> ParameterDecl:
    parameter_modifier(s)
    if s.at("self") and s.ahead(1).text in (",", ")"):
        instead = "leave it out: in every method, this is the object"
        raise s.fail(messages.FOREIGN_KEYWORD, keyword="self", instead=instead)
    if s.at_name() and s.ahead(1).text == ":":
        order = f"the type comes first: {s.ahead(2).text} {s.current.text}"
        raise s.fail(messages.EXPECTED_NAME, hint=order, what="a type", found=s.current)
    declared = type_name(s, "a parameter")
    hint = "write the type and the name: int x" if s.at(")", ",") else None
    name = s.expect_name("the name of a parameter", hint)
    misplaced_brackets(s, declared, name.text)
    if s.at("="):
        instead = "parameters have no default values: write a second method with fewer parameters"
        s.report(messages.FOREIGN_OPERATOR, s.current.span, operator="= ...", instead=instead)
        s.advance()
        expression(s)
    return ParameterDecl(declared, name.text, name.span)


def _body(s: TokenStream, owner: Unit, method: Method) -> None:
    """Parse the body of a method and add the method to the unit, even if the body is wrong."""
    owner.methods.append(method)
    before = s.reset_broken()
    try:
        _foreign_ending(s, method)
        if s.at(";"):
            s.report(messages.NEEDS_BODY, method.span, what=f"{method.kind} {method.name}".strip())
            s.advance()
        else:
            method.body = block(s)
    finally:
        method.end = s.previous.span
        method.broken = s.broken
        s.restore_broken(before)
