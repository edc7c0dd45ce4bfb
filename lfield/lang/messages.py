"""THE table of what the front end can say: code, sentence, hint.

Every diagnostic of the front end is made by `Message.at`, so codes, wording and documentation cannot drift
apart. L1xx lexical, L2xx syntax, L3xx names and declarations, L4xx types, L5xx scope rules (chapters III and
IV), L6xx files, L7xx deployments, L8xx together, within and reserve, L9xx warnings. A hint says what to do
instead.
"""

from __future__ import annotations

from lfield.text.findings import Table

#: Every message by its code, in the order of the codes.
TABLE = Table(warnings="L9")
_message = TABLE.message


# --- L1xx: characters and tokens ------------------------------------------------------------------------

ILLEGAL_CHARACTER = _message(
    "L101",
    "the character {character} has no meaning in L",
    "names are ASCII letters, digits and _; any other text stands in double quotes",
)
UNCLOSED_STRING = _message(
    "L102",
    "this text is not closed before the end of the line",
    'close it with "; a new line inside text is written \\n',
)
UNCLOSED_COMMENT = _message("L103", "this comment is never closed", "close it with */")
BAD_ESCAPE = _message(
    "L104",
    "{escape} is not an escape",
    'the escapes are \\n \\t \\r \\0 \\" \\\\ and \\u{{...}} with the number of a character in hex',
)
BAD_NUMBER = _message(
    "L105",
    "'{text}' is not a number",
    "write 12 or 1.5 or 1e3, with a digit on both sides of the point; names cannot begin with a digit",
)
NUMBER_RANGE = _message(
    "L106",
    "the number {text} does not fit into {type}",
    "int goes from -9223372036854775808 to 9223372036854775807, real up to about 1.8e308",
)
SINGLE_QUOTES = _message("L107", "text stands in straight double quotes", 'write "{text}"')
NOT_TEXT = _message(
    "L108",
    "the file holds a character that is not text ({character})",
    "save it as plain UTF-8 text; is it really an L program?",
)

# --- L2xx: syntax ---------------------------------------------------------------------------------------

EXPECTED_UNIT = _message(
    "L201",
    "expected resource, coordinator, class or include, found {found}",
    "everything in a program stands inside a resource, a coordinator or a class",
)
EXPECTED_MEMBER = _message(
    "L202",
    "expected a field, a method, init or a portal, found {found}",
    "statements stand inside a method, a portal or init",
)
EXPECTED_NAME = _message("L203", "expected {what}, found {found}")
RESERVED_NAME = _message("L204", "'{word}' is a word of the language, not a name", "choose another name")
EXPECTED_EXPRESSION = _message("L205", "expected an expression, found {found}")
EXPECTED_SYMBOL = _message("L206", "expected {what}, found {found}")
MISSING_SEMICOLON = _message("L207", "missing ; after this", "every statement and field ends with ;")
MISSING_CLOSE = _message("L208", "missing {symbol} after this", "the {opening} is on line {line}")
UNCLOSED_BRACE = _message("L209", "this {{ is never closed", "add the missing }}")
EXTRA_BRACE = _message("L210", "this }} closes nothing", "remove it, or look for a }} too many above it")
TOO_DEEP = _message(
    "L211", "this is nested more than {limit} levels deep", "move the inner part into a method of its own"
)
ELSE_WITHOUT_IF = _message(
    "L212", "else without an if before it", "an if takes one statement or a block in {{ }}"
)
CATCH_WITHOUT_TRY = _message(
    "L213",
    "catch without a try before it",
    "write try {{ ... }} catch (Exception e) {{ ... }}; finally stands behind the last catch",
)
TRY_WITHOUT_CATCH = _message(
    "L214",
    "try without a catch or finally",
    "add catch (Exception e) {{ ... }} or finally {{ ... }} after it",
)
MISSING_MODIFIER = _message("L215", "{what} begins with public or private", "write: private {text}")
UNWANTED_MODIFIER = _message("L216", "{what} does not begin with '{word}'", "leave it out{reason}")
FOREIGN_WORD = _message("L217", "L has no '{word}'", "{instead}")
FOREIGN_OPERATOR = _message("L218", "L has no operator {operator}", "{instead}")
NO_TERNARY = _message("L219", "L has no ? : expression", "write if (...) x = a; else x = b;")
CAST = _message(
    "L220",
    "a type cannot stand inside an expression",
    "L converts with functions: i2f, f2i, i2s, f2s, b2s, s2i, s2f",
)
ARRAY_LENGTH_MISSING = _message(
    "L221", "a new array needs its length or its elements", "write new {type}[10] or new {type}[] {{a, b}}"
)
NEW_NEEDS = _message(
    "L222", "after new {type} come arguments or a length", "write new {type}(...) or new {type}[10]"
)
ONE_VARIABLE = _message("L223", "a declaration declares one variable", "write two: int a; int b;")
ARRAY_STYLE = _message("L224", "the [] belongs to the type", "write {type}[] {name}")
NEEDS_BODY = _message("L225", "{what} needs a body", "write {{ ... }} after it")
LOOP_ONLY = _message("L226", "'{word}' outside a loop", "it leaves or continues the innermost while or for")
INIT_CALLED = _message(
    "L227", "init cannot be called", "the machine calls it once; move the code into a method"
)
MISSPELT_KEYWORD = _message("L229", "'{word}' is no word of the language", "did you mean '{close}'?")
VOID_VALUE_TYPE = _message(
    "L230", "void is no type for {what}", "void is only the result of a method without a value"
)
NOT_A_CALL = _message("L231", "only a name can be called", "write name(...) or object.name(...)")
FINALLY_WITHOUT_TRY = _message(
    "L232", "finally without a try before it", "write try {{ ... }} finally {{ ... }}"
)
LEAVES_FINALLY = _message(
    "L233",
    "'{word}' would leave this finally, and an exception or a result on its way would be lost",
    "set a variable in the finally, and write the {word} behind the try",
)

