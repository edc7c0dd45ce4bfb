"""Diagnostics of the registry reader: code, sentence and hint of each.

`FindingKind.at` creates them. C10x the files and names, C11x the taxonomy, C12x
attributes, values and units, C13x primitives, C14x portals that are mapped, C15x rules, C16x agents, C17x
the program the registry is used with, C19x warnings. Mistakes of any YAML file (an unknown key, a list where
text is expected) are Y1xx, in yaml_source.py.
"""

from __future__ import annotations

from lfield.text.message_tables import FindingTable

#: Every message by its code, in the order of the codes.
TABLE = FindingTable("C", warnings="C19")
_message = TABLE.message


# --- C10x: files and names ------------------------------------------------------------------------------

VERSION = _message("C100", "this is not a registry of version 1", "begin the file with 'registry: 1'")
TOO_MANY = _message("C101", "more than {limit} {what}; the rest is not read", "split the registry by mission")
BAD_NAME = _message("C102", "'{name}' cannot be the name of {what}", "write it like {example}")
KEYWORD = _message(
    "C103", "'{name}' is a keyword of L and cannot be the name of {what}", "choose another name"
)
DUPLICATE = _message(
    "C104",
    "{what} '{name}' is also in {file}, line {line}",
    "keep one of them; only the registry of a mission may override",
)
REDEFINED = _message(
    "C105",
    "a mission cannot redefine {what} '{name}', which other missions use",
    "it is defined in {file}, line {line}; give the one of the mission another name",
)

STATED_AND_NOMINAL = _message(
    "C106", "'{name}' is both stated and nominal", "remove 'nominal', which is for usual values"
)
TOO_RARE = _message(
    "C107",
    "'{name}' is polled every {every} s, but its 'max_age' is {age} s",
    "poll it more often, or give the attribute a longer 'max_age'",
)

# --- C11x: the taxonomy ---------------------------------------------------------------------------------

NO_PARENT = _message("C110", "'{id}' has no parent: there is no term '{parent}'", "add the parent as well")
UNKNOWN_TERM = _message(
    "C111", "there is no term '{id}' in the taxonomy", "`lfield capabilities tree` shows it"
)
ALIAS_IN_USE = _message(
    "C112",
    "the alias '{alias}' is already the id or an alias of the term '{id}'",
    "remove this alias, or choose another one",
)
DEPRECATED_BY_DEPRECATED = _message(
    "C113", "'{id}' is deprecated and cannot replace another term", "name a term that is not deprecated"
)
TAXONOMY_VERSION = _message(
    "C114",
    "this needs version {expected} of the taxonomy, but this lfield has version {version}",
    "install a later lfield, or use only terms of version {version}",
)

# --- C12x: attributes, values, units --------------------------------------------------------------------

UNKNOWN_ATTRIBUTE = _message("C120", "there is no attribute '{name}'", "define it under 'attributes'")
BAD_VALUE = _message("C121", "'{name}' is {expected}, not {given}")
NOT_A_MEMBER = _message("C122", "'{value}' is not a value of '{name}'", "its values are {values}")
UNKNOWN_UNIT = _message("C123", "there is no unit '{unit}'")
OTHER_DIMENSION = _message(
    "C124", "'{given}' cannot be converted to '{expected}'", "they have different dimensions"
)
NO_UNIT_HERE = _message("C125", "only numbers have a unit, and {what} is {type}", "leave the unit out")
NOT_SI = _message(
    "C126", "the registry is in SI, and '{unit}' is not", "write '{si}' here; providers may use any unit"
)
VALUES_OF_NUMBER = _message(
    "C127", "only a set or a text can list its values, and '{name}' is {type}", "leave 'values' out"
)
RESERVED_ATTRIBUTE = _message(
    "C128", "'{name}' already has another meaning in conditions", "give the attribute another name"
)
BAD_LIVE = _message(
    "C129",
    "'{text}' is not a source of values",
    "write device.quantity, as in fc.battery or fc.position[0], or a portal that only queries, as in load()",
)

# --- C13x: primitives -----------------------------------------------------------------------------------

UNKNOWN_PRIMITIVE = _message("C130", "there is no primitive '{name}'", "define it under 'primitives'")
RESERVED_PORTAL = _message(
    "C131", "every offer already has a method '{name}'", "give the portal another name"
)
NO_PORTALS = _message("C132", "'{name}' cannot be called: it has no portals", "give it at least one")
RESERVED_TYPE = _message("C133", "'{name}' is a type of L", "give it another name")
TYPE_IN_USE = _message(
    "C134",
    "'{name}' is both a primitive and {what}; in L both would be the type {name}",
    "rename one of them",
)

