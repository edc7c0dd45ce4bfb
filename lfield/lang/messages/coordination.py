"""Diagnostics of together, within and reserve (L8xx), and the warnings (L9xx)."""

from __future__ import annotations

from lfield.text.message_tables import FindingTable

COORDINATION = FindingTable("L8", "L9", warnings="L9")
_message = COORDINATION.message

# --- L8xx: together, within and reserve -----------------------------------------------------------------

COORDINATOR_KEYWORD = _message(
    "L801",
    "'{keyword}' is not allowed in {viewer}",
    "declare it class {unit} coordinator specific {{ ... }}: only coordinators call portals",
)
TOGETHER_EMPTY = _message(
    "L802",
    "this together starts no portal call",
    "write the calls directly in it, alone or as x = arm.lift(1.5); not in methods that it calls",
)
TOGETHER_INSIDE = _message(
    "L803",
    "this portal call is part of an expression, but a together has results only at its end",
    "write it alone or as x = ...; with a variable declared before the block, and use x after it",
)
TOGETHER_BARRED = _message(
    "L804",
    "a portal call of the together is inside a nested {keyword}",
    "put the {keyword} around the together, or write a separate together in the {keyword}",
)
TOGETHER_DECLARED = _message(
    "L805",
    "'{name}' is declared inside the together, which assigns it only at its end",
    "declare it before the block: {type} {name};",
)
TOGETHER_TARGET = _message(
    "L806",
    "a together assigns results only to local variables and elements of local arrays",
    "declare a local variable before the block, and copy it after the block",
)
TOGETHER_DOUBLE_TARGET = _message(
    "L807",
    "'{name}' is already assigned by the call on line {line} of this together",
    "use a separate variable for each call, and choose after the block",
)
TOGETHER_LOOP = _message(
    "L808",
    "each iteration would assign '{name}', but all calls of a together run at the same time",
    "use an array with an element for each iteration, or put the loop around the together",
)
TOGETHER_USED = _message(
    "L809", "'{name}' is assigned by this together, at its end", "use it before or after the block"
)
TOGETHER_ALIAS = _message(
    "L810",
    "'{name}' may share its elements with '{array}', which this together assigns at its end",
    "use it before or after the block; inside, only its length may be read",
)
TOGETHER_TYPE = _message(
    "L811",
    "the call returns {given}, the variable is {expected}",
    "in a together both types must be equal: declare {given}, and convert after the block",
)
WITHIN_OVER = _message(
    "L812", "the time of a within must be more than 0 seconds, this is {given}", "write within (30) {{ ... }}"
)
RESERVE_TYPE = _message(
    "L813",
    "reserve takes a resource, an offer, or an array of them, this is {given}",
    "write reserve (arm) {{ ... }} or reserve (offers[0]) {{ ... }}",
)
RESERVE_INSIDE = _message(
    "L814",
    "a reserve inside a together does not apply to the calls of the together",
    "put the reserve around the together",
)

# --- L9xx: warnings -------------------------------------------------------------------------------------

MISSING_RETURN = _message(
    "L901",
    "{method} can end without a return",
    "it then throws MissingReturnException; write a return or a throw at its end",
)
UNREACHABLE = _message("L902", "this statement is unreachable", "remove it, or the {cause} before it")
UNREACHABLE_CATCH = _message(
    "L903", "this catch is unreachable: {earlier} above catches the same", "put specific classes first"
)
LOSING_FINALLY = _message(
    "L904",
    "this finally never ends normally: the result or exception of the try is lost",
    "move the {cause} after the try",
)
LIMIT_PASSES = _message(
    "L905",
    "this catch does not catch the time-out of the within around it",
    "put the try around the within",
)
LONE_HOST = _message(
    "L906",
    "the host '{host}' occurs on this line only and resembles '{close}' on line {line}",
    "did you mean '{close}'?",
)
UNKNOWN_HOST = _message("L908", "the host '{host}' is unknown: {reason}", "check its name")
UNKNOWN_AGENT = _message("L907", "the deployment has no {type} with the id '{id}'", "check the argument")
EMPTY_BRANCH = _message("L909", "this ; is the whole body of the if", "remove the ; or write {{ }} instead")