# --- L3xx: names and declarations -----------------------------------------------------------------------

UNKNOWN_NAME = _message("L301", "there is no variable '{name}' here", "declare it first: int {name};")
UNKNOWN_TYPE = _message(
    "L302",
    "there is no type '{name}'",
    "declare class {name} {{ ... }}, include its file, or install the driver of that device type",
)
UNKNOWN_FUNCTION = _message(
    "L303",
    "there is no method or function '{name}' here",
    "own methods and library functions are called by their name alone, others as object.{name}(...)",
)
UNKNOWN_FIELD = _message("L304", "{type} has no field '{name}'", "{known}")
UNKNOWN_METHOD = _message("L305", "{type} has no {kind} '{name}'", "{known}")
LOCAL_TWICE = _message("L306", "'{name}' is declared on line {line} already", "choose another name")
UNIT_TWICE = _message(
    "L307", "'{name}' is declared in {place} already", "units have different names; rename one"
)
NAME_TAKEN = _message("L308", "'{name}' is {what} already", "choose another name for this {kind}")
FIELD_TWICE = _message(
    "L309", "the field '{name}' is declared on line {line} already", "rename or remove one"
)
SAME_SIGNATURE = _message(
    "L310",
    "{signature} is declared on line {line} already",
    "overloads differ in the types of their parameters; result and parameter names do not count",
)
NO_INIT = _message("L311", "{unit} has no init", "add: init(string[] arg) {{ ... }}")
INIT_TWICE = _message(
    "L312", "init is declared on line {line} already", "merge the two; init is not overloadable"
)
INIT_SHAPE = _message("L313", "init takes exactly one string[]", "write: init(string[] arg) {{ ... }}")
INIT_IN_CLASS = _message("L314", "a class has constructors, not init", "write: public {name}(...) {{ ... }}")
METHOD_NAME_TAKEN = _message("L315", "'{name}' is {what}", "choose another name for this method")
TYPE_AS_VALUE = _message("L316", "'{name}' is a type, not a variable", "{instead}")
CALL_WITHOUT_PARENTHESES = _message("L317", "'{name}' is a method", "call it: {call}")
CONSTRUCTOR_NAME = _message(
    "L318", "this method has no result type", "write void {name}(...); a constructor is named like its class"
)
NOT_A_METHOD = _message("L319", "'{name}' is a variable, not a method", "remove the ( )")

# --- L4xx: types ----------------------------------------------------------------------------------------

