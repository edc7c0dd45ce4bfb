"""Diagnostics of the front end: code, sentence and hint of each.

`FindingKind.at` creates them; the language page is generated from this table. L1xx lexical, L2xx syntax,
L3xx names and declarations, L4xx types, L5xx scope rules (chapters III and IV), L6xx files, L7xx deployments,
L8xx together, within and reserve, L9xx warnings.
"""

from __future__ import annotations

from lfield.text.message_tables import FindingTable

#: Every message by its code, in the order of the codes.
TABLE = FindingTable(warnings="L9")
_message = TABLE.message


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
    "methods of this unit and library functions are called by name alone, others as object.{name}(...)",
)
UNKNOWN_FIELD = _message("L304", "{type} has no field '{name}'", "{known}")
UNKNOWN_METHOD = _message("L305", "{type} has no {kind} '{name}'", "{known}")
DUPLICATE_LOCAL = _message("L306", "'{name}' is already declared on line {line}", "choose another name")
DUPLICATE_UNIT = _message(
    "L307", "'{name}' is already declared in {place}", "names at the top level are unique: rename one"
)
NAME_IN_USE = _message("L308", "'{name}' is already {what}", "choose another name for this {kind}")
DUPLICATE_FIELD = _message(
    "L309", "the field '{name}' is already declared on line {line}", "rename or remove one"
)
SAME_SIGNATURE = _message(
    "L310",
    "{signature} is already declared on line {line}",
    "overloads differ in the types of their parameters; result and parameter names do not count",
)
NO_INIT = _message("L311", "{unit} has no init", "add: init(string[] arg) {{ ... }}")
DUPLICATE_INIT = _message(
    "L312", "init is already declared on line {line}", "merge the two; init is not overloadable"
)
INIT_SHAPE = _message(
    "L313", "init takes exactly one parameter string[]", "write: init(string[] arg) {{ ... }}"
)
INIT_IN_CLASS = _message("L314", "a class has constructors, not init", "write: public {name}(...) {{ ... }}")
METHOD_NAME_IN_USE = _message("L315", "'{name}' is {what}", "choose another name for this method")
TYPE_AS_VALUE = _message("L316", "'{name}' is a type, not a variable", "{instead}")
CALL_WITHOUT_PARENTHESES = _message("L317", "'{name}' is a method", "call it: {call}")
CONSTRUCTOR_NAME = _message(
    "L318", "this method has no result type", "write void {name}(...); a constructor is named like its class"
)
NOT_A_METHOD = _message("L319", "'{name}' is a variable, not a method", "remove the ( )")
CONSTANT_CYCLE = _message(
    "L320", "the value of '{name}' depends on itself: {path}", "write one of these values as a literal"
)
DUPLICATE_MEMBER = _message(
    "L321", "the member '{name}' is already declared on line {line}", "rename or remove one"
)
UNKNOWN_MEMBER = _message("L322", "the enum {enum} has no member '{name}'", "{known}")

# --- L4xx: types ----------------------------------------------------------------------------------------

