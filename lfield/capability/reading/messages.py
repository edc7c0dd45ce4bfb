"""THE table of what the reader of the registry can say: code, sentence, hint.

Every finding about a registry is made by `Message.at`. C10x the files and names, C11x the taxonomy, C12x
attributes, values and units, C13x primitives, C14x portals that are mapped, C15x rules, C16x agents, C17x
the program the registry is used with, C19x warnings. What any YAML of lfield can have wrong (a key nobody
knows, a list where text is expected) is Y1xx and stands in yaml_source.py.
"""

from __future__ import annotations

from lfield.text.findings import Table

#: Every message by its code, in the order of the codes.
TABLE = Table(warnings="C19")
_message = TABLE.message


# --- C10x: files and names ------------------------------------------------------------------------------

VERSION = _message("C100", "this is not a registry of version 1", "begin the file with 'registry: 1'")
TOO_MANY = _message("C101", "more than {limit} {what}; the rest is not read", "split the registry by mission")
BAD_NAME = _message("C102", "'{name}' cannot be the name of {what}", "write it like {example}")
KEYWORD = _message("C103", "'{name}' is a word of L and cannot be the name of {what}", "take another name")
TWICE = _message(
    "C104", "{what} '{name}' stands in {file}, line {line}, too", "keep one of them; only a mission overrides"
)
REDEFINED = _message(
    "C105",
    "a mission cannot change what {what} '{name}' means to everybody else",
    "it is defined in {file}, line {line}; give yours another name",
)

STATED_AND_NOMINAL = _message(
    "C106", "'{name}' is stated and nominal at once", "leave out 'nominal', which is for what is only usual"
)
TOO_RARE = _message(
    "C107",
    "'{name}' is asked every {every} s and counts for {age} s",
    "ask it more often, or give the attribute a longer 'max_age'",
)

# --- C11x: the taxonomy ---------------------------------------------------------------------------------

NO_PARENT = _message("C110", "'{id}' has no parent: there is no term '{parent}'", "add the parent as well")
UNKNOWN_TERM = _message(
    "C111", "there is no term '{id}' in the taxonomy", "`lfield capabilities tree` shows it"
)
ALIAS_TAKEN = _message("C112", "'{alias}' already means the term '{id}'", "one id means one thing")
DEPRECATED_BY_DEPRECATED = _message(
    "C113", "'{id}' is out of use itself and cannot replace another term", "name the term that is in use"
)
TAXONOMY_VERSION = _message(
    "C114",
    "this needs version {wanted} of the taxonomy, and there is version {version}",
    "a later lfield has it; or write what the terms of version {version} can say",
)

# --- C12x: attributes, values, units --------------------------------------------------------------------

UNKNOWN_ATTRIBUTE = _message("C120", "there is no attribute '{name}'", "define it under 'attributes'")
BAD_VALUE = _message("C121", "'{name}' is {expected}, not {given}")
NOT_A_MEMBER = _message("C122", "'{value}' is no value of '{name}'", "its values are {values}")
UNKNOWN_UNIT = _message("C123", "there is no unit '{unit}'")
OTHER_DIMENSION = _message("C124", "'{given}' cannot be turned into '{wanted}'", "they measure other things")
NO_UNIT_HERE = _message("C125", "only numbers have a unit, and {what} is {type}", "leave the unit out")
NOT_SI = _message(
    "C126", "the registry is in SI, and '{unit}' is not", "write '{si}' here; providers may use any unit"
)
VALUES_OF_NUMBER = _message(
    "C127", "only a set or a text can list its values, and '{name}' is {type}", "leave 'values' out"
)
RESERVED_ATTRIBUTE = _message(
    "C128", "'{name}' means something else in conditions already", "give the attribute another name"
)
BAD_LIVE = _message(
    "C129",
    "'{text}' does not say where the value comes from",
    "write device.quantity, as in fc.battery or fc.position[0], or a portal that only queries, as in load()",
)

# --- C13x: primitives -----------------------------------------------------------------------------------

UNKNOWN_PRIMITIVE = _message("C130", "there is no primitive '{name}'", "define it under 'primitives'")
RESERVED_PORTAL = _message(
    "C131", "every offer has a method '{name}' of its own", "give the portal another name"
)
NO_PORTALS = _message("C132", "nobody can call '{name}': it has no portals", "give it at least one")
RESERVED_TYPE = _message("C133", "'{name}' is a type of L itself", "give it another name")
TYPE_TAKEN = _message(
    "C134",
    "'{name}' is a primitive and {what} at once; in L both would be the type {name}",
    "rename one of them",
)

