"""The parts of the library in L that a program uses: methods for arrays, and classes of maps, each by types.

The text of a method for arrays is parsed again for every instance, and its body is checked in the unit that
uses it, after all bodies of the program. In the texts `T` is the type of elements, `K` that of keys, `V` that
of values.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import cache
from pathlib import Path

from msgspec import Struct, field

from lfield.lang import syntax, tree
from lfield.lang.parser import parse_file
from lfield.lang.types import INT, STRING, VOID, FutureType, MapType, Type
from lfield.text.source_text import Diagnostics, Source

#: The name of every source of the library.
LIBRARY_FILE = "<library>"
#: The name of the constructor of the classes of maps.
MAP_CONSTRUCTOR = "Map"
#: The name of the constructor of the classes of futures.
FUTURE_CONSTRUCTOR = "Future"
_FUTURE = Path(__file__).with_name("future.L")
#: In the class of futures of calls without a result: the omitted text, and the replacement of T.
_ONLY_WITH_RESULT = re.compile(
    r"^.*(?:T\[\] result|result = place|return result).*\n|, T\[\] place", re.MULTILINE
)
_RETURNS = re.compile(r"return (await\(\));")
_MAP = Path(__file__).with_name("map.L")
_REFUSAL = 'if (key == null) throw new NullException("a key of a map is null");'
#: By type of keys: the bucket of a key among n, the text of a key, and the statement that refuses null.
_KEYS = {
    STRING: ("key.hash() % n", '"\\"" + key + "\\""', _REFUSAL),
    INT: ("(key % n + n) % n", "i2s(key)", ""),
}
_ENUM_KEY = ("(key.ordinal() % n + n) % n", "key.name()", "")
_METHODS = (Path(__file__).with_name("arrays.L"), Path(__file__).with_name("futures.L"))
_NAME = re.compile(r"(\w+)\(")


@cache
def array_texts() -> dict[str, str]:
    """For each method of arrays, by name, the text of a class with that method alone."""
    texts = (file.read_text(encoding="utf-8").removesuffix("}\n") for file in _METHODS)
    methods = [method for text in texts for method in text.split("    private ")[1:]]
    return {_NAME.findall(method)[0]: f"class Arrays {{\n    private {method}}}\n" for method in methods}


@cache
def _map_text() -> str:
    return _MAP.read_text(encoding="utf-8")


def enum_text(name: str, members: Sequence[str]) -> str:
    """The methods of an enum, with numbers for its members."""
    names = (f'if (number == {i}) return "{member}";' for i, member in enumerate(members))
    numbers = (f'if (name == "{member}") return {i};' for i, member in enumerate(members))
    null = 'if (name == null) throw new NullException("of(null)");'
    unknown = f'throw new ConversionException("the enum {name} has no member " + name);'
    return (
        f"// The members of the enum {name}.\nclass Enums {{\n"
        f"    private string name(int number) {{\n{_lines(names)}        return i2s(number);\n    }}\n"
        f"    private int of(string name) {{\n{_lines((null, *numbers))}        {unknown}\n    }}\n}}\n"
    )


def _lines(statements: Iterable[str]) -> str:
    return "".join(f"        {statement}\n" for statement in statements)


def _text_of(kind: MapType | FutureType) -> str:
    """The text of the class of a type, while its types are bound."""
    if isinstance(kind, MapType):
        bucket, text, refuse = _KEYS.get(kind.key, _ENUM_KEY)
        return _map_text().replace("BUCKET", bucket).replace("TEXT", text).replace("REFUSE;", refuse)
    text = _FUTURE.read_text(encoding="utf-8")
    if kind.value == VOID:
        text = _RETURNS.sub(r"\1;", _ONLY_WITH_RESULT.sub("", text)).replace("public T ", "public void ")
    return text


class LibraryBody(Struct, frozen=True):
    """A method of the library whose body is not checked yet, and the meanings of the types in it.

    `function`: the method sees no members of its unit.
    """

    method: tree.Method
    written: syntax.Method
    parameters: Mapping[str, Type]
    function: bool = False


class LibraryUses(Struct):
    """The methods of the library that a program uses, and their texts."""

    #: The meanings of the names of types while a method of the library is checked.
    parameters: Mapping[str, Type] = field(default_factory=dict)
    #: The texts, by text.
    sources: dict[str, Source] = field(default_factory=dict)
    #: The classes of maps.
    units: list[tree.Unit] = field(default_factory=list)
    _methods: dict[object, tree.Method] = field(default_factory=dict)
    _unchecked: list[LibraryBody] = field(default_factory=list)

    def source(self, text: str) -> Source:
        """The source with that text, created at its first use."""
        return self.sources.setdefault(text, Source(LIBRARY_FILE, text))

    def method(self, key: object, make: Callable[[], LibraryBody]) -> tree.Method:
        """The instance of a method for a key, created at its first use."""
        if key not in self._methods:
            body = make()
            self._methods[key] = body.method
            self._unchecked.append(body)
        return self._methods[key]

    def class_of(
        self, kind: MapType | FutureType, usage: tree.Usage, resolve: Callable[[syntax.TypeName], Type]
    ) -> tree.Unit:
        """The class of a type of maps or futures, while its types are bound; its bodies are checked later."""
        source = self.source(_text_of(kind))
        written = parse_file(source, Diagnostics()).units[0]
        unit = tree.Unit(kind.name, "class", usage, written.span)
        for number, each in enumerate(written.fields):
            unit.add_field(tree.Field(each.name, resolve(each.type), number, each.public, each.span))
        for head in written.methods:
            method = tree.Method(
                head.name,
                head.kind,
                unit,
                [tree.Local(p.name, resolve(p.type), p.span) for p in head.parameters],
                VOID if head.result is None else resolve(head.result),
                head.public,
                head.synchronized,
                head.span,
                head.end,
            )
            unit.add_method(method)
            self._unchecked.append(LibraryBody(method, head, self.parameters))
        self.units.append(unit)
        return unit

    def unchecked(self) -> Iterator[LibraryBody]:
        """The methods whose bodies are to be checked; checking one may add others."""
        while self._unchecked:
            yield self._unchecked.pop(0)

    @contextmanager
    def bound(self, parameters: Mapping[str, Type]) -> Iterator[None]:
        """Let names of types mean these types."""
        before, self.parameters = self.parameters, parameters
        yield
        self.parameters = before
