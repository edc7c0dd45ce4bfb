"""Words of Python, C++, Java and ROS, with their equivalents in L.

All of them are valid names in L, so they are checked only after an error.
"""

from __future__ import annotations

from lfield.lang.language_library import FUNCTIONS

_ONE_TYPE = "write the type: int x = 1;"
_NO_LIST = "arrays grow: write int[], and a.append(...), a.insert(...), a.remove(...) or a.pop()"
_NO_MAP = "write map<string, int>, with keys of type string, int or an enum"
_NO_MODULES = "L has no modules: call library functions by their name alone, as in sleep(1.0) or print(...)"
_TOGETHER = "write together { ... } around the portal calls that should run at the same time"
_METHOD = "write private void name(...) { ... } inside a resource, a coordinator or a class"
_PRINT = "write print(...)"
_IF = "write if (...) ... else if (...) ... else ..."
_YIELD = "write return with the value; yield() only runs other threads"
_NO_WAIT = "leave it out: a call returns when it is complete; for the result of a future f write f.await()"
_NO_MODIFIER = "units have no modifier; leave it out"
_ASYNC = "write async before the call of a portal, without parentheses: async arm.work()"
_CONST = "leave it out here; const declares constants at the top level of a file: const int NAME = 1;"
_EACH = "write for (int x : array) { ... }, with the type of the elements"
_NODES = "L has no nodes and topics: write a resource with portals, and call these from a coordinator"
_SLEEP = "write sleep(1.0), in seconds"
_NOW = "write now(), in seconds since 1970"
_THREADS = "declare portals synchronized; for calls that run at the same time write together { ... }"
JOIN = 'join text with +, as in "n is " + i2s(n)'

#: Type names of other languages and the corresponding L type.
FOREIGN_TYPES = {
    "String": "string",
    "str": "string",
    "char": "string",
    "bool": "boolean",
    "Boolean": "boolean",
    "float": "real",
    "double": "real",
    "Float": "real",
    "Double": "real",
    "float32": "real",
    "float64": "real",
    "long": "int",
    "short": "int",
    "byte": "int",
    "unsigned": "int",
    "signed": "int",
    "integer": "int",
    "Integer": "int",
    "Long": "int",
    "Int": "int",
    "number": "real",
    "size_t": "int",
    **{
        f"{sign}int{bits}{end}": "int" for sign in ("u", "") for bits in (8, 16, 32, 64) for end in ("_t", "")
    },
}

#: Types of other languages that L has no type for.
CONTAINERS = {
    **dict.fromkeys(
        ("List", "list", "vector", "Vector", "ArrayList", "array", "Array", "deque", "Vec", "Sequence"),
        _NO_LIST,
    ),
    **dict.fromkeys(("Map", "map", "HashMap", "unordered_map", "dict", "Dict", "Dictionary"), _NO_MAP),
    **dict.fromkeys(
        ("set", "Set", "HashSet", "frozenset"), "write map<string, boolean>, or an array with contains(x)"
    ),
    **dict.fromkeys(("tuple", "Tuple", "pair", "Pair"), "write a class with a field for each element"),
    **dict.fromkeys(
        ("Optional", "optional", "unique_ptr", "shared_ptr", "SharedPtr", "Ptr"),
        "write the class itself: a variable of a class may be null",
    ),
}
NO_GENERICS = "L has no generic types: write a class for each element type"
FOREIGN_TYPE_HINTS = {
    **CONTAINERS,
    **dict.fromkeys(("auto", "var", "let", "any", "Any", "object", "Object", "dynamic"), _ONE_TYPE),
    **dict.fromkeys(
        ("thread", "Thread", "mutex", "Mutex", "Lock"),
        _THREADS,
    ),
    **dict.fromkeys(("future", "Future", "Promise", "Task"), "write future<real>, with the result type"),
    **dict.fromkeys(("Node", "Publisher", "Subscription", "Client", "Service", "Timer", "Executor"), _NODES),
}