MISMATCH = _message("L401", "{expected} expected, this is {given}")
CONDITION = _message(
    "L402", "a condition is boolean, this is {given}", "compare it with something, as in x != 0"
)
RETURN_MISMATCH = _message("L403", "{method} returns {expected}, this is {given}")
RETURN_NOTHING = _message("L404", "{method} returns no value", "write return; or give it a result type")
RETURN_SOMETHING = _message("L405", "{method} must return {expected}", "write return with a value after it")
OPERANDS = _message("L406", "{operator} does not work on {left} and {right}")
OPERAND = _message("L407", "{operator} does not work on {given}")
INCOMPARABLE = _message("L408", "{left} and {right} cannot be compared")
VOID_VALUE = _message("L409", "{call} returns no value", "call it as a separate statement")
NOT_AN_ARRAY = _message("L410", "only arrays and maps are indexed, this is {given}")
NOT_ASSIGNABLE = _message("L411", "this cannot be assigned to", "assign to a variable, a field or an element")
ASSIGNMENT_HERE = _message(
    "L412", "an assignment is not allowed here", "did you mean == ? An assignment is a separate statement"
)
NO_EFFECT = _message("L413", "this statement has no effect", "call something or assign the value: x = ...;")
ARGUMENT_COUNT = _message("L414", "{signature} takes {expected}, {given} given")
ARGUMENT_TYPE = _message("L415", "argument {number} of {signature} is {expected}, this is {given}")
NO_OVERLOAD = _message("L416", "no {name} takes ({given})", "the candidates are {candidates}")
AMBIGUOUS = _message("L417", "{name}({given}) is ambiguous", "the candidates are {candidates}")
THROW_TYPE = _message(
    "L418", "only objects can be thrown, this is {given}", 'write throw new Exception("reason");'
)
CATCH_TYPE = _message(
    "L419", "only classes can be caught, {given} is not a class", "catch (Exception e) catches all"
)
NO_MEMBERS = _message("L420", "{given} has no members", "only objects, arrays, strings and proxies have them")
NEW_TYPE = _message(
    "L421", "{given} has no constructor", "new creates objects of classes, and arrays: new {given}[10]"
)
EACH_ARRAY = _message("L423", "for iterates over an array or a map, this is {given}")
EACH_ELEMENT = _message(
    "L424", "the elements are {given}, the variable is {expected}", "declare the variable with that type"
)
ELEMENTS = _message("L425", "{{ }} is an array, {expected} expected")
ELEMENTS_TYPE = _message(
    "L426", "the type of this array is unknown", "write its type before the elements: new int[] {{1, 2}}"
)
CONSTRAINT = _message("L422", "{problem}")
EMPTY_CONDITION = _message(
    "L427",
    "the condition of {name} is empty",
    'write {name}({rest}) without a condition, or a condition as in {name}("payload >= 2.0"{more})',
)
EMPTY_ID = _message(
    "L428",
    "the id in {name} is empty",
    "write the id of an agent of the deployment; {name}() returns an array of all",
)

SORT_ORDER = _message(
    "L429",
    "sort() does not know the order of {type}",
    "name a method of this unit that compares two elements or gives a key: a.sort(nearer), with boolean "
    "nearer({element} a, {element} b) or real distance({element} a)",
)
SORT_ARGUMENT = _message(
    "L430",
    "sort takes nothing, or the name of a method",
    "write a.sort(), or a.sort(nearer) with a method of this unit",
)
SORT_METHOD = _message(
    "L431",
    "sort cannot compare elements by '{name}': {found}",
    "write boolean {name}({element} a, {element} b), whether a comes before b, or a key: int, real or string "
    "{name}({element} a)",
)
MAP_TYPES = _message(
    "L432",
    "a map has two types, of its keys and of its values",
    "write map<string, int>, or another value type",
)
MAP_KEY = _message(
    "L433",
    "the keys of a map are string, int or an enum, not {given}",
    "use an id or a number of it as the key, and the object as the value",
)
NOT_CONSTANT = _message(
    "L434",
    "the value of the constant '{name}' must be known before the program runs",
    "write literals, other constants and members of enums, joined by operators",
)
CONSTANT_TYPE = _message(
    "L435", "a constant cannot be {given}", "constants are boolean, int, real, string or of an enum"
)
CONSTANT_VALUE = _message("L436", "the value of the constant '{name}' is {problem}", "{hint}")
IMPURE = _message(
    "L437",
    "the function '{function}' {what}",
    "a function computes its result from its arguments alone; write a method of the unit for the rest",
)
CHANGES_ARGUMENT = _message(
    "L438",
    "the function '{function}' would change {what}, which its caller has",
    "change a copy: a.slice(0, a.length()), or a new array",
)
NO_THIS = _message("L439", "the function '{function}' has no this", "pass what it needs as a parameter")
ENUM_NAME = _message("L440", "'{name}' is an enum, not a value", "write one of its members: {name}.{member}")
PARAMETER_TYPE = _message(
    "L441",
    "a query cannot have {given}",
    "its parameters are numbers, text, true or false, and members of enums",
)
QUOTED_PARAMETER = _message(
    "L442",
    "'${name}' within quotes is text, not the value of '{name}'",
    "leave the quotes out: the value of a string variable is text already",
)
COMPUTED_QUERY = _message(
    "L443",
    "'${name}' is in a text that is not known before the program runs",
    "write the query as one literal, or as a sum of literals and constants",
)