MISMATCH = _message("L401", "{wanted} expected, this is {given}")
CONDITION = _message(
    "L402", "a condition is boolean, this is {given}", "compare it with something, as in x != 0"
)
RETURN_MISMATCH = _message("L403", "{method} returns {wanted}, this is {given}")
RETURN_NOTHING = _message("L404", "{method} returns no value", "write return; or give it a result type")
RETURN_SOMETHING = _message("L405", "{method} must return {wanted}", "write return with a value after it")
OPERANDS = _message("L406", "{operator} does not work on {left} and {right}")
OPERAND = _message("L407", "{operator} does not work on {given}")
INCOMPARABLE = _message("L408", "{left} and {right} cannot be compared")
VOID_VALUE = _message("L409", "{call} gives no value", "call it as a statement of its own")
NOT_AN_ARRAY = _message("L410", "only arrays are indexed, this is {given}")
NOT_ASSIGNABLE = _message(
    "L411", "this cannot be assigned to", "what is assigned to is a variable, a field or an element"
)
ASSIGNMENT_HERE = _message(
    "L412", "an assignment cannot stand here", "did you mean == ? An assignment is a statement of its own"
)
NO_EFFECT = _message(
    "L413", "this does nothing as a statement", "call something or assign the value: x = ...;"
)
ARGUMENT_COUNT = _message("L414", "{signature} takes {wanted}, {given} given")
ARGUMENT_TYPE = _message("L415", "argument {number} of {signature} is {wanted}, this is {given}")
NO_OVERLOAD = _message("L416", "no {name} takes ({given})", "there are {candidates}")
AMBIGUOUS = _message("L417", "{name}({given}) fits several equally well", "they are {candidates}")
THROW_TYPE = _message(
    "L418", "only objects can be thrown, this is {given}", 'write throw new Exception("what went wrong");'
)
CATCH_TYPE = _message("L419", "only classes can be caught, {given} is none", "catch (Exception e) takes any")
NO_MEMBERS = _message("L420", "{given} has no members", "only objects, arrays, strings and proxies have them")
NEW_TYPE = _message(
    "L421", "{given} has no constructor", "new makes objects of classes and arrays: new {given}[10]"
)
EACH_ARRAY = _message("L423", "for goes through an array, this is {given}")
EACH_ELEMENT = _message(
    "L424", "the array holds {given}, the variable is {wanted}", "declare the variable with that type"
)
ELEMENTS = _message("L425", "{{ }} makes an array, {wanted} expected")
ELEMENTS_TYPE = _message(
    "L426", "it is not known what array this is", "write its type before the elements: new int[] {{1, 2}}"
)
CONSTRAINT = _message("L422", "{problem}")

# --- L5xx: scope rules ----------------------------------------------------------------------------------