#: Names of values in other languages.
FOREIGN_VALUES = {
    "self": "this",
    "None": "null",
    "nil": "null",
    "NULL": "null",
    "nullptr": "null",
    "undefined": "null",
    "True": "true",
    "TRUE": "true",
    "False": "false",
    "FALSE": "false",
}

#: Modules and other names of other languages, used like variables.
FOREIGN_NAMES = {
    **dict.fromkeys(
        (
            "time",
            "math",
            "os",
            "sys",
            "asyncio",
            "threading",
            "random",
            "np",
            "numpy",
            "std",
            "Math",
            "Thread",
        ),
        _NO_MODULES,
    ),
    **dict.fromkeys(("rospy", "rclpy", "rclcpp", "ros", "node", "executor"), _NODES),
    **dict.fromkeys(("System", "cout", "cerr", "logger", "logging", "console"), _PRINT),
    "super": "L has no inheritance: put an object of the other class into a field",
}

#: Functions of other languages, and the equivalent in L.
FOREIGN_FUNCTIONS = {
    **dict.fromkeys(("println", "printf", "echo", "log_info", "loginfo", "puts"), "in L it is print(...)"),
    **dict.fromkeys(
        (f"{ros}_{level}" for ros in ("RCLCPP", "ROS") for level in ("INFO", "WARN", "ERROR")), _PRINT
    ),
    **dict.fromkeys(("get_logger", "getLogger"), _PRINT),
    **dict.fromkeys(("toString", "str", "to_string"), "in L it is i2s(...), f2s(...) or b2s(...)"),
    **dict.fromkeys(("parseInt", "atoi", "stoi"), "in L it is s2i(...)"),
    **dict.fromkeys(("atof", "stof", "stod", "parseFloat"), "in L it is s2f(...)"),
    **dict.fromkeys(("float", "double"), "L converts with i2f(...) and s2f(...)"),
    **dict.fromkeys(("bool",), "compare it with something, as in x != 0"),
    **dict.fromkeys(("delay", "sleep_for", "sleep_until"), "in L it is sleep(seconds)"),
    **dict.fromkeys(
        ("sleep_ms", "usleep", "msleep", "delay_ms"), "in L it is sleep(seconds): write sleep(0.1) for 100 ms"
    ),
    **dict.fromkeys(("len", "sizeof", "size"), "write a.length()"),
    **dict.fromkeys(("strcmp", "equals"), "compare with ==, which compares the characters of text"),
    **dict.fromkeys(("fabs",), "in L it is abs(...)"),
    **dict.fromkeys(("trunc",), "in L it is f2i(...)"),
    **dict.fromkeys(("rand", "randint"), "in L it is random(n)"),
    "range": "write for (int i = 0; i < n; i += 1) { ... }",
    "enumerate": "write for (int i = 0; i < a.length(); i += 1) { ... }",
    "not": "write !(...)",
    "assert": 'write if (!(...)) throw new Exception("reason");',
    "await": _NO_WAIT,
    **dict.fromkeys(("spawn", "launch", "go", "gather", "together"), _TOGETHER),
    "async": _ASYNC,
    **dict.fromkeys(("isinstance", "typeof", "type"), "every variable has one static type"),
    "open": "L reads no files: pass values as deployment arguments",
    **dict.fromkeys(
        ("input", "scanf", "readLine"), "a resource reads a line of the operator, with a limit: read(30.0)"
    ),
    **dict.fromkeys(("lock", "acquire"), "declare the portal synchronized"),
    **dict.fromkeys(("timeout", "wait_for"), "write within (seconds) { ... }"),
    **dict.fromkeys(("wait_until", "waitUntil"), "write wait until (...);"),
    **dict.fromkeys(("until", "unless"), "write while (!(...)) or if (!(...))"),
    **dict.fromkeys(("exit", "quit", "abort"), 'write throw new Exception("reason");'),
    **dict.fromkeys(("repeat", "times"), "write for (int i = 0; i < n; i += 1) { ... }"),
}