# --- C14x: portals that are mapped ----------------------------------------------------------------------

NOT_ITS_PORTAL = _message("C140", "{primitive} has no portal '{name}'", "its portals are {portals}")
MISSING_PORTAL = _message(
    "C141", "{by} has nothing named {portals} that could serve {serves}", "map it under 'portals'"
)
UNKNOWN_PARAMETER = _message(
    "C142", "'{name}' is no parameter of {primitive}.{portal}", "its parameters are {parameters}"
)
WRONG_COUNT = _message("C143", "{target} takes {wanted} arguments, not {given}", "it takes {parameters}")
WRONG_ARGUMENT = _message("C144", "argument {number} of {target} is {wanted}, not {given}")
NOTHING_EMITTED = _message("C145", "{primitive}.{portal} emits nothing", "leave 'emit' out")
WRONG_RESULT = _message(
    "C146", "{primitive}.{portal} emits {wanted}, and this gives {given}", "say with 'emit' what it gives"
)
BAD_ARGUMENT = _message(
    "C147",
    "{given} is no argument",
    "write the name of a parameter, a number, true, false, {{parameter: x, unit: mm}} or {{constant: x}}",
)
WRONG_UNIT = _message(
    "C148",
    "{what} is in {wanted}, and this is in {given}",
    "write {{parameter: x, unit: {wanted}}}, or emit: {{unit: {given}}}; only a class in L converts arrays",
)

# --- C15x: rules ----------------------------------------------------------------------------------------

NEITHER_NOR = _message(
    "C150", "the rule '{name}' needs either 'by' or 'needs'", "'by' for one-to-one, 'needs' for one-to-many"
)
SERVES_ITSELF = _message("C151", "{primitive} serves {primitive} without any rule", "remove the rule")
CYCLE = _message(
    "C152",
    "this need leads back to what it is a part of: {path}",
    "remove one of these rules; a rule may only need just what it serves",
)
NO_SOURCE = _message("C153", "there is no file {path}", "paths are seen from the folder of this file")
BAD_EXPRESSION = _message("C154", "{problem}")
SAME_WAY = _message(
    "C155", "'{name}' and '{other}' would both be the field {way} of {primitive}", "rename one of them"
)
NO_CLASS = _message("C156", "{file} has no coordinator specific class '{name}'")
NO_METHOD = _message("C157", "class {name} lacks public methods of {primitive}", "it needs {signatures}")
NO_CONSTRUCTOR = _message("C158", "class {name} cannot be made of its parts", "it needs {signature}")
NUMBER_OF_NEEDS = _message(
    "C159",
    "a rule has from 1 to {most} needs, not {count}",
    "what is made of parts can be a part; write it as a rule of its own",
)

NOT_DISTINCT = _message("C180", "{problem}", "'distinct' is true, or a list of two parts or more: {parts}")

# --- C16x: agents ---------------------------------------------------------------------------------------

UNKNOWN_AGENT = _message("C160", "the deployment has no agent '{name}'", "its agents are {agents}")

# --- C17x: the program ----------------------------------------------------------------------------------

NO_TARGET = _message("C170", "resource {type} has no portal {missing}", "its portals are {portals}")
NO_OVERLOAD = _message(
    "C171", "no portal '{portal}' of {type} takes ({given})", "what it takes is {overloads}"
)
NO_DEVICE = _message("C172", "resource {type} has no device '{device}'", "its devices are {devices}")
NO_QUANTITY = _message(
    "C173", "{device}, a {device_type}, does not tell '{quantity}'", "it tells {quantities}"
)
WRONG_QUANTITY = _message("C174", "'{attribute}' is {wanted}, and {quantity} is {given}")
NO_TYPE = _message("C175", "the program has no resource type '{type}'", "a type of a library says 'include'")
NO_LIBRARY = _message(
    "C176", "no driver brings a file '{path}'", "leave 'include' out for a type of the mission's own"
)
NOT_IN_LIBRARY = _message("C177", "there is no resource type '{type}' in {path}")

LIVE_PORTAL = _message(
    "C178",
    "resource {type} has no portal {portal}() that takes nothing",
    "only such a portal can feed an attribute",
)
LIVE_ACTS = _message(
    "C179",
    "{type}.{portal}() may do more than query, and a host asks it by itself",
    "a portal that feeds an attribute commands no device and changes no field",
)

# --- C19x: warnings -------------------------------------------------------------------------------------

DEPRECATED_TERM = _message("C190", "the term '{id}' is out of use", "write {instead}")
