"""Diagnostics of characters and tokens (L1xx) and of the syntax (L2xx)."""

from __future__ import annotations

from lfield.text.message_tables import FindingTable

SYNTAX = FindingTable("L1", "L2", warnings="L9")
_message = SYNTAX.message

# --- L1xx: characters and tokens ------------------------------------------------------------------------

ILLEGAL_CHARACTER = _message(
    "L101",
    "L has no character {character}",
    "names consist of ASCII letters, digits and _; other text is written in double quotes",
)
UNCLOSED_STRING = _message(
    "L102",
    "this string is not closed before the end of the line",
    'close it with "; a line break in a string is written \\n',
)
UNCLOSED_COMMENT = _message("L103", "this comment is not closed", "close it with */")
BAD_ESCAPE = _message(
    "L104",
    "{escape} is not an escape sequence",
    'the escape sequences are \\n \\t \\r \\0 \\" \\\\ and \\u{{...}} with the code point in hexadecimal',
)
BAD_NUMBER = _message(
    "L105",
    "'{text}' is not a number",
    "write 12 or 1.5 or 1e3, with a digit on both sides of the point; names cannot begin with a digit",
)
NUMBER_RANGE = _message(
    "L106",
    "the number {text} does not fit into {type}",
    "int ranges from -9223372036854775808 to 9223372036854775807, real to about 1.8e308",
)
SINGLE_QUOTES = _message("L107", "a string is written in straight double quotes", 'write "{text}"')
NOT_TEXT = _message(
    "L108",
    "the file contains a control character ({character})",
    "save it as plain UTF-8 text, and check that it is an L program",
)

# --- L2xx: syntax ---------------------------------------------------------------------------------------

EXPECTED_UNIT = _message(
    "L201",
    "expected resource, coordinator, class or include, found {found}",
    "a program consists of resources, coordinators, classes, constants, enums and functions",
)
EXPECTED_MEMBER = _message(
    "L202",
    "expected a field, a method, init or a portal, found {found}",
    "statements belong inside a method, a portal or init",
)
EXPECTED_NAME = _message("L203", "expected {what}, found {found}")
RESERVED_NAME = _message("L204", "'{keyword}' is a keyword, not a name", "choose another name")
EXPECTED_EXPRESSION = _message("L205", "expected an expression, found {found}")
EXPECTED_SYMBOL = _message("L206", "expected {what}, found {found}")
MISSING_SEMICOLON = _message("L207", "missing ; after this", "every statement and field ends with ;")
MISSING_CLOSE = _message("L208", "missing {symbol} after this", "the {opening} is on line {line}")
UNCLOSED_BRACE = _message("L209", "this {{ is not closed", "add the missing }}")
EXTRA_BRACE = _message("L210", "this }} has no matching {{", "remove it, or an extra }} above it")
TOO_DEEP = _message(
    "L211", "this is nested more than {limit} levels deep", "move the inner part into a method of its own"
)
ELSE_WITHOUT_IF = _message(
    "L212", "else without an if before it", "an if takes one statement or a block in {{ }}"
)
CATCH_WITHOUT_TRY = _message(
    "L213",
    "catch without a try before it",
    "write try {{ ... }} catch (Exception e) {{ ... }}; finally follows the last catch",
)
TRY_WITHOUT_CATCH = _message(
    "L214",
    "try without a catch or finally",
    "add catch (Exception e) {{ ... }} or finally {{ ... }}",
)
MISSING_MODIFIER = _message("L215", "{what} needs public or private", "write: private {text}")
UNWANTED_MODIFIER = _message("L216", "'{keyword}' is not allowed before {what}", "remove it{reason}")
FOREIGN_KEYWORD = _message("L217", "L has no '{keyword}'", "{instead}")
FOREIGN_OPERATOR = _message("L218", "L has no operator '{operator}'", "{instead}")
NO_TERNARY = _message("L219", "L has no ? : expression", "write if (...) x = a; else x = b;")
CAST = _message(
    "L220",
    "a type is not allowed in an expression",
    "L converts with functions: i2f, f2i, i2s, f2s, b2s, s2i, s2f",
)
ARRAY_LENGTH_MISSING = _message(
    "L221", "a new array needs its length or its elements", "write new {type}[10] or new {type}[] {{a, b}}"
)
NEW_NEEDS = _message(
    "L222", "new {type} needs arguments or a length", "write new {type}(...) or new {type}[10]"
)
ONE_VARIABLE = _message("L223", "a declaration declares one variable", "write two: int a; int b;")
ARRAY_STYLE = _message("L224", "the [] belongs to the type", "write {type}[] {name}")
NEEDS_BODY = _message("L225", "{what} needs a body", "write {{ ... }} after it")
LOOP_ONLY = _message(
    "L226", "'{keyword}' outside a loop", "it leaves or continues the innermost while or for"
)
INIT_CALLED = _message(
    "L227", "init cannot be called", "it runs once, when the agent starts; move the code into a method"
)
MISSPELT_KEYWORD = _message("L229", "'{keyword}' is not a keyword", "did you mean '{close}'?")
VOID_VALUE_TYPE = _message(
    "L230", "void is not a type for {what}", "void is only the result type of a method without a result"
)
NOT_A_CALL = _message("L231", "only a name can be called", "write name(...) or object.name(...)")
FINALLY_WITHOUT_TRY = _message(
    "L232", "finally without a try before it", "write try {{ ... }} finally {{ ... }}"
)
LEAVES_FINALLY = _message(
    "L233",
    "'{keyword}' would leave this finally and discard a pending exception or result",
    "set a variable in the finally, and write the {keyword} after the try",
)
CONSTANT_SHAPE = _message(
    "L234", "a constant needs a type and a value", "write const int {name} = 1; with the type of the value"
)
EMPTY_ENUM = _message("L235", "the enum {name} has no members", "write enum {name} {{ FIRST, SECOND }}")