#: Methods of text and of arrays in other languages, and the equivalent in L.
STRING_METHODS = {
    **dict.fromkeys(("equals", "compare", "compareTo", "strcmp"), "write ==, which compares the characters"),
    **dict.fromkeys(("format", "join", "concat", "append", "f"), JOIN),
    **dict.fromkeys(("size", "len", "count"), "in L it is length()"),
    **dict.fromkeys(("isEmpty", "empty"), 'compare with "", as in s == ""'),
    **dict.fromkeys(("charAt", "at", "get"), "write s.substring(i, i + 1)"),
    **dict.fromkeys(("contains", "find", "startsWith", "startswith"), "write indexOf(...), -1 if not found"),
    **dict.fromkeys(("substr", "slice"), "write s.substring(from, to)"),
    **dict.fromkeys(("c_str", "toString", "encode", "decode"), "leave it out"),
}
ARRAY_METHODS = {
    **dict.fromkeys(("size", "len", "count"), "in L it is length()"),
    **dict.fromkeys(("push_back", "push", "add", "emplace_back"), "in L it is append(...)"),
    **dict.fromkeys(("extend", "addAll"), "write a loop with append(...)"),
    **dict.fromkeys(("pop_back", "removeLast"), "in L it is pop()"),
    **dict.fromkeys(("erase", "delete", "removeAt"), "in L it is remove(index)"),
    **dict.fromkeys(("clear", "resize"), "assign a new array: a = new int[0];"),
    **dict.fromkeys(("at", "get", "set"), "write a[i]"),
    **dict.fromkeys(("index", "find"), "in L it is indexOf(...), -1 if not found"),
    **dict.fromkeys(("includes", "has"), "in L it is contains(...)"),
    **dict.fromkeys(("subList", "substring", "copyOfRange"), "in L it is slice(from, to)"),
    **dict.fromkeys(("sorted", "sort_by", "sortBy"), "in L it is sort(), or sort(method)"),
    **dict.fromkeys(("map", "filter"), "write a loop over the array"),
    **dict.fromkeys(("empty", "isEmpty"), "compare a.length() with 0"),
}

MAP_METHODS = {
    **dict.fromkeys(("size", "len", "count"), "in L it is length()"),
    **dict.fromkeys(("put", "insert", "add", "update"), "write m[key] = value;"),
    **dict.fromkeys(("containsKey", "has", "has_key", "find", "exists"), "in L it is contains(key)"),
    **dict.fromkeys(("at", "getOrDefault"), "write m[key]; contains(key) says whether there is one"),
    **dict.fromkeys(("erase", "pop", "delete"), "in L it is remove(key)"),
    **dict.fromkeys(("keySet", "items", "entrySet"), "write for (string key : m) { ... }"),
    **dict.fromkeys(("empty", "isEmpty"), "compare m.length() with 0"),
}

#: Words that begin a member in other languages, and the equivalent in L.
FOREIGN_MODIFIERS = {
    "static": "every method belongs to an object; leave it out",
    "final": "leave it out",
    "const": _CONST,
    "constexpr": _CONST,
    "readonly": "leave it out",
    "protected": "write private or public",
    "abstract": "leave it out and give the method a body",
    "internal": "write private or public",
    "virtual": "leave it out",
    "override": "leave it out",
    "inline": "leave it out",
    "explicit": "leave it out",
    "volatile": "leave it out",
    "mutable": "leave it out",
    "async": _NO_WAIT,
}

#: Words between the parameters of a method and its body.
METHOD_ENDS = {
    "throws": "leave it out: any method may throw",
    "const": "leave it out",
    "override": "leave it out",
    "noexcept": "leave it out",
    "final": "leave it out",
}

#: Words that begin a method in other languages.
METHOD_WORDS = ("def", "func", "fn", "function", "fun", "sub")