RESOURCE_NAMES_RESOURCE = _message(
    "L501",
    "{viewer} cannot name the resource '{name}'",
    "resources know nothing of each other; let a coordinator carry values between them",
)
RESOURCE_NAMES_COORDINATOR = _message(
    "L502",
    "{viewer} cannot name the coordinator '{name}'",
    "offer a portal; the coordinator comes and calls it",
)
COORDINATOR_NAMES_COORDINATOR = _message(
    "L503",
    "{viewer} cannot name the coordinator '{name}'",
    "coordinators meet only in resources: leave the value in one portal, fetch it from another",
)
COORDINATOR_NAMES_DEVICE = _message(
    "L504",
    "{viewer} cannot have the device type '{name}'",
    "put the device into a resource and call a portal of that resource",
)
COORDINATOR_IO = _message(
    "L505",
    "{viewer} cannot call {name}: a coordinator does no I/O",
    "use print(...), which goes to the log of the host, or a portal of a resource",
)
ONLY_PORTALS = _message(
    "L506",
    "'{name}' is a method inside the resource {resource}; through a proxy only portals can be called",
    "write a portal in {resource} that calls it",
)
PROXY_FIELD = _message(
    "L507",
    "'{name}' cannot be reached: a proxy has no fields",
    "write a portal in {resource} that emits or sets it, and call that",
)
PORTAL_INSIDE = _message(
    "L508",
    "'{name}' is a portal; only coordinators call portals, through a proxy",
    "move its work into a private method and call that here and in the portal",
)
PORTAL_PROXY = _message(
    "L509",
    "{type} cannot pass through a portal: it is or holds a proxy",
    "pass the id (a string); the coordinator finds the resource by it",
)
PORTAL_RESOURCE_CLASS = _message(
    "L510",
    "{type} cannot pass through a portal: it is resource specific",
    "copy what the coordinator needs into an object of a class without a usage clause",
)
PORTAL_EXCEPTION = _message(
    "L511",
    "{type} cannot pass through a portal: {why}",
    "throw the exception, or pass its message() as a string",
)
DEVICE_PLACE = _message(
    "L512",
    "the device type '{name}' stands only at a field of a resource, or of a class that is given it",
    "declare {name} fc; in the resource; a resource specific class gets it by its constructor",
)
DEVICE_USE = _message(
    "L513", "the device '{name}' is not a value", "call its instructions: {name}.{instruction}(...)"
)
GLOBAL_NAMES_RESOURCE = _message(
    "L514",
    "{viewer} cannot name the resource '{name}'",
    "declare it class {unit} coordinator specific {{ ... }}, or keep only the id of the resource",
)
GLOBAL_NAMES_COORDINATOR = _message(
    "L515",
    "{viewer} cannot name the coordinator '{name}'",
    "nothing holds a coordinator; give the class the values it needs",
)
GLOBAL_IO = _message(
    "L516",
    "{viewer} cannot call {name}: it may run in a coordinator",
    "declare it class {unit} resource specific {{ ... }}, or return the text and write it in a resource",
)
GLOBAL_NAMES_SPECIFIC = _message(
    "L517",
    "{viewer} cannot name '{name}', which is {usage} specific",
    "declare it class {unit} {usage} specific {{ ... }} too, or remove the clause from {name}",
)
RESOURCE_CLASS_OUTSIDE = _message(
    "L518",
    "{viewer} cannot name '{name}', which is resource specific",
    "use a class without a usage clause for what coordinators and resources share",
)
COORDINATOR_CLASS_OUTSIDE = _message(
    "L519",
    "{viewer} cannot name '{name}', which is coordinator specific",
    "use a class without a usage clause for what coordinators and resources share",
)
NEW_AGENT = _message(
    "L520", "the {kind} '{name}' cannot be made with new", "the deployment says which ones there are{find}"
)
PORTAL_PLACE = _message("L521", "{unit} cannot have portals", "only resources have them; write a method")
PRIVATE_MEMBER = _message(
    "L522", "'{name}' is private in {owner}", "declare it public, or add a public method to {owner}"
)
FIND_PLACE = _message(
    "L523",
    "{viewer} cannot find {what}",
    "only coordinators and coordinator specific classes do; pass the result in as a value",
)
COORDINATOR_FUNCTION = _message(
    "L524",
    "{viewer} cannot call {name}: only coordinators migrate and are recovered",
    "call it in the coordinator or a coordinator specific class; pass a result on as a value",
)
THIS_VALUE = _message(
    "L525", "'this' of {unit} is not a value", "use it to reach its own members: this.name or this.method()"
)
DEVICE_THROWN = _message(
    "L527",
    "{type} is no exception: it has the device '{device}', which stays with its resource",
    "throw an object that says what went wrong",
)
CAPABILITY_OUTSIDE = _message(
    "L526",
    "{viewer} cannot name the capability '{name}'",
    "capabilities belong to coordinators, which find offers and call them; a resource just has portals",
)

# --- L6xx: files ----------------------------------------------------------------------------------------

INCLUDE_MISSING = _message(
    "L601", "there is no file {path}", "the path is relative to the file with the include"
)
INCLUDE_UNREADABLE = _message("L602", "cannot read {path}: {reason}", "check the path and its permissions")
INCLUDE_UNKNOWN = _message(
    "L603",
    "no installed package has the include <{path}>",
    'install the driver it comes with; files of your own are included as "file.L"',
)
INCLUDE_SYNTAX = _message(
    "L604", "an include names one file", 'write include "file.L"; or include <name/file.L>;'
)
NOT_UTF8 = _message("L605", "the file is not UTF-8 here (byte {byte})", "save it as UTF-8 text")

# --- L7xx: deployments ----------------------------------------------------------------------------------

