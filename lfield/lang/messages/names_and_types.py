"""Diagnostics of names and declarations (L3xx) and of types (L4xx)."""

from __future__ import annotations

from lfield.text.message_tables import FindingTable

NAMES_AND_TYPES = FindingTable("L3", "L4", warnings="L9")
_message = NAMES_AND_TYPES.message

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
    "write a.sort(nearer) with a method of this unit: boolean nearer({element} a, {element} b), which "
    "returns whether a comes before b, or nearer({element} a), which returns an int, real or string key",
)
SORT_ARGUMENT = _message(
    "L430",
    "sort takes nothing, or the name of a method",
    "write a.sort(), or a.sort(nearer) with a method of this unit",
)
SORT_METHOD = _message(
    "L431",
    "sort cannot compare elements by '{name}': {found}",
    "write boolean {name}({element} a, {element} b), which returns whether a comes before b, or "
    "{name}({element} a), which returns a key of type int, real or string",
)
MAP_TYPES = _message(
    "L432",
    "a map needs two types: the type of its keys and the type of its values",
    "write them in angle brackets, as in map<string, int>",
)
MAP_KEY = _message(
    "L433",
    "the key type of a map must be string, int or an enum, not {given}",
    "use a name or a number as the key, and store the rest as the value",
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
    "the function '{function}' cannot change {what}, which belongs to its caller",
    "change a copy of the array, such as a.slice(0, a.length()), or create a new object",
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
    "write loop {name} at 10.0 {{ ... }}, in hertz, or loop {name} every 0.1 {{ ... }}, in seconds; write "
    "priority and when after the rate",
)
LOOP_PERIOD = _message(
    "L472",
    "the period of a loop is {given}: it must be from 0.001 s to 1000 s",
    "write the rate in hertz after at, or the period in seconds after every",
)
LOOP_PRIORITY = _message(
    "L473",
    "the priority of a loop is a whole number",
    "write priority 2, a constant: a loop suppresses those with lower numbers; portals have 0",
)
LOOP_UNCONDITIONAL = _message(
    "L474",
    "the loop '{name}' has no `when`, so {lower} with a lower priority can never run",
    "add when (condition), or give this loop the lowest priority",
)
LOOP_NAME = _message("L475", "'{name}' is already a field (line {line})", "choose another name for the loop")
LOOP_MEMBER = _message("L476", "a loop has no method '{name}'", "it has running() and overruns()")
LOOP_VALUE = _message(
    "L477", "the loop '{name}' is not a value", "call its methods: {name}.running() and {name}.overruns()"
)
LOOP_CALL = _message(
    "L478",
    "the loop '{name}' cannot be called",
    "the thread of the loop runs its body at each tick; move the code into a method, and call that method",
)
TOO_MANY_LOOPS = _message(
    "L479",
    "a resource has at most {limit} loops",
    "move the statements of several loops with the same rate into one loop",
)

LIMIT_OVER = _message(
    "L460",
    "the time limit of {name} must be more than 0 seconds, this is {given}",
    "write the longest wait in seconds, as in {example}; after this time {name} throws TimeLimitException",
)

ASYNC_CALL = _message(
    "L450",
    "async must be followed by a call of a portal, and this is not such a call",
    "call a portal of a proxy or of an offer, as in async arm.lift(1.5); remove async before any other call",
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
    "{name}() takes {argument}",
    "write futures.next(), futures.race(), or futures.race(enough) with a method boolean enough(real result)",
)
RACE_METHOD = _message(
    "L456",
    "race needs a method that returns boolean and has one parameter, of type {of}; {found}",
    "write private boolean {name}({of} result) {{ ... }} in this unit, which returns whether a result wins",
)
FUTURE_TYPE = _message(
    "L457",
    "a future needs one type: the type of the result of its call",
    "write future<real>, or future<void> for a call without a result",
)
FUTURE_NEW = _message(
    "L458", "a {type} is not created with new", "begin a call: {type} f = async arm.lift(1.5);"
)