#: Words that begin a statement in other languages, and the equivalent in L.
FOREIGN_STATEMENTS = {
    **dict.fromkeys(("switch", "case", "match", "when"), _IF),
    "do": "write while (true) { ... if (!(...)) break; }",
    "loop": "write while (true) { ... }",
    "until": "write while (!(...)) { ... }",
    "unless": "write if (!(...)) ...",
    "repeat": "write for (int i = 0; i < n; i += 1) { ... }",
    "goto": "use while, for, break and continue",
    "foreach": _EACH,
    **dict.fromkeys(("elif", "elsif", "elseif", "elseIf"), "write else if"),
    **dict.fromkeys(("var", "let", "auto"), _ONE_TYPE),
    **dict.fromkeys(("const", "constexpr"), _CONST),
    **dict.fromkeys(("final", "volatile", "mutable"), "leave it out"),
    "static": "declare a field of the resource, coordinator or class",
    **dict.fromkeys(("delete", "del", "free"), "objects are freed automatically; leave it out"),
    "pass": "leave it out: a block may be empty",
    "raise": 'write throw new Exception("reason");',
    "except": "write catch (Exception e) { ... }",
    "assert": 'write if (!(...)) throw new Exception("reason");',
    **dict.fromkeys(("parallel", "par", "concurrent", "async", "spawn", "fork", "launch"), _TOGETHER),
    **dict.fromkeys(("await", "co_await"), _NO_WAIT),
    **dict.fromkeys(("yield", "co_yield", "co_return"), _YIELD),
    **dict.fromkeys(("lock", "synchronize", "atomic"), "declare the portal synchronized"),
    **dict.fromkeys(("timeout", "deadline"), "write within (seconds) { ... }"),
    "with": "write try { ... } finally { ... }, within (seconds) { ... } or reserve (arm) { ... }",
    **dict.fromkeys(("print", "echo"), _PRINT),
    **dict.fromkeys(("global", "nonlocal"), "leave it out: fields of the unit are visible in its methods"),
    **dict.fromkeys(METHOD_WORDS, _METHOD),
    **dict.fromkeys(("import", "from", "using", "use"), 'write include "file.L"; at the top of the file'),
    "typedef": "write the type itself",
    **dict.fromkeys(("struct", "namespace", "template"), "write class Name { ... } at the top level"),
    "enum": "write enum Name { A, B } at the top level",
}
#: Words that begin a unit in other languages, and the equivalent in L.
FOREIGN_UNITS = {
    **dict.fromkeys(("import", "using", "from", "use"), 'write include "file.L";'),
    "package": "files need no package; leave it out",
    "namespace": "names need no namespace; leave it out",
    "template": NO_GENERICS,
    "typedef": "write the type itself",
    "interface": "write the class itself",
    "struct": "write class Name { ... }",
    "enum": "write enum Name { A, B }",
    **dict.fromkeys(
        ("public", "private", "protected", "abstract", "final", "export", "static", "extern", "pub"),
        _NO_MODIFIER,
    ),
    **dict.fromkeys(
        (
            "void",
            "int",
            "real",
            "boolean",
            "string",
            "bool",
            "double",
            "float",
            "auto",
            "var",
            "let",
            "std",
            "unsigned",
        ),
        "write const int NAME = 1; for a constant; variables are inside a resource, a coordinator or a class",
    ),
    **dict.fromkeys(("const", "constexpr"), "write const int NAME = 1;"),
    **dict.fromkeys((*METHOD_WORDS, "async"), _METHOD),
    "pass": "leave it out: a program has no statements outside of methods",
    **dict.fromkeys(("node", "robot", "device", "actor", "server", "service"), "write resource Name { ... }"),
    **dict.fromkeys(("mission", "agent", "process", "task"), "write coordinator Name { ... }"),
    "module": "write resource, coordinator or class Name { ... }",
    **dict.fromkeys(("if", "while", "for", "main"), "a program starts in init(string[] arg) of each agent"),
}

