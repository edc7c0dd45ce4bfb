"""Values of portal calls as msgpack bytes: numbers, texts, lists, maps, and objects as an extension type.

Values are trees: the copies of an object that occurs twice are two objects. Depth and number are limited, so
the decoding of a peer's bytes takes a bounded time.
"""

from __future__ import annotations

from collections.abc import Sequence

import msgspec

from lfield.vm.person_calls.l_object import LObject

#: The deepest nesting, and the most values of one message.
MAX_DEPTH, MAX_VALUES = 32, 1 << 16
#: The extension type of an object: an array of its class and its fields.
_OBJECT = 1
_UNREADABLE = (msgspec.MsgspecError, UnicodeDecodeError, RecursionError, TypeError, ValueError)


class UnsendableValue(Exception):
    """A value that has no encoding, with the reason."""


def encode_values(values: Sequence[object], longest: int) -> bytes:
    """The bytes of some values, at most `longest`. Raises UnsendableValue."""
    try:
        data = msgspec.msgpack.encode(_Encoding().plain(list(values), 0))
    except (TypeError, OverflowError, UnicodeEncodeError) as error:
        raise UnsendableValue(str(error)) from None
    if len(data) > longest:
        raise UnsendableValue(f"the values take {len(data)} bytes, more than {longest}")
    return data


def decode_values(data: bytes) -> list[object]:
    """The values in a message of a peer. Raises UnsendableValue."""
    try:
        values = msgspec.msgpack.decode(data, ext_hook=_object)
    except _UNREADABLE as error:
        raise UnsendableValue(f"the values cannot be decoded: {error}") from None
    if not isinstance(values, list):
        raise UnsendableValue("the values are not a list")
    _Encoding().plain(values, 0)
    return values


def _object(code: int, data: memoryview) -> LObject:
    if code != _OBJECT:
        raise ValueError(f"unknown extension type {code}")
    name, fields = msgspec.msgpack.decode(data, ext_hook=_object)
    if not isinstance(name, str) or not isinstance(fields, dict) or not all(map(_is_text, fields)):
        raise ValueError("an object has a class and fields with names")
    value = LObject(name)
    assert isinstance(value.fields, dict)
    value.fields.update(fields)
    return value


def _is_text(value: object) -> bool:
    return isinstance(value, str)


class _Encoding:
    """Counts the values of one message."""

    def __init__(self) -> None:
        self._remaining = MAX_VALUES

    def plain(self, value: object, depth: int) -> object:
        """The value in types of msgpack. Raises UnsendableValue."""
        self._remaining -= 1
        if depth > MAX_DEPTH:
            raise UnsendableValue(f"values are nested more than {MAX_DEPTH} deep, or contain themselves")
        if self._remaining < 0:
            raise UnsendableValue(f"there are more than {MAX_VALUES} values")
        match value:
            case None | bool() | int() | float() | str():
                return value
            case list() | tuple():
                return [self.plain(each, depth + 1) for each in value]
            case dict():
                return {self._key(key): self.plain(each, depth + 1) for key, each in value.items()}
            case LObject():
                fields = {name: self.plain(each, depth + 1) for name, each in value.fields.items()}
                return msgspec.msgpack.Ext(_OBJECT, msgspec.msgpack.encode([value.class_name, fields]))
        raise UnsendableValue(f"a {type(value).__name__} is not a value of L")

    def _key(self, key: object) -> object:
        if not isinstance(key, bool | int | float | str):
            raise UnsendableValue(f"the key of a map is a {type(key).__name__}: it is a number or a text")
        return key