LOOP_PLACE = _message(
    "L470",
    "{unit} cannot have a loop",
    "only resources have loops; a coordinator enables one through a portal of its resource",
)
LOOP_RATE = _message(
    "L471",
    "the loop '{name}' has no rate",
    "write loop {name} at 10.0 {{ ... }}, in hertz, or loop {name} every 0.1 {{ ... }}, in seconds; priority "
    "and when follow",
)
LOOP_PERIOD = _message(
    "L472",
    "the period of a loop is {given}: it must be from 0.001 s to 1000 s",
    "at is followed by hertz, every by seconds",
)
LOOP_PRIORITY = _message(
    "L473",
    "the priority of a loop is a whole number",
    "write priority 2, a constant: a loop suppresses those with lower numbers; portals have 0",
)
LOOP_UNCONDITIONAL = _message(
    "L474",
    "the loop '{name}' has no `when`, so {lower} with a lower priority can never run",
    "add when (condition), or give it the lowest priority",
)
LOOP_NAME = _message("L475", "'{name}' is a field already (line {line})", "choose another name for the loop")
LOOP_MEMBER = _message("L476", "a loop has no method '{name}'", "it has running() and overruns()")
LOOP_VALUE = _message(
    "L477", "the loop '{name}' is not a value", "call its methods: {name}.running() and {name}.overruns()"
)
LOOP_CALL = _message(
    "L478",
    "the loop '{name}' cannot be called",
    "its thread calls it at each tick; move the code into a method that both can call",
)
TOO_MANY_LOOPS = _message(
    "L479", "a resource has at most {limit} loops", "put what has the same rate into one loop"
)

LIMIT_OVER = _message(
    "L460",
    "the limit of {name} must be more than 0 seconds, this is {given}",
    "write how long it waits at most, as in {example}; after that it throws TimeLimitException",
)

ASYNC_CALL = _message(
    "L450",
    "async begins the call of a portal, and this is none",
    "call a portal of a proxy or of an offer: async arm.lift(1.5); other methods are called without async",
)
ASYNC_TOGETHER = _message(
    "L451",
    "a together begins its calls itself",
    "leave async out, or begin the call before the block",
)
FUTURE_DROPPED = _message(
    "L452",
    "the future of this call is not kept, so its result and its failure would be lost",
    "write {type} f = {call}; and f.await() later; without async the call is awaited here",
)
RACE_EMPTY = _message(
    "L453",
    "this array has no futures, so {name} has nothing to wait for",
    "add calls first: futures.append(async arm.lift(1.5));",
)
FUTURE_TWICE = _message(
    "L454",
    "the future '{name}' is twice in this array",
    "write each future once, or begin a second call: async arm.lift(1.5)",
)
RACE_ARGUMENT = _message(
    "L455",
    "{name} has {argument}",
    "futures.race(), futures.race(enough) with a method boolean enough(real result), futures.next()",
)
RACE_METHOD = _message(
    "L456",
    "race needs a method that has a {of} and returns boolean; {found}",
    "write private boolean {name}({of} result) {{ ... }} in this unit: whether a result wins",
)
FUTURE_TYPE = _message(
    "L457",
    "the type of a future has one type: that of the result",
    "write future<real>, or future<void> for a call without a result",
)
FUTURE_NEW = _message(
    "L458", "a {type} is not created with new", "begin a call: {type} f = async arm.lift(1.5);"
)

# --- L5xx: scope rules ----------------------------------------------------------------------------------