#: Operators that are words in other languages: the operator of L, or "" for none, and the equivalent.
WORD_OPERATORS = {
    "and": ("&&", "write &&"),
    "or": ("||", "write ||"),
    "is": ("==", "write =="),
    "mod": ("%", "write %"),
    "div": ("/", "write /: it divides whole numbers if both sides are int"),
    "xor": ("!=", "write !=, for two booleans"),
    "in": ("", "write array.contains(x), or map.contains(key)"),
    "not": ("", "write !array.contains(x), or !map.contains(key)"),
    "instanceof": ("", "every variable has one static type"),
    "as": ("", "L converts with functions: i2f, f2i, i2s, f2s, b2s, s2i, s2f"),
}
#: Words before an operand.
WORD_PREFIXES = {
    "not": "write !",
    "await": _NO_WAIT,
    "co_await": _NO_WAIT,
    "async": _ASYNC,
    "spawn": _TOGETHER,
    "launch": _TOGETHER,
    "yield": _YIELD,
    "typeof": "every variable has one static type",
    "sizeof": "write a.length()",
    "lambda": "methods are not values: write a method and call it by its name",
}
#: The correct form instead of a symbol that begins no expression of L.
FOREIGN_SYMBOLS = {
    ":": "a block is in braces: { ... }",
    "[": "the elements of an array are in braces: new int[] {1, 2}",
    "emit": "emit belongs in the head of a portal and names its type; in the body write return value;",
    ".": "write a name before the dot",
}
#: Members of modules and namespaces, as in `ros::spin()`, `std::cout` and `time.sleep(1)`.
MODULE_MEMBERS = {
    **dict.fromkeys(
        ("spin", "spinOnce", "spin_once", "spin_some", "spin_until_future_complete"),
        "leave it out: a resource waits for calls of its portals",
    ),
    **dict.fromkeys(("init", "init_node", "shutdown"), "leave it out: lfield starts and ends every agent"),
    **dict.fromkeys(("ok", "is_shutdown"), "write true: lfield ends every agent"),
    **dict.fromkeys(("Duration", "sleep", "sleep_for", "sleep_until", "seconds", "milliseconds"), _SLEEP),
    **dict.fromkeys(("Rate", "WallRate", "create_rate"), "write sleep(0.1) in the loop for 10 Hz"),
    **dict.fromkeys(("Time", "time", "now", "monotonic", "get_clock"), _NOW),
    **dict.fromkeys(
        (
            *("cout", "cerr", "clog", "endl", "print", "println", "printf", "info", "warn", "error", "log"),
            *("loginfo", "logwarn", "logerr", "logdebug"),
        ),
        _PRINT,
    ),
    **dict.fromkeys(("gather", "create_task", "async"), _TOGETHER),
    **dict.fromkeys(("make_shared", "make_unique"), "write new Name(...), with the name of a class"),
    **dict.fromkeys(("exception", "runtime_error"), "write Exception"),
    "pi": "write 3.141592653589793",
    "string": "write string",
    **FOREIGN_TYPE_HINTS,
}


def type_hint(name: str) -> str | None:
    """The equivalent in L of a type of another language, or None."""
    if name in FOREIGN_TYPES:
        return f"in L it is called {FOREIGN_TYPES[name]}"
    return FOREIGN_TYPE_HINTS.get(name)


def variable_hint(name: str, member: str = "") -> str | None:
    """The equivalent in L of a name of another language, or of a member of it; None for no hint."""
    if name in FOREIGN_VALUES:
        return f"in L it is called {FOREIGN_VALUES[name]}"
    return _member_hint(member) or FOREIGN_NAMES[name] if name in FOREIGN_NAMES else None


def qualified_hint(names: list[str]) -> str:
    """The equivalent in L of `std::vector` or `ros::spin`, given its parts."""
    namespace, *members = names
    hints = [hint for member in members if (hint := _member_hint(member))]
    # The last part may only name a pointer, as in rclcpp::Node::SharedPtr: the first part is more specific.
    return hints[0] if hints else FOREIGN_NAMES.get(namespace, "members are reached with a dot: object.name")


def _member_hint(member: str) -> str | None:
    if member not in MODULE_MEMBERS and any(function.name == member for function in FUNCTIONS):
        return f"write {member}(...)"
    return MODULE_MEMBERS.get(member) or FOREIGN_FUNCTIONS.get(member)
