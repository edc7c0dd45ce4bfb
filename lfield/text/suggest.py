"""Did-you-mean: the closest of the names that would have been right, and the habits of other languages."""

from __future__ import annotations

from bisect import bisect
from collections.abc import Iterable
from difflib import get_close_matches
from functools import lru_cache

#: Type names of other languages and the L type that is meant.
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
    "long": "int",
    "short": "int",
    "byte": "int",
    "unsigned": "int",
    "integer": "int",
    "Integer": "int",
    "Long": "int",
    "Int": "int",
}

#: Names of values in other languages.
FOREIGN_VALUES = {
    "self": "this",
    "None": "null",
    "nil": "null",
    "NULL": "null",
    "nullptr": "null",
    "True": "true",
    "TRUE": "true",
    "False": "false",
    "FALSE": "false",
}

#: Functions of other languages.
FOREIGN_FUNCTIONS = {
    "println": "print",
    "printf": "print",
    "toString": "i2s",
    "str": "i2s",
    "parseInt": "s2i",
    "atoi": "s2i",
    "delay": "sleep",
    "len": "a.length",
}

#: Words that begin a member in other languages, and what L has instead.
FOREIGN_MODIFIERS = {
    "static": "every method belongs to an object; leave it out",
    "final": "leave it out",
    "const": "leave it out",
    "protected": "write private or public",
    "abstract": "leave it out and give the method a body",
    "internal": "write private or public",
    "virtual": "leave it out",
    "override": "leave it out",
}

#: Words that begin a statement or a unit in other languages, and what L has instead.
FOREIGN_STATEMENTS = {
    "switch": "write if (...) ... else if (...) ... else ...",
    "case": "write if (...) ... else if (...) ... else ...",
    "do": "write while (true) { ... if (...) break; }",
    "goto": "use while, for, break and continue",
    "foreach": "write for (T x : array) { ... }",
    "elif": "write else if",
    "elsif": "write else if",
    "var": "write the type: int x = 1;",
    "let": "write the type: int x = 1;",
    "const": "leave it out",
    "final": "leave it out",
    "static": "declare a field of the resource, coordinator or class",
    "delete": "objects are freed by themselves; leave it out",
    "raise": 'write throw new Exception("what went wrong");',
}
FOREIGN_UNITS = {
    "import": 'write include "file.L";',
    "package": "files need no package; leave it out",
    "using": 'write include "file.L";',
    "interface": "write the class itself",
    "struct": "write class Name { ... }",
    "enum": "use int constants",
    "public": "units have no modifier; leave it out",
    "private": "units have no modifier; leave it out",
    "abstract": "units have no modifier; leave it out",
    "final": "units have no modifier; leave it out",
    "void": "write the method inside a resource, a coordinator or a class",
    "function": "write the method inside a resource, a coordinator or a class",
    "def": "write the method inside a resource, a coordinator or a class",
}


#: The longest name, and the most known ones, among which the likest is looked for.
LONGEST, MOST = 64, 100


def closest(name: str, known: Iterable[str]) -> str | None:
    """The known name most like this one, or None when none is like it; case does not count.

    Of very many names only those near in the alphabet are looked at: a file of thousands of mistakes among
    thousands of names is told of in seconds.
    """
    if len(name) > LONGEST:
        return None
    names = sorted(known)
    if len(names) > MOST:
        at = bisect(names, name)
        names = names[max(at - MOST // 2, 0) : at + MOST // 2]
    return _closest(name.lower(), tuple(names))


@lru_cache(maxsize=64)
def _closest(name: str, known: tuple[str, ...]) -> str | None:
    """Kept for a while: who forgets one declaration is told of every place that needs it."""
    by_lower = {k.lower(): k for k in known}
    found = get_close_matches(name, list(by_lower), n=1, cutoff=0.65)
    return by_lower[found[0]] if found else None


def did_you_mean(name: str, known: Iterable[str]) -> str | None:
    """`did you mean 'x'?`, or None when nothing is like it."""
    close = closest(name, known)
    return f"did you mean '{close}'?" if close is not None else None


def listed(names: Iterable[str], nothing: str = "none") -> str:
    """Names for a sentence: `a, b and c`."""
    items = list(names)
    if not items:
        return nothing
    return items[0] if len(items) == 1 else f"{', '.join(items[:-1])} and {items[-1]}"