# --- C14x: portals that are mapped ----------------------------------------------------------------------

NOT_ITS_PORTAL = _message("C140", "{primitive} has no portal '{name}'", "its portals are {portals}")
MISSING_PORTAL = _message(
    "C141", "{by} has no portal named {portals} to serve {serves}", "map it under 'portals'"
)
UNKNOWN_PARAMETER = _message(
    "C142", "'{name}' is not a parameter of {primitive}.{portal}", "its parameters are {parameters}"
)
WRONG_COUNT = _message("C143", "{target} takes {expected} arguments, not {given}", "it takes {parameters}")
WRONG_ARGUMENT = _message("C144", "argument {number} of {target} is {expected}, not {given}")
NOTHING_EMITTED = _message("C145", "{primitive}.{portal} emits nothing", "leave 'emit' out")
WRONG_RESULT = _message("C146", "{primitive}.{portal} emits {expected}, but this emits {given}", "add 'emit'")
BAD_ARGUMENT = _message(
    "C147",
    "{given} is not an argument",
    "write the name of a parameter, a number, true, false, {{parameter: x, unit: mm}} or {{constant: x}}",
)
WRONG_UNIT = _message(
    "C148",
    "{what} is in {expected}, but this is in {given}",
    "write {{parameter: x, unit: {expected}}}, or emit: {{unit: {given}}}; only a class in L converts arrays",
)

# --- C15x: rules ----------------------------------------------------------------------------------------

NEITHER_NOR = _message(
    "C150", "the rule '{name}' needs either 'by' or 'needs'", "'by' for one-to-one, 'needs' for one-to-many"
)
SERVES_ITSELF = _message("C151", "{primitive} needs no rule to serve {primitive}", "remove the rule")
CYCLE = _message(
    "C152",
    "this need leads back to the primitive that it is a part of: {path}",
    "remove one of these rules; only a direct need of the served primitive is allowed",
)
NO_SOURCE = _message("C153", "there is no file {path}", "paths are relative to the folder of this file")
BAD_EXPRESSION = _message("C154", "{problem}")
SAME_WAY = _message(
    "C155", "'{name}' and '{other}' would both be the field {way} of {primitive}", "rename one of them"
)
NO_CLASS = _message("C156", "{file} has no coordinator specific class '{name}'")
NO_METHOD = _message("C157", "class {name} lacks public methods of {primitive}", "it needs {signatures}")
NO_CONSTRUCTOR = _message("C158", "class {name} cannot be constructed from its parts", "it needs {signature}")
NUMBER_OF_NEEDS = _message(
    "C159",
    "a rule has from 1 to {most} needs, not {count}",
    "write a separate rule for some of the parts, and use its primitive as a part",
)

NOT_DISTINCT = _message("C180", "{problem}", "'distinct' is true, or a list of two parts or more: {parts}")

# --- C16x: agents ---------------------------------------------------------------------------------------

UNKNOWN_AGENT = _message("C160", "the deployment has no agent '{name}'", "its agents are {agents}")

# --- C17x: the program ----------------------------------------------------------------------------------

NO_TARGET = _message("C170", "resource {type} has no portal {missing}", "its portals are {portals}")
NO_OVERLOAD = _message(
    "C171", "no portal '{portal}' of {type} takes ({given})", "the overloads are {overloads}"
)
NO_DEVICE = _message("C172", "resource {type} has no device '{device}'", "its devices are {devices}")
NO_QUANTITY = _message(
    "C173", "{device}, a {device_type}, has no telemetry '{quantity}'", "it has {quantities}"
)
WRONG_QUANTITY = _message("C174", "'{attribute}' is {expected}, and {quantity} is {given}")
NO_TYPE = _message("C175", "the program has no resource type '{type}'", "a type of a library needs 'include'")
NO_LIBRARY = _message(
    "C176", "no driver provides a file '{path}'", "remove 'include' for a type of the mission's program"
)
NOT_IN_LIBRARY = _message("C177", "there is no resource type '{type}' in {path}")

LIVE_PORTAL = _message(
    "C178",
    "resource {type} has no portal {portal}() without parameters",
    "only such a portal can be the source of an attribute",
)
LIVE_ACTS = _message(
    "C179",
    "{type}.{portal}() has side effects, but a host calls it periodically",
    "the portal of a live attribute must command no device and change no field",
)

# --- C19x: warnings -------------------------------------------------------------------------------------

DEPRECATED_TERM = _message("C190", "the term '{id}' is deprecated", "write {instead}")