DEPLOY_SYNTAX = _message(
    "L701",
    "{problem}",
    "a line is //Type:id@host or //Type:id@host:port?argument&argument, or //@host for one without agents",
)
DEPLOY_TYPE = _message("L702", "the program has no resource or coordinator '{name}'", "it has {known}")
DEPLOY_CLASS = _message(
    "L703", "'{name}' is a class", "only resources and coordinators are deployed: {known}"
)
DEPLOY_ID = _message("L704", "the id '{id}' is not good", "an id is letters, digits, '.', '_' and '-'")
DEPLOY_DUPLICATE = _message(
    "L705", "the id '{id}' is on line {line} already", "ids are unique over the whole deployment"
)
DEPLOY_HOST = _message(
    "L706",
    "the host '{host}' is not good",
    "a host is a name or an address of letters, digits, '.', '_' and '-', at most 253 of them, or [::1]",
)
DEPLOY_PORT = _message("L707", "the port '{port}' is not good", "a port is a number from 1 to 65535")
DEPLOY_TWO_PORTS = _message(
    "L708", "{host} has port {first} on line {line}, here {port}", "one host runs one machine: use one port"
)
DEPLOY_HOST_CASE = _message(
    "L709",
    "'{host}' is written '{first}' on line {line}",
    "host names do not tell upper case from lower: write one",
)
DEPLOY_ESCAPE = _message(
    "L710",
    "'{escape}' is not a percent escape of UTF-8 text",
    "write %25 for %, %26 for &, %23 for #, %20 for a space",
)
DEPLOY_SPACE = _message("L711", "a space inside a line", "write %20 in an argument; a comment begins with #")
DEPLOY_EMPTY = _message("L712", "the deployment is empty", "write one line //Type:id@host for every agent")
DEPLOY_NO_PROGRAM = _message(
    "L713",
    "the program has no resources and no coordinators, so there is no '{name}' to deploy",
    "is this deployment beside its own program?",
)
DEPLOY_NOT_TEXT = _message(
    "L714", "the deployment is not UTF-8 text here (byte {byte})", "save it as UTF-8 text"
)
DEPLOY_WITNESS = _message(
    "L715", "{host} is on line {line} already", "a line without an agent is for a host that has no other line"
)

# --- L8xx: together, within and reserve -----------------------------------------------------------------

COORDINATOR_WORD = _message(
    "L801",
    "{viewer} cannot have '{word}'",
    "declare it class {unit} coordinator specific {{ ... }}: only coordinators call portals",
)
TOGETHER_EMPTY = _message(
    "L802",
    "this together begins no portal call",
    "write the calls into it, alone or as x = arm.lift(1.5); those of methods that it calls do not count",
)
TOGETHER_INSIDE = _message(
    "L803",
    "this portal call is part of something else, and the together has its result only at its end",
    "write it alone or as x = ...; with a variable declared before the block, and use x after it",
)
TOGETHER_BARRED = _message(
    "L804",
    "a portal call of the together stands inside a {word} in it",
    "put the {word} around the together, or give it a together of its own",
)
TOGETHER_DECLARED = _message(
    "L805",
    "'{name}' is declared inside the together, which gives it its value only at its end",
    "declare it before the block: {type} {name};",
)
TOGETHER_TARGET = _message(
    "L806",
    "a call of a together is assigned to a local variable or an element of a local array",
    "take a local one, declared before the block, and copy it after the block",
)
TOGETHER_TWICE = _message(
    "L807",
    "'{name}' is assigned by the call on line {line} of this together already",
    "take a variable for each call, and choose after the block",
)
TOGETHER_LOOP = _message(
    "L808",
    "'{name}' would be assigned in every round, and all calls of a together are under way at one time",
    "take an array with an element for each round, or put the loop around the together",
)
TOGETHER_USED = _message(
    "L809", "'{name}' is assigned by this together, at its end", "use it before or after the block"
)
TOGETHER_ALIAS = _message(
    "L810",
    "'{name}' may share its elements with '{array}', which this together assigns at its end",
    "use it before or after the block; only its length may be asked inside",
)
TOGETHER_TYPE = _message(
    "L811",
    "the call gives {given}, the variable is {wanted}",
    "in a together the two are the same: take {given}, and convert after the block",
)
WITHIN_OVER = _message(
    "L812", "a within lasts more than 0 seconds, this is {given}", "write within (30) {{ ... }}"
)
RESERVE_TYPE = _message(
    "L813",
    "a reserve keeps a resource, an offer, or an array of them, and this is {given}",
    "write reserve (arm) {{ ... }} or reserve (offers[0]) {{ ... }}",
)
RESERVE_INSIDE = _message(
    "L814",
    "a reserve stands inside a together, whose calls begin and end without regard to it",
    "put the reserve around the together",
)

# --- L9xx: warnings -------------------------------------------------------------------------------------

FALLS_OFF = _message(
    "L901",
    "{method} can end without a return",
    "it then throws MissingReturnException; write a return or a throw at its end",
)
UNREACHABLE = _message("L902", "this statement is never reached", "remove it, or the {cause} before it")
UNREACHABLE_CATCH = _message(
    "L903", "this catch is never reached: {earlier} above takes it", "put catches of special classes first"
)
LOSING_FINALLY = _message(
    "L904",
    "this finally never comes to its end: what the try returns or throws is lost",
    "let the {cause} stand behind the try",
)
LIMIT_PASSES = _message(
    "L905",
    "this catch does not take the end of the within around it",
    "put the try around the within",
)