RESOURCE_NAMES_RESOURCE = _message(
    "L501",
    "{viewer} cannot name the resource '{name}'",
    "a resource cannot refer to another one; a coordinator carries values between them",
)
RESOURCE_NAMES_COORDINATOR = _message(
    "L502",
    "{viewer} cannot name the coordinator '{name}'",
    "declare a portal; the coordinator calls it",
)
COORDINATOR_NAMES_COORDINATOR = _message(
    "L503",
    "{viewer} cannot name the coordinator '{name}'",
    "coordinators exchange values through resources: write to one portal, read from another",
)
COORDINATOR_NAMES_DEVICE = _message(
    "L504",
    "{viewer} cannot have the device type '{name}'",
    "put the device into a resource and call a portal of that resource",
)
COORDINATOR_IO = _message(
    "L505",
    "{viewer} cannot call {name}: a coordinator does no I/O",
    "use print(...), which writes to the host's log, or a portal of a resource",
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
    "move its code into a private method and call that here and in the portal",
)
PORTAL_PROXY = _message(
    "L509",
    "{type} cannot pass through a portal: it is or holds a proxy",
    "pass the id (a string), with which the coordinator finds the resource",
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
    "the device type '{name}' is only for fields of a resource or of a resource specific class",
    "declare {name} fc; in the resource; a resource specific class receives it in its constructor",
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
    "a coordinator is not a value; pass the values that the class needs",
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
    "use a class without a usage clause for data that coordinators and resources share",
)
COORDINATOR_CLASS_OUTSIDE = _message(
    "L519",
    "{viewer} cannot name '{name}', which is coordinator specific",
    "use a class without a usage clause for data that coordinators and resources share",
)
NEW_AGENT = _message(
    "L520", "the {kind} '{name}' cannot be created with new", "the deployment defines its instances{find}"
)
PORTAL_PLACE = _message("L521", "{unit} cannot have portals", "only resources have them; write a method")
PRIVATE_MEMBER = _message(
    "L522", "'{name}' is private in {owner}", "declare it public, or add a public method to {owner}"
)
FIND_PLACE = _message(
    "L523",
    "{viewer} cannot find {what}",
    "only coordinators and coordinator specific classes can; pass the result as a value",
)
COORDINATOR_FUNCTION = _message(
    "L524",
    "{viewer} cannot call {name}: only coordinators migrate and are recovered",
    "call it in the coordinator or a coordinator specific class; pass a result on as a value",
)
THIS_VALUE = _message(
    "L525", "'this' of {unit} is not a value", "use it only for members: this.name or this.method()"
)
DEVICE_THROWN = _message(
    "L527",
    "{type} cannot be thrown: its device '{device}' stays with its resource",
    "throw an object that describes the error",
)
CAPABILITY_OUTSIDE = _message(
    "L526",
    "{viewer} cannot name the capability '{name}'",
    "only coordinators find and call offers of a capability; a resource has portals",
)
FUTURE_PORTAL = _message(
    "L528",
    "a {type} cannot pass through a portal: its call belongs to the coordinator that began it",
    "pass the result: f.await()",
)
ASYNC_PLACE = _message(
    "L529", "{viewer} cannot begin calls", "offer portals; a coordinator begins calls of several resources"
)
WAIT_PLACE = _message(
    "L530",
    "wait until leaves the monitor, and {method} of {viewer} does not hold it",
    "write it in a synchronized portal or method of a resource or of a resource specific class",
)
WAIT_SECONDS = _message(
    "L531",
    "the time of a wait until must be more than 0 seconds, this is {given}",
    "write wait until (...) within (5.0);",
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
DEPLOY_ID = _message(
    "L704", "the id '{id}' is not valid", "an id consists of letters, digits, '.', '_' and '-'"
)
DEPLOY_DUPLICATE = _message(
    "L705", "the id '{id}' is already used on line {line}", "ids are unique in a deployment"
)
DEPLOY_HOST = _message(
    "L706",
    "the host '{host}' is not valid",
    "a host is a name or an address of letters, digits, '.', '_' and '-', at most 253 of them, or [::1]",
)
DEPLOY_PORT = _message("L707", "the port '{port}' is not valid", "a port is a number from 1 to 65535")
DEPLOY_TWO_PORTS = _message(
    "L708",
    "{host} has port {first} on line {line}, here {port}",
    "a host listens on one port: write the same one on all its lines",
)
DEPLOY_HOST_CASE = _message(
    "L709",
    "'{host}' is written '{first}' on line {line}",
    "host names are case-insensitive: use one spelling",
)
DEPLOY_ESCAPE = _message(
    "L710",
    "'{escape}' is not a percent escape of UTF-8 text",
    "write %25 for %, %26 for &, %23 for #, %20 for a space",
)
DEPLOY_SPACE = _message(
    "L711", "a space is not allowed here", "write %20 in an argument; a comment begins with #"
)
DEPLOY_EMPTY = _message("L712", "the deployment is empty", "write one line //Type:id@host for every agent")
DEPLOY_NO_PROGRAM = _message(
    "L713",
    "the program has no resources and no coordinators, so there is no '{name}' to deploy",
    "check that this deployment belongs to this program",
)
DEPLOY_NOT_TEXT = _message(
    "L714", "the deployment is not UTF-8 text here (byte {byte})", "save it as UTF-8 text"
)
DEPLOY_WITNESS = _message(
    "L715", "{host} is already on line {line}", "remove this line: it is for a host without agents"
)

MISSING_ARGUMENT = _message(
    "L716",
    "{agent} has {count}, and its init reads arg[{index}] on line {line} of the program",
    "end its line with ?{given}",
)

UNKNOWN_STARTABLE = _message(
    "L717", "the deployment has no coordinator '{id}'", "{function} takes the id of a startable coordinator"
)
NOT_STARTABLE = _message(
    "L718",
    "'{id}' is not startable",
    "write startable before its line in the deployment: it then starts only when a coordinator starts it",
)
DEPLOY_STARTABLE = _message(
    "L719", "'{id}' is a resource: resources start with their hosts", "remove startable from this line"
)

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
